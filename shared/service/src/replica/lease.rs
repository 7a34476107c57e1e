//! What a leader does at intervals: it renews its lease, and asks its readers what they have seen.

use std::time::Duration;

use muster_model::header::Revision;
use muster_model::time::Tick;

/// How often a leader renews its lease. Several renewals fit into the lease, so that one lost message
/// changes nothing.
pub const RENEWAL_INTERVAL: Duration = Duration::from_millis(500);

/// How often a leader asks its readers whether they have seen a higher revision than its own, which
/// happens if its start could not reach them: they would drop all that it publishes. As often it
/// announces its settings again: a standby that missed a change would bring the old ones back.
const TERM_CHECK_INTERVAL: Duration = Duration::from_secs(5);

/// How soon it asks again when they have. Another leader that lives goes on meanwhile, and is left
/// alone.
const TERM_RECHECK_DELAY: Duration = Duration::from_secs(1);

/// What a leader does next.
#[derive(Debug, Clone)]
pub(crate) struct Lease {
    renew_at: Tick,
    check_at: Tick,
    /// A higher revision that readers had seen at the last check.
    higher: Option<Revision>,
}

/// What readers know of this leader's output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TermCheck {
    /// Nothing above its own.
    Sound,
    /// A higher revision, for the second time: whoever published it does not go on.
    Outrun(Revision),
}

impl Lease {
    /// The lease of an instance that begins a term, whose readers were asked just now.
    pub(crate) fn new_term(now: Tick) -> Self {
        Self { check_at: now.after(TERM_CHECK_INTERVAL), ..Self::confirmed(now) }
    }

    /// The lease of a suspect that leads again.
    pub(crate) fn confirmed(now: Tick) -> Self {
        Self { renew_at: now, check_at: now, higher: None }
    }

    /// When the next renewal or check is due.
    pub(crate) fn deadline(&self) -> Tick {
        self.renew_at.min(self.check_at)
    }

    /// The readers are asked at the next opportunity.
    pub(crate) fn check_soon(&mut self, now: Tick) {
        self.check_at = now;
    }

    /// Whether the lease is to be renewed now.
    pub(crate) fn renews(&mut self, now: Tick) -> bool {
        let is_due = self.renew_at <= now;
        if is_due {
            self.renew_at = now.after(RENEWAL_INTERVAL);
        }
        is_due
    }

    /// Whether the readers are to be asked now what they have seen.
    pub(crate) fn checks_term(&mut self, now: Tick) -> bool {
        let is_due = self.check_at <= now;
        if is_due {
            self.check_at = now.after(TERM_CHECK_INTERVAL);
        }
        is_due
    }

    /// Receives the highest revision that readers have seen. `own` is the revision of the last output.
    pub(crate) fn term_checked(
        &mut self,
        now: Tick,
        seen: Option<Revision>,
        own: Revision,
    ) -> TermCheck {
        let higher = seen.filter(|seen| *seen > own);
        if let Some(seen) = higher {
            if self.higher == higher {
                return TermCheck::Outrun(seen);
            }
            self.check_at = now.after(TERM_RECHECK_DELAY);
        }
        self.higher = higher;
        TermCheck::Sound
    }
}
