//! The newest message of a stream, and whether it is still valid.
//!
//! This is a pure state machine over the moments that it is given: a test reaches every state of a
//! link without a network.

use std::ops::Deref;
use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::header::{Header, Revision};
use muster_model::roster::{Roster, RosterEntry};
use muster_model::teams::{RobotTeam, Teams};

/// How many gets a reader that receives nothing sends within
/// [`Config::stale_after`](crate::Config::stale_after): one reply may be lost before anything is stale.
pub(crate) const GETS_BEFORE_STALE: u32 = 2;

/// Why the newest message may not be valid any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Staleness {
    /// The link to the router is lost; or it was restored less than
    /// [`Config::stale_after`](crate::Config::stale_after) ago, and nothing newer arrived since.
    LinkLost,
    /// No newer message arrived for longer than [`Config::stale_after`](crate::Config::stale_after).
    Silent,
    /// Only messages with lower revisions arrive: the services started again without their state. The
    /// newest of these replaces the value once they, and nothing newer, have arrived for
    /// [`Config::stale_after`](crate::Config::stale_after).
    Restarted,
}

/// The newest message of a stream. It is never withdrawn, only marked stale.
#[derive(Debug)]
pub struct Latest<T> {
    /// The content of the message.
    pub value: Arc<T>,
    /// Why it may not be valid any more; none while it is. The first message may be the reply of another service that has
    /// kept it: where its publisher has ended, it is marked only once
    /// [`Config::stale_after`](crate::Config::stale_after) has passed in silence.
    pub stale: Option<Staleness>,
    /// When it last arrived from its publisher, or was first received.
    pub received: Instant,
}

impl<T> Clone for Latest<T> {
    fn clone(&self) -> Self {
        Self { value: Arc::clone(&self.value), stale: self.stale, received: self.received }
    }
}

impl<T> Deref for Latest<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> Latest<T> {
    /// Whether it may not be valid any more.
    #[must_use]
    pub const fn is_stale(&self) -> bool {
        self.stale.is_some()
    }
}

/// A message that its service publishes again and again, each time with a higher revision.
pub trait Publication: Send + Sync + 'static {
    /// The head of the message.
    fn header(&self) -> &Header;

    /// Whether another message has the same content, whatever its revision.
    fn same_content(&self, other: &Self) -> bool;
}

impl Publication for RobotTeam {
    fn header(&self) -> &Header {
        &self.header
    }

    fn same_content(&self, other: &Self) -> bool {
        self.team == other.team && self.leader == other.leader && self.members == other.members
    }
}

impl Publication for Teams {
    fn header(&self) -> &Header {
        &self.header
    }

    fn same_content(&self, other: &Self) -> bool {
        self.same_division(other)
    }
}

impl Publication for Audit {
    fn header(&self) -> &Header {
        &self.header
    }

    fn same_content(&self, other: &Self) -> bool {
        self.quality == other.quality
            && self.in_embedding == other.in_embedding
            && self.in_physical == other.in_physical
            && self.flapping == other.flapping
            && self.per_team == other.per_team
            && self.losses == other.losses
    }
}

impl Publication for Alerts {
    fn header(&self) -> &Header {
        &self.header
    }

    fn same_content(&self, other: &Self) -> bool {
        self.open == other.open
    }
}

impl Publication for Roster {
    fn header(&self) -> &Header {
        &self.header
    }

    fn same_content(&self, other: &Self) -> bool {
        // `last_seen` changes with every message of a robot.
        let same = |(left, right): (&RosterEntry, &RosterEntry)| {
            *left == RosterEntry { last_seen: left.last_seen, ..right.clone() }
        };
        self.robots.len() == other.robots.len() && self.robots.iter().zip(&other.robots).all(same)
    }
}

/// How a message came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Via {
    /// The publisher put it, so that it is valid now.
    Put,
    /// It is the reply to a get, perhaps from the cache of a reader.
    Reply,
}

/// Messages with lower revisions that arrive while nothing newer does.
#[derive(Debug, Clone, Copy)]
struct Lower {
    highest: Revision,
    /// When the first and the last of them arrived; each had a higher revision than the one before.
    since: Instant,
    last: Instant,
}

/// Keeps the newest message of a stream, and decides whether it is stale.
///
/// [`Watch`](crate::Watch) joins it to a session. Alone it is for those who bring the messages in another way, such as a
/// simulation: they pass on what arrives and when, and send a get when one is due.
#[derive(Debug)]
pub struct Freshness<T> {
    stale_after: Duration,
    /// Since when the link is there; none while it is lost.
    linked_since: Option<Instant>,
    latest: Option<Latest<T>>,
    lower: Option<Lower>,
    /// When the next get is due; at once if it has passed.
    get_at: Instant,
}

impl<T: Publication> Freshness<T> {
    /// Without a message. `stale_after` is how long silence may last, `linked` whether there is a link.
    #[must_use]
    pub fn new(now: Instant, stale_after: Duration, linked: bool) -> Self {
        let linked_since = linked.then_some(now);
        Self { stale_after, linked_since, latest: None, lower: None, get_at: now }
    }

    /// The newest message.
    #[must_use]
    pub fn latest(&self) -> Option<&Latest<T>> {
        self.latest.as_ref()
    }

    fn get_every(&self) -> Duration {
        self.stale_after / GETS_BEFORE_STALE
    }

    /// Receives a message. True if that changes the content or whether it is stale.
    pub fn receive(&mut self, now: Instant, value: T, via: Via) -> bool {
        let revision = value.header().revision;
        let stale = self.linked_since.is_none().then_some(Staleness::LinkLost);
        let Some(latest) = &mut self.latest else {
            self.replace(now, value, stale);
            return true;
        };
        let newest = latest.value.header().revision;
        if revision == newest {
            if via == Via::Reply || stale.is_some() {
                return false;
            }
            // Only the publisher puts it: it is valid.
            self.get_at = now + self.stale_after / GETS_BEFORE_STALE;
            self.lower = None;
            latest.received = now;
            return latest.stale.take().is_some();
        }
        if revision < newest && !self.is_restart(now, revision) {
            return self.mark_restarted();
        }
        let Some(latest) = &self.latest else { return false };
        let changed = latest.stale != stale || !latest.value.same_content(&value);
        self.replace(now, value, stale);
        changed
    }

    fn replace(&mut self, now: Instant, value: T, stale: Option<Staleness>) {
        self.latest = Some(Latest { value: Arc::new(value), stale, received: now });
        self.lower = None;
        self.get_at = now + self.get_every();
    }

    /// Whether a lower revision is that of services that started again, rather than an old message.
    /// Revisions start again when every service was lost at once with its state. Then nothing newer
    /// than the newest message arrives for `stale_after`, and lower revisions keep rising for as long.
    fn is_restart(&mut self, now: Instant, revision: Revision) -> bool {
        if self.linked_since.is_none() {
            return false;
        }
        let stale = self.latest.as_ref().is_some_and(Latest::is_stale);
        match &mut self.lower {
            Some(lower) if revision > lower.highest => {
                lower.highest = revision;
                lower.last = now;
                stale && now.saturating_duration_since(lower.since) >= self.stale_after
            }
            Some(_) => false,
            None => {
                self.lower = Some(Lower { highest: revision, since: now, last: now });
                false
            }
        }
    }

    /// Notices that services restarted, once two lower revisions arrived. True if that is new.
    fn mark_restarted(&mut self) -> bool {
        let rising = self.lower.is_some_and(|lower| lower.last > lower.since);
        match &mut self.latest {
            Some(latest)
                if rising && !matches!(latest.stale, None | Some(Staleness::Restarted)) =>
            {
                latest.stale = Some(Staleness::Restarted);
                true
            }
            _ => false,
        }
    }

    /// The link is lost or restored. True if that makes the newest message stale.
    pub fn set_link(&mut self, now: Instant, linked: bool) -> bool {
        self.linked_since = linked.then_some(now);
        self.lower = None;
        self.get_at = now;
        match &mut self.latest {
            Some(latest) if !linked && latest.stale != Some(Staleness::LinkLost) => {
                latest.stale = Some(Staleness::LinkLost);
                true
            }
            _ => false,
        }
    }

    /// Time has passed. True if that changes whether the newest message is stale, or why.
    pub fn advance(&mut self, now: Instant) -> bool {
        if self.lower_ends_at().is_some_and(|at| now >= at) {
            self.lower = None;
        }
        let restarting = self.lower.is_some();
        let is_silent = self.silent_at().is_some_and(|at| now >= at);
        let Some(latest) = &mut self.latest else { return false };
        if is_silent || latest.stale == Some(Staleness::Restarted) && !restarting {
            latest.stale = Some(Staleness::Silent);
            return true;
        }
        false
    }

    /// Whether a get is due now; counts as sent.
    pub fn take_get(&mut self, now: Instant) -> bool {
        let due = self.linked_since.is_some() && now >= self.get_at;
        if due {
            self.get_at = now + self.get_every();
        }
        due
    }

    /// When silence becomes the reason why the newest message is stale.
    fn silent_at(&self) -> Option<Instant> {
        let since = match self.latest.as_ref()? {
            Latest { stale: None, received, .. } => *received,
            Latest { stale: Some(Staleness::LinkLost), .. } => self.linked_since?,
            Latest { stale: Some(_), .. } => return None,
        };
        Some(since + self.stale_after)
    }

    /// When lower revisions that stopped rising count as old messages.
    fn lower_ends_at(&self) -> Option<Instant> {
        self.lower.map(|lower| lower.last + self.stale_after)
    }

    /// When [`Freshness::advance`] or [`Freshness::take_get`] has something to do next.
    pub(crate) fn deadline(&self) -> Option<Instant> {
        let get_at = self.linked_since.map(|_| self.get_at);
        [self.silent_at(), self.lower_ends_at(), get_at].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests {
    use muster_model::id::{FleetId, RobotId, TeamId};

    use super::*;

    const STALE: Duration = Duration::from_secs(4);
    const SECOND: Duration = Duration::from_secs(1);

    fn message(term: u64, epoch: u64, team: u64) -> RobotTeam {
        let robot = RobotId::new("r1").unwrap();
        RobotTeam {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: Revision { term, epoch },
                oldest: None,
                newest: None,
                stages: vec![],
            },
            robot: robot.clone(),
            team: Some(TeamId::numbered(team)),
            members: Some(vec![robot.clone()]),
            leader: Some(robot),
            confidence: 0.5,
        }
    }

    fn fresh(now: Instant) -> Freshness<RobotTeam> {
        let mut freshness = Freshness::new(now, STALE, true);
        assert!(freshness.receive(now, message(2, 5, 1), Via::Put));
        freshness
    }

    fn team(freshness: &Freshness<RobotTeam>) -> (u64, Option<Staleness>) {
        let latest = freshness.latest().unwrap();
        (latest.header.revision.epoch, latest.stale)
    }

    #[test]
    fn older_revisions_are_dropped_and_repetitions_are_quiet() {
        let now = Instant::now();
        let mut freshness = fresh(now);
        for (term, epoch) in [(2, 4), (1, 99), (2, 5)] {
            assert!(!freshness.receive(now, message(term, epoch, 9), Via::Put));
            assert_eq!(team(&freshness), (5, None));
        }
        assert!(!freshness.receive(now, message(2, 6, 1), Via::Put), "the same team is no change");
        assert_eq!(team(&freshness), (6, None));
        assert!(freshness.receive(now, message(3, 1, 2), Via::Reply));
        assert_eq!(team(&freshness), (1, None));
    }

    #[test]
    fn a_lost_link_marks_stale_at_once_and_only_newer_messages_freshen() {
        let now = Instant::now();
        let mut freshness = fresh(now);
        assert!(freshness.set_link(now, false));
        assert_eq!(team(&freshness), (5, Some(Staleness::LinkLost)));
        assert_eq!(freshness.deadline(), None, "nothing to do until it is back");
        // A message that was under way arrives late: it is newer, and stale all the same.
        assert!(!freshness.receive(now, message(2, 6, 1), Via::Put));
        assert_eq!(team(&freshness), (6, Some(Staleness::LinkLost)));
        let back = now + 10 * SECOND;
        assert!(!freshness.set_link(back, true));
        assert!(freshness.take_get(back), "a get is due at once");
        assert!(!freshness.take_get(back));
        assert!(!freshness.receive(back, message(2, 6, 1), Via::Reply), "a cache proves nothing");
        assert_eq!(team(&freshness), (6, Some(Staleness::LinkLost)));
        assert!(freshness.receive(back, message(2, 7, 1), Via::Reply));
        assert_eq!(team(&freshness), (7, None));
    }

    #[test]
    fn a_restored_link_without_a_message_turns_into_silence() {
        let now = Instant::now();
        let mut freshness = fresh(now);
        freshness.set_link(now + SECOND, false);
        assert!(!freshness.advance(now + 100 * SECOND), "no link, whatever time passes");
        let back = now + 100 * SECOND;
        freshness.set_link(back, true);
        assert!(!freshness.advance(back + STALE - SECOND / 10));
        assert!(freshness.advance(back + STALE));
        assert_eq!(team(&freshness), (5, Some(Staleness::Silent)));
    }

    #[test]
    fn silence_marks_stale_after_its_time_and_the_publisher_freshens() {
        let now = Instant::now();
        let mut freshness = fresh(now);
        assert!(!freshness.advance(now + STALE - SECOND / 10));
        assert!(freshness.advance(now + STALE));
        assert!(!freshness.advance(now + STALE + SECOND), "that is reported once");
        assert_eq!(team(&freshness), (5, Some(Staleness::Silent)));
        assert!(!freshness.receive(now + 5 * SECOND, message(2, 5, 1), Via::Reply));
        assert!(freshness.receive(now + 5 * SECOND, message(2, 5, 1), Via::Put));
        assert_eq!(team(&freshness), (5, None));
    }

    #[test]
    fn gets_are_sent_at_a_bounded_pace() {
        let start = Instant::now();
        let mut freshness = fresh(start);
        let mut sent = 0;
        let mut now = start;
        for _ in 0..1000 {
            let Some(deadline) = freshness.deadline() else { break };
            assert!(deadline > now || sent == 0, "no busy loop");
            now = now.max(deadline);
            if now > start + 20 * SECOND {
                break;
            }
            freshness.advance(now);
            sent += u32::from(freshness.take_get(now));
        }
        assert_eq!(sent, 10, "twice in the four seconds that make stale");
    }

    #[test]
    fn services_that_restart_with_lower_terms_are_followed_after_a_while() {
        let now = Instant::now();
        let stale = now + STALE;
        let mut freshness = fresh(now);
        assert!(freshness.advance(stale));
        let mut changes = Vec::new();
        for tick in 0..10 {
            let at = stale + tick * SECOND;
            if freshness.receive(at, message(1, 10 + u64::from(tick), 3), Via::Put) {
                changes.push((tick, team(&freshness)));
            }
        }
        let why = (1, (5, Some(Staleness::Restarted)));
        assert_eq!(changes, [why, (4, (14, None))], "the reason first, then the new messages");
        assert_eq!(team(&freshness), (19, None));
    }

    /// The services are back before their silence is noticed.
    #[test]
    fn lower_terms_count_from_their_first_message_on_and_only_while_nothing_newer_comes() {
        let now = Instant::now();
        let mut freshness = fresh(now);
        for tick in 1..=3 {
            let lower = message(1, u64::from(tick), 3);
            assert!(!freshness.receive(now + tick * SECOND, lower, Via::Put), "it is still fresh");
        }
        assert!(freshness.advance(now + STALE));
        assert!(freshness.receive(now + STALE, message(1, 4, 3), Via::Put));
        assert_eq!(team(&freshness), (5, Some(Staleness::Restarted)));
        assert!(freshness.receive(now + 5 * SECOND, message(1, 5, 3), Via::Put));
        assert_eq!(team(&freshness), (5, None));
        assert_eq!(freshness.latest().unwrap().header.revision.term, 1);
        // As long as the newer ones come as well, those are believed.
        let mut freshness = fresh(now);
        for tick in 1..=20 {
            let at = now + tick * SECOND;
            freshness.receive(at, message(1, u64::from(tick), 3), Via::Put);
            freshness.receive(at, message(2, 5 + u64::from(tick), 5), Via::Put);
            freshness.advance(at);
            assert_eq!(team(&freshness).1, None);
            assert_eq!(freshness.latest().unwrap().header.revision.term, 2);
        }
    }

    /// The documentation promises `stale_after` and one heartbeat from the start of the services on.
    #[test]
    fn a_restart_is_followed_within_the_documented_time_whenever_it_happens() {
        for (heartbeat, downtime) in [(1, 0), (1, 2), (2, 3), (1, 30)] {
            let last = Instant::now();
            let mut freshness = fresh(last);
            let (started, heartbeat) = (last + downtime * SECOND, heartbeat * SECOND);
            let promised = STALE + heartbeat;
            let mut epoch = 0;
            let mut at = started;
            while freshness.latest().unwrap().header.revision.term == 2 {
                assert!(at <= started + promised, "{heartbeat:?} {downtime}: {freshness:?}");
                while let Some(due) = freshness.deadline().filter(|due| *due <= at) {
                    freshness.advance(due);
                    freshness.take_get(due);
                }
                epoch += 1;
                freshness.receive(at, message(1, epoch, 3), Via::Put);
                at += heartbeat;
            }
            assert_eq!(freshness.latest().unwrap().stale, None);
        }
    }

    #[test]
    fn old_messages_are_never_taken_for_a_restart() {
        let now = Instant::now();
        let stale = now + STALE;
        // The same message again and again does not rise.
        let mut freshness = fresh(now);
        freshness.advance(stale);
        for tick in 0..100 {
            assert!(!freshness.receive(stale + tick * SECOND, message(1, 7, 3), Via::Put));
        }
        // A few late messages stop rising, and others that come much later do not continue them.
        let mut freshness = fresh(now);
        freshness.advance(stale);
        freshness.receive(stale, message(1, 7, 3), Via::Put);
        assert!(freshness.receive(stale + SECOND, message(1, 8, 3), Via::Put));
        assert_eq!(team(&freshness), (5, Some(Staleness::Restarted)));
        assert_eq!(freshness.lower_ends_at(), Some(stale + SECOND + STALE));
        assert!(freshness.advance(stale + SECOND + STALE), "that was none");
        assert_eq!(team(&freshness), (5, Some(Staleness::Silent)));
        assert!(!freshness.receive(stale + 20 * SECOND, message(1, 9, 3), Via::Put));
        assert_eq!(team(&freshness), (5, Some(Staleness::Silent)));
        // A link that is lost starts the count again.
        freshness.set_link(stale + 21 * SECOND, false);
        assert!(!freshness.receive(stale + 60 * SECOND, message(1, 10, 3), Via::Put));
        assert_eq!(team(&freshness), (5, Some(Staleness::LinkLost)));
    }
}
