//! What a host says when stored state is lost or cannot be written, and which terms it believes.

use std::time::Duration;

use muster_model::event::{EventKind, Severity};
use muster_model::header::Revision;
use muster_model::settings::Settings;
use muster_model::status::StatusGauge;
use muster_model::term::{highest_term, latest_date};
use muster_wire::message::quoted;
use muster_wire::{Message, Rejection};

use crate::facilities::Facilities;

/// How soon state that could not be written is written again: each attempt on a full disk is a line in the log.
const STORE_RETRY_INTERVAL: Duration = Duration::from_secs(10);

/// The counter of a status for messages with a term that is not believed.
const TERMS_REFUSED: &str = "terms_refused";

/// The same for changes of settings with a date that is not believed.
const DATES_REFUSED: &str = "dates_refused";

impl<S: Settings, F: Copy + Eq, J> Facilities<S, F, J> {
    /// A message, if its term is believed, and the dates of changes in it are. One far above what any clock allows was forged: a
    /// leader that went above it would be believed by no instance.
    ///
    /// # Errors
    /// The refusal, which names the bound.
    pub(crate) fn believed(&mut self, key: &str, message: Message) -> Result<Message, Rejection> {
        let term = message.header().map_or(0, |header| header.revision.term);
        let replica = &mut self.replica;
        let latest = latest_date(self.now);
        let changed = match &message {
            Message::Settings(announced) => announced.changed.values().max().copied(),
            Message::Outcome(outcome) => outcome.changed.as_ref().map(|changed| changed.at),
            _ => None,
        };
        if let Some(changed) = changed.filter(|changed| *changed > latest) {
            replica.add(DATES_REFUSED, 1);
            let reason = format!(
                "changed: {} is above {}, which no operator can have sent; it was forged or a clock is wrong",
                changed.as_seconds(),
                latest.as_seconds()
            );
            return Err(Rejection::new(&replica.space, key, reason));
        }
        if replica.believes(self.now, term) {
            return Ok(message);
        }
        replica.add(TERMS_REFUSED, 1);
        let reason = format!(
            "term: {term} is above {}, which no service can have begun; it was forged or its sender\'s \
             clock is wrong",
            highest_term(self.now)
        );
        Err(Rejection::new(&replica.space, key, reason))
    }

    /// What was kept could not be read.
    pub(crate) fn state_lost(&mut self, reason: &str) {
        self.replica.state_loss = Some(quoted(reason));
        if self.replica.election.has_term() {
            self.report_state_loss();
        }
    }

    /// An instance that has stored nothing begins to lead, and others know an earlier output of its service.
    pub(crate) fn notice_state_loss(&mut self, seen: Option<Revision>) {
        let Some(seen) = seen.filter(|_| self.replica.has_no_stored_term()) else { return };
        let loss = format!(
            "nothing is stored on this host, and others know term {}: settings that were changed are lost, \
             unless this service is new here; keep its state directory on a disk that lasts",
            seen.term
        );
        self.replica.state_loss.get_or_insert(loss);
    }

    /// Reports a loss of state, once there is a term to report it in.
    pub(crate) fn report_state_loss(&mut self) {
        if let Some(reason) = self.replica.state_loss.take() {
            self.replica.set(StatusGauge::StateLost, 1);
            self.publish_event(Severity::Error, EventKind::StateLost { reason });
        }
    }

    /// Writes state again that could not be written before: a disk that was full may have room, and an instance
    /// that starts with an old state would fall behind what readers have received.
    pub(crate) fn store_again_when_due(&mut self) {
        if self.store_again_at.is_some_and(|at| at <= self.now) {
            self.store();
        }
    }

    /// State was written, or could not be. A leader reports a failure once until it can.
    pub(crate) fn store_ended(&mut self, error: Option<&str>) {
        self.replica.set(StatusGauge::StateUnwritable, u64::from(error.is_some()));
        self.store_again_at = error.is_some().then(|| self.now.after(STORE_RETRY_INTERVAL));
        self.is_loss_reported &= error.is_some();
        if let Some(error) = error
            && !self.is_loss_reported
            && self.replica.election.is_leading()
        {
            self.is_loss_reported = true;
            let reason = format!(
                "state cannot be written and will not survive a restart: {}",
                quoted(error)
            );
            self.publish_event(Severity::Error, EventKind::StateLost { reason });
        }
    }
}
