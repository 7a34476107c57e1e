//! Fleets in files: positions, superiors, and how the fleet is truly divided.
//!
//! A file is one JSON object:
//!
//! ```json
//! {
//!   "name": "pair",
//!   "description": "Two robots abreast.",
//!   "velocity": [0.0, 1.0],
//!   "robots": [
//!     {"id": "a", "role": "leader", "superior": null, "at": [0.0, 0.0]},
//!     {"id": "b", "role": "member", "superior": "a", "at": [5.0, 0.0]}
//!   ],
//!   "nets": [["a", "b"]],
//!   "divisions": [[["a"], ["b"]]]
//! }
//! ```
//!
//! Positions are metres east and north. `velocity` (metres per second, 0 if left out) is that of the whole
//! fleet, which marches for a minute and back, again and again. `nets` (none if left out) are the radio nets
//! of the fleet: all members of one receive each other. Each of `divisions`, of which there is one at least,
//! names teams that the fleet truly forms; robots that are in no team of it do not count in it.

use std::collections::BTreeMap;

use muster_model::id::RobotId;
use muster_model::limits::{MAX_COORDINATE_M, MAX_ROBOTS, MAX_TEAMS};
use serde::{Deserialize, Serialize};

use crate::formation::{Command, Formation, Member, Place, Point};

/// How long a fleet marches before it turns back.
const MARCH_S: f64 = 60.0;

/// Fastest fleet, in metres per second: a sounding rocket.
const MAX_SPEED: f64 = 2000.0;

/// Longest file: that of the largest fleet with long names, several times over.
pub const MAX_FILE_BYTES: usize = 64 << 20;

/// One robot of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileRobot {
    /// The robot.
    pub id: RobotId,
    /// What it is in its unit.
    pub role: String,
    /// Its superior; none at the top.
    pub superior: Option<RobotId>,
    /// Metres east and north.
    pub at: [f64; 2],
}

/// A fleet in a file, as it stands there. [`Layout`] is what it means.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenarioFile {
    /// What it is called.
    pub name: String,
    /// What it is, for people.
    #[serde(default)]
    pub description: String,
    /// How the whole fleet moves, in metres per second east and north.
    #[serde(default)]
    pub velocity: [f64; 2],
    /// The robots.
    pub robots: Vec<FileRobot>,
    /// Robots that receive each other.
    #[serde(default)]
    pub nets: Vec<Vec<RobotId>>,
    /// How the fleet is truly divided: teams of robots, in one or more ways.
    pub divisions: Vec<Vec<Vec<RobotId>>>,
}

/// A file that is none, by the field that is to be changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct FileError {
    /// The field.
    pub field: String,
    /// What is wrong with it, and what it may be.
    pub problem: String,
}

fn refuse<T>(field: impl Into<String>, problem: impl Into<String>) -> Result<T, FileError> {
    Err(FileError { field: field.into(), problem: problem.into() })
}

/// A checked fleet, in which robots are numbers from 0 in the order of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// What it is called.
    pub name: String,
    /// How the whole fleet moves, in metres per second east and north.
    pub velocity: [f64; 2],
    /// The robots.
    pub robots: Vec<RobotId>,
    /// What each is in its unit.
    pub roles: Vec<String>,
    /// Metres east and north.
    pub places: Vec<[f64; 2]>,
    /// The superior of each; none at the top.
    pub superiors: Vec<Option<usize>>,
    /// Robots that receive each other.
    pub nets: Vec<Vec<usize>>,
    /// The team of each robot in each division, none where it does not count.
    pub divisions: Vec<Vec<Option<usize>>>,
}

impl Layout {
    /// Reads a file.
    ///
    /// # Errors
    /// Names the field that is wrong, and what it may be.
    pub fn read(text: &str) -> Result<Self, FileError> {
        if text.len() > MAX_FILE_BYTES {
            return refuse("(file)", format!("is longer than {MAX_FILE_BYTES} bytes"));
        }
        let file: ScenarioFile = match serde_json::from_str(text) {
            Ok(file) => file,
            Err(error) => return refuse("(file)", error.to_string()),
        };
        Self::new(file)
    }

    /// Checks a file.
    ///
    /// # Errors
    /// Names the field that is wrong, and what it may be.
    pub fn new(file: ScenarioFile) -> Result<Self, FileError> {
        if !(1..=MAX_ROBOTS).contains(&file.robots.len()) {
            return refuse(
                "robots",
                format!("must be 1 to {MAX_ROBOTS}, are {}", file.robots.len()),
            );
        }
        let [east, north] = file.velocity;
        // Written so that what is no number is refused too.
        if !matches!(east.hypot(north), speed if speed <= MAX_SPEED) {
            let problem = format!("must be at most {MAX_SPEED} m/s, is [{east}, {north}]");
            return refuse("velocity", problem);
        }
        let mut numbers = BTreeMap::new();
        for (number, robot) in file.robots.iter().enumerate() {
            let within = |metres: &f64| metres.abs() <= MAX_COORDINATE_M;
            if !robot.at.iter().all(within) {
                let problem = format!("must be within {MAX_COORDINATE_M} m, is {:?}", robot.at);
                return refuse(format!("robots[{number}].at"), problem);
            }
            if numbers.insert(&robot.id, number).is_some() {
                return refuse(
                    format!("robots[{number}].id"),
                    format!("{} stands twice", robot.id),
                );
            }
        }
        let find = |field: String, robot: &RobotId| match numbers.get(robot) {
            Some(number) => Ok(*number),
            None => refuse(field, format!("{robot} is none of the robots")),
        };
        let mut superiors = Vec::with_capacity(file.robots.len());
        for (number, robot) in file.robots.iter().enumerate() {
            let field = || format!("robots[{number}].superior");
            let superior = robot.superior.as_ref().map(|s| find(field(), s)).transpose()?;
            if superior == Some(number) {
                return refuse(field(), format!("{} cannot answer to itself", robot.id));
            }
            superiors.push(superior);
        }
        let mut nets = Vec::with_capacity(file.nets.len());
        for (place, net) in file.nets.iter().enumerate() {
            let members = net.iter().map(|robot| find(format!("nets[{place}]"), robot));
            nets.push(members.collect::<Result<Vec<_>, _>>()?);
        }
        if file.divisions.is_empty() {
            return refuse(
                "divisions",
                "must be one at least: the teams that the fleet truly forms",
            );
        }
        let mut divisions = Vec::with_capacity(file.divisions.len());
        for (place, teams) in file.divisions.iter().enumerate() {
            if !(1..=MAX_TEAMS as usize).contains(&teams.len()) {
                let problem = format!("must have 1 to {MAX_TEAMS} teams, has {}", teams.len());
                return refuse(format!("divisions[{place}]"), problem);
            }
            let mut labels = vec![None; file.robots.len()];
            for (team, members) in teams.iter().enumerate() {
                let field = || format!("divisions[{place}][{team}]");
                if members.is_empty() {
                    return refuse(field(), "must have a robot");
                }
                for robot in members {
                    if labels[find(field(), robot)?].replace(team).is_some() {
                        return refuse(field(), format!("{robot} stands in two teams"));
                    }
                }
            }
            divisions.push(labels);
        }
        let robots = file.robots;
        Ok(Self {
            name: file.name,
            velocity: file.velocity,
            roles: robots.iter().map(|robot| robot.role.clone()).collect(),
            places: robots.iter().map(|robot| robot.at).collect(),
            robots: robots.into_iter().map(|robot| robot.id).collect(),
            superiors,
            nets,
            divisions,
        })
    }

    /// How many teams a division has.
    #[must_use]
    pub fn teams(&self, division: usize) -> usize {
        let labels = self.divisions.get(division).into_iter().flatten();
        labels.flatten().max().map_or(0, |team| team + 1)
    }
}

/// A fleet of a file that marches.
#[derive(Debug)]
pub(crate) struct March {
    members: Vec<Member>,
    places: Vec<Point>,
    velocity: Point,
    commands: Vec<Command>,
}

impl March {
    pub(crate) fn new(layout: &Layout) -> Self {
        // The division that counts the most robots; who is in none of its teams is in one more.
        let labelled_count = |labels: &&Vec<Option<usize>>| labels.iter().flatten().count();
        let labels = layout.divisions.iter().max_by_key(labelled_count);
        let teams = labels.into_iter().flatten().flatten().max().map_or(0, |team| team + 1);
        let team = |robot: usize| labels.and_then(|labels| labels[robot]).unwrap_or(teams);
        let named = layout.robots.iter().zip(&layout.roles);
        Self {
            members: named
                .map(|(id, role)| Member { id: id.clone(), role: role.clone().into() })
                .collect(),
            places: layout.places.clone(),
            velocity: layout.velocity,
            commands: layout
                .superiors
                .iter()
                .enumerate()
                .map(|(robot, superior)| Command { superior: *superior, team: team(robot) })
                .collect(),
        }
    }
}

impl Formation for March {
    fn members(&self) -> &[Member] {
        &self.members
    }

    fn places(&self, t_seconds: f64) -> Vec<Place> {
        let phase = t_seconds.rem_euclid(2.0 * MARCH_S);
        let (gone, ahead) =
            if phase < MARCH_S { (phase, 1.0) } else { (2.0 * MARCH_S - phase, -1.0) };
        // Not −0, of which the heading would be the other way round.
        let velocity = self.velocity.map(|speed| ahead * speed + 0.0);
        let moves = self.velocity != [0.0; 2];
        let place = |at: &Point| Place {
            at: [0, 1].map(|axis| at[axis] + gone * self.velocity[axis]),
            velocity: moves.then_some(velocity),
        };
        self.places.iter().map(place).collect()
    }

    fn commands(&self, _t_seconds: f64) -> Vec<Command> {
        self.commands.clone()
    }
}
