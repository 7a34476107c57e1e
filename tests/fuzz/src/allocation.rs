//! The peak memory use of a piece of code.

use std::sync::atomic::{AtomicUsize, Ordering};

use peak_alloc::PeakAlloc;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// The highest peak that inner measurements have reset.
static INNER: AtomicUsize = AtomicUsize::new(0);

/// Runs something and checks that it never uses more than so many bytes beyond what was in use before.
/// Measurements may be nested. Other threads are measured too, so one target runs at a time.
///
/// # Panics
/// If it held more.
pub fn at_most<T>(limit: usize, what: &str, run: impl FnOnce() -> T) -> T {
    let peak = || ALLOCATOR.peak_usage().max(INNER.load(Ordering::Relaxed));
    let outer = peak();
    ALLOCATOR.reset_peak_usage();
    INNER.store(0, Ordering::Relaxed);
    let before = ALLOCATOR.current_usage();
    let result = run();
    let held = peak().saturating_sub(before);
    INNER.store(outer.max(peak()), Ordering::Relaxed);
    assert!(held <= limit, "{what} held {held} bytes, and may hold {limit}");
    result
}
