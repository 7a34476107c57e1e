//! All tests of messages as bytes in one program, which is linked once.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

mod golden;
mod hostile;
mod recordings;
mod samples;
mod schema;
mod sizes;
mod strict;
