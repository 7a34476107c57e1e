//! The paper's experiments and ours ([`experiments`], [`collapse`]): what is divided ([`formations`],
//! [`random_systems`], [`physical`], [`system`]), by which methods ([`methods`]), how it is scored ([`score`],
//! [`spaces`], [`statistics`]), on which seeds ([`seeds`]), and how it is shown ([`results`], [`figures`],
//! [`plots`], [`explained`]).
//!
//! With the feature `bus`, the physical case runs through the real services (`live`, `case_study`); all else
//! knows neither bus nor services.
//!
//! Fleets that move ([`moving`]) go through the cores of all services, with their truth at any moment.
//!
//! On [`situations`], kinds of fleets of all sorts, Muster is compared with what Python's libraries have.
//!
//! `cargo run --release -p muster-experiments -- --help` lists what can be run.

#[cfg(feature = "bus")]
pub mod case_study;
pub mod collapse;
pub mod experiments;
pub mod explained;
pub mod figures;
pub mod formations;
pub mod goals;
pub mod grid;
#[cfg(feature = "bus")]
pub mod live;
pub mod methods;
pub mod moving;
pub mod paper;
pub mod physical;
pub mod plots;
pub mod progress;
pub mod random_systems;
pub mod results;
pub mod scenario_one;
pub mod score;
pub mod seeds;
pub mod situations;
pub mod spaces;
pub mod statistics;
pub mod system;
