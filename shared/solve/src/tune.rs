//! `muster tune`: which weights, decay and dimension divide a fleet best, by a search over a grid.
//!
//! The paper names the weights of its modalities as parameters to be searched for. Every setting of the
//! [`grid`] divides the fleet into the same number of teams and is scored by the mean silhouette of its
//! division, as an audit would score it. A silhouette is taken among the vectors of the setting itself, and a
//! setting may have fine silhouettes because it looks at one modality alone; so the best ones are
//! cross-checked by their *stability*: how far their division stays the same when a part of the robots is
//! drawn and divided again. One is proposed only if it is as stable as the settings in force.
//!
//! Every division respects the limits, wishes and needs of the fleet, since no other would ever hold. The stability
//! is that of the divisions without them: four fifths of the robots need not satisfy what all do.
//! [`page`] shows what was found.

mod grid;
mod page;

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use muster_method::division::divide;
use muster_method::embedding::{Embedded, embed};
use muster_method::params::{DivisionParams, EmbeddingParams};
use muster_method::silhouettes::{SilhouetteParams, silhouettes};
use muster_method::{Frame, Graph as FrameGraph, MethodError};
use muster_model::settings::{ClustererSettings, EmbedderSettings, TeamCount};
use muster_numeric::agreement::adjusted_rand_index;
use muster_numeric::matching::{match_by_overlap, overlap_table};
use muster_numeric::matrix::SparseMatrix;
use rand::SeedableRng;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::error::{SolveError, refuse};
use super::limited::{self, Within};
use super::options::Options;
use super::problem::{Division, Problem};

/// Most robots of a fleet that is tuned: each setting of a larger one takes seconds.
pub const MAX_TUNED_ROBOTS: usize = 10_000;

/// Fewest robots: of fewer, four fifths are not much of a fleet.
pub const LEAST_TUNED_ROBOTS: usize = 5;

/// The share of the robots that is drawn to see whether a division is stable.
const DRAWN_SHARE: f64 = 0.8;

/// Divisions that are shown, and whose stability is examined, besides that of the settings in force.
const SHORTLIST: usize = 12;

/// How much less stable than the settings in force a setting may be that is proposed: less than one robot in a
/// hundred in another team.
const STABILITY_TOLERANCE: f64 = 0.02;

/// Starts of k-means for a setting of the grid; the division of the settings in force has all of its own.
const GRID_STARTS: usize = 10;

/// How a fleet is tuned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::Args)]
pub struct TuneOptions {
    /// In how many parts the weights are shared out among the modalities, each of which has one at least: with 6
    /// and three modalities each is 1/6, 2/6, 3/6 or 4/6.
    #[arg(long, value_name = "PARTS", default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=20))]
    pub parts: u32,
    /// How often four fifths of the robots are drawn to see whether a division is stable.
    #[arg(long, value_name = "DRAWS", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=100))]
    pub draws: u32,
    /// How many teams, instead of as many as the settings in force form.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1024))]
    pub teams: Option<u32>,
}

/// How far a search is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TuneStep {
    /// Settings of the grid are scored.
    Grid {
        /// How many are done.
        done: usize,
        /// How many there are.
        of: usize,
    },
    /// The stability of the best ones is examined.
    Stability {
        /// How many are done.
        done: usize,
        /// How many there are.
        of: usize,
    },
}

impl fmt::Display for TuneStep {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Grid { done, of } => write!(formatter, "silhouettes, {done} of {of} settings"),
            Self::Stability { done, of } => write!(formatter, "stability, {done} of {of} settings"),
        }
    }
}

/// A setting of the grid, and how it divides the fleet.
#[derive(Debug, Clone, PartialEq)]
pub struct Tuned {
    /// The settings of the embedder.
    pub settings: EmbedderSettings,
    /// Mean silhouette of the division among the vectors; none where it has fewer than two teams.
    pub silhouette: Option<f64>,
    /// Mean adjusted Rand index between the division and those of drawn robots; none where it was not examined.
    pub stability: Option<f64>,
    /// Robots that have another team than by the settings in force.
    pub moved: usize,
    labels: Vec<Option<usize>>,
    /// The division without limits; none where there are no limits, and `labels` are it.
    unlimited: Option<Vec<Option<usize>>>,
}

impl Tuned {
    /// Robots of the largest team.
    #[must_use]
    pub fn largest_team(&self) -> usize {
        let mut sizes = BTreeMap::new();
        for team in self.labels.iter().flatten() {
            *sizes.entry(team).or_insert(0_usize) += 1;
        }
        sizes.into_values().max().unwrap_or(0)
    }

    /// Robots in no team: they have no vector, or limits and wishes leave them out.
    #[must_use]
    pub fn unassigned(&self) -> usize {
        self.labels.iter().filter(|team| team.is_none()).count()
    }
}

/// What a search has found.
#[derive(Debug)]
pub struct Tuning {
    /// The settings in force.
    pub present: Tuned,
    /// The settings of the grid with the best silhouettes, best first; each divides the fleet in another way.
    pub best: Vec<Tuned>,
    /// How many settings were scored.
    pub scored: usize,
    /// How many robots and teams.
    pub robots: usize,
    /// How many teams the fleet was divided into.
    pub teams: usize,
}

impl Tuning {
    /// Searches the grid for the fleet in a text, as [`Solved`](crate::Solved) reads it.
    ///
    /// # Errors
    /// Names the field that is wrong and the remedy.
    pub fn new(
        text: &[u8],
        options: &TuneOptions,
        progress: &mut dyn FnMut(TuneStep),
    ) -> Result<Self, SolveError> {
        let teams = options.teams.map(TeamCount::Fixed);
        let problem = super::parse(text, Options { teams, ..Options::default() })?;
        let fleet = Fleet::new(&problem)?;
        let present = fleet.divide(&problem.settings, fleet.starts)?;
        let grid = grid::settings(&problem.settings, &fleet.frame, fleet.teams, options.parts);
        let scored = grid.len();
        let mut best: Vec<Tuned> = Vec::new();
        for (done, settings) in grid.into_iter().enumerate() {
            progress(TuneStep::Grid { done, of: scored });
            let mut found = fleet.divide(&settings, GRID_STARTS)?;
            found.moved = moved(&found.labels, &present.labels);
            keep_best(&mut best, found);
        }
        let mut tuning =
            Self { present, best, scored, robots: problem.robots.len(), teams: fleet.teams };
        let of = tuning.best.len() + 1;
        let examined = std::iter::once(&mut tuning.present).chain(&mut tuning.best);
        for (done, tuned) in examined.enumerate() {
            progress(TuneStep::Stability { done, of });
            tuned.stability = Some(fleet.stability(tuned, options.draws)?);
        }
        Ok(tuning)
    }

    /// The setting to be proposed: with the best silhouette of those that are as stable as the settings in
    /// force, and with a better one than these.
    #[must_use]
    pub fn proposed(&self) -> Option<&Tuned> {
        let least = self.present.stability.unwrap_or(0.0) - STABILITY_TOLERANCE;
        let is_better = |tuned: &&Tuned| {
            tuned.silhouette > self.present.silhouette
                && tuned.stability.is_some_and(|stability| stability >= least)
        };
        self.best.iter().find(is_better)
    }

    /// The change of the embedder's settings that applies a setting.
    #[must_use]
    pub fn patch(tuned: &Tuned) -> Value {
        let EmbedderSettings { weights, alpha, dimension, .. } = &tuned.settings;
        json!({ "weights": weights, "alpha": alpha, "dimension": dimension })
    }
}

/// A fleet to be tuned.
struct Fleet<'a> {
    problem: &'a Problem,
    frame: Frame,
    teams: usize,
    /// Starts of k-means that the clusterer has.
    starts: usize,
    /// The settings of the clusterer with `teams`.
    wanted: ClustererSettings,
}

impl<'a> Fleet<'a> {
    fn new(problem: &'a Problem) -> Result<Self, SolveError> {
        let robots = problem.robots.len();
        if !(LEAST_TUNED_ROBOTS..=MAX_TUNED_ROBOTS).contains(&robots) {
            return refuse(
                "robots",
                format!("{robots} cannot be tuned: {LEAST_TUNED_ROBOTS} to {MAX_TUNED_ROBOTS} can"),
            );
        }
        let Division::Wanted(wanted) = &problem.division else {
            return refuse(
                "labels",
                "are a division; a fleet to be tuned has \"teams\" or nothing",
            );
        };
        let wanted = wanted.clone();
        let graphs = problem.graphs.iter();
        let graph = |matrix: &Arc<SparseMatrix>| FrameGraph::Matrix(Arc::clone(matrix));
        let frame = Frame {
            robots: problem.robots.as_slice().into(),
            graphs: graphs.map(|of| (of.name.clone(), graph(&of.matrix))).collect(),
        };
        let params = EmbeddingParams::once(&problem.settings, wanted.teams).check();
        let found = params
            .map_err(MethodError::from)
            .and_then(|params| embed(&frame, &params, &mut |_| {}))
            .or_else(of_method)?;
        let mut teams = found.decomposition.teams.teams as usize;
        if let Some(rules) = limited::rules(problem, &wanted)? {
            // Limits may leave room for another number only.
            teams = limited::divide(problem, &wanted, &found, rules)?.ids.iter().flatten().count();
        }
        if teams < 2 {
            return refuse(
                "teams",
                "the fleet is one team by its settings, and one team has no silhouette; \
                 say how many with --teams",
            );
        }
        if teams > robots / 2 {
            let problem = format!("{teams} teams of {robots} robots leave too few in each");
            return refuse("teams", problem);
        }
        let starts = wanted.restarts as usize;
        let teams_wanted = TeamCount::Fixed(u32::try_from(teams).unwrap_or(u32::MAX));
        Ok(Self {
            problem,
            frame,
            teams,
            starts,
            wanted: ClustererSettings { teams: teams_wanted, ..wanted },
        })
    }

    /// Divides the whole fleet by other settings.
    fn divide(&self, settings: &EmbedderSettings, starts: usize) -> Result<Tuned, SolveError> {
        let embedded = self.embed(&self.frame, settings)?;
        let found = self.unlimited(&embedded, starts)?;
        let wanted = ClustererSettings {
            restarts: u32::try_from(starts).unwrap_or(u32::MAX),
            ..self.wanted.clone()
        };
        let (labels, unlimited) = match limited::rules(self.problem, &wanted)? {
            Some(rules) => {
                let within = limited::divide(self.problem, &wanted, &embedded, rules)?;
                (of_teams(&within), Some(found))
            }
            None => (found, None),
        };
        let silhouette = mean_silhouette(&embedded, &labels);
        let settings = settings.clone();
        Ok(Tuned { settings, silhouette, stability: None, moved: 0, labels, unlimited })
    }

    /// The vectors of a frame.
    fn embed(&self, frame: &Frame, settings: &EmbedderSettings) -> Result<Embedded, SolveError> {
        let params = EmbeddingParams {
            tolerance: settings.residual_tolerance,
            ..EmbeddingParams::once(settings, self.wanted.teams)
        };
        let params = params.check().map_err(MethodError::from);
        params.and_then(|params| embed(frame, &params, &mut |_| {})).or_else(of_method)
    }

    /// The team of each robot of a frame without limits.
    fn unlimited(
        &self,
        embedded: &Embedded,
        starts: usize,
    ) -> Result<Vec<Option<usize>>, SolveError> {
        let params =
            DivisionParams { restarts: starts, ..DivisionParams::new(&self.wanted, self.teams) };
        let params = params.check().or_else(|error| refuse("teams", error.to_string()))?;
        let (x, without) = (&embedded.x, &embedded.without_embedding);
        let division = divide(x, without, &params, None, &mut |_| {});
        Ok(division.or_else(|error| refuse("teams", error.to_string()))?.labels)
    }

    /// The mean adjusted Rand index of a division with those of robots that are drawn.
    fn stability(&self, tuned: &Tuned, draws: u32) -> Result<f64, SolveError> {
        let robots = self.frame.robots.len();
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of a few thousand robots"
        )]
        let drawn = (robots as f64 * DRAWN_SHARE).round() as usize;
        let whole = tuned.unlimited.as_ref().unwrap_or(&tuned.labels);
        let mut sum = 0.0;
        for draw in 0..draws {
            let mut random = ChaCha8Rng::seed_from_u64(u64::from(draw));
            let mut kept = sample(&mut random, robots, drawn).into_vec();
            kept.sort_unstable();
            let embedded = self.embed(&self.of_some(&kept)?, &tuned.settings)?;
            let labels = self.unlimited(&embedded, GRID_STARTS)?;
            let both = kept
                .iter()
                .zip(labels)
                .filter_map(|(robot, label)| Some((whole.get(*robot).copied().flatten()?, label?)));
            sum += adjusted_rand_index(both);
        }
        Ok(sum / f64::from(draws))
    }

    /// The fleet without the robots that were not drawn; `kept` rises.
    fn of_some(&self, kept: &[usize]) -> Result<Frame, SolveError> {
        let place = |robot: usize| kept.binary_search(&robot).ok();
        let mut graphs = Vec::with_capacity(self.problem.graphs.len());
        for graph in &self.problem.graphs {
            let edges = graph.matrix.triplets();
            let edges = edges.filter_map(|(from, to, w)| Some((place(from)?, place(to)?, w)));
            let matrix = SparseMatrix::from_triplets(kept.len(), edges)
                .or_else(|error| refuse(graph.name.as_str(), error.to_string()))?;
            graphs.push((graph.name.clone(), FrameGraph::Matrix(Arc::new(matrix))));
        }
        let robots = kept.iter().map(|robot| self.frame.robots[*robot].clone());
        Ok(Frame { robots: robots.collect(), graphs })
    }
}

/// The labels of a division under limits; none for robots without a team.
fn of_teams(within: &Within) -> Vec<Option<usize>> {
    let has_team = |label: &usize| within.ids.get(*label).is_some_and(Option::is_some);
    within.labels.iter().map(|label| Some(*label).filter(has_team)).collect()
}

/// The mean silhouette of the robots that have a team, among their vectors; none for fewer than two teams.
fn mean_silhouette(embedded: &Embedded, labels: &[Option<usize>]) -> Option<f64> {
    let rows: Vec<usize> = (0..labels.len()).filter(|row| labels[*row].is_some()).collect();
    let labels: Vec<usize> = labels.iter().flatten().copied().collect();
    let x = embedded.x.select_rows(&rows);
    silhouettes(&x, &labels, &SilhouetteParams::default()).ok().map(|scores| scores.mean)
}

/// Keeps the settings with the best silhouettes, best first; of those with the same division, the best one.
fn keep_best(best: &mut Vec<Tuned>, found: Tuned) {
    if let Some(place) = best.iter().position(|other| other.labels == found.labels) {
        if best[place].silhouette >= found.silhouette {
            return;
        }
        best.remove(place);
    }
    let place = best.partition_point(|other| other.silhouette >= found.silhouette);
    best.insert(place, found);
    best.truncate(SHORTLIST);
}

/// How many robots are in another team than before, when teams are matched so that the fewest are.
fn moved(labels: &[Option<usize>], before: &[Option<usize>]) -> usize {
    let count = |labels: &[Option<usize>]| labels.iter().flatten().max().map_or(0, |most| most + 1);
    let both: Vec<_> =
        labels.iter().zip(before).filter_map(|(new, old)| Some(((*new)?, *old))).collect();
    let (new, old): (Vec<usize>, Vec<Option<usize>>) = both.into_iter().unzip();
    let table = overlap_table(&new, count(labels), &old, count(before)).unwrap_or_default();
    let matched = match_by_overlap(&table).unwrap_or_default();
    let stay: u64 = table.iter().zip(matched).filter_map(|(row, old)| Some(row[old?])).sum();
    labels.len().saturating_sub(usize::try_from(stay).unwrap_or(usize::MAX))
}

fn of_method<T>(error: MethodError) -> Result<T, SolveError> {
    refuse("settings", error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_that_moved_are_counted_whatever_the_labels() {
        let labels = |list: &[usize]| list.iter().copied().map(Some).collect::<Vec<_>>();
        assert_eq!(moved(&labels(&[1, 1, 0, 0]), &labels(&[0, 0, 1, 1])), 0);
        assert_eq!(moved(&labels(&[0, 0, 0, 1]), &labels(&[5, 5, 3, 3])), 1);
        assert_eq!(moved(&[Some(0), None], &[Some(0), Some(0)]), 1);
        assert_eq!(moved(&[], &[]), 0);
    }
}
