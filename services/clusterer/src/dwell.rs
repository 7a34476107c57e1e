//! How long a change must last before it is published: of the number of teams, and of a robot's team.
//!
//! Everything here is a small state machine that is given the time. What is remembered is at most one entry
//! per robot of the last division or roster.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_division::number::best_number;
use muster_model::id::{RobotId, TeamId};
use muster_model::settings::TeamCount;
use muster_model::teams::{HeldRobot, Teams};
use muster_model::time::Tick;

/// How long another number of teams must be the best one before it is used: a few frames of a fleet, so that
/// one frame of bad data divides nobody, and a split is still followed within a second.
pub(crate) const TEAM_COUNT_DWELL: Duration = Duration::from_millis(400);

/// The number of teams of one division after the other.
#[derive(Debug, Default)]
pub(crate) struct CountDwell {
    /// Another number than the current one, and since when it is the best.
    candidate: Option<(u32, Tick)>,
    due: Option<Tick>,
}

impl CountDwell {
    /// How many teams the next division has. `shown` is the number by the newest embedding, none if it has no
    /// evidence, `current` is the number of the last division, none if there is none to go on from. What operators have
    /// asked for since counts at once.
    pub(crate) fn decide(
        &mut self,
        now: Tick,
        wanted: TeamCount,
        shown: Option<u32>,
        current: Option<u32>,
        is_asked_for: bool,
    ) -> u32 {
        self.due = None;
        let range = wanted.range();
        let current = current.filter(|teams| range.contains(teams));
        let best = best_number(wanted, shown, current);
        let Some(current) = current.filter(|current| *current != best && !is_asked_for) else {
            self.candidate = None;
            return best;
        };
        let since = self.candidate.filter(|(teams, _)| *teams == best).map_or(now, |(_, at)| at);
        self.candidate = Some((best, since));
        let due = since.after(TEAM_COUNT_DWELL);
        if now >= due {
            return best;
        }
        self.due = Some(due);
        current
    }

    /// When the decision may be another one although nothing changes.
    pub(crate) fn due(&self) -> Option<Tick> {
        self.due
    }
}

/// A move that has not lasted for long enough.
#[derive(Debug, Clone)]
struct Pending {
    /// The other team …
    to: TeamId,
    /// … and since when every division says so.
    since: Tick,
    /// Whether it began as other robots had just left.
    is_by_loss: bool,
}

/// What has become of other robots.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Losses {
    /// Until when moves that begin are taken for a consequence; none if no robots have left.
    pub(crate) show_until: Option<Tick>,
    /// Whether a whole team is absent.
    pub(crate) is_team_absent: bool,
    /// Whether the new division was to leave all robots in their team, whatever their vectors are.
    pub(crate) all_stay: bool,
}

/// Robots that a new division puts into another team, but not yet for long enough.
#[derive(Debug, Default)]
pub(crate) struct MoveDwell {
    pending: BTreeMap<RobotId, Pending>,
    losses: Losses,
}

impl MoveDwell {
    /// The moves that an earlier leader held back because robots had left.
    pub(crate) fn resumed(now: Tick, held: &[HeldRobot]) -> Self {
        let pending = held.iter().map(|held| {
            (held.robot.clone(), Pending { to: held.team.clone(), since: now, is_by_loss: true })
        });
        Self { pending: pending.collect(), losses: Losses::default() }
    }

    /// Which robots stay in their team of the division before, although the new division has them in another.
    ///
    /// A change counts at once where the number of teams has changed, where one of the two teams is in only one
    /// of the divisions, where the robot had no team or has none, and where it has new orders. What the loss of other
    /// robots has caused waits until no more are about to leave, and while a whole team is absent: its return would undo it.
    /// No team is left without a robot by those who stay.
    pub(crate) fn hold(
        &mut self,
        now: Tick,
        dwell: Duration,
        new: &Teams,
        before: Option<&Teams>,
        renewed: &BTreeSet<&RobotId>,
        losses: Losses,
    ) -> BTreeMap<RobotId, TeamId> {
        self.losses = losses;
        let losses_show = losses.show_until.is_some_and(|until| now < until);
        let all_stay =
            losses.all_stay && before.is_none_or(|before| !moves_any(before, new, renewed));
        if all_stay {
            // It says nothing of moves that others before it have begun.
            return BTreeMap::new();
        }
        let pending = std::mem::take(&mut self.pending);
        let mut held = BTreeMap::new();
        let Some(before) = before.filter(|before| {
            before.requested == new.requested && before.teams.len() == new.teams.len()
        }) else {
            return held;
        };
        let old: BTreeMap<&RobotId, &TeamId> = before.assignments().collect();
        let known: BTreeSet<&TeamId> = before.teams.iter().map(|team| &team.id).collect();
        let living: BTreeSet<&TeamId> = new.teams.iter().map(|team| &team.id).collect();
        for (robot, to) in new.assignments() {
            let from = old.get(robot).filter(|from| **from != to && living.contains(*from));
            let Some(from) = from.filter(|_| known.contains(to) && !renewed.contains(robot)) else {
                continue;
            };
            let last = pending.get(robot).filter(|last| last.to == *to);
            let is_by_loss = last.map_or(losses_show, |last| last.is_by_loss);
            let since = last.map_or(now, |last| last.since);
            let moves = Pending { to: to.clone(), since, is_by_loss };
            let waits = is_by_loss && (losses.is_team_absent || losses_show);
            if waits || now < since.after(dwell) {
                self.pending.insert(robot.clone(), moves);
                held.insert(robot.clone(), (*from).clone());
            }
        }
        self.release_into_empty(new, &mut held);
        held
    }

    /// Lets robots go into teams that would have no robot without them.
    fn release_into_empty(&mut self, new: &Teams, held: &mut BTreeMap<RobotId, TeamId>) {
        while !held.is_empty() {
            let filled: BTreeSet<&TeamId> =
                new.assignments().map(|(robot, team)| held.get(robot).unwrap_or(team)).collect();
            let empty = new.teams.iter().find(|team| !filled.contains(&team.id));
            let Some(empty) = empty else { return };
            for member in &empty.members {
                held.remove(&member.robot);
                self.pending.remove(&member.robot);
            }
        }
    }

    /// Only these robots stay after all.
    pub(crate) fn keep(&mut self, held: &BTreeMap<RobotId, TeamId>) {
        self.pending.retain(|robot, _| held.contains_key(robot));
    }

    /// When the first robot that stays has stayed for long enough.
    pub(crate) fn due(&self, dwell: Duration) -> Option<Tick> {
        let waits = |moves: &&Pending| !(moves.is_by_loss && self.losses.is_team_absent);
        let due = |moves: &Pending| {
            let due = moves.since.after(dwell);
            let recent = self.losses.show_until.filter(|_| moves.is_by_loss);
            recent.map_or(due, |until| due.max(until))
        };
        self.pending.values().filter(waits).map(due).min()
    }

    /// How many robots stay.
    pub(crate) fn robot_count(&self) -> usize {
        self.pending.len()
    }
}

/// Whether a robot without new orders is in another team than before.
fn moves_any(before: &Teams, new: &Teams, renewed: &BTreeSet<&RobotId>) -> bool {
    let old: BTreeMap<&RobotId, &TeamId> = before.assignments().collect();
    let is_elsewhere = |robot, team| old.get(robot).is_some_and(|last| *last != team);
    new.assignments().any(|(robot, team)| is_elsewhere(robot, team) && !renewed.contains(robot))
}

#[cfg(test)]
pub(crate) mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::FleetId;
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::{Member, Team};

    use super::*;

    const DWELL: Duration = Duration::from_millis(500);

    fn at(ms: u64) -> Tick {
        Tick::default().after(Duration::from_millis(1_000_000 + ms))
    }

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn header() -> Header {
        Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: vec![],
        }
    }

    /// A division: teams as `("t1", "a b c")`.
    pub(crate) fn division(teams: &[(&str, &str)]) -> Teams {
        let teams: Vec<Team> = teams
            .iter()
            .map(|(id, names)| {
                let names = names.split_whitespace();
                let members: Vec<_> =
                    names.map(|name| Member { robot: robot(name), margin: 0.5 }).collect();
                let leader = members[0].robot.clone();
                Team { id: TeamId::new(*id).unwrap(), leader, members, centroid: vec![] }
            })
            .collect();
        Teams {
            header: header(),
            embedding: Revision::default(),
            requested: u32::try_from(teams.len()).unwrap(),
            considered: vec![],
            teams,
            unassigned: vec![],
            stale: vec![],
            inertia: 0.0,
            changes: vec![],
            next_team: 9,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams::default(),
        }
    }

    /// Who stays, as `a>t1`.
    fn held(dwell: &mut MoveDwell, ms: u64, new: &Teams, before: &Teams, renewed: &str) -> String {
        let renewed: Vec<RobotId> = renewed.split_whitespace().map(robot).collect();
        let renewed = renewed.iter().collect();
        let held = dwell.hold(at(ms), DWELL, new, Some(before), &renewed, Losses::default());
        assert_eq!(dwell.robot_count(), held.len());
        held.iter().map(|(robot, team)| format!("{robot}>{team}")).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn a_robot_that_flips_stays() {
        let before = division(&[("t1", "a b m"), ("t2", "y z")]);
        let other = division(&[("t1", "a b"), ("t2", "m y z")]);
        let mut dwell = MoveDwell::default();
        for step in 0..100 {
            let new = if step % 2 == 0 { &other } else { &before };
            let wanted = if step % 2 == 0 { "m>t1" } else { "" };
            assert_eq!(held(&mut dwell, 300 * step, new, &before, ""), wanted);
        }
    }

    #[test]
    fn a_change_that_lasts_counts_after_the_dwell() {
        let before = division(&[("t1", "a b m"), ("t2", "y z")]);
        let other = division(&[("t1", "a b"), ("t2", "m y z")]);
        let mut dwell = MoveDwell::default();
        for ms in [0, 100, 499] {
            assert_eq!(held(&mut dwell, ms, &other, &before, ""), "m>t1");
            assert_eq!(dwell.due(DWELL), Some(at(500)));
        }
        assert_eq!(held(&mut dwell, 500, &other, &before, ""), "");
        assert_eq!(dwell.due(DWELL), None);
        // A third team begins anew.
        let before = division(&[("t1", "a b m"), ("t2", "y z"), ("t3", "p q")]);
        let second = division(&[("t1", "a b"), ("t2", "m y z"), ("t3", "p q")]);
        let third = division(&[("t1", "a b"), ("t2", "y z"), ("t3", "m p q")]);
        assert_eq!(held(&mut dwell, 1000, &second, &before, ""), "m>t1");
        assert_eq!(held(&mut dwell, 1400, &third, &before, ""), "m>t1");
        assert_eq!(held(&mut dwell, 1800, &third, &before, ""), "m>t1");
        assert_eq!(held(&mut dwell, 1900, &third, &before, ""), "");
        let losses = Losses::default();
        let none =
            dwell.hold(at(0), Duration::ZERO, &third, Some(&before), &BTreeSet::new(), losses);
        assert!(none.is_empty(), "no time is no dwell");
    }

    #[test]
    fn what_is_no_noise_counts_at_once() {
        let before = division(&[("t1", "a b m"), ("t2", "y z")]);
        let other = division(&[("t1", "a b"), ("t2", "m y z")]);
        let mut dwell = MoveDwell::default();
        assert_eq!(held(&mut dwell, 0, &other, &before, "m"), "", "it has new orders");
        let more = division(&[("t1", "a b"), ("t2", "y z"), ("t3", "m")]);
        assert_eq!(held(&mut dwell, 0, &more, &before, ""), "", "there are more teams");
        let reborn = division(&[("t1", "a b"), ("t3", "m y z")]);
        assert_eq!(held(&mut dwell, 0, &reborn, &before, ""), "", "a team was born");
        let dead = division(&[("t2", "a b"), ("t3", "m y z")]);
        assert_eq!(held(&mut dwell, 0, &dead, &before, ""), "", "the old team is dead");
        let joined = division(&[("t1", "a b m"), ("t2", "n y z")]);
        assert_eq!(held(&mut dwell, 0, &joined, &before, ""), "", "it had no team");
        let losses = Losses::default();
        assert!(dwell.hold(at(0), DWELL, &other, None, &BTreeSet::new(), losses).is_empty());
        // Robots that leave are forgotten.
        assert_eq!(held(&mut dwell, 0, &other, &before, ""), "m>t1");
        let left = division(&[("t1", "a b"), ("t2", "y z")]);
        assert_eq!(held(&mut dwell, 0, &left, &before, ""), "");
        assert_eq!(dwell.robot_count(), 0);
    }

    #[test]
    fn what_the_loss_of_a_team_causes_waits_until_it_is_not_absent_any_more() {
        let before = division(&[("t1", "a b m"), ("t2", "y z n")]);
        let other = division(&[("t1", "a b"), ("t2", "m y z n")]);
        let both = division(&[("t1", "a b n"), ("t2", "m y z")]);
        let mut dwell = MoveDwell::default();
        let mut held = |ms, new: &Teams, show_until: Option<u64>, is_team_absent| {
            let show_until = show_until.map(at);
            let losses = Losses { show_until, is_team_absent, all_stay: false };
            let held = dwell.hold(at(ms), DWELL, new, Some(&before), &BTreeSet::new(), losses);
            let held: Vec<String> = held.keys().map(ToString::to_string).collect();
            (held.join(" "), dwell.due(DWELL))
        };
        let m = "m".to_owned();
        assert_eq!(held(0, &other, Some(6_000), true), (m.clone(), None));
        assert_eq!(held(9_000, &other, Some(6_000), true), (m.clone(), None));
        // What begins later has another cause.
        assert_eq!(held(9_100, &both, Some(6_000), true), ("m n".to_owned(), Some(at(9_600))));
        assert_eq!(held(9_600, &both, Some(6_000), true), (m, None));
        assert_eq!(held(9_700, &other, Some(6_000), false), (String::new(), None));
        // Without a whole team that is absent it waits until no more robots are about to leave.
        assert_eq!(held(20_000, &other, Some(26_000), false), ("m".to_owned(), Some(at(26_000))));
        assert_eq!(held(26_000, &other, Some(26_000), false), (String::new(), None));
    }

    #[test]
    fn moves_that_an_earlier_leader_held_back_for_an_absent_team_wait_for_it() {
        let before = division(&[("t1", "a b m"), ("t2", "y z")]);
        let other = division(&[("t1", "a b"), ("t2", "m y z")]);
        let held = [HeldRobot { robot: robot("m"), team: TeamId::new("t2").unwrap() }];
        for (is_team_absent, later) in [(true, 1), (false, 0)] {
            let mut dwell = MoveDwell::resumed(at(0), &held);
            let losses = Losses { is_team_absent, ..Losses::default() };
            for (ms, count) in [(0, 1), (9000, later)] {
                let held =
                    dwell.hold(at(ms), DWELL, &other, Some(&before), &BTreeSet::new(), losses);
                assert_eq!(held.len(), count, "{is_team_absent} after {ms} ms");
            }
        }
    }

    #[test]
    fn a_division_in_which_all_stay_ends_no_move_that_has_begun() {
        let before = division(&[("t1", "a b m"), ("t2", "y z")]);
        let other = division(&[("t1", "a b"), ("t2", "m y z")]);
        let mut dwell = MoveDwell::default();
        let staying = Losses { all_stay: true, ..Losses::default() };
        for (ms, new, losses, count) in [
            (0, &other, Losses::default(), 1),
            (100, &before, staying, 0),
            (400, &before, staying, 0),
            (499, &other, Losses::default(), 1),
            (500, &other, Losses::default(), 0),
        ] {
            let held = dwell.hold(at(ms), DWELL, new, Some(&before), &BTreeSet::new(), losses);
            assert_eq!(held.len(), count, "after {ms} ms");
        }
        // Robots in the same place may be fewer teams than are asked for, so that not all can stay.
        let mut dwell = MoveDwell::default();
        let held = dwell.hold(at(0), DWELL, &other, Some(&before), &BTreeSet::new(), staying);
        assert_eq!(held.len(), 1);
    }

    #[test]
    fn no_team_is_left_without_a_robot() {
        // The robots of t1 have left, and those of t2 are shared out over both.
        let before = division(&[("t1", "a b"), ("t2", "p q y z")]);
        let new = division(&[("t1", "p q"), ("t2", "y z")]);
        let mut dwell = MoveDwell::default();
        assert_eq!(held(&mut dwell, 0, &new, &before, ""), "");
        let circle = division(&[("t1", "p q y z"), ("t2", "a b")]);
        assert_eq!(held(&mut dwell, 0, &circle, &before, ""), "a>t1 b>t1 p>t2 q>t2 y>t2 z>t2");
    }

    #[test]
    fn another_number_of_teams_must_last() {
        let mut dwell = CountDwell::default();
        let (two, three) = (Some(2), Some(3));
        let mut next = |ms, wanted, shown, current| {
            (dwell.decide(at(ms), wanted, shown, current, false), dwell.due())
        };
        let auto = TeamCount::Auto;
        assert_eq!(next(0, auto, two, None), (2, None), "the first at once");
        assert_eq!(next(100, auto, three, Some(2)), (2, Some(at(500))));
        assert_eq!(next(200, auto, two, Some(2)), (2, None));
        assert_eq!(next(300, auto, three, Some(2)), (2, Some(at(700))));
        assert_eq!(next(699, auto, three, Some(2)), (2, Some(at(700))));
        assert_eq!(next(700, auto, three, Some(2)), (3, None));
        assert_eq!(next(800, auto, None, Some(3)), (3, None), "nothing to choose by");
        assert_eq!(next(800, auto, None, None), (1, None));
        // Settings are obeyed at once.
        assert_eq!(next(900, TeamCount::Fixed(5), two, Some(3)), (5, None));
        assert_eq!(next(900, TeamCount::Between { from: 2, to: 2 }, three, Some(3)), (2, None));
        assert_eq!(next(900, TeamCount::Between { from: 4, to: 6 }, three, Some(3)), (4, None));
        assert_eq!(next(900, auto, Some(u32::MAX), None), (16, None), "within the range");
        // So is what follows from them.
        assert_eq!(next(1000, auto, three, Some(2)), (2, Some(at(1400))));
        assert_eq!(dwell.decide(at(1001), auto, three, two, true), 3);
        assert_eq!(dwell.due(), None);
    }
}
