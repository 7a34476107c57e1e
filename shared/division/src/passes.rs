//! Divisions that are made again until they stay: the same vectors that are divided another time, such as after a restart, change
//! nothing.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::id::{RobotId, TeamId};
use muster_model::teams::{Limited, Member, Team, TeamChange, Teams};

use crate::division::Job;
use crate::identity;

/// How many divisions are made at most, each from the one before, and only where that has changed something. Each costs as much
/// as the first.
const MAX_PASSES: usize = 8;

/// The division that `found`, which is that of a job, becomes as it is divided again, by `again`, until nothing changes any more.
/// Where a division comes back, the best one since is taken, so that it does not depend on where that began. No team is lost on the
/// way. A team that lives again keeps most of the robots with which it was found.
pub(crate) fn until_it_stays(
    job: &Job,
    mut found: Teams,
    again: impl Fn(&Teams) -> Option<Teams>,
) -> Teams {
    let first = job.previous.as_deref();
    let mut earlier: Vec<Teams> = Vec::new();
    for _ in 1..MAX_PASSES {
        if first.is_some_and(|first| is_kept(first, &found)) {
            break;
        }
        let next = again(&found).filter(|next| has_teams_of(next, &found));
        let Some(next) = next.filter(|next| revived_teams_stay(job, &found, next)) else { break };
        if is_kept(&found, &next) {
            found.limited = next.limited;
            break;
        }
        let next = Teams { changes: changes_since(job, &next), ..next };
        earlier.push(std::mem::replace(&mut found, next));
        if let Some(at) = earlier.iter().position(|before| is_kept(before, &found)) {
            let best = earlier.into_iter().skip(at).min_by(|left, right| {
                let order = stands(left).cmp(&stands(right));
                let order = order.then(left.unassigned.len().cmp(&right.unassigned.len()));
                let order = order.then(left.inertia.total_cmp(&right.inertia));
                order.then_with(|| left.assignments().cmp(right.assignments()))
            });
            return best.unwrap_or(found);
        }
    }
    found
}

/// What has changed since the last division of a job.
fn changes_since(job: &Job, now: &Teams) -> Vec<TeamChange> {
    let teams = now.teams.iter().map(|team| team.members.iter().map(|member| &member.robot));
    let clusters: Vec<Vec<&RobotId>> = teams.map(Iterator::collect).collect();
    let ids = now.teams.iter().map(|team| team.id.clone()).collect();
    let previous = job.previous.as_deref();
    identity::named(&clusters, ids, &now.unassigned, previous, &job.memory).changes
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

/// Whether the teams that are not in the last division of a job, but were there before it, keep more than half of their robots:
/// these have given them their ids.
fn revived_teams_stay(job: &Job, before: &Teams, now: &Teams) -> bool {
    let last = job.previous.iter().flat_map(|last| &last.teams);
    let known: BTreeSet<&TeamId> = last.map(|team| &team.id).collect();
    let team_of: BTreeMap<&RobotId, &TeamId> = now.assignments().collect();
    let stays = |team: &Team| {
        let is_there = |member: &&Member| team_of.get(&member.robot) == Some(&&team.id);
        let kept = team.members.iter().filter(is_there).count();
        let is_new = identity::number(&team.id).is_some_and(|number| number >= job.next_team());
        is_new || known.contains(&team.id) || 2 * kept > team.members.len()
    };
    before.teams.iter().all(stays)
}
