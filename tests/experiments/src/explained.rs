//! What of the paper's numbers comes out again, what does not, and why that may be: a page that is written from
//! the numbers of a run and of the paper's tables, so that it cannot say what they do not.

use std::collections::{BTreeMap, BTreeSet};

use crate::collapse;
use crate::experiments::{FUSED, PLAIN, ROBOTS, SPACES, TEAMS, over_seeds, share};
use crate::formations::Radio;
use crate::paper;
use crate::results::{Page, Record};
use crate::statistics::{Estimate, correlation};

/// By how many points an accuracy may miss the printed one and still be called near it.
const NEAR_POINTS: f64 = 3.0;

/// The methods of a run that the paper has too, in the order of its records.
fn methods_of_the_paper(run: &Page) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for record in &run.records {
        if !names.contains(&record.method) && paper::scenario_one(&record.method).is_some() {
            names.push(record.method.clone());
        }
    }
    names
}

fn of_formations<'a>(name: &'a str, radio: &'a str) -> impl Fn(&Record) -> bool + 'a {
    move |r| (r.experiment, r.method.as_str(), r.condition.as_str()) == ("formations", name, radio)
}

fn texts<const N: usize>(cells: [&str; N]) -> Vec<String> {
    cells.map(str::to_owned).to_vec()
}

fn mean(values: &[f64]) -> f64 {
    Estimate::of(values).mean
}

/// The page, from the numbers of Scenarios I and II.
#[must_use]
pub fn papers_numbers(run: &Page) -> Page {
    let mut page = Page::default();
    page.say(
        "## What of the paper's numbers comes out again, and what does not",
        "The paper publishes neither its distances nor its radios, neither α nor K nor how graphs are weighted, and \
         names no program. What follows compares what it prints with what this run has measured.",
    );
    counts(run, &mut page);
    accuracies(run, &mut page);
    spaces(run, &mut page);
    yardstick(run, &mut page);
    rows_of_means(&mut page, &methods_of_the_paper(run));
    page
}

/// What is counted: the checks that do not depend on distances.
fn counts(run: &Page, page: &mut Page) {
    let name = "GN (spatial)";
    // Each run by radio and seed.
    let mut right: BTreeSet<(u64, u64)> = BTreeSet::new();
    let mut runs = 0;
    for radio in Radio::ALL.map(|radio| radio.to_string()) {
        let is_asked = of_formations(name, &radio);
        let seeds: BTreeSet<u64> =
            run.records.iter().filter(|r| is_asked(r)).map(|record| record.seed).collect();
        for seed in seeds {
            let sum = |measure: &str| {
                let values = run.values(|r| is_asked(r) && (r.seed, r.measure) == (seed, measure));
                values.iter().sum::<f64>() as u64
            };
            right.insert((sum("right"), sum("counted")));
            runs += 1;
        }
    }
    let found: Vec<String> =
        right.iter().map(|(right, total)| format!("{right} of {total} robots")).collect();
    let printed = paper::scenario_one(name).map_or(f64::NAN, |(accuracy, _)| 100.0 * accuracy);
    let share = right.iter().next().map_or(f64::NAN, |(r, c)| 100.0 * *r as f64 / *c as f64);
    let whole = methods_of_the_paper(run).into_iter().filter(|name| {
        let Some((accuracy, _)) = paper::scenario_one(name) else { return false };
        is_whole(accuracy, paper::ROBOTS)
    });
    let [(squads, of_squads), (platoons, of_platoons)] = paper::HOPE_WITHOUT_NOISE;
    let [in_squads, in_platoons] =
        paper::HOPE_WITHOUT_NOISE.map(|(share, robots)| (share * robots as f64).round());
    let together = 100.0 * (in_squads + in_platoons) / paper::ROBOTS as f64;
    let table = paper::scenario_one("HOPE (spatial)").map_or(f64::NAN, |(share, _)| 100.0 * share);
    page.say(
        "### What is counted comes out exactly",
        &format!(
            "On the complete spatial graph, the division by edge betweenness does not look at distances: what it \
             finds depends on the formations, on what counts and on how teams are matched, and on nothing else. \
             Here it has {found} right in all of {runs} runs, {share:.2} %; the paper prints {printed:.2} %. So the \
             formations, their divisions and the matching are the paper's, as far as this can \
             show.\n\nThe paper's own numbers agree: {whole} \
             of its {all} accuracies are whole numbers of {robots} robots, so that its table is a single run and \
             not a mean. Its text has HOPE on the spatial graph at {squads:.2} % of squads and {platoons:.2} % of \
             platoons, which are {in_squads} of {of_squads} and {in_platoons} of {of_platoons} robots, as many as \
             count here. Together they would be {together:.2} %; its table has {table:.2} %. Text and table are \
             thus of different runs.",
            found = found.join(" or "),
            whole = whole.count(),
            all = methods_of_the_paper(run).len(),
            robots = paper::ROBOTS,
            squads = 100.0 * squads,
            platoons = 100.0 * platoons,
        ),
    );
}

/// With two digits, and no negative zero.
fn round(value: f64) -> f64 {
    (100.0 * value).round() / 100.0 + 0.0
}

/// Whether a share that is printed with four digits is one of whole robots.
fn is_whole(share: f64, robots: usize) -> bool {
    let right = (share * robots as f64).round();
    (right / robots as f64 - share).abs() <= 0.5e-4 + 1e-12
}

/// Which accuracies are near the printed ones.
fn accuracies(run: &Page, page: &mut Page) {
    let mut rows = Vec::new();
    let (mut near, mut far) = (Vec::new(), Vec::new());
    let mut hierarchy = Vec::new();
    for name in methods_of_the_paper(run) {
        let Some((printed, _)) = paper::scenario_one(&name) else { continue };
        let printed = 100.0 * printed;
        let of = |radio: Radio| {
            let radio = radio.to_string();
            100.0 * share(run, of_formations(&name, &radio)).mean
        };
        let found = Radio::ALL.map(of);
        let off = found.map(|found| found - printed);
        let least = if off[0].abs() <= off[1].abs() { off[0] } else { off[1] };
        if least.abs() <= NEAR_POINTS { &mut near } else { &mut far }.push(name.clone());
        if name.ends_with("(hierarchy)") {
            hierarchy.push(format!("{name} {:.2} instead of {printed:.2}", found[0]));
        }
        let numbers = [printed, found[0], found[1]].map(|value| format!("{value:.2}"));
        rows.push([vec![name], numbers.to_vec(), vec![format!("{:+.2}", round(least))]].concat());
    }
    let (least, most) = single_runs(run, PLAIN);
    page.say(
        "### What depends on distances and radios comes out in part",
        &format!(
            "Accuracy in percent; *off* is the difference of the nearer radio. Within {NEAR_POINTS} points of the \
             paper: {}. Not: {}.\n\nDistances and radios may explain what is related to them. They cannot explain the graph \
             of command, which has neither: {}. The paper's graph of command must be another one, or embedded in \
             another way, and it does not say which. The paper's own method starts k-means once and at random: its \
             single runs are between {:.2} and {:.2} % here, so that one run, as the paper has it, says little.",
            list(&near),
            list(&far),
            list(&hierarchy),
            least,
            most
        ),
    );
    page.table(&texts(["method", "paper", "range", "net", "off"]), &rows);
}

/// The worst and the best run of a method in percent, of all seeds and radios.
fn single_runs(run: &Page, name: &str) -> (f64, f64) {
    let mut sums: BTreeMap<(&str, u64), [f64; 2]> = BTreeMap::new();
    let is_asked = |r: &&Record| (r.experiment, r.method.as_str()) == ("formations", name);
    for record in run.records.iter().filter(is_asked) {
        let place = ["right", "counted"].iter().position(|measure| *measure == record.measure);
        let sums = sums.entry((&record.condition, record.seed)).or_default();
        place.into_iter().for_each(|place| sums[place] += record.value);
    }
    let shares = sums.values().map(|[right, total]| 100.0 * right / total);
    shares.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| (low.min(s), high.max(s)))
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join("; ") }
}

/// In which space the paper may have scored Scenario II.
fn spaces(run: &Page, page: &mut Page) {
    let measures = [SPACES[0], FUSED, SPACES[1], SPACES[2]];
    let words = ["own vectors", "vectors of the paper's method", "positions", "common space"];
    let mut rows = Vec::new();
    let mut nearest = Vec::new();
    let mut all = [const { Vec::new() }; 4];
    let (mut of_plain, mut best_of_plain) = ([f64::NAN; 5], 0);
    for name in methods_of_the_paper(run) {
        let cells: Vec<(usize, usize, f64)> = ROBOTS
            .into_iter()
            .flat_map(|robots| TEAMS.map(|teams| (robots, teams)))
            .filter_map(|(robots, teams)| {
                Some((robots, teams, paper::scenario_two(robots, teams, &name)?))
            })
            .collect();
        if cells.is_empty() {
            continue;
        }
        let found = measures.map(|measure| {
            let of_cell = |(robots, teams, _): &(usize, usize, f64)| {
                let case = robots.to_string();
                mean(&run.values(|r| {
                    (r.experiment, r.measure, r.teams) == ("systems", measure, *teams)
                        && (&r.method, &r.case) == (&name, &case)
                }))
            };
            cells.iter().map(of_cell).collect::<Vec<f64>>()
        });
        let printed: Vec<f64> = cells.iter().map(|cell| cell.2).collect();
        let off = |values: &Vec<f64>| {
            let apart = values.iter().zip(&printed).map(|(found, printed)| (found - printed).abs());
            mean(&apart.collect::<Vec<f64>>())
        };
        let offs = [0, 1, 2, 3].map(|space| off(&found[space]));
        let least = (0..4).min_by(|l, r| offs[*l].total_cmp(&offs[*r])).unwrap_or(0);
        nearest.push(format!("{name}: {}", words[least]));
        if name == PLAIN {
            let [own, fused, physical, common] = [0, 1, 2, 3].map(|space| mean(&found[space]));
            (of_plain, best_of_plain) = ([own, fused, physical, common, mean(&printed)], least);
        }
        offs.iter().zip(&mut all).for_each(|(off, all)| all.push(*off));
        let cell = |space: usize| format!("{:.3} ({:.3})", mean(&found[space]), offs[space]);
        let numbers = [0, 1, 2, 3].map(cell);
        rows.push([vec![name, format!("{:.3}", mean(&printed))], numbers.to_vec()].concat());
    }
    let over_all: Vec<String> =
        words.iter().zip(&all).map(|(word, offs)| format!("{word} {:.3}", mean(offs))).collect();
    page.say(
        "### In which space the paper scores",
        &format!(
            "The paper does not say in which space its silhouettes are. For Scenario II, here are the means over \
             its 15 rows in four spaces, and in brackets by how much a row is off on average. The space that fits \
             best, method by method: {}. Over all methods, a row is off on average by: {}.\n\nFor the paper's own \
             method, {:.3} is printed. Its divisions have {:.3} in its own fused vectors, {:.3} where robots stand \
             and {:.3} in the common space: {} come nearest, and still miss the printed value by {:.3}. How campus, \
             radios and chain of command were made is not stated, so this is a likely reading and no proof.",
            nearest.join("; "),
            over_all.join("; "),
            of_plain[4],
            of_plain[0],
            of_plain[2],
            of_plain[3],
            words[best_of_plain],
            (of_plain[best_of_plain] - of_plain[4]).abs()
        ),
    );
    page.table(&[texts(["method", "paper"]), words.map(str::to_owned).to_vec()].concat(), &rows);
}

/// Why own vectors are no yardstick, and what is taken instead.
fn yardstick(run: &Page, page: &mut Page) {
    let mut names: Vec<&str> = Vec::new();
    for record in run.records.iter().filter(|record| record.experiment == "formations") {
        if !names.contains(&record.method.as_str()) {
            names.push(&record.method);
        }
    }
    let accuracy =
        |name: &str| share(run, |r| (r.experiment, r.method.as_str()) == ("formations", name)).mean;
    let silhouette = |name: &str, measure: &str| {
        let is_asked = |r: &Record| {
            (r.experiment, r.method.as_str(), r.measure) == ("formations", name, measure)
        };
        over_seeds(run, is_asked).mean
    };
    let along = |measure: &str| {
        let pairs = names.iter().map(|name| (silhouette(name, measure), accuracy(name)));
        correlation(&pairs.filter(|(score, _)| score.is_finite()).collect::<Vec<_>>())
    };
    let [own, physical, common] = SPACES.map(along);
    let printed = names.iter().filter_map(|name| paper::scenario_one(name));
    let printed = correlation(&printed.map(|(share, score)| (score, share)).collect::<Vec<_>>());
    let (looks, is) = misleading(&names, accuracy, |name| silhouette(name, SPACES[0]));
    let example = format!(
        "{looks} has {:.3} in its own vectors and {:.2} % of robots right, {is} has {:.3} and {:.2} %",
        silhouette(looks, SPACES[0]),
        100.0 * accuracy(looks),
        silhouette(is, SPACES[0]),
        100.0 * accuracy(is),
    );
    let of_rank = |rank: usize| {
        let of = |measure: &str| {
            mean(&run.values(|r| {
                (r.experiment, r.measure) == ("collapse", measure) && r.case == rank.to_string()
            }))
        };
        let [accuracy, _, systems] = collapse::MEASURES.map(of);
        format!("with K = {rank} {:.2} % and {systems:.3}", 100.0 * accuracy)
    };
    let ranks: Vec<String> = collapse::RANKS.into_iter().map(of_rank).collect();
    page.say(
        "### Why a method's own vectors are no yardstick",
        &format!(
            "k-means looks for the division that is tight in the vectors that it is given. Scored in the same \
             vectors, a method is better the more of its robots it puts into one place, whether they belong together \
             or not: what is rewarded is collapse. The paper's own method shows it, which only has to drop \
             coordinates: robots in the right team in Scenario I, and silhouettes in own vectors in Scenario II, \
             are {}. Different methods show it as well, in Scenario I: {example}. The paper finds that silhouettes \
             rise with accuracy (its printed numbers are correlated by {printed:.2}) and concludes that \
             they may stand for it where no truth is known. Over the methods of this run, accuracy is correlated by \
             {own:.2} with silhouettes in own vectors, by {physical:.2} with those of positions, and by {common:.2} \
             with those of the common space.\n\nThe *common space* is therefore what this page compares methods in \
             where no truth is known. Two robots are as far apart in it as three distances say together: metres, \
             the fewest radio links between them, and the fewest steps along the chain of command, each divided by \
             its mean over all pairs, so that each has the same say and units do not matter. It is made of what was \
             observed, is the same for all methods, and no method looks for divisions in it. It is no truth either: \
             where the truth is known, accuracy decides.",
            list(&ranks)
        ),
    );
}

/// The two methods by which own vectors mislead most: the first looks better by the most, and is worse.
fn misleading<'a>(
    names: &[&'a str],
    accuracy: impl Fn(&str) -> f64,
    silhouette: impl Fn(&str) -> f64,
) -> (&'a str, &'a str) {
    let pairs = names.iter().flat_map(|looks| names.iter().map(move |is| (*looks, *is)));
    let gain = |pair: &(&str, &str)| silhouette(pair.0) - silhouette(pair.1);
    let wrong = pairs.filter(|(looks, is)| accuracy(looks) < accuracy(is));
    let known = wrong.filter(|pair| gain(pair).is_finite());
    known.max_by(|l, r| gain(l).total_cmp(&gain(r))).unwrap_or_default()
}

/// Of which rows the paper's means are.
fn rows_of_means(page: &mut Page, names: &[String]) {
    let mut rows = Vec::new();
    let (mut of_printed, mut of_all) = (0, 0);
    for name in names {
        let Some((_, stated)) = paper::scenario_one(name) else { continue };
        let [printed, unprinted] = paper::scenario_one_silhouettes(name);
        let means = [mean(&printed), mean(&[printed, unprinted].concat())];
        // As good as three digits can be.
        let [is_printed, is_all] = means.map(|mean| (mean - stated).abs() < 0.001);
        of_printed += usize::from(is_printed);
        of_all += usize::from(is_all);
        let numbers = [stated, means[0], means[1]].map(|value| format!("{value:.3}"));
        rows.push([vec![name.clone()], numbers.to_vec()].concat());
    }
    let [printed, unprinted] = paper::scenario_one_silhouettes(PLAIN);
    let stated = paper::scenario_one(PLAIN).map_or(f64::NAN, |(_, silhouette)| silhouette);
    page.say(
        "### Of which rows the paper's means are",
        &format!(
            "The paper's table of silhouettes in Scenario I prints {} rows, and its source has {} more, those of \
             platoons in four teams, which are commented out. The means that it prints are those of all {} rows for \
             {of_all} of {} methods, and those of the printed rows for {of_printed}. For its own method, {stated:.3} \
             is printed; the rows that are left out have a mean of {:.3}, the printed ones of {:.3}.",
            printed.len(),
            unprinted.len(),
            printed.len() + unprinted.len(),
            rows.len(),
            mean(&unprinted),
            mean(&printed)
        ),
    );
    page.table(&texts(["method", "mean that is printed", "of printed rows", "of all rows"]), &rows);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formations::Formation;
    use crate::methods::Method;
    use crate::seeds::TRAINING;

    #[test]
    fn shares_of_whole_robots_are_recognised() {
        assert!(is_whole(0.3922, 306) && is_whole(0.9673, 306));
        assert!(!is_whole(0.3935, 306));
    }

    #[test]
    fn the_page_has_the_numbers_of_the_run() {
        let seeds: Vec<u64> = TRAINING.take(1).collect();
        let formations = Formation::all().unwrap();
        let methods = Method::all();
        let silent = |_: &str| {};
        let mut run =
            crate::experiments::formations(&formations, &methods, &seeds, &silent).unwrap();
        run.append(crate::experiments::systems(&methods, &seeds, &silent).unwrap());
        run.append(collapse::collapse(&formations, &seeds, &silent).unwrap());
        let text = papers_numbers(&run).text;
        assert!(text.contains("120 of 306 robots right in all of 2 runs, 39.22 %"), "{text}");
        assert!(text.contains("11 of its 11 accuracies are whole numbers of 306 robots"), "{text}");
        assert!(text.contains("which are 39 of 51 and 225 of 255 robots"), "{text}");
        assert!(text.contains("those of all 15 rows for 10 of 11 methods"), "{text}");
        assert!(!text.contains("NaN"), "{text}");
    }
}
