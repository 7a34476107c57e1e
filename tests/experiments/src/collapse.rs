//! How a method scores in its own vectors when these have fewer coordinates: the paper's method with
//! different K, scored in its own vectors and by the truth.

use rayon::prelude::*;

use crate::experiments::{Progress, ROBOTS, TEAMS};
use crate::formations::{Formation, Radio};
use crate::methods::embedding::Rank;
use crate::methods::{BASELINE_STARTS, DivisionError, Method, Recipe};
use crate::random_systems::campus;
use crate::results::{Page, Record};
use crate::scenario_one::{run, total};
use crate::spaces::in_vectors;
use crate::statistics::Estimate;

/// The K that are tried.
pub const RANKS: [usize; 4] = [1, 2, 3, 4];

/// The measures of a K by their names in records: robots in the right team and silhouettes in own vectors in
/// Scenario I, silhouettes in own vectors in Scenario II.
pub const MEASURES: [&str; 3] =
    ["accuracy", "silhouette own, formations", "silhouette own, systems"];

/// Measures the paper's method with all [`RANKS`], each with as many starts of k-means as the baselines have, so
/// that it is the vectors that differ and not the luck of a start.
///
/// # Errors
/// If the method fails.
pub fn collapse(
    formations: &[Formation],
    seeds: &[u64],
    progress: &Progress<'_>,
) -> anyhow::Result<Page> {
    let mut page = Page::default();
    let mut rows = Vec::new();
    for rank in RANKS {
        progress(&format!("collapse: K = {rank}"));
        let mut recipe = Recipe::plain();
        recipe.form.rank = Rank::Fixed(rank);
        recipe.clustering.starts = BASELINE_STARTS;
        let method = Method::Multimodal("plain", Box::new(recipe));
        let found: Vec<[f64; 3]> = seeds
            .par_iter()
            .map(|seed| measured(formations, &method, *seed))
            .collect::<Result<_, _>>()?;
        let mut row = vec![rank.to_string()];
        for (at, measure) in MEASURES.into_iter().enumerate() {
            let values: Vec<f64> = found.iter().map(|values| values[at]).collect();
            let estimate = Estimate::of(&values);
            row.push(if at == 0 { estimate.percent() } else { estimate.plain() });
            page.records.extend(seeds.iter().zip(values).map(|(seed, value)| Record {
                experiment: "collapse",
                case: rank.to_string(),
                teams: 0,
                condition: String::new(),
                method: "plain, more starts".to_owned(),
                seed: *seed,
                measure,
                value,
            }));
        }
        rows.push(row);
    }
    page.say(
        "## Fewer coordinates",
        &format!(
            "The paper's method with K singular triplets, vectors of 2 K numbers, and {BASELINE_STARTS} starts of \
             k-means: robots in the right team in percent in Scenario I, over both radios, and silhouettes in its \
             own vectors in both scenarios."
        ),
    );
    let head = ["K", "accuracy", "own vectors, Scenario I", "own vectors, Scenario II"];
    page.table(&head.map(str::to_owned), &rows);
    Ok(page)
}

/// All measures of one seed.
fn measured(
    formations: &[Formation],
    method: &Method,
    seed: u64,
) -> Result<[f64; 3], DivisionError> {
    let (mut accuracies, mut own, mut systems) = (Vec::new(), Vec::new(), Vec::new());
    for radio in Radio::ALL {
        let found = run(formations, method, radio, Some(seed))?;
        accuracies.push(total(&found).share());
        own.extend(found.iter().filter_map(|outcome| outcome.silhouettes.own));
    }
    for (robots, teams) in ROBOTS.into_iter().flat_map(|robots| TEAMS.map(|teams| (robots, teams)))
    {
        let found = method.divide(&campus(robots, seed), teams, seed)?;
        let vectors = found.vectors.as_ref();
        systems.extend(vectors.and_then(|vectors| in_vectors(&found.labels, vectors)));
    }
    Ok([accuracies, own, systems].map(|values| Estimate::of(&values).mean))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seeds::TRAINING;

    #[test]
    fn one_coordinate_looks_better_and_is_worse() {
        let seeds: Vec<u64> = TRAINING.take(2).collect();
        let page = collapse(&Formation::all().unwrap(), &seeds, &|_| {}).unwrap();
        let of = |rank: &str, measure: &str| {
            Estimate::of(&page.values(|r| r.case == rank && r.measure == measure)).mean
        };
        assert!(of("1", MEASURES[0]) < of("3", MEASURES[0]) - 0.1, "{}", page.text);
        assert!(of("1", MEASURES[2]) > of("3", MEASURES[2]), "{}", page.text);
    }
}
