//! Squares that robots are looked up by.

/// Robots by the square cell that they are in.
pub(crate) struct Cells<'a> {
    points: &'a [[f64; 2]],
    side: f64,
    low: [f64; 2],
    columns: usize,
    rows: usize,
    /// Where each cell begins in `robots`, and where the last one ends.
    starts: Vec<u32>,
    robots: Vec<u32>,
}

impl<'a> Cells<'a> {
    /// Cells of the given side around all of `points`, of which there is at least one.
    pub(crate) fn new(points: &'a [[f64; 2]], side: f64) -> Self {
        let ends = |axis: usize| {
            let values = points.iter().map(move |point| point[axis]);
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)))
        };
        let (x, y) = (ends(0), ends(1));
        let count = |(low, high): (f64, f64)| ((high - low) / side) as usize + 1;
        let (columns, rows) = (count(x), count(y));
        let mut cells = Self {
            points,
            side,
            low: [x.0, y.0],
            columns,
            rows,
            starts: Vec::new(),
            robots: Vec::new(),
        };
        let place = |point: &[f64; 2]| {
            let (column, row) = cells.cell(point);
            row * columns + column
        };
        let mut starts = vec![0_u32; columns * rows + 1];
        for point in points {
            starts[place(point) + 1] += 1;
        }
        for cell in 0..columns * rows {
            starts[cell + 1] += starts[cell];
        }
        let mut next = starts.clone();
        let mut robots = vec![0; points.len()];
        for (robot, point) in points.iter().enumerate() {
            let next = &mut next[place(point)];
            robots[*next as usize] = robot as u32;
            *next += 1;
        }
        (cells.starts, cells.robots) = (starts, robots);
        cells
    }

    fn cell(&self, point: &[f64; 2]) -> (usize, usize) {
        let place = |axis: usize| ((point[axis] - self.low[axis]) / self.side) as usize;
        (place(0), place(1))
    }

    /// The other robots within `rings` cells of the cell of a robot, with their squared distances.
    /// No robot within `rings` sides is missing.
    pub(crate) fn around(&self, robot: usize, rings: usize, found: &mut Vec<(f64, usize)>) {
        found.clear();
        let at = self.points[robot];
        let (column, row) = self.cell(&at);
        let columns = column.saturating_sub(rings)..(column + rings + 1).min(self.columns);
        for row in row.saturating_sub(rings)..(row + rings + 1).min(self.rows) {
            let first = self.starts[row * self.columns + columns.start] as usize;
            let last = self.starts[row * self.columns + columns.end] as usize;
            for &other in &self.robots[first..last] {
                let place = self.points[other as usize];
                let square = (at[0] - place[0]).powi(2) + (at[1] - place[1]).powi(2);
                if other as usize != robot {
                    found.push((square, other as usize));
                }
            }
        }
    }

    /// The `count` nearest other robots, or all if there are fewer, with their squared distances.
    pub(crate) fn nearest(&self, robot: usize, count: usize, found: &mut Vec<(f64, usize)>) {
        let count = count.min(self.points.len() - 1);
        for rings in 1.. {
            self.around(robot, rings, found);
            let sure = (rings as f64 * self.side).powi(2);
            found.sort_unstable_by(|left, right| left.0.total_cmp(&right.0));
            let all = rings > self.columns.max(self.rows);
            if all || found.get(count.saturating_sub(1)).is_some_and(|last| last.0 <= sure) {
                break;
            }
        }
        found.truncate(count);
    }
}
