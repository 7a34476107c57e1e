//! What a fleet does and when, and so what is true at any moment.

use std::f64::consts::TAU;
use std::fmt;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::fleet::{Fleet, JOINED, JOINS, SPACING_M, SPLITS, SQUAD_GAP_M, TEAM_GAP_M};

/// How fast a part of the fleet parts from the others or closes up, in m/s: it waits while they march, or
/// they wait for it.
pub const PACE_M_S: f64 = 1.75;

/// Time from standing still to [`PACE_M_S`], in seconds.
const SETTING_OUT_S: f64 = 1.0;

/// How far the part that splits off falls back at most, in metres.
const SPLIT_DISTANCE_M: f64 = 40.0;

/// Standard deviation of reported positions on the march, in metres along each axis.
const MARCH_NOISE_M: f64 = 0.15;

/// Noise of distances between neighbours of a fleet at rest, as a share of them.
pub const REST_NOISE: f64 = 0.1;

/// Share of the robots whose radio fails, and of those that fall silent.
pub const STRUCK_SHARE: f64 = 0.1;

/// When radios fail and work again, and when robots fall silent, in seconds.
const RADIOS_FAIL_S: (f64, f64) = (5.0, 9.0);
/// See [`RADIOS_FAIL_S`].
const SILENT_FROM_S: f64 = 11.0;

/// How teams, squads and robots sway about their places: amplitude in metres, shortest and longest period in
/// seconds.
const SWAY: [(f64, f64, f64); 3] = [(2.0, 20.0, 30.0), (1.0, 12.0, 20.0), (0.5, 5.0, 10.0)];

/// When a part of the fleet gets another task, and when it goes back, in seconds: long enough to see whether the
/// change was followed, and short enough for many seeds.
const CHANGE_S: f64 = 5.0;
/// See [`CHANGE_S`].
const BACK_S: f64 = 13.0;

/// What a fleet lives through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Case {
    /// No robot moves, and distances are measured with [`REST_NOISE`].
    Rest,
    /// All march, and nothing changes.
    March,
    /// A part of a team gets a task of its own, and later comes back.
    Split,
    /// A team splits while another one joins a third, and later all go back. The number of teams stays.
    Regroup,
    /// Some radios fail for a while, then some robots fall silent for good.
    Losses,
}

impl Case {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Rest, Self::March, Self::Split, Self::Regroup, Self::Losses];

    /// How long it lasts, in seconds.
    #[must_use]
    pub fn lasts_s(self) -> f64 {
        match self {
            Self::Rest | Self::March => 13.0,
            Self::Split | Self::Regroup => 20.0,
            Self::Losses => 17.0,
        }
    }

    /// The acts, with their starts in seconds.
    #[must_use]
    pub fn phases(self) -> &'static [(f64, Act)] {
        match self {
            Self::Rest | Self::March | Self::Losses => &[(0.0, Act::Together)],
            Self::Split => &[(0.0, Act::Together), (CHANGE_S, Act::Split), (BACK_S, Act::Together)],
            Self::Regroup => {
                &[(0.0, Act::Together), (CHANGE_S, Act::Regroup), (BACK_S, Act::Together)]
            }
        }
    }
}

impl fmt::Display for Case {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(match self {
            Self::Rest => "rest",
            Self::March => "march",
            Self::Split => "split",
            Self::Regroup => "regroup",
            Self::Losses => "losses",
        })
    }
}

/// How robots form teams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Act {
    /// Every robot is in its own team.
    Together,
    /// A part of a team is a team of its own.
    Split,
    /// The same, and another team is part of a third.
    Regroup,
}

impl Act {
    /// Whether the teams of a robot's kind are others in this act than in [`Act::Together`].
    #[must_use]
    pub fn involves(self, team: usize) -> bool {
        match self {
            Self::Together => false,
            Self::Split => team == SPLITS,
            Self::Regroup => [SPLITS, JOINED, JOINS].contains(&team),
        }
    }
}

/// A fleet with what it lives through.
#[derive(Debug, Clone)]
pub struct Mission {
    /// The robots that take part.
    pub fleet: Fleet,
    /// What they live through.
    pub case: Case,
    /// Standard deviation of reported positions, in metres along each axis.
    pub noise_m: f64,
    /// How teams, squads and robots sway: along each axis way, pulse in radians per second, and phase.
    sways: [Vec<[[f64; 3]; 2]>; 3],
    /// By robot: whether its radio fails, and whether it falls silent.
    radio_fails: Vec<bool>,
    falls_silent: Vec<bool>,
}

impl Mission {
    /// A mission of a fleet; how robots sway and which fail follows from the seed.
    #[must_use]
    pub fn new(fleet: Fleet, case: Case, seed: u64) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let counts = [fleet.teams, fleet.squads, fleet.robots.len()];
        let sways = [0, 1, 2].map(|kind| {
            let (way, shortest, longest) = SWAY[kind];
            let way = if case == Case::Rest { 0.0 } else { way };
            let mut axis = || {
                let period = shortest + (longest - shortest) * chance.random::<f64>();
                [way * chance.random::<f64>(), TAU / period, TAU * chance.random::<f64>()]
            };
            (0..counts[kind]).map(|_| [axis(), axis()]).collect()
        });
        let mut struck = || {
            fleet.robots.iter().map(|_| chance.random::<f64>() < STRUCK_SHARE).collect::<Vec<_>>()
        };
        let (radio_fails, falls_silent) = (struck(), struck());
        let noise_m = match case {
            // The distance of two robots errs by the noise of both.
            Case::Rest => REST_NOISE * SPACING_M / 2.0_f64.sqrt(),
            _ => MARCH_NOISE_M,
        };
        Self { fleet, case, noise_m, sways, radio_fails, falls_silent }
    }

    /// What happens at a moment.
    #[must_use]
    pub fn act(&self, t: f64) -> Act {
        let phase = self.case.phases().iter().rev().find(|(from, _)| *from <= t);
        phase.map_or(Act::Together, |(_, act)| *act)
    }

    /// When the truth changes, and what comes then.
    pub fn turning_points(&self) -> impl Iterator<Item = (f64, Act)> + '_ {
        self.case.phases().iter().skip(1).copied()
    }

    /// How many teams there are.
    #[must_use]
    pub fn teams_asked(&self, t: f64) -> usize {
        self.fleet.teams + usize::from(self.act(t) == Act::Split)
    }

    /// The true team of a robot; none of one that has fallen silent. A team that split off has the number behind
    /// all others.
    #[must_use]
    pub fn team(&self, robot: usize, t: f64) -> Option<usize> {
        (!self.is_silent(robot, t)).then(|| self.team_in(self.act(t), robot))
    }

    fn team_in(&self, act: Act, robot: usize) -> usize {
        let one = &self.fleet.robots[robot];
        match act {
            Act::Split | Act::Regroup if one.splits => self.fleet.teams,
            Act::Regroup if one.team == JOINS => JOINED,
            _ => one.team,
        }
    }

    /// Whether anything happens to the team of a robot in this case.
    #[must_use]
    pub fn is_involved(&self, robot: usize) -> bool {
        let team = self.fleet.robots[robot].team;
        self.case.phases().iter().any(|(_, act)| act.involves(team))
    }

    /// How often the truth moves a robot to another team.
    #[must_use]
    pub fn moves(&self, robot: usize) -> usize {
        let phases = self.case.phases().windows(2);
        phases.filter(|two| self.team_in(two[0].1, robot) != self.team_in(two[1].1, robot)).count()
    }

    /// Whether a robot has fallen silent.
    #[must_use]
    pub fn is_silent(&self, robot: usize, t: f64) -> bool {
        self.case == Case::Losses && t >= SILENT_FROM_S && self.falls_silent[robot]
    }

    /// Whether a robot has no links in either direction.
    #[must_use]
    pub fn is_deaf(&self, robot: usize, t: f64) -> bool {
        let fails = (RADIOS_FAIL_S.0..RADIOS_FAIL_S.1).contains(&t) && self.radio_fails[robot];
        self.is_silent(robot, t) || self.case == Case::Losses && fails
    }

    /// The superior of a robot at this moment, or, if that one has fallen silent, the first below or above it that
    /// has not.
    #[must_use]
    pub fn superior(&self, robot: usize, t: f64) -> Option<usize> {
        let act = self.act(t);
        let mut superior = self.superior_in(act, robot);
        while let Some(lost) = superior.filter(|lost| self.is_silent(*lost, t)) {
            let below = (lost + 1..self.fleet.robots.len())
                .take_while(|other| self.fleet.robots[*other].team == self.fleet.robots[lost].team)
                .find(|other| {
                    self.superior_in(act, *other) == Some(lost) && !self.is_silent(*other, t)
                });
            superior = match below {
                Some(deputy) if deputy != robot => return Some(deputy),
                _ => self.superior_in(act, lost),
            };
        }
        superior
    }

    fn superior_in(&self, act: Act, robot: usize) -> Option<usize> {
        let one = &self.fleet.robots[robot];
        let base = one.superior?;
        let [joined, joins] = [JOINED, JOINS].map(|team| self.fleet.leaders.get(team).copied());
        let leaves_with_others = one.splits && !self.fleet.robots[base].splits;
        match act {
            Act::Split | Act::Regroup if robot == self.fleet.head => Some(self.fleet.leaders[0]),
            Act::Split | Act::Regroup if leaves_with_others => Some(self.fleet.head),
            // Its units are units of the other team, and its leader is at that one's disposal.
            Act::Regroup if [Some(robot), Some(base)].contains(&joins) => joined,
            _ => Some(base),
        }
    }

    /// Where all robots are, in metres ahead and to the left of a point that moves with the fleet: shared motion
    /// changes no distance.
    #[must_use]
    pub fn places(&self, t: f64) -> Vec<[f64; 2]> {
        let back = self.way(t, |act| if act == Act::Together { 0.0 } else { SPLIT_DISTANCE_M });
        let left = self.way(t, |act| match act {
            Act::Regroup => TEAM_GAP_M - SQUAD_GAP_M,
            _ => 0.0,
        });
        let place = |(number, robot): (usize, &super::fleet::Robot)| {
            let [team, squad, own] = [(0, robot.team), (1, robot.squad), (2, number)]
                .map(|(kind, one)| self.sways[kind][one].map(|sway| swayed(sway, t)));
            let off = [
                if robot.splits { -back } else { 0.0 },
                if robot.team == JOINS { left } else { 0.0 },
            ];
            [0, 1].map(|axis| robot.home[axis] + team[axis] + squad[axis] + own[axis] + off[axis])
        };
        self.fleet.robots.iter().enumerate().map(place).collect()
    }

    /// How far a robot has gone that sets out in each phase for the goal of that phase.
    fn way(&self, t: f64, goal: impl Fn(Act) -> f64) -> f64 {
        let phases = self.case.phases();
        let mut at = 0.0_f64;
        for (number, (from, act)) in phases.iter().enumerate().filter(|(_, (from, _))| *from <= t) {
            let until = phases.get(number + 1).map_or(t, |(next, _)| next.min(t));
            let gone = walked(until - from);
            at += (goal(*act) - at).clamp(-gone, gone);
        }
        at
    }
}

/// Distance in metres after so many seconds, from standing still.
fn walked(seconds: f64) -> f64 {
    if seconds < SETTING_OUT_S {
        0.5 * PACE_M_S * seconds * seconds / SETTING_OUT_S
    } else {
        PACE_M_S * (seconds - 0.5 * SETTING_OUT_S)
    }
}

fn swayed([way, pulse, phase]: [f64; 3], t: f64) -> f64 {
    way * (pulse * t + phase).sin()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    fn mission(case: Case) -> Mission {
        Mission::new(Fleet::new(48, 4).unwrap(), case, 1)
    }

    #[test]
    fn no_robot_leaps() {
        for case in Case::ALL {
            let mission = mission(case);
            let mut before = mission.places(0.0);
            for step in 1..=(10.0 * case.lasts_s()) as usize {
                let now = mission.places(step as f64 / 10.0);
                for (from, to) in before.iter().zip(&now) {
                    let metres = (from[0] - to[0]).hypot(from[1] - to[1]);
                    assert!(metres < 0.1 * (PACE_M_S + 2.0), "{case} {step}: {metres}");
                }
                before = now;
            }
        }
    }

    #[test]
    fn orders_change_with_the_truth() {
        let mission = mission(Case::Regroup);
        let head = mission.fleet.head;
        assert_eq!(mission.team(head, CHANGE_S - 0.1), Some(SPLITS));
        assert_eq!(mission.team(head, CHANGE_S), Some(4));
        assert_eq!(mission.superior(head, CHANGE_S), Some(0));
        let joins = mission.fleet.leaders[JOINS];
        assert_eq!(mission.team(joins, CHANGE_S), Some(JOINED));
        assert_eq!(mission.superior(joins, CHANGE_S), Some(mission.fleet.leaders[JOINED]));
        assert_eq!(mission.team(joins, BACK_S), Some(JOINS));
        assert_eq!((mission.moves(head), mission.moves(joins), mission.moves(0)), (2, 2, 0));
    }

    #[test]
    fn no_robot_answers_to_a_silent_one() {
        let mission = mission(Case::Losses);
        let silent = (0..48).filter(|robot| mission.is_silent(*robot, SILENT_FROM_S)).count();
        assert!(silent > 0);
        for robot in (0..48).filter(|robot| !mission.is_silent(*robot, SILENT_FROM_S)) {
            let superior = mission.superior(robot, SILENT_FROM_S);
            assert!(superior.is_none_or(|s| s != robot && !mission.is_silent(s, SILENT_FROM_S)));
        }
    }
}
