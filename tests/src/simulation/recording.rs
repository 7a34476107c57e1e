//! The records of historians: a virtual disk for each, and the real recorder that writes to it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use muster_model::history::{Coverage, Entry, Page, Query, RecordingReport, Retention};
use muster_model::id::ServiceName;
use muster_service::Input;
use muster_service::records::{
    COMMIT_INTERVAL, MemoryRecords, RETRY_INTERVAL, Recorder, Records, WriteError,
};
use muster_wire::Message;

use super::clock::{MS, Micros, SECOND};
use super::oracle::breach;
use super::world::{Event, World};

/// How long a transaction takes.
const WRITE_TIME: (Micros, Micros) = (MS, 8 * MS);

/// How long all go on agreeing while a disk is full before there is room again.
const FULL_TIME: Micros = 4 * SECOND;

/// How old a division may be then: two heartbeats of the slowest setting.
const DIVISION_AGE: Micros = 4 * SECOND;

/// How soon recording has caught up once its disk has room, or its process runs: an attempt, a transaction, and a second
/// for what was under way.
const CATCH_UP_TIME: Duration =
    RETRY_INTERVAL.saturating_add(COMMIT_INTERVAL).saturating_add(Duration::from_secs(2));

/// A disk, which outlives the process.
#[derive(Debug, Clone, Default)]
pub(crate) struct Disk(Arc<Mutex<Content>>);

#[derive(Debug, Default)]
struct Content {
    records: MemoryRecords,
    /// What is on it, in order.
    entries: Vec<Entry>,
    /// How many of those were there before the last transaction.
    before_last: usize,
    is_full: bool,
    /// Whether a write to the full disk is taken for one that ended well.
    is_careless: bool,
}

impl Disk {
    fn content(&self) -> MutexGuard<'_, Content> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether there is no room.
    pub(crate) fn is_full(&self) -> bool {
        self.content().is_full
    }

    /// From now on there is no room, or there is again.
    pub(crate) fn fill(&self, is_full: bool) {
        self.content().is_full = is_full;
    }

    /// From now on what is not written is taken for written.
    pub(crate) fn be_careless(&self) {
        self.content().is_careless = true;
    }

    /// Loses the last transaction.
    pub(crate) fn lose_last(&self) {
        let mut content = self.content();
        let kept = content.before_last;
        content.entries.truncate(kept);
        let mut records = MemoryRecords::default();
        // A store in memory without a fault writes everything.
        let _ = records.write(&content.entries);
        content.records = records;
    }

    /// What is on it.
    pub(crate) fn entries(&self) -> Vec<Entry> {
        self.content().entries.clone()
    }
}

impl Records for Disk {
    fn write(&mut self, entries: &[Entry]) -> Result<(), WriteError> {
        let mut content = self.content();
        if content.is_full && !content.is_careless {
            return Err(WriteError::Full("the virtual disk is full".to_owned()));
        }
        content.records.write(entries)?;
        if !content.is_full {
            content.before_last = content.entries.len();
            content.entries.extend_from_slice(entries);
        }
        Ok(())
    }

    fn coverage(&self) -> Coverage {
        self.content().records.coverage()
    }

    fn retain(&mut self, retention: &Retention) -> Result<bool, WriteError> {
        self.content().records.retain(retention)
    }

    fn answer(&mut self, query: &Query) -> Result<Page, String> {
        self.content().records.answer(query)
    }

    fn shortage(&mut self) -> Option<String> {
        let content = self.content();
        (content.is_full && !content.is_careless).then(|| "the virtual disk is full".to_owned())
    }
}

impl Disk {
    /// The recorder of a process.
    pub(crate) fn recorder(&self) -> Recorder {
        let disk = self.clone();
        Recorder::new(move || Ok(Box::new(disk.clone())))
    }
}

impl World {
    /// The recorder of a process writes what waits.
    pub(super) fn write_records(&mut self, index: usize, life: u32) {
        let resigns = self.mutator.resigns();
        let node = &mut self.nodes[index];
        if node.life != life {
            return;
        }
        let Some(recorder) = node.process.as_mut().and_then(|process| process.recorder.as_mut())
        else {
            return;
        };
        let step = recorder.step(0);
        let next = Micros::try_from(step.next.as_micros()).unwrap_or(Micros::MAX);
        if let Some(report) = step.news {
            let time = node.chance.between(WRITE_TIME.0, WRITE_TIME.1);
            let report = Box::new(report);
            self.schedule(self.now + time, Event::Written { node: index, life, report });
        }
        if !(resigns && step.next == RETRY_INTERVAL) {
            self.schedule(self.now + next, Event::WriteRecords { node: index, life });
        }
    }

    /// The host learns what became of records.
    pub(super) fn written(&mut self, index: usize, life: u32, report: Box<RecordingReport>) {
        let node = &mut self.nodes[index];
        if node.life == life {
            node.complete(Input::Recorded(report));
            self.schedule_step(index);
        }
    }

    /// A record, a lookup, or what is to be forgotten, on its way to the recorder of a process.
    pub(super) fn with_recorder(&mut self, index: usize, act: impl FnOnce(&mut Recorder)) {
        let process = self.nodes[index].process.as_mut();
        if let Some(recorder) = process.and_then(|process| process.recorder.as_mut()) {
            act(recorder);
        }
    }

    /// Notes what a historian is about to receive.
    pub(super) fn note_received(&mut self, index: usize, input: &Input) {
        let node = &self.nodes[index];
        if node.service != ServiceName::Historian || !self.is_judged() {
            return;
        }
        if let Input::Answered { answers, .. } = input {
            for answer in answers {
                if let Ok(Message::Teams { teams, .. }) = answer.clone().into_message(&self.space) {
                    let revision = teams.header.revision;
                    self.oracle.recorded.learned(self.nodes[index].instance, revision);
                }
            }
        }
        let Input::Arrived(arrival) = input else { return };
        let (Some(process), Ok(message)) =
            (&node.process, arrival.clone().into_message(&self.space))
        else {
            return;
        };
        let at = process.clock.tick(self.now);
        self.oracle.recorded.received(node.instance, at, &message);
    }

    /// Whether all that is published is believed, so that all of it must be recorded.
    fn is_judged(&self) -> bool {
        self.clocks_agree && !self.oracle.had_forged_terms()
    }

    /// Checks what a historian promises to keep against what is on its disk.
    pub(super) fn check_promised(&mut self, index: usize, message: &Message) {
        let node = &self.nodes[index];
        let (Message::HistoryState(state), Some(disk)) = (message, &node.disk) else { return };
        let (entries, instance, whole) = (disk.entries(), node.instance, self.is_judged());
        let checked = self.oracle.promised(instance, state, &entries, whole);
        self.require(checked);
    }

    /// A disk has room again.
    pub(super) fn free_disk(&mut self, index: usize) {
        if let Some(disk) = self.nodes[index].disk.as_ref().filter(|disk| disk.is_full()) {
            disk.fill(false);
            self.nodes[index].recording_since = self.now;
            let name = self.nodes[index].name();
            self.log.line(self.now, format_args!("the disk of {name} has room again"));
        }
    }

    /// In the quiet: frees disks once all have agreed for a while without them, and requires that recording goes on by
    /// itself. True if nothing is left to wait for.
    pub(super) fn historians_have_recorded(&mut self, settled_for: Option<Micros>) -> bool {
        let catch_up = Micros::try_from(CATCH_UP_TIME.as_micros()).unwrap_or(Micros::MAX);
        // A division of robots that have all left need not be replaced, where nobody is left who knows it.
        let has_robots = !self.robots.alive().is_empty();
        let mut all = true;
        for index in 0..self.nodes.len() {
            let node = &self.nodes[index];
            let (Some(disk), Some(process)) = (&node.disk, &node.process) else { continue };
            if disk.is_full() {
                all = false;
                if settled_for.is_some_and(|time| time >= FULL_TIME) {
                    if has_robots && self.now > self.division_at + DIVISION_AGE {
                        let seen = format!("the last division is of {} µs", self.division_at);
                        self.require(breach("a full disk stops no division", seen));
                    }
                    self.free_disk(index);
                }
                continue;
            }
            let recording_since = node.recording_since.max(self.quiet_since());
            if self.now < recording_since + catch_up {
                all = false;
                continue;
            }
            if !self.is_judged() {
                continue;
            }
            let before = process.clock.tick(self.now.saturating_sub(catch_up));
            let (instance, name) = (node.instance, node.name());
            if let Some(behind) = self.oracle.is_behind(instance, before) {
                let promise = "recording goes on by itself once there is room";
                self.require(breach(promise, format!("{name}: {behind}")));
            }
        }
        all
    }
}
