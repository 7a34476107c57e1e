//! The radio links of a fleet that moves.

use std::collections::HashMap;

use muster_model::limits::MAX_LINKS;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::mission::Mission;
use crate::formations::Radio;

/// Radio range in metres.
const RANGE_M: f64 = 40.0;

/// Quality of all links of a net.
const NET_QUALITY: f64 = 0.9;

/// Greatest error of a reported quality.
const MAX_QUALITY_ERROR: f64 = 0.1;

/// Links of less quality than this are not reported.
const MIN_QUALITY: f64 = 0.05;

/// The fleet on the air at one moment.
#[derive(Debug)]
pub struct Air<'a> {
    mission: &'a Mission,
    radio: Radio,
    t: f64,
    places: &'a [[f64; 2]],
    /// Robots by cell of one range, or by net.
    cells: HashMap<[i64; 2], Vec<usize>>,
    /// By robot, for nets: its superior, and whether that one is of its team.
    commands: Vec<Option<(usize, bool)>>,
}

impl<'a> Air<'a> {
    /// The air at a moment, with the places of all robots.
    #[must_use]
    pub fn new(mission: &'a Mission, radio: Radio, t: f64, places: &'a [[f64; 2]]) -> Self {
        let mut cells: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
        let mut commands = Vec::new();
        if radio == Radio::Net {
            commands = (0..places.len()).map(|robot| command(mission, robot, t)).collect();
        }
        for (robot, at) in places.iter().enumerate() {
            let key = match radio {
                Radio::Range => Some(cell(*at)),
                Radio::Net => commands[robot].map(net),
            };
            if let Some(key) = key {
                cells.entry(key).or_default().push(robot);
            }
        }
        Self { mission, radio, t, places, cells, commands }
    }

    /// The incoming links of a robot: peer and quality; the best [`MAX_LINKS`] at most.
    pub fn links(&self, robot: usize, chance: &mut ChaCha8Rng) -> Vec<(usize, f64)> {
        if self.mission.is_deaf(robot, self.t) {
            return Vec::new();
        }
        let peers = match self.radio {
            Radio::Range => self.in_range(robot),
            Radio::Net => self.in_nets(robot),
        };
        let mut links: Vec<(usize, f64)> = peers
            .into_iter()
            .filter(|(peer, _)| !self.mission.is_deaf(*peer, self.t))
            .map(|(peer, quality)| {
                let error = MAX_QUALITY_ERROR * (2.0 * chance.random::<f64>() - 1.0);
                (peer, (quality + error).min(1.0))
            })
            .filter(|(_, quality)| *quality >= MIN_QUALITY)
            .collect();
        links.sort_unstable_by(|left, right| right.1.total_cmp(&left.1).then(left.0.cmp(&right.0)));
        links.truncate(MAX_LINKS);
        links
    }

    /// Quality falls with the square of the distance.
    fn in_range(&self, robot: usize) -> Vec<(usize, f64)> {
        let at = self.places[robot];
        let [x, y] = cell(at);
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x + dx, y + dy]));
        let peers = around.filter_map(|cell| self.cells.get(&cell)).flatten();
        let links = peers.filter(|peer| **peer != robot).map(|peer| {
            let from = self.places[*peer];
            let share = (at[0] - from[0]).hypot(at[1] - from[1]) / RANGE_M;
            (*peer, 1.0 - share * share)
        });
        links.filter(|(_, quality)| *quality > 0.0).collect()
    }

    /// A superior and its subordinates in its own team share a net, and so do a superior and its subordinates in
    /// other teams.
    fn in_nets(&self, robot: usize) -> Vec<(usize, f64)> {
        let of = |command| self.cells.get(&net(command)).into_iter().flatten();
        let above = self.commands[robot];
        let peers = above.into_iter().flat_map(of).filter(|peer| **peer != robot);
        let below = [true, false].into_iter().flat_map(|within| of((robot, within)));
        let superior = above.map(|(superior, _)| superior);
        superior
            .into_iter()
            .chain(peers.copied())
            .chain(below.copied())
            .map(|peer| (peer, NET_QUALITY))
            .collect()
    }
}

/// The superior of a robot, and whether that one is of its team.
fn command(mission: &Mission, robot: usize, t: f64) -> Option<(usize, bool)> {
    let superior = mission.superior(robot, t)?;
    Some((superior, mission.team(robot, t) == mission.team(superior, t)))
}

fn cell(at: [f64; 2]) -> [i64; 2] {
    at.map(|metres| (metres / RANGE_M).floor() as i64)
}

/// The net of a superior's subordinates, within its team or not, as a cell.
fn net((superior, within): (usize, bool)) -> [i64; 2] {
    [superior as i64, i64::from(within)]
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::moving::fleet::Fleet;
    use crate::moving::mission::Case;

    fn peers(radio: Radio, robot: usize, t: f64) -> Vec<usize> {
        let mission = Mission::new(Fleet::new(48, 4).unwrap(), Case::Losses, 1);
        let places = mission.places(t);
        let air = Air::new(&mission, radio, t, &places);
        let links = air.links(robot, &mut ChaCha8Rng::seed_from_u64(1));
        let mut peers: Vec<usize> = links.into_iter().map(|link| link.0).collect();
        peers.sort_unstable();
        peers
    }

    #[test]
    fn a_leader_is_in_two_nets_and_a_member_in_one() {
        // Leaders of teams are 0, 12, 24, 36; those of the first squads 1 and 7.
        assert_eq!(peers(Radio::Net, 0, 0.0), [1, 7, 12, 24, 36]);
        assert_eq!(peers(Radio::Net, 1, 0.0), [0, 2, 3, 4, 5, 6, 7]);
        assert_eq!(peers(Radio::Net, 3, 0.0), [1, 2, 4, 5, 6]);
    }

    #[test]
    fn near_robots_have_links_and_silent_ones_have_none() {
        let before = peers(Radio::Range, 5, 0.0);
        assert!(before.len() > 10 && before.len() < 47);
        assert!(peers(Radio::Range, 5, 20.0).len() < before.len());
    }
}
