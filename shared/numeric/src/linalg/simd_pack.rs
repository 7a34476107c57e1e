//! Points packed for vector registers, and the two products that run over them.
//!
//! Eight points stand side by side, coordinate by coordinate, so that one register holds the same
//! coordinate of several points: what is computed of a point, such as the least of its distances,
//! then needs no step across the lanes of a register. A kernel keeps the sums of R registers of
//! points with C other points in registers throughout, which reads R + C values for R·C
//! multiplications; that is what makes it bound by arithmetic rather than by memory.

use pulp::{Simd, WithSimd};

use super::matrix::DenseMatrix;
use super::simd::{dispatch, prefetch};

/// Points that stand side by side: the lanes of the widest registers there are.
pub(crate) const GROUP: usize = 8;

/// Registers of points that a kernel works on at a time. Three times eight sums and what they are
/// made from fill the 32 registers of the instruction sets with the widest ones.
pub(crate) const REGISTERS: usize = 3;

/// Number of registers from which a kernel takes a whole group at a time; with less it takes half
/// a group, so that all sums stay in registers.
const MANY_REGISTERS: usize = 32;

/// Rows whose mean points are centred by. Centring only keeps numbers small, so that the mean of
/// some of the points serves as well as that of all.
const CENTRE_ROWS: usize = 1024;

/// Points in groups of [`GROUP`]; places that hold no point are zero.
#[derive(Debug, Clone)]
pub(crate) struct Panels {
    groups: usize,
    dims: usize,
    data: Vec<f64>,
}

impl Panels {
    /// Room for `points` points of `cols` coordinates. Points without any coordinate get one that
    /// is zero, so that no kernel has to deal with rows of no length.
    pub(crate) fn zeros(points: usize, cols: usize) -> Self {
        let (groups, dims) = (points.div_ceil(GROUP), cols.max(1));
        Self { groups, dims, data: vec![0.0; groups * dims * GROUP] }
    }

    /// The rows of `x`, centred, and what they are centred by, so that numbers are of the order of
    /// the distances between points, wherever the points lie.
    pub(crate) fn centred(x: &DenseMatrix) -> (Self, Vec<f64>) {
        let centre = centre(x);
        let (groups, dims) = (x.rows().div_ceil(GROUP), x.cols().max(1));
        let mut data = Vec::with_capacity(groups * dims * GROUP);
        for g in 0..groups {
            // Behind the last point stands the centre, which is zero less itself.
            let place = |lane: usize| {
                let i = g * GROUP + lane;
                if i < x.rows() { x.row(i) } else { &centre }
            };
            let rows: [&[f64]; GROUP] = core::array::from_fn(place);
            for (d, middle) in centre.iter().enumerate() {
                data.extend_from_slice(&rows.map(|row| row[d] - middle));
            }
            data.resize((g + 1) * dims * GROUP, 0.0);
        }
        (Self { groups, dims, data }, centre)
    }

    /// Puts a point at `place`.
    pub(crate) fn set(&mut self, place: usize, values: impl Iterator<Item = f64>) {
        let start = place / GROUP * self.dims * GROUP + place % GROUP;
        for (slot, value) in self.data[start..].iter_mut().step_by(GROUP).zip(values) {
            *slot = value;
        }
    }

    /// Copies the point at `place` of `other`, which has as many coordinates.
    pub(crate) fn copy_point(&mut self, to: usize, other: &Self, place: usize) {
        let start = place / GROUP * self.dims * GROUP + place % GROUP;
        self.set(to, other.data[start..].iter().step_by(GROUP).take(other.dims).copied());
    }

    /// ‖x‖² of all points x, one per place.
    pub(crate) fn squares(&self) -> Vec<f64> {
        let mut squares = vec![0.0; self.places()];
        dispatch(Squares { panels: self, squares: &mut squares });
        squares
    }

    /// Number of groups.
    pub(crate) fn groups(&self) -> usize {
        self.groups
    }

    /// Number of places, a multiple of [`GROUP`].
    pub(crate) fn places(&self) -> usize {
        self.groups * GROUP
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
        for x in group.iter().skip(part).step_by(GROUP / S::F64_LANES) {
            sum = simd.mul_add_e_f64s(*x, *x, sum);
        }
        sum
    }

    /// The coordinates of group `g`: `dims` times [`GROUP`] values.
    #[inline(always)]
    fn group(&self, g: usize) -> &[f64] {
        &self.data[g * self.dims * GROUP..(g + 1) * self.dims * GROUP]
    }
}

/// About the mean of the rows of `x`.
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
    panels: &'a Panels,
    squares: &'a mut [f64],
}

impl WithSimd for Squares<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (squares, _) = S::as_mut_simd_f64s(self.squares);
        for (r, square) in squares.iter_mut().enumerate() {
            *square = self.panels.square(simd, r * S::F64_LANES);
        }
    }
}

/// Something done with R registers of points and C members of a group, from its member F on.
pub(crate) trait Block<S: Simd, const R: usize> {
    /// Does it for group `group`.
    fn run<const C: usize, const F: usize>(&mut self, simd: S, group: usize);
}

/// Runs `block` over the first `members` members of a group, and over a place without a point
/// when their number is odd.
#[inline(always)]
pub(crate) fn over_group<S: Simd, const R: usize>(
    simd: S,
    block: &mut impl Block<S, R>,
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

/// As [`over_group`], half a group at a time: for kernels that do more with a sum than keep it.
#[inline(always)]
pub(crate) fn over_halves<S: Simd, const R: usize>(
    simd: S,
    block: &mut impl Block<S, R>,
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

/// R registers of the points from `place` on: for each the registers of its group, and which of
/// the registers of one coordinate it is.
#[inline(always)]
fn registers<S: Simd, const R: usize>(points: &Panels, place: usize) -> [(&[S::f64s], usize); R] {
    core::array::from_fn(|r| {
        let at = place + r * S::F64_LANES;
        let (group, _) = S::as_simd_f64s(points.group(at / GROUP));
        (group, at % GROUP / S::F64_LANES)
    })
}

/// Blocks of points between the one that a kernel works on and the one that it has fetched into the
/// cache meanwhile, where it goes through more points than the cache holds: enough to hide that
/// memory answers only after some hundred operations.
pub(crate) const AHEAD: usize = 2;

/// start\[c\] + x·g for R registers of points x from `place` on and the members g of group `group`
/// of `others`, with start\[c\] the entry of member c. Fetches the points of the block after the
/// next `P` ones beforehand, unless `P` is 0.
#[inline(always)]
pub(crate) fn products<S: Simd, const R: usize, const C: usize, const F: usize, const P: usize>(
    simd: S,
    points: &Panels,
    place: usize,
    others: &Panels,
    group: usize,
    starts: &[f64],
) -> [[S::f64s; R]; C] {
    let points = registers::<S, R>(points, place);
    let per = GROUP / S::F64_LANES;
    let starts = &starts[group * GROUP..(group + 1) * GROUP];
    let mut sums = [[simd.splat_f64s(0.0); R]; C];
    for c in 0..C {
        sums[c] = [simd.splat_f64s(starts[F + c]); R];
    }
    let ahead = P * R * S::F64_LANES * others.dims;
    let (rows, _) = others.group(group).as_chunks::<GROUP>();
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
/// `others`. Differences come before squares, so that near points lose no digits.
#[inline(always)]
pub(crate) fn squared_distances<S: Simd, const R: usize, const C: usize, const F: usize>(
    simd: S,
    points: &Panels,
    place: usize,
    others: &Panels,
    group: usize,
) -> [[S::f64s; R]; C] {
    let points = registers::<S, R>(points, place);
    let per = GROUP / S::F64_LANES;
    let mut sums = [[simd.splat_f64s(0.0); R]; C];
    let (rows, _) = others.group(group).as_chunks::<GROUP>();
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
