//! Exact division of robots among teams under limits, at the least cost.
//!
//! Every robot goes to one *column*: a team, or the reserve where there is one. Teams and the
//! reserve have bounds on their robots, and on those of each exclusive class; pairs of a robot and
//! a column may be forced or forbidden. That is a minimum-cost flow on integers, and so its optimum
//! is exact ([`Assigner`]). Its dual prices prove it ([`Certificate`]), and are kept for the next
//! call, which then repairs only what has changed. Rules that nothing satisfies are answered with
//! an irreducible set of them ([`Conflict`]).
//!
//! Wishes that some robots be together or apart, and needs of skills that robots have several of,
//! are NP-hard in general. [`assign_with_wishes`] branches over them on the bound of the flow, and
//! says how far from the optimum its answer may be.
//!
//! Costs are integers ([`CostMatrix`]), so that no tolerance decides what is optimal. Ties go to
//! the column of the previous call, then to the first. Nothing here is random or timed: the same
//! calls give the same answers.
//!
//! The flow method is successive shortest paths with potentials (Ahuja, Magnanti and Orlin,
//! *Network Flows*, 1993, section 9.7; Edmonds and Karp, Journal of the ACM 19, 1972), on a graph
//! whose nodes are the columns and not the robots: an edge between two columns is the robot that
//! moves at the least cost.

mod assigner;
mod branch;
mod certificate;
mod conflict;
mod costs;
mod cut;
mod exact_wishes;
mod filter;
mod max_flow;
mod movers;
mod network;
mod paths;
mod restrictions;
mod rules;
mod search_node;
mod wishes;

pub use assigner::{Assigner, Assignment, AssignmentError, ClassPrice};
pub use branch::{Division, DivisionError, assign_with_wishes, is_grantable};
pub use certificate::Certificate;
pub use conflict::{Conflict, Imbalance, Rule};
pub use costs::{CostError, CostMatrix, MAX_COST};
pub use exact_wishes::{ApartClasses, apart_as_classes};
pub use rules::{
    Bounds, ClassLimit, Column, MAX_CLASSES, MAX_COLUMNS, MAX_LIMITED_CELLS, MAX_ROBOTS, Pair,
    Rules, RulesError, ValidRules, Wanted,
};
pub use wishes::{MAX_NEEDS, MAX_WISHES, Need, Relation, ValidWishes, Wish, Wishes, WishesError};
