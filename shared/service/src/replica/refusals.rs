//! Refused messages: all are counted, and reported at a bounded rate.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::id::RobotId;
use muster_model::time::Tick;
use muster_wire::Rejection;

/// How long refused messages of one robot and key are only counted after one was reported: an
/// offender must not flood the event stream.
const REPORT_INTERVAL: Duration = Duration::from_secs(2);

/// Most robots and keys that are watched for repetition at once. Further offenders are counted and
/// not reported until others have been silent.
const MAX_OFFENDERS: usize = 256;

/// Most keys of one robot of which refusals are reported within that time: more than its streams and some
/// misspelt ones. One robot must neither fill the list of offenders nor its own key.
const MAX_REPORTED_KEYS_OF_ROBOT: usize = 8;

#[derive(Debug)]
struct Offender {
    reported: Tick,
    unreported: u64,
}

/// Senders of refused messages.
#[derive(Debug, Default)]
pub(crate) struct Refusals {
    offenders: BTreeMap<(Option<RobotId>, String), Offender>,
}

impl Refusals {
    /// How many senders are watched for repetition.
    pub(crate) fn offender_count(&self) -> usize {
        self.offenders.len()
    }

    /// Counts one refused message; how many of the same robot and key are to be reported now, if any.
    pub(crate) fn add(&mut self, now: Tick, rejection: &Rejection) -> Option<u64> {
        let is_recent = |offender: &Offender| now.since(offender.reported) < REPORT_INTERVAL;
        let key = (rejection.robot.clone(), rejection.key.clone());
        if let Some(offender) = self.offenders.get_mut(&key) {
            offender.unreported += 1;
            if is_recent(offender) {
                return None;
            }
            offender.reported = now;
            return Some(std::mem::take(&mut offender.unreported));
        }
        if self.offenders.len() >= MAX_OFFENDERS {
            self.offenders.retain(|_, offender| is_recent(offender));
        }
        if self.offenders.len() >= MAX_OFFENDERS {
            return None;
        }
        let of_robot = self.offenders.range((key.0.clone(), String::new())..);
        let of_robot = of_robot.take_while(|((robot, _), _)| *robot == key.0);
        let is_noisy = key.0.is_some()
            && of_robot.filter(|(_, offender)| is_recent(offender)).count()
                >= MAX_REPORTED_KEYS_OF_ROBOT;
        if is_noisy {
            return None;
        }
        self.offenders.insert(key, Offender { reported: now, unreported: 0 });
        Some(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rejection(robot: &str, key: usize) -> Rejection {
        Rejection {
            robot: Some(RobotId::new(robot).unwrap()),
            key: format!("{robot}/{key}"),
            reason: "wrong".to_owned(),
        }
    }

    #[test]
    fn a_robot_with_many_wrong_keys_keeps_no_other_from_being_reported() {
        let mut refusals = Refusals::default();
        let now = Tick(1_000_000_000);
        let reported = |refusals: &mut Refusals, now, robot: &str| {
            (0..1000).filter(|key| refusals.add(now, &rejection(robot, *key)).is_some()).count()
        };
        assert_eq!(reported(&mut refusals, now, "r2"), MAX_REPORTED_KEYS_OF_ROBOT);
        assert_eq!(reported(&mut refusals, now, "r1"), MAX_REPORTED_KEYS_OF_ROBOT);
        assert_eq!(refusals.offender_count(), 2 * MAX_REPORTED_KEYS_OF_ROBOT);
        let later = now.after(REPORT_INTERVAL);
        assert!(refusals.add(later, &rejection("r1", 2000)).is_some());
    }
}
