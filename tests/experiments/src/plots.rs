//! Plots as SVG: data in, text out. What is in them is decided elsewhere ([`crate::figures`]).
//!
//! Colours are those of Okabe and Ito (Color Universal Design, 2008), which people of every colour vision can tell
//! apart; shapes repeat the distinction for print in grey.

pub mod dots;
pub mod lines;
pub mod map;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// The colours, dark ones first.
pub const COLOURS: [[u8; 3]; 8] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [0, 0, 0],
    [240, 228, 66],
];

/// Text and axes.
const INK: RGBColor = RGBColor(40, 40, 40);

/// Height of text in pixels.
const TEXT: u32 = 17;

/// Height of a line of a legend in pixels.
const LEGEND_LINE: u32 = 24;

/// Half of the width of a mark in pixels.
const MARK: i32 = 5;

/// Why there is no plot.
#[derive(Debug, thiserror::Error)]
#[error("a plot cannot be drawn: {0}")]
pub struct PlotError(String);

impl<E: std::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for PlotError {
    fn from(error: DrawingAreaErrorKind<E>) -> Self {
        Self(error.to_string())
    }
}

/// The shape of a mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A disc.
    Disc,
    /// A square.
    Square,
    /// A triangle on its side.
    Triangle,
    /// A square on its corner.
    Diamond,
    /// A triangle on its corner.
    Wedge,
}

impl Shape {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Disc, Self::Square, Self::Triangle, Self::Diamond, Self::Wedge];
}

/// By what a series is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Look {
    /// Red, green, blue.
    pub colour: [u8; 3],
    /// Of its marks.
    pub shape: Shape,
}

impl Look {
    /// One of many distinct colours, the same for the same number.
    #[must_use]
    pub fn of(number: usize) -> Self {
        Self {
            colour: COLOURS[number % COLOURS.len()],
            shape: Shape::ALL[number % Shape::ALL.len()],
        }
    }

    fn ink(self) -> RGBColor {
        let [red, green, blue] = self.colour;
        RGBColor(red, green, blue)
    }
}

/// An axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it shows, with its unit.
    pub title: String,
    /// Where it begins and ends.
    pub range: (f64, f64),
    /// Digits after the point.
    pub decimals: usize,
}

impl Axis {
    fn label(&self, value: f64) -> String {
        // Adding 0 turns −0 into 0.
        let digits = 10_f64.powi(i32::try_from(self.decimals).unwrap_or(0));
        format!("{:.*}", self.decimals, (value * digits).round() / digits + 0.0)
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A picture of so many pixels.
fn drawn(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> Result<(), PlotError>,
) -> Result<String, PlotError> {
    let mut svg = String::new();
    let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
    area.fill(&WHITE)?;
    draw(&area)?;
    area.present()?;
    // The text is complete once the area is gone.
    drop(area);
    Ok(svg)
}

/// A count of pixels as a coordinate.
fn signed(pixels: u32) -> i32 {
    i32::try_from(pixels).unwrap_or(i32::MAX)
}

fn font<'a>() -> TextStyle<'a> {
    ("sans-serif", TEXT).into_font().color(&INK)
}

fn write(area: &Area<'_>, text: &str, at: (i32, i32), side: HPos) -> Result<(), PlotError> {
    let style = font().pos(Pos::new(side, VPos::Center));
    Ok(area.draw(&Text::new(text.to_owned(), at, style))?)
}

fn line(
    area: &Area<'_>,
    points: Vec<(i32, i32)>,
    colour: RGBColor,
    width: u32,
) -> Result<(), PlotError> {
    Ok(area.draw(&PathElement::new(points, colour.stroke_width(width)))?)
}

/// Draws a mark of some half width.
fn mark(area: &Area<'_>, (x, y): (i32, i32), look: Look, half: i32) -> Result<(), PlotError> {
    let ink = look.ink().filled();
    let wide = half + half / 3;
    let corners = match look.shape {
        Shape::Disc => return Ok(area.draw(&Circle::new((x, y), half, ink))?),
        Shape::Square => {
            vec![
                (x - half, y - half),
                (x + half, y - half),
                (x + half, y + half),
                (x - half, y + half),
            ]
        }
        Shape::Triangle => vec![(x - wide, y + half), (x + wide, y + half), (x, y - wide)],
        Shape::Diamond => vec![(x - wide, y), (x, y - wide), (x + wide, y), (x, y + wide)],
        Shape::Wedge => vec![(x - wide, y - half), (x + wide, y - half), (x, y + wide)],
    };
    Ok(area.draw(&Polygon::new(corners, ink))?)
}

/// The height of a legend of so many names in so many columns, in pixels.
fn legend_height(names: usize, columns: usize) -> u32 {
    u32::try_from(names.div_ceil(columns.max(1))).unwrap_or(1) * LEGEND_LINE + LEGEND_LINE / 2
}

/// Writes names with their marks, row by row; a line through the mark if series are lines.
fn legend(
    area: &Area<'_>,
    names: &[(String, Look)],
    columns: usize,
    lines: bool,
) -> Result<(), PlotError> {
    let columns = columns.max(1);
    let width = signed(area.dim_in_pixel().0) / i32::try_from(columns).unwrap_or(1);
    for (at, (name, look)) in names.iter().enumerate() {
        let (row, column) = (at / columns, at % columns);
        let x = 30 + width * i32::try_from(column).unwrap_or(0);
        let y = signed(LEGEND_LINE) * i32::try_from(row).unwrap_or(0) + signed(LEGEND_LINE) / 2;
        if lines {
            line(area, vec![(x - 16, y), (x + 16, y)], look.ink(), 2)?;
        }
        mark(area, (x, y), *look, MARK)?;
        write(area, name, (x + 24, y), HPos::Left)?;
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// How many marks of a colour a picture has; it must be well-formed.
    pub(crate) fn marks(svg: &str, colour: [u8; 3]) -> usize {
        let [red, green, blue] = colour;
        let wanted = format!("#{red:02X}{green:02X}{blue:02X}");
        let document = roxmltree::Document::parse(svg).unwrap();
        let is_mark = |node: &roxmltree::Node<'_, '_>| {
            matches!(node.tag_name().name(), "circle" | "polygon")
                && node.attribute("fill") == Some(wanted.as_str())
        };
        document.descendants().filter(is_mark).count()
    }

    /// All words of a picture.
    pub(crate) fn words(svg: &str) -> String {
        let document = roxmltree::Document::parse(svg).unwrap();
        let texts = document.descendants().filter(roxmltree::Node::is_text);
        texts.filter_map(|node| node.text()).map(|text| format!("{}\n", text.trim())).collect()
    }

    #[test]
    fn marks_of_all_shapes_are_drawn_and_names_are_escaped() {
        let names: Vec<(String, Look)> =
            (0..8).map(|number| (format!("<{number}> & so"), Look::of(number))).collect();
        let svg = drawn((400, 300), |area| legend(area, &names, 3, true)).unwrap();
        for (number, colour) in COLOURS.into_iter().enumerate() {
            assert_eq!(marks(&svg, colour), 1);
            assert!(words(&svg).contains(&format!("<{number}> & so")));
        }
    }

    #[test]
    fn labels_have_no_negative_zero() {
        let axis = Axis { title: String::new(), range: (-1.0, 1.0), decimals: 1 };
        assert_eq!([-0.04, 0.25, -0.3].map(|value| axis.label(value)), ["0.0", "0.3", "-0.3"]);
    }
}
