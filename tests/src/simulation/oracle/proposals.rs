//! Proposals: questions that change nothing, are right about what would change, and are forgotten.

use std::collections::BTreeMap;

use muster_model::content::Checked;
use muster_model::id::{OperatorId, ProposalId, RobotId, ServiceName, TeamId};
use muster_model::proposal::{Proposal, ProposedDivision, ProposedMove};
use muster_model::teams::Teams;
use muster_wire::Message;

use super::super::clock::{Micros, SECOND};
use super::{Published, Publisher, Verified, breach};

/// What is promised of what a planner publishes.
const MEDDLES_NOT: &str = "a planner publishes nothing that others go by";

/// What is promised of how many there are.
const BOUNDED: &str = "at most 16 proposals are open, and 8 of one operator";

/// Most proposals of a fleet, and of one operator.
const MOST: (usize, usize) = (16, 8);

/// What is promised of how long they are there.
const FORGOTTEN: &str = "a proposal is forgotten 60 s after it was computed";

/// How long they may be there: a second more than is promised, for clocks that drift.
const LIFETIME: Micros = 61 * SECOND;

/// How much younger a proposal may say that it is than it is, for clocks that drift.
const CLOCKS_DIFFER_S: f64 = 0.5;

/// What is promised of what they say.
const DIFFERENCE: &str = "a proposal says who would move";

/// When somebody first read a proposal that was computed, and how old it was by its own words.
#[derive(Debug)]
struct FirstRead {
    at: Micros,
    age_s: f64,
}

/// What is known of proposals.
#[derive(Debug, Default)]
pub(crate) struct ProposalLog {
    read: BTreeMap<(Publisher, OperatorId, ProposalId), FirstRead>,
}

/// What a planner publishes is about itself.
pub(crate) fn check_published(publisher: Publisher, message: &Message) -> Verified {
    if publisher.service != ServiceName::Planner {
        return Ok(());
    }
    let is_own = match message {
        Message::Settings(announced) => announced.service == ServiceName::Planner,
        Message::Roster(_)
        | Message::Graph(_)
        | Message::Embedding(_)
        | Message::Teams { .. }
        | Message::Wishes(_)
        | Message::RobotTeam(_)
        | Message::Audit(_)
        | Message::Alerts(_) => false,
        _ => true,
    };
    if is_own {
        return Ok(());
    }
    breach(MEDDLES_NOT, format!("{publisher:?} publishes {}", message.keys().0))
}

impl ProposalLog {
    /// Checks one answer of a planner.
    pub(crate) fn check(
        &mut self,
        now: Micros,
        publisher: Publisher,
        messages: &[Message],
        divisions: &Published<Checked<Teams>>,
    ) -> Verified {
        let proposals = messages.iter().filter_map(|message| match message {
            Message::Proposal(report) => Some(&report.proposal),
            _ => None,
        });
        let mut own: BTreeMap<&OperatorId, usize> = BTreeMap::new();
        let mut count = 0;
        for proposal in proposals {
            count += 1;
            let own = own.entry(&proposal.operator).or_default();
            *own += 1;
            if count > MOST.0 || *own > MOST.1 {
                return breach(BOUNDED, format!("{publisher:?} has {count}"));
            }
            self.check_age(now, publisher, proposal)?;
            if let Some(division) = &proposal.division {
                check_moves(division, divisions)?;
            }
        }
        Ok(())
    }

    /// A proposal that is computed is read within its lifetime. One that is younger than the one before would be by now is
    /// another one.
    fn check_age(&mut self, now: Micros, publisher: Publisher, proposal: &Proposal) -> Verified {
        let name = (publisher, proposal.operator.clone(), proposal.id.clone());
        if proposal.division.is_none() {
            self.read.remove(&name);
            return Ok(());
        }
        let age_s = proposal.age_s;
        let first = self.read.entry(name).or_insert(FirstRead { at: now, age_s });
        let age_by_now = first.age_s + (now - first.at) as f64 / SECOND as f64;
        if age_s + CLOCKS_DIFFER_S < age_by_now {
            *first = FirstRead { at: now, age_s };
        }
        if now > first.at + LIFETIME {
            let id = &proposal.id;
            return breach(FORGOTTEN, format!("{id} is there since {} µs", now - first.at));
        }
        Ok(())
    }
}

/// The robots that would move are those whose team is another one than in the division that it goes on from.
fn check_moves(division: &ProposedDivision, divisions: &Published<Checked<Teams>>) -> Verified {
    let based_on = divisions.named(division.based_on);
    let [live] = based_on else { return Ok(()) };
    let mut before: BTreeMap<&RobotId, Option<&TeamId>> =
        live.assignments().map(|(robot, team)| (robot, Some(team))).collect();
    before.extend(live.unassigned.iter().map(|robot| (robot, None)));
    let mut after: BTreeMap<&RobotId, Option<&TeamId>> = BTreeMap::new();
    for team in &division.teams {
        after.extend(team.members.iter().map(|robot| (robot, Some(&team.id))));
    }
    after.extend(division.unassigned.iter().map(|robot| (robot, None)));
    let mut expected = Vec::new();
    for (robot, to) in &after {
        // One that came since has been nowhere.
        let Some(from) = before.get(robot).copied() else { continue };
        if from != *to {
            let (robot, from, to) = ((*robot).clone(), from.cloned(), to.cloned());
            expected.push(ProposedMove { robot, from, to });
        }
    }
    let mut found = division.moves.clone();
    // Those that have left since the division are not in the proposal.
    found.retain(|one| after.contains_key(&one.robot));
    found.sort_by(|left, right| left.robot.cmp(&right.robot));
    if found == expected {
        return Ok(());
    }
    breach(DIFFERENCE, format!("{found:?} instead of {expected:?}"))
}
