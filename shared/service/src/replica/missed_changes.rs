//! Changes of settings that are known by the outcomes of commands, and not by the settings of a leader.
//!
//! A leader confirms a change once it is on its own disk. Its announcement may be lost, and the leader with it; the
//! outcome of the command may have arrived all the same, or arrives when the leader is back as a standby. What was confirmed
//! to an operator counts then.

use std::collections::VecDeque;

use muster_model::command::{Action, CommandOutcome};
use muster_model::header::{Header, Revision};
use muster_model::time::Tick;
use serde_json::{Map, Value};

use crate::commands::CommandName;

/// Most changes that are kept, and that an instance repeats of its own term: a person gives a command in some seconds, and
/// within a minute the settings are announced a dozen times.
pub(crate) const MAX_MISSED: usize = 16;

/// The patch of a command that changed settings, and was not refused.
pub(crate) fn confirmed_patch(outcome: &CommandOutcome) -> Option<Map<String, Value>> {
    if outcome.refused.is_some() {
        return None;
    }
    match serde_json::from_str(&outcome.action) {
        Ok(Action::Set(patch)) => Some(patch),
        _ => None,
    }
}

/// What tells which of two outcomes is the newer one. A leader that has published nothing carries out commands under one and the same
/// revision, and its clock orders them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct OutcomeMoment {
    /// That of the last output of the leader then.
    pub(crate) revision: Revision,
    /// When it was confirmed, by the clock of that leader.
    pub(crate) confirmed: Tick,
}

impl OutcomeMoment {
    pub(crate) fn of(outcome: &CommandOutcome) -> Self {
        let Header { revision, stages, .. } = &outcome.header;
        let confirmed = stages.last().map(|stage| stage.published).unwrap_or_default();
        Self { revision: *revision, confirmed }
    }
}

/// What tells which of two commands came later.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CommandTime {
    /// The term in which it was carried out.
    term: u64,
    /// When, by the clock of that leader.
    confirmed: Tick,
    /// Until when it is remembered, by the clock of the operator.
    expires: f64,
}

impl CommandTime {
    pub(crate) fn of(outcome: &CommandOutcome) -> Self {
        let OutcomeMoment { revision, confirmed } = OutcomeMoment::of(outcome);
        Self { term: revision.term, confirmed, expires: outcome.expires }
    }

    /// One leader carries commands out one after the other. Two that lead at the same time carry out the same ones, and neither
    /// their terms nor their clocks tell which was given later.
    pub(crate) fn is_before(&self, other: &CommandOutcome) -> bool {
        let other = Self::of(other);
        if self.term == other.term {
            self.confirmed < other.confirmed
        } else {
            self.expires < other.expires
        }
    }
}

/// Who has confirmed a change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ConfirmedBy {
    /// This instance, before it stood down: the next leader may not have received it.
    Own,
    /// The leader that was followed then: it counts even if that has a lower term than the settings.
    Followed,
    /// The same, but it is known by its answers to the instance that takes over from it: the operator's clock
    /// alone says when that was.
    Replaced,
    /// Another instance.
    Other,
}

/// A change that a leader has confirmed.
#[derive(Debug)]
pub(crate) struct MissedChange {
    name: CommandName,
    /// When it was confirmed: it is in the settings that the same leader sent later.
    moment: OutcomeMoment,
    confirmed_by: ConfirmedBy,
    pub(crate) time: CommandTime,
    pub(crate) patch: Map<String, Value>,
}

impl MissedChange {
    /// The term of the leader that has confirmed it while it was followed: it is later than all changes of other terms,
    /// whatever the clocks of other instances say.
    pub(crate) fn confirmed_lately_in(&self) -> Option<u64> {
        (self.confirmed_by == ConfirmedBy::Followed).then_some(self.moment.revision.term)
    }
}

/// What a standby knows of the outcomes of leaders, its own ones too, and has not received with settings since.
#[derive(Debug, Default)]
pub(crate) struct MissedChanges(VecDeque<MissedChange>);

impl MissedChanges {
    /// An outcome was received, or given, whose change is in force in the settings of that revision.
    pub(crate) fn note(&mut self, outcome: &CommandOutcome, confirmed_by: ConfirmedBy) {
        if let Some(patch) = confirmed_patch(outcome) {
            if self.0.len() >= MAX_MISSED {
                self.0.pop_front();
            }
            let (moment, time) = (OutcomeMoment::of(outcome), CommandTime::of(outcome));
            let name = (outcome.operator.clone(), outcome.id.clone());
            self.0.push_back(MissedChange { name, moment, confirmed_by, time, patch });
        }
    }

    /// The commands whose changes are missing, with these.
    pub(crate) fn all(&self) -> impl Iterator<Item = (&CommandName, &Map<String, Value>)> {
        self.0.iter().map(|missed| (&missed.name, &missed.patch))
    }

    /// Settings that were sent at a moment were adopted. A new leader may not have received yet what this instance had
    /// confirmed, as long as that is said again (`are_own_said`). A field whose value this instance never had
    /// (`is_unknown`) was changed by a leader after it, which counts.
    pub(crate) fn adopted(
        &mut self,
        sent: OutcomeMoment,
        are_own_said: bool,
        has: impl Fn(&Map<String, Value>) -> bool,
        is_unknown: impl Fn(&str) -> bool,
    ) {
        self.0.retain_mut(|missed| match missed.confirmed_by {
            // Its own settings may come back from the bus.
            ConfirmedBy::Own if missed.moment.revision.term == sent.revision.term => true,
            ConfirmedBy::Own => {
                let is_of_before = missed.moment.revision.term < sent.revision.term;
                missed.patch.retain(|field, _| !(is_of_before && is_unknown(field)));
                are_own_said && !has(&missed.patch)
            }
            ConfirmedBy::Followed | ConfirmedBy::Replaced | ConfirmedBy::Other => {
                missed.moment > sent && !has(&missed.patch)
            }
        });
    }

    /// The changes since settings that were sent at a moment, the oldest first; they are given once.
    pub(crate) fn take_since(&mut self, sent: OutcomeMoment) -> Vec<MissedChange> {
        let mut all = std::mem::take(&mut self.0);
        // Several instances may have said them, each in its own order.
        all.make_contiguous().sort_by_key(|missed| missed.moment);
        let counts = |missed: &MissedChange| {
            missed.confirmed_by != ConfirmedBy::Other || missed.moment > sent
        };
        all.into_iter().filter(counts).collect()
    }
}
