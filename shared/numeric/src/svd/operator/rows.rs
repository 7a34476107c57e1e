//! A sparse square matrix whose rows can be replaced one by one.

use crate::linalg::matrix::SparseMatrix;
use crate::linalg::parallel::{Parts, PerPart, Split};

/// Free entries of a row that had to move because it grew.
const FREE_ENTRIES: usize = 4;

/// Location of the entries of a row.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Span {
    start: u32,
    len: u32,
    room: u32,
}

/// Rows with 32-bit indices, in double and in single precision. Columns ascend within a row.
#[derive(Debug, Default)]
pub(super) struct Rows {
    spans: Vec<Span>,
    columns: Vec<u32>,
    weights: Vec<f64>,
    single: Vec<f32>,
    /// Number of entries that belong to a row.
    live: usize,
    /// Number of entries of each row of a transpose.
    lengths: Vec<u32>,
    /// Largest sum of a row of each part.
    heaviest: Vec<f64>,
}

/// Consecutive rows; the entries of the first one begin at `start`.
struct Entries<'a> {
    start: u32,
    spans: &'a mut [Span],
    columns: &'a mut [u32],
    weights: &'a mut [f64],
    single: &'a mut [f32],
}

impl Split for Entries<'_> {
    fn split(self, rows: usize, _parts: usize) -> (Self, Self) {
        let start =
            self.spans.get(rows).map_or(self.start + self.columns.len() as u32, |s| s.start);
        let place = (start - self.start) as usize;
        let (spans, other_spans) = self.spans.split_at_mut(rows);
        let (columns, other_columns) = self.columns.split_at_mut(place);
        let (weights, other_weights) = self.weights.split_at_mut(place);
        let (single, other_single) = self.single.split_at_mut(place);
        let first = Self { start: self.start, spans, columns, weights, single };
        let second = Self {
            start,
            spans: other_spans,
            columns: other_columns,
            weights: other_weights,
            single: other_single,
        };
        (first, second)
    }
}

/// Resizes a buffer whose values are all overwritten afterwards.
fn resize<T: Copy + Default>(buffer: &mut Vec<T>, len: usize) {
    buffer.truncate(len);
    buffer.reserve_exact(len - buffer.len());
    buffer.resize(len, T::default());
}

impl Rows {
    /// Columns and weights of row `i`.
    #[inline(always)]
    pub(super) fn row(&self, i: usize) -> (&[u32], &[f64]) {
        let range = self.range(i);
        (&self.columns[range.clone()], &self.weights[range])
    }

    /// The same in single precision.
    #[inline(always)]
    pub(super) fn row_single(&self, i: usize) -> (&[u32], &[f32]) {
        let range = self.range(i);
        (&self.columns[range.clone()], &self.single[range])
    }

    #[inline(always)]
    fn range(&self, i: usize) -> std::ops::Range<usize> {
        let span = self.spans[i];
        span.start as usize..span.start as usize + span.len as usize
    }

    /// Assigns αA with its nodes renumbered, in the existing memory: row k is row `outer[k]` of
    /// `a`, and column j becomes `inner[j]`. Without an order the indices stay. Returns the largest
    /// row sum.
    pub(super) fn assign(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        order: Option<(&[u32], &[u32])>,
        threads: usize,
    ) -> f64 {
        let outer = |k: usize| order.map_or(k, |(outer, _)| outer[k] as usize);
        self.lay_out((0..a.nodes()).map(|k| a.row(outer(k)).len()));
        let parts = Parts::one_each(a.nodes(), threads);
        let mut heaviest = std::mem::take(&mut self.heaviest);
        heaviest.clear();
        heaviest.resize(parts.count(), 0.0);
        parts.run((self.entries(), PerPart(&mut heaviest, 1)), |rows, (entries, heaviest)| {
            for (k, span) in rows.zip(entries.spans) {
                let place = (span.start - entries.start) as usize;
                let place = place..place + span.room as usize;
                span.len = span.room;
                let columns = &mut entries.columns[place.clone()];
                let weights = &mut entries.weights[place.clone()];
                for ((column, weight), (j, w)) in
                    columns.iter_mut().zip(&mut *weights).zip(a.row(outer(k)))
                {
                    *column = order.map_or(j as u32, |(_, inner)| inner[j]);
                    *weight = alpha * w;
                }
                if order.is_some() {
                    sort_row(columns, weights);
                }
                for (single, weight) in entries.single[place].iter_mut().zip(&*weights) {
                    *single = *weight as f32;
                }
                heaviest.0[0] = heaviest.0[0].max(weights.iter().sum());
            }
        });
        self.heaviest = heaviest;
        self.heaviest.iter().copied().fold(0.0, f64::max)
    }

    /// Assigns the transpose of `rows`, in the existing memory.
    pub(super) fn assign_transpose(&mut self, rows: &Self, threads: usize) {
        let n = rows.spans.len();
        let mut lengths = std::mem::take(&mut self.lengths);
        lengths.clear();
        lengths.resize(n, 0);
        for i in 0..n {
            for j in rows.row(i).0 {
                lengths[*j as usize] += 1;
            }
        }
        self.lay_out(lengths.iter().map(|length| *length as usize));
        self.lengths = lengths;
        // Each thread scans all entries and copies those of its own columns.
        let parts = Parts::one_each(n, threads);
        parts.run(self.entries(), |own, entries| {
            let all = own.len() == n;
            let (first, count) = (own.start as u32, own.len() as u32);
            for i in 0..n {
                let (columns, weights) = rows.row(i);
                for (&j, &weight) in columns.iter().zip(weights) {
                    let column = j.wrapping_sub(first);
                    if all || column < count {
                        let span = &mut entries.spans[column as usize];
                        let place = (span.start - entries.start + span.len) as usize;
                        span.len += 1;
                        entries.columns[place] = i as u32;
                        entries.weights[place] = weight;
                        entries.single[place] = weight as f32;
                    }
                }
            }
        });
    }

    /// Lays out empty rows of such lengths, one after the other.
    fn lay_out(&mut self, lengths: impl ExactSizeIterator<Item = usize>) {
        self.spans.clear();
        self.spans.reserve_exact(lengths.len());
        let mut start = 0;
        for room in lengths {
            self.spans.push(Span { start: start as u32, len: 0, room: room as u32 });
            start += room;
        }
        self.live = start;
        resize(&mut self.columns, start);
        resize(&mut self.weights, start);
        resize(&mut self.single, start);
    }

    fn entries(&mut self) -> Entries<'_> {
        let Self { spans, columns, weights, single, .. } = self;
        Entries { start: 0, spans, columns, weights, single }
    }

    /// True when moved rows waste so much room that rebuilding the matrix pays.
    pub(super) fn scattered(&self) -> bool {
        self.columns.len() > self.live + self.live / 2
    }

    /// Replaces row `i`; `columns` ascend.
    pub(super) fn replace(&mut self, i: usize, columns: &[u32], weights: &[f64]) {
        self.live += columns.len();
        self.live -= self.spans[i].len as usize;
        self.make_room(i, columns.len());
        self.spans[i].len = columns.len() as u32;
        let range = self.range(i);
        self.columns[range.clone()].copy_from_slice(columns);
        self.weights[range.clone()].copy_from_slice(weights);
        for (single, weight) in self.single[range].iter_mut().zip(weights) {
            *single = *weight as f32;
        }
    }

    /// Sets the entry in row `i` and column `j`, new or not; 0 removes it.
    pub(super) fn set(&mut self, i: usize, j: u32, weight: f64) {
        let found = self.row(i).0.binary_search(&j);
        let len = self.spans[i].len as usize;
        match found {
            Ok(at) if weight != 0.0 => self.write(self.spans[i].start as usize + at, j, weight),
            Ok(at) => {
                let range = self.range(i);
                let (from, to) = (range.start + at + 1..range.end, range.start + at);
                self.columns.copy_within(from.clone(), to);
                self.weights.copy_within(from.clone(), to);
                self.single.copy_within(from, to);
                self.spans[i].len -= 1;
                self.live -= 1;
            }
            Err(_) if weight == 0.0 => {}
            Err(at) => {
                self.make_room(i, len + 1);
                self.spans[i].len += 1;
                self.live += 1;
                let range = self.range(i);
                let (from, to) = (range.start + at..range.end - 1, range.start + at + 1);
                self.columns.copy_within(from.clone(), to);
                self.weights.copy_within(from.clone(), to);
                self.single.copy_within(from, to);
                self.write(range.start + at, j, weight);
            }
        }
    }

    fn write(&mut self, place: usize, column: u32, weight: f64) {
        self.columns[place] = column;
        self.weights[place] = weight;
        self.single[place] = weight as f32;
    }

    /// Moves row `i` behind all others if it has no room for `len` entries.
    fn make_room(&mut self, i: usize, len: usize) {
        let span = self.spans[i];
        if len <= span.room as usize {
            return;
        }
        let (start, room) = (self.columns.len(), len + FREE_ENTRIES);
        let range = self.range(i);
        self.columns.extend_from_within(range.clone());
        self.columns.resize(start + room, 0);
        self.weights.extend_from_within(range.clone());
        self.weights.resize(start + room, 0.0);
        self.single.extend_from_within(range);
        self.single.resize(start + room, 0.0);
        self.spans[i] = Span { start: start as u32, room: room as u32, ..span };
    }
}

/// Sorts a row by its columns, by insertion: rows are short, and nearly sorted where neighbours are
/// close.
pub(super) fn sort_row(columns: &mut [u32], weights: &mut [f64]) {
    for i in 1..columns.len() {
        let mut k = i;
        while k > 0 && columns[k - 1] > columns[k] {
            columns.swap(k - 1, k);
            weights.swap(k - 1, k);
            k -= 1;
        }
    }
}
