//! Messages that are refused: all are counted, and told of at a bounded rate.

use std::time::Duration;

use muster_model::event::{EventKind, Severity};
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::{Key, Rejection};

use super::Role;
use crate::core::Effects;

/// How long refused messages of one robot and key are only counted after one was told of: an
/// offender must not flood the event stream.
const QUARANTINE_SILENCE: Duration = Duration::from_secs(2);

/// How many robots and keys are watched for such repetition at once; beyond it, further offenders
/// are counted and not told of until others have been silent.
const MAX_OFFENDERS: usize = 256;

#[derive(Debug, Clone)]
pub(super) struct Offender {
    told: Tick,
    untold: u64,
}

impl<S: Settings> Role<S> {
    /// How many senders of refused messages are watched for repetition.
    #[must_use]
    pub fn offender_count(&self) -> usize {
        self.offenders.len()
    }

    /// Refuses the content of a message, as [`Role::quarantine`] does.
    pub fn refuse<J>(&mut self, now: Tick, key: &Key, reason: &str, effects: &mut Effects<J>) {
        let rejection = Rejection::new(&self.space, &self.space.format(key), reason);
        self.quarantine(now, rejection, effects);
    }

    /// Counts a refused message, and tells of it unless the term has not begun or its robot and key
    /// have just been told of.
    pub fn quarantine<J>(&mut self, now: Tick, rejection: Rejection, effects: &mut Effects<J>) {
        self.count("messages_refused");
        if !self.has_term() {
            return;
        }
        let Rejection { robot, key, reason } = rejection;
        let offence = (robot.clone(), key.clone());
        if let Some(offender) = self.offenders.get_mut(&offence) {
            offender.untold += 1;
            if now.since(offender.told) < QUARANTINE_SILENCE {
                return;
            }
        } else {
            if self.offenders.len() >= MAX_OFFENDERS {
                self.offenders.retain(|_, offender| now.since(offender.told) < QUARANTINE_SILENCE);
            }
            if self.offenders.len() >= MAX_OFFENDERS {
                return;
            }
            self.offenders.insert(offence.clone(), Offender { told: now, untold: 1 });
        }
        let Some(offender) = self.offenders.get_mut(&offence) else { return };
        offender.told = now;
        let count = std::mem::take(&mut offender.untold);
        let kind = EventKind::Quarantined { robot, key, reason, count };
        self.tell(now, Severity::Warning, kind, effects);
    }
}
