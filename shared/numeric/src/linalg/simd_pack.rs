//! Points packed for vector registers, and the two products that run over them.
//!
//! A group interleaves eight points, coordinate by coordinate, so that one register holds the same
//! coordinate of several points. Reductions over one point, such as its least distance, then need
//! no operation across the lanes of a register. A kernel keeps the sums of R registers of points
//! with C other points in registers throughout: it reads R + C values for R·C multiplications,
//! which makes it bound by arithmetic rather than by memory.

use pulp::{Simd, WithSimd};

use super::matrix::DenseMatrix;
use super::simd::{dispatch, prefetch};

/// Points of a group: the lanes of the widest registers there are.
pub(crate) const GROUP_POINTS: usize = 8;

/// Registers of points in one block of a kernel. Three times eight sums and their operands fill the
/// 32 registers of the widest instruction sets.
pub(crate) const BLOCK_REGISTERS: usize = 3;

/// Registers of the machine from which a kernel processes a whole group at once; with fewer it
/// processes half a group, so that all sums stay in registers.
const MANY_REGISTERS: usize = 32;

/// Rows whose mean is the centre of the points. Centring only keeps numbers small, so a sample of
/// the rows serves as well as all of them.
const CENTRE_ROWS: usize = 1024;

/// Points in groups of [`GROUP_POINTS`]. Places without a point are zero.
#[derive(Debug, Clone)]
pub(crate) struct SimdPack {
    groups: usize,
    dims: usize,
    data: Vec<f64>,
}

impl SimdPack {
    /// Zeros for `points` points of `cols` coordinates. Points without coordinates get a single
    /// zero, so that no kernel has to handle empty rows.
    pub(crate) fn zeros(points: usize, cols: usize) -> Self {
        let (groups, dims) = (points.div_ceil(GROUP_POINTS), cols.max(1));
        Self { groups, dims, data: vec![0.0; groups * dims * GROUP_POINTS] }
    }

    /// The rows of `x` minus their centre, and the centre: entries are then of the order of the
    /// distances between points.
    pub(crate) fn centred(x: &DenseMatrix) -> (Self, Vec<f64>) {
        let centre = centre(x);
        let (groups, dims) = (x.rows().div_ceil(GROUP_POINTS), x.cols().max(1));
        let mut data = Vec::with_capacity(groups * dims * GROUP_POINTS);
        for g in 0..groups {
            // Places after the last point hold the centre, which becomes zero.
            let place = |lane: usize| {
                let i = g * GROUP_POINTS + lane;
                if i < x.rows() { x.row(i) } else { &centre }
            };
            let rows: [&[f64]; GROUP_POINTS] = core::array::from_fn(place);
            for (d, middle) in centre.iter().enumerate() {
                data.extend_from_slice(&rows.map(|row| row[d] - middle));
            }
            data.resize((g + 1) * dims * GROUP_POINTS, 0.0);
        }
        (Self { groups, dims, data }, centre)
    }

    /// Writes a point to `place`.
    pub(crate) fn set(&mut self, place: usize, values: impl Iterator<Item = f64>) {
        let start = place / GROUP_POINTS * self.dims * GROUP_POINTS + place % GROUP_POINTS;
        for (slot, value) in self.data[start..].iter_mut().step_by(GROUP_POINTS).zip(values) {
            *slot = value;
        }
    }

    /// Copies the point at `place` of `other`, which has as many coordinates.
    pub(crate) fn copy_point(&mut self, to: usize, other: &Self, place: usize) {
        let start = place / GROUP_POINTS * self.dims * GROUP_POINTS + place % GROUP_POINTS;
        self.set(to, other.data[start..].iter().step_by(GROUP_POINTS).take(other.dims).copied());
    }

    /// ‖x‖² of all points x, one per place.
    pub(crate) fn squares(&self) -> Vec<f64> {
        let mut squares = vec![0.0; self.places()];
        dispatch(Squares { pack: self, squares: &mut squares });
        squares
    }

    /// Number of groups.
    pub(crate) fn groups(&self) -> usize {
        self.groups
    }

    /// Number of places, a multiple of [`GROUP_POINTS`].
    pub(crate) fn places(&self) -> usize {
        self.groups * GROUP_POINTS
    }

    /// Coordinates of each point, at least 1.
    pub(crate) fn dims(&self) -> usize {
        self.dims
    }

    /// ‖x‖² of the register of points x that begins at `place`.
    #[inline(always)]
    fn square<S: Simd>(&self, simd: S, place: usize) -> S::f64s {
        let [(group, part)] = registers::<S, 1>(self, place);
        let mut sum = simd.splat_f64s(0.0);
        for x in group.iter().skip(part).step_by(GROUP_POINTS / S::F64_LANES) {
            sum = simd.mul_add_e_f64s(*x, *x, sum);
        }
        sum
    }

    /// The coordinates of group `g`: `dims` times [`GROUP_POINTS`] values.
    #[inline(always)]
    fn group(&self, g: usize) -> &[f64] {
        &self.data[g * self.dims * GROUP_POINTS..(g + 1) * self.dims * GROUP_POINTS]
    }
}

/// Approximate mean of the rows of `x`.
pub(crate) fn centre(x: &DenseMatrix) -> Vec<f64> {
    let step = x.rows().div_ceil(CENTRE_ROWS).max(1);
    let mut centre = vec![0.0; x.cols()];
    let mut count = 0.0;
    for i in (0..x.rows()).step_by(step) {
        count += 1.0;
        for (sum, value) in centre.iter_mut().zip(x.row(i)) {
            *sum += value;
        }
    }
    for sum in &mut centre {
        *sum /= count;
    }
    centre
}

struct Squares<'a> {
    pack: &'a SimdPack,
    squares: &'a mut [f64],
}

impl WithSimd for Squares<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (squares, _) = S::as_mut_simd_f64s(self.squares);
        for (r, square) in squares.iter_mut().enumerate() {
            *square = self.pack.square(simd, r * S::F64_LANES);
        }
    }
}

/// A computation on R registers of points and C members of a group, from its member F on.
pub(crate) trait GroupKernel<S: Simd, const R: usize> {
    /// Processes group `group`.
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize);
}

/// Runs `block` over the first `members` members of a group, and over one empty place when their
/// number is odd.
#[inline(always)]
pub(crate) fn over_group<S: Simd, const R: usize>(
    simd: S,
    block: &mut impl GroupKernel<S, R>,
    group: usize,
    members: usize,
) {
    if S::REGISTER_COUNT < MANY_REGISTERS {
        over_halves(simd, block, group, members);
        return;
    }
    match members {
        0..=2 => block.run::<2, 0>(simd, group),
        3 | 4 => block.run::<4, 0>(simd, group),
        5 | 6 => block.run::<6, 0>(simd, group),
        _ => block.run::<8, 0>(simd, group),
    }
}

/// As [`over_group`], half a group at a time: for kernels that need registers beyond those of their
/// sums.
#[inline(always)]
pub(crate) fn over_halves<S: Simd, const R: usize>(
    simd: S,
    block: &mut impl GroupKernel<S, R>,
    group: usize,
    members: usize,
) {
    if members > 2 {
        block.run::<4, 0>(simd, group);
    } else {
        block.run::<2, 0>(simd, group);
    }
    match members {
        0..=4 => {}
        5 | 6 => block.run::<2, 4>(simd, group),
        _ => block.run::<4, 4>(simd, group),
    }
}

/// R registers of the points from `place` on: for each the registers of its group, and its index
/// among the registers of one coordinate.
#[inline(always)]
fn registers<S: Simd, const R: usize>(points: &SimdPack, place: usize) -> [(&[S::f64s], usize); R] {
    core::array::from_fn(|r| {
        let at = place + r * S::F64_LANES;
        let (group, _) = S::as_simd_f64s(points.group(at / GROUP_POINTS));
        (group, at % GROUP_POINTS / S::F64_LANES)
    })
}

/// Blocks between the one in work and the one being prefetched, where the points exceed the cache:
/// enough to hide a memory latency of some hundred operations.
pub(crate) const PREFETCH_BLOCKS: usize = 2;

/// start\[c\] + x·g for R registers of points x from `place` on and the members g of group `group`
/// of `others`; start\[c\] is the entry of member c. Prefetches `P` blocks ahead, unless `P` is 0.
#[inline(always)]
pub(crate) fn products<S: Simd, const R: usize, const C: usize, const F: usize, const P: usize>(
    simd: S,
    points: &SimdPack,
    place: usize,
    others: &SimdPack,
    group: usize,
    starts: &[f64],
) -> [[S::f64s; R]; C] {
    let points = registers::<S, R>(points, place);
    let per = GROUP_POINTS / S::F64_LANES;
    let starts = &starts[group * GROUP_POINTS..(group + 1) * GROUP_POINTS];
    let mut sums = [[simd.splat_f64s(0.0); R]; C];
    for c in 0..C {
        sums[c] = [simd.splat_f64s(starts[F + c]); R];
    }
    let ahead = P * R * S::F64_LANES * others.dims;
    let (rows, _) = others.group(group).as_chunks::<GROUP_POINTS>();
    for (d, row) in rows.iter().enumerate() {
        let mut x = [simd.splat_f64s(0.0); R];
        for r in 0..R {
            let register = &points[r].0[d * per + points[r].1];
            if P > 0 {
                prefetch(register, ahead);
            }
            x[r] = *register;
        }
        for c in 0..C {
            let g = simd.splat_f64s(row[F + c]);
            for r in 0..R {
                sums[c][r] = simd.mul_add_e_f64s(g, x[r], sums[c][r]);
            }
        }
    }
    sums
}

/// ‖x − g‖² for R registers of points x from `place` on and the members g of group `group` of
/// `others`. It squares differences, so that close points lose no digits.
#[inline(always)]
pub(crate) fn squared_distances<S: Simd, const R: usize, const C: usize, const F: usize>(
    simd: S,
    points: &SimdPack,
    place: usize,
    others: &SimdPack,
    group: usize,
) -> [[S::f64s; R]; C] {
    let points = registers::<S, R>(points, place);
    let per = GROUP_POINTS / S::F64_LANES;
    let mut sums = [[simd.splat_f64s(0.0); R]; C];
    let (rows, _) = others.group(group).as_chunks::<GROUP_POINTS>();
    for (d, row) in rows.iter().enumerate() {
        let mut x = [simd.splat_f64s(0.0); R];
        for r in 0..R {
            x[r] = points[r].0[d * per + points[r].1];
        }
        for c in 0..C {
            let g = simd.splat_f64s(row[F + c]);
            for r in 0..R {
                let gap = simd.sub_f64s(x[r], g);
                sums[c][r] = simd.mul_add_e_f64s(gap, gap, sums[c][r]);
            }
        }
    }
    sums
}
