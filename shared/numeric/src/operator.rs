//! αA* in the two orientations and precisions that the products of the partial decomposition need.
//!
//! Nodes are renumbered so that neighbours come close together (reverse Cuthill–McKee, see
//! [`crate::order`]): a product reads the rows of all neighbours of a node, which then are in the
//! cache already. Everything outside of this module and of [`crate::partial`] knows the numbering
//! of the caller only.

use pulp::{Arch, Simd, WithSimd};

use crate::matrix::SparseMatrix;
use crate::order::proximity_order;

/// Compressed rows with small indices, in one precision.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rows<T> {
    starts: Vec<u32>,
    columns: Vec<u32>,
    weights: Vec<T>,
}

/// αA and αAᵀ of an n × n adjacency matrix, renumbered.
#[derive(Debug, Clone, Default)]
pub(crate) struct KatzOperator {
    nodes: usize,
    alpha: f64,
    /// The caller's number of each node in the own order, and the reverse.
    outer: Vec<u32>,
    inner: Vec<u32>,
    forward: Rows<f64>,
    backward: Rows<f64>,
    forward_single: Rows<f32>,
    backward_single: Rows<f32>,
}

/// Which of the two orientations a product takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Orientation {
    /// αA.
    Forward,
    /// αAᵀ.
    Backward,
}

impl KatzOperator {
    /// Builds αA anew in the buffers that are there. The order of the nodes is kept if `keep_order`
    /// and the number of nodes is the same.
    pub(crate) fn assign(&mut self, a: &SparseMatrix, alpha: f64, keep_order: bool) {
        let n = a.nodes();
        if !(keep_order && self.nodes == n && self.outer.len() == n) {
            self.outer = proximity_order(a);
            self.inner.clear();
            self.inner.resize(n, 0);
            for (inner, &outer) in self.outer.iter().enumerate() {
                self.inner[outer as usize] = inner as u32;
            }
        }
        self.nodes = n;
        self.alpha = alpha;
        self.fill_forward(a);
        transpose(&self.forward, &mut self.backward, n);
        to_single(&self.forward, &mut self.forward_single);
        to_single(&self.backward, &mut self.backward_single);
    }

    fn fill_forward(&mut self, a: &SparseMatrix) {
        let rows = &mut self.forward;
        rows.starts.clear();
        rows.columns.clear();
        rows.weights.clear();
        rows.starts.push(0);
        for &outer in &self.outer {
            let start = rows.columns.len();
            for (j, w) in a.row(outer as usize) {
                rows.columns.push(self.inner[j]);
                rows.weights.push(self.alpha * w);
            }
            sort_row(&mut rows.columns[start..], &mut rows.weights[start..]);
            rows.starts.push(rows.columns.len() as u32);
        }
    }

    /// Number of nodes n.
    pub(crate) fn nodes(&self) -> usize {
        self.nodes
    }

    /// The own number of each node of the caller.
    pub(crate) fn inner(&self) -> &[u32] {
        &self.inner
    }

    /// The caller's number of each own one.
    pub(crate) fn outer(&self) -> &[u32] {
        &self.outer
    }

    /// Whether a node, by its own number, has no edge at all.
    pub(crate) fn is_isolated(&self, inner: usize) -> bool {
        let has_none = |rows: &Rows<f64>| rows.starts[inner] == rows.starts[inner + 1];
        has_none(&self.forward) && has_none(&self.backward)
    }

    /// Y = B X with B = αA or αAᵀ; X and Y are n × `width` in rows of `width` values.
    pub(crate) fn multiply(
        &self,
        orientation: Orientation,
        x: &[f64],
        y: &mut [f64],
        width: usize,
    ) {
        let rows = match orientation {
            Orientation::Forward => &self.forward,
            Orientation::Backward => &self.backward,
        };
        Arch::new().dispatch(Product { rows, x, y, width });
    }

    /// One step of Horner's scheme in single precision: `next` = `coefficient` r + B z.
    pub(crate) fn horner_step(
        &self,
        orientation: Orientation,
        coefficient: f32,
        r: &[f32],
        z: &[f32],
        next: &mut [f32],
        width: usize,
    ) {
        let rows = match orientation {
            Orientation::Forward => &self.forward_single,
            Orientation::Backward => &self.backward_single,
        };
        Arch::new().dispatch(HornerStep { rows, coefficient, r, z, next, width });
    }
}

fn sort_row(columns: &mut [u32], weights: &mut [f64]) {
    // Rows are short, and nearly sorted after the first frame.
    for i in 1..columns.len() {
        let mut k = i;
        while k > 0 && columns[k - 1] > columns[k] {
            columns.swap(k - 1, k);
            weights.swap(k - 1, k);
            k -= 1;
        }
    }
}

fn transpose(rows: &Rows<f64>, out: &mut Rows<f64>, n: usize) {
    let count = rows.columns.len();
    out.starts.clear();
    out.starts.resize(n + 1, 0);
    out.columns.clear();
    out.columns.resize(count, 0);
    out.weights.clear();
    out.weights.resize(count, 0.0);
    for &j in &rows.columns {
        out.starts[j as usize + 1] += 1;
    }
    for i in 0..n {
        out.starts[i + 1] += out.starts[i];
    }
    // Each start is moved on while its row fills up, and back again afterwards.
    for i in 0..n {
        for at in rows.starts[i] as usize..rows.starts[i + 1] as usize {
            let j = rows.columns[at] as usize;
            let place = out.starts[j] as usize;
            out.columns[place] = i as u32;
            out.weights[place] = rows.weights[at];
            out.starts[j] += 1;
        }
    }
    for i in (1..=n).rev() {
        out.starts[i] = out.starts[i - 1];
    }
    if let Some(first) = out.starts.first_mut() {
        *first = 0;
    }
}

fn to_single(rows: &Rows<f64>, out: &mut Rows<f32>) {
    out.starts.clone_from(&rows.starts);
    out.columns.clone_from(&rows.columns);
    out.weights.clear();
    out.weights.extend(rows.weights.iter().map(|w| *w as f32));
}

struct Product<'a> {
    rows: &'a Rows<f64>,
    x: &'a [f64],
    y: &'a mut [f64],
    width: usize,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = size_of::<S::f64s>() / size_of::<f64>();
        let mut at = 0;
        while at < self.width {
            let left = (self.width - at) / lanes;
            at += lanes
                * match left {
                    0 => {
                        scalar_columns(self.rows, self.x, self.y, self.width, at);
                        return;
                    }
                    1 => columns_f64::<S, 1>(simd, self.rows, self.x, self.y, self.width, at),
                    2 => columns_f64::<S, 2>(simd, self.rows, self.x, self.y, self.width, at),
                    3 => columns_f64::<S, 3>(simd, self.rows, self.x, self.y, self.width, at),
                    4 => columns_f64::<S, 4>(simd, self.rows, self.x, self.y, self.width, at),
                    5 => columns_f64::<S, 5>(simd, self.rows, self.x, self.y, self.width, at),
                    _ => columns_f64::<S, 6>(simd, self.rows, self.x, self.y, self.width, at),
                };
        }
    }
}

/// C registers of columns from `at` on of Y = B X; returns C.
#[inline(always)]
fn columns_f64<S: Simd, const C: usize>(
    simd: S,
    rows: &Rows<f64>,
    x: &[f64],
    y: &mut [f64],
    width: usize,
    at: usize,
) -> usize {
    let lanes = size_of::<S::f64s>() / size_of::<f64>();
    for (bounds, out) in rows.starts.windows(2).zip(y.chunks_exact_mut(width)) {
        let range = bounds[0] as usize..bounds[1] as usize;
        let mut sums = [simd.splat_f64s(0.0); C];
        for (&j, &w) in rows.columns[range.clone()].iter().zip(&rows.weights[range]) {
            let start = j as usize * width + at;
            let (row, _) = S::as_simd_f64s(&x[start..start + C * lanes]);
            let w = simd.splat_f64s(w);
            for c in 0..C {
                sums[c] = simd.mul_add_e_f64s(w, row[c], sums[c]);
            }
        }
        let (out, _) = S::as_mut_simd_f64s(&mut out[at..at + C * lanes]);
        out.copy_from_slice(&sums);
    }
    C
}

/// The columns from `at` on that fill no register.
#[inline(always)]
fn scalar_columns(rows: &Rows<f64>, x: &[f64], y: &mut [f64], width: usize, at: usize) {
    for (bounds, out) in rows.starts.windows(2).zip(y.chunks_exact_mut(width)) {
        out[at..].fill(0.0);
        for e in bounds[0] as usize..bounds[1] as usize {
            let (j, w) = (rows.columns[e] as usize, rows.weights[e]);
            for (out, x) in out[at..].iter_mut().zip(&x[j * width + at..(j + 1) * width]) {
                *out += w * x;
            }
        }
    }
}

struct HornerStep<'a> {
    rows: &'a Rows<f32>,
    coefficient: f32,
    r: &'a [f32],
    z: &'a [f32],
    next: &'a mut [f32],
    width: usize,
}

impl WithSimd for HornerStep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let lanes = size_of::<S::f32s>() / size_of::<f32>();
        let mut at = 0;
        while at < self.width {
            let left = (self.width - at) / lanes;
            at += lanes
                * match left {
                    0 => {
                        self.scalar(at);
                        return;
                    }
                    1 => self.columns::<S, 1>(simd, at),
                    2 => self.columns::<S, 2>(simd, at),
                    3 => self.columns::<S, 3>(simd, at),
                    _ => self.columns::<S, 4>(simd, at),
                };
        }
    }
}

impl HornerStep<'_> {
    #[inline(always)]
    fn columns<S: Simd, const C: usize>(&mut self, simd: S, at: usize) -> usize {
        let lanes = size_of::<S::f32s>() / size_of::<f32>();
        let coefficient = simd.splat_f32s(self.coefficient);
        for (i, bounds) in self.rows.starts.windows(2).enumerate() {
            let range = bounds[0] as usize..bounds[1] as usize;
            let own = i * self.width + at..i * self.width + at + C * lanes;
            let (r, _) = S::as_simd_f32s(&self.r[own.clone()]);
            let mut sums = [simd.splat_f32s(0.0); C];
            for c in 0..C {
                sums[c] = simd.mul_f32s(coefficient, r[c]);
            }
            for (&j, &w) in self.rows.columns[range.clone()].iter().zip(&self.rows.weights[range]) {
                let start = j as usize * self.width + at;
                let (row, _) = S::as_simd_f32s(&self.z[start..start + C * lanes]);
                let w = simd.splat_f32s(w);
                for c in 0..C {
                    sums[c] = simd.mul_add_e_f32s(w, row[c], sums[c]);
                }
            }
            let (next, _) = S::as_mut_simd_f32s(&mut self.next[own]);
            next.copy_from_slice(&sums);
        }
        C
    }

    /// The columns from `at` on that fill no register.
    #[inline(always)]
    fn scalar(&mut self, at: usize) {
        for (i, bounds) in self.rows.starts.windows(2).enumerate() {
            for c in at..self.width {
                let mut sum = self.coefficient * self.r[i * self.width + c];
                for e in bounds[0] as usize..bounds[1] as usize {
                    let j = self.rows.columns[e] as usize;
                    sum += self.rows.weights[e] * self.z[j * self.width + c];
                }
                self.next[i * self.width + c] = sum;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn random(n: usize, seed: u64) -> SparseMatrix {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let edges: Vec<_> = (0..4 * n)
            .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
            .collect();
        SparseMatrix::from_triplets(n, edges).unwrap()
    }

    #[test]
    fn products_equal_the_definition_in_every_width() {
        let (n, alpha) = (57, 0.3);
        let a = random(n, 3);
        let mut operator = KatzOperator::default();
        operator.assign(&a, alpha, false);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for width in 1..40 {
            let x: Vec<f64> = (0..n * width).map(|_| rng.random::<f64>()).collect();
            let mut y = vec![0.0; n * width];
            for orientation in [Orientation::Forward, Orientation::Backward] {
                operator.multiply(orientation, &x, &mut y, width);
                for i in 0..n {
                    for c in 0..width {
                        let term = |j: usize| {
                            let (from, to) = match orientation {
                                Orientation::Forward => (i, j),
                                Orientation::Backward => (j, i),
                            };
                            let at = |k: usize| operator.outer[k] as usize;
                            alpha * a.weight(at(from), at(to)) * x[j * width + c]
                        };
                        let wanted: f64 = (0..n).map(term).sum();
                        assert!((y[i * width + c] - wanted).abs() < 1e-12);
                    }
                }
            }
        }
        let _ = rng.next_u64();
    }
}
