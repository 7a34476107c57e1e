//! What if: proposals that a console asks for, looks at, and accepts or drops.

use std::time::{Duration, Instant};

use muster_bus::{Answer, Ask, Target};
use muster_model::command::Action;
use muster_model::id::{OperatorId, ProposalId, ServiceName, WishId};
use muster_model::proposal::{Proposal, ProposalRequest, ProposalState, ProposedDivision};
use muster_model::wish::{StandingWish, Wish, WishKind};
use muster_wire::{Key, Pattern};
use serde_json::{Map, Value, json};

use crate::client::Client;
use crate::error::Error;
use crate::get::ask_for;
use crate::reporter::wall_clock;

/// How long the reply to one get of a proposal is waited for: the planner replies within three seconds, with how far it
/// is if it is not there.
const PROPOSAL_REPLY_TIMEOUT: Duration = Duration::from_secs(8);

/// How long [`Client::accept_proposal`] waits for one that is still being computed.
const ACCEPT_WAIT_TIME: Duration = Duration::from_secs(30);

/// A part of a proposal, as it is applied by one command.
#[derive(Debug, Clone, PartialEq)]
pub enum AppliedPart {
    /// A wish keeps these robots in no team.
    Reserve {
        /// Its id.
        id: WishId,
        /// The robots.
        robots: Vec<muster_model::id::RobotId>,
    },
    /// Settings of a service have these values now.
    Settings {
        /// The service.
        service: ServiceName,
        /// The settings that were changed.
        changed: Map<String, Value>,
    },
}

impl AppliedPart {
    /// The action of a command that applies it, as JSON, with the service that carries it out.
    #[must_use]
    pub fn to_json(&self) -> Value {
        match self {
            Self::Reserve { id, robots } => {
                let service = ServiceName::Clusterer.as_str();
                json!({"service": service, "reserve": {"id": id.as_str(), "robots": robots}})
            }
            Self::Settings { service, changed } => {
                json!({"service": service.as_str(), "set": changed})
            }
        }
    }
}

impl std::fmt::Display for AppliedPart {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Reserve { id, robots } => {
                let robots: Vec<&str> = robots.iter().map(|robot| robot.as_str()).collect();
                write!(formatter, "wish {id}: {} in reserve", robots.join(" "))
            }
            Self::Settings { service, changed } => {
                write!(formatter, "settings of {service}: {}", Value::Object(changed.clone()))
            }
        }
    }
}

/// How a part that was applied is taken back.
enum Undo {
    /// The wish that stood under the name before; none if there was none.
    Wish(WishId, Option<Box<Wish>>),
    /// The values before.
    Settings(ServiceName, Map<String, Value>),
}

fn refused(reason: String) -> Error {
    Error::Refused { service: ServiceName::Planner, reason }
}

impl Client {
    /// Asks what the teams would be, and waits for the proposal as long as `within`. One that is not computed by then has
    /// the state *computing*; [`Client::get_proposal`] asks for it again. The same request under the same id is the
    /// same proposal, another one takes its place. Nothing of the fleet changes.
    ///
    /// # Errors
    /// [`Error::Refused`] if a field is wrong, if nothing satisfies what is asked for, or if there are too many open
    /// proposals; the reason names the field. [`Error::Unanswered`] if `planner` does not run, [`Error::Denied`] if the
    /// rules of the router drop the get, [`Error::Bus`] if the bus fails.
    pub async fn propose(
        &self,
        operator: &OperatorId,
        id: &ProposalId,
        request: &ProposalRequest,
        within: Duration,
    ) -> Result<Proposal, Error> {
        let payload = serde_json::to_vec(request).map_err(Error::bus)?;
        let start = Instant::now();
        let first = self.proposal_reply(operator, id, Some(&payload)).await?;
        self.computed(first, within.saturating_sub(start.elapsed())).await
    }

    /// A proposal. The reply comes once it is computed, or after a few seconds with how far it is.
    ///
    /// # Errors
    /// As [`Client::propose`]; [`Error::Refused`] if it is not there, as it was dropped or forgotten.
    pub async fn get_proposal(
        &self,
        operator: &OperatorId,
        id: &ProposalId,
    ) -> Result<Proposal, Error> {
        self.proposal_reply(operator, id, None).await
    }

    /// All open proposals of an operator, ordered by id; empty if there is none.
    ///
    /// # Errors
    /// [`Error::Unanswered`] if `planner` does not run, [`Error::Bus`] if the bus fails.
    pub async fn get_proposals(&self, operator: &OperatorId) -> Result<Vec<Proposal>, Error> {
        let pattern = Pattern::ProposalsOf(operator.clone());
        let mut found = Vec::new();
        for answer in self.get(&pattern, ask_for("format=json", Target::All)).await? {
            match answer {
                Answer::Packet(packet) => {
                    let space = self.bus().space();
                    match muster_wire::proposal::decode(space, &packet, wall_clock()) {
                        Ok(report) => found.push(report.proposal),
                        Err(refused) => {
                            tracing::warn!("refused on {}: {}", refused.key, refused.reason);
                        }
                    }
                }
                Answer::Error(error) => return Err(Error::reply(ServiceName::Planner, &error)),
            }
        }
        if found.is_empty() {
            let key = format!("propose/{operator}/*");
            return self.none_of(ServiceName::Planner, key).await;
        }
        found.sort_by(|left, right| left.id.cmp(&right.id));
        Ok(found)
    }

    /// Drops a proposal, and returns the last of it.
    ///
    /// # Errors
    /// As [`Client::get_proposal`].
    pub async fn drop_proposal(
        &self,
        operator: &OperatorId,
        id: &ProposalId,
    ) -> Result<Proposal, Error> {
        self.proposal_reply(operator, id, Some(b"null")).await
    }

    /// Makes the fleet what a proposal says, by ordinary commands: a wish that keeps robots in reserve, and changes of
    /// settings. The clusterer then divides the fleet as it is by then. If one of the commands is not carried out, those
    /// before are taken back. An accepted proposal is dropped.
    ///
    /// # Errors
    /// [`Error::Refused`] if the proposal is not there or changes nothing, or if somebody has changed the same settings
    /// since; [`Error::NotApplied`] if a command is refused or stays without an answer, with what could not be taken back;
    /// [`Error::Unstored`] if the proposal is applied, and a service could not store its part; otherwise as
    /// [`Client::command`].
    pub async fn accept_proposal(
        &self,
        operator: &OperatorId,
        id: &ProposalId,
    ) -> Result<Vec<AppliedPart>, Error> {
        let found = self.proposal_reply(operator, id, None).await?;
        let proposal = self.computed(found, ACCEPT_WAIT_TIME).await?;
        let Some(division) = &proposal.division else {
            return Err(refused(format!(
                "{id} is still being computed; accept it once it is there"
            )));
        };
        let parts = parts(&proposal)?;
        self.check_unchanged(division).await?;
        let mut result = self.apply(operator, division, &parts).await;
        // Limits may need the robots in reserve first, or the other way round.
        if matches!(&result, Err(Error::NotApplied { left, .. }) if left.is_empty())
            && let [first @ AppliedPart::Reserve { .. }, second, rest @ ..] = &parts[..]
        {
            let other: Vec<_> = [second, first].into_iter().chain(rest).cloned().collect();
            result = self.apply(operator, division, &other).await;
        }
        let unstored = result?;
        // It is forgotten anyway.
        let _ = self.drop_proposal(operator, id).await;
        unstored.map_or(Ok(parts), Err)
    }

    /// Waits until a proposal is computed.
    async fn computed(&self, first: Proposal, within: Duration) -> Result<Proposal, Error> {
        let start = Instant::now();
        let mut proposal = first;
        while proposal.state == ProposalState::Computing && start.elapsed() < within {
            proposal = self.proposal_reply(&proposal.operator, &proposal.id, None).await?;
        }
        Ok(proposal)
    }

    async fn proposal_reply(
        &self,
        operator: &OperatorId,
        id: &ProposalId,
        payload: Option<&[u8]>,
    ) -> Result<Proposal, Error> {
        let key = Key::Proposal(operator.clone(), id.clone());
        let ask = Ask {
            payload,
            within: PROPOSAL_REPLY_TIMEOUT,
            ..ask_for("format=json", Target::Complete)
        };
        let service = ServiceName::Planner;
        match self.get_of_leader(service, &key, ask).await?.into_iter().next() {
            Some(Answer::Packet(packet)) => {
                let space = self.bus().space();
                let report = muster_wire::proposal::decode(space, &packet, wall_clock());
                report.map(|report| report.proposal).map_err(|refused| Error::bus(refused.reason))
            }
            Some(Answer::Error(error)) => Err(Error::reply(service, &error)),
            None => Err(self.unanswered(key)),
        }
    }

    /// Refuses a proposal if the settings that it changes are others than when it was made.
    async fn check_unchanged(&self, division: &ProposedDivision) -> Result<(), Error> {
        for (service, before) in &division.replaces {
            let settings = self.get_settings(*service).await?;
            let is_other = |(name, value): &(&String, &Value)| settings.get(*name) != Some(*value);
            if let Some((name, _)) = before.iter().find(is_other) {
                let reason = format!(
                    "{name} of {service} was changed since the proposal was made; propose again"
                );
                return Err(refused(reason));
            }
        }
        Ok(())
    }

    /// Applies the parts of a proposal in order, and takes those back that were applied, or may have been, if one is not.
    /// Returns the error of a service that could not store its part.
    async fn apply(
        &self,
        operator: &OperatorId,
        division: &ProposedDivision,
        parts: &[AppliedPart],
    ) -> Result<Option<Error>, Error> {
        let (mut begun, mut unstored) = (Vec::new(), None);
        for part in parts {
            let undo = match self.undo_of(operator, division, part).await {
                Ok(undo) => undo,
                Err(error) => return Err(self.not_applied(operator, error, begun).await),
            };
            match self.carry_out(operator, division, part).await {
                Ok(()) => {}
                Err(error @ Error::Unstored { .. }) => unstored = Some(error),
                // It has changed nothing.
                Err(error @ (Error::Refused { .. } | Error::Denied { .. })) => {
                    return Err(self.not_applied(operator, error, begun).await);
                }
                // Its answer did not come: it may have been carried out.
                Err(error) => {
                    begun.push((undo, part));
                    return Err(self.not_applied(operator, error, begun).await);
                }
            }
            begun.push((undo, part));
        }
        Ok(unstored)
    }

    /// How a part is taken back once it is applied.
    async fn undo_of(
        &self,
        operator: &OperatorId,
        division: &ProposedDivision,
        part: &AppliedPart,
    ) -> Result<Undo, Error> {
        Ok(match part {
            AppliedPart::Reserve { id, .. } => {
                let is_it = |one: &StandingWish| one.operator == *operator && one.id == *id;
                let before = self.get_wishes().await?.into_iter().find(is_it);
                Undo::Wish(id.clone(), before.map(|one| Box::new(one.wish)))
            }
            AppliedPart::Settings { service, .. } => Undo::Settings(
                *service,
                division.replaces.get(service).cloned().unwrap_or_default(),
            ),
        })
    }

    async fn carry_out(
        &self,
        operator: &OperatorId,
        division: &ProposedDivision,
        part: &AppliedPart,
    ) -> Result<(), Error> {
        let (service, action) = match part {
            AppliedPart::Reserve { id, robots } => {
                let kind = WishKind::Reserve;
                let robots = robots.clone();
                let wish = Wish { kind, robots, team: None, expires: None, note: None };
                let Ok(Value::Object(wish)) = serde_json::to_value(&wish) else {
                    return Err(Error::bus("a wish is no object"));
                };
                (ServiceName::Clusterer, Action::Wish { id: id.clone(), wish })
            }
            AppliedPart::Settings { service, changed } => (*service, Action::Set(changed.clone())),
        };
        self.command(operator, service, action, Some(division.based_on)).await.map(drop)
    }

    /// Takes parts back, the last first, as one of them was not carried out.
    async fn not_applied(
        &self,
        operator: &OperatorId,
        reason: Error,
        begun: Vec<(Undo, &AppliedPart)>,
    ) -> Error {
        let mut left = Vec::new();
        for (undo, part) in begun.into_iter().rev() {
            match self.take_back(operator, undo).await {
                // What is not stored is taken back for now, and is stored as soon as the disk works.
                Ok(()) | Err(Error::Unstored { .. }) => {}
                Err(_) => left.push(part.clone()),
            }
        }
        Error::NotApplied { reason: Box::new(reason), left }
    }

    async fn take_back(&self, operator: &OperatorId, undo: Undo) -> Result<(), Error> {
        match undo {
            Undo::Wish(id, Some(before)) => self.put_wish(operator, &id, &before).await.map(drop),
            Undo::Wish(id, None) => match self.withdraw_wish(operator, &id).await {
                // It was not put.
                Err(Error::Refused { .. }) => Ok(()),
                withdrawn => withdrawn.map(drop),
            },
            Undo::Settings(service, before) => {
                let before = Value::Object(before);
                self.change_settings(operator, service, &before).await.map(drop)
            }
        }
    }
}

/// The parts of a proposal, the robots in reserve first.
fn parts(proposal: &Proposal) -> Result<Vec<AppliedPart>, Error> {
    let mut parts = Vec::new();
    let robots = proposal.asked.without.clone();
    if let Some(id) = Proposal::reserve_wish(&proposal.id).filter(|_| !robots.is_empty()) {
        parts.push(AppliedPart::Reserve { id, robots });
    }
    for service in ProposalRequest::SERVICES {
        let changed = proposal.asked.patch(service);
        if !changed.is_empty() {
            parts.push(AppliedPart::Settings { service, changed });
        }
    }
    if parts.is_empty() {
        return Err(refused(format!("{} changes nothing", proposal.id)));
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proposal(asked: Value) -> Proposal {
        let text = json!({"operator": "alice", "id": "p1", "state": "ready", "asked": asked, "ahead": 0,
                          "age_s": 1.0, "forgotten_in_s": 59.0, "division": null});
        serde_json::from_value(text).unwrap()
    }

    #[test]
    fn a_proposal_is_applied_by_a_wish_and_changes_of_settings() {
        let all = proposal(json!({"teams": 3, "weights": {"spatial": 1.0}, "without": ["r7"]}));
        let parts = parts(&all).unwrap();
        let as_json: Vec<Value> = parts.iter().map(AppliedPart::to_json).collect();
        assert_eq!(
            as_json,
            [
                json!({"service": "clusterer", "reserve": {"id": "propose-p1", "robots": ["r7"]}}),
                json!({"service": "clusterer", "set": {"teams": 3}}),
                json!({"service": "embedder", "set": {"weights": {"spatial": 1.0}}}),
            ]
        );
        assert_eq!(parts[0].to_string(), "wish propose-p1: r7 in reserve");
        let error = super::parts(&proposal(json!({}))).unwrap_err().to_string();
        assert!(error.contains("p1 changes nothing"), "{error}");
    }

    #[test]
    fn what_could_not_be_taken_back_is_named() {
        let reason = Box::new(refused("no".to_owned()));
        let text = Error::NotApplied { reason, left: Vec::new() }.to_string();
        assert_eq!(text, "the proposal is not applied: planner refuses: no");
        let parts = parts(&proposal(json!({"teams": 3}))).unwrap();
        let reason = Box::new(refused("no".to_owned()));
        let text = Error::NotApplied { reason, left: parts }.to_string();
        assert!(text.ends_with("may still hold: settings of clusterer: {\"teams\":3}"), "{text}");
    }
}
