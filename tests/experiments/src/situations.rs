//! Situations: kinds of fleets whose teams are known, on which Muster is compared with what anybody can take
//! from a Python library.
//!
//! | step | module |
//! | --- | --- |
//! | what a situation is | [`situation`] |
//! | how one is drawn: places, radio, command, faults | `draw`, `shapes`, `fleet`, `faults` |
//! | the kinds, in two lists | [`kinds`], `chosen_on`, `looked_at_once` |
//! | Muster and the paper's method on one | [`divided`] |
//! | what baselines read and write | [`exchange`] |
//! | all kinds over all seeds | [`run`] |
//! | the method without one step each | [`steps`] |
//! | the page, and the goals on it | [`page`], `goals` |
//!
//! Kinds are divided like seeds ([`crate::seeds`]): defaults may be chosen on the kinds of one list alone; those
//! of the other are looked at once, at the end.

mod chosen_on;
pub mod divided;
mod draw;
pub mod exchange;
mod faults;
mod fleet;
mod goals;
pub mod kinds;
mod looked_at_once;
pub mod page;
pub mod run;
mod shapes;
pub mod situation;
pub mod steps;
