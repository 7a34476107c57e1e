//! What was told last: the newest is kept, and known to be fresh or stale.
//!
//! This is a pure state machine over moments that it is given, so that all that can happen to a link
//! is tested without one.

use std::ops::Deref;
use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_model::audit::Audit;
use muster_model::header::{Header, Revision};
use muster_model::teams::{RobotTeam, Teams};

/// How many times in [`Config::stale_after`](crate::Config::stale_after) somebody who hears nothing
/// asks: one answer may be lost before anything counts as stale.
pub(crate) const ASKS: u32 = 2;

/// Why what was told last may not hold any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Staleness {
    /// The link to the router is lost.
    LinkLost,
    /// Nothing newer was told for longer than [`Config::stale_after`](crate::Config::stale_after).
    Silent,
}

/// What was told last. It is never withdrawn, only marked stale.
#[derive(Debug)]
pub struct Latest<T> {
    /// What was told.
    pub value: Arc<T>,
    /// Why it may not hold any more; none while it does.
    pub stale: Option<Staleness>,
    /// When it was last told, or confirmed.
    pub told: Instant,
}

impl<T> Clone for Latest<T> {
    fn clone(&self) -> Self {
        Self { value: Arc::clone(&self.value), stale: self.stale, told: self.told }
    }
}

impl<T> Deref for Latest<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> Latest<T> {
    /// Whether it may not hold any more.
    #[must_use]
    pub const fn is_stale(&self) -> bool {
        self.stale.is_some()
    }
}

/// What services tell over and over, each time with a later revision.
pub trait Telling: Send + Sync + 'static {
    /// The head of the message.
    fn header(&self) -> &Header;

    /// Whether another message tells the same, however much later.
    fn tells_the_same(&self, other: &Self) -> bool;
}

impl Telling for RobotTeam {
    fn header(&self) -> &Header {
        &self.header
    }

    fn tells_the_same(&self, other: &Self) -> bool {
        self.team == other.team && self.leader == other.leader && self.members == other.members
    }
}

impl Telling for Teams {
    fn header(&self) -> &Header {
        &self.header
    }

    fn tells_the_same(&self, other: &Self) -> bool {
        self.same_division(other)
    }
}

impl Telling for Audit {
    fn header(&self) -> &Header {
        &self.header
    }

    fn tells_the_same(&self, other: &Self) -> bool {
        self.verdict == other.verdict
            && self.in_embedding == other.in_embedding
            && self.in_physical == other.in_physical
    }
}

/// How something came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    /// Its author put it, so that it holds now.
    Put,
    /// It answers a question, perhaps from the memory of others.
    Answer,
}

/// Keeps what was told last.
#[derive(Debug)]
pub(crate) struct Keeper<T> {
    stale_after: Duration,
    linked: bool,
    latest: Option<Latest<T>>,
    /// The highest of the lower revisions that are told while nobody tells a newer one, and since
    /// when that has gone on.
    lower: Option<(Revision, Instant)>,
    /// When the next question is due; at once if it has passed.
    ask_at: Instant,
}

impl<T: Telling> Keeper<T> {
    pub(crate) fn new(now: Instant, stale_after: Duration, linked: bool) -> Self {
        Self { stale_after, linked, latest: None, lower: None, ask_at: now }
    }

    pub(crate) fn latest(&self) -> Option<&Latest<T>> {
        self.latest.as_ref()
    }

    fn ask_every(&self) -> Duration {
        self.stale_after / ASKS
    }

    /// Takes in what is told. True if the caller would want to know of it.
    pub(crate) fn told(&mut self, now: Instant, value: T, way: Way) -> bool {
        let revision = value.header().revision;
        let stale = (!self.linked).then_some(Staleness::LinkLost);
        let Some(latest) = &mut self.latest else {
            self.replace(now, value, stale);
            return true;
        };
        let last = latest.value.header().revision;
        if revision == last {
            if way == Way::Answer || stale.is_some() {
                return false;
            }
            // Its author says it again, and nobody else puts it: it holds.
            self.ask_at = now + self.stale_after / ASKS;
            latest.told = now;
            return latest.stale.take().is_some();
        }
        if revision < last && !self.begins_anew(now, revision) {
            return false;
        }
        let Some(latest) = &self.latest else { return false };
        let changed = latest.stale != stale || !latest.value.tells_the_same(&value);
        self.replace(now, value, stale);
        changed
    }

    fn replace(&mut self, now: Instant, value: T, stale: Option<Staleness>) {
        self.latest = Some(Latest { value: Arc::new(value), stale, told: now });
        self.lower = None;
        self.ask_at = now + self.ask_every();
    }

    /// Whether a lower revision is a new beginning rather than an old message. Revisions begin anew
    /// when every service and router was lost at once. Then nobody tells anything newer than what is
    /// kept, and lower revisions go on rising for as long as makes a message stale.
    fn begins_anew(&mut self, now: Instant, revision: Revision) -> bool {
        let silent = self.latest.as_ref().is_some_and(Latest::is_stale);
        if !self.linked || !silent {
            return false;
        }
        match &mut self.lower {
            None => self.lower = Some((revision, now)),
            Some((highest, since)) if revision > *highest => {
                if now.saturating_duration_since(*since) >= self.stale_after {
                    return true;
                }
                *highest = revision;
            }
            Some(_) => {}
        }
        false
    }

    /// The link is lost or back. True if that makes what was told stale.
    pub(crate) fn link(&mut self, now: Instant, linked: bool) -> bool {
        self.linked = linked;
        self.lower = None;
        self.ask_at = now;
        match &mut self.latest {
            Some(latest) if !linked && latest.stale != Some(Staleness::LinkLost) => {
                latest.stale = Some(Staleness::LinkLost);
                true
            }
            _ => false,
        }
    }

    /// Time has passed. True if that makes what was told stale.
    pub(crate) fn pass(&mut self, now: Instant) -> bool {
        let is_silent = self.silent_at().is_some_and(|at| now >= at);
        if let Some(latest) = self.latest.as_mut().filter(|_| is_silent) {
            latest.stale = Some(Staleness::Silent);
        }
        is_silent
    }

    /// Whether somebody should be asked now; counts as asked.
    pub(crate) fn asks(&mut self, now: Instant) -> bool {
        let due = self.linked && now >= self.ask_at;
        if due {
            self.ask_at = now + self.ask_every();
        }
        due
    }

    fn silent_at(&self) -> Option<Instant> {
        let latest = self.latest.as_ref().filter(|latest| !latest.is_stale())?;
        Some(latest.told + self.stale_after)
    }

    /// When time makes a difference next.
    pub(crate) fn deadline(&self) -> Option<Instant> {
        let ask_at = self.linked.then_some(self.ask_at);
        [self.silent_at(), ask_at].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests {
    use muster_model::id::{FleetId, RobotId, TeamId};

    use super::*;

    const STALE: Duration = Duration::from_secs(4);
    const SECOND: Duration = Duration::from_secs(1);

    fn told(term: u64, epoch: u64, team: u64) -> RobotTeam {
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

    fn keeper(now: Instant) -> Keeper<RobotTeam> {
        let mut keeper = Keeper::new(now, STALE, true);
        assert!(keeper.told(now, told(2, 5, 1), Way::Put));
        keeper
    }

    fn team(keeper: &Keeper<RobotTeam>) -> (u64, Option<Staleness>) {
        let latest = keeper.latest().unwrap();
        (latest.header.revision.epoch, latest.stale)
    }

    #[test]
    fn older_revisions_are_dropped_and_repetitions_are_quiet() {
        let now = Instant::now();
        let mut keeper = keeper(now);
        for (term, epoch) in [(2, 4), (1, 99), (2, 5)] {
            assert!(!keeper.told(now, told(term, epoch, 9), Way::Put));
            assert_eq!(team(&keeper), (5, None));
        }
        assert!(!keeper.told(now, told(2, 6, 1), Way::Put), "the same team needs no word");
        assert_eq!(team(&keeper), (6, None));
        assert!(keeper.told(now, told(3, 1, 2), Way::Answer));
        assert_eq!(team(&keeper), (1, None));
    }

    #[test]
    fn a_lost_link_marks_stale_at_once_and_only_newer_words_freshen() {
        let now = Instant::now();
        let mut keeper = keeper(now);
        assert!(keeper.link(now, false));
        assert_eq!(team(&keeper), (5, Some(Staleness::LinkLost)));
        assert_eq!(keeper.deadline(), None, "nothing to do until it is back");
        // What was under way comes late: it is newer, and still nobody vouches for it.
        assert!(!keeper.told(now, told(2, 6, 1), Way::Put));
        assert_eq!(team(&keeper), (6, Some(Staleness::LinkLost)));
        let back = now + 10 * SECOND;
        assert!(!keeper.link(back, true));
        assert!(keeper.asks(back), "whoever comes back asks at once");
        assert!(!keeper.asks(back));
        assert!(!keeper.told(back, told(2, 6, 1), Way::Answer), "a memory vouches for nothing");
        assert_eq!(team(&keeper), (6, Some(Staleness::LinkLost)));
        assert!(keeper.told(back, told(2, 7, 1), Way::Answer));
        assert_eq!(team(&keeper), (7, None));
    }

    #[test]
    fn silence_marks_stale_after_its_time_and_its_author_freshens() {
        let now = Instant::now();
        let mut keeper = keeper(now);
        assert!(!keeper.pass(now + STALE - SECOND / 10));
        assert!(keeper.pass(now + STALE));
        assert!(!keeper.pass(now + STALE + SECOND), "that is told once");
        assert_eq!(team(&keeper), (5, Some(Staleness::Silent)));
        assert!(!keeper.told(now + 5 * SECOND, told(2, 5, 1), Way::Answer));
        assert!(keeper.told(now + 5 * SECOND, told(2, 5, 1), Way::Put));
        assert_eq!(team(&keeper), (5, None));
    }

    #[test]
    fn questions_are_asked_at_a_bounded_pace() {
        let start = Instant::now();
        let mut keeper = keeper(start);
        let mut asked = 0;
        let mut now = start;
        for _ in 0..1000 {
            let Some(deadline) = keeper.deadline() else { break };
            assert!(deadline > now || asked == 0, "no busy loop");
            now = now.max(deadline);
            if now > start + 20 * SECOND {
                break;
            }
            keeper.pass(now);
            asked += u32::from(keeper.asks(now));
        }
        assert_eq!(asked, 10, "twice in the four seconds that make stale");
    }

    #[test]
    fn a_fleet_that_began_anew_is_believed_after_a_while_and_a_late_message_never() {
        let now = Instant::now();
        let mut keeper = keeper(now);
        assert!(!keeper.told(now + SECOND, told(1, 1, 3), Way::Put), "something newer is fresh");
        let stale = now + STALE;
        assert!(keeper.pass(stale));
        let mut accepted = None;
        for tick in 0..10 {
            let at = stale + tick * SECOND;
            if keeper.told(at, told(1, 10 + u64::from(tick), 3), Way::Put) {
                accepted.get_or_insert(tick);
            }
        }
        assert_eq!(accepted, Some(4), "after as long as makes stale");
        assert_eq!(team(&keeper), (19, None));

        let mut keeper = self::keeper(now);
        keeper.pass(stale);
        for tick in 0..100 {
            assert!(
                !keeper.told(stale + tick * SECOND, told(1, 7, 3), Way::Put),
                "it does not rise"
            );
        }
    }
}
