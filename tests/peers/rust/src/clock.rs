//! What a computation costs, by two clocks.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

/// Seconds of the process on all of its threads, and of the wall.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct Seconds {
    /// Time that the process computed, which others on the machine do not lengthen by making it wait.
    pub(crate) cpu: f64,
    /// Time that passed.
    pub(crate) wall: f64,
}

/// Does `work`, and says how long it took.
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (Seconds, T) {
    let (wall, cpu) = (Instant::now(), process_seconds());
    let done = work();
    (Seconds { cpu: process_seconds() - cpu, wall: wall.elapsed().as_secs_f64() }, done)
}

fn process_seconds() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}
