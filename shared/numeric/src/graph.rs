//! Graph algorithms on an adjacency matrix.

pub(crate) mod components;
pub mod modularity;
pub(crate) mod ordering;
pub(crate) mod subgraph;
