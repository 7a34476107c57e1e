//! The page of Scenario III.

use super::faults::{Fault, Sense};
use super::measures::{Outcome, Sample};
use super::mission::Case;
use super::plan::{FAULTY_CASES, Tried, condition, planned, tried};
use crate::experiments::Progress;
use crate::figures;
use crate::results::{Page, Record};
use crate::statistics::Estimate;

/// What is measured and how.
const DEFINITIONS: &str = "\
Robots report to the four services, whose cores run in virtual time with default settings and the true number of \
teams; messages arrive and jobs end at once, so that times are those of the method at 10 Hz and not of a host. \
Teams of squads march side by side, 20 m from each other, squads 10 m, robots 6 m, all swaying about their places \
by up to 2 + 1 + 0.5 m, at 10 poses (0.15 m of noise along each axis), 2 reports of links (qualities wrong by up to \
0.1) and 1 of ranks a second, and ranks at once when they change. Radios reach 40 m (range) or those who command and \
obey each other and their peers (net).\n\n\
*rest*: no robot moves, distances of neighbours have a standard error of 10 %. *march*: nothing changes. *split*: at \
8 s less than half of a team answers to a leader of its own and falls back at 1.75 m/s, and the operator asks for \
one team more; at 18 s it answers to its old leader again, closes up, and the operator asks for one team less. \
*regroup*: at 8 s a part splits off likewise while another team joins a third, whose leader its units now answer \
to; at 18 s all goes back. The number of teams stays. *losses*: a tenth of the radios fails from 8 to 14 s, and a \
tenth of the robots falls silent at 18 s; their deputies take over.\n\n\
The truth changes at the moment of the order, when hierarchy (and net) change and robots set out: positions do \
not show it yet. Accuracy is the share of robots in the right team by the best matching, 10 times a second from \
3 s on; *settled* leaves out the 2 s behind each change of the truth; *involved* is that of the robots of the teams \
that the mission changes. A change is followed at the first comparison from which on, for a second, at least 95 % \
of all robots and 95 % of those involved are in the right team; *in time* is within 2 s. Needless changes are those \
of a robot's team id beyond the number of times that the truth moves it, per robot and minute.";

/// Runs all missions on held-out seeds and writes their page.
///
/// # Errors
/// If a mission has no outcome.
pub fn moving(quick: bool, seeds: &[u64], progress: &Progress<'_>) -> anyhow::Result<Page> {
    let mut all = Vec::new();
    for planned in planned(quick) {
        all.push(tried(&planned, seeds, progress)?);
    }
    let mut page = Page::default();
    page.say("## Scenario III: fleets that move", DEFINITIONS);
    let curves: Vec<_> = all.iter().map(Tried::curve).collect();
    page.plot(
        "missions",
        "Robots of the teams that a mission changes that are in the right team, over time, by size of the fleet",
        figures::missions(&curves)?,
    );
    whole(&mut page, &all);
    faulty(&mut page, &all);
    goals(&mut page, &all);
    for tried in &all {
        record(&mut page, tried);
    }
    Ok(page)
}

fn settled(outcome: &Outcome) -> f64 {
    outcome.settled_mean(|sample| sample.accuracy)
}

/// Seconds to follow a change and how often that was in time; nothing where nothing changes.
fn following(tried: &Tried, change: usize) -> String {
    if tried.outcomes.iter().all(|(_, outcome)| outcome.followings.len() <= change) {
        return String::new();
    }
    let took: Vec<f64> = tried.took_s(change).into_iter().flatten().collect();
    let in_time = format!("{:.0} % in time", 100.0 * tried.in_time(change));
    if took.is_empty() {
        return format!("never; {in_time}");
    }
    let missed = tried.outcomes.len() - took.len();
    let missed = if missed > 0 { format!(", {missed} never") } else { String::new() };
    format!("{} s{missed}; {in_time}", Estimate::of(&took).plain())
}

/// What fleets live through whose reports are right.
fn whole(page: &mut Page, all: &[Tried]) {
    page.say("### Without faults", "Means over seeds with their 95 % intervals.");
    let head = [
        "robots",
        "teams",
        "mission",
        "radio",
        "seeds",
        "accuracy in %",
        "settled",
        "settled, involved",
        "adjusted Rand index",
        "needless changes per robot and minute",
        "first change followed in",
        "way back followed in",
    ];
    let row = |tried: &Tried| {
        let percent =
            |number: &dyn Fn(&Outcome) -> f64| Estimate::of(&tried.each(number)).percent();
        vec![
            tried.setup.robots.to_string(),
            tried.setup.teams.to_string(),
            tried.setup.case.to_string(),
            condition(&tried.setup),
            tried.outcomes.len().to_string(),
            percent(&|outcome| outcome.mean(|sample| sample.accuracy)),
            percent(&settled),
            percent(&|outcome| outcome.settled_mean(|sample| sample.involved)),
            Estimate::of(&tried.each(|outcome| outcome.settled_mean(|sample| sample.rand))).plain(),
            Estimate::of(&tried.each(|outcome| outcome.needless_rate)).plain(),
            following(tried, 0),
            following(tried, 1),
        ]
    };
    let rows: Vec<_> = all.iter().filter(|tried| tried.setup.fault.is_none()).map(row).collect();
    page.table(&head.map(str::to_owned), &rows);
}

/// The same where one kind of reports is wrong.
fn faulty(page: &mut Page, all: &[Tried]) {
    page.say(
        "### With one modality at fault",
        "Settled accuracy in %, radio by range. *lost*: no robot reports it. *wrong*: every robot reports what is true \
         of another robot, always the same one. *delayed*: everything is reported 2 s late. Without hierarchy, a \
         split shows in the growing distance alone.",
    );
    let mut head = vec!["robots".to_owned(), "mission".to_owned(), "modality".to_owned()];
    head.extend(Fault::ALL.map(|fault| fault.to_string()));
    head.extend(Fault::ALL.map(|fault| format!("split followed when {fault}")));
    let mut rows = Vec::new();
    let mut sizes: Vec<usize> = all.iter().map(|tried| tried.setup.robots).collect();
    sizes.dedup();
    for robots in sizes {
        for case in FAULTY_CASES {
            for sense in Sense::ALL {
                let of = |fault| {
                    all.iter().find(move |tried| {
                        let setup = tried.setup;
                        (setup.robots, setup.case) == (robots, case)
                            && setup.fault == Some((sense, fault))
                    })
                };
                let Some(found) = Fault::ALL.into_iter().map(of).collect::<Option<Vec<&Tried>>>()
                else {
                    continue;
                };
                let mut row = vec![robots.to_string(), case.to_string(), sense.to_string()];
                row.extend(found.iter().map(|t| Estimate::of(&t.each(settled)).percent()));
                row.extend(found.iter().map(|tried| following(tried, 0)));
                rows.push(row);
            }
        }
    }
    page.table(&head, &rows);
}

/// Whether the goals are reached.
fn goals(page: &mut Page, all: &[Tried]) {
    let verdict = |is_reached: bool| if is_reached { "reached" } else { "missed" }.to_owned();
    let mut rows = Vec::new();
    for tried in all {
        let setup = tried.setup;
        let of = format!("{} robots, {}, {}", setup.robots, setup.case, condition(&setup));
        let (goal, found, is_reached) = match (setup.case, setup.fault) {
            (Case::Split | Case::Regroup, None) => {
                let share = tried.in_time(0);
                ("a split is followed within 2 s", following(tried, 0), share >= 1.0)
            }
            (Case::Rest, None) => {
                let needless: usize = tried.outcomes.iter().map(|(_, o)| o.needless).sum();
                ("no robot changes team at rest", format!("{needless} changes"), needless == 0)
            }
            (_, Some((_, Fault::Lost))) => {
                let share = Estimate::of(&tried.each(settled));
                ("accuracy of 95 % with a modality lost", share.percent(), share.mean >= 0.95)
            }
            _ => continue,
        };
        rows.push(vec![goal.to_owned(), of, found, verdict(is_reached)]);
    }
    page.say(
        "### Goals",
        "A goal is reached where it is on every seed, that of the accuracy where it is in the mean.",
    );
    page.table(&["goal", "of", "found", "verdict"].map(str::to_owned), &rows);
}

fn record(page: &mut Page, tried: &Tried) {
    let setup = tried.setup;
    for (seed, outcome) in &tried.outcomes {
        let mut add = |measure, value| {
            page.records.push(Record {
                experiment: "moving",
                case: format!("{} robots, {}", setup.robots, setup.case),
                teams: setup.teams,
                condition: condition(&setup),
                method: "muster".to_owned(),
                seed: *seed,
                measure,
                value,
            });
        };
        let settled = |number: fn(&Sample) -> f64| outcome.settled_mean(number);
        add("accuracy", outcome.mean(|sample| sample.accuracy));
        add("settled accuracy", settled(|sample| sample.accuracy));
        add("settled accuracy of those involved", settled(|sample| sample.involved));
        add("settled adjusted rand index", settled(|sample| sample.rand));
        add("silhouette", outcome.mean(|sample| sample.silhouette.unwrap_or(0.0)));
        add("needless changes per robot and minute", outcome.needless_rate);
        add("changes of the dimension", outcome.dimension_changes() as f64);
        let names = ["first change followed after s", "way back followed after s"];
        for (measure, following) in names.into_iter().zip(&outcome.followings) {
            // What is never followed counts as infinite: left out, it would improve the mean.
            add(measure, following.took_s.unwrap_or(f64::INFINITY));
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use crate::formations::Radio;
    use crate::moving::plan::Planned;
    use crate::moving::run::{Count, Setup};
    use crate::seeds::TRAINING;

    #[test]
    fn every_mission_has_its_row_and_its_records() {
        let setup =
            Setup { robots: 48, teams: 4, case: Case::Split, radio: Radio::Range, fault: None, count: Count::Chosen };
        let seeds: Vec<u64> = TRAINING.take(2).collect();
        let found = tried(&Planned { setup, seeds: 2 }, &seeds, &|_| ()).unwrap();
        let mut page = Page::default();
        whole(&mut page, std::slice::from_ref(&found));
        goals(&mut page, std::slice::from_ref(&found));
        record(&mut page, &found);
        assert_eq!(page.text.matches("| 48 | 4 | split |").count(), 1);
        assert_eq!(page.text.matches("a split is followed within 2 s").count(), 1);
        assert_eq!(page.values(|record| record.measure == "accuracy").len(), 2);
        assert_eq!(page.values(|record| record.measure.contains("followed")).len(), 4);
        let curve = found.curve();
        assert_eq!(curve.points.len(), 280);
        assert!(curve.points.iter().all(|point| (0.0..=1.0).contains(&point.accuracy)));
    }
}
