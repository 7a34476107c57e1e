//! Robots that are awaited before the fleet is divided.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_model::id::RobotId;
use muster_model::settings::MAX_TICK_HZ;
use muster_model::time::Tick;

use super::Clusterer;

/// How long the robots of the division of an earlier leader are awaited before the first division, from the
/// first robot on. Robots connect again within a second or two of the router's return, and repeat their links and
/// ranks as often: before that, what relates them is not what it was when they were divided. Services that start
/// have looked for a leader for two seconds by then and received robots; with the start of their processes and the first frame
/// all stays below five seconds.
const REUNION_TIME: Duration = Duration::from_secs(2);

/// How long they are awaited where all of them are there and related to others: each stream of each robot has been repeated
/// by then.
const WHOLE_REUNION_TIME: Duration = Duration::from_millis(1500);

/// After so many frames an `ingest` has run for longer than that, however fast it is: it knows its robots.
const FRAMES_OF_REUNION: f64 = REUNION_TIME.as_secs_f64() * MAX_TICK_HZ;

/// How long they are awaited where there is no robot at all: then they have left, or come later than any that only lost a
/// link. Who comes within `TEAM_MEMORY_TIME` after that has its team again.
const EMPTY_REUNION_TIME: Duration = Duration::from_secs(20);

/// How long robots that return are awaited until something relates them to others: their next report, and the
/// frame that holds it. Without that they would be told that they have no team, and a moment later that they
/// have their old one.
const RELATION_TIME: Duration = Duration::from_secs(1);

/// The robots of the division of an earlier leader are awaited.
#[derive(Debug, Default)]
pub(super) struct Reunion {
    /// When the first of them was there.
    begun: Option<Tick>,
    /// Since when no robot is there.
    empty_since: Option<Tick>,
    /// Whether all of them are there, and related to others.
    is_whole: bool,
}

impl Reunion {
    fn time(&self) -> Duration {
        if self.is_whole { WHOLE_REUNION_TIME } else { REUNION_TIME }
    }

    fn ends_at(&self) -> Option<Tick> {
        let begun = self.begun.map(|begun| begun.after(self.time()));
        begun.or_else(|| Some(self.empty_since?.after(EMPTY_REUNION_TIME)))
    }
}

impl Clusterer {
    /// Whether `ingest` or `embedder` have lived on since the division of an earlier leader: then there is
    /// no robot to wait for; robots and relations are those of before.
    #[expect(clippy::cast_precision_loss, reason = "frames are few")]
    fn others_lived_on(&self) -> bool {
        let frames = self.roster.as_ref().map_or(0, |roster| roster.header.revision.epoch);
        let embedded = self.newest.as_ref().map(|newest| newest.embedding.header.revision.term);
        let divided = self.division.as_ref().map(|division| division.embedding.term);
        frames as f64 > FRAMES_OF_REUNION || embedded.is_some() && embedded == divided
    }

    /// Whether every robot of the last division has a vector that more than one relation stands behind, or had none such then.
    fn is_whole(&self) -> bool {
        let (Some(newest), Some(division)) = (&self.newest, &self.division) else { return false };
        let embedding = &newest.embedding;
        division.assignments().all(|(robot, _)| {
            embedding.robots.binary_search(robot).is_ok_and(|row| {
                let is_provisional = embedding.provisional.get(row).copied().unwrap_or_default();
                let was_provisional = || division.provisional.binary_search(robot).is_ok();
                !embedding.without_embedding[row] && (!is_provisional || was_provisional())
            })
        })
    }

    /// Whether the robots of the division of an earlier leader are still awaited.
    pub(super) fn awaits_robots(&mut self, now: Tick) -> bool {
        if self.reunion.is_some() && self.others_lived_on() {
            self.reunion = None;
        }
        let is_whole = self.is_whole();
        let (Some(reunion), Some(newest)) = (&mut self.reunion, &self.newest) else {
            return false;
        };
        if newest.embedding.robots.is_empty() {
            // Those that were there have left again: the time counts from the next one on.
            reunion.begun = None;
            let since = *reunion.empty_since.get_or_insert(now);
            let are_awaited = now.since(since) < EMPTY_REUNION_TIME;
            if !are_awaited {
                self.reunion = None;
            }
            return are_awaited;
        }
        reunion.empty_since = None;
        let begun = *reunion.begun.get_or_insert(now);
        reunion.is_whole = is_whole;
        let are_awaited = now.since(begun) < reunion.time();
        if !are_awaited {
            self.reunion = None;
        }
        are_awaited
    }

    /// Whether robots that return are awaited until something relates them to others.
    pub(super) fn awaits_relations(&mut self, now: Tick) -> bool {
        let (Some(newest), Some(division)) = (&self.newest, &self.division) else {
            self.returning_since = None;
            return false;
        };
        let robots = newest.embedding.robots.iter().zip(&newest.embedding.without_embedding);
        let loose = robots.filter(|(_, without)| **without).map(|(robot, _)| robot);
        let mut back = loose.filter(|robot| self.memory.last_team(robot).is_some()).peekable();
        if back.peek().is_none() {
            self.returning_since = None;
            return false;
        }
        let members = division.assignments().map(|(robot, _)| robot);
        let divided: BTreeSet<&RobotId> = members.chain(&division.unassigned).collect();
        if back.all(|robot| divided.contains(robot)) {
            self.returning_since = None;
            return false;
        }
        now.since(*self.returning_since.get_or_insert(now)) < RELATION_TIME
    }

    /// When robots are awaited no longer.
    pub(super) fn awaits_until(&self) -> Option<Tick> {
        let reunion = self.reunion.as_ref().and_then(Reunion::ends_at);
        let returning = self.returning_since.map(|since| since.after(RELATION_TIME));
        reunion.into_iter().chain(returning).min()
    }
}
