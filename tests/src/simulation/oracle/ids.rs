//! No id of a team is ever given to another team, whatever is killed, as long as the disk is there.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::id::{RobotId, TeamId};
use muster_model::teams::Teams;

use super::{Verified, breach};

/// All robots that were ever in the team of an id.
#[derive(Debug, Default)]
pub(crate) struct Ids {
    members: BTreeMap<TeamId, BTreeSet<RobotId>>,
    last: BTreeSet<TeamId>,
}

impl Ids {
    /// A disk is lost: ids may begin anew.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// An id that was not in the division before is new, or has a robot that was in its team.
    pub(crate) fn check(&mut self, teams: &Teams) -> Verified {
        let last = std::mem::take(&mut self.last);
        for team in &teams.teams {
            let robots = team.members.iter().map(|member| &member.robot);
            let known = self.members.entry(team.id.clone()).or_default();
            let is_other = !known.is_empty() && !robots.clone().any(|robot| known.contains(robot));
            if is_other && !last.contains(&team.id) {
                let now: Vec<_> = robots.collect();
                return breach(
                    "no id of a team is given to another team",
                    format!("{} had {known:?}, and is given to {now:?}", team.id),
                );
            }
            known.extend(robots.cloned());
            self.last.insert(team.id.clone());
        }
        Ok(())
    }
}
