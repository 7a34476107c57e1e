//! Assignment of points to their nearest centroids in single precision, where that decides.
//!
//! Half of the bytes and twice the numbers per register. Its rounding errors are bounded as those in
//! [`super::assign`]; points whose two nearest centroids are closer to each other than the bound are left
//! to double precision.
//!
//! Measured against double precision alone: 20 iterations of 10,000 points 1.3 times as fast, of 100,000
//! 1.3 with 8 clusters and 1.6 with 50; up to 1,000 points it makes no difference.

use pulp::{Simd, WithSimd};

use super::assign::{Assignment, SLACK_FACTOR, UNDECIDED};
use super::points::CHUNK_POINTS;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::{dispatch, prefetch};
use crate::linalg::simd_pack::{
    BLOCK_REGISTERS, GROUP_POINTS, GroupKernel, PREFETCH_BLOCKS, over_group,
};

/// Points of a group: the lanes of the widest registers there are.
const GROUP_SINGLES: usize = 16;

/// Range of the largest coordinate, and most coordinate of a centroid, for squares to stay far from the
/// ends of the range of numbers.
const LARGEST: std::ops::RangeInclusive<f64> = 1e-12..=1e12;
const LARGEST_CENTROID: f64 = 1e15;

/// Least margin: that of squares which underflow.
const LEAST_MARGIN: f32 = 1e-30;

/// Undecided points of a block from which double precision labels the whole of it.
const MANY_UNDECIDED: usize = 6;

const _: () = assert!(CHUNK_POINTS.is_multiple_of(GROUP_SINGLES * BLOCK_REGISTERS));

/// Centred points in groups of [`GROUP_SINGLES`], interleaved as in [`crate::linalg::simd_pack`].
pub(super) struct SinglePoints {
    dims: usize,
    data: Vec<f32>,
    /// Squared length of each point.
    squares: Vec<f32>,
}

impl SinglePoints {
    /// Packs the rows of `x` minus `centre`. `None` where single precision has not the range for them.
    pub(super) fn new(x: &DenseMatrix, centre: &[f64]) -> Option<Self> {
        let dims = x.cols();
        let groups = x.rows().div_ceil(GROUP_SINGLES);
        let mut data = Vec::with_capacity(groups * dims * GROUP_SINGLES);
        let mut squares = Vec::with_capacity(groups * GROUP_SINGLES);
        let mut largest = [0.0_f64; GROUP_SINGLES];
        for g in 0..groups {
            // Places after the last point hold the centre, which becomes zero.
            let rows: [&[f64]; GROUP_SINGLES] = core::array::from_fn(|lane| {
                let i = g * GROUP_SINGLES + lane;
                if i < x.rows() { x.row(i) } else { centre }
            });
            let mut sums = [0.0_f64; GROUP_SINGLES];
            for (d, middle) in centre.iter().enumerate() {
                let values = rows.map(|row| row[d] - middle);
                for ((sum, largest), value) in sums.iter_mut().zip(&mut largest).zip(values) {
                    *sum += value * value;
                    // NaN stays.
                    *largest = if value.abs() <= *largest { *largest } else { value.abs() };
                }
                data.extend_from_slice(&values.map(|value| value as f32));
            }
            squares.extend_from_slice(&sums.map(|sum| sum as f32));
        }
        // No comparison holds for NaN.
        let fits = largest.iter().all(|size| size <= LARGEST.end())
            && largest.iter().any(|size| size >= LARGEST.start());
        (dims > 0 && fits).then_some(Self { dims, data, squares })
    }
}

/// Centroids as the kernel reads them.
pub(super) struct SingleCentroids {
    clusters: usize,
    /// −c, centred as the points are, in groups of [`GROUP_POINTS`].
    negative: Vec<f32>,
    /// ½‖c‖²; infinite for places without a centroid.
    halves: Vec<f32>,
}

impl SingleCentroids {
    /// Packs the rows of `centroids`. `None` where one is far outside of the points.
    pub(super) fn new(centroids: &DenseMatrix, centre: &[f64]) -> Option<Self> {
        let (clusters, dims) = (centroids.rows(), centre.len());
        let places = clusters.next_multiple_of(GROUP_POINTS);
        let mut negative = vec![0.0; places * dims];
        let mut halves = vec![f32::INFINITY; places];
        for (c, (row, half)) in centroids.iter_rows().zip(&mut halves).enumerate() {
            let start = c / GROUP_POINTS * dims * GROUP_POINTS + c % GROUP_POINTS;
            let mut square = 0.0;
            for (d, (value, middle)) in row.iter().zip(centre).enumerate() {
                let value = middle - value;
                if !matches!(value.abs(), size if size <= LARGEST_CENTROID) {
                    return None;
                }
                square += value * value;
                negative[start + d * GROUP_POINTS] = value as f32;
            }
            *half = (0.5 * square) as f32;
        }
        Some(Self { clusters, negative, halves })
    }
}

/// Labels the points of a chunk.
pub(super) fn assign(
    assignment: &mut Assignment<'_>,
    single: &SinglePoints,
    centroids: &SingleCentroids,
) {
    dispatch(Assign { assignment, single, centroids });
}

struct Assign<'a, 'b> {
    assignment: &'a mut Assignment<'b>,
    single: &'a SinglePoints,
    centroids: &'a SingleCentroids,
}

impl WithSimd for Assign<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let first = self.assignment.first;
        let end = first + self.assignment.labels.len().next_multiple_of(GROUP_SINGLES);
        let mut at = first;
        while at + BLOCK_REGISTERS * S::F32_LANES <= end {
            self.block::<S, BLOCK_REGISTERS>(simd, at);
            at += BLOCK_REGISTERS * S::F32_LANES;
        }
        while at < end {
            self.block::<S, 1>(simd, at);
            at += S::F32_LANES;
        }
    }
}

impl Assign<'_, '_> {
    /// Labels R registers of points from `place` on.
    #[inline(always)]
    fn block<S: Simd, const R: usize>(&mut self, simd: S, place: usize) {
        let mut nearest = Nearest {
            single: self.single,
            centroids: self.centroids,
            place,
            best: [simd.splat_f32s(f32::INFINITY); R],
            second: [simd.splat_f32s(f32::INFINITY); R],
            index: [simd.splat_u32s(0); R],
        };
        let clusters = self.centroids.clusters;
        for group in 0..clusters.div_ceil(GROUP_POINTS) {
            over_group(simd, &mut nearest, group, clusters - group * GROUP_POINTS);
        }
        let mut found = [0; GROUP_SINGLES * BLOCK_REGISTERS];
        let (registers, _) = S::as_mut_simd_u32s(&mut found);
        let (squares, _) = S::as_simd_f32s(&self.single.squares[place..]);
        let slack = SLACK_FACTOR as f32 * (self.single.dims + 8) as f32 * f32::EPSILON;
        let (slack, least) = (simd.splat_f32s(slack), simd.splat_f32s(LEAST_MARGIN));
        for r in 0..R {
            let scale = simd.add_f32s(squares[r], simd.abs_f32s(nearest.best[r]));
            let margin = simd.mul_add_e_f32s(slack, scale, least);
            let limit = simd.add_f32s(nearest.best[r], margin);
            let close = simd.less_than_or_equal_f32s(nearest.second[r], limit);
            registers[r] = simd.select_u32s(close, simd.splat_u32s(UNDECIDED), nearest.index[r]);
        }
        let assignment = &mut *self.assignment;
        // A narrow register may contain only places after the last point.
        let start = (place - assignment.first).min(assignment.labels.len());
        let count = (R * S::F32_LANES).min(assignment.labels.len() - start);
        let (mut differ, mut undecided) = (false, 0);
        for (label, found) in assignment.labels[start..start + count].iter().zip(&found) {
            differ |= label != found;
            undecided += usize::from(*found == UNDECIDED);
        }
        if undecided > MANY_UNDECIDED {
            assignment.label_exactly(place..place + R * S::F32_LANES);
        } else if differ {
            assignment.write_labels(start, &found[..count]);
        }
    }
}

/// The least shortened distance of R registers of points, its centroid, and the second least.
struct Nearest<'a, S: Simd, const R: usize> {
    single: &'a SinglePoints,
    centroids: &'a SingleCentroids,
    place: usize,
    best: [S::f32s; R],
    second: [S::f32s; R],
    index: [S::u32s; R],
}

impl<S: Simd, const R: usize> GroupKernel<S, R> for Nearest<'_, S, R> {
    #[allow(clippy::needless_range_loop, reason = "registers of several arrays belong together")]
    #[inline(always)]
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize) {
        let dims = self.single.dims;
        let per = GROUP_SINGLES / S::F32_LANES;
        let points: [(&[S::f32s], usize); R] = core::array::from_fn(|r| {
            let at = self.place + r * S::F32_LANES;
            let start = at / GROUP_SINGLES * dims * GROUP_SINGLES;
            let own = &self.single.data[start..start + dims * GROUP_SINGLES];
            (S::as_simd_f32s(own).0, at % GROUP_SINGLES / S::F32_LANES)
        });
        let halves = &self.centroids.halves[group * GROUP_POINTS..(group + 1) * GROUP_POINTS];
        let mut sums = [[simd.splat_f32s(0.0); R]; C];
        for c in 0..C {
            sums[c] = [simd.splat_f32s(halves[F + c]); R];
        }
        // In doubles, of which a cache line has half as many.
        let ahead = PREFETCH_BLOCKS * R * S::F32_LANES * dims / 2;
        let length = dims * GROUP_POINTS;
        let others = &self.centroids.negative[group * length..(group + 1) * length];
        for (d, row) in others.as_chunks::<GROUP_POINTS>().0.iter().enumerate() {
            let mut x = [simd.splat_f32s(0.0); R];
            for r in 0..R {
                let register = &points[r].0[d * per + points[r].1];
                prefetch(register, ahead);
                x[r] = *register;
            }
            for c in 0..C {
                let g = simd.splat_f32s(row[F + c]);
                for r in 0..R {
                    sums[c][r] = simd.mul_add_e_f32s(g, x[r], sums[c][r]);
                }
            }
        }
        for c in 0..C {
            let number = simd.splat_u32s((group * GROUP_POINTS + F + c) as u32);
            for r in 0..R {
                let value = sums[c][r];
                let less = simd.less_than_f32s(value, self.best[r]);
                let other = simd.max_f32s(value, self.best[r]);
                self.index[r] = simd.select_u32s(less, number, self.index[r]);
                self.second[r] = simd.min_f32s(self.second[r], other);
                self.best[r] = simd.min_f32s(self.best[r], value);
            }
        }
    }
}
