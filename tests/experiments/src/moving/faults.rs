//! What is wrong with one kind of reports.

use std::fmt;

use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

/// What robots report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Sense {
    /// Where they are.
    Spatial,
    /// Their incoming links.
    Connectivity,
    /// Their superiors.
    Hierarchy,
}

impl Sense {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Spatial, Self::Connectivity, Self::Hierarchy];
}

impl fmt::Display for Sense {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(match self {
            Self::Spatial => "spatial",
            Self::Connectivity => "connectivity",
            Self::Hierarchy => "hierarchy",
        })
    }
}

/// How reports are wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// No robot reports.
    Lost,
    /// Every robot reports what is true of another robot, always the same one.
    Wrong,
    /// Every robot reports what was true [`LATE_S`] seconds before.
    Delayed,
}

/// How late delayed reports are, in seconds.
pub const LATE_S: f64 = 2.0;

impl Fault {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Lost, Self::Wrong, Self::Delayed];
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(match self {
            Self::Lost => "lost",
            Self::Wrong => "wrong",
            Self::Delayed => "delayed",
        })
    }
}

/// Which robot reports what is true of which.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    /// By the robot that reports: the robot whose state it reports.
    pub of: Vec<usize>,
    /// By the robot that is meant: the robot that is named.
    pub named: Vec<usize>,
}

impl Mask {
    /// Every robot reports its own state.
    #[must_use]
    pub fn none(robots: usize) -> Self {
        Self { of: (0..robots).collect(), named: (0..robots).collect() }
    }

    /// Every robot reports the state of a random one, and all names fit: the graph keeps its form and belongs to
    /// other robots.
    #[must_use]
    pub fn shuffled(robots: usize, chance: &mut ChaCha8Rng) -> Self {
        let mut of: Vec<usize> = (0..robots).collect();
        of.shuffle(chance);
        let mut named = vec![0; robots];
        for (reports, meant) in of.iter().enumerate() {
            named[*meant] = reports;
        }
        Self { of, named }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn names_match_the_robots_that_report() {
        let mask = Mask::shuffled(20, &mut ChaCha8Rng::seed_from_u64(3));
        assert!((0..20).all(|robot| mask.named[mask.of[robot]] == robot));
        assert_ne!(mask, Mask::none(20));
    }
}
