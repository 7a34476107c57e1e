//! Many seeds on all processors, and what they were like together.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::{Effort, Mutant, Options, Outcome, Stats, has_fault, in_ticks, shrink, simulate};

/// Most lines of a failing run that are printed; the command that replays it prints them all.
const MAX_PRINTED: usize = 160;

/// Which seeds to run, and how.
#[derive(Debug, Clone)]
pub struct Batch {
    /// The first seed.
    pub first: u64,
    /// How many.
    pub seeds: u64,
    /// How many threads.
    pub jobs: usize,
    /// How each run is to be.
    pub options: Options,
    /// The kind of a fault without which a seed is left out.
    pub having: Option<String>,
    /// What is broken on purpose.
    pub mutant: Option<Mutant>,
    /// How long a failing run may be shortened.
    pub shrink_within: Duration,
}

/// What the runs were like.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// How many runs there were.
    pub runs: u64,
    /// All added up.
    pub total: Stats,
    /// The longest time to agreement in microseconds, and its seed.
    pub worst: (u64, u64),
    /// The runs that broke a promise, by seed.
    pub failed: BTreeMap<u64, String>,
}

impl Summary {
    fn add(&mut self, outcome: &Outcome) {
        self.runs += 1;
        let (total, stats) = (&mut self.total, &outcome.stats);
        total.events += stats.events;
        total.simulated += stats.simulated;
        total.lost += stats.lost;
        total.repeated += stats.repeated;
        total.mixed += stats.mixed;
        total.panics += stats.panics;
        total.published += stats.published;
        total.divisions += stats.divisions;
        total.takeovers += stats.takeovers;
        total.joined += stats.joined;
        total.proposals += stats.proposals;
        total.proposals_refused += stats.proposals_refused;
        total.proposals_compared += stats.proposals_compared;
        total.bridged += stats.bridged;
        total.scenes += stats.scenes;
        total.remembered = total.remembered.max(stats.remembered);
        for (kind, count) in &stats.faults {
            *total.faults.entry(kind).or_default() += count;
        }
        if outcome.failure.is_none() {
            self.worst = self.worst.max((stats.agreement, outcome.seed));
        }
    }

    /// The summary as text.
    #[must_use]
    pub fn text(&self) -> String {
        let total = &self.total;
        let mut text = format!(
            "{} runs, {} events in {} virtual minutes, {} messages and {} divisions published\n",
            self.runs,
            total.events,
            total.simulated / 60_000_000,
            total.published,
            total.divisions
        );
        let faults: u64 = total.faults.values().sum();
        let kinds: Vec<String> =
            total.faults.iter().map(|(kind, count)| format!("{kind} {count}")).collect();
        let _ = writeln!(text, "{faults} faults: {}", kinds.join(", "));
        let _ = writeln!(
            text,
            "messages lost {}, repeated {}, overtaken {}; job panics {}",
            total.lost, total.repeated, total.mixed, total.panics
        );
        let _ = writeln!(
            text,
            "takeovers checked {}, gets of late joiners {}; most robots remembered {}",
            total.takeovers, total.joined, total.remembered
        );
        let _ = writeln!(
            text,
            "proposals read {}, refused {}, compared with the division {}",
            total.proposals, total.proposals_refused, total.proposals_compared
        );
        let _ = writeln!(
            text,
            "reports put for robots of ROS {}, messages sent to viewers {}",
            total.bridged, total.scenes
        );
        let (worst, seed) = self.worst;
        let _ = writeln!(text, "longest time to agreement: {}, seed {seed}", in_ticks(worst));
        let failed: Vec<String> = self.failed.keys().map(ToString::to_string).collect();
        let failed = if failed.is_empty() { "none".to_owned() } else { failed.join(", ") };
        let _ = writeln!(text, "seeds that broke a promise: {failed}");
        text
    }
}

/// Runs a batch. `failed` is called with the report of each run that breaks a promise, made short;
/// `progress` is called after every run, with how many have ended.
pub fn run_batch(
    batch: &Batch,
    progress: impl Fn(u64, &Outcome) + Sync,
    failed: impl Fn(&str) + Sync,
) -> Summary {
    let next = AtomicU64::new(0);
    let summary = Mutex::new(Summary::default());
    std::thread::scope(|scope| {
        for _ in 0..batch.jobs.max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= batch.seeds {
                        return;
                    }
                    let seed = batch.first.saturating_add(number);
                    let is_wanted = |kind: &String| has_fault(seed, &batch.options, &[kind]);
                    if !batch.having.as_ref().is_none_or(is_wanted) {
                        continue;
                    }
                    let outcome = simulate(seed, &batch.options, batch.mutant, false);
                    let report = outcome.failure.is_some().then(|| report(batch, &outcome));
                    let mut summary = summary.lock().unwrap_or_else(PoisonError::into_inner);
                    summary.add(&outcome);
                    if let Some(report) = report {
                        failed(&report);
                        summary.failed.insert(seed, report);
                    }
                    progress(summary.runs, &outcome);
                }
            });
        }
    });
    summary.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// The report of a run that broke a promise.
fn report(batch: &Batch, outcome: &Outcome) -> String {
    let Some(failure) = &outcome.failure else { return String::new() };
    let shrunk = shrink(
        outcome.seed,
        &batch.options,
        batch.mutant,
        failure,
        Effort::Time(batch.shrink_within),
    );
    let mut text = format!(
        "seed {} breaks the promise: {}\n  {}\n",
        outcome.seed, failure.promise, failure.seen
    );
    let _ = writeln!(
        text,
        "the shortest run found after {} tries has {} robots and {} of {} faults:",
        shrunk.tries,
        shrunk.outcome.robots,
        shrunk.faults.len(),
        shrunk.of
    );
    for fault in &shrunk.outcome.faults {
        let _ = writeln!(text, "  {fault}");
    }
    if let Some(failure) = &shrunk.outcome.failure {
        let _ = writeln!(text, "and ends with: {}", failure.seen);
    }
    let lines = &shrunk.outcome.log;
    let from = lines.len().saturating_sub(MAX_PRINTED);
    let _ = writeln!(text, "its log, the last {} of {} lines:", lines.len() - from, lines.len());
    for line in &lines[from..] {
        let _ = writeln!(text, "  {line}");
    }
    let _ = writeln!(text, "replay it: {}", shrunk.outcome.command(&shrunk.options));
    text
}
