//! Groups that become strong while a fleet of a fixed dimension is followed, as the embedder follows it.

use std::sync::Arc;

use muster_method::embedding::{Frames, embed};
use muster_method::params::{EmbeddingParams, Pace};
use muster_method::{Frame, Graph};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{Alpha, Dimension, EmbedderSettings, Normalization};
use muster_numeric::matrix::SparseMatrix;

const ROBOTS: usize = 400;

/// Robots of a squad.
const SQUAD: usize = 4;

/// Frames after which the vectors must be those of a search from nothing.
const FRAMES: usize = 6;

/// Weight of a link to the next squad.
const LINK: f64 = 1e-6;

/// Frames before the group forms.
const BEFORE: usize = 23;

/// Squads of different strengths, all of whose weights sway by `motion` of their size.
fn frame(strengths: &[f64], motion: f64, number: usize) -> Frame {
    let sway = |i: usize, j: usize| 0.7 * (number + 7 * i + 3 * j) as f64;
    let weight = |i: usize, j: usize| 1.0 + motion * sway(i, j).sin();
    let mut edges = Vec::new();
    for i in 0..ROBOTS {
        let first = i / SQUAD * SQUAD;
        let squad = (first..first + SQUAD).filter(|j| *j != i);
        edges.extend(squad.map(|j| (i, j, strengths[i / SQUAD] * weight(i, j))));
        let next = (i + SQUAD) % ROBOTS;
        edges.push((i, next, LINK * weight(i, next)));
    }
    let names = (0..ROBOTS).map(|i| RobotId::new(format!("r{i:03}")).unwrap());
    let matrix = SparseMatrix::from_triplets(ROBOTS, edges).unwrap();
    Frame {
        robots: names.collect(),
        graphs: vec![(Modality::spatial(), Graph::Matrix(Arc::new(matrix)))],
    }
}

#[test]
fn a_new_group_is_found_where_the_dimension_is_fixed() {
    // Weights as they are, so that groups differ by their strength, and one decay for all frames: that
    // of a fleet at work stays within a band.
    let settings = EmbedderSettings {
        dimension: Dimension::Fixed(32),
        alpha: Alpha::Value(0.25),
        normalize: Normalization::None,
        ..Default::default()
    };
    let live = EmbeddingParams::new(&settings, 5, Pace::Moving).check().unwrap();
    let once = EmbeddingParams::once(&settings, 5).check().unwrap();
    for motion in [0.0, 1e-3] {
        let mut strengths: Vec<f64> =
            (0..ROBOTS / SQUAD).map(|squad| 0.4 + 0.004 * (squad * 7 % 100) as f64).collect();
        let new = ROBOTS / SQUAD / 2;
        strengths[new] = 0.1;
        let mut frames = Frames::default();
        for number in 0..BEFORE {
            frames.embed(&frame(&strengths, motion, number), &live, None, &mut |_| {}).unwrap();
        }
        // Among the strongest, but no robot of it has more links than others had before.
        strengths[new] = 0.76;
        let mut found = None;
        for number in BEFORE..BEFORE + FRAMES {
            let frame = frame(&strengths, motion, number);
            let warm = frames.embed(&frame, &live, None, &mut |_| {}).unwrap().decomposition;
            let cold = embed(&frame, &once, &mut |_| {}).unwrap().decomposition;
            assert_eq!((warm.svd.rank(), cold.svd.rank()), (16, 16));
            let pairs = warm.svd.sigma.iter().zip(&cold.svd.sigma);
            let off = pairs.map(|(warm, cold)| (warm - cold).abs()).fold(0.0, f64::max);
            let agrees = off <= 1e-3 * cold.svd.sigma[0];
            assert!(agrees || !warm.complete, "motion {motion}, frame {number}: {off:e}");
            found = found.or(agrees.then_some(number - BEFORE));
        }
        assert!(found.is_some());
    }
}
