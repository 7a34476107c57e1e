//! From vectors, limits, wishes, needs and the last division to named teams, and the silhouettes of those.
//!
//! Read in the order of the data's path: [`division::Job`] is one embedding to divide, and [`division::divide`] does it:
//! k-means on the rows, started from the teams before. [`rules`] is what limits, wishes and [`needs`] ask of a division,
//! `limited` the division under them, `passes` divides again until nothing changes, `words` why they cannot be obeyed; [`number`] says how many teams there are to be;
//! [`identity`] gives each cluster a team id that lives on, and names what changed, with the help of [`memory`], which
//! robot was in which team lately; [`seats`] keeps the places of teams that are absent; [`wishes`] says what has become of each
//! wish; [`scores`] has the silhouettes.
//!
//! The live division, proposals and `muster solve` under limits are made by this code, so that each is what the fleet would
//! become.

#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]

pub mod division;
pub mod identity;
mod limited;
pub mod memory;
pub mod needs;
pub mod number;
mod passes;
pub mod rules;
pub mod scores;
pub mod seats;
pub mod wishes;
pub mod words;
