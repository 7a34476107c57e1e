//! LU of small general systems in reused memory, and the products that apply their solutions.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::lu::partial_pivoting::{factor, solve};
use faer::linalg::matmul::matmul;
use faer::perm::PermRef;
use faer::{Accum, MatMut, MatRef, Par};

/// Steps of the estimate of the norm of an inverse; it rarely changes after the second.
const NORM_STEPS: usize = 5;

/// LU factors of one k × k matrix at a time, with scratch space.
#[derive(Default)]
pub(crate) struct Factored {
    size: usize,
    factors: Vec<f64>,
    forward: Vec<usize>,
    backward: Vec<usize>,
    memory: Option<(usize, usize, MemBuffer)>,
    vector: Vec<f64>,
    trial: Vec<f64>,
}

impl std::fmt::Debug for Factored {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Factored").field("size", &self.size).finish_non_exhaustive()
    }
}

fn stack(
    memory: &mut Option<(usize, usize, MemBuffer)>,
    size: usize,
    columns: usize,
) -> &mut MemStack {
    let fits = memory.as_ref().is_some_and(|(rows, wide, _)| *rows >= size && *wide >= columns);
    if !fits {
        *memory = None;
    }
    let (_, _, buffer) = memory.get_or_insert_with(|| {
        let par = Par::Seq;
        let factors =
            factor::lu_in_place_scratch::<usize, f64>(size, size, par, Default::default());
        let there = solve::solve_in_place_scratch::<usize, f64>(size, columns, par);
        let back = solve::solve_transpose_in_place_scratch::<usize, f64>(size, columns, par);
        (size, columns, MemBuffer::new(StackReq::any_of(&[factors, there, back])))
    });
    MemStack::new(buffer)
}

impl Factored {
    /// Factors the k × k row-major matrix that `fill` writes, by LU with partial pivoting. Returns
    /// an estimate of its reciprocal condition in the 1-norm, 0 when it is singular or not finite
    /// (Hager, SIAM J. Sci. Stat. Comput. 5, 1984; Higham, ACM Trans. Math. Softw. 14, 1988).
    pub(crate) fn factor(&mut self, k: usize, fill: impl FnOnce(&mut [f64])) -> f64 {
        self.size = k;
        self.factors.clear();
        self.factors.resize(k * k, 0.0);
        fill(&mut self.factors);
        let column = |j: usize| (0..k).map(|i| self.factors[i * k + j].abs()).sum::<f64>();
        let norm = (0..k).map(column).fold(0.0, f64::max);
        if !(norm.is_finite() && norm > 0.0) {
            return 0.0;
        }
        self.forward.resize(k, 0);
        self.backward.resize(k, 0);
        factor::lu_in_place(
            MatMut::from_row_major_slice_mut(&mut self.factors, k, k),
            &mut self.forward[..k],
            &mut self.backward[..k],
            Par::Seq,
            stack(&mut self.memory, k, 1),
            Default::default(),
        );
        let inverse = self.inverse_norm();
        if inverse.is_finite() && inverse > 0.0 { 1.0 / (norm * inverse) } else { 0.0 }
    }

    /// A lower estimate of ‖K⁻¹‖₁.
    fn inverse_norm(&mut self) -> f64 {
        let k = self.size;
        let mut x = std::mem::take(&mut self.vector);
        let mut trial = std::mem::take(&mut self.trial);
        x.clear();
        x.resize(k, 1.0 / k as f64);
        let mut best = 0.0_f64;
        for _ in 0..NORM_STEPS {
            trial.clone_from(&x);
            self.solve(&mut trial, 1);
            let norm: f64 = trial.iter().map(|v| v.abs()).sum();
            if norm.is_nan() || norm <= best {
                best = if norm.is_nan() { f64::NAN } else { best };
                break;
            }
            best = norm;
            for v in &mut trial {
                *v = 1.0_f64.copysign(*v);
            }
            self.solve_transposed(&mut trial);
            let along: f64 = trial.iter().zip(&x).map(|(z, x)| z * x).sum();
            let top = (0..k).max_by(|&i, &j| trial[i].abs().total_cmp(&trial[j].abs()));
            let Some(top) = top.filter(|&j| trial[j].abs() > along) else { break };
            x.fill(0.0);
            x[top] = 1.0;
        }
        (self.vector, self.trial) = (x, trial);
        best
    }

    /// Replaces `block`, k × `columns` in rows, by K⁻¹ `block`.
    pub(crate) fn solve(&mut self, block: &mut [f64], columns: usize) {
        let k = self.size;
        let factors = MatRef::from_row_major_slice(&self.factors, k, k);
        solve::solve_in_place(
            factors,
            factors,
            PermRef::new_checked(&self.forward[..k], &self.backward[..k], k),
            MatMut::from_row_major_slice_mut(block, k, columns),
            Par::Seq,
            stack(&mut self.memory, k, columns),
        );
    }

    fn solve_transposed(&mut self, vector: &mut [f64]) {
        let k = self.size;
        let factors = MatRef::from_row_major_slice(&self.factors, k, k);
        solve::solve_transpose_in_place(
            factors,
            factors,
            PermRef::new_checked(&self.forward[..k], &self.backward[..k], k),
            MatMut::from_row_major_slice_mut(vector, k, 1),
            Par::Seq,
            stack(&mut self.memory, k, 1),
        );
    }
}

/// `out` += P Z for P m × k, Z k × n and `out` m × n, all row-major.
pub(crate) fn add_product(p: &[f64], z: &[f64], out: &mut [f64], k: usize, n: usize) {
    let m = out.len() / n.max(1);
    matmul(
        MatMut::from_row_major_slice_mut(out, m, n),
        Accum::Add,
        MatRef::from_row_major_slice(p, m, k),
        MatRef::from_row_major_slice(z, k, n),
        1.0,
        Par::Seq,
    );
}

/// `out` += Pᵀ Z for P k × m, Z k × n and `out` m × n, all row-major.
pub(crate) fn add_transposed_product(p: &[f64], z: &[f64], out: &mut [f64], k: usize, n: usize) {
    let m = out.len() / n.max(1);
    matmul(
        MatMut::from_row_major_slice_mut(out, m, n),
        Accum::Add,
        MatRef::from_column_major_slice(p, m, k),
        MatRef::from_row_major_slice(z, k, n),
        1.0,
        Par::Seq,
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_and_conditions_of_small_systems() {
        let mut factored = Factored::default();
        let rcond = factored.factor(2, |k| k.copy_from_slice(&[0.0, 2.0, 1.0, 1.0]));
        // The inverse is [−0.5 1; 0.5 0].
        assert!((rcond - 1.0 / 3.0).abs() < 1e-15, "{rcond}");
        let mut block = [2.0, 4.0, 6.0, 5.0, 5.0, 5.0];
        factored.solve(&mut block, 3);
        assert_eq!(block, [4.0, 3.0, 2.0, 1.0, 2.0, 3.0]);
        assert_eq!(factored.factor(2, |k| k.copy_from_slice(&[1.0, 2.0, 2.0, 4.0])), 0.0);
        assert_eq!(factored.factor(1, |k| k[0] = f64::NAN), 0.0);
        let n = 12;
        let rcond = factored.factor(n, |k| {
            for (at, v) in k.iter_mut().enumerate() {
                *v = 1.0 / (at / n + at % n + 1) as f64;
            }
        });
        // The Hilbert matrix of order 12 has condition 1.6e16.
        assert!(rcond < 1e-15);
    }
}
