//! The kinds of fused graphs that a fleet is compared on.

use muster_numeric::matrix::{MatrixError, SparseMatrix};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;

use crate::cells::Cells;
use crate::fleet::Fleet;

/// Robots that answer to one superior.
const SUBORDINATES: usize = 8;

/// Weight of an edge from a superior.
const COMMAND: f64 = 0.5;

/// How many nearest neighbours a robot has.
const NEIGHBOURS: usize = 8;

/// Width of the Gaussian kernel of the nearest neighbours, in mean spacings.
const WIDTH: f64 = 1.0;

/// Range of an average radio, in mean spacings.
const RANGE: f64 = 1.35;

/// Weight of the best link.
const LINK: f64 = 0.5;

/// Radius at which the smooth kernel ends, in mean spacings.
const RADIUS: f64 = 1.95;

/// What relates robots: mostly something in addition to the chain of command, which is a tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Kind {
    /// The nearest neighbours by a Gaussian kernel, and radio links: about 12 edges a robot.
    Knn,
    /// Wendland's kernel of smoothness C², which falls to 0 with all who are within its radius: about
    /// 18 edges a robot.
    Smooth,
    /// The smooth kernel without a chain of command.
    Undirected,
    /// The smooth kernel, and a chain of command that has nothing to do with where robots are.
    Apart,
}

/// The fused graph of a fleet.
pub(crate) fn graph(fleet: &Fleet, kind: Kind) -> Result<SparseMatrix, MatrixError> {
    let points = &fleet.points;
    let reach = match kind {
        Kind::Knn => 2.0,
        Kind::Smooth | Kind::Undirected | Kind::Apart => RADIUS,
    };
    let cells = Cells::new(points, reach);
    let mut edges = Vec::with_capacity(20 * points.len());
    let mut found = Vec::new();
    let mut places: Vec<usize> = (0..points.len()).collect();
    if kind == Kind::Apart {
        places.shuffle(&mut ChaCha8Rng::seed_from_u64(points.len() as u64));
    }
    for robot in 0..points.len() {
        match kind {
            Kind::Knn => {
                cells.nearest(robot, NEIGHBOURS, &mut found);
                let weight = |square: f64| (-0.5 * square / (WIDTH * WIDTH)).exp();
                edges.extend(found.iter().map(|&(square, other)| (robot, other, weight(square))));
                cells.around(robot, 1, &mut found);
                edges.extend(found.iter().filter_map(|&(square, other)| {
                    let range = RANGE * fleet.gains[robot] * fleet.gains[other];
                    let quality = 1.0 - square / (range * range);
                    (quality > 0.0).then_some((robot, other, LINK * quality))
                }));
            }
            Kind::Smooth | Kind::Undirected | Kind::Apart => {
                cells.around(robot, 1, &mut found);
                edges.extend(found.iter().filter_map(|&(square, other)| {
                    let r = square.sqrt() / RADIUS;
                    (r < 1.0).then(|| (robot, other, (1.0 - r).powi(4) * (1.0 + 4.0 * r)))
                }));
            }
        }
        let first = SUBORDINATES * robot + 1;
        let last = (first + SUBORDINATES).min(points.len());
        if kind != Kind::Undirected {
            let followers = first.min(last)..last;
            edges.extend(followers.map(|other| (places[robot], places[other], COMMAND)));
        }
    }
    SparseMatrix::from_triplets(points.len(), edges)
}
