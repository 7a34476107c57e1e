//! The Katz similarity of all pairs, updated from frame to frame.
//!
//! Solving for S costs 8/3 n³ multiply-adds. When a few robots move, the Woodbury identity gives
//! the new S as the old one and a product of two thin matrices. These cost some rows of S per changed
//! row or column; the product itself, 2n² each, is added once many have gathered. The changes are
//! found by comparing the matrices, not from a list of moved robots, as those change the
//! neighbourhood of others too. Robots that join or leave are rows and columns that appear or
//! disappear.
//!
//! Rounding errors accumulate very slowly (4e-15 after 10,000 updates), but without proof: every
//! update ends with a probe of the whole matrix, and S is solved from scratch when the probe is too
//! large.

mod changes;
mod entries;
mod low_rank_sum;
mod woodbury;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::alpha::check_alpha;
use super::error::KatzError;
use super::similarity::{katz_probe, katz_similarity};
use crate::linalg::matrix::{MatrixError, SparseMatrix};
use crate::radius::exact::SpectralRadius;
use changes::{Changes, Row};
use low_rank_sum::LowRankSum;
use woodbury::Woodbury;

/// Most nodes of a cached similarity. 4096² entries are 128 MiB, and solving takes seconds.
pub const MAX_CACHED_NODES: usize = 4096;

/// Rank of an update relative to n beyond which S is solved from scratch: with at most two per
/// moved robot, a quarter of the fleet. An update of this rank takes less than half as long
/// (measured at n = 200 to 2000), but solving also resets the rounding errors.
pub const MAX_RANK_SHARE: f64 = 0.5;

/// Reciprocal condition of the capacitance matrix below which an update could lose more than half
/// of all digits.
pub const MIN_CONDITION: f64 = 1e-8;

/// Probe above which S is solved from scratch: far above the 1e-15 of a sound update, far below
/// what affects an embedding.
pub const MAX_PROBE: f64 = 1e-10;

/// One free slot is added per this many slots when there are too few.
const FREE_SLOT_SHARE: usize = 16;

/// Method of an update.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Nothing had changed.
    Kept,
    /// Updated by the Woodbury identity.
    Updated,
    /// Solved: there was no similarity, or it belonged to another decay.
    Started,
    /// Solved: the rank was so large that an update would take longer.
    TooMany,
    /// Solved: more than half of the slots were free.
    Compacted,
    /// Solved: the capacitance matrix was too close to singular.
    IllConditioned,
    /// Solved: the probe of the updated matrix was too large.
    Inexact,
}

/// Result of an update.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Update {
    /// The method.
    pub method: Method,
    /// Number of changed rows and columns.
    pub rank: usize,
    /// Estimate of the reciprocal condition of the capacitance matrix; 1 without one.
    pub condition: f64,
    /// The accuracy of S. After a solution, that of [`katz_probe`]; after an update ‖M(S + I)z −
    /// z‖/‖z‖ for a random z of ±1, M = I − αA, which is larger where entries of S are. A new z is drawn
    /// whenever updates are added to the matrix.
    pub probe: f64,
}

/// S = (I − αA)⁻¹ − I for up to [`MAX_CACHED_NODES`] nodes, kept up to date.
///
/// Changes can be collected: [`CachedKatz::defer`] records a graph, at a cost proportional to its
/// edges, and [`CachedKatz::apply`] brings S up to date with the last one, which for ten moved
/// robots costs a third of ten updates. [`CachedKatz::update`] does both.
///
/// Rows and columns of S stay in slots that do not move when other nodes join or leave. In the
/// steady state nothing is allocated here; solving, joins and leaves, and rows or ranks larger than
/// any before allocate, and the library's product may allocate its own blocks.
#[derive(Debug, Default)]
pub struct CachedKatz {
    alpha: f64,
    /// Number of slots.
    slots: usize,
    /// S in slots, or nothing. Rows and columns of free slots are zero.
    s: LowRankSum,
    /// Slot of each node.
    place: Vec<u32>,
    free: Vec<u32>,
    /// Slots of nodes that left since the last update.
    leaving: Vec<u32>,
    is_leaving: Vec<bool>,
    /// Rows of the A that S belongs to, and of the last graph, in slots.
    basis: Vec<Row>,
    latest: Vec<Row>,
    is_dirty: Vec<bool>,
    /// True when S belongs to the last graph.
    is_current: bool,
    /// True when S belongs to `alpha` and can be updated.
    is_valid: bool,
    radius: SpectralRadius,
    rank_share: Option<f64>,
    probes: u64,
    changes: Changes,
    woodbury: Woodbury,
    arrived: Vec<u32>,
}

impl CachedKatz {
    /// Sets the rank of an update, relative to n, beyond which S is solved from scratch: for
    /// callers that have measured both. The default is [`MAX_RANK_SHARE`]; infinity updates at any
    /// rank.
    ///
    /// # Errors
    /// [`KatzError::RankShare`] for a negative share, or one that is not a number.
    pub fn set_rank_share(&mut self, share: f64) -> Result<(), KatzError> {
        if share.is_nan() || share < 0.0 {
            return Err(KatzError::RankShare(share));
        }
        self.rank_share = Some(share);
        Ok(())
    }

    /// Brings S up to date with the graph `a` and the decay `alpha`.
    ///
    /// `radius` bounds the spectral radius of `a`. `map` holds the new index of each node of the
    /// previous graph, `None` for those that left; without it the nodes are the same. If the map
    /// does not fit the graphs, or is missing where the number of nodes has changed, S is solved
    /// from scratch.
    ///
    /// # Errors
    /// [`KatzError::Alpha`] and [`KatzError::Diverges`] for a decay that the bound does not admit,
    /// and [`KatzError::Matrix`] beyond [`MAX_CACHED_NODES`] nodes: the similarity of the previous graph
    /// stays. [`KatzError::Overflow`] when S is out of range: there is no similarity then.
    pub fn update(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        map: Option<&[Option<usize>]>,
    ) -> Result<Update, KatzError> {
        self.defer(a, alpha, radius, map)?;
        self.apply()
    }

    /// Records a graph without touching S; parameters as of [`CachedKatz::update`].
    ///
    /// # Errors
    /// As [`CachedKatz::update`], except for [`KatzError::Overflow`].
    pub fn defer(
        &mut self,
        a: &SparseMatrix,
        alpha: f64,
        radius: &SpectralRadius,
        map: Option<&[Option<usize>]>,
    ) -> Result<(), KatzError> {
        check_alpha(alpha, radius.upper)?;
        let n = a.nodes();
        if n > MAX_CACHED_NODES {
            return Err(MatrixError::TooLarge { rows: n, cols: n }.into());
        }
        self.copy_radius(radius);
        self.is_valid &= alpha.to_bits() == self.alpha.to_bits();
        self.alpha = alpha;
        match map {
            None if n == self.place.len() => {}
            Some(map) if fits(map, self.place.len(), n) => self.rearrange(map, n),
            _ => self.reset_slots(n),
        }
        for i in 0..n {
            let slot = self.place[i] as usize;
            let place = &self.place;
            let row = || a.row(i).map(|(j, w)| (place[j], w));
            let latest = &mut self.latest[slot];
            if !latest.iter().copied().eq(row()) {
                latest.clear();
                latest.extend(row());
                self.is_dirty[slot] = true;
                self.is_current = false;
            }
        }
        self.is_current &= self.is_valid;
        Ok(())
    }

    /// Copies the bounds into the existing vector.
    fn copy_radius(&mut self, radius: &SpectralRadius) {
        let mut vector = std::mem::take(&mut self.radius.vector);
        vector.clone_from(&radius.vector);
        let SpectralRadius { lower, upper, value, acyclic, .. } = *radius;
        self.radius = SpectralRadius { lower, upper, value, acyclic, vector };
    }

    /// Gives every node the slot of its index, without a similarity.
    fn reset_slots(&mut self, n: usize) {
        self.place.clear();
        self.place.extend(0..n as u32);
        self.free.clear();
        self.leaving.clear();
        self.slots = n;
        self.s.clear();
        self.is_valid = false;
        self.is_current = false;
        for rows in [&mut self.basis, &mut self.latest] {
            rows.resize_with(n, Row::new);
            rows.iter_mut().for_each(Row::clear);
        }
        self.is_leaving.clear();
        self.is_leaving.resize(n, false);
        self.is_dirty.clear();
        self.is_dirty.resize(n, true);
    }

    /// Moves the slots of nodes to their new indices, and finds slots for new nodes.
    fn rearrange(&mut self, map: &[Option<usize>], n: usize) {
        const NONE: u32 = u32::MAX;
        let mut arrived = std::mem::take(&mut self.arrived);
        arrived.clear();
        arrived.resize(n, NONE);
        for (slot, to) in self.place.iter().zip(map) {
            match to {
                Some(to) => arrived[*to] = *slot,
                None => {
                    self.leaving.push(*slot);
                    self.is_leaving[*slot as usize] = true;
                    self.is_dirty[*slot as usize] = true;
                    self.latest[*slot as usize].clear();
                    self.is_current = false;
                }
            }
        }
        let missing = arrived.iter().filter(|slot| **slot == NONE).count();
        if missing > self.free.len() {
            self.grow(missing - self.free.len());
        }
        for slot in arrived.iter_mut().filter(|slot| **slot == NONE) {
            *slot = self.free.pop().unwrap_or(NONE);
        }
        std::mem::swap(&mut self.place, &mut arrived);
        self.arrived = arrived;
    }

    /// Adds at least `count` slots.
    fn grow(&mut self, count: usize) {
        let old = self.slots;
        let new = old + count + old / FREE_SLOT_SHARE;
        if self.s.side() == old {
            self.s.grow(new);
        }
        for rows in [&mut self.basis, &mut self.latest] {
            rows.resize_with(new, Row::new);
        }
        self.is_leaving.resize(new, false);
        self.is_dirty.resize(new, false);
        // The lowest slots are used first.
        self.free.splice(0..0, (old as u32..new as u32).rev());
        self.slots = new;
    }

    /// Brings S up to date with the last recorded graph.
    ///
    /// # Errors
    /// [`KatzError::Overflow`] when S had to be solved from scratch and is out of range.
    pub fn apply(&mut self) -> Result<Update, KatzError> {
        if !self.is_valid {
            return self.solve(Method::Started, 0, 1.0);
        }
        if self.is_current {
            let probe = self.probe();
            return match probe {
                probe if probe <= MAX_PROBE => {
                    Ok(Update { method: Method::Kept, rank: 0, condition: 1.0, probe })
                }
                _ => self.solve(Method::Inexact, 0, 1.0),
            };
        }
        let m = self.slots;
        if m > 2 * self.place.len() {
            return self.solve(Method::Compacted, 0, 1.0);
        }
        self.find_changes();
        let rank = self.changes.lines().len();
        let share = self.rank_share.unwrap_or(MAX_RANK_SHARE);
        if rank as f64 > share * self.place.len() as f64 {
            return self.solve(Method::TooMany, rank, 1.0);
        }
        let mut condition = 1.0;
        if rank > 0 {
            condition = self.woodbury.prepare(&self.s, self.alpha, &self.changes);
            if condition < MIN_CONDITION {
                return self.solve(Method::IllConditioned, rank, condition);
            }
            self.woodbury.apply(&mut self.s);
        }
        self.accept_latest();
        let probe = self.probe();
        // Written so that NaN fails the comparison too.
        if !matches!(probe, p if p <= MAX_PROBE) {
            return self.solve(Method::Inexact, rank, condition);
        }
        let method = if rank > 0 { Method::Updated } else { Method::Kept };
        Ok(Update { method, rank, condition, probe })
    }

    /// Compares the rows that may differ. Ignores edges *to* nodes that left: without edges of
    /// their own those lie on no walk between others, and their columns are cleared afterwards.
    fn find_changes(&mut self) {
        self.changes.clear(self.slots);
        for slot in 0..self.slots {
            if self.is_dirty[slot] {
                let leaving = |column: u32| self.is_leaving[column as usize];
                self.changes.compare(slot as u32, &self.basis[slot], &self.latest[slot], leaving);
            }
        }
        self.changes.cover();
    }

    /// Makes the last graph the one that S belongs to, and frees the slots of nodes that left.
    fn accept_latest(&mut self) {
        for slot in 0..self.slots {
            if std::mem::take(&mut self.is_dirty[slot]) {
                self.basis[slot].clone_from(&self.latest[slot]);
            }
        }
        for slot in self.leaving.drain(..) {
            self.s.clear_line(slot as usize);
            self.is_leaving[slot as usize] = false;
            self.free.push(slot);
        }
        self.is_current = true;
    }

    /// Solves for the S of the last graph by elimination, with one slot per node.
    fn solve(&mut self, method: Method, rank: usize, condition: f64) -> Result<Update, KatzError> {
        let n = self.place.len();
        let mut node = vec![usize::MAX; self.slots];
        for (i, slot) in self.place.iter().enumerate() {
            node[*slot as usize] = i;
        }
        let mut entries = Vec::new();
        for (i, slot) in self.place.iter().enumerate() {
            let row = &self.latest[*slot as usize];
            entries.extend(row.iter().map(|&(j, w)| (i, node[j as usize], w)));
        }
        let a = SparseMatrix::from_checked(n, entries);
        self.reset_slots(n);
        for i in 0..n {
            self.latest[i].extend(a.row(i).map(|(j, w)| (j as u32, w)));
        }
        // Free the old matrix before the new one is built.
        self.s.clear();
        let s = katz_similarity(&a, self.alpha, &self.radius)?;
        let probe = katz_probe(&a, self.alpha, &s, self.probes)?;
        self.probes = self.probes.wrapping_add(1);
        self.s.replace(n, s.into_data());
        self.is_valid = true;
        self.accept_latest();
        Ok(Update { method, rank, condition, probe })
    }

    /// ‖M(S + I)z − z‖/‖z‖ for a random z of ±1, the same ones in every run.
    fn probe(&mut self) -> f64 {
        let probes = &mut self.probes;
        let (signs, image) = self.s.image(|signs| {
            let mut rng = ChaCha8Rng::seed_from_u64(*probes);
            *probes = probes.wrapping_add(1);
            for some in signs.chunks_mut(64) {
                let bits = rng.next_u64();
                for (b, sign) in some.iter_mut().enumerate() {
                    *sign = if bits >> b & 1 == 0 { 1.0 } else { -1.0 };
                }
            }
        });
        let mut squares = 0.0;
        for &slot in &self.place {
            let slot = slot as usize;
            let row = self.basis[slot].iter();
            let walked: f64 = row.map(|&(j, w)| w * (image[j as usize] + signs[j as usize])).sum();
            squares += (image[slot] - self.alpha * walked).powi(2);
        }
        if self.place.is_empty() { 0.0 } else { (squares / self.place.len() as f64).sqrt() }
    }

    /// Number of nodes of the last graph.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.place.len()
    }

    /// The decay α.
    #[must_use]
    pub fn alpha(&self) -> f64 {
        self.alpha
    }
}

/// True when `map` maps `old` nodes to distinct ones of `new` nodes.
fn fits(map: &[Option<usize>], old: usize, new: usize) -> bool {
    let mut mapped = vec![false; new];
    let mut is_new = |to: usize| mapped.get_mut(to).is_some_and(|s| !std::mem::replace(s, true));
    map.len() == old && map.iter().flatten().all(|to| is_new(*to))
}
