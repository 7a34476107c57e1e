//! How good the estimate of `muster solve --estimate` is: for fleets of the sizes that are given, what
//! was estimated and what it took, step by step.
//!
//! `cargo run --release -p muster-solve --example estimate -- 500 1000 2000`

#![allow(clippy::unwrap_used, reason = "an example may end where it has nothing to show")]

use std::time::Instant;

use muster_scenario::{Fleet, FleetOptions, ScenarioKind};
use muster_solve::{Estimate, Options, Solved, Step};
use serde_json::{Map, Value, json};

/// The observations of a fleet of groups.
fn file(robots: usize) -> String {
    let options = FleetOptions { robots, teams: 5, ..FleetOptions::default() };
    let fleet = Fleet::new(ScenarioKind::Clusters, options).unwrap();
    let names: Vec<String> = fleet.robots().iter().map(ToString::to_string).collect();
    let by_name = |values: Vec<Value>| -> Value {
        Value::Object(names.iter().cloned().zip(values).collect::<Map<_, _>>())
    };
    let poses = fleet.poses(0.0).iter().map(|pose| json!({"x": pose.x, "y": pose.y})).collect();
    let ranks = fleet.ranks(0.0).iter().map(|rank| json!({"superior": rank.superior})).collect();
    json!({"robots": names, "poses": by_name(poses), "ranks": by_name(ranks), "teams": 5})
        .to_string()
}

/// The most memory that this process ever held, in MiB.
fn peak_mib() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? >> 10)
}

fn main() {
    for robots in std::env::args().skip(1) {
        let text = file(robots.parse().unwrap());
        let begin = Instant::now();
        let estimate = Estimate::new(text.as_bytes(), Options::default()).unwrap();
        let estimated = begin.elapsed();
        print!("{}", estimate.summary());
        let begin = Instant::now();
        let mut steps: Vec<(Step, Instant)> = Vec::new();
        let mut watch = |step| match step {
            Step::KMeans { done: 1.., .. } => {}
            step => steps.push((step, Instant::now())),
        };
        let solved = Solved::watched(text.as_bytes(), Options::default(), &mut watch).unwrap();
        let ends = steps.iter().skip(1).map(|step| step.1).chain([Instant::now()]);
        for ((step, begin), end) in steps.iter().zip(ends) {
            println!("  took: {:30}{:>10.3} s", step.to_string(), (end - *begin).as_secs_f64());
        }
        println!(
            "took {:.2} s and at most {} MiB so far; the estimate {:.0} ms; {} labels\n",
            begin.elapsed().as_secs_f64(),
            peak_mib().unwrap_or_default(),
            estimated.as_secs_f64() * 1e3,
            solved.labels().len(),
        );
    }
}
