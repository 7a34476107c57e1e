//! Times of the bounds of the spectral radius, of Katz centralities, and of updates of the kept Katz
//! similarity.

mod fleet;

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use fleet::{Fleet, STEP};
use muster_numeric::cached_katz::{CachedKatz, Method};
use muster_numeric::katz::katz_similarity;
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::RadiusTracker;
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Robots of graphs.
const SIZES: [usize; 3] = [1_000, 10_000, 100_000];

/// Robots, and how many of them move, of similarities.
const UPDATES: [(usize, usize); 6] =
    [(200, 1), (200, 20), (1_000, 1), (1_000, 50), (2_000, 1), (2_000, 200)];

fn main() {
    divan::main();
}

/// Random links of degree 8: no part is denser than another.
fn random(n: usize) -> SparseMatrix {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut edge = || (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>());
    SparseMatrix::from_triplets(n, (0..8 * n).map(|_| edge()))
        .unwrap_or_else(|error| unreachable!("{error}"))
}

/// The radius of `a` with a margin for motion, and α for αρ about 0.7.
fn decay(a: &SparseMatrix) -> (SpectralRadius, f64) {
    let mut tracker = RadiusTracker::default();
    let bound = tracker.bound(a);
    let radius = tracker.spectral_radius(&bound);
    (SpectralRadius { upper: 1.2 * radius.upper, ..radius }, 0.7 / bound.upper)
}

/// The radius to 1e-13.
#[divan::bench(args = SIZES[..2].iter().copied())]
fn exact(bencher: Bencher<'_, '_>, n: usize) {
    let a = Fleet::new(n).graph();
    bencher.counter(ItemsCount::new(n)).bench_local(|| spectral_radius(black_box(&a), None));
}

/// Live bounds without a previous frame.
#[divan::bench(args = SIZES, consts = [true, false])]
fn cold<const SQUADS: bool>(bencher: Bencher<'_, '_>, n: usize) {
    let a = if SQUADS { Fleet::new(n).graph() } else { random(n) };
    bencher
        .counter(ItemsCount::new(n))
        .bench_local(|| RadiusTracker::default().bound(black_box(&a)));
}

/// Live bounds after all robots have moved.
#[divan::bench(args = SIZES)]
fn warm(bencher: Bencher<'_, '_>, n: usize) {
    let (mut fleet, mut tracker) = (Fleet::new(n), RadiusTracker::default());
    let next = || {
        (0..n).for_each(|robot| fleet.shift(robot, STEP));
        fleet.graph()
    };
    bencher
        .counter(ItemsCount::new(n))
        .with_inputs(next)
        .bench_local_refs(|a| tracker.bound(black_box(a)));
}

/// Bounds of a given relative width.
#[divan::bench(args = [1e-2, 1e-3, 1e-6])]
fn refined(bencher: Bencher<'_, '_>, width: f64) {
    let (a, mut tracker) = (Fleet::new(SIZES[1]).graph(), RadiusTracker::default());
    bencher.bench_local(|| tracker.refine(black_box(&a), width));
}

/// Katz centralities to 1e-6.
#[divan::bench(args = SIZES)]
fn centrality(bencher: Bencher<'_, '_>, n: usize) {
    let a = Fleet::new(n).graph();
    bencher.with_inputs(RadiusTracker::default).bench_local_values(|mut tracker| {
        let bound = tracker.bound(&a);
        tracker.solve_centrality(black_box(&a), 0.5 / bound.upper, &bound, 1e-6)
    });
}

/// The similarity from scratch.
#[divan::bench(args = [200, 1_000, 2_000])]
fn scratch(bencher: Bencher<'_, '_>, n: usize) {
    let a = Fleet::new(n).graph();
    let (radius, alpha) = decay(&a);
    bencher.bench_local(|| katz_similarity(black_box(&a), alpha, &radius));
}

/// The similarity after some robots have moved.
#[divan::bench(args = UPDATES)]
fn update(bencher: Bencher<'_, '_>, (n, movers): (usize, usize)) {
    let mut fleet = Fleet::new(n);
    let a = fleet.graph();
    let (radius, alpha) = decay(&a);
    let mut cached = CachedKatz::default();
    let updated = cached.set_rank_share(1.0).and_then(|()| cached.update(&a, alpha, &radius, None));
    updated.unwrap_or_else(|error| unreachable!("{error}"));
    let mut robot = 0;
    let next = || {
        for _ in 0..movers {
            robot = (robot + 7919) % n;
            fleet.shift(robot, STEP);
        }
        fleet.graph()
    };
    bencher.with_inputs(next).bench_local_refs(|a| {
        let update = cached.update(black_box(a), alpha, &radius, None);
        assert!(update.is_ok_and(|update| matches!(update.method, Method::Updated | Method::Kept)));
    });
}
