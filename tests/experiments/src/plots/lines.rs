//! Panels of lines over the same axes, with intervals.

use plotters::prelude::*;

use super::{
    Area, Axis, INK, Look, MARK, PlotError, TEXT, drawn, font, legend, legend_height, line, mark,
};

/// Size of one panel in pixels.
const PANEL: (u32, u32) = (480, 360);

/// A point of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Along the horizontal axis.
    pub x: f64,
    /// Along the vertical axis.
    pub y: f64,
    /// Half of the interval about `y`.
    pub half: f64,
}

/// A line.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// What it is of.
    pub name: String,
    /// How it is drawn, the same in all panels.
    pub look: Look,
    /// From left to right.
    pub points: Vec<Point>,
}

/// Lines over the same axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What differs from other panels.
    pub title: String,
    /// The lines.
    pub series: Vec<Series>,
}

/// Draws panels side by side, `columns` in a row, over a legend of all lines.
///
/// # Errors
/// If the drawing fails.
pub fn lines(panels: &[Panel], columns: usize, x: &Axis, y: &Axis) -> Result<String, PlotError> {
    let mut names: Vec<(String, Look)> = Vec::new();
    for series in panels.iter().flat_map(|panel| &panel.series) {
        if !names.iter().any(|(name, _)| *name == series.name) {
            names.push((series.name.clone(), series.look));
        }
    }
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let wide = u32::try_from(columns).unwrap_or(1) * PANEL.0;
    let high = u32::try_from(rows).unwrap_or(1) * PANEL.1;
    let of_legend = usize::try_from(wide / 230).unwrap_or(1);
    let size = (wide, high + legend_height(names.len(), of_legend));
    drawn(size, |area| {
        let (top, bottom) = area.split_vertically(high);
        for (panel, area) in panels.iter().zip(top.split_evenly((rows, columns))) {
            draw(&area, &top, panel, x, y)?;
        }
        legend(&bottom, &names, of_legend, true)
    })
}

/// Draws a panel in its area; marks at coordinates of the chart are drawn in pixels of the whole.
fn draw(
    area: &Area<'_>,
    whole: &Area<'_>,
    panel: &Panel,
    x: &Axis,
    y: &Axis,
) -> Result<(), PlotError> {
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .caption(&panel.title, font())
        .x_label_area_size(48)
        .y_label_area_size(66)
        .build_cartesian_2d(x.range.0..x.range.1, y.range.0..y.range.1)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .axis_style(INK)
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|value| x.label(*value))
        .y_label_formatter(&|value| y.label(*value))
        .label_style(("sans-serif", TEXT - 2).into_font().color(&INK))
        .axis_desc_style(font())
        .x_desc(&x.title)
        .y_desc(&y.title)
        .draw()?;
    let within = |value: f64| value.clamp(y.range.0, y.range.1);
    for series in &panel.series {
        let at = |x: f64, y: f64| chart.backend_coord(&(x, within(y)));
        let path: Vec<_> = series.points.iter().map(|point| at(point.x, point.y)).collect();
        for point in series.points.iter().filter(|point| point.half > 0.0) {
            let ends = [point.y - point.half, point.y + point.half].map(|end| at(point.x, end));
            line(whole, ends.to_vec(), series.look.ink(), 1)?;
        }
        line(whole, path.clone(), series.look.ink(), 2)?;
        for place in path {
            mark(whole, place, series.look, MARK)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{marks, words};
    use super::*;

    #[test]
    fn all_points_of_all_panels_are_there_and_each_line_is_named_once() {
        let series = |number: usize, count: usize| Series {
            name: format!("method {number}"),
            look: Look::of(number),
            points: (0..count).map(|x| Point { x: x as f64, y: 0.5, half: 0.1 }).collect(),
        };
        let panels = [
            Panel { title: "squads".to_owned(), series: vec![series(0, 4), series(1, 3)] },
            Panel { title: "platoons".to_owned(), series: vec![series(0, 2)] },
        ];
        let axis =
            |title: &str, end| Axis { title: title.to_owned(), range: (0.0, end), decimals: 1 };
        let svg = lines(&panels, 2, &axis("noise", 4.0), &axis("accuracy", 1.0)).unwrap();
        // One more of each in the legend.
        assert_eq!(marks(&svg, Look::of(0).colour), 4 + 2 + 1);
        assert_eq!(marks(&svg, Look::of(1).colour), 3 + 1);
        let words = words(&svg);
        for word in ["squads", "platoons", "noise", "accuracy"] {
            assert!(words.contains(word), "{words}");
        }
        assert_eq!(words.matches("method 0").count(), 1);
    }
}
