//! Faults of hosts and links: what the users of a fleet on three hosts see of each.
//!
//! They need root, and a kernel with network namespaces, virtual links and bridges. Where something
//! is missing they say so on standard error and test nothing.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::io::Write as _;

use muster_tests::hosts::course;
use muster_tests::hosts::fault::{FAULTS, Fault};
use muster_tests::hosts::lab;

/// Says something past the test harness, which keeps back what a good test prints.
fn say(text: &str) {
    writeln!(std::io::stderr(), "{text}").unwrap();
}

fn check(name: &str) {
    if let Some(missing) = lab::missing() {
        say(&format!(
            "NOT TESTED: {name}, a fault of hosts and links: {missing}; run as root on Linux with \
             iproute2: cargo test -p muster-tests --test hosts"
        ));
        return;
    }
    let measured = course::check(Fault::named(name).unwrap()).unwrap();
    say(&measured.json().to_string());
}

macro_rules! faults {
    ($($test:ident: $name:literal;)*) => {
        /// The faults that have a test.
        const TESTED: &[&str] = &[$($name),*];

        $(
            #[test]
            fn $test() {
                check($name);
            }
        )*
    };
}

faults! {
    cable_of_the_robots_pulled_shortly: "robots-pulled-3";
    cable_of_the_robots_pulled_until_they_leave: "robots-pulled-20";
    packets_of_the_robots_lost_shortly: "robots-lost-3";
    packets_of_the_robots_lost_until_they_leave: "robots-lost-20";
    cable_of_the_base_pulled_shortly: "base-pulled-3";
    cable_of_the_base_pulled_for_long: "base-pulled-20";
    packets_of_the_base_lost_for_long: "base-lost-20";
    link_of_the_robots_narrowed: "narrow-64";
    link_of_the_robots_slow_and_lossy: "slow";
    router_killed_shortly: "router-killed-1";
    router_killed_for_long: "router-killed-15";
    router_hangs: "router-stopped-5";
    router_hangs_shortly: "router-stopped-1";
}

#[test]
fn every_fault_of_the_table_has_a_test() {
    assert_eq!(TESTED, FAULTS.map(|fault| fault.name));
}
