//! Graphs of a kernel that ends at a radius, with a bound on the edges of each robot.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::kernel::Kernel;
use crate::neighbours::{Point, Stack, distance, stacks};

/// Places that are looked up beyond those that may be related: the place itself, the one that ends the
/// radius, and one in case the tree rounds distances otherwise than [`distance`].
const BEYOND: usize = 3;

/// By how much the search is wider than the radius, for the same reason.
const WIDER: f64 = 1.0 + 1e-9;

/// What surrounds the robots of one spot.
struct Surroundings {
    /// The radius of their own in metres, 0 if even those on the spot are too many.
    radius_m: f64,
    /// The other spots within it and their distances in metres.
    near: Vec<(usize, f64)>,
}

/// The edges of each robot, by target: those of `kernel`, whose length is the radius of its support,
/// with no more than `most` per robot.
///
/// Takes O(N log N) for any positions: a crowd is never looked through.
pub(crate) fn rows_within(points: &[Point], kernel: Kernel, most: usize) -> Vec<Vec<(u32, f64)>> {
    // The tree holds each position once: it would look through all robots of a spot for each of them.
    let stacks = stacks(points);
    let surroundings = surroundings(&stacks, kernel.length_m(), most);
    let mut rows = vec![Vec::new(); points.len()];
    let mut around = Vec::new();
    for (stack, own) in stacks.iter().zip(&surroundings) {
        around.clear();
        for &(other, metres) in &own.near {
            let Some((spot, theirs)) = stacks.get(other).zip(surroundings.get(other)) else {
                continue;
            };
            let kernel = kernel.with_length(own.radius_m.min(theirs.radius_m));
            if let Some(weight) = kernel.weight(metres) {
                around.extend(spot.robots.iter().map(|&robot| (robot, weight)));
            }
        }
        for (place, &robot) in stack.robots.iter().enumerate() {
            let Some(row) = rows.get_mut(robot as usize) else { continue };
            let (before, after) = stack.robots.split_at(place);
            let circle = after.iter().skip(1).chain(before);
            if own.radius_m > 0.0 {
                row.extend(circle.map(|&other| (other, 1.0)));
            } else {
                let behind = circle.clone().rev().take(most / 2);
                row.extend(circle.take(most / 2).chain(behind).map(|&other| (other, 1.0)));
            }
            row.extend_from_slice(&around);
            row.sort_unstable_by_key(|&(target, _)| target);
        }
    }
    rows
}

/// What surrounds each of the stacks within `radius_m`, or within the radius of its own.
fn surroundings(stacks: &[Stack], radius_m: f64, most: usize) -> Vec<Surroundings> {
    let looked_up = NonZeroUsize::new(most + BEYOND).unwrap_or(NonZeroUsize::MIN);
    let places: Vec<Point> = stacks.iter().map(|stack| stack.at).collect();
    // Fails for more than 2³² robots only, which no memory holds.
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&places).ok();
    let look = |(index, stack): (usize, &Stack)| {
        let on_spot = stack.robots.len() - 1;
        if on_spot > most {
            return Surroundings { radius_m: 0.0, near: Vec::new() };
        }
        let found = tree.iter().flat_map(|tree| {
            let query = tree.query(&stack.at).nearest_n::<SquaredEuclidean<f64>>(looked_up);
            query.within::<SquaredEuclidean<f64>>(radius_m * radius_m * WIDER).execute()
        });
        let mut near: Vec<(usize, f64)> = found
            .filter_map(|place| {
                let other = place.item as usize;
                Some((other, distance(&stack.at, &stacks.get(other)?.at)))
            })
            .filter(|&(other, metres)| other != index && metres < radius_m)
            .collect();
        near.sort_unstable_by(|left, right| left.1.total_cmp(&right.1));
        let mut related = on_spot;
        let too_many = near.iter().find(|(other, _)| {
            related += stacks.get(*other).map_or(0, |spot| spot.robots.len());
            related > most
        });
        let radius_m = too_many.map_or(radius_m, |&(_, metres)| metres);
        near.retain(|&(_, metres)| metres < radius_m);
        Surroundings { radius_m, near }
    };
    stacks.iter().enumerate().map(look).collect()
}
