//! Faults over real sockets: a fleet of real processes on a real bus, to which a seeded plan of faults happens,
//! one after the other, while observers judge all that is published.
//!
//! [`mod@plan`] draws the fleet and its faults from a seed; the [`field`] is the fleet, with its links, disks and
//! processes; [`judge`] has the promises, with the rules of the simulation's oracle where they apply;
//! [`memory`] samples the processes; [`flood`] is what a stranger puts; [`run`] plays a plan. What Zenoh
//! does is part of what is tested, as it is not in the simulation.
//!
//! [`steady`] is the other kind of a long run: many robots, and no fault at all.

mod disk;
mod field;
mod flood;
mod judge;
mod memory;
mod plan;
mod run;
pub mod steady;

pub use plan::{Plan, plan};
pub use run::{Outcome, RunOptions, run};
