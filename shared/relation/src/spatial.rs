//! Where the robots are: positions to a symmetric graph whose weights fall with distance.
//!
//! There are two ways to keep the graph of a large fleet sparse. The Gaussian and the exponential
//! kernel never end, so that only the nearest neighbours are related; whenever two robots change
//! places in that order, an edge with a weight well above 0 appears and another one vanishes, however
//! small the motion. Wendland's kernel ends at a radius and is 0 there, so that weights are a continuous
//! function of the positions. What follows the graph from frame to frame then has little to do after
//! little motion.

use muster_model::settings::{SpatialKernel, SpatialSettings};

use crate::compact::rows_within;
use crate::edge::Edge;
use crate::kernel::Kernel;
pub use crate::kernel::MIN_WEIGHT;
use crate::neighbours::{Point, distance, k_nearest, length_scale, nearest_distances, placed};

/// The spatial edges of robots whose positions are given in metres east, north and up in one frame.
///
/// The weight is within 0 to 1, and 1 for robots on one spot. It is the settings' kernel of the
/// distance d in units of a length: `width` or, for Wendland's, `cutoff` times the median distance to
/// the nearest neighbour. Where most robots stand on each other, so that the median is 0, the median
/// over their distinct positions takes its place.
///
/// Gaussian and exponential: fleets of more than `all_pairs_up_to` robots relate those of which one is
/// among the `neighbours` nearest of the other. Edges longer than `radius_m` or weaker than
/// [`MIN_WEIGHT`] are left out.
///
/// Wendland's: the radius R of the support is at most `radius_m`. In fleets of more than
/// `all_pairs_up_to` robots, none is related to more than 4 × `neighbours` others: each has a radius of
/// its own, which is R or, if more others are within R, the distance to the nearest of those that are
/// too many, and the smaller radius of two robots is that of their edge. A crowd thus shortens the
/// radius of those who are in it, and of nobody else. Robots that stand on one spot with more others
/// than that have no radius left; each is related to half as many that follow it by index and, in turn,
/// to those that it follows.
///
/// Its weights are continuous in the positions, but for edges below [`MIN_WEIGHT`]: a median of
/// distances and the distance to the n-th nearest change by at most 2δ when robots move by at most δ,
/// and the kernel's slope is bounded by [`crate::kernel::WENDLAND_C2_SLOPE`]. Two things remain that do
/// jump, since no scale that follows the fleet can be continuous there: when half of the robots come
/// to stand on others exactly, and when more than 4 × `neighbours` come to stand on one spot exactly.
/// Robots that come or go change the median and the neighbours, which is a change of the fleet and no
/// motion. And a fleet of pairs that stand much closer than one pair to the next is measured by the
/// pairs, as with every kernel here: beyond `cutoff` such lengths there is no edge.
///
/// Robots whose position is not finite or beyond 4e7 m are left out. Each edge stands in both
/// directions with the same weight. The weights do not depend on the unit, the origin or the axes of
/// the frame (but for rounding), nor on the order of the robots, except where robots on one spot are
/// equal candidates for the last of the `neighbours`: there those that follow by index are taken.
#[must_use]
pub fn spatial_edges(positions: &[[f64; 3]], settings: &SpatialSettings) -> Vec<Edge> {
    let (robots, points) = placed(positions);
    let rows = if points.len() <= settings.all_pairs_up_to as usize {
        rows_of_all_pairs(&points, settings)
    } else {
        match settings.kernel {
            SpatialKernel::Gaussian | SpatialKernel::Exponential => {
                rows_of_neighbours(&points, settings)
            }
            SpatialKernel::WendlandC2 => {
                let scale_m = length_scale(&points, nearest_distances(&points));
                let kernel = Kernel::new(settings, scale_m);
                rows_within(&points, kernel, settings.most_related().max(1) as usize)
            }
        }
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
    let kernel = Kernel::new(settings, length_scale(points, nearest_distances(points)));
    let row = |(robot, point): (u32, &Point)| {
        let others = (0..).zip(points).filter(|(other, _)| *other != robot);
        others
            .filter_map(|(other, place)| Some((other, kernel.weight(distance(point, place))?)))
            .collect()
    };
    (0..).zip(points).map(row).collect()
}

fn rows_of_neighbours(points: &[Point], settings: &SpatialSettings) -> Vec<Vec<(u32, f64)>> {
    let nearest = k_nearest(points, settings.neighbours.max(1) as usize);
    let closest = nearest.iter().filter_map(|row| row.first()).map(|&(_, metres)| metres).collect();
    let kernel = Kernel::new(settings, length_scale(points, closest));
    let mut rows = vec![Vec::new(); points.len()];
    for (robot, neighbours) in (0..).zip(&nearest) {
        for &(other, metres) in neighbours {
            let Some(weight) = kernel.weight(metres) else { continue };
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
