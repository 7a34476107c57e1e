//! What the spatial graph promises, on many fleets.

use std::collections::BTreeMap;

use muster_model::settings::{IngestSettings, SpatialKernel, SpatialScale, SpatialSettings};
use muster_relation::spatial::{MIN_WEIGHT, scale_neighbour};
use muster_relation::{Edge, median_nearest_neighbour_distance, spatial_edges};
use proptest::prelude::*;

type Point = [f64; 3];

fn settings() -> SpatialSettings {
    IngestSettings::default().spatial
}

/// Settings by which all robots are measured alike.
fn by_fleet() -> SpatialSettings {
    SpatialSettings { scale: SpatialScale::Fleet, width: 2.0, ..settings() }
}

/// Settings that relate only the nearest, whatever the size of the fleet.
fn sparse(neighbours: u32) -> SpatialSettings {
    SpatialSettings { all_pairs_up_to: 0, neighbours, ..settings() }
}

fn weights(edges: &[Edge]) -> BTreeMap<(u32, u32), f64> {
    edges.iter().map(|&(source, target, weight)| ((source, target), weight)).collect()
}

/// Equal but for rounding, which may also push an edge over the least weight.
fn assert_close(left: &[Edge], right: &[Edge]) -> Result<(), TestCaseError> {
    let (left, right) = (weights(left), weights(right));
    for pair in left.keys().chain(right.keys()) {
        let (l, r) = (left.get(pair).unwrap_or(&0.0), right.get(pair).unwrap_or(&0.0));
        prop_assert!((l - r).abs() <= 1e-7 * l.max(*r) + 2.0 * MIN_WEIGHT, "{pair:?}: {l} {r}");
    }
    Ok(())
}

#[test]
fn no_edges_without_a_pair() {
    for all_pairs_up_to in [0, 200] {
        let settings = SpatialSettings { all_pairs_up_to, ..settings() };
        assert_eq!(spatial_edges(&[], &settings), []);
        assert_eq!(spatial_edges(&[[1.0; 3]], &settings), []);
        assert_eq!(spatial_edges(&[[1.0; 3], [f64::NAN, 0.0, 0.0]], &settings), []);
    }
}

#[test]
fn the_kernels_are_those_of_the_settings() {
    let line = [[0.0; 3], [3.0, 0.0, 0.0], [0.0, 0.0, 6.0]];
    assert_eq!(median_nearest_neighbour_distance(&line), Some(3.0));
    let weight =
        |kernel| weights(&spatial_edges(&line, &SpatialSettings { kernel, ..by_fleet() }))[&(0, 2)];
    assert!((weight(SpatialKernel::Gaussian) - (-0.5f64).exp()).abs() < 1e-15);
    assert!((weight(SpatialKernel::Exponential) - (-1.0f64).exp()).abs() < 1e-15);
    let kernel = SpatialKernel::WendlandC2;
    for (cutoff, expected) in [(4.0, Some(0.1875)), (2.0, None), (1.5, None)] {
        let settings = SpatialSettings { kernel, cutoff, ..settings() };
        assert_eq!(weights(&spatial_edges(&line, &settings)).get(&(0, 2)).copied(), expected);
    }
}

#[test]
fn robots_are_measured_by_their_own_distances() {
    // A close team, and the same one spread out twice as far.
    let team = [0.0, 1.0, 3.0, 4.0];
    let line: Vec<Point> = team.iter().map(|x| [*x, 0.0, 0.0]).collect();
    let mut both = line.clone();
    both.extend(team.iter().map(|x| [1000.0 + 2.0 * x, 0.0, 0.0]));
    let settings = SpatialSettings { scale_neighbour: Some(2), ..settings() };
    let weights = weights(&spatial_edges(&both, &settings));
    for (&(i, j), weight) in weights.range((0, 0)..(4, 0)) {
        assert!(i < 4 && (weights[&(i + 4, j + 4)] - weight).abs() < 1e-12, "{i} {j} {weight}");
    }
    // The second nearest of the first robot is 3 m away, that of the second one 2 m.
    let expected = (-0.5f64 / (0.85 * 0.85 * 3.0 * 2.0)).exp();
    assert!((weights[&(0, 1)] - expected).abs() < 1e-12, "{}", weights[&(0, 1)]);
}

#[test]
fn the_neighbour_that_robots_are_measured_by_grows_with_the_fleet() {
    let of = |robots| scale_neighbour(&settings(), robots);
    assert_eq!([0, 2, 9, 29, 54, 120, 300, 100_000].map(of), [4, 4, 4, 4, 4, 5, 8, 8]);
    let set = SpatialSettings { scale_neighbour: Some(3), ..settings() };
    assert_eq!(scale_neighbour(&set, 300), 3);
}

#[test]
fn a_pair_is_measured_by_itself_and_not_by_the_next_pair() {
    let pairs = [[0.0; 3], [3.0, 0.0, 0.0], [90.0, 0.0, 0.0], [93.0, 0.0, 0.0]];
    let weights = weights(&spatial_edges(&pairs, &settings()));
    let to_next = weights.get(&(0, 2)).copied().unwrap_or(0.0);
    assert!(weights[&(0, 1)] > 0.8 && to_next < 1e-9, "{weights:?}");
}

#[test]
fn robots_in_a_dock_do_not_lose_those_around_it() {
    let mut positions = vec![[0.0; 3]; 5];
    positions.extend((1..=6).map(|place| [f64::from(place), 0.0, 0.0]));
    let weights = weights(&spatial_edges(&positions, &settings()));
    assert_eq!(weights[&(0, 4)], 1.0);
    // A tenth of the fleet's metre is the least that they are measured by.
    let expected = (-0.5f64 / (0.85 * 0.85 * 0.1 * 1.0)).exp();
    assert!((weights[&(0, 5)] - expected).abs() < 1e-12, "{}", weights[&(0, 5)]);
}

#[test]
fn robots_on_one_spot_are_fully_related() {
    let edges = spatial_edges(&[[5.0; 3]; 3], &settings());
    assert_eq!(edges.len(), 6);
    assert!(edges.iter().all(|&(_, _, weight)| weight == 1.0));
    // Two stacks: measured by the distance between them.
    let stacks = [[0.0; 3], [0.0; 3], [4.0, 0.0, 0.0], [4.0, 0.0, 0.0]];
    let weights = weights(&spatial_edges(&stacks, &by_fleet()));
    assert_eq!((weights[&(0, 1)], weights[&(0, 2)]), (1.0, (-0.125f64).exp()));
}

#[test]
fn ten_thousand_robots_on_one_spot_stay_sparse_and_have_no_hub() {
    let mut positions = vec![[7.0, 7.0, 0.0]; 10_000];
    positions.push([9.0, 7.0, 0.0]);
    let edges = spatial_edges(&positions, &settings());
    assert!(edges.len() <= 2 * 16 * 10_001);
    assert!(edges.iter().all(|&(_, _, weight)| weight > 0.0 && weight <= 1.0));
    let degree = |robot| edges.iter().filter(|edge| edge.0 == robot).count();
    assert_eq!((degree(5000), degree(10_000)), (32, 16));
}

#[test]
fn broken_and_far_positions_do_no_harm() {
    for all_pairs_up_to in [0, 200] {
        let settings = SpatialSettings { all_pairs_up_to, ..settings() };
        let positions =
            [[f64::NAN; 3], [0.0; 3], [f64::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0], [1e300; 3]];
        let edges = spatial_edges(&positions, &settings);
        assert_eq!(weights(&edges).into_keys().collect::<Vec<_>>(), [(1, 3), (3, 1)]);
        let by_fleet = SpatialSettings { all_pairs_up_to, ..by_fleet() };
        let edges = spatial_edges(&[[-4e7; 3], [4e7; 3]], &by_fleet);
        assert_eq!(edges.len(), 2);
        assert!(edges.iter().all(|edge| edge.2 == (-0.125f64).exp()));
        let tiny = spatial_edges(&[[0.0; 3], [1e-300, 0.0, 0.0]], &settings);
        assert_eq!(tiny.len(), 2);
    }
}

#[test]
fn no_edge_is_longer_than_the_radius() {
    let line: Vec<Point> = (0..100).map(|step| [f64::from(step), 0.0, 0.0]).collect();
    for all_pairs_up_to in [0, 200] {
        let settings =
            SpatialSettings { all_pairs_up_to, radius_m: Some(2.0), width: 100.0, ..settings() };
        let edges = spatial_edges(&line, &settings);
        assert_eq!(edges.len(), 2 * (99 + 98), "2.0 m counts as within");
        assert!(edges.iter().all(|edge| edge.0.abs_diff(edge.1) <= 2));
    }
}

fn fleet() -> impl Strategy<Value = Vec<Point>> {
    prop::collection::vec(prop::array::uniform3(-50.0..50.0f64), 0..90)
}

fn any_settings() -> impl Strategy<Value = SpatialSettings> {
    let kernel = prop_oneof![
        Just(SpatialKernel::Gaussian),
        Just(SpatialKernel::Exponential),
        Just(SpatialKernel::WendlandC2)
    ];
    let pairs = prop_oneof![Just(0u32), Just(200)];
    let scale = prop_oneof![Just(SpatialScale::Fleet), Just(SpatialScale::Robots)];
    (kernel, (scale, prop::option::of(1..6u32)), 0.1..10.0f64, 1.0..10.0f64, pairs, 1..20u32)
        .prop_map(
            |(kernel, (scale, scale_neighbour), width, cutoff, all_pairs_up_to, neighbours)| {
                SpatialSettings {
                    kernel,
                    scale,
                    scale_neighbour,
                    width,
                    cutoff,
                    all_pairs_up_to,
                    neighbours,
                    radius_m: None,
                }
            },
        )
}

/// Turns by two angles in radians, scales and moves.
fn moved(point: &Point, angles: (f64, f64), scale: f64, shift: &Point) -> Point {
    let (sin, cos) = angles.0.sin_cos();
    let [x, y, z] = [cos * point[0] - sin * point[1], sin * point[0] + cos * point[1], point[2]];
    let (sin, cos) = angles.1.sin_cos();
    let turned = [x, cos * y - sin * z, sin * y + cos * z];
    std::array::from_fn(|axis| scale * turned[axis] + shift[axis])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn edges_are_symmetric_bounded_ordered_and_repeatable(
        fleet in fleet(), settings in any_settings(),
    ) {
        let edges = spatial_edges(&fleet, &settings);
        prop_assert!(edges.is_sorted_by(|l, r| (l.0, l.1) < (r.0, r.1)));
        let weights = weights(&edges);
        for (&(source, target), weight) in &weights {
            prop_assert!(source != target && (target as usize) < fleet.len());
            prop_assert!(*weight >= MIN_WEIGHT && *weight <= 1.0);
            prop_assert_eq!(weights.get(&(target, source)), Some(weight));
        }
        prop_assert_eq!(edges, spatial_edges(&fleet, &settings));
    }

    #[test]
    fn the_order_of_the_robots_does_not_matter(
        (fleet, order) in fleet().prop_flat_map(|fleet| {
            let order: Vec<u32> = (0..).take(fleet.len()).collect();
            (Just(fleet), Just(order).prop_shuffle())
        }),
        settings in any_settings(),
    ) {
        let shuffled: Vec<Point> = order.iter().map(|&robot| fleet[robot as usize]).collect();
        let edges: Vec<Edge> = spatial_edges(&shuffled, &settings)
            .into_iter()
            .map(|(source, target, w)| (order[source as usize], order[target as usize], w))
            .collect();
        prop_assert_eq!(weights(&edges), weights(&spatial_edges(&fleet, &settings)));
    }

    #[test]
    fn origin_axes_and_unit_do_not_matter(
        fleet in fleet(),
        settings in any_settings(),
        angles in (0.0..6.0f64, 0.0..6.0f64),
        scale in 0.01..100.0f64,
        shift in prop::array::uniform3(-1e3..1e3f64),
    ) {
        let other: Vec<Point> =
            fleet.iter().map(|point| moved(point, angles, scale, &shift)).collect();
        assert_close(&spatial_edges(&fleet, &settings), &spatial_edges(&other, &settings))?;
    }

    #[test]
    fn as_many_neighbours_as_robots_are_all_pairs(fleet in fleet(), width in 0.1..10.0f64) {
        let all = SpatialSettings { width, ..settings() };
        let nearest = SpatialSettings { width, ..sparse(200) };
        prop_assert_eq!(spatial_edges(&fleet, &all), spatial_edges(&fleet, &nearest));
    }

    #[test]
    fn every_robot_keeps_its_nearest(fleet in fleet(), neighbours in 1..10u32) {
        let wide = SpatialSettings { width: 1000.0, ..sparse(neighbours) };
        let edges = spatial_edges(&fleet, &wide);
        for robot in (0..).take(fleet.len()) {
            let degree = edges.iter().filter(|edge| edge.0 == robot).count();
            prop_assert!(degree >= (neighbours as usize).min(fleet.len() - 1));
        }
    }
}
