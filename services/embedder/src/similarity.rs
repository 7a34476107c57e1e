//! The Katz similarity of all pairs, kept from job to job: for small fleets, which are decomposed whole,
//! and for questions after single pairs.

use std::sync::Arc;

use muster_model::id::RobotId;
use muster_numeric::cached_katz::{CachedKatz, Update};
use muster_numeric::katz::KatzError;
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};

use crate::correspondence::Correspondence;
use crate::decay::Chosen;

/// S, and the robots that it belongs to.
#[derive(Debug, Default)]
pub(crate) struct Similarity {
    katz: CachedKatz,
    robots: Arc<[RobotId]>,
}

impl Similarity {
    /// Brings S up to date with A* and its decay: by the rows and columns that have changed where they are
    /// few, and anew otherwise.
    pub(crate) fn update(
        &mut self,
        fused: &SparseMatrix,
        chosen: &Chosen,
        robots: &Arc<[RobotId]>,
    ) -> Result<Update, KatzError> {
        let between = Correspondence::between(&self.robots, robots);
        let map = between.as_ref().map(Correspondence::to_new);
        self.katz.defer(fused, chosen.alpha, &chosen.radius, map)?;
        self.robots = Arc::clone(robots);
        self.katz.apply()
    }

    /// S, in the order of the robots; empty before the first update.
    pub(crate) fn matrix(&self) -> Option<DenseMatrix> {
        self.katz.similarity()
    }

    /// S_ij and the share of each graph in it.
    pub(crate) fn pair(
        &self,
        [from, to]: [usize; 2],
        parts: &[(&SparseMatrix, f64)],
    ) -> Option<(f64, Vec<f64>)> {
        Some((self.katz.pair(from, to)?, self.katz.shares(from, to, parts)?))
    }
}
