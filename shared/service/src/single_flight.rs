//! One job at a time for the newest input: which task a job is for, and what became of the last one.
//!
//! There is no queue. A core keeps its newest input itself and asks again when a job has ended;
//! whatever was newest in between is never computed.

use std::fmt::Display;
use std::time::Duration;

use muster_model::time::Tick;

use crate::{Context, Core, JobEnd};

/// How long after a panic the same task is tried again: a fault that comes and goes must not stop a
/// service for good, and a lasting one must not keep a processor busy.
const RETRY_DELAY: Duration = Duration::from_secs(1);

/// Remembers the task that runs and the task that ran last, so that the same is not done twice.
#[derive(Debug)]
pub struct SingleFlight<Task> {
    running: Option<Task>,
    completed: Option<Task>,
    failure: Option<String>,
    retry_at: Option<Tick>,
}

impl<Task> Default for SingleFlight<Task> {
    fn default() -> Self {
        Self { running: None, completed: None, failure: None, retry_at: None }
    }
}

impl<Task: PartialEq> SingleFlight<Task> {
    /// Whether a job should start for a task: it differs from the last one, or that one panicked and
    /// its time has come again.
    #[must_use]
    pub fn should_start(&self, now: Tick, task: &Task) -> bool {
        let retries = self.retry_at.is_some_and(|at| at <= now);
        self.running.is_none() && (self.completed.as_ref() != Some(task) || retries)
    }

    /// A job for a task starts.
    pub fn started(&mut self, task: Task) {
        self.retry_at = None;
        self.running = Some(task);
    }

    /// The job has ended. Returns its result; a failure is counted and reported by an event, at a bounded
    /// rate for each `kind` of error.
    pub fn ended<C: Core, T, E: Display>(
        &mut self,
        context: &mut Context<'_, C>,
        kind: impl Fn(&E) -> &'static str,
        end: JobEnd<Result<T, E>>,
    ) -> Option<T> {
        match end {
            JobEnd::Finished(Ok(result)) => {
                context.report_job_success();
                self.succeeded();
                return Some(result);
            }
            JobEnd::Finished(Err(error)) => {
                let reason = error.to_string();
                context.report_job_failure(kind(&error), &reason);
                self.refused(reason);
            }
            JobEnd::Panicked(reason) => {
                context.report_job_failure("panic", &reason);
                self.panicked(context.now(), reason);
            }
        }
        None
    }

    /// The job has ended well.
    fn succeeded(&mut self) {
        self.completed = self.running.take();
        self.failure = None;
    }

    /// The job has ended with an error that the same task would meet again.
    fn refused(&mut self, reason: String) {
        self.completed = self.running.take();
        self.failure = Some(reason);
    }

    /// The job has panicked; the task is tried again later.
    fn panicked(&mut self, now: Tick, reason: String) {
        self.refused(reason);
        self.retry_at = Some(now.after(RETRY_DELAY));
    }

    /// A job that was for no task has panicked and lost what it held, so that the last task is done
    /// again later.
    pub fn side_job_panicked(&mut self, now: Tick) {
        self.retry_at = Some(now.after(RETRY_DELAY));
    }

    /// The task of the last job that has ended.
    #[must_use]
    pub fn completed(&self) -> Option<&Task> {
        self.completed.as_ref()
    }

    /// Why the last task has no result, if it has none.
    #[must_use]
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// When a task that panicked is to be tried again.
    #[must_use]
    pub fn retry_at(&self) -> Option<Tick> {
        self.retry_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Tick = Tick(1_000_000_000);

    #[test]
    fn one_job_runs_and_the_same_task_is_not_done_twice() {
        let mut flight = SingleFlight::default();
        assert!(flight.should_start(NOW, &1));
        flight.started(1);
        assert!(!flight.should_start(NOW, &1) && !flight.should_start(NOW, &2));
        flight.succeeded();
        assert!(!flight.should_start(NOW, &1) && flight.should_start(NOW, &2));
    }

    #[test]
    fn a_task_that_panicked_is_tried_again_each_second() {
        let mut flight = SingleFlight::default();
        let mut started = 0;
        let mut now = NOW;
        for _ in 0..50 {
            if flight.should_start(now, &1) {
                flight.started(1);
                flight.panicked(now, "x".to_owned());
                started += 1;
            }
            now = now.after(Duration::from_millis(100));
        }
        assert_eq!(started, 5);
        assert_eq!(flight.failure(), Some("x"));
        assert!(flight.should_start(now, &2), "another task does not wait");
    }

    #[test]
    fn after_the_panic_of_a_side_job_the_last_task_is_done_again() {
        let mut flight = SingleFlight::default();
        flight.started(1);
        flight.succeeded();
        flight.side_job_panicked(NOW);
        assert!(!flight.should_start(NOW, &1));
        assert!(flight.should_start(NOW.after(RETRY_DELAY), &1));
    }

    #[test]
    fn an_error_is_not_tried_again_on_the_same_input() {
        let mut flight = SingleFlight::default();
        flight.started(1);
        flight.refused("too large".to_owned());
        assert_eq!((flight.retry_at(), flight.failure()), (None, Some("too large")));
        assert!(!flight.should_start(NOW.after(Duration::from_secs(60)), &1));
        assert!(flight.should_start(NOW, &2));
        flight.started(2);
        flight.succeeded();
        assert_eq!(flight.failure(), None);
    }
}
