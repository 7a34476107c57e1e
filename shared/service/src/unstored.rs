//! Publications of a term that wait until the term is on the disk.
//!
//! The next process on the host counts on from the term that is stored. If this one published and ended before that,
//! both would use the same term, and readers would take the first of two publications with one revision.

use std::time::Duration;

use muster_model::role::ReplicaState;
use muster_model::time::Tick;

use crate::io::{Command, Publication};

/// Longest time that publications wait. A disk takes some milliseconds; one that takes longer than this hangs, and then
/// a fleet that is divided is worth more than a term that cannot be used twice.
const MAX_WAIT: Duration = Duration::from_secs(1);

/// Most publications that wait: a leader publishes fewer than ten a second before it has data, and an event for each
/// robot at most.
const MAX_WAITING: usize = 1024;

/// What waits for the store of a term.
#[derive(Debug, Default)]
pub(crate) struct UnstoredTerm {
    write: Option<Write>,
    waiting: Vec<Publication>,
}

#[derive(Debug)]
struct Write {
    /// How many stores must end before, with that of the term.
    stores: u32,
    until: Tick,
}

impl UnstoredTerm {
    /// A term is being stored; `stores` states are being written, with it.
    pub(crate) fn begin(&mut self, now: Tick, stores: u32) {
        self.write = Some(Write { stores, until: now.after(MAX_WAIT) });
    }

    /// State was written, or could not be.
    pub(crate) fn stored(&mut self) {
        if let Some(write) = &mut self.write {
            write.stores = write.stores.saturating_sub(1);
        }
    }

    /// When publications wait no longer for the disk. Those of a suspect wait until it leads again.
    pub(crate) fn deadline(&self, state: ReplicaState) -> Option<Tick> {
        let write = self.write.as_ref().filter(|_| state != ReplicaState::Suspect);
        write.map(|write| write.until)
    }

    /// Takes publications out of `commands` while the term is being written, and gives back those that have waited once
    /// it is. Those of a suspect wait on: once it leads again, what it publishes follows them, as a delta follows the
    /// graph before. An instance that has no term has nothing to say.
    pub(crate) fn pass(&mut self, now: Tick, state: ReplicaState, commands: &mut Vec<Command>) {
        let Some(write) = &self.write else { return };
        let has_term = matches!(state, ReplicaState::Leading | ReplicaState::Suspect);
        let is_written = write.stores == 0 || now >= write.until;
        let is_full = self.waiting.len() >= MAX_WAITING;
        if (is_written && state != ReplicaState::Suspect) || is_full || !has_term {
            self.write = None;
            let waited = self.waiting.drain(..).filter(|_| has_term).map(Command::Publish);
            let after = std::mem::take(commands);
            commands.extend(waited.chain(after));
            return;
        }
        for command in std::mem::take(commands) {
            match command {
                Command::Publish(publication) => self.waiting.push(publication),
                other => commands.push(other),
            }
        }
    }
}
