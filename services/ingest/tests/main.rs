//! All tests of ingest in one program, which is linked once.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

mod bench;
mod checks;
mod frames;
mod presence;
mod properties;
mod restart;
