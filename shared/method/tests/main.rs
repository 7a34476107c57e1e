//! All tests of the method in one program, which is linked once.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

mod apart;
mod bounded_frames;
mod needs;
mod new_groups;
mod reasons;
mod team_count;
mod trust;
