//! Times of the leading triplets of the Katz similarity: cold, when all robots move, and when one
//! does; and, for comparison, the memory bandwidth and the arithmetic speed of the machine.
//!
//! Fleets are clustered squads at unit density in the order of a Morton curve, related by a kernel
//! that falls smoothly to zero and by a tree of commands: about 18 weights a robot.

use divan::counter::{BytesCount, ItemsCount};
use divan::{Bencher, black_box};
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::RadiusTracker;
use muster_numeric::spectral_radius::SpectralRadius;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Robots.
const SIZES: [usize; 5] = [200, 500, 1_000, 10_000, 100_000];

/// Triplets.
const RANK: usize = 16;

/// Distance that each robot covers from frame to frame, in mean spacings.
const STEP: f64 = 0.004;

/// Reach of the kernel, in mean spacings.
const REACH: f64 = 2.0;

/// Numbers of a block that exceeds every cache.
const LARGE: usize = 1 << 24;

fn main() {
    divan::main();
}

struct Fleet {
    places: Vec<[f64; 2]>,
    headings: Vec<f64>,
    side: f64,
}

impl Fleet {
    fn new(n: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let side = (n as f64).sqrt();
        let squads: Vec<[f64; 2]> =
            (0..n.div_ceil(12)).map(|_| [(); 2].map(|()| side * rng.random::<f64>())).collect();
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let mut place = |i: usize| {
            squads[i % squads.len()].map(|centre| (centre + 1.6 * normal()).rem_euclid(side))
        };
        let mut places: Vec<[f64; 2]> = (0..n).map(&mut place).collect();
        places.sort_by_key(|place| morton(place.map(|x| (64.0 * x) as u32)));
        let headings = (0..n).map(|_| std::f64::consts::TAU * rng.random::<f64>()).collect();
        Self { places, headings, side }
    }

    fn shift(&mut self, robot: usize, step: f64) {
        let heading = self.headings[robot];
        self.places[robot][0] += step * heading.cos();
        self.places[robot][1] += step * heading.sin();
    }

    fn graph(&self) -> SparseMatrix {
        let cells = (self.side / REACH) as usize + 3;
        let cell = |x: f64| ((x / REACH + 1.0).max(0.0) as usize).min(cells - 1);
        let mut grid = vec![Vec::new(); cells * cells];
        for (i, place) in self.places.iter().enumerate() {
            grid[cell(place[1]) * cells + cell(place[0])].push(i);
        }
        let near = |i: usize| {
            let [x, y] = self.places[i].map(cell);
            let rows = y.saturating_sub(1)..(y + 2).min(cells);
            let columns = x.saturating_sub(1)..(x + 2).min(cells);
            rows.flat_map(move |row| columns.clone().map(move |column| row * cells + column))
        };
        let mut edges = Vec::new();
        for (i, p) in self.places.iter().enumerate() {
            for &j in near(i).flat_map(|cell| &grid[cell]) {
                let q = self.places[j];
                let square = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / REACH.powi(2);
                if i != j && square < 1.0 {
                    edges.push((i, j, (1.0 - square).powi(2)));
                }
            }
            if i > 0 {
                edges.extend([(i, (i - 1) / 8, 0.3), ((i - 1) / 8, i, 0.2)]);
            }
        }
        SparseMatrix::from_triplets(self.places.len(), edges)
            .unwrap_or_else(|error| unreachable!("{error}"))
    }
}

/// Place on the curve that takes the bits of both coordinates in turn.
fn morton(place: [u32; 2]) -> u64 {
    let spread = |v: u32| (0..32).map(|bit| u64::from(v >> bit & 1) << (2 * bit)).sum::<u64>();
    spread(place[0]) | spread(place[1]) << 1
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
    KatzSvdOptions { rank: RANK, tolerance, seed: 3, threads }
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
