//! All tests of the mathematics in one program, which is linked once.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

mod assignment;
mod assignment_wishes;
mod cached_katz;
mod certificates;
mod cold_searches;
mod common;
mod embedding;
mod katz;
mod katz_svd;
mod katz_svd_changes;
mod kmeans;
mod kmeans_limits;
mod kmeans_recorded;
mod matrices;
mod new_groups;
mod oracle;
mod properties;
mod radius;
mod radius_bound;
mod silhouettes;
mod svd;
