//! Times of updates of the kept Katz similarity, on fleets of squads of which some robots move.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::time::Instant;

use muster_numeric::cached_katz::{CachedKatz, Method};
use muster_numeric::katz::katz_similarity;
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::RadiusTracker;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A radius kernel that vanishes smoothly, and an 8-ary tree.
fn smooth(points: &[(f64, f64)]) -> SparseMatrix {
    let reach = 1.8_f64;
    let mut edges = Vec::new();
    for (i, p) in points.iter().enumerate() {
        for (j, q) in points.iter().enumerate().filter(|e| e.0 != i) {
            let d2 = ((p.0 - q.0).powi(2) + (p.1 - q.1).powi(2)) / reach.powi(2);
            if d2 < 1.0 {
                edges.push((i, j, (1.0 - d2).powi(2)));
            }
        }
        if i > 0 {
            edges.push(((i - 1) / 8, i, 0.5));
        }
    }
    SparseMatrix::from_triplets(points.len(), edges).unwrap()
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() {
    let sizes = std::env::args().nth(1).unwrap_or_else(|| "200,1000,2000".into());
    for n in sizes.split(',').map(|n| n.parse::<usize>().unwrap()) {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let side = (n as f64).sqrt();
        let mut points: Vec<(f64, f64)> =
            (0..n).map(|_| (rng.random::<f64>() * side, rng.random::<f64>() * side)).collect();
        let a = smooth(&points);
        let mut tracker = RadiusTracker::default();
        let bound = tracker.bound(&a);
        let alpha = 0.7 / bound.upper;
        let t = Instant::now();
        katz_similarity(&a, alpha, &tracker.spectral_radius(&bound)).unwrap();
        let scratch = t.elapsed().as_secs_f64() * 1e3;
        let mut kept = CachedKatz::default();
        kept.set_rank_share(1.0).unwrap();
        let t = Instant::now();
        kept.update(&a, alpha, &tracker.spectral_radius(&bound), None).unwrap();
        println!("n {n}: scratch {scratch:.2} ms, first {:.2} ms", t.elapsed().as_secs_f64() * 1e3);
        for movers in
            [1, 2, n / 100, n / 20, n / 10, n / 5, 3 * n / 10].into_iter().filter(|m| *m > 0)
        {
            let (mut times, mut ranks, mut probes) = (Vec::new(), Vec::new(), Vec::new());
            let reps = (20_000 / (n + 10 * movers)).clamp(3, 40);
            for _ in 0..reps {
                for _ in 0..movers {
                    let who = rng.random_range(0..n);
                    let p = &mut points[who];
                    p.0 += 0.1 * (rng.random::<f64>() - 0.5);
                    p.1 += 0.1 * (rng.random::<f64>() - 0.5);
                }
                let a = smooth(&points);
                let bound = tracker.bound(&a);
                let radius = tracker.spectral_radius(&bound);
                let t = Instant::now();
                let found = kept.update(&a, alpha, &radius, None).unwrap();
                times.push(t.elapsed().as_secs_f64() * 1e3);
                ranks.push(found.rank);
                probes.push(found.probe);
                assert_eq!(found.method, Method::Updated);
            }
            println!(
                "  {movers} moved: {:.3}–{:.3} ms, rank {}, probe {:.1e}",
                times.iter().copied().fold(f64::INFINITY, f64::min),
                median(times),
                ranks.iter().sum::<usize>() / ranks.len(),
                median(probes),
            );
        }
    }
}
