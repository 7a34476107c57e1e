//! The same vectors under the same rules are divided as they were, however often.

#![allow(clippy::unwrap_used, missing_docs, reason = "a test fails by panicking")]

use std::sync::Arc;

use muster_division::division::{Job, divide};
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::rules::{Asked, TeamRules};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, RobotId, TeamId};
use muster_model::settings::{ClustererSettings, TeamSize};
use muster_model::teams::Teams;
use muster_model::wish::{Wish, WishKind};

const DIMENSION: usize = 4;

/// A number from 0 to 1 for each pair of numbers.
fn noise(a: usize, b: usize) -> f64 {
    let mixed = (a as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (b as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (mixed.wrapping_mul(0x94d0_49bb_1331_11eb) >> 11) as f64 / (1_u64 << 53) as f64
}

fn embedding(robots: usize, case: usize) -> Embedding {
    let values = (0..robots * DIMENSION).map(|at| noise(case, at));
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

fn short(teams: &Teams) -> String {
    let team = |team: &muster_model::teams::Team| {
        let members: Vec<&str> = team.members.iter().map(|member| member.robot.as_str()).collect();
        format!("{}: {}", team.id, members.join(" "))
    };
    teams.teams.iter().map(team).collect::<Vec<_>>().join(" | ")
}

#[test]
fn the_same_again_is_divided_as_it_was() {
    let mut failed = Vec::new();
    for case in 0..400 {
        let robots = 4 + case % 5;
        let teams = 2 + case % 3;
        let mut settings = ClustererSettings::default();
        if case % 2 == 0 {
            settings.size = TeamSize { min: Some(1), max: Some((robots / teams + 1) as u32) };
        }
        let embedding = embedding(robots, case);
        let wish = |kind, robot: usize, team: u64| Asked {
            name: format!("alice/{robot}-{team}"),
            wish: Wish {
                kind,
                robots: vec![embedding.robots[robot].clone()],
                team: Some(TeamId::numbered(team)),
                expires: None,
                note: None,
            },
        };
        let wishes = vec![wish(WishKind::Pin, 0, 2), wish(WishKind::Ban, 1, 1)];
        let rules = TeamRules::of(&settings, wishes, Needs::default()).map(Arc::new);
        let next = |previous: Option<Teams>| {
            let job = Job {
                embedding: Checked::new_unchecked(embedding.clone()),
                settings: settings.clone(),
                rules: rules.clone(),
                teams: teams as u32,
                requested: teams as u32,
                same_number: true,
                returning: None,
                previous: previous.map(Checked::new_unchecked),
                memory: Arc::new(Memory::default()),
            };
            divide(&job).unwrap()
        };
        // The first one names the teams, so that wishes count from the second one on.
        let first = next(None);
        let second = next(Some(first.clone()));
        let third = next(Some(second.clone()));
        let fourth = next(Some(third.clone()));
        if short(&fourth) != short(&third) || short(&third) != short(&second) {
            failed.push(format!(
                "{case}: {} => {} => {} => {}",
                short(&first),
                short(&second),
                short(&third),
                short(&fourth)
            ));
        }
    }
    assert!(failed.is_empty(), "{} of 400: {:#?}", failed.len(), &failed[..failed.len().min(8)]);
}
