//! The paper's experiments and ours ([`experiments`]): what is divided ([`formations`], [`random_systems`],
//! [`system`]), by which methods
//! ([`methods`]), how it is scored ([`score`], [`spaces`],
//! [`statistics`]), and on which seeds ([`seeds`]).
//!
//! Fleets that move ([`moving`]) go through the cores of all services, with their truth at any moment.
//!
//! `cargo run --release -p muster-experiments -- --help` tells what can be run.

pub mod experiments;
pub mod formations;
pub mod grid;
pub mod methods;
pub mod moving;
pub mod paper;
pub mod random_systems;
pub mod results;
pub mod scenario_one;
pub mod score;
pub mod seeds;
pub mod spaces;
pub mod statistics;
pub mod system;
