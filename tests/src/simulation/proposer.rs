//! Operators who ask what the teams would be: they accept proposals, drop them, or let them be forgotten.

use std::sync::Arc;

use muster_model::id::{RobotId, ServiceName, TeamId};
use muster_model::proposal::{Proposal, ProposalRequest, ProposalState};
use muster_model::role::ReplicaState;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use serde_json::{Value, json};

use super::clock::{MS, Micros, SECOND};
use super::log::digest;
use super::oracle::breach;
use super::plan::Then;
use super::router::{Answer, BusGet};
use super::world::{AGREED_ORDERS_TIME, Asker, Event, World};

/// How long the reply to a get is waited for: the planner replies within three seconds.
const REPLY_TIME: Micros = 5 * SECOND;

/// How often an unanswered get is repeated: long enough for a planner that was killed, and then no one waits any more.
const MAX_TRIES: u32 = 8;

/// How long all must have agreed before a proposal at rest is asked for, and after it is accepted before the
/// division is compared with it: longer than anything is held back.
const REST_TIME: Micros = 4 * SECOND;

/// How often somebody looks at a proposal that is left to be forgotten.
const LOOK_INTERVAL: Micros = 7 * SECOND;

/// What an accepted proposal promises.
const AS_PROPOSED: &str = "an accepted proposal becomes the division, if nothing else changes";

/// What is promised of the answers to one get.
const ONE_ANSWERS: &str = "one planner answers";

/// A proposal that somebody asks for.
#[derive(Debug, Clone)]
pub(crate) struct Errand {
    pub(crate) operator: String,
    pub(crate) id: String,
    /// The payload of the next get; none once the proposal was asked for.
    pub(crate) payload: Option<String>,
    pub(crate) then: Then,
    pub(crate) tries: u32,
}

/// A proposal while nothing else changes.
#[derive(Debug)]
pub(crate) enum AtRest {
    /// It is to be asked for once all agree.
    Planned(String),
    /// It was asked for.
    Asked,
    /// It was accepted, and how often operators had been refused by then.
    Accepted { proposal: Box<Proposal>, refused: u64 },
}

impl World {
    /// Somebody asks for a proposal.
    pub(super) fn propose(&mut self, errand: Errand) {
        let Errand { operator, id, payload, .. } = &errand;
        let selector = format!("muster/v1/{}/propose/{operator}/{id}", self.space.fleet());
        let payload = payload.clone().map(String::into_bytes);
        let asked = BusGet { selector, parameters: "format=json", payload };
        let link = self.operator.link;
        let one_led = self.one_plans();
        self.get(link, asked, REPLY_TIME, Asker::Proposer(Box::new(errand), one_led));
    }

    /// Somebody asks for all proposals.
    pub(super) fn list_proposals(&mut self) {
        let selector = format!("muster/v1/{}/propose/*/*", self.space.fleet());
        let asked = BusGet { selector, parameters: "format=json", payload: None };
        self.get(self.operator.link, asked, REPLY_TIME, Asker::Nobody);
    }

    /// Whether one planner leads, and all others that run stand by.
    fn one_plans(&self) -> bool {
        let planners = self.nodes.iter().filter(|node| node.service == ServiceName::Planner);
        let states: Vec<ReplicaState> =
            planners.filter_map(|node| Some(node.process.as_ref()?.host.replica_state())).collect();
        let count = |wanted| states.iter().filter(|state| **state == wanted).count();
        count(ReplicaState::Leading) == 1 && count(ReplicaState::Standby) + 1 == states.len()
    }

    /// A get about a proposal has ended.
    pub(super) fn proposal_answered(
        &mut self,
        errand: Errand,
        one_led: bool,
        answers: &[Arc<Answer>],
    ) {
        let is_seen =
            |answer: &&Arc<Answer>| answer.packets().is_none_or(|packets| !packets.is_empty());
        let seen: Vec<_> = answers.iter().filter(is_seen).collect();
        // One that has just begun refuses what it cannot know. Clients take what another one answers.
        let given: Vec<_> = seen.iter().filter(|answer| answer.packets().is_some()).collect();
        if one_led && self.one_plans() && given.len() > 1 {
            let seen = format!("{}/{} is answered {seen:?}", errand.operator, errand.id);
            return self.require(breach(ONE_ANSWERS, seen));
        }
        match given.first().copied().or(seen.first()).map(|answer| answer.as_ref()) {
            None if errand.tries < MAX_TRIES => {
                let again = Errand { tries: errand.tries + 1, ..errand };
                self.schedule(self.now + SECOND, Event::AskForProposal(Box::new(again)));
            }
            Some(Answer::Packets(packets)) => {
                let read = packets.first().map(|packet| {
                    let now = Tick(self.now);
                    muster_wire::proposal::decode(&self.space, packet, now)
                });
                match read {
                    Some(Ok(report)) => self.read_proposal(errand, report.proposal),
                    other => {
                        let seen = format!("{other:?}");
                        self.require(breach("what a service publishes, others understand", seen));
                    }
                }
            }
            Some(Answer::Error(error)) => {
                self.log.line(self.now, format_args!("the proposal is refused: {error}"));
                self.stats.proposals_refused += 1;
                self.end_errand(&errand);
            }
            None => self.end_errand(&errand),
        }
    }

    /// Nothing more comes of a proposal.
    fn end_errand(&mut self, errand: &Errand) {
        if errand.then == Then::AcceptAtRest && matches!(self.at_rest, Some(AtRest::Asked)) {
            self.at_rest = None;
        }
    }

    fn read_proposal(&mut self, errand: Errand, proposal: Proposal) {
        let text = digest(format!("{proposal:?}").as_bytes());
        let name = format!("{}/{}", errand.operator, errand.id);
        self.log.line(self.now, format_args!("{name} is {:?}: {text}", proposal.state));
        match proposal.state {
            ProposalState::Dropped => return,
            ProposalState::Computing if errand.tries < MAX_TRIES => {
                let again = Errand { payload: None, tries: errand.tries + 1, ..errand };
                return self.propose(again);
            }
            ProposalState::Computing => return self.end_errand(&errand),
            ProposalState::Ready => {}
        }
        self.stats.proposals += 1;
        match errand.then {
            Then::Forget => {
                let again = Errand { payload: None, tries: 0, ..errand };
                let at = self.now + LOOK_INTERVAL;
                self.schedule(at, Event::AskForProposal(Box::new(again)));
            }
            Then::Drop => {
                let payload = Some("null".to_owned());
                self.propose(Errand { payload, tries: 0, ..errand });
            }
            Then::Accept => {
                self.accept(&proposal);
                let payload = Some("null".to_owned());
                self.propose(Errand { payload, then: Then::Drop, tries: 0, ..errand });
            }
            Then::AcceptAtRest => {
                // The division that it goes on from must still be the one that all agree on.
                let division = proposal.division.as_ref();
                let is_last = division.is_some_and(|division| {
                    let last = self.oracle.divisions.last();
                    let based_on = self.oracle.divisions.named(division.based_on);
                    last.is_some_and(|last| based_on.iter().any(|one| one.same_division(last)))
                });
                if !is_last || self.operator.is_busy() {
                    return self.end_errand(&errand);
                }
                self.accept(&proposal);
                self.forget_agreement();
                let refused = self.operator.refused;
                self.at_rest = Some(AtRest::Accepted { proposal: Box::new(proposal), refused });
            }
        }
    }

    /// Applies a proposal by ordinary commands.
    fn accept(&mut self, proposal: &Proposal) {
        if !proposal.asked.without.is_empty() {
            let robots = json!({"kind": "reserve", "robots": proposal.asked.without});
            let change = format!("wish/{}/propose-{} {robots}", proposal.operator, proposal.id);
            self.operator.wants(ServiceName::Clusterer, change);
        }
        for service in ProposalRequest::SERVICES {
            let patch = proposal.asked.patch(service);
            if !patch.is_empty() {
                self.operator.wants(service, Value::Object(patch).to_string());
            }
        }
    }

    /// Asks for a proposal once all have agreed for a while, and compares the division with one that was accepted.
    pub(super) fn rest(&mut self, settled_for: Option<Micros>) {
        let Some(settled_for) = settled_for.filter(|time| *time >= REST_TIME) else { return };
        match self.at_rest.take() {
            Some(AtRest::Planned(asked))
                if self.is_at_rest() && settled_for >= AGREED_ORDERS_TIME =>
            {
                self.at_rest = Some(AtRest::Asked);
                let (operator, id) = ("alice".to_owned(), "rest".to_owned());
                let then = Then::AcceptAtRest;
                self.propose(Errand { operator, id, payload: Some(asked), then, tries: 0 });
            }
            Some(AtRest::Accepted { proposal, refused }) => {
                self.log.line(self.now, format_args!("compared after {} ms", settled_for / MS));
                // The division of a fleet that all have left need not be published.
                let has_robots = self.settled.as_ref().is_some_and(|(_, now)| now.has_robots());
                if self.operator.refused == refused && has_robots {
                    self.compare(&proposal);
                }
            }
            other => self.at_rest = other,
        }
    }

    /// The division is what was proposed. A proposal of several commands, or one that changes the vectors, is one of
    /// several steps, of which each begins where the one before has ended. A planner that did not run all the time, or was
    /// cut off, does not know which teams are absent or have ended lately, whose seats are kept and ids given back, nor in
    /// which team a robot was that had no place lately.
    fn compare(&mut self, proposal: &Proposal) {
        let parts = ProposalRequest::SERVICES.map(|service| proposal.asked.patch(service));
        let commands = parts.iter().filter(|patch| !patch.is_empty()).count()
            + usize::from(!proposal.asked.without.is_empty());
        let (Some(division), Some(last)) = (&proposal.division, self.oracle.divisions.last())
        else {
            return;
        };
        let based_on = self.oracle.divisions.named(division.based_on);
        let has_free_seats = |teams: &Teams| teams.requested as usize != teams.teams.len();
        // Where rules allow the present robots only so few teams as the seats of absent ones leave, these seats end
        // within a minute.
        let leaves_seats_free = proposal.asked.teams.is_none()
            && based_on.iter().any(|teams| teams.requested as usize > division.teams.len());
        if commands > 1
            || division.embedded
            || leaves_seats_free
            || has_free_seats(last)
            || based_on.iter().any(|teams| has_free_seats(teams))
        {
            return;
        }
        let was_there = |id: &TeamId| {
            based_on.iter().any(|teams| teams.teams.iter().any(|team| team.id == *id))
        };
        // Rules name teams that have ended: one of them may be given its id again, whose limits are others than those of a new
        // team.
        let is_back = |id: &TeamId| {
            let number =
                id.as_str().strip_prefix('t').and_then(|number| number.parse::<u64>().ok());
            let was_given =
                based_on.iter().any(|teams| number.is_some_and(|of| of < teams.next_team));
            was_given && !was_there(id)
        };
        if last.teams.iter().any(|team| is_back(&team.id)) {
            return;
        }
        let is_placed = |robot: &&RobotId| !last.unassigned.contains(robot);
        if based_on.iter().any(|teams| teams.unassigned.iter().any(|robot| is_placed(&robot))) {
            return;
        }
        self.stats.proposals_compared += 1;
        // Members, and the id of a team that goes on.
        let mut proposed: Vec<(Vec<&RobotId>, Option<&TeamId>)> = division
            .teams
            .iter()
            .map(|team| (team.members.iter().collect(), Some(&team.id).filter(|id| was_there(id))))
            .collect();
        let mut live: Vec<_> = last
            .teams
            .iter()
            .map(|team| {
                let members = team.members.iter().map(|member| &member.robot).collect();
                (members, Some(&team.id).filter(|id| was_there(id)))
            })
            .collect();
        proposed.sort();
        live.sort();
        if proposed != live || division.unassigned != last.unassigned {
            let asked = &proposal.asked;
            let (would, is) = (&division.conflict, &last.limited);
            let seen = format!(
                "{asked:?} was to be {proposed:?}, {would:?}, and is {live:?}, {is:?} of {}",
                last.requested
            );
            self.require(breach(AS_PROPOSED, seen));
        }
    }
}
