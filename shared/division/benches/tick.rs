//! One tick of a live fleet: robots have moved a little, and the division goes on from the last one, without rules, with
//! limits of size, and with pins.

#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark fails by panicking")]

use std::hint::black_box;
use std::sync::Arc;

use divan::Bencher;
use muster_division::division::{Job, divide};
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::rules::{Asked, TeamRules};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, RobotId};
use muster_model::settings::{ClustererSettings, TeamSize};
use muster_model::teams::Teams;
use muster_model::wish::{Wish, WishKind};

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

/// A number from 0 to 1 for each pair of numbers.
fn noise(a: usize, b: usize) -> f64 {
    let mixed = (a as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (b as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (mixed.wrapping_mul(0x94d0_49bb_1331_11eb) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Robots around as many places as there are teams, at a moment.
fn embedding(robots: usize, teams: usize, moment: usize) -> Embedding {
    let value = |robot: usize, at: usize| {
        let middle = f64::from(u8::from(robot * teams / robots == at % teams));
        middle + 0.5 * noise(robot, at) + 0.01 * noise(robot * DIMENSION + at, moment + 1)
    };
    let values = (0..robots).flat_map(|robot| (0..DIMENSION).map(move |at| value(robot, at)));
    Embedding {
        header: Header {
            fleet: FleetId::new("bench").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: Vec::new(),
        },
        roster: Revision::default(),
        graphs: Vec::new(),
        robots: (0..robots).map(|robot| RobotId::new(format!("r{robot:06}")).unwrap()).collect(),
        dimension: DIMENSION as u32,
        values: values.collect(),
        without_embedding: vec![false; robots],
        provisional: vec![false; robots],
        centrality: Vec::new(),
        quality: EmbeddingQuality {
            spectral_radius: (1.0, 1.0),
            alpha: 0.9,
            singular_values: vec![1.0; DIMENSION / 2],
            next_singular_value: 0.0,
            residual: 0.0,
            katz_residual: 0.0,
            gap: 1.0,
            ambiguous: false,
            mode: EmbeddingMode::Dense,
            teams_shown: None,
            team_scores: Vec::new(),
            stage_us: [0; 3],
        },
    }
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
        returning: None,
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
