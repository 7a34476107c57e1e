//! Failed jobs are reported at a bounded rate: frames come many times a second, and each may fail.

use std::time::Duration;

use muster_model::time::Tick;
use muster_wire::message::plain_reason;

/// How long a failure of the same kind is not reported again.
const REPORT_INTERVAL: Duration = Duration::from_secs(2);

/// When which kind of failure was last reported.
#[derive(Debug, Default)]
pub(crate) struct Failures {
    reported: Option<(&'static str, Tick)>,
}

impl Failures {
    /// Whether a failure of a kind is to be reported now; it counts as reported then.
    pub(crate) fn is_to_be_reported(&mut self, now: Tick, kind: &'static str) -> bool {
        let is_recent = |(last, at): (&str, Tick)| last == kind && now.since(at) < REPORT_INTERVAL;
        let due = !self.reported.is_some_and(is_recent);
        if due {
            self.reported = Some((kind, now));
        }
        due
    }
}

/// Jobs that have failed without one in between that has not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobsFailing {
    /// When the first of them ended.
    pub since: Tick,
    /// Why the last of them failed.
    pub reason: String,
}

/// How the last jobs have ended.
#[derive(Debug, Default)]
pub(crate) struct JobOutcomes {
    failing: Option<JobsFailing>,
}

impl JobOutcomes {
    pub(crate) fn failed(&mut self, now: Tick, reason: &str) {
        let since = self.failing.as_ref().map_or(now, |failing| failing.since);
        self.failing = Some(JobsFailing { since, reason: plain_reason(reason) });
    }

    /// A job has not failed, or what it was for is over.
    pub(crate) fn succeeded(&mut self) {
        self.failing = None;
    }

    /// Since when every job has failed; none if the last one has not.
    pub(crate) fn failing(&self) -> Option<&JobsFailing> {
        self.failing.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_fail_from_the_first_failure_to_the_next_success() {
        let mut jobs = JobOutcomes::default();
        assert_eq!(jobs.failing(), None);
        jobs.failed(Tick(1), "first");
        jobs.failed(Tick(2), "last");
        let failing = JobsFailing { since: Tick(1), reason: "last".to_owned() };
        assert_eq!(jobs.failing(), Some(&failing));
        jobs.succeeded();
        assert_eq!(jobs.failing(), None);
    }

    #[test]
    fn the_same_kind_is_reported_every_two_seconds() {
        let mut failures = Failures::default();
        let start = Tick(1_000_000_000);
        let times = (0..5).map(|second| start.after(Duration::from_secs(second)));
        let reported: Vec<bool> = times.map(|at| failures.is_to_be_reported(at, "panic")).collect();
        assert_eq!(reported, [true, false, true, false, true]);
        assert!(failures.is_to_be_reported(start.after(Duration::from_secs(4)), "alpha"));
    }
}
