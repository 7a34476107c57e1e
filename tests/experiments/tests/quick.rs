//! What must hold even of a few seeds.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use std::process::Command;

use muster_experiments::formations::{Formation, Radio};
use muster_experiments::methods::{Method, Recipe};
use muster_experiments::scenario_one::{run, total};
use muster_experiments::seeds::held_out;

/// Few: differences of many percent need no more.
const SEEDS: usize = 4;

/// The mean share of robots in the right team over seeds and radios.
fn accuracy(formations: &[Formation], method: &Method) -> f64 {
    let runs = held_out(SEEDS).flat_map(|seed| Radio::ALL.map(|radio| (seed, radio)));
    let shares: Vec<f64> = runs
        .map(|(seed, radio)| total(&run(formations, method, radio, Some(seed)).unwrap()).share())
        .collect();
    shares.iter().sum::<f64>() / shares.len() as f64
}

#[test]
fn the_live_defaults_divide_better_than_every_baseline() {
    let formations = Formation::all().unwrap();
    let best = accuracy(&formations, &Method::Multimodal("muster", Box::new(Recipe::live())));
    assert!(best > 0.98, "{best}");
    let methods = Method::all();
    let baselines = methods.iter().filter(|method| !matches!(method, Method::Multimodal(..)));
    for baseline in baselines {
        let other = accuracy(&formations, baseline);
        assert!(best > other, "{}: {other}, muster: {best}", baseline.name());
    }
}

/// What the program writes into a folder when it is asked for few seeds.
fn written(what: &str) -> (String, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let program = env!("CARGO_BIN_EXE_muster-experiments");
    let out = folder.path().to_str().unwrap();
    let run = Command::new(program).args([what, "--quick", "--out", out]).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    (std::fs::read_to_string(folder.path().join("RESULTS.md")).unwrap(), folder)
}

#[test]
fn the_program_finds_the_papers_number_and_draws() {
    let (page, folder) = written("formations");
    assert!(page.contains("| GN (spatial) | 39.22 | 39.22 ± 0.00 | 39.22 ± 0.00 |"), "{page}");
    let plot = std::fs::read_to_string(folder.path().join("plots/accuracy.svg")).unwrap();
    assert!(plot.starts_with("<svg") && plot.contains("HOPE (concatenated)"));
    let numbers = std::fs::read_to_string(folder.path().join("results.csv")).unwrap();
    assert!(numbers.lines().count() > 1000, "every number of every seed");
}

#[test]
fn the_program_follows_fleets_that_move() {
    let (page, _) = written("moving");
    assert!(
        page.contains(
            "| no robot changes team at rest | 50 robots, rest, range | 0 changes, with "
        ),
        "{page}"
    );
    assert!(!page.contains("with a modality lost | 50 robots, march, range, spatial lost | NaN"));
}
