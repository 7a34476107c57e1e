//! Groups that become strong after a search has begun to follow others.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions, PROBE_STEPS};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};

/// Triplets that are followed, for half of the dimension 32.
const RANK: usize = 16;

/// Frames after which the triplets must be those of a cold search.
const FRAMES: usize = 6;

fn options(tolerance: f64) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank: RANK, tolerance, seed: 3, threads: 1 }
}

/// Robots in squads of ten that sway around their places; some of them stand closer together.
struct Fleet {
    /// Phase of each robot.
    phases: Vec<f64>,
    /// How strong each squad is.
    strengths: Vec<f64>,
    frame: f64,
}

impl Fleet {
    fn new(n: usize) -> Self {
        let mut random = numbers(n as u64);
        let phases = (0..n).map(|_| 6.3 * random()).collect();
        let strengths = (0..n / 10).map(|_| 0.3 + 0.4 * random()).collect();
        Self { phases, strengths, frame: 0.0 }
    }

    /// Links within each squad, weak ones to the next squad, and a command tree. Weights change by
    /// `motion` of their size from frame to frame.
    fn graph(&self, motion: f64) -> SparseMatrix {
        let n = self.phases.len();
        let weight = |i: usize, j: usize| {
            1.0 + motion * (self.frame + self.phases[i] + 2.0 * self.phases[j]).sin()
        };
        let mut edges = Vec::new();
        for i in 0..n {
            let squad = i / 10;
            for j in 10 * squad..10 * squad + 10 {
                if i != j {
                    edges.push((i, j, self.strengths[squad] * weight(i, j)));
                }
            }
            let next = (i + 10) % n;
            edges.extend([(i, next, 0.05 * weight(i, next)), (next, i, 0.03 * weight(next, i))]);
            if i > 0 {
                edges.push((i, (i - 1) / 8, 0.05));
            }
        }
        graph(n, &edges)
    }
}

/// Follows a fleet whose squads are changed by `change` before some frames, given how many frames
/// have passed; returns after how many frames the values are those of a cold search again.
fn frames_until_found(
    n: usize,
    motion: f64,
    change: impl Fn(&mut Fleet, usize),
    lasts: usize,
) -> usize {
    let mut fleet = Fleet::new(n);
    let first = fleet.graph(motion);
    let exact = spectral_radius(&first, None);
    let radius = SpectralRadius { upper: 1.9 * exact.upper, ..exact };
    let alpha = 0.5 / exact.upper;
    let tolerance = 1e-3;
    let mut warm = KatzSvd::default();
    for _ in 0..10 {
        fleet.frame += 1.0;
        warm.solve(&fleet.graph(motion), alpha, &radius, options(tolerance), None).unwrap();
    }
    let mut last = 0;
    for frame in 0..lasts + 2 * FRAMES {
        change(&mut fleet, frame);
        fleet.frame += 1.0;
        let a = fleet.graph(motion);
        let report = warm.solve(&a, alpha, &radius, options(tolerance), None).unwrap();
        assert!(report.converged, "{report:?}");
        let mut cold = KatzSvd::default();
        assert!(cold.solve(&a, alpha, &radius, options(1e-5), None).unwrap().complete);
        let (found, wanted) = (warm.all_singular_values(), cold.all_singular_values());
        let off = (0..RANK).map(|j| (found[j] - wanted[j]).abs()).fold(0.0, f64::max) / wanted[0];
        if off > 2.0 * tolerance {
            last = frame + 1;
            assert!(frame < PROBE_STEPS as usize || !report.complete, "{frame}: {off:e}");
        }
    }
    last
}

#[test]
fn groups_that_form_at_once_are_found_at_once() {
    for n in [100, 400, 1000, 3000] {
        for motion in [0.0, 1e-3] {
            let change = |fleet: &mut Fleet, frame: usize| {
                if frame == 0 {
                    fleet.strengths[n / 20] = 0.9;
                }
            };
            let frames = frames_until_found(n, motion, change, 0);
            assert!(frames <= FRAMES, "{n} robots, motion {motion}: {frames} frames");
        }
    }
}

#[test]
fn groups_that_grow_are_found_as_they_pass_the_others() {
    for n in [400, 1000] {
        for motion in [0.0, 1e-3] {
            let lasts = 40;
            let change = |fleet: &mut Fleet, frame: usize| {
                if frame < lasts {
                    fleet.strengths[n / 20] = 0.3 + 0.015 * frame as f64;
                    fleet.strengths[n / 20 + 2] = 0.9 - 0.015 * frame as f64;
                }
            };
            let frames = frames_until_found(n, motion, change, lasts);
            assert!(frames <= lasts + FRAMES, "{n} robots, motion {motion}: {frames} frames");
        }
    }
}
