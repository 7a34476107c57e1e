//! Which records are written when, and what is reported of it, by whatever clock and thread drives it.

use std::time::Duration;

use muster_model::history::{Coverage, Entry, Page, Query, RecordingReport, Retention};

use super::queue::MAX_WAITING_RECORDS;
use super::{MAX_BATCH_RECORDS, RecordQueue, Records, WriteError};

/// How often records are written: each transaction waits for the disk.
pub const COMMIT_INTERVAL: Duration = Duration::from_secs(1);

/// How soon records that could not be written are tried again: each attempt is a line in the log.
pub const RETRY_INTERVAL: Duration = Duration::from_secs(5);

/// Most batches of one step. A batch that finds a damaged file is written again, so that this is twice what may wait: the
/// last step of a process writes all of it.
const MAX_BATCHES: usize = 2 * MAX_WAITING_RECORDS / MAX_BATCH_RECORDS;

/// What opens a store; it is called again after an error.
type Open = Box<dyn FnMut() -> Result<Box<dyn Records>, String> + Send>;

/// The records of an instance on their way to its store.
pub struct Recorder {
    open: Open,
    store: Option<Box<dyn Records>>,
    queue: RecordQueue,
    retention: Option<Retention>,
    reported: Option<RecordingReport>,
}

/// What a step has led to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// What the core is to know, if that is anything new.
    pub news: Option<RecordingReport>,
    /// After which time the next step is due.
    pub next: Duration,
}

impl Recorder {
    /// A recorder whose first step opens the store and reports what it holds.
    pub fn new(open: impl FnMut() -> Result<Box<dyn Records>, String> + Send + 'static) -> Self {
        Self {
            open: Box::new(open),
            store: None,
            queue: RecordQueue::default(),
            retention: None,
            reported: None,
        }
    }

    /// Accepts a record, to be written with the next step.
    pub fn append(&mut self, entry: Entry) {
        self.queue.push(entry);
    }

    /// Forgets what is too old or too much with the next step.
    pub fn retain(&mut self, retention: Retention) {
        self.retention = Some(retention);
    }

    /// Looks records up; those that wait are not among them.
    ///
    /// # Errors
    /// If the store is not open, or cannot be read.
    pub fn answer(&mut self, query: &Query) -> Result<Page, String> {
        match &mut self.store {
            Some(store) => store.answer(query),
            None => Err(self.problem_before()),
        }
    }

    /// Whether a step is due before its time: a whole batch waits, and the last one was written.
    #[must_use]
    pub fn is_full(&self) -> bool {
        let is_failing = self.reported.as_ref().is_some_and(|reported| reported.problem.is_some());
        self.queue.len() >= MAX_BATCH_RECORDS && !is_failing
    }

    /// Writes what waits, and forgets what is to be forgotten. `overflow` counts the records that a queue before the
    /// recorder has lost: their gap has come with the others, and nothing that rests on them has.
    pub fn step(&mut self, overflow: u64) -> Step {
        let mut report = RecordingReport::default();
        if let Err(problem) = self.write(&mut report) {
            report.problem = Some(problem);
        }
        report.lost = self.queue.take_lost().saturating_add(overflow);
        report.coverage =
            self.store.as_ref().map_or_else(Coverage::default, |store| store.coverage());
        let next = if report.problem.is_some() { RETRY_INTERVAL } else { COMMIT_INTERVAL };
        let is_news =
            report.lost > 0 || report.damaged.is_some() || self.reported.as_ref() != Some(&report);
        if is_news {
            self.reported = Some(report.clone());
        }
        Step { news: is_news.then_some(report), next }
    }

    fn problem_before(&self) -> String {
        let reported = self.reported.as_ref().and_then(|reported| reported.problem.clone());
        reported.unwrap_or_else(|| "the history is not open yet; ask again in a moment".to_owned())
    }

    fn write(&mut self, report: &mut RecordingReport) -> Result<(), String> {
        let store = match &mut self.store {
            Some(store) => store,
            none => none.insert((self.open)()?),
        };
        report.damaged = store.take_damage();
        let mut kept = |result: Result<bool, WriteError>, queue: &mut RecordQueue| match result {
            Ok(more) => Ok(more),
            Err(WriteError::Damaged(problem)) => {
                queue.interrupt();
                report.damaged = Some(problem);
                Ok(false)
            }
            Err(WriteError::Full(problem) | WriteError::Failed(problem)) => Err(problem),
        };
        for _ in 0..MAX_BATCHES {
            if self.queue.is_empty() {
                break;
            }
            let written = store.write(self.queue.batch());
            if written.is_ok() {
                self.queue.written();
            }
            kept(written.map(|()| false), &mut self.queue)?;
        }
        if let Some(retention) = self.retention.take()
            && kept(store.retain(&retention), &mut self.queue)?
        {
            // The rest goes with the next transactions.
            self.retention = Some(retention);
        }
        store.shortage().map_or(Ok(()), Err)
    }
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { queue, retention, reported, .. } = self;
        formatter
            .debug_struct("Recorder")
            .field("waiting", &queue.len())
            .field("retention", retention)
            .field("reported", reported)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use muster_model::history::Record;
    use muster_model::id::RobotId;
    use muster_model::time::Tick;

    use super::super::MemoryRecords;
    use super::*;

    fn joined(at: u64) -> Entry {
        Entry { at: Tick(at), record: Record::Joined(RobotId::new("r1").unwrap()) }
    }

    fn report(recorder: &mut Recorder) -> RecordingReport {
        recorder.step(0).news.unwrap()
    }

    #[test]
    fn what_is_not_written_waits_and_is_written_once_there_is_room() {
        let mut recorder = Recorder::new(|| {
            let full = WriteError::Full("the disk is full".to_owned());
            Ok(Box::new(MemoryRecords::failing(full)))
        });
        recorder.append(joined(1));
        let full = report(&mut recorder);
        assert_eq!((full.problem.as_deref(), full.lost), (Some("the disk is full"), 0));
        assert_eq!(recorder.step(0), Step { news: None, next: RETRY_INTERVAL });
        recorder.store = Some(Box::<MemoryRecords>::default());
        let written = report(&mut recorder);
        assert_eq!((written.problem, written.coverage.sequence), (None, 1));
        assert_eq!(recorder.step(0), Step { news: None, next: COMMIT_INTERVAL });
        // A file that was damaged: what comes next must be whole.
        let damaged = WriteError::Damaged("put aside".to_owned());
        recorder.store = Some(Box::new(MemoryRecords::failing(damaged)));
        recorder.append(joined(2));
        let report = report(&mut recorder);
        assert_eq!(report.damaged.as_deref(), Some("put aside"));
        assert!(report.lost > 0 && report.problem.is_none());
    }
}
