//! Colours of teams: the same by which the console tells teams apart, so that both show one fleet.

use super::scene::Color;

/// Seven of the colours of Okabe and Ito, which people of every colour vision tell apart.
const BASE: [[u8; 3]; 7] = [
    [0x56, 0xb4, 0xe9],
    [0xe6, 0x9f, 0x00],
    [0x00, 0x9e, 0x73],
    [0xf0, 0xe4, 0x42],
    [0x00, 0x72, 0xb2],
    [0xd5, 0x5e, 0x00],
    [0xcc, 0x79, 0xa7],
];

/// What is neither in a team nor lost.
pub(super) const NO_TEAM: Color = Color { r: 0.85, g: 0.85, b: 0.85, a: 1.0 };

/// What is silent or lost.
pub(super) const MISSING: Color = Color { r: 0.5, g: 0.5, b: 0.5, a: 0.8 };

/// Names and numbers.
pub(super) const TEXT: Color = Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };

/// What whoever looks must know before all else.
pub(super) const NOTICE: Color = Color { r: 1.0, g: 0.35, b: 0.25, a: 1.0 };

/// The number in a team's id; a hash of the text where it has none.
fn number_of(id: &str) -> u64 {
    let digits = id.len() - id.bytes().rev().take_while(u8::is_ascii_digit).count();
    if let Ok(number) = id[digits..].parse::<u64>() {
        // The first team is t1. What comes before it is the last of the dark colours, as in the console.
        return number.checked_sub(1).unwrap_or(3 * BASE.len() as u64 - 1);
    }
    let hash = |hash: u32, byte: u8| hash.wrapping_mul(31).wrapping_add(u32::from(byte));
    u64::from(id.bytes().fold(7, hash))
}

/// The colour of a team, which lasts with its id.
#[must_use]
pub fn team_color(id: &str) -> Color {
    let number = number_of(id);
    let count = BASE.len() as u64;
    let base = BASE[usize::try_from(number % count).unwrap_or_default()];
    // After seven teams come lighter colours, then darker ones.
    let mix = |part: u8| {
        let part = f64::from(part);
        match number / count % 3 {
            0 => part,
            1 => (part * 0.55 + 255.0 * 0.45).round(),
            _ => (part * 0.6).round(),
        }
    };
    let [r, g, b] = base.map(|part| mix(part) / 255.0);
    Color { r, g, b, a: 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_colours_are_those_of_the_console() {
        let console = include_str!("../../../console/web/colors.js");
        for [r, g, b] in BASE {
            let color = format!("[0x{r:02x}, 0x{g:02x}, 0x{b:02x}]");
            assert!(console.contains(&color), "{color}");
        }
        assert_eq!(console.matches("[0x").count(), BASE.len());
    }

    #[test]
    fn a_colour_lasts_with_the_id_and_neighbours_differ() {
        let all: Vec<Color> = (1..=21).map(|number| team_color(&format!("t{number}"))).collect();
        for (at, color) in all.iter().enumerate() {
            assert_eq!(*color, team_color(&format!("t{}", at + 1)));
            assert!(!all[..at].contains(color), "t{}", at + 1);
        }
        assert_eq!(team_color("t22"), team_color("t1"));
        assert_eq!(team_color("t1").r, f64::from(0x56) / 255.0);
        // Names without a number, of any length, have a colour as well.
        for id in ["", "alpha", "t0", "9", "t99999999999999999999999"] {
            assert!((0.0..=1.0).contains(&team_color(id).r), "{id}");
        }
    }
}
