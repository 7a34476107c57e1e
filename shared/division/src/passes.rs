//! Divisions that are made again until they stay: the same vectors that are divided another time, such as after a restart, change
//! nothing.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::id::{RobotId, TeamId};
use muster_model::teams::{Limited, Member, Team, TeamChange, Teams};

use crate::identity::{self, Numbers};
use crate::memory::Memory;

/// How many divisions are made at most, each from the one before, and only where that has changed something. Each costs as much
/// as the first.
const MAX_PASSES: usize = 8;

/// What a division becomes that is made again and again.
#[derive(Debug)]
pub(crate) struct Passed {
    /// The last one, or the best one of a circle.
    pub(crate) found: Teams,
    /// Teams of it that live again, and that the robots with which they were found would leave at once; empty where it stays.
    pub(crate) left: BTreeSet<TeamId>,
}

/// The division that `found`, which follows `previous`, becomes as it is divided again, by `again`, until nothing changes any more.
/// Where a division comes back, the best one since is taken, so that it does not depend on where that began. No team is lost on the
/// way. A team that lives again keeps most of the robots with which it was found: these have given it its id.
pub(crate) fn until_it_stays(
    previous: Option<&Teams>,
    memory: &Memory,
    mut found: Teams,
    again: impl Fn(&Teams) -> Option<Teams>,
) -> Passed {
    let settled = |found| Passed { found, left: BTreeSet::new() };
    let mut earlier: Vec<Teams> = Vec::new();
    for _ in 1..MAX_PASSES {
        if previous.is_some_and(|previous| is_kept(previous, &found)) {
            break;
        }
        let Some(next) = again(&found).filter(|next| has_teams_of(next, &found)) else { break };
        let left = left_teams(previous, memory, &found, &next);
        if !left.is_empty() {
            return Passed { found, left };
        }
        if is_kept(&found, &next) {
            found.limited = next.limited;
            break;
        }
        let next = Teams { changes: changes_since(previous, memory, &next), ..next };
        earlier.push(std::mem::replace(&mut found, next));
        if let Some(at) = earlier.iter().position(|before| is_kept(before, &found)) {
            let best = earlier.into_iter().skip(at).min_by(|left, right| {
                let order = stands(left).cmp(&stands(right));
                let order = order.then(left.unassigned.len().cmp(&right.unassigned.len()));
                let order = order.then(left.inertia.total_cmp(&right.inertia));
                order.then_with(|| left.assignments().cmp(right.assignments()))
            });
            return settled(best.unwrap_or(found));
        }
    }
    settled(found)
}

/// What has changed since the division before.
fn changes_since(previous: Option<&Teams>, memory: &Memory, now: &Teams) -> Vec<TeamChange> {
    let teams = now.teams.iter().map(|team| team.members.iter().map(|member| &member.robot));
    let clusters: Vec<Vec<&RobotId>> = teams.map(Iterator::collect).collect();
    let ids = now.teams.iter().map(|team| team.id.clone()).collect();
    identity::named(&clusters, ids, &now.unassigned, previous, memory).changes
}

/// Whether a division has all teams of another one.
fn has_teams_of(now: &Teams, before: &Teams) -> bool {
    before.teams.iter().all(|team| now.teams.iter().any(|other| other.id == team.id))
}

/// Whether two divisions have teams with the same ids.
pub(crate) fn has_same_teams(left: &Teams, right: &Teams) -> bool {
    left.teams.iter().map(|team| &team.id).eq(right.teams.iter().map(|team| &team.id))
}

/// Whether nothing satisfied the rules of a division.
fn stands(teams: &Teams) -> bool {
    teams.limited.as_ref().is_some_and(Limited::stands)
}

/// Whether every robot of a division was in its team before, or in none.
fn is_kept(before: &Teams, now: &Teams) -> bool {
    let team_of: BTreeMap<&RobotId, &TeamId> = before.assignments().collect();
    now.assignments().all(|(robot, team)| team_of.get(robot) == Some(&team))
        && !now.unassigned.iter().any(|robot| team_of.contains_key(robot))
}

/// The teams that are not in the division before, but were there once, and would have half of their robots or fewer.
fn left_teams(
    previous: Option<&Teams>,
    memory: &Memory,
    before: &Teams,
    now: &Teams,
) -> BTreeSet<TeamId> {
    let last = previous.into_iter().flat_map(|last| &last.teams);
    let known: BTreeSet<&TeamId> = last.map(|team| &team.id).collect();
    let first_new = Numbers::after(previous, memory).first();
    let team_of: BTreeMap<&RobotId, &TeamId> = now.assignments().collect();
    let is_left = |team: &&Team| {
        let is_there = |member: &&Member| team_of.get(&member.robot) == Some(&&team.id);
        let kept = team.members.iter().filter(is_there).count();
        let is_new = identity::number(&team.id).is_some_and(|number| number >= first_new);
        !is_new && !known.contains(&team.id) && 2 * kept <= team.members.len()
    };
    before.teams.iter().filter(is_left).map(|team| team.id.clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::tests::division;

    /// A division with its sum of squared distances; it stands if that is below zero.
    fn found(teams: &[(&str, &str)], inertia: f64) -> Teams {
        let limited = (inertia < 0.0).then(|| Limited::standing("full".to_owned()));
        Teams { inertia, limited, ..division(teams, "", 4) }
    }

    /// Each division leads to the next one, and the last one to that with the number `back`; none refuses to be divided.
    fn settled(previous: Option<&Teams>, all: &[Teams], back: usize) -> Teams {
        let again = |from: &Teams| {
            let at = all.iter().position(|one| is_kept(one, from) && is_kept(from, one)).unwrap();
            all.get(at + 1).or(all.get(back)).cloned()
        };
        until_it_stays(previous, &Memory::default(), all[0].clone(), again).found
    }

    #[test]
    fn of_divisions_in_a_circle_the_best_is_taken() {
        let [far, near] = [(["a b", "c d"], 2.0), (["a c", "b d"], 1.0)]
            .map(|([one, two], inertia)| found(&[("t1", one), ("t2", two)], inertia));
        for all in [[far.clone(), near.clone()], [near.clone(), far.clone()]] {
            assert!(is_kept(&settled(None, &all, 0), &near));
        }
        // What stands is worse than whatever satisfies the rules.
        let standing = found(&[("t1", "a c"), ("t2", "b d")], -1.0);
        assert!(is_kept(&settled(None, &[far.clone(), standing], 0), &far));
        // The first one is not in the circle.
        let best = found(&[("t1", "a d"), ("t2", "b c")], 0.5);
        assert!(is_kept(&settled(None, &[best, far, near.clone()], 1), &near));
    }

    #[test]
    fn a_team_may_begin_on_the_way_and_none_ends() {
        let previous = found(&[("t1", "a b"), ("t2", "c")], 1.0);
        let standing = found(&[("t1", "a b c")], -1.0);
        let with_new = found(&[("t1", "a b"), ("t4", "c")], 1.0);
        let settled_with = |all: &[Teams]| settled(Some(&previous), all, all.len());
        let both = settled_with(&[standing.clone(), with_new.clone()]);
        assert!(is_kept(&both, &with_new));
        // The changes are those since the division before.
        let team = |id: &str| TeamId::new(id).unwrap();
        assert_eq!(
            both.changes,
            [
                TeamChange::Merged { from: team("t2"), into: team("t4") },
                TeamChange::Born { team: team("t4") },
                TeamChange::Moved {
                    robot: RobotId::new("c").unwrap(),
                    from: Some(team("t2")),
                    to: Some(team("t4")),
                },
            ]
        );
        assert!(is_kept(&settled_with(&[with_new.clone(), standing]), &with_new));
    }

    #[test]
    fn a_team_that_lives_again_and_would_lose_its_robots_at_once_is_named() {
        let previous = found(&[("t2", "c")], 1.0);
        let back = found(&[("t1", "a b"), ("t2", "c")], 2.0);
        let better = found(&[("t1", "c"), ("t2", "a b")], 1.0);
        let again = |_: &Teams| Some(better.clone());
        let passed = until_it_stays(Some(&previous), &Memory::default(), back.clone(), again);
        assert!(is_kept(&passed.found, &back));
        assert_eq!(passed.left, BTreeSet::from([TeamId::numbered(1)]));
        // One that was there may lose its robots.
        let passed = until_it_stays(Some(&back), &Memory::default(), better.clone(), again);
        assert!(is_kept(&passed.found, &better) && passed.left.is_empty());
    }

    #[test]
    fn what_is_as_before_is_not_divided_again() {
        let previous = found(&[("t1", "a b"), ("t2", "c d")], 2.0);
        let better = found(&[("t1", "a c"), ("t2", "b d")], 1.0);
        assert!(is_kept(&settled(Some(&previous), &[previous.clone(), better], 0), &previous));
        // A robot that has no team any more has changed.
        let without = Teams {
            unassigned: vec![RobotId::new("d").unwrap()],
            ..found(&[("t1", "a b"), ("t2", "c")], 1.0)
        };
        let elsewhere = found(&[("t1", "a b d"), ("t2", "c")], 1.0);
        let all = [without, elsewhere.clone()];
        assert!(is_kept(&settled(Some(&previous), &all, 2), &elsewhere));
    }
}
