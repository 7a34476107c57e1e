//! The Katz similarity of the last frame and its decomposition, kept for as long as they hold.

use muster_machine::Stopwatch;
use muster_model::embedding::EmbeddingMode;
use muster_numeric::katz::{self, katz_probe, katz_similarity};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use muster_numeric::svd::{FullSvd, full_svd};

use crate::compute::ComputeError;

/// What was last computed from a fused graph.
#[derive(Debug)]
pub(crate) struct Cache {
    /// A*.
    pub(crate) fused: SparseMatrix,
    alpha: f64,
    /// Bounds of the spectral radius of the fused graph.
    pub(crate) radius: SpectralRadius,
    /// The Katz similarity S.
    pub(crate) similarity: DenseMatrix,
    /// S = U Σ Vᵀ, whole, so that another K costs nothing.
    pub(crate) svd: FullSvd,
}

/// How a similarity was come by.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Obtained {
    /// The kept one, or a new one.
    pub(crate) mode: EmbeddingMode,
    /// How exact it is, by a random sign vector.
    pub(crate) probe: f64,
    /// Microseconds for the similarity with its probe, and for the decomposition.
    pub(crate) took_us: [u64; 2],
}

/// The spectral radius of a fused graph: the kept one if the graph is still the same.
pub(crate) fn radius_of(cache: Option<&Cache>, fused: &SparseMatrix) -> SpectralRadius {
    match cache {
        Some(kept) if kept.fused == *fused => kept.radius.clone(),
        // Not started from the vector of the last frame, so that α depends on the graph alone.
        _ => spectral_radius(fused, None),
    }
}

/// The similarity of a fused graph and its decomposition: the kept ones if graph and decay are the
/// same bit for bit and the probe stays within the tolerance, new ones otherwise.
pub(crate) fn obtain(
    kept: Option<Cache>,
    fused: SparseMatrix,
    radius: SpectralRadius,
    alpha: f64,
    tolerance: f64,
    seed: u64,
    stopwatch: &mut Stopwatch,
) -> Result<(Cache, Obtained), ComputeError> {
    let same = |kept: &Cache| kept.alpha.to_bits() == alpha.to_bits() && kept.fused == fused;
    if let Some(kept) = kept.filter(same) {
        let probe = katz_probe(&fused, alpha, &kept.similarity, seed)?;
        if probe <= tolerance {
            let took_us = [stopwatch.lap(), 0];
            return Ok((kept, Obtained { mode: EmbeddingMode::Cached, probe, took_us }));
        }
    }
    let similarity = katz_similarity(&fused, alpha, &radius)?;
    let probe = katz_probe(&fused, alpha, &similarity, seed)?;
    let solved_us = stopwatch.lap();
    let svd = full_svd(&similarity)?;
    let took_us = [solved_us, stopwatch.lap()];
    let cache = Cache { fused, alpha, radius, similarity, svd };
    Ok((cache, Obtained { mode: EmbeddingMode::Dense, probe, took_us }))
}

impl From<katz::KatzError> for ComputeError {
    fn from(error: katz::KatzError) -> Self {
        match error {
            katz::KatzError::Diverges { alpha, radius } => {
                Self::Diverges { alpha, limit: radius.recip() }
            }
            other => Self::Katz(other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring() -> SparseMatrix {
        SparseMatrix::from_triplets(4, (0..4).map(|i| (i, (i + 1) % 4, 1.0))).unwrap()
    }

    fn get(kept: Option<Cache>, alpha: f64) -> (Cache, Obtained) {
        let radius = radius_of(kept.as_ref(), &ring());
        obtain(kept, ring(), radius, alpha, 1e-8, 7, &mut Stopwatch::still()).unwrap()
    }

    #[test]
    fn the_same_graph_and_decay_reuse_the_similarity() {
        let (first, how) = get(None, 0.5);
        assert_eq!(how.mode, EmbeddingMode::Dense);
        let (second, how) = get(Some(first), 0.5);
        assert_eq!(how.mode, EmbeddingMode::Cached);
        let (_, how) = get(Some(second), 0.25);
        assert_eq!(how.mode, EmbeddingMode::Dense);
    }

    #[test]
    fn a_spoilt_similarity_is_found_by_the_probe_and_replaced() {
        let (mut kept, _) = get(None, 0.5);
        let whole = kept.similarity.clone();
        let mut data = whole.data().to_vec();
        data[5] += 1e-3;
        kept.similarity = DenseMatrix::new(4, 4, data).unwrap();
        let (mended, how) = get(Some(kept), 0.5);
        assert_eq!(how.mode, EmbeddingMode::Dense);
        assert!(how.probe < 1e-14);
        assert_eq!(mended.similarity, whole);
    }
}
