//! One job at a time, for the newest input, and what becomes of failures.

use std::time::Duration;

use muster_model::time::Tick;
use muster_wire::message::quoted;

/// How long after a panic the same task is tried again: a fault that comes and goes must not stop a
/// service for good, and one that stays must not keep a processor busy.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// How long a failure of the same kind is not told again: frames come many times a second, and each
/// may fail.
const SILENCE: Duration = Duration::from_secs(2);

/// Lets one job run at a time. A task says what a job is for, so that the same is not done twice.
///
/// There is no queue: a core keeps its newest input itself and asks again when a job has ended. What
/// was newest in between is never computed.
#[derive(Debug)]
pub struct JobGate<Task> {
    running: Option<Task>,
    settled: Option<Task>,
    retry: Option<Tick>,
    standing: Option<String>,
    told: Option<(&'static str, Tick)>,
    /// Whether a job that is for no task runs.
    aside: bool,
    abandoned: bool,
}

impl<Task> Default for JobGate<Task> {
    fn default() -> Self {
        Self {
            running: None,
            settled: None,
            retry: None,
            standing: None,
            told: None,
            aside: false,
            abandoned: false,
        }
    }
}

impl<Task: PartialEq> JobGate<Task> {
    /// Whether a job for a task should start now: none runs, and the task is another one than the
    /// last, or the last has panicked and its time has come again.
    #[must_use]
    pub fn wants(&self, now: Tick, task: &Task) -> bool {
        !self.is_running()
            && (self.settled.as_ref() != Some(task) || self.retry.is_some_and(|at| at <= now))
    }

    /// A job for a task starts.
    pub fn started(&mut self, task: Task) {
        self.retry = None;
        self.running = Some(task);
    }

    /// A job starts that is for no task, such as one whose result answers a get: it keeps others from
    /// starting and leaves no trace. One that panics is no failure of a task either.
    pub fn started_aside(&mut self) {
        self.aside = true;
    }

    /// Such a job has ended, if one ran; whether one did.
    pub fn ended_aside(&mut self) -> bool {
        std::mem::take(&mut self.aside)
    }

    /// Such a job has panicked, if one ran; whether one did. What it held is lost, so that the last task
    /// is done again after a while.
    pub fn failed_aside(&mut self, now: Tick) -> bool {
        let failed = self.ended_aside();
        if failed {
            self.retry = Some(now.after(RETRY_AFTER));
        }
        failed
    }

    /// Whether a job runs.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.aside || self.running.is_some()
    }

    /// The task of the last job that has ended.
    #[must_use]
    pub fn settled(&self) -> Option<&Task> {
        self.settled.as_ref()
    }

    /// The gate of an instance that begins anew while a job of its former self may still run: that
    /// one's result is not wanted, and no other starts beside it.
    #[must_use]
    pub fn abandoned(&mut self) -> Self {
        let abandoned = self.is_running();
        Self { abandoned, aside: self.aside, running: self.running.take(), ..Self::default() }
    }

    /// Whether the job that has just ended was [`JobGate::abandoned`]: then it is as if it had never
    /// been.
    #[must_use]
    pub fn was_abandoned(&mut self) -> bool {
        let abandoned = std::mem::take(&mut self.abandoned);
        if abandoned {
            self.running = None;
            self.aside = false;
        }
        abandoned
    }

    /// The job has ended well.
    pub fn succeeded(&mut self) {
        self.settled = self.running.take();
        self.standing = None;
    }

    /// The job has ended with an error that the same task would meet again. What is returned is to
    /// be told; nothing, if the like has just been told.
    pub fn refused(&mut self, now: Tick, kind: &'static str, reason: String) -> Option<String> {
        self.settled = self.running.take();
        self.fail(now, kind, reason)
    }

    /// The job has panicked; the task will be tried again. What is returned is to be told: what a
    /// panic says may hold words of a message, and is made fit for a log line.
    pub fn panicked(&mut self, now: Tick, said: &str) -> Option<String> {
        self.settled = self.running.take();
        self.retry = Some(now.after(RETRY_AFTER));
        self.fail(now, "panic", format!("the job panicked: {}", quoted(said)))
    }

    fn fail(&mut self, now: Tick, kind: &'static str, reason: String) -> Option<String> {
        self.standing = Some(reason.clone());
        if self.told.is_some_and(|(told, at)| told == kind && now.since(at) < SILENCE) {
            return None;
        }
        self.told = Some((kind, now));
        Some(reason)
    }

    /// Why the newest task has no result, if it has none.
    #[must_use]
    pub fn standing_failure(&self) -> Option<&str> {
        self.standing.as_deref()
    }

    /// When a failed task is to be tried again.
    #[must_use]
    pub fn deadline(&self) -> Option<Tick> {
        self.retry.filter(|_| !self.is_running())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Tick = Tick(1_000_000_000);

    #[test]
    fn one_job_runs_and_the_same_task_is_not_done_twice() {
        let mut gate = JobGate::default();
        assert!(gate.wants(NOW, &1));
        gate.started(1);
        assert!(!gate.wants(NOW, &1) && !gate.wants(NOW, &2));
        gate.succeeded();
        assert!(!gate.wants(NOW, &1) && gate.wants(NOW, &2));
    }

    #[test]
    fn a_panic_is_tried_again_and_told_at_intervals() {
        let mut gate = JobGate::default();
        let mut told = 0;
        let mut now = NOW;
        for _ in 0..50 {
            if gate.wants(now, &1) {
                gate.started(1);
                told += usize::from(gate.panicked(now, "x").is_some());
            }
            now = now.after(Duration::from_millis(100));
        }
        assert_eq!(told, 3, "five tries in five seconds, each second one told");
        assert!(gate.standing_failure().unwrap().contains('x'));
        assert!(gate.wants(now, &2), "another task does not wait");
    }

    #[test]
    fn a_job_aside_holds_others_up_and_leaves_no_trace() {
        let mut gate = JobGate::default();
        gate.started(1);
        gate.succeeded();
        gate.started_aside();
        assert!(gate.is_running() && !gate.wants(NOW, &2));
        assert!(gate.ended_aside() && !gate.ended_aside());
        assert!(!gate.wants(NOW, &1) && gate.wants(NOW, &2));
        gate.started_aside();
        let mut anew = gate.abandoned();
        assert!(!anew.wants(NOW, &2));
        assert!(anew.was_abandoned() && !anew.ended_aside() && anew.wants(NOW, &1));
    }

    #[test]
    fn an_error_is_not_tried_again_on_the_same_input() {
        let mut gate = JobGate::default();
        gate.started(1);
        assert!(gate.refused(NOW, "alpha", "too large".to_owned()).is_some());
        assert_eq!(gate.deadline(), None);
        assert!(!gate.wants(NOW.after(Duration::from_secs(60)), &1) && gate.wants(NOW, &2));
        gate.started(2);
        assert!(gate.refused(NOW, "alpha", "too large".to_owned()).is_none());
        gate.started(3);
        gate.succeeded();
        assert_eq!(gate.standing_failure(), None);
    }
}
