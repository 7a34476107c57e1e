//! What a historian promises to keep is on its disk, is what was published, and is all that it received.
//!
//! The records are read here as any reader of the file would: a whole division, and what changed since.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use muster_model::content::Checked;
use muster_model::event::Event;
use muster_model::header::Revision;
use muster_model::history::{DivisionRecord, Entry, EventRecord, Record, RecordingState};
use muster_model::id::{RobotId, ServiceName, TeamId};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_wire::Message;
use serde_json::Value;

use super::{Oracle, Published, Verified, breach};

/// What is promised of the disk.
const KEPT: &str = "what is published as recorded is on the disk, whatever is killed";

/// What is promised of the records.
const TRUE: &str = "what is recorded is what was published";

/// What is promised of what was received.
const WHOLE: &str =
    "everything that a historian received is recorded, up to the moment that it names";

/// Where a robot is: in the division, its team, whether it is stale.
type Place = (bool, Option<TeamId>, bool);

/// Everything that a division says of robots and teams.
type Picture = (BTreeMap<RobotId, Place>, BTreeMap<TeamId, RobotId>);

/// What was received.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Received {
    Event(ServiceName, Revision),
    Division(Revision),
}

/// The records of one instance, as far as they are promised.
#[derive(Debug, Default)]
struct Tape {
    /// How many records were promised.
    promised: usize,
    /// How many were there when the process began: its clock may be behind theirs.
    begun_at: usize,
    picture: Picture,
    division: Option<Revision>,
    events: BTreeSet<(ServiceName, Revision)>,
    /// What the process has received and not promised yet, with the moment by its clock.
    awaited: VecDeque<(Tick, Received)>,
    /// The newest division that it has received and promised, or was answered with. A leader of a lower term may lead again
    /// after a higher one was killed; a reader does not go back to what it publishes, and a historian does not either.
    newest: Option<Revision>,
}

/// Every event that was published, as the bus has it in JSON.
type Events = BTreeMap<(ServiceName, Revision), Vec<Value>>;

/// What is known of all recordings.
#[derive(Debug, Default)]
pub(crate) struct Recorded {
    events: Events,
    tapes: BTreeMap<usize, Tape>,
}

impl Recorded {
    /// A service has published an event, which has this form in JSON.
    pub(crate) fn published(&mut self, event: &Event, json: Value) {
        self.events.entry((event.source, event.header.revision)).or_default().push(json);
    }

    /// An instance receives a message at a moment of its own clock.
    pub(crate) fn received(&mut self, instance: usize, at: Tick, message: &Message) {
        let received = match message {
            Message::Event(event) => Received::Event(event.source, event.header.revision),
            Message::Teams { teams, .. } => Received::Division(teams.header.revision),
            _ => return,
        };
        self.tapes.entry(instance).or_default().awaited.push_back((at, received));
    }

    /// An instance is answered with a division. What is published of a lower revision need not be recorded.
    pub(crate) fn learned(&mut self, instance: usize, revision: Revision) {
        let tape = self.tapes.entry(instance).or_default();
        tape.newest = tape.newest.max(Some(revision));
    }

    /// The process of an instance was killed: what it had not promised may be lost, and so many records are there.
    pub(crate) fn killed(&mut self, instance: usize, records: usize) {
        let tape = self.tapes.entry(instance).or_default();
        tape.awaited.clear();
        tape.newest = None;
        tape.begun_at = records;
    }

    /// An instance has lost its disk.
    pub(crate) fn forget(&mut self, instance: usize) {
        self.tapes.remove(&instance);
    }
}

impl Oracle {
    /// Judges what an instance promises. `whole` if everything that it received must be recorded.
    pub(crate) fn promised(
        &mut self,
        instance: usize,
        state: &RecordingState,
        disk: &[Entry],
        whole: bool,
    ) -> Verified {
        let Recorded { events, tapes } = &mut self.recorded;
        let tape = tapes.entry(instance).or_default();
        let count = usize::try_from(state.coverage.sequence).unwrap_or(usize::MAX);
        if count > disk.len() || count < tape.promised {
            let had = tape.promised;
            let seen =
                format!("{count} records are promised, {had} were, {} are there", disk.len());
            return breach(KEPT, seen);
        }
        for entry in &disk[tape.promised..count] {
            tape.play(entry, events, &self.divisions)?;
        }
        tape.promised = count;
        let last = disk[..count].last().map(|entry| entry.at);
        if state.coverage.recorded_through != last {
            return breach(KEPT, format!("{:?}, and on the disk {last:?}", state.coverage));
        }
        let own = disk[..count].iter().skip(tape.begun_at);
        let through = own.map(|entry| entry.at).max();
        tape.check_whole(through, whole && state.lost == 0, &self.divisions)
    }

    /// What an instance has received before a moment and not recorded; none if there is nothing of the kind.
    pub(crate) fn is_behind(&self, instance: usize, before: Tick) -> Option<String> {
        let tape = self.recorded.tapes.get(&instance)?;
        let is_missing = |(at, received): &&(Tick, Received)| {
            *at < before
                && match received {
                    Received::Event(..) => true,
                    Received::Division(revision) => {
                        Some(*revision) > tape.newest && !tape.shows(*revision, &self.divisions)
                    }
                }
        };
        // Of divisions the newest counts: those before it may be gone from the picture.
        let divisions =
            tape.awaited.iter().filter(|(_, received)| matches!(received, Received::Division(_)));
        let newest = divisions.max_by_key(|(_, received)| match received {
            Received::Division(revision) => Some(*revision),
            Received::Event(..) => None,
        });
        let events = tape
            .awaited
            .iter()
            .find(|(at, received)| *at < before && matches!(received, Received::Event(..)));
        let missing = newest.filter(is_missing).or(events)?;
        Some(format!("{missing:?} is not recorded before {before:?}"))
    }
}

impl Tape {
    /// Reads one record.
    fn play(
        &mut self,
        entry: &Entry,
        events: &Events,
        divisions: &Published<Checked<Teams>>,
    ) -> Verified {
        match &entry.record {
            Record::Division(division) => {
                self.apply(division);
                let revision = division.revision;
                let named = divisions.named(revision);
                let is_known = !named.is_empty() || !divisions.has_forgotten(revision);
                if is_known && !named.iter().any(|teams| picture(teams) == self.picture) {
                    let seen = format!("{:?} of {revision:?}, published {named:?}", self.picture);
                    return breach(TRUE, seen);
                }
                self.division = Some(revision);
            }
            Record::Event(event) => {
                let of = (event.source, event.revision);
                let published = events.get(&of).map_or(&[][..], Vec::as_slice);
                if !published.iter().any(|published| says(event, published)) {
                    return breach(TRUE, format!("{event:?}, published {published:?}"));
                }
                self.events.insert(of);
            }
            _ => {}
        }
        Ok(())
    }

    fn apply(&mut self, division: &DivisionRecord) {
        let (places, leaders) = &mut self.picture;
        if division.snapshot.is_some() {
            places.clear();
            leaders.clear();
        }
        for place in &division.places {
            if place.present || place.stale {
                let now = (place.present, place.team.clone(), place.stale);
                places.insert(place.robot.clone(), now);
            } else {
                places.remove(&place.robot);
            }
        }
        for line in &division.lines {
            match &line.leader {
                Some(leader) => leaders.insert(line.team.clone(), leader.clone()),
                None => leaders.remove(&line.team),
            };
        }
    }

    /// Whether the records show a division, or one that came later.
    fn shows(&self, revision: Revision, divisions: &Published<Checked<Teams>>) -> bool {
        self.division.is_some_and(|recorded| recorded >= revision)
            || divisions.has_forgotten(revision)
            || divisions.named(revision).iter().any(|teams| picture(teams) == self.picture)
    }

    /// What was received up to a moment is among the records.
    fn check_whole(
        &mut self,
        through: Option<Tick>,
        whole: bool,
        divisions: &Published<Checked<Teams>>,
    ) -> Verified {
        let count = self.awaited.iter().take_while(|(at, _)| Some(*at) <= through).count();
        let promised: Vec<_> = self.awaited.drain(..count).collect();
        let revisions = promised.iter().filter_map(|(_, received)| match received {
            Received::Division(revision) => Some(*revision),
            Received::Event(..) => None,
        });
        let newest = revisions.max().filter(|revision| Some(*revision) > self.newest);
        self.newest = self.newest.max(newest);
        if !whole {
            return Ok(());
        }
        let event = promised.iter().find(|(_, received)| match received {
            Received::Event(source, revision) => !self.events.contains(&(*source, *revision)),
            Received::Division(_) => false,
        });
        if let Some(revision) = newest.filter(|revision| !self.shows(*revision, divisions)) {
            let seen = format!("division {revision:?} is not, up to {through:?}");
            return breach(WHOLE, seen);
        }
        match event {
            None => Ok(()),
            Some(event) => breach(WHOLE, format!("{event:?} is not, up to {through:?}")),
        }
    }
}

/// What a division says.
fn picture(teams: &Teams) -> Picture {
    let mut places: BTreeMap<RobotId, Place> = BTreeMap::new();
    for team in &teams.teams {
        for member in &team.members {
            places.insert(member.robot.clone(), (true, Some(team.id.clone()), false));
        }
    }
    for robot in &teams.unassigned {
        places.insert(robot.clone(), (true, None, false));
    }
    for robot in &teams.stale {
        places.entry(robot.clone()).or_insert((false, None, false)).2 = true;
    }
    let leaders = teams.teams.iter().map(|team| (team.id.clone(), team.leader.clone()));
    (places, leaders.collect())
}

/// Whether a record says the same as an event: all that is no part of the head.
fn says(record: &EventRecord, published: &Value) -> bool {
    const HEAD: [&str; 8] =
        ["fleet", "term", "epoch", "data_age_s", "stages", "source", "severity", "event"];
    let Ok(Value::Object(mut said)) = serde_json::from_str(&record.detail) else { return false };
    let Some(published) = published.as_object() else { return false };
    let severity = serde_json::to_value(record.severity).ok();
    let is_same = published.get("event").and_then(Value::as_str) == Some(&record.kind)
        && published.get("source").and_then(Value::as_str) == Some(record.source.as_str())
        && published.get("severity") == severity.as_ref();
    let others = published.iter().filter(|(name, _)| !HEAD.contains(&name.as_str()));
    let has_all = others.into_iter().all(|(name, value)| said.remove(name).as_ref() == Some(value));
    is_same && has_all && said.is_empty()
}
