//! Branch and bound over wishes and needs, within a number of nodes.

use thiserror::Error;

use super::assigner::{Assigner, Assignment, AssignmentError};
use super::costs::CostMatrix;
use super::exact_wishes::split;
use super::rules::{Column, RulesError, ValidRules};
use super::search_node::{Choice, Problem};
use super::wishes::{Need, ValidWishes};

/// Most nodes that are spent on multipliers before the search; a quarter of the budget if that is less.
const MULTIPLIER_NODES: usize = 60;

/// Nodes without a better bound after which multipliers move half as far.
const STALLED_NODES: usize = 3;

/// An assignment that respects wishes and needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Division {
    /// Column of every robot.
    pub columns: Vec<Column>,
    /// Cost in units, with the prices of what is missing or not granted.
    pub cost: i128,
    /// No assignment under the rules, wishes and needs costs less.
    pub bound: i128,
    /// By how much the cost may be above the least one: cost − bound.
    pub gap: i128,
    /// True if the gap is 0.
    pub optimal: bool,
    /// Nodes that were looked at, each a flow.
    pub nodes: usize,
}

/// Why there is no division.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum DivisionError {
    /// The rules alone have no assignment, or the costs do not fit them.
    #[error(transparent)]
    Assignment(#[from] AssignmentError),
    /// A limit that stands for a wish makes no sense with the rules.
    #[error(transparent)]
    Rules(#[from] RulesError),
    /// The rules can be satisfied, but not together with these wishes and needs.
    #[error("the rules leave no way to grant wishes {wishes:?} and needs {needs:?} together")]
    Infeasible {
        /// Places of wishes that contradict the rules or each other.
        wishes: Vec<usize>,
        /// Places of needs that do.
        needs: Vec<usize>,
        /// True if the others could be granted without any one of these; false where the budget did not suffice
        /// to tell.
        irreducible: bool,
    },
    /// Neither a division nor a proof that there is none was found.
    #[error("nothing was found in {nodes} nodes: raise the budget, or drop wishes or needs")]
    Undecided {
        /// Nodes that were looked at.
        nodes: usize,
    },
}

/// The cheapest assignment under `rules`, `wishes` and `needs` that is found within `node_budget` nodes, each of
/// which takes one call of the flow; at least one is looked at.
///
/// Hard groups that are to be apart, and skills of which no robot has two, become limits of classes as long as their
/// robots have no class: they are exact and cost no node. For the others the search goes depth first, in an order
/// that depends on the input alone. `assigner` keeps its prices and columns from call to call, as in
/// [`Assigner::solve`], whose certificate does not cover wishes.
///
/// # Errors
/// [`DivisionError`]. For wishes that cannot be granted the budget is spent again for each of them.
pub fn assign_with_wishes(
    assigner: &mut Assigner,
    rules: &ValidRules,
    wishes: &ValidWishes,
    costs: &CostMatrix,
    node_budget: usize,
) -> Result<Division, DivisionError> {
    let chosen = [vec![true; wishes.get().wishes.len()], vec![true; wishes.get().needs.len()]];
    let ended = search(assigner, rules, wishes, &chosen, costs, node_budget, Goal::Best)?;
    match ended {
        Ended::Found { labels, cost, bound, nodes } => {
            let columns = labels.iter().map(|at| rules.get().column_at(*at as usize)).collect();
            let previous: Vec<Option<Column>> =
                labels.iter().map(|at| Some(rules.get().column_at(*at as usize))).collect();
            assigner.set_previous(rules, &previous);
            let gap = cost - bound;
            Ok(Division { columns, cost, bound, gap, optimal: gap == 0, nodes })
        }
        Ended::Undecided { nodes } => Err(DivisionError::Undecided { nodes }),
        Ended::Infeasible => {
            // If the rules alone cannot be satisfied, their conflict says more.
            let Assignment { .. } = assigner.solve(rules, costs)?;
            Err(conflicting_wishes(assigner, rules, wishes, costs, node_budget)?)
        }
    }
}

/// Whether anything satisfies `rules` and all that is hard of `wishes`, as far as `node_budget` nodes tell; none where
/// they do not.
///
/// # Errors
/// [`DivisionError::Assignment`] and [`DivisionError::Rules`] if wishes, rules and costs do not fit each other.
pub fn is_grantable(
    assigner: &mut Assigner,
    rules: &ValidRules,
    wishes: &ValidWishes,
    node_budget: usize,
) -> Result<Option<bool>, DivisionError> {
    let (robots, columns) = (rules.get().robots, rules.get().columns());
    let Ok(costs) = CostMatrix::new(robots, columns, vec![0; robots * columns]) else {
        return Ok(None);
    };
    let hard_wishes = wishes.get().wishes.iter().map(|wish| wish.price.is_none());
    let needs = wishes.get().needs.len();
    let chosen = [hard_wishes.collect(), vec![true; needs]];
    let ended = search(assigner, rules, wishes, &chosen, &costs, node_budget, Goal::Any)?;
    Ok(match ended {
        Ended::Found { .. } => Some(true),
        Ended::Infeasible => Some(false),
        Ended::Undecided { .. } => None,
    })
}

/// The deletion filter over hard wishes and needs.
fn conflicting_wishes(
    assigner: &mut Assigner,
    rules: &ValidRules,
    wishes: &ValidWishes,
    costs: &CostMatrix,
    node_budget: usize,
) -> Result<DivisionError, DivisionError> {
    let hard_wishes = wishes.get().wishes.iter().map(|wish| wish.price.is_none());
    let is_hard = |need: &Need| need.price.is_none() || need.at_most < usize::MAX;
    let hard_needs = wishes.get().needs.iter().map(is_hard);
    let mut chosen: [Vec<bool>; 2] = [hard_wishes.collect(), hard_needs.collect()];
    let mut irreducible = true;
    for kind in 0..2 {
        for number in 0..chosen[kind].len() {
            if !chosen[kind][number] {
                continue;
            }
            chosen[kind][number] = false;
            let ended = search(assigner, rules, wishes, &chosen, costs, node_budget, Goal::Any)?;
            if !matches!(ended, Ended::Infeasible) {
                chosen[kind][number] = true;
                irreducible &= matches!(ended, Ended::Found { .. });
            }
        }
    }
    let [wishes, needs] = chosen.map(|kind| {
        kind.iter().enumerate().filter(|(_, chosen)| **chosen).map(|(number, _)| number).collect()
    });
    Ok(DivisionError::Infeasible { wishes, needs, irreducible })
}

/// What a search is for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Goal {
    /// The cheapest division.
    Best,
    /// Whether there is any.
    Any,
}

/// How a search ended.
enum Ended {
    Found { labels: Vec<u32>, cost: i128, bound: i128, nodes: usize },
    Infeasible,
    Undecided { nodes: usize },
}

/// A node that was not looked at yet.
struct Open {
    choices: Vec<Choice>,
    /// Bound of the node above it.
    bound: i128,
}

/// Searches with the chosen wishes and needs.
fn search(
    assigner: &mut Assigner,
    rules: &ValidRules,
    wishes: &ValidWishes,
    chosen: &[Vec<bool>; 2],
    costs: &CostMatrix,
    node_budget: usize,
    goal: Goal,
) -> Result<Ended, DivisionError> {
    let shape = (costs.robots(), costs.columns());
    let wanted = (rules.get().robots, rules.get().columns());
    if shape != wanted {
        // Says which shapes these are.
        assigner.solve(rules, costs)?;
    }
    let mut problem = Problem::new(split(rules, wishes.get(), &chosen[0], &chosen[1])?, costs);
    let mut best: Option<(i128, Vec<u32>)> = None;
    let mut nodes = 0;
    let mut root = i128::MIN;
    if problem.has_needs() {
        let limit = MULTIPLIER_NODES.min(node_budget / 4);
        match climb(&mut problem, assigner, limit, &mut best, &mut nodes) {
            Some(bound) => root = bound,
            None => return Ok(Ended::Infeasible),
        }
    }
    let mut open = vec![Open { choices: Vec::new(), bound: root }];
    while let Some(node) = open.pop() {
        let useless = |bound: i128| best.as_ref().is_some_and(|(cost, _)| bound >= *cost);
        if useless(node.bound) {
            continue;
        }
        if (goal == Goal::Any && best.is_some()) || (nodes > 0 && nodes >= node_budget) {
            open.push(node);
            break;
        }
        nodes += 1;
        let Some(found) = problem.evaluate(&node.choices, assigner) else { continue };
        let bound = found.bound.max(node.bound);
        if let Some(cost) = found.cost
            && best.as_ref().is_none_or(|(least, _)| cost < *least)
        {
            best = Some((cost, found.labels));
        }
        for child in found.children {
            let choices = [&node.choices[..], &child].concat();
            open.push(Open { choices, bound });
        }
    }
    let Some((cost, labels)) = best else {
        return Ok(if open.is_empty() { Ended::Infeasible } else { Ended::Undecided { nodes } });
    };
    let bound = open.iter().map(|node| node.bound).fold(cost, i128::min);
    Ok(Ended::Found { labels, cost, bound, nodes })
}

/// Raises the bound of the root by moving multipliers along subgradients (Held, Wolfe and Crowder, Mathematical
/// Programming 6, 1974). Returns the best bound; `None` if there is no division.
fn climb(
    problem: &mut Problem<'_>,
    assigner: &mut Assigner,
    limit: usize,
    best: &mut Option<(i128, Vec<u32>)>,
    nodes: &mut usize,
) -> Option<i128> {
    let mut step = (problem.largest_detour() / 2).max(1);
    let mut highest = i128::MIN;
    let mut kept = problem.multipliers.clone();
    let mut stalled = 0;
    while *nodes < limit && step > 0 {
        *nodes += 1;
        let found = problem.evaluate(&[], assigner)?;
        if let Some(cost) = found.cost
            && best.as_ref().is_none_or(|(least, _)| cost < *least)
        {
            *best = Some((cost, found.labels));
        }
        if found.bound > highest {
            highest = found.bound;
            kept.clone_from(&problem.multipliers);
            stalled = 0;
        } else {
            stalled += 1;
        }
        if found.children.is_empty() {
            break;
        }
        if stalled >= STALLED_NODES {
            step /= 2;
            stalled = 0;
            problem.multipliers.clone_from(&kept);
        }
        problem.climb(&found.missing, step);
    }
    problem.multipliers = kept;
    Some(highest)
}
