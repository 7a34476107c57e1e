//! Which robots are informed of a division: those whose team has changed, and the others in rotation;
//! and what operators learn where there are fewer teams than asked for.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_division::words::plural;
use muster_model::id::RobotId;
use muster_model::limits::MAX_MEMBERS_PUBLISHED;
use muster_model::settings::TeamCount;
use muster_model::teams::{Team, Teams};
use muster_model::time::Tick;

/// How many robots are informed of their team again in each heartbeat: that repairs lost messages without a
/// burst.
const ROBOTS_INFORMED_PER_HEARTBEAT: usize = 64;

/// Which robots are informed of their team next, so that a lost message is repaired in the end.
#[derive(Debug, Default)]
pub(crate) struct Rotation {
    /// When robots were last informed; none if that is due at once.
    informed: Option<Tick>,
    last: Option<RobotId>,
}

impl Rotation {
    /// When the next robots are to be informed.
    pub(crate) fn due(&self, every: Duration) -> Tick {
        self.informed.map_or(Tick(0), |informed| informed.after(every))
    }

    /// Makes the rotation due at once.
    pub(crate) fn make_due(&mut self) {
        self.informed = None;
    }

    /// The next robots in rotation, of all robots ordered by name.
    pub(crate) fn next(&mut self, now: Tick, robots: &[RobotId]) -> Vec<RobotId> {
        self.informed = Some(now);
        let last = self.last.as_ref();
        let first = last.map_or(0, |last| robots.partition_point(|robot| robot <= last));
        let count = robots.len().min(ROBOTS_INFORMED_PER_HEARTBEAT);
        let next: Vec<_> = robots.iter().cycle().skip(first).take(count).cloned().collect();
        self.last = next.last().cloned();
        next
    }
}

/// How many teams were asked for, how many there are, and why, if they are too few. Of a range its least
/// number was asked for.
///
/// Teams that are `absent` have a seat, which nobody else takes.
pub(crate) fn shortage(
    teams: &Teams,
    wanted: TeamCount,
    absent: u32,
) -> Option<(u32, u32, String)> {
    let formed = u32::try_from(teams.teams.len()).unwrap_or(u32::MAX);
    let requested = match wanted {
        TeamCount::Fixed(_) => teams.requested,
        TeamCount::Between { from, .. } => from,
        TeamCount::Auto => return None,
    };
    if formed >= requested {
        return None;
    }
    let placed: usize = teams.teams.iter().map(|team| team.members.len()).sum();
    let reason = if placed == 0 && teams.unassigned.is_empty() {
        "there are no robots".to_owned()
    } else if placed == 0 {
        "nothing relates the robots to each other".to_owned()
    } else if formed.saturating_add(absent) >= requested {
        format!("all robots of {} are absent", plural(absent as usize, "other team"))
    } else if placed < requested as usize {
        format!("only {} can be placed", plural(placed, "robot"))
    } else {
        format!("the robots' places differ in only {}", plural(formed as usize, "way"))
    };
    Some((requested, formed, reason))
}

/// The robots for which the published team, its members (as far as they are published) or its leader
/// differ from before; all if there was nothing before.
pub(crate) fn robots_to_inform<'a>(teams: &'a Teams, before: Option<&Teams>) -> Vec<&'a RobotId> {
    let old: BTreeMap<_, _> =
        before.into_iter().flat_map(|b| b.teams.iter().map(|team| (&team.id, team))).collect();
    let mut robots = Vec::new();
    for team in &teams.teams {
        let same = old.get(&team.id).filter(|old| same_for_members(old, team));
        let members = team.members.iter().map(|member| &member.robot);
        robots.extend(members.filter(|robot| {
            same.is_none_or(|old| old.members.binary_search_by(|m| m.robot.cmp(robot)).is_err())
        }));
    }
    let loose = teams.unassigned.iter().filter(|robot| {
        before.is_none_or(|before| before.unassigned.binary_search(robot).is_err())
    });
    robots.extend(loose);
    robots
}

/// Whether members that stay in a team would be sent the same as before.
fn same_for_members(old: &Team, new: &Team) -> bool {
    let is_large = |team: &Team| team.members.len() > MAX_MEMBERS_PUBLISHED;
    let same_names = || {
        old.members.len() == new.members.len()
            && old.members.iter().zip(&new.members).all(|(old, new)| old.robot == new.robot)
    };
    old.leader == new.leader && (is_large(old) && is_large(new) || same_names())
}
