//! Rigid transforms, the datum of a satellite fix, and axes that point elsewhere.

use std::f64::consts::{FRAC_PI_2, PI};

/// How far the square of a rotation's length may be from 1: senders round, some to `float32`.
const MAX_ROTATION_ERROR: f64 = 1e-3;

/// Farthest from the datum in metres at which a satellite fix is taken: beyond, the plane that touches the earth at the
/// datum is 8 m off.
pub const MAX_DATUM_DISTANCE_M: f64 = 10_000.0;

/// The semi-major axis of the WGS 84 ellipsoid in metres.
const SEMI_MAJOR_M: f64 = 6_378_137.0;

/// Its flattening.
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// A rotation as a quaternion of length 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Rotation {
    /// None.
    pub const IDENTITY: Self = Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };

    /// That of a quaternion, which is made as long as it must be; none if it is far from that, or not finite.
    #[must_use]
    pub fn new([x, y, z, w]: [f64; 4]) -> Option<Self> {
        let square = x * x + y * y + z * z + w * w;
        let is_rotation = (square - 1.0).abs() <= MAX_ROTATION_ERROR;
        let length = square.sqrt();
        is_rotation.then(|| Self { x: x / length, y: y / length, z: z / length, w: w / length })
    }

    /// About the vertical, counter-clockwise, in radians.
    #[must_use]
    pub fn about_z(angle: f64) -> Self {
        let (sin, cos) = (angle / 2.0).sin_cos();
        Self { z: sin, w: cos, ..Self::IDENTITY }
    }

    fn inverse(self) -> Self {
        Self { x: -self.x, y: -self.y, z: -self.z, w: self.w }
    }

    /// This one after another.
    fn after(self, first: Self) -> Self {
        let (a, b) = (self, first);
        Self {
            x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
            w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
        }
    }

    fn rotate(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        // v + 2 w (u × v) + 2 u × (u × v), with u the vector of the quaternion.
        let cross = |[a, b, c]: [f64; 3]| {
            [self.y * c - self.z * b, self.z * a - self.x * c, self.x * b - self.y * a]
        };
        let once = cross([x, y, z]);
        let twice = cross(once);
        [0, 1, 2].map(|axis| [x, y, z][axis] + 2.0 * (self.w * once[axis] + twice[axis]))
    }

    /// The angle of its forward axis about the vertical, in radians, counter-clockwise from the first axis; none where it
    /// points straight up or down.
    #[must_use]
    pub fn heading(self) -> Option<f64> {
        let [x, y, _] = self.rotate([1.0, 0.0, 0.0]);
        (x.hypot(y) > 1e-6).then(|| y.atan2(x))
    }
}

/// Where the axes of a frame are in another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform {
    /// Its origin in metres.
    pub translation: [f64; 3],
    /// How its axes are turned.
    pub rotation: Rotation,
}

impl Transform {
    /// The same frame.
    pub const IDENTITY: Self = Self { translation: [0.0; 3], rotation: Rotation::IDENTITY };

    /// From a frame into the one that `outer` leads to.
    #[must_use]
    pub fn within(self, outer: Self) -> Self {
        let moved = outer.rotation.rotate(self.translation);
        Self {
            translation: [0, 1, 2].map(|axis| outer.translation[axis] + moved[axis]),
            rotation: outer.rotation.after(self.rotation),
        }
    }

    /// The way back.
    #[must_use]
    pub fn inverse(self) -> Self {
        let rotation = self.rotation.inverse();
        let [x, y, z] = rotation.rotate(self.translation);
        Self { translation: [-x, -y, -z], rotation }
    }

    /// Whether all numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.translation.iter().all(|value| value.is_finite())
    }

    /// The same pose where it was given with axes north, east and down, and with a heading clockwise from north, as PX4
    /// has it. One that points straight up or down has no heading, and is not turned.
    #[must_use]
    pub fn from_north_east_down(self) -> Self {
        let [north, east, down] = self.translation;
        let heading = self.rotation.heading();
        let rotation = heading
            .map_or(Rotation::IDENTITY, |angle| Rotation::about_z(heading_from_north(angle)));
        Self { translation: [east, north, -down], rotation }
    }
}

/// A heading clockwise from north as one counter-clockwise from east, in (−π, π].
#[must_use]
pub fn heading_from_north(angle: f64) -> f64 {
    let angle = (FRAC_PI_2 - angle).rem_euclid(2.0 * PI);
    if angle > PI { angle - 2.0 * PI } else { angle }
}

/// A place on the earth: degrees north, degrees east, metres above the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geodetic {
    /// Degrees north.
    pub latitude: f64,
    /// Degrees east.
    pub longitude: f64,
    /// Metres above the ellipsoid.
    pub altitude: f64,
}

impl Geodetic {
    /// Whether it is a place: finite, and within the ranges of degrees.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.latitude.abs() <= 90.0 && self.longitude.abs() <= 180.0 && self.altitude.is_finite()
    }

    /// Metres from the middle of the earth.
    fn geocentric(&self) -> [f64; 3] {
        let (sin_lat, cos_lat) = self.latitude.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude.to_radians().sin_cos();
        let eccentricity = FLATTENING * (2.0 - FLATTENING);
        let normal = SEMI_MAJOR_M / (1.0 - eccentricity * sin_lat * sin_lat).sqrt();
        let horizontal = (normal + self.altitude) * cos_lat;
        [
            horizontal * cos_lon,
            horizontal * sin_lon,
            (normal * (1.0 - eccentricity) + self.altitude) * sin_lat,
        ]
    }

    /// Metres east, north and up of a datum, on the plane that touches the ellipsoid there.
    #[must_use]
    pub fn east_north_up_of(&self, datum: &Self) -> [f64; 3] {
        let (own, origin) = (self.geocentric(), datum.geocentric());
        let [x, y, z] = [0, 1, 2].map(|axis| own[axis] - origin[axis]);
        let (sin_lat, cos_lat) = datum.latitude.to_radians().sin_cos();
        let (sin_lon, cos_lon) = datum.longitude.to_radians().sin_cos();
        [
            -sin_lon * x + cos_lon * y,
            -sin_lat * cos_lon * x - sin_lat * sin_lon * y + cos_lat * z,
            cos_lat * cos_lon * x + cos_lat * sin_lon * y + sin_lat * z,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(one: [f64; 3], other: [f64; 3], within: f64) {
        for axis in 0..3 {
            assert!((one[axis] - other[axis]).abs() <= within, "{one:?} is not {other:?}");
        }
    }

    #[test]
    fn a_chain_of_transforms_leads_there_and_back() {
        let quarter = Rotation::about_z(FRAC_PI_2);
        let outer = Transform { translation: [10.0, 0.0, 0.0], rotation: quarter };
        let inner = Transform { translation: [1.0, 2.0, 3.0], rotation: quarter };
        let whole = inner.within(outer);
        near(whole.translation, [8.0, 1.0, 3.0], 1e-12);
        assert!((whole.rotation.heading().unwrap().abs() - PI).abs() < 1e-12);
        let back = whole.within(outer.inverse());
        near(back.translation, inner.translation, 1e-12);
        assert!((back.rotation.heading().unwrap() - FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn rotations_are_made_as_long_as_they_must_be_or_refused() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let rounded = Rotation::new([0.0, 0.0, 0.6, 0.8001]).unwrap();
        assert!((rounded.z.hypot(rounded.w) - 1.0).abs() < 1e-12);
        for wrong in [[0.0; 4], [0.0, 0.0, 0.0, 2.0], [f64::NAN, 0.0, 0.0, 1.0], [f64::INFINITY; 4]]
        {
            assert_eq!(Rotation::new(wrong), None, "{wrong:?}");
        }
        let up = Rotation::new([0.0, -half, 0.0, half]).unwrap();
        assert_eq!(up.heading(), None, "it looks straight up");
    }

    #[test]
    fn north_east_down_becomes_east_north_up() {
        // One metre north, two east, three above, looking east.
        let pose =
            Transform { translation: [1.0, 2.0, -3.0], rotation: Rotation::about_z(FRAC_PI_2) };
        let own = pose.from_north_east_down();
        near(own.translation, [2.0, 1.0, 3.0], 1e-12);
        assert!(own.rotation.heading().unwrap().abs() < 1e-12);
        for (north, east) in
            [(0.0, FRAC_PI_2), (PI, -FRAC_PI_2), (-FRAC_PI_2, PI), (5.0 * PI, -FRAC_PI_2)]
        {
            assert!((heading_from_north(north) - east).abs() < 1e-9, "{north}");
        }
    }

    #[test]
    fn a_fix_lies_where_geodesy_says() {
        let datum = Geodetic { latitude: 48.0, longitude: 11.0, altitude: 500.0 };
        near(datum.east_north_up_of(&datum), [0.0; 3], 1e-9);
        // A ten-thousandth of a degree: of the meridian 111,203 m a degree here, of the parallel 74,626 m, both by the radii
        // of curvature at 48 degrees, and 500 m up.
        let north = Geodetic { latitude: 48.0001, ..datum };
        near(north.east_north_up_of(&datum), [0.0, 11.1206, 0.0], 2e-3);
        let east = Geodetic { longitude: 11.0001, ..datum };
        near(east.east_north_up_of(&datum), [7.4632, 0.0, 0.0], 2e-3);
        let up = Geodetic { altitude: 510.0, ..datum };
        near(up.east_north_up_of(&datum), [0.0, 0.0, 10.0], 1e-6);
        assert!(!Geodetic { latitude: f64::NAN, ..datum }.is_valid());
        assert!(!Geodetic { longitude: 181.0, ..datum }.is_valid());
    }
}
