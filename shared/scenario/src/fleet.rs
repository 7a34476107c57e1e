//! A fleet at any moment.

use std::sync::Arc;

use muster_model::id::RobotId;
use muster_model::observation::{Link, Links, Pose, Rank};

use crate::clusters::Clusters;
use crate::crossing::Crossing;
use crate::file::{Layout, March};
use crate::formation::{Formation, Place};
use crate::noise::{Purpose, chance, normal_pair};
use crate::options::{FleetOptions, ScenarioError, ScenarioKind};
use crate::radio::Radio;
use crate::random::Random;

/// The frame of all positions.
const FRAME: &str = "map";

/// The reports of one robot at one moment. Stamps, boot ids and sequence numbers are for the sender to fill
/// in.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotObservation {
    /// The robot.
    pub robot: RobotId,
    /// Where it is.
    pub pose: Pose,
    /// Which robots it receives.
    pub links: Links,
    /// Its superior.
    pub rank: Rank,
}

/// A simulated fleet. All lists have one entry per robot, in the order of [`Fleet::robots`].
///
/// Moments are seconds from the beginning, and may be negative or large; one that is not finite is
/// taken as 0. The same moment always gives the same answers.
#[derive(Debug, Clone)]
pub struct Fleet {
    options: FleetOptions,
    robots: Vec<RobotId>,
    formation: Arc<dyn Formation>,
    radio: Arc<Radio>,
}

impl Fleet {
    /// Makes a fleet.
    ///
    /// # Errors
    /// Names the first option that makes no fleet, and what it may be.
    pub fn new(kind: ScenarioKind, options: FleetOptions) -> Result<Self, ScenarioError> {
        options.check(kind)?;
        let formation: Arc<dyn Formation> = match kind {
            ScenarioKind::Crossing => Arc::new(Crossing::new(&options)?),
            ScenarioKind::Clusters => Arc::new(Clusters::new(&options)?),
            ScenarioKind::Random => Arc::new(Random::new(&options)?),
        };
        Ok(Self::of(formation, options))
    }

    /// Makes the fleet of a file. The options set how noisy it is, how far its radios reach, and what chance
    /// follows from; robots and teams are those of the file.
    ///
    /// # Errors
    /// Names the first option that is wrong, and what it may be.
    pub fn of_layout(layout: &Layout, options: FleetOptions) -> Result<Self, ScenarioError> {
        options.check_senses()?;
        let formation: Arc<dyn Formation> = Arc::new(March::new(layout));
        Ok(Self::of(formation, FleetOptions { robots: layout.robots.len(), ..options }))
    }

    fn of(formation: Arc<dyn Formation>, options: FleetOptions) -> Self {
        let robots = formation.members().iter().map(|member| member.id.clone()).collect();
        let radio = Arc::new(Radio::new(options.robots, options.radio_range_m, options.seed));
        Self { options, robots, formation, radio }
    }

    /// The robots; their number is that of the options.
    #[must_use]
    pub fn robots(&self) -> &[RobotId] {
        &self.robots
    }

    /// Where the robots measure themselves to be: metres and radians in the frame `map`, with noise
    /// on x and y; the heading is that of the true motion, and missing where nothing moves.
    #[must_use]
    pub fn poses(&self, t_seconds: f64) -> Vec<Pose> {
        let t = finite(t_seconds);
        let mut chance = chance(self.options.seed, Purpose::Position, t);
        let pose = |place: Place| {
            let [east, north] = normal_pair(&mut chance).map(|off| off * self.options.noise_m);
            Pose {
                x: place.at[0] + east,
                y: place.at[1] + north,
                z: None,
                heading: place.velocity.map(|[east, north]| north.atan2(east)),
                frame: Some(FRAME.to_owned()),
                stamp: None,
                boot: None,
                seq: None,
            }
        };
        self.formation.places(t).into_iter().map(pose).collect()
    }

    /// Which robots each robot receives, with the quality of each link from 0 to 1, ordered as the robots are.
    #[must_use]
    pub fn links(&self, t_seconds: f64) -> Vec<Links> {
        let places = self.formation.places(finite(t_seconds));
        let positions: Vec<_> = places.into_iter().map(|place| place.at).collect();
        let report = |senders: Vec<(usize, f64)>| {
            let links = senders.into_iter().filter_map(|(peer, quality)| {
                Some(Link { peer: self.robots.get(peer)?.clone(), quality })
            });
            Links { links: links.collect(), stamp: None, boot: None, seq: None }
        };
        self.radio.received(&positions).into_iter().map(report).collect()
    }

    /// The superiors of the robots.
    #[must_use]
    pub fn ranks(&self, t_seconds: f64) -> Vec<Rank> {
        let commands = self.formation.commands(finite(t_seconds));
        let ranks =
            commands.into_iter().zip(self.formation.members()).map(|(command, member)| Rank {
                superior: command.superior.and_then(|superior| self.robots.get(superior).cloned()),
                weight: Some(1.0),
                role: Some(member.role.clone().into_owned()),
                skills: None,
                stamp: None,
                boot: None,
                seq: None,
            });
        ranks.collect()
    }

    /// The team that each robot truly is in, from 0 to one less than the teams of the options.
    #[must_use]
    pub fn truth(&self, t_seconds: f64) -> Vec<usize> {
        let commands = self.formation.commands(finite(t_seconds));
        commands.into_iter().map(|command| command.team).collect()
    }

    /// All reports of all robots.
    #[must_use]
    pub fn observe(&self, t_seconds: f64) -> Vec<RobotObservation> {
        let reports = self.poses(t_seconds).into_iter().zip(self.links(t_seconds));
        let reports = reports.zip(self.ranks(t_seconds)).zip(&self.robots);
        reports
            .map(|(((pose, links), rank), robot)| RobotObservation {
                robot: robot.clone(),
                pose,
                links,
                rank,
            })
            .collect()
    }
}

fn finite(t_seconds: f64) -> f64 {
    if t_seconds.is_finite() { t_seconds } else { 0.0 }
}
