//! How often robots change their team and change back.
//!
//! A *return* is a change into a team that the robot had left within the window. A robot that moves on from
//! team to team makes none, and neither does one that joins or leaves the fleet. Returns are read off the
//! teams of consecutive divisions and not off the changes that a division lists: of divisions that come
//! faster than they are received only the newest is there.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use muster_model::audit::{Flapping, RobotReturns};
use muster_model::content::Checked;
use muster_model::id::{RobotId, TeamId};
use muster_model::limits::MAX_FLAPPING_ROBOTS;
use muster_model::teams::Teams;
use muster_model::time::Tick;

/// How long a change is remembered. A robot that comes back later was of use in the other team; and an
/// operator who has changed a setting sees within this time whether it has helped.
const FLAPPING_WINDOW: Duration = Duration::from_secs(60);

/// The shortest time that a rate is taken over. Just after the first division a single return would be
/// hundreds per minute; so it is at most six times what it would be over the whole window.
const MIN_OBSERVED: Duration = Duration::from_secs(10);

/// Most teams that are remembered as left by one robot: a robot that goes to and fro does so between two or
/// three. Of more, the one that it left first is forgotten.
const MAX_LEFT_TEAMS: usize = 8;

/// Most returns that are remembered of one robot: one every two seconds, many times more than any threshold
/// that tells something. Of more, the first is forgotten, so that the rate stays at this.
const MAX_RETURNS: usize = 32;

/// Most divisions whose changes are remembered: those of a minute at ten per second, all of which would have to
/// change something.
const MAX_CHANGES: usize = 600;

const SECONDS_PER_MINUTE: f64 = 60.0;

/// A team that a robot was in.
#[derive(Debug)]
struct Left {
    team: TeamId,
    at: Tick,
}

/// The changes of one robot within the window.
#[derive(Debug, Default)]
struct Track {
    /// Teams that it is not in, in the order in which it left them.
    left: VecDeque<Left>,
    /// When it came back into a team.
    returns: VecDeque<Tick>,
}

impl Track {
    fn change(&mut self, now: Tick, from: Option<&TeamId>, to: Option<&TeamId>) {
        if let Some(place) = self.left.iter().position(|left| Some(&left.team) == to) {
            self.left.remove(place);
            push(&mut self.returns, now, MAX_RETURNS);
        }
        if let Some(team) = from {
            push(&mut self.left, Left { team: team.clone(), at: now }, MAX_LEFT_TEAMS);
        }
    }

    fn forget_before(&mut self, first: Tick) {
        self.left.retain(|left| left.at > first);
        self.returns.retain(|at| *at > first);
    }

    fn count(&self) -> u32 {
        u32::try_from(self.returns.len()).unwrap_or(u32::MAX)
    }
}

/// Appends to a queue; past `most` entries the first is dropped.
fn push<T>(queue: &mut VecDeque<T>, value: T, most: usize) {
    queue.push_back(value);
    if queue.len() > most {
        queue.pop_front();
    }
}

/// Watches the teams of robots over the window.
#[derive(Debug, Default)]
pub(crate) struct FlappingWindow {
    /// When the first division was received.
    since: Option<Tick>,
    /// The newest division.
    last: Option<Checked<Teams>>,
    /// The robots of the newest division that have changed their team within the window.
    tracks: BTreeMap<RobotId, Track>,
    /// How many robots changed teams, and when.
    changes: VecDeque<Changes>,
    /// Until when another leader watched that has raised an alert; what it saw is not known here.
    taken_over: Option<Tick>,
}

/// Robots that changed teams at once.
#[derive(Debug)]
struct Changes {
    at: Tick,
    robots: u32,
}

impl FlappingWindow {
    /// Another leader has watched until now, and raised an alert that is open.
    pub(crate) fn take_over(&mut self, now: Tick) {
        self.taken_over = Some(now);
    }

    /// Whether changes that another leader saw may lie within the window: low rates prove nothing then.
    pub(crate) fn is_partial(&self, now: Tick) -> bool {
        self.taken_over.is_some_and(|since| now.since(since) < FLAPPING_WINDOW)
    }

    /// Accepts the next division, received at a moment that is not before the last one.
    pub(crate) fn observe(&mut self, now: Tick, teams: Checked<Teams>) {
        self.forget(now);
        self.since.get_or_insert(now);
        let Some(last) = self.last.replace(teams.clone()) else { return };
        if last.assignments().eq(teams.assignments()) && last.unassigned == teams.unassigned {
            return;
        }
        let mut changed = 0;
        let mut before: BTreeMap<&RobotId, Option<&TeamId>> = robots(&last).collect();
        for (robot, team) in robots(&teams) {
            // A robot that has joined comes from no team.
            let Some(was) = before.remove(robot) else { continue };
            if was != team {
                changed += u32::from(was.is_some() && team.is_some());
                self.tracks.entry(robot.clone()).or_default().change(now, was, team);
            }
        }
        if changed > 0 {
            push(&mut self.changes, Changes { at: now, robots: changed }, MAX_CHANGES);
        }
        // Those that remain have left the fleet. One that joins again begins anew.
        for robot in before.into_keys() {
            self.tracks.remove(robot);
        }
    }

    /// How often robots came back, over the window that ends at a moment.
    pub(crate) fn flapping(&mut self, now: Tick) -> Flapping {
        self.forget(now);
        let Some((since, last)) = self.since.zip(self.last.as_ref()) else {
            return Flapping::default();
        };
        let robots = last.assignments().count() + last.unassigned.len();
        let robots = u32::try_from(robots.max(1)).unwrap_or(u32::MAX);
        let observed = now.since(since).clamp(MIN_OBSERVED, FLAPPING_WINDOW);
        let minutes = observed.as_secs_f64() / SECONDS_PER_MINUTE;
        let mut all: Vec<_> = self.tracks.iter().filter(|(_, track)| track.count() > 0).collect();
        let returns: u32 = all.iter().map(|(_, track)| track.count()).sum();
        // A stable sort: among equals the first by name.
        all.sort_by_key(|(_, track)| std::cmp::Reverse(track.count()));
        let most = all.into_iter().take(MAX_FLAPPING_ROBOTS);
        let named = |(robot, track): (&RobotId, &Track)| RobotReturns {
            robot: robot.clone(),
            returns: track.count(),
        };
        Flapping {
            returns_per_robot_minute: f64::from(returns) / f64::from(robots) / minutes,
            robots: most.map(named).collect(),
        }
    }

    /// How often robots changed from one team to another within the window that ends at a moment, per robot and
    /// minute. The window is always whole: a fleet that has just been divided has not churned yet.
    pub(crate) fn changes(&mut self, now: Tick) -> f64 {
        self.forget(now);
        let Some(last) = &self.last else { return 0.0 };
        let robots = last.assignments().count() + last.unassigned.len();
        let robots = u32::try_from(robots.max(1)).unwrap_or(u32::MAX);
        let changes: f64 = self.changes.iter().map(|changes| f64::from(changes.robots)).sum();
        changes / f64::from(robots) / (FLAPPING_WINDOW.as_secs_f64() / SECONDS_PER_MINUTE)
    }

    /// When the next return leaves the window, so that the rate falls without another division.
    pub(crate) fn falls_at(&self) -> Option<Tick> {
        let first = self.tracks.values().filter_map(|track| track.returns.front()).min();
        first.map(|first| first.after(FLAPPING_WINDOW))
    }

    /// How many robots are remembered, for the memory use.
    pub(crate) fn robots(&self) -> usize {
        self.tracks.len()
    }

    /// Whether a division is remembered, for the memory use.
    pub(crate) fn has_division(&self) -> bool {
        self.last.is_some()
    }

    /// Drops what lies outside of the window.
    fn forget(&mut self, now: Tick) {
        let first = now.before(FLAPPING_WINDOW);
        self.changes.retain(|changes| changes.at > first);
        self.tracks.retain(|_, track| {
            track.forget_before(first);
            !track.left.is_empty() || !track.returns.is_empty()
        });
    }
}

/// Each robot of a division with its team; none for one that belongs to no team.
fn robots(teams: &Teams) -> impl Iterator<Item = (&RobotId, Option<&TeamId>)> {
    let assigned = teams.assignments().map(|(robot, team)| (robot, Some(team)));
    assigned.chain(teams.unassigned.iter().map(|robot| (robot, None)))
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::FleetId;
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::{Member, Team};
    use muster_model::time::seconds;

    use super::*;

    const START: Tick = Tick(1_000_000_000);

    fn at(second: f64) -> Tick {
        START.after(seconds(second))
    }

    /// A division such as `"t1: a b, t2: c, : d"`; without a team's name, its robots have none.
    fn division(text: &str) -> Checked<Teams> {
        let robot = |name: &str| RobotId::new(name).unwrap();
        let (mut teams, mut unassigned) = (Vec::new(), Vec::new());
        for part in text.split(',') {
            let (id, names) = part.split_once(':').unwrap();
            let robots: Vec<_> = names.split_whitespace().map(robot).collect();
            if id.trim().is_empty() {
                unassigned = robots;
                continue;
            }
            teams.push(Team {
                id: TeamId::new(id.trim()).unwrap(),
                leader: robots[0].clone(),
                members: robots.into_iter().map(|robot| Member { robot, margin: 0.5 }).collect(),
                centroid: vec![],
            });
        }
        let header = Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: vec![],
        };
        Checked::new(Teams {
            header,
            embedding: Revision::default(),
            requested: 2,
            considered: vec![],
            teams,
            unassigned,
            stale: vec![],
            inertia: 0.0,
            changes: vec![],
            next_team: 9,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams::default(),
        })
        .unwrap()
    }

    /// What is observed of one division every second.
    fn watched(divisions: &[&str]) -> FlappingWindow {
        let mut window = FlappingWindow::default();
        for (second, text) in (0_u32..).zip(divisions) {
            window.observe(at(f64::from(second)), division(text));
        }
        window
    }

    /// The robots that came back after one division every second, each with its count.
    fn returned(divisions: &[&str]) -> String {
        let found = watched(divisions).flapping(at(divisions.len() as f64 - 1.0)).robots;
        let found = found.iter().map(|entry| format!("{} {}", entry.robot, entry.returns));
        found.collect::<Vec<_>>().join(", ")
    }

    const HOME: &str = "t1: a b, t2: c d";
    const AWAY: &str = "t1: a, t2: b c d";

    #[test]
    fn a_change_back_is_a_return_and_a_change_is_none() {
        assert_eq!(returned(&[HOME, HOME]), "");
        assert_eq!(returned(&[HOME, AWAY, AWAY]), "");
        assert_eq!(returned(&[HOME, AWAY, HOME]), "b 1");
        assert_eq!(returned(&[HOME, AWAY, HOME, AWAY, HOME]), "b 3");
        // It moves on, and comes back over a third team.
        let third = "t1: a, t2: c d, t3: b";
        assert_eq!(returned(&[HOME, AWAY, third]), "");
        assert_eq!(returned(&[HOME, AWAY, third, HOME]), "b 1");
    }

    #[test]
    fn a_robot_without_a_team_comes_back_into_its_own() {
        let lone = "t1: a, t2: c d, : b";
        assert_eq!(returned(&[HOME, lone]), "");
        assert_eq!(returned(&[HOME, lone, HOME]), "b 1");
        // To be without a team again is no return.
        assert_eq!(returned(&[lone, HOME, lone]), "");
    }

    #[test]
    fn teams_that_split_and_merge_are_changes_like_others() {
        let three = |id: &str| format!("t1: a b, t2: c, {id}: d");
        let (third, fourth) = (three("t3"), three("t4"));
        assert_eq!(returned(&[HOME, &third, HOME, &fourth, HOME]), "d 2");
        // A team that takes over another's robots and gets a name of its own is no return.
        assert_eq!(returned(&[HOME, "t1: a b, t5: c d", "t1: a b, t6: c d"]), "");
    }

    #[test]
    fn robots_that_join_and_leave_make_no_return() {
        let without = "t1: a, t2: c d";
        assert_eq!(returned(&[HOME, without, HOME]), "");
        assert_eq!(returned(&[HOME, AWAY, HOME, without]), "", "what it did counts no longer");
        assert_eq!(returned(&[HOME, AWAY, without, HOME]), "");
    }

    #[test]
    fn a_missed_division_hides_changes_and_invents_none() {
        let elsewhere = "t1: a, t2: c d, t3: b";
        // Of HOME, AWAY, elsewhere, HOME one or both in the middle are missed.
        assert_eq!(returned(&[HOME, elsewhere, HOME]), "b 1");
        assert_eq!(returned(&[HOME, HOME]), "");
    }

    #[test]
    fn the_rate_is_per_robot_and_minute_observed() {
        let rate = |divisions: &[&str], second| {
            watched(divisions).flapping(at(second)).returns_per_robot_minute
        };
        let near = |left: f64, right: f64| assert!((left - right).abs() < 1e-12, "{left} {right}");
        near(FlappingWindow::default().flapping(at(5.0)).returns_per_robot_minute, 0.0);
        near(rate(&[HOME, AWAY], 1.0), 0.0);
        // One return of four robots: over the shortest time, over half a minute, over the window.
        let once = [HOME, AWAY, HOME];
        near(rate(&once, 2.0), 1.5);
        near(rate(&once, 10.0), 1.5);
        near(rate(&once, 30.0), 0.5);
        near(rate(&once, 60.0), 0.25);
        near(rate(&once, 62.0), 0.0);
        // Robots without a team are robots of the fleet.
        near(
            rate(&["t1: a b, t2: c, : d", "t1: a, t2: b c, : d", "t1: a b, t2: c, : d"], 30.0),
            0.5,
        );
    }

    #[test]
    fn the_window_forgets_by_time_alone() {
        let mut window = watched(&[HOME, AWAY, HOME, AWAY]);
        assert_eq!(window.falls_at(), Some(at(62.0)));
        assert_eq!(window.flapping(at(61.9)).robots[0].returns, 2);
        assert_eq!(window.flapping(at(62.0)).robots[0].returns, 1);
        assert_eq!(window.falls_at(), Some(at(63.0)));
        assert_eq!(window.flapping(at(63.0)), Flapping::default());
        assert_eq!((window.falls_at(), window.robots()), (None, 0));
        // It left t1 too long ago.
        window.observe(at(70.0), division(HOME));
        assert_eq!(window.flapping(at(70.0)), Flapping::default());
    }

    #[test]
    fn the_memory_of_a_robot_is_bounded() {
        let mut window = FlappingWindow::default();
        for number in 0..1000_u32 {
            let team = format!("t{}: a, t0: b", number % 7 + 1);
            window.observe(at(f64::from(number) * 0.01), division(&team));
        }
        let track = &window.tracks[&RobotId::new("a").unwrap()];
        assert_eq!((track.left.len(), track.returns.len()), (6, MAX_RETURNS));
        for number in 0..100_u32 {
            window.observe(at(10.0), division(&format!("t{}: a, t0: b", number + 100)));
        }
        assert_eq!(window.tracks[&RobotId::new("a").unwrap()].left.len(), MAX_LEFT_TEAMS);
    }

    #[test]
    fn the_robots_with_most_returns_are_listed() {
        let names: Vec<_> = (0..20).map(|number| format!("r{number:02}")).collect();
        let all = names.join(" ");
        let last = &names[19];
        let (home, away) = (format!("t1: a {all}, t2: y"), format!("t1: a, t2: {all} y"));
        let alone = format!("t1: a {}, t2: {last} y", names[..19].join(" "));
        let mut window = watched(&[&home, &away, &home, &alone, &home]);
        let robots = window.flapping(at(4.0)).robots;
        assert_eq!(robots.len(), MAX_FLAPPING_ROBOTS);
        assert_eq!((robots[0].robot.as_str(), robots[0].returns), ("r19", 3));
        assert_eq!((robots[1].robot.as_str(), robots[1].returns), ("r00", 1));
    }
}
