//! Records that wait until they are written.
//!
//! When too many wait, the oldest whole minutes go, and a record of the gap stands in their place. A division that
//! holds only what changed says nothing without those before it: after a gap such records go as well, until one
//! holds the whole division. The same holds for positions.

use std::collections::VecDeque;

use muster_model::history::{DivisionRecord, Entry, PositionsRecord, Record};
use muster_model::time::Tick;

/// Most records that are written in one transaction.
pub const MAX_BATCH_RECORDS: usize = 4096;

/// Most records that wait: a busy quarter of an hour. A disk that is full for longer loses the oldest minutes.
pub(super) const MAX_WAITING_RECORDS: usize = 65_536;

/// Most bytes of records that wait, estimated: a few whole divisions of the largest fleet.
const MAX_WAITING_BYTES: usize = 64 * 1024 * 1024;

/// What a record takes beside its lists, in bytes, estimated.
const RECORD_BYTES: usize = 256;

/// What one robot or team of a record takes, in bytes, estimated.
const LINE_BYTES: usize = 96;

/// Microseconds of a minute.
const MINUTE_US: u64 = 60_000_000;

/// Records that wait, the oldest first.
#[derive(Debug, Default)]
pub struct RecordQueue {
    waiting: VecDeque<Entry>,
    bytes: usize,
    /// Divisions are useless until one is whole.
    awaits_snapshot: bool,
    /// Positions are useless until all of them are recorded.
    awaits_survey: bool,
    lost: u64,
}

fn weight(entry: &Entry) -> usize {
    let lines = match &entry.record {
        Record::Division(division) => division.places.len() + division.lines.len(),
        Record::Audit(audit) => audit.per_team.len(),
        Record::Present(robots) => robots.len(),
        Record::Positions(positions) => positions.robots.len(),
        Record::Event(event) => event.detail.len() / LINE_BYTES,
        Record::Settings { settings, .. } => settings.len() / LINE_BYTES,
        Record::Joined(_) | Record::Left { .. } | Record::Gap { .. } => 0,
    };
    RECORD_BYTES + lines * LINE_BYTES
}

fn is_change(entry: &Entry) -> bool {
    matches!(&entry.record, Record::Division(DivisionRecord { snapshot: None, .. }))
}

fn is_snapshot(entry: &Entry) -> bool {
    matches!(&entry.record, Record::Division(DivisionRecord { snapshot: Some(_), .. }))
}

/// Positions that rest on the last whole ones.
fn is_partial_survey(entry: &Entry) -> bool {
    matches!(&entry.record, Record::Positions(PositionsRecord { is_whole: false, .. }))
}

fn is_whole_survey(entry: &Entry) -> bool {
    matches!(&entry.record, Record::Positions(PositionsRecord { is_whole: true, .. }))
}

fn minute(at: Tick) -> u64 {
    at.0 / MINUTE_US
}

impl RecordQueue {
    /// Adds a record.
    pub fn push(&mut self, entry: Entry) {
        let rests_on_lost = (self.awaits_snapshot && is_change(&entry))
            || (self.awaits_survey && is_partial_survey(&entry));
        if rests_on_lost {
            self.lost += 1;
            return;
        }
        self.awaits_snapshot &= !is_snapshot(&entry);
        self.awaits_survey &= !is_whole_survey(&entry);
        self.bytes += weight(&entry);
        self.waiting.push_back(entry);
        while self.waiting.len() > MAX_WAITING_RECORDS
            || (self.bytes > MAX_WAITING_BYTES && self.waiting.len() > 1)
        {
            self.drop_oldest_minute();
        }
    }

    /// How many records wait.
    #[must_use]
    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Whether none waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// The records that are to be written next, together.
    pub fn batch(&mut self) -> &[Entry] {
        let count = self.waiting.len().min(MAX_BATCH_RECORDS);
        &self.waiting.make_contiguous()[..count]
    }

    /// The batch is on the disk.
    pub fn written(&mut self) {
        let count = self.waiting.len().min(MAX_BATCH_RECORDS);
        for entry in self.waiting.drain(..count) {
            self.bytes = self.bytes.saturating_sub(weight(&entry));
        }
    }

    /// Takes out all that waits, for another queue. What was lost here stands as a gap among it.
    pub fn take(&mut self) -> VecDeque<Entry> {
        self.bytes = 0;
        std::mem::take(&mut self.waiting)
    }

    /// What was written before is gone: divisions and positions that hold only what changed are useless.
    pub fn interrupt(&mut self) {
        self.drop_changes();
        // Something was lost in any case, so that whole ones follow.
        self.lost += 1;
    }

    /// How many records were lost since the last call.
    pub fn take_lost(&mut self) -> u64 {
        std::mem::take(&mut self.lost)
    }

    fn drop_oldest_minute(&mut self) {
        let Some(first) = self.waiting.pop_front() else { return };
        self.bytes = self.bytes.saturating_sub(weight(&first));
        let (from, mut until, mut records, dropped) = match first.record {
            // The minute behind an earlier gap.
            Record::Gap { from, until, records } => {
                let next = self.waiting.front().map_or(first.at, |entry| entry.at);
                (from, until, records, minute(next))
            }
            _ => {
                self.lost += 1;
                (first.at, first.at, 1, minute(first.at))
            }
        };
        while let Some(entry) = self.waiting.front().filter(|entry| minute(entry.at) == dropped) {
            self.bytes = self.bytes.saturating_sub(weight(entry));
            until = entry.at;
            match &entry.record {
                // A gap that came with its records from another queue, which has counted them.
                Record::Gap { records: before, .. } => records += before,
                _ => {
                    records += 1;
                    self.lost += 1;
                }
            }
            self.waiting.pop_front();
        }
        let gap = Entry { at: until, record: Record::Gap { from, until, records } };
        self.bytes += weight(&gap);
        self.waiting.push_front(gap);
        self.drop_changes();
    }

    /// Drops divisions and positions that hold only what changed, up to whole ones.
    fn drop_changes(&mut self) {
        let snapshot = self.waiting.iter().position(is_snapshot);
        let survey = self.waiting.iter().position(is_whole_survey);
        self.awaits_snapshot = snapshot.is_none();
        self.awaits_survey = survey.is_none();
        let is_before = |at: usize, whole: Option<usize>| whole.is_none_or(|whole| at < whole);
        let mut kept = VecDeque::with_capacity(self.waiting.len());
        for (at, entry) in std::mem::take(&mut self.waiting).into_iter().enumerate() {
            let rests_on_lost = (is_change(&entry) && is_before(at, snapshot))
                || (is_partial_survey(&entry) && is_before(at, survey));
            if rests_on_lost {
                self.bytes = self.bytes.saturating_sub(weight(&entry));
                self.lost += 1;
            } else {
                kept.push_back(entry);
            }
        }
        self.waiting = kept;
    }
}

#[cfg(test)]
mod tests {
    use muster_model::header::Revision;
    use muster_model::history::{Place, SnapshotCause};
    use muster_model::id::RobotId;

    use super::*;

    const START: Tick = Tick(1_795_208_980_000_000);

    fn at(minutes: u64, record: Record) -> Entry {
        Entry { at: Tick(START.0 + minutes * MINUTE_US), record }
    }

    fn robot() -> RobotId {
        RobotId::new("r1").unwrap()
    }

    fn division(snapshot: Option<SnapshotCause>, places: usize) -> Record {
        let place = Place { robot: robot(), present: true, team: None, stale: false, was: None };
        Record::Division(DivisionRecord {
            revision: Revision::default(),
            requested: 1,
            teams: 0,
            robots: 0,
            snapshot,
            places: vec![place; places],
            lines: Vec::new(),
        })
    }

    #[test]
    fn records_leave_in_their_order_in_batches() {
        let mut queue = RecordQueue::default();
        for number in 0..MAX_BATCH_RECORDS as u64 + 3 {
            queue.push(Entry { at: Tick(number), record: Record::Joined(robot()) });
        }
        assert_eq!(queue.batch().len(), MAX_BATCH_RECORDS);
        queue.written();
        let rest: Vec<_> = queue.batch().iter().map(|entry| entry.at.0 as usize).collect();
        assert_eq!(rest, [MAX_BATCH_RECORDS, MAX_BATCH_RECORDS + 1, MAX_BATCH_RECORDS + 2]);
        queue.written();
        assert!(queue.is_empty() && queue.bytes == 0 && queue.take_lost() == 0);
    }

    #[test]
    fn when_too_many_wait_whole_minutes_go_and_a_gap_stands_for_them() {
        let mut queue = RecordQueue::default();
        let minutes = 8;
        let each = MAX_WAITING_RECORDS as u64 / minutes;
        for minute in 0..minutes {
            for _ in 0..each {
                queue.push(at(minute, Record::Joined(robot())));
            }
        }
        assert_eq!(queue.take_lost(), 0);
        queue.push(at(minutes, Record::Joined(robot())));
        assert_eq!(queue.take_lost(), each);
        let gap = Record::Gap { from: START, until: START, records: each };
        assert_eq!(queue.batch()[0], Entry { at: START, record: gap });
        for _ in 0..each {
            queue.push(at(minutes, Record::Joined(robot())));
        }
        let second = Tick(START.0 + MINUTE_US);
        let gap = Record::Gap { from: START, until: second, records: 2 * each };
        assert_eq!(queue.batch()[0], Entry { at: second, record: gap });
        assert_eq!(queue.take_lost(), each);
    }

    #[test]
    fn after_a_gap_divisions_wait_for_a_whole_one() {
        let mut queue = RecordQueue::default();
        let places = MAX_WAITING_BYTES / LINE_BYTES / 2;
        queue.push(at(0, division(Some(SnapshotCause::Start), places)));
        queue.push(at(1, division(None, 1)));
        queue.push(at(1, division(None, places)));
        // The whole one went with its minute, and what rests on it.
        assert_eq!(queue.take_lost(), 3);
        assert!(matches!(queue.batch(), [Entry { record: Record::Gap { records: 1, .. }, .. }]));
        queue.push(at(2, division(None, 1)));
        queue.push(at(2, Record::Joined(robot())));
        queue.push(at(2, division(Some(SnapshotCause::Gap), 1)));
        queue.push(at(2, division(None, 1)));
        assert_eq!((queue.take_lost(), queue.len()), (1, 4));
        queue.interrupt();
        assert_eq!((queue.take_lost(), queue.len()), (1, 4), "a whole one is among them");
    }

    #[test]
    fn after_a_gap_positions_wait_for_all_of_them() {
        let survey = |is_whole, robots: usize| {
            let robots = vec![(robot(), [0, 0]); robots];
            Record::Positions(PositionsRecord { is_whole, robots })
        };
        let mut queue = RecordQueue::default();
        let robots = MAX_WAITING_BYTES / LINE_BYTES / 2;
        queue.push(at(0, survey(true, robots)));
        queue.push(at(1, survey(false, 1)));
        queue.push(at(1, survey(false, robots)));
        // The whole one went with its minute, and what rests on it.
        assert_eq!(queue.take_lost(), 3);
        assert!(matches!(queue.batch(), [Entry { record: Record::Gap { records: 1, .. }, .. }]));
        // A whole division does not help positions, nor they a division.
        queue.push(at(2, division(Some(SnapshotCause::Gap), 1)));
        queue.push(at(2, survey(false, 1)));
        queue.push(at(2, division(None, 1)));
        assert_eq!((queue.take_lost(), queue.len()), (1, 3));
        queue.push(at(2, survey(true, 1)));
        queue.push(at(2, survey(false, 1)));
        assert_eq!((queue.take_lost(), queue.len()), (0, 5));
        queue.written();
        queue.push(at(3, survey(false, 1)));
        queue.interrupt();
        queue.push(at(3, survey(false, 1)));
        assert_eq!((queue.take_lost(), queue.len()), (3, 0), "the whole one was written before");
    }

    #[test]
    fn a_gap_of_another_queue_keeps_its_count() {
        let (mut first, mut second) = (RecordQueue::default(), RecordQueue::default());
        let each = MAX_WAITING_RECORDS as u64;
        for (minute, count) in [(0, each), (1, each - 1)] {
            for _ in 0..count {
                first.push(at(minute, Record::Joined(robot())));
            }
        }
        assert_eq!(first.take_lost(), each);
        second.push(at(0, Record::Joined(robot())));
        first.take().into_iter().for_each(|entry| second.push(entry));
        assert!(first.is_empty() && first.bytes == 0);
        assert_eq!(second.take_lost(), 1, "the others are counted");
        let gap = Record::Gap { from: START, until: START, records: each + 1 };
        assert_eq!(second.batch()[0], Entry { at: START, record: gap });
    }

    #[test]
    fn a_queue_never_holds_more_than_its_limits() {
        let mut queue = RecordQueue::default();
        for number in 0..3 * MAX_WAITING_RECORDS as u64 {
            queue.push(Entry { at: START, record: Record::Joined(robot()) });
            if number % 1000 == 0 {
                queue.push(Entry { at: START, record: division(None, 5) });
            }
        }
        assert!(queue.len() <= MAX_WAITING_RECORDS && queue.bytes <= MAX_WAITING_BYTES);
    }
}
