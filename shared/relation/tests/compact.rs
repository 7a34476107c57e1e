//! What the spatial graph of Wendland's kernel promises beyond that of the others: it is what its
//! definition says, and it is continuous.

use std::collections::BTreeMap;

use muster_model::settings::{IngestSettings, SpatialKernel, SpatialScale, SpatialSettings};
use muster_relation::kernel::{MIN_WEIGHT, WENDLAND_C2_SLOPE, wendland_c2};
use muster_relation::{Edge, median_nearest_neighbour_distance, spatial_edges};
use proptest::prelude::*;

type Point = [f64; 3];

/// The largest change of a weight per relative change of the radius of its edge: r times the slope of
/// the kernel, which is largest at 2/5.
const STRETCH: f64 = 20.0 * 0.16 * 0.216;

fn settings(cutoff: f64, all_pairs_up_to: u32, neighbours: u32) -> SpatialSettings {
    SpatialSettings {
        kernel: SpatialKernel::WendlandC2,
        cutoff,
        all_pairs_up_to,
        neighbours,
        ..IngestSettings::default().spatial
    }
}

fn weights(edges: &[Edge]) -> BTreeMap<(u32, u32), f64> {
    edges.iter().map(|&(source, target, weight)| ((source, target), weight)).collect()
}

fn distance(left: &Point, right: &Point) -> f64 {
    left.iter().zip(right).map(|(l, r)| (l - r) * (l - r)).sum::<f64>().sqrt()
}

/// The radius of each robot by its definition, with all pairs.
fn radii(fleet: &[Point], settings: &SpatialSettings) -> Vec<f64> {
    let Some(scale) = median_nearest_neighbour_distance(fleet) else {
        return vec![0.0; fleet.len()];
    };
    let common = (settings.cutoff * scale).min(settings.radius_m.unwrap_or(f64::INFINITY));
    let most = 4 * settings.neighbours as usize;
    let radius = |point: &Point| {
        let mut all: Vec<f64> = fleet.iter().map(|other| distance(point, other)).collect();
        all.sort_by(f64::total_cmp);
        // The first is the robot itself.
        all.get(most + 1).map_or(common, |too_many| common.min(*too_many))
    };
    if fleet.len() <= settings.all_pairs_up_to as usize {
        return vec![common; fleet.len()];
    }
    fleet.iter().map(radius).collect()
}

/// The weight and the radius of the edge of each pair, with all pairs.
fn by_definition(fleet: &[Point], settings: &SpatialSettings) -> Vec<((u32, u32), f64, f64)> {
    let radii = radii(fleet, settings);
    let mut pairs = Vec::new();
    for (i, left) in fleet.iter().enumerate() {
        for (j, right) in fleet.iter().enumerate().filter(|(j, _)| *j != i) {
            let radius = radii[i].min(radii[j]);
            let weight = wendland_c2(distance(left, right) / radius);
            pairs.push(((i as u32, j as u32), weight, radius));
        }
    }
    pairs
}

/// Scattered, with a crowd in which the bound on edges takes hold.
fn fleet() -> impl Strategy<Value = Vec<Point>> {
    let wide = prop::collection::vec(prop::array::uniform3(-50.0..50.0f64), 2..60);
    let crowd = prop::collection::vec(prop::array::uniform3(-2.0..2.0f64), 0..40);
    (wide, crowd).prop_map(|(mut wide, crowd)| {
        wide.extend(crowd);
        wide
    })
}

fn any_settings() -> impl Strategy<Value = SpatialSettings> {
    (1.0..12.0f64, prop_oneof![Just(0u32), Just(200)], 1..8u32)
        .prop_map(|(cutoff, pairs, neighbours)| settings(cutoff, pairs, neighbours))
}

/// A fleet, and where its robots are after a motion of at most so many metres each.
fn motion() -> impl Strategy<Value = (Vec<Point>, Vec<Point>, f64)> {
    (fleet(), -6.0..0.5f64).prop_flat_map(|(fleet, exponent)| {
        let most = 10f64.powf(exponent);
        let step = prop::array::uniform3(-1.0..1.0f64);
        let steps = prop::collection::vec(step, fleet.len());
        (Just(fleet), steps).prop_map(move |(fleet, steps)| {
            let share = most / 3f64.sqrt();
            let place = |(point, step): (&Point, &Point)| -> Point {
                std::array::from_fn(|axis| point[axis] + share * step[axis])
            };
            let moved = fleet.iter().zip(&steps).map(place).collect();
            (fleet, moved, most)
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn it_is_what_its_definition_says(
        fleet in fleet(), settings in any_settings(), radius_m in prop::option::of(1.0..40.0f64),
    ) {
        let settings = SpatialSettings { radius_m, ..settings };
        let found = weights(&spatial_edges(&fleet, &settings));
        for (pair, weight, _) in by_definition(&fleet, &settings) {
            let found = found.get(&pair).copied().unwrap_or(0.0);
            prop_assert!((found - weight).abs() <= 2.0 * MIN_WEIGHT, "{pair:?}: {found} {weight}");
        }
    }

    /// Distances change by at most 2δ and radii by at most 2δ × cutoff, as the median does: across the
    /// radius, across the bound on edges and across changes of neighbours, no weight jumps.
    #[test]
    fn weights_change_no_more_than_robots_move(
        (fleet, moved, most) in motion(), settings in any_settings(),
    ) {
        let (before, after) = (spatial_edges(&fleet, &settings), spatial_edges(&moved, &settings));
        let (before, after) = (weights(&before), weights(&after));
        let radii: BTreeMap<_, _> = by_definition(&moved, &settings)
            .into_iter()
            .map(|(pair, _, radius)| (pair, radius))
            .collect();
        for (pair, _, radius) in by_definition(&fleet, &settings) {
            let weight = |weights: &BTreeMap<_, f64>| weights.get(&pair).copied().unwrap_or(0.0);
            let change = (weight(&before) - weight(&after)).abs();
            let per_radius = 2.0 * (WENDLAND_C2_SLOPE + settings.cutoff * STRETCH);
            let bound = per_radius * most / radius.min(radii[&pair]);
            prop_assert!(change <= bound + 2.0 * MIN_WEIGHT, "{pair:?}: {change} above {bound}");
        }
    }

    #[test]
    fn no_robot_has_more_edges_than_are_allowed(fleet in fleet(), neighbours in 1..12u32) {
        let edges = spatial_edges(&fleet, &settings(1000.0, 0, neighbours));
        for robot in (0..).take(fleet.len()) {
            let degree = edges.iter().filter(|edge| edge.0 == robot).count();
            prop_assert!(degree <= 4 * neighbours as usize, "{degree} edges of {robot}");
        }
    }

    #[test]
    fn one_on_another_and_in_ranks_it_is_symmetric_and_bounded(
        fleet in prop::collection::vec(prop::array::uniform3((0..4i8).prop_map(f64::from)), 0..200),
        cutoff in 1.0..4.0f64,
        neighbours in 1..6u32,
    ) {
        let edges = spatial_edges(&fleet, &settings(cutoff, 0, neighbours));
        let weights = weights(&edges);
        prop_assert_eq!(weights.len(), edges.len());
        for (&(source, target), weight) in &weights {
            prop_assert_eq!(weights.get(&(target, source)), Some(weight));
            prop_assert!(*weight > 0.0 && *weight <= 1.0);
        }
        for robot in (0..).take(fleet.len()) {
            let degree = edges.iter().filter(|edge| edge.0 == robot).count();
            prop_assert!(degree <= 4 * neighbours as usize);
        }
    }
}

/// The largest change of a weight as something moves from one side of 0 to the other.
fn jump(place: impl Fn(f64) -> Vec<Point>, settings: &SpatialSettings) -> f64 {
    let sides = [1e-9, -1e-9].map(|off| weights(&spatial_edges(&place(off), settings)));
    let weight = |side: &BTreeMap<_, f64>, pair| side.get(pair).copied().unwrap_or(0.0);
    let pairs = sides[0].keys().chain(sides[1].keys());
    pairs.map(|pair| (weight(&sides[0], pair) - weight(&sides[1], pair)).abs()).fold(0.0, f64::max)
}

#[test]
fn where_the_nearest_neighbours_jump_it_does_not() {
    // The first robot is about as far from the second as from the fourth, who have nearer ones.
    let tied = |off: f64| -> Vec<Point> {
        vec![[0.0; 3], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 2.0 + off, 0.0], [0.0, 3.0, 0.0]]
    };
    let smooth = settings(20.0, 0, 1);
    let nearest = SpatialSettings {
        kernel: SpatialKernel::Gaussian,
        scale: SpatialScale::Fleet,
        width: 2.0,
        ..smooth.clone()
    };
    assert!(jump(tied, &nearest) > 0.5, "{}", jump(tied, &nearest));
    assert!(jump(tied, &smooth) < 1e-7, "{}", jump(tied, &smooth));
}

#[test]
fn a_crowd_costs_its_robots_radius_and_no_others() {
    // A rank of robots 1 m apart, and a crowd far away in which they stand ten times closer.
    let rank = |count: i32, step: f64, at: f64| {
        (0..count).map(move |place| [at + f64::from(place) * step, 0.0, 0.0])
    };
    let mut fleet: Vec<Point> = rank(60, 1.0, 0.0).collect();
    let alone = spatial_edges(&fleet, &settings(4.0, 0, 4));
    fleet.extend(rank(40, 0.1, 1000.0));
    let edges = spatial_edges(&fleet, &settings(4.0, 0, 4));
    let (rest, crowd): (Vec<Edge>, Vec<Edge>) = edges.into_iter().partition(|edge| edge.0 < 60);
    assert_eq!(rest, alone);
    // Eight to either side, and the ninth is where the radius ends.
    assert_eq!(crowd.iter().filter(|edge| edge.0 == 80).count(), 16);
    let weight = weights(&crowd)[&(80, 81)];
    assert!((weight - wendland_c2(1.0 / 9.0)).abs() < 1e-9, "{weight}");
}

#[test]
fn ten_thousand_robots_on_one_spot_stay_sparse_and_have_no_hub() {
    let mut positions = vec![[7.0, 7.0, 0.0]; 10_000];
    positions.extend([[9.0, 7.0, 0.0], [9.5, 7.0, 0.0], [9.0, 8.0, 0.0]]);
    let edges = spatial_edges(&positions, &settings(5.0, 200, 16));
    let mut degrees = vec![0; positions.len()];
    for &(source, _, weight) in &edges {
        assert!(weight > 0.0 && weight <= 1.0);
        degrees[source as usize] += 1;
    }
    assert!(degrees[..10_000].iter().all(|degree| *degree == 64));
    assert_eq!(degrees[10_000..], [2; 3], "those outside the crowd have each other");
}
