//! From a failing run to the shortest one that fails in the same way.
//!
//! Faults are left out by delta debugging (Zeller and Hildebrandt 2002): first those that come after
//! the failure, then halves, quarters and so on, and single ones, as far as is tried. Then
//! robots are left out from the end.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use super::{Failure, Mutant, Options, Outcome, simulate};

/// How much is tried to make a run short.
#[derive(Debug, Clone, Copy)]
pub enum Effort {
    /// As much as fits into a time.
    Time(Duration),
    /// So many runs: the same on every machine.
    Runs(usize),
}

/// A failing run made short.
#[derive(Debug, Clone)]
pub struct Shrunk {
    /// The run, with its log.
    pub outcome: Outcome,
    /// Its options: perhaps fewer robots.
    pub options: Options,
    /// The numbers of the faults that are left.
    pub faults: BTreeSet<usize>,
    /// How many faults there were.
    pub of: usize,
    /// How many runs were tried.
    pub tries: usize,
}

/// Shortens a failing run.
#[must_use]
pub fn shrink(
    seed: u64,
    options: &Options,
    mutant: Option<Mutant>,
    failure: &Failure,
    effort: Effort,
) -> Shrunk {
    let mut search = Search {
        seed,
        options: options.clone(),
        mutant,
        promise: failure.promise,
        begun: Instant::now(),
        effort,
        tries: 0,
    };
    let of = failure.planned;
    let all: Vec<usize> = match &options.only {
        Some(only) => only.iter().copied().collect(),
        None => (0..of).collect(),
    };
    let mut kept = all;
    if search.fails(&failure.happened) {
        kept = failure.happened.iter().copied().collect();
    }
    kept = search.minimize(kept);
    search.fewer_robots(&kept);
    let faults: BTreeSet<usize> = kept.into_iter().collect();
    let options = Options { only: Some(faults.clone()), ..search.options.clone() };
    let outcome = simulate(seed, &options, mutant, true);
    Shrunk { outcome, options, faults, of, tries: search.tries }
}

struct Search {
    seed: u64,
    options: Options,
    mutant: Option<Mutant>,
    promise: &'static str,
    begun: Instant,
    effort: Effort,
    tries: usize,
}

impl Search {
    fn fleet(&self) -> usize {
        self.options.scale(self.seed).fleet
    }

    fn is_over(&self) -> bool {
        match self.effort {
            Effort::Time(time) => self.begun.elapsed() >= time,
            Effort::Runs(runs) => self.tries >= runs,
        }
    }

    /// Whether the run still breaks the same promise with these faults alone.
    fn fails(&mut self, faults: &BTreeSet<usize>) -> bool {
        self.tries += 1;
        let options = Options { only: Some(faults.clone()), ..self.options.clone() };
        let outcome = simulate(self.seed, &options, self.mutant, false);
        outcome.failure.is_some_and(|failure| failure.promise == self.promise)
    }

    fn minimize(&mut self, mut kept: Vec<usize>) -> Vec<usize> {
        let mut parts = 2;
        if !kept.is_empty() && self.fails(&BTreeSet::new()) {
            return Vec::new();
        }
        while kept.len() > 1 && !self.is_over() {
            let size = kept.len().div_ceil(parts);
            let chunks: Vec<Vec<usize>> = kept.chunks(size).map(<[usize]>::to_vec).collect();
            let without = |chunk: &[usize]| -> Vec<usize> {
                kept.iter().copied().filter(|number| !chunk.contains(number)).collect()
            };
            let alone = chunks.iter().cloned();
            let candidates: Vec<Vec<usize>> = if parts == 2 {
                alone.collect()
            } else {
                alone.chain(chunks.iter().map(|chunk| without(chunk))).collect()
            };
            let mut found = None;
            for candidate in candidates {
                if self.is_over() {
                    break;
                }
                if self.fails(&candidate.iter().copied().collect()) {
                    found = Some(candidate);
                    break;
                }
            }
            match found {
                Some(smaller) => {
                    kept = smaller;
                    parts = 2;
                }
                None if parts >= kept.len() => break,
                None => parts = (parts * 2).min(kept.len()),
            }
        }
        kept
    }

    fn fewer_robots(&mut self, kept: &[usize]) {
        let faults: BTreeSet<usize> = kept.iter().copied().collect();
        // The plan is drawn for the robots of the seed; only the fleet is made smaller.
        while self.fleet() > 1 && !self.is_over() {
            let before = self.options.clone();
            self.options.fleet = Some(self.fleet() / 2);
            if !self.fails(&faults) {
                self.options = before;
                break;
            }
        }
    }
}
