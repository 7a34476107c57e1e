//! The same vectors under the same rules are divided as they were, however often.

#![allow(clippy::unwrap_used, missing_docs, reason = "a test fails by panicking")]

mod vectors;

use std::collections::BTreeSet;
use std::sync::Arc;

use muster_division::division::{Job, Staying, divide};
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

/// Some robots, a number of teams, and what is asked of them.
struct Fleet {
    case: usize,
    robots: usize,
    teams: usize,
    settings: ClustererSettings,
}

impl Fleet {
    fn new(case: usize) -> Self {
        let (robots, teams) = (4 + case % 5, 2 + case % 3);
        let mut settings = ClustererSettings::default();
        if case.is_multiple_of(2) {
            settings.size = TeamSize { min: Some(1), max: Some((robots / teams + 1) as u32) };
        }
        Self { case, robots, teams, settings }
    }

    /// The division of the vectors of a moment, from the last one.
    fn divided(&self, moment: usize, previous: Option<&Teams>) -> Teams {
        let value = |at| noise(self.case, at + moment * self.robots * DIMENSION);
        let embedding = embedding(DIMENSION, (0..self.robots * DIMENSION).map(value).collect());
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
        let rules = TeamRules::of(&self.settings, wishes, Needs::default()).map(Arc::new);
        let job = Job {
            embedding: Checked::new_unchecked(embedding),
            settings: self.settings.clone(),
            rules,
            teams: self.teams as u32,
            requested: self.teams as u32,
            same_number: true,
            staying: Staying::None,
            renewed: BTreeSet::new(),
            previous: previous.cloned().map(Checked::new_unchecked),
            memory: Arc::new(Memory::default()),
        };
        divide(&job).unwrap()
    }
}

/// Robots have moved since the last division, and have stood since: a restart then changes nothing.
#[test]
fn what_has_changed_is_divided_once() {
    let mut failed = Vec::new();
    for case in 0..2000 {
        let fleet = Fleet::new(case);
        let first = fleet.divided(0, None);
        let second = fleet.divided(1, Some(&first));
        let third = fleet.divided(1, Some(&second));
        if short(&third) != short(&second) {
            let [first, second, third] = [&first, &second, &third].map(short);
            failed.push(format!("{case}: {first} => {second} => {third}"));
        }
    }
    assert!(failed.is_empty(), "{} of 2000: {:#?}", failed.len(), &failed[..failed.len().min(8)]);
}

#[test]
fn the_same_again_is_divided_as_it_was() {
    let mut failed = Vec::new();
    for case in 0..400 {
        let fleet = Fleet::new(case);
        // The first one names the teams, so that wishes count from the second one on.
        let first = fleet.divided(0, None);
        let second = fleet.divided(0, Some(&first));
        let third = fleet.divided(0, Some(&second));
        let fourth = fleet.divided(0, Some(&third));
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
