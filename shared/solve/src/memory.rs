//! Whether a problem fits into the memory of this machine.

use muster_method::decomposition::Path;

use super::cost::Size;
use super::error::{SolveError, refuse};

/// Fleets of up to so many robots fit everywhere.
pub(super) const SMALL_ROBOTS: usize = 1000;

/// Whether a fleet fits by a path. Where the system does not report how much memory is available, every fleet
/// does.
pub(super) fn fits_path(
    path: Path,
    robots: usize,
    size: &Size,
    available_mib: Option<u64>,
) -> bool {
    fits(robots, size.peak_mib(path), available_mib)
}

/// Refuses what does not fit now, instead of being killed half an hour later.
pub(super) fn admit_path(path: Path, robots: usize, size: &Size) -> Result<(), SolveError> {
    if robots <= SMALL_ROBOTS {
        return Ok(());
    }
    admit(path, robots, size.peak_mib(path), available_mib())
}

/// Whether so many robots fit that take so much.
pub(super) fn fits(robots: usize, peak_mib: u64, available_mib: Option<u64>) -> bool {
    robots <= SMALL_ROBOTS || available_mib.is_none_or(|available| peak_mib <= available)
}

/// Refuses a fleet that does not fit.
pub(super) fn admit(
    path: Path,
    robots: usize,
    peak_mib: u64,
    available_mib: Option<u64>,
) -> Result<(), SolveError> {
    let Some(available) = available_mib.filter(|_| !fits(robots, peak_mib, available_mib)) else {
        return Ok(());
    };
    let (what, remedy) = match path {
        Path::Dense => ("dense matrices", "let the path be inverse-free"),
        Path::InverseFree => ("graphs and vectors", "ask for a smaller dimension or fewer teams"),
    };
    refuse(
        "robots",
        format!(
            "the {what} of {robots} robots need about {peak_mib} MiB of memory, and {available} MiB \
             are available; {remedy}, end other programs, take a larger machine, or divide parts of \
             the fleet"
        ),
    )
}

/// Memory that can be had without swapping, by Linux's own estimate.
pub(super) fn available_mib() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib >> 10)
}
