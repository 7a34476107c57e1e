//! The formations of Scenario I: squads and platoons as doctrine has them (FM 3-21.8, chapter 3), with noise
//! of the march.

use std::fmt;

use muster_scenario::FileError;
use muster_scenario::Layout;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::system::System;

/// The files of all formations.
pub const FILES: [(&str, &str); 6] = [
    ("squad-column", include_str!("../formations/squad-column.json")),
    ("squad-file", include_str!("../formations/squad-file.json")),
    ("squad-line", include_str!("../formations/squad-line.json")),
    ("platoon-column", include_str!("../formations/platoon-column.json")),
    ("platoon-wedge", include_str!("../formations/platoon-wedge.json")),
    ("platoon-vee", include_str!("../formations/platoon-vee.json")),
];

/// Between which robots there are links.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Radio {
    /// All within [`RANGE_M`], the better the nearer.
    Range,
    /// All of the same radio net, equally well, wherever they are.
    Net,
}

impl Radio {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Range, Self::Net];
}

impl fmt::Display for Radio {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(match self {
            Self::Range => "range",
            Self::Net => "net",
        })
    }
}

/// Radio range in metres: a hand-held radio among obstacles, less than the length of a squad in column.
pub const RANGE_M: f64 = 40.0;

/// By which factor a formation may be drawn out or pulled together.
const SPACING: (f64, f64) = (0.8, 1.25);

/// By how much a robot is off its place, in metres along each axis: on a march, ten metres between robots
/// vary by at most so much.
const JITTER_M: f64 = 2.0;

/// A formation of the list, by its place in it.
#[derive(Debug, Clone)]
pub struct Formation {
    /// Its name.
    pub name: &'static str,
    /// The content of its file.
    pub layout: Layout,
}

impl Formation {
    /// All of them.
    ///
    /// # Errors
    /// If a file is none.
    pub fn all() -> Result<Vec<Self>, FileError> {
        let read = |(name, text): (&'static str, &str)| {
            Layout::read(text).map(|layout| Self { name, layout })
        };
        FILES.into_iter().map(read).collect()
    }

    /// Whether it is a platoon.
    #[must_use]
    pub fn is_platoon(&self) -> bool {
        self.name.starts_with("platoon")
    }

    /// The formation as its file has it.
    #[must_use]
    pub fn drawn(&self, radio: Radio) -> System {
        self.system(self.layout.places.clone(), radio)
    }

    /// The formation on the march: drawn out or pulled together, and every robot a little off its place.
    #[must_use]
    pub fn marching(&self, radio: Radio, seed: u64) -> System {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let spacing = SPACING.0 * (SPACING.1 / SPACING.0).powf(chance.random::<f64>());
        let mut off = || JITTER_M * (2.0 * chance.random::<f64>() - 1.0);
        let places = self.layout.places.iter().map(|at| at.map(|metres| spacing * metres + off()));
        self.system(places.collect(), radio)
    }

    fn system(&self, positions: Vec<[f64; 2]>, radio: Radio) -> System {
        let links = match radio {
            Radio::Range => in_range(&positions),
            Radio::Net => in_nets(positions.len(), &self.layout.nets),
        };
        let superiors = self.layout.superiors.iter().map(|superior| superior.map(|s| s as u32));
        System { positions, links, superiors: superiors.collect(), measured: None }
    }
}

fn in_range(positions: &[[f64; 2]]) -> Vec<Vec<(u32, f64)>> {
    let of_robot = |(i, at): (usize, &[f64; 2])| {
        let others = (0..).zip(positions).filter(|(j, _)| *j as usize != i);
        let links = others.map(|(j, from)| {
            let share = (at[0] - from[0]).hypot(at[1] - from[1]) / RANGE_M;
            (j, 1.0 - share * share)
        });
        links.filter(|(_, quality)| *quality > 0.0).collect()
    };
    positions.iter().enumerate().map(of_robot).collect()
}

fn in_nets(robots: usize, nets: &[Vec<usize>]) -> Vec<Vec<(u32, f64)>> {
    let mut peers = vec![Vec::new(); robots];
    for net in nets {
        for &robot in net {
            peers[robot].extend(net.iter().filter(|peer| **peer != robot).map(|p| *p as u32));
        }
    }
    // Two leaders may be on two nets together.
    let links = peers.into_iter().map(|mut peers: Vec<u32>| {
        peers.sort_unstable();
        peers.dedup();
        peers.into_iter().map(|peer| (peer, 1.0)).collect()
    });
    links.collect()
}
