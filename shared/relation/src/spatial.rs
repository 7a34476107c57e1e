//! Where the robots are: positions to a symmetric graph whose weights fall with distance.

use muster_model::settings::{SpatialKernel, SpatialSettings};

use crate::edge::Edge;
use crate::neighbours::{Point, distance, k_nearest, length_scale, nearest_distances, placed};

/// Weights below this are no edges: next to a neighbour's weight, which is near 1, they move no digit
/// that anybody reads, but they would fill the graph of a wide fleet with edges between strangers.
pub const MIN_WEIGHT: f64 = 1e-12;

/// The spatial edges of robots whose positions are given in metres east, north and up in one frame.
///
/// The weight is the settings' kernel of d / (width × median distance to the nearest neighbour),
/// within 0 to 1; robots on one spot have weight 1. Where most robots stand on each other, so that
/// the median is 0, the median over their distinct positions takes its place. Fleets of more than
/// `all_pairs_up_to` robots relate those of which one is among the `neighbours` nearest of the other.
/// Edges longer than `radius_m` or weaker than [`MIN_WEIGHT`] are left out, as are robots whose
/// position is not finite or beyond 4e7 m. Each edge stands in both directions with the same weight.
///
/// The weights do not depend on the unit, the origin or the axes of the frame (but for rounding), nor
/// on the order of the robots, except where robots on one spot are equal candidates for the last of
/// the `neighbours`: there those that follow by index are taken.
#[must_use]
pub fn spatial_edges(positions: &[[f64; 3]], settings: &SpatialSettings) -> Vec<Edge> {
    let (robots, points) = placed(positions);
    let rows = if points.len() <= settings.all_pairs_up_to as usize {
        rows_of_all_pairs(&points, settings)
    } else {
        rows_of_neighbours(&points, settings)
    };
    let name = |index: u32| robots.get(index as usize).copied();
    // Robots keep their order when those without a position are left out, so that edges keep theirs.
    robots
        .iter()
        .zip(&rows)
        .flat_map(|(&source, row)| {
            row.iter().filter_map(move |&(target, weight)| Some((source, name(target)?, weight)))
        })
        .collect()
}

fn rows_of_all_pairs(points: &[Point], settings: &SpatialSettings) -> Vec<Vec<(u32, f64)>> {
    let weigh = Weigh::new(settings, length_scale(points, nearest_distances(points)));
    let row = |(robot, point): (u32, &Point)| {
        let others = (0..).zip(points).filter(|(other, _)| *other != robot);
        others
            .filter_map(|(other, place)| Some((other, weigh.weight(distance(point, place))?)))
            .collect()
    };
    (0..).zip(points).map(row).collect()
}

fn rows_of_neighbours(points: &[Point], settings: &SpatialSettings) -> Vec<Vec<(u32, f64)>> {
    let nearest = k_nearest(points, settings.neighbours.max(1) as usize);
    let closest = nearest.iter().filter_map(|row| row.first()).map(|&(_, metres)| metres).collect();
    let weigh = Weigh::new(settings, length_scale(points, closest));
    let mut rows = vec![Vec::new(); points.len()];
    for (robot, neighbours) in (0..).zip(&nearest) {
        for &(other, metres) in neighbours {
            let Some(weight) = weigh.weight(metres) else { continue };
            for (source, target) in [(robot, other), (other, robot)] {
                if let Some(row) = rows.get_mut(source as usize) {
                    row.push((target, weight));
                }
            }
        }
    }
    for row in &mut rows {
        // Those who are each other's neighbours stand twice, with the same weight.
        row.sort_unstable_by_key(|&(target, _)| target);
        row.dedup_by_key(|&mut (target, _)| target);
    }
    rows
}

/// How much a distance is worth.
struct Weigh {
    kernel: SpatialKernel,
    width_m: f64,
    radius_m: f64,
}

impl Weigh {
    fn new(settings: &SpatialSettings, scale_m: f64) -> Self {
        Self {
            kernel: settings.kernel,
            width_m: settings.width * scale_m,
            radius_m: settings.radius_m.unwrap_or(f64::INFINITY),
        }
    }

    fn weight(&self, metres: f64) -> Option<f64> {
        let widths = metres / self.width_m;
        let weight = match self.kernel {
            SpatialKernel::Gaussian => (-0.5 * widths * widths).exp(),
            SpatialKernel::Exponential => (-widths).exp(),
        };
        (metres <= self.radius_m && weight >= MIN_WEIGHT).then_some(weight)
    }
}
