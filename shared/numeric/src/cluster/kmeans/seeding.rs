//! First centroids of a start.

use pulp::{Simd, WithSimd};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::points::{CHUNK_POINTS, Points, longest_square};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::dispatch;
use crate::linalg::simd_pack::{
    BLOCK_REGISTERS, GROUP_POINTS, GroupKernel, SimdPack, over_group, squared_distances,
};
use crate::linalg::vector::squared_distance;

/// Points closer to each other than this fraction of the longest row count as equal: nodes that are
/// interchangeable in the graph have equal rows up to rounding, which must not divide them.
pub const DISTINCT_ROW_RATIO: f64 = 1e-9;

/// Number of distinct rows of `x`, N × D, counted up to `limit`: those are equal that are closer than [`DISTINCT_ROW_RATIO`] of the
/// longest one.
#[must_use]
pub fn count_distinct(x: &DenseMatrix, limit: usize) -> usize {
    let tolerance = DISTINCT_ROW_RATIO * DISTINCT_ROW_RATIO * longest_square(x);
    let mut found: Vec<&[f64]> = Vec::new();
    for row in x.iter_rows() {
        if found.len() == limit {
            break;
        }
        if found.iter().all(|f| squared_distance(f, row) > tolerance) {
            found.push(row);
        }
    }
    found.len()
}

/// `clusters` different points drawn uniformly (a partial Fisher–Yates shuffle).
pub(super) fn random(x: &DenseMatrix, clusters: usize, rng: &mut ChaCha8Rng) -> DenseMatrix {
    let mut indices: Vec<usize> = (0..x.rows()).collect();
    for i in 0..clusters {
        let j = rng.random_range(i..x.rows());
        indices.swap(i, j);
    }
    x.select_rows(&indices[..clusters])
}

/// Greedy k-means++: every further centroid is a point drawn with probability proportional to
/// its squared distance from the nearest one so far, the best of 2 + ln k draws.
pub(super) fn plus_plus(points: &Points<'_>, clusters: usize, rng: &mut ChaCha8Rng) -> DenseMatrix {
    let trials = 2 + (clusters as f64).ln() as usize;
    let mut chosen = vec![rng.random_range(0..points.len())];
    let mut nearest = NearestChosen::new(points);
    nearest.add(points, chosen[0]);
    let mut drawn = Vec::with_capacity(trials);
    while chosen.len() < clusters {
        drawn.clear();
        drawn.extend((0..trials).map(|_| nearest.draw(rng)));
        let potentials = nearest.potentials(points, &drawn);
        let better =
            |best: usize, i: usize| if potentials[i] < potentials[best] { i } else { best };
        let best = drawn[(0..trials).fold(0, better)];
        chosen.push(best);
        nearest.add(points, best);
    }
    points.x.select_rows(&chosen)
}

/// Squared distance of every point from the nearest of some points.
struct NearestChosen {
    points: usize,
    /// One per place of the packed points; zero where there is no point.
    squares: Vec<f64>,
    /// Sum of `squares` over each chunk.
    sums: Vec<f64>,
}

impl NearestChosen {
    /// Distances from no point: infinite.
    fn new(points: &Points<'_>) -> Self {
        let mut squares = vec![f64::INFINITY; points.pack().pack.places()];
        squares[points.len()..].fill(0.0);
        Self { points: points.len(), squares, sums: Vec::new() }
    }

    /// Adds one more chosen point.
    fn add(&mut self, points: &Points<'_>, point: usize) {
        let others = packed(points, &[point]);
        self.sums = points.for_chunks(&mut self.squares, CHUNK_POINTS, |number, squares| {
            dispatch(Lower { points, others: &others, first: number * CHUNK_POINTS, squares })
        });
    }

    /// For each of the given points the sum of squared distances if it were added.
    fn potentials(&self, points: &Points<'_>, others: &[usize]) -> Vec<f64> {
        let mut totals = Vec::with_capacity(others.len());
        for others in others.chunks(GROUP_POINTS) {
            let count = others.len();
            let others = packed(points, others);
            let parts = points.over_chunks(&self.squares, CHUNK_POINTS, |number, squares| {
                let first = number * CHUNK_POINTS;
                dispatch(Potentials { points, others: &others, count, first, squares })
            });
            let total = |c: usize| parts.iter().map(|part| part[c]).sum::<f64>();
            totals.extend((0..count).map(total));
        }
        totals
    }

    /// Point drawn with probability proportional to its squared distance; uniform when all are
    /// zero.
    fn draw(&self, rng: &mut ChaCha8Rng) -> usize {
        let total: f64 = self.sums.iter().sum();
        if total <= 0.0 {
            return rng.random_range(0..self.points);
        }
        let mut left = rng.random::<f64>() * total;
        // The last chunk and point of positive weight absorb the rounding.
        let mut chunk = 0;
        for (number, &sum) in self.sums.iter().enumerate().filter(|s| *s.1 > 0.0) {
            chunk = number;
            if left < sum {
                break;
            }
            left -= sum;
        }
        let start = chunk * CHUNK_POINTS;
        let end = (start + CHUNK_POINTS).min(self.points);
        let mut last = start;
        for (i, &weight) in self.squares[start..end].iter().enumerate() {
            if weight > 0.0 {
                last = start + i;
                left -= weight;
                if left < 0.0 {
                    break;
                }
            }
        }
        last
    }
}

/// Some of the points as one group.
fn packed(points: &Points<'_>, chosen: &[usize]) -> SimdPack {
    let mut pack = SimdPack::zeros(GROUP_POINTS, points.x.cols());
    for (place, &point) in chosen.iter().enumerate() {
        pack.copy_point(place, &points.pack().pack, point);
    }
    pack
}

struct Lower<'a> {
    points: &'a Points<'a>,
    others: &'a SimdPack,
    first: usize,
    squares: &'a mut [f64],
}

impl WithSimd for Lower<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let mut total = simd.splat_f64s(0.0);
        let (squares, _) = S::as_mut_simd_f64s(self.squares);
        let pack = &self.points.pack().pack;
        let mut blocks = squares.chunks_exact_mut(BLOCK_REGISTERS);
        let mut place = self.first;
        for block in &mut blocks {
            let [found, _] =
                squared_distances::<S, BLOCK_REGISTERS, 2, 0>(simd, pack, place, self.others, 0);
            for r in 0..BLOCK_REGISTERS {
                block[r] = simd.min_f64s(block[r], found[r]);
                total = simd.add_f64s(total, block[r]);
            }
            place += BLOCK_REGISTERS * S::F64_LANES;
        }
        for square in blocks.into_remainder() {
            let [[found], _] = squared_distances::<S, 1, 2, 0>(simd, pack, place, self.others, 0);
            *square = simd.min_f64s(*square, found);
            total = simd.add_f64s(total, *square);
            place += S::F64_LANES;
        }
        simd.reduce_sum_f64s(total)
    }
}

struct Potentials<'a> {
    points: &'a Points<'a>,
    others: &'a SimdPack,
    count: usize,
    first: usize,
    squares: &'a [f64],
}

impl WithSimd for Potentials<'_> {
    type Output = [f64; GROUP_POINTS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; GROUP_POINTS] {
        let mut sums = [simd.splat_f64s(0.0); GROUP_POINTS];
        let (squares, _) = S::as_simd_f64s(self.squares);
        let (blocks, rest) = squares.as_chunks::<BLOCK_REGISTERS>();
        let mut place = self.first;
        for squares in blocks {
            let mut sum = Sum { work: &self, place, squares: *squares, sums: &mut sums };
            over_group(simd, &mut sum, 0, self.count);
            place += BLOCK_REGISTERS * S::F64_LANES;
        }
        for square in rest {
            let mut sum = Sum { work: &self, place, squares: [*square], sums: &mut sums };
            over_group(simd, &mut sum, 0, self.count);
            place += S::F64_LANES;
        }
        let mut totals = [0.0; GROUP_POINTS];
        for (total, sum) in totals.iter_mut().zip(sums) {
            *total = simd.reduce_sum_f64s(sum);
        }
        totals
    }
}

/// Sums over R registers of points of the lower of two squared distances.
struct Sum<'a, S: Simd, const R: usize> {
    work: &'a Potentials<'a>,
    place: usize,
    squares: [S::f64s; R],
    sums: &'a mut [S::f64s; GROUP_POINTS],
}

impl<S: Simd, const R: usize> GroupKernel<S, R> for Sum<'_, S, R> {
    #[allow(clippy::needless_range_loop, reason = "registers of several arrays belong together")]
    #[inline(always)]
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize) {
        let pack = &self.work.points.pack().pack;
        let others = self.work.others;
        let found = squared_distances::<S, R, C, F>(simd, pack, self.place, others, group);
        for c in 0..C {
            for r in 0..R {
                let square = simd.min_f64s(found[c][r], self.squares[r]);
                self.sums[F + c] = simd.add_f64s(self.sums[F + c], square);
            }
        }
    }
}
