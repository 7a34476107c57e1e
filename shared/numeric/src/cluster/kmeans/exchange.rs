//! Moves of single points (Hartigan and Wong, Algorithm AS 136, Applied Statistics 28, 1979).
//!
//! Removing point x from a cluster of n points with mean φ lowers the inertia by n/(n−1)·‖x−φ‖²;
//! adding it to one raises it by n/(n+1)·‖x−φ‖². After Lloyd's iteration hardly any point gains by
//! moving. So a vector kernel screens for points that might, with a margin for its rounding errors,
//! and the plain formula decides about them one after the other.

use pulp::{Simd, WithSimd};

use super::assign::{Packed, slack};
use super::partition::Partition;
use super::points::Points;
use crate::linalg::simd::dispatch;
use crate::linalg::simd_pack::{BLOCK_REGISTERS, GROUP_POINTS, GroupKernel};
use crate::linalg::vector::squared_distance;

/// Relative gain below which a single point is not moved, as rounding could make it move for ever.
const MIN_GAIN: f64 = 1e-10;

/// Factor of the margin over that of an assignment: a point is compared with centroids up to twice
/// as far away as its own, and both distances count at most twice.
const MARGIN_FACTOR: f64 = 8.0;

impl Partition {
    /// Moves single points to other clusters while that lowers the inertia. Returns the passes, and
    /// true when a pass without moves was reached.
    ///
    /// The gain must exceed the share `hysteresis` of what removing the point saves.
    pub(super) fn exchange(
        &mut self,
        points: &Points<'_>,
        limit: usize,
        hysteresis: f64,
    ) -> (usize, bool) {
        let keep = 1.0 - hysteresis.max(MIN_GAIN);
        let mut screen = Screen::new(points, self, keep);
        for pass in 1..=limit {
            let mut moved = false;
            let mut at = 0;
            while let Some(i) = screen.next(points, &self.labels, at) {
                at = i + 1;
                let Some(to) = self.better_cluster(points.x.row(i), self.labels[i] as usize, keep)
                else {
                    continue;
                };
                let from = self.labels[i] as usize;
                self.transfer(points, i, to);
                screen.set(points, self, from);
                screen.set(points, self, to);
                moved = true;
            }
            if !moved {
                if self.refresh(points) {
                    return (pass, true);
                }
                screen = Screen::new(points, self, keep);
            }
        }
        (limit, false)
    }

    /// The cluster that `row`, which is in `own`, should move to.
    fn better_cluster(&self, row: &[f64], own: usize, keep: f64) -> Option<usize> {
        if self.sizes[own] < 2 {
            return None;
        }
        let mut best = (own, f64::INFINITY);
        for (c, centroid) in self.centroids.iter_rows().enumerate() {
            if c == own {
                continue;
            }
            let cost = cost(self.sizes[c]) * squared_distance(row, centroid);
            if cost < best.1 {
                best = (c, cost);
            }
        }
        let saved = saving(self.sizes[own]) * squared_distance(row, self.centroids.row(own));
        (best.1 < saved * keep).then_some(best.0)
    }
}

/// n/(n+1) for a cluster of n points.
fn cost(size: usize) -> f64 {
    size as f64 / (size as f64 + 1.0)
}

/// n/(n−1) for a cluster of n points; 0 for a single point, which stays.
fn saving(size: usize) -> f64 {
    if size < 2 { 0.0 } else { size as f64 / (size as f64 - 1.0) }
}

/// The clusters as the screening kernel reads them.
struct Screen {
    packed: Packed,
    keep: f64,
    /// n/(n+1) of every cluster.
    costs: Vec<f64>,
    /// n/(n−1) of every cluster, times the share that a gain must not exceed.
    savings: Vec<f64>,
}

impl Screen {
    fn new(points: &Points<'_>, partition: &Partition, keep: f64) -> Self {
        let packed = Packed::new(points, &partition.centroids);
        let clusters = partition.sizes.len();
        let costs = vec![1.0; clusters.next_multiple_of(GROUP_POINTS)];
        let mut screen = Self { packed, keep, costs, savings: vec![0.0; clusters] };
        for c in 0..clusters {
            screen.weigh(partition, c);
        }
        screen
    }

    fn weigh(&mut self, partition: &Partition, c: usize) {
        self.costs[c] = cost(partition.sizes[c]);
        self.savings[c] = saving(partition.sizes[c]) * self.keep;
    }

    /// Updates cluster `c`, which has changed.
    fn set(&mut self, points: &Points<'_>, partition: &Partition, c: usize) {
        self.packed.set(points, c, partition.centroids.row(c));
        self.weigh(partition, c);
    }

    /// The first point from `from` on that might gain by moving.
    fn next(&self, points: &Points<'_>, labels: &[u32], from: usize) -> Option<usize> {
        dispatch(Next { screen: self, points, labels, from })
    }
}

struct Next<'a> {
    screen: &'a Screen,
    points: &'a Points<'a>,
    labels: &'a [u32],
    from: usize,
}

impl WithSimd for Next<'_> {
    type Output = Option<usize>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<usize> {
        let end = self.labels.len().next_multiple_of(GROUP_POINTS);
        let mut at = self.from / GROUP_POINTS * GROUP_POINTS;
        while at + BLOCK_REGISTERS * S::F64_LANES <= end {
            if let Some(found) = self.block::<S, BLOCK_REGISTERS>(simd, at) {
                return Some(found);
            }
            at += BLOCK_REGISTERS * S::F64_LANES;
        }
        while at < end {
            if let Some(found) = self.block::<S, 1>(simd, at) {
                return Some(found);
            }
            at += S::F64_LANES;
        }
        None
    }
}

impl Next<'_> {
    #[inline(always)]
    fn block<S: Simd, const R: usize>(&self, simd: S, place: usize) -> Option<usize> {
        // A narrow register may contain only places after the last point.
        let labels = &self.labels[place.min(self.labels.len())..];
        let count = (R * S::F64_LANES).min(labels.len());
        let labels = &labels[..count];
        let mut own_label = [0_u64; GROUP_POINTS * BLOCK_REGISTERS];
        let mut saving = [0.0; GROUP_POINTS * BLOCK_REGISTERS];
        for ((own, saving), &label) in own_label.iter_mut().zip(&mut saving).zip(labels) {
            *own = u64::from(label);
            *saving = self.screen.savings[label as usize];
        }
        let (own_labels, _) = S::as_simd_u64s(&own_label);
        let (savings, _) = S::as_simd_f64s(&saving);
        let (squares, _) = S::as_simd_f64s(&self.points.pack().squares[place..]);
        let mut gains = Gains {
            screen: self.screen,
            points: self.points,
            place,
            labels: [simd.splat_u64s(0); R],
            squares: [simd.splat_f64s(0.0); R],
            own: [simd.splat_f64s(0.0); R],
            cheapest: [simd.splat_f64s(f64::INFINITY); R],
        };
        gains.labels.copy_from_slice(&own_labels[..R]);
        gains.squares.copy_from_slice(&squares[..R]);
        self.screen.packed.over(simd, &mut gains);

        let slack = simd.splat_f64s(MARGIN_FACTOR * slack(self.points.pack().pack.dims()));
        let smallest = simd.splat_f64s(f64::MIN_POSITIVE);
        let mut suspects = [0_u64; GROUP_POINTS * BLOCK_REGISTERS];
        let (registers, _) = S::as_mut_simd_u64s(&mut suspects);
        for r in 0..R {
            let scale = simd.add_f64s(squares[r], simd.abs_f64s(gains.own[r]));
            let margin = simd.mul_add_e_f64s(slack, scale, smallest);
            let limit = simd.mul_add_e_f64s(savings[r], gains.own[r], margin);
            let suspect = simd.less_than_or_equal_f64s(gains.cheapest[r], limit);
            registers[r] = simd.select_u64s(suspect, simd.splat_u64s(1), simd.splat_u64s(0));
        }
        let mut any = 0;
        for suspect in &suspects[..count] {
            any |= suspect;
        }
        if any == 0 {
            return None;
        }
        let passed = self.from.saturating_sub(place).min(count);
        suspects[passed..count].iter().position(|s| *s == 1).map(|i| place + passed + i)
    }
}

/// Savings and costs of moving R registers of points.
struct Gains<'a, S: Simd, const R: usize> {
    screen: &'a Screen,
    points: &'a Points<'a>,
    place: usize,
    labels: [S::u64s; R],
    squares: [S::f64s; R],
    /// Squared distance to the own centroid.
    own: [S::f64s; R],
    /// Least cost of moving to another cluster.
    cheapest: [S::f64s; R],
}

impl<S: Simd, const R: usize> GroupKernel<S, R> for Gains<'_, S, R> {
    #[allow(clippy::needless_range_loop, reason = "registers of several arrays belong together")]
    #[inline(always)]
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize) {
        let packed = &self.screen.packed;
        let values =
            packed.shortened::<S, R, C, F>(simd, &self.points.pack().pack, self.place, group);
        let costs = &self.screen.costs[group * GROUP_POINTS..(group + 1) * GROUP_POINTS];
        let (two, never) = (simd.splat_f64s(2.0), simd.splat_f64s(f64::INFINITY));
        for c in 0..C {
            let number = simd.splat_u64s((group * GROUP_POINTS + F + c) as u64);
            let cost = simd.splat_f64s(costs[F + c]);
            for r in 0..R {
                let square = simd.mul_add_e_f64s(two, values[c][r], self.squares[r]);
                let own = simd.equal_u64s(self.labels[r], number);
                self.own[r] = simd.select_f64s(own, square, self.own[r]);
                let cost = simd.select_f64s(own, never, simd.mul_f64s(cost, square));
                self.cheapest[r] = simd.min_f64s(self.cheapest[r], cost);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::linalg::matrix::DenseMatrix;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn no_point_that_gains_is_passed_over(
            n in 2_usize..90,
            dims in 1_usize..12,
            clusters in 1_usize..20,
            coarse: bool,
            hysteresis in 0.0_f64..0.5,
            seed: u64,
        ) {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let value = |_, _| if coarse { rng.random_range(0..3) as f64 } else { rng.random() };
            let x = DenseMatrix::from_fn(n, dims, value);
            let points = Points::new(&x, 1);
            let clusters = clusters.min(n);
            let labels = (0..n).map(|i| (i * 7 % clusters) as u32).collect();
            let partition = Partition::from_labels(&points, labels, clusters);
            let keep = 1.0 - hysteresis;
            let screen = Screen::new(&points, &partition, keep);
            let mut at = 0;
            while let Some(found) = screen.next(&points, &partition.labels, at) {
                prop_assert!(found >= at && found < n);
                for i in at..found {
                    let own = partition.labels[i] as usize;
                    prop_assert_eq!(partition.better_cluster(x.row(i), own, keep), None);
                }
                at = found + 1;
            }
            for i in at..n {
                let own = partition.labels[i] as usize;
                prop_assert_eq!(partition.better_cluster(x.row(i), own, keep), None);
            }
        }
    }
}
