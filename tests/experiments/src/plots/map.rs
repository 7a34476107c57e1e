//! Fleets from above, each robot in the colour of its team.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{
    Area, INK, LEGEND_LINE, Look, PlotError, drawn, legend, legend_height, line, mark, signed,
    write,
};

/// Size of the picture of one fleet in pixels, and what is left free at its sides.
const PANEL: (u32, u32) = (440, 400);
const MARGIN: i32 = 34;

/// Half of the width of a robot in pixels.
const ROBOT: i32 = 7;

/// A fleet from above.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Map {
    /// What is to be seen.
    pub title: String,
    /// Metres east and north of each robot.
    pub places: Vec<[f64; 2]>,
    /// The team of each robot; none for robots without.
    pub teams: Vec<Option<usize>>,
    /// Robots with a ring, which command others.
    pub leaders: Vec<bool>,
    /// Pairs of robots that a solid line joins: robot and superior.
    pub command: Vec<(usize, usize)>,
    /// Pairs of robots that a thin pale line joins: radio links.
    pub links: Vec<(usize, usize)>,
    /// Whether teams have boxes about them.
    pub boxes: bool,
}

/// From metres to pixels: as large as it fits, the same along both axes.
struct Scale {
    middle: [f64; 2],
    pixels_per_metre: f64,
}

impl Scale {
    fn of(places: &[[f64; 2]]) -> Self {
        let ends = [0, 1].map(|axis| {
            let along = places.iter().map(|at| at[axis]);
            along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            })
        });
        let room =
            [PANEL.0, PANEL.1 - LEGEND_LINE].map(|pixels| f64::from(signed(pixels) - 2 * MARGIN));
        let fit = |axis: usize| room[axis] / (ends[axis].1 - ends[axis].0).max(1e-9);
        Self {
            middle: ends.map(|(low, high)| 0.5 * (low + high)),
            pixels_per_metre: fit(0).min(fit(1)),
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "pixels of a panel are few")]
    fn at(&self, place: [f64; 2]) -> (i32, i32) {
        let off = [0, 1]
            .map(|axis| ((place[axis] - self.middle[axis]) * self.pixels_per_metre).round() as i32);
        let centre = (signed(PANEL.0) / 2, signed(PANEL.1 + LEGEND_LINE) / 2);
        (centre.0 + off[0], centre.1 - off[1])
    }
}

/// Draws fleets side by side, `columns` in a row, over a legend of the teams by their names and a line
/// that says what else is drawn.
///
/// # Errors
/// If the drawing fails.
pub fn maps(
    maps: &[Map],
    columns: usize,
    teams: &[String],
    note: &str,
) -> Result<String, PlotError> {
    let columns = columns.clamp(1, maps.len().max(1));
    let rows = maps.len().div_ceil(columns);
    let wide = u32::try_from(columns).unwrap_or(1) * PANEL.0;
    let high = u32::try_from(rows).unwrap_or(1) * PANEL.1;
    let names: Vec<(String, Look)> =
        teams.iter().enumerate().map(|(team, name)| (name.clone(), Look::of(team))).collect();
    let of_legend = legend_height(names.len(), names.len());
    drawn((wide, high + of_legend + LEGEND_LINE), |area| {
        let (top, bottom) = area.split_vertically(high);
        for (map, area) in maps.iter().zip(top.split_evenly((rows, columns))) {
            draw(&area, map)?;
        }
        let (teams, said) = bottom.split_vertically(of_legend);
        legend(&teams, &names, names.len(), false)?;
        write(&said, note, (14, signed(LEGEND_LINE) / 2 - 4), HPos::Left)
    })
}

fn draw(area: &Area<'_>, map: &Map) -> Result<(), PlotError> {
    let scale = Scale::of(&map.places);
    let at: Vec<(i32, i32)> = map.places.iter().map(|place| scale.at(*place)).collect();
    write(area, &map.title, (signed(PANEL.0) / 2, signed(LEGEND_LINE) / 2 + 2), HPos::Center)?;
    let pairs = |pairs: &[(usize, usize)], colour: RGBColor, width: u32| -> Result<(), PlotError> {
        for &(from, to) in pairs {
            line(area, vec![at[from], at[to]], colour, width)?;
        }
        Ok(())
    };
    pairs(&map.links, RGBColor(205, 215, 225), 1)?;
    pairs(&map.command, RGBColor(120, 120, 120), 2)?;
    let teams = map.teams.iter().flatten().max().map_or(0, |team| team + 1);
    for team in (0..teams).filter(|_| map.boxes) {
        let members = at.iter().zip(&map.teams).filter(|(_, of)| **of == Some(team));
        let members: Vec<(i32, i32)> = members.map(|(at, _)| *at).collect();
        let (xs, ys) = (members.iter().map(|at| at.0), members.iter().map(|at| at.1));
        if let (Some(left), Some(right), Some(high), Some(low)) =
            (xs.clone().min(), xs.max(), ys.clone().min(), ys.max())
        {
            let free = 2 * ROBOT + 2;
            let corners = [(left - free, high - free), (right + free, low + free)];
            let style = Look::of(team).ink().stroke_width(2);
            area.draw(&Rectangle::new(corners, style))?;
        }
    }
    for (robot, place) in at.iter().enumerate() {
        match map.teams.get(robot).copied().flatten() {
            Some(team) => mark(area, *place, Look::of(team), ROBOT)?,
            None => area.draw(&Circle::new(*place, ROBOT, INK.stroke_width(1)))?,
        }
        if map.leaders.get(robot) == Some(&true) {
            area.draw(&Circle::new(*place, ROBOT + 5, INK.stroke_width(2)))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{marks, words};
    use super::*;

    #[test]
    fn every_robot_is_where_it_stands_and_in_its_team() {
        let map = Map {
            title: "a wedge".to_owned(),
            places: vec![[0.0, 0.0], [10.0, 0.0], [5.0, 5.0], [0.0, 1.0]],
            teams: vec![Some(0), Some(1), Some(0), None],
            leaders: vec![true, false, false, false],
            command: vec![(0, 1)],
            links: vec![(1, 2)],
            boxes: true,
        };
        let names = ["first".to_owned(), "second".to_owned()];
        let svg = maps(&[map.clone(), map.clone()], 2, &names, "rings: leaders").unwrap();
        assert_eq!(marks(&svg, Look::of(0).colour), 2 * 2 + 1);
        assert_eq!(marks(&svg, Look::of(1).colour), 2 + 1);
        for word in ["a wedge", "first", "second", "rings"] {
            assert!(words(&svg).contains(word), "{word}");
        }
        let scale = Scale::of(&map.places);
        let [west, east, north] = [0, 1, 2].map(|robot| scale.at(map.places[robot]));
        assert!(west.0 < north.0 && north.0 < east.0 && north.1 < west.1 && west.1 == east.1);
    }

    #[test]
    fn robots_in_one_place_are_drawn_too() {
        let map = Map { places: vec![[3.0, 3.0]; 2], teams: vec![Some(0); 2], ..Map::default() };
        assert_eq!(marks(&maps(&[map], 1, &[], "").unwrap(), Look::of(0).colour), 2);
    }
}
