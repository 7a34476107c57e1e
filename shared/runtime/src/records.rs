//! A thread of its own that keeps the records of a service: it may wait for a disk as long as that takes, and nothing
//! waits for it.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use anyhow::Context;
use muster_model::history::{Coverage, Entry, Query, RecordingReport, Retention};
use muster_model::id::{FleetId, InstanceId};
use muster_service::Input;
use muster_service::records::{MAX_BATCH_RECORDS, RecordQueue, Records, WriteError};
use tokio::sync::oneshot;

/// Most tasks that wait for the thread: four transactions. It takes them up while it waits for nothing but the disk.
const MAX_WAITING_TASKS: usize = 4 * MAX_BATCH_RECORDS;

/// How often records are written: each transaction waits for the disk.
const COMMIT_INTERVAL: Duration = Duration::from_secs(1);

/// How soon records that could not be written are tried again: each attempt is a line in the log.
const RETRY_INTERVAL: Duration = Duration::from_secs(5);

/// Where the records of an instance are kept.
#[derive(Debug, Clone)]
pub struct RecordPlace {
    /// The folder of the fleet in the state directory; none if nothing is kept over a restart.
    pub folder: Option<PathBuf>,
    /// The fleet.
    pub fleet: FleetId,
    /// The instance.
    pub instance: InstanceId,
}

/// Opens the store of an instance. It is called on the thread that writes, again after an error.
pub type OpenRecords = fn(&RecordPlace) -> Result<Box<dyn Records>, String>;

/// The records of a service that keeps some.
#[derive(Debug, Clone)]
pub struct RecordOptions {
    /// Where they are kept.
    pub place: RecordPlace,
    /// What opens the store.
    pub open: OpenRecords,
}

enum Task {
    Append(Box<Entry>),
    LookUp { lookup: u64, query: Query },
    Retain(Retention),
}

/// Hands tasks to the thread, which ends when the handle is gone and all records are written.
pub(crate) struct RecordWriter {
    tasks: SyncSender<Task>,
    /// Records that found the queue full.
    overflow: Arc<AtomicU64>,
}

impl RecordWriter {
    /// Starts the thread. `send` brings inputs back to the loop. The returned receiver learns of the thread's end.
    pub(crate) fn start(
        options: RecordOptions,
        send: impl Fn(Input) + Send + 'static,
    ) -> anyhow::Result<(Self, oneshot::Receiver<()>)> {
        let (sender, tasks) = sync_channel(MAX_WAITING_TASKS);
        let overflow = Arc::new(AtomicU64::new(0));
        let (done, ended) = oneshot::channel();
        let recorder = Recorder::new(options, Arc::clone(&overflow));
        let span = tracing::Span::current();
        std::thread::Builder::new()
            .name("muster-records".to_owned())
            .spawn(move || {
                let _service = span.enter();
                recorder.run(&tasks, &send);
                let _ = done.send(());
            })
            .context("cannot start the thread that writes records")?;
        Ok((Self { tasks: sender, overflow }, ended))
    }

    /// Appends a record; [`Input::Recorded`] follows. Never waits: one that finds the queue full is lost, and counted
    /// in the next report.
    pub(crate) fn append(&self, entry: Box<Entry>) {
        if self.tasks.try_send(Task::Append(entry)).is_err() {
            self.overflow.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Looks records up; [`Input::Found`] follows. False if too many tasks wait.
    pub(crate) fn look_up(&self, lookup: u64, query: Query) -> bool {
        self.tasks.try_send(Task::LookUp { lookup, query }).is_ok()
    }

    /// Forgets what is too old or too much, with the next transaction. The core says so again soon.
    pub(crate) fn retain(&self, retention: Retention) {
        let _ = self.tasks.try_send(Task::Retain(retention));
    }
}

/// What the thread keeps.
struct Recorder {
    options: RecordOptions,
    store: Option<Box<dyn Records>>,
    queue: RecordQueue,
    overflow: Arc<AtomicU64>,
    retention: Option<Retention>,
    reported: Option<RecordingReport>,
}

impl Recorder {
    fn new(options: RecordOptions, overflow: Arc<AtomicU64>) -> Self {
        Self {
            options,
            store: None,
            queue: RecordQueue::default(),
            overflow,
            retention: None,
            reported: None,
        }
    }

    fn run(mut self, tasks: &Receiver<Task>, send: &impl Fn(Input)) {
        // The first step opens the store and reports what it holds.
        let mut due = Instant::now();
        loop {
            let wait = due.saturating_duration_since(Instant::now());
            match tasks.recv_timeout(wait) {
                Ok(Task::Append(entry)) => self.queue.push(*entry),
                Ok(Task::LookUp { lookup, query }) => {
                    let page = match &mut self.store {
                        Some(store) => store.answer(&query),
                        None => Err(self.problem_before()),
                    };
                    send(Input::Found { lookup, page });
                }
                Ok(Task::Retain(retention)) => self.retention = Some(retention),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    self.step();
                    return;
                }
            }
            let is_failing =
                self.reported.as_ref().is_some_and(|reported| reported.problem.is_some());
            let is_full = self.queue.len() >= MAX_BATCH_RECORDS && !is_failing;
            if is_full || Instant::now() >= due {
                let report = self.step();
                let interval =
                    if report.problem.is_some() { RETRY_INTERVAL } else { COMMIT_INTERVAL };
                due = Instant::now() + interval;
                let is_news = report.lost > 0
                    || report.damaged.is_some()
                    || self.reported.as_ref() != Some(&report);
                if is_news {
                    self.log(&report);
                    self.reported = Some(report.clone());
                    send(Input::Recorded(Box::new(report)));
                }
            }
        }
    }

    fn problem_before(&self) -> String {
        let reported = self.reported.as_ref().and_then(|reported| reported.problem.clone());
        reported.unwrap_or_else(|| "the history is not open yet; ask again in a moment".to_owned())
    }

    fn log(&self, report: &RecordingReport) {
        let before = self.reported.as_ref().and_then(|reported| reported.problem.as_ref());
        match (&report.problem, before) {
            (Some(problem), _) => tracing::error!("recording is degraded: {problem}"),
            (None, Some(_)) => tracing::info!("recording goes on as it should"),
            (None, None) => {}
        }
        if let Some(damaged) = &report.damaged {
            tracing::error!("{damaged}");
        }
        if report.lost > 0 {
            tracing::error!("{} records are lost", report.lost);
        }
    }

    /// Writes what waits, and forgets what is to be forgotten.
    fn step(&mut self) -> RecordingReport {
        let overflow = self.overflow.swap(0, Ordering::Relaxed);
        if overflow > 0 {
            self.queue.interrupt();
        }
        let mut report = RecordingReport::default();
        if let Err(problem) = self.write(&mut report) {
            report.problem = Some(problem);
        }
        report.lost = self.queue.take_lost().saturating_add(overflow);
        report.coverage =
            self.store.as_ref().map_or_else(Coverage::default, |store| store.coverage());
        report
    }

    fn write(&mut self, report: &mut RecordingReport) -> Result<(), String> {
        let store = match &mut self.store {
            Some(store) => store,
            none => none.insert((self.options.open)(&self.options.place)?),
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
        // Twice the batches that wait at most: one that finds a damaged file is written again.
        for _ in 0..2 * MAX_WAITING_TASKS / MAX_BATCH_RECORDS {
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

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use muster_model::history::{Record, Rows, Subject};
    use muster_model::id::RobotId;
    use muster_model::time::Tick;
    use muster_service::records::MemoryRecords;

    use super::*;

    const WAIT: Duration = Duration::from_secs(10);

    fn place() -> RecordPlace {
        RecordPlace {
            folder: None,
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("i-1").unwrap(),
        }
    }

    fn started(open: OpenRecords) -> (RecordWriter, Receiver<Input>) {
        let (sender, inputs) = mpsc::channel();
        let options = RecordOptions { place: place(), open };
        let send = move |input| drop(sender.send(input));
        (RecordWriter::start(options, send).unwrap().0, inputs)
    }

    fn joined(at: u64) -> Box<Entry> {
        let record = Record::Joined(RobotId::new("r1").unwrap());
        Box::new(Entry { at: Tick(at), record })
    }

    fn report(inputs: &Receiver<Input>) -> RecordingReport {
        loop {
            if let Input::Recorded(report) = inputs.recv_timeout(WAIT).unwrap() {
                return *report;
            }
        }
    }

    #[test]
    fn records_are_written_reported_and_looked_up() {
        let (writer, inputs) = started(|_| Ok(Box::<MemoryRecords>::default()));
        assert_eq!(report(&inputs), RecordingReport::default());
        for at in 1..=3 {
            writer.append(joined(at));
        }
        let written = report(&inputs);
        let through = (written.coverage.sequence, written.coverage.recorded_through);
        assert_eq!(through, (3, Some(Tick(3))));
        assert!(writer.look_up(7, Query::of(Subject::Robots(None))));
        let Input::Found { lookup: 7, page: Ok(page) } = inputs.recv_timeout(WAIT).unwrap() else {
            panic!("no page");
        };
        assert!(matches!(page.rows, Rows::Robots(rows) if rows.len() == 1));
    }

    #[test]
    fn a_store_that_does_not_open_is_reported_and_asked_in_vain() {
        let (writer, inputs) = started(|_| Err("no place".to_owned()));
        assert_eq!(report(&inputs).problem.as_deref(), Some("no place"));
        assert!(writer.look_up(1, Query::of(Subject::Divisions)));
        let found = inputs.recv_timeout(WAIT).unwrap();
        assert_eq!(found, Input::Found { lookup: 1, page: Err("no place".to_owned()) });
    }

    #[test]
    fn what_is_not_written_waits_and_is_written_once_there_is_room() {
        let overflow = Arc::default();
        let open: OpenRecords = |_| {
            let full = WriteError::Full("the disk is full".to_owned());
            Ok(Box::new(MemoryRecords::failing(full)))
        };
        let mut recorder = Recorder::new(RecordOptions { place: place(), open }, overflow);
        recorder.queue.push(*joined(1));
        let full = recorder.step();
        assert_eq!((full.problem.as_deref(), full.lost), (Some("the disk is full"), 0));
        recorder.store = Some(Box::<MemoryRecords>::default());
        let written = recorder.step();
        assert_eq!((written.problem, written.coverage.sequence), (None, 1));
        // A file that was damaged: what comes next must be whole.
        let damaged = WriteError::Damaged("put aside".to_owned());
        recorder.store = Some(Box::new(MemoryRecords::failing(damaged)));
        recorder.queue.push(*joined(2));
        let report = recorder.step();
        assert_eq!(report.damaged.as_deref(), Some("put aside"));
        assert!(report.lost > 0 && report.problem.is_none());
    }
}
