//! Failed jobs are reported at a bounded rate: frames come many times a second, and each may fail.

use std::time::Duration;

use muster_model::time::Tick;

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

#[cfg(test)]
mod tests {
    use super::*;

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
