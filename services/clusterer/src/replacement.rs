//! Which robots came to a team because it needs their skill, and why it needed them.

use std::collections::BTreeSet;

use muster_model::event::EventKind;
use muster_model::id::{RobotId, SkillId, TeamId};
use muster_model::limits::MAX_ROBOTS_OF_EVENT;
use muster_model::roster::Roster;
use muster_model::teams::Teams;

use muster_division::needs::Needs;
use muster_division::words::list;

/// The events of needs that newcomers fill: those of teams that were there before and would lack them now without the
/// newcomers.
pub(crate) fn filled(
    before: Option<&Teams>,
    teams: &Teams,
    needs: &Needs,
    roster: Option<&Roster>,
) -> Vec<EventKind> {
    let Some(before) = before else { return Vec::new() };
    let event = |need: &muster_model::teams::TeamNeed| {
        let last = members(before, &need.team)?;
        let able = needs.able(&need.skill, &members(teams, &need.team)?);
        let (stayed, came): (Vec<_>, Vec<_>) =
            able.into_iter().partition(|robot| last.binary_search(robot).is_ok());
        if came.is_empty() || stayed.len() >= need.min as usize {
            return None;
        }
        let reason = reason(&need.skill, &last, &stayed, need.min, teams, roster);
        let robots = came.into_iter().take(MAX_ROBOTS_OF_EVENT).collect();
        let (team, skill) = (need.team.clone(), need.skill.clone());
        Some(EventKind::NeedFilled { team, skill, robots, reason })
    };
    teams.needs.iter().filter_map(event).collect()
}

/// The robots of a team, ordered by name.
fn members(teams: &Teams, id: &TeamId) -> Option<Vec<RobotId>> {
    let team = teams.teams.iter().find(|team| team.id == *id)?;
    Some(team.members.iter().map(|member| member.robot.clone()).collect())
}

/// What has become of those who had filled a need.
fn reason(
    skill: &SkillId,
    last: &[RobotId],
    stayed: &[RobotId],
    min: u32,
    teams: &Teams,
    roster: Option<&Roster>,
) -> String {
    let entry = |robot: &RobotId| {
        let entries = roster.map_or(&[][..], |roster| &roster.robots);
        let at = entries.binary_search_by(|entry| entry.robot.cmp(robot)).ok()?;
        entries.get(at)
    };
    let had = |robot: &&RobotId| {
        !stayed.contains(robot)
            && entry(robot).is_some_and(|entry| entry.skills.binary_search(skill).is_ok())
    };
    let mut words: Vec<String> = last
        .iter()
        .filter(had)
        .map(|robot| {
            if teams.stale.binary_search(robot).is_ok() {
                return format!("{robot} is silent");
            }
            let now = teams.assignments().find(|(other, _)| *other == robot);
            now.map_or(format!("{robot} has no team"), |(_, team)| format!("{robot} is in {team}"))
        })
        .collect();
    if words.is_empty() {
        let there: BTreeSet<&RobotId> =
            teams.assignments().map(|(robot, _)| robot).chain(&teams.unassigned).collect();
        let gone = last.iter().filter(|robot| !there.contains(robot));
        words = gone.map(|robot| format!("{robot} has left")).collect();
    }
    if words.is_empty() {
        return format!("it had {} of {min}", stayed.len());
    }
    list(&words)
}
