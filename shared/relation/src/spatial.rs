//! Where the robots are: positions to a symmetric graph whose weights fall with distance.
//!
//! There are two ways to keep the graph of a large fleet sparse. The Gaussian and the exponential
//! kernel never end, so that only the nearest neighbours are related; whenever two robots change
//! places in that order, an edge with a weight well above 0 appears and another one vanishes, however
//! small the motion. Wendland's kernel ends at a radius and is 0 there, so that weights are a continuous
//! function of the positions. What follows the graph from frame to frame then has little to do after
//! little motion.

use muster_model::settings::{SpatialKernel, SpatialScale, SpatialSettings};

use crate::compact::rows_within;
use crate::edge::Edge;
use crate::kernel::Kernel;
pub use crate::kernel::MIN_WEIGHT;
use crate::neighbours::{
    Neighbour, Point, distance, k_nearest, length_scale, nearest_distances, placed,
};

/// Lowest and highest number of the neighbour whose distance is a robot's scale, unless it is set. With the
/// first neighbour the scale of two close robots would be chance; up to the eighth, the edges to the 16
/// nearest robots of a large fleet end without a jump.
const SCALE_NEIGHBOURS: (f64, f64) = (4.0, 8.0);

/// The root of the number of robots is divided by this. Teams of large fleets are large: measured by
/// their fourth nearest they fall apart.
const ROOT_PER_NEIGHBOUR: f64 = 2.2;

/// Largest scale of a robot as a multiple of the distance to its nearest neighbour. In teams of two the
/// fourth neighbour is in another team, which would then seem as near as its own.
const MAX_SCALE_PER_NEAREST: f64 = 5.0;

/// Largest scale of a robot as a multiple of the lower quartile of the fleet's: a team of two far from all
/// others would reach them otherwise.
const MAX_SCALE_PER_QUARTILE: f64 = 3.0;

/// Smallest scale of a robot as a share of the median distance to the nearest neighbour: for robots that
/// stand on each other, as in a dock, the distance to the nearest means nothing.
const MIN_SCALE_PER_MEDIAN: f64 = 0.1;

/// The spatial edges of robots whose positions are given in metres east, north and up in one frame.
///
/// The weight is within 0 to 1, and 1 for robots on one spot. It is the settings' kernel of the
/// distance d in units of a length. For Wendland's, that is `cutoff` times the median distance to the
/// nearest neighbour. For Gaussian and exponential it is `width` times the same median or, where the
/// scale is that of the robots, times √(sᵢ sⱼ) with the distance s of each robot to its
/// nearest of number [`scale_neighbour`] (or farthest, if there are fewer others): local scaling by L.
/// Zelnik-Manor and P. Perona, "Self-tuning spectral clustering", NIPS 2004. A team that keeps close and
/// one that is spread out are then equally tied together, and robots halfway between the two belong to
/// neither more than their distances say. Where most robots stand on each other, so that the median is
/// 0, the median over their distinct positions takes its place, and no s is below [`MIN_SCALE_PER_MEDIAN`]
/// times it, nor above [`MAX_SCALE_PER_NEAREST`] times the distance to the robot's own nearest or
/// [`MAX_SCALE_PER_QUARTILE`] times the lower quartile of all s above that least one.
///
/// Gaussian and exponential: fleets of more than `all_pairs_up_to` robots relate those of which one is
/// among the `neighbours` nearest of the other. Edges longer than `radius_m` or weaker than
/// [`MIN_WEIGHT`] are left out.
///
/// Wendland's: the radius R of the support is at most `radius_m`. In fleets of more than
/// `all_pairs_up_to` robots, none is related to more than 4 × `neighbours` others: each has a radius of
/// its own, which is R or, if more others are within R, the distance to the nearest of those that are
/// too many, and the smaller radius of two robots is that of their edge. A crowd thus shortens
/// the radii of its own robots only. Robots on one spot with more others than that have radius 0; each is
/// related to half as many robots that follow it by index, and to those that it follows.
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

/// What distances are measured by.
struct Measure {
    /// The kernel of the fleet's length.
    kernel: Kernel,
    /// The root of each robot's own width in metres; empty where all have the kernel's.
    roots: Vec<f64>,
}

impl Measure {
    /// `nearest` holds at least [`Measure::looks_at`] others of each robot, as far as there are so many.
    fn new(points: &[Point], nearest: &[Vec<Neighbour>], settings: &SpatialSettings) -> Self {
        let metres = |row: &[Neighbour], at: usize| row.get(at).map(|&(_, metres)| metres);
        let closest = nearest.iter().filter_map(|row| metres(row, 0)).collect();
        let kernel = Kernel::new(settings, length_scale(points, closest));
        let Some(place) = own_scale(settings, points.len()) else {
            return Self { kernel, roots: Vec::new() };
        };
        let own = |row: &Vec<Neighbour>| {
            let last = row.len().min(place).checked_sub(1);
            let own = last.and_then(|last| metres(row, last)).unwrap_or(0.0) * settings.width;
            let nearest = metres(row, 0).unwrap_or(0.0) * settings.width;
            let own = own.min(MAX_SCALE_PER_NEAREST * nearest);
            own.max(MIN_SCALE_PER_MEDIAN * kernel.length_m())
        };
        let scales: Vec<f64> = nearest.iter().map(own).collect();
        // Robots that stand on each other are measured by the least, which says nothing of the fleet.
        let least = MIN_SCALE_PER_MEDIAN * kernel.length_m();
        let apart = scales.iter().copied().filter(|scale| *scale > least).collect();
        let most = MAX_SCALE_PER_QUARTILE * lower_quartile(apart);
        Self { kernel, roots: scales.into_iter().map(|scale| scale.min(most).sqrt()).collect() }
    }

    /// How many of its nearest others each robot is measured by.
    fn looks_at(settings: &SpatialSettings, robots: usize) -> usize {
        own_scale(settings, robots).unwrap_or(1)
    }

    /// The weight of two robots that are so many metres apart; none if that is no edge.
    fn weight(&self, robot: u32, other: u32, metres: f64) -> Option<f64> {
        let root = |robot: u32| self.roots.get(robot as usize);
        match root(robot).zip(root(other)) {
            Some((own, theirs)) => self.kernel.with_length(own * theirs).weight(metres),
            None => self.kernel.weight(metres),
        }
    }
}

/// By which of its neighbours a robot is measured, if not by the fleet.
fn own_scale(settings: &SpatialSettings, robots: usize) -> Option<usize> {
    let ends = settings.kernel == SpatialKernel::WendlandC2;
    let by_robots = settings.scale == SpatialScale::Robots && !ends;
    by_robots.then(|| scale_neighbour(settings, robots))
}

/// The value that a quarter of the numbers do not exceed; infinite where there are none.
fn lower_quartile(mut numbers: Vec<f64>) -> f64 {
    let place = numbers.len() / 4;
    if numbers.is_empty() {
        return f64::INFINITY;
    }
    *numbers.select_nth_unstable_by(place, f64::total_cmp).1
}

/// The number, from 1, of the nearest robot by which each of so many is measured: the settings', or the
/// root of their number divided by 2.2, from 4 to 8.
#[must_use]
pub fn scale_neighbour(settings: &SpatialSettings, robots: usize) -> usize {
    let (least, most) = SCALE_NEIGHBOURS;
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a number from 4 to 8"
    )]
    let by_size =
        || ((robots as f64).sqrt() / ROOT_PER_NEIGHBOUR).round().clamp(least, most) as usize;
    settings.scale_neighbour.map_or_else(by_size, |set| set.max(1) as usize)
}

fn rows_of_all_pairs(points: &[Point], settings: &SpatialSettings) -> Vec<Vec<(u32, f64)>> {
    let nearest = k_nearest(points, Measure::looks_at(settings, points.len()));
    let measure = Measure::new(points, &nearest, settings);
    let row = |(robot, point): (u32, &Point)| {
        let others = (0..).zip(points).filter(|(other, _)| *other != robot);
        others
            .filter_map(|(other, place)| {
                Some((other, measure.weight(robot, other, distance(point, place))?))
            })
            .collect()
    };
    (0..).zip(points).map(row).collect()
}

fn rows_of_neighbours(points: &[Point], settings: &SpatialSettings) -> Vec<Vec<(u32, f64)>> {
    let related = settings.neighbours.max(1) as usize;
    let nearest = k_nearest(points, related.max(Measure::looks_at(settings, points.len())));
    let measure = Measure::new(points, &nearest, settings);
    let mut rows = vec![Vec::new(); points.len()];
    for (robot, neighbours) in (0..).zip(&nearest) {
        for &(other, metres) in neighbours.iter().take(related) {
            let Some(weight) = measure.weight(robot, other, metres) else { continue };
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
