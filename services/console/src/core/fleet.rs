//! The fleet as browsers see it: who is in it, where, in which team, and who has been lost.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_model::id::{RobotId, TeamId};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, WishKind, WishState};
use serde_json::{Value, json};

use super::frame::{self, Dot, HELD, Head, LEADER, LOST, NONE, PINNED, PROVISIONAL, STALE, View};
use super::limits::{LOST_FOR, MAX_LOST, MAX_LOST_LISTED, NAMES_PER_PIECE};

/// A robot that has left, as it was last seen.
#[derive(Debug, Clone)]
struct Lost {
    entry: RosterEntry,
    /// When the roster first came without it.
    left: Tick,
    team: Option<TeamId>,
}

/// What does not change while the same robots are there with the same roles, skills and superiors.
#[derive(Debug, Clone, PartialEq)]
struct Line {
    robot: RobotId,
    role: Option<String>,
    skills: Vec<String>,
    superior: Option<RobotId>,
    frame: Option<String>,
}

impl Line {
    fn of(entry: &RosterEntry) -> Self {
        Self {
            robot: entry.robot.clone(),
            role: entry.role.clone(),
            skills: entry.skills.iter().map(ToString::to_string).collect(),
            superior: entry.superior.clone(),
            frame: entry.frame.clone(),
        }
    }
}

/// The fleet as browsers see it.
#[derive(Debug, Default)]
pub(super) struct Fleet {
    roster: Option<Arc<Roster>>,
    teams: Option<Arc<Teams>>,
    lost: BTreeMap<RobotId, Lost>,
    /// Every robot that is shown, ordered by name: the roster and who was lost.
    lines: Vec<Line>,
    names: u32,
    slots: u32,
    /// Slot of the team and flags of robots that the division names.
    places: BTreeMap<RobotId, (u16, u8)>,
    pinned: BTreeSet<RobotId>,
    locked: BTreeSet<TeamId>,
}

impl Fleet {
    /// The number of the list of names. It grows when the list changes.
    pub(super) fn names(&self) -> u32 {
        self.names
    }

    pub(super) fn roster(&self) -> Option<&Arc<Roster>> {
        self.roster.as_ref()
    }

    /// The index of a robot in the list of names.
    pub(super) fn index(&self, robot: &RobotId) -> Option<u32> {
        let found = self.lines.binary_search_by(|line| line.robot.cmp(robot)).ok()?;
        u32::try_from(found).ok()
    }

    /// Follows the roster. A robot that is gone from it stays as lost.
    pub(super) fn follow_roster(&mut self, now: Tick, roster: Arc<Roster>) {
        if let Some(before) = &self.roster {
            let mut after = roster.robots.iter().map(|entry| &entry.robot).peekable();
            for entry in &before.robots {
                while after.next_if(|robot| **robot < entry.robot).is_some() {}
                if after.peek().is_none_or(|robot| **robot != entry.robot) {
                    let team = self.team_of(&entry.robot).cloned();
                    let lost = Lost { entry: entry.clone(), left: now, team };
                    self.lost.insert(entry.robot.clone(), lost);
                }
            }
        }
        for entry in &roster.robots {
            self.lost.remove(&entry.robot);
        }
        self.roster = Some(roster);
        self.forget(now);
        self.relist();
    }

    /// Forgets who was lost too long ago; true if somebody was.
    pub(super) fn forget(&mut self, now: Tick) -> bool {
        let before = self.lost.len();
        self.lost.retain(|_, lost| now.since(lost.left) < LOST_FOR);
        while self.lost.len() > MAX_LOST {
            let oldest = self.lost.values().min_by_key(|lost| lost.left);
            let Some(robot) = oldest.map(|lost| lost.entry.robot.clone()) else { break };
            self.lost.remove(&robot);
        }
        self.lost.len() != before
    }

    /// Makes the list of names again where it has changed.
    pub(super) fn relist(&mut self) {
        let present = self.roster.iter().flat_map(|roster| &roster.robots);
        let mut entries: Vec<&RosterEntry> =
            present.chain(self.lost.values().map(|lost| &lost.entry)).collect();
        entries.sort_by(|left, right| left.robot.cmp(&right.robot));
        let same = entries.len() == self.lines.len()
            && entries.iter().zip(&self.lines).all(|(entry, line)| {
                entry.robot == line.robot
                    && entry.role == line.role
                    && entry.superior == line.superior
                    && entry.frame == line.frame
                    && entry.skills.len() == line.skills.len()
                    && entry.skills.iter().zip(&line.skills).all(|(l, r)| l.as_str() == r)
            });
        if !same {
            self.lines = entries.into_iter().map(Line::of).collect();
            self.names = self.names.wrapping_add(1);
        }
    }

    pub(super) fn follow_teams(&mut self, teams: Arc<Teams>) {
        self.places.clear();
        for (number, team) in teams.teams.iter().enumerate() {
            let slot = u16::try_from(number).unwrap_or(NONE);
            for member in &team.members {
                let flags = if member.robot == team.leader { LEADER } else { 0 };
                self.places.insert(member.robot.clone(), (slot, flags));
            }
        }
        let held = teams.held.iter().map(|held| &held.robot);
        for (robots, flag) in
            [(teams.provisional.iter().collect::<Vec<_>>(), PROVISIONAL), (held.collect(), HELD)]
        {
            for robot in robots {
                self.places.entry(robot.clone()).or_insert((NONE, 0)).1 |= flag;
            }
        }
        self.teams = Some(teams);
        self.slots = self.slots.wrapping_add(1);
    }

    /// Follows the wishes; true if other robots are bound by them than before.
    pub(super) fn follow_wishes(&mut self, wishes: &[StandingWish]) -> bool {
        let holding = |wish: &&StandingWish| {
            matches!(wish.state, WishState::Active | WishState::Waiting | WishState::Conflicting)
        };
        let (mut pinned, mut locked) = (BTreeSet::new(), BTreeSet::new());
        for standing in wishes.iter().filter(holding) {
            pinned.extend(standing.wish.robots.iter().cloned());
            if standing.wish.kind == WishKind::Lock {
                locked.extend(standing.wish.team.iter().cloned());
            }
        }
        let changed = pinned != self.pinned || locked != self.locked;
        (self.pinned, self.locked) = (pinned, locked);
        changed
    }

    fn team_of(&self, robot: &RobotId) -> Option<&TeamId> {
        let (slot, _) = self.places.get(robot)?;
        Some(&self.teams.as_ref()?.teams.get(usize::from(*slot))?.id)
    }

    /// Slot and flags of a robot, by the division and the wishes.
    fn place(&self, robot: &RobotId) -> (u16, u8) {
        let (slot, mut flags) = self.places.get(robot).copied().unwrap_or((NONE, 0));
        let is_locked = || self.team_of(robot).is_some_and(|team| self.locked.contains(team));
        if self.pinned.contains(robot) || (!self.locked.is_empty() && is_locked()) {
            flags |= PINNED;
        }
        (slot, flags)
    }

    fn head(&self, view: View) -> Head {
        let newest = self.roster.as_ref().and_then(|roster| roster.header.newest);
        let newest = newest.map_or(0.0, Tick::as_seconds);
        Head { view, names: self.names, teams: self.slots, newest }
    }

    /// The frame of the ground.
    pub(super) fn ground(&self) -> Vec<u8> {
        let mut dots = Vec::with_capacity(self.lines.len());
        let present = self.roster.iter().flat_map(|roster| &roster.robots);
        let mut present = present.peekable();
        let mut lost = self.lost.values().peekable();
        // Both are ordered by name, as the list of names is.
        for line in &self.lines {
            let (entry, gone) = match present.next_if(|entry| entry.robot == line.robot) {
                Some(entry) => (Some(entry), false),
                None => {
                    (lost.next_if(|one| one.entry.robot == line.robot).map(|one| &one.entry), true)
                }
            };
            let (team, mut flags) = self.place(&line.robot);
            if gone {
                flags |= LOST;
            } else if entry.is_some_and(|entry| entry.presence == Presence::Stale) {
                flags |= STALE;
            }
            let place = entry.and_then(|entry| entry.position).map(|at| [at[0], at[1]]);
            let heading = entry.and_then(|entry| entry.heading);
            dots.push(Dot { place, team, heading, flags });
        }
        frame::robots(&self.head(View::Ground), &dots)
    }

    /// The frame of the embedding, whose robots have these places.
    pub(super) fn embedding(&self, places: &[(RobotId, Option<[f64; 2]>)]) -> Vec<u8> {
        let stale = |robot: &RobotId| {
            let robots = self.roster.as_ref().map(|roster| &roster.robots);
            let found = robots.and_then(|robots| {
                let at = robots.binary_search_by(|entry| entry.robot.cmp(robot)).ok()?;
                Some(robots[at].presence)
            });
            match found {
                Some(Presence::Active) => 0,
                Some(Presence::Stale) => STALE,
                None => LOST,
            }
        };
        let dot = |line: &Line| {
            let at = places.binary_search_by(|(robot, _)| robot.cmp(&line.robot)).ok();
            let place = at.and_then(|at| places[at].1);
            let (team, flags) = self.place(&line.robot);
            Dot { place, team, heading: None, flags: flags | stale(&line.robot) }
        };
        let dots: Vec<Dot> = self.lines.iter().map(dot).collect();
        frame::robots(&self.head(View::Embedding), &dots)
    }

    /// The head of a frame of links.
    pub(super) fn links_head(&self) -> Head {
        self.head(View::Links)
    }

    /// In how many pieces the names are sent; at least one, so that a browser learns that there are none.
    pub(super) fn pieces(&self) -> usize {
        self.lines.len().div_ceil(NAMES_PER_PIECE).max(1)
    }

    /// A piece of the names.
    pub(super) fn piece(&self, number: usize) -> Value {
        let from = number * NAMES_PER_PIECE;
        let lines = self.lines.iter().skip(from).take(NAMES_PER_PIECE);
        let robots: Vec<Value> = lines
            .map(|line| {
                // Short rows: most robots have neither role nor skills.
                let row = [
                    json!(line.robot),
                    json!(line.superior),
                    json!(line.role),
                    json!(line.skills),
                    json!(line.frame),
                ];
                let used = [
                    true,
                    line.superior.is_some(),
                    line.role.is_some(),
                    !line.skills.is_empty(),
                    line.frame.is_some(),
                ];
                let length = used.iter().rposition(|used| *used).map_or(1, |last| last + 1);
                Value::Array(row.into_iter().take(length).collect())
            })
            .collect();
        json!({"names": self.names, "of": self.lines.len(), "from": from, "robots": robots})
    }

    /// Who is silent or has left, the ones that were received last first.
    pub(super) fn missing(&self) -> Value {
        let present = self.roster.iter().flat_map(|roster| &roster.robots);
        let stale = present.filter(|entry| entry.presence == Presence::Stale);
        let stale = stale.map(|entry| (entry, "stale", self.team_of(&entry.robot)));
        let gone = self.lost.values().map(|lost| (&lost.entry, "lost", lost.team.as_ref()));
        let mut all: Vec<_> = stale.chain(gone).collect();
        all.sort_by_key(|(entry, ..)| std::cmp::Reverse(entry.last_seen));
        let count = all.len();
        let robots: Vec<Value> = all
            .into_iter()
            .take(MAX_LOST_LISTED)
            .map(|(entry, state, team)| {
                let last_seen = entry.last_seen.as_seconds();
                json!({"robot": entry.robot, "state": state, "last_seen": last_seen, "team": team})
            })
            .collect();
        json!({"count": count, "robots": robots})
    }

    /// The division for the table of teams: members are counted, since each robot's team stands in the frames.
    pub(super) fn division(&self) -> Option<Value> {
        let teams = self.teams.as_ref()?;
        let prices = teams.limited.as_ref().map_or(&[][..], |limited| &limited.prices);
        let list: Vec<Value> = teams
            .teams
            .iter()
            .enumerate()
            .map(|(number, team)| {
                json!({
                    "id": team.id, "members": team.members.len(), "leader": team.leader,
                    "price": prices.get(number),
                })
            })
            .collect();
        let limited = teams.limited.as_ref();
        Some(json!({
            "slots": self.slots,
            "term": teams.header.revision.term,
            "epoch": teams.header.revision.epoch,
            "newest": teams.header.newest.map(Tick::as_seconds),
            "requested": teams.requested,
            "considered": teams.considered,
            "teams": list,
            "unassigned": teams.unassigned.len(),
            "stale": teams.stale.len(),
            "provisional": teams.provisional.len(),
            "held": teams.held.len(),
            "optimal": limited.map(|limited| limited.optimal),
            "gap": limited.filter(|limited| limited.conflict.is_none()).map(|limited| limited.gap),
            "conflict": limited.and_then(|limited| limited.conflict.clone()),
            "needs": teams.needs,
        }))
    }
}
