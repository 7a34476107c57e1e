//! A thread of its own that keeps the records of a service: it may wait for a disk as long as that takes, and nothing
//! waits for it.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use anyhow::Context;
use muster_model::history::{Entry, Query, RecordingReport, Retention};
use muster_model::id::{FleetId, InstanceId};
use muster_service::Input;
use muster_service::records::{MAX_BATCH_RECORDS, RecordQueue, Recorder, Records};
use tokio::sync::oneshot;

/// Most tasks that wait for the thread: all gets that the core lets wait, and what is said of retention in some hours in
/// which the disk hangs.
const MAX_WAITING_TASKS: usize = 512;

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
    /// A whole batch has arrived.
    Batch,
    LookUp {
        lookup: u64,
        query: Query,
    },
    Retain(Retention),
}

/// Records that the thread has not taken up. Where the disk hangs, they wait by the rules of every queue of records.
#[derive(Default)]
struct Arriving(Mutex<RecordQueue>);

impl Arriving {
    fn queue(&self) -> MutexGuard<'_, RecordQueue> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Brings all of them to a recorder, and says how many were lost before.
    fn bring_to(&self, recorder: &mut Recorder) -> u64 {
        // The lock is held for a moment: the loop never waits for the recorder.
        let (entries, lost) = {
            let mut queue = self.queue();
            (queue.take(), queue.take_lost())
        };
        entries.into_iter().for_each(|entry| recorder.append(entry));
        lost
    }
}

/// Hands tasks to the thread, which ends when the handle is gone and all records are written.
pub(crate) struct RecordWriter {
    tasks: SyncSender<Task>,
    arriving: Arc<Arriving>,
}

impl RecordWriter {
    /// Starts the thread. `send` brings inputs back to the loop. The returned receiver learns of the thread's end.
    pub(crate) fn start(
        options: RecordOptions,
        send: impl Fn(Input) + Send + 'static,
    ) -> anyhow::Result<(Self, oneshot::Receiver<()>)> {
        let (sender, tasks) = sync_channel(MAX_WAITING_TASKS);
        let arriving = Arc::new(Arriving::default());
        let (done, ended) = oneshot::channel();
        let taken = Arc::clone(&arriving);
        let span = tracing::Span::current();
        std::thread::Builder::new()
            .name("muster-records".to_owned())
            .spawn(move || {
                let _service = span.enter();
                let recorder = Recorder::new(move || (options.open)(&options.place));
                run(recorder, &taken, &tasks, &send);
                let _ = done.send(());
            })
            .context("cannot start the thread that writes records")?;
        Ok((Self { tasks: sender, arriving }, ended))
    }

    /// Appends a record; [`Input::Recorded`] follows. Never waits for the disk: where too many records wait, the oldest
    /// minutes are lost, and counted in the next report.
    #[expect(clippy::boxed_local, reason = "commands have their record in a box")]
    pub(crate) fn append(&self, entry: Box<Entry>) {
        let waiting = {
            let mut queue = self.arriving.queue();
            queue.push(*entry);
            queue.len()
        };
        if waiting == MAX_BATCH_RECORDS {
            // A thread that has tasks is awake.
            let _ = self.tasks.try_send(Task::Batch);
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

/// Drives a recorder by the clock until the handle is gone.
fn run(mut recorder: Recorder, arriving: &Arriving, tasks: &Receiver<Task>, send: &impl Fn(Input)) {
    // The first step opens the store and reports what it holds.
    let mut due = Instant::now();
    let mut had_problem = false;
    let mut overflow = 0;
    loop {
        let wait = due.saturating_duration_since(Instant::now());
        match tasks.recv_timeout(wait) {
            Ok(Task::Batch) | Err(RecvTimeoutError::Timeout) => {}
            Ok(Task::LookUp { lookup, query }) => {
                send(Input::Found { lookup, page: recorder.answer(&query) });
            }
            Ok(Task::Retain(retention)) => recorder.retain(retention),
            Err(RecvTimeoutError::Disconnected) => {
                overflow += arriving.bring_to(&mut recorder);
                recorder.step(overflow);
                return;
            }
        }
        overflow += arriving.bring_to(&mut recorder);
        if recorder.is_full() || Instant::now() >= due {
            let step = recorder.step(std::mem::take(&mut overflow));
            due = Instant::now() + step.next;
            if let Some(report) = step.news {
                log(&report, had_problem);
                had_problem = report.problem.is_some();
                send(Input::Recorded(Box::new(report)));
            }
        }
    }
}

fn log(report: &RecordingReport, had_problem: bool) {
    match (&report.problem, had_problem) {
        (Some(problem), _) => tracing::error!("recording is degraded: {problem}"),
        (None, true) => tracing::info!("recording goes on as it should"),
        (None, false) => {}
    }
    if let Some(damaged) = &report.damaged {
        tracing::error!("{damaged}");
    }
    if report.lost > 0 {
        tracing::error!("{} records are lost", report.lost);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::time::Duration;

    use muster_model::history::{Coverage, Page, Record, Rows, Subject};
    use muster_model::id::RobotId;
    use muster_model::time::Tick;
    use muster_service::records::{MemoryRecords, WriteError};

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

    /// What is on the disk of [`Hanging`], which hangs as long as a test holds this.
    static HANGING: Mutex<Vec<Entry>> = Mutex::new(Vec::new());

    #[derive(Default)]
    struct Hanging(MemoryRecords);

    impl Records for Hanging {
        fn write(&mut self, entries: &[Entry]) -> Result<(), WriteError> {
            HANGING.lock().unwrap().extend_from_slice(entries);
            self.0.write(entries)
        }

        fn coverage(&self) -> Coverage {
            self.0.coverage()
        }

        fn retain(&mut self, retention: &Retention) -> Result<bool, WriteError> {
            self.0.retain(retention)
        }

        fn answer(&mut self, query: &Query) -> Result<Page, String> {
            self.0.answer(query)
        }
    }

    #[test]
    fn while_the_disk_hangs_the_oldest_records_are_lost_and_a_gap_stands_for_them() {
        let (writer, inputs) = started(|_| Ok(Box::<Hanging>::default()));
        report(&inputs);
        let disk = HANGING.lock().unwrap();
        // Far more than may wait, a minute for each thousand.
        let count = 200_000;
        for at in 1..=count {
            writer.append(joined(at * 60_000));
        }
        drop(disk);
        let mut lost = 0;
        loop {
            let report = report(&inputs);
            lost += report.lost;
            if report.coverage.recorded_through == Some(Tick(count * 60_000)) {
                break;
            }
        }
        let written = HANGING.lock().unwrap();
        let gaps = written.iter().filter_map(|entry| match entry.record {
            Record::Gap { records, .. } => Some(records),
            _ => None,
        });
        let gaps: Vec<u64> = gaps.collect();
        assert!(lost > 0 && gaps.iter().sum::<u64>() == lost, "{lost}, {gaps:?}");
        assert_eq!(written.len() as u64, count - lost + gaps.len() as u64);
    }

    #[test]
    fn a_store_that_does_not_open_is_reported_and_asked_in_vain() {
        let (writer, inputs) = started(|_| Err("no place".to_owned()));
        assert_eq!(report(&inputs).problem.as_deref(), Some("no place"));
        assert!(writer.look_up(1, Query::of(Subject::Divisions)));
        let found = inputs.recv_timeout(WAIT).unwrap();
        assert_eq!(found, Input::Found { lookup: 1, page: Err("no place".to_owned()) });
    }
}
