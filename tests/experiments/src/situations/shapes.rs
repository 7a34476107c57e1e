//! Where the robots of a team stand: places in metres east and north.

use super::draw::Draw;

/// A place.
pub(super) type Place = [f64; 2];

/// Around a middle, with a standard deviation along each axis.
pub(super) fn blob(draw: &mut Draw, middle: Place, spread_m: f64, robots: usize) -> Vec<Place> {
    (0..robots).map(|_| middle.map(|at| at + spread_m * draw.normal())).collect()
}

/// One behind the other from a place on, towards an angle; every robot is a little off.
#[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
pub(super) fn column(
    draw: &mut Draw,
    (start, angle): (Place, f64),
    gap_m: f64,
    off_m: f64,
    robots: usize,
) -> Vec<Place> {
    let step = [angle.cos(), angle.sin()];
    let place = |i: usize| {
        [0, 1].map(|axis| start[axis] + gap_m * i as f64 * step[axis] + off_m * draw.normal())
    };
    (0..robots).map(place).collect()
}

/// Evenly on a part of a circle: from an angle on, as far as `sweep`, both in radians.
#[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
pub(super) fn arc(
    draw: &mut Draw,
    (middle, radius_m): (Place, f64),
    (from, sweep): (f64, f64),
    off_m: f64,
    robots: usize,
) -> Vec<Place> {
    let place = |i: usize| {
        let angle = from + sweep * i as f64 / robots.max(1) as f64;
        let at = [angle.cos(), angle.sin()];
        [0, 1].map(|axis| middle[axis] + radius_m * at[axis] + off_m * draw.normal())
    };
    (0..robots).map(place).collect()
}

/// In rows of a square camp.
#[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
pub(super) fn camp(
    draw: &mut Draw,
    corner: Place,
    gap_m: f64,
    off_m: f64,
    robots: usize,
) -> Vec<Place> {
    let wide = ((robots as f64).sqrt().ceil() as usize).max(1);
    let place = |i: usize| {
        let at = [(i % wide) as f64, (i / wide) as f64];
        [0, 1].map(|axis| corner[axis] + gap_m * at[axis] + off_m * draw.normal())
    };
    (0..robots).map(place).collect()
}
