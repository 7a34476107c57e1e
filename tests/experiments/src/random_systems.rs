//! Random systems: those of Scenario II, whose right division is unknown, and planted fleets, whose division is
//! known.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::system::System;

/// Radio range in Scenario II along a free line of sight, in metres.
const SIGHT_M: f64 = 40.0;

/// Area for each robot of Scenario II, in square metres: a campus on which neighbours are some twenty metres
/// from each other.
const AREA_M2: f64 = 400.0;

/// Buildings of a campus for each robot, and the least and the greatest length of their walls in metres.
const BUILDINGS: f64 = 0.2;
const WALL_M: (f64, f64) = (8.0, 30.0);

/// Tries to place a robot outside of all buildings. After more there is probably no such place.
const MAX_ATTEMPTS: usize = 1000;

/// Robots of a planted team.
const TEAM_ROBOTS: (usize, usize) = (4, 10);

/// Standard deviation of a planted team's robots about its middle, along each axis in metres.
const SPREAD_M: f64 = 10.0;

/// Least distance of two middles, in spreads: some robots of neighbouring teams are nearer to each other
/// than to their own.
const MIN_SEPARATION_SPREADS: f64 = 4.0;

/// Radio range in a planted fleet, in metres.
const RADIO_RANGE_M: f64 = 40.0;

/// A building: its south-west and north-east corner.
type Building = [[f64; 2]; 2];

fn within(building: &Building, at: [f64; 2]) -> bool {
    (0..2).all(|axis| (building[0][axis]..=building[1][axis]).contains(&at[axis]))
}

/// Whether the line between two places crosses a building: the part of the line that is between both pairs of
/// walls is not empty (Liang and Barsky, ACM Transactions on Graphics 3, 1984).
fn blocks(building: &Building, from: [f64; 2], to: [f64; 2]) -> bool {
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    for axis in 0..2 {
        let step = to[axis] - from[axis];
        let walls = [building[0][axis] - from[axis], building[1][axis] - from[axis]];
        if step == 0.0 {
            if walls[0] > 0.0 || walls[1] < 0.0 {
                return false;
            }
            continue;
        }
        let (enters, leaves) = (walls[0] / step, walls[1] / step);
        first = first.max(enters.min(leaves));
        last = last.min(enters.max(leaves));
    }
    first <= last
}

/// A random system of Scenario II: robots anywhere on a campus, links by line of sight, and a hierarchy in which
/// robots near the middle command those at the edge.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "there are a few dozen robots")]
pub fn campus(robots: usize, seed: u64) -> System {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let side = (AREA_M2 * robots as f64).sqrt();
    let buildings: Vec<Building> = (0..(BUILDINGS * robots as f64).ceil() as usize)
        .map(|_| {
            let corner = [(); 2].map(|()| side * chance.random::<f64>());
            let wall = |share: f64| WALL_M.0 + (WALL_M.1 - WALL_M.0) * share;
            [corner, corner.map(|metres| metres + wall(chance.random::<f64>()))]
        })
        .collect();
    let mut place = || {
        let mut at = [0.0; 2];
        for _ in 0..MAX_ATTEMPTS {
            at = [(); 2].map(|()| side * chance.random::<f64>());
            if !buildings.iter().any(|building| within(building, at)) {
                break;
            }
        }
        at
    };
    let positions: Vec<[f64; 2]> = (0..robots).map(|_| place()).collect();
    let sees = |from, to| !buildings.iter().any(|building| blocks(building, from, to));
    let links = links_in_range(&positions, SIGHT_M, sees);
    let superiors = by_centrality(&positions);
    System { positions, links, superiors, measured: None }
}

/// The superior of each robot: the nearest of those nearer to the middle than itself.
#[expect(clippy::cast_precision_loss, reason = "there are a few dozen robots")]
fn by_centrality(positions: &[[f64; 2]]) -> Vec<Option<u32>> {
    let count = positions.len().max(1) as f64;
    let middle = [0, 1].map(|axis| positions.iter().map(|at| at[axis]).sum::<f64>() / count);
    let off = |at: &[f64; 2]| metres(*at, middle);
    let superior = |at: &[f64; 2]| {
        let above = (0..).zip(positions).filter(|(_, other)| off(other) < off(at));
        let nearest = above.min_by(|l, r| metres(*at, *l.1).total_cmp(&metres(*at, *r.1)));
        nearest.map(|(robot, _)| robot)
    };
    positions.iter().map(superior).collect()
}

fn metres(from: [f64; 2], to: [f64; 2]) -> f64 {
    (from[0] - to[0]).hypot(from[1] - to[1])
}

fn links_in_range(
    positions: &[[f64; 2]],
    range_m: f64,
    sees: impl Fn([f64; 2], [f64; 2]) -> bool,
) -> Vec<Vec<(u32, f64)>> {
    let of_robot = |(i, at): (u32, &[f64; 2])| {
        let others = (0..).zip(positions).filter(move |(j, _)| *j != i);
        let links = others.filter_map(|(j, from)| {
            let share = metres(*at, *from) / range_m;
            (share < 1.0 && sees(*at, *from)).then_some((j, 1.0 - share * share))
        });
        links.collect()
    };
    (0..).zip(positions).map(of_robot).collect()
}

/// Distance between teams of [`plain_to_see`], in metres.
const FAR_M: f64 = 90.0;

/// A planted fleet and the team of each robot: teams scattered about their middles, whose members answer to a
/// leader each and whose leaders answer to the first leader.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "there are a few teams")]
pub fn planted(teams: usize, seed: u64) -> (System, Vec<Option<usize>>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let side = MIN_SEPARATION_SPREADS * SPREAD_M * (2.0 * teams as f64).sqrt();
    let mut middles: Vec<[f64; 2]> = Vec::new();
    while middles.len() < teams {
        // The last try counts: a fleet may be crowded.
        let mut at = [0.0; 2];
        for _ in 0..MAX_ATTEMPTS {
            at = [(); 2].map(|()| side * chance.random::<f64>());
            if middles.iter().all(|other| metres(at, *other) >= MIN_SEPARATION_SPREADS * SPREAD_M) {
                break;
            }
        }
        middles.push(at);
    }
    let (mut system, mut truth) = (System::default(), Vec::new());
    for (team, middle) in middles.iter().enumerate() {
        let leader = system.positions.len() as u32;
        for member in 0..chance.random_range(TEAM_ROBOTS.0..=TEAM_ROBOTS.1) {
            // Of both coordinates at once (Box and Muller 1958).
            let (radius, turn) = (chance.random::<f64>(), chance.random::<f64>());
            let radius = SPREAD_M * (-2.0 * (1.0 - radius).ln()).sqrt();
            let (sin, cos) = (std::f64::consts::TAU * turn).sin_cos();
            system.positions.push([middle[0] + radius * cos, middle[1] + radius * sin]);
            let above = if member > 0 { Some(leader) } else { (team > 0).then_some(0) };
            system.superiors.push(above);
            truth.push(Some(team));
        }
    }
    system.links = links_in_range(&system.positions, RADIO_RANGE_M, |_, _| true);
    (system, truth)
}

/// Which of a fleet's relations are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Known {
    /// Where robots are.
    pub positions: bool,
    /// Their incoming links.
    pub links: bool,
    /// Their superiors.
    pub ranks: bool,
}

impl Known {
    /// Every choice of some of them.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let bit = |bits: u8, at: u8| bits >> at & 1 == 1;
        (1..8)
            .map(|bits| Self { positions: bit(bits, 0), links: bit(bits, 1), ranks: bit(bits, 2) })
            .collect()
    }
}

/// A fleet with one obvious division, and the team of each robot: teams of `size` whose robots are a few metres
/// apart and [`FAR_M`] from the next team, have links within their team alone, and answer to the first of it.
/// Positions that are not known are NaN.
#[must_use]
pub fn plain_to_see(
    teams: usize,
    size: usize,
    known: Known,
    seed: u64,
) -> (System, Vec<Option<usize>>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let (mut system, mut truth) = (System::default(), Vec::new());
    for team in 0..teams {
        let first = (team * size) as u32;
        let members = first..first + size as u32;
        for robot in members.clone() {
            let jitter = [(); 2].map(|()| chance.random_range(-1.0..1.0));
            let place =
                [f64::from(robot - first) * 3.0 + jitter[0], team as f64 * FAR_M + jitter[1]];
            system.positions.push(if known.positions { place } else { [f64::NAN; 2] });
            let peers = members.clone().filter(|peer| *peer != robot);
            let mut links: Vec<_> =
                peers.map(|peer| (peer, chance.random_range(0.5..1.0))).collect();
            links.retain(|_| known.links);
            system.links.push(links);
            system.superiors.push((known.ranks && robot != first).then_some(first));
            truth.push(Some(team));
        }
    }
    (system, truth)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_block_what_crosses_them() {
        let building = [[0.0, 0.0], [2.0, 1.0]];
        assert!(blocks(&building, [-1.0, 0.5], [3.0, 0.5]));
        assert!(blocks(&building, [-1.0, -1.0], [3.0, 2.0]));
        assert!(!blocks(&building, [-1.0, 2.0], [3.0, 2.0]));
        assert!(!blocks(&building, [-1.0, 0.5], [-0.5, 0.5]));
        assert!(!blocks(&building, [0.0, 3.0], [4.0, 0.5]));
    }

    #[test]
    fn a_campus_has_robots_outside_of_buildings_links_in_sight_and_one_at_the_top() {
        for seed in 0..20 {
            let system = campus(50, seed);
            assert_eq!(system.robots(), 50);
            assert_eq!(system.superiors.iter().filter(|superior| superior.is_none()).count(), 1);
            for (robot, links) in system.links.iter().enumerate() {
                for &(peer, quality) in links {
                    assert!(quality > 0.0 && quality <= 1.0);
                    let back = &system.links[peer as usize];
                    assert!(back.iter().any(|(other, _)| *other as usize == robot));
                }
            }
            assert_eq!(system, campus(50, seed));
        }
    }

    #[test]
    fn planted_teams_are_complete() {
        for teams in 2..=6 {
            let (system, truth) = planted(teams, 3);
            assert_eq!(system.robots(), truth.len());
            for team in 0..teams {
                let members = truth.iter().filter(|of| **of == Some(team)).count();
                assert!((TEAM_ROBOTS.0..=TEAM_ROBOTS.1).contains(&members));
            }
            assert_eq!(system.superiors.iter().filter(|superior| superior.is_none()).count(), 1);
        }
    }
}
