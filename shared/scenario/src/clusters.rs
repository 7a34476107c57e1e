//! Groups that stand still, far from each other.

use crate::formation::{Command, Formation, Member, Place, Point, columns, evenly, number};
use crate::noise::{Purpose, between, chance};
use crate::options::{FleetOptions, ScenarioError};

/// Metres between the nearest robots of two groups: beyond the default radio range, and many times
/// the distance of neighbours.
const GAP_M: f64 = 60.0;

/// Metres from the middle to the first robot of a sunflower, whose neighbours are 1.5 to 2 times as
/// far from each other.
const SEED_M: f64 = 4.5;

/// Most metres along each axis by which a robot's place is off.
const UNTIDINESS_M: f64 = 0.5;

/// The angle in radians between successive seeds of a sunflower: a full turn divided by the golden
/// ratio squared (Vogel 1979).
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// The scenario.
#[derive(Debug)]
pub(crate) struct Clusters {
    members: Vec<Member>,
    places: Vec<Place>,
    commands: Vec<Command>,
}

impl Clusters {
    /// Places the robots. The options are checked.
    pub(crate) fn new(options: &FleetOptions) -> Result<Self, ScenarioError> {
        let mut untidiness = chance(options.seed, Purpose::Layout, 0.0);
        let mut clusters = Self { members: Vec::new(), places: Vec::new(), commands: Vec::new() };
        let radius = SEED_M * number(options.robots.div_ceil(options.teams)).sqrt();
        let (pitch, columns) = (2.0 * radius + GAP_M, columns(options.teams));
        for (team, robots) in evenly(options.robots, options.teams).enumerate() {
            let middle = [number(team % columns) * pitch, number(team / columns) * pitch];
            let leader = robots.start;
            for (place, robot) in robots.enumerate() {
                let is_leader = robot == leader;
                let role = if is_leader { "leader" } else { "member" };
                let id = format!("c{}-r{}", team + 1, place + 1);
                clusters.members.push(Member::new(id, role)?);
                let superior = (!is_leader).then_some(leader);
                clusters.commands.push(Command { superior, team });
                let seed = sunflower_seed(place);
                let at = std::array::from_fn(|axis| {
                    let off = between(&mut untidiness, -UNTIDINESS_M, UNTIDINESS_M);
                    middle[axis] + seed[axis] + off
                });
                clusters.places.push(Place { at, velocity: None });
            }
        }
        Ok(clusters)
    }
}

/// Where the n-th seed of a sunflower is, in metres: evenly spaced for any number of seeds.
fn sunflower_seed(place: usize) -> Point {
    let (sin, cos) = (number(place) * GOLDEN_ANGLE).sin_cos();
    let radius = SEED_M * number(place).sqrt();
    [radius * cos, radius * sin]
}

impl Formation for Clusters {
    fn members(&self) -> &[Member] {
        &self.members
    }

    fn places(&self, _t_seconds: f64) -> Vec<Place> {
        self.places.clone()
    }

    fn commands(&self, _t_seconds: f64) -> Vec<Command> {
        self.commands.clone()
    }
}
