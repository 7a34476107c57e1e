//! What if: divisions that an operator asks for to look at. They are not published, and nothing acts on them.
//!
//! A proposal is asked for with what is to be different, and says what the fleet would become: who would move, and how
//! good the division would be beside the live one. It is forgotten [`PROPOSAL_LIFETIME`] after it was computed.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::content::{Content, ContentError, refuse};
use crate::header::{Header, Revision};
use crate::id::{Modality, OperatorId, ProposalId, RobotId, ServiceName, TeamId, WishId};
use crate::limits::{
    MAX_NEEDS, MAX_ROBOTS, MAX_TEAM_SIZE, MAX_TEAM_SIZES, MAX_TEAMS, MAX_WISH_ROBOTS,
};
use crate::settings::{Need, SettingsError, TeamCount, TeamSize, from_value};

/// How long after it was computed a proposal is forgotten: an operator has looked at it by then, and the fleet has
/// changed.
pub const PROPOSAL_LIFETIME: Duration = Duration::from_secs(60);

/// Most proposals of a fleet that are open at once: each holds a division of the whole fleet.
pub const MAX_OPEN_PROPOSALS: usize = 16;

/// Most open proposals of one operator, so that no single one keeps all others from asking.
pub const MAX_OPEN_PROPOSALS_OF_OPERATOR: usize = 8;

/// What stands before the id of a proposal in that of the wish which keeps its robots in reserve.
const RESERVE: &str = "propose-";

/// What is to be different. What is left out or null stays as it is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProposalRequest {
    /// How many teams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub teams: Option<TeamCount>,
    /// The weight of each modality, all of them; they sum to 1, and none at all means equal ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<BTreeMap<Modality, f64>>,
    /// How many robots each team has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(schema_with = "size_or_null")]
    pub size: Option<TeamSize>,
    /// How many robots single teams have, by their ids, all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(schema_with = "sizes_or_null")]
    pub team_size: Option<BTreeMap<TeamId, TeamSize>>,
    /// Which robots teams need, all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(length(max = MAX_NEEDS))]
    pub needs: Option<Vec<Need>>,
    /// Robots that are in no team, as if a wish kept them in reserve; each once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = MAX_WISH_ROBOTS))]
    pub without: Vec<RobotId>,
}

fn size_schema() -> Schema {
    json_schema!({
        "type": "object",
        "properties": {
            "min": {"type": ["integer", "null"], "minimum": 0, "maximum": MAX_TEAM_SIZE,
                    "description": "Least number of robots."},
            "max": {"type": ["integer", "null"], "minimum": 1, "maximum": MAX_TEAM_SIZE,
                    "description": "Most robots."},
        },
        "additionalProperties": false,
    })
}

fn size_or_null(_: &mut SchemaGenerator) -> Schema {
    json_schema!({"anyOf": [size_schema(), {"type": "null"}]})
}

fn sizes_or_null(generator: &mut SchemaGenerator) -> Schema {
    let name = generator.subschema_for::<TeamId>();
    json_schema!({
        "type": ["object", "null"],
        "maxProperties": MAX_TEAM_SIZES,
        "propertyNames": name,
        "additionalProperties": size_schema(),
    })
}

impl ProposalRequest {
    /// Reads a request.
    ///
    /// # Errors
    /// Names the field that is unknown, of the wrong type or makes no sense by itself.
    pub fn from_json(value: Value) -> Result<Self, SettingsError> {
        let mut request: Self = from_value(value)?;
        let wrong = |field: &str, problem: String| Err(SettingsError::new(field, problem));
        request.without.sort_unstable();
        if request.without.windows(2).any(|pair| pair[0] == pair[1]) {
            return wrong("without", "must name each robot once".to_owned());
        }
        let named = request.without.len();
        if named > MAX_WISH_ROBOTS {
            let problem = format!("may name at most {MAX_WISH_ROBOTS} robots, not {named}");
            return wrong("without", problem);
        }
        if let Some(teams) = request.teams {
            teams.check()?;
        }
        Ok(request)
    }

    /// The settings of a service that it changes, as a patch; empty if it changes none.
    #[must_use]
    pub fn patch(&self, service: ServiceName) -> Map<String, Value> {
        let fields: &[&str] = match service {
            ServiceName::Clusterer => &["teams", "size", "team_size", "needs"],
            ServiceName::Embedder => &["weights"],
            _ => &[],
        };
        let Ok(Value::Object(all)) = serde_json::to_value(self) else { return Map::new() };
        all.into_iter().filter(|(name, _)| fields.contains(&name.as_str())).collect()
    }

    /// The services whose settings a proposal may change.
    pub const SERVICES: [ServiceName; 2] = [ServiceName::Clusterer, ServiceName::Embedder];
}

/// How far a proposal is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProposalState {
    /// It waits, or is being computed.
    Computing,
    /// It is there.
    Ready,
    /// It was dropped: the last that is heard of it.
    Dropped,
}

/// Silhouettes of a division, as the audit has them: none where they are not defined.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DivisionQuality {
    /// Mean silhouette of all robots among the vectors.
    pub mean: Option<f64>,
    /// The mean silhouette of the team where it is least.
    pub least_team: Option<f64>,
    /// Mean silhouette of all robots among the positions.
    pub physical_mean: Option<f64>,
}

impl DivisionQuality {
    /// By how much this one is better than another.
    #[must_use]
    pub fn beyond(&self, other: &Self) -> Self {
        let less = |new: Option<f64>, old: Option<f64>| Some(new? - old?);
        Self {
            mean: less(self.mean, other.mean),
            least_team: less(self.least_team, other.least_team),
            physical_mean: less(self.physical_mean, other.physical_mean),
        }
    }
}

/// A team of a proposal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProposedTeam {
    /// Its id: that of the live team with which it shares most robots, or the next one.
    pub id: TeamId,
    /// Its robots, ordered by name.
    #[schemars(length(max = MAX_ROBOTS))]
    pub members: Vec<RobotId>,
    /// The mean silhouette of its robots among the vectors; none with fewer than two teams.
    pub mean: Option<f64>,
    /// The least silhouette of its robots among the vectors.
    pub least: Option<f64>,
}

/// A live team, among the vectors of a proposal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LiveTeam {
    /// Its id.
    pub id: TeamId,
    /// How many robots it has.
    pub robots: u32,
    /// The mean silhouette of its robots.
    pub mean: Option<f64>,
    /// The least silhouette of its robots.
    pub least: Option<f64>,
}

/// A robot that would be elsewhere.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ProposedMove {
    /// The robot.
    pub robot: RobotId,
    /// Its team in the live division; none if it is in none.
    pub from: Option<TeamId>,
    /// Its team in the proposal; none if it is in none.
    pub to: Option<TeamId>,
}

/// A division that was computed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProposedDivision {
    /// The live division that it goes on from.
    pub based_on: Revision,
    /// The values that the changed settings of each service have now, by the name of the service.
    pub replaces: BTreeMap<ServiceName, Map<String, Value>>,
    /// Whether the vectors were computed for it; else they are those of the live division.
    pub embedded: bool,
    /// The teams.
    #[schemars(length(max = MAX_TEAMS))]
    pub teams: Vec<ProposedTeam>,
    /// Robots without a team, ordered by name.
    #[schemars(length(max = MAX_ROBOTS))]
    pub unassigned: Vec<RobotId>,
    /// Robots that would be elsewhere, ordered by name.
    #[schemars(length(max = MAX_ROBOTS))]
    pub moves: Vec<ProposedMove>,
    /// How good it is.
    pub proposed: DivisionQuality,
    /// How good the live division is among the same vectors and robots.
    pub live: DivisionQuality,
    /// By how much the proposal is better: the difference of the two.
    pub change: DivisionQuality,
    /// The live teams among the same vectors and robots.
    #[schemars(length(max = MAX_TEAMS))]
    pub live_teams: Vec<LiveTeam>,
    /// Which needs it cannot fill, as the live division cannot either; none if it obeys everything.
    pub conflict: Option<String>,
}

/// A proposal, as it is read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Proposal {
    /// Who asked for it.
    pub operator: OperatorId,
    /// Its id among those of the operator.
    pub id: ProposalId,
    /// How far it is.
    pub state: ProposalState,
    /// What is to be different.
    #[schemars(with = "Map<String, Value>")]
    pub asked: ProposalRequest,
    /// How many others are computed before it.
    pub ahead: u32,
    /// Seconds since it was asked for.
    pub age_s: f64,
    /// Seconds until it is forgotten; none before it is computed.
    pub forgotten_in_s: Option<f64>,
    /// The division; none before it is computed.
    pub division: Option<ProposedDivision>,
}

impl Proposal {
    /// The id of the wish that keeps the robots of [`ProposalRequest::without`] in reserve once the proposal is accepted;
    /// always there.
    #[must_use]
    pub fn reserve_wish(id: &ProposalId) -> Option<WishId> {
        let text = format!("{RESERVE}{id}");
        // What would be longer than an id may be goes without what stands before it.
        WishId::new(text).or_else(|_| WishId::new(id.as_str())).ok()
    }
}

/// A proposal with the head of its message.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposalReport {
    /// The head.
    pub header: Header,
    /// The proposal.
    pub proposal: Proposal,
}

impl Content for ProposalReport {
    /// A proposal that is ready has a division; teams are not empty, and no robot is in two of them.
    fn check(&self) -> Result<(), ContentError> {
        let proposal = &self.proposal;
        let Some(division) = &proposal.division else {
            return if proposal.state == ProposalState::Ready {
                refuse("division", "must be there once the proposal is ready")
            } else {
                Ok(())
            };
        };
        let mut robots: BTreeSet<&RobotId> = division.unassigned.iter().collect();
        let mut count = division.unassigned.len();
        for team in &division.teams {
            if team.members.is_empty() {
                return refuse("teams", "must not be empty");
            }
            count += team.members.len();
            robots.extend(&team.members);
        }
        if robots.len() != count || count > MAX_ROBOTS {
            return refuse("teams", "must have each robot once");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_request_names_what_is_to_be_different() {
        let request = json!({"teams": 3, "weights": {"spatial": 1.0}, "size": {"max": 4},
                             "without": ["r9", "r7"]});
        let request = ProposalRequest::from_json(request).unwrap();
        assert_eq!(request.without.iter().map(RobotId::as_str).collect::<Vec<_>>(), ["r7", "r9"]);
        let patch = |service| Value::Object(request.patch(service));
        assert_eq!(
            patch(ServiceName::Clusterer),
            json!({"teams": 3, "size": {"min": null, "max": 4}})
        );
        assert_eq!(patch(ServiceName::Embedder), json!({"weights": {"spatial": 1.0}}));
        assert_eq!(patch(ServiceName::Ingest), json!({}));
        let nothing = json!({"teams": null, "without": []});
        assert_eq!(ProposalRequest::from_json(nothing), Ok(ProposalRequest::default()));
        for (wrong, field) in [
            (json!({"team": 3}), "team"),
            (json!({"teams": 0}), "teams"),
            (json!({"teams": {"from": 3, "to": 2}}), "teams.to"),
            (json!({"size": {"most": 3}}), "size.most"),
            (json!({"weights": {"spatial": "all"}}), "weights.spatial"),
            (json!({"without": ["r1", "r1"]}), "without"),
            (json!({"without": ["R 1"]}), "without[0]"),
        ] {
            let error = ProposalRequest::from_json(wrong).unwrap_err();
            assert!(error.to_string().contains(field), "{error}");
        }
        let crowd: Vec<String> = (0..=MAX_WISH_ROBOTS).map(|at| format!("r{at}")).collect();
        let error = ProposalRequest::from_json(json!({"without": crowd})).unwrap_err();
        assert_eq!(error.field, "without");
    }
}
