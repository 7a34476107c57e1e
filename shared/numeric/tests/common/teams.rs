//! Random rules of assignments, and what brute force says about them.

use muster_numeric::assignment::{
    Bounds, ClassLimit, Column, CostMatrix, Pair, Rule, Rules, Wanted,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Sizes of random rules, and how tight they are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub(crate) robots: usize,
    pub(crate) teams: usize,
    pub(crate) classes: usize,
    /// Largest cost.
    pub(crate) largest: i64,
    /// Extra room of limits in robots: negative ones are often infeasible.
    pub(crate) room: i64,
}

pub(crate) fn column_at(rules: &Rules, place: usize) -> Column {
    if place < rules.teams.len() { Column::Team(place) } else { Column::Reserve }
}

/// Random rules with limits around an even division.
pub(crate) fn random_rules(shape: Shape, seed: u64) -> Rules {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let Shape { robots, teams, classes, room, .. } = shape;
    let share = (robots / teams.max(1)) as i64;
    let mut bounds = |share: i64| {
        let middle = share + rng.random_range(-1..=1);
        let lower = (middle - room - rng.random_range(0..3)).max(0) as usize;
        let upper = (middle + room + rng.random_range(0..3)).max(lower as i64) as usize;
        match rng.random_range(0..4) {
            0 => Bounds::at_least(lower),
            1 => Bounds::at_most(upper),
            2 => Bounds::new(lower, upper),
            _ => Bounds::ANY,
        }
    };
    let mut rules = Rules::new(robots, teams);
    rules.teams = (0..teams).map(|_| bounds(share)).collect();
    let mut small = (0..4 * teams * classes).map(|_| bounds(share / 2)).collect::<Vec<_>>();
    if rng.random_bool(0.5) {
        rules.reserve = Some(Bounds::at_most(rng.random_range(0..=robots / 2)));
    }
    if classes > 0 {
        rules.classes = (0..robots)
            .map(|_| rng.random_bool(0.7).then(|| rng.random_range(0..classes)))
            .collect();
    }
    for class in 0..classes {
        for place in 0..rules.columns() {
            if rng.random_bool(0.5) {
                let wanted = rng.random_bool(0.3).then(|| Wanted {
                    count: rng.random_range(0..4),
                    price: rng.random_range(0..=shape.largest),
                });
                let bounds = small.pop().unwrap_or_default();
                let column = column_at(&rules, place);
                rules.class_limits.push(ClassLimit { column, class, bounds, wanted });
            }
        }
    }
    for robot in 0..robots {
        if rng.random_bool(0.2) {
            let column = column_at(&rules, rng.random_range(0..rules.columns()));
            let pair = if rng.random_bool(0.4) {
                Pair::Forced { robot, column }
            } else {
                Pair::Forbidden { robot, column }
            };
            rules.pairs.push(pair);
        }
    }
    rules
}

pub(crate) fn random_costs(rules: &Rules, largest: i64, seed: u64) -> CostMatrix {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let count = rules.robots * rules.columns();
    let values = (0..count).map(|_| rng.random_range(-largest..=largest)).collect();
    CostMatrix::new(rules.robots, rules.columns(), values).unwrap()
}

fn place(rules: &Rules, column: Column) -> usize {
    rules.index_of(column).unwrap()
}

fn count(rules: &Rules, labels: &[usize], column: usize, class: Option<usize>) -> usize {
    let fits = |robot: usize| class.is_none() || rules.classes[robot] == class;
    labels.iter().enumerate().filter(|(robot, at)| **at == column && fits(*robot)).count()
}

/// True if `labels` satisfy one rule.
pub(crate) fn holds(rules: &Rules, rule: &Rule, labels: &[usize]) -> bool {
    match *rule {
        Rule::Least { column, class, count: least } => {
            count(rules, labels, place(rules, column), class) >= least
        }
        Rule::Most { column, class, count: most } => {
            count(rules, labels, place(rules, column), class) <= most
        }
        Rule::Pair(Pair::Forced { robot, column }) => labels[robot] == place(rules, column),
        Rule::Pair(Pair::Forbidden { robot, column }) => labels[robot] != place(rules, column),
    }
}

/// Every rule by itself, read from `rules` directly.
pub(crate) fn single_rules(rules: &Rules) -> Vec<Rule> {
    let mut all = Vec::new();
    let mut add = |column, class, bounds: Bounds| {
        all.push(Rule::Least { column, class, count: bounds.lower });
        all.push(Rule::Most { column, class, count: bounds.upper });
    };
    for (team, bounds) in rules.teams.iter().enumerate() {
        add(Column::Team(team), None, *bounds);
    }
    if let Some(bounds) = rules.reserve {
        add(Column::Reserve, None, bounds);
    }
    for limit in &rules.class_limits {
        add(limit.column, Some(limit.class), limit.bounds);
    }
    all.extend(rules.pairs.iter().copied().map(Rule::Pair));
    all
}

/// Every labelling.
pub(crate) fn labellings(rules: &Rules) -> impl Iterator<Item = Vec<usize>> {
    let (robots, columns) = (rules.robots, rules.columns());
    (0..columns.pow(robots as u32))
        .map(move |code| (0..robots).map(|i| code / columns.pow(i as u32) % columns).collect())
}

/// True if any labelling satisfies all of `kept`.
pub(crate) fn satisfiable(rules: &Rules, kept: &[Rule]) -> bool {
    labellings(rules).any(|labels| kept.iter().all(|rule| holds(rules, rule, &labels)))
}

/// Cost of labels with wanted robots that are missing.
pub(crate) fn cost(rules: &Rules, costs: &CostMatrix, labels: &[usize]) -> i128 {
    let own = labels.iter().enumerate().map(|(robot, at)| i128::from(costs.row(robot)[*at]));
    let missing = rules.class_limits.iter().filter_map(|limit| {
        let Wanted { count: wanted, price } = limit.wanted?;
        let there = count(rules, labels, place(rules, limit.column), Some(limit.class));
        Some(wanted.saturating_sub(there) as i128 * i128::from(price))
    });
    own.sum::<i128>() + missing.sum::<i128>()
}

/// Least cost of all labellings that satisfy the rules and `also`, where that gives extra costs.
pub(crate) fn least_cost(
    rules: &Rules,
    costs: &CostMatrix,
    also: impl Fn(&[usize]) -> Option<i128>,
) -> Option<i128> {
    let all = single_rules(rules);
    labellings(rules)
        .filter(|labels| all.iter().all(|rule| holds(rules, rule, labels)))
        .filter_map(|labels| Some(cost(rules, costs, &labels) + also(&labels)?))
        .min()
}
