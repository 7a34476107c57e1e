//! The story of the crossing: together, apart with one squad handed over, together again.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use muster_scenario::{Fleet, FleetOptions, ScenarioKind};

fn fleet(robots: usize, teams: usize) -> Fleet {
    let options = FleetOptions { robots, teams, noise_m: 0.0, ..FleetOptions::default() };
    Fleet::new(ScenarioKind::Crossing, options).unwrap()
}

fn positions(fleet: &Fleet, t: f64) -> Vec<[f64; 2]> {
    fleet.poses(t).iter().map(|pose| [pose.x, pose.y]).collect()
}

fn metres(left: [f64; 2], right: [f64; 2]) -> f64 {
    (left[0] - right[0]).hypot(left[1] - right[1])
}

/// The median distance to the nearest robot, and the least distance between robots of two teams.
fn spacing_and_gap(fleet: &Fleet, t: f64) -> (f64, f64) {
    let (places, truth) = (positions(fleet, t), fleet.truth(t));
    let mut gap = f64::INFINITY;
    let mut nearest = vec![f64::INFINITY; places.len()];
    for left in 0..places.len() {
        for right in (0..places.len()).filter(|right| *right != left) {
            let distance = metres(places[left], places[right]);
            nearest[left] = nearest[left].min(distance);
            if truth[left] != truth[right] {
                gap = gap.min(distance);
            }
        }
    }
    nearest.sort_by(f64::total_cmp);
    (nearest[nearest.len() / 2], gap)
}

#[test]
fn one_squad_is_handed_over_within_thirty_seconds_and_returns() {
    for (robots, teams) in [(4, 2), (18, 2), (60, 3), (500, 2)] {
        let fleet = fleet(robots, teams);
        let (before, apart, after) = (fleet.truth(5.0), fleet.truth(25.0), fleet.truth(55.0));
        let moved: Vec<usize> =
            (0..robots).filter(|&robot| before[robot] != apart[robot]).collect();
        assert!(!moved.is_empty() && moved.len() <= 9);
        assert!(moved.iter().all(|&robot| (before[robot], apart[robot]) == (0, 1)));
        assert_eq!(before, after);
        assert_eq!(before, fleet.truth(65.0));
        // Only the leader of the squad answers to somebody else.
        let (ranks, lent) = (fleet.ranks(5.0), fleet.ranks(25.0));
        let changed: Vec<_> =
            (0..robots).filter(|&robot| ranks[robot].superior != lent[robot].superior).collect();
        assert_eq!(changed, [moved[0]]);
        assert_eq!(lent[moved[0]].superior.as_ref().unwrap().as_str(), "p2-lead");
        assert_eq!(ranks[moved[0]].superior.as_ref().unwrap().as_str(), "p1-lead");
    }
}

#[test]
fn the_first_change_comes_soon_but_not_at_once() {
    let fleet = fleet(18, 2);
    let changes =
        (0..600).map(f64::from).find(|tenth| fleet.truth(tenth / 10.0) != fleet.truth(0.0));
    assert!((100.0..=120.0).contains(&changes.unwrap()));
}

#[test]
fn robots_keep_their_distance_and_teams_part() {
    for (robots, teams) in [(4, 2), (9, 2), (18, 2), (30, 3), (200, 2), (500, 4)] {
        let fleet = fleet(robots, teams);
        let mut least = f64::INFINITY;
        for second in 0..60 {
            let places = positions(&fleet, f64::from(second));
            for (robot, left) in places.iter().enumerate() {
                for right in &places[..robot] {
                    least = least.min(metres(*left, *right));
                }
            }
        }
        assert!(least > 4.0, "{robots} robots come as near as {least} m");
        let (spacing, together) = spacing_and_gap(&fleet, 5.0);
        assert!((4.0..=17.0).contains(&spacing), "{robots}: {spacing} m");
        let (_, apart) = spacing_and_gap(&fleet, 28.0);
        println!("{robots} {teams}: {spacing:.1} together {together:.1} apart {apart:.1}");
        // Squads of one or two are narrower than their place.
        assert!(together < 35.0, "{robots}: {together} m");
        assert!(apart > 1.6 * together && apart > 5.0 * spacing.min(7.0), "{robots}: {apart} m");
    }
}

#[test]
fn all_move_smoothly_at_the_speed_of_robots_along_their_heading() {
    let fleet = fleet(60, 3);
    let step = 0.01;
    for tick in 0..6000 {
        let t = f64::from(tick) * step;
        let (poses, after) = (fleet.poses(t), positions(&fleet, t + step));
        for (pose, after) in poses.iter().zip(after) {
            let [east, north] = [after[0] - pose.x, after[1] - pose.y];
            let speed = east.hypot(north) / step;
            assert!((1.2..=5.0).contains(&speed), "{speed} m/s at {t} s");
            let turn = north.atan2(east) - pose.heading.unwrap();
            // At the crossing itself all turn on the spot.
            let is_crossing = [11.0, 47.0].iter().any(|at| (t - at).abs() < 2.0 * step);
            assert!(turn.cos() > 0.99 || is_crossing, "{turn} at {t} s");
        }
    }
}

#[test]
fn the_lent_squad_marches_next_to_its_hosts() {
    let fleet = fleet(18, 2);
    let (places, truth, home) = (positions(&fleet, 29.0), fleet.truth(29.0), fleet.truth(0.0));
    let team = |robot: usize| (home[robot], truth[robot]);
    let lent: Vec<usize> = (0..18).filter(|&robot| team(robot) == (0, 1)).collect();
    let nearest = |robot: usize, of: (usize, usize)| {
        let others = (0..18).filter(|&other| team(other) == of);
        others.map(|other| metres(places[robot], places[other])).fold(f64::INFINITY, f64::min)
    };
    assert!(lent.iter().any(|&robot| nearest(robot, (1, 1)) < 14.0));
    assert!(lent.iter().all(|&robot| nearest(robot, (0, 0)) > 60.0));
}
