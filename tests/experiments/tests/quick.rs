//! What must hold even of a few seeds.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use muster_experiments::formations::{Formation, Radio};
use muster_experiments::methods::{Method, Recipe};
use muster_experiments::scenario_one::{run, total};
use muster_experiments::seeds::judging;

/// Few: differences of many percent need no more.
const SEEDS: usize = 4;

/// The mean share of robots in the right team over seeds and radios.
fn accuracy(formations: &[Formation], method: &Method) -> f64 {
    let runs = judging(SEEDS).flat_map(|seed| Radio::ALL.map(|radio| (seed, radio)));
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
