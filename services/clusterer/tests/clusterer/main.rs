//! The clusterer on a bench: what it divides, what it publishes, and when.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    missing_docs,
    unreachable_pub,
    reason = "this is a test, and so are its helpers"
)]

mod absence;
mod common;
mod division;
mod dwell;
mod gets;
mod identity;
mod kept;
mod limits;
mod needs;
mod properties;
mod publishing;
mod recovery;
mod solve;
mod standing;
mod wishes;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use common::{
    Bench, START, again, changes_in_short, embedding, from_rows, header, leaders, robot, roster,
    short,
};
use muster_clusterer::Clusterer;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::event::EventKind;
use muster_model::header::Revision;
use muster_model::id::{RobotId, ServiceName, SkillId, TeamId};
use muster_model::settings::{ClustererSettings, TeamCount};
use muster_model::teams::{RobotTeam, Teams};
use muster_service::{Core, Input, ServedKey, Stored};
use muster_wire::{Key, Message, Pattern};
use proptest::prelude::*;

const WEST: [f64; 2] = [0.0, 0.0];
const EAST: [f64; 2] = [1.0, 0.0];
const NORTH: [f64; 2] = [0.0, 1.0];

fn teams(teams: u32) -> ClustererSettings {
    let teams = TeamCount::Fixed(teams);
    ClustererSettings { teams, restarts: 10, dwell_s: 0.0, ..ClustererSettings::default() }
}

fn mirrored(teams: &Checked<Teams>) -> Message {
    Message::Teams { teams: teams.clone(), mirror: false }
}

/// A bench that has divided one embedding.
fn divided(settings: ClustererSettings, first: &Checked<Embedding>) -> (Bench, Checked<Teams>) {
    let mut bench = Bench::leading(settings);
    bench.receive_embedding(first);
    let division = bench.division();
    (bench, division)
}
