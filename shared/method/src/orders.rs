//! Orders first: what is left of places and links of robots that have new orders.
//!
//! A robot whose superior has changed stands where its old orders have sent it, and its links are those of that
//! place.
//! While its orders are new, its edges of all modalities but the ranks count [`OLD_TIE`] of their weight,
//! except those to robots of the same new orders: its superior, those with the same superior, and those below
//! the same robot with new orders. Its rank is not doubted meanwhile.

use muster_numeric::matrix::{MatrixError, SparseMatrix};

/// What is left of the weight of an edge that old orders explain.
const OLD_TIE: f64 = 0.2;

/// Steps up the chain of command that are followed. No real chain is longer; without a limit, a chain or a circle
/// of all robots of a large fleet would take time with the square of their number.
const LONGEST_CHAIN: usize = 64;

/// Which robots have new orders, and which robots have given them.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Standings {
    /// Per robot; empty if no robot has new orders.
    robots: Vec<Standing>,
}

/// The place of a robot in the chain of command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Standing {
    /// The highest robot with new orders that it is, or is below of; none if its orders are old.
    head: Option<usize>,
    /// The superior of that robot; its own one if its orders are old.
    superior: Option<usize>,
    /// Whether its own superior has changed.
    is_new: bool,
}

impl Standings {
    /// Of robots with these ranks, from superiors down, of which `changed` have another superior than before.
    pub(crate) fn new(ranks: &SparseMatrix, changed: &[usize]) -> Self {
        let nodes = ranks.nodes();
        let mut superiors: Vec<Option<(usize, f64)>> = vec![None; nodes];
        for (from, to, weight) in ranks.triplets() {
            if superiors[to].is_none_or(|(_, most)| weight > most) {
                superiors[to] = Some((from, weight));
            }
        }
        let superior = |robot: usize| superiors[robot].map(|(superior, _)| superior);
        let mut is_new = vec![false; nodes];
        for &robot in changed.iter().filter(|robot| **robot < nodes) {
            is_new[robot] = true;
        }
        if !is_new.contains(&true) {
            return Self::default();
        }
        let standing = |robot: usize| {
            let mut head = is_new[robot].then_some(robot);
            let mut at = robot;
            for _ in 0..LONGEST_CHAIN {
                let Some(next) = superior(at).filter(|next| *next != robot) else { break };
                if is_new[next] {
                    head = Some(next);
                }
                at = next;
            }
            let superior = superior(head.unwrap_or(robot));
            Standing { head, superior, is_new: is_new[robot] }
        };
        Self { robots: (0..nodes).map(standing).collect() }
    }

    /// Whether the rank of a robot is new.
    pub(crate) fn is_new(&self, robot: usize) -> bool {
        self.robots.get(robot).is_some_and(|standing| standing.is_new)
    }

    /// The graph of another modality than the ranks, without what old orders explain.
    ///
    /// # Errors
    /// [`MatrixError`], never for a graph that was checked.
    pub(crate) fn weigh_edges(
        &self,
        matrix: &SparseMatrix,
    ) -> Option<Result<SparseMatrix, MatrixError>> {
        if self.robots.is_empty() {
            return None;
        }
        Some(matrix.map_weights(
            |from, to, weight| {
                if self.is_old_tie(from, to) { OLD_TIE * weight } else { weight }
            },
        ))
    }

    fn is_old_tie(&self, from: usize, to: usize) -> bool {
        let (Some(a), Some(b)) = (self.robots.get(from), self.robots.get(to)) else { return false };
        if a.head.is_none() && b.head.is_none() {
            return false;
        }
        let same_orders = a.head == b.head
            || a.superior == Some(to)
            || b.superior == Some(from)
            || (a.superior.is_some() && a.superior == b.superior);
        !same_orders
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Robots 1 and 2 answer to 0, robots 4 and 5 to 3, robot 6 to 5.
    fn ranks(extra: &[(usize, usize)]) -> SparseMatrix {
        let ranks = [(0, 1), (0, 2), (3, 4), (3, 5), (5, 6)];
        let ranks = ranks.iter().filter(|(_, to)| extra.iter().all(|(_, new)| new != to));
        let ranks = ranks.chain(extra).map(|(from, to)| (*from, *to, 1.0));
        SparseMatrix::from_triplets(7, ranks).unwrap()
    }

    #[test]
    fn without_new_orders_nothing_changes() {
        assert!(Standings::new(&ranks(&[]), &[]).weigh_edges(&ranks(&[])).is_none());
        assert!(Standings::new(&ranks(&[]), &[99]).weigh_edges(&ranks(&[])).is_none());
    }

    #[test]
    fn robots_with_new_orders_keep_the_edges_to_their_new_team() {
        // Robot 5 and robot 6 below it are handed over to robot 0.
        let standings = Standings::new(&ranks(&[(0, 5)]), &[5]);
        for (from, to, old) in [
            (5, 3, true),
            (5, 4, true),
            (4, 6, true),
            (5, 6, false),
            (5, 0, false),
            (5, 1, false),
            (6, 2, false),
            (1, 2, false),
            (3, 4, false),
        ] {
            assert_eq!(standings.is_old_tie(from, to), old, "{from} {to}");
            assert_eq!(standings.is_old_tie(to, from), old, "{to} {from}");
        }
        assert!(standings.is_new(5) && !standings.is_new(6));
        let edges = SparseMatrix::from_triplets(7, [(5, 3, 1.0), (5, 0, 1.0)]).unwrap();
        let left = standings.weigh_edges(&edges).unwrap().unwrap();
        assert_eq!((left.weight(5, 3), left.weight(5, 0)), (OLD_TIE, 1.0));
    }

    #[test]
    fn a_chain_of_all_robots_takes_no_longer_than_its_length() {
        let nodes = 100_000;
        let chain = SparseMatrix::from_triplets(nodes, (1..nodes).map(|i| (i - 1, i, 1.0)));
        let standings = Standings::new(&chain.unwrap(), &[0, nodes - 1]);
        assert_eq!(standings.robots[LONGEST_CHAIN].head, Some(0));
        assert_eq!(standings.robots[LONGEST_CHAIN + 1].head, None);
        assert_eq!(standings.robots[nodes - 1].head, Some(nodes - 1));
    }

    #[test]
    fn circles_of_superiors_end() {
        let ranks = SparseMatrix::from_triplets(3, [(0, 1, 1.0), (1, 2, 1.0), (2, 0, 1.0)]);
        let standings = Standings::new(&ranks.unwrap(), &[1]);
        assert!((0..3).all(|robot| standings.robots[robot].head == Some(1)));
    }
}
