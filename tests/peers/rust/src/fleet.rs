//! Fleets of squads that move: positions, headings and radios.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Robots of a squad.
const SQUAD_ROBOTS: usize = 8;

/// Most distance of a robot from the middle of its squad along each axis, in mean spacings.
const SPREAD: f64 = 1.5;

/// By how much a robot may turn from one tick to the next, in radians: about 6 degrees.
const MAX_TURN_RAD: f64 = 0.1;

/// By how much an antenna may differ from the average one, as a factor on the range.
const ANTENNA_GAIN: (f64, f64) = (0.9, 1.1);

/// Robots in the plane. Lengths are in mean spacings: there is one robot per unit of area.
#[derive(Debug)]
pub(crate) struct Fleet {
    pub(crate) points: Vec<[f64; 2]>,
    /// Factor on the range of each robot's radio.
    pub(crate) gains: Vec<f64>,
    headings: Vec<f64>,
    rng: ChaCha8Rng,
}

impl Fleet {
    /// Squads whose middles are anywhere in a square, numbered along a Morton curve, so that robots
    /// with near numbers are near each other.
    pub(crate) fn new(robots: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let side = (robots as f64).sqrt();
        let squads = robots.div_ceil(SQUAD_ROBOTS);
        let middles: Vec<[f64; 2]> =
            (0..squads).map(|_| [rng.random::<f64>() * side, rng.random::<f64>() * side]).collect();
        let mut near = || SPREAD * (rng.random::<f64>() + rng.random::<f64>() - 1.0);
        let mut points: Vec<[f64; 2]> =
            (0..robots).map(|i| middles[i / SQUAD_ROBOTS].map(|middle| middle + near())).collect();
        points.sort_by_cached_key(|point| morton(point, side));
        let headings = (0..robots).map(|_| rng.random::<f64>() * std::f64::consts::TAU).collect();
        let gains = (0..robots)
            .map(|_| ANTENNA_GAIN.0 + (ANTENNA_GAIN.1 - ANTENNA_GAIN.0) * rng.random::<f64>())
            .collect();
        Self { points, gains, headings, rng }
    }

    /// Every robot goes `spacings` ahead and turns a little.
    pub(crate) fn all_move(&mut self, spacings: f64) {
        for (point, heading) in self.points.iter_mut().zip(&mut self.headings) {
            *heading += MAX_TURN_RAD * (2.0 * self.rng.random::<f64>() - 1.0);
            point[0] += spacings * heading.cos();
            point[1] += spacings * heading.sin();
        }
    }

    /// Any one robot goes `spacings` in any direction.
    pub(crate) fn one_moves(&mut self, spacings: f64) {
        let robot = self.rng.random_range(0..self.points.len());
        let heading = self.rng.random::<f64>() * std::f64::consts::TAU;
        self.points[robot][0] += spacings * heading.cos();
        self.points[robot][1] += spacings * heading.sin();
    }
}

/// Place along a Morton curve through a square that holds the fleet.
fn morton(point: &[f64; 2], side: f64) -> u64 {
    let whole = side + 2.0 * SPREAD;
    let place = |value: f64| ((value + SPREAD) / whole * 65535.0) as u64;
    let (x, y) = (place(point[0]), place(point[1]));
    (0..16).map(|bit| ((x >> bit & 1) << (2 * bit)) | ((y >> bit & 1) << (2 * bit + 1))).sum()
}
