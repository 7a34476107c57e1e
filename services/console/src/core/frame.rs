//! Frames: what a browser draws, as bytes. Eight bytes per robot, or per link, behind a head of fixed length.
//!
//! All numbers are little-endian. The head:
//!
//! | bytes | content |
//! | --- | --- |
//! | 0 | what it shows: 1 the ground, 2 the embedding, 3 links |
//! | 1 | the version of this form, 1 |
//! | 4..8 | the list of names that indices refer to |
//! | 8..12 | the list of teams that slots refer to |
//! | 12..16 | how many records follow |
//! | 16..24, 24..32 | where the grid begins: x, y |
//! | 32..40 | the width of its cells |
//! | 40..48 | when the newest data behind it was received, in seconds since 1970 by the clock of the service |
//!
//! A robot, in the order of the names: column and row of the grid (2 × `u16`, both 65535 without a place), slot of the
//! team (`u16`, 65535 without one), heading (`u8`, in 255ths of a turn, 255 without one), flags (`u8`). A link: index of
//! the source in the lower 24 bits and weight in the upper 8 (`u32`), index of the target (`u32`).

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum View {
    /// Metres east and north.
    Ground = 1,
    /// The two main directions of the embedding.
    Embedding = 2,
    /// Links between robots.
    Links = 3,
}

/// Length of the head in bytes.
pub const HEAD: usize = 48;

/// Length of each record in bytes.
pub const RECORD: usize = 8;

/// Last cell of the grid in each direction; the one above says that there is no place.
const LAST_CELL: f64 = 65_534.0;

/// No place, no team.
pub const NONE: u16 = u16::MAX;

/// Narrowest cell: a millimetre is finer than any robot knows its place.
const LEAST_CELL: f64 = 0.001;

/// The robot is silent.
pub const STALE: u8 = 1;
/// It has left the fleet.
pub const LOST: u8 = 2;
/// A wish of an operator binds it.
pub const PINNED: u8 = 4;
/// One modality alone relates it to others.
pub const PROVISIONAL: u8 = 8;
/// It leads its team.
pub const LEADER: u8 = 16;
/// It stays in its team for now, although the newest vectors put it into another.
pub const HELD: u8 = 32;

/// What the head says besides the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Head {
    /// What the frame shows.
    pub view: View,
    /// The list of names.
    pub names: u32,
    /// The list of teams.
    pub teams: u32,
    /// When the newest data was received, in seconds since 1970.
    pub newest: f64,
}

/// One robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dot {
    /// Its place; none if no one knows it.
    pub place: Option<[f64; 2]>,
    /// The slot of its team, or [`NONE`].
    pub team: u16,
    /// Radians, counter-clockwise from east.
    pub heading: Option<f64>,
    /// What holds of it.
    pub flags: u8,
}

/// One link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Index of the robot where it starts.
    pub from: u32,
    /// Index of the robot where it ends.
    pub to: u32,
    /// Its weight, as a share of the largest one shown.
    pub share: f64,
}

/// A grid that holds all places.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Grid {
    origin: [f64; 2],
    cell: f64,
}

impl Grid {
    fn around(places: impl Iterator<Item = [f64; 2]>) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for place in places {
            for axis in 0..2 {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            }
        }
        if low[0] > high[0] {
            return Self { origin: [0.0; 2], cell: LEAST_CELL };
        }
        let extent = (high[0] - low[0]).max(high[1] - low[1]);
        Self { origin: low, cell: (extent / LAST_CELL).max(LEAST_CELL) }
    }

    fn cell_of(&self, value: f64, axis: usize) -> u16 {
        let cell = ((value - self.origin[axis]) / self.cell).round();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "it lies between 0 and the last cell"
        )]
        let cell = cell.clamp(0.0, LAST_CELL) as u16;
        cell
    }
}

fn begin(head: &Head, grid: &Grid, count: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEAD + RECORD * count);
    bytes.extend([head.view as u8, 1, 0, 0]);
    bytes.extend(head.names.to_le_bytes());
    bytes.extend(head.teams.to_le_bytes());
    bytes.extend(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
    for number in [grid.origin[0], grid.origin[1], grid.cell, head.newest] {
        bytes.extend(number.to_le_bytes());
    }
    bytes
}

/// A frame of robots.
#[must_use]
pub fn robots(head: &Head, dots: &[Dot]) -> Vec<u8> {
    let grid = Grid::around(dots.iter().filter_map(|dot| dot.place));
    let mut bytes = begin(head, &grid, dots.len());
    for dot in dots {
        let cells =
            dot.place.map_or([NONE; 2], |at| [grid.cell_of(at[0], 0), grid.cell_of(at[1], 1)]);
        for number in [cells[0], cells[1], dot.team] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend([dot.heading.map_or(u8::MAX, heading), dot.flags]);
    }
    bytes
}

/// A frame of links.
#[must_use]
pub fn links(head: &Head, lines: &[Line]) -> Vec<u8> {
    let mut bytes = begin(head, &Grid { origin: [0.0; 2], cell: 1.0 }, lines.len());
    for line in lines {
        let weight = u32::from(byte(line.share * 255.0));
        bytes.extend(((line.from & 0x00ff_ffff) | (weight << 24)).to_le_bytes());
        bytes.extend(line.to.to_le_bytes());
    }
    bytes
}

fn heading(radians: f64) -> u8 {
    let turns = (radians / std::f64::consts::TAU).rem_euclid(1.0);
    // A whole turn is none.
    byte((turns * 255.0).round()) % 255
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "it lies between 0 and 255"
)]
fn byte(value: f64) -> u8 {
    value.clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHAT: Head = Head { view: View::Ground, names: 7, teams: 3, newest: 12.5 };

    fn dot(place: Option<[f64; 2]>) -> Dot {
        Dot { place, team: 1, heading: None, flags: STALE }
    }

    fn number(bytes: &[u8], at: usize) -> f64 {
        f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
    }

    fn short(bytes: &[u8], at: usize) -> u16 {
        u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap())
    }

    #[test]
    fn a_robot_takes_eight_bytes_and_is_found_again_within_a_cell() {
        let places = [[-1000.0, 5.0], [3000.0, 250.0], [17.3, -44.9]];
        let dots: Vec<Dot> = places.iter().map(|place| dot(Some(*place))).collect();
        let bytes = robots(&WHAT, &dots);
        assert_eq!(bytes.len(), HEAD + 3 * 8);
        assert_eq!(bytes[..2], [1, 1]);
        let cell = number(&bytes, 32);
        assert!((cell - 4000.0 / 65_534.0).abs() < 1e-12);
        assert!((number(&bytes, 40) - 12.5).abs() < f64::EPSILON);
        for (number_of, place) in places.iter().enumerate() {
            for axis in 0..2 {
                let column = f64::from(short(&bytes, HEAD + 8 * number_of + 2 * axis));
                let back = number(&bytes, 16 + 8 * axis) + column * cell;
                assert!((back - place[axis]).abs() <= cell / 2.0 + 1e-9, "{back} {place:?}");
            }
        }
    }

    #[test]
    fn a_robot_without_a_place_is_listed_all_the_same() {
        let bytes = robots(&WHAT, &[dot(None), dot(Some([1.0, 1.0]))]);
        assert_eq!((short(&bytes, HEAD), short(&bytes, HEAD + 2)), (NONE, NONE));
        assert_eq!(short(&bytes, HEAD + 8), 0);
        assert_eq!(robots(&WHAT, &[]).len(), HEAD);
    }

    #[test]
    fn headings_go_round() {
        use std::f64::consts::{PI, TAU};
        assert_eq!([heading(0.0), heading(TAU), heading(-TAU)], [0, 0, 0]);
        assert_eq!([heading(PI), heading(-PI)], [128, 128]);
        assert_eq!(heading(TAU - 1e-9), 0);
    }

    #[test]
    fn a_link_has_its_ends_and_its_weight() {
        let bytes = links(&WHAT, &[Line { from: 99_999, to: 3, share: 1.0 }]);
        let first = u32::from_le_bytes(bytes[HEAD..HEAD + 4].try_into().unwrap());
        assert_eq!((first & 0x00ff_ffff, first >> 24), (99_999, 255));
    }
}
