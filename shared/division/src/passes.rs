//! Divisions that are made again until they stay: the same vectors that are divided another time, such as after a restart, change
//! nothing.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::id::{RobotId, TeamId};
use muster_model::teams::{Limited, Team, Teams};

use crate::division::changes;
use crate::identity::number;

/// How many divisions are made at most, each from the one before, and only where that has changed something. Each costs as much
/// as the first.
const MAX_PASSES: usize = 8;

/// The division that `found`, which was made from `first`, becomes as it is divided again, by `again`, until nothing changes any more.
/// Where a division comes back, the best one since is taken, so that it does not depend on where that began. No team is lost or
/// begins on the way. A team that lives again, with a number below `next_team`, keeps most of the robots with which it was found.
pub(crate) fn until_it_stays(
    first: Option<&Teams>,
    next_team: u64,
    mut found: Teams,
    again: impl Fn(&Teams) -> Option<Teams>,
) -> Teams {
    let mut earlier: Vec<Teams> = Vec::new();
    for _ in 1..MAX_PASSES {
        let has_changed = first.is_none_or(|first| !is_kept(first, &found));
        if !has_changed || found.limited.as_ref().is_some_and(Limited::stands) {
            break;
        }
        let next = again(&found).filter(|next| has_same_teams(&found, next));
        let Some(next) = next.filter(|next| revived_teams_stay(first, next_team, &found, next))
        else {
            break;
        };
        if is_kept(&found, &next) {
            found.limited = next.limited;
            break;
        }
        let next = Teams { changes: found.changes.clone(), ..next };
        let next = Teams { changes: changes(&next, first), ..next };
        earlier.push(std::mem::replace(&mut found, next));
        if let Some(at) = earlier.iter().position(|before| is_kept(before, &found)) {
            let best = earlier.into_iter().skip(at).min_by(|left, right| {
                let order = left.inertia.total_cmp(&right.inertia);
                order.then_with(|| left.assignments().cmp(right.assignments()))
            });
            return best.unwrap_or(found);
        }
    }
    found
}

/// Whether two divisions have teams with the same ids.
pub(crate) fn has_same_teams(left: &Teams, right: &Teams) -> bool {
    left.teams.iter().map(|team| &team.id).eq(right.teams.iter().map(|team| &team.id))
}

/// Whether every robot of a division was in its team before.
fn is_kept(before: &Teams, now: &Teams) -> bool {
    let team_of: BTreeMap<&RobotId, &TeamId> = before.assignments().collect();
    now.assignments().all(|(robot, team)| team_of.get(robot) == Some(&team))
}

/// Whether the teams that are not in `first`, but were there before it, keep more than half of their robots: these have given them their
/// ids.
fn revived_teams_stay(first: Option<&Teams>, next_team: u64, before: &Teams, now: &Teams) -> bool {
    let known: BTreeSet<&TeamId> =
        first.into_iter().flat_map(|first| &first.teams).map(|team| &team.id).collect();
    let stays = |(before, now): (&Team, &Team)| {
        let robots: BTreeSet<&RobotId> = now.members.iter().map(|member| &member.robot).collect();
        let kept = before.members.iter().filter(|member| robots.contains(&member.robot)).count();
        let is_new = number(&before.id).is_some_and(|number| number >= next_team);
        is_new || known.contains(&before.id) || 2 * kept > before.members.len()
    };
    before.teams.iter().zip(&now.teams).all(stays)
}
