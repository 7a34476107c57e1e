//! A fleet that always moves: teams of squads that circle about their places.
//!
//! Each team is a disc of squads of [`SQUAD_ROBOTS`] robots, the teams are in a row. Every squad moves along
//! a circle of its own and turns, at about 1 m/s, so that each pose is another one and the neighbours of
//! robots at the rims of squads change. In each team but the last one robot is a courier, which flies to
//! the next team, answers to a leader there, and comes back; so that divisions change.

use std::f64::consts::{PI, TAU};

/// Robots of a squad: a leader and nine others.
const SQUAD_ROBOTS: usize = 10;

/// Metres between the places of neighbouring squads.
const SQUAD_PITCH_M: f64 = 16.0;

/// Metres from the middle of a squad to its robots.
const RING_M: f64 = 4.5;

/// Metres between the rims of neighbouring teams.
const TEAM_GAP_M: f64 = 40.0;

/// Metres from a squad's place to where it is.
const CIRCLE_M: f64 = 3.0;

/// Seconds in which a squad goes around its place once.
const CIRCLE_S: f64 = 20.0;

/// Radio range in metres.
const RANGE_M: f64 = 40.0;

/// Seconds of a courier's whole way; a quarter each at home, on the way, away, and on the way back.
const COURIER_S: f64 = 24.0;

/// The angle in radians between successive seeds of a sunflower (Vogel 1979).
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// Where a robot belongs.
#[derive(Debug, Clone, Copy)]
struct Post {
    /// The squad, by its number in the fleet.
    squad: usize,
    /// Its place on the squad's ring.
    place: usize,
    /// The squad that a courier flies to, and when its way begins.
    courier: Option<(usize, f64)>,
}

/// One squad.
#[derive(Debug, Clone)]
struct Squad {
    at: [f64; 2],
    phase: f64,
    /// Its robots, the leader first; couriers of other teams are not among them.
    robots: Vec<usize>,
    /// The superior of the leader.
    superior: Option<usize>,
}

/// The whole fleet.
#[derive(Debug, Clone)]
pub struct Squads {
    posts: Vec<Post>,
    squads: Vec<Squad>,
}

impl Squads {
    /// So many robots in so many teams, at least one of each; robots of a team have adjacent numbers.
    #[must_use]
    pub fn new(robots: usize, teams: usize) -> Self {
        let teams = teams.clamp(1, robots.max(1));
        let most = robots.div_ceil(teams).div_ceil(SQUAD_ROBOTS);
        let pitch = SQUAD_PITCH_M * (most as f64).sqrt() + TEAM_GAP_M;
        let mut fleet = Self { posts: Vec::new(), squads: Vec::new() };
        let mut first_squads = Vec::new();
        for team in 0..teams {
            let (first, after) = (robots * team / teams, robots * (team + 1) / teams);
            first_squads.push(fleet.squads.len());
            for (number, begin) in (first..after).step_by(SQUAD_ROBOTS).enumerate() {
                let squad = fleet.squads.len();
                let members: Vec<usize> = (begin..after.min(begin + SQUAD_ROBOTS)).collect();
                let seed = number as f64;
                let (out, turn) = (0.5 * SQUAD_PITCH_M * seed.sqrt(), seed * GOLDEN_ANGLE);
                let posts = (0..members.len()).map(|place| Post { squad, place, courier: None });
                fleet.posts.extend(posts);
                fleet.squads.push(Squad {
                    at: [team as f64 * pitch + out * turn.cos(), out * turn.sin()],
                    phase: (squad as f64 * GOLDEN_ANGLE) % TAU,
                    robots: members,
                    superior: (number > 0).then_some(first),
                });
            }
        }
        for (team, pair) in first_squads.windows(2).enumerate() {
            let squad = &fleet.squads[pair[0]];
            // A leader stays.
            if let Some(robot) = squad.robots.last().filter(|_| squad.robots.len() > 2) {
                let begins = COURIER_S * team as f64 / teams as f64;
                fleet.posts[*robot].courier = Some((pair[1], begins));
            }
        }
        fleet
    }

    /// How many robots there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.posts.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.posts.is_empty()
    }

    /// Metres east and north of a robot, at a moment in seconds.
    #[must_use]
    pub fn place(&self, robot: usize, t: f64) -> [f64; 2] {
        let post = self.posts[robot];
        let home = self.on_ring(post.squad, post.place, t);
        let Some((away, begins)) = post.courier else { return home };
        let there = self.on_ring(away, SQUAD_ROBOTS, t);
        let share = share_away(t - begins);
        std::array::from_fn(|axis| home[axis] + share * (there[axis] - home[axis]))
    }

    fn on_ring(&self, squad: usize, place: usize, t: f64) -> [f64; 2] {
        let squad = &self.squads[squad];
        let (sin, cos) = (squad.phase + TAU * t / CIRCLE_S).sin_cos();
        // The leader is in the middle. The ring turns once while the squad goes around once.
        let radius = if place == 0 { 0.0 } else { RING_M };
        let (side, front) = (TAU * (place as f64 / SQUAD_ROBOTS as f64 + t / CIRCLE_S)).sin_cos();
        [
            squad.at[0] + CIRCLE_M * cos + radius * front,
            squad.at[1] + CIRCLE_M * sin + radius * side,
        ]
    }

    /// The squad that a robot is with now.
    fn squad(&self, robot: usize, t: f64) -> usize {
        let post = self.posts[robot];
        match post.courier {
            Some((away, begins)) if share_away(t - begins) > 0.5 => away,
            _ => post.squad,
        }
    }

    /// The incoming links of a robot, with qualities from 0 to 1: from the robots of the squad that it is with; its
    /// leader also has one from its own superior.
    #[must_use]
    pub fn links(&self, robot: usize, t: f64) -> Vec<(usize, f64)> {
        let squad = &self.squads[self.squad(robot, t)];
        let leads = squad.robots.first() == Some(&robot);
        let above = squad.superior.filter(|_| leads);
        let at = self.place(robot, t);
        let peers = squad.robots.iter().copied().filter(|peer| *peer != robot).chain(above);
        let received = peers.map(|peer| {
            let place = self.place(peer, t);
            let distance = (at[0] - place[0]).hypot(at[1] - place[1]) / RANGE_M;
            // The antenna of a superior reaches further.
            (peer, (1.0 - distance * distance).max(0.1))
        });
        received.collect()
    }

    /// The superior of a robot: the leader of its squad; that one's is the leader of its team.
    #[must_use]
    pub fn superior(&self, robot: usize, t: f64) -> Option<usize> {
        let squad = &self.squads[self.squad(robot, t)];
        match squad.robots.first() {
            Some(leader) if *leader == robot => squad.superior,
            leader => leader.copied(),
        }
    }
}

/// How far a courier is, from 0 at home to 1 away, so many seconds after it began.
fn share_away(t: f64) -> f64 {
    let quarter = 4.0 * t.rem_euclid(COURIER_S) / COURIER_S;
    let eased = |x: f64| 0.5 - 0.5 * (PI * x).cos();
    match quarter {
        x if x < 1.0 => 0.0,
        x if x < 2.0 => eased(x - 1.0),
        x if x < 3.0 => 1.0,
        x => eased(4.0 - x),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_move_at_the_pace_of_a_robot_and_couriers_fly() {
        let fleet = Squads::new(503, 5);
        assert_eq!(fleet.len(), 503);
        let mut couriers = 0;
        for robot in 0..fleet.len() {
            let far = (0..240).map(|tick| f64::from(tick) / 10.0).map(|t| {
                let (before, after) = (fleet.place(robot, t), fleet.place(robot, t + 0.1));
                (after[0] - before[0]).hypot(after[1] - before[1])
            });
            let most = far.clone().fold(0.0, f64::max);
            assert!(far.fold(f64::INFINITY, f64::min) > 1e-3, "robot {robot} stands still");
            couriers += usize::from(most > 0.25);
            assert!(most < 5.0, "robot {robot} jumps by {most} m");
        }
        assert_eq!(couriers, 4);
    }

    #[test]
    fn robots_stand_apart_and_answer_to_somebody_but_the_leaders_of_teams() {
        let fleet = Squads::new(120, 3);
        let places: Vec<_> = (0..120).map(|robot| fleet.place(robot, 3.0)).collect();
        for (robot, at) in places.iter().enumerate() {
            let near = places.iter().enumerate().filter(|(other, _)| *other != robot);
            let near = near.map(|(_, place)| (at[0] - place[0]).hypot(at[1] - place[1]));
            assert!(near.fold(f64::INFINITY, f64::min) > 0.2, "robot {robot} stands on another");
        }
        let free = (0..120).filter(|robot| fleet.superior(*robot, 0.0).is_none()).count();
        assert_eq!(free, 3);
        let received = (0..120).map(|robot| fleet.links(robot, 0.0));
        assert!(received.flatten().all(|(_, quality)| (0.0..=1.0).contains(&quality)));
    }

    #[test]
    fn small_fleets_are_fleets_too() {
        for (robots, teams) in [(1, 1), (2, 2), (3, 5), (12, 2)] {
            let fleet = Squads::new(robots, teams);
            assert_eq!(fleet.len(), robots);
            assert!((0..robots).all(|robot| fleet.place(robot, 9.0).iter().all(|x| x.is_finite())));
        }
    }
}
