//! Which fleet is wanted, and what makes none.

use std::fmt;
use std::str::FromStr;

use muster_model::id::IdError;
use muster_model::limits::{MAX_ROBOTS, MAX_TEAMS};

/// Most noise of positions in metres: beyond it nothing of a formation is left.
const MAX_NOISE_M: f64 = 1000.0;

/// Shortest radio range in metres: a whisper.
const LEAST_RANGE_M: f64 = 0.1;

/// Longest radio range in metres: a satellite's horizon.
const MOST_RANGE_M: f64 = 1.0e6;

/// What a fleet does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ScenarioKind {
    /// Platoons march side by side and part at a crossing, where one squad is handed over to another
    /// platoon; later all rejoin and the squad returns. Repeats every minute.
    Crossing,
    /// Groups far from each other that stand still.
    Clusters,
    /// Robots that wander about on their own.
    Random,
}

impl ScenarioKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Crossing, Self::Clusters, Self::Random];

    /// The name as it stands on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Crossing => "crossing",
            Self::Clusters => "clusters",
            Self::Random => "random",
        }
    }
}

impl fmt::Display for ScenarioKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.as_str())
    }
}

impl FromStr for ScenarioKind {
    type Err = ScenarioError;

    fn from_str(text: &str) -> Result<Self, ScenarioError> {
        let mut kinds = Self::ALL.into_iter();
        kinds.find(|kind| kind.as_str() == text).ok_or_else(|| ScenarioError::Kind(text.to_owned()))
    }
}

/// How large a fleet is, and how noisy.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetOptions {
    /// How many robots there are.
    pub robots: usize,
    /// How many teams they truly form: platoons that march, groups that stand, or command units that
    /// wander.
    pub teams: usize,
    /// What all choices follow from.
    pub seed: u64,
    /// Standard deviation of the noise of positions, in metres along each axis.
    pub noise_m: f64,
    /// The range of a robot with an average antenna, in metres.
    pub radio_range_m: f64,
}

impl Default for FleetOptions {
    /// Two platoons of nine.
    fn default() -> Self {
        Self { robots: 18, teams: 2, seed: 1, noise_m: 0.15, radio_range_m: 40.0 }
    }
}

/// Why there is no such fleet.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScenarioError {
    /// The name is that of no scenario.
    #[error("no scenario is called {0:?}; there are crossing, clusters, random")]
    Kind(String),
    /// The scenario has fewer teams than it needs.
    #[error("teams: {kind} needs {least} to {MAX_TEAMS}, not {teams}")]
    Teams {
        /// The scenario.
        kind: ScenarioKind,
        /// How many were asked for.
        teams: usize,
        /// How many it needs.
        least: usize,
    },
    /// A scenario without enough robots for its teams, or with more than a fleet may have.
    #[error("robots: {kind} with {teams} teams needs {least} to {MAX_ROBOTS}, not {robots}")]
    Robots {
        /// The scenario.
        kind: ScenarioKind,
        /// How many teams were asked for.
        teams: usize,
        /// How many robots were asked for.
        robots: usize,
        /// How many it needs.
        least: usize,
    },
    /// A deviation that is none.
    #[error("noise_m: must be 0 to {MAX_NOISE_M} metres, not {0}")]
    Noise(f64),
    /// A range that is none.
    #[error("radio_range_m: must be {LEAST_RANGE_M} to {MOST_RANGE_M} metres, not {0}")]
    RadioRange(f64),
    /// A robot got a name that is no id.
    #[error(transparent)]
    Id(#[from] IdError),
}

impl FleetOptions {
    /// Checks that the options make a fleet of some kind.
    ///
    /// # Errors
    /// Names the first option that is wrong, and what it may be.
    pub fn check(&self, kind: ScenarioKind) -> Result<(), ScenarioError> {
        let &Self { robots, teams, .. } = self;
        let least_teams = match kind {
            // One platoon cannot part.
            ScenarioKind::Crossing => 2,
            ScenarioKind::Clusters | ScenarioKind::Random => 1,
        };
        if !(least_teams..=MAX_TEAMS as usize).contains(&teams) {
            return Err(ScenarioError::Teams { kind, teams, least: least_teams });
        }
        let least = match kind {
            // Each platoon has a leader and a squad of at least one.
            ScenarioKind::Crossing => 2 * teams,
            ScenarioKind::Clusters | ScenarioKind::Random => teams.max(2),
        };
        if !(least..=MAX_ROBOTS).contains(&robots) {
            return Err(ScenarioError::Robots { kind, teams, robots, least });
        }
        self.check_senses()
    }

    /// Checks what does not depend on the kind.
    pub(crate) fn check_senses(&self) -> Result<(), ScenarioError> {
        let &Self { noise_m, radio_range_m, .. } = self;
        if !(0.0..=MAX_NOISE_M).contains(&noise_m) {
            return Err(ScenarioError::Noise(noise_m));
        }
        if !(LEAST_RANGE_M..=MOST_RANGE_M).contains(&radio_range_m) {
            return Err(ScenarioError::RadioRange(radio_range_m));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_to_their_kinds_and_back() {
        for kind in ScenarioKind::ALL {
            assert_eq!(kind.to_string().parse(), Ok(kind));
        }
        let error = "parade".parse::<ScenarioKind>().unwrap_err().to_string();
        assert!(ScenarioKind::ALL.iter().all(|kind| error.contains(kind.as_str())), "{error}");
    }

    #[test]
    fn what_makes_no_fleet_is_named_with_what_would() {
        let problem = |kind, change: fn(&mut FleetOptions)| {
            let mut options = FleetOptions::default();
            change(&mut options);
            options.check(kind).unwrap_err().to_string()
        };
        use ScenarioKind::{Clusters, Crossing, Random};
        let robots = "robots: crossing with 2 teams needs 4 to 100000, not 3";
        assert_eq!(problem(Crossing, |options| options.robots = 3), robots);
        let robots = "robots: random with 1 teams needs 2 to 100000, not 0";
        assert_eq!(problem(Random, |options| (options.robots, options.teams) = (0, 1)), robots);
        assert!(problem(Clusters, |options| options.robots = MAX_ROBOTS + 1).contains("100001"));
        assert!(problem(Clusters, |options| options.teams = 19).contains("needs 19"));
        let teams = "teams: crossing needs 2 to 1024, not 1";
        assert_eq!(problem(Crossing, |options| options.teams = 1), teams);
        assert!(problem(Random, |options| options.teams = usize::MAX).starts_with("teams"));
        assert!(problem(Random, |options| options.noise_m = f64::NAN).starts_with("noise_m"));
        let range = "radio_range_m: must be 0.1 to 1000000 metres, not 0";
        assert_eq!(problem(Random, |options| options.radio_range_m = 0.0), range);
    }
}
