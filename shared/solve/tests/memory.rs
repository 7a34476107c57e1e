//! The memory that is estimated is the memory that is held.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use muster_solve::{Estimate, Options, PathChoice, Solved, Step};
use peak_alloc::PeakAlloc;
use serde_json::{Value, json};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// What an estimate may be above what is held, in MiB: the program itself, of which the allocator knows
/// nothing.
const PROGRAM_MIB: f64 = 16.0;

fn names(robots: usize) -> Vec<String> {
    (0..robots).map(|robot| format!("r{robot}")).collect()
}

/// Robots on a grid, related to their neighbours or to all.
fn dense_file(robots: usize, is_complete: bool) -> Value {
    let columns = robots.isqrt();
    let weight = |i: usize, j: usize| {
        let [x, y] = [(i % columns).abs_diff(j % columns), (i / columns).abs_diff(j / columns)];
        let near = i != j && (is_complete || x + y == 1);
        if near { 1.0 / (x + y) as f64 } else { 0.0 }
    };
    let matrix: Vec<Vec<f64>> =
        (0..robots).map(|i| (0..robots).map(|j| weight(i, j)).collect()).collect();
    json!({"robots": names(robots), "teams": 4, "restarts": 4, "emit": ["katz"],
           "modalities": [{"name": "near", "matrix": matrix}]})
}

/// Robots on a grid, each related to those around it, one way more than the other.
fn sparse_file(robots: usize, dimension: usize) -> Value {
    let names = names(robots);
    let columns = robots.isqrt();
    let steps = [1, 2, columns - 1, columns, columns + 1, 2 * columns];
    let edges = (0..robots).flat_map(|i| {
        let names = &names;
        steps.into_iter().filter(move |step| i + step < robots).flat_map(move |step| {
            let weight = 1.0 / (1 + (i * 7 + step) % 5) as f64;
            [json!([names[i], names[i + step], weight]), json!([names[i + step], names[i], 1.0])]
        })
    });
    json!({"robots": names, "teams": 4, "restarts": 4, "dimension": dimension,
           "modalities": [{"name": "near", "edges": edges.collect::<Vec<_>>()}]})
}

/// The same with three graphs, of which each may contradict the others.
fn doubtful_file(robots: usize, dimension: usize) -> Value {
    let mut file = sparse_file(robots, dimension);
    let near = file["modalities"][0].clone();
    let named = |name: &str| {
        let mut graph = near.clone();
        graph["name"] = json!(name);
        graph
    };
    file["modalities"] = json!(["near", "radio", "orders"].map(named));
    file
}

/// Solves a file and compares what each step holds with what was estimated.
fn check(what: &str, text: &str, options: Options) {
    let estimate = Estimate::new(text.as_bytes(), options).unwrap();
    let estimate: Value = serde_json::from_str(&estimate.to_json().unwrap()).unwrap();
    let outside = ALLOCATOR.current_usage_as_mb();
    let mut held: Vec<(String, f64)> = Vec::new();
    let mut close = |step: Option<Step>| {
        if let Some(last) = held.last_mut() {
            last.1 = f64::from(ALLOCATOR.peak_usage_as_mb() - outside);
        }
        if let Some(step) = step {
            held.push((step.to_string(), 0.0));
        }
        ALLOCATOR.reset_peak_usage();
    };
    let mut watch = |step| match step {
        Step::KMeans { done: 1.., .. } | Step::Search { round: 1.., .. } => {}
        step => close(Some(step)),
    };
    Solved::watched(text.as_bytes(), options, &mut watch).unwrap();
    close(None);
    let steps = estimate["steps"].as_array().unwrap();
    assert_eq!(steps.len(), held.len());
    for (step, (name, held)) in steps.iter().zip(&held) {
        assert_eq!(&step["step"], name);
        let estimated = step["mib"].as_f64().unwrap();
        println!("{what}, {name}: {held:.1} MiB held, {estimated} estimated");
        assert!(*held <= estimated, "{what}, {name}: {held} MiB, {estimated} estimated");
        // What an elimination fills in is not known before.
        let times = if *name == Step::SpectralRadius.to_string() { 6.0 } else { 2.0 };
        let most = PROGRAM_MIB + 1.0 + times * held;
        assert!(estimated <= most, "{what}, {name}: {held} MiB, {estimated} estimated");
    }
    let peak = estimate["peak_mib"].as_f64().unwrap();
    let most = held.iter().fold(0.0_f64, |most, (_, held)| held.max(most));
    assert!((most..PROGRAM_MIB + 1.0 + 1.5 * most).contains(&peak), "{most} MiB, {peak} estimated");
}

#[test]
fn no_step_holds_more_than_estimated_nor_far_less() {
    for (robots, is_complete) in [(400, false), (400, true), (600, false)] {
        let what = format!("{robots} robots {is_complete}");
        check(&what, &dense_file(robots, is_complete).to_string(), Options::default());
    }
    check("700 robots of three modalities", &doubtful_file(700, 8).to_string(), Options::default());
    let options = Options { path: PathChoice::InverseFree, ..Options::default() };
    for (robots, dimension) in [(5000, 8), (20_000, 16)] {
        let what = format!("{robots} robots of dimension {dimension}");
        check(&what, &sparse_file(robots, dimension).to_string(), options);
    }
    check("8000 robots of three modalities", &doubtful_file(8000, 8).to_string(), options);
}
