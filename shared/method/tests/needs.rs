//! Needs of overlapping skills in fleets of a usual size: the bounded search finds what is there.

use muster_method::limited::{LimitedError, Limits, divide_within};
use muster_method::params::DivisionParams;
use muster_numeric::assignment::{Bounds, Column, Need, Rules, Wishes};
use muster_numeric::matrix::DenseMatrix;

/// A linear congruential generator (Knuth, MMIX).
struct Draw(u64);

impl Draw {
    fn next(&mut self) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }

    fn below(&mut self, count: usize) -> usize {
        usize::try_from(self.next()).unwrap() % count
    }

    fn coordinate(&mut self) -> f64 {
        f64::from(u32::try_from(self.next()).unwrap()) / f64::from(u32::MAX)
    }
}

/// A fleet in groups, whose needs can be filled: every team was given what it needs, and some robots have more.
fn divided(robots: usize, teams: usize, skills: usize, min: usize, seed: u64) -> bool {
    let mut draw = Draw(seed);
    let mut has = vec![vec![false; robots]; skills];
    for has in &mut has {
        for team in 0..teams {
            // Robots of some group, whichever: the division may have to mix them.
            let mut group: Vec<usize> = (0..robots).filter(|robot| robot % teams == team).collect();
            for _ in 0..min {
                has[group.swap_remove(draw.below(group.len()))] = true;
            }
        }
    }
    let values = (0..3 * robots).map(|_| draw.coordinate()).collect();
    let x = DenseMatrix::new(robots, 3, values).unwrap();
    let rules = Rules { teams: vec![Bounds::at_least(1); teams], ..Rules::new(robots, teams) };
    let rules = rules.check().unwrap();
    let need = |team, has: &Vec<bool>| Need {
        robots: (0..robots).filter(|robot| has[*robot]).collect(),
        column: Column::Team(team),
        at_least: min,
        at_most: usize::MAX,
        price: None,
    };
    let needs: Vec<Need> =
        (0..teams).flat_map(|team| has.iter().map(move |has| need(team, has))).collect();
    let groups = Wishes { needs: needs.clone(), ..Wishes::default() }.check(&rules).unwrap();
    let params = DivisionParams { teams, restarts: 5, ..DivisionParams::default() };
    let previous = vec![None; robots];
    let limits = Limits { rules: &rules, groups: &groups, previous: &previous, refine_only: false };
    match divide_within(&x, &params.check().unwrap(), &limits) {
        Ok(found) => {
            for need in &needs {
                let Column::Team(team) = need.column else { continue };
                let there = need.robots.iter().filter(|robot| found.labels[**robot] == Some(team));
                assert!(there.count() >= min);
            }
            true
        }
        Err(LimitedError::Groups(error)) => {
            println!("{robots} robots, {teams} teams, {skills} skills, {min}: {error}");
            false
        }
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn needs_that_can_be_filled_are() {
    for (robots, teams, skills) in [(12, 3, 2), (18, 3, 3), (40, 6, 2), (60, 8, 3)] {
        let found = (0..10).filter(|seed| divided(robots, teams, skills, 1, *seed)).count();
        println!("{robots} robots in {teams} teams with {skills} skills: {found} of 10");
        assert_eq!(found, 10);
    }
}
