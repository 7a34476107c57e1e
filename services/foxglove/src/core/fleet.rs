//! The fleet as it is drawn: who is where, in which team, and who has been lost.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::id::RobotId;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::teams::Teams;
use muster_model::time::Tick;

use super::limits::{LOST_FOR, MAX_LOST};

/// The frame of positions that name none.
const DEFAULT_FRAME: &str = "map";

/// A robot that has left, as it was last seen.
#[derive(Debug, Clone)]
pub(super) struct Lost {
    pub(super) entry: RosterEntry,
    /// When the roster first came without it.
    left: Tick,
}

/// The fleet as it is drawn.
#[derive(Debug, Default)]
pub(super) struct Fleet {
    roster: Option<Arc<Roster>>,
    teams: Option<Arc<Teams>>,
    /// The members of all teams, ordered by name: the slot of the team, and the place in it.
    order: Vec<(usize, usize)>,
    lost: BTreeMap<RobotId, Lost>,
}

/// The frame in which a robot's position is.
pub(super) fn frame_of(entry: &RosterEntry) -> &str {
    entry.frame.as_deref().unwrap_or(DEFAULT_FRAME)
}

impl Fleet {
    pub(super) fn roster(&self) -> Option<&Arc<Roster>> {
        self.roster.as_ref()
    }

    pub(super) fn teams(&self) -> Option<&Arc<Teams>> {
        self.teams.as_ref()
    }

    /// The robots of the roster, ordered by name.
    pub(super) fn robots(&self) -> &[RosterEntry] {
        self.roster.as_ref().map_or(&[], |roster| &roster.robots)
    }

    /// Who is silent or has left and was once somewhere, those that were received last first.
    pub(super) fn missing(&self) -> Vec<&RosterEntry> {
        let silent = self.robots().iter().filter(|entry| entry.presence == Presence::Stale);
        let all = silent.chain(self.lost.values().map(|lost| &lost.entry));
        let mut all: Vec<_> = all.filter(|entry| entry.position.is_some()).collect();
        all.sort_by_key(|entry| std::cmp::Reverse(entry.last_seen));
        all
    }

    /// Follows the roster. A robot that is gone from it stays as lost.
    pub(super) fn follow_roster(&mut self, now: Tick, roster: Arc<Roster>) {
        if let Some(before) = &self.roster {
            let mut after = roster.robots.iter().map(|entry| &entry.robot).peekable();
            for entry in &before.robots {
                while after.next_if(|robot| **robot < entry.robot).is_some() {}
                if after.peek().is_none_or(|robot| **robot != entry.robot) {
                    let lost = Lost { entry: entry.clone(), left: now };
                    self.lost.insert(entry.robot.clone(), lost);
                }
            }
        }
        if !self.lost.is_empty() {
            for entry in &roster.robots {
                self.lost.remove(&entry.robot);
            }
        }
        self.roster = Some(roster);
        self.forget(now);
    }

    /// Forgets who was lost too long ago.
    pub(super) fn forget(&mut self, now: Tick) {
        self.lost.retain(|_, lost| now.since(lost.left) < LOST_FOR);
        while self.lost.len() > MAX_LOST {
            let oldest = self.lost.values().min_by_key(|lost| lost.left);
            let Some(robot) = oldest.map(|lost| lost.entry.robot.clone()) else { break };
            self.lost.remove(&robot);
        }
    }

    pub(super) fn follow_teams(&mut self, teams: Arc<Teams>) {
        let slots = teams.teams.iter().enumerate();
        let members =
            slots.flat_map(|(slot, team)| (0..team.members.len()).map(move |at| (slot, at)));
        self.order = members.collect();
        self.order.sort_unstable_by(|left, right| {
            let robot = |&(slot, at): &(usize, usize)| &teams.teams[slot].members[at].robot;
            robot(left).cmp(robot(right))
        });
        self.teams = Some(teams);
    }

    /// The robots of the roster, ordered by name, each with the slot of its team.
    pub(super) fn placed(&self) -> impl Iterator<Item = (&RosterEntry, Option<usize>)> {
        let teams = self.teams.as_ref().map_or(&[][..], |teams| &teams.teams);
        let members = self.order.iter().map(|&(slot, at)| (&teams[slot].members[at].robot, slot));
        let mut members = members.peekable();
        self.robots().iter().map(move |entry| {
            while members.next_if(|(robot, _)| **robot < entry.robot).is_some() {}
            let slot = members.next_if(|(robot, _)| **robot == entry.robot).map(|(_, slot)| slot);
            (entry, slot)
        })
    }
}
