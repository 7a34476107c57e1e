//! What every fleet promises, whatever it does.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use std::collections::BTreeSet;

use muster_model::limits::MAX_LINKS;
use muster_model::observation::Observation;
use muster_scenario::{Fleet, FleetOptions, ScenarioKind};

const MOMENTS: [f64; 8] = [0.0, 7.3, 11.0, 20.0, 33.3, 46.9, 59.99, 1.8e9];

fn fleet(kind: ScenarioKind, robots: usize, teams: usize, seed: u64) -> Fleet {
    let options = FleetOptions { robots, teams, seed, ..FleetOptions::default() };
    Fleet::new(kind, options).unwrap()
}

/// All kinds with some numbers of robots and teams that they can have, each with that of its teams.
fn fleets() -> impl Iterator<Item = (usize, Fleet)> {
    let sizes =
        [(2, 1), (2, 2), (3, 2), (4, 2), (5, 2), (7, 3), (18, 2), (61, 3), (500, 2), (500, 9)];
    ScenarioKind::ALL.into_iter().flat_map(move |kind| {
        sizes.into_iter().filter_map(move |(robots, teams)| {
            let options = FleetOptions { robots, teams, ..FleetOptions::default() };
            Some((teams, Fleet::new(kind, options).ok()?))
        })
    })
}

#[test]
fn every_size_from_two_to_five_hundred_makes_a_fleet() {
    for kind in ScenarioKind::ALL {
        for robots in 0..=500 {
            let options = FleetOptions { robots, ..FleetOptions::default() };
            let least = if kind == ScenarioKind::Crossing { 4 } else { 2 };
            let fleet = Fleet::new(kind, options);
            assert_eq!(fleet.is_ok(), robots >= least, "{kind} with {robots} robots");
            if let Ok(fleet) = fleet {
                assert_eq!(fleet.robots().len(), robots);
                assert_eq!(fleet.poses(1.0).len(), robots);
                let teams: BTreeSet<_> = fleet.truth(0.0).into_iter().collect();
                assert_eq!(teams, BTreeSet::from([0, 1]), "{kind} with {robots} robots");
            }
        }
    }
}

#[test]
fn robots_have_names_of_their_own_and_say_what_is_allowed() {
    for (_, fleet) in fleets() {
        let names: BTreeSet<_> = fleet.robots().iter().collect();
        assert_eq!(names.len(), fleet.robots().len());
        for t in MOMENTS {
            let reports = fleet.observe(t);
            assert_eq!(reports.len(), names.len());
            for (report, robot) in reports.iter().zip(fleet.robots()) {
                assert_eq!(&report.robot, robot);
                report.pose.check().unwrap();
                report.links.check().unwrap();
                report.rank.check().unwrap();
                assert_eq!(report.pose.frame.as_deref(), Some("map"));
                assert_eq!(
                    (report.pose.stamp, &report.pose.boot, report.pose.seq),
                    (None, &None, None)
                );
                assert!(report.links.links.len() <= MAX_LINKS);
                for link in &report.links.links {
                    assert!((0.0..=1.0).contains(&link.quality));
                    assert!(names.contains(&link.peer) && link.peer != report.robot);
                }
                let superior = report.rank.superior.as_ref();
                assert!(superior.is_none_or(|name| names.contains(name) && *name != report.robot));
            }
        }
    }
}

#[test]
fn the_same_seed_reports_the_same_and_another_one_something_else() {
    for kind in ScenarioKind::ALL {
        let observed = |seed, t| fleet(kind, 30, 2, seed).observe(t);
        assert_eq!(observed(5, 12.3), observed(5, 12.3));
        assert_ne!(observed(5, 12.3), observed(6, 12.3));
        assert_ne!(observed(5, 12.3), observed(5, 12.4));
        let (one, other) = (fleet(kind, 30, 2, 5), fleet(kind, 30, 2, 6));
        assert_ne!(one.links(3.0), other.links(3.0), "antennas differ");
        let _ = one.observe(99.0);
        assert_eq!(one.observe(12.3), observed(5, 12.3), "what was asked before does not matter");
        let parts = one.observe(12.3);
        assert!(parts.iter().map(|part| &part.pose).eq(&one.poses(12.3)));
        assert!(parts.iter().map(|part| &part.links).eq(&one.links(12.3)));
        assert!(parts.iter().map(|part| &part.rank).eq(&one.ranks(12.3)));
    }
}

#[test]
fn moments_that_are_none_do_no_harm() {
    for kind in ScenarioKind::ALL {
        let fleet = fleet(kind, 12, 2, 1);
        for t in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(fleet.observe(t), fleet.observe(0.0));
        }
        for t in [-1e-300, -13.0, -1e9, 1e18, f64::MAX, f64::MIN] {
            for report in fleet.observe(t) {
                report.pose.check().unwrap();
                assert!(report.pose.x.abs() < 1e3 && report.pose.y.abs() < 1e3);
            }
        }
    }
}

#[test]
fn the_true_team_is_that_of_the_highest_superior() {
    for (teams, fleet) in fleets() {
        for t in MOMENTS {
            let (ranks, truth) = (fleet.ranks(t), fleet.truth(t));
            let index = |name| fleet.robots().iter().position(|robot| robot == name).unwrap();
            let mut tops = BTreeSet::new();
            for robot in 0..ranks.len() {
                let mut top = robot;
                for _ in 0..4 {
                    top = ranks[top].superior.as_ref().map_or(top, index);
                }
                assert_eq!(ranks[top].superior, None, "the chain of command ends");
                assert_eq!(truth[top], truth[robot]);
                tops.insert(top);
            }
            assert_eq!(tops.len(), teams);
        }
    }
}

#[test]
fn links_are_short_and_differ_a_little_by_direction() {
    let fleet = fleet(ScenarioKind::Crossing, 18, 2, 1);
    let (links, poses) = (fleet.links(5.0), fleet.poses(5.0));
    let index = |name| fleet.robots().iter().position(|robot| robot == name).unwrap();
    let mut unequal = 0;
    for (robot, report) in links.iter().enumerate() {
        for link in &report.links {
            let peer = index(&link.peer);
            let metres = (poses[robot].x - poses[peer].x).hypot(poses[robot].y - poses[peer].y);
            assert!(metres < 40.0 * 1.21 + 2.0);
            let back = links[peer].links.iter().find(|link| link.peer == fleet.robots()[robot]);
            if let Some(back) = back {
                assert!((back.quality - link.quality).abs() < 0.5);
                unequal += usize::from(back.quality != link.quality);
            }
        }
    }
    assert!(unequal > 50, "{unequal}");
}

#[test]
fn groups_stand_still_and_far_from_each_other() {
    let options = FleetOptions { robots: 60, teams: 4, noise_m: 0.0, ..FleetOptions::default() };
    let fleet = Fleet::new(ScenarioKind::Clusters, options).unwrap();
    let (poses, truth) = (fleet.poses(0.0), fleet.truth(0.0));
    assert_eq!(poses, fleet.poses(77.0));
    for (robot, left) in poses.iter().enumerate() {
        assert_eq!(left.heading, None);
        let mut others: Vec<_> = (0..60)
            .filter(|other| *other != robot)
            .map(|other| ((left.x - poses[other].x).hypot(left.y - poses[other].y), other))
            .collect();
        others.sort_by(|l, r| l.0.total_cmp(&r.0));
        assert!(others[0].0 > 3.0 && others[0].0 < 12.0);
        assert!(others[..14].iter().all(|(_, other)| truth[*other] == truth[robot]));
        assert!(others[14].0 > 55.0 && truth[others[14].1] != truth[robot]);
    }
}

#[test]
fn wanderers_move_at_the_speed_of_robots_and_mix() {
    let options = FleetOptions { robots: 100, teams: 3, noise_m: 0.0, ..FleetOptions::default() };
    let fleet = Fleet::new(ScenarioKind::Random, options).unwrap();
    for (before, after) in fleet.poses(10.0).iter().zip(fleet.poses(10.1)) {
        assert!((after.x - before.x).hypot(after.y - before.y) < 0.3);
        assert!(before.heading.is_some());
    }
    assert_eq!(fleet.truth(0.0), fleet.truth(100.0));
    assert_ne!(fleet.links(0.0), fleet.links(10.0));
}

#[test]
fn a_large_fleet_is_observed_quickly() {
    for kind in ScenarioKind::ALL {
        let fleet = fleet(kind, 5000, 2, 1);
        let start = std::time::Instant::now();
        assert_eq!(fleet.observe(20.0).len(), 5000);
        let seconds = start.elapsed().as_secs_f64();
        println!("{kind}: {seconds} s");
        assert!(seconds < 5.0, "{kind} took {seconds} s");
    }
}
