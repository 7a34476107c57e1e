//! Changes of settings that are known by the outcomes of commands, and not by the settings of a leader.
//!
//! A leader confirms a change once it is on its own disk. Its announcement may be lost, and the leader with it; the
//! outcome of the command may have arrived all the same, or arrives when the leader is back as a standby. What was confirmed
//! to an operator counts then.

use std::collections::VecDeque;

use muster_model::command::{Action, CommandOutcome};
use muster_model::header::Revision;
use serde_json::{Map, Value};

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

/// A change that a leader has confirmed.
#[derive(Debug)]
pub(crate) struct MissedChange {
    /// The revision of the settings in which it is in force.
    revision: Revision,
    /// Until when the command is remembered, which tells which of two commands was given later.
    pub(crate) expires: f64,
    pub(crate) patch: Map<String, Value>,
}

/// What a standby has received of the outcomes of its leader since the last settings of it.
#[derive(Debug, Default)]
pub(crate) struct MissedChanges(VecDeque<MissedChange>);

impl MissedChanges {
    /// An outcome was received, whose change is in force in the settings of that revision.
    pub(crate) fn note(&mut self, outcome: &CommandOutcome) {
        if let Some(patch) = confirmed_patch(outcome) {
            if self.0.len() >= MAX_MISSED {
                self.0.pop_front();
            }
            let (revision, expires) = (outcome.header.revision, outcome.expires);
            self.0.push_back(MissedChange { revision, expires, patch });
        }
    }

    /// Settings of a revision were adopted. Those of the same revision may be of before a change, or have it.
    pub(crate) fn adopted(
        &mut self,
        revision: Revision,
        has: impl Fn(&Map<String, Value>) -> bool,
    ) {
        self.0.retain(|missed| missed.revision >= revision && !has(&missed.patch));
    }

    /// The changes since settings of a revision, the oldest first; they are given once.
    pub(crate) fn take_since(&mut self, revision: Revision) -> Vec<MissedChange> {
        let mut all = std::mem::take(&mut self.0);
        // Several instances may have said them, each in its own order.
        all.make_contiguous().sort_by_key(|missed| missed.revision);
        all.into_iter().filter(|missed| missed.revision >= revision).collect()
    }
}
