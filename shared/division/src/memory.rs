//! Teams that robots had, remembered for a while.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::id::{RobotId, TeamId};
use muster_model::limits::{MAX_ROBOTS, MAX_TEAMS};
use muster_model::remembered::RememberedTeams;
use muster_model::teams::Teams;
use muster_model::time::Tick;

use crate::identity::number;

/// How long a robot's last team, and a team that ended, are remembered: a platoon that drives through a
/// tunnel or is restarted is back within it, and one that comes later is another platoon.
pub const TEAM_MEMORY_TIME: Duration = Duration::from_secs(60);

/// What is remembered of divisions before the last.
#[derive(Debug, Clone, Default)]
pub struct Memory {
    /// The last team of robots that have left or have none now, and when that was. At most
    /// [`MAX_ROBOTS`].
    last: BTreeMap<RobotId, (TeamId, Tick)>,
    /// Teams that ended. At most [`MAX_TEAMS`] with [`MAX_ROBOTS`] robots in all.
    pub(crate) ended: BTreeMap<TeamId, Ended>,
    /// No division that was received has this team number or a higher one.
    pub next_team: u64,
    /// Teams with this number and higher ones began when no robot was there that had been in a team before.
    newcomers_from: u64,
}

/// A team that ended.
#[derive(Debug, Clone)]
pub(crate) struct Ended {
    members: BTreeSet<RobotId>,
    at: Tick,
}

impl Memory {
    /// What the leader of a division remembered with it. How long ago all that was is not known: it counts from now.
    #[must_use]
    pub fn of(remembered: &RememberedTeams, now: Tick) -> Self {
        let RememberedTeams { last, ended, newcomers_from } = remembered;
        let last = last.iter().map(|(robot, team)| (robot.clone(), (team.clone(), now))).collect();
        let ended = ended.iter().map(|(team, members)| {
            let members = members.iter().cloned().collect();
            (team.clone(), Ended { members, at: now })
        });
        Self { last, ended: ended.collect(), next_team: 0, newcomers_from: *newcomers_from }
    }

    /// What whoever divides next is to remember.
    #[must_use]
    pub fn remembered(&self) -> RememberedTeams {
        let last = self.last.iter().map(|(robot, (team, _))| (robot.clone(), team.clone()));
        let members = |ended: &Ended| ended.members.iter().cloned().collect();
        let ended = self.ended.iter().map(|(team, ended)| (team.clone(), members(ended)));
        RememberedTeams {
            last: last.collect(),
            ended: ended.collect(),
            newcomers_from: self.newcomers_from,
        }
    }

    /// The robots that are remembered: they have left, or have no team.
    pub fn robots(&self) -> impl Iterator<Item = &RobotId> {
        self.last.keys()
    }

    /// One division follows another.
    pub fn follow(&mut self, now: Tick, before: Option<&Teams>, after: &Teams) {
        let placed: BTreeSet<&RobotId> = after.assignments().map(|(robot, _)| robot).collect();
        let living: BTreeSet<&TeamId> = after.teams.iter().map(|team| &team.id).collect();
        let mut members = before.into_iter().flat_map(Teams::assignments);
        let is_any_known = members.any(|(robot, _)| placed.contains(robot))
            || placed.iter().any(|robot| self.last.contains_key(*robot));
        if !placed.is_empty() && !is_any_known {
            self.newcomers_from = self.next_team;
        }
        if after.teams.iter().any(|team| !self.is_of_newcomers(&team.id)) {
            // Robots of before are back: all are one fleet from now on.
            self.newcomers_from = 0;
        }
        for team in before.into_iter().flat_map(|before| &before.teams) {
            for member in team.members.iter().filter(|m| !placed.contains(&m.robot)) {
                self.last.insert(member.robot.clone(), (team.id.clone(), now));
            }
            if !living.contains(&team.id) {
                let left = self.last.iter().filter(|(_, (id, _))| *id == team.id);
                let members = team.members.iter().map(|member| &member.robot);
                let members = members.chain(left.map(|(robot, _)| robot)).cloned().collect();
                self.ended.insert(team.id.clone(), Ended { members, at: now });
            }
        }
        self.last.retain(|robot, _| !placed.contains(robot));
        self.ended.retain(|id, _| !living.contains(id));
        self.next_team = self.next_team.max(after.next_team);
        self.bound();
    }

    /// Drops the oldest of what is too much.
    fn bound(&mut self) {
        if let Some(excess) = self.last.len().checked_sub(MAX_ROBOTS).filter(|excess| *excess > 0) {
            let mut ages: Vec<(Tick, RobotId)> =
                self.last.iter().map(|(robot, (_, at))| (*at, robot.clone())).collect();
            ages.sort_unstable();
            for (_, robot) in ages.into_iter().take(excess) {
                self.last.remove(&robot);
            }
        }
        let mut robots: usize = self.ended.values().map(|ended| ended.members.len()).sum();
        while self.ended.len() > MAX_TEAMS as usize || robots > MAX_ROBOTS {
            let oldest = self.ended.iter().min_by_key(|(_, ended)| ended.at);
            let Some(oldest) = oldest.map(|(id, _)| id.clone()) else { return };
            robots -= self.ended.remove(&oldest).map_or(0, |ended| ended.members.len());
        }
    }

    /// The same without some teams; none if it has none of them.
    pub(crate) fn without(&self, teams: &BTreeSet<TeamId>) -> Option<Self> {
        let mut other = self.clone();
        other.last.retain(|_, (team, _)| !teams.contains(team));
        other.ended.retain(|team, _| !teams.contains(team));
        let is_less = (other.last.len(), other.ended.len()) != (self.last.len(), self.ended.len());
        is_less.then_some(other)
    }

    /// How many robots are remembered; a robot counts once for each team that ended with it.
    pub fn robot_count(&self) -> usize {
        self.last.len() + self.ended.values().map(|ended| ended.members.len()).sum::<usize>()
    }

    /// Whether something was remembered for long enough.
    pub fn is_overdue(&self, now: Tick) -> bool {
        let times = self.last.values().map(|(_, at)| *at);
        times.chain(self.ended.values().map(|ended| ended.at)).any(|at| is_over(now, at))
    }

    /// Forgets what was remembered for long enough. A robot that left its team long before that ended is none of its robots then:
    /// most of them may be away for the rest of their time.
    pub fn forget(&mut self, now: Tick) {
        self.ended.retain(|_, ended| !is_over(now, ended.at));
        for (robot, (team, _)) in self.last.iter().filter(|(_, (_, at))| is_over(now, *at)) {
            if let Some(ended) = self.ended.get_mut(team) {
                ended.members.remove(robot);
            }
        }
        self.last.retain(|_, (_, at)| !is_over(now, *at));
    }

    /// The last team of a robot that left it.
    #[must_use]
    pub fn last_team(&self, robot: &RobotId) -> Option<&TeamId> {
        self.last.get(robot).map(|(team, _)| team)
    }

    /// Whether a team began when no robot was there that had been in a team before.
    pub(crate) fn is_of_newcomers(&self, id: &TeamId) -> bool {
        number(id).is_none_or(|number| number >= self.newcomers_from)
    }

    /// Teams that ended as their robots left: most of them are in no team since, and not all of those `reserved`.
    pub fn lost_teams<'a>(
        &'a self,
        reserved: &'a BTreeSet<&'a RobotId>,
    ) -> impl Iterator<Item = &'a TeamId> {
        let is_lost = move |(id, ended): &(&'a TeamId, &'a Ended)| {
            let left = ended.members.iter().filter(|robot| self.last_team(robot) == Some(*id));
            left.clone().count() * 2 > ended.members.len()
                && left.into_iter().any(|robot| !reserved.contains(robot))
        };
        self.ended.iter().filter(is_lost).map(|(id, _)| id)
    }

    /// Teams that ended and may be revived, each with its cluster and how many robots they share: more than
    /// half of the team's present robots, and more than half of the cluster. At most one for each cluster.
    pub(crate) fn revivable(
        &self,
        clusters: &[Vec<&RobotId>],
        unassigned: &[RobotId],
    ) -> Vec<(&TeamId, usize, u64)> {
        if self.ended.is_empty() {
            return Vec::new();
        }
        let mut place: BTreeMap<&RobotId, Option<usize>> =
            unassigned.iter().map(|robot| (robot, None)).collect();
        for (number, robots) in clusters.iter().enumerate() {
            place.extend(robots.iter().map(|robot| (*robot, Some(number))));
        }
        // Of two teams that share as many robots with a cluster, the one that these were in last; which ended last is not known
        // after a restart.
        let mut best: BTreeMap<usize, (u64, usize, Tick, &TeamId)> = BTreeMap::new();
        for (id, ended) in &self.ended {
            let places: Vec<Option<usize>> =
                ended.members.iter().filter_map(|robot| place.get(robot).copied()).collect();
            let mut shared: BTreeMap<usize, usize> = BTreeMap::new();
            for cluster in places.iter().flatten() {
                *shared.entry(*cluster).or_default() += 1;
            }
            let most = shared.into_iter().find(|(cluster, count)| {
                count * 2 > places.len() && count * 2 > clusters[*cluster].len()
            });
            if let Some((cluster, count)) = most {
                let were_last = |robot: &&RobotId| self.last_team(robot) == Some(id);
                let last = ended.members.iter().filter(were_last).count();
                let candidate = (count as u64, last, ended.at, id);
                let entry = best.entry(cluster).or_insert(candidate);
                *entry = (*entry).max(candidate);
            }
        }
        best.into_iter().map(|(cluster, (count, _, _, id))| (id, cluster, count)).collect()
    }
}

fn is_over(now: Tick, at: Tick) -> bool {
    now.since(at) >= TEAM_MEMORY_TIME
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::tests::division;

    /// A memory of `left` robots and of one ended team for each count of members; higher numbers are newer.
    fn memory(left: usize, ended: &[usize]) -> Memory {
        let robot = |number: usize| RobotId::new(format!("r{number:06}")).unwrap();
        let at = |number: usize| Tick(1000 + number as u64);
        let team = |number: usize| TeamId::numbered(number as u64);
        let ended = ended.iter().enumerate().map(|(number, members)| {
            let members = (0..*members).map(robot).collect();
            (team(number), Ended { members, at: at(number) })
        });
        Memory {
            last: (0..left).map(|number| (robot(number), (team(0), at(number)))).collect(),
            ended: ended.collect(),
            next_team: 0,
            newcomers_from: 0,
        }
    }

    #[test]
    fn the_next_process_remembers_the_same_from_its_start_on() {
        let before = memory(3, &[2, 3]);
        let after = Memory::of(&before.remembered(), Tick(5_000_000_000));
        assert_eq!((after.remembered(), after.robots().count()), (before.remembered(), 3));
        assert!(before.is_overdue(Tick(4000).after(TEAM_MEMORY_TIME)));
        assert!(!after.is_overdue(Tick(4_999_999_999).after(TEAM_MEMORY_TIME)));
        assert!(after.is_overdue(Tick(5_000_000_000).after(TEAM_MEMORY_TIME)));
    }

    #[test]
    fn a_team_is_away_for_its_whole_time_though_one_of_its_robots_left_long_before() {
        let at = |seconds| Tick(1_000_000).after(Duration::from_secs(seconds));
        let [both, one, other] = [("t1", "a b"), ("t1", "a"), ("t2", "c")];
        let mut memory = Memory::default();
        let divisions = [[both, other], [one, other]].map(|teams| division(&teams, "", 3));
        memory.follow(at(0), Some(&divisions[0]), &divisions[1]);
        memory.follow(at(20), Some(&divisions[1]), &division(&[other], "", 3));
        for (seconds, is_lost) in [(59, true), (61, true), (79, true), (80, false)] {
            memory.forget(at(seconds));
            let lost = memory.lost_teams(&BTreeSet::new()).count();
            assert_eq!(lost, usize::from(is_lost), "after {seconds} s");
        }
    }

    #[test]
    fn newcomers_are_a_fleet_of_their_own_until_earlier_robots_are_back() {
        let [first, second] = [("t1", "a"), ("t2", "b")];
        let mut memory = Memory::default();
        let (one, other) = (division(&[first], "", 2), division(&[second], "", 3));
        memory.follow(Tick(0), None, &one);
        memory.follow(Tick(1), Some(&one), &other);
        let t1 = TeamId::numbered(1);
        assert!(!memory.is_of_newcomers(&t1));
        let both = division(&[first, second], "", 3);
        memory.follow(Tick(2), Some(&other), &both);
        memory.follow(Tick(3), Some(&both), &other);
        assert!(memory.is_of_newcomers(&t1), "it has been there with them");
    }

    #[test]
    fn the_oldest_of_what_is_too_much_is_dropped() {
        let most_teams = MAX_TEAMS as usize;
        // How many robots left, the members of teams that ended; how many of both are kept.
        let cases: [(usize, Vec<usize>, usize, usize); 6] = [
            (3, vec![2, 2], 3, 2),
            (MAX_ROBOTS, vec![], MAX_ROBOTS, 0),
            (MAX_ROBOTS + 2, vec![], MAX_ROBOTS, 0),
            (0, vec![1; most_teams], 0, most_teams),
            (0, vec![1; most_teams + 3], 0, most_teams),
            (1, vec![5, MAX_ROBOTS - 4, 4], 1, 2),
        ];
        for (left, ended, kept_left, kept_ended) in cases {
            let mut memory = memory(left, &ended);
            memory.bound();
            assert_eq!((memory.last.len(), memory.ended.len()), (kept_left, kept_ended));
            let robots: usize = ended[ended.len() - kept_ended..].iter().sum();
            assert_eq!(memory.robot_count(), kept_left + robots);
            assert!(memory.robot_count() <= 2 * MAX_ROBOTS);
            let oldest_left = memory.last.values().map(|(_, at)| at.0).min();
            assert!(oldest_left.is_none_or(|at| at == 1000 + (left - kept_left) as u64));
            let oldest_ended = memory.ended.values().map(|ended| ended.at.0).min();
            assert!(oldest_ended.is_none_or(|at| at == 1000 + (ended.len() - kept_ended) as u64));
        }
    }
}
