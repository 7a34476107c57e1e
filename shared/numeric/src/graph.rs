//! Graph algorithms on the pattern of an adjacency matrix.

pub(crate) mod components;
pub(crate) mod ordering;
pub(crate) mod subgraph;
