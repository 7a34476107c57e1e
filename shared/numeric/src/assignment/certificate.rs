//! A proof that an assignment costs as little as possible.

use super::costs::CostMatrix;
use super::network::Network;
use super::restrictions::Restrictions;

/// Cost of an assignment, and a bound below which no assignment under the rules can cost, in units.
///
/// The bound is the value of the Lagrangian dual at the prices of the nodes: every robot pays its cost and the
/// price of the column in the cheapest column for it, and every bound is used where that pays. It needs
/// nothing of the assignment, so that equality proves the optimum (Ahuja, Magnanti and Orlin, section 9.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Certificate {
    /// Cost of the assignment, with the prices of wanted robots that are missing.
    pub cost: i128,
    /// Lower bound on the cost of any assignment under the rules.
    pub bound: i128,
}

impl Certificate {
    /// By how much the assignment may cost more than the best: 0 proves the optimum.
    #[must_use]
    pub fn gap(&self) -> i128 {
        self.cost - self.bound
    }
}

/// Cost of `labels`: of every robot in its column, and of wanted robots that are missing.
pub(super) fn cost_of(network: &Network, costs: &CostMatrix, labels: &[u32]) -> i128 {
    let own = costs.rows().zip(labels).map(|(row, label)| i128::from(row[*label as usize]));
    own.sum::<i128>() + missing_cost(network, labels)
}

/// Cost of wanted robots that `labels` leave missing.
pub(super) fn missing_cost(network: &Network, labels: &[u32]) -> i128 {
    if network.constant == 0 {
        return 0;
    }
    let mut inflow = vec![0_i64; network.nodes()];
    for (robot, label) in labels.iter().enumerate() {
        inflow[network.nodes_of(network.group_of(robot))[*label as usize] as usize] += 1;
    }
    let mut cost = network.constant;
    for arc in network.arcs.iter().filter(|arc| arc.cost != 0) {
        // The arc that pays is the first one of its cell.
        cost += i128::from(arc.cost) * i128::from(inflow[arc.from as usize].min(arc.upper));
    }
    cost
}

/// The dual value at `prices`.
pub(super) fn dual_bound(
    network: &Network,
    restrictions: &Restrictions,
    costs: &CostMatrix,
    prices: &[i64],
) -> i128 {
    let mut bound = network.constant;
    let mut tolls = vec![0; network.columns];
    let mut group = usize::MAX;
    for (robot, row) in costs.rows().enumerate() {
        if network.group_of(robot) != group {
            group = network.group_of(robot);
            for (toll, node) in tolls.iter_mut().zip(network.nodes_of(group)) {
                *toll = prices[*node as usize];
            }
        }
        let pays = row.iter().zip(&tolls).map(|(cost, toll)| cost + toll);
        let least = if restrictions.is_free(robot) {
            pays.min()
        } else {
            let allowed = pays.enumerate().filter(|(at, _)| restrictions.allows(robot, *at));
            allowed.map(|(_, pay)| pay).min()
        };
        bound += i128::from(least.unwrap_or(0));
    }
    for arc in &network.arcs {
        let reduced = i128::from(arc.cost + prices[arc.to as usize] - prices[arc.from as usize]);
        bound += (reduced * i128::from(arc.lower)).min(reduced * i128::from(arc.upper));
    }
    bound - costs.robots() as i128 * i128::from(prices[network.sink()])
}
