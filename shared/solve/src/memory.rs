//! Whether the dense matrices of a fleet fit into this machine.

use super::{SolveError, refuse};

/// Matrices of one double per pair of robots that are held at once at the worst moment: the
/// singular value decomposition with its copies and its working space.
const MATRICES: u64 = 12;

/// Fleets up to this size fit everywhere.
const SMALL: usize = 1000;

/// Refuses a fleet whose matrices do not fit, instead of being killed half an hour later. Where the
/// system does not tell how much memory is available, every fleet passes.
pub(super) fn check(robots: usize) -> Result<(), SolveError> {
    if robots <= SMALL {
        return Ok(());
    }
    let needed = needed_mib(robots);
    match available_mib() {
        Some(available) if needed > available => refuse(
            "robots",
            format!(
                "the dense matrices of {robots} robots need about {needed} MiB of memory, and \
                 {available} MiB are available"
            ),
        ),
        _ => Ok(()),
    }
}

fn needed_mib(robots: usize) -> u64 {
    let pairs = (robots as u64).saturating_mul(robots as u64);
    pairs.saturating_mul(8 * MATRICES) >> 20
}

/// Memory that can be had without swapping, by Linux's own estimate.
fn available_mib() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib >> 10)
}
