//! What changed in a division, and when it is recorded as a whole.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::content::Checked;
use muster_model::history::{DivisionRecord, Place, SnapshotCause, TeamLine};
use muster_model::id::{RobotId, TeamId};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_service::{Newest, Recency};

/// How often a division is recorded as a whole: what a moment is found by is read from there on.
pub(crate) const SNAPSHOT_INTERVAL: Duration = Duration::from_secs(600);

/// Where a robot is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Whereabouts<'a> {
    present: bool,
    team: Option<&'a TeamId>,
    stale: bool,
}

/// The divisions as they are recorded.
#[derive(Debug, Default)]
pub(crate) struct Divisions {
    last: Option<Checked<Teams>>,
    newest: Newest,
    /// When the last one was recorded as a whole.
    whole_at: Option<Tick>,
}

impl Divisions {
    /// Receives a division. What is returned is to be recorded.
    pub(crate) fn receive(&mut self, now: Tick, teams: Checked<Teams>) -> Option<DivisionRecord> {
        if self.newest.receive(now, teams.header.revision) == Recency::Old {
            return None;
        }
        let record = match &self.last {
            Some(last) if teams.same_division(last) => None,
            Some(last) => Some(changes(last, &teams)),
            None => {
                self.whole_at = Some(now);
                Some(whole(&teams, SnapshotCause::Start))
            }
        };
        self.last = Some(teams);
        record
    }

    /// The newest division as a whole, if there is one.
    pub(crate) fn snapshot(&mut self, now: Tick, cause: SnapshotCause) -> Option<DivisionRecord> {
        self.whole_at = Some(now);
        Some(whole(self.last.as_ref()?, cause))
    }

    /// When the next whole division is due.
    pub(crate) fn due(&self) -> Option<Tick> {
        let whole_at = self.whole_at.filter(|_| self.last.is_some())?;
        Some(whole_at.after(SNAPSHOT_INTERVAL))
    }

    /// How many robots the newest division has.
    pub(crate) fn robots(&self) -> usize {
        self.last.as_ref().map_or(0, |teams| teams.assignments().count() + teams.unassigned.len())
    }
}

fn places(teams: &Teams) -> BTreeMap<&RobotId, Whereabouts<'_>> {
    let mut places: BTreeMap<&RobotId, Whereabouts<'_>> = BTreeMap::new();
    for (robot, team) in teams.assignments() {
        places.insert(robot, Whereabouts { present: true, team: Some(team), stale: false });
    }
    for robot in &teams.unassigned {
        places.insert(robot, Whereabouts { present: true, team: None, stale: false });
    }
    for robot in &teams.stale {
        places.entry(robot).or_default().stale = true;
    }
    places
}

fn place(robot: &RobotId, at: Whereabouts<'_>, was: Option<&TeamId>) -> Place {
    Place {
        robot: robot.clone(),
        present: at.present,
        team: at.team.cloned(),
        stale: at.stale,
        was: was.cloned(),
    }
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

fn record(teams: &Teams, places: Vec<Place>, lines: Vec<TeamLine>) -> DivisionRecord {
    DivisionRecord {
        revision: teams.header.revision,
        requested: teams.requested,
        teams: count(teams.teams.len()),
        robots: count(teams.assignments().count() + teams.unassigned.len()),
        snapshot: None,
        places,
        lines,
    }
}

fn line(team: &muster_model::teams::Team) -> TeamLine {
    let leader = Some(team.leader.clone());
    TeamLine { team: team.id.clone(), leader, members: count(team.members.len()) }
}

fn whole(teams: &Teams, cause: SnapshotCause) -> DivisionRecord {
    let places = places(teams).into_iter().map(|(robot, at)| place(robot, at, None)).collect();
    let lines = teams.teams.iter().map(line).collect();
    DivisionRecord { snapshot: Some(cause), ..record(teams, places, lines) }
}

fn changes(before: &Teams, after: &Teams) -> DivisionRecord {
    let (old, new) = (places(before), places(after));
    let mut changed = Vec::new();
    let robots: BTreeSet<_> = old.keys().chain(new.keys()).copied().collect();
    for robot in robots {
        let was = old.get(robot).copied().unwrap_or_default();
        let is = new.get(robot).copied().unwrap_or_default();
        if was != is {
            changed.push(place(robot, is, was.team));
        }
    }
    let moved: BTreeSet<&TeamId> = changed
        .iter()
        .filter(|place| place.team != place.was)
        .flat_map(|place| place.team.iter().chain(&place.was))
        .collect();
    let old: BTreeMap<_, _> = before.teams.iter().map(|team| (&team.id, team)).collect();
    let mut lines: Vec<TeamLine> = after
        .teams
        .iter()
        .filter(|team| {
            let same = old.get(&team.id).is_some_and(|before| before.leader == team.leader);
            !same || moved.contains(&team.id)
        })
        .map(line)
        .collect();
    let is_there = |id: &TeamId| after.teams.iter().any(|team| team.id == *id);
    let ended = before.teams.iter().filter(|team| !is_there(&team.id));
    lines.extend(ended.map(|team| TeamLine { team: team.id.clone(), leader: None, members: 0 }));
    record(after, changed, lines)
}
