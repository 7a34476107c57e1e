//! One robot has moved: what the triplets of the next frame take, from A* on.
//!
//! `handed_over` is what the embedder calls, which looks for the rows that have changed once and hands them
//! over. `compared_twice` asks first whether anything has changed, and lets the search compare again.

#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark fails by panicking")]

use std::hint::black_box;
use std::sync::Arc;

use divan::Bencher;
use muster_method::Decay;
use muster_method::decomposition::LeadingTriplets;
use muster_model::id::RobotId;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::spectral_radius::spectral_radius;

const SIZES: [usize; 3] = [300, 2000, 20_000];

fn main() {
    divan::main();
}

/// Robots on a grid, each related to those within two cells; one of them is nearer to all or further away.
struct Fleet {
    columns: usize,
    robots: usize,
    shifts: Vec<f64>,
    moved: usize,
}

impl Fleet {
    fn new(robots: usize) -> Self {
        let shifts = (0..robots).map(|i| 0.2 * ((i * 7919 % 101) as f64 / 101.0)).collect();
        Self { columns: robots.isqrt(), robots, shifts, moved: 0 }
    }

    fn graph(&self) -> Arc<SparseMatrix> {
        let steps: Vec<(i64, i64)> = (-2..=2)
            .flat_map(|x| (-2..=2).map(move |y| (x, y)))
            .filter(|step| *step != (0, 0))
            .collect();
        let columns = self.columns as i64;
        let edges = (0..self.robots as i64).flat_map(|i| {
            let (x, y) = (i % columns, i / columns);
            let near = move |(dx, dy): &(i64, i64)| {
                let (x, y) = (x + dx, y + dy);
                ((0..columns).contains(&x) && y >= 0)
                    .then_some((y * columns + x, dx * dx + dy * dy))
            };
            steps.clone().into_iter().filter_map(move |step| near(&step)).filter_map(
                move |(j, square)| {
                    let (i, j) = (i as usize, j as usize);
                    let distance = square as f64 + self.shifts[i] + self.shifts.get(j)?;
                    Some((i, j, (-distance).exp()))
                },
            )
        });
        Arc::new(SparseMatrix::from_triplets(self.robots, edges).unwrap())
    }

    fn next(&mut self) -> Arc<SparseMatrix> {
        self.moved = (self.moved + 7919) % self.robots;
        self.shifts[self.moved] = (self.shifts[self.moved] + 0.01) % 0.2;
        self.graph()
    }
}

fn options(tolerance: f64) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank: 5, tolerance, seed: 1, threads: 1 }
}

fn decay(graph: &SparseMatrix) -> Decay {
    let radius = spectral_radius(graph, None);
    Decay { alpha: 0.5 / (1.01 * radius.upper), radius }
}

#[divan::bench(args = SIZES, max_time = 4)]
fn handed_over(bencher: Bencher<'_, '_>, robots: usize) {
    let mut fleet = Fleet::new(robots);
    let first = fleet.graph();
    let decay = decay(&first);
    let names: Arc<[RobotId]> =
        (0..robots).map(|i| RobotId::new(format!("r{i:06}")).unwrap()).collect();
    let mut leading = LeadingTriplets::default();
    leading.advance(&first, &decay, &names, options(1e-5), &mut |_| {}).unwrap();
    bencher.with_inputs(|| fleet.next()).bench_local_values(|graph| {
        leading.advance(black_box(&graph), &decay, &names, options(1e-4), &mut |_| {}).unwrap()
    });
}

#[divan::bench(args = SIZES, max_time = 4)]
fn compared_twice(bencher: Bencher<'_, '_>, robots: usize) {
    let mut fleet = Fleet::new(robots);
    let mut before = fleet.graph();
    let decay = decay(&before);
    let mut search = KatzSvd::default();
    search.solve(&before, decay.alpha, &decay.radius, options(1e-5), None).unwrap();
    bencher.with_inputs(|| fleet.next()).bench_local_values(|graph| {
        let is_same = *before == *graph;
        let report =
            search.solve(black_box(&graph), decay.alpha, &decay.radius, options(1e-4), None);
        before = (*graph).clone().into();
        (is_same, report.unwrap())
    });
}
