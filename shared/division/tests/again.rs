//! The same vectors under the same rules are divided as they were, however often.

#![allow(clippy::unwrap_used, missing_docs, reason = "a test fails by panicking")]

mod vectors;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_division::division::{Job, Staying, divide, with_held};
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::rules::{Asked, TeamRules};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, SkillId, TeamId};
use muster_model::roster::{Roster, RosterEntry};
use muster_model::settings::{ClustererSettings, Need, SkillCount, TeamSize};
use muster_model::teams::{Limited, Teams};
use muster_model::time::Tick;
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

fn wish(kind: WishKind, robots: &[&RobotId], team: Option<u64>) -> Asked {
    let names: Vec<&str> = robots.iter().map(|robot| robot.as_str()).collect();
    Asked {
        name: format!("alice/{kind:?}-{}-{team:?}", names.join("-")),
        wish: Wish {
            kind,
            robots: robots.iter().copied().cloned().collect(),
            team: team.map(TeamId::numbered),
            expires: None,
            note: None,
        },
    }
}

/// What is asked of the robots of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asking {
    /// Two wishes that are the same all the time.
    Same,
    /// Anything, and something else in every moment: also what nothing satisfies.
    Anything,
}

/// Some robots, a number of teams, and what is asked of them.
struct Fleet {
    case: usize,
    robots: usize,
    teams: usize,
    settings: ClustererSettings,
    asking: Asking,
}

impl Fleet {
    fn new(case: usize, asking: Asking) -> Self {
        let (robots, teams) = (4 + case % 5, 2 + case % 3);
        let mut settings = ClustererSettings::default();
        if case.is_multiple_of(2) {
            settings.size = TeamSize { min: Some(1), max: Some((robots / teams + 1) as u32) };
        }
        Self { case, robots, teams, settings, asking }
    }

    /// The division of the vectors of a moment, from the last one.
    fn divided(&self, moment: usize, previous: Option<&Teams>) -> Teams {
        self.divided_knowing(moment, previous, Memory::default())
    }

    /// The same with what is remembered of teams before.
    fn divided_knowing(&self, moment: usize, previous: Option<&Teams>, memory: Memory) -> Teams {
        divide(&self.job(moment, previous, memory)).unwrap()
    }

    /// What is to be divided in a moment.
    fn job(&self, moment: usize, previous: Option<&Teams>, memory: Memory) -> Job {
        let value = |at| noise(self.case, at + moment * self.robots * DIMENSION);
        let mut embedding = embedding(DIMENSION, (0..self.robots * DIMENSION).map(value).collect());
        let (mut settings, mut wishes) = (self.settings.clone(), Vec::new());
        let (mut teams, mut staying) = (self.teams, Staying::None);
        if self.asking == Asking::Anything {
            wishes.extend(self.wishes(moment, &embedding.robots));
            settings.needs = self.needs(moment);
            teams = 2 + self.draw(moment, 91, 3);
            if self.draw(moment, 92, 3) == 0 {
                staying = Staying::KeepingTeams;
            }
            for robot in 0..self.draw(moment, 93, 3) {
                let robot = self.draw(moment, 94 + robot, self.robots);
                embedding.without_embedding[robot] = true;
                embedding.values[robot * DIMENSION..(robot + 1) * DIMENSION].fill(0.0);
            }
        } else {
            wishes.push(wish(WishKind::Pin, &[&embedding.robots[0]], Some(2)));
            wishes.push(wish(WishKind::Ban, &[&embedding.robots[1]], Some(1)));
        }
        let needs = Needs::of(&settings, Some(&roster(&embedding)), previous);
        let memory = Arc::new(memory);
        let rules = TeamRules::of(&settings, wishes, needs);
        let rules = rules.map(|rules| Arc::new(rules.resolved(previous, &memory, &embedding)));
        Job {
            embedding: Checked::new_unchecked(embedding),
            settings,
            rules,
            teams: teams as u32,
            requested: teams as u32,
            same_number: previous.is_none_or(|previous| previous.teams.len() == teams),
            staying,
            renewed: BTreeSet::new(),
            previous: previous.cloned().map(Checked::new_unchecked),
            memory,
        }
    }

    /// A number below `end` for each question about a moment.
    fn draw(&self, moment: usize, question: usize, end: usize) -> usize {
        (noise(self.case, 100_000 + 1_000 * moment + question) * end as f64) as usize
    }

    /// None to three wishes.
    fn wishes(&self, moment: usize, robots: &[RobotId]) -> Vec<Asked> {
        let one = |number: usize| {
            let draw = |question, end| self.draw(moment, 10 * number + question, end);
            let robot = &robots[draw(1, robots.len())];
            let other = &robots[draw(2, robots.len())];
            let team = Some(draw(3, self.teams) as u64 + 1);
            match draw(4, 6) {
                0 => wish(WishKind::Pin, &[robot], team),
                1 => wish(WishKind::Ban, &[robot], team),
                2 => wish(WishKind::Lock, &[], team),
                3 => wish(WishKind::Reserve, &[robot], None),
                4 if robot != other => wish(WishKind::Together, &[robot, other], None),
                _ if robot != other => wish(WishKind::Apart, &[robot, other], None),
                _ => wish(WishKind::Lock, &[], team),
            }
        };
        (1..=self.draw(moment, 0, 4)).map(one).collect()
    }

    /// What each team needs; nothing in half of the moments.
    fn needs(&self, moment: usize) -> Vec<Need> {
        let need = |skill: &str, min, max| Need {
            skill: SkillId::new(skill).unwrap(),
            team: None,
            per_team: SkillCount { min, max },
            soft: false,
        };
        match self.draw(moment, 90, 4) {
            0 | 1 => Vec::new(),
            2 => vec![need("medic", 1, Some(2))],
            _ => vec![need("medic", 1, None), need("relay", 1, None)],
        }
    }
}

/// Every second robot is a medic, every third one a relay.
fn roster(embedding: &Embedding) -> Roster {
    let entry = |(robot, node): (&RobotId, u32)| {
        let skills = [("medic", 2), ("relay", 3)].into_iter();
        let skills = skills.filter(|(_, each)| node % each == 0);
        RosterEntry {
            skills: skills.map(|(skill, _)| SkillId::new(skill).unwrap()).collect(),
            ..RosterEntry::active(node, robot.clone(), Tick(0))
        }
    };
    let robots = embedding.robots.iter().zip(0..).map(entry).collect();
    Roster { header: embedding.header.clone(), robots, graphs: Vec::new() }
}

/// Robots have moved since the last division, and have stood since: a restart then changes nothing.
#[test]
fn what_has_changed_is_divided_once() {
    let mut failed = Vec::new();
    for case in 0..2000 {
        let fleet = Fleet::new(case, Asking::Same);
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
        let fleet = Fleet::new(case, Asking::Same);
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

/// Nothing may satisfy what is asked: that a division stands changes who is in a locked team.
#[test]
fn whatever_is_asked_is_divided_once() {
    let (mut failed, mut standing) = (Vec::new(), 0);
    for case in 0..4000 {
        let fleet = Fleet::new(case, Asking::Anything);
        // The first one names the teams, so that wishes count from the second one on.
        let mut memory = Memory::default();
        let mut divisions: Vec<Teams> = Vec::new();
        for moment in [0, 0, 1, 2, 2, 2] {
            let last = divisions.last();
            let found = fleet.divided_knowing(moment, last, memory.clone());
            memory.follow(Tick(divisions.len() as u64), last, &found);
            divisions.push(found);
        }
        let [_, _, _, before, second, third] = &divisions[..] else { unreachable!() };
        standing += usize::from(third.limited.as_ref().is_some_and(Limited::stands));
        if short(third) != short(second) {
            let [before, second, third] = [before, second, third].map(short);
            failed.push(format!("{case}: {before} => {second} => {third}"));
        }
    }
    assert!(standing > 100, "{standing} of 4000");
    assert!(failed.is_empty(), "{} of 4000: {:#?}", failed.len(), &failed[..failed.len().min(8)]);
}

/// Robots that are to wait in their last team take no place that others need.
#[test]
fn no_team_is_without_a_robot_while_others_wait() {
    let (mut held_back, mut empty) = (0, Vec::new());
    for case in 0..4000 {
        let fleet = Fleet::new(case, Asking::Anything);
        let mut memory = Memory::default();
        let mut last: Option<Teams> = None;
        for moment in 0..4 {
            let job = fleet.job(moment, last.as_ref(), memory.clone());
            let found = divide(&job).unwrap();
            if let (Some(rules), Some(last)) = (&job.rules, &last) {
                let lives = |id: &TeamId| found.teams.iter().any(|team| team.id == *id);
                let before: BTreeMap<&RobotId, &TeamId> = last.assignments().collect();
                let moved = found.assignments().filter_map(|(robot, team)| {
                    let from = before.get(robot).filter(|from| **from != team && lives(from))?;
                    Some((robot.clone(), (*from).clone()))
                });
                let held = rules.keep(&found, moved.collect());
                held_back += held.len();
                let waiting = with_held(&found, &held, Some(rules), &job.embedding).unwrap();
                if waiting.teams.iter().any(|team| team.members.is_empty()) {
                    empty.push(format!("{case}: {} => {}", short(last), short(&waiting)));
                }
            }
            memory.follow(Tick(moment as u64), last.as_ref(), &found);
            last = Some(found);
        }
    }
    assert!(held_back > 1000, "{held_back} robots were held back");
    assert!(empty.is_empty(), "{} of 4000: {:#?}", empty.len(), &empty[..empty.len().min(8)]);
}
