//! The experiments, each a page with its numbers.

use std::collections::BTreeMap;
use std::fmt::Display;

use rayon::prelude::*;

use crate::figures;
use crate::formations::{Formation, Radio};
use crate::grid::PLANTED_TEAMS;
use crate::methods::{DivisionError, Method};
use crate::paper;
use crate::random_systems::{campus, planted};
use crate::results::{Page, Record};
use crate::scenario_one::{cases, run, run_noisy, total};
use crate::score::correct;
use crate::spaces::{Silhouettes, in_vectors};
use crate::statistics::Estimate;

/// Shows what is being done.
pub type Progress<'a> = dyn Fn(&str) + 'a;

/// Sizes and numbers of teams of Scenario II.
pub const ROBOTS: [usize; 5] = [10, 20, 30, 40, 50];
/// See [`ROBOTS`].
pub const TEAMS: [usize; 3] = [3, 4, 5];

/// Errors of distances, as shares of them.
pub const NOISES: [f64; 6] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5];

/// The three measures of silhouettes by their names in records.
pub(crate) const SPACES: [&str; 3] = ["silhouette own", "silhouette physical", "silhouette common"];

/// The silhouette of any division in the vectors of the paper's method, where the paper may have scored all.
pub(crate) const FUSED: &str = "silhouette fused";

/// The paper's method by its name in records.
pub(crate) const PLAIN: &str = "multimodal, plain";

fn texts<T: Display>(cells: &[T]) -> Vec<String> {
    cells.iter().map(ToString::to_string).collect()
}

fn of_silhouettes(found: Silhouettes) -> [(&'static str, Option<f64>); 3] {
    [(SPACES[0], found.own), (SPACES[1], found.physical), (SPACES[2], found.common)]
}

/// The mean over seeds of the mean of each seed's values that are asked for.
pub(crate) fn over_seeds(page: &Page, is_asked: impl Fn(&Record) -> bool) -> Estimate {
    let mut sums: BTreeMap<u64, (f64, f64)> = BTreeMap::new();
    for record in page.records.iter().filter(|record| is_asked(record)) {
        let (sum, count) = sums.entry(record.seed).or_default();
        *sum += record.value;
        *count += 1.0;
    }
    Estimate::of(&sums.into_values().map(|(sum, count)| sum / count).collect::<Vec<_>>())
}

/// The mean over seeds of the share of robots that are right among all that count.
pub(crate) fn share(page: &Page, is_asked: impl Fn(&Record) -> bool) -> Estimate {
    let mut sums: BTreeMap<u64, (f64, f64)> = BTreeMap::new();
    for record in page.records.iter().filter(|record| is_asked(record)) {
        let (right, total) = sums.entry(record.seed).or_default();
        match record.measure {
            "right" => *right += record.value,
            "counted" => *total += record.value,
            _ => {}
        }
    }
    Estimate::of(&sums.into_values().map(|(right, total)| right / total).collect::<Vec<_>>())
}

/// Scenario I: formations on the march, by all methods and both radios.
///
/// # Errors
/// If a method fails, or a drawing.
pub fn formations(
    formations: &[Formation],
    methods: &[Method],
    seeds: &[u64],
    progress: &Progress<'_>,
) -> anyhow::Result<Page> {
    let mut page = Page::default();
    for method in methods {
        for radio in Radio::ALL {
            progress(&format!("formations: {}, {radio}", method.name()));
            let found: Vec<Vec<_>> = seeds
                .par_iter()
                .map(|seed| run(formations, method, radio, Some(*seed)))
                .collect::<Result<_, _>>()?;
            for (seed, outcomes) in seeds.iter().zip(found) {
                for outcome in outcomes {
                    let formation = &formations[outcome.case.formation];
                    let record = |measure, value| Record {
                        experiment: "formations",
                        case: formation.name.to_owned(),
                        teams: formation.layout.teams(outcome.case.division),
                        condition: radio.to_string(),
                        method: method.name(),
                        seed: *seed,
                        measure,
                        value,
                    };
                    // Robots, so that sums over formations are those of the paper.
                    page.records.push(record("right", outcome.correct.right as f64));
                    page.records.push(record("counted", outcome.correct.total as f64));
                    for (measure, value) in of_silhouettes(outcome.silhouettes) {
                        page.records.extend(value.map(|value| record(measure, value)));
                    }
                }
            }
        }
    }
    page.say(
        "## Scenario I: formations",
        &format!(
            "Squads and platoons on the march, over {} held-out seeds of spacing and places, with 95 % intervals. \
             Robots in the right team in percent, of 306; *range*: links between all within 40 m, *net*: links \
             between all of one radio net. The paper states neither distances nor radios.",
            seeds.len()
        ),
    );
    page.plot(
        "accuracy",
        "Robots in the right team by method, with both radios, and what the paper prints",
        figures::accuracy(&page)?,
    );
    table_of_methods(&mut page, methods);
    table_of_formations(&mut page, formations, methods);
    if let Some(muster) = methods.iter().find(|method| method.name() == "muster") {
        page.plot(
            "formations",
            "The six formations, each robot in the colour of the team that Muster finds",
            figures::formations(formations, muster)?,
        );
    }
    Ok(page)
}

/// The accuracy and the silhouettes of each method, over all formations.
fn table_of_methods(page: &mut Page, methods: &[Method]) {
    let mut rows = Vec::new();
    for method in methods {
        let name = method.name();
        let printed = paper::scenario_one(&name);
        let mut row = vec![name.clone()];
        row.push(
            printed.map_or("–".to_owned(), |(accuracy, _)| format!("{:.2}", 100.0 * accuracy)),
        );
        for radio in Radio::ALL {
            let condition = radio.to_string();
            let is_asked = |r: &Record| r.method == name && r.condition == condition;
            row.push(share(page, is_asked).percent());
        }
        row.push(printed.map_or("–".to_owned(), |(_, silhouette)| format!("{silhouette:.3}")));
        for space in SPACES {
            let found = over_seeds(page, |r| r.method == name && r.measure == space);
            row.push(if found.count == 0 {
                "–".to_owned()
            } else {
                format!("{:.3}", found.mean)
            });
        }
        rows.push(row);
    }
    let head = [
        "method",
        "paper",
        "range",
        "net",
        "silhouette, paper",
        "own vectors",
        "positions",
        "common space",
    ];
    page.table(&texts(&head), &rows);
}

/// The accuracy of all methods in each formation.
fn table_of_formations(page: &mut Page, formations: &[Formation], methods: &[Method]) {
    let names: Vec<String> = methods.iter().map(Method::name).collect();
    let mut rows = Vec::new();
    for case in cases(formations) {
        let formation = &formations[case.formation];
        let teams = formation.layout.teams(case.division);
        for radio in Radio::ALL {
            let condition = radio.to_string();
            let mut row = texts(&[formation.name.to_owned(), teams.to_string(), condition.clone()]);
            for name in &names {
                let is_asked = |r: &Record| {
                    (r.case.as_str(), r.teams) == (formation.name, teams)
                        && (&r.method, &r.condition) == (name, &condition)
                };
                row.push(format!("{:.1}", 100.0 * share(page, is_asked).mean));
            }
            rows.push(row);
        }
    }
    let head = [texts(&["formation", "k", "radio"]), names].concat();
    page.table(&head, &rows);
}

/// Scenario I with distances that are wrong by up to half of them.
///
/// # Errors
/// If a method fails, or a drawing.
pub fn noise(
    formations: &[Formation],
    methods: &[Method],
    seeds: &[u64],
    progress: &Progress<'_>,
) -> anyhow::Result<Page> {
    let mut page = Page::default();
    let mut rows = Vec::new();
    for method in methods {
        for radio in Radio::ALL {
            for platoons in [false, true] {
                let kind = if platoons { "platoons" } else { "squads" };
                progress(&format!("noise: {}, {radio}, {kind}", method.name()));
                let own: Vec<Formation> =
                    formations.iter().filter(|f| f.is_platoon() == platoons).cloned().collect();
                let mut row = texts(&[method.name(), radio.to_string(), kind.to_owned()]);
                for noise in NOISES {
                    let found: Vec<Vec<_>> = seeds
                        .par_iter()
                        .map(|seed| run_noisy(&own, method, radio, noise, *seed))
                        .collect::<Result<_, _>>()?;
                    let mut shares = Vec::new();
                    for (seed, outcomes) in seeds.iter().zip(&found) {
                        let record = |measure, value| Record {
                            experiment: "noise",
                            case: kind.to_owned(),
                            teams: 0,
                            condition: format!("{radio}, {noise}"),
                            method: method.name(),
                            seed: *seed,
                            measure,
                            value,
                        };
                        let share = total(outcomes).share();
                        shares.push(share);
                        page.records.push(record("accuracy", share));
                        for outcome in outcomes {
                            for (measure, value) in of_silhouettes(outcome.silhouettes) {
                                page.records.extend(value.map(|value| record(measure, value)));
                            }
                        }
                    }
                    row.push(Estimate::of(&shares).percent());
                }
                rows.push(row);
            }
        }
    }
    page.say(
        "## Noise",
        "The same formations where every distance between robots is measured with an error of up to so much of it. \
         Robots in the right team in percent. In the paper, HOPE on the spatial graph falls from 76.47 to 61.77 on \
         squads and from 88.24 to 72.95 on platoons; the multimodal method stays at 100 on platoons.",
    );
    page.plot(
        "noise-accuracy",
        "Robots in the right team against the error of distances, squads and platoons, with both radios",
        figures::accuracy_under_noise(&page)?,
    );
    page.plot(
        "noise-silhouettes",
        "Silhouettes in the common space against the error of distances",
        figures::silhouettes_under_noise(&page)?,
    );
    let noises = NOISES.map(|noise| format!("{:.0} %", 100.0 * noise));
    page.table(&[texts(&["method", "radio", "formations"]), noises.to_vec()].concat(), &rows);
    Ok(page)
}

/// Scenario II: random systems, whose right division is unknown.
///
/// # Errors
/// If a method fails, or a drawing.
pub fn systems(methods: &[Method], seeds: &[u64], progress: &Progress<'_>) -> anyhow::Result<Page> {
    let mut page = Page::default();
    for robots in ROBOTS {
        for teams in TEAMS {
            progress(&format!("systems: {robots} robots, {teams} teams"));
            let of_seed = |seed: &u64| -> Result<Vec<Record>, DivisionError> {
                let system = campus(robots, *seed);
                let mut records = Vec::new();
                let plain = methods.iter().find(|method| method.name() == PLAIN);
                let plain = plain.map(|m| m.divide(&system, teams, *seed)).transpose()?;
                let fused = plain.and_then(|division| division.vectors);
                for method in methods {
                    let found = method.divide(&system, teams, *seed)?;
                    let in_fused = fused.as_ref().and_then(|x| in_vectors(&found.labels, x));
                    let scores = Silhouettes::of(&system, &found.labels, found.vectors.as_ref());
                    let record = |(measure, value): (&'static str, Option<f64>)| {
                        value.map(|value| Record {
                            experiment: "systems",
                            case: robots.to_string(),
                            teams,
                            condition: String::new(),
                            method: method.name(),
                            seed: *seed,
                            measure,
                            value,
                        })
                    };
                    records.extend(of_silhouettes(scores).into_iter().filter_map(record));
                    records.extend(record((FUSED, in_fused)));
                }
                Ok(records)
            };
            let found: Vec<Vec<Record>> =
                seeds.par_iter().map(of_seed).collect::<Result<_, _>>()?;
            page.records.extend(found.into_iter().flatten());
        }
    }
    page.say(
        "## Scenario II: random systems",
        &format!(
            "Robots anywhere on a campus with buildings, {} systems for each row. The mean silhouette of the \
             division in the common space, where every modality has the same say and which no method has made; in \
             brackets that in the method's own vectors, and what the paper prints.",
            seeds.len()
        ),
    );
    page.plot(
        "systems",
        "Silhouettes in the common space by number of robots, for three, four and five teams",
        figures::systems(&page)?,
    );
    table_of_systems(&mut page, methods);
    Ok(page)
}

/// The silhouettes of all methods for each size and number of teams.
fn table_of_systems(page: &mut Page, methods: &[Method]) {
    let mut rows = Vec::new();
    for robots in ROBOTS {
        for teams in TEAMS {
            let mut row = texts(&[robots, teams]);
            for method in methods {
                let name = method.name();
                let mean = |space: &str| {
                    let is_asked = |r: &Record| {
                        (r.case.as_str(), r.teams) == (robots.to_string().as_str(), teams)
                            && (r.method.as_str(), r.measure) == (name.as_str(), space)
                    };
                    let values = page.values(is_asked);
                    if values.is_empty() {
                        "–".to_owned()
                    } else {
                        format!("{:.2}", Estimate::of(&values).mean)
                    }
                };
                let printed = paper::scenario_two(robots, teams, &name);
                let printed = printed.map_or("–".to_owned(), |value| format!("{value:.2}"));
                row.push(format!("{} ({}, {printed})", mean(SPACES[2]), mean(SPACES[0])));
            }
            rows.push(row);
        }
    }
    let names: Vec<String> = methods.iter().map(Method::name).collect();
    page.table(&[texts(&["robots", "k"]), names].concat(), &rows);
}

/// Planted fleets, whose division is known.
///
/// # Errors
/// If a method fails.
pub fn planted_fleets(
    methods: &[Method],
    seeds: &[u64],
    progress: &Progress<'_>,
) -> anyhow::Result<Page> {
    let mut page = Page::default();
    let mut rows = Vec::new();
    for method in methods {
        progress(&format!("planted fleets: {}", method.name()));
        let mut row = vec![method.name()];
        let mut all = vec![0.0; seeds.len()];
        for teams in PLANTED_TEAMS {
            let of_seed = |seed: &u64| -> Result<f64, DivisionError> {
                let (system, truth) = planted(teams, *seed);
                let found = method.divide(&system, teams, *seed)?;
                Ok(correct(&found.labels, &truth).unwrap_or_default().share())
            };
            let found: Vec<f64> = seeds.par_iter().map(of_seed).collect::<Result<_, _>>()?;
            for ((seed, value), sum) in seeds.iter().zip(&found).zip(&mut all) {
                *sum += value / PLANTED_TEAMS.count() as f64;
                page.records.push(Record {
                    experiment: "planted",
                    case: String::new(),
                    teams,
                    condition: String::new(),
                    method: method.name(),
                    seed: *seed,
                    measure: "accuracy",
                    value: *value,
                });
            }
            row.push(Estimate::of(&found).percent());
        }
        row.push(Estimate::of(&all).percent());
        rows.push(row);
    }
    page.say(
        "## Planted fleets",
        "Teams of 4 to 10 robots about a middle each, some of which overlap. Robots in the right team in percent.",
    );
    let teams: Vec<String> = PLANTED_TEAMS.map(|teams| format!("{teams} teams")).collect();
    page.table(&[texts(&["method"]), teams, texts(&["all"])].concat(), &rows);
    Ok(page)
}
