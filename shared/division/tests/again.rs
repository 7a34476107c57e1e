//! The same vectors under the same rules are divided as they were, however often.

#![allow(clippy::unwrap_used, missing_docs, reason = "a test fails by panicking")]

mod vectors;

use std::sync::Arc;

use muster_division::division::{Job, divide};
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::rules::{Asked, TeamRules};
use muster_model::content::Checked;
use muster_model::id::TeamId;
use muster_model::settings::{ClustererSettings, TeamSize};
use muster_model::teams::Teams;
use muster_model::wish::{Wish, WishKind};
use vectors::{embedding, noise};

const DIMENSION: usize = 4;

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
        let values = (0..robots * DIMENSION).map(|at| noise(case, at)).collect();
        let embedding = embedding(DIMENSION, values);
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
