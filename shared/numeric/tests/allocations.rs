//! State that is kept from frame to frame allocates nothing after one frame of each kind.
//!
//! Allocations are counted on the calling thread, which does all work when one thread is asked for.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use allocation_counter::measure;
use muster_numeric::cached_katz::{CachedKatz, Method};
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::RadiusTracker;
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};

/// Searches between two new orders of the nodes, as in `katz_svd`; a new order allocates.
const ORDER_FRAMES: u64 = 100;

/// A grid whose weights sway a little from frame to frame; only those of `rows` rows if there is a limit.
fn swaying(n: usize, frame: u64, rows: Option<usize>) -> SparseMatrix {
    let side = n.isqrt();
    let weight = |i: usize, j: usize| {
        let phase = if rows.is_none_or(|rows| i < rows) { 0.02 * frame as f64 } else { 0.0 };
        1.0 + 0.3 * ((i * 7 + j * 3) as f64 + phase).sin()
    };
    let edges = (0..n).flat_map(|i| {
        [i + 1, i + side, i + n - 1, i + n - side, i + 2 * side]
            .map(|j| (i, j % n, weight(i, j % n)))
    });
    SparseMatrix::from_triplets(n, edges).unwrap()
}

fn roomy(a: &SparseMatrix) -> SpectralRadius {
    let radius = spectral_radius(a, None);
    SpectralRadius { upper: 1.2 * radius.upper, ..radius }
}

#[test]
fn searches_allocate_nothing_from_the_second_frame_on() {
    for (n, rank) in [(100, 4), (900, 8), (2500, 16)] {
        let first = swaying(n, 0, None);
        let radius = roomy(&first);
        let alpha = 0.8 / radius.upper;
        let options = KatzSvdOptions { exact: None, rank, tolerance: 1e-6, seed: 1, threads: 1 };
        let mut solver = KatzSvd::default();
        // Two frames fill the start of the search; the third one has used all of it.
        for frame in 0..3 {
            solver.solve(&swaying(n, frame, None), alpha, &radius, options, None).unwrap();
        }
        // None of the frames has a new order.
        let frames = 3..43;
        assert!(frames.end < ORDER_FRAMES);
        for frame in frames {
            let a = swaying(n, frame, None);
            let mut rounds = 0;
            let counted = measure(|| {
                rounds = solver.solve(&a, alpha, &radius, options, None).unwrap().rounds;
            });
            assert!(rounds > 0);
            assert_eq!(counted.count_total, 0, "n {n} frame {frame}: {counted:?}");
        }
    }
}

#[test]
fn changes_of_few_rows_allocate_nothing() {
    let n = 900;
    let radius = roomy(&swaying(n, 0, None));
    let alpha = 0.8 / radius.upper;
    let options = KatzSvdOptions { exact: None, rank: 8, tolerance: 5e-3, seed: 1, threads: 1 };
    let mut solver = KatzSvd::default();
    let mut without = 0;
    for frame in 0..40 {
        let a = swaying(n, frame, Some(9));
        let mut rounds = 0;
        let counted = measure(|| {
            rounds = solver.solve(&a, alpha, &radius, options, None).unwrap().rounds;
        });
        // The first change without a search computes the sums, the second updates them.
        assert!(without < 2 || counted.count_total == 0, "frame {frame}: {counted:?}");
        without += usize::from(rounds == 0);
    }
    assert!(without >= 10, "{without}");
}

#[test]
fn bounds_of_the_radius_allocate_nothing_in_the_steady_state() {
    for n in [100, 2500] {
        let mut tracker = RadiusTracker::default();
        for frame in 0..3 {
            tracker.bound(&swaying(n, frame, None));
        }
        for frame in 3..30 {
            let a = swaying(n, frame, None);
            let counted = measure(|| {
                let bound = tracker.bound(&a);
                assert!(bound.upper > bound.lower);
            });
            assert_eq!(counted.count_total, 0, "n {n} frame {frame}: {counted:?}");
        }
    }
}

#[test]
fn updates_of_the_similarity_allocate_nothing_in_the_steady_state() {
    let n = 200;
    let radius = roomy(&swaying(n, 0, None));
    let alpha = 0.5 / radius.upper;
    let mut cached = CachedKatz::default();
    // Until updates have been added to the matrix twice.
    for frame in 0..20 {
        cached.update(&swaying(n, frame, Some(4)), alpha, &radius, None).unwrap();
    }
    for frame in 20..50 {
        let a = swaying(n, frame, Some(4));
        let mut method = Method::Kept;
        let counted = measure(|| {
            method = cached.update(&a, alpha, &radius, None).unwrap().method;
        });
        assert_eq!(method, Method::Updated);
        assert_eq!(counted.count_total, 0, "frame {frame}: {counted:?}");
    }
}
