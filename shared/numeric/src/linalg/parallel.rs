//! Parallel loops over the rows of large blocks, with the same result for any number of threads.
//!
//! Rows are divided into parts whose bounds depend on the number of rows alone. Sums are taken per
//! part and then over the parts in order, so the assignment of parts to threads does not matter.

use std::ops::Range;

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Least rows of a part: enough work to be worth a task, few enough that ten thousand rows divide
/// evenly.
const MIN_PART_ROWS: usize = 512;

/// Most parts; each has its own sums.
const MAX_PARTS: usize = 512;

/// Rows from which threads are used: with fewer, they would wait for one another longer than they
/// work.
const MIN_PARALLEL_ROWS: usize = 2048;

/// Most threads that are started: more than any machine has cores, as each has a stack.
const MAX_THREADS: usize = 1024;

/// A thread pool that is kept from call to call.
#[derive(Debug, Default)]
pub(crate) struct Threads {
    /// `None` for the calling thread alone.
    pool: Option<ThreadPool>,
}

impl Threads {
    /// A pool of `threads` threads, at most [`MAX_THREADS`]; the calling thread alone if no pool
    /// can be started.
    pub(crate) fn new(threads: usize) -> Self {
        let mut started = Self::default();
        started.start(threads);
        started
    }

    /// Changes the number of threads, at most [`MAX_THREADS`]; the calling thread alone if no pool
    /// can be started.
    pub(crate) fn start(&mut self, threads: usize) {
        let threads = threads.clamp(1, MAX_THREADS);
        if threads != self.count() {
            let build = || ThreadPoolBuilder::new().num_threads(threads).build().ok();
            self.pool = if threads > 1 { build() } else { None };
        }
    }

    /// Number of threads.
    pub(crate) fn count(&self) -> usize {
        self.pool.as_ref().map_or(1, ThreadPool::current_num_threads)
    }

    /// Runs `work` inside the pool, where [`Parts`] can use its threads.
    pub(crate) fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// Output that can be split between two rows.
pub(crate) trait Split: Send + Sized {
    /// The first `rows` rows, which are `parts` parts, and the others.
    fn split(self, rows: usize, parts: usize) -> (Self, Self);
}

/// Rows of `stride` values each.
#[derive(Debug)]
pub(crate) struct Strided<'a, T>(pub(crate) &'a mut [T], pub(crate) usize);

/// The given number of values per part.
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

/// No output.
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

/// Rows divided into parts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Parts {
    rows: usize,
    size: usize,
    parallel: bool,
}

impl Parts {
    /// Parts of `rows` rows. More than one of `threads` threads are used only inside the caller's
    /// pool, and only for many rows.
    pub(crate) fn new(rows: usize, threads: usize) -> Self {
        let size = rows.div_ceil(MAX_PARTS).max(MIN_PART_ROWS).next_multiple_of(8);
        Self { rows, size, parallel: threads > 1 && rows >= MIN_PARALLEL_ROWS }
    }

    /// One part per thread: for work whose result does not depend on the division.
    pub(crate) fn one_each(rows: usize, threads: usize) -> Self {
        let parallel = threads > 1 && rows >= MIN_PARALLEL_ROWS;
        let parts = if parallel { threads } else { 1 };
        Self { rows, size: rows.div_ceil(parts).max(1), parallel }
    }

    /// Number of parts, at least 1.
    pub(crate) fn count(&self) -> usize {
        self.rows.div_ceil(self.size).max(1)
    }

    /// Calls `work` with the rows of each part and its share of `out`.
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
        if self.parallel {
            rayon::join(left, right);
        } else {
            left();
            right();
        }
    }

    /// Calls `work` with the rows of each part, its share of `out`, and `length` zeros to add to.
    /// Leaves the sums over all parts in the first `length` values of `sums`.
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
