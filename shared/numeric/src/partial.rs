//! The leading singular triplets of the Katz similarity S, without S and without any inverse.
//!
//! Write V = M W with M = I − αA. Since S = αA M⁻¹ = M⁻¹ αA, S V = αA W and W = V + S V: one product
//! with a sparse matrix is all that Rayleigh and Ritz need on the range of V, and it is exact. The
//! residual of a right vector costs one more, Mᵀ(Sᵀu − σv) = αAᵀ(u + σv) − σv. The best next direction,
//! (M Mᵀ)⁻¹ times that residual, is approximated by a few steps of the Chebyshev iteration in single
//! precision; how well decides the number of rounds, not the accuracy. This is a block Davidson method
//! (Davidson, J. Comput. Phys. 17, 1975) for SᵀS that exploits how the Katz similarity is made.

use pulp::Arch;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::backend::tall::{
    Block, BlockMut, Symmetric, divide_by_factor, gram, product, subtract_product,
};
use crate::operator::{KatzOperator, Orientation};

/// More vectors than asked for that are carried along: how fast the last one wanted converges depends
/// on the gap to the first that is not carried.
const EXTRA: usize = 8;

/// How many blocks of vectors the search space holds before it is restarted with the best.
const BLOCKS: usize = 3;

/// Columns of a block are a multiple of this where possible: the doubles in the largest registers.
const REGISTER: usize = 8;

/// Degree of the preconditioner: with fewer, rounds get more, with more, dearer.
const DEGREE: usize = 3;

/// Random vectors that the preconditioner is fitted to.
const SAMPLES: usize = 8;

/// Rounds after which the search gives up.
const MAX_ROUNDS: usize = 300;

/// Squared length that must be left of a direction of length 1 beside the space and the other ones. What
/// is left is scaled up to length 1 again, and the rounding of S V with it.
const DEPENDENT: f64 = 1e-12;

/// What must be left of every new direction, beside the space and the other ones, for rounding to have
/// spoiled no more than a few digits of its being orthogonal.
const LITTLE: f64 = 0.03;

/// Values up to this fraction of the largest count as zero, and their vectors are not looked at: squares
/// of them are lost beside the square of the largest.
pub(crate) const NULL: f64 = 1e-7;

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Request {
    /// How many triplets.
    pub(crate) rank: usize,
    /// Largest residual ‖Mᵀ(Sᵀu − σv)‖ relative to σ₁.
    pub(crate) tolerance: f64,
    /// Random directions beside those to begin with, which find what those do not hold at all.
    pub(crate) probes: usize,
    /// Seed of the random directions.
    pub(crate) seed: u64,
}

/// Triplets in the own order of the operator, in rows of `width` values.
#[derive(Debug, Clone, Default)]
pub(crate) struct Triplets {
    /// Values in a row; those beyond the rank asked for are less exact.
    pub(crate) width: usize,
    /// Right vectors V, n × width.
    pub(crate) right: Vec<f64>,
    /// S V = U Σ, n × width.
    pub(crate) image: Vec<f64>,
    /// Singular values, descending.
    pub(crate) sigma: Vec<f64>,
    /// ‖Mᵀ(Sᵀu − σv)‖ of each, relative to σ₁.
    pub(crate) residuals: Vec<f64>,
    /// Rounds that it took.
    pub(crate) rounds: usize,
    /// Whether all that were asked for are within the tolerance.
    pub(crate) converged: bool,
}

/// Scratch space, reused from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    /// Orthonormal V and S V of the search space, n × capacity.
    space: Vec<f64>,
    image: Vec<f64>,
    /// New directions, n × carried.
    block: Vec<f64>,
    product: Vec<f64>,
    single: [Vec<f32>; 3],
    /// Coefficients of the preconditioner, from the constant on.
    polynomial: Vec<f64>,
    /// (S V)ᵀ S V, capacity × capacity.
    energy: Vec<f64>,
    compact: Vec<f64>,
    overlap: Vec<f64>,
    lengths: Vec<f64>,
    symmetric: Symmetric,
}

/// Leading triplets of the Katz similarity behind `operator`.
///
/// `start` holds blocks of directions W to begin with, each n × p in rows, in the own order of the
/// operator: V + UΣ of similar graphs, for example. Random ones fill what is missing.
pub(crate) fn leading_triplets(
    operator: &KatzOperator,
    request: Request,
    start: &[(&[f64], usize)],
    work: &mut Workspace,
    out: &mut Triplets,
) {
    let n = operator.nodes();
    let carried = (request.rank + EXTRA).next_multiple_of(8).min(n);
    let capacity = (BLOCKS * carried).min(n);
    let mut search = Search { operator, request, n, carried, capacity, size: 0, work };
    search.reserve(out);
    search.fit_polynomial();
    search.begin(start);
    search.run(out);
}

struct Search<'a> {
    operator: &'a KatzOperator,
    request: Request,
    n: usize,
    /// Vectors that a restart keeps.
    carried: usize,
    /// Most vectors of the space.
    capacity: usize,
    /// Vectors in the space.
    size: usize,
    work: &'a mut Workspace,
}

impl Search<'_> {
    fn reserve(&mut self, out: &mut Triplets) {
        let (n, carried, capacity) = (self.n, self.carried, self.capacity);
        let work = &mut *self.work;
        work.space.resize(n * capacity, 0.0);
        work.image.resize(n * capacity, 0.0);
        for buffer in [&mut work.block, &mut work.product, &mut out.right, &mut out.image] {
            buffer.resize(n * carried, 0.0);
        }
        for buffer in &mut work.single {
            buffer.resize(n * carried.next_multiple_of(2 * REGISTER), 0.0);
        }
        work.energy.resize(capacity * capacity, 0.0);
        work.compact.resize(capacity * capacity, 0.0);
        work.overlap.resize(capacity * carried, 0.0);
        out.width = carried;
    }

    fn begin(&mut self, start: &[(&[f64], usize)]) {
        for (block, columns) in start {
            let columns = (*columns).min(self.carried).min(self.capacity - self.size);
            if columns > 0 {
                self.work.block[..self.n * columns].copy_from_slice(&block[..self.n * columns]);
                self.expand(columns);
            }
        }
        let missing = self.carried.saturating_sub(self.size).max(self.request.probes);
        let columns = missing.min(self.carried).min(self.capacity - self.size);
        if columns > 0 {
            let mut rng = ChaCha8Rng::seed_from_u64(self.request.seed);
            for value in &mut self.work.block[..self.n * columns] {
                *value = rng.random::<f64>() - 0.5;
            }
            self.expand(columns);
        }
    }

    fn run(&mut self, out: &mut Triplets) {
        out.rounds = 0;
        loop {
            out.rounds += 1;
            if !self.ritz(out) {
                out.converged = false;
                return;
            }
            let wanted = self.residuals(out);
            out.converged = wanted == 0;
            if wanted == 0 || out.rounds >= MAX_ROUNDS || self.size >= self.n {
                return;
            }
            if self.size + wanted > self.capacity {
                self.restart(out);
            }
            let room = self.capacity - self.size;
            let wanted = wanted.min(room);
            if wanted == 0 {
                return;
            }
            self.precondition(wanted);
            let before = self.size;
            self.expand(wanted);
            if self.size == before {
                return;
            }
        }
    }

    /// Takes the directions W in the block into the space, as V = M W and S V = αA W.
    fn expand(&mut self, width: usize) {
        let (n, capacity) = (self.n, self.capacity);
        {
            let Workspace { block, product, .. } = &mut *self.work;
            let (block, product) = (&mut block[..n * width], &mut product[..n * width]);
            self.operator.multiply(Orientation::Forward, block, product, width);
            Arch::new().dispatch(|| {
                for (w, s) in block.iter_mut().zip(&*product) {
                    *w -= s;
                }
            });
        }
        let mut kept = width;
        // Twice is enough (Kahan and Parlett), and once where little was taken out.
        for _ in 0..2 {
            self.normalise(width);
            self.project_out(width);
            let (independent, left) = self.orthonormalise(width, kept);
            kept = independent;
            if kept == 0 {
                return;
            }
            if left >= LITTLE {
                break;
            }
        }
        let size = self.size;
        let Workspace { space, image, block, product, energy, overlap, .. } = &mut *self.work;
        for (to, from) in [(&mut *space, &*block), (&mut *image, &*product)] {
            let rows = to.chunks_exact_mut(capacity).zip(from[..n * width].chunks_exact(width));
            for (to, from) in rows {
                to[size..size + kept].copy_from_slice(&from[..kept]);
            }
        }
        self.size += kept;
        let all = self.size;
        let new = Block::new(&product[..n * width], kept, width);
        let overlap = &mut overlap[..all * kept];
        gram(Block::new(image, all, capacity), new, BlockMut::new(overlap, kept, kept));
        for i in 0..all {
            for j in 0..kept {
                let value = overlap[i * kept + j];
                energy[i * capacity + size + j] = value;
                energy[(size + j) * capacity + i] = value;
            }
        }
    }

    /// Scales the new directions to length 1; those of length 0 stay.
    fn normalise(&mut self, width: usize) {
        let n = self.n;
        let Workspace { block, product, lengths, .. } = &mut *self.work;
        let (block, product) = (&mut block[..n * width], &mut product[..n * width]);
        column_lengths(block, width, lengths);
        for length in lengths.iter_mut() {
            *length = if *length > 0.0 { 1.0 / *length } else { 0.0 };
        }
        for rows in [block, product] {
            Arch::new().dispatch(|| {
                for row in rows.chunks_exact_mut(width) {
                    for (value, factor) in row.iter_mut().zip(&*lengths) {
                        *value *= factor;
                    }
                }
            });
        }
    }

    /// Takes out of the new directions what the space holds already.
    fn project_out(&mut self, width: usize) {
        if self.size == 0 {
            return;
        }
        let (n, size, capacity) = (self.n, self.size, self.capacity);
        let Workspace { space, image, block, product, overlap, .. } = &mut *self.work;
        let (block, product) = (&mut block[..n * width], &mut product[..n * width]);
        let space = Block::new(space, size, capacity);
        let overlap = &mut overlap[..size * width];
        gram(space, Block::new(block, width, width), BlockMut::new(overlap, width, width));
        let overlap = Block::new(overlap, width, width);
        subtract_product(space, overlap, BlockMut::new(block, width, width));
        let image = Block::new(image, size, capacity);
        subtract_product(image, overlap, BlockMut::new(product, width, width));
    }

    /// Makes the first `columns` new directions, which had length 1, orthonormal. Returns how many
    /// independent ones there were, which come first, and what was left at least of each.
    fn orthonormalise(&mut self, width: usize, columns: usize) -> (usize, f64) {
        let n = self.n;
        let Workspace { block, product, compact, overlap, symmetric, .. } = &mut *self.work;
        let (block, product) = (&mut block[..n * width], &mut product[..n * width]);
        let gram_matrix = &mut compact[..columns * columns];
        let view = Block::new(block, columns, width);
        gram(view, view, BlockMut::new(gram_matrix, columns, columns));
        let factor = &mut overlap[..columns * columns];
        factor.copy_from_slice(gram_matrix);
        if symmetric.cholesky(factor, columns, DEPENDENT) {
            let left = (0..columns).map(|i| factor[i * columns + i]).fold(1.0, f64::min);
            for rows in [block, product] {
                divide_by_factor(factor, columns, BlockMut::new(rows, columns, width));
            }
            return (columns, left);
        }
        // Some directions depend on others: keep the principal ones.
        let Some((values, vectors)) = symmetric.eigen(gram_matrix, columns) else {
            return (0, 0.0);
        };
        let kept = values.iter().filter(|value| **value > DEPENDENT).count();
        let transform = &mut overlap[..columns * kept];
        for i in 0..columns {
            for j in 0..kept {
                transform[i * kept + j] = vectors[i * columns + j] / values[j].sqrt();
            }
        }
        let mut row = vec![0.0; kept];
        for rows in [block, product] {
            for values in rows.chunks_exact_mut(width) {
                row.fill(0.0);
                for (value, factors) in values.iter().zip(transform.chunks_exact(kept.max(1))) {
                    for (sum, factor) in row.iter_mut().zip(factors) {
                        *sum += value * factor;
                    }
                }
                values[..kept].copy_from_slice(&row);
                values[kept..].fill(0.0);
            }
        }
        (kept, 0.0)
    }

    /// The best triplets of the space. False when there are none in floating point.
    fn ritz(&mut self, out: &mut Triplets) -> bool {
        let (size, capacity, carried) = (self.size, self.capacity, self.carried);
        let Workspace { space, image, energy, compact, overlap, symmetric, .. } = &mut *self.work;
        if size == 0 {
            out.sigma.clear();
            out.sigma.resize(carried, 0.0);
            out.residuals.clear();
            out.residuals.resize(carried, f64::INFINITY);
            return false;
        }
        let compact = &mut compact[..size * size];
        for (to, from) in compact.chunks_exact_mut(size).zip(energy.chunks_exact(capacity)) {
            to.copy_from_slice(&from[..size]);
        }
        out.sigma.clear();
        let count = carried.min(size);
        let vectors = &mut overlap[..size * count];
        let Some((values, all)) = symmetric.eigen(compact, size) else {
            out.sigma.resize(carried, 0.0);
            out.residuals.clear();
            out.residuals.resize(carried, f64::INFINITY);
            return false;
        };
        out.sigma.extend(values[..count].iter().map(|value| value.max(0.0).sqrt()));
        for (to, from) in vectors.chunks_exact_mut(count).zip(all.chunks_exact(size)) {
            to.copy_from_slice(&from[..count]);
        }
        let vectors = Block::new(vectors, count, count);
        let width = out.width;
        product(
            Block::new(space, size, capacity),
            vectors,
            BlockMut::new(&mut out.right, count, width),
        );
        product(
            Block::new(image, size, capacity),
            vectors,
            BlockMut::new(&mut out.image, count, width),
        );
        out.sigma.resize(carried, 0.0);
        true
    }

    /// Residuals of all triplets, into the block. How many triplets still need directions, 0 when those
    /// that were asked for are within the tolerance; their residuals come first in the block.
    fn residuals(&mut self, out: &mut Triplets) -> usize {
        let (n, width) = (self.n, out.width);
        let Workspace { block, product, lengths, .. } = &mut *self.work;
        let (block, product) = (&mut block[..n * width], &mut product[..n * width]);
        let top = out.sigma.first().copied().unwrap_or(0.0);
        let null = NULL * top;
        lengths.clear();
        lengths.extend(out.sigma.iter().map(|s| if *s > null { 1.0 / s } else { 0.0 }));
        let sigma = &out.sigma[..width];
        Arch::new().dispatch(|| {
            let rows = block.chunks_exact_mut(width).zip(out.image.chunks_exact(width));
            for ((to, image), right) in rows.zip(out.right.chunks_exact(width)) {
                let values = to.iter_mut().zip(image).zip(right).zip(&*lengths).zip(sigma);
                for ((((to, image), right), inverse), sigma) in values {
                    *to = image * inverse + right * sigma;
                }
            }
        });
        self.operator.multiply(Orientation::Backward, block, product, width);
        Arch::new().dispatch(|| {
            for (row, right) in product.chunks_exact_mut(width).zip(out.right.chunks_exact(width)) {
                for ((value, right), sigma) in row.iter_mut().zip(right).zip(sigma) {
                    *value -= right * sigma;
                }
            }
        });
        column_lengths(product, width, lengths);
        out.residuals.clear();
        let relative = |(length, sigma): (&f64, &f64)| {
            if *sigma > null && top > 0.0 { length / top } else { 0.0 }
        };
        out.residuals.extend(lengths.iter().zip(&out.sigma).map(relative));
        let rank = self.request.rank.min(width);
        let tolerance = self.request.tolerance;
        if out.residuals[..rank].iter().all(|residual| *residual <= tolerance) {
            return 0;
        }
        let mut open: Vec<usize> = (0..width).filter(|c| out.residuals[*c] > tolerance).collect();
        // Registers hold so many columns, and what is left over costs as much as a whole one.
        let wanted = open.len().next_multiple_of(REGISTER);
        let rest = (0..width).filter(|c| (1e-14..=tolerance).contains(&out.residuals[*c]));
        open.extend(rest.take(wanted - open.len()));
        let scales: Vec<f64> = open.iter().map(|&c| 1.0 / lengths[c]).collect();
        for (to, from) in block.chunks_exact_mut(open.len()).zip(product.chunks_exact(width)) {
            for ((to, &c), scale) in to.iter_mut().zip(&open).zip(&scales) {
                *to = from[c] * scale;
            }
        }
        open.len()
    }

    /// Begins the space anew with the best triplets.
    fn restart(&mut self, out: &Triplets) {
        let (n, capacity, width) = (self.n, self.capacity, out.width);
        let Workspace { space, image, energy, .. } = &mut *self.work;
        for (to, from) in [(space, &out.right), (image, &out.image)] {
            for i in 0..n {
                to[i * capacity..i * capacity + width]
                    .copy_from_slice(&from[i * width..(i + 1) * width]);
            }
        }
        energy.fill(0.0);
        for (c, sigma) in out.sigma.iter().enumerate() {
            energy[c * capacity + c] = sigma * sigma;
        }
        self.size = width;
    }

    /// Replaces the residuals r in the block by about (M Mᵀ)⁻¹ r, in single precision.
    fn precondition(&mut self, width: usize) {
        let n = self.n;
        let Workspace { block, single, polynomial, .. } = &mut *self.work;
        let block = &mut block[..n * width];
        let [r, z, next] = single;
        // Twice as many single numbers fit a register; columns that fill it up are zero.
        let stride = width.next_multiple_of(2 * REGISTER);
        let (r, z, next) = (&mut r[..n * stride], &mut z[..n * stride], &mut next[..n * stride]);
        Arch::new().dispatch(|| {
            for (to, from) in r.chunks_exact_mut(stride).zip(block.chunks_exact(width)) {
                let (to, padding) = to.split_at_mut(width);
                padding.fill(0.0);
                for (to, from) in to.iter_mut().zip(from) {
                    *to = *from as f32;
                }
            }
        });
        let (mut current, mut other): (&mut [f32], &mut [f32]) = (z, next);
        for orientation in [Orientation::Backward, Orientation::Forward] {
            let Some((last, rest)) = polynomial.split_last() else { return };
            let last = *last as f32;
            Arch::new().dispatch(|| {
                for (z, r) in current.iter_mut().zip(&*r) {
                    *z = last * r;
                }
            });
            for coefficient in rest.iter().rev() {
                let c = *coefficient as f32;
                self.operator.horner_step(orientation, c, r, current, other, stride);
                std::mem::swap(&mut current, &mut other);
            }
            r.copy_from_slice(current);
        }
        // Weights may span more magnitudes than single numbers do; the residuals serve as they are then.
        if !r.iter().all(|value| value.is_finite()) {
            return;
        }
        Arch::new().dispatch(|| {
            for (to, from) in block.chunks_exact_mut(width).zip(r.chunks_exact(stride)) {
                for (to, from) in to.iter_mut().zip(from) {
                    *to = f64::from(*from);
                }
            }
        });
    }

    /// Coefficients of the polynomial p of degree [`DEGREE`] for which p(B) comes nearest to (I − B)⁻¹ on a few
    /// random vectors, B = αA: that of GMRES (Embree, Loe and Morgan, SIAM J. Sci. Comput. 43, 2021).
    /// It fits any spectrum, also that of directed graphs.
    fn fit_polynomial(&mut self) {
        let n = self.n;
        let terms = DEGREE + 2;
        let mut powers: Vec<Vec<f64>> = Vec::with_capacity(terms);
        let mut rng = ChaCha8Rng::seed_from_u64(self.request.seed ^ 0x9e37);
        powers.push((0..n * SAMPLES).map(|_| rng.random::<f64>() - 0.5).collect());
        for k in 1..terms {
            let mut next = vec![0.0; n * SAMPLES];
            self.operator.multiply(Orientation::Forward, &powers[k - 1], &mut next, SAMPLES);
            powers.push(next);
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut products = vec![0.0; terms * terms];
        for i in 0..terms {
            for j in 0..=i {
                let value = dot(&powers[i], &powers[j]);
                products[i * terms + j] = value;
                products[j * terms + i] = value;
            }
        }
        let p = |i: usize, j: usize| products[i * terms + j];
        // Normal equations for the columns Bᵏ b − Bᵏ⁺¹ b.
        let size = DEGREE + 1;
        let mut system = vec![0.0; size * size];
        let mut right = vec![0.0; size];
        for i in 0..size {
            for j in 0..size {
                system[i * size + j] = p(i, j) - p(i + 1, j) - p(i, j + 1) + p(i + 1, j + 1);
            }
            right[i] = p(i, 0) - p(i + 1, 0);
        }
        self.work.polynomial = solve_small(&mut system, &mut right, size);
    }
}

/// Solves a small symmetric positive semidefinite system by elimination with pivoting; directions that
/// are lost in rounding get nothing.
fn solve_small(system: &mut [f64], right: &mut [f64], size: usize) -> Vec<f64> {
    let top = (0..size).map(|i| system[i * size + i]).fold(0.0, f64::max);
    for k in 0..size {
        let pivot = system[k * size + k];
        if pivot <= 1e-14 * top {
            for i in k..size {
                right[i] = 0.0;
                for j in 0..size {
                    system[i * size + j] = f64::from(u8::from(i == j));
                }
            }
            break;
        }
        for i in k + 1..size {
            let factor = system[i * size + k] / pivot;
            for j in k..size {
                system[i * size + j] -= factor * system[k * size + j];
            }
            right[i] -= factor * right[k];
        }
    }
    let mut solution = vec![0.0; size];
    for i in (0..size).rev() {
        let known: f64 = (i + 1..size).map(|j| system[i * size + j] * solution[j]).sum();
        solution[i] = (right[i] - known) / system[i * size + i];
    }
    solution
}

/// Length of each column of rows of `width` values.
fn column_lengths(rows: &[f64], width: usize, lengths: &mut Vec<f64>) {
    lengths.clear();
    lengths.resize(width, 0.0);
    Arch::new().dispatch(|| {
        for row in rows.chunks_exact(width) {
            for (sum, value) in lengths.iter_mut().zip(row) {
                *sum += value * value;
            }
        }
    });
    for length in lengths {
        *length = length.sqrt();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::katz::katz_similarity;
    use crate::matrix::SparseMatrix;
    use crate::spectral_radius::spectral_radius;
    use crate::svd::full_svd;

    fn random(n: usize, degree: usize, seed: u64) -> SparseMatrix {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let edges: Vec<_> = (0..degree * n)
            .map(|_| (rng.random_range(0..n), rng.random_range(0..n), rng.random::<f64>()))
            .collect();
        SparseMatrix::from_triplets(n, edges).unwrap()
    }

    #[test]
    fn triplets_equal_those_of_the_full_decomposition() {
        for (n, seed) in [(40, 1), (97, 2), (150, 3), (300, 4)] {
            for fraction in [0.5, 0.9] {
                let a = random(n, 4, seed);
                let radius = spectral_radius(&a, None);
                let alpha = fraction / radius.upper;
                let full = full_svd(&katz_similarity(&a, alpha, &radius).unwrap()).unwrap();
                let mut operator = KatzOperator::default();
                operator.assign(&a, alpha, false);
                let request = Request { rank: 8, tolerance: 1e-9, probes: 0, seed: 5 };
                let mut out = Triplets::default();
                leading_triplets(&operator, request, &[], &mut Workspace::default(), &mut out);
                assert!(out.converged, "n {n}: {:?}", out.residuals);
                for j in 0..8 {
                    let wanted = full.singular_values()[j];
                    assert!((out.sigma[j] - wanted).abs() < 1e-11 * wanted, "n {n} σ{j}");
                }
            }
        }
    }
}
