//! The triplets of the last frame as callers see them.

use super::solver::KatzSvd;
use crate::linalg::block_vectors::{BlockView, product};
use crate::linalg::matrix::DenseMatrix;
use crate::svd::davidson::{NULL_VALUE_RATIO, Triplets};
use crate::svd::error::SvdError;
use crate::svd::rank_k::RankKSvd;
use crate::svd::signs::fix_signs;
use crate::svd::spectrum::Spectrum;

impl KatzSvd {
    /// V and S V in the order of the operator, n × width.
    fn vectors(&self) -> (&[f64], &[f64]) {
        let Triplets { width, right, image, .. } = &self.triplets;
        if !self.certificate.valid {
            return (right, image);
        }
        let [right, image] = self.rotated.get_or_init(|| {
            let rotation = BlockView::new(&self.certificate.rotation, *width, *width);
            [right, image].map(|block| {
                let mut rotated = vec![0.0; block.len()];
                product(BlockView::new(block, *width, *width), rotation, &mut rotated, *width, 0);
                rotated
            })
        });
        (right, image)
    }

    /// Singular values, descending: those that were asked for, and a few more that are less exact.
    #[must_use]
    pub fn all_singular_values(&self) -> &[f64] {
        &self.triplets.sigma
    }

    /// The `k` leading triplets in the order of the caller's nodes, with the signs of
    /// [`crate::svd::full_svd`]. Vectors of values below 1e-7 σ₁ are set to zero, as they cannot be
    /// distinguished from the null space. So are the rows of nodes without an edge, where the search
    /// leaves errors up to the tolerance.
    ///
    /// # Errors
    /// [`SvdError::Rank`] unless 1 ≤ k ≤ the number of [`KatzSvd::all_singular_values`].
    pub fn truncate(&self, k: usize) -> Result<RankKSvd, SvdError> {
        let Triplets { width, sigma, residuals, .. } = &self.triplets;
        let nodes = sigma.len();
        if k == 0 || k > nodes {
            return Err(SvdError::Rank { rank: k, nodes });
        }
        let cut = NULL_VALUE_RATIO * sigma[0];
        let inner = self.operator.inner();
        let (right, image) = self.vectors();
        // Values descend.
        let kept = sigma[..k].iter().take_while(|sigma| **sigma > cut).count();
        let row = |block: &'_ [f64], i: usize, to: &mut [f64]| {
            let inner = inner[i] as usize;
            if !self.operator.is_isolated(inner) {
                to[..kept].copy_from_slice(&block[inner * width..][..kept]);
            }
        };
        let mut svd = RankKSvd {
            u: DenseMatrix::from_row_fn(self.nodes, k, |i, to| {
                row(image, i, to);
                to.iter_mut().zip(&sigma[..kept]).for_each(|(value, sigma)| *value /= sigma);
            }),
            sigma: sigma[..k].to_vec(),
            v: DenseMatrix::from_row_fn(self.nodes, k, |i, to| row(right, i, to)),
            // Of values beyond those that were found, no gap is claimed.
            sigma_next: (k < self.nodes).then(|| sigma[k.min(nodes - 1)]),
            next_residual: residuals.get(k).copied().unwrap_or(0.0) * sigma[0],
        };
        fix_signs(&mut svd.u, &mut svd.v);
        Ok(svd)
    }
}

impl Spectrum for KatzSvd {
    fn nodes(&self) -> usize {
        self.nodes
    }

    /// The values that were asked for.
    fn singular_values(&self) -> &[f64] {
        &self.triplets.sigma[..self.rank.min(self.triplets.sigma.len())]
    }

    fn noise(&self) -> f64 {
        NULL_VALUE_RATIO * self.triplets.sigma.first().copied().unwrap_or(0.0)
    }

    fn squared_share(&self, i: usize, j: usize) -> f64 {
        let Triplets { width, sigma, .. } = &self.triplets;
        let (right, image) = self.vectors();
        let at = self.operator.inner()[i] as usize * width + j;
        if sigma[j] <= self.noise() {
            return 0.0;
        }
        image[at].powi(2) / sigma[j] + right[at].powi(2) * sigma[j]
    }
}
