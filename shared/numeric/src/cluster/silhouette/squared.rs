//! Silhouettes of squared distances.

use pulp::{Simd, WithSimd};

use super::groups::{Groups, same_place, summary, value};
use super::types::{Method, Silhouette, SilhouetteError};
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::simd::dispatch;
use crate::linalg::simd_pack::{
    BLOCK_REGISTERS, GROUP_POINTS, GroupKernel, SimdPack, over_group, squared_distances,
};

/// As [`silhouette`](super::silhouette), with squared Euclidean distances throughout, in O(N k D).
///
/// The mean of ‖x − y‖² over the members y of a cluster with mean m is ‖x − m‖² plus the mean of ‖y
/// − m‖²: a sum of non-negative terms, without cancellation. The points are centred first, so that
/// m is rounded no coarser than the spread of the points. This is not the "simplified" silhouette,
/// which omits the second term.
///
/// # Errors
/// As [`silhouette`](super::silhouette).
pub fn silhouette_squared(
    x: &DenseMatrix,
    labels: &[usize],
) -> Result<Silhouette, SilhouetteError> {
    let groups = Groups::new(x, labels)?;
    let (pack, centre) = SimdPack::centred(x);
    let (means, spreads) = moments(x, &centre, &groups);
    let mut own = vec![0.0; pack.places()];
    let mut next = vec![f64::INFINITY; pack.places()];
    dispatch(Means {
        pack: &pack,
        means: &means,
        spreads: &spreads,
        clusters: groups.sizes.len(),
        member: &groups.member,
        own: &mut own,
        next: &mut next,
    });
    let none = same_place(&pack.squares()).powi(2);
    let values = groups.member.iter().zip(own.iter().zip(&next)).map(|(&c, (own, next))| {
        let size = groups.sizes[c as usize];
        // The mean includes the distance of the point to itself, which is zero.
        value(size, own * (size as f64 / (size.max(2) - 1) as f64), *next, none)
    });
    Ok(summary(values.collect(), &groups, Method::SquaredExact))
}

/// Mean m of each cluster, centred, and the mean of ‖y − m‖² over its members; infinite for places
/// without a cluster.
fn moments(x: &DenseMatrix, centre: &[f64], groups: &Groups) -> (SimdPack, Vec<f64>) {
    let (clusters, dims) = (groups.sizes.len(), x.cols());
    let mut sums = vec![0.0; clusters * dims];
    for (row, &c) in x.iter_rows().zip(&groups.member) {
        let sum = &mut sums[c as usize * dims..(c as usize + 1) * dims];
        for ((sum, value), middle) in sum.iter_mut().zip(row).zip(centre) {
            *sum += value - middle;
        }
    }
    let mut means = SimdPack::zeros(clusters, dims);
    for (c, &size) in groups.sizes.iter().enumerate() {
        let mean = &mut sums[c * dims..(c + 1) * dims];
        for sum in mean.iter_mut() {
            *sum /= size as f64;
        }
        means.set(c, mean.iter().copied());
    }
    let mut squares = vec![0.0; clusters * dims];
    for (row, &c) in x.iter_rows().zip(&groups.member) {
        let range = c as usize * dims..(c as usize + 1) * dims;
        let places = squares[range.clone()].iter_mut().zip(&sums[range]);
        for ((square, mean), (value, middle)) in places.zip(row.iter().zip(centre)) {
            let gap = value - middle - mean;
            *square += gap * gap;
        }
    }
    let mut spreads = vec![f64::INFINITY; means.places()];
    for (c, &size) in groups.sizes.iter().enumerate() {
        spreads[c] = squares[c * dims..(c + 1) * dims].iter().sum::<f64>() / size as f64;
    }
    (means, spreads)
}

/// For each point the mean squared distance to its own cluster, itself included, and the least one
/// to another.
struct Means<'a> {
    pack: &'a SimdPack,
    means: &'a SimdPack,
    spreads: &'a [f64],
    clusters: usize,
    member: &'a [u32],
    own: &'a mut [f64],
    next: &'a mut [f64],
}

impl WithSimd for Means<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let mut at = 0;
        while at + BLOCK_REGISTERS * S::F64_LANES <= self.own.len() {
            self.block::<S, BLOCK_REGISTERS>(simd, at);
            at += BLOCK_REGISTERS * S::F64_LANES;
        }
        while at < self.own.len() {
            self.block::<S, 1>(simd, at);
            at += S::F64_LANES;
        }
    }
}

impl Means<'_> {
    #[inline(always)]
    fn block<S: Simd, const R: usize>(&mut self, simd: S, place: usize) {
        let mut member = [0_u64; GROUP_POINTS * BLOCK_REGISTERS];
        for (to, &c) in member.iter_mut().zip(self.member.iter().skip(place)) {
            *to = u64::from(c);
        }
        let (members, _) = S::as_simd_u64s(&member);
        let mut distances = Distances {
            work: self,
            place,
            members: [simd.splat_u64s(0); R],
            own: [simd.splat_f64s(0.0); R],
            next: [simd.splat_f64s(f64::INFINITY); R],
        };
        distances.members.copy_from_slice(&members[..R]);
        for group in 0..self.means.groups() {
            over_group(simd, &mut distances, group, self.clusters - group * GROUP_POINTS);
        }
        let (own, next) = (distances.own, distances.next);
        let (to, _) = S::as_mut_simd_f64s(&mut self.own[place..]);
        to[..R].copy_from_slice(&own);
        let (to, _) = S::as_mut_simd_f64s(&mut self.next[place..]);
        to[..R].copy_from_slice(&next);
    }
}

/// As [`Means`], for R registers of points.
struct Distances<'a, S: Simd, const R: usize> {
    work: &'a Means<'a>,
    place: usize,
    members: [S::u64s; R],
    own: [S::f64s; R],
    next: [S::f64s; R],
}

impl<S: Simd, const R: usize> GroupKernel<S, R> for Distances<'_, S, R> {
    #[allow(clippy::needless_range_loop, reason = "registers of several arrays belong together")]
    #[inline(always)]
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize) {
        let work = self.work;
        let found = squared_distances::<S, R, C, F>(simd, work.pack, self.place, work.means, group);
        let never = simd.splat_f64s(f64::INFINITY);
        for c in 0..C {
            let spread = simd.splat_f64s(work.spreads[group * GROUP_POINTS + F + c]);
            let number = simd.splat_u64s((group * GROUP_POINTS + F + c) as u64);
            for r in 0..R {
                let mean = simd.add_f64s(found[c][r], spread);
                let own = simd.equal_u64s(self.members[r], number);
                self.own[r] = simd.select_f64s(own, mean, self.own[r]);
                self.next[r] = simd.min_f64s(self.next[r], simd.select_f64s(own, never, mean));
            }
        }
    }
}
