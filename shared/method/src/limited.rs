//! From vectors to teams that have limits: k-means over the robots with an embedding, whose assignments are exact.

mod groups;

use std::cmp::Reverse;
use std::collections::BTreeSet;

use muster_numeric::assignment::{
    ApartClasses, Assigner, ClassPrice, Column, CostError, CostMatrix, DivisionError, Need, Pair,
    ValidRules, ValidWishes, Wanted, Wishes, apart_as_classes, assign_with_wishes,
};
use muster_numeric::kmeans::{KMeansError, KMeansLimits, KMeansOptions, LimitedKMeansError};
use muster_numeric::matrix::{DenseMatrix, MatrixError};

use self::groups::{NODE_BUDGET, grouped, means};
use crate::division::Division;
use crate::params::ValidDivisionParams;

/// Share of the sum of squared distances below which a difference is rounding: costs are integers, of which the largest
/// is 2³².
const ROUNDING_SHARE: f64 = 1e-6;

/// What a robot without a place costs, in multiples of the largest squared distance that two robots can have: more than
/// any other robot could save by taking the place.
const RESERVE_FACTOR: f64 = 4.0;

/// Why robots could not be divided.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LimitedError {
    /// k-means refuses the vectors or the limits.
    #[error(transparent)]
    KMeans(#[from] LimitedKMeansError),
    /// The wishes of groups cannot be granted.
    #[error(transparent)]
    Groups(#[from] DivisionError),
    /// Distances are no numbers.
    #[error(transparent)]
    Costs(#[from] CostError),
    /// Vectors are no matrix.
    #[error(transparent)]
    Vectors(#[from] MatrixError),
}

/// What a division has to respect.
#[derive(Debug, Clone, Copy)]
pub struct Limits<'a> {
    /// Limits of the teams, for as many robots as there are rows.
    pub rules: &'a ValidRules,
    /// Robots that are to be together or apart, and needs that are no limits of classes.
    pub groups: &'a ValidWishes,
    /// Column of every robot in the previous division; `None` for a new robot.
    pub previous: &'a [Option<Column>],
    /// Whether the previous division is only refined, if there was one.
    pub refine_only: bool,
}

/// How far a division is from the best assignment of its robots.
#[derive(Debug, Clone, PartialEq)]
pub struct Optimality {
    /// Whether no assignment to these teams under the limits has a lesser sum of squared distances to the centroids.
    pub optimal: bool,
    /// By which share the sum could be lower at most, from 0 to 1.
    pub gap: f64,
    /// What a place in each team costs in the best assignment, as a squared distance: above zero where the team is full,
    /// below where it has as few robots as it must have. Empty if there is no assignment.
    pub prices: Vec<f64>,
    /// What a place costs the robots of a class beside that.
    pub class_prices: Vec<PlacePrice>,
    /// The robots that are placed together with others: in groups, or for needs that are no limits of classes. The prices
    /// are those at which all others are where they are cheapest while these stay where they are; none stands for their own
    /// places. Robots that are to be apart are not among them where that costs no one anything: the prices stand for their
    /// places as well.
    pub jointly: Vec<usize>,
}

/// What a place in a team costs a robot of a class beside the price of the team.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacePrice {
    /// The class.
    pub class: usize,
    /// The team.
    pub team: usize,
    /// The price, as a squared distance.
    pub price: f64,
}

/// Divides robots, each a row of `x`, N × D, into the teams of `limits`. Labels are the numbers of the teams; a robot in
/// the reserve has none.
///
/// # Errors
/// [`LimitedError`]; with a conflict where nothing satisfies the limits.
pub fn divide_within(
    x: &DenseMatrix,
    params: &ValidDivisionParams,
    limits: &Limits<'_>,
) -> Result<Division, LimitedError> {
    let options = KMeansOptions {
        clusters: limits.rules.get().teams.len(),
        init: params.init,
        restarts: params.restarts,
        max_iterations: params.max_iterations,
        seed: params.seed,
        warm_labels: None,
        hysteresis: params.hysteresis,
        threads: params.threads,
    };
    let options =
        options.check().map_err(|error| LimitedKMeansError::from(KMeansError::from(error)))?;
    let reserve_cost = RESERVE_FACTOR * largest_distance(x);
    let previous = Some(limits.previous);
    let Limits { rules, refine_only, .. } = *limits;
    let found =
        options.divide_within(x, &KMeansLimits { rules, reserve_cost, previous, refine_only })?;
    let label = |column: &Column| match column {
        Column::Team(team) => Some(*team),
        Column::Reserve => None,
    };
    let found = Division {
        labels: found.columns.iter().map(label).collect(),
        centroids: found.centroids,
        inertia: found.inertia,
        iterations: found.iterations,
        converged: found.converged,
    };
    if is_empty(limits.groups) {
        return Ok(found);
    }
    // The same for groups: from the centroids that were found, and from those before, which are kept unless the others
    // are better by more than the hysteresis.
    let label = |column: &Option<Column>| column.as_ref().and_then(label);
    let labels: Vec<Option<usize>> = limits.previous.iter().map(label).collect();
    if labels.iter().all(Option::is_none) {
        return grouped(x, limits, found.centroids, 1.0);
    }
    let before = means(x, &labels, &found.centroids)?;
    let warm = grouped(x, limits, before, 1.0 - params.hysteresis);
    if refine_only {
        return warm;
    }
    let (warm, cold) = match (warm, grouped(x, limits, found.centroids, 1.0)) {
        (Ok(warm), Ok(cold)) => (warm, cold),
        // A search that was cut short finds nothing; the other one does.
        (found @ Ok(_), Err(_)) | (Err(_), found) => return found,
    };
    let order = |found: &Division| {
        let filled = found.labels.iter().flatten().collect::<BTreeSet<_>>().len();
        (shortfall(limits.rules, limits.groups, &found.labels), Reverse(filled))
    };
    let (of_warm, of_cold) = (order(&warm), order(&cold));
    let keeps = of_warm < of_cold
        || of_warm == of_cold && warm.inertia <= (1.0 + params.hysteresis) * cold.inertia;
    Ok(if keeps { warm } else { cold })
}

/// Whether nothing is asked that needs a search.
fn is_empty(groups: &ValidWishes) -> bool {
    groups.get().wishes.is_empty() && groups.get().needs.is_empty()
}

/// The prices of the robots that soft minima and soft needs lack.
fn shortfall(rules: &ValidRules, groups: &ValidWishes, labels: &[Option<usize>]) -> i128 {
    let all = rules.get();
    let price = |column: Column, count: usize, price: i64, has: &dyn Fn(usize) -> bool| {
        let Column::Team(team) = column else { return 0 };
        let there = (0..labels.len()).filter(|robot| labels[*robot] == Some(team) && has(*robot));
        i128::from(price) * count.saturating_sub(there.count()) as i128
    };
    let of_classes = all.class_limits.iter().filter_map(|limit| {
        let Wanted { count, price: each } = limit.wanted?;
        let has = |robot: usize| all.classes.get(robot) == Some(&Some(limit.class));
        Some(price(limit.column, count, each, &has))
    });
    let of_needs = groups.get().needs.iter().filter_map(|need: &Need| {
        let has = |robot: usize| need.robots.binary_search(&robot).is_ok();
        Some(price(need.column, need.at_least, need.price?, &has))
    });
    of_classes.chain(of_needs).sum()
}

fn square(row: &[f64], centroid: &[f64]) -> f64 {
    row.iter().zip(centroid).map(|(x, c)| (x - c).powi(2)).sum()
}

/// A bound of the squared distance of two rows that is above zero.
fn largest_distance(x: &DenseMatrix) -> f64 {
    let square = |row: &[f64]| row.iter().map(|value| value * value).sum::<f64>();
    let most = x.iter_rows().map(square).fold(0.0, f64::max);
    if most > 0.0 { 4.0 * most } else { 1.0 }
}

/// How far the robots of a division, each a row of `x`, are from the best assignment to its centroids under `rules`,
/// which have no reserve, with the wishes of `groups`.
///
/// # Errors
/// [`CostError`] if distances are no numbers.
#[expect(clippy::cast_precision_loss, reason = "the share needs no more than 53 bits")]
pub fn optimality(
    x: &DenseMatrix,
    labels: &[usize],
    centroids: &DenseMatrix,
    rules: &ValidRules,
    groups: &ValidWishes,
) -> Result<Optimality, CostError> {
    let (costs, unit) = costs(x, centroids, |_, _| 1.0)?;
    let own = |(robot, team): (usize, &usize)| i128::from(costs.row(robot)[*team]);
    let near: i128 = labels.iter().enumerate().map(own).sum();
    let places: Vec<Option<usize>> = labels.iter().copied().map(Some).collect();
    let cost = near + shortfall(rules, groups, &places);
    let mut assigner = Assigner::new();
    let apart = apart_as_classes(rules, groups);
    let is_class = |wish: usize| apart.classes.iter().any(|(place, _)| *place == wish);
    let mut jointly = jointly(groups, &is_class);
    let fixed = (!jointly.is_empty()).then(|| with_fixed(&apart.rules, &jointly, labels));
    // Where the others' places contradict the rules, nothing has a price.
    let priced = match &fixed {
        None => Some(&apart.rules),
        Some(fixed) => fixed.as_ref(),
    };
    let free = priced.and_then(|rules| assigner.solve(rules, &costs).ok()).map(|best| best.cost);
    jointly.extend(hindered(&apart, groups, &assigner, free.is_some()));
    jointly.sort_unstable();
    jointly.dedup();
    let (mut prices, mut class_prices) = (Vec::new(), Vec::new());
    if free.is_some() {
        prices.extend(assigner.column_prices().iter().map(|price| *price as f64 * unit));
        let of_class = |of: ClassPrice| {
            let ClassPrice { class, column: team, price } = of;
            PlacePrice { class, team, price: price as f64 * unit }
        };
        // A group that is apart has no name that its price could be published by.
        let has_name = |of: &ClassPrice| apart.classes.iter().all(|(_, class)| *class != of.class);
        let of_classes = assigner.class_prices().into_iter().filter(has_name);
        class_prices.extend(of_classes.map(of_class));
    }
    let judged = |optimal, gap| Optimality { optimal, gap, prices, class_prices, jointly };
    let best = if is_empty(groups) {
        // Without groups no robot was fixed.
        free
    } else {
        let mut assigner = Assigner::new();
        let found = assign_with_wishes(&mut assigner, rules, groups, &costs, NODE_BUDGET);
        found.ok().map(|best| best.bound)
    };
    // Where nothing is found, the labels do not satisfy the rules either.
    let Some(best) = best else { return Ok(judged(false, 1.0)) };
    // What is missing is no distance: the gap is a share of the distances alone.
    let gap = if cost > best { ((cost - best) as f64 / near.max(1) as f64).min(1.0) } else { 0.0 };
    let is_optimal = gap <= ROUNDING_SHARE;
    Ok(judged(is_optimal, if is_optimal { 0.0 } else { gap }))
}

/// The robots of groups whose places cost them more than others, as they are to be apart; all of them where nothing has a
/// price.
fn hindered(
    apart: &ApartClasses,
    groups: &ValidWishes,
    assigner: &Assigner,
    has_prices: bool,
) -> Vec<usize> {
    let paid: Vec<usize> = if has_prices {
        let all = assigner.class_prices().into_iter();
        all.filter(|of| of.price != 0).map(|of| of.class).collect()
    } else {
        apart.classes.iter().map(|(_, class)| *class).collect()
    };
    let wishes = &groups.get().wishes;
    let pay = apart.classes.iter().filter(|(_, class)| paid.contains(class));
    pay.filter_map(|(place, _)| wishes.get(*place))
        .flat_map(|wish| wish.robots.iter().copied())
        .collect()
}

/// The robots that a search places, in order; those of a wish that `is_class` has no search.
fn jointly(groups: &ValidWishes, is_class: &dyn Fn(usize) -> bool) -> Vec<usize> {
    let Wishes { wishes, needs } = groups.get();
    let searched = wishes.iter().enumerate().filter(|(place, _)| !is_class(*place));
    let wished = searched.flat_map(|(_, wish)| &wish.robots);
    let mut robots: Vec<usize> =
        wished.chain(needs.iter().flat_map(|need| &need.robots)).copied().collect();
    robots.sort_unstable();
    robots.dedup();
    robots
}

/// The rules with some robots where they are; none if they are no rules.
fn with_fixed(rules: &ValidRules, robots: &[usize], labels: &[usize]) -> Option<ValidRules> {
    let mut rules = rules.get().clone();
    let fixed = |robot: &usize| {
        let column = Column::Team(*labels.get(*robot)?);
        Some(Pair::Forced { robot: *robot, column })
    };
    rules.pairs.extend(robots.iter().filter_map(fixed));
    rules.check().ok()
}

/// Squared distances of rows to centroids, each times its share, as integers, and what one of them stands for.
fn costs(
    x: &DenseMatrix,
    centroids: &DenseMatrix,
    share: impl Fn(usize, usize) -> f64,
) -> Result<(CostMatrix, f64), CostError> {
    let mut values = Vec::with_capacity(x.rows() * centroids.rows());
    for (robot, row) in x.iter_rows().enumerate() {
        let far = |(column, c)| share(robot, column) * square(row, c);
        values.extend(centroids.iter_rows().enumerate().map(far));
    }
    let unit = CostMatrix::unit_for(values.iter().fold(0.0, |most: f64, value| most.max(*value)));
    Ok((CostMatrix::from_floats(x.rows(), centroids.rows(), &values, unit)?, unit))
}

/// The rows of some robots.
///
/// # Errors
/// [`MatrixError`], never for rows of a matrix.
///
/// # Panics
/// If there is no such row.
pub fn rows_of(x: &DenseMatrix, rows: &[usize]) -> Result<DenseMatrix, MatrixError> {
    let values = rows.iter().flat_map(|row| x.row(*row)).copied().collect();
    DenseMatrix::new(rows.len(), x.cols(), values)
}

#[cfg(test)]
mod tests {
    use muster_numeric::assignment::{Bounds, ClassLimit, Relation, Rules, Wish};

    use super::*;
    use crate::params::DivisionParams;

    fn line(points: &[f64]) -> DenseMatrix {
        DenseMatrix::new(points.len(), 1, points.to_vec()).unwrap()
    }

    fn rules(robots: usize, teams: &[Bounds], reserve: Option<Bounds>) -> ValidRules {
        let rules = Rules { robots, teams: teams.to_vec(), reserve, ..Rules::default() };
        rules.check().unwrap()
    }

    fn no_groups(rules: &ValidRules) -> ValidWishes {
        Wishes::default().check(rules).unwrap()
    }

    /// How many teams robots on a line are divided into, some of which are to be together.
    fn teams_of(points: &[f64], teams: usize, together: &[usize]) -> usize {
        let rules = rules(points.len(), &vec![Bounds::ANY; teams], None);
        let wish = Wish { relation: Relation::Together, robots: together.to_vec(), price: None };
        let wishes = Wishes { wishes: vec![wish], ..Wishes::default() };
        let groups = wishes.check(&rules).unwrap();
        let previous = vec![None; points.len()];
        let limits =
            Limits { rules: &rules, groups: &groups, previous: &previous, refine_only: false };
        let params = DivisionParams { teams, ..DivisionParams::default() }.check().unwrap();
        let found = divide_within(&line(points), &params, &limits).unwrap();
        assert!(together.iter().all(|robot| found.labels[*robot] == found.labels[together[0]]));
        found.labels.iter().flatten().collect::<BTreeSet<_>>().len()
    }

    #[test]
    fn no_team_is_left_empty_for_a_group() {
        assert_eq!(teams_of(&[0.0, 1.0, 10.0, 10.1], 3, &[0, 1]), 3);
        assert_eq!(teams_of(&[0.0, 1.0, 10.0], 2, &[0, 2]), 2);
        // As many as a group leaves room for.
        assert_eq!(teams_of(&[0.0, 1.0, 10.0], 3, &[0, 2]), 2);
        assert_eq!(teams_of(&[0.0, 1.0, 2.0, 10.0], 4, &[0, 1, 3]), 2);
        // Robots in one place are one team, and a group of all cannot be two.
        assert_eq!(teams_of(&[1.0, 1.0, 1.0], 2, &[0, 1]), 1);
        assert_eq!(teams_of(&[0.0, 1.0, 10.0], 2, &[0, 1, 2]), 1);
    }

    #[test]
    fn a_team_that_is_closed_takes_the_room_of_no_other() {
        let x = line(&[0.0, 0.0, 10.0, 10.0]);
        let rules = rules(4, &[Bounds::ANY, Bounds::ANY, Bounds::new(0, 0)], None);
        let together = |robots: [usize; 2]| Wish {
            relation: Relation::Together,
            robots: robots.to_vec(),
            price: None,
        };
        let wishes = vec![together([0, 2]), together([1, 3])];
        let groups = Wishes { wishes, ..Wishes::default() }.check(&rules).unwrap();
        let params = DivisionParams { teams: 3, ..DivisionParams::default() }.check().unwrap();
        let limits =
            Limits { rules: &rules, groups: &groups, previous: &[None; 4], refine_only: false };
        let found = divide_within(&x, &params, &limits).unwrap();
        let teams: BTreeSet<_> = found.labels.iter().flatten().collect();
        assert_eq!(teams.len(), 2, "{:?}", found.labels);
    }

    #[test]
    fn groups_are_together_or_apart() {
        let x = line(&[0.0, 0.1, 0.2, 5.0, 5.1, 5.2]);
        let rules = rules(6, &[Bounds::ANY, Bounds::ANY], None);
        let params = DivisionParams { teams: 2, ..DivisionParams::default() }.check().unwrap();
        let wish =
            |relation, robots: &[usize]| Wish { relation, robots: robots.to_vec(), price: None };
        let wishes = vec![wish(Relation::Together, &[2, 3]), wish(Relation::Apart, &[0, 1])];
        let groups = Wishes { wishes, ..Wishes::default() }.check(&rules).unwrap();
        let limits =
            Limits { rules: &rules, groups: &groups, previous: &[None; 6], refine_only: false };
        let found = divide_within(&x, &params, &limits).unwrap();
        let of = |robot: usize| found.labels[robot].unwrap();
        assert!(of(2) == of(3) && of(0) != of(1), "{:?}", found.labels);
        let labels: Vec<usize> = (0..6).map(of).collect();
        let judged = optimality(&x, &labels, &found.centroids, &rules, &groups).unwrap();
        assert!(judged.optimal, "{judged:?}");
        let column = |label: &Option<usize>| label.map(Column::Team);
        let previous: Vec<Option<Column>> = found.labels.iter().map(column).collect();
        let again = Limits { previous: &previous, ..limits };
        assert_eq!(divide_within(&x, &params, &again).unwrap().labels, found.labels);
    }

    #[test]
    fn needs_of_overlapping_skills_are_filled() {
        // Two teams far apart, and all who have a skill in one of them.
        let x = line(&[0.0, 0.1, 0.2, 0.3, 5.0, 5.1, 5.2, 5.3]);
        let rules = rules(8, &[Bounds::ANY, Bounds::ANY], None);
        let params = DivisionParams { teams: 2, ..DivisionParams::default() }.check().unwrap();
        let need = |robots: &[usize], team, price| Need {
            robots: robots.to_vec(),
            column: Column::Team(team),
            at_least: 1,
            at_most: usize::MAX,
            price,
        };
        let of = |robots: &[usize], price| [0, 1].map(|team| need(robots, team, price));
        let needs = [of(&[0, 1], None), of(&[1, 2], None)].concat();
        let groups = Wishes { needs, ..Wishes::default() }.check(&rules).unwrap();
        let limits =
            Limits { rules: &rules, groups: &groups, previous: &[None; 8], refine_only: false };
        let found = divide_within(&x, &params, &limits).unwrap();
        let of_robot = |robot: usize| found.labels[robot].unwrap();
        for skilled in [[0, 1], [1, 2]] {
            assert_ne!(of_robot(skilled[0]), of_robot(skilled[1]), "{:?}", found.labels);
        }
        assert!(of_robot(3) != of_robot(4) && of_robot(4) == of_robot(7));
        // Three teams' worth of a soft need for two robots: as many as there can be.
        let needs = [of(&[0], Some(1 << 36)), of(&[0, 3], Some(1 << 36))].concat();
        let soft = Wishes { needs, ..Wishes::default() }.check(&rules).unwrap();
        let limits = Limits { groups: &soft, ..limits };
        let found = divide_within(&x, &params, &limits).unwrap();
        assert_ne!(found.labels[0], found.labels[3], "{:?}", found.labels);
        let labels: Vec<usize> = found.labels.iter().flatten().copied().collect();
        let judged = optimality(&x, &labels, &found.centroids, &rules, &soft).unwrap();
        assert!(judged.optimal, "{judged:?}");
    }

    #[test]
    fn limits_hold_and_the_assignment_is_the_best() {
        let x = line(&[0.0, 0.1, 0.2, 0.3, 5.0]);
        let rules = rules(5, &[Bounds::new(2, 3), Bounds::new(2, 3)], None);
        let params = DivisionParams { teams: 2, ..DivisionParams::default() }.check().unwrap();
        let groups = no_groups(&rules);
        let limits =
            Limits { rules: &rules, groups: &groups, previous: &[None; 5], refine_only: false };
        let found = divide_within(&x, &params, &limits).unwrap();
        let far = found.labels[4];
        assert_eq!(found.labels.iter().filter(|label| **label == far).count(), 2);
        assert_eq!(found.labels[3], far, "the nearest of the others");
        let labels: Vec<usize> = found.labels.iter().flatten().copied().collect();
        let judged = optimality(&x, &labels, &found.centroids, &rules, &groups).unwrap();
        assert_eq!((judged.optimal, judged.gap), (true, 0.0));
        let worse: Vec<usize> = vec![labels[0], labels[0], labels[3], labels[0], labels[3]];
        let judged = optimality(&x, &worse, &found.centroids, &rules, &groups).unwrap();
        assert!(!judged.optimal && judged.gap > 0.0 && judged.gap < 1.0, "{judged:?}");
    }

    #[test]
    fn at_the_prices_every_robot_is_where_it_is_cheapest() {
        let mut seed = 1_u64;
        let mut draw = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) as f64 / (1_u64 << 31) as f64
        };
        let mut priced = 0;
        for _ in 0..100 {
            let robots = 6 + (10.0 * draw()) as usize;
            let points: Vec<f64> = (0..2 * robots).map(|_| draw()).collect();
            let x = DenseMatrix::new(robots, 2, points).unwrap();
            let most = robots.div_ceil(3) + (2.0 * draw()) as usize;
            let rules = rules(robots, &[Bounds::new(1, most); 3], None);
            let params = DivisionParams { teams: 3, hysteresis: 0.0, ..DivisionParams::default() };
            let (groups, previous) = (no_groups(&rules), vec![None; robots]);
            let limits =
                Limits { rules: &rules, groups: &groups, previous: &previous, refine_only: false };
            let found = divide_within(&x, &params.check().unwrap(), &limits).unwrap();
            let labels: Vec<usize> = found.labels.iter().flatten().copied().collect();
            let judged = optimality(&x, &labels, &found.centroids, &rules, &groups).unwrap();
            if !judged.optimal {
                continue;
            }
            let prices = &judged.prices;
            assert_eq!(prices.len(), 3);
            for (row, own) in x.iter_rows().zip(&labels) {
                let pay = |team: usize| square(row, found.centroids.row(team)) + prices[team];
                assert!((0..3).all(|team| pay(*own) <= pay(team) + 1e-6), "{prices:?}");
            }
            for (team, price) in prices.iter().enumerate() {
                let size = labels.iter().filter(|label| **label == team).count();
                assert!(*price <= 0.0 || size == most, "a team with room costs {price}");
                assert!(*price >= 0.0 || size == 1, "a team with more than it needs costs {price}");
            }
            priced += usize::from(prices.iter().any(|price| *price > 0.01));
        }
        assert!(priced > 10, "{priced} divisions had a full team that others wanted");
    }

    /// With the prices of classes, and with groups of robots whose places are given, all others are where they are
    /// cheapest.
    #[test]
    fn at_the_prices_of_classes_and_beside_groups_every_other_robot_is_where_it_is_cheapest() {
        let mut seed = 7_u64;
        let mut draw = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) as f64 / (1_u64 << 31) as f64
        };
        let (mut of_classes, mut beside_groups) = (0, 0);
        for round in 0..200 {
            let robots = 8 + (8.0 * draw()) as usize;
            let points: Vec<f64> = (0..2 * robots).map(|_| draw()).collect();
            let x = DenseMatrix::new(robots, 2, points).unwrap();
            let most = robots.div_ceil(3) + 1;
            // Two of one class in the second team at least, and one of the other in the third at most; one wanted there.
            let classes: Vec<Option<usize>> =
                (0..robots).map(|robot| [Some(0), Some(1), None][robot % 3]).collect();
            let limit = |team, class, bounds, wanted| ClassLimit {
                column: Column::Team(team),
                class,
                bounds,
                wanted,
            };
            let class_limits = vec![
                limit(1, 0, Bounds::at_least(2), None),
                limit(2, 1, Bounds::at_most(1), None),
                limit(0, 1, Bounds::ANY, Some(Wanted { count: 2, price: 1 << 36 })),
            ];
            let teams = vec![Bounds::new(1, most); 3];
            let rules = Rules { robots, teams, classes, class_limits, ..Rules::default() };
            let rules = rules.check().unwrap();
            let wish = |relation, robots: &[usize]| Wish {
                relation,
                robots: robots.to_vec(),
                price: None,
            };
            let wishes = if round % 2 == 0 {
                Vec::new()
            } else {
                vec![wish(Relation::Together, &[0, 3]), wish(Relation::Apart, &[1, 4, 7])]
            };
            let groups = Wishes { wishes, ..Wishes::default() }.check(&rules).unwrap();
            let params = DivisionParams { teams: 3, hysteresis: 0.0, ..DivisionParams::default() };
            let previous = vec![None; robots];
            let limits =
                Limits { rules: &rules, groups: &groups, previous: &previous, refine_only: false };
            let found = divide_within(&x, &params.check().unwrap(), &limits).unwrap();
            let labels: Vec<usize> = found.labels.iter().flatten().copied().collect();
            let judged = optimality(&x, &labels, &found.centroids, &rules, &groups).unwrap();
            let jointly: &[usize] = if round % 2 == 0 { &[] } else { &[0, 1, 3, 4, 7] };
            assert_eq!(judged.jointly, jointly);
            if !judged.optimal {
                continue;
            }
            let classes = &rules.get().classes;
            for (robot, own) in labels.iter().enumerate() {
                if jointly.contains(&robot) {
                    continue;
                }
                let by_class = |team: usize| {
                    let of = |of: &&PlacePrice| of.team == team && Some(of.class) == classes[robot];
                    judged.class_prices.iter().find(of).map_or(0.0, |of| of.price)
                };
                let pay = |team: usize| {
                    let far = square(x.row(robot), found.centroids.row(team));
                    far + judged.prices[team] + by_class(team)
                };
                assert!((0..3).all(|team| pay(*own) <= pay(team) + 1e-6), "{robot}: {judged:?}");
                of_classes += usize::from((0..3).any(|team| by_class(team).abs() > 0.01));
                beside_groups += usize::from(!jointly.is_empty());
            }
        }
        assert!(of_classes > 100 && beside_groups > 100, "{of_classes} {beside_groups}");
    }

    #[test]
    fn who_has_no_place_is_in_the_reserve() {
        let x = line(&[0.0, 0.1, 9.0]);
        let rules = rules(3, &[Bounds::at_most(2)], Some(Bounds::ANY));
        let params = DivisionParams { teams: 1, ..DivisionParams::default() }.check().unwrap();
        let groups = no_groups(&rules);
        let limits =
            Limits { rules: &rules, groups: &groups, previous: &[None; 3], refine_only: false };
        let found = divide_within(&x, &params, &limits).unwrap();
        assert_eq!(found.labels, [Some(0), Some(0), None]);
    }
}
