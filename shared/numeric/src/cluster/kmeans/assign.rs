//! Assignment of points to their nearest centroids.
//!
//! Of ‖x − c‖² only ½‖c‖² − x·c depends on the centroid, which takes one multiplication per
//! coordinate instead of two operations. The cancellation error of this shortened distance is
//! bounded (see [`slack`]). Where two centroids are closer to each other than the bound, the full
//! distances decide: the labels are those of [`nearest`] in every case.

use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::points::{CHUNK_POINTS, CentredPack, Points};
use super::single::{self, SingleCentroids};
use super::sums::Move;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::dispatch;
use crate::linalg::simd_pack::{
    BLOCK_REGISTERS, GROUP_POINTS, GroupKernel, PREFETCH_BLOCKS, SimdPack, over_group, products,
};
use crate::linalg::vector::squared_distance;

/// Label of a point whose two nearest centroids the shortened distance does not distinguish.
pub(super) const UNDECIDED: u32 = u32::MAX;

/// Factor of [`slack`].
pub(super) const SLACK_FACTOR: f64 = 32.0;

/// Centroids as the kernels read them.
pub(super) struct Packed {
    clusters: usize,
    /// −c, centred as the points are.
    negative: SimdPack,
    /// ½‖c‖²; infinite for places without a centroid.
    halves: Vec<f64>,
}

impl Packed {
    /// Packs the rows of `centroids`.
    pub(super) fn new(points: &Points<'_>, centroids: &DenseMatrix) -> Self {
        let clusters = centroids.rows();
        let negative = SimdPack::zeros(clusters, centroids.cols());
        let halves = vec![f64::INFINITY; negative.places()];
        let mut packed = Self { clusters, negative, halves };
        for (c, row) in centroids.iter_rows().enumerate() {
            packed.set(points, c, row);
        }
        packed
    }

    /// Replaces centroid `c`.
    pub(super) fn set(&mut self, points: &Points<'_>, c: usize, row: &[f64]) {
        let centred = row.iter().zip(&points.centre).map(|(v, m)| m - v);
        self.halves[c] = 0.5 * centred.clone().map(|v| v * v).sum::<f64>();
        self.negative.set(c, centred);
    }

    /// Runs `block` over all centroids.
    #[inline(always)]
    pub(super) fn over<S: Simd, const R: usize>(
        &self,
        simd: S,
        block: &mut impl GroupKernel<S, R>,
    ) {
        for group in 0..self.negative.groups() {
            over_group(simd, block, group, self.clusters - group * GROUP_POINTS);
        }
    }

    /// ½‖c‖² − x·c for R registers of points from `place` on.
    #[inline(always)]
    pub(super) fn shortened<S: Simd, const R: usize, const C: usize, const F: usize>(
        &self,
        simd: S,
        pack: &SimdPack,
        place: usize,
        group: usize,
    ) -> [[S::f64s; R]; C] {
        let others = &self.negative;
        products::<S, R, C, F, PREFETCH_BLOCKS>(simd, pack, place, others, group, &self.halves)
    }
}

/// Share of X² and of the least shortened distance s, within which two shortened distances of a
/// point x with ‖x‖ = X do not say which centroid [`nearest`] finds.
///
/// With D coordinates and the unit roundoff u, a shortened distance is wrong by at most
/// (D + 4)u(½C² + XC) where C = ‖c‖ (Higham, Accuracy and Stability of Numerical Algorithms,
/// section 3.1; centring adds a relative error of u to every coordinate), and ½‖x − c‖² as
/// [`nearest`] computes it by at most (D + 3)u·½(X + C)². For two centroids that is below
/// 2(D + 8)u(X + C)² in sum, C being the longer one. If C ≤ 4X, this is at most 50(D + 8)u·X²;
/// otherwise s ≥ C²/4 up to rounding, and it is at most 28(D + 8)u·s, whichever of the two
/// centroids is the longer one.
pub(super) fn slack(dims: usize) -> f64 {
    SLACK_FACTOR * (dims + 8) as f64 * f64::EPSILON
}

/// Changed labels of some points.
pub(super) struct Changes {
    /// Number of points with another label than before.
    pub(super) count: usize,
    /// The moves of these points; incomplete when they are so many that a pass over all points is
    /// cheaper.
    pub(super) list: Vec<Move>,
}

/// Centroids of an assignment of all points.
pub(super) struct Centroids<'a> {
    rows: &'a DenseMatrix,
    packed: Packed,
    single: Option<SingleCentroids>,
}

impl<'a> Centroids<'a> {
    pub(super) fn new(points: &Points<'_>, rows: &'a DenseMatrix) -> Self {
        let single = points.single.is_some().then(|| SingleCentroids::new(rows, &points.centre));
        Self { rows, packed: Packed::new(points, rows), single: single.flatten() }
    }
}

/// Labels the points of chunk `chunk` by their nearest centroids. A point equally near to its own
/// and another centroid stays; among others, the first wins.
pub(super) fn assign_chunk(
    points: &Points<'_>,
    centroids: &Centroids<'_>,
    chunk: usize,
    labels: &mut [u32],
) -> Changes {
    let changes = Changes { count: 0, list: Vec::new() };
    let first = chunk * CHUNK_POINTS;
    let mut assignment = Assignment { points, centroids, first, labels, changes };
    match points.single.as_ref().zip(centroids.single.as_ref()) {
        Some((single, own)) => single::assign(&mut assignment, single, own),
        None => assignment.label_exactly(first..first + CHUNK_POINTS),
    }
    assignment.changes
}

/// Labels of the points of a chunk, and what has changed.
pub(super) struct Assignment<'a> {
    points: &'a Points<'a>,
    centroids: &'a Centroids<'a>,
    /// The first point.
    pub(super) first: usize,
    pub(super) labels: &'a mut [u32],
    changes: Changes,
}

impl Assignment<'_> {
    /// Labels the points at `places`, whole groups, in double precision.
    pub(super) fn label_exactly(&mut self, places: Range<usize>) {
        let end = self.first + self.labels.len().next_multiple_of(GROUP_POINTS);
        let places = places.start..places.end.min(end);
        dispatch(Assign { pack: self.points.pack(), assignment: self, places });
    }

    /// Writes the labels of some points, from the `start`-th of the chunk on.
    #[inline(never)]
    pub(super) fn write_labels(&mut self, start: usize, found: &[u32]) {
        let many = self.labels.len() / 2;
        for (i, &found) in found.iter().enumerate() {
            let point = self.first + start + i;
            let own = self.labels[start + i];
            let next = if found == UNDECIDED {
                nearest(self.points.x.row(point), self.centroids.rows, own as usize) as u32
            } else {
                found
            };
            if next != own {
                self.labels[start + i] = next;
                self.changes.count += 1;
                if self.changes.count <= many {
                    self.changes.list.push(Move { point: point as u32, from: own, to: next });
                }
            }
        }
    }
}

struct Assign<'a, 'b> {
    assignment: &'a mut Assignment<'b>,
    pack: &'b CentredPack,
    places: Range<usize>,
}

impl WithSimd for Assign<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let Range { start: mut at, end } = self.places;
        while at + BLOCK_REGISTERS * S::F64_LANES <= end {
            self.block::<S, BLOCK_REGISTERS>(simd, at);
            at += BLOCK_REGISTERS * S::F64_LANES;
        }
        while at < end {
            self.block::<S, 1>(simd, at);
            at += S::F64_LANES;
        }
    }
}

impl Assign<'_, '_> {
    /// Labels R registers of points from `place` on.
    #[inline(always)]
    fn block<S: Simd, const R: usize>(&mut self, simd: S, place: usize) {
        let assignment = &mut *self.assignment;
        // A register may contain only places after the last point.
        let start = (place - assignment.first).min(assignment.labels.len());
        let count = (R * S::F64_LANES).min(assignment.labels.len() - start);
        if count == 0 {
            return;
        }
        let packed = &assignment.centroids.packed;
        let mut nearest = Nearest {
            pack: &self.pack.pack,
            packed,
            place,
            best: [simd.splat_f64s(f64::INFINITY); R],
            second: [simd.splat_f64s(f64::INFINITY); R],
            index: [simd.splat_u64s(0); R],
        };
        packed.over(simd, &mut nearest);
        let mut found = [0; GROUP_POINTS * BLOCK_REGISTERS];
        let (registers, _) = S::as_mut_simd_u64s(&mut found);
        let (squares, _) = S::as_simd_f64s(&self.pack.squares[place..]);
        let slack = simd.splat_f64s(slack(self.pack.pack.dims()));
        let smallest = simd.splat_f64s(f64::MIN_POSITIVE);
        for r in 0..R {
            let scale = simd.add_f64s(squares[r], simd.abs_f64s(nearest.best[r]));
            let margin = simd.mul_add_e_f64s(slack, scale, smallest);
            let limit = simd.add_f64s(nearest.best[r], margin);
            let close = simd.less_than_or_equal_f64s(nearest.second[r], limit);
            let undecided = simd.splat_u64s(u64::from(UNDECIDED));
            registers[r] = simd.select_u64s(close, undecided, nearest.index[r]);
        }
        let mut differ = false;
        for (label, found) in assignment.labels[start..start + count].iter().zip(&found) {
            differ |= u64::from(*label) != *found;
        }
        if differ {
            assignment.write_labels(start, &found.map(|found| found as u32)[..count]);
        }
    }
}

/// The least shortened distance of R registers of points, its centroid, and the second least.
struct Nearest<'a, S: Simd, const R: usize> {
    pack: &'a SimdPack,
    packed: &'a Packed,
    place: usize,
    best: [S::f64s; R],
    second: [S::f64s; R],
    index: [S::u64s; R],
}

impl<S: Simd, const R: usize> GroupKernel<S, R> for Nearest<'_, S, R> {
    #[allow(clippy::needless_range_loop, reason = "registers of several arrays belong together")]
    #[inline(always)]
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize) {
        let values = self.packed.shortened::<S, R, C, F>(simd, self.pack, self.place, group);
        for c in 0..C {
            let number = simd.splat_u64s((group * GROUP_POINTS + F + c) as u64);
            for r in 0..R {
                let value = values[c][r];
                let less = simd.less_than_f64s(value, self.best[r]);
                let other = simd.max_f64s(value, self.best[r]);
                self.index[r] = simd.select_u64s(less, number, self.index[r]);
                self.second[r] = simd.min_f64s(self.second[r], other);
                self.best[r] = simd.min_f64s(self.best[r], value);
            }
        }
    }
}

/// Index of the centroid nearest to `row`; `current` wins ties, then the smallest index.
pub(super) fn nearest(row: &[f64], centroids: &DenseMatrix, current: usize) -> usize {
    let mut best = (current, squared_distance(row, centroids.row(current)));
    for (c, centroid) in centroids.iter_rows().enumerate() {
        let far = squared_distance(row, centroid);
        if far < best.1 {
            best = (c, far);
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Points and centroids of one of several kinds, each hard to distinguish in its own way.
    fn draw(n: usize, dims: usize, clusters: usize, kind: u8, seed: u64) -> [DenseMatrix; 2] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut value = |row: usize| match kind {
            // A coarse grid: most points are equally near to several centroids.
            0 => rng.random_range(0..3) as f64,
            // Far from the origin, so that differences are relatively tiny.
            1 => 1e8 + rng.random::<f64>(),
            // One row in five is larger by far.
            2 => rng.random::<f64>() * if row.is_multiple_of(5) { 1e100 } else { 1.0 },
            // Entries whose squares underflow.
            3 => 1e-170 * rng.random::<f64>(),
            // Differences in the last digits only.
            4 => 1.0 + f64::EPSILON * rng.random_range(0..4) as f64,
            // Differences that single precision rounds away, in some rows.
            5 => {
                let far = rng.random_range(0..3) as f64;
                far + if row.is_multiple_of(3) { 1e-8 * rng.random::<f64>() } else { 0.0 }
            }
            _ => rng.random::<f64>(),
        };
        [n, clusters].map(|rows| DenseMatrix::from_fn(rows, dims, |i, _| value(i)))
    }

    #[test]
    fn single_precision_decides_ordinary_points() {
        // How many points of a grid are undecided at once depends on the width of registers.
        for (kind, needed) in [(6, false), (2, true), (3, true), (4, true), (5, true)] {
            let [x, centroids] = draw(500, 8, 5, kind, 1);
            let points = Points::new(&x, 1);
            let packed = Centroids::new(&points, &centroids);
            let mut labels = vec![0; 500];
            assign_chunk(&points, &packed, 0, &mut labels);
            assert_eq!(points.is_packed(), needed, "{kind}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn labels_are_those_of_the_plain_distances(
            n in 1_usize..90,
            dims in 0_usize..20,
            clusters in 1_usize..28,
            kind in 0_u8..7,
            seed: u64,
        ) {
            let [x, centroids] = draw(n, dims, clusters, kind, seed);
            let points = Points::new(&x, 1);
            let before: Vec<u32> = (0..n).map(|i| (i * 7 % clusters) as u32).collect();
            let mut labels = before.clone();
            let packed = Centroids::new(&points, &centroids);
            let changes = assign_chunk(&points, &packed, 0, &mut labels);
            for i in 0..n {
                let wanted = nearest(x.row(i), &centroids, before[i] as usize);
                prop_assert_eq!(labels[i] as usize, wanted);
            }
            let changed = (0..n).filter(|&i| labels[i] != before[i]).count();
            prop_assert_eq!(changes.count, changed);
        }
    }
}
