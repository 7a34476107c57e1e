//! The job: from the rows of an embedding to named teams.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_method::division::{Division, divide as divide_robots};
use muster_method::limited::LimitedError;
use muster_method::params::{DivisionParams, ParamsError};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::remembered::RememberedTeams;
use muster_model::settings::ClustererSettings;
use muster_model::teams::{Member, Team, TeamChange, TeamCountScore, Teams};
use muster_numeric::assignment::{CostError, RulesError, WishesError};
use muster_numeric::kmeans::KMeansError;
use muster_numeric::margins::MarginError;
use muster_numeric::matching::MatchError;
use muster_numeric::matrix::{DenseMatrix, MatrixError};

use crate::identity::{self, Memory, Named};
use crate::limited;
use crate::passes::{Passed, until_it_stays};
use crate::rules::TeamRules;
use crate::seats::last_teams;

/// One embedding to divide.
#[derive(Debug, Clone)]
pub struct Job {
    /// The vectors of the robots.
    pub embedding: Checked<Embedding>,
    /// How it is divided.
    pub settings: ClustererSettings,
    /// What divisions have to respect; none if nothing is asked of them.
    pub rules: Option<Arc<TeamRules>>,
    /// How many teams the robots of the embedding are divided into.
    pub teams: u32,
    /// How many teams were asked for, with those that are absent.
    pub requested: u32,
    /// Whether those robots were in so many teams before.
    pub same_number: bool,
    /// Which robots stay in their last team.
    pub staying: Staying,
    /// Robots that have new orders, and do not stay.
    pub renewed: BTreeSet<RobotId>,
    /// The division that it goes on from; none if there is none.
    pub previous: Option<Checked<Teams>>,
    /// Teams that robots had before that.
    pub memory: Arc<Memory>,
}

/// Which robots stay in their last team, whatever their vectors are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Staying {
    /// Their vectors decide.
    #[default]
    None,
    /// All, while the robots of a team leave or return one after the other: until the last one has, its vectors and those
    /// of its neighbours rest on few relations.
    All,
    /// All, where a team that is there would be divided or put together with another one; otherwise their vectors decide. A
    /// whole team is absent: its loss has changed what the vectors of the others show, and its return would change it back.
    KeepingTeams,
}

/// Why an embedding is not divided.
#[derive(Debug, thiserror::Error)]
pub enum DivisionError {
    /// The vectors are no matrix.
    #[error(transparent)]
    Vectors(#[from] MatrixError),
    /// The settings are out of range.
    #[error(transparent)]
    Settings(#[from] ParamsError),
    /// k-means refuses the vectors.
    #[error(transparent)]
    KMeans(#[from] KMeansError),
    /// The margins of the robots cannot be computed.
    #[error(transparent)]
    Margins(#[from] MarginError),
    /// The clusters cannot be matched with the teams before.
    #[error(transparent)]
    Matching(#[from] MatchError),
    /// The rules do not fit the robots.
    #[error(transparent)]
    Rules(#[from] RulesError),
    /// k-means under limits refuses the vectors.
    #[error(transparent)]
    Limited(#[from] LimitedError),
    /// The wishes do not fit the robots.
    #[error(transparent)]
    Wishes(#[from] WishesError),
    /// The costs of robots in teams cannot be computed.
    #[error(transparent)]
    Costs(#[from] CostError),
}

/// Whether two embeddings hold the same robots with the same vectors, and the same evidence for a number of
/// teams.
pub fn same_data(left: &Embedding, right: &Embedding) -> bool {
    std::ptr::eq(left, right)
        || left.dimension == right.dimension
            && left.robots == right.robots
            && left.without_embedding == right.without_embedding
            && left.quality.teams_shown == right.quality.teams_shown
            && left.values == right.values
}

/// Robots of one cluster, as rows of the embedding, and its centroid.
pub(crate) struct Cluster {
    pub(crate) rows: Vec<usize>,
    centroid: Vec<f64>,
}

/// Divides the robots that have a non-zero embedding. The caller fills in header, leaders and stale robots.
///
/// # Errors
/// [`DivisionError`] if the vectors, settings or rules do not fit each other.
pub fn divide(job: &Job) -> Result<Teams, DivisionError> {
    let mut passed = divide_until_it_stays(job)?;
    if passed.left.is_empty() {
        return Ok(passed.found);
    }
    let mut job = job.clone();
    // A team whose robots would leave it again at once does not live again, so that the same is divided as it was.
    while let Some(memory) = job.memory.without(&passed.left) {
        job.rules = job.rules.map(|rules| {
            let rules = TeamRules::clone(&rules);
            Arc::new(rules.resolved(job.previous.as_deref(), &memory, &job.embedding))
        });
        job.memory = Arc::new(memory);
        passed = divide_until_it_stays(&job)?;
    }
    Ok(passed.found)
}

fn divide_until_it_stays(job: &Job) -> Result<Passed, DivisionError> {
    if let Some(rules) = &job.rules {
        return limited::divide(job, rules);
    }
    let found = divide_freely(job)?;
    if job.staying != Staying::KeepingTeams {
        return Ok(Passed { found, left: BTreeSet::new() });
    }
    // Robots that would have divided a team stay with the others, and may then be elsewhere by what is around them.
    Ok(until_it_stays(job.previous.as_deref(), &job.memory, found, |found| {
        let same_number = found.teams.len() == job.teams as usize;
        let previous = Some(Checked::new_unchecked(found.clone()));
        divide_freely(&Job { previous, same_number, ..job.clone() }).ok()
    }))
}

/// One division from the last one, without rules.
fn divide_freely(job: &Job) -> Result<Teams, DivisionError> {
    let x = vectors(&job.embedding)?;
    let previous = job.previous.as_deref().filter(|_| job.same_number);
    let last = previous.map(|previous| LastTeams::of(previous, job));
    let found = cluster(&x, job, last.as_ref())?;
    let named = |found| {
        assemble(job, &x, found, |_, members, unassigned| {
            Ok(identity::name(members, unassigned, job.previous.as_deref(), &job.memory)?)
        })
    };
    let teams = named(&found)?;
    if let (Staying::KeepingTeams, Some(last)) = (job.staying, &last)
        && !(last.are_kept_by(&found, job) && last.are_named_in(&teams, job))
        && let Some(found) = stay(&x, &last.labels, job)?
    {
        return named(&found);
    }
    Ok(teams)
}

/// The teams of a division, with the names that its clusters get. The clusters are ordered by their first rows.
pub(crate) fn assemble(
    job: &Job,
    x: &DenseMatrix,
    found: &Division,
    name: impl FnOnce(&[Cluster], &[Vec<&RobotId>], &[RobotId]) -> Result<Named, DivisionError>,
) -> Result<Teams, DivisionError> {
    let embedding = &*job.embedding;
    let margin_of = found.margins(x)?;
    let inertia = found.inertia;
    let clusters = gather(found);
    let unassigned: Vec<RobotId> = (0..embedding.robots.len())
        .filter(|&i| found.labels[i].is_none())
        .map(|i| embedding.robots[i].clone())
        .collect();

    let members: Vec<Vec<&RobotId>> = clusters
        .iter()
        .map(|cluster| cluster.rows.iter().map(|&i| &embedding.robots[i]).collect())
        .collect();
    let named = name(&clusters, &members, &unassigned)?;
    let mut teams: Vec<Team> = clusters
        .iter()
        .zip(named.ids)
        .filter_map(|(cluster, id)| {
            let leader = embedding.robots[*cluster.rows.first()?].clone();
            let member =
                |&i: &usize| Member { robot: embedding.robots[i].clone(), margin: margin_of[i] };
            let members = cluster.rows.iter().map(member).collect();
            Some(Team { id, members, leader, centroid: cluster.centroid.clone() })
        })
        .collect();
    teams.sort_by(|left, right| identity::order(&left.id).cmp(&identity::order(&right.id)));
    Ok(Teams {
        header: embedding.header.clone(),
        embedding: embedding.header.revision,
        requested: job.requested,
        considered: considered(&job.settings, embedding),
        teams,
        unassigned,
        stale: Vec::new(),
        inertia,
        changes: named.changes,
        next_team: named.next_team,
        limited: None,
        needs: vec![],
        provisional: vec![],
        held: vec![],
        remembered: RememberedTeams::default(),
    })
}

/// Steps of vectors for one unit of length. Robots that all relations place alike differ in the last bits by how the singular vectors were
/// computed, and are in the same place.
const STEPS: f64 = (1_u64 << 40) as f64;

/// The vectors of the robots as rows, N × D, without what is rounding.
pub(crate) fn vectors(embedding: &Embedding) -> Result<DenseMatrix, MatrixError> {
    let values = embedding.values.iter().map(|value| (value * STEPS).round() / STEPS).collect();
    DenseMatrix::new(embedding.robots.len(), embedding.dimension as usize, values)
}

/// The numbers of teams that the settings allow, with the evidence of the embedding.
fn considered(settings: &ClustererSettings, embedding: &Embedding) -> Vec<TeamCountScore> {
    if settings.teams.fixed().is_some() {
        return Vec::new();
    }
    let scores = (1..).zip(&embedding.quality.team_scores);
    let possible = scores.filter(|(teams, _)| settings.teams.range().contains(teams));
    possible.map(|(teams, score)| TeamCountScore { teams, score: *score }).collect()
}

/// The same division with some robots in the teams of which `held` has the ids; centroids, margins and inertia
/// are those of the robots that are then together. Every team keeps a robot, and `rules` hold.
///
/// # Errors
/// [`DivisionError`] as for the division itself.
pub fn with_held(
    new: &Teams,
    held: &BTreeMap<RobotId, TeamId>,
    rules: Option<&TeamRules>,
    embedding: &Embedding,
) -> Result<Teams, DivisionError> {
    let robots = &embedding.robots;
    let number_of: BTreeMap<&TeamId, usize> =
        new.teams.iter().enumerate().map(|(number, team)| (&team.id, number)).collect();
    let mut labels = vec![None; robots.len()];
    for (robot, team) in new.assignments() {
        if let Ok(row) = robots.binary_search(robot) {
            labels[row] = number_of.get(held.get(robot).unwrap_or(team)).copied();
        }
    }
    let x = vectors(embedding)?;
    let centroids = means(&x, &labels, new.teams.len())?;
    let inertia = inertia(&x, &labels, &centroids);
    let found = Division { labels, centroids, inertia, iterations: 0, converged: true };
    let margin_of = found.margins(&x)?;
    let mut teams = new.clone();
    for (number, team) in teams.teams.iter_mut().enumerate() {
        team.centroid = found.centroids.row(number).to_vec();
        let rows = (0..robots.len()).filter(|row| found.labels[*row] == Some(number));
        let member = |row: usize| Member { robot: robots[row].clone(), margin: margin_of[row] };
        team.members = rows.map(member).collect();
        if let Some(first) = team.members.first() {
            team.leader = first.robot.clone();
        }
    }
    teams.inertia = inertia;
    // A division that lacks what it needs says why, whoever stays.
    let lacks = new.limited.as_ref().is_some_and(|limited| limited.conflict.is_some());
    if let Some(rules) = rules.filter(|_| !lacks) {
        teams.limited = Some(limited::judge(rules, &teams, embedding)?);
    }
    Ok(teams)
}

/// The sum of squared distances of the rows to the centroids of their labels.
pub(crate) fn inertia(x: &DenseMatrix, labels: &[Option<usize>], centroids: &DenseMatrix) -> f64 {
    let squares = x.iter_rows().zip(labels).filter_map(|(row, label)| {
        let centre = centroids.row((*label)?);
        Some(row.iter().zip(centre).map(|(x, mean)| (x - mean).powi(2)).sum::<f64>())
    });
    // The sum of nothing would be -0.
    squares.fold(0.0, |sum, square| sum + square)
}

/// The mean row of each label.
#[expect(clippy::cast_precision_loss, reason = "there are fewer than 2⁵³ robots")]
pub(crate) fn means(
    x: &DenseMatrix,
    labels: &[Option<usize>],
    count: usize,
) -> Result<DenseMatrix, MatrixError> {
    let mut sums = vec![0.0; count * x.cols()];
    let mut sizes = vec![0_usize; count];
    for (row, label) in x.iter_rows().zip(labels) {
        let Some(label) = *label else { continue };
        sizes[label] += 1;
        for (sum, value) in sums[label * x.cols()..].iter_mut().zip(row) {
            *sum += value;
        }
    }
    for (sums, size) in sums.chunks_mut(x.cols().max(1)).zip(sizes) {
        sums.iter_mut().for_each(|sum| *sum /= size.max(1) as f64);
    }
    DenseMatrix::new(count, x.cols(), sums)
}

/// Those changes of a new division that are about teams, and the robots of it that are elsewhere than before.
pub fn changes(new: &Teams, before: Option<&Teams>) -> Vec<TeamChange> {
    let of_teams = |change: &&TeamChange| !matches!(change, TeamChange::Moved { .. });
    let mut changes: Vec<TeamChange> = new.changes.iter().filter(of_teams).cloned().collect();
    if let Some(before) = before {
        changes.extend(identity::moved(new, before));
    }
    changes
}

/// k-means, from the teams before where those were as many.
fn cluster(
    x: &DenseMatrix,
    job: &Job,
    last: Option<&LastTeams<'_>>,
) -> Result<Division, DivisionError> {
    let Job { embedding, settings, .. } = job;
    let warm = last.map(|last| &*last.labels);
    if let (Staying::All, Some(labels)) = (job.staying, warm)
        && let Some(found) = stay(x, labels, job)?
    {
        return Ok(found);
    }
    let params = DivisionParams::new(settings, job.teams as usize).check()?;
    let without = &embedding.without_embedding;
    Ok(divide_robots(x, without, &params, warm, &mut |_| {})?)
}

/// The teams of the robots before.
struct LastTeams<'a> {
    ids: Vec<&'a TeamId>,
    /// The place among `ids` of each robot's team; none for robots without a team or without a vector.
    labels: Vec<Option<usize>>,
}

impl<'a> LastTeams<'a> {
    fn of(previous: &'a Teams, job: &'a Job) -> Self {
        let embedding = &*job.embedding;
        // A robot may remember a team that has ended and is not awaited: that is none of the teams to keep.
        let none = BTreeSet::new();
        let kept: BTreeSet<&TeamId> = {
            let living = previous.teams.iter().map(|team| &team.id);
            living.chain(job.memory.lost_teams(&none)).collect()
        };
        let last = last_teams(previous, &job.memory, embedding);
        let last: Vec<_> = last.into_iter().map(|id| id.filter(|id| kept.contains(*id))).collect();
        let ids: BTreeSet<&TeamId> = last.iter().flatten().copied().collect();
        let number_of: BTreeMap<&TeamId, usize> = ids.iter().copied().zip(0..).collect();
        let mut labels = last.into_iter().map(|id| number_of.get(id?).copied());
        let label = |without: &bool| if *without { None } else { labels.next().flatten() };
        let labels = embedding.without_embedding.iter().map(label).collect();
        Self { ids: ids.into_iter().collect(), labels }
    }

    /// The place of each robot's team, and the row of the robot, without those that have new orders.
    fn without_orders(&self, job: &Job) -> impl Iterator<Item = (usize, usize)> {
        let rows = self.labels.iter().zip(&job.embedding.robots).enumerate();
        rows.filter(|(_, (_, robot))| !job.renewed.contains(*robot))
            .filter_map(|(row, (label, _))| Some(((*label)?, row)))
    }

    /// Whether each of them has half of its robots in a cluster of its own.
    fn are_kept_by(&self, found: &Division, job: &Job) -> bool {
        let mut robots: BTreeMap<usize, BTreeMap<usize, usize>> = BTreeMap::new();
        for (last, row) in self.without_orders(job) {
            if let Some(now) = found.labels[row] {
                *robots.entry(last).or_default().entry(now).or_default() += 1;
            }
        }
        let mut taken = BTreeSet::new();
        robots.values().all(|clusters| {
            let all: usize = clusters.values().sum();
            let mut halves = clusters.iter().filter(|(_, count)| **count * 2 >= all);
            halves.any(|(cluster, _)| taken.insert(*cluster))
        })
    }

    /// Whether each of them has its id. Where half of a team parts from the others, the other half may be called a team that is
    /// remembered, and these robots the team of a third one, which then has none.
    fn are_named_in(&self, teams: &Teams, job: &Job) -> bool {
        let named: BTreeSet<&TeamId> = teams.teams.iter().map(|team| &team.id).collect();
        self.without_orders(job).all(|(last, _)| named.contains(self.ids[last]))
    }
}

/// Every robot in its last team, but for those that have none or have new orders: these are in the nearest one.
/// None if these are not as many teams as are asked for.
fn stay(
    x: &DenseMatrix,
    last: &[Option<usize>],
    job: &Job,
) -> Result<Option<Division>, DivisionError> {
    let embedding = &*job.embedding;
    let stays = |row: usize| last[row].filter(|_| !job.renewed.contains(&embedding.robots[row]));
    let mut labels: Vec<Option<usize>> = (0..last.len()).map(stays).collect();
    let teams = job.teams as usize;
    let filled: BTreeSet<usize> = labels.iter().flatten().copied().collect();
    if filled.len() != teams || filled.last().is_none_or(|last| last + 1 != teams) {
        return Ok(None);
    }
    let centroids = means(x, &labels, teams)?;
    for (row, label) in labels.iter_mut().enumerate() {
        if label.is_none() && !embedding.without_embedding[row] {
            *label = nearest(x.row(row), &centroids);
        }
    }
    let centroids = means(x, &labels, teams)?;
    let inertia = inertia(x, &labels, &centroids);
    Ok(Some(Division { labels, centroids, inertia, iterations: 0, converged: true }))
}

/// The centroid that is nearest to a row, the first of equal ones.
fn nearest(row: &[f64], centroids: &DenseMatrix) -> Option<usize> {
    let distance =
        |centre: &[f64]| row.iter().zip(centre).map(|(x, mean)| (x - mean).powi(2)).sum::<f64>();
    let all = centroids.iter_rows().map(distance).enumerate();
    all.min_by(|left, right| left.1.total_cmp(&right.1)).map(|(number, _)| number)
}

/// The clusters, ordered by their smallest member, so that nothing rests on how they were numbered.
fn gather(found: &Division) -> Vec<Cluster> {
    let mut clusters: Vec<Cluster> = found
        .centroids
        .iter_rows()
        .map(|centroid| Cluster { rows: Vec::new(), centroid: centroid.to_vec() })
        .collect();
    for (row, label) in found.labels.iter().enumerate() {
        if let Some(cluster) = label.and_then(|label| clusters.get_mut(label)) {
            cluster.rows.push(row);
        }
    }
    clusters.retain(|cluster| !cluster.rows.is_empty());
    clusters.sort_by_key(|cluster| cluster.rows.first().copied());
    clusters
}
