//! Clusters of the rows of a matrix: division, quality, and identities over time.

pub mod agreement;
pub mod kmeans;
pub mod margins;
pub mod matching;
#[cfg(test)]
mod register_widths;
pub mod silhouette;
