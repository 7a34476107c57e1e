//! Costs of robots in columns, as integers.

use thiserror::Error;

/// Largest modulus of a cost. Sums along a path of the flow graph, whose length
/// [`MAX_LIMITED_CELLS`](super::MAX_LIMITED_CELLS) bounds, and prices on top of them stay within 64 bits; totals
/// are 128 bits wide.
pub const MAX_COST: i64 = 1 << 40;

/// Largest modulus of a cost that [`CostMatrix::scaled`] makes: costs differ by a unit only where they
/// differ by less than a billionth of the largest, and sums of several of them stay below [`MAX_COST`].
const SCALED_COST: f64 = (1_u64 << 32) as f64;

/// Cost of every robot in every column, robots × columns in row-major order; the reserve, where there is
/// one, is the last column. Every modulus is at most [`MAX_COST`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CostMatrix {
    robots: usize,
    columns: usize,
    values: Vec<i64>,
}

/// What is wrong with costs.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CostError {
    /// The number of values does not equal robots × columns.
    #[error("{robots} robots and {columns} columns need as many costs as pairs, not {len}")]
    Shape {
        /// Robots asked for.
        robots: usize,
        /// Columns asked for.
        columns: usize,
        /// Values given.
        len: usize,
    },
    /// A cost is larger than [`MAX_COST`], or not a number.
    #[error(
        "the cost of robot {robot} in column {column} is {value}, beyond ±{MAX_COST} units: scale costs down"
    )]
    Cost {
        /// Row of the cost.
        robot: usize,
        /// Column of the cost.
        column: usize,
        /// Its value in units.
        value: f64,
    },
    /// The unit is not a positive number.
    #[error("the unit of costs is {0}: it must be a positive number")]
    Unit(f64),
}

impl CostMatrix {
    /// Costs of `robots` × `columns` pairs in row-major order.
    ///
    /// # Errors
    /// [`CostError::Shape`] and [`CostError::Cost`].
    pub fn new(robots: usize, columns: usize, values: Vec<i64>) -> Result<Self, CostError> {
        check_shape(robots, columns, values.len())?;
        if let Some(at) = values.iter().position(|v| !(-MAX_COST..=MAX_COST).contains(v)) {
            let (robot, column) = (at / columns, at % columns);
            return Err(CostError::Cost { robot, column, value: values[at] as f64 });
        }
        Ok(Self { robots, columns, values })
    }

    /// Costs from numbers: each is divided by `unit` and rounded to the nearest integer, halves away from
    /// zero. The least sum of the integers, times the unit, differs from the least sum of the numbers by at
    /// most `robots · unit`. Keep the unit from call to call, so that kept prices stay valid.
    ///
    /// # Errors
    /// [`CostError::Unit`], [`CostError::Shape`], and [`CostError::Cost`] for a value that is not finite or
    /// too large for this unit.
    pub fn from_floats(
        robots: usize,
        columns: usize,
        values: &[f64],
        unit: f64,
    ) -> Result<Self, CostError> {
        check_shape(robots, columns, values.len())?;
        if !(unit.is_finite() && unit > 0.0) {
            return Err(CostError::Unit(unit));
        }
        let mut rounded = Vec::with_capacity(values.len());
        for (at, value) in values.iter().enumerate() {
            let value = value / unit;
            // Written so that NaN fails the comparison too.
            if !matches!(value.abs(), size if size <= MAX_COST as f64) {
                let (robot, column) = (at / columns, at % columns);
                return Err(CostError::Cost { robot, column, value });
            }
            // `round` is a call without SSE 4.1, which not every machine has.
            rounded.push((value + 0.5_f64.copysign(value)) as i64);
        }
        Ok(Self { robots, columns, values: rounded })
    }

    /// A unit that makes costs of up to `largest` in modulus fit with room to spare: 2⁻³² of it, or 1 if it
    /// is zero.
    #[must_use]
    pub fn unit_for(largest: f64) -> f64 {
        let unit = largest.abs() / SCALED_COST;
        if unit.is_finite() && unit > 0.0 { unit } else { 1.0 }
    }

    /// Number of robots.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.robots
    }

    /// Number of columns, with the reserve.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The costs of one robot.
    ///
    /// # Panics
    /// When `robot` is not below [`CostMatrix::robots`], as slice indexing does.
    #[must_use]
    pub fn row(&self, robot: usize) -> &[i64] {
        &self.values[robot * self.columns..(robot + 1) * self.columns]
    }

    /// The rows of some robots.
    pub(super) fn selected(&self, robots: &[usize]) -> Self {
        let mut values = Vec::with_capacity(robots.len() * self.columns);
        for robot in robots {
            values.extend_from_slice(self.row(*robot));
        }
        Self { robots: robots.len(), columns: self.columns, values }
    }

    /// All rows in order.
    pub(super) fn rows(&self) -> impl Iterator<Item = &[i64]> {
        self.values.chunks_exact(self.columns.max(1))
    }

    /// Adds to one cost; the caller keeps the sum below a small multiple of [`MAX_COST`].
    pub(super) fn add(&mut self, robot: usize, column: usize, amount: i64) {
        self.values[robot * self.columns + column] += amount;
    }
}

fn check_shape(robots: usize, columns: usize, len: usize) -> Result<(), CostError> {
    if robots.checked_mul(columns) != Some(len) {
        return Err(CostError::Shape { robots, columns, len });
    }
    Ok(())
}
