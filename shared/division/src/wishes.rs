//! What has become of wishes in a division.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::teams::Teams;
use muster_model::wish::{Wish, WishKind, WishState};

use crate::rules::grants_group;
use crate::words;

/// What a wish waits for that no division has taken up yet.
pub const NEXT_DIVISION: &str = "the next division";

/// A division of an embedding as wishes are compared with it.
#[derive(Debug)]
pub struct Assessment<'a> {
    placed: BTreeMap<RobotId, TeamId>,
    /// The robots that have an embedding.
    there: BTreeSet<&'a RobotId>,
    living: BTreeSet<&'a TeamId>,
    conflict: Option<&'a str>,
}

impl<'a> Assessment<'a> {
    /// Of a division and the embedding that was divided.
    #[must_use]
    pub fn of(teams: &'a Teams, embedding: &'a Embedding) -> Self {
        let robots = embedding.robots.iter().zip(&embedding.without_embedding);
        let there = robots.filter(|(_, without)| !**without).map(|(robot, _)| robot);
        Self::with_robots(teams, there.collect())
    }

    /// Of a division whose embedding may be lost: all its robots count as having one.
    #[must_use]
    pub fn of_last(teams: &'a Teams) -> Self {
        let placed = teams.assignments().map(|(robot, _)| robot);
        Self::with_robots(teams, placed.chain(&teams.unassigned).collect())
    }

    fn with_robots(teams: &'a Teams, there: BTreeSet<&'a RobotId>) -> Self {
        let placed = teams.assignments().map(|(robot, team)| (robot.clone(), team.clone()));
        Self {
            placed: placed.collect(),
            there,
            living: teams.teams.iter().map(|team| &team.id).collect(),
            conflict: teams.limited.as_ref().and_then(|limited| limited.conflict.as_deref()),
        }
    }

    /// What has become of a wish that counts, and what it waits for or contradicts.
    #[must_use]
    pub fn state(&self, wish: &Wish) -> (WishState, Option<String>) {
        match self.awaited(wish) {
            Some(reason) => (WishState::Waiting, Some(reason)),
            None if self.is_granted(wish) => (WishState::Active, None),
            None => match self.conflict {
                Some(why) => (WishState::Conflicting, Some(why.to_owned())),
                // Its team has just come to life again.
                None => (WishState::Waiting, Some(NEXT_DIVISION.to_owned())),
            },
        }
    }

    /// What a wish waits for; none if its robots and its team are there.
    fn awaited(&self, wish: &Wish) -> Option<String> {
        if let Some(team) = wish.team.as_ref().filter(|team| !self.living.contains(*team)) {
            return Some(format!("team {team} is not there"));
        }
        let needed = if wish.kind.is_of_group() { 2 } else { 1 };
        let absent: Vec<&RobotId> =
            wish.robots.iter().filter(|robot| !self.there.contains(*robot)).collect();
        if wish.kind != WishKind::Lock && wish.robots.len() - absent.len() < needed {
            let names: Vec<String> = absent.iter().map(ToString::to_string).collect();
            let verb = if names.len() == 1 { "is" } else { "are" };
            return Some(format!("{} {verb} not there", words::list(&names)));
        }
        None
    }

    /// Whether the division grants a wish to those of its robots that are there.
    fn is_granted(&self, wish: &Wish) -> bool {
        let placed = &self.placed;
        let mut robots = wish.robots.iter().filter(|robot| self.there.contains(robot));
        match wish.kind {
            WishKind::Pin => robots.all(|robot| placed.get(robot) == wish.team.as_ref()),
            WishKind::Ban => robots.all(|robot| placed.get(robot) != wish.team.as_ref()),
            WishKind::Together | WishKind::Apart => grants_group(wish, placed),
            WishKind::Reserve => robots.all(|robot| !placed.contains_key(robot)),
            // Who stays in the team is in it.
            WishKind::Lock => true,
        }
    }
}
