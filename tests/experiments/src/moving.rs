//! Scenario III: fleets that move, split, join and lose radios and members, with known truth at any moment.
//!
//! Read in this order: [`fleet`] has the chain of command and the formation; [`mission`] what happens when, and so
//! what is true; [`radio`] the links; [`reports`] what robots report of that, and [`faults`] what is wrong with it;
//! [`pipeline`] the real cores of all services in virtual time, with the [`times`] of a live system; [`run`] one mission through them; [`measures`] how
//! well it was followed. [`mod@page`] is the page of many missions.

mod chance;
pub mod faults;
pub mod fleet;
pub mod measures;
pub mod mission;
pub mod page;
pub mod pipeline;
pub mod plan;
pub mod radio;
pub mod reports;
pub mod run;
pub mod times;
