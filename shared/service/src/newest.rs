//! Which of the messages that a reader receives is the newest.
//!
//! A message with a forged revision, or one of a term that was lost with all that knew it, is newer than all that come.
//! Leaders ask the readers that answer for them what they have seen, and go above it. A reader that answers for no other
//! service, such as `planner`, is not asked, and has to find out by itself, as clients do.

use std::time::Duration;

use muster_model::header::Revision;
use muster_model::time::Tick;

/// For how long nothing newer comes while lower revisions rise, until those count: as long as in clients, and as many
/// heartbeats of a service.
const RESTART_TIME: Duration = Duration::from_secs(5);

/// What a message is to what was received before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recency {
    /// It is newer.
    Newer,
    /// It is of a publisher that has begun again below what was received before. It counts from now on.
    Restarted,
    /// It is known, or old.
    Old,
}

/// The revision of the newest message of one key.
#[derive(Debug, Clone, Copy, Default)]
pub struct Newest {
    revision: Option<Revision>,
    lower: Option<Lower>,
}

/// Lower revisions, each higher than the one before.
#[derive(Debug, Clone, Copy)]
struct Lower {
    highest: Revision,
    since: Tick,
    last: Tick,
}

impl Newest {
    /// A message was received.
    pub fn receive(&mut self, now: Tick, revision: Revision) -> Recency {
        let is_newer = self.revision.is_none_or(|newest| revision > newest);
        if !is_newer && !self.is_restart(now, revision) {
            return Recency::Old;
        }
        *self = Self { revision: Some(revision), lower: None };
        if is_newer { Recency::Newer } else { Recency::Restarted }
    }

    /// Whether a revision that is not newer ends a row of lower ones that has lasted for long enough.
    fn is_restart(&mut self, now: Tick, revision: Revision) -> bool {
        if self.revision == Some(revision) {
            return false;
        }
        let has_ended = |lower: &mut Lower| now.since(lower.last) >= RESTART_TIME;
        self.lower.take_if(has_ended);
        let lower = self.lower.get_or_insert(Lower { highest: revision, since: now, last: now });
        if revision > lower.highest {
            *lower = Lower { highest: revision, last: now, ..*lower };
            return now.since(lower.since) >= RESTART_TIME;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(tenths: u64) -> Tick {
        Tick::default().after(Duration::from_millis(100 * tenths))
    }

    fn revision(term: u64, epoch: u64) -> Revision {
        Revision { term, epoch }
    }

    #[test]
    fn lower_revisions_count_once_they_have_risen_for_long_enough_and_nothing_newer_came() {
        let mut newest = Newest::default();
        assert_eq!(newest.receive(at(0), revision(9, 9)), Recency::Newer);
        for tenth in 0..50 {
            assert_eq!(newest.receive(at(tenth), revision(1, tenth)), Recency::Old);
        }
        assert_eq!(newest.receive(at(50), revision(1, 50)), Recency::Restarted);
        assert_eq!(newest.receive(at(51), revision(1, 51)), Recency::Newer);
    }

    #[test]
    fn old_messages_that_come_late_do_not_count() {
        let mut newest = Newest::default();
        newest.receive(at(0), revision(9, 9));
        for tenth in 0..200 {
            let repeated = newest.receive(at(tenth), revision(1, 7));
            assert_eq!(repeated, Recency::Old, "the same again and again");
        }
        // What is newer ends the row: two leaders publish in turn until one hears of the other.
        for second in 20..60 {
            let newer = newest.receive(at(10 * second), revision(9, second));
            assert_eq!(newer, Recency::Newer);
            assert_eq!(newest.receive(at(10 * second + 5), revision(8, second)), Recency::Old);
        }
        // So does a long silence.
        for minute in 2..9 {
            assert_eq!(newest.receive(at(600 * minute), revision(8, 60 + minute)), Recency::Old);
        }
    }
}
