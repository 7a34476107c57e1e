//! The page: kinds, accuracy by kind, where Muster loses, and the number of teams.

use std::fmt::Write as _;

use super::goals::goals;
use super::kinds::{Kind, List};
use super::run::{Divider, Outcome, Score};
use super::steps::Worth;
use crate::plots::dots::{Row, dots};
use crate::plots::{Axis, Look, PlotError};
use crate::results::{Page, Record};
use crate::statistics::Estimate;

/// By how much, as a share of the robots, Muster must be worse before a kind is named as lost.
const LOSS: f64 = 0.01;

/// What stands in a table where a method has nothing to work on.
const NOTHING: &str = "–";

/// What the page says before its tables.
const BEFORE: &str = "Written by `tests/peers/divide`. Each *kind* is a family of fleets whose true teams are \
    known; a seed draws one of it. Muster runs with its defaults, as `muster solve` does on observations. The \
    others run by their usual libraries on the same observations:\n\n\
    - *spectral*: `sklearn.cluster.SpectralClustering` (Ng, Jordan and Weiss 2001) of the plain sum of the three \
    graphs, each symmetric and divided by its largest weight. The spatial graph is the one that Muster makes.\n\
    - *Leiden with k*: multiplex Leiden (`leidenalg`, a layer for each graph) at the resolution, found in at most \
    40 steps, that gives the number of teams or comes nearest to it. *Leiden*: the same at resolution 1, without \
    the number.\n\
    - *k-means on positions*: `sklearn.cluster.KMeans`, ten starts.\n\
    - *tree of command*: the ties nearest the top are cut until there are as many parts as teams.\n\
    - *the paper's method*: to the letter, with distances as 1/d.\n\n\
    A robot that a method puts into no team is wrong. A modality that no robot reports is absent, and a method \
    that needs it has nothing to work on (–). *Best other* is the best of them all on that kind, which nobody \
    knows beforehand.";

/// The outcomes of one kind.
pub(super) struct OfKind<'a> {
    pub(super) kind: &'static Kind,
    pub(super) outcomes: Vec<&'a Outcome>,
}

impl<'a> OfKind<'a> {
    /// The kinds of a list that were run.
    pub(super) fn all(list: List, outcomes: &'a [Outcome]) -> Vec<Self> {
        let of_kind = |kind: &'static Kind| {
            let outcomes = outcomes.iter().filter(|outcome| outcome.case.kind.name == kind.name);
            Self { kind, outcomes: outcomes.collect() }
        };
        list.kinds().iter().map(of_kind).filter(|kind| !kind.outcomes.is_empty()).collect()
    }

    /// A number of each seed on which a method has something to work on.
    pub(super) fn values(&self, divider: Divider, of: impl Fn(&Score) -> f64) -> Vec<f64> {
        let scores = self.outcomes.iter().filter_map(|outcome| outcome.score(divider));
        scores.map(|score| of(&score)).collect()
    }

    /// The mean accuracy of a method; none where it has nothing to work on.
    pub(super) fn accuracy(&self, divider: Divider) -> Option<Estimate> {
        let values = self.values(divider, |score| score.accuracy);
        (!values.is_empty()).then(|| Estimate::of(&values))
    }

    /// The best other method with its accuracy. There is always one: the paper's method.
    fn best_other(&self) -> Option<(Divider, Estimate)> {
        let all =
            Divider::OTHERS.into_iter().filter_map(|other| Some((other, self.accuracy(other)?)));
        all.reduce(|best, next| if next.1.mean > best.1.mean { next } else { best })
    }

    /// Muster's accuracy less that of the best other, seed by seed.
    fn difference(&self) -> Option<Estimate> {
        let (other, _) = self.best_other()?;
        let pair = |outcome: &&Outcome| {
            Some(outcome.score(Divider::Muster)?.accuracy - outcome.score(other)?.accuracy)
        };
        let differences: Vec<f64> = self.outcomes.iter().filter_map(pair).collect();
        Some(Estimate::of(&differences))
    }

    fn is_lost(&self) -> bool {
        self.difference().is_some_and(|difference| difference.mean < -LOSS)
    }

    /// A number of all situations, or from which to which.
    fn range(&self, of: impl Fn(&Outcome) -> usize) -> String {
        let all = || self.outcomes.iter().map(|outcome| of(outcome));
        let (least, most) = (all().min().unwrap_or(0), all().max().unwrap_or(0));
        if least == most {
            thousands(least)
        } else {
            format!("{}–{}", thousands(least), thousands(most))
        }
    }
}

/// A number of at most six digits with a comma.
fn thousands(number: usize) -> String {
    if number < 1000 {
        number.to_string()
    } else {
        format!("{},{:03}", number / 1000, number % 1000)
    }
}

/// A share in percent.
fn percent(estimate: Option<Estimate>) -> String {
    estimate.map_or_else(|| NOTHING.to_owned(), |found| format!("{:.1}", 100.0 * found.mean))
}

/// The mean over kinds of independent estimates, with its interval.
#[expect(clippy::cast_precision_loss, reason = "there are a few dozen kinds")]
pub(super) fn over_kinds(estimates: &[Estimate]) -> Option<Estimate> {
    let count = estimates.len();
    if count == 0 {
        return None;
    }
    let sum = |of: fn(&Estimate) -> f64| estimates.iter().map(of).sum::<f64>();
    let mean = sum(|estimate| estimate.mean) / count as f64;
    let half = sum(|estimate| estimate.half * estimate.half).sqrt() / count as f64;
    Some(Estimate { mean, half, count })
}

/// The page of all outcomes, and of the worth of each step.
///
/// # Errors
/// If the plot cannot be drawn.
pub fn page(outcomes: &[Outcome], steps: &[Worth]) -> Result<Page, PlotError> {
    let mut page = Page::default();
    page.say("# Situations", BEFORE);
    kinds(&mut page);
    let lists = List::ALL.map(|list| (list, OfKind::all(list, outcomes)));
    let lists = || lists.iter().filter(|(_, kinds)| !kinds.is_empty());
    page.say(
        "## Robots in the right team",
        "In percent, the mean over seeds with its 95 % interval for Muster. *Difference* is between Muster and the \
         best other of that kind, seed by seed. A kind on which Muster loses by more than 1 point is **bold**. Means \
         are over the kinds on which a method has something to work on.",
    );
    for (list, kinds) in lists() {
        accuracy(&mut page, *list, kinds);
    }
    let rows = lists().flat_map(|(_, kinds)| kinds);
    let svg = plot(rows)?;
    page.plot("accuracy", "Robots in the right team by kind, Muster and the best other", svg);
    page.say(
        "## The number of teams",
        "*Right*: seeds in which the number that a method chooses by itself is that of the true teams. *ARI*: the Rand \
         index adjusted for chance (Hubert and Arabie 1985), which is 1 for the true division and about 0 for an \
         arbitrary one; a robot without a team counts as a team of its own. The rule for the number was chosen on \
         the first list, after the second one had been looked at with another rule.",
    );
    for (list, kinds) in lists() {
        numbers(&mut page, *list, kinds);
    }
    if let Some((_, kinds)) = lists().find(|(list, _)| *list == List::LookedAtOnce) {
        goals(&mut page, kinds);
    }
    worth(&mut page, steps);
    page.records = outcomes.iter().flat_map(records).collect();
    Ok(page)
}

fn worth(page: &mut Page, steps: &[Worth]) {
    page.say(
        "## What each step is worth",
        "Robots in the right team over the kinds that defaults may be chosen on, in percent, with the number of \
         teams given: the defaults, and the defaults with one step changed. *Loss*: how much less than the \
         defaults, kind by kind, with its 95 % interval.",
    );
    let head = ["method", "right", "loss", "loses most"].map(str::to_owned);
    let row = |step: &Worth| {
        let worst = step.worst.map(|(kind, loss)| format!("{kind} ({:.1})", 100.0 * loss));
        vec![
            step.name.to_owned(),
            format!("{:.1}", 100.0 * step.accuracy),
            format!("{:.1} ± {:.1}", 100.0 * step.loss.mean, 100.0 * step.loss.half),
            worst.unwrap_or_else(|| NOTHING.to_owned()),
        ]
    };
    page.table(&head, &steps.iter().map(row).collect::<Vec<_>>());
}

fn kinds(page: &mut Page) {
    page.say(
        "## Kinds",
        "Muster's defaults may be chosen on the kinds of one list; those of the other are looked at once, when all \
         is chosen.",
    );
    let head = ["kind", "list", "what it is"].map(str::to_owned);
    let rows = List::ALL.into_iter().flat_map(|list| {
        let row = move |kind: &Kind| {
            vec![kind.name.to_owned(), list.name().to_owned(), kind.description.to_owned()]
        };
        list.kinds().iter().map(row)
    });
    page.table(&head, &rows.collect::<Vec<_>>());
}

fn accuracy(page: &mut Page, list: List, kinds: &[OfKind<'_>]) {
    let mut head: Vec<String> =
        ["kind", "robots", "teams", "seeds", "Muster"].map(str::to_owned).into();
    head.extend(Divider::OTHERS.map(|other| other.name().to_owned()));
    head.extend(["best other", "difference"].map(str::to_owned));
    let row = |of: &OfKind<'_>| {
        let name =
            if of.is_lost() { format!("**{}**", of.kind.name) } else { of.kind.name.to_owned() };
        let mut row = vec![
            name,
            of.range(|outcome| outcome.robots),
            of.range(|outcome| outcome.teams),
            of.outcomes.len().to_string(),
            of.accuracy(Divider::Muster).map_or_else(String::new, interval),
        ];
        row.extend(Divider::OTHERS.map(|other| percent(of.accuracy(other))));
        row.push(of.best_other().map_or_else(String::new, |(other, found)| {
            format!("{:.1} ({})", 100.0 * found.mean, other.name())
        }));
        row.push(of.difference().map_or_else(String::new, signed));
        row
    };
    let mut rows: Vec<Vec<String>> = kinds.iter().map(row).collect();
    let mean = |divider| {
        over_kinds(&kinds.iter().filter_map(|of| of.accuracy(divider)).collect::<Vec<_>>())
    };
    let mut last = vec![format!("mean of {} kinds", kinds.len())];
    last.extend(["", "", ""].map(str::to_owned));
    last.push(mean(Divider::Muster).map_or_else(String::new, interval));
    last.extend(Divider::OTHERS.map(|other| percent(mean(other))));
    let best = kinds.iter().filter_map(|of| Some(of.best_other()?.1)).collect::<Vec<_>>();
    last.push(percent(over_kinds(&best)));
    let differences: Vec<Estimate> = kinds.iter().filter_map(OfKind::difference).collect();
    last.push(over_kinds(&differences).map_or_else(String::new, signed));
    rows.push(last);
    page.say(&format!("### Kinds {}", list_words(list)), &rivals(kinds));
    page.table(&head, &rows);
    page.text += &losses(kinds);
    page.text += "\n\n";
}

fn list_words(list: List) -> &'static str {
    match list {
        List::ChosenOn => "that defaults may be chosen on",
        List::LookedAtOnce => "that are looked at once",
    }
}

fn interval(found: Estimate) -> String {
    format!("{:.1} ± {:.1}", 100.0 * found.mean, 100.0 * found.half)
}

fn signed(found: Estimate) -> String {
    format!("{:+.1} ± {:.1}", 100.0 * found.mean, 100.0 * found.half)
}

/// Muster against each other method over the kinds on which that one has something to work on.
fn rivals(kinds: &[OfKind<'_>]) -> String {
    let mut words = String::from("Over the kinds on which both have something to work on:");
    for other in Divider::OTHERS {
        let both: Vec<(Estimate, Estimate)> = kinds
            .iter()
            .filter_map(|of| Some((of.accuracy(Divider::Muster)?, of.accuracy(other)?)))
            .collect();
        let (ours, theirs): (Vec<Estimate>, Vec<Estimate>) = both.iter().copied().unzip();
        if let Some((ours, theirs)) = over_kinds(&ours).zip(over_kinds(&theirs)) {
            // Writing to a text does not fail.
            let _ = write!(
                words,
                " Muster {:.1}, {} {:.1} ({} kinds);",
                100.0 * ours.mean,
                other.name(),
                100.0 * theirs.mean,
                both.len()
            );
        }
    }
    words.truncate(words.len() - 1);
    words + "."
}

/// The kinds on which Muster loses, in words.
fn losses(kinds: &[OfKind<'_>]) -> String {
    let mut lost: Vec<(&OfKind<'_>, Estimate)> = kinds
        .iter()
        .filter(|of| of.is_lost())
        .filter_map(|of| Some((of, of.difference()?)))
        .collect();
    if lost.is_empty() {
        return "Muster loses by more than 1 point on none of these kinds.".to_owned();
    }
    lost.sort_by(|left, right| left.1.mean.total_cmp(&right.1.mean));
    let mut words =
        format!("Muster loses by more than 1 point on {} of {} kinds:\n", lost.len(), kinds.len());
    for (of, difference) in lost {
        let Some((other, best)) = of.best_other() else { continue };
        // Writing to a text does not fail.
        let _ = write!(
            words,
            "\n- *{}*: {} has {:.1}, Muster {} points less. {}",
            of.kind.name,
            other.name(),
            100.0 * best.mean,
            interval(Estimate { mean: -difference.mean, ..difference }),
            of.kind.description
        );
    }
    words
}

/// Muster with its interval, and the best other as a bar.
fn plot<'a>(kinds: impl Iterator<Item = &'a OfKind<'a>>) -> Result<String, PlotError> {
    let hundredfold =
        |found: Estimate| Estimate { mean: 100.0 * found.mean, half: 100.0 * found.half, ..found };
    let row = |of: &OfKind<'_>| Row {
        name: of.kind.name.to_owned(),
        values: of.accuracy(Divider::Muster).map(hundredfold).into_iter().collect(),
        printed: of.best_other().map(|(_, best)| 100.0 * best.mean),
    };
    let rows: Vec<Row> = kinds.map(row).collect();
    let axis =
        Axis { title: "robots in the right team, %".to_owned(), range: (0.0, 100.0), decimals: 0 };
    dots(&rows, &[("Muster".to_owned(), Look::of(0))], ("best other", Look::of(1)), &axis)
}

#[expect(clippy::cast_precision_loss, reason = "there are a few teams")]
fn numbers(page: &mut Page, list: List, kinds: &[OfKind<'_>]) {
    let head = [
        "kind",
        "teams",
        "right: Muster",
        "right: Leiden",
        "mean number: Muster",
        "mean number: Leiden",
        "ARI: Muster with k",
        "ARI: Muster by itself",
        "ARI: Leiden with k",
        "ARI: Leiden",
    ];
    let is_right = |of: &OfKind<'_>, divider| {
        let all = of.outcomes.iter().filter_map(|outcome| Some((outcome, outcome.score(divider)?)));
        let all: Vec<bool> = all.map(|(outcome, score)| outcome.teams == score.teams).collect();
        (all.iter().filter(|right| **right).count(), all.len())
    };
    let right = |of: &OfKind<'_>, divider| match is_right(of, divider) {
        (_, 0) => NOTHING.to_owned(),
        (right, all) => format!("{right} of {all}"),
    };
    let mean = |of: &OfKind<'_>, divider, value: fn(&Score) -> f64| {
        let values = of.values(divider, value);
        (!values.is_empty()).then(|| Estimate::of(&values))
    };
    let text = |found: Option<Estimate>, digits: usize| {
        found.map_or_else(|| NOTHING.to_owned(), |found| format!("{:.digits$}", found.mean))
    };
    let itself = [Divider::MusterByItself, Divider::Leiden];
    let all = [Divider::Muster, Divider::MusterByItself, Divider::LeidenTeams, Divider::Leiden];
    let row = |of: &OfKind<'_>| {
        let mut row = vec![of.kind.name.to_owned(), of.range(|outcome| outcome.teams)];
        row.extend(itself.map(|divider| right(of, divider)));
        row.extend(itself.map(|divider| text(mean(of, divider, |score| score.teams as f64), 1)));
        row.extend(all.map(|divider| text(mean(of, divider, |score| score.rand_index), 3)));
        row
    };
    let mut rows: Vec<Vec<String>> = kinds.iter().map(row).collect();
    let mut last = vec![format!("all {} kinds", kinds.len()), String::new()];
    last.extend(itself.map(|divider| {
        let all = kinds.iter().map(|of| is_right(of, divider));
        match all.fold((0, 0), |sum, next| (sum.0 + next.0, sum.1 + next.1)) {
            (_, 0) => NOTHING.to_owned(),
            (right, all) => format!("{right} of {all}"),
        }
    }));
    last.extend(["", ""].map(str::to_owned));
    last.extend(all.map(|divider| {
        let of_kinds = kinds.iter().filter_map(|of| mean(of, divider, |score| score.rand_index));
        text(over_kinds(&of_kinds.collect::<Vec<_>>()), 3)
    }));
    rows.push(last);
    page.text += &format!("### Of kinds {}\n\n", list_words(list));
    page.table(&head.map(str::to_owned), &rows);
}

/// Every number of a situation.
#[expect(clippy::cast_precision_loss, reason = "there are a few teams")]
fn records(outcome: &Outcome) -> Vec<Record> {
    let of = |(divider, score): &(Divider, Score)| {
        let record = |measure, value| Record {
            experiment: "situations",
            case: outcome.case.kind.name.to_owned(),
            teams: outcome.teams,
            condition: String::new(),
            method: divider.name().to_owned(),
            seed: outcome.case.seed,
            measure,
            value,
        };
        [
            record("accuracy", score.accuracy),
            record("adjusted rand index", score.rand_index),
            record("teams found", score.teams as f64),
        ]
    };
    outcome.scores.iter().flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plots::tests::marks;
    use crate::situations::run::Case;

    fn outcome(kind: &'static Kind, seed: u64, accuracies: &[(Divider, f64)]) -> Outcome {
        let score = |(divider, accuracy): &(Divider, f64)| {
            (*divider, Score { accuracy: *accuracy, rand_index: 0.5, teams: 3 })
        };
        let case = Case { kind, seed };
        Outcome { case, robots: 2000, teams: 3, scores: accuracies.iter().map(score).collect() }
    }

    #[test]
    fn losses_are_marked_and_told_and_methods_without_work_are_dashes() {
        let kinds = List::ChosenOn.kinds();
        let outcomes: Vec<Outcome> = [0, 1]
            .into_iter()
            .flat_map(|seed| {
                let won =
                    [(Divider::Muster, 1.0), (Divider::MusterByItself, 1.0), (Divider::Paper, 0.5)];
                let lost = [(Divider::Muster, 0.75), (Divider::Paper, 0.5), (Divider::Tree, 1.0)];
                [outcome(&kinds[0], seed, &won), outcome(&kinds[1], seed, &lost)]
            })
            .collect();
        let steps = [Worth {
            name: "without it",
            accuracy: 0.9,
            loss: Estimate { mean: 0.05, half: 0.01, count: 2 },
            worst: Some(("a kind", 0.1)),
        }];
        let page = page(&outcomes, &steps).unwrap();
        assert!(page.text.contains("| without it | 90.0 | 5.0 ± 1.0 | a kind (10.0) |"));
        let text = &page.text;
        let won = "| round teams | 2,000 | 3 | 2 | 100.0 ± 0.0 | – | – | – | – | – | 50.0 | \
                   50.0 (the paper's method) | +50.0 ± 0.0 |";
        assert!(text.contains(won), "{text}");
        assert!(text.contains("| **overlapping teams** |"), "{text}");
        assert!(text.contains(
            "- *overlapping teams*: tree of command has 100.0, Muster 25.0 ± 0.0 points less."
        ));
        assert!(text.contains("| mean of 2 kinds |  |  |  | 87.5 ± 0.0 |"), "{text}");
        assert!(
            text.contains("| round teams | 3 | 2 of 2 | – | 3.0 | – | 0.500 | 0.500 | – | – |"),
            "{text}"
        );
        for list in List::ALL {
            assert!(list.kinds().iter().all(|kind| text.contains(kind.description)));
        }
        assert_eq!(page.records.len(), 2 * 6 * 3);
        assert_eq!(marks(&page.plots[0].1, Look::of(0).colour), 2 + 1);
    }
}
