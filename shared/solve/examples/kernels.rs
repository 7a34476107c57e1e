//! Which spatial kernel divides better: the adjusted Rand index (Hubert and Arabie, Journal of
//! Classification 2, 1985) between the teams that are found and the true ones, on fleets of all
//! scenarios. 1 is the truth, 0 what chance finds.
//!
//! `cargo run --release -p muster-solve --example kernels -- 20` takes 20 seeds of each fleet; with a
//! number of robots behind it, only fleets of that size. The column `±` is the standard error of the mean
//! difference to the default, fleet by fleet.

#![allow(clippy::unwrap_used, reason = "an example may end where it has nothing to show")]

use muster_numeric::agreement::adjusted_rand_index;
use muster_scenario::{Fleet, FleetOptions, ScenarioKind};
use muster_solve::{Options, Solved};
use serde_json::{Map, Value, json};

/// Robots and teams of the fleets; the last are larger than what is related in all pairs.
const SIZES: [(usize, usize); 4] = [(18, 2), (54, 3), (120, 5), (300, 6)];

/// Noise of positions in metres: that of a good receiver, and that of a poor one, which is a third of the
/// distance between neighbours.
const NOISES_M: [f64; 2] = [0.15, 2.0];

/// When the platoons of a crossing march together, and when they are apart.
const MOMENTS_S: [f64; 2] = [5.0, 30.0];

/// Names and settings of the kernels; the first is the default.
fn kernels() -> Vec<(String, Value)> {
    let mut kernels = vec![
        ("gaussian 0.7 by robots".to_owned(), json!({})),
        ("gaussian 2 by fleet".to_owned(), json!({"scale": "fleet", "width": 2.0})),
        (
            "exponential 2 by fleet".to_owned(),
            json!({"kernel": "exponential", "scale": "fleet", "width": 2.0}),
        ),
    ];
    for cutoff in [3.0, 5.0, 7.0, 9.0, 12.0] {
        let settings = json!({"kernel": "wendland-c2", "cutoff": cutoff});
        kernels.push((format!("wendland-c2 {cutoff}"), settings));
    }
    let fewer = json!({"kernel": "wendland-c2", "neighbours": 8});
    kernels.push(("wendland-c2 9, 8 neighbours".to_owned(), fewer));
    kernels
}

/// The file of a fleet at a moment, from positions alone or from everything that it observes.
fn file(fleet: &Fleet, teams: usize, t_seconds: f64, is_whole: bool, spatial: &Value) -> String {
    let names: Vec<String> = fleet.robots().iter().map(ToString::to_string).collect();
    let by_name = |values: Vec<Value>| -> Value {
        Value::Object(names.iter().cloned().zip(values).collect::<Map<_, _>>())
    };
    let pose = |pose: &muster_model::observation::Pose| json!({"x": pose.x, "y": pose.y});
    let poses = by_name(fleet.poses(t_seconds).iter().map(pose).collect());
    let mut file = json!({
        "robots": names, "poses": poses, "spatial": spatial, "teams": teams,
        "restarts": 10,
    });
    if is_whole {
        let links = fleet.links(t_seconds);
        let ranks = fleet.ranks(t_seconds);
        let links = links.iter().map(|links| json!(links.links)).collect();
        let ranks = ranks.iter().map(|rank| json!({"superior": rank.superior})).collect();
        file["links"] = by_name(links);
        file["ranks"] = by_name(ranks);
    }
    file.to_string()
}

/// Mean and standard error.
fn mean(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0) / count).sqrt())
}

fn main() {
    let seeds: u64 = std::env::args().nth(1).map_or(5, |seeds| seeds.parse().unwrap());
    let only: Option<usize> = std::env::args().nth(2).map(|robots| robots.parse().unwrap());
    let kernels = kernels();
    let mut all: Vec<Vec<f64>> = vec![Vec::new(); kernels.len()];
    for is_whole in [false, true] {
        for kind in ScenarioKind::ALL {
            for (robots, teams) in SIZES {
                if only.is_some_and(|only| only != robots) {
                    continue;
                }
                let mut scores: Vec<Vec<f64>> = vec![Vec::new(); kernels.len()];
                for noise_m in NOISES_M {
                    for seed in 1..=seeds {
                        let options =
                            FleetOptions { robots, teams, seed, noise_m, ..Default::default() };
                        let fleet = Fleet::new(kind, options).unwrap();
                        for t in MOMENTS_S {
                            let truth = fleet.truth(t);
                            for ((_, spatial), scores) in kernels.iter().zip(&mut scores) {
                                let text = file(&fleet, teams, t, is_whole, spatial);
                                let solved =
                                    Solved::new(text.as_bytes(), Options::default()).unwrap();
                                let labels = solved.labels().iter().copied();
                                let both = labels.zip(truth.iter().copied());
                                scores.push(adjusted_rand_index(both));
                            }
                        }
                    }
                }
                let inputs = if is_whole { "everything" } else { "positions" };
                print(
                    &format!("{inputs}, {kind}, {robots} robots, {teams} teams"),
                    &kernels,
                    &scores,
                );
                for (all, scores) in all.iter_mut().zip(&scores) {
                    all.extend(scores);
                }
            }
        }
    }
    print("all", &kernels, &all);
}

/// Prints the mean of each kernel, and of its difference to the first one.
fn print(title: &str, kernels: &[(String, Value)], scores: &[Vec<f64>]) {
    println!("{title}");
    for ((name, _), own) in kernels.iter().zip(scores) {
        let differences: Vec<f64> =
            own.iter().zip(&scores[0]).map(|(own, first)| own - first).collect();
        let ((score, _), (difference, error)) = (mean(own), mean(&differences));
        println!("  {name:28}{score:>8.3}{difference:>+9.3} ± {error:.3}");
    }
}
