//! Platoons that march side by side, part at a crossing, and rejoin.
//!
//! All march the leaf of a clover that lies west of the crossing, then each platoon marches a leaf of
//! its own, then all march the common leaf again. Formations do not turn, so that all robots of a
//! platoon have the same speed, however large it is. Platoons stand from north to south, and their
//! leaves do the same. While the platoons are apart, the squad of the first platoon that stands next
//! to the second one marches with the second one and answers to its leader.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use muster_model::id::IdError;
use rand_chacha::ChaCha8Rng;

use crate::formation::{Command, Formation, Member, Place, Point, columns, evenly, number};
use crate::noise::{Purpose, between, chance};
use crate::options::{FleetOptions, ScenarioError};

/// After how many seconds all begins again.
const PERIOD_S: f64 = 60.0;

/// When the platoons part: late enough that whoever watches has seen them together.
const PART_S: f64 = 11.0;

/// When they rejoin.
const REJOIN_S: f64 = 47.0;

/// Metres between neighbours of a squad.
const SPACING_M: f64 = 6.0;

/// Metres between the nearest robots of two squads.
const SQUAD_GAP_M: f64 = 10.0;

/// Metres between the nearest robots of two platoons that march together.
const PLATOON_GAP_M: f64 = 20.0;

/// How far a platoon's leader marches before the first rank, in metres.
const LEAD_M: f64 = 8.0;

/// Most metres along each axis by which a robot's place in the formation is off.
const UNTIDINESS_M: f64 = 0.5;

/// Most robots of a squad: three ranks of three, without the platoon's leader.
const SQUAD: usize = 9;

/// Robots side by side in a squad, in the order in which places are taken: the leader in the middle.
const FILES: [f64; 3] = [0.0, 1.0, -1.0];

/// From the northernmost leaf to the crossing, as sine of its bearing: all leaves point east a little.
const STEEPEST: f64 = 0.95;

/// A way out and back again, as a leaf of a clover.
struct Leaf {
    /// Sine and cosine of the bearing, counter-clockwise from east.
    bearing: (f64, f64),
    length_m: f64,
    half_width_m: f64,
    duration_s: f64,
}

impl Leaf {
    /// The way west of the crossing that all march: 1.6 to 3.7 m/s.
    const COMMON: Self = Self {
        bearing: (0.0, -1.0),
        length_m: 25.0,
        half_width_m: 6.5,
        duration_s: PERIOD_S - REJOIN_S + PART_S,
    };

    /// The way of one platoon: 1.6 to 4.3 m/s.
    fn of(platoon: usize, platoons: usize) -> Self {
        let share = number(platoon) / number(platoons.saturating_sub(1).max(1));
        let sine = STEEPEST * (1.0 - 2.0 * share);
        Self {
            bearing: (sine, (1.0 - sine * sine).sqrt()),
            length_m: 44.0,
            half_width_m: 11.0,
            duration_s: REJOIN_S - PART_S,
        }
    }

    /// Where on it one is a share of the duration after its start at the crossing.
    fn at(&self, share: f64) -> (Point, Point) {
        let (sin, cos) = self.bearing;
        let turn =
            |[along, across]: Point| [cos * along - sin * across, sin * along + cos * across];
        let place = [self.length_m * (PI * share).sin(), self.half_width_m * (TAU * share).sin()];
        let pace = PI / self.duration_s;
        let velocity = [
            self.length_m * pace * (PI * share).cos(),
            self.half_width_m * 2.0 * pace * (TAU * share).cos(),
        ];
        (turn(place), turn(velocity))
    }
}

/// Where a robot belongs.
#[derive(Debug, Clone, Copy)]
struct Slot {
    /// Its place in the formation, in metres east and north of the point that all march around.
    home: Point,
    command: Command,
    /// Its team while the platoons are apart.
    apart: Command,
}

impl Slot {
    fn is_lent(&self) -> bool {
        self.command.team != self.apart.team
    }
}

/// The scenario.
#[derive(Debug)]
pub(crate) struct Crossing {
    members: Vec<Member>,
    slots: Vec<Slot>,
    platoons: usize,
}

impl Crossing {
    /// Places the robots. The options are checked.
    pub(crate) fn new(options: &FleetOptions) -> Result<Self, ScenarioError> {
        let platoons: Vec<_> = evenly(options.robots, options.teams).collect();
        let files = platoons.iter().map(|robots| columns(squads(robots.len() - 1)));
        let width = number(files.max().unwrap_or(1) - 1) * squad_pitch() + squad_width();
        let mut draft = Draft {
            crossing: Self { members: Vec::new(), slots: Vec::new(), platoons: options.teams },
            chance: chance(options.seed, Purpose::Layout, 0.0),
            host: platoons.get(1).map_or(0, |robots| robots.start),
        };
        for (team, robots) in platoons.into_iter().enumerate() {
            let middle = number(options.teams - 1) / 2.0 - number(team);
            draft.platoon(team, &robots, middle * (width + PLATOON_GAP_M))?;
        }
        Ok(draft.crossing)
    }
}

/// A crossing whose robots are being placed.
struct Draft {
    crossing: Crossing,
    chance: ChaCha8Rng,
    /// The leader of the second platoon, superior to the lent squad.
    host: usize,
}

impl Draft {
    /// Adds a platoon whose middle is so many metres north.
    fn platoon(&mut self, team: usize, robots: &Range<usize>, north: f64) -> Result<(), IdError> {
        let (lead, name) = (robots.start, team + 1);
        let top = Command { superior: None, team };
        self.join(format!("p{name}-lead"), "platoon-leader", [LEAD_M, north], top, top)?;
        let followers = robots.len() - 1;
        let squads = squads(followers);
        let columns = columns(squads);
        for (squad, places) in evenly(followers, squads).enumerate() {
            let leader = lead + 1 + places.start;
            // The last of the first platoon's front row stands next to the second platoon.
            let is_lent = team == 0 && squad + 1 == columns.min(squads);
            for place in 0..places.len() {
                let (role, superior, host) = match place {
                    0 => ("squad-leader", lead, self.host),
                    _ => ("member", leader, leader),
                };
                let command = Command { superior: Some(superior), team };
                let apart =
                    if is_lent { Command { superior: Some(host), team: 1 } } else { command };
                let [x, y] = place_of(squad, columns, place);
                let id = format!("p{name}-s{}-r{}", squad + 1, place + 1);
                self.join(id, role, [x, y + north], command, apart)?;
            }
        }
        Ok(())
    }

    fn join(
        &mut self,
        id: String,
        role: &'static str,
        home: Point,
        command: Command,
        apart: Command,
    ) -> Result<(), IdError> {
        let off = |metres| metres + between(&mut self.chance, -UNTIDINESS_M, UNTIDINESS_M);
        self.crossing.slots.push(Slot { home: home.map(off), command, apart });
        self.crossing.members.push(Member::new(id, role)?);
        Ok(())
    }
}

/// How many squads follow a platoon's leader: at least two, so that one can be lent.
fn squads(followers: usize) -> usize {
    followers.div_ceil(SQUAD).max(2).min(followers)
}

fn squad_width() -> f64 {
    SPACING_M * number(FILES.len() - 1)
}

fn squad_pitch() -> f64 {
    squad_width() + SQUAD_GAP_M
}

/// Where a robot stands, in metres east of its platoon's first rank and north of its middle.
fn place_of(squad: usize, columns: usize, place: usize) -> Point {
    let (row, column) = (squad / columns, squad % columns);
    let (rank, file) = (place / FILES.len(), place % FILES.len());
    let file = FILES.get(file).copied().unwrap_or_default();
    [
        -number(row) * squad_pitch() - number(rank) * SPACING_M,
        (number(columns - 1) / 2.0 - number(column)) * squad_pitch() + file * SPACING_M,
    ]
}

/// Seconds since the last beginning.
fn phase(t_seconds: f64) -> f64 {
    t_seconds.rem_euclid(PERIOD_S)
}

fn are_apart(t_seconds: f64) -> bool {
    (PART_S..REJOIN_S).contains(&phase(t_seconds))
}

impl Formation for Crossing {
    fn members(&self) -> &[Member] {
        &self.members
    }

    fn places(&self, t_seconds: f64) -> Vec<Place> {
        let apart = are_apart(t_seconds);
        let share = if apart {
            (phase(t_seconds) - PART_S) / (REJOIN_S - PART_S)
        } else {
            let since = phase(t_seconds) - REJOIN_S;
            (if since < 0.0 { since + PERIOD_S } else { since }) / Leaf::COMMON.duration_s
        };
        let ways: Vec<(Point, Point)> = (0..self.platoons)
            .map(|platoon| {
                if apart {
                    Leaf::of(platoon, self.platoons).at(share)
                } else {
                    Leaf::COMMON.at(share)
                }
            })
            .collect();
        // The lent squad closes up to its hosts, and goes back to its place before it rejoins.
        let closer_m = PLATOON_GAP_M - SQUAD_GAP_M;
        let (sin, cos) = (PI * share).sin_cos();
        let closing = (closer_m * sin * sin, closer_m * 2.0 * sin * cos * PI / (REJOIN_S - PART_S));
        let place = |slot: &Slot| {
            let command = if apart { slot.apart } else { slot.command };
            let (way, pace) = ways.get(command.team).copied().unwrap_or_default();
            let (south, southward) =
                if apart && slot.is_lent() { closing } else { Default::default() };
            Place {
                at: [slot.home[0] + way[0], slot.home[1] + way[1] - south],
                velocity: Some([pace[0], pace[1] - southward]),
            }
        };
        self.slots.iter().map(place).collect()
    }

    fn commands(&self, t_seconds: f64) -> Vec<Command> {
        let apart = are_apart(t_seconds);
        self.slots.iter().map(|slot| if apart { slot.apart } else { slot.command }).collect()
    }
}
