//! Which plots there are, and what they show: from the numbers of a run to pictures.

use crate::experiments::{NOISES, ROBOTS, TEAMS, over_seeds, share};
use crate::formations::{Formation, Radio};
use crate::methods::{DivisionError, Method};
use crate::moving::mission::Case;
use crate::moving::plan::Curve;
use crate::moving::run::{Count, Setup};
use crate::paper;
use crate::plots::dots::{Row, dots};
use crate::plots::lines::{Panel, Point, Series, lines};
use crate::plots::map::{Map, maps};
use crate::plots::{Axis, COLOURS, Look, PlotError, Shape};
use crate::results::{Page, Record};
use crate::score::correct;
use crate::statistics::Estimate;

/// How a method is drawn everywhere: its family by colour, its modality by shape.
#[must_use]
pub fn look(method: &str) -> Look {
    let colour = match method {
        "muster" => 0,
        "HOPE (concatenated)" => 2,
        "multimodal, plain" => 3,
        _ if method.starts_with("LLE") => 4,
        _ if method.starts_with("HOPE") => 5,
        _ if method.starts_with("GN") => 6,
        _ => 7,
    };
    let shape = match method {
        "multimodal, plain" => Shape::Diamond,
        "HOPE (concatenated)" => Shape::Wedge,
        _ if method.ends_with("(connectivity)") => Shape::Triangle,
        _ if method.ends_with("(hierarchy)") => Shape::Square,
        _ => Shape::Disc,
    };
    Look { colour: COLOURS[colour], shape }
}

fn axis(title: &str, range: (f64, f64), decimals: usize) -> Axis {
    Axis { title: title.to_owned(), range, decimals }
}

fn percent(of: Estimate) -> Estimate {
    Estimate { mean: 100.0 * of.mean, half: 100.0 * of.half, ..of }
}

/// The names of all methods of an experiment, in the order of its records.
fn methods(page: &Page) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for record in &page.records {
        if !names.contains(&record.method) {
            names.push(record.method.clone());
        }
    }
    names
}

/// An axis that holds all points, in tenths.
fn tenths(title: &str, panels: &[Panel]) -> Axis {
    let points = panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.points);
    let (low, high) = points.fold((0.0_f64, 0.1_f64), |(low, high), point| {
        (low.min(point.y - point.half), high.max(point.y + point.half))
    });
    axis(title, ((10.0 * low).floor() / 10.0, (10.0 * high).ceil() / 10.0), 1)
}

/// Scenario I: robots in the right team by method, with both radios and what the paper prints.
///
/// # Errors
/// If the drawing fails.
pub fn accuracy(page: &Page) -> Result<String, PlotError> {
    let row = |name: String| {
        let of_radio = |radio: Radio| {
            let condition = radio.to_string();
            percent(share(page, |r| r.method == name && r.condition == condition))
        };
        let printed = paper::scenario_one(&name).map(|(accuracy, _)| 100.0 * accuracy);
        Row { values: Radio::ALL.map(of_radio).to_vec(), printed, name }
    };
    let rows: Vec<Row> = methods(page).into_iter().map(row).collect();
    let kinds = [
        ("radio: all within range".to_owned(), Look { colour: COLOURS[0], shape: Shape::Disc }),
        ("radio: all of a net".to_owned(), Look { colour: COLOURS[1], shape: Shape::Square }),
    ];
    let printed = ("printed in the paper", Look { colour: COLOURS[6], shape: Shape::Diamond });
    dots(&rows, &kinds, printed, &axis("robots in the right team, %", (0.0, 100.0), 0))
}

/// Panels of squads and platoons with both radios, by noise.
fn noise_panels(page: &Page, measure: &str, factor: f64) -> Vec<Panel> {
    let mut panels = Vec::new();
    for (radio, words) in Radio::ALL.into_iter().zip(["all within range", "all of a net"]) {
        for kind in ["squads", "platoons"] {
            let series = |name: String| {
                let point = |noise: f64| {
                    let condition = format!("{radio}, {noise}");
                    let found = over_seeds(page, |r| {
                        (r.case.as_str(), r.measure) == (kind, measure)
                            && (&r.method, &r.condition) == (&name, &condition)
                    });
                    Point { x: 100.0 * noise, y: factor * found.mean, half: factor * found.half }
                };
                let points = NOISES.map(point).to_vec();
                Series { look: look(&name), points, name }
            };
            let series = methods(page).into_iter().map(series).collect();
            panels.push(Panel { title: format!("{kind}, radio: {words}"), series });
        }
    }
    panels
}

/// The error of distances as an axis.
fn noise_axis() -> Axis {
    axis("error of distances, %", (0.0, 100.0 * NOISES[NOISES.len() - 1]), 0)
}

/// Robots in the right team against the noise of distances.
///
/// # Errors
/// If the drawing fails.
pub fn accuracy_under_noise(page: &Page) -> Result<String, PlotError> {
    let panels = noise_panels(page, "accuracy", 100.0);
    let points = panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.points);
    let least = points.fold(100.0_f64, |least, point| least.min(point.y - point.half));
    let from = 10.0 * (0.1 * least).floor();
    lines(&panels, 2, &noise_axis(), &axis("robots in the right team, %", (from, 100.0), 0))
}

/// Silhouettes in the common space against the noise of distances.
///
/// # Errors
/// If the drawing fails.
pub fn silhouettes_under_noise(page: &Page) -> Result<String, PlotError> {
    let panels = noise_panels(page, "silhouette common", 1.0);
    lines(&panels, 2, &noise_axis(), &tenths("silhouette, common space", &panels))
}

/// Of so many comparisons of a mission one is drawn: two in a second.
const DRAWN: usize = 5;

/// Scenario III: robots of the teams concerned that are in the right team, over time, where teams change and all
/// reports are right, with radios by range.
///
/// # Errors
/// If the drawing fails.
pub fn missions(curves: &[Curve]) -> Result<String, PlotError> {
    let panel = |case: Case| {
        let of_case = |curve: &&Curve| {
            let Setup { case: of, radio, fault, count, .. } = curve.setup;
            (of, radio, fault, count) == (case, Radio::Range, None, Count::Chosen)
        };
        let shapes = [Shape::Disc, Shape::Square, Shape::Triangle, Shape::Diamond, Shape::Wedge];
        let series = |(at, curve): (usize, &Curve)| {
            let drawn = curve.points.iter().step_by(DRAWN);
            Series {
                name: format!("{} robots", curve.setup.robots),
                look: Look {
                    colour: COLOURS[at % COLOURS.len()],
                    shape: shapes[at % shapes.len()],
                },
                points: drawn
                    .map(|point| Point { x: point.t, y: 100.0 * point.involved, half: 0.0 })
                    .collect(),
            }
        };
        let series = curves.iter().filter(of_case).enumerate().map(series).collect();
        Panel { title: case.to_string(), series }
    };
    let panels = [Case::Split, Case::Regroup].map(panel);
    let lasts = Case::Split.lasts_s().max(Case::Regroup.lasts_s());
    let seconds = axis("seconds", (0.0, lasts), 0);
    lines(&panels, 2, &seconds, &axis("involved robots in the right team, %", (0.0, 100.0), 0))
}

/// Scenario II: silhouettes in the common space by number of robots, for the methods of the paper's table and
/// those of all modalities.
///
/// # Errors
/// If the drawing fails.
#[expect(clippy::cast_precision_loss, reason = "there are a few dozen robots")]
pub fn systems(page: &Page) -> Result<String, PlotError> {
    let is_shown = |name: &String| {
        paper::scenario_two(ROBOTS[0], TEAMS[0], name).is_some() || !name.contains('(')
    };
    let panel = |teams: usize| {
        let series = |name: String| {
            let point = |robots: usize| {
                let case = robots.to_string();
                let is_asked = |r: &Record| {
                    (r.teams, r.measure) == (teams, "silhouette common")
                        && (&r.method, &r.case) == (&name, &case)
                };
                let found = Estimate::of(&page.values(is_asked));
                Point { x: robots as f64, y: found.mean, half: found.half }
            };
            Series { look: look(&name), points: ROBOTS.map(point).to_vec(), name }
        };
        let series = methods(page).into_iter().filter(is_shown).map(series).collect();
        Panel { title: format!("{teams} teams"), series }
    };
    let panels = TEAMS.map(panel);
    let ends = (ROBOTS[0] as f64 - 2.0, ROBOTS[ROBOTS.len() - 1] as f64 + 2.0);
    let y = tenths("silhouette, common space", &panels);
    lines(&panels, panels.len(), &axis("robots", ends, 0), &y)
}

/// Why there is no picture of a fleet.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// No method divides it.
    #[error(transparent)]
    Division(#[from] DivisionError),
    /// It cannot be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
}

/// All formations as their files have them, with links between all within range, each divided by a method into the
/// teams of its finest division.
///
/// # Errors
/// If the method fails, or the drawing.
pub fn formations(formations: &[Formation], method: &Method) -> Result<String, PictureError> {
    let mut pictures = Vec::new();
    let mut most = 0;
    for formation in formations {
        let layout = &formation.layout;
        let finest = layout.divisions.len() - 1;
        let (teams, system) = (layout.teams(finest), formation.drawn(Radio::Range));
        let labels = method.divide(&system, teams, 0)?.labels;
        // Both name the robots of the formation.
        let found = correct(&labels, &layout.divisions[finest]).unwrap_or_default();
        most = most.max(teams);
        pictures.push(Map {
            title: format!(
                "{}, {teams} teams: {} of {} right",
                formation.name.replace('-', " "),
                found.right,
                found.total
            ),
            places: layout.places.clone(),
            teams: labels.into_iter().map(Some).collect(),
            leaders: leaders(&layout.superiors),
            command: command(&layout.superiors),
            ..Map::default()
        });
    }
    let names = team_names(most);
    Ok(maps(
        &pictures,
        3,
        &names,
        "rings: robots that command others; lines: robots and their superiors",
    )?)
}

/// The legend of so many teams.
pub(crate) fn team_names(teams: usize) -> Vec<String> {
    (1..=teams).map(|team| format!("team {team}")).collect()
}

/// Which robots command others.
pub(crate) fn leaders(superiors: &[Option<usize>]) -> Vec<bool> {
    (0..superiors.len()).map(|robot| superiors.contains(&Some(robot))).collect()
}

/// Pairs of robots and superiors.
pub(crate) fn command(superiors: &[Option<usize>]) -> Vec<(usize, usize)> {
    let pairs = superiors.iter().enumerate();
    pairs.filter_map(|(robot, superior)| Some((robot, (*superior)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::Recipe;
    use crate::plots::tests::{marks, words};

    fn record(measure: &'static str, value: f64) -> Record {
        Record {
            experiment: "any",
            case: "squads".to_owned(),
            teams: 3,
            condition: "range".to_owned(),
            method: "muster".to_owned(),
            seed: 1,
            measure,
            value,
        }
    }

    #[test]
    fn methods_of_the_tables_look_different() {
        let names: Vec<String> = Method::all().iter().map(Method::name).collect();
        for (at, name) in names.iter().enumerate() {
            for other in &names[at + 1..] {
                assert_ne!(look(name), look(other), "{name}, {other}");
            }
        }
    }

    #[test]
    fn all_robots_of_all_formations_are_in_the_picture() {
        let all = Formation::all().unwrap();
        let method = Method::Multimodal("muster", Box::new(Recipe::live()));
        let svg = formations(&all, &method).unwrap();
        let robots: usize = all.iter().map(|formation| formation.layout.robots.len()).sum();
        let drawn: usize = (0..5).map(|team| marks(&svg, Look::of(team).colour)).sum();
        assert_eq!(drawn, robots + 5);
        assert!(words(&svg).contains("squad column, 3 teams: "));
    }

    #[test]
    fn numbers_become_marks() {
        let records = vec![record("right", 7.0), record("counted", 8.0)];
        let mut page = Page { records, ..Page::default() };
        let mut net = page.records.clone();
        net.iter_mut().for_each(|record| record.condition = "net".to_owned());
        page.records.extend(net);
        let svg = accuracy(&page).unwrap();
        assert_eq!([0, 1].map(|colour| marks(&svg, COLOURS[colour])), [2, 2]);

        page.records.clear();
        for (radio, kind) in
            [("range", "squads"), ("net", "squads"), ("range", "platoons"), ("net", "platoons")]
        {
            for noise in NOISES {
                for measure in ["accuracy", "silhouette common"] {
                    let condition = format!("{radio}, {noise}");
                    page.records.push(Record {
                        case: kind.to_owned(),
                        condition,
                        ..record(measure, 0.5)
                    });
                }
            }
        }
        for svg in [accuracy_under_noise(&page).unwrap(), silhouettes_under_noise(&page).unwrap()] {
            assert_eq!(marks(&svg, look("muster").colour), 4 * NOISES.len() + 1);
        }

        page.records.clear();
        for (robots, teams) in
            ROBOTS.into_iter().flat_map(|robots| TEAMS.map(|teams| (robots, teams)))
        {
            let case = robots.to_string();
            page.records.push(Record { case, teams, ..record("silhouette common", 0.2) });
        }
        let svg = systems(&page).unwrap();
        assert_eq!(marks(&svg, look("muster").colour), 15 + 1);
    }
}
