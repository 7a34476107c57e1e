//! What the kinds of spatial graphs cost, and how much they change when robots move a little: edges,
//! milliseconds, and changes of weights, for 1,000 to 100,000 robots that wander about, and for as many
//! in crowds.
//!
//! `cargo run --release -p muster-relation --example edges`

#![allow(clippy::unwrap_used, reason = "an example may end where it has nothing to say")]

use std::collections::BTreeMap;
use std::sync::LazyLock;
use std::time::Instant;

use muster_model::settings::{IngestSettings, SpatialKernel, SpatialScale, SpatialSettings};
use muster_relation::{Edge, median_nearest_neighbour_distance, spatial_edges};
use muster_scenario::{Fleet, FleetOptions, ScenarioKind};

const SIZES: [usize; 3] = [1000, 10_000, 100_000];

/// How far robots move, in median distances to the nearest neighbour.
const MOTION: f64 = 0.01;

/// Robots that each kind of graph is made for in all.
const WORK: usize = 100_000;

fn positions(kind: ScenarioKind, robots: usize) -> Vec<[f64; 3]> {
    let options = FleetOptions { robots, teams: robots / 100, noise_m: 0.0, ..Default::default() };
    let fleet = Fleet::new(kind, options).unwrap();
    fleet.poses(7.0).iter().map(|pose| [pose.x, pose.y, 0.0]).collect()
}

/// Seconds that this thread has computed, which others on the machine do not lengthen; of the clock where
/// the system does not report it.
fn seconds() -> f64 {
    static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = stat.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| BEGIN.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

/// The sum and the largest of the changes of weights, the former relative to the sum of the weights.
fn change(before: &[Edge], after: &[Edge]) -> (f64, f64) {
    let mut weights: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    before.iter().for_each(|&(i, j, weight)| *weights.entry((i, j)).or_default() += weight);
    after.iter().for_each(|&(i, j, weight)| *weights.entry((i, j)).or_default() -= weight);
    let all: f64 = before.iter().map(|edge| edge.2).sum();
    let changes = weights.values().map(|change| change.abs());
    (changes.clone().sum::<f64>() / all, changes.fold(0.0, f64::max))
}

fn main() {
    let default = IngestSettings::default().spatial;
    let compact = |cutoff: f64| SpatialSettings {
        kernel: SpatialKernel::WendlandC2,
        cutoff,
        ..default.clone()
    };
    let kinds = [
        ("gaussian by robots, 16 nearest", default.clone()),
        (
            "gaussian by fleet, 16 nearest",
            SpatialSettings { scale: SpatialScale::Fleet, width: 2.0, ..default.clone() },
        ),
        ("wendland-c2, cutoff 5", compact(5.0)),
        ("wendland-c2, cutoff 9", compact(9.0)),
        ("the same, 8 neighbours", SpatialSettings { neighbours: 8, ..compact(9.0) }),
    ];
    for kind in [ScenarioKind::Random, ScenarioKind::Clusters] {
        for robots in SIZES {
            let fleet = positions(kind, robots);
            let step = MOTION * median_nearest_neighbour_distance(&fleet).unwrap();
            let moved = |(robot, point): (usize, &[f64; 3])| {
                let (sin, cos) = (robot as f64 * 2.399_963).sin_cos();
                [point[0] + step * cos, point[1] + step * sin, 0.0]
            };
            let moved: Vec<[f64; 3]> = fleet.iter().enumerate().map(moved).collect();
            println!("{robots} robots, {kind}");
            for (name, settings) in &kinds {
                // As many as take long enough for a clock of milliseconds.
                let repeats = (WORK / robots).max(1);
                let begin = seconds();
                let mut edges = Vec::new();
                for _ in 0..repeats {
                    edges = spatial_edges(&fleet, settings);
                }
                let milliseconds = (seconds() - begin) * 1e3 / repeats as f64;
                let (total, largest) = change(&edges, &spatial_edges(&moved, settings));
                println!(
                    "  {name:24}{:>10.1} edges each{milliseconds:>10.1} ms; all moved by {MOTION}: weights \
                     {:.2} %, the largest change {largest:.3}",
                    edges.len() as f64 / robots as f64,
                    100.0 * total,
                );
            }
        }
    }
}
