//! Memory of processes over a run in which they are killed and started again.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::process_stats::{process_stats, quantile};

/// How much more than at the beginning a process may take at any time, in MiB: buffers for the largest garbage and
/// for a fleet with a thousand strange robots. A leak of hours is found by [`GROWTH_MIB_PER_MIN`].
const MAX_PEAK_MIB: f64 = 160.0;

/// How much more than in the second quarter of the run a process may take in the last, in MiB: what allocators
/// keep after a flood.
const KEPT_MIB: f64 = 32.0;

/// What is added to that for each minute between the two: at this rate a day costs less than 400 MiB.
const GROWTH_MIB_PER_MIN: f64 = 0.25;

/// A sample: when, in seconds since the begin, and resident memory in MiB.
#[derive(Debug, Clone, Copy)]
struct Sample {
    at: f64,
    mib: f64,
}

/// The memory of every process by its name, whatever its id is at the time.
#[derive(Debug, Default)]
pub(super) struct Memory {
    samples: BTreeMap<String, Vec<Sample>>,
}

impl Memory {
    /// Samples processes; one that has ended is left out.
    pub(super) fn sample(&mut self, at: f64, processes: &[(String, u32)]) {
        for (name, id) in processes {
            if let Ok(stats) = process_stats(*id, at) {
                let sample = Sample { at, mib: stats.memory / 1024.0 };
                self.samples.entry(name.clone()).or_default().push(sample);
            }
        }
    }

    /// A table of all processes, and what is broken.
    pub(super) fn judge(&self) -> (String, Vec<String>) {
        let mut table = format!(
            "{:<14} {:>9} {:>9} {:>9} {:>9}  MiB\n",
            "process", "first", "2nd 1/4", "last 1/4", "peak"
        );
        let mut broken = Vec::new();
        for (name, samples) in &self.samples {
            let end = samples.last().map_or(0.0, |sample| sample.at);
            let median = |from: f64, to: f64| {
                let within =
                    samples.iter().filter(|sample| (from * end..=to * end).contains(&sample.at));
                let mut mib: Vec<f64> = within.map(|sample| sample.mib).collect();
                mib.sort_by(f64::total_cmp);
                quantile(&mib, 0.5)
            };
            let (first, second, last) = (median(0.0, 0.1), median(0.25, 0.5), median(0.75, 1.0));
            let peak = samples.iter().map(|sample| sample.mib).fold(0.0, f64::max);
            let _ =
                writeln!(table, "{name:<14} {first:>9.1} {second:>9.1} {last:>9.1} {peak:>9.1}");
            if peak > first + MAX_PEAK_MIB {
                broken.push(format!(
                    "memory is bounded: {name} took {peak:.1} MiB, and {first:.1} at first"
                ));
            }
            let allowed = KEPT_MIB + GROWTH_MIB_PER_MIN * end * 0.5 / 60.0;
            if last > second + allowed {
                broken.push(format!(
                    "memory is flat: {name} took {second:.1} MiB in the second quarter of the run and \
                     {last:.1} in the last, {allowed:.1} more are allowed"
                ));
            }
        }
        (table, broken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory(mib: impl Fn(f64) -> f64) -> Memory {
        let samples = (0..600).map(|second| {
            let at = f64::from(second);
            Sample { at, mib: mib(at) }
        });
        Memory { samples: BTreeMap::from([("ingest".to_owned(), samples.collect())]) }
    }

    #[test]
    fn steps_and_restarts_are_flat_and_a_leak_or_a_peak_is_not() {
        let broken = |mib: &dyn Fn(f64) -> f64| memory(mib).judge().1.len();
        assert_eq!(broken(&|_| 40.0), 0);
        assert_eq!(broken(&|at| if at < 300.0 { 40.0 } else { 65.0 }), 0);
        assert_eq!(broken(&|at| 40.0 + at % 50.0), 0);
        assert_eq!(broken(&|at| 40.0 + at / 5.0), 1);
        assert_eq!(broken(&|at| if at == 400.0 { 300.0 } else { 40.0 }), 1);
        let mut memory = Memory::default();
        memory
            .sample(0.0, &[("this".to_owned(), std::process::id()), ("none".to_owned(), u32::MAX)]);
        assert!(memory.judge().0.contains("this") && !memory.judge().0.contains("none"));
    }
}
