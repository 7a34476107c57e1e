//! The changed entries of a matrix, and the fewest rows and columns that cover them all.

use std::collections::BinaryHeap;

/// One row of a sparse matrix as (column, weight), in any order.
pub(crate) type Row = Vec<(u32, f64)>;

/// One changed entry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Change {
    pub(crate) row: u32,
    pub(crate) column: u32,
    /// New weight minus old weight.
    pub(crate) difference: f64,
}

/// A row or a column of the matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Line {
    /// This row.
    Row(u32),
    /// This column.
    Column(u32),
}

/// The changed entries, each covered by one line. Reuses its memory.
#[derive(Debug, Default)]
pub(crate) struct Changes {
    entries: Vec<Change>,
    /// Entries of each column, as positions in `entries`, from `column_starts` on.
    by_column: Vec<u32>,
    column_starts: Vec<u32>,
    row_starts: Vec<u32>,
    /// Entries of each line that no chosen line covers yet, rows first.
    open: Vec<u32>,
    covered: Vec<bool>,
    heap: BinaryHeap<(u32, Line)>,
    /// The chosen lines, each with its range in `grouped`.
    lines: Vec<(Line, u32, u32)>,
    grouped: Vec<Change>,
    line: Vec<f64>,
    touched: Vec<u32>,
}

impl Changes {
    /// Discards all changes, for a matrix of `size` rows.
    pub(crate) fn clear(&mut self, size: usize) {
        self.entries.clear();
        self.lines.clear();
        self.grouped.clear();
        self.line.resize(size, 0.0);
    }

    /// Adds the difference of two versions of row `row`, except for columns that `skip` names. Rows
    /// must come in ascending order.
    pub(crate) fn compare(&mut self, row: u32, old: &Row, new: &Row, skip: impl Fn(u32) -> bool) {
        self.touched.clear();
        for &(column, weight) in new {
            self.line[column as usize] = weight;
            self.touched.push(column);
        }
        for &(column, weight) in old {
            let place = &mut self.line[column as usize];
            if *place == 0.0 {
                self.touched.push(column);
            }
            *place -= weight;
        }
        for &column in &self.touched {
            let difference = std::mem::take(&mut self.line[column as usize]);
            if difference != 0.0 && !skip(column) {
                self.entries.push(Change { row, column, difference });
            }
        }
    }

    /// Chooses the lines: all rows, all columns, or a mixture that greedily takes the line with
    /// most entries, whichever are fewest. A moved robot changes its row and its column, which the
    /// mixture covers by two lines where rows alone would need one per neighbour.
    pub(crate) fn cover(&mut self) {
        let size = self.line.len();
        self.index(size);
        let count = |starts: &[u32]| starts.windows(2).filter(|w| w[0] < w[1]).count();
        let (rows, columns) = (count(&self.row_starts), count(&self.column_starts));
        self.choose_mixture(size);
        if self.lines.len() >= rows.min(columns) {
            self.choose_all(size, rows <= columns);
        }
    }

    /// Sorts the entries by rows and by columns.
    fn index(&mut self, size: usize) {
        let Self { entries, by_column, column_starts, row_starts, .. } = self;
        for starts in [&mut *column_starts, &mut *row_starts] {
            starts.clear();
            starts.resize(size + 1, 0);
        }
        for entry in entries.iter() {
            row_starts[entry.row as usize + 1] += 1;
            column_starts[entry.column as usize + 1] += 1;
        }
        for i in 0..size {
            row_starts[i + 1] += row_starts[i];
            column_starts[i + 1] += column_starts[i];
        }
        by_column.clear();
        by_column.resize(entries.len(), 0);
        for (at, entry) in entries.iter().enumerate() {
            let start = &mut column_starts[entry.column as usize];
            by_column[*start as usize] = at as u32;
            *start += 1;
        }
        // Each start has moved to the end of its column, the start of the next.
        column_starts.rotate_right(1);
        column_starts[0] = 0;
    }

    fn choose_mixture(&mut self, size: usize) {
        let Self { entries, open, covered, heap, lines, grouped, .. } = self;
        open.clear();
        open.extend(self.row_starts.windows(2).map(|w| w[1] - w[0]));
        open.extend(self.column_starts.windows(2).map(|w| w[1] - w[0]));
        covered.clear();
        covered.resize(entries.len(), false);
        heap.clear();
        for i in 0..size {
            let lines = [Line::Row(i as u32), Line::Column(i as u32)];
            let counted = lines.into_iter().zip([open[i], open[size + i]]);
            heap.extend(counted.filter(|(_, count)| *count > 0).map(|(line, count)| (count, line)));
        }
        while let Some((count, line)) = heap.pop() {
            let place = |line| match line {
                Line::Row(i) => i as usize,
                Line::Column(j) => size + j as usize,
            };
            // Counts only fall; an outdated one goes back with its present value.
            let now = open[place(line)];
            if now < count {
                if now > 0 {
                    heap.push((now, line));
                }
                continue;
            }
            let start = grouped.len() as u32;
            let mut take = |at: usize| {
                if !std::mem::replace(&mut covered[at], true) {
                    let entry = entries[at];
                    grouped.push(entry);
                    open[entry.row as usize] -= 1;
                    open[size + entry.column as usize] -= 1;
                }
            };
            match line {
                Line::Row(i) => {
                    let (from, to) = (self.row_starts[i as usize], self.row_starts[i as usize + 1]);
                    (from..to).for_each(|at| take(at as usize));
                }
                Line::Column(j) => {
                    let range = self.column_starts[j as usize] as usize
                        ..self.column_starts[j as usize + 1] as usize;
                    self.by_column[range].iter().for_each(|at| take(*at as usize));
                }
            }
            lines.push((line, start, grouped.len() as u32));
        }
    }

    fn choose_all(&mut self, size: usize, rows: bool) {
        self.lines.clear();
        self.grouped.clear();
        let starts = if rows { &self.row_starts } else { &self.column_starts };
        if rows {
            self.grouped.extend_from_slice(&self.entries);
        } else {
            self.grouped.extend(self.by_column.iter().map(|at| self.entries[*at as usize]));
        }
        for i in 0..size {
            let (from, to) = (starts[i], starts[i + 1]);
            let line = if rows { Line::Row(i as u32) } else { Line::Column(i as u32) };
            if from < to {
                self.lines.push((line, from, to));
            }
        }
    }

    /// The chosen lines with the entries that they cover; every entry is covered once.
    pub(crate) fn lines(&self) -> impl ExactSizeIterator<Item = (Line, &[Change])> {
        let grouped = &self.grouped;
        self.lines.iter().map(|&(line, from, to)| (line, &grouped[from as usize..to as usize]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cover_of(old: &[Row], new: &[Row]) -> (Vec<Line>, usize) {
        let mut changes = Changes::default();
        changes.clear(old.len());
        for (i, (old, new)) in old.iter().zip(new).enumerate() {
            changes.compare(i as u32, old, new, |_| false);
        }
        changes.cover();
        for (line, entries) in changes.lines() {
            assert!(entries.iter().all(|e| match line {
                Line::Row(i) => e.row == i,
                Line::Column(j) => e.column == j,
            }));
        }
        let covered = changes.lines().map(|(_, entries)| entries.len()).sum();
        (changes.lines().map(|(line, _)| line).collect(), covered)
    }

    #[test]
    fn a_moved_robot_is_one_row_and_one_column() {
        let old: Vec<Row> = vec![vec![]; 9];
        let mut new = old.clone();
        for j in [0, 2, 5, 7, 8] {
            new[3].push((j, 1.0));
            new[j as usize].push((3, 1.0));
        }
        let (mut lines, covered) = cover_of(&old, &new);
        lines.sort();
        assert_eq!((lines, covered), (vec![Line::Row(3), Line::Column(3)], 10));
        assert_eq!(cover_of(&new, &old).0.len(), 2);
    }

    #[test]
    fn rows_or_columns_where_they_suffice() {
        let old: Vec<Row> = vec![vec![(1, 1.0), (2, 4.0)], vec![], vec![(0, 2.0)], vec![]];
        let mut new = old.clone();
        new[0] = vec![(2, 4.0), (3, 0.5), (1, 1.5)];
        assert_eq!(cover_of(&old, &new), (vec![Line::Row(0)], 2));
        for row in &mut new {
            row.push((0, 9.0));
        }
        new[0] = old[0].clone();
        assert_eq!(cover_of(&old, &new).0, vec![Line::Column(0)]);
        assert_eq!(cover_of(&old, &old), (vec![], 0));
    }
}
