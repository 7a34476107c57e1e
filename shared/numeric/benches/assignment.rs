//! Time of exact assignments: cold, and in the next tick of robots that move.

use divan::{Bencher, black_box};
use muster_numeric::assignment::{Assigner, Bounds, CostMatrix, Rules, ValidRules};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Robots and teams.
const SIZES: [(usize, usize); 3] = [(500, 8), (1_000, 8), (10_000, 50)];

/// Distance that a robot moves from tick to tick; the fleet is 1 wide.
const STEP: f64 = 0.002;

/// Largest relative deviation of a team from an even share.
const ROOM: f64 = 0.05;

fn main() {
    divan::main();
}

/// Robots in the unit square, denser towards a corner, and centres of teams.
struct Fleet {
    robots: Vec<[f64; 2]>,
    teams: Vec<[f64; 2]>,
    rng: ChaCha8Rng,
}

impl Fleet {
    fn new((robots, teams): (usize, usize)) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut place = |power: i32| [(); 2].map(|()| rng.random::<f64>().powi(power));
        let robots = (0..robots).map(|_| place(2)).collect();
        let teams = (0..teams).map(|_| place(1)).collect();
        Self { robots, teams, rng }
    }

    fn shift(&mut self) {
        for robot in &mut self.robots {
            for x in robot {
                *x += STEP * (2.0 * self.rng.random::<f64>() - 1.0);
            }
        }
    }

    /// Squared distances in units of 2⁻³².
    fn costs(&self) -> CostMatrix {
        let square = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
        let values: Vec<f64> =
            self.robots.iter().flat_map(|r| self.teams.iter().map(|t| square(r, t))).collect();
        let (robots, teams) = (self.robots.len(), self.teams.len());
        CostMatrix::from_floats(robots, teams, &values, CostMatrix::unit_for(1.0))
            .unwrap_or_else(|error| unreachable!("{error}"))
    }
}

fn even_teams((robots, teams): (usize, usize)) -> ValidRules {
    let share = robots as f64 / teams as f64;
    let bounds =
        Bounds::new((share * (1.0 - ROOM)) as usize, (share * (1.0 + ROOM)).ceil() as usize);
    Rules { teams: vec![bounds; teams], ..Rules::new(robots, teams) }
        .check()
        .unwrap_or_else(|error| unreachable!("{error}"))
}

#[divan::bench(args = SIZES)]
fn cold(bencher: Bencher<'_, '_>, size: (usize, usize)) {
    let (rules, costs) = (even_teams(size), Fleet::new(size).costs());
    bencher.bench_local(|| Assigner::new().solve(black_box(&rules), &costs));
}

#[divan::bench(args = SIZES)]
fn next_tick(bencher: Bencher<'_, '_>, size: (usize, usize)) {
    let rules = even_teams(size);
    let mut fleet = Fleet::new(size);
    let mut assigner = Assigner::new();
    let _ = assigner.solve(&rules, &fleet.costs());
    bencher
        .with_inputs(|| {
            fleet.shift();
            fleet.costs()
        })
        .bench_local_values(|costs| assigner.solve(black_box(&rules), &costs).map(|f| f.repairs));
}

#[divan::bench(args = SIZES)]
fn costs_from_floats(bencher: Bencher<'_, '_>, (robots, teams): (usize, usize)) {
    let values = vec![0.5; robots * teams];
    bencher.bench_local(|| CostMatrix::from_floats(robots, teams, black_box(&values), 1e-9));
}
