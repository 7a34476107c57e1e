//! Fuzz targets for everything that reads foreign bytes, and for the cores behind it.
//!
//! A target is a plain function of bytes that panics if a promise does not hold. It is driven in two
//! ways: the test `replay` runs every input of `corpus/` and seeded mutations of it with plain `cargo
//! test`; `run` lets LLVM's fuzzer look for new paths, guided by coverage, for as long as one likes.
//!
//! The promises, beyond "it does not panic": what is accepted is written again and read back as the
//! same; what is refused is refused in short words without control characters; memory stays within
//! a multiple of the input ([`allocation`]); what a core publishes is finite, ordered, and accepted
//! by its readers.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a target fails by panicking"
)]

pub mod allocation;
mod cores;
mod draw;
mod kept;
mod keys;
mod mcap;
pub mod mutate;
mod packets;
mod recording;
mod replica;
mod ros;
pub mod seeds;
mod settings;
mod solve;
mod text;

/// What became of an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing came of it: the reader refused all of it, or the core published no result.
    Refused,
    /// The reader accepted it, or the core published a result of robots.
    Accepted,
}

impl Outcome {
    pub(crate) fn accepted_if(is_accepted: bool) -> Self {
        if is_accepted { Self::Accepted } else { Self::Refused }
    }
}

/// One thing to be fuzzed.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name, which is that of its folder in the corpus.
    pub name: &'static str,
    /// Runs it once; panics if a promise does not hold.
    pub run: fn(&[u8]) -> Outcome,
    /// Longest input in bytes that is tried: enough for what it reads, short enough to be fast.
    pub longest: usize,
    /// How many mutations the test command tries: what takes a second or so without optimisation.
    pub mutations: usize,
}

/// All targets.
pub const TARGETS: [Target; 23] = [
    target("packet", packets::packet, 2048, 30_000),
    target("envelope", packets::envelope, 2048, 30_000),
    target("robot_team", packets::robot_team, 2048, 20_000),
    target("katz", packets::katz, 2048, 20_000),
    target("why", packets::why, 4096, 10_000),
    target("bridge", packets::bridge, 4096, 10_000),
    target("proposal", packets::proposal, 4096, 10_000),
    target("recording", recording::recording, 4096, 10_000),
    target("kept", kept::kept, 2048, 10_000),
    target("edge_json", packets::edge_json, 2048, 30_000),
    target("key", keys::key, 256, 20_000),
    target("request", keys::request, 512, 5_000),
    target("settings", settings::settings, 1024, 4_000),
    target("stored", settings::stored, 1024, 4_000),
    target("solve", solve::solve, 1024, 1_000),
    target("replica", replica::replica, 1024, 4_000),
    target("ingest", cores::ingest, 4096, 400),
    target("embedder", cores::embedder, 4096, 400),
    target("clusterer", cores::clusterer, 4096, 400),
    target("auditor", cores::auditor, 4096, 400),
    target("planner", cores::planner, 6144, 400),
    target("ros", ros::ros, 2048, 20_000),
    target("mcap", mcap::mcap, 2048, 10_000),
];

const fn target(
    name: &'static str,
    run: fn(&[u8]) -> Outcome,
    longest: usize,
    mutations: usize,
) -> Target {
    Target { name, run, longest, mutations }
}

/// The target of a name.
#[must_use]
pub fn find(name: &str) -> Option<Target> {
    TARGETS.into_iter().find(|target| target.name == name)
}
