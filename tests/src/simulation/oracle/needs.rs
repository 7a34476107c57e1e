//! Needs of teams are filled, or the division says why not; and what it says of them is true.
//!
//! What a division says of needs is compared with the rosters that were published. A need that a robot filled a moment
//! ago is filled again by the next division, so that it may be open for a while.

use std::collections::BTreeMap;

use muster_model::content::Checked;
use muster_model::id::{SkillId, TeamId};
use muster_model::roster::Roster;
use muster_model::teams::{Team, TeamNeed, Teams};

use super::super::clock::{Micros, SECOND};
use super::{Published, Publisher, Verified, breach};

/// What is promised of the numbers.
const TRUE: &str = "what a division says of needs is so by a roster that was published";

/// What is promised of the needs.
const FILLED: &str = "needs of teams are filled within 20 s, or the division says why not";

/// How long a need may be open although the division says nothing: all faults of jobs are shorter.
const OPEN_TIME: Micros = 20 * SECOND;

/// A process that publishes nothing for so long was held up.
const SILENCE: Micros = 2 * SECOND;

/// What is known of the needs of the process that published last.
#[derive(Debug, Default)]
pub(crate) struct NeedLog {
    publisher: Option<Publisher>,
    published: Micros,
    /// The needs that are open and of which the division says nothing, since when.
    open: BTreeMap<(TeamId, SkillId), Micros>,
}

impl NeedLog {
    /// A process has published a division.
    pub(crate) fn check(
        &mut self,
        now: Micros,
        publisher: Publisher,
        teams: &Teams,
        rosters: &Published<Checked<Roster>>,
    ) -> Verified {
        if self.publisher != Some(publisher) || now > self.published + SILENCE {
            self.open.clear();
        }
        (self.publisher, self.published) = (Some(publisher), now);
        if !teams.needs.is_empty()
            && !rosters.newest_first().any(|roster| is_true_by(teams, roster))
        {
            let revision = teams.header.revision;
            return breach(TRUE, format!("division {revision:?}: {:?}", teams.needs));
        }
        let lacking = lacking(teams);
        self.open.retain(|(team, skill), _| {
            lacking.iter().any(|need| need.team == *team && need.skill == *skill)
        });
        for need in lacking {
            let key = (need.team.clone(), need.skill.clone());
            let since = *self.open.entry(key).or_insert(now);
            if now > since + OPEN_TIME {
                return breach(FILLED, format!("{need:?} is open since {since}, now {now}"));
            }
        }
        Ok(())
    }
}

/// The needs that must be filled and are not, although the division says nothing of it.
pub(crate) fn lacking(teams: &Teams) -> Vec<&TeamNeed> {
    if teams.limited.as_ref().is_some_and(|limited| limited.conflict.is_some()) {
        return Vec::new();
    }
    let is_wrong = |need: &&TeamNeed| {
        !need.soft && need.lacks() > 0 || need.max.is_some_and(|max| need.have > max)
    };
    teams.needs.iter().filter(is_wrong).collect()
}

/// Whether the teams have what the division says that they have, by a roster.
fn is_true_by(teams: &Teams, roster: &Roster) -> bool {
    let able = |team: &Team, skill: &SkillId| {
        let offers = |robot| {
            let at = roster.robots.binary_search_by(|entry| entry.robot.cmp(robot)).ok();
            at.is_some_and(|at| roster.robots[at].offers(skill))
        };
        team.members.iter().filter(|member| offers(&member.robot)).count()
    };
    teams.needs.iter().all(|need| {
        let team = teams.teams.iter().find(|team| team.id == need.team);
        team.is_some_and(|team| able(team, &need.skill) == need.have as usize)
    })
}
