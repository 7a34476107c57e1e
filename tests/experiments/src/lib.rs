//! The paper's experiments and ours ([`experiments`]): what is divided ([`formations`], [`random_systems`],
//! [`system`]), by which methods
//! ([`methods`]), how it is scored ([`score`], [`spaces`],
//! [`statistics`]), on which seeds ([`seeds`]),
//! and how it is shown ([`results`], [`figures`], [`plots`]).
//!
//! `cargo run --release -p muster-experiments -- --help` tells what can be run.

pub mod collapse;
pub mod experiments;
pub mod explained;
pub mod figures;
pub mod formations;
pub mod grid;
pub mod methods;
pub mod paper;
pub mod plots;
pub mod progress;
pub mod random_systems;
pub mod results;
pub mod scenario_one;
pub mod score;
pub mod seeds;
pub mod spaces;
pub mod statistics;
pub mod system;
