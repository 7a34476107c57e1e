//! Silhouettes from Euclidean distances between points and clusters.
//!
//! ‖x − y‖² = ‖x‖² + ‖y‖² − 2x·y takes one multiplication per coordinate instead of two operations,
//! but loses digits where points are much closer to each other than to the centre. There the
//! differences themselves are squared, so that every distance is right to rounding; see
//! [`NEAR_SHARE`].

use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::groups::{Groups, Ordered, same_place, summary, value};
use super::types::{Method, Silhouette, SilhouetteError};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::dispatch;
use crate::linalg::simd_pack::{
    GROUP_POINTS, GroupKernel, SimdPack, centre, over_halves, products, squared_distances,
};

/// Points of one cluster that are compared with all points of another before the next ones: they
/// and their sums stay in the first-level cache.
const TILE_POINTS: usize = 32 * GROUP_POINTS;

/// Share of ‖x‖² below which ‖x − y‖² is computed from the differences.
///
/// With D coordinates and the unit roundoff u, the shorter formula is wrong by at most
/// (D + 4)u(‖x‖ + ‖y‖)² (Higham, Accuracy and Stability of Numerical Algorithms, section 3.1), and
/// ‖y‖ ≤ ‖x‖ + ‖x − y‖: the relative error of a distance is below 150(D + 4)u, and hardly ever above
/// u for points that do not lie close together.
const NEAR_SHARE: f64 = 1.0 / 64.0;

/// Coordinates up to which differences are always squared: that is hardly slower there, and among
/// points of few coordinates many are close together.
const MAX_DIRECT_DIMS: usize = 6;

/// Silhouette (b − a) / max(a, b) of every row of `x`, where a is the mean distance to the other
/// members of its cluster and b the smallest mean distance to the members of another cluster.
///
/// `x` is N × D, `labels` contains N arbitrary numbers. The only member of a cluster has the value
/// 0, as has a point with a = b = 0, but for rounding. O(N² D) time, every distance once; O(N D + k) memory.
///
/// # Errors
/// [`SilhouetteError::Labels`], and [`SilhouetteError::Undefined`] for fewer than two clusters.
pub fn silhouette(x: &DenseMatrix, labels: &[usize]) -> Result<Silhouette, SilhouetteError> {
    let groups = Groups::new(x, labels)?;
    let per_point = all_pairs(x, &groups);
    Ok(summary(per_point, &groups, Method::Exact))
}

/// Silhouettes of all points. Every distance is computed once and counts for both points.
pub(super) fn all_pairs(x: &DenseMatrix, groups: &Groups) -> Vec<f64> {
    let centre = centre(x);
    let ordered = Ordered::new(x, &centre, groups);
    let (starts, sizes) = (&ordered.starts, &groups.sizes);
    let mut scores = Scores::new(ordered.pack.places(), same_place(&ordered.squares));
    let mut rows = vec![0.0; sizes.iter().max().map_or(0, |n| n.next_multiple_of(GROUP_POINTS))];
    let mut columns = vec![0.0; TILE_POINTS * GROUP_POINTS];
    for a in 0..sizes.len() {
        let places = starts[a]..starts[a + 1];
        for b in a..sizes.len() {
            let rows = &mut rows[..places.len()];
            rows.fill(0.0);
            for first in (starts[b]..starts[b + 1]).step_by(TILE_POINTS) {
                let tile = first..(first + TILE_POINTS).min(starts[b + 1]);
                let columns = &mut columns[..tile.len() * GROUP_POINTS];
                columns.fill(0.0);
                dispatch(Sweep {
                    points: &ordered.pack,
                    squares: &ordered.squares,
                    weights: &ordered.used,
                    places: places.clone(),
                    others: &ordered,
                    tile: tile.clone(),
                    end: starts[b] + sizes[b],
                    same: a == b,
                    rows,
                    columns,
                });
                for (place, lanes) in tile.zip(columns.chunks_exact(GROUP_POINTS)) {
                    scores.add(place, lanes.iter().sum(), sizes[a], a == b);
                }
            }
            for (place, sum) in places.clone().zip(rows.iter()) {
                scores.add(place, *sum, sizes[b], a == b);
            }
        }
    }
    let values = groups.member.iter().zip(&ordered.place);
    values.map(|(&c, &place)| scores.value(place as usize, sizes[c as usize])).collect()
}

/// Silhouettes of the points `chosen`, from their distances to all points.
pub(super) fn some_points(x: &DenseMatrix, groups: &Groups, chosen: &[usize]) -> Vec<f64> {
    let centre = centre(x);
    let ordered = Ordered::new(x, &centre, groups);
    let mut pack = SimdPack::zeros(chosen.len(), x.cols());
    for (place, &point) in chosen.iter().enumerate() {
        pack.set(place, x.row(point).iter().zip(&centre).map(|(v, c)| v - c));
    }
    let squares = pack.squares();
    let places = 0..pack.places();
    let weights = vec![0.0; pack.places()];
    let mut scores = Scores::new(chosen.len(), same_place(&ordered.squares));
    let mut rows = vec![0.0; places.len()];
    let mut columns = vec![0.0; TILE_POINTS * GROUP_POINTS];
    for (c, &size) in groups.sizes.iter().enumerate() {
        rows.fill(0.0);
        for first in (ordered.starts[c]..ordered.starts[c + 1]).step_by(TILE_POINTS) {
            let tile = first..(first + TILE_POINTS).min(ordered.starts[c + 1]);
            let columns = &mut columns[..tile.len() * GROUP_POINTS];
            dispatch(Sweep {
                points: &pack,
                squares: &squares,
                weights: &weights,
                places: places.clone(),
                others: &ordered,
                tile,
                end: ordered.starts[c] + size,
                same: false,
                rows: &mut rows,
                columns,
            });
        }
        for (place, (&point, sum)) in chosen.iter().zip(&rows).enumerate() {
            scores.add(place, *sum, size, groups.member[point] as usize == c);
        }
    }
    let size = |point: usize| groups.sizes[groups.member[point] as usize];
    chosen.iter().enumerate().map(|(place, &point)| scores.value(place, size(point))).collect()
}

/// For each place the sum of distances to its own cluster, and the least mean distance to another
/// one.
struct Scores {
    own: Vec<f64>,
    next: Vec<f64>,
    /// The distance up to which points are in the same place.
    none: f64,
}

impl Scores {
    fn new(places: usize, none: f64) -> Self {
        Self { own: vec![0.0; places], next: vec![f64::INFINITY; places], none }
    }

    /// Adds the sum of distances of the point at `place` to a cluster of `size` points; in parts if
    /// it is its own one.
    fn add(&mut self, place: usize, sum: f64, size: usize, own: bool) {
        if own {
            self.own[place] += sum;
        } else {
            self.next[place] = self.next[place].min(sum / size as f64);
        }
    }

    /// Silhouette of the point at `place`, in a cluster of `size` points.
    fn value(&self, place: usize, size: usize) -> f64 {
        let own = self.own[place] / (size.max(2) - 1) as f64;
        value(size, own, self.next[place], self.none)
    }
}

/// Distances between the points at `places` and those of a tile of one cluster, summed for both.
struct Sweep<'a> {
    points: &'a SimdPack,
    /// ‖x‖² of the points.
    squares: &'a [f64],
    /// Weight of a distance for the points of the tile, one per place of `points`.
    weights: &'a [f64],
    places: Range<usize>,
    others: &'a Ordered,
    tile: Range<usize>,
    /// End of the places of the tile's cluster that contain a point.
    end: usize,
    /// True when `points` and the tile are of the same cluster, so that half of all pairs suffice.
    same: bool,
    /// Sums over the tile, one per place.
    rows: &'a mut [f64],
    /// Sums over the places, [`GROUP_POINTS`] parts per point of the tile.
    columns: &'a mut [f64],
}

impl WithSimd for Sweep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.sweep::<S, 3, 1>(simd),
            4 => self.sweep::<S, 2, 2>(simd),
            2 => self.sweep::<S, 4, 4>(simd),
            _ => self.sweep::<S, 8, 8>(simd),
        }
    }
}

impl Sweep<'_> {
    /// Processes all places, `WIDE` registers at a time and the last ones by `NARROW`; both fill
    /// whole groups, so that a block either overlaps a group of the tile or does not.
    #[inline(always)]
    fn sweep<S: Simd, const WIDE: usize, const NARROW: usize>(mut self, simd: S) {
        let mut at = self.places.start;
        while at + WIDE * S::F64_LANES <= self.places.end {
            self.block::<S, WIDE>(simd, at);
            at += WIDE * S::F64_LANES;
        }
        while at < self.places.end {
            self.block::<S, NARROW>(simd, at);
            at += NARROW * S::F64_LANES;
        }
    }

    #[inline(always)]
    fn block<S: Simd, const R: usize>(&mut self, simd: S, place: usize) {
        let end = place + R * S::F64_LANES;
        let (weights, _) = S::as_simd_f64s(&self.weights[place..end]);
        let (squares, _) = S::as_simd_f64s(&self.squares[place..end]);
        let (columns, _) = S::as_mut_simd_f64s(self.columns);
        let mut distances = Distances {
            points: self.points,
            others: self.others,
            place,
            first: self.tile.start,
            short: self.points.dims() > MAX_DIRECT_DIMS,
            squares: [simd.splat_f64s(0.0); R],
            weights: [simd.splat_f64s(0.0); R],
            rows: [simd.splat_f64s(0.0); R],
            columns,
        };
        distances.squares.copy_from_slice(&squares[..R]);
        let mut group = self.tile.start / GROUP_POINTS;
        if self.same {
            // Pairs with earlier points of the cluster are counted already.
            group = group.max(place / GROUP_POINTS);
            while group < (end / GROUP_POINTS).min(self.tile.end / GROUP_POINTS) {
                over_halves(simd, &mut distances, group, self.end - group * GROUP_POINTS);
                group += 1;
            }
        }
        distances.weights.copy_from_slice(&weights[..R]);
        for group in group..self.tile.end / GROUP_POINTS {
            over_halves(simd, &mut distances, group, self.end - group * GROUP_POINTS);
        }
        let found = distances.rows;
        let start = place - self.places.start;
        let (rows, _) = S::as_mut_simd_f64s(&mut self.rows[start..start + R * S::F64_LANES]);
        for r in 0..R {
            rows[r] = simd.add_f64s(rows[r], found[r]);
        }
    }
}

/// Sums of the distances of R registers of points.
struct Distances<'a, S: Simd, const R: usize> {
    points: &'a SimdPack,
    others: &'a Ordered,
    place: usize,
    /// First place of the tile.
    first: usize,
    /// True when the shorter formula is tried.
    short: bool,
    /// ‖x‖² of the points.
    squares: [S::f64s; R],
    /// Weight of a distance for the other point.
    weights: [S::f64s; R],
    rows: [S::f64s; R],
    /// One register of parts per point of the tile, [`GROUP_POINTS`] lanes or as many registers.
    columns: &'a mut [S::f64s],
}

impl<S: Simd, const R: usize> Distances<'_, S, R> {
    /// ‖x − y‖² of the points x and the members y of a group.
    #[allow(clippy::needless_range_loop, reason = "registers of several arrays belong together")]
    #[inline(always)]
    fn squared<const C: usize, const F: usize>(&self, simd: S, group: usize) -> [[S::f64s; R]; C] {
        let (points, place, pack) = (self.points, self.place, &self.others.pack);
        if self.short {
            let starts = &self.others.minus_halves;
            let mut found = products::<S, R, C, F, 0>(simd, points, place, pack, group, starts);
            let (two, near) = (simd.splat_f64s(2.0), simd.splat_f64s(NEAR_SHARE));
            let mut nearest = simd.splat_f64s(0.0);
            for r in 0..R {
                let limit = simd.mul_f64s(near, self.squares[r]);
                for c in 0..C {
                    found[c][r] = simd.negate_mul_add_e_f64s(two, found[c][r], self.squares[r]);
                    nearest = simd.min_f64s(nearest, simd.sub_f64s(found[c][r], limit));
                }
            }
            let some = simd.less_than_f64s(nearest, simd.splat_f64s(0.0));
            if simd.first_true_m64s(some) >= S::F64_LANES {
                return found;
            }
        }
        squared_distances::<S, R, C, F>(simd, points, place, pack, group)
    }
}

impl<S: Simd, const R: usize> GroupKernel<S, R> for Distances<'_, S, R> {
    #[allow(clippy::needless_range_loop, reason = "registers of several arrays belong together")]
    #[inline(always)]
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize) {
        let squares = self.squared::<C, F>(simd, group);
        let used = &self.others.used[group * GROUP_POINTS..(group + 1) * GROUP_POINTS];
        let per = GROUP_POINTS / S::F64_LANES;
        let start = (group * GROUP_POINTS - self.first) * per;
        let columns = &mut self.columns[start..start + GROUP_POINTS * per];
        for c in 0..C {
            let counts = simd.splat_f64s(used[F + c]);
            let mut column = columns[(F + c) * per];
            for r in 0..R {
                let distance = simd.sqrt_f64s(squares[c][r]);
                self.rows[r] = simd.mul_add_e_f64s(distance, counts, self.rows[r]);
                column = simd.mul_add_e_f64s(distance, self.weights[r], column);
            }
            columns[(F + c) * per] = column;
        }
    }
}
