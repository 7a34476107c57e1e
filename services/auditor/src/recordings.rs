//! Whether the history of the fleet is whole, by what every historian publishes of its own.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::alert::AlertSubject;
use muster_model::history::RecordingState;
use muster_model::id::InstanceId;
use muster_model::time::Tick;
use muster_wire::message::plain_reason;

use crate::alerts::{Condition, Wanted};

/// Most historians that are followed: a fleet has one or two, and anybody may say that he is one.
const MAX_RECORDINGS: usize = 16;

/// How long lost records are worth an alert: long enough for a person to see it, as nothing is wrong any more.
const GAP_TIME: Duration = Duration::from_secs(60);

/// One historian.
#[derive(Debug, Clone)]
struct Recording {
    lost: u64,
    degraded: Option<String>,
    /// How many records it has lost at a time, and when.
    gap: Option<(u64, Tick)>,
}

/// The historians of the fleet.
#[derive(Debug, Clone, Default)]
pub(crate) struct Recordings(BTreeMap<InstanceId, Recording>);

impl Recordings {
    /// A historian says how far it goes.
    pub(crate) fn receive(&mut self, now: Tick, state: &RecordingState) {
        if !self.0.contains_key(&state.instance) && self.0.len() >= MAX_RECORDINGS {
            return;
        }
        let degraded = state.degraded.as_deref().map(plain_reason);
        let before = self.0.get(&state.instance);
        // What was lost before this auditor knew of it was for the leader before.
        let more = before.map_or(0, |before| state.lost.saturating_sub(before.lost));
        let gap = if more > 0 { Some((more, now)) } else { before.and_then(|before| before.gap) };
        self.0.insert(state.instance.clone(), Recording { lost: state.lost, degraded, gap });
    }

    /// A historian is gone: its disk does not count until it is back.
    pub(crate) fn gone(&mut self, instance: &InstanceId) {
        self.0.remove(instance);
    }

    /// What is observed of them.
    pub(crate) fn condition(&self, now: Tick) -> Condition {
        let is_recent = |(_, at): &(u64, Tick)| now < at.after(GAP_TIME);
        let mut wrong = self.0.iter().filter_map(|(instance, recording)| {
            let lost = || {
                let (lost, _) = recording.gap.filter(is_recent)?;
                Some(format!("{lost} records were lost"))
            };
            let what = recording.degraded.clone().or_else(lost)?;
            Some(format!("{instance}: {what}"))
        });
        let first = wrong.next();
        let count = u32::from(first.is_some()) + u32::try_from(wrong.count()).unwrap_or(u32::MAX);
        Condition {
            subject: AlertSubject::Fleet,
            wanted: Wanted::of(first.is_some()),
            value: f64::from(count),
            threshold: 1.0,
            reason: first.unwrap_or_default(),
            robots: Vec::new(),
        }
    }

    /// How many are followed.
    pub(crate) fn count(&self) -> usize {
        self.0.len()
    }
}

#[cfg(test)]
mod tests {
    use muster_model::history::Coverage;
    use muster_model::id::FleetId;

    use super::*;

    fn state(instance: &str, lost: u64, degraded: Option<&str>) -> RecordingState {
        RecordingState {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new(instance).unwrap(),
            coverage: Coverage::default(),
            lost,
            degraded: degraded.map(str::to_owned),
        }
    }

    #[test]
    fn a_full_disk_and_a_gap_are_wrong_and_end() {
        let mut all = Recordings::default();
        let now = Tick(1_000_000_000);
        let wrong = |all: &Recordings, now: Tick| {
            let condition = all.condition(now);
            (condition.wanted == Wanted::Raise, condition.value, condition.reason)
        };
        assert_eq!(wrong(&all, now), (false, 0.0, String::new()));
        all.receive(now, &state("h-1", 5, None));
        assert_eq!(wrong(&all, now), (false, 0.0, String::new()), "of the past nothing is known");
        all.receive(now, &state("h-1", 5, Some("the disk is full")));
        all.receive(now, &state("h-2", 0, Some("no folder")));
        assert_eq!(wrong(&all, now), (true, 2.0, "h-1: the disk is full".to_owned()));
        all.gone(&InstanceId::new("h-2").unwrap());
        all.receive(now, &state("h-1", 12, None));
        assert_eq!(wrong(&all, now), (true, 1.0, "h-1: 7 records were lost".to_owned()));
        assert!(!wrong(&all, now.after(GAP_TIME)).0);
    }

    #[test]
    fn no_more_historians_are_followed_than_there_may_be() {
        let mut all = Recordings::default();
        for number in 0..100 {
            all.receive(Tick(1), &state(&format!("h-{number}"), 0, None));
        }
        assert_eq!(all.count(), MAX_RECORDINGS);
    }
}
