//! Times of the bounds of the spectral radius, on fleets of squads.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::time::Instant;

use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::RadiusTracker;
use muster_numeric::spectral_radius::spectral_radius;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn interleave(x: f64, y: f64, side: f64) -> u64 {
    let (x, y) = ((x / side * 65535.0) as u64, (y / side * 65535.0) as u64);
    (0..16).map(|b| ((x >> b & 1) << (2 * b)) | ((y >> b & 1) << (2 * b + 1))).sum()
}

/// How far robots move from one frame to the next, relative to their mean spacing.
const MOTION: f64 = 0.004;

/// Squads of eight at unit density, along a Morton curve.
fn fleet(n: usize, seed: u64) -> Vec<(f64, f64)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let side = (n as f64).sqrt();
    let centres: Vec<(f64, f64)> = (0..n.div_ceil(8))
        .map(|_| (rng.random::<f64>() * side, rng.random::<f64>() * side))
        .collect();
    let mut near = || 1.5 * (rng.random::<f64>() + rng.random::<f64>() - 1.0);
    let mut points: Vec<_> =
        (0..n).map(|i| (centres[i / 8].0 + near(), centres[i / 8].1 + near())).collect();
    points.sort_by_key(|p| interleave(p.0.max(0.0), p.1.max(0.0), side));
    points
}

/// A radius kernel that vanishes smoothly, and an 8-ary tree.
fn smooth(points: &[(f64, f64)]) -> SparseMatrix {
    let radius = 1.8;
    let cell = |p: &(f64, f64)| ((p.0 / radius).floor() as i64, (p.1 / radius).floor() as i64);
    let mut cells = std::collections::HashMap::<(i64, i64), Vec<usize>>::new();
    for (i, p) in points.iter().enumerate() {
        cells.entry(cell(p)).or_default().push(i);
    }
    let mut edges = Vec::new();
    for (i, p) in points.iter().enumerate() {
        let (cx, cy) = cell(p);
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (cx + dx, cy + dy)));
        for &j in around.filter_map(|c| cells.get(&c)).flatten().filter(|j| **j != i) {
            let q = points[j];
            let d2 = ((p.0 - q.0).powi(2) + (p.1 - q.1).powi(2)) / (radius * radius);
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

/// Random links: no place is denser than another.
fn random(n: usize, degree: usize) -> SparseMatrix {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut edge = || (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>());
    SparseMatrix::from_triplets(n, (0..degree * n).map(|_| edge())).unwrap()
}

/// Fastest and median.
fn summary(mut times: Vec<f64>) -> String {
    times.sort_by(f64::total_cmp);
    format!("{:.3}–{:.3} ms", times[0], times[times.len() / 2])
}

fn measure(name: &str, n: usize, a: &SparseMatrix, moved: &SparseMatrix) {
    let reps = (300_000 / n).clamp(5, 300);
    let exact = spectral_radius(a, None);
    let fastest = (0..if n > 5000 { 1 } else { 7 }).map(|_| {
        let t = Instant::now();
        std::hint::black_box(spectral_radius(a, None));
        t.elapsed().as_secs_f64() * 1e3
    });
    let exact_ms = fastest.fold(f64::INFINITY, f64::min);
    let (mut cold, mut warm, mut solve) = (Vec::new(), Vec::new(), Vec::new());
    let mut tracker = RadiusTracker::default();
    let ms = |t: Instant| t.elapsed().as_secs_f64() * 1e3;
    let (mut first, mut second) = (None, None);
    let mut centrality = None;
    for _ in 0..reps {
        let t = Instant::now();
        tracker = RadiusTracker::default();
        let bound = tracker.bound(a);
        cold.push(ms(t));
        first = Some(bound);
        let t = Instant::now();
        second = Some(tracker.bound(moved));
        warm.push(ms(t));
        let t = Instant::now();
        centrality =
            Some(tracker.solve_centrality(a, 0.5 / bound.upper, &bound, 1e-6).unwrap().sweeps);
        solve.push(ms(t));
    }
    let (first, second) = (first.unwrap(), second.unwrap());
    let narrow: Vec<_> = [1e-2, 1e-3, 1e-6]
        .iter()
        .map(|width| {
            let t = Instant::now();
            let bound = tracker.refine(a, *width).unwrap();
            format!("{:.1e} {} sweeps {:.2} ms", bound.relative_width(), bound.sweeps, ms(t))
        })
        .collect();
    println!(
        "{name} n {n} degree {:.1}: exact {exact_ms:.2} ms ({:.1e}); cold {}, {} sweeps, \
         {:+.2} % {:+.2} %; warm {}, {} sweeps; centrality {}, {centrality:?} sweeps; \
         refined {narrow:?}",
        a.edges() as f64 / n as f64,
        (exact.upper - exact.lower) / exact.upper,
        summary(cold),
        first.sweeps,
        100.0 * (first.upper / exact.upper - 1.0),
        100.0 * (first.lower / exact.upper - 1.0),
        summary(warm),
        second.sweeps,
        summary(solve),
    );
}

fn main() {
    let sizes = std::env::args().nth(1).unwrap_or_else(|| "1000,10000,100000".into());
    for n in sizes.split(',').map(|n| n.parse().unwrap()) {
        let mut points = fleet(n, 1);
        let a = smooth(&points);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for p in &mut points {
            let angle = rng.random::<f64>() * std::f64::consts::TAU;
            *p = (p.0 + MOTION * angle.cos(), p.1 + MOTION * angle.sin());
        }
        measure("smooth", n, &a, &smooth(&points));
        let a = random(n, 8);
        measure("random", n, &a, &a);
    }
}
