//! Robots that wander about, each on a curve of its own around its home.
//!
//! Command units are those whose homes are nearest to the home of the same leader: they do not change
//! while the robots mix.

use std::f64::consts::TAU;

use rand::RngExt;

use crate::formation::{Command, Formation, Member, Place, Point, columns, number};
use crate::noise::{Purpose, between, chance};
use crate::options::{FleetOptions, ScenarioError};

/// Metres between homes, before they are moved.
const PITCH_M: f64 = 14.0;

/// Most metres along each axis by which a home is off.
const OFF_M: f64 = 4.0;

/// How far a robot wanders from home along each axis, in metres.
const REACH_M: (f64, f64) = (6.0, 18.0);

/// Highest speed along each axis, in metres per second.
const SPEED_M_S: (f64, f64) = (0.8, 2.0);

/// An oscillation along one axis.
#[derive(Debug, Clone, Copy)]
struct Swing {
    home_m: f64,
    reach_m: f64,
    /// Radians per second.
    pace: f64,
    /// Radians.
    start: f64,
}

/// The scenario.
#[derive(Debug)]
pub(crate) struct Random {
    members: Vec<Member>,
    /// East and north: together a curve of Lissajous.
    swings: Vec<[Swing; 2]>,
    commands: Vec<Command>,
}

impl Random {
    /// Places the robots. The options are checked.
    pub(crate) fn new(options: &FleetOptions) -> Result<Self, ScenarioError> {
        let mut chance = chance(options.seed, Purpose::Layout, 0.0);
        let columns = columns(options.robots);
        let mut swings = Vec::with_capacity(options.robots);
        for robot in 0..options.robots {
            swings.push([robot % columns, robot / columns].map(|cell| {
                let home_m = number(cell) * PITCH_M + between(&mut chance, -OFF_M, OFF_M);
                let reach_m = between(&mut chance, REACH_M.0, REACH_M.1);
                let pace = between(&mut chance, SPEED_M_S.0, SPEED_M_S.1) / reach_m;
                Swing { home_m, reach_m, pace, start: between(&mut chance, 0.0, TAU) }
            }));
        }
        let mut leaders: Vec<usize> = (0..options.robots).collect();
        for drawn in 0..options.teams.min(options.robots) {
            leaders.swap(drawn, chance.random_range(drawn..options.robots));
        }
        leaders.truncate(options.teams);
        leaders.sort_unstable();
        let commands = commands(&swings, &leaders);
        let role = |command: &Command| if command.superior.is_none() { "leader" } else { "member" };
        let members = (1..).zip(&commands).map(|(n, command)| {
            Member::new(format!("r{n}"), role(command)).map_err(ScenarioError::from)
        });
        Ok(Self { members: members.collect::<Result<_, _>>()?, swings, commands })
    }
}

fn commands(swings: &[[Swing; 2]], leaders: &[usize]) -> Vec<Command> {
    let home = |swings: &[Swing; 2]| swings.map(|swing| swing.home_m);
    let leaders: Vec<(usize, Point)> =
        leaders.iter().filter_map(|&leader| Some((leader, home(swings.get(leader)?)))).collect();
    let command = |(robot, swings): (usize, &[Swing; 2])| {
        let [x, y] = home(swings);
        let squared =
            |&(_, (_, [u, v])): &(usize, (usize, Point))| (x - u).powi(2) + (y - v).powi(2);
        let nearest = leaders.iter().copied().enumerate();
        let nearest = nearest.min_by(|l, r| squared(l).total_cmp(&squared(r)));
        let (team, (leader, _)) = nearest.unwrap_or((0, (robot, [x, y])));
        Command { superior: (leader != robot).then_some(leader), team }
    };
    swings.iter().enumerate().map(command).collect()
}

impl Formation for Random {
    fn members(&self) -> &[Member] {
        &self.members
    }

    fn places(&self, t_seconds: f64) -> Vec<Place> {
        let place = |swings: &[Swing; 2]| {
            let angle = |swing: &Swing| swing.start + swing.pace * t_seconds;
            Place {
                at: swings.map(|swing| swing.home_m + swing.reach_m * angle(&swing).sin()),
                velocity: Some(
                    swings.map(|swing| swing.reach_m * swing.pace * angle(&swing).cos()),
                ),
            }
        };
        self.swings.iter().map(place).collect()
    }

    fn commands(&self, _t_seconds: f64) -> Vec<Command> {
        self.commands.clone()
    }
}
