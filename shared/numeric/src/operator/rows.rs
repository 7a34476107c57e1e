//! A sparse square matrix by rows that can be replaced one by one.

use crate::matrix::SparseMatrix;

/// Room for that many more entries in a row that had to be moved because it grew.
const SPARE: usize = 4;

/// Where the entries of a row stand.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Span {
    start: u32,
    len: u32,
    room: u32,
}

/// Rows with small indices, in double and in single precision. Columns ascend within a row.
#[derive(Debug, Default)]
pub(super) struct Rows {
    spans: Vec<Span>,
    columns: Vec<u32>,
    weights: Vec<f64>,
    single: Vec<f32>,
    /// Entries that belong to a row.
    live: usize,
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

    /// αA with its nodes renumbered, in the memory that is there: row k is row `outer[k]` of `a`, and
    /// column j becomes `inner[j]`. Without an order the numbers stay.
    pub(super) fn assign(&mut self, a: &SparseMatrix, alpha: f64, order: Option<(&[u32], &[u32])>) {
        self.clear(a.nodes(), a.edges());
        for k in 0..a.nodes() {
            let start = self.columns.len();
            match order {
                None => {
                    for (j, w) in a.row(k) {
                        self.push(j as u32, alpha * w);
                    }
                }
                Some((outer, inner)) => {
                    for (j, w) in a.row(outer[k] as usize) {
                        self.push(inner[j], alpha * w);
                    }
                    sort_row(&mut self.columns[start..], &mut self.weights[start..]);
                    for (single, weight) in
                        self.single[start..].iter_mut().zip(&self.weights[start..])
                    {
                        *single = *weight as f32;
                    }
                }
            }
            let len = (self.columns.len() - start) as u32;
            self.spans.push(Span { start: start as u32, len, room: len });
        }
    }

    fn clear(&mut self, nodes: usize, entries: usize) {
        self.spans.clear();
        self.spans.reserve_exact(nodes);
        self.columns.clear();
        self.columns.reserve_exact(entries);
        self.weights.clear();
        self.weights.reserve_exact(entries);
        self.single.clear();
        self.single.reserve_exact(entries);
        self.live = entries;
    }

    fn push(&mut self, column: u32, weight: f64) {
        self.columns.push(column);
        self.weights.push(weight);
        self.single.push(weight as f32);
    }

    /// The transpose of `rows`, in the memory that is there.
    pub(super) fn assign_transpose(&mut self, rows: &Self) {
        let n = rows.spans.len();
        self.clear(n, rows.live);
        self.columns.resize(rows.live, 0);
        self.weights.resize(rows.live, 0.0);
        self.single.resize(rows.live, 0.0);
        self.spans.resize(n, Span::default());
        for i in 0..n {
            for j in rows.row(i).0 {
                self.spans[*j as usize].room += 1;
            }
        }
        let mut start = 0;
        for span in &mut self.spans {
            span.start = start;
            start += span.room;
        }
        for i in 0..n {
            let (columns, weights) = rows.row(i);
            for (&j, &weight) in columns.iter().zip(weights) {
                let span = &mut self.spans[j as usize];
                let place = (span.start + span.len) as usize;
                span.len += 1;
                self.columns[place] = i as u32;
                self.weights[place] = weight;
                self.single[place] = weight as f32;
            }
        }
    }

    /// True when so much room is lost to rows that were moved that the matrix is better built anew.
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

    /// Sets the entry in row `i` and column `j`, whether there is one or not; 0 takes it away.
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

    /// Moves row `i` behind all others if there is no room for `len` entries where it stands.
    fn make_room(&mut self, i: usize, len: usize) {
        let span = self.spans[i];
        if len <= span.room as usize {
            return;
        }
        let (start, room) = (self.columns.len(), len + SPARE);
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

/// Sorts a row by its columns. Rows are short, and nearly sorted where neighbours lie close.
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
