//! Entries of the kept similarity, and the share of each graph in them.

use super::CachedKatz;
use crate::fuse::WeightedGraph;
use crate::linalg::matrix::DenseMatrix;

impl CachedKatz {
    /// S_ij, the damped weight of all walks from node `i` to node `j`. `None` for unknown nodes,
    /// and while changes are pending.
    ///
    /// Updates leave zeros of S at the size of a rounding, on either side; as S ≥ 0, negative
    /// values are returned as 0. The kept matrix does not change, as that would bias every later
    /// update.
    #[must_use]
    pub fn pair(&self, i: usize, j: usize) -> Option<f64> {
        self.entry(i, j).map(|value| value.max(0.0))
    }

    /// A copy of S, n × n, in the order of the nodes. `None` while changes are pending.
    #[must_use]
    pub fn similarity(&mut self) -> Option<DenseMatrix> {
        if !self.is_current {
            return None;
        }
        self.s.add_updates();
        let (n, s, place) = (self.place.len(), &self.s, &self.place);
        let entry = |i: usize, j: usize| s.base_row(place[i] as usize)[place[j] as usize];
        Some(DenseMatrix::from_fn(n, n, |i, j| entry(i, j).max(0.0)))
    }

    fn entry(&self, i: usize, j: usize) -> Option<f64> {
        let (i, j) = (*self.place.get(i)? as usize, *self.place.get(j)? as usize);
        self.is_current.then(|| self.s.entry(i, j))
    }

    /// Share of each graph in S_ij, where A = Σ w_m A_m.
    ///
    /// S = αA(I + S): every walk is a first step, followed by nothing or another walk. The share of
    /// graph m is the weight of the walks whose *first* step uses it, α w_m Σ_k (A_m)_ik (I +
    /// S)_kj. The shares are not negative, and their sum is S_ij up to rounding. The weights of
    /// `graphs` include all scaling. `None` as [`CachedKatz::pair`].
    #[must_use]
    pub fn shares<'a>(
        &self,
        i: usize,
        j: usize,
        graphs: &[impl Into<WeightedGraph<'a>> + Copy],
    ) -> Option<Vec<f64>> {
        self.entry(i, j)?;
        let share = |graph: &_| {
            let WeightedGraph { graph, weight } = Into::into(*graph);
            let terms = graph.row(i).map(|(k, w)| {
                let stay = f64::from(u8::from(k == j));
                Some(w * (stay + self.pair(k, j)?))
            });
            Some(self.alpha * weight * terms.sum::<Option<f64>>()?)
        };
        graphs.iter().map(share).collect()
    }
}
