//! All tests of the embedder in one program, which is linked once.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;
mod embedding;
mod follow;
mod late;
mod pairs;
mod reasons;
mod rest;
mod restart;
