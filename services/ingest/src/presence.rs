//! What is reported of robots that fall silent, recover and leave: one event for those that do so within a
//! moment, and who has left within the last hour.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use muster_model::event::{EventKind, Severity};
use muster_model::id::RobotId;
use muster_model::limits::{MAX_DEPARTED_ROBOTS, MAX_ROBOTS_OF_EVENT};
use muster_model::status::Departure;
use muster_model::time::Tick;

use crate::robot::Transition;

/// How long an event waits for other robots that are about to change in the same way. Robots that are lost
/// with one link have put their last poses within one period of each other, which is rarely longer.
pub(crate) const GATHERING_WINDOW: Duration = Duration::from_millis(500);

/// How long a robot that has left is remembered: an operator who comes back from a break still sees it.
const DEPARTED_FOR: Duration = Duration::from_secs(3600);

/// Changes of presence that no event has reported yet.
#[derive(Debug, Default)]
pub(crate) struct PresenceEvents {
    waiting: BTreeMap<Transition, BTreeSet<RobotId>>,
    due: Option<Tick>,
}

impl PresenceEvents {
    /// Adds a change. With `more` other robots may follow within the window, and the event waits for them.
    pub(crate) fn add(&mut self, now: Tick, robot: RobotId, transition: Transition, more: bool) {
        self.waiting.entry(transition).or_default().insert(robot);
        let due = if more { now.after(GATHERING_WINDOW) } else { now };
        self.due = Some(self.due.map_or(due, |before| before.min(due)));
    }

    /// Takes back, with `take_back`, that robots fell silent of which no event was published yet; where it
    /// answers that there was nothing to be taken back, their event stays.
    pub(crate) fn take_stale_back(&mut self, mut take_back: impl FnMut(&RobotId) -> bool) {
        if let Some(stale) = self.waiting.get_mut(&Transition::Stale) {
            stale.retain(|robot| !take_back(robot));
        }
        self.waiting.retain(|_, robots| !robots.is_empty());
        self.due = self.due.filter(|_| !self.waiting.is_empty());
    }

    /// Lets what waits be due where a robot is among those that have left: it joins again, and events are read in order.
    pub(crate) fn hasten(&mut self, now: Tick, robot: &RobotId) {
        if self.waiting.get(&Transition::Left).is_some_and(|left| left.contains(robot)) {
            self.due = Some(now);
        }
    }

    /// When the next events are due.
    pub(crate) fn due(&self) -> Option<Tick> {
        self.due
    }

    /// The events that are due: at most one for each kind of change.
    pub(crate) fn take(&mut self, now: Tick) -> Vec<(Severity, EventKind)> {
        if self.due.is_none_or(|due| due > now) {
            return Vec::new();
        }
        self.due = None;
        let waiting = std::mem::take(&mut self.waiting);
        waiting.into_iter().map(|(transition, robots)| event(transition, robots)).collect()
    }
}

fn event(transition: Transition, robots: BTreeSet<RobotId>) -> (Severity, EventKind) {
    let severity = match transition {
        Transition::Stale | Transition::Left => Severity::Warning,
        Transition::Recovered => Severity::Info,
    };
    let count = u32::try_from(robots.len()).unwrap_or(u32::MAX);
    let mut robots: Vec<_> = robots.into_iter().take(MAX_ROBOTS_OF_EVENT).collect();
    let single = if count == 1 { robots.pop() } else { None };
    let kind = match (transition, single) {
        (Transition::Stale, Some(robot)) => EventKind::RobotStale { robot },
        (Transition::Stale, None) => EventKind::RobotsStale { count, robots },
        (Transition::Recovered, Some(robot)) => EventKind::RobotRecovered { robot },
        (Transition::Recovered, None) => EventKind::RobotsRecovered { count, robots },
        (Transition::Left, Some(robot)) => EventKind::RobotLeft { robot },
        (Transition::Left, None) => EventKind::RobotsLeft { count, robots },
    };
    (severity, kind)
}

/// Who has left, the last one first; never more than a status lists.
#[derive(Debug, Default)]
pub(crate) struct Departures(VecDeque<Departure>);

impl Departures {
    /// A robot has left.
    pub(crate) fn left(&mut self, now: Tick, robot: RobotId) {
        self.returned(&robot);
        self.0.push_front(Departure { robot, left: now });
        self.0.truncate(MAX_DEPARTED_ROBOTS);
    }

    /// A robot has joined.
    pub(crate) fn returned(&mut self, robot: &RobotId) {
        self.0.retain(|departure| departure.robot != *robot);
    }

    /// Those that have left within the last hour.
    pub(crate) fn recent(&self, now: Tick) -> Vec<Departure> {
        let is_recent = |departure: &&Departure| now.since(departure.left) < DEPARTED_FOR;
        self.0.iter().take_while(is_recent).cloned().collect()
    }

    /// How many are remembered.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Tick = Tick(1_000_000_000_000);

    fn robot(number: usize) -> RobotId {
        RobotId::new(format!("r{number:04}")).unwrap()
    }

    #[test]
    fn robots_that_are_lost_together_are_one_event_with_a_bounded_list() {
        let mut events = PresenceEvents::default();
        for number in 0..500 {
            events.add(NOW, robot(number), Transition::Left, true);
        }
        let due = NOW.after(GATHERING_WINDOW);
        assert_eq!(events.due(), Some(due));
        assert!(events.take(NOW).is_empty());
        let taken = events.take(due);
        let [(Severity::Warning, EventKind::RobotsLeft { count: 500, robots })] = taken.as_slice()
        else {
            panic!("{taken:?}");
        };
        assert_eq!(robots.len(), MAX_ROBOTS_OF_EVENT);
        assert_eq!((events.due(), events.take(due)), (None, Vec::new()));
    }

    #[test]
    fn a_robot_that_is_lost_alone_is_reported_at_once_under_its_own_name() {
        let mut events = PresenceEvents::default();
        events.add(NOW, robot(1), Transition::Stale, false);
        let alone = EventKind::RobotStale { robot: robot(1) };
        assert_eq!(events.take(NOW), [(Severity::Warning, alone)]);
    }

    #[test]
    fn a_robot_that_returns_is_reported_as_gone_before() {
        let mut events = PresenceEvents::default();
        events.add(NOW, robot(1), Transition::Left, true);
        events.hasten(NOW, &robot(2));
        assert!(events.take(NOW).is_empty());
        events.hasten(NOW, &robot(1));
        let gone = EventKind::RobotLeft { robot: robot(1) };
        assert_eq!(events.take(NOW), [(Severity::Warning, gone)]);
    }

    #[test]
    fn departures_are_bounded_in_number_and_time_and_end_with_a_return() {
        let mut departures = Departures::default();
        for number in 0..1000 {
            departures.left(NOW, robot(number));
        }
        assert_eq!(departures.len(), MAX_DEPARTED_ROBOTS);
        let last = departures.recent(NOW);
        assert_eq!((last.len(), &last[0].robot), (MAX_DEPARTED_ROBOTS, &robot(999)));
        departures.returned(&robot(999));
        assert_eq!(departures.recent(NOW)[0].robot, robot(998));
        let later = NOW.after(DEPARTED_FOR);
        departures.left(later, robot(1));
        assert_eq!(departures.recent(later).len(), 1);
    }
}
