//! Publications of a term that wait until the term is on the disk.
//!
//! The next process on the host counts on from the term that is stored. If this one published and ended before that,
//! both would use the same term, and readers would take the first of two publications with one revision.

use std::time::Duration;

use muster_model::limits::MAX_ROBOTS;
use muster_model::role::ReplicaState;
use muster_model::time::Tick;

use crate::io::{Command, Publication};

/// Longest time that publications wait. A disk takes some milliseconds; one that takes longer than this hangs, and then
/// a fleet that is divided is worth more than a term that cannot be used twice.
const MAX_WAIT: Duration = Duration::from_secs(1);

/// Most publications that wait: a message and an event for each robot of the largest fleet. A suspect adds none.
const MAX_WAITING: usize = 2 * MAX_ROBOTS;

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
        if !has_term || (state == ReplicaState::Leading && (is_written || is_full)) {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn publications(count: usize) -> Vec<Command> {
        let one = Publication { packets: Vec::new(), is_lease_renewal: false, message: None };
        vec![Command::Publish(one); count]
    }

    /// All that waits, whatever the next input is: a leader may have more to say at once than is kept.
    #[test]
    fn a_suspect_keeps_all_and_a_leader_publishes_what_is_too_much() {
        let mut unstored = UnstoredTerm::default();
        unstored.begin(Tick(0), 1);
        let mut commands = publications(MAX_WAITING + 1);
        unstored.pass(Tick(0), ReplicaState::Leading, &mut commands);
        assert!(commands.is_empty());
        unstored.pass(Tick(1), ReplicaState::Suspect, &mut commands);
        unstored.stored();
        unstored.pass(Tick(0).after(MAX_WAIT), ReplicaState::Suspect, &mut commands);
        assert!(commands.is_empty());
        assert_eq!(unstored.deadline(ReplicaState::Suspect), None);
        unstored.pass(Tick(2), ReplicaState::Leading, &mut commands);
        assert_eq!(commands.len(), MAX_WAITING + 1);
        // Without a suspicion no more waits than that.
        let mut unstored = UnstoredTerm::default();
        unstored.begin(Tick(0), 1);
        let mut commands = publications(MAX_WAITING);
        unstored.pass(Tick(0), ReplicaState::Leading, &mut commands);
        unstored.pass(Tick(0), ReplicaState::Leading, &mut commands);
        assert_eq!(commands.len(), MAX_WAITING);
    }
}
