//! How long scenes take: `cargo bench --package muster-foxglove --no-default-features
//! --features messages`. The goal is 20 ms for one turn of 10,000 robots.

#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark fails by panicking")]

use std::collections::BTreeSet;
use std::sync::Arc;

use divan::Bencher;
use muster_foxglove::messages::bytes;
use muster_foxglove::{Access, Bridge, Input, Output, Topic};
use muster_model::id::{FleetId, Modality};
use muster_model::time::Tick;

#[path = "../tests/fleet/mod.rs"]
mod fleet;

const ROBOTS: u32 = 10_000;
const TEAMS: u32 = 50;

fn main() {
    divan::main();
}

/// One turn of everything: the scenes of a new roster, and their bytes.
#[divan::bench(sample_count = 50)]
fn turn_of_10_000_robots(bencher: Bencher<'_, '_>) {
    let mut bridge = Bridge::new(FleetId::new("grid").unwrap(), Access::ReadOnly);
    let now = |turn: u64| Tick(1_000_000_000 + turn * 100_000);
    bridge.handle(now(0), Input::Link(true));
    bridge.handle(now(0), Input::Teams(fleet::teams(ROBOTS, TEAMS), None));
    let all = [Topic::Transforms, Topic::Teams, Topic::Links(Modality::spatial())];
    bridge.handle(now(0), Input::Watched(BTreeSet::from(all)));
    bridge.handle(now(0), Input::Graph(fleet::graph(ROBOTS, 1)));
    let mut turn = 0;
    bencher
        .with_inputs(|| {
            turn += 1;
            (turn, Arc::new(fleet::roster(ROBOTS, turn)))
        })
        .bench_local_values(|(turn, roster)| {
            bridge.handle(now(turn), Input::Roster(roster, None));
            let outputs = bridge.handle(now(turn), Input::Tick);
            let sent = outputs.into_iter().filter_map(|output| match output {
                Output::Send(_, message) => bytes(message, now(turn)),
                _ => None,
            });
            let sizes: Vec<usize> = sent.map(|bytes| bytes.len()).collect();
            assert_eq!(sizes.len(), 3);
            sizes
        });
}
