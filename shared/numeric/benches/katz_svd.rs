//! Times of the leading triplets of the Katz similarity: cold, when all robots move, and when one
//! does; and, for comparison, the memory bandwidth and the arithmetic speed of the machine.

mod fleet;

use divan::counter::{BytesCount, ItemsCount};
use divan::{Bencher, black_box};
use fleet::{Fleet, STEP};
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::RadiusTracker;
use muster_numeric::spectral_radius::SpectralRadius;

/// Robots.
const SIZES: [usize; 5] = [200, 500, 1_000, 10_000, 100_000];

/// Triplets.
const RANK: usize = 16;

/// Numbers of a block that exceeds every cache.
const LARGE: usize = 1 << 24;

fn main() {
    divan::main();
}

/// The fleet's radius with a margin for motion, and α for αρ about 0.9.
fn decay(fleet: &Fleet) -> (SpectralRadius, f64) {
    let a = fleet.graph();
    let mut tracker = RadiusTracker::default();
    let bound = tracker.bound(&a);
    let radius = tracker.spectral_radius(&bound);
    let alpha = 0.9 / radius.upper;
    (SpectralRadius { upper: 1.1 * radius.upper, ..radius }, alpha)
}

fn options(tolerance: f64, threads: usize) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank: RANK, tolerance, seed: 3, threads }
}

fn solve(
    solver: &mut KatzSvd,
    a: &SparseMatrix,
    (radius, alpha): &(SpectralRadius, f64),
    options: KatzSvdOptions,
) -> usize {
    let report = solver.solve(a, *alpha, radius, options, None);
    report.unwrap_or_else(|error| unreachable!("{error}")).rounds
}

/// From nothing to a residual of 1e-6.
#[divan::bench(args = SIZES, consts = [1, 2], max_time = 5)]
fn cold<const THREADS: usize>(bencher: Bencher<'_, '_>, n: usize) {
    let fleet = Fleet::new(n);
    let (a, decay) = (fleet.graph(), decay(&fleet));
    bencher.counter(ItemsCount::new(n)).with_inputs(KatzSvd::default).bench_local_values(
        |mut solver| {
            solve(&mut solver, black_box(&a), &decay, options(1e-6, THREADS));
            solver
        },
    );
}

/// All robots have moved since the last frame, to 1e-3.
#[divan::bench(args = SIZES, consts = [1, 2], max_time = 5)]
fn tick<const THREADS: usize>(bencher: Bencher<'_, '_>, n: usize) {
    let mut fleet = Fleet::new(n);
    let decay = decay(&fleet);
    let options = options(1e-3, THREADS);
    let mut solver = KatzSvd::default();
    let mut next = || {
        (0..n).for_each(|robot| fleet.shift(robot, STEP));
        fleet.graph()
    };
    for _ in 0..3 {
        solve(&mut solver, &next(), &decay, options);
    }
    bencher
        .counter(ItemsCount::new(n))
        .with_inputs(next)
        .bench_local_refs(|a| solve(&mut solver, black_box(a), &decay, options));
}

/// One robot has moved, to 1e-4; the graphs are compared.
#[divan::bench(args = SIZES, max_time = 5)]
fn event(bencher: Bencher<'_, '_>, n: usize) {
    let mut fleet = Fleet::new(n);
    let decay = decay(&fleet);
    let mut solver = KatzSvd::default();
    solve(&mut solver, &fleet.graph(), &decay, options(1e-5, 1));
    let mut robot = 0;
    let mut next = || {
        robot = (robot + 7919) % n;
        fleet.shift(robot, STEP);
        fleet.graph()
    };
    solve(&mut solver, &next(), &decay, options(1e-4, 1));
    bencher
        .with_inputs(next)
        .bench_local_refs(|a| solve(&mut solver, black_box(a), &decay, options(1e-4, 1)));
}

/// The same for a caller that knows which rows have changed.
#[divan::bench(args = SIZES, max_time = 5)]
fn event_with_rows(bencher: Bencher<'_, '_>, n: usize) {
    let mut fleet = Fleet::new(n);
    let decay = decay(&fleet);
    let mut solver = KatzSvd::default();
    let mut before = fleet.graph();
    solve(&mut solver, &before, &decay, options(1e-5, 1));
    let mut robot = 0;
    let mut next = || {
        robot = (robot + 7919) % n;
        fleet.shift(robot, STEP);
        let (a, mut changed) = (fleet.graph(), Vec::new());
        before.differing_rows(&a, n, &mut changed);
        before = a.clone();
        (a, changed)
    };
    let (a, _) = next();
    solve(&mut solver, &a, &decay, options(1e-4, 1));
    let (radius, alpha) = &decay;
    bencher.with_inputs(next).bench_local_refs(|(a, changed)| {
        solver.solve_changed(black_box(a), *alpha, radius, options(1e-4, 1), changed)
    });
}

/// Memory bandwidth: x ← y + 3z over blocks that exceed every cache, in bytes moved.
#[divan::bench(max_time = 2)]
fn triad(bencher: Bencher<'_, '_>) {
    let (y, z) = (vec![1.0_f64; LARGE], vec![2.0_f64; LARGE]);
    let mut x = vec![0.0_f64; LARGE];
    bencher.counter(BytesCount::new(3 * 8 * LARGE)).bench_local(|| {
        for (x, (y, z)) in x.iter_mut().zip(black_box(&y).iter().zip(&z)) {
            *x = y + 3.0 * z;
        }
        black_box(&x);
    });
}
