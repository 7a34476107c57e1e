//! Triplets that are updated after a change of few rows, against passes over all rows.

use muster_numeric::katz_svd::{KatzSvd, KatzSvdError, KatzSvdOptions, KatzSvdReport};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use muster_numeric::svd::RankKSvd;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const RANK: usize = 6;

fn options(tolerance: f64) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank: RANK, tolerance, seed: 3, threads: 1 }
}

/// Robots in the plane, related by a kernel that falls smoothly to zero, more one way than the other.
struct Fleet {
    places: Vec<(f64, f64)>,
}

impl Fleet {
    fn new(n: usize, rng: &mut ChaCha8Rng) -> Self {
        let side = (n as f64).sqrt();
        let place = |_| (side * rng.random::<f64>(), side * rng.random::<f64>());
        Self { places: (0..n).map(place).collect() }
    }

    fn graph(&self) -> SparseMatrix {
        let n = self.places.len();
        let mut edges = Vec::new();
        for (i, p) in self.places.iter().enumerate() {
            for (j, q) in self.places.iter().enumerate() {
                let square = ((p.0 - q.0).powi(2) + (p.1 - q.1).powi(2)) / 4.0;
                if i != j && square < 1.0 {
                    edges.push((i, j, (1.0 - square).powi(2) * (1.0 + 0.3 * (j % 3) as f64)));
                }
            }
            if i > 0 {
                edges.push((i, (i - 1) / 8, 0.2));
            }
        }
        SparseMatrix::from_triplets(n, edges).unwrap()
    }
}

/// The radius that the tests need: all graphs stay below it.
fn roomy(a: &SparseMatrix) -> SpectralRadius {
    SpectralRadius { upper: 1.3 * spectral_radius(a, None).upper, ..spectral_radius(a, None) }
}

fn product(a: &SparseMatrix, x: &[f64]) -> Vec<f64> {
    a.mat_vec(x).unwrap()
}

/// The largest ‖αAᵀ(u + σv) − σv‖/σ₁, and how far S v = σu is from true, as ‖αA(v + σu) − σu‖/σ₁.
fn whole_pass(a: &SparseMatrix, alpha: f64, svd: &RankKSvd) -> (f64, f64) {
    let transposed = a.transpose();
    let column = |m: &DenseMatrix, j: usize| (0..m.rows()).map(|i| m.row(i)[j]).collect::<Vec<_>>();
    let mut worst = (0.0_f64, 0.0_f64);
    for (j, sigma) in svd.sigma.iter().enumerate() {
        let (u, v) = (column(&svd.u, j), column(&svd.v, j));
        let length = |a: &SparseMatrix, x: &[f64], y: &[f64]| {
            let sum: Vec<f64> = x.iter().zip(y).map(|(x, y)| x + sigma * y).collect();
            let off = product(a, &sum);
            let off = off.iter().zip(y).map(|(s, y)| (alpha * s - sigma * y).powi(2));
            off.sum::<f64>().sqrt() / svd.sigma[0]
        };
        worst = (worst.0.max(length(&transposed, &u, &v)), worst.1.max(length(a, &v, &u)));
    }
    worst
}

fn orthonormal(m: &DenseMatrix) -> f64 {
    let mut worst = 0.0_f64;
    for p in 0..m.cols() {
        for q in 0..m.cols() {
            let sum: f64 = (0..m.rows()).map(|i| m.row(i)[p] * m.row(i)[q]).sum();
            worst = worst.max((sum - f64::from(u8::from(p == q))).abs());
        }
    }
    worst
}

/// Moves one robot after the other and passes each result to `check`. Returns how many needed no
/// search.
fn follow(
    n: usize,
    seed: u64,
    tolerance: f64,
    rows_given: bool,
    mut check: impl FnMut(&KatzSvd, &KatzSvdReport, &SparseMatrix, f64),
) -> usize {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut fleet = Fleet::new(n, &mut rng);
    let mut before = fleet.graph();
    let radius = roomy(&before);
    let alpha = 0.95 / radius.upper;
    let mut solver = KatzSvd::default();
    solver.solve(&before, alpha, &radius, options(tolerance), None).unwrap();
    let mut without = 0;
    for event in 0..40 {
        let robot = rng.random_range(0..n);
        let step = [0.001, 0.03, 0.3][event % 3];
        fleet.places[robot].0 += step * (rng.random::<f64>() - 0.5);
        fleet.places[robot].1 += step * (rng.random::<f64>() - 0.5);
        let a = fleet.graph();
        let report = if rows_given {
            let mut changed = vec![robot];
            before.differing_rows(&a, n, &mut changed);
            solver.solve_changed(&a, alpha, &radius, options(tolerance), &changed)
        } else {
            solver.solve(&a, alpha, &radius, options(tolerance), None)
        };
        let report = report.unwrap();
        without += usize::from(report.rounds == 0);
        check(&solver, &report, &a, alpha);
        before = a;
    }
    without
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10))]

    #[test]
    fn the_residual_is_never_below_that_of_a_whole_pass(
        seed in 0..10_000_u64,
        n in 130..400_usize,
        rows_given: bool,
        tolerance in prop::sample::select(vec![1e-2, 1e-4, 1e-7]),
    ) {
        follow(n, seed, tolerance, rows_given, |solver, report, a, alpha| {
            assert!(report.converged && report.residual <= tolerance, "{report:?}");
            let svd = solver.truncate(RANK).unwrap();
            let (right, left) = whole_pass(a, alpha, &svd);
            assert!(right <= report.residual * (1.0 + 1e-6) + 1e-12, "{right:e} {report:?}");
            assert!(left < 1e-12, "{left:e}");
            assert!(orthonormal(&svd.u).max(orthonormal(&svd.v)) < 1e-9);
        });
    }
}

#[test]
fn small_moves_need_no_search_and_give_the_triplets_of_one() {
    let mut largest = 0.0_f64;
    let without = follow(400, 7, 1e-3, false, |solver, report, a, alpha| {
        let radius = SpectralRadius { upper: 0.99 / alpha, ..roomy(a) };
        let mut fresh = KatzSvd::default();
        fresh.solve(a, alpha, &radius, options(1e-9), None).unwrap();
        let top = fresh.all_singular_values()[0];
        for (j, wanted) in fresh.all_singular_values().iter().enumerate().take(RANK) {
            // Weyl; ‖Sᵀu − σv‖ is at most 1 + σ₁ times the residual.
            let bound = (1.0 + top) * report.residual * top;
            let off = (solver.all_singular_values()[j] - wanted).abs();
            assert!(off <= bound, "σ{j} is off by {off:e}: {report:?}");
            largest = largest.max(off / top);
        }
    });
    assert!(without >= 20, "{without} of 40 without a search");
    assert!(largest < 1e-4, "{largest:e}");
}

#[test]
fn compared_and_given_rows_lead_to_the_same_result_bit_for_bit() {
    let results = [false, true].map(|rows_given| {
        let mut all = Vec::new();
        follow(300, 11, 1e-3, rows_given, |solver, report, _, _| {
            let svd = solver.truncate(RANK).unwrap();
            all.push((report.residual.to_bits(), svd.u.data().to_vec(), svd.sigma));
        });
        all
    });
    assert!(results[0] == results[1]);
}

#[test]
fn a_pair_closer_than_any_before_is_found_at_once() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let a = Fleet::new(300, &mut rng).graph();
    let radius = roomy(&a);
    let heavy = 0.9 * radius.upper;
    let docked = a.triplets().chain([(7, 290, heavy), (290, 7, heavy)]);
    let docked = SparseMatrix::from_triplets(300, docked).unwrap();
    let radius = SpectralRadius { upper: 2.0 * radius.upper, ..radius };
    let alpha = 0.9 / radius.upper;
    for calm in 0..3 {
        let mut solver = KatzSvd::default();
        for _ in 0..=calm {
            solver.solve(&a, alpha, &radius, options(1e-4), None).unwrap();
        }
        let mut fresh = KatzSvd::default();
        solver.solve_changed(&docked, alpha, &radius, options(1e-4), &[7, 290]).unwrap();
        fresh.solve(&docked, alpha, &radius, options(1e-8), None).unwrap();
        let (found, wanted) = (solver.all_singular_values()[0], fresh.all_singular_values()[0]);
        assert!((found - wanted).abs() < 1e-4 * wanted, "{found} {wanted}");
    }
}

#[test]
fn rows_that_change_back_and_forth_are_not_forgotten() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let a = Fleet::new(300, &mut rng).graph();
    let radius = roomy(&a);
    let alpha = 0.9 / radius.upper;
    // Another entry in row 17, then other weights in row 40, then all as it was.
    let more = |extra: &[(usize, usize, f64)]| {
        SparseMatrix::from_triplets(300, a.triplets().chain(extra.iter().copied())).unwrap()
    };
    let own = a.row(40).next().unwrap().0;
    let versions = [
        more(&[]),
        more(&[(17, 250, 0.01)]),
        more(&[(17, 250, 0.01), (40, own, 0.01)]),
        more(&[(40, own, 0.02)]),
        more(&[]),
        more(&[]),
    ];
    let mut solver = KatzSvd::default();
    for version in &versions {
        let report = solver.solve(version, alpha, &radius, options(1e-3), None).unwrap();
        let (right, left) = whole_pass(version, alpha, &solver.truncate(RANK).unwrap());
        assert!(right <= report.residual * (1.0 + 1e-6) + 1e-12 && left < 1e-12, "{right} {left}");
    }
    let wrong = solver.solve_changed(&a, alpha, &radius, options(1e-3), &[300]);
    assert_eq!(wrong, Err(KatzSvdError::Changed { row: 300, nodes: 300 }));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let n = 5000;
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let edges: Vec<_> = (0..6 * n)
        .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
        .collect();
    let graph = |scale: f64| {
        let edges = edges.iter().enumerate();
        let scaled = edges.map(|(k, e)| (e.0, e.1, if k < 9 { scale * e.2 } else { e.2 }));
        SparseMatrix::from_triplets(n, scaled).unwrap()
    };
    let radius = roomy(&graph(1.0));
    let alpha = 0.7 / radius.upper;
    let run = |threads| {
        let mut solver = KatzSvd::default();
        let mut all = Vec::new();
        for scale in [1.0, 0.9, 0.8] {
            let options = KatzSvdOptions { threads, ..options(1e-5) };
            let report = solver.solve(&graph(scale), alpha, &radius, options, None).unwrap();
            let svd = solver.truncate(RANK).unwrap();
            all.push((report.residual.to_bits(), svd.sigma, svd.u.into_data()));
        }
        all
    };
    assert!(run(1) == run(3));
}
