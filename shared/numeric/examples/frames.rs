//! Times of the partial decomposition on fleets of squads.
use std::time::Instant;
use muster_numeric::katz_svd::KatzSvd;
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::spectral_radius::spectral_radius;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn fleet(n: usize, seed: u64) -> Vec<(f64, f64)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let side = (n as f64).sqrt();
    let squads = n.div_ceil(8);
    let centres: Vec<(f64, f64)> = (0..squads).map(|_| (rng.random::<f64>() * side, rng.random::<f64>() * side)).collect();
    (0..n).map(|i| { let c = centres[i / 8]; (c.0 + 1.5 * (rng.random::<f64>() + rng.random::<f64>() - 1.0), c.1 + 1.5 * (rng.random::<f64>() + rng.random::<f64>() - 1.0)) }).collect()
}

/// A radius kernel that vanishes smoothly, plus an 8-ary tree.
fn smooth(points: &[(f64, f64)]) -> SparseMatrix {
    let n = points.len();
    let radius = 1.8;
    let mut cells = std::collections::HashMap::<(i64, i64), Vec<usize>>::new();
    for (i, p) in points.iter().enumerate() { cells.entry(((p.0 / radius).floor() as i64, (p.1 / radius).floor() as i64)).or_default().push(i); }
    let mut edges = Vec::new();
    for (i, p) in points.iter().enumerate() {
        let c = ((p.0 / radius).floor() as i64, (p.1 / radius).floor() as i64);
        for dx in -1..=1 { for dy in -1..=1 { if let Some(list) = cells.get(&(c.0 + dx, c.1 + dy)) { for &j in list { if j != i {
            let d2 = ((p.0 - points[j].0).powi(2) + (p.1 - points[j].1).powi(2)) / (radius * radius);
            if d2 < 1.0 { edges.push((i, j, (1.0 - d2).powi(2))); }
        }}}}}
        if i > 0 { edges.push(((i - 1) / 8, i, 0.5)); }
    }
    SparseMatrix::from_triplets(n, edges).unwrap()
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let sizes: Vec<usize> = args[1].split(',').map(|a| a.parse().unwrap()).collect();
    for n in sizes {
        let mut points = fleet(n, 1);
        let a = smooth(&points);
        let t = Instant::now();
        let radius = spectral_radius(&a, None);
        let rho_ms = t.elapsed().as_secs_f64() * 1e3;
        let alpha = 0.9 / radius.upper;
        let reps = (20000 / n).clamp(3, 50);
        let mut cold = Vec::new();
        let mut rounds = 0;
        for tol in [1e-3, 1e-6] {
            let mut times = Vec::new();
            for _ in 0..reps {
                let mut s = KatzSvd::default();
                s.solve(&a, alpha, &radius, 16, 1e-1);
                s.forget();
                let t = Instant::now();
                let q = s.solve(&a, alpha, &radius, 16, tol);
                times.push(t.elapsed().as_secs_f64() * 1e3);
                rounds = q.rounds;
                assert!(q.converged);
            }
            times.sort_by(f64::total_cmp);
            cold.push((times[reps / 2], rounds));
        }
        let mut s = KatzSvd::default();
        s.solve(&a, alpha, &radius, 16, 1e-6);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let velocity: Vec<(f64, f64)> = (0..n).map(|_| { let t = rng.random::<f64>() * 6.283; (t.cos() * 0.004, t.sin() * 0.004) }).collect();
        let mut ticks = Vec::new();
        let mut rounds = 0;
        for _ in 0..reps.min(12) + 2 {
            for (p, v) in points.iter_mut().zip(&velocity) { p.0 += v.0; p.1 += v.1; }
            let a = smooth(&points);
            let t = Instant::now();
            let q = s.solve(&a, alpha * 0.98, &radius, 16, 1e-3);
            ticks.push(t.elapsed().as_secs_f64() * 1e3);
            rounds = q.rounds;
        }
        let mut last: Vec<f64> = ticks[2..].to_vec();
        last.sort_by(f64::total_cmp);
        println!("n {n} nnz/row {:.1} rho {rho_ms:.2} cold 1e-3 {:.2} ms ({} rounds) 1e-6 {:.2} ms ({}) tick {:.2} ms ({rounds})", a.edges() as f64 / n as f64, cold[0].0, cold[0].1, cold[1].0, cold[1].1, last[last.len() / 2]);
    }
}
