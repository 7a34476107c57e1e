//! Faults of hosts and links: what the users of a fleet on three hosts see of each.
//!
//! They need root, and a kernel with network namespaces, virtual links and bridges. Where one of
//! these is missing they report that on standard error and test nothing; anything else that is wrong fails them.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::io::Write as _;
use std::process::Command;
use std::time::Duration;

use muster_tests::hosts::fault::{FAULTS, Fault};
use muster_tests::hosts::lab::{self, Host, Lab};
use muster_tests::hosts::run_plan;

/// Prints past the test harness, which hides what a passing test prints.
#[allow(clippy::explicit_write, reason = "what eprintln prints is kept back")]
fn say(text: &str) {
    writeln!(std::io::stderr(), "{text}").unwrap();
}

fn check(name: &str) {
    if let Some(missing) = lab::missing().unwrap() {
        say(&format!(
            "NOT TESTED: {name}, a fault of hosts and links: {missing}; run as root on Linux with \
             iproute2: cargo test --workspace --test hosts"
        ));
        return;
    }
    let measured = run_plan::check(Fault::named(name).unwrap()).unwrap();
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
    cable_of_a_whole_team_pulled: "team-pulled-20";
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

/// The namespaces of this machine that these tests made.
fn namespaces() -> Vec<String> {
    let output = Command::new("ip").args(["netns", "list"]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let names = text.lines().filter_map(|line| line.split_whitespace().next());
    names.filter(|name| name.starts_with("muster-hosts-")).map(str::to_owned).collect()
}

#[test]
fn hosts_are_gone_when_a_test_panics_and_after_one_was_killed() {
    if let Some(missing) = lab::missing().unwrap() {
        say(&format!("NOT TESTED: hosts are removed: {missing}"));
        return;
    }
    let (sender, receiver) = std::sync::mpsc::channel();
    let failing = std::thread::spawn(move || {
        let lab = Lab::new().unwrap();
        sender.send(lab.namespace(Host::Base)).unwrap();
        panic!("as a test that fails");
    });
    let name = receiver.recv().unwrap();
    assert!(failing.join().is_err());
    assert!(!namespaces().contains(&name), "{name} is left behind");

    // What a killed process leaves: a namespace with its name, which no process has any more, and
    // a program that still runs in it.
    let mut child = Command::new("sleep").arg("0").spawn().unwrap();
    let left = format!("muster-hosts-{}-1-0-base", child.id());
    child.wait().unwrap();
    assert!(Command::new("ip").args(["netns", "add", &left]).status().unwrap().success());
    let mut running =
        Command::new("ip").args(["netns", "exec", &left, "sleep", "60"]).spawn().unwrap();
    while Command::new("ip").args(["netns", "pids", &left]).output().unwrap().stdout.is_empty() {
        std::thread::sleep(Duration::from_millis(10));
    }
    drop(Lab::new().unwrap());
    assert!(!namespaces().contains(&left), "{left} is left behind");
    assert!(!running.wait().unwrap().success(), "what ran there was killed");
}
