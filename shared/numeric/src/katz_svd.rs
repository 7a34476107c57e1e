//! Leading singular triplets of the Katz similarity from frame to frame, without the similarity.
//!
//! A [`KatzSvd`] keeps the triplets of the last two frames: while the graph moves smoothly, the next
//! ones lie close to what both span, with an error of second order in the motion.

use crate::matrix::{DenseMatrix, SparseMatrix};
use crate::operator::KatzOperator;
use crate::partial::{Request, Triplets, Workspace, leading_triplets};
use crate::spectral_radius::SpectralRadius;

/// State that is kept between frames.
#[derive(Debug, Default)]
pub struct KatzSvd {
    operator: KatzOperator,
    work: Workspace,
    triplets: Triplets,
    /// W = V + UΣ of the last frames, the newest first, n × width each.
    history: [Vec<f64>; 2],
    width: usize,
    frames: usize,
}

/// What a solve took and how exact it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// Rounds of the search.
    pub rounds: usize,
    /// The largest ‖Mᵀ(Sᵀu − σv)‖/σ₁ of the triplets that were asked for.
    pub residual: f64,
    /// Whether that is within the tolerance.
    pub converged: bool,
}

impl KatzSvd {
    /// The `rank` leading triplets for the graph `a` and α, to a residual of `tolerance`.
    pub fn solve(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        rank: usize,
        tolerance: f64,
    ) -> Quality {
        self.operator.assign(a, alpha, true);
        let request = Request { rank, tolerance, radius: alpha * radius.upper, seed: 1 };
        let n = a.nodes();
        let usable = self.frames.min(2);
        let start: Vec<_> = self.history[..usable]
            .iter()
            .filter(|block| block.len() == n * self.width)
            .map(|block| (block.as_slice(), self.width))
            .collect();
        leading_triplets(&self.operator, request, &start, &mut self.work, &mut self.triplets);
        self.history.swap(0, 1);
        let newest = &mut self.history[0];
        newest.clear();
        newest.extend(self.triplets.right.iter().zip(&self.triplets.image).map(|(v, s)| v + s));
        self.width = self.triplets.width;
        self.frames += 1;
        let residuals = &self.triplets.residuals[..rank.min(self.triplets.width)];
        Quality {
            rounds: self.triplets.rounds,
            residual: residuals.iter().fold(0.0, |top, r| r.max(top)),
            converged: self.triplets.converged,
        }
    }

    /// Forgets the frames before.
    pub fn forget(&mut self) {
        self.frames = 0;
    }

    /// The singular values, descending.
    #[must_use]
    pub fn singular_values(&self) -> &[f64] {
        &self.triplets.sigma
    }

    /// The right vectors in the caller's order, n × rank.
    #[must_use]
    pub fn right(&self, rank: usize) -> DenseMatrix {
        let inner = self.operator.inner();
        let width = self.triplets.width;
        DenseMatrix::from_fn(inner.len(), rank, |i, j| {
            self.triplets.right[inner[i] as usize * width + j]
        })
    }
}
