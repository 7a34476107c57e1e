//! What browsers send: short JSON texts.

use std::str::FromStr as _;

use muster_model::command::Action;
use muster_model::header::Revision;
use muster_model::history::Query;
use muster_model::id::{Modality, OperatorId, ProposalId, RobotId, ServiceName};
use muster_model::proposal::ProposalRequest;
use serde::Deserialize;
use serde_json::Value;

use super::limits::MAX_LINK_ROBOTS;

/// What a browser sends.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Request {
    /// It has drawn the turn of this number.
    Credit(u64),
    /// What it shows.
    View(ViewRequest),
    /// It commands a service.
    Command(CommandRequest),
    /// It asks something.
    Ask(AskRequest),
    /// It asks for a proposal, or decides on one.
    Propose(ProposeRequest),
}

/// What a browser shows.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ViewRequest {
    /// Whether it shows the embedding instead of the ground.
    #[serde(default)]
    pub(super) embedding: bool,
    /// Which links it shows.
    #[serde(default)]
    pub(super) links: Option<LinksRequest>,
}

/// Which links a browser shows.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LinksRequest {
    /// Of which modality.
    pub(super) modality: Modality,
    /// Those that begin or end at one of these robots; all if there are none.
    #[serde(default)]
    pub(super) robots: Vec<RobotId>,
}

/// A command.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CommandRequest {
    /// Names it among those of the browser.
    pub(super) id: u64,
    /// Which service carries it out.
    pub(super) service: ServiceName,
    /// The division that the operator had seen.
    #[serde(default)]
    pub(super) based_on: Option<Revision>,
    /// What is commanded, as it stands on the bus.
    pub(super) action: Action,
}

/// A question.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AskRequest {
    /// Names it among those of the browser.
    pub(super) id: u64,
    /// Why this robot is in its team.
    #[serde(default)]
    why: Option<String>,
    /// What the fleet was, in the parameters of a get of a history.
    #[serde(default)]
    history: Option<String>,
}

/// A question that was understood.
#[derive(Debug, Clone, PartialEq)]
pub enum Question {
    /// Why a robot is in its team.
    Why(RobotId),
    /// What the fleet was.
    History(Query),
}

/// What is wanted of a proposal, as browsers write it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ProposeRequest {
    /// Names the request among those of the browser.
    pub(super) id: u64,
    /// Names the proposal among those of the operator.
    name: ProposalId,
    /// What is wanted of it.
    pub(super) step: RequestedStep,
}

/// What is wanted of a proposal, before what it asks for is checked.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum RequestedStep {
    /// See [`ProposalStep::Ask`].
    Ask(Value),
    /// See [`ProposalStep::Show`].
    Show,
    /// See [`ProposalStep::Drop`].
    Drop,
    /// See [`ProposalStep::Accept`].
    Accept,
}

impl RequestedStep {
    /// Whether it changes the fleet.
    pub(super) fn accepts(&self) -> bool {
        *self == Self::Accept
    }
}

/// What is wanted of a proposal.
#[derive(Debug, Clone, PartialEq)]
pub enum ProposalStep {
    /// That it is computed. Another one of the same name is forgotten.
    Ask(Box<ProposalRequest>),
    /// How far it is.
    Show,
    /// That it is forgotten.
    Drop,
    /// That the fleet becomes what it says.
    Accept,
}

/// What an operator wants of a proposal.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposalOrder {
    /// Who wants it.
    pub operator: OperatorId,
    /// The proposal's name.
    pub id: ProposalId,
    /// What is wanted.
    pub step: ProposalStep,
}

impl ProposeRequest {
    /// The order, in the name of an operator.
    ///
    /// # Errors
    /// Names the field of what is asked for that makes no sense.
    pub(super) fn order(self, operator: OperatorId) -> Result<ProposalOrder, String> {
        let step = match self.step {
            RequestedStep::Ask(asked) => {
                let asked = ProposalRequest::from_json(asked).map_err(|error| error.to_string())?;
                ProposalStep::Ask(Box::new(asked))
            }
            RequestedStep::Show => ProposalStep::Show,
            RequestedStep::Drop => ProposalStep::Drop,
            RequestedStep::Accept => ProposalStep::Accept,
        };
        Ok(ProposalOrder { operator, id: self.name, step })
    }
}

impl AskRequest {
    /// The question.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub(super) fn question(&self) -> Result<Question, String> {
        match (&self.why, &self.history) {
            (Some(robot), None) => {
                RobotId::from_str(robot).map(Question::Why).map_err(|error| format!("why: {error}"))
            }
            (None, Some(parameters)) => muster_wire::history::query(parameters)
                .map(Question::History)
                .map_err(|error| error.to_string()),
            _ => Err("ask: must have one of why and history".to_owned()),
        }
    }
}

/// Reads a message of a browser.
///
/// # Errors
/// Says what is wrong with it.
pub(super) fn read(text: &str) -> Result<Request, String> {
    let request: Request = serde_json::from_str(text).map_err(|error| error.to_string())?;
    match &request {
        Request::View(ViewRequest { links: Some(links), .. })
            if links.robots.len() > MAX_LINK_ROBOTS =>
        {
            Err(format!("links.robots: may name at most {MAX_LINK_ROBOTS} robots"))
        }
        Request::Command(command)
            if command.action.service().is_some_and(|service| service != command.service) =>
        {
            Err(format!("service: {} is no command of {}", command.action.name(), command.service))
        }
        _ => Ok(request),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_browsers_send_is_read_or_refused_with_a_reason() {
        assert_eq!(read("{\"credit\": 7}"), Ok(Request::Credit(7)));
        for right in [
            r#"{"view": {}}"#,
            r#"{"view": {"embedding": true, "links": {"modality": "spatial", "robots": ["r1"]}}}"#,
            r#"{"command": {"id": 1, "service": "clusterer", "action": {"set": {"teams": 3}}}}"#,
            r#"{"ask": {"id": 2, "why": "r7"}}"#,
            r#"{"propose": {"id": 3, "name": "c1", "step": {"ask": {"teams": 3}}}}"#,
            r#"{"propose": {"id": 4, "name": "c1", "step": "accept"}}"#,
        ] {
            assert!(read(right).is_ok(), "{right}: {:?}", read(right));
        }
        let many: Vec<String> = (0..=MAX_LINK_ROBOTS).map(|at| format!("\"r{at}\"")).collect();
        let many = format!(
            r#"{{"view": {{"links": {{"modality": "spatial", "robots": [{}]}}}}}}"#,
            many.join(",")
        );
        for (wrong, named) in [
            ("", "EOF"),
            (r#"{"credit": -1}"#, "invalid value"),
            (r#"{"draw": 1}"#, "unknown variant"),
            (r#"{"view": {"links": {"modality": "A b"}}}"#, "id"),
            (
                r#"{"command": {"id": 1, "service": "ingest", "action": {"acknowledge": {"alert": 1}}}}"#,
                "acknowledge is no command of ingest",
            ),
            (r#"{"command": {"id": 1, "service": "ingest", "action": {"shoot": {}}}}"#, "shoot"),
            (&many, "at most 400"),
        ] {
            let problem = read(wrong).unwrap_err();
            assert!(problem.contains(named), "{wrong}: {problem}");
        }
    }

    #[test]
    fn what_a_proposal_asks_for_is_checked() {
        let order = |asked: &str| {
            let text =
                format!(r#"{{"propose": {{"id": 1, "name": "c1", "step": {{"ask": {asked}}}}}}}"#);
            match read(&text).unwrap() {
                Request::Propose(propose) => propose.order(OperatorId::new("kim").unwrap()),
                other => panic!("{other:?}"),
            }
        };
        assert!(matches!(order(r#"{"teams": 3}"#).unwrap().step, ProposalStep::Ask(_)));
        assert!(order(r#"{"teams": 0}"#).unwrap_err().contains("teams"));
        assert!(order(r#"{"size": {"most": 3}}"#).unwrap_err().contains("size.most"));
        assert!(read(r#"{"propose": {"id": 1, "name": "C 1", "step": "show"}}"#).is_err());
    }

    #[test]
    fn a_question_names_one_thing() {
        let question = |text: &str| match read(text).unwrap() {
            Request::Ask(ask) => ask.question(),
            other => panic!("{other:?}"),
        };
        assert!(matches!(question(r#"{"ask": {"id": 1, "why": "r7"}}"#), Ok(Question::Why(_))));
        let past = question(r#"{"ask": {"id": 1, "history": "as_of=1795208990.5"}}"#);
        assert!(matches!(past, Ok(Question::History(_))));
        assert!(question(r#"{"ask": {"id": 1}}"#).unwrap_err().contains("why and history"));
        assert!(question(r#"{"ask": {"id": 1, "why": "R 7"}}"#).unwrap_err().starts_with("why: "));
        assert!(question(r#"{"ask": {"id": 1, "history": "x=1"}}"#).unwrap_err().contains("x"));
    }
}
