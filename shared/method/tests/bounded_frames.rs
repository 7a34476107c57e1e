//! One frame of a large fleet takes a bounded time, whatever its graphs are like.

use std::sync::Arc;

use muster_method::embedding::{Embedded, Frames, embed};
use muster_method::params::{EmbeddingParams, Pace};
use muster_method::{Frame, Graph};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{EmbedderSettings, Normalization};
use muster_numeric::matrix::SparseMatrix;

const TEAMS: usize = 4;
const GROUPS: usize = 40;
const GROUP_ROBOTS: usize = 8;
const ROBOTS: usize = GROUPS * GROUP_ROBOTS;

/// Groups between which nothing is reported, as while a fleet joins: each needs a triplet of its own.
fn groups() -> Frame {
    let edges = (0..ROBOTS).flat_map(|i| {
        let first = i - i % GROUP_ROBOTS;
        // Each group has a strength of its own, so that none takes the triplet of another.
        let weight = 1.0 - first as f64 / (2 * ROBOTS) as f64;
        (first..first + GROUP_ROBOTS).filter(move |j| *j != i).map(move |j| (i, j, weight))
    });
    let graph = SparseMatrix::from_triplets(ROBOTS, edges).unwrap();
    Frame {
        robots: (0..ROBOTS).map(|i| RobotId::new(format!("r{i:03}")).unwrap()).collect(),
        graphs: [(Modality::spatial(), Graph::Matrix(Arc::new(graph)))].into(),
    }
}

/// Graphs that are divided by their largest singular value keep the strengths of the groups.
fn settings() -> EmbedderSettings {
    EmbedderSettings { normalize: Normalization::Spectral, ..EmbedderSettings::default() }
}

fn uncovered(embedded: &Embedded) -> usize {
    embedded.without_embedding.iter().filter(|without| **without).count()
}

#[test]
fn groups_beyond_the_first_ones_are_found_over_several_frames_while_robots_move() {
    let (frame, settings) = (groups(), settings());
    let params = EmbeddingParams::new(&settings, TEAMS, Pace::Moving).check().unwrap();
    let mut frames = Frames::default();
    let mut left = Vec::new();
    let mut ranks = Vec::new();
    for _ in 0..6 {
        let embedded = frames.embed(&frame, &params, None, &mut |_| {}).unwrap();
        left.push(uncovered(&embedded));
        ranks.push(embedded.x.cols() / 2);
    }
    assert!(ranks[0] <= 2 * (TEAMS + 1), "one frame doubles once: {ranks:?}");
    assert!(left[0] > 0, "{left:?}");
    assert_eq!(left.last(), Some(&0), "{ranks:?}");
}

#[test]
fn all_groups_are_found_at_once_where_there_is_time() {
    let (frame, settings) = (groups(), settings());
    let at_rest = EmbeddingParams::new(&settings, TEAMS, Pace::AtRest).check().unwrap();
    let found = Frames::default().embed(&frame, &at_rest, None, &mut |_| {}).unwrap();
    assert_eq!(uncovered(&found), 0);
    let single = EmbeddingParams::once(&settings, TEAMS).check().unwrap();
    assert_eq!(uncovered(&embed(&frame, &single, &mut |_| {}).unwrap()), 0);
}
