//! All tests of what all services share in one program, which is linked once.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::unwrap_used,
    reason = "a test fails by panicking"
)]

mod changes;
mod commands;
mod host;
mod pair;
mod recording;
mod replica;
mod small;
mod terms;
