//! The job where operators have set rules: from the rows of an embedding to teams that obey them.

use std::collections::{BTreeMap, BTreeSet};

use muster_method::division::Division;
use muster_method::limited::{
    LimitedError, Limits, Optimality, PlacePrice, divide_within, optimality, rows_of,
};
use muster_method::params::DivisionParams;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, SkillId, TeamId};
use muster_model::limits::MAX_CONFLICT_LENGTH;
use muster_model::teams::{Limited, SkillPrices, Team, Teams};
use muster_numeric::assignment::{
    Assigner, Bounds, Column, CostMatrix, Pair, Rules, ValidRules, ValidWishes, Wishes,
};
use muster_numeric::kmeans::LimitedKMeansError;
use muster_numeric::matrix::DenseMatrix;

use crate::division::{DivisionError, Job, assemble, vectors};
use crate::identity;
use crate::passes::{Passed, has_same_teams, until_it_stays};
use crate::rules::TeamRules;
use crate::seats::last_of;

/// Two teams exchange most of their robots only where the sum of squared distances becomes this share of what it was, or less.
const EXCHANGE_SHARE: f64 = 0.5;

/// Divides the robots that have a non-zero embedding. While nothing satisfies the rules the last division stands.
///
/// Teams do not swap their ids for a few robots, so that what is found depends on where robots were: from what was found
/// something better may be found that was out of reach before. So it is divided again until nothing changes any more.
pub(crate) fn divide(job: &Job, rules: &TeamRules) -> Result<Passed, DivisionError> {
    let found = divide_from(job, rules)?;
    let first = job.previous.as_deref();
    // Wishes that would change a team that is new, or lives again, count from the next division on: it keeps a robot of before until
    // then.
    let lives = |id: &TeamId| first.is_some_and(|first| first.teams.iter().any(|t| t.id == *id));
    let new = found.teams.iter().map(|team| &team.id).filter(|id| !lives(id));
    let rules = rules.without_new_wishes(&new.collect(), &found);
    Ok(until_it_stays(first, &job.memory, found, |found| {
        let again = Job { previous: Some(Checked::new_unchecked(found.clone())), ..job.clone() };
        let rules = rules.clone().resolved(Some(found), &job.memory, &job.embedding);
        // A search may end before it finds anything; what was found stands.
        divide_from(&again, &rules).ok()
    }))
}

/// One division, from the last one: the best one, or else, where two teams would exchange their robots for little, the best one that
/// is reached from the last one step by step.
fn divide_from(job: &Job, rules: &TeamRules) -> Result<Teams, DivisionError> {
    let best = divide_once(job, rules, Search::All)?;
    let Some(last) = job.previous.as_deref().filter(|last| has_same_teams(last, &best)) else {
        return Ok(best);
    };
    if keeps_ids(last, &best) || !is_sound(rules, last, &best) {
        return Ok(best);
    }
    let Ok(near) = divide_once(job, rules, Search::Refining) else { return Ok(best) };
    let is_better = best.inertia <= EXCHANGE_SHARE * near.inertia;
    let is_near = has_same_teams(last, &near) && keeps_ids(last, &near);
    Ok(if is_near && !is_better { near } else { best })
}

/// Whether the robots of a division were in the teams of the last one as the rules want it.
fn is_sound(rules: &TeamRules, last: &Teams, found: &Teams) -> bool {
    let has_conflict = found.limited.as_ref().is_some_and(|limited| limited.conflict.is_some());
    let unfilled = |teams: &Teams| -> usize {
        let of_team = |team: &Team| rules.needs.unfilled_by(&team.id, &robots_of(team));
        teams.teams.iter().map(of_team).sum()
    };
    let placed: BTreeMap<RobotId, TeamId> =
        last.assignments().map(|(robot, team)| (robot.clone(), team.clone())).collect();
    let columns: Vec<TeamId> = last.teams.iter().map(|team| team.id.clone()).collect();
    let admits = |team: &Team| rules.admits(&team.id, &team.id, &robots_of(team), &columns);
    !has_conflict
        && unfilled(last) <= unfilled(found)
        && found.assignments().count() == placed.len()
        && found.assignments().all(|(robot, _)| placed.contains_key(robot))
        && last.teams.iter().all(admits)
        && rules.grants_groups(&placed)
}

fn robots_of(team: &Team) -> Vec<&RobotId> {
    team.members.iter().map(|member| &member.robot).collect()
}

/// Whether no two teams exchange their ids, at once or bit by bit: of more than two robots fewer went from one to the other
/// than stayed.
fn keeps_ids(before: &Teams, now: &Teams) -> bool {
    let team_of: BTreeMap<&RobotId, &TeamId> = before.assignments().collect();
    let mut counts: BTreeMap<(&TeamId, &TeamId), usize> = BTreeMap::new();
    for (robot, team) in now.assignments() {
        if let Some(last) = team_of.get(robot) {
            *counts.entry((*last, team)).or_default() += 1;
        }
    }
    let count = |from: &TeamId, to: &TeamId| counts.get(&(from, to)).copied().unwrap_or_default();
    let fits = |(a, b): (&TeamId, &TeamId)| {
        let (crossed, stayed) = (count(a, b) + count(b, a), count(a, a) + count(b, b));
        crossed < stayed || crossed == stayed && crossed <= 2
    };
    let ids: Vec<&TeamId> = now.teams.iter().map(|team| &team.id).collect();
    ids.iter().enumerate().all(|(at, a)| ids[..at].iter().all(|b| fits((a, b))))
}

/// One division, from the last one.
fn divide_once(job: &Job, rules: &TeamRules, search: Search) -> Result<Teams, DivisionError> {
    let embedding = &*job.embedding;
    let rows = rules.rows(embedding);
    let solved =
        if rows.is_empty() { Solved::default() } else { solve(job, rules, &rows, search)? };
    let Solved { columns, labels, limited } = solved;
    let stands = limited.as_ref().is_some_and(Limited::stands);
    let mut ids: Vec<TeamId> = Vec::new();
    let mut all = vec![None; embedding.robots.len()];
    for (id, column) in columns.iter().zip(0..) {
        let members = labels.iter().zip(&rows).filter(|(label, _)| **label == Some(column));
        let mut members = members.map(|(_, row)| *row).peekable();
        if members.peek().is_some() {
            for row in members {
                all[row] = Some(ids.len());
            }
            ids.push(id.clone());
        }
    }
    let clusters = clusters_of(&embedding.robots, &all, ids.len());
    let unassigned = embedding.robots.iter().zip(&all).filter(|(_, label)| label.is_none());
    let unassigned: Vec<RobotId> = unassigned.map(|(robot, _)| robot.clone()).collect();
    revive(job, rules, &clusters, &unassigned, stands, &mut ids);
    if !stands {
        keep_left_out(job, rules, &clusters, &mut ids);
    }
    let x = vectors(embedding)?;
    let centroids = crate::division::means(&x, &all, ids.len())?;
    let inertia = crate::division::inertia(&x, &all, &centroids);
    let found = Division { labels: all, centroids, inertia, iterations: 0, converged: true };
    let mut teams = assemble(job, &x, &found, |clusters, members, unassigned| {
        let id_of = |row: usize| found.labels[row].and_then(|label| ids.get(label)).cloned();
        let ids = clusters.iter().filter_map(|cluster| id_of(*cluster.rows.first()?)).collect();
        Ok(identity::named(members, ids, unassigned, job.previous.as_deref(), &job.memory))
    })?;
    teams.limited = Some(match limited {
        Some(limited) => limited,
        None => judge(rules, &teams, embedding)?,
    });
    Ok(teams)
}

/// The robots of each of so many clusters.
fn clusters_of<'a>(
    robots: &'a [RobotId],
    labels: &[Option<usize>],
    count: usize,
) -> Vec<Vec<&'a RobotId>> {
    let mut clusters = vec![Vec::new(); count];
    for (robot, label) in robots.iter().zip(labels) {
        if let Some(label) = *label {
            clusters[label].push(robot);
        }
    }
    clusters
}

/// Gives clusters the ids of teams that were left out as fewer are made, where more of their robots were in such a team
/// than in the one that they would become: which teams are left out is decided before it is known which robots stay
/// together. Limits, needs and wishes of a team that is named are its own, so that its id goes to no other robots.
fn keep_left_out(job: &Job, rules: &TeamRules, clusters: &[Vec<&RobotId>], ids: &mut [TeamId]) {
    let Some(previous) = &job.previous else { return };
    let last: BTreeMap<&RobotId, &TeamId> = previous.assignments().collect();
    let last_of =
        |robot: &RobotId| last.get(robot).copied().or_else(|| job.memory.last_team(robot));
    let mut shared: BTreeMap<(usize, &TeamId), usize> = BTreeMap::new();
    for (cluster, robots) in clusters.iter().enumerate() {
        for team in robots.iter().filter_map(|robot| last_of(robot)) {
            *shared.entry((cluster, team)).or_default() += 1;
        }
    }
    let lives = |id: &TeamId| previous.teams.iter().any(|team| team.id == *id);
    // Each turn more robots keep their team, so that there are no more turns than robots.
    loop {
        let gain = |cluster: usize, count: usize| {
            let own = shared.get(&(cluster, &ids[cluster])).copied().unwrap_or_default();
            count.saturating_sub(own)
        };
        let admits = |cluster: usize, team: &TeamId| {
            let mut after = ids.to_vec();
            after[cluster].clone_from(team);
            rules.admits(team, &ids[cluster], &clusters[cluster], &after)
        };
        let may_be = |cluster: usize, team: &TeamId| {
            !ids.contains(team)
                && lives(team)
                && !rules.names(team)
                && !rules.names(&ids[cluster])
                && admits(cluster, team)
        };
        let gains =
            shared.iter().map(|(&(cluster, team), &count)| (gain(cluster, count), cluster, team));
        // Of equal ones the first.
        let best = gains
            .filter(|(gain, cluster, team)| *gain > 0 && may_be(*cluster, team))
            .reduce(|best, other| if other.0 > best.0 { other } else { best });
        let Some((_, cluster, team)) = best else { return };
        ids[cluster].clone_from(team);
    }
}

/// Gives new teams the ids of those that ended, where most of their robots are back in one, and the limits of the old team
/// and the wishes of these robots allow it; `stands` if no rules hold for now. Wishes of other robots that name such a team
/// count from the next division on, which follows at once.
fn revive(
    job: &Job,
    rules: &TeamRules,
    clusters: &[Vec<&RobotId>],
    unassigned: &[RobotId],
    stands: bool,
    ids: &mut [TeamId],
) {
    let living = job.previous.as_deref().map_or(&[][..], |previous| &previous.teams);
    let lives = |id: &TeamId| living.iter().any(|team| team.id == *id);
    for (id, cluster, _) in job.memory.revivable(clusters, unassigned) {
        // Also while no rules hold no team has more robots than it may have.
        let robots = clusters[cluster].len();
        let mut after = ids.to_vec();
        after[cluster].clone_from(id);
        let is_sound = rules.admits(id, &ids[cluster], &clusters[cluster], &after);
        let has_room = || is_sound || stands && robots <= rules.bounds(id).upper;
        if !lives(id) && !lives(&ids[cluster]) && has_room() {
            ids[cluster] = id.clone();
        }
    }
}

/// How a division that obeys the rules stands to the best assignment to its teams.
pub(crate) fn judge(
    rules: &TeamRules,
    teams: &Teams,
    embedding: &Embedding,
) -> Result<Limited, DivisionError> {
    let place = |robot: &RobotId| embedding.robots.binary_search(robot).ok();
    let (mut rows, mut labels) = (Vec::new(), Vec::new());
    for (label, team) in teams.teams.iter().enumerate() {
        for row in team.members.iter().filter_map(|member| place(&member.robot)) {
            rows.push(row);
            labels.push(label);
        }
    }
    if rows.is_empty() {
        return Ok(Limited::open());
    }
    let columns: Vec<TeamId> = teams.teams.iter().map(|team| team.id.clone()).collect();
    let dimension = embedding.dimension as usize;
    let x = rows_of(&vectors(embedding)?, &rows)?;
    let centroids = teams.teams.iter().flat_map(|team| team.centroid.iter().copied()).collect();
    let centroids = DenseMatrix::new(columns.len(), dimension, centroids)?;
    let robots: Vec<&RobotId> = rows.iter().map(|row| &embedding.robots[*row]).collect();
    let valid = rules.assignment(&columns, &robots)?;
    let groups = rules.groups(&valid, &columns, &robots)?.valid;
    let found = optimality(&x, &labels, &centroids, &valid, &groups)?;
    let skill_prices = skill_prices(rules, &found.class_prices, &columns, &robots);
    let mut jointly: Vec<RobotId> =
        found.jointly.iter().filter_map(|at| Some((*robots.get(*at)?).clone())).collect();
    jointly.sort_unstable();
    let Optimality { optimal, gap, prices, .. } = found;
    Ok(Limited { optimal, gap, conflict: None, prices, skill_prices, jointly })
}

/// The prices of needed skills that are any.
fn skill_prices(
    rules: &TeamRules,
    found: &[PlacePrice],
    columns: &[TeamId],
    robots: &[&RobotId],
) -> Vec<SkillPrices> {
    let skills = rules.needs.class_names();
    let of_class = |(class, skill): (usize, &&SkillId)| {
        let mut prices = vec![0.0; columns.len()];
        for of in found.iter().filter(|of| of.class == class) {
            if let Some(price) = prices.get_mut(of.team) {
                *price = of.price;
            }
        }
        let mut able: Vec<RobotId> =
            robots.iter().filter(|robot| rules.needs.has(skill, robot)).copied().cloned().collect();
        able.sort_unstable();
        let has_price = prices.iter().any(|price| *price != 0.0);
        has_price.then(|| SkillPrices { skill: (*skill).clone(), robots: able, prices })
    };
    skills.iter().enumerate().filter_map(of_class).collect()
}

/// A division as the assignment gives it.
#[derive(Default)]
struct Solved {
    /// The team that each column is.
    columns: Vec<TeamId>,
    /// The column of each robot; none for one in the reserve.
    labels: Vec<Option<usize>>,
    /// How it stands to the rules, where nothing satisfies all of them.
    limited: Option<Limited>,
}

/// Robots, teams and rules as the assignment sees them.
struct Problem<'a> {
    rules: &'a TeamRules,
    robots: Vec<&'a RobotId>,
    x: DenseMatrix,
    /// The teams that there may be.
    columns: Vec<TeamId>,
    /// The place of the last team of each robot among them.
    previous: Vec<Option<Column>>,
}

/// Which teams make room for others.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Closing {
    /// Those in which no robot may be.
    Closed,
    /// None: the last division is to stand.
    Nothing,
}

/// Which divisions are looked at.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Search {
    /// Those from many starts.
    All,
    /// Those that are reached from the last one step by step.
    Refining,
}

/// The best division within the rules; the last one where nothing satisfies them.
fn solve(
    job: &Job,
    rules: &TeamRules,
    rows: &[usize],
    search: Search,
) -> Result<Solved, DivisionError> {
    match Problem::new(job, rules, rows, Closing::Closed)?.solve(job, search)? {
        Ok(solved) => Ok(solved),
        Err(conflict) => Problem::new(job, rules, rows, Closing::Nothing)?.stand(job, conflict),
    }
}

impl<'a> Problem<'a> {
    fn new(
        job: &'a Job,
        rules: &'a TeamRules,
        rows: &[usize],
        closing: Closing,
    ) -> Result<Self, DivisionError> {
        let embedding = &*job.embedding;
        let last = last_of(job.previous.as_deref(), &job.memory, embedding, rows);
        let teams = (job.teams as usize).min(rows.len());
        let robots: Vec<&RobotId> = rows.iter().map(|row| &embedding.robots[*row]).collect();
        let asked = if closing == Closing::Closed { &robots[..] } else { &[] };
        let columns = rules.columns(teams, asked, &last, job.previous.as_deref(), &job.memory);
        let columns = columns.columns;
        let place_of: BTreeMap<&TeamId, usize> = columns
            .iter()
            .zip(0..)
            .filter_map(|(column, at)| Some((column.last.as_ref()?, at)))
            .collect();
        let place = |id: &Option<&TeamId>| Some(Column::Team(*place_of.get((*id)?)?));
        let previous = last.iter().map(place).collect();
        let columns = columns.into_iter().map(|column| column.team).collect();
        let x = rows_of(&vectors(embedding)?, rows)?;
        Ok(Self { rules, robots, x, columns, previous })
    }

    /// The column of each robot within rules.
    ///
    /// Teams do not swap their ids so that a few robots need not be among others: with one robot pinned into another
    /// team it would cost less distance to give that team's id to all robots of the first. What was found is then
    /// begun from again with the ids that most robots had.
    fn divided(
        &self,
        job: &Job,
        rules: &ValidRules,
        groups: &ValidWishes,
        search: Search,
    ) -> Result<Result<Vec<Option<usize>>, LimitedError>, DivisionError> {
        let params = DivisionParams::new(&job.settings, self.columns.len()).check()?;
        let within = |previous: &[Option<Column>], refine_only: bool| {
            let limits = Limits { rules, groups, previous, refine_only };
            divide_within(&self.x, &params, &limits)
        };
        let found = match within(&self.previous, search == Search::Refining) {
            Ok(found) => found,
            Err(error) => return Ok(Err(error)),
        };
        if search == Search::Refining {
            return Ok(Ok(found.labels));
        }
        let Some(kept) = self.with_kept_ids(&found.labels) else { return Ok(Ok(found.labels)) };
        // A search that ends before it finds anything leaves what was found first.
        let begun = [&self.previous, &kept].map(|previous| within(previous, true).ok());
        let least = match begun {
            [Some(before), Some(other)] => {
                let stays = before.inertia <= (1.0 + job.settings.hysteresis) * other.inertia;
                if stays { before } else { other }
            }
            [before, other] => before.or(other).unwrap_or(found),
        };
        Ok(Ok(least.labels))
    }

    /// The columns of the same clusters under the ids that most robots had, where the rules let fewer robots keep theirs.
    fn with_kept_ids(&self, labels: &[Option<usize>]) -> Option<Vec<Option<Column>>> {
        let Clusters { members, shared } = self.clusters(labels);
        let keeping = |order: &[usize]| -> i64 {
            order.iter().zip(&shared).map(|(column, shared)| shared[*column]).sum()
        };
        let within = self.order_within(&members, &shared);
        let free = matched(&shared, self.robots.len(), |_, _| true)?;
        let column = |label: &Option<usize>| label.map(|label| Column::Team(free[label]));
        (keeping(&within) < keeping(&free)).then(|| labels.iter().map(column).collect())
    }

    /// The best division within the rules; why there is none, where nothing satisfies them.
    fn solve(self, job: &Job, search: Search) -> Result<Result<Solved, String>, DivisionError> {
        // Where needs cannot all be filled, as many are as can be, and all else holds.
        let mut first_conflict = None;
        let lenient = self.rules.needs.lenient();
        let lenient = lenient.into_iter().map(|needs| self.rules.with_needs(needs));
        for rules in std::iter::once(self.rules.clone()).chain(lenient) {
            let conflict = match rules.conflict(&self.columns, &self.robots) {
                Some(conflict) => conflict,
                None => {
                    let valid = rules.assignment(&self.columns, &self.robots)?;
                    let groups = rules.groups(&valid, &self.columns, &self.robots)?;
                    match self.divided(job, &valid, &groups.valid, search)? {
                        Ok(labels) => {
                            let columns = self.named(&labels);
                            let limited = first_conflict.map(Limited::lacking);
                            return Ok(Ok(Solved { columns, labels, limited }));
                        }
                        // The search ended before it found anything.
                        Err(LimitedError::Groups(error)) => {
                            error.to_string().chars().take(MAX_CONFLICT_LENGTH).collect()
                        }
                        Err(error) => return Err(error.into()),
                    }
                }
            };
            first_conflict.get_or_insert(conflict);
        }
        Ok(Err(first_conflict.unwrap_or_default()))
    }

    /// The last division, as nothing satisfies the rules.
    fn stand(self, job: &Job, conflict: String) -> Result<Solved, DivisionError> {
        let relaxed = |stay: &[Option<Column>]| -> Result<_, DivisionError> {
            let rules = self.rules.relaxed(&self.columns, &self.robots, stay)?;
            let no_wishes = Wishes::default().check(&rules)?;
            self.divided(job, &rules, &no_wishes, Search::All)
        };
        let members: BTreeSet<&RobotId> = match job.previous.as_deref() {
            Some(last) => last.assignments().map(|(robot, _)| robot).collect(),
            None => BTreeSet::new(),
        };
        let is_member = |robot: &&RobotId| members.contains(*robot);
        let stays = self.robots.iter().map(is_member).zip(&self.previous);
        let of_members = stays.map(|(is_member, last)| last.filter(|_| is_member)).collect();
        let no_robot = vec![None; self.robots.len()];
        // A team may have more robots than it may hold: with those that come back, or by itself, if its limits have changed.
        let mut found = relaxed(&self.previous)?;
        for stay in [of_members, no_robot] {
            let Err(LimitedError::KMeans(LimitedKMeansError::Assignment(_))) = found else { break };
            found = relaxed(&stay)?;
        }
        let limited = Some(Limited::standing(conflict));
        Ok(Solved { columns: self.columns, labels: found?, limited })
    }

    /// The team that each column becomes: of those whose rules it obeys, such that most robots stay in their team.
    fn named(&self, labels: &[Option<usize>]) -> Vec<TeamId> {
        let Clusters { members, shared } = self.clusters(labels);
        let mut order = self.order_within(&members, &shared);
        self.sort_new(&members, &mut order);
        order.into_iter().map(|column| self.columns[column].clone()).collect()
    }

    /// The robots of each column, and where they were.
    fn clusters(&self, labels: &[Option<usize>]) -> Clusters<'a> {
        let count = self.columns.len();
        let mut members: Vec<Vec<&RobotId>> = vec![Vec::new(); count];
        let mut shared = vec![vec![0_i64; count]; count];
        for ((robot, label), previous) in self.robots.iter().zip(labels).zip(&self.previous) {
            let Some(label) = *label else { continue };
            members[label].push(*robot);
            if let Some(Column::Team(team)) = *previous {
                shared[label][team] += 1;
            }
        }
        Clusters { members, shared }
    }

    /// The column whose team each cluster becomes, by the rules, such that most robots stay in their team.
    fn order_within(&self, members: &[Vec<&RobotId>], shared: &[Vec<i64>]) -> Vec<usize> {
        let order = (0..members.len()).collect();
        let is_most = |(at, row): (usize, &Vec<i64>)| row.iter().all(|shared| *shared <= row[at]);
        if shared.iter().enumerate().all(is_most) {
            return order;
        }
        let admits = |cluster: usize, column: usize| {
            let (team, own) = (&self.columns[column], &self.columns[cluster]);
            cluster == column || self.rules.admits(team, own, &members[cluster], &self.columns)
        };
        matched(shared, self.robots.len(), admits).unwrap_or(order)
    }

    /// Gives teams that nobody was in to clusters in the order of their first robots, where the rules allow it: the order
    /// of centroids is one of chance.
    fn sort_new(&self, clusters: &[Vec<&RobotId>], order: &mut [usize]) {
        let is_new = |column: usize| !self.previous.contains(&Some(Column::Team(column)));
        let mut news: Vec<usize> =
            (0..clusters.len()).filter(|cluster| is_new(order[*cluster])).collect();
        let mut columns: Vec<usize> = news.iter().map(|cluster| order[*cluster]).collect();
        columns.sort_unstable();
        // An empty cluster is no team, and has no first robot.
        news.sort_by_key(|cluster| (clusters[*cluster].is_empty(), clusters[*cluster].first()));
        let sorted: Vec<(usize, usize)> = news.into_iter().zip(columns).collect();
        if sorted.iter().all(|(at, column)| {
            let (team, own) = (&self.columns[*column], &self.columns[order[*at]]);
            self.rules.admits(team, own, &clusters[*at], &self.columns)
        }) {
            for (cluster, column) in sorted {
                order[cluster] = column;
            }
        }
    }
}

/// The robots of each column of a division, and how many of them were in the team of each column before.
struct Clusters<'a> {
    members: Vec<Vec<&'a RobotId>>,
    shared: Vec<Vec<i64>>,
}

/// The column whose team each cluster becomes, such that most of `robots` robots stay in theirs; none if there is no
/// order of which all `admits` pairs of cluster and column.
fn matched(
    shared: &[Vec<i64>],
    robots: usize,
    admits: impl Fn(usize, usize) -> bool,
) -> Option<Vec<usize>> {
    let count = shared.len();
    let most = i64::try_from(robots).ok()?;
    let (mut pairs, mut costs) = (Vec::new(), Vec::new());
    for (cluster, shared) in shared.iter().enumerate() {
        for (column, shared) in shared.iter().enumerate() {
            if !admits(cluster, column) {
                pairs.push(Pair::Forbidden { robot: cluster, column: Column::Team(column) });
            }
            // Of equal ones the column itself.
            costs.push(2 * (most - shared) + i64::from(cluster != column));
        }
    }
    let teams = vec![Bounds::new(1, 1); count];
    let rules = Rules { robots: count, teams, pairs, ..Rules::default() }.check().ok()?;
    let costs = CostMatrix::new(count, count, costs).ok()?;
    let found = Assigner::new().solve(&rules, &costs).ok()?;
    let place = |column: &Column| match column {
        Column::Team(at) => Some(*at),
        Column::Reserve => None,
    };
    found.columns.iter().map(place).collect()
}
