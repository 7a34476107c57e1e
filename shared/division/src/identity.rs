//! Lasting team ids, and what changed since the division before.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::id::{RobotId, TeamId};
use muster_model::teams::{Team, TeamChange, Teams};
use muster_numeric::matching::{MatchError, match_by_overlap};

pub(crate) use crate::memory::Memory;

/// The names of the clusters.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Named {
    /// The id of each cluster.
    pub(crate) ids: Vec<TeamId>,
    /// What changed: teams first, then robots, each in order.
    pub(crate) changes: Vec<TeamChange>,
    /// The number that the next new team will get.
    pub(crate) next_team: u64,
}

/// How team ids are ordered: numbered ones by number, others after them by name.
pub(crate) fn order(id: &TeamId) -> (u64, &str) {
    match number(id) {
        Some(number) => (number, ""),
        None => (u64::MAX, id.as_str()),
    }
}

/// The number of an id that [`TeamId::numbered`] made.
pub(crate) fn number(id: &TeamId) -> Option<u64> {
    let digits = id.as_str().strip_prefix('t')?;
    let number = digits.parse().ok()?;
    // `t01` and `t+1` are names, not numbers.
    (TeamId::numbered(number) == *id).then_some(number)
}

/// The end of the numbers that are believed of others. A fleet that forms a thousand teams a second gets there
/// in nine thousand years; a forged message that names the last number of all would leave none to be given.
const MAX_BELIEVED_NUMBER: u64 = 1 << 48;

/// The end of the numbers that are read from disk: what is believed, and room for what was reserved beyond it. A
/// file with a higher one would leave none to be given, restart after restart.
pub const MAX_KEPT_NUMBER: u64 = 2 * MAX_BELIEVED_NUMBER;

/// Whether the numbers of a division of another instance leave some to be given.
pub fn is_believable(teams: &Teams) -> bool {
    let living = teams.teams.iter().map(|team| &team.id);
    let last = teams.remembered.last.iter().map(|(_, team)| team);
    let ended = teams.remembered.ended.iter().map(|(team, _)| team);
    let mut numbers = living.chain(last).chain(ended).filter_map(number);
    teams.next_team <= MAX_BELIEVED_NUMBER && numbers.all(|number| number < MAX_BELIEVED_NUMBER)
}

/// The weight of a robot of a living team against one of a team that ended: on a tie the living team wins.
const LIVING: u64 = 2;

/// Gives each cluster the id of the team with which it shares most robots, and new numbers, in order, to
/// clusters without such a team.
///
/// A robot without a team counts for its last one, as long as that is remembered. A team that ended is
/// revived under its id if most of its present robots are most of a cluster; that is reported as a birth, or
/// as a split where most robots come from a living team.
pub(crate) fn name(
    clusters: &[Vec<&RobotId>],
    unassigned: &[RobotId],
    previous: Option<&Teams>,
    memory: &Memory,
) -> Result<Named, MatchError> {
    let teams = previous.map_or(&[][..], |previous| &previous.teams);
    let old_of: BTreeMap<&RobotId, usize> = teams
        .iter()
        .enumerate()
        .flat_map(|(number, team)| team.members.iter().map(move |m| (&m.robot, number)))
        .collect();
    let number_of: BTreeMap<&TeamId, usize> =
        teams.iter().enumerate().map(|(number, team)| (&team.id, number)).collect();
    let mut overlap = vec![vec![0_u64; teams.len()]; clusters.len()];
    let mut votes = overlap.clone();
    for ((row, votes), robots) in overlap.iter_mut().zip(&mut votes).zip(clusters) {
        for robot in robots {
            if let Some(old) = old_of.get(robot) {
                row[*old] += 1;
                votes[*old] += LIVING;
            } else if let Some(last) = memory.last_team(robot).and_then(|id| number_of.get(id)) {
                votes[*last] += LIVING;
            }
        }
    }
    let ended: Vec<(&TeamId, usize, u64)> = memory
        .revivable(clusters, unassigned)
        .into_iter()
        .filter(|(id, ..)| !number_of.contains_key(id))
        .collect();
    for (at, (_, cluster, shared)) in ended.iter().enumerate() {
        for (number, votes) in votes.iter_mut().enumerate() {
            debug_assert_eq!(votes.len(), teams.len() + at);
            votes.push(if number == *cluster { *shared } else { 0 });
        }
    }
    let matched = match_by_overlap(&votes)?;

    let mut numbers = Numbers::after(previous, memory);
    let ids: Vec<TeamId> = matched
        .iter()
        .map(|heir| match heir {
            None => numbers.next(),
            Some(old) => teams
                .get(*old)
                .map_or_else(|| ended[*old - teams.len()].0.clone(), |team| team.id.clone()),
        })
        .collect();
    let heirs: Vec<Option<usize>> =
        matched.into_iter().map(|heir| heir.filter(|old| *old < teams.len())).collect();

    let mut changes = team_changes(clusters, unassigned, &overlap, &heirs, &ids, teams);
    if let Some(previous) = previous {
        changes.extend(moves(clusters, unassigned, &ids, previous));
    }
    Ok(Named { ids, changes, next_team: numbers.next })
}

/// The changes from one division to the next, whose clusters have their ids already, and the number that the next new
/// team will get.
pub(crate) fn named(
    clusters: &[Vec<&RobotId>],
    ids: Vec<TeamId>,
    unassigned: &[RobotId],
    previous: Option<&Teams>,
    memory: &Memory,
) -> Named {
    let teams = previous.map_or(&[][..], |previous| &previous.teams);
    let number_of: BTreeMap<&TeamId, usize> =
        teams.iter().enumerate().map(|(number, team)| (&team.id, number)).collect();
    let old_of: BTreeMap<&RobotId, usize> = teams
        .iter()
        .enumerate()
        .flat_map(|(number, team)| team.members.iter().map(move |m| (&m.robot, number)))
        .collect();
    let mut overlap = vec![vec![0_u64; teams.len()]; clusters.len()];
    for (row, robots) in overlap.iter_mut().zip(clusters) {
        for old in robots.iter().filter_map(|robot| old_of.get(robot)) {
            row[*old] += 1;
        }
    }
    let heirs: Vec<Option<usize>> = ids.iter().map(|id| number_of.get(id).copied()).collect();
    let mut changes = team_changes(clusters, unassigned, &overlap, &heirs, &ids, teams);
    if let Some(previous) = previous {
        changes.extend(moves(clusters, unassigned, &ids, previous));
    }
    let highest = ids.iter().filter_map(number).max().unwrap_or(0);
    let next_team = Numbers::after(previous, memory).next.max(highest.saturating_add(1));
    Named { ids, changes, next_team }
}

/// Gives numbers that no team has or had.
pub(crate) struct Numbers<'a> {
    next: u64,
    used: BTreeSet<&'a TeamId>,
}

impl<'a> Numbers<'a> {
    /// Those that are left after a division.
    pub(crate) fn after(previous: Option<&'a Teams>, memory: &'a Memory) -> Self {
        let teams = previous.map_or(&[][..], |previous| &previous.teams);
        let highest = teams.iter().filter_map(|team| number(&team.id)).max().unwrap_or(0);
        let next = previous.map_or(1, |previous| previous.next_team).max(memory.next_team);
        let used = teams.iter().map(|team| &team.id).chain(memory.ended.keys()).collect();
        Self { next: next.max(highest.saturating_add(1)).max(1), used }
    }

    /// The lowest that may be left.
    pub(crate) fn first(&self) -> u64 {
        self.next
    }

    /// The next one.
    pub(crate) fn next(&mut self) -> TeamId {
        loop {
            let id = TeamId::numbered(self.next);
            // Wraps only if a message has named a number near the end of the range.
            self.next = self.next.wrapping_add(1);
            if !self.used.contains(&id) {
                return id;
            }
        }
    }
}

/// Births, splits, mergers and deaths, ordered by the team that they are about.
fn team_changes(
    clusters: &[Vec<&RobotId>],
    unassigned: &[RobotId],
    overlap: &[Vec<u64>],
    heirs: &[Option<usize>],
    ids: &[TeamId],
    teams: &[Team],
) -> Vec<TeamChange> {
    let mut lives = vec![false; teams.len()];
    for old in heirs.iter().flatten() {
        lives[*old] = true;
    }
    let mut changes: Vec<(&TeamId, TeamChange)> = Vec::new();
    for ((row, robots), (heir, id)) in overlap.iter().zip(clusters).zip(heirs.iter().zip(ids)) {
        if heir.is_some() {
            continue;
        }
        let most = majority(row.iter().copied(), robots.len()).filter(|old| lives[*old]);
        let change = match most {
            Some(old) => TeamChange::Split { from: teams[old].id.clone(), into: id.clone() },
            None => TeamChange::Born { team: id.clone() },
        };
        changes.push((id, change));
    }
    for (old, team) in teams.iter().enumerate().filter(|(old, _)| !lives[*old]) {
        let placed: u64 = overlap.iter().map(|row| row[old]).sum();
        let loose = team.members.iter().filter(|m| unassigned.binary_search(&m.robot).is_ok());
        let left = usize::try_from(placed).unwrap_or(usize::MAX).saturating_add(loose.count());
        let change = match majority(overlap.iter().map(|row| row[old]), left) {
            Some(new) => TeamChange::Merged { from: team.id.clone(), into: ids[new].clone() },
            None => TeamChange::Died { team: team.id.clone() },
        };
        changes.push((&team.id, change));
    }
    changes.sort_by(|left, right| order(left.0).cmp(&order(right.0)));
    changes.into_iter().map(|(_, change)| change).collect()
}

/// The place of the count that is more than half of the total.
fn majority(counts: impl Iterator<Item = u64>, total: usize) -> Option<usize> {
    counts
        .enumerate()
        .find(|(_, count)| u128::from(*count) * 2 > total as u128)
        .map(|(place, _)| place)
}

/// Robots that were there before and are now elsewhere, ordered by name.
fn moves(
    clusters: &[Vec<&RobotId>],
    unassigned: &[RobotId],
    ids: &[TeamId],
    previous: &Teams,
) -> Vec<TeamChange> {
    let mut now: BTreeMap<&RobotId, Option<&TeamId>> =
        unassigned.iter().map(|robot| (robot, None)).collect();
    for (robots, id) in clusters.iter().zip(ids) {
        now.extend(robots.iter().map(|robot| (*robot, Some(id))));
    }
    let assigned = previous.assignments().map(|(robot, team)| (robot, Some(team)));
    let before = assigned.chain(previous.unassigned.iter().map(|robot| (robot, None)));
    let mut moved: Vec<TeamChange> = before
        .filter_map(|(robot, from)| {
            let to = *now.get(robot)?;
            (from != to).then(|| TeamChange::Moved {
                robot: robot.clone(),
                from: from.cloned(),
                to: to.cloned(),
            })
        })
        .collect();
    moved.sort_by(|left, right| robot_of(left).cmp(&robot_of(right)));
    moved
}

/// Robots of a division that were elsewhere in the one before, ordered by name.
pub fn moved(new: &Teams, before: &Teams) -> Vec<TeamChange> {
    let clusters: Vec<Vec<&RobotId>> =
        new.teams.iter().map(|team| team.members.iter().map(|m| &m.robot).collect()).collect();
    let ids: Vec<TeamId> = new.teams.iter().map(|team| team.id.clone()).collect();
    moves(&clusters, &new.unassigned, &ids, before)
}

fn robot_of(change: &TeamChange) -> Option<&RobotId> {
    match change {
        TeamChange::Moved { robot, .. } => Some(robot),
        _ => None,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::FleetId;
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::{Member, Team};

    use super::*;

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn team(id: &str) -> TeamId {
        TeamId::new(id).unwrap()
    }

    /// A division: teams as `("t1", "a b c")`, robots without a team, the next number.
    pub(crate) fn division(teams: &[(&str, &str)], unassigned: &str, next_team: u64) -> Teams {
        let header = Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: vec![],
        };
        let teams = teams.iter().map(|(id, names)| {
            let members: Vec<Member> = names
                .split_whitespace()
                .map(|name| Member { robot: robot(name), margin: 0.5 })
                .collect();
            Team { id: team(id), leader: members[0].robot.clone(), members, centroid: vec![] }
        });
        Teams {
            header,
            embedding: Revision::default(),
            requested: 2,
            considered: vec![],
            teams: teams.collect(),
            unassigned: unassigned.split_whitespace().map(robot).collect(),
            stale: vec![],
            inertia: 0.0,
            changes: vec![],
            next_team,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams::default(),
        }
    }

    fn named(clusters: &[&str], unassigned: &str, previous: Option<&Teams>) -> Named {
        let robots: Vec<Vec<RobotId>> =
            clusters.iter().map(|names| names.split_whitespace().map(robot).collect()).collect();
        let clusters: Vec<Vec<&RobotId>> = robots.iter().map(|r| r.iter().collect()).collect();
        let unassigned: Vec<RobotId> = unassigned.split_whitespace().map(robot).collect();
        name(&clusters, &unassigned, previous, &Memory::default()).unwrap()
    }

    fn ids(named: &Named) -> Vec<&str> {
        named.ids.iter().map(TeamId::as_str).collect()
    }

    fn moved(name: &str, from: Option<&str>, to: Option<&str>) -> TeamChange {
        TeamChange::Moved { robot: robot(name), from: from.map(team), to: to.map(team) }
    }

    #[test]
    fn the_first_teams_are_numbered_from_one_and_born() {
        let first = named(&["a c", "b d"], "e", None);
        assert_eq!(ids(&first), ["t1", "t2"]);
        assert_eq!(first.next_team, 3);
        let born = |id| TeamChange::Born { team: team(id) };
        assert_eq!(first.changes, [born("t1"), born("t2")]);
    }

    #[test]
    fn ids_follow_the_members_and_not_the_numbers_of_the_clusters() {
        let before = division(&[("t1", "a b c"), ("t2", "d e f")], "", 3);
        let same = named(&["d e f", "a b c"], "", Some(&before));
        assert_eq!(ids(&same), ["t2", "t1"]);
        assert_eq!((same.changes.as_slice(), same.next_team), (&[][..], 3));
        let one = named(&["a b d", "c e f"], "", Some(&before));
        assert_eq!(ids(&one), ["t1", "t2"]);
        assert_eq!(
            one.changes,
            [moved("c", Some("t1"), Some("t2")), moved("d", Some("t2"), Some("t1"))]
        );
    }

    #[test]
    fn a_part_that_leaves_is_a_split() {
        let before = division(&[("t1", "a b c d e")], "", 2);
        let split = named(&["a b", "c d e"], "", Some(&before));
        assert_eq!(ids(&split), ["t2", "t1"]);
        assert_eq!(
            split.changes,
            [
                TeamChange::Split { from: team("t1"), into: team("t2") },
                moved("a", Some("t1"), Some("t2")),
                moved("b", Some("t1"), Some("t2")),
            ]
        );
        assert_eq!(split.next_team, 3);
    }

    #[test]
    fn a_new_team_of_mostly_new_robots_is_born() {
        let before = division(&[("t1", "a b c")], "", 2);
        let born = named(&["a b", "c x y"], "", Some(&before));
        assert_eq!(ids(&born), ["t1", "t2"]);
        assert_eq!(
            born.changes,
            [TeamChange::Born { team: team("t2") }, moved("c", Some("t1"), Some("t2"))]
        );
    }

    #[test]
    fn a_team_that_ends_in_another_is_merged_and_one_that_ends_nowhere_died() {
        let before = division(&[("t1", "a b c"), ("t2", "d e"), ("t3", "f g")], "", 4);
        let merged = named(&["a b c d e"], "", Some(&before));
        assert_eq!(ids(&merged), ["t1"]);
        assert_eq!(
            merged.changes,
            [
                TeamChange::Merged { from: team("t2"), into: team("t1") },
                TeamChange::Died { team: team("t3") },
                moved("d", Some("t2"), Some("t1")),
                moved("e", Some("t2"), Some("t1")),
            ]
        );
        // Two of three have no team now: that is no merger.
        let before = division(&[("t1", "a b c d"), ("t2", "e f g")], "", 3);
        let loose = named(&["a b c d e"], "f g", Some(&before));
        assert_eq!(
            loose.changes,
            [
                TeamChange::Died { team: team("t2") },
                moved("e", Some("t2"), Some("t1")),
                moved("f", Some("t2"), None),
                moved("g", Some("t2"), None),
            ]
        );
    }

    #[test]
    fn robots_that_joined_or_left_have_not_moved() {
        let before = division(&[("t1", "a b c")], "x y", 2);
        let after = named(&["a b new x"], "y", Some(&before));
        assert_eq!(after.changes, [moved("x", None, Some("t1"))]);
    }

    #[test]
    fn a_number_is_never_given_twice() {
        let before = division(&[("t9", "a"), ("blue", "b")], "", 2);
        assert_eq!(ids(&named(&["a", "b", "c"], "", Some(&before))), ["t9", "blue", "t10"]);
        let end = division(&[("t18446744073709551615", "a")], "", u64::MAX);
        let wrapped = named(&["a", "b", "c"], "", Some(&end));
        assert_eq!(ids(&wrapped), ["t18446744073709551615", "t0", "t1"]);
    }

    #[test]
    fn teams_are_ordered_as_people_count() {
        let mut all: Vec<TeamId> =
            ["t10", "blue", "t2", "t01", "t1"].into_iter().map(team).collect();
        all.sort_by(|left, right| order(left).cmp(&order(right)));
        assert_eq!(all, ["t1", "t2", "t10", "blue", "t01"].map(team));
    }
}
