//! The robots of a fleet that moves: teams of squads with their chain of command and formation.
//!
//! A team is a unit of units down to squads of up to nine, each with a leader in its first place. Leaders of
//! teams answer to the leader of the first team. Teams march side by side.

use std::ops::Range;

use muster_model::id::{IdError, RobotId};

/// Most robots of a squad, with its leader.
const SQUAD_ROBOTS: usize = 9;

/// Robots of a squad without its leader, where there are many squads.
const SQUAD_FOLLOWERS: usize = 8;

/// Most units under one leader: above that there is one more level of command.
const MAX_UNITS: usize = 8;

/// Metres between neighbours of a squad.
pub const SPACING_M: f64 = 6.0;

/// Metres between the nearest robots of two squads.
pub const SQUAD_GAP_M: f64 = 10.0;

/// Metres between the nearest robots of two teams.
pub const TEAM_GAP_M: f64 = 20.0;

/// How far in front of the first of its squads the leader of a larger unit marches, in metres.
const LEAD_M: f64 = 4.0;

/// Robots side by side in a squad, in the order in which places are taken: the leader in the middle.
const FILES: [f64; 3] = [0.0, 1.0, -1.0];

/// The team that splits.
pub const SPLITS: usize = 1;

/// The team that another one joins, and the one that joins it.
pub const JOINED: usize = 2;
/// See [`JOINED`].
pub const JOINS: usize = 3;

/// Fewest teams of a fleet: those that split and join, and the commander's.
pub const LEAST_TEAMS: usize = 4;

/// One robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Its name.
    pub name: RobotId,
    /// Its superior while every robot is in its own team, by place in the fleet.
    pub superior: Option<usize>,
    /// Its own team.
    pub team: usize,
    /// Whether it belongs to the part of its team that splits off.
    pub splits: bool,
    /// Its squad, counted through the fleet.
    pub squad: usize,
    /// Its place in the formation, in metres ahead and to the left.
    pub home: [f64; 2],
}

/// All robots, ordered by name.
#[derive(Debug, Clone, PartialEq)]
pub struct Fleet {
    /// The robots, team by team, each with its leader first.
    pub robots: Vec<Robot>,
    /// How many teams there are before anything happens.
    pub teams: usize,
    /// The leader of each team.
    pub leaders: Vec<usize>,
    /// The leader of the part that splits off.
    pub head: usize,
    /// How many squads there are.
    pub squads: usize,
}

impl Fleet {
    /// So many robots in teams that are as equal as can be.
    ///
    /// # Errors
    /// If a name is none: never, below a hundred thousand robots.
    ///
    /// # Panics
    /// For fewer than [`LEAST_TEAMS`] teams, or teams that are no more than a squad.
    pub fn new(robots: usize, teams: usize) -> Result<Self, IdError> {
        assert!(
            teams >= LEAST_TEAMS && robots / teams > SQUAD_ROBOTS,
            "too few teams, or too small ones"
        );
        let mut draft = Draft::default();
        let mut leaders = Vec::new();
        let mut head = 0;
        let mut left_m = 0.0;
        for (team, members) in evenly(0..robots, teams).into_iter().enumerate() {
            let leader = members.start;
            let superior = leaders.first().copied();
            leaders.push(leader);
            let first_squad = draft.squads.len();
            let parts = draft.unit(members.clone(), superior);
            if team == SPLITS {
                head = parts.get(parts.len().div_ceil(2)).map_or(leader, |part| part.start);
            }
            left_m -= draft.place(first_squad, left_m) + TEAM_GAP_M;
            for robot in members {
                draft.teams.push((team, team == SPLITS && robot >= head));
            }
        }
        let mut all = Vec::with_capacity(robots);
        for (number, (team, splits)) in draft.teams.iter().enumerate() {
            all.push(Robot {
                name: RobotId::new(format!("r{number:05}"))?,
                superior: draft.superiors[number],
                team: *team,
                splits: *splits,
                squad: draft.squad_of[number],
                home: draft.homes[number],
            });
        }
        Ok(Self { robots: all, teams, leaders, head, squads: draft.squads.len() })
    }
}

/// A fleet that is being made. Lists have one entry per robot, in order.
#[derive(Default)]
struct Draft {
    superiors: Vec<Option<usize>>,
    squad_of: Vec<usize>,
    homes: Vec<[f64; 2]>,
    teams: Vec<(usize, bool)>,
    /// The robots of each squad, first those in front of it that lead larger units, and the number of these.
    squads: Vec<(Range<usize>, usize)>,
    /// Leaders of larger units whose first squad is still to come.
    leading: usize,
}

impl Draft {
    /// Adds a unit, and returns those that it consists of.
    fn unit(&mut self, robots: Range<usize>, superior: Option<usize>) -> Vec<Range<usize>> {
        let leader = robots.start;
        self.superiors.push(superior);
        if robots.len() <= SQUAD_ROBOTS {
            self.superiors.extend((leader + 1..robots.end).map(|_| Some(leader)));
            let ahead = std::mem::take(&mut self.leading);
            self.squads.push((robots.start - ahead..robots.end, ahead));
            return Vec::new();
        }
        self.leading += 1;
        let followers = leader + 1..robots.end;
        let squads = followers.len().div_ceil(SQUAD_FOLLOWERS).max(2);
        let parts = if squads <= MAX_UNITS + 1 {
            squads
        } else {
            followers.len().div_ceil(MAX_UNITS * SQUAD_FOLLOWERS + 1).max(2)
        };
        let parts = evenly(followers, parts);
        for part in &parts {
            self.unit(part.clone(), Some(leader));
        }
        parts
    }

    /// Places the squads of a team from the `first` on, in columns, with the leftmost so far to the left; how
    /// many metres wide it is.
    fn place(&mut self, first: usize, left_m: f64) -> f64 {
        let squad_m = SPACING_M * (FILES.len() - 1) as f64;
        let pitch_m = squad_m + SQUAD_GAP_M;
        let columns = (self.squads.len() - first).isqrt().max(1);
        for (number, (robots, ahead)) in self.squads[first..].iter().enumerate() {
            let (row, column) = (number / columns, number % columns);
            let front = -(row as f64) * pitch_m;
            let middle = left_m - column as f64 * pitch_m - 0.5 * squad_m;
            for place in 0..robots.len() {
                self.squad_of.push(first + number);
                self.homes.push(match place.checked_sub(*ahead) {
                    None => [front + (ahead - place) as f64 * LEAD_M, middle],
                    Some(place) => [
                        front - (place / FILES.len()) as f64 * SPACING_M,
                        middle + FILES[place % FILES.len()] * SPACING_M,
                    ],
                });
            }
        }
        (columns - 1) as f64 * pitch_m + squad_m
    }
}

/// A range in so many parts that differ by one at most, none larger than the first.
fn evenly(range: Range<usize>, parts: usize) -> Vec<Range<usize>> {
    let bound = |part: usize| range.start + (range.len() * part).div_ceil(parts);
    (0..parts).map(|part| bound(part)..bound(part + 1)).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    #[test]
    fn all_but_leaders_answer_to_a_robot_of_their_team() {
        for (robots, teams) in [(48, 4), (50, 4), (200, 8), (500, 10), (5000, 10)] {
            let fleet = Fleet::new(robots, teams).unwrap();
            assert_eq!((fleet.robots.len(), fleet.leaders.len()), (robots, teams));
            for (number, robot) in fleet.robots.iter().enumerate() {
                match robot.superior {
                    None => assert_eq!(number, 0),
                    Some(superior) if fleet.leaders.contains(&number) => assert_eq!(superior, 0),
                    Some(superior) => {
                        assert_eq!(fleet.robots[superior].team, robot.team);
                        assert!(superior < number);
                    }
                }
            }
        }
    }

    #[test]
    fn less_than_half_of_a_team_splits_off() {
        for (robots, teams) in [(48, 4), (200, 8), (500, 10), (5000, 10)] {
            let fleet = Fleet::new(robots, teams).unwrap();
            let of_team = fleet.robots.iter().filter(|robot| robot.team == SPLITS).count();
            let off = fleet.robots.iter().filter(|robot| robot.splits).count();
            assert!(4 * off > of_team && 2 * off < of_team, "{off} of {of_team}");
            let superior = fleet.robots[fleet.head].superior;
            assert_eq!(superior, Some(fleet.leaders[SPLITS]));
        }
    }

    #[test]
    fn no_two_robots_share_a_place_and_teams_keep_their_distance() {
        let fleet = Fleet::new(200, 8).unwrap();
        for (number, one) in fleet.robots.iter().enumerate() {
            for other in &fleet.robots[..number] {
                let metres = (one.home[0] - other.home[0]).hypot(one.home[1] - other.home[1]);
                let least = if one.team == other.team { LEAD_M } else { TEAM_GAP_M };
                assert!(metres >= least - 1e-9, "{one:?} {other:?}");
            }
        }
    }
}
