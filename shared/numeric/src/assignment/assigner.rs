//! The cheapest assignment, from call to call.

use thiserror::Error;

use super::certificate::{Certificate, cost_of, dual_bound};
use super::conflict::Conflict;
use super::costs::CostMatrix;
use super::cut::find_conflict;
use super::movers::Movers;
use super::network::{Members, Network};
use super::paths::{Blocked, Flow};
use super::restrictions::Restrictions;
use super::rules::{Column, ValidRules};

/// Largest modulus of a kept price. Beyond it a call begins without prices, so that sums of prices and path
/// lengths stay within 64 bits.
const MAX_PRICE: i64 = 1 << 57;

/// Fewest robots whose prices begin with those of a sample: of fewer, all repairs take less than a millisecond.
const MIN_SAMPLED_ROBOTS: usize = 1_000;

/// No column.
const NOWHERE: u32 = u32::MAX;

/// Every robot in a column, at the least cost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assignment {
    /// Column of every robot.
    pub columns: Vec<Column>,
    /// Cost in units, with the prices of wanted robots that are missing.
    pub cost: i128,
    /// Paths along which robots were moved after each had its best choice at the kept prices.
    pub repairs: usize,
}

/// What a place in a column costs a robot of a limited class beside the price of the column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClassPrice {
    /// The class.
    pub class: usize,
    /// Place of the column among all columns.
    pub column: usize,
    /// The price in units: above zero where the column has as many robots of the class as it may have, below where it has
    /// as few as it must have or wants more.
    pub price: i64,
}

/// Why there is no assignment.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum AssignmentError {
    /// The costs do not fit the rules.
    #[error(
        "costs of {robots} robots in {columns} columns for {wanted_robots} robots and {wanted_columns} columns"
    )]
    Shape {
        /// Rows of the costs.
        robots: usize,
        /// Columns of the costs.
        columns: usize,
        /// Robots of the rules.
        wanted_robots: usize,
        /// Columns of the rules.
        wanted_columns: usize,
    },
    /// No assignment satisfies the rules.
    #[error("{0}")]
    Infeasible(Box<Conflict>),
}

/// Finds the cheapest assignment, and keeps prices and columns for the next call.
///
/// A call gives every robot the column that is cheapest for it at the kept prices, of equal ones the one that it
/// has; then it repairs what exceeds or misses a bound. Without kept prices these are the unconstrained best
/// choices; of many robots, those at the prices of a sample of them. When costs have changed little since the last call, little is left to repair. The cost of the result
/// does not depend on what was kept; among assignments of equal cost the choice may.
///
/// Time of a cold call of N robots and k columns without classes: O(N k) and O(k² + (N/k) log N) for each repair.
#[derive(Debug, Clone, Default)]
pub struct Assigner {
    /// Price of every node of the last call.
    prices: Vec<i64>,
    /// What the prices are for.
    shape: Shape,
    labels: Vec<u32>,
}

impl Assigner {
    /// Nothing kept.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Tells the column that each robot has, so that ties keep it there; `None` for one that has none.
    /// Columns of the last call are forgotten, prices are kept. Robots beyond the slice have none.
    pub fn set_previous(&mut self, rules: &ValidRules, columns: &[Option<Column>]) {
        let place = |column: &Option<Column>| {
            let at = column.and_then(|column| rules.get().index_of(column).ok());
            at.map_or(NOWHERE, |at| at as u32)
        };
        self.labels = columns.iter().map(place).collect();
    }

    /// The cheapest assignment under `rules`. `costs` is robots × columns, with the reserve as last column where
    /// `rules` have one. If robots came or went since the last call, tell their columns by
    /// [`Assigner::set_previous`] first.
    ///
    /// # Errors
    /// [`AssignmentError::Shape`], and [`AssignmentError::Infeasible`] with a conflict if nothing satisfies the
    /// rules; what is kept then stays as it was.
    pub fn solve(
        &mut self,
        rules: &ValidRules,
        costs: &CostMatrix,
    ) -> Result<Assignment, AssignmentError> {
        check_shape(rules, costs)?;
        let Ok(solved) = self.solve_restricted(&rules.network, &rules.restrictions, costs) else {
            return Err(AssignmentError::Infeasible(Box::new(find_conflict(rules.get()))));
        };
        debug_assert_eq!(self.certificate(rules, costs).map(|found| found.gap()), Ok(0));
        let columns = self.labels.iter().map(|at| rules.get().column_at(*at as usize)).collect();
        Ok(Assignment { columns, cost: solved.cost, repairs: solved.repairs })
    }

    /// The proof for the last result of [`Assigner::solve`], which was for these `rules` and `costs`. With others
    /// it is a bound for them, too, as long as robots, columns and limited classes are the same.
    ///
    /// # Errors
    /// [`AssignmentError::Shape`] if the last result does not fit.
    pub fn certificate(
        &self,
        rules: &ValidRules,
        costs: &CostMatrix,
    ) -> Result<Certificate, AssignmentError> {
        check_shape(rules, costs)?;
        let network = &rules.network;
        if self.labels.len() != costs.robots() || self.prices.len() != network.nodes() {
            return Err(AssignmentError::Shape {
                robots: self.labels.len(),
                columns: self.shape.columns,
                wanted_robots: costs.robots(),
                wanted_columns: costs.columns(),
            });
        }
        Ok(Certificate {
            cost: cost_of(network, costs, &self.labels),
            bound: dual_bound(network, &rules.restrictions, costs, &self.prices),
        })
    }

    /// What a place in each column of the last result costs beside the cost of the robot: above zero where the column
    /// has as many robots as it may have, below where it has as few as it must have, and else zero. Every robot that
    /// no pair of the rules ties is where its cost and the price are least, but for those of limited classes, which pay
    /// [`Assigner::class_prices`] as well.
    #[must_use]
    pub fn column_prices(&self) -> &[i64] {
        self.prices.get(..self.shape.columns).unwrap_or_default()
    }

    /// What a place in each limited column costs the robots of a limited class in the last result, beside
    /// [`Assigner::column_prices`]. With both, every robot that no pair ties is where its cost and the prices are least.
    #[must_use]
    pub fn class_prices(&self) -> Vec<ClassPrice> {
        let cells = self.prices.get(self.shape.columns..).unwrap_or_default();
        let of_cell = |(&(class, column), price): (&(Option<usize>, usize), &i64)| {
            let of_column = self.prices.get(column)?;
            Some(ClassPrice { class: class?, column, price: price - of_column })
        };
        self.shape.cells.iter().zip(cells).filter_map(of_cell).collect()
    }

    /// Places of the columns of the last result.
    pub(crate) fn labels(&self) -> &[u32] {
        &self.labels
    }

    /// As [`Assigner::solve`], by restrictions of the caller.
    pub(super) fn solve_restricted(
        &mut self,
        network: &Network,
        restrictions: &Restrictions,
        costs: &CostMatrix,
    ) -> Result<Solved, Blocked> {
        let prices = self
            .kept_prices(network)
            .unwrap_or_else(|| sampled_prices(network, restrictions, costs));
        let labels = best_choices(network, restrictions, costs, &prices, &self.labels)?;
        let mut inflow = vec![0; network.nodes()];
        for (robot, label) in labels.iter().enumerate() {
            let nodes = network.nodes_of(network.group_of(robot));
            inflow[nodes[*label as usize] as usize] += 1;
        }
        let mut flow = Flow::new(network, prices, inflow, labels.len());
        let (labels, repairs) = if flow.is_balanced() {
            (labels, 0)
        } else {
            let mut movers = Movers::new(network, costs, restrictions, labels);
            let repairs = flow.repair(&mut movers)?;
            (movers.labels, repairs)
        };
        let base = flow.prices[network.sink()];
        self.prices = flow.prices.iter().map(|price| price - base).collect();
        self.shape = shape_of(network);
        self.labels = labels;
        Ok(Solved { cost: cost_of(network, costs, &self.labels), repairs })
    }

    /// The kept price of every node; `None` if the columns are others or a price is too large.
    fn kept_prices(&self, network: &Network) -> Option<Vec<i64>> {
        let shape = shape_of(network);
        let bounded = self.prices.iter().all(|price| (-MAX_PRICE..=MAX_PRICE).contains(price));
        if self.shape.columns != shape.columns || !bounded {
            return None;
        }
        if self.shape == shape {
            return Some(self.prices.clone());
        }
        let columns = shape.columns;
        let mut prices = self.prices[..columns].to_vec();
        for (class, column) in &shape.cells {
            // A cell that was not limited had the price of its column.
            let before = self.shape.cells.binary_search(&(*class, *column));
            prices.push(self.prices[before.map_or(*column, |place| columns + place)]);
        }
        prices.push(0);
        Some(prices)
    }
}

/// Prices for a first call: those of a quarter of many robots under bounds in proportion, found in the same way, or
/// none. They leave most repairs to few robots; any prices lead to the same cost.
fn sampled_prices(network: &Network, restrictions: &Restrictions, costs: &CostMatrix) -> Vec<i64> {
    let robots = costs.robots();
    if robots >= MIN_SAMPLED_ROBOTS {
        // Fibonacci hashing (Knuth, The Art of Computer Programming 3, section 6.4), so that the order of the robots
        // does not matter.
        let hash = |robot: &usize| (*robot as u32).wrapping_mul(0x9E37_79B9) >> 30;
        let picked: Vec<usize> = (0..robots).filter(|robot| hash(robot) == 0).collect();
        let (network, costs) = (network.sampled(&picked, robots), costs.selected(&picked));
        let mut assigner = Assigner::new();
        let restrictions = restrictions.selected(&picked);
        if assigner.solve_restricted(&network, &restrictions, &costs).is_ok() {
            return assigner.prices;
        }
    }
    vec![0; network.nodes()]
}

/// The nodes of a flow graph.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Shape {
    columns: usize,
    /// Class and column of every limited cell, in the order of the nodes.
    cells: Vec<(Option<usize>, usize)>,
}

/// What [`Assigner::solve_restricted`] found.
pub(super) struct Solved {
    pub(super) cost: i128,
    pub(super) repairs: usize,
}

fn shape_of(network: &Network) -> Shape {
    let cells = &network.members_at[network.columns..network.sink()];
    let cell = |members: &Vec<Members>| {
        let first = members.first()?;
        Some((network.class_of_group(first.group as usize), first.column as usize))
    };
    Shape { columns: network.columns, cells: cells.iter().filter_map(cell).collect() }
}

/// The cheapest column of every robot at `prices`; of equal ones the previous one, then the first.
fn best_choices(
    network: &Network,
    restrictions: &Restrictions,
    costs: &CostMatrix,
    prices: &[i64],
    previous: &[u32],
) -> Result<Vec<u32>, Blocked> {
    let mut tolls = vec![0; network.columns];
    let mut group = usize::MAX;
    let mut labels = Vec::with_capacity(costs.robots());
    let simple = network.is_uniform() && restrictions.is_empty();
    for (robot, row) in costs.rows().enumerate() {
        if network.group_of(robot) != group {
            group = network.group_of(robot);
            for (toll, node) in tolls.iter_mut().zip(network.nodes_of(group)) {
                *toll = prices[*node as usize];
            }
        }
        let own = previous.get(robot).copied().filter(|at| (*at as usize) < network.columns);
        let mut best = NOWHERE;
        let mut least = i64::MAX;
        if let Some(own) = own
            && (simple || restrictions.allows(robot, own as usize))
        {
            (best, least) = (own, row[own as usize] + tolls[own as usize]);
        }
        let free = simple || restrictions.is_free(robot);
        for (at, (cost, toll)) in row.iter().zip(&tolls).enumerate() {
            let pay = cost + toll;
            if pay < least && (free || restrictions.allows(robot, at)) {
                (best, least) = (at as u32, pay);
            }
        }
        if best == NOWHERE {
            return Err(Blocked);
        }
        labels.push(best);
    }
    Ok(labels)
}

fn check_shape(rules: &ValidRules, costs: &CostMatrix) -> Result<(), AssignmentError> {
    let (wanted_robots, wanted_columns) = (rules.get().robots, rules.get().columns());
    let (robots, columns) = (costs.robots(), costs.columns());
    if (robots, columns) != (wanted_robots, wanted_columns) {
        return Err(AssignmentError::Shape { robots, columns, wanted_robots, wanted_columns });
    }
    Ok(())
}
