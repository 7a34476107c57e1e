//! Distances and nearest neighbours among positions.

use std::cmp::Ordering;
use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use muster_model::limits::MAX_COORDINATE_M;

/// Metres east, north and up.
pub(crate) type Point = [f64; 3];

/// How many more positions than asked for may be looked at to decide a tie for the last place: regular
/// formations tie with a few dozen, and a ring must not cost the square of its size.
const MOST_TIED: usize = 128;

/// One neighbour: its index and its distance in metres.
pub(crate) type Neighbour = (u32, f64);

/// The robots that have a position, by index, and their positions. A position that is not finite or
/// beyond [`MAX_COORDINATE_M`] is none: distances to it would not be numbers.
pub(crate) fn placed(positions: &[Point]) -> (Vec<u32>, Vec<Point>) {
    (0..)
        .zip(positions)
        .filter(|(_, point)| point.iter().all(|metres| metres.abs() <= MAX_COORDINATE_M))
        // Adding 0 turns −0 into 0, so that equal positions are equal bit by bit.
        .map(|(robot, point)| (robot, point.map(|metres| metres + 0.0)))
        .unzip()
}

/// Distance in metres; the same bit by bit in both directions.
pub(crate) fn distance(left: &Point, right: &Point) -> f64 {
    let [x, y, z] = [left[0] - right[0], left[1] - right[1], left[2] - right[2]];
    (x * x + y * y + z * z).sqrt()
}

/// The median over all robots of the distance to the nearest other robot, in metres; the mean of the
/// middle two for an even number. `positions` are metres east, north and up in one frame; robots
/// whose position is not finite or beyond 4e7 m are left out. None with fewer than two robots, 0 if
/// most robots stand on each other.
#[must_use]
pub fn median_nearest_neighbour_distance(positions: &[[f64; 3]]) -> Option<f64> {
    let (_, points) = placed(positions);
    median(nearest_distances(&points))
}

/// The distance of each robot to the nearest other one, in metres. Empty with fewer than two robots.
pub(crate) fn nearest_distances(points: &[Point]) -> Vec<f64> {
    k_nearest(points, 1).iter().flatten().map(|&(_, metres)| metres).collect()
}

/// The length that a fleet is measured by: the median distance to the nearest neighbour. Where most
/// robots stand on each other that is 0, and their distinct positions are measured instead; where
/// all do, every length serves.
pub(crate) fn length_scale(points: &[Point], nearest: Vec<f64>) -> f64 {
    let positive = |length: &f64| *length > 0.0;
    median(nearest).filter(positive).unwrap_or_else(|| {
        let distinct: Vec<Point> = stacks(points).into_iter().map(|stack| stack.at).collect();
        median(nearest_distances(&distinct)).filter(positive).unwrap_or(1.0)
    })
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let lower = below.iter().copied().max_by(f64::total_cmp).filter(|_| even);
    Some(lower.map_or(upper, |lower| lower.midpoint(upper)))
}

/// All robots on one spot.
pub(crate) struct Stack {
    pub(crate) at: Point,
    /// In ascending order, at least one.
    pub(crate) robots: Vec<u32>,
}

/// The distinct positions in order, each with its robots.
pub(crate) fn stacks(points: &[Point]) -> Vec<Stack> {
    let mut robots: Vec<(&Point, u32)> = points.iter().zip(0..).collect();
    robots.sort_unstable_by(|l, r| by_position(l.0, r.0).then(l.1.cmp(&r.1)));
    robots
        .chunk_by(|left, right| left.0 == right.0)
        .filter_map(|chunk| {
            let (at, _) = chunk.first()?;
            Some(Stack { at: **at, robots: chunk.iter().map(|&(_, robot)| robot).collect() })
        })
        .collect()
}

/// The `k` nearest other robots of each robot, nearest first. Ties are decided by position as far as
/// [`MOST_TIED`] allows; on one spot, those that follow the robot by index come first, in a circle,
/// so that a crowd on one spot has no hubs.
pub(crate) fn k_nearest(points: &[Point], k: usize) -> Vec<Vec<Neighbour>> {
    // The tree holds each position once: it would look through all robots of a spot for each of them.
    let stacks = stacks(points);
    let places: Vec<Point> = stacks.iter().map(|stack| stack.at).collect();
    // Fails for more than 2³² robots only, which no memory holds.
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&places).ok();
    let mut nearest = vec![Vec::new(); points.len()];
    for stack in &stacks {
        let mut near: Vec<(f64, &Stack)> = tree
            .iter()
            .flat_map(|tree| candidates(tree, &stack.at, k))
            .filter_map(|place| stacks.get(place as usize))
            .map(|other| (distance(&stack.at, &other.at), other))
            .collect();
        near.sort_unstable_by(|l, r| {
            l.0.total_cmp(&r.0).then_with(|| by_position(&l.1.at, &r.1.at))
        });
        for &robot in &stack.robots {
            let neighbours = near.iter().flat_map(|&(metres, other)| {
                let next = other.robots.partition_point(|&other| other <= robot);
                let (before, after) = other.robots.split_at(next);
                after.iter().chain(before).map(move |&other| (other, metres))
            });
            if let Some(row) = nearest.get_mut(robot as usize) {
                *row = neighbours.filter(|&(other, _)| other != robot).take(k).collect();
            }
        }
    }
    nearest
}

/// The places among which the `k` nearest of the one at `point` are, itself included.
fn candidates(tree: &ImmutableKdTree<f64, 3>, point: &Point, k: usize) -> Vec<u32> {
    // The place itself and one beyond, which shows whether others tie with the last that counts.
    let mut count = k.saturating_add(2);
    loop {
        let wanted = NonZeroUsize::new(count).unwrap_or(NonZeroUsize::MIN);
        let found = tree.query(point).nearest_n::<SquaredEuclidean<f64>>(wanted).execute();
        let is_tied = match (found.get(k), found.get(count - 1)) {
            (Some(last), Some(beyond)) => last.distance >= beyond.distance,
            _ => false,
        };
        if !is_tied || count > k.saturating_add(MOST_TIED) {
            return found.into_iter().map(|neighbour| neighbour.item).collect();
        }
        count = count.saturating_mul(2);
    }
}

fn by_position(left: &Point, right: &Point) -> Ordering {
    let mut axes = left.iter().zip(right).map(|(l, r)| l.total_cmp(r));
    axes.find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// What [`k_nearest`] returns, by its definition.
    fn k_nearest_of_all_pairs(points: &[Point], k: usize) -> Vec<Vec<Neighbour>> {
        let row = |(robot, point): (usize, &Point)| {
            let mut others: Vec<usize> =
                (0..points.len()).filter(|&other| other != robot).collect();
            others.sort_by(|&l, &r| {
                let by_distance =
                    distance(point, &points[l]).total_cmp(&distance(point, &points[r]));
                by_distance
                    .then(by_position(&points[l], &points[r]))
                    .then((l < robot, l).cmp(&(r < robot, r)))
            });
            others.truncate(k);
            others.iter().map(|&other| (other as u32, distance(point, &points[other]))).collect()
        };
        points.iter().enumerate().map(row).collect()
    }

    fn along_a_line(metres: &[f64]) -> Vec<Point> {
        metres.iter().map(|&x| [x, 0.0, 0.0]).collect()
    }

    #[test]
    fn the_median_is_that_of_the_nearest_neighbours() {
        let median = |metres: &[f64]| median_nearest_neighbour_distance(&along_a_line(metres));
        assert_eq!(median(&[]), None);
        assert_eq!(median(&[5.0]), None);
        assert_eq!(median(&[5.0, 8.0]), Some(3.0));
        assert_eq!(median(&[0.0, 1.0, 3.0]), Some(1.0));
        assert_eq!(median(&[0.0, 1.0, 10.0, 13.0]), Some(2.0));
        assert_eq!(median(&[0.0, 0.0, 0.0, 13.0]), Some(0.0));
        assert_eq!(median(&[0.0, f64::NAN, 4.0, f64::INFINITY, 1e300]), Some(4.0));
        assert_eq!(median(&[-4.0e7, 4.0e7]), Some(8.0e7));
    }

    #[test]
    fn a_thousand_robots_on_one_spot_are_found() {
        let nearest = k_nearest(&vec![[1.0, 2.0, 3.0]; 1000], 3);
        for (robot, found) in (0..).zip(&nearest) {
            let next = [1, 2, 3].map(|step| ((robot + step) % 1000, 0.0));
            assert_eq!(found, &next);
        }
    }

    #[test]
    fn stacks_are_measured_by_the_distance_between_them() {
        let points = along_a_line(&[0.0, 0.0, -0.0, 7.0, 7.0, 7.0]);
        let (_, points) = placed(&points);
        assert_eq!(length_scale(&points, nearest_distances(&points)), 7.0);
        let points = along_a_line(&[3.0; 4]);
        assert_eq!(length_scale(&points, nearest_distances(&points)), 1.0);
    }

    fn scattered() -> impl Strategy<Value = Vec<Point>> {
        prop::collection::vec(prop::array::uniform3(-100.0..100.0f64), 0..200)
    }

    /// Whole metres in a small space: many equal coordinates, coincident robots and ties.
    fn in_ranks() -> impl Strategy<Value = Vec<Point>> {
        let metres = (0..6i8).prop_map(f64::from);
        prop::collection::vec(prop::array::uniform3(metres), 0..200)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn the_tree_finds_what_all_pairs_find(points in scattered(), k in 1..20usize) {
            prop_assert_eq!(k_nearest(&points, k), k_nearest_of_all_pairs(&points, k));
        }

        #[test]
        fn the_tree_decides_ties_as_all_pairs_do(points in in_ranks(), k in 1..20usize) {
            prop_assert_eq!(k_nearest(&points, k), k_nearest_of_all_pairs(&points, k));
        }
    }
}
