//! Graph algorithms on an adjacency matrix or a list of edges.

pub(crate) mod components;
pub mod conductance;
pub mod cuts;
pub(crate) mod elimination;
pub mod modularity;
pub(crate) mod ordering;
pub(crate) mod subgraph;
