//! One tick of a live fleet: robots have moved a little, and the division goes on from the last one, without rules, with
//! limits of size, and with pins.

#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark fails by panicking")]

#[path = "../tests/vectors/mod.rs"]
mod vectors;

use std::collections::BTreeSet;
use std::hint::black_box;
use std::sync::Arc;

use divan::Bencher;
use muster_division::division::{Job, Staying, divide};
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::rules::{Asked, TeamRules};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::settings::{ClustererSettings, TeamSize};
use muster_model::teams::Teams;
use muster_model::wish::{Wish, WishKind};
use vectors::noise;

/// Length of a vector, as the embedder chooses it for some teams.
const DIMENSION: usize = 10;

fn main() {
    divan::main();
}

/// What divisions have to respect.
#[derive(Clone, Copy)]
enum Asks {
    Nothing,
    Sizes,
    Pins,
}

/// Robots around as many places as there are teams, at a moment.
fn embedding(robots: usize, teams: usize, moment: usize) -> Embedding {
    let value = |robot: usize, at: usize| {
        let middle = f64::from(u8::from(robot * teams / robots == at % teams));
        middle + 0.5 * noise(robot, at) + 0.01 * noise(robot * DIMENSION + at, moment + 1)
    };
    let values = (0..robots).flat_map(|robot| (0..DIMENSION).map(move |at| value(robot, at)));
    vectors::embedding(DIMENSION, values.collect())
}

/// The job of a moment.
fn job(robots: usize, teams: usize, moment: usize, asks: Asks, previous: Option<Teams>) -> Job {
    let mut settings = ClustererSettings::default();
    let mut wishes = Vec::new();
    if let Asks::Sizes = asks {
        let each = (robots / teams) as u32;
        settings.size = TeamSize { min: Some(each - 1), max: Some(each + each / 10) };
    }
    if let (Asks::Pins, Some(last)) = (asks, &previous) {
        for team in &last.teams {
            for member in team.members.iter().take(4) {
                let wish = Wish {
                    kind: WishKind::Pin,
                    robots: vec![member.robot.clone()],
                    team: Some(team.id.clone()),
                    expires: None,
                    note: None,
                };
                wishes.push(Asked { name: member.robot.to_string(), wish });
            }
        }
    }
    Job {
        embedding: Checked::new_unchecked(embedding(robots, teams, moment)),
        rules: TeamRules::of(&settings, wishes, Needs::default()).map(Arc::new),
        settings,
        teams: teams as u32,
        requested: teams as u32,
        same_number: true,
        staying: Staying::None,
        renewed: BTreeSet::new(),
        previous: previous.map(Checked::new_unchecked),
        memory: Arc::new(Memory::default()),
    }
}

fn tick(bencher: Bencher<'_, '_>, (robots, teams): (usize, usize), asks: Asks) {
    let last = divide(&job(robots, teams, 0, Asks::Nothing, None)).unwrap();
    let last = divide(&job(robots, teams, 0, asks, Some(last))).unwrap();
    let mut moment = 0;
    let next = || {
        moment += 1;
        job(robots, teams, moment, asks, Some(last.clone()))
    };
    bencher.with_inputs(next).bench_local_values(|job| black_box(divide(&job).unwrap()));
}

const SIZES: [(usize, usize); 3] = [(50, 5), (500, 5), (2000, 8)];

#[divan::bench(args = SIZES)]
fn without_rules(bencher: Bencher<'_, '_>, size: (usize, usize)) {
    tick(bencher, size, Asks::Nothing);
}

#[divan::bench(args = SIZES)]
fn with_sizes(bencher: Bencher<'_, '_>, size: (usize, usize)) {
    tick(bencher, size, Asks::Sizes);
}

#[divan::bench(args = SIZES)]
fn with_pins(bencher: Bencher<'_, '_>, size: (usize, usize)) {
    tick(bencher, size, Asks::Pins);
}
