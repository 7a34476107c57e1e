//! Dispatch to the widest vector registers of the machine, and prefetching into its cache.

use pulp::{Arch, WithSimd};

/// Runs `work` with the widest registers of this machine.
pub(crate) fn dispatch<W: WithSimd>(work: W) -> W::Output {
    #[cfg(test)]
    let work = match narrow::run(work) {
        Ok(output) => return output,
        Err(work) => work,
    };
    Arch::new().dispatch(work)
}

/// Fetches the cache line of `value`, `offset` doubles further on. The address need not exist.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T, offset: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(sse) = pulp::core_arch::x86::Sse::try_new() {
        let address = core::ptr::from_ref(value).cast::<f64>().wrapping_add(offset);
        sse._mm_prefetch::<{ core::arch::x86_64::_MM_HINT_T0 }>(address.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (value, offset);
}

/// Registers narrower than those of the machine, for tests.
#[cfg(test)]
pub(crate) mod narrow {
    use std::cell::Cell;

    use pulp::{Simd, WithSimd};

    thread_local! {
        /// Lanes per register on this thread; 0 for the widest.
        static LANES: Cell<usize> = const { Cell::new(0) };
    }

    /// Runs `work` with registers of `lanes` lanes where the machine has them.
    pub(crate) fn with_lanes<T>(lanes: usize, work: impl FnOnce() -> T) -> T {
        LANES.set(lanes);
        let output = work();
        LANES.set(0);
        output
    }

    /// Runs `work` with as many lanes as the test set, or returns it.
    pub(super) fn run<W: WithSimd>(work: W) -> Result<W::Output, W> {
        match LANES.get() {
            1 => Ok(Simd::vectorize(pulp::Scalar::new(), work)),
            #[cfg(target_arch = "x86_64")]
            4 => match pulp::x86::V3::try_new() {
                Some(simd) => Ok(Simd::vectorize(simd, work)),
                None => Err(work),
            },
            _ => Err(work),
        }
    }
}
