//! Scenario III: fleets that move, split, join and lose radios and members, with known truth at any moment.
//!
//! Read in this order: [`fleet`] has who commands whom and where everybody belongs; [`mission`] what happens
//! when, and so what is true; [`radio`] who hears whom; [`reports`] what robots say of that, and [`faults`] what
//! is wrong with it; [`pipeline`] the real cores of all services in virtual time; [`run`] one mission through
//! them; [`measures`] how well it was followed. [`mod@page`] tells of many.

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
