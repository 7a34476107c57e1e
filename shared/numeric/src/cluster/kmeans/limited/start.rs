//! One start under limits: seeding, exact assignments, exchanges.

use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hash, Hasher};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::exchange::Exchanged;
use super::places::Places;
use super::seeding::capped_plus_plus;
use super::{KMeansLimits, LimitedKMeansError, cost_unit};
use crate::assignment::{Assigner, Bounds, Column, CostMatrix, Rules};
use crate::cluster::kmeans::division::INERTIA_TIE;
use crate::cluster::kmeans::options::{Init, KMeansOptions};
use crate::cluster::kmeans::points::Points;
use crate::cluster::kmeans::seeding;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::squared_distance;

/// Largest cost in units: a reserve that costs more is as expensive as one that costs this, which is far more than any
/// distance.
const MAX_UNITS: f64 = (1_u64 << 39) as f64;

/// A finished start.
pub(super) struct Divided {
    pub(super) labels: Vec<u32>,
    pub(super) centroids: DenseMatrix,
    pub(super) inertia: f64,
    pub(super) iterations: usize,
    pub(super) converged: bool,
    /// Prices of the robots that soft minima lack.
    pub(super) shortfall: i128,
}

/// What a cold start that is not the first came to.
pub(super) struct Later {
    /// The keys of the labels that it had.
    pub(super) visited: Vec<u64>,
    /// None if a start before it had the same labels.
    pub(super) found: Option<Divided>,
}

/// Why a start has no division.
enum Ended {
    /// A start before it had the same labels.
    Known,
    Failed(LimitedKMeansError),
}

impl From<LimitedKMeansError> for Ended {
    fn from(error: LimitedKMeansError) -> Self {
        Self::Failed(error)
    }
}

/// Two lists of labels with the same key are the same, but for one pair in 2⁶⁴: then a start is missed.
fn key_of(labels: &[u32]) -> u64 {
    let mut hasher = DefaultHasher::new();
    labels.hash(&mut hasher);
    hasher.finish()
}

/// What all starts have in common.
pub(super) struct Task<'a> {
    pub(super) points: &'a Points<'a>,
    pub(super) options: &'a KMeansOptions<'a>,
    pub(super) limits: &'a KMeansLimits<'a>,
    unit: f64,
    /// Place of the previous column of every point, where it still is one.
    pub(super) previous: Vec<Option<u32>>,
    /// Mean of the points that were in each team before and may be there, with those that are forced into it. A team is
    /// its robots: one that is forced into it does not take its id elsewhere.
    anchors: Vec<Option<Vec<f64>>>,
}

impl<'a> Task<'a> {
    pub(super) fn new(
        points: &'a Points<'a>,
        options: &'a KMeansOptions<'a>,
        limits: &'a KMeansLimits<'a>,
    ) -> Self {
        let rules = limits.rules.get();
        let place = |column: &Option<Column>| {
            column.and_then(|column| rules.index_of(column).ok()).map(|at| at as u32)
        };
        let previous: Vec<Option<u32>> =
            limits.previous.unwrap_or_default().iter().map(place).collect();
        let forced = (0..points.len())
            .map(|point| limits.rules.restrictions.only(point).map(|at| at as u32));
        let before = previous.iter().copied().chain(std::iter::repeat(None));
        let placed: Vec<Option<u32>> =
            forced.zip(before).map(|(first, second)| first.or(second)).collect();
        let anchors = means(points.x, &placed, rules.teams.len());
        Self { points, options, limits, unit: cost_unit(points), previous, anchors }
    }

    pub(super) fn teams(&self) -> usize {
        self.options.clusters
    }

    /// What a point adds to the inertia in a column.
    pub(super) fn cost(&self, point: usize, column: usize, centroids: &DenseMatrix) -> f64 {
        if column < centroids.rows() {
            squared_distance(self.points.x.row(point), centroids.row(column))
        } else {
            self.limits.reserve_cost
        }
    }

    /// Sum of what all points add.
    pub(super) fn inertia(&self, labels: &[u32], centroids: &DenseMatrix) -> f64 {
        let costs = labels.iter().enumerate();
        costs.map(|(point, label)| self.cost(point, *label as usize, centroids)).sum()
    }

    /// Prices of the robots that soft minima lack.
    fn shortfall(&self, labels: &[u32]) -> i128 {
        let rules = self.limits.rules;
        if rules.get().class_limits.iter().all(|limit| limit.wanted.is_none()) {
            return 0;
        }
        Places::new(rules, labels).shortfall()
    }

    /// Means of the teams; an empty team keeps its centroid.
    pub(super) fn update_means(&self, labels: &[u32], centroids: &mut DenseMatrix) {
        let labels: Vec<Option<u32>> = labels.iter().map(|label| Some(*label)).collect();
        for (team, mean) in means(self.points.x, &labels, self.teams()).into_iter().enumerate() {
            if let Some(mean) = mean {
                centroids.row_mut(team).copy_from_slice(&mean);
            }
        }
    }

    /// Cold start `number`, from the labels of which on it only follows the way of a start before it: it ends there.
    pub(super) fn later_start(
        &self,
        number: u64,
        before: &BTreeSet<u64>,
    ) -> Result<Later, LimitedKMeansError> {
        let mut visited = Vec::new();
        let visit = |key: u64| {
            visited.push(key);
            if before.contains(&key) { Err(Ended::Known) } else { Ok(()) }
        };
        let found = match self.start(number, visit) {
            Ok(found) => Some(found),
            Err(Ended::Known) => None,
            Err(Ended::Failed(error)) => return Err(error),
        };
        Ok(Later { visited, found })
    }

    /// Cold start `number`. `visit` receives the key of all labels from which the rest follows.
    pub(super) fn start<E: From<LimitedKMeansError>>(
        &self,
        number: u64,
        mut visit: impl FnMut(u64) -> Result<(), E>,
    ) -> Result<Divided, E> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed);
        rng.set_stream(number);
        let seeds = match self.options.init {
            Init::PlusPlus if self.limits.rules.get().reserve.is_some() => {
                let most = self.limits.reserve_cost;
                capped_plus_plus(self.points.x, self.teams(), most, &mut rng)
            }
            Init::PlusPlus => seeding::plus_plus(self.points, self.teams(), &mut rng),
            Init::Random => seeding::random(self.points.x, self.teams(), &mut rng),
        };
        let mut centroids = self.matched(&seeds)?;
        let limit = self.options.max_iterations;
        let mut assigner = Assigner::new();
        let mut iterations = 0;
        let mut least = f64::INFINITY;
        loop {
            let mut labels: Vec<u32> = Vec::new();
            while iterations < limit {
                iterations += 1;
                let next = self.assigned(&centroids, &mut assigner, 1.0)?;
                let same = next == labels;
                labels = next;
                if self.is_full(&labels) {
                    visit(key_of(&labels))?;
                }
                self.update_means(&labels, &mut centroids);
                let inertia = self.inertia(&labels, &centroids);
                // Rounding of costs could make assignments alternate for ever.
                if same || inertia >= least * (1.0 - INERTIA_TIE) {
                    break;
                }
                least = inertia;
            }
            let Exchanged { passes, moved, settled } =
                self.exchange(&mut labels, &mut centroids, 0.0);
            iterations += passes;
            if !moved || iterations >= limit {
                let inertia = self.inertia(&labels, &centroids);
                let converged = settled && !moved;
                let shortfall = self.shortfall(&labels);
                return Ok(Divided {
                    labels,
                    centroids,
                    inertia,
                    iterations,
                    converged,
                    shortfall,
                });
            }
        }
    }

    /// Whether each team has points, so that their means follow from the labels alone.
    fn is_full(&self, labels: &[u32]) -> bool {
        let mut has_points = vec![false; self.limits.rules.get().columns()];
        labels.iter().for_each(|label| has_points[*label as usize] = true);
        has_points[..self.teams()].iter().all(|has| *has)
    }

    /// The previous division, brought within the limits where it is not, and refined; `None` if there was none.
    pub(super) fn refined(&self) -> Result<Option<Divided>, LimitedKMeansError> {
        let teams = self.teams();
        let before = means(self.points.x, &self.previous, teams);
        if before.iter().all(Option::is_none) {
            return Ok(None);
        }
        let mut gaps = vec![f64::INFINITY; self.points.len()];
        let mut centroids = DenseMatrix::from_fn(teams, self.points.x.cols(), |_, _| 0.0);
        // Teams that had nobody begin at the points that are farthest from all others.
        let (old, new): (Vec<usize>, Vec<usize>) =
            (0..teams).partition(|team| before[*team].is_some());
        for team in old.into_iter().chain(new) {
            let farther =
                |best: usize, point: usize| if gaps[point] > gaps[best] { point } else { best };
            let farthest = (0..gaps.len()).fold(0, farther);
            let row = before[team].as_deref().unwrap_or_else(|| self.points.x.row(farthest));
            centroids.row_mut(team).copy_from_slice(row);
            for (gap, point) in gaps.iter_mut().zip(self.points.x.iter_rows()) {
                *gap = gap.min(squared_distance(point, row));
            }
        }
        let mut assigner = Assigner::new();
        let columns: Vec<Option<Column>> = self.limits.previous.unwrap_or_default().to_vec();
        assigner.set_previous(self.limits.rules, &columns);
        let keep = 1.0 - self.options.hysteresis;
        let mut labels = self.assigned(&centroids, &mut assigner, keep)?;
        self.update_means(&labels, &mut centroids);
        let Exchanged { passes, settled: converged, .. } =
            self.exchange(&mut labels, &mut centroids, self.options.hysteresis);
        let inertia = self.inertia(&labels, &centroids);
        let (iterations, shortfall) = (passes + 1, self.shortfall(&labels));
        Ok(Some(Divided { labels, centroids, inertia, iterations, converged, shortfall }))
    }

    /// The exact assignment to `centroids`, where the previous column of a point costs the share `keep` only.
    fn assigned(
        &self,
        centroids: &DenseMatrix,
        assigner: &mut Assigner,
        keep: f64,
    ) -> Result<Vec<u32>, LimitedKMeansError> {
        let rules = self.limits.rules;
        let columns = rules.get().columns();
        let reserve = self.limits.reserve_cost.min(MAX_UNITS * self.unit);
        let mut values = Vec::with_capacity(self.points.len() * columns);
        for (point, row) in self.points.x.iter_rows().enumerate() {
            let first = values.len();
            values.extend(centroids.iter_rows().map(|centroid| squared_distance(row, centroid)));
            if rules.get().reserve.is_some() {
                values.push(reserve);
            }
            if let Some(Some(own)) = self.previous.get(point).filter(|_| keep < 1.0) {
                values[first + *own as usize] *= keep;
            }
        }
        let costs = CostMatrix::from_floats(self.points.len(), columns, &values, self.unit)?;
        assigner.solve(rules, &costs)?;
        Ok(assigner.labels().to_vec())
    }

    /// The seeds in the order of the teams: those of teams with pinned or previous points near their means, or else
    /// seeds with many points for teams with much room.
    fn matched(&self, seeds: &DenseMatrix) -> Result<DenseMatrix, LimitedKMeansError> {
        let teams = self.teams();
        let rules = Rules { teams: vec![Bounds::new(1, 1); teams], ..Rules::new(teams, teams) };
        let Ok(rules) = rules.check() else { return Ok(seeds.clone()) };
        let values: Vec<f64> = if self.anchors.iter().any(Option::is_some) {
            let distance = |seed: &[f64], anchor: &Option<Vec<f64>>| {
                anchor.as_ref().map_or(0.0, |anchor| squared_distance(seed, anchor))
            };
            let rows = seeds.iter_rows();
            rows.flat_map(|seed| self.anchors.iter().map(move |a| distance(seed, a))).collect()
        } else {
            let sizes = nearest_counts(self.points.x, seeds);
            let bounds = &self.limits.rules.get().teams;
            let off = |size: usize, bounds: &Bounds| {
                let excess = size.saturating_sub(bounds.upper);
                (excess + bounds.lower.saturating_sub(size)) as f64
            };
            sizes.iter().flat_map(|size| bounds.iter().map(move |b| off(*size, b))).collect()
        };
        let unit = CostMatrix::unit_for(values.iter().fold(0.0, |a: f64, b| a.max(*b)));
        let costs = CostMatrix::from_floats(teams, teams, &values, unit)?;
        let mut assigner = Assigner::new();
        assigner.solve(&rules, &costs)?;
        let mut order = vec![0; teams];
        for (seed, team) in assigner.labels().iter().enumerate() {
            order[*team as usize] = seed;
        }
        Ok(seeds.select_rows(&order))
    }
}

/// Number of points that are nearest to each seed.
fn nearest_counts(x: &DenseMatrix, seeds: &DenseMatrix) -> Vec<usize> {
    let mut counts = vec![0; seeds.rows()];
    for row in x.iter_rows() {
        let mut best = (0, f64::INFINITY);
        for (seed, place) in seeds.iter_rows().enumerate() {
            let far = squared_distance(row, place);
            if far < best.1 {
                best = (seed, far);
            }
        }
        counts[best.0] += 1;
    }
    counts
}

/// Mean of the points of each team; `None` for a team without any.
fn means(x: &DenseMatrix, labels: &[Option<u32>], teams: usize) -> Vec<Option<Vec<f64>>> {
    let mut sums = vec![vec![0.0; x.cols()]; teams];
    let mut sizes = vec![0_usize; teams];
    for (row, label) in x.iter_rows().zip(labels) {
        let Some(team) = label.map(|label| label as usize).filter(|team| *team < teams) else {
            continue;
        };
        sizes[team] += 1;
        for (sum, value) in sums[team].iter_mut().zip(row) {
            *sum += value;
        }
    }
    let mean = |(mut sum, size): (Vec<f64>, usize)| {
        sum.iter_mut().for_each(|value| *value /= size.max(1) as f64);
        (size > 0).then_some(sum)
    };
    sums.into_iter().zip(sizes).map(mean).collect()
}
