//! Rows of large blocks, shared out over threads with the same result for any number of them.
//!
//! Rows are worked on in parts whose bounds depend on the number of rows alone, and sums are made
//! per part and then over the parts in order. Which thread takes which part decides nothing.

use std::ops::Range;

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Rows of a part at least: enough work to be worth handing over, few enough that ten thousand rows
/// are divided evenly.
const LEAST_PART: usize = 512;

/// Parts at most; each has sums of its own.
const MOST_PARTS: usize = 512;

/// Rows from which they are shared out: with fewer, threads would wait for one another longer than
/// they work.
const SHARED_ROWS: usize = 2048;

/// Most threads that are started. More than any machine has cores help nobody, and each has a stack.
const MAX_THREADS: usize = 1024;

/// Threads that are kept from call to call.
#[derive(Debug, Default)]
pub(crate) struct Threads {
    /// None for the calling thread alone.
    pool: Option<ThreadPool>,
}

impl Threads {
    /// As many threads, at most [`MAX_THREADS`]; the calling one if no more are available.
    pub(crate) fn new(threads: usize) -> Self {
        let mut started = Self::default();
        started.start(threads);
        started
    }

    /// Makes as many ready, at most [`MAX_THREADS`]; the calling one if no more are available.
    pub(crate) fn start(&mut self, threads: usize) {
        let threads = threads.clamp(1, MAX_THREADS);
        if threads != self.count() {
            let build = || ThreadPoolBuilder::new().num_threads(threads).build().ok();
            self.pool = if threads > 1 { build() } else { None };
        }
    }

    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        self.pool.as_ref().map_or(1, ThreadPool::current_num_threads)
    }

    /// Runs where [`Parts`] may be shared out over them.
    pub(crate) fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// What is written row by row, so that it can be divided between two rows.
pub(crate) trait Split: Send + Sized {
    /// The first `rows` rows, which are `parts` parts, and the others.
    fn split(self, rows: usize, parts: usize) -> (Self, Self);
}

/// Rows of `stride` values each.
#[derive(Debug)]
pub(crate) struct Strided<'a, T>(pub(crate) &'a mut [T], pub(crate) usize);

/// So many values for each part.
#[derive(Debug)]
pub(crate) struct PerPart<'a>(pub(crate) &'a mut [f64], pub(crate) usize);

impl<T: Send> Split for Strided<'_, T> {
    fn split(self, rows: usize, _parts: usize) -> (Self, Self) {
        let (first, rest) = self.0.split_at_mut(rows * self.1);
        (Self(first, self.1), Self(rest, self.1))
    }
}

impl Split for PerPart<'_> {
    fn split(self, _rows: usize, parts: usize) -> (Self, Self) {
        let (first, rest) = self.0.split_at_mut(parts * self.1);
        (Self(first, self.1), Self(rest, self.1))
    }
}

/// Nothing is written.
impl Split for () {
    fn split(self, _rows: usize, _parts: usize) -> (Self, Self) {
        ((), ())
    }
}

impl<A: Split, B: Split> Split for (A, B) {
    fn split(self, rows: usize, parts: usize) -> (Self, Self) {
        let ((a, c), (b, d)) = (self.0.split(rows, parts), self.1.split(rows, parts));
        ((a, b), (c, d))
    }
}

impl<A: Split, B: Split, C: Split> Split for (A, B, C) {
    fn split(self, rows: usize, parts: usize) -> (Self, Self) {
        let ((a, d), (b, e)) = (self.0.split(rows, parts), self.1.split(rows, parts));
        let (c, f) = self.2.split(rows, parts);
        ((a, b, c), (d, e, f))
    }
}

/// So many rows in parts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Parts {
    rows: usize,
    size: usize,
    shared: bool,
}

impl Parts {
    /// Parts of `rows` rows. More than one of `threads` threads are used only within a pool of the
    /// caller, and only for many rows.
    pub(crate) fn new(rows: usize, threads: usize) -> Self {
        let size = rows.div_ceil(MOST_PARTS).max(LEAST_PART).next_multiple_of(8);
        Self { rows, size, shared: threads > 1 && rows >= SHARED_ROWS }
    }

    /// One part for each thread: for work whose result does not depend on how it is divided.
    pub(crate) fn one_each(rows: usize, threads: usize) -> Self {
        let shared = threads > 1 && rows >= SHARED_ROWS;
        let parts = if shared { threads } else { 1 };
        Self { rows, size: rows.div_ceil(parts).max(1), shared }
    }

    /// How many parts there are, at least 1.
    pub(crate) fn count(&self) -> usize {
        self.rows.div_ceil(self.size).max(1)
    }

    /// Calls `work` with the rows of each part and what of `out` belongs to it.
    pub(crate) fn run<O: Split>(&self, out: O, work: impl Fn(Range<usize>, O) + Sync) {
        self.descend(0..self.count(), out, &work);
    }

    fn descend<O: Split>(
        &self,
        parts: Range<usize>,
        out: O,
        work: &(impl Fn(Range<usize>, O) + Sync),
    ) {
        if parts.len() <= 1 {
            let first = parts.start * self.size;
            return work(first..(first + self.size).min(self.rows), out);
        }
        let half = parts.len() / 2;
        let middle = parts.start + half;
        let (left, right) = out.split(half * self.size, half);
        let left = || self.descend(parts.start..middle, left, work);
        let right = || self.descend(middle..parts.end, right, work);
        if self.shared {
            rayon::join(left, right);
        } else {
            left();
            right();
        }
    }

    /// Calls `work`, which sums up over the rows of a part, with those rows, what of `out` belongs
    /// to them and zeros to add to; the sums over all parts are left in the first `length` values
    /// of `sums`.
    pub(crate) fn sum<O: Split>(
        &self,
        sums: &mut Vec<f64>,
        length: usize,
        out: O,
        work: impl Fn(Range<usize>, O, &mut [f64]) + Sync,
    ) {
        sums.resize((self.count() * length).max(sums.len()), 0.0);
        let all = &mut sums[..self.count() * length];
        self.run((out, PerPart(all, length)), |rows, (out, sums)| {
            sums.0.fill(0.0);
            work(rows, out, sums.0);
        });
        let (first, rest) = all.split_at_mut(length);
        for part in rest.chunks_exact(length.max(1)) {
            for (sum, value) in first.iter_mut().zip(part) {
                *sum += value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_the_same_bit_for_bit_for_any_number_of_threads() {
        for rows in [0, 1, 511, 513, 40_001] {
            let run = |threads| {
                let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let mut written = vec![0_usize; 2 * rows];
                let mut sums = Vec::new();
                pool.install(|| {
                    let parts = Parts::new(rows, threads);
                    parts.sum(&mut sums, 1, Strided(&mut written, 2), |range, out, sum| {
                        for (i, row) in range.zip(out.0.chunks_exact_mut(2)) {
                            row.fill(i);
                            sum[0] += 1.0 / (i + 1) as f64;
                        }
                    });
                });
                assert!(written.iter().enumerate().all(|(at, i)| at / 2 == *i));
                sums[0]
            };
            assert_eq!(run(1).to_bits(), run(3).to_bits());
        }
    }
}
