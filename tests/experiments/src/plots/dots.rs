//! Values by name, each a dot with its interval on a line of its own.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Axis, INK, Look, MARK, PlotError, TEXT, drawn, font, legend, legend_height, line, mark, write,
};
use crate::statistics::Estimate;

/// Height of a row, and width of the whole and of its names, in pixels.
const ROW: u32 = 38;
const WIDTH: u32 = 960;
const NAMES: u32 = 210;

/// The values of one name.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// What they are of.
    pub name: String,
    /// For each kind of the legend, from top to bottom.
    pub values: Vec<Estimate>,
    /// A value of other origin, as a bar across.
    pub printed: Option<f64>,
}

/// Draws rows from top to bottom; `kinds` names the values of a row, `printed` the origin of the bars.
///
/// # Errors
/// If the drawing fails.
pub fn dots(
    rows: &[Row],
    kinds: &[(String, Look)],
    printed: (&str, Look),
    x: &Axis,
) -> Result<String, PlotError> {
    let names = [kinds, &[(printed.0.to_owned(), printed.1)]].concat();
    let count = u32::try_from(rows.len()).unwrap_or(1);
    let high = count * ROW + 70;
    let size = (WIDTH, high + legend_height(names.len(), names.len()));
    drawn(size, |area| {
        let (top, bottom) = area.split_vertically(high);
        let mut chart = ChartBuilder::on(&top)
            .margin(14)
            .margin_left(NAMES)
            .margin_right(40)
            .x_label_area_size(48)
            .build_cartesian_2d(x.range.0..x.range.1, 0.0..f64::from(count))?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(225, 225, 225))
            .axis_style(INK)
            .x_labels(11)
            .x_label_formatter(&|value| x.label(*value))
            .label_style(("sans-serif", TEXT - 2).into_font().color(&INK))
            .axis_desc_style(font())
            .x_desc(&x.title)
            .draw()?;
        let within = |value: f64| value.clamp(x.range.0, x.range.1);
        let mut below = f64::from(count);
        for row in rows {
            let middle = below - 0.5;
            below -= 1.0;
            let name_at = (chart.backend_coord(&(x.range.0, middle)).0 - 12, 0);
            let at = |value: f64, up: f64| chart.backend_coord(&(within(value), middle + up));
            write(&top, &row.name, (name_at.0, at(0.0, 0.0).1), HPos::Right)?;
            if let Some(value) = row.printed {
                line(&top, vec![at(value, -0.42), at(value, 0.42)], printed.1.ink(), 3)?;
                mark(&top, at(value, 0.0), printed.1, MARK - 1)?;
            }
            // From top to bottom within the row, evenly.
            let step = 0.7 / f64::from(u32::try_from(row.values.len()).unwrap_or(1)).max(1.0);
            let mut up = 0.35 - 0.5 * step;
            for (value, (_, look)) in row.values.iter().zip(kinds) {
                let ends = [value.mean - value.half, value.mean + value.half];
                line(&top, ends.map(|end| at(end, up)).to_vec(), look.ink(), 2)?;
                mark(&top, at(value.mean, up), *look, MARK)?;
                up -= step;
            }
        }
        legend(&bottom, &names, names.len(), false)
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::{marks, words};
    use super::*;

    #[test]
    fn every_value_and_every_printed_one_is_there() {
        let value = |mean| Estimate { mean, half: 0.02, count: 5 };
        let row = |name: &str, printed| Row {
            name: name.to_owned(),
            values: vec![value(0.3), value(0.9)],
            printed,
        };
        let rows = [row("GN (spatial)", Some(0.39)), row("muster", None), row("chosen", None)];
        let kinds = [("range".to_owned(), Look::of(0)), ("net".to_owned(), Look::of(1))];
        let axis = Axis { title: "accuracy".to_owned(), range: (0.0, 1.0), decimals: 1 };
        let svg = dots(&rows, &kinds, ("paper", Look::of(6)), &axis).unwrap();
        assert_eq!(marks(&svg, Look::of(0).colour), 3 + 1);
        assert_eq!(marks(&svg, Look::of(1).colour), 3 + 1);
        assert_eq!(marks(&svg, Look::of(6).colour), 1 + 1);
        for word in ["GN (spatial)", "muster", "chosen", "range", "net", "paper", "accuracy"] {
            assert!(words(&svg).contains(word), "{word}");
        }
    }
}
