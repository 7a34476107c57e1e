//! The number of teams that relations show where one of them relates a part of the fleet alone.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use std::sync::Arc;

use muster_method::embedding::embed;
use muster_method::params::EmbeddingParams;
use muster_method::{Frame, Graph};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{EmbedderSettings, TeamCount};
use muster_numeric::matrix::SparseMatrix;

const TEAMS: usize = 3;
const SIZE: usize = 5;
const ROBOTS: usize = TEAMS * SIZE;

/// How many teams a fleet shows in which those near each other hear each other, and robots answer to the first
/// of so many teams.
fn teams_found(with_leaders: usize) -> u32 {
    let near = |within: f64, across: f64| {
        let pairs = (0..ROBOTS).flat_map(|from| (0..ROBOTS).map(move |to| (from, to)));
        let weight =
            |from: usize, to: usize| if from / SIZE == to / SIZE { within } else { across };
        let edges =
            pairs.filter(|(from, to)| from != to).map(|(from, to)| (from, to, weight(from, to)));
        SparseMatrix::from_triplets(ROBOTS, edges).unwrap()
    };
    let led = (0..with_leaders * SIZE).filter(|robot| robot % SIZE != 0);
    let orders = led.map(|robot| (robot / SIZE * SIZE, robot, 1.0));
    let graphs = [
        (Modality::connectivity(), near(0.9, 0.1)),
        (Modality::hierarchy(), SparseMatrix::from_triplets(ROBOTS, orders).unwrap()),
        (Modality::spatial(), near(0.8, 0.01)),
    ];
    let frame = Frame {
        robots: (0..ROBOTS).map(|i| RobotId::new(format!("r{i:02}")).unwrap()).collect(),
        graphs: graphs.into_iter().map(|(name, g)| (name, Graph::Matrix(Arc::new(g)))).collect(),
    };
    let settings = EmbedderSettings::default();
    let params = EmbeddingParams::once(&settings, TeamCount::Auto).check().unwrap();
    embed(&frame, &params, &mut |_| {}).unwrap().decomposition.teams.teams
}

#[test]
fn teams_that_lost_their_leaders_are_still_teams() {
    for with_leaders in [3, 2, 1, 0] {
        assert_eq!(teams_found(with_leaders), 3, "{with_leaders} of three teams have a leader");
    }
}
