//! Every event about teams is the difference of two divisions that were published.

use muster_model::content::Checked;
use muster_model::event::EventKind;
use muster_model::id::{RobotId, TeamId};
use muster_model::teams::{TeamChange, Teams};

use super::{Published, Publisher, Verified, breach};

/// What is promised of events about teams.
const CHANGES: &str = "every event about teams is the difference of two divisions";

/// The last two divisions of the process that published last.
#[derive(Debug, Default)]
pub(super) struct Changes {
    publisher: Option<Publisher>,
    /// None of its first one in a term: it goes on from a division that it has received, or kept, and one that leads again
    /// after another leader may not go on from its own last one.
    before: Option<Checked<Teams>>,
    now: Option<Checked<Teams>>,
}

impl Changes {
    /// A process publishes a division.
    pub(super) fn divided(&mut self, publisher: Publisher, teams: &Checked<Teams>) {
        let is_same = self.publisher == Some(publisher);
        let term = teams.header.revision.term;
        let last = self.now.take().filter(|last| is_same && last.header.revision.term == term);
        self.before = last;
        (self.publisher, self.now) = (Some(publisher), Some(teams.clone()));
    }

    /// A process publishes an event.
    pub(super) fn reported(
        &self,
        publisher: Publisher,
        kind: &EventKind,
        divisions: &Published<Checked<Teams>>,
    ) -> Verified {
        if !matches!(kind, EventKind::TeamChanged(_) | EventKind::NeedFilled { .. }) {
            return Ok(());
        }
        let now = self.now.as_deref().filter(|_| self.publisher == Some(publisher));
        let differs = now.is_some_and(|now| match &self.before {
            Some(before) => is_difference(kind, before, now),
            None => {
                let nothing = Teams { teams: Vec::new(), unassigned: Vec::new(), ..now.clone() };
                is_difference(kind, &nothing, now)
                    || divisions.newest_first().any(|before| is_difference(kind, before, now))
            }
        });
        if differs {
            return Ok(());
        }
        let teams = |teams: Option<&Teams>| teams.map(|teams| (teams.header.revision, ids(teams)));
        let (before, now) = (teams(self.before.as_deref()), teams(now));
        breach(CHANGES, format!("{kind:?} from {before:?} to {now:?}"))
    }
}

fn ids(teams: &Teams) -> Vec<(String, Vec<String>)> {
    let robots = |team: &muster_model::teams::Team| {
        team.members.iter().map(|member| member.robot.to_string()).collect()
    };
    teams.teams.iter().map(|team| (team.id.to_string(), robots(team))).collect()
}

fn has(teams: &Teams, id: &TeamId) -> bool {
    teams.teams.iter().any(|team| team.id == *id)
}

/// The place of a robot: none if it is not in the division, and no team if it is in none.
fn place<'a>(teams: &'a Teams, robot: &RobotId) -> Option<Option<&'a TeamId>> {
    let assigned = teams.assignments().find(|(of, _)| *of == robot).map(|(_, team)| Some(team));
    assigned.or_else(|| teams.unassigned.contains(robot).then_some(None))
}

fn is_difference(kind: &EventKind, before: &Teams, now: &Teams) -> bool {
    let is_born = |id: &TeamId| has(now, id) && !has(before, id);
    let has_ended = |id: &TeamId| has(before, id) && !has(now, id);
    match kind {
        EventKind::TeamChanged(TeamChange::Born { team }) => is_born(team),
        EventKind::TeamChanged(TeamChange::Died { team }) => has_ended(team),
        EventKind::TeamChanged(TeamChange::Split { from, into }) => {
            is_born(into) && has(before, from) && has(now, from)
        }
        EventKind::TeamChanged(TeamChange::Merged { from, into }) => {
            has_ended(from) && has(now, into)
        }
        EventKind::TeamChanged(TeamChange::Moved { robot, from, to }) => {
            from != to
                && place(before, robot) == Some(from.as_ref())
                && place(now, robot) == Some(to.as_ref())
        }
        EventKind::NeedFilled { team, robots, .. } => robots.iter().all(|robot| {
            place(now, robot) == Some(Some(team)) && place(before, robot) != Some(Some(team))
        }),
        _ => true,
    }
}
