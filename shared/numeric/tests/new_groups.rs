//! Groups that become strong after a search has begun to follow others.
use crate::common::*;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};

/// Triplets that are followed, for half of the dimension 32.
const RANK: usize = 16;

/// Frames after which the triplets must be those of a cold search.
const FRAMES: usize = 6;

fn options(tolerance: f64) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank: RANK, tolerance, seed: 3, threads: 1 }
}

/// Robots in squads that sway around their places; some of them stand closer together.
struct Fleet {
    /// Phase of each robot.
    phases: Vec<f64>,
    /// Robots of a squad.
    squad: usize,
    /// How strong each squad is.
    strengths: Vec<f64>,
    /// Squads that are not there.
    absent: Vec<usize>,
    frame: f64,
}

impl Fleet {
    fn new(n: usize) -> Self {
        let mut random = numbers(n as u64);
        let phases = (0..n).map(|_| 6.3 * random()).collect();
        // More squads than triplets.
        let squad = if n < 200 { 4 } else { 10 };
        let strengths = (0..n / squad).map(|_| 0.3 + 0.4 * random()).collect();
        Self { phases, squad, strengths, absent: Vec::new(), frame: 0.0 }
    }

    /// The graph of those who are there, and where each of them was among `members`, if these have
    /// changed.
    fn present(
        &self,
        all: &SparseMatrix,
        members: &mut Vec<usize>,
    ) -> (SparseMatrix, Option<Vec<Option<usize>>>) {
        let present = (0..self.phases.len()).filter(|i| !self.absent.contains(&(i / self.squad)));
        let now: Vec<usize> = present.collect();
        let place = |i: usize| now.binary_search(&i).ok();
        let edges = all.triplets().filter_map(|(i, j, w)| Some((place(i)?, place(j)?, w)));
        let a = SparseMatrix::from_triplets(now.len(), edges).unwrap();
        let previous = now.iter().map(|i| members.binary_search(i).ok()).collect();
        let changed = now != *members;
        *members = now;
        (a, changed.then_some(previous))
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
            let squad = i / self.squad;
            for j in self.squad * squad..self.squad * (squad + 1) {
                if i != j {
                    edges.push((i, j, self.strengths[squad] * weight(i, j)));
                }
            }
            let next = (i + self.squad) % n;
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
    let mut members: Vec<usize> = (0..n).collect();
    for frame in 0..lasts + FRAMES + 2 {
        change(&mut fleet, frame);
        fleet.frame += 1.0;
        let all = fleet.graph(motion);
        let (a, previous) = fleet.present(&all, &mut members);
        let report = warm.solve(&a, alpha, &radius, options(tolerance), previous.as_deref());
        let report = report.unwrap();
        assert!(report.converged, "{report:?}");
        let mut cold = KatzSvd::default();
        let reference = cold.solve(&a, alpha, &radius, options(1e-5), None).unwrap();
        assert!(reference.complete, "{n} robots, motion {motion}, frame {frame}: {reference:?}");
        let (found, wanted) = (warm.all_singular_values(), cold.all_singular_values());
        let off = (0..RANK).map(|j| (found[j] - wanted[j]).abs()).fold(0.0, f64::max) / wanted[0];
        if off > 2.0 * tolerance {
            last = frame + 1;
            assert!(!report.complete, "{n} robots, motion {motion}, frame {frame}: {off:e}");
        }
    }
    last
}

/// [`frames_until_found`] for fleets of several sizes, at rest and with all robots moving.
fn follow(sizes: &[usize], lasts: usize, change: impl Fn(&mut Fleet, usize, usize)) {
    for n in sizes {
        // A fleet of ten thousand takes long: it is followed as it moves.
        let motions = if *n < 10_000 { &[0.0, 1e-3][..] } else { &[1e-3] };
        for &motion in motions {
            let change = |fleet: &mut Fleet, frame: usize| change(fleet, *n, frame);
            let frames = frames_until_found(*n, motion, change, lasts);
            assert!(frames <= lasts + FRAMES, "{n} robots, motion {motion}: {frames} frames");
        }
    }
}

#[test]
fn groups_that_form_at_once_are_found_at_once() {
    follow(&[100, 400, 1000, 3000, 10_000], 0, |fleet, n, frame| {
        if frame == 0 {
            fleet.strengths[n / 20] = 0.9;
        }
    });
}

#[test]
fn groups_that_grow_are_found_as_they_pass_the_others() {
    let lasts = 40;
    follow(&[100, 400, 1000], lasts, |fleet, n, frame| {
        if frame < lasts {
            fleet.strengths[n / 20] = 0.3 + 0.015 * frame as f64;
            fleet.strengths[n / 20 + 2] = 0.9 - 0.015 * frame as f64;
        }
    });
}

#[test]
fn groups_of_large_fleets_that_grow_are_found_as_they_pass_the_others() {
    let lasts = 12;
    follow(&[3000, 10_000], lasts, |fleet, n, frame| {
        if frame < lasts {
            fleet.strengths[n / 20] = 0.3 + 0.05 * frame as f64;
        }
    });
}

#[test]
fn what_remains_of_groups_that_split_is_found() {
    // The strongest squads fall apart at once or one after the other, so that others come up which none
    // of the known triplets holds.
    follow(&[400, 1000, 3000, 10_000], 0, |fleet, _, frame| {
        if frame == 0 {
            for _ in 0..24 {
                let strengths = fleet.strengths.iter_mut();
                let strongest = strengths.max_by(|left, right| left.total_cmp(right)).unwrap();
                *strongest = 0.2;
            }
        }
    });
    follow(&[400, 1000], 12, |fleet, _, frame| {
        if frame < 12 {
            for _ in 0..3 {
                let strengths = fleet.strengths.iter_mut();
                let strongest = strengths.max_by(|left, right| left.total_cmp(right)).unwrap();
                *strongest = 0.2;
            }
        }
    });
}

#[test]
fn what_remains_where_groups_leave_is_found() {
    follow(&[400, 1000, 3000, 10_000], 0, |fleet, _, frame| {
        if frame == 0 {
            let mut squads: Vec<usize> = (0..fleet.strengths.len()).collect();
            squads.sort_by(|i, j| fleet.strengths[*j].total_cmp(&fleet.strengths[*i]));
            fleet.absent = squads[..24].to_vec();
        }
    });
}

#[test]
fn groups_that_join_are_found() {
    follow(&[400, 3000, 10_000], 3, |fleet, n, frame| {
        if frame == 0 {
            fleet.absent = vec![n / 20, n / 20 + 1];
            fleet.strengths[n / 20] = 0.9;
        } else if frame == 3 {
            fleet.absent.clear();
        }
    });
}
