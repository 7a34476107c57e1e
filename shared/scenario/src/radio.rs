//! Which robots receive which.

use std::cmp::Ordering;
use std::collections::HashMap;

use muster_model::limits::MAX_LINKS;

use crate::formation::Point;
use crate::noise::{Purpose, between, chance};

/// By how much an antenna may differ from the average one, as a factor on the range.
const GAIN: (f64, f64) = (0.9, 1.1);

/// A robot that is received worse than this is not reported: its messages do not arrive.
const FLOOR: f64 = 0.05;

/// One antenna, as factors on the range.
#[derive(Debug, Clone, Copy)]
struct Antenna {
    sends: f64,
    gain_in: f64,
}

/// The radios of a fleet.
#[derive(Debug, Clone)]
pub(crate) struct Radio {
    range_m: f64,
    antennas: Vec<Antenna>,
}

impl Radio {
    /// Radios with a range of about `range_m` metres.
    pub(crate) fn new(robots: usize, range_m: f64, seed: u64) -> Self {
        let mut chance = chance(seed, Purpose::Radio, 0.0);
        let mut gain = || between(&mut chance, GAIN.0, GAIN.1);
        let antennas = (0..robots).map(|_| Antenna { sends: gain(), gain_in: gain() }).collect();
        Self { range_m, antennas }
    }

    /// For each robot the robots that it receives, by index, with the quality of the link from 0 to 1;
    /// the best [`MAX_LINKS`] where there are more. Positions are in metres.
    pub(crate) fn received(&self, positions: &[Point]) -> Vec<Vec<(usize, f64)>> {
        // No robot is received beyond one cell, so that a cell and those around it contain all senders.
        let cell_m = self.range_m * GAIN.1 * GAIN.1;
        let cell = |at: &Point| at.map(|metres| (metres / cell_m).floor() as i64);
        let mut cells: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
        for (robot, at) in positions.iter().enumerate() {
            cells.entry(cell(at)).or_default().push(robot);
        }
        let received = |(robot, (at, antenna)): (usize, (&Point, &Antenna))| {
            let [x, y] = cell(at);
            let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x + dx, y + dy]));
            let peers = around.filter_map(|cell| cells.get(&cell)).flatten();
            let links = peers.filter(|&&peer| peer != robot).filter_map(|&peer| {
                let (place, sender) = (positions.get(peer)?, self.antennas.get(peer)?);
                let reach_m = self.range_m * sender.sends * antenna.gain_in;
                let quality = quality((at[0] - place[0]).hypot(at[1] - place[1]) / reach_m);
                (quality >= FLOOR).then_some((peer, quality))
            });
            strongest(links.collect())
        };
        positions.iter().zip(&self.antennas).enumerate().map(received).collect()
    }
}

/// Quality at a distance in units of the range: 1 at 0, falling smoothly to 0 at the range.
fn quality(distance: f64) -> f64 {
    let distance = distance.min(1.0);
    1.0 - distance * distance * (3.0 - 2.0 * distance)
}

/// The best links, ordered by peer.
fn strongest(mut links: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    if links.len() > MAX_LINKS {
        let best_first = |l: &(usize, f64), r: &(usize, f64)| -> Ordering {
            r.1.total_cmp(&l.1).then(l.0.cmp(&r.0))
        };
        links.select_nth_unstable_by(MAX_LINKS, best_first);
        links.truncate(MAX_LINKS);
    }
    links.sort_unstable_by_key(|&(peer, _)| peer);
    links
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_a_row(count: usize, spacing_m: f64) -> Vec<Point> {
        (0..count).map(|robot| [robot as f64 * spacing_m - 100.0, 50.0]).collect()
    }

    #[test]
    fn quality_falls_with_distance_to_nothing() {
        let steps: Vec<f64> = (0..=20).map(|step| quality(f64::from(step) / 10.0)).collect();
        assert_eq!((steps[0], steps[5], steps[10], steps[20]), (1.0, 0.5, 0.0, 0.0));
        assert!(steps.is_sorted_by(|near, far| near >= far));
    }

    #[test]
    fn the_grid_finds_every_sender_in_range() {
        let positions = in_a_row(60, 7.3);
        let radio = Radio::new(60, 40.0, 3);
        for (robot, links) in radio.received(&positions).iter().enumerate() {
            let expected: Vec<usize> = (0..60)
                .filter(|&peer| {
                    let reach = 40.0 * radio.antennas[peer].sends * radio.antennas[robot].gain_in;
                    let metres = (positions[peer][0] - positions[robot][0]).abs();
                    peer != robot && quality(metres / reach) >= FLOOR
                })
                .collect();
            assert_eq!(links.iter().map(|link| link.0).collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn links_are_directed() {
        let links = Radio::new(2, 40.0, 3).received(&in_a_row(2, 20.0));
        assert_ne!(links[0][0].1, links[1][0].1);
    }

    #[test]
    fn a_crowd_keeps_its_strongest_links() {
        let positions = in_a_row(1300, 0.01);
        let links = Radio::new(1300, 40.0, 3).received(&positions);
        assert!(links.iter().all(|links| links.len() == MAX_LINKS));
        assert!(links.iter().all(|links| links.is_sorted_by_key(|link| link.0)));
    }

    #[test]
    fn no_robot_receives_itself_and_a_lost_robot_receives_none() {
        let links = Radio::new(3, 40.0, 3).received(&[[0.0; 2], [0.0; 2], [4e7, -4e7]]);
        assert_eq!(links, [vec![(1, 1.0)], vec![(0, 1.0)], vec![]]);
    }
}
