//! The Katz similarity of all pairs: kept from frame to frame for small fleets, solved for otherwise.

use std::sync::Arc;

use muster_model::id::RobotId;
use muster_numeric::cached_katz::{CachedKatz, Method, Update};
use muster_numeric::katz::{KatzError, katz_probe, katz_similarity};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};

use crate::correspondence::Correspondence;
use crate::decay::Decay;
use crate::params::EmbeddingParams;

/// S, and the robots that it belongs to.
#[derive(Debug, Default)]
pub(crate) struct Similarity {
    katz: CachedKatz,
    robots: Arc<[RobotId]>,
}

/// S of a frame.
pub(crate) struct Solved {
    pub(crate) matrix: DenseMatrix,
    pub(crate) origin: Origin,
    /// Largest |M S z − α A z| for random signs z, relative to what rounding is relative to.
    pub(crate) probe: f64,
}

/// Where S comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Origin {
    /// It is that of the frame before, bit for bit.
    Kept,
    /// That of the frame before was updated by the rows that have changed.
    Updated,
    /// It was solved for.
    Solved,
}

impl Similarity {
    /// S of A* and its decay.
    pub(crate) fn solve(
        &mut self,
        fused: &SparseMatrix,
        decay: &Decay,
        robots: &Arc<[RobotId]>,
        params: &EmbeddingParams,
    ) -> Result<Solved, KatzError> {
        if fused.nodes() > params.cached_robots {
            let matrix = katz_similarity(fused, decay.alpha, &decay.radius)?;
            let probe = katz_probe(fused, decay.alpha, &matrix, params.seed)?;
            return Ok(Solved { matrix, origin: Origin::Solved, probe });
        }
        let update = self.update(fused, decay, robots)?;
        let overflow = KatzError::Overflow { alpha: decay.alpha };
        let origin = match update.method {
            Method::Kept => Origin::Kept,
            Method::Updated => Origin::Updated,
            _ => Origin::Solved,
        };
        let matrix = self.katz.similarity().ok_or(overflow)?;
        Ok(Solved { matrix, origin, probe: update.probe })
    }

    /// Brings the kept S up to date with A* and its decay: by the rows and columns that have changed where
    /// they are few, by a full solve otherwise.
    pub(crate) fn update(
        &mut self,
        fused: &SparseMatrix,
        decay: &Decay,
        robots: &Arc<[RobotId]>,
    ) -> Result<Update, KatzError> {
        let between = Correspondence::between(&self.robots, robots);
        let map = between.as_ref().map(Correspondence::to_new);
        self.katz.defer(fused, decay.alpha, &decay.radius, map)?;
        self.robots = Arc::clone(robots);
        self.katz.apply()
    }

    /// S_ij of the kept S, and the share of each graph in it.
    pub(crate) fn pair(
        &self,
        [from, to]: [usize; 2],
        parts: &[(&SparseMatrix, f64)],
    ) -> Option<(f64, Vec<f64>)> {
        Some((self.katz.pair(from, to)?, self.katz.shares(from, to, parts)?))
    }
}
