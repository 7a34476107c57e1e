//! The Katz similarity and its singular values by other ways and in more digits.
//!
//! [`rational`] solves in whole numbers, without any rounding, for graphs of a few nodes. [`Precise`]
//! holds a number as the sum of two doubles (Dekker 1971; Hida, Li and Bailey 2001), some 31 digits, in
//! which the series is summed and decomposed by one-sided Jacobi rotations.

use std::ops::{Add, Mul, Neg, Sub};

use muster_numeric::matrix::{DenseMatrix, SparseMatrix};

/// S of a graph of whole weights and the decay 1/`inverse_decay`, exactly up to the last division: with
/// M = q I − A, S = M⁻¹ A, by Bareiss elimination (Math. Comp. 22, 1968), in which all quotients are whole.
///
/// # Panics
/// If the numbers leave 127 bits.
pub(crate) fn rational(a: &SparseMatrix, inverse_decay: i128) -> DenseMatrix {
    let n = a.nodes();
    let weight = |i: usize, j: usize| a.weight(i, j) as i128;
    let mut rows: Vec<Vec<i128>> = (0..n)
        .map(|i| {
            let own = |j: usize| if i == j { inverse_decay } else { 0 };
            (0..n).map(|j| own(j) - weight(i, j)).chain((0..n).map(|j| weight(i, j))).collect()
        })
        .collect();
    let mut last = 1;
    for k in 0..n {
        // The leading minors of an M-matrix are positive, so that nothing has to be exchanged.
        let pivot = rows[k].clone();
        for (i, row) in rows.iter_mut().enumerate() {
            if i == k {
                continue;
            }
            let factor = row[k];
            for (value, above) in row.iter_mut().zip(&pivot) {
                let product = pivot[k].checked_mul(*value).unwrap();
                let other = factor.checked_mul(*above).unwrap();
                *value = product.checked_sub(other).unwrap() / last;
            }
        }
        last = pivot[k];
    }
    let rows: Vec<Vec<f64>> = rows
        .iter()
        .enumerate()
        .map(|(i, row)| row[n..].iter().map(|value| *value as f64 / row[i] as f64).collect())
        .collect();
    DenseMatrix::from_rows(&rows).unwrap()
}

/// A number of twice the digits: the sum of two doubles, the second below half a unit of the first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Precise(f64, f64);

impl Precise {
    pub(crate) const ZERO: Self = Self(0.0, 0.0);

    pub(crate) fn new(value: f64) -> Self {
        Self(value, 0.0)
    }

    pub(crate) fn value(self) -> f64 {
        self.0
    }

    /// The sum of any two doubles, without an error.
    fn sum(a: f64, b: f64) -> Self {
        let sum = a + b;
        let there = sum - a;
        Self(sum, (a - (sum - there)) + (b - there))
    }

    /// The same for a that is no smaller than b.
    fn tidy(a: f64, b: f64) -> Self {
        let sum = a + b;
        Self(sum, b - (sum - a))
    }

    fn inverse(self) -> Self {
        // One step of Newton's iteration doubles the digits of a double.
        let guess = Self::new(1.0 / self.0);
        guess + guess * (Self::new(1.0) - self * guess)
    }

    fn root(self) -> Self {
        if self.0 <= 0.0 {
            return Self::ZERO;
        }
        let guess = Self::new(self.0.sqrt());
        guess + (self - guess * guess) * (guess + guess).inverse()
    }
}

impl Add for Precise {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let (high, low) = (Self::sum(self.0, other.0), Self::sum(self.1, other.1));
        let first = Self::tidy(high.0, high.1 + low.0);
        Self::tidy(first.0, first.1 + low.1)
    }
}

impl Neg for Precise {
    type Output = Self;

    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}

impl Sub for Precise {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Precise {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let product = self.0 * other.0;
        let error = self.0.mul_add(other.0, -product);
        Self::tidy(product, error + (self.0 * other.1 + self.1 * other.0))
    }
}

/// A square matrix, column by column.
pub(crate) type Columns = Vec<Vec<Precise>>;

/// Σ αˡ Aˡ for l from 1 to 2¹³, by doubling: the sum of twice as many terms is P + B P with the last
/// power B.
pub(crate) fn series(a: &SparseMatrix, alpha: f64) -> Columns {
    let n = a.nodes();
    let mut power = vec![vec![Precise::ZERO; n]; n];
    for (i, j, w) in a.triplets() {
        power[j][i] = Precise::new(alpha) * Precise::new(w);
    }
    let mut sum = power.clone();
    for _ in 0..13 {
        let more = product(&power, &sum);
        for (sum, more) in sum.iter_mut().zip(&more) {
            for (sum, more) in sum.iter_mut().zip(more) {
                *sum = *sum + *more;
            }
        }
        power = product(&power, &power);
    }
    sum
}

fn product(left: &Columns, right: &Columns) -> Columns {
    let column = |right: &Vec<Precise>| {
        let mut sums = vec![Precise::ZERO; right.len()];
        for (column, factor) in left.iter().zip(right) {
            for (sum, value) in sums.iter_mut().zip(column) {
                *sum = *sum + *factor * *value;
            }
        }
        sums
    };
    right.iter().map(column).collect()
}

/// Singular values, descending, with the left and right vectors of each, by rotating columns until they
/// are orthogonal (Hestenes 1958).
pub(crate) fn decomposed(s: &Columns) -> Vec<(f64, Vec<f64>, Vec<f64>)> {
    let n = s.len();
    let dot = |a: &[Precise], b: &[Precise]| {
        a.iter().zip(b).fold(Precise::ZERO, |sum, (a, b)| sum + *a * *b)
    };
    let mut rotated = s.clone();
    let mut right: Columns = (0..n)
        .map(|j| (0..n).map(|i| Precise::new(f64::from(u8::from(i == j)))).collect())
        .collect();
    let top = rotated.iter().map(|column| dot(column, column).value()).fold(0.0, f64::max);
    for _ in 0..60 {
        let mut rotations = 0;
        for p in 0..n {
            for q in p + 1..n {
                let (a, b) = (dot(&rotated[p], &rotated[p]), dot(&rotated[q], &rotated[q]));
                let c = dot(&rotated[p], &rotated[q]);
                if c.value().abs() <= 1e-29 * (a.value() * b.value()).sqrt() + 1e-60 * top {
                    continue;
                }
                rotations += 1;
                let zeta = (b - a) * (c + c).inverse();
                let length = (Precise::new(1.0) + zeta * zeta).root();
                let tangent = if zeta.value() >= 0.0 {
                    (zeta + length).inverse()
                } else {
                    -((length - zeta).inverse())
                };
                let cosine = (Precise::new(1.0) + tangent * tangent).root().inverse();
                let sine = cosine * tangent;
                for columns in [&mut rotated, &mut right] {
                    let (first, second) = columns.split_at_mut(q);
                    for (x, y) in first[p].iter_mut().zip(&mut second[0]) {
                        (*x, *y) = (cosine * *x - sine * *y, sine * *x + cosine * *y);
                    }
                }
            }
        }
        if rotations == 0 {
            break;
        }
    }
    let mut triplets: Vec<_> = rotated
        .iter()
        .zip(&right)
        .map(|(image, right)| {
            let sigma = dot(image, image).root();
            let scale = if sigma.value() > 0.0 { sigma.inverse() } else { Precise::ZERO };
            let left = image.iter().map(|value| (*value * scale).value()).collect();
            (sigma.value(), left, right.iter().map(|value| value.value()).collect())
        })
        .collect();
    triplets.sort_by(|left: &(f64, _, _), right| right.0.total_cmp(&left.0));
    triplets
}
