//! What Muster is to reach, and what it has reached: the first thing to read of a run.

use crate::experiments::{NOISES, PLAIN, ROBOTS, SPACES, TEAMS, over_seeds, share};
use crate::formations::Radio;
use crate::grid::described;
use crate::methods::Recipe;
use crate::results::{Page, Record};
use crate::statistics::Estimate;

/// The method that the goals are about.
const MUSTER: &str = "muster";

/// Robots of all formations in the right team.
const FORMATIONS: f64 = 0.99;

/// The same of squads and of platoons alone, and with distances that are half wrong.
const PARTS: f64 = 0.98;

/// Robots of planted fleets in the right team.
const PLANTED: f64 = 0.97;

/// One goal, with what is found.
struct Goal {
    what: String,
    wanted: f64,
    found: Estimate,
}

impl Goal {
    fn row(self) -> Vec<String> {
        let verdict = if self.found.mean >= self.wanted { "reached" } else { "missed" };
        let wanted = format!("{:.0}", 100.0 * self.wanted);
        vec![self.what, wanted, self.found.percent(), verdict.to_owned()]
    }
}

/// The goals of formations, noise, planted fleets and random systems, out of the records of a run that has
/// all of them.
#[must_use]
pub fn goals(run: &Page) -> Page {
    let mut page = Page::default();
    page.say(
        "## Goals, and what is reached",
        &format!(
            "Muster is what the services do by default: {}. Robots in the right team in percent, means over \
             held-out seeds with 95 % intervals; a goal is reached where the mean is.",
            described(&Recipe::live())
        ),
    );
    let mut all = of_formations(run);
    all.extend(of_noise(run));
    let planted = over_seeds(run, |r| r.experiment == "planted" && r.method == MUSTER);
    all.push(Goal {
        what: "planted fleets of 2 to 6 teams".to_owned(),
        wanted: PLANTED,
        found: planted,
    });
    let head = ["goal", "wanted", "found", "verdict"].map(str::to_owned);
    page.table(&head, &all.into_iter().map(Goal::row).collect::<Vec<_>>());
    page.text += &of_systems(run);
    page
}

fn of_formations(run: &Page) -> Vec<Goal> {
    let mut all = Vec::new();
    for radio in Radio::ALL.map(|radio| radio.to_string()) {
        let of = |kind: Option<&str>| {
            let is_asked = |r: &Record| {
                r.experiment == "formations"
                    && r.method == MUSTER
                    && r.condition == radio
                    && kind.is_none_or(|kind| r.case.starts_with(kind))
            };
            share(run, is_asked)
        };
        let named = |what: &str| format!("Scenario I, {radio}, {what}");
        all.push(Goal { what: named("all formations"), wanted: FORMATIONS, found: of(None) });
        for kind in ["squad", "platoon"] {
            all.push(Goal {
                what: named(&format!("{kind}s")),
                wanted: PARTS,
                found: of(Some(kind)),
            });
        }
    }
    all
}

fn of_noise(run: &Page) -> Vec<Goal> {
    let Some(most) = NOISES.last() else { return Vec::new() };
    let mut all = Vec::new();
    for radio in Radio::ALL {
        let condition = format!("{radio}, {most}");
        for kind in ["squads", "platoons"] {
            let is_asked = |r: &Record| {
                r.experiment == "noise"
                    && (r.method.as_str(), r.measure) == (MUSTER, "accuracy")
                    && (r.case.as_str(), &r.condition) == (kind, &condition)
            };
            let what = format!(
                "Scenario I, {radio}, {kind}, distances wrong by up to {:.0} %",
                100.0 * most
            );
            all.push(Goal { what, wanted: PARTS, found: over_seeds(run, is_asked) });
        }
    }
    all
}

/// In how many rows of Scenario II the silhouette in the common space is at least that of each other method.
fn of_systems(run: &Page) -> String {
    let mut others: Vec<String> = Vec::new();
    for record in run.records.iter().filter(|record| record.experiment == "systems") {
        if ![MUSTER, PLAIN].contains(&record.method.as_str()) && !others.contains(&record.method) {
            others.push(record.method.clone());
        }
    }
    let mean = |robots: usize, teams: usize, method: &str| {
        let robots = robots.to_string();
        let is_asked = |r: &Record| {
            r.experiment == "systems"
                && (r.case.as_str(), r.teams) == (robots.as_str(), teams)
                && (r.method.as_str(), r.measure) == (method, SPACES[2])
        };
        Estimate::of(&run.values(is_asked)).mean
    };
    let rows = || ROBOTS.into_iter().flat_map(|robots| TEAMS.map(|teams| (robots, teams)));
    let comparisons: Vec<String> = others
        .iter()
        .map(|other| {
            let behind = rows()
                .map(|(robots, teams)| mean(robots, teams, other) - mean(robots, teams, MUSTER));
            let behind: Vec<f64> = behind.collect();
            let ahead = behind.iter().filter(|by| **by <= 0.0).count();
            let most = behind.iter().fold(f64::NEG_INFINITY, |most, by| most.max(*by));
            if most > 0.0 {
                format!("{other} in {ahead} (behind by {most:.3} at most)")
            } else {
                format!("{other} in all")
            }
        })
        .collect();
    format!(
        "In Scenario II the silhouette in the common space should be at least that of each method on a single \
         modality and of concatenated HOPE in every one of the {} rows. It is at least that of {}. Methods that \
         split off single robots and leave the rest together, as Girvan and Newman's does, have good silhouettes \
         and no teams; accuracy is undefined where the truth is unknown.\n\n",
        rows().count(),
        comparisons.join(", of ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(experiment: &'static str, method: &str, measure: &'static str, value: f64) -> Record {
        Record {
            experiment,
            case: "10".to_owned(),
            teams: 3,
            condition: String::new(),
            method: method.to_owned(),
            seed: 1,
            measure,
            value,
        }
    }

    #[test]
    fn what_is_missed_is_said_to_be() {
        let mut run = Page::default();
        run.records.push(record("planted", MUSTER, "accuracy", 0.96));
        run.records.push(record("systems", MUSTER, SPACES[2], 0.2));
        run.records.push(record("systems", "HOPE (concatenated)", SPACES[2], 0.3));
        let text = goals(&run).text;
        assert!(
            text.contains("| planted fleets of 2 to 6 teams | 97 | 96.00 ± 0.00 | missed |"),
            "{text}"
        );
        assert!(text.contains("HOPE (concatenated) in 0 (behind by 0.100 at most)"), "{text}");
        run.records[0].value = 0.98;
        assert!(goals(&run).text.contains("98.00 ± 0.00 | reached |"));
    }
}
