//! An image of the ground below the map: which files are taken, and where their edges lie.

use serde::Serialize;

/// Largest file in bytes: an orthophoto of 8,192 × 8,192 pixels as JPEG.
pub const MAX_IMAGE_BYTES: u64 = 32 * 1024 * 1024;

/// Farthest edge from the origin in metres, as that of a position.
const MAX_METRES: f64 = 4.0e7;

/// Where the edges of an image lie, in metres east and north of the origin of the fleet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Edges {
    /// The left one.
    pub west: f64,
    /// The lower one.
    pub south: f64,
    /// The right one.
    pub east: f64,
    /// The upper one.
    pub north: f64,
}

impl Edges {
    /// Reads WEST,SOUTH,EAST,NORTH.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> =
            text.split(',').map(|number| number.trim().parse().ok()).collect();
        let Some([west, south, east, north]) = numbers.as_deref() else {
            return Err(
                "must be WEST,SOUTH,EAST,NORTH in metres, such as -50,-50,150,100".to_owned()
            );
        };
        let (west, south, east, north) = (*west, *south, *east, *north);
        // Written so that what is no number is refused too.
        let is_near = [west, south, east, north].iter().all(|edge| edge.abs() <= MAX_METRES);
        if is_near && west < east && south < north {
            return Ok(Self { west, south, east, north });
        }
        Err(format!(
            "west must be below east, south below north, and all within {MAX_METRES} m of the origin"
        ))
    }
}

/// The media type of an image, by its first bytes; none for any other file.
#[must_use]
pub fn kind(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("image/png"),
        [0xff, 0xd8, 0xff, ..] => Some("image/jpeg"),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Some("image/webp"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_read_or_refused_with_a_reason() {
        let edges = Edges::parse("-50, -40.5,150,100").unwrap();
        assert_eq!(edges, Edges { west: -50.0, south: -40.5, east: 150.0, north: 100.0 });
        for (wrong, named) in [
            ("", "WEST,SOUTH"),
            ("1,2,3", "WEST,SOUTH"),
            ("1,2,3,x", "WEST,SOUTH"),
            ("5,0,1,10", "west must be below"),
            ("0,NaN,1,10", "west must be below"),
            ("0,0,1e9,10", "origin"),
        ] {
            let problem = Edges::parse(wrong).unwrap_err();
            assert!(problem.contains(named), "{wrong}: {problem}");
        }
    }

    #[test]
    fn only_images_without_scripts_are_images() {
        assert_eq!(kind(b"\x89PNG\r\n\x1a\n"), Some("image/png"));
        assert_eq!(kind(b"\xff\xd8\xff\xe0"), Some("image/jpeg"));
        assert_eq!(kind(b"RIFF\0\0\0\0WEBPVP8 "), Some("image/webp"));
        assert_eq!(kind(b"<svg xmlns=\"http://www.w3.org/2000/svg\"/>"), None);
        assert_eq!(kind(b""), None);
    }
}
