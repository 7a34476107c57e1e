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
        self.offenders.insert(key, Offender { reported: now, unreported: 0 });
        Some(1)
    }
}
