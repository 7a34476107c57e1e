//! Memory and processor time of a process, as Linux reports them.

use anyhow::Context;

/// The kernel's ticks a second in `/proc/PID/stat`, the same on every Linux.
const TICKS_HZ: f64 = 100.0;

/// One sample of one process.
#[derive(Debug, Clone, Copy)]
pub struct ProcessStats {
    /// When, in seconds since an origin of the caller.
    pub at: f64,
    /// Resident memory in KiB.
    pub memory: f64,
    /// Processor time so far, in seconds.
    pub busy: f64,
}

/// Samples a process.
///
/// # Errors
/// If it has ended.
pub fn process_stats(process: u32, at: f64) -> anyhow::Result<ProcessStats> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status"))?;
    let memory = number(&status, "VmRSS:").context("a process has no memory; has it ended?")?;
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat"))?;
    // The name of the program is in brackets and may contain blanks.
    let fields = stat.rsplit_once(") ").map_or("", |(_, rest)| rest).split(' ');
    let ticks: f64 = fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum();
    Ok(ProcessStats { at, memory, busy: ticks / TICKS_HZ })
}

/// The memory of a process in KiB, each page that it shares divided among those who do.
///
/// # Errors
/// If it has ended.
pub fn memory_of(process: u32) -> anyhow::Result<f64> {
    let text = std::fs::read_to_string(format!("/proc/{process}/smaps_rollup"))?;
    number(&text, "Pss:").context("a process has no memory; has it ended?")
}

/// How many threads a process has.
///
/// # Errors
/// If it has ended.
pub fn threads_of(process: u32) -> anyhow::Result<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status"))?;
    Ok(number(&status, "Threads:").context("a process has no threads; has it ended?")? as u64)
}

/// The number that follows a name at the beginning of a line.
fn number(text: &str, name: &str) -> Option<f64> {
    let rest = text.lines().find_map(|line| line.strip_prefix(name))?;
    rest.split_whitespace().next()?.parse().ok()
}

/// The value below which a share of sorted values lies; NaN if there is none.
#[must_use]
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = (sorted.len() as f64 * share) as usize;
    sorted.get(place.min(sorted.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}

/// The slope of the straight line that fits points (x, y) best; 0 where all x are the same.
#[must_use]
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean =
        |value: fn(&(f64, f64)) -> f64| points.iter().map(value).sum::<f64>() / count.max(1.0);
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let both: f64 = points.iter().map(|point| (point.0 - x) * (point.1 - y)).sum();
    let square: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
    if square > 0.0 { both / square } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Other tests run in this process at the same time: they use processor time and give memory back, so that
    /// only what this test holds and computes itself is asserted.
    #[test]
    fn this_process_uses_memory_and_time() {
        let before = process_stats(std::process::id(), 0.0).unwrap();
        let held = vec![1_u8; 32 << 20];
        let after = loop {
            let sum: u64 = held.iter().map(|byte| u64::from(*byte)).sum();
            assert_eq!(sum, 32 << 20);
            let now = process_stats(std::process::id(), 0.0).unwrap();
            if now.busy - before.busy >= 0.05 {
                break now;
            }
        };
        assert!(after.memory > 32.0 * 1024.0, "{after:?}");
        assert!(memory_of(std::process::id()).unwrap() > 32.0 * 1024.0);
        drop(held);
        assert!(threads_of(std::process::id()).unwrap() >= 1);
        assert!(process_stats(u32::MAX, 0.0).is_err());
    }

    #[test]
    fn quantiles_and_slopes_are_those_of_the_numbers() {
        let values: Vec<f64> = (0..100).map(f64::from).collect();
        assert_eq!(
            (quantile(&values, 0.5), quantile(&values, 0.99), quantile(&values, 1.0)),
            (50.0, 99.0, 99.0)
        );
        assert!(quantile(&[], 0.5).is_nan());
        let line: Vec<_> = (0..9).map(|x| (f64::from(x), 7.0 - 2.5 * f64::from(x))).collect();
        assert!((slope(&line) + 2.5).abs() < 1e-12);
        assert_eq!(slope(&[(1.0, 5.0)]), 0.0);
    }
}
