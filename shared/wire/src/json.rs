//! The JSON form of messages at the edge, for dashboards and robots in any language.
//!
//! Every object begins with the same head: `fleet`, `term`, `epoch`, `data_age_s` (age of the oldest
//! robot data behind it when it was written; null where there is none) and `stages` (each service passed, with the seconds
//! since the Unix epoch at which it received and published).

use std::borrow::Cow;
use std::collections::BTreeMap;

use muster_model::alert::{Alert, AlertKind, Alerts};
use muster_model::audit::{Audit, Flapping, Quality, SilhouetteMethod, SilhouetteReport, Space};
use muster_model::embedding::{Embedding, EmbeddingQuality};
use muster_model::event::{Event, EventKind, Severity};
use muster_model::graph::GraphDelta;
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, Modality, OperatorId, RobotId, ServiceName, SkillId, TeamId};
use muster_model::katz::{PairMethod, PairSimilarity};
use muster_model::limits::{
    MAX_ALERT_ROBOTS, MAX_CONFLICT_LENGTH, MAX_LOSSES, MAX_MEMBERS_PUBLISHED, MAX_OPEN_ALERTS,
    MAX_WISHES,
};
use muster_model::refused::Refused;
use muster_model::roster::{Presence, Roster};
use muster_model::team_audit::{Loss, TeamAudit};
use muster_model::teams::{HeldRobot, RobotTeam, SkillPrices, TeamCountScore, TeamNeed, Teams};
use muster_model::time::Tick;
use muster_model::why::{Reason, Why};
use muster_model::wish::{StandingWish, WishList, WishReport};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Map, Value, json};

use crate::packet::MAX_REASON;

/// The head of every JSON message.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Head<'a> {
    /// The fleet.
    fleet: &'a FleetId,
    /// Which leader of the service published it; a later one has a higher term.
    term: u64,
    /// Which of its outputs this is. Readers never go back to a lower pair of term and epoch.
    epoch: u64,
    /// Seconds since the oldest pose behind the message was received, stale robots left out; null where
    /// no pose is behind it.
    #[schemars(range(min = 0))]
    data_age_s: Option<f64>,
    /// The services that the data has passed, in order.
    stages: Vec<Stage>,
}

/// The fields of the head. No further field of a message may have one of these names: an object with the
/// same name twice is read differently by different parsers.
const HEAD_FIELDS: [&str; 5] = ["fleet", "term", "epoch", "data_age_s", "stages"];

/// When a service had received what it needed, and when it published what it made of it.
#[derive(Debug, Serialize, JsonSchema)]
struct Stage {
    /// The service.
    stage: ServiceName,
    /// Seconds since the Unix epoch, by the clock of the service's host.
    received: f64,
    /// Seconds since the Unix epoch, by the clock of the service's host.
    published: f64,
}

pub(crate) fn head(header: &Header, now: Tick) -> Head<'_> {
    let stages = header.stages.iter().map(|time| Stage {
        stage: time.stage,
        received: time.received.as_seconds(),
        published: time.published.as_seconds(),
    });
    Head {
        fleet: &header.fleet,
        term: header.revision.term,
        epoch: header.revision.epoch,
        data_age_s: header.data_age_s(now),
        stages: stages.collect(),
    }
}

/// Writes pairs as a JSON object, in their order.
fn as_object<K: Serialize, V: Serialize, S: Serializer>(
    pairs: &[(K, V)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(pairs.len()))?;
    for (key, value) in pairs {
        map.serialize_entry(key, value)?;
    }
    map.end()
}

/// A type that has a JSON form at the edge.
pub trait EdgeJson {
    /// The JSON form, written at a moment.
    ///
    /// # Errors
    /// If the content does not serialise. A number that is not finite becomes null.
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error>;
}

/// The division of the fleet into teams.
#[derive(Serialize, JsonSchema)]
pub(crate) struct TeamsForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// How many teams were asked for, or chosen by the evidence; there may be fewer.
    #[schemars(range(min = 1))]
    requested: u32,
    /// The numbers of teams that could be chosen, in order, with the evidence for each; empty where a number
    /// was asked for.
    considered: &'a [TeamCountScore],
    /// The teams, ordered by id as people count: t2 before t10.
    teams: Vec<TeamForm<'a>>,
    /// Robots that belong to no team, ordered by name: nothing relates them to the others, or limits leave no place.
    unassigned: &'a [RobotId],
    /// Stale robots, with or without a team, ordered by name.
    stale: &'a [RobotId],
    /// Whether no assignment of the robots to these teams that respects the limits has a lesser sum of squared
    /// distances to the teams' centroids; null without limits.
    optimal: Option<bool>,
    /// By which share that sum could be lower at most; null where nothing satisfies the limits, and without limits.
    #[schemars(range(min = 0, max = 1))]
    gap: Option<f64>,
    /// Why nothing satisfies the limits, so that the last division stands, or why needs cannot all be filled; null where
    /// this one does, and without limits.
    #[schemars(length(max = MAX_CONFLICT_LENGTH))]
    conflict: Option<&'a str>,
    /// What the teams need and have, ordered as the teams, then by skill; empty without needs.
    needs: &'a [TeamNeed],
    /// Robots with a team that one modality alone relates to others, where several relate robots of the fleet, ordered
    /// by name: nothing confirms their place.
    provisional: &'a [RobotId],
    /// Robots that the newest vectors put into another team, for not long enough yet, ordered by name.
    held: &'a [HeldRobot],
    /// What a place costs robots with a needed skill beside `price` of the team.
    skill_prices: &'a [SkillPrices],
    /// Robots that are placed together with others, by wishes of groups or for skills of which robots have several: no price
    /// stands for their places.
    jointly: &'a [RobotId],
}

/// One team.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Team")]
struct TeamForm<'a> {
    /// Its lasting name.
    id: &'a TeamId,
    /// Its robots, ordered by name.
    #[schemars(length(min = 1))]
    members: Vec<&'a RobotId>,
    /// The robot that commands most of the others; the previous leader if none commands any.
    leader: &'a RobotId,
    /// What a place in the team costs, as a squared distance of vectors: above zero where it is full, below where it has as
    /// few robots as it must have; null without limits, and while nothing satisfies them.
    price: Option<f64>,
}

impl EdgeJson for Teams {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let limited = self.limited.as_ref();
        let prices = limited.map_or(&[][..], |limited| &limited.prices);
        let teams = self.teams.iter().enumerate().map(|(number, team)| TeamForm {
            id: &team.id,
            members: team.members.iter().map(|member| &member.robot).collect(),
            leader: &team.leader,
            price: prices.get(number).copied(),
        });
        serde_json::to_vec(&TeamsForm {
            head: head(&self.header, now),
            requested: self.requested,
            considered: &self.considered,
            teams: teams.collect(),
            unassigned: &self.unassigned,
            stale: &self.stale,
            optimal: limited.map(|limited| limited.optimal),
            gap: limited.filter(|limited| limited.conflict.is_none()).map(|limited| limited.gap),
            conflict: limited.and_then(|limited| limited.conflict.as_deref()),
            needs: &self.needs,
            provisional: &self.provisional,
            held: &self.held,
            skill_prices: limited.map_or(&[][..], |limited| &limited.skill_prices),
            jointly: limited.map_or(&[][..], |limited| &limited.jointly),
        })
    }
}

/// The team of one robot, published whenever it changes. Its term and epoch are those of the division.
#[derive(Serialize, JsonSchema)]
pub(crate) struct RobotTeamForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The robot.
    robot: &'a RobotId,
    /// Its team; null if nothing relates it to the others.
    team: Option<&'a TeamId>,
    /// All robots of the team, itself among them, ordered by name; null if they are more than a message
    /// may list: the division has the list.
    #[schemars(length(max = MAX_MEMBERS_PUBLISHED))]
    members: Option<&'a [RobotId]>,
    /// Who leads the team; null if there is none.
    leader: Option<&'a RobotId>,
    /// How clearly it belongs there, from 0 (on the border to another team) to 1.
    #[schemars(range(min = 0, max = 1))]
    confidence: f64,
}

impl EdgeJson for RobotTeam {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&RobotTeamForm {
            head: head(&self.header, now),
            robot: &self.robot,
            team: self.team.as_ref(),
            members: self.members.as_deref(),
            leader: self.leader.as_ref(),
            confidence: self.confidence,
        })
    }
}

/// Messages of a robot were refused: what `ingest` publishes on the robot's own key, at most every two seconds
/// for each of its keys. What was accepted before stays.
#[derive(Serialize, JsonSchema)]
pub(crate) struct RefusedForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The robot.
    robot: &'a RobotId,
    /// The key of the messages, cut short and without control characters.
    key: &'a str,
    /// What is wrong and the remedy, of the newest of them.
    #[schemars(length(max = MAX_REASON))]
    reason: &'a str,
    /// How many messages were refused on this key since the last such message.
    count: u64,
}

impl EdgeJson for Refused {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&RefusedForm {
            head: head(&self.header, now),
            robot: &self.robot,
            key: &self.key,
            reason: &self.reason,
            count: self.count,
        })
    }
}

/// A silhouette: -1 misplaced, 0 on a border, 1 apart.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "only its schema is used")]
struct Silhouette(#[schemars(range(min = -1, max = 1))] f64);

/// Silhouettes (Rousseeuw 1987) of a division in one space.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "SilhouetteReport")]
struct SilhouetteForm<'a> {
    /// In which space.
    space: Space,
    /// Mean over all robots that have a place there; null with fewer than two teams, where it is not
    /// defined.
    #[schemars(range(min = -1, max = 1))]
    mean: Option<f64>,
    /// How the mean was computed.
    method: SilhouetteMethod,
    /// Standard error of the mean; 0 unless it is an estimate.
    #[schemars(range(min = 0))]
    standard_error: f64,
    /// Mean over the members of each team.
    #[serde(serialize_with = "as_object")]
    #[schemars(with = "BTreeMap<TeamId, Silhouette>")]
    per_team: &'a [(TeamId, f64)],
    /// Each robot that has a place there.
    #[serde(serialize_with = "as_object")]
    #[schemars(with = "BTreeMap<RobotId, Silhouette>")]
    per_robot: &'a [(RobotId, f64)],
    /// How those of teams and robots were computed.
    detail_method: SilhouetteMethod,
}

fn silhouette_form(report: &SilhouetteReport) -> SilhouetteForm<'_> {
    SilhouetteForm {
        space: report.space,
        mean: report.mean,
        method: report.method,
        standard_error: report.standard_error,
        per_team: &report.per_team,
        per_robot: &report.per_robot,
        detail_method: report.detail_method,
    }
}

/// The independent scores of a division.
#[derive(Serialize, JsonSchema)]
pub(crate) struct AuditForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The space of `silhouette`.
    space: Space,
    /// Silhouettes among the vectors that the division was made from.
    silhouette: SilhouetteForm<'a>,
    /// Silhouettes among the positions in metres, over the robots that have one.
    physical: SilhouetteForm<'a>,
    /// The quality in one word, by the silhouettes among the vectors.
    verdict: Quality,
    /// How often robots change their team and change back, over the last minute.
    flapping: &'a Flapping,
    /// The roster with whose graphs the teams were scored; null while the graphs are not known.
    graphs: Option<Revision>,
    /// Each team, in the order of the division.
    teams: &'a [TeamAudit],
    /// The robots whose loss would hurt a team most, the worst first.
    #[schemars(length(max = MAX_LOSSES))]
    losses: Vec<LossForm<'a>>,
}

/// What the loss of one robot would do to its team.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "LossEffect")]
struct LossForm<'a> {
    #[serde(flatten)]
    loss: &'a Loss,
    /// What happens, in words.
    effect: String,
}

impl EdgeJson for Audit {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let losses = self.losses.iter().map(|loss| LossForm { loss, effect: loss.describe() });
        serde_json::to_vec(&AuditForm {
            head: head(&self.header, now),
            space: self.in_embedding.space,
            silhouette: silhouette_form(&self.in_embedding),
            physical: silhouette_form(&self.in_physical),
            verdict: self.quality,
            flapping: &self.flapping,
            graphs: self.graphs,
            teams: &self.per_team,
            losses: losses.collect(),
        })
    }
}

/// Something that happened to a robot, a team or a service. `event` says what, and which further fields
/// there are; `change` does so where a division changed.
#[derive(Serialize, JsonSchema)]
pub(crate) struct EventForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The service that reports it.
    source: ServiceName,
    /// How much it matters.
    severity: Severity,
    #[serde(flatten)]
    kind: KindForm,
}

/// What happened, as [`named_variant`] writes it.
#[derive(Serialize)]
struct KindForm(Map<String, Value>);

impl JsonSchema for KindForm {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "EventKind".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut all = Vec::new();
        for kind in variants(&EventKind::json_schema(generator)) {
            if kind.name == TEAM_CHANGED {
                let target = kind.content.get("$ref").and_then(Value::as_str);
                let name = target.and_then(|target| target.rsplit('/').next()).unwrap_or_default();
                let change = generator.definitions().get(name).cloned().unwrap_or_default();
                let change = Schema::try_from(change).unwrap_or_default();
                let event = [("event", TEAM_CHANGED)];
                all.extend(variants(&change).iter().map(|change| {
                    change.named(&[&event[..], &[("change", change.name.as_str())]].concat())
                }));
                // Only the form above stands at the edge.
                generator.definitions_mut().remove(name);
            } else {
                all.push(kind.named(&[("event", kind.name.as_str())]));
            }
        }
        schemars::json_schema!({ "oneOf": all })
    }
}

/// The variant of an event that holds another choice, which is named as well.
const TEAM_CHANGED: &str = "team_changed";

/// One variant of a choice, taken from the schema that serde's own form has.
struct Variant {
    name: String,
    description: Option<Value>,
    content: Map<String, Value>,
}

fn variants(choice: &Schema) -> Vec<Variant> {
    let all = choice.get("oneOf").and_then(Value::as_array).into_iter().flatten();
    all.filter_map(|variant| {
        let (name, content) = variant.get("properties")?.as_object()?.iter().next()?;
        Some(Variant {
            name: name.clone(),
            description: variant.get("description").cloned(),
            content: content.as_object()?.clone(),
        })
    })
    .collect()
}

impl Variant {
    /// The schema of the object with the fields of the variant, and with names that say which it is.
    fn named(&self, names: &[(&str, &str)]) -> Value {
        let fields = self.content.get("properties").and_then(Value::as_object);
        let mut properties = fields.cloned().unwrap_or_default();
        properties.retain(|name, _| !HEAD_FIELDS.contains(&name.as_str()));
        let mut required: Vec<Value> = names.iter().map(|(name, _)| json!(name)).collect();
        required.extend(properties.keys().map(|name| json!(name)));
        for (name, value) in names {
            properties.insert((*name).to_owned(), json!({ "const": value }));
        }
        let mut schema =
            json!({ "type": "object", "properties": properties, "required": required });
        if let Some(description) = &self.description {
            schema["description"] = description.clone();
        }
        schema
    }
}

impl EdgeJson for Event {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let kind = named_variant("event", serde_json::to_value(&self.kind)?);
        serde_json::to_vec(&EventForm {
            head: head(&self.header, now),
            source: self.source,
            severity: self.severity,
            kind: KindForm(kind),
        })
    }
}

/// The fields that say what happened, as `json/event` has them.
pub(crate) fn event_fields(kind: &EventKind) -> Map<String, Value> {
    named_variant("event", serde_json::to_value(kind).unwrap_or_default())
}

/// Turns `{"variant": {fields}}`, nested ones too, into `{name: "variant", fields}`: the form that a
/// reader in any language expects.
fn named_variant(name: &str, value: Value) -> Map<String, Value> {
    let Value::Object(object) = value else { return Map::new() };
    let Some((variant, content)) = object.into_iter().next() else { return Map::new() };
    let mut named = Map::from_iter([(name.to_owned(), Value::String(variant.clone()))]);
    match content {
        Value::Object(_) if variant == TEAM_CHANGED => {
            named.extend(named_variant("change", content));
        }
        Value::Object(fields) => named.extend(fields),
        _ => {}
    }
    // The term of `service_started` is that of the head.
    named.retain(|name, _| !HEAD_FIELDS.contains(&name.as_str()));
    named
}

/// All open alerts. Each kind and subject has at most one.
#[derive(Serialize, JsonSchema)]
pub(crate) struct AlertsForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The number that the next alert will get.
    next_id: u64,
    /// How many events of alerts were not published in this term, because there were too many in a minute.
    folded: u64,
    /// The open alerts, ordered by number.
    #[schemars(length(max = MAX_OPEN_ALERTS))]
    open: Vec<AlertForm<'a>>,
}

/// One open alert.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Alert")]
struct AlertForm<'a> {
    /// Its number.
    id: u64,
    /// What it is about.
    kind: AlertKind,
    /// How much it matters.
    severity: Severity,
    /// The team that it concerns; null if it concerns none.
    team: Option<&'a TeamId>,
    /// The modality that it concerns; null if it concerns none.
    modality: Option<&'a Modality>,
    /// When it was raised, in seconds since the Unix epoch.
    raised: f64,
    /// What was measured when it was raised.
    value: f64,
    /// The threshold that was passed.
    threshold: f64,
    /// What is wrong, in words.
    reason: &'a str,
    /// The robots that it is about, those that matter most first.
    #[schemars(length(max = MAX_ALERT_ROBOTS))]
    robots: &'a [RobotId],
    /// Who has seen it; null if nobody has said so.
    acknowledged: Option<AcknowledgementForm<'a>>,
}

/// Who has seen an alert, and when.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Acknowledgement")]
struct AcknowledgementForm<'a> {
    /// The operator.
    operator: &'a OperatorId,
    /// Seconds since the Unix epoch.
    at: f64,
}

impl EdgeJson for Alerts {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let open = self.open.iter().map(|alert: &Alert| AlertForm {
            id: alert.id,
            kind: alert.kind,
            severity: alert.kind.severity(),
            team: alert.subject.team(),
            modality: alert.subject.modality(),
            raised: alert.raised.as_seconds(),
            value: alert.value,
            threshold: alert.threshold,
            reason: &alert.reason,
            robots: &alert.robots,
            acknowledged: alert
                .acknowledged
                .as_ref()
                .map(|by| AcknowledgementForm { operator: &by.operator, at: by.at.as_seconds() }),
        });
        serde_json::to_vec(&AlertsForm {
            head: head(&self.header, now),
            next_id: self.next_id,
            folded: self.folded,
            open: open.collect(),
        })
    }
}

/// One relation of all robots, whole.
#[derive(Serialize, JsonSchema)]
pub(crate) struct GraphForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// Which relation this is.
    modality: &'a Modality,
    /// All robots of the graph, those without an edge too.
    robots: Vec<&'a RobotId>,
    /// From, to, and the weight of the edge.
    edges: Vec<(&'a RobotId, &'a RobotId, f64)>,
}

impl EdgeJson for GraphDelta {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let names: BTreeMap<_, _> =
            self.nodes_added.iter().map(|(node, robot)| (*node, robot)).collect();
        let edges = self.rows.iter().flat_map(|row| {
            row.edges.iter().filter_map(|(target, weight)| {
                Some((*names.get(&row.source)?, *names.get(target)?, *weight))
            })
        });
        serde_json::to_vec(&GraphForm {
            head: head(&self.header, now),
            modality: &self.modality,
            robots: names.values().copied().collect(),
            edges: edges.collect(),
        })
    }
}

/// Who belongs to the fleet now, and where each robot is.
#[derive(Serialize, JsonSchema)]
pub(crate) struct RosterForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The robots, ordered by name.
    robots: Vec<RosterEntryForm<'a>>,
}

/// One robot of the fleet.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "RosterEntry")]
struct RosterEntryForm<'a> {
    /// Its name.
    robot: &'a RobotId,
    /// Whether the robot is still there.
    presence: Presence,
    /// Metres east, north, up; null while the robot is known but unplaced.
    position: Option<[f64; 3]>,
    /// Radians, counter-clockwise from east.
    heading: Option<f64>,
    /// The coordinate frame of the position.
    frame: Option<&'a str>,
    /// Its superior.
    superior: Option<&'a RobotId>,
    /// What it is within its unit.
    role: Option<&'a str>,
    /// What it can do that not every robot can, ordered by name.
    skills: &'a [SkillId],
    /// Seconds since anything was received from it.
    #[schemars(range(min = 0))]
    silent_s: f64,
}

impl EdgeJson for Roster {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let robots = self.robots.iter().map(|entry| RosterEntryForm {
            robot: &entry.robot,
            presence: entry.presence,
            position: entry.position,
            heading: entry.heading,
            frame: entry.frame.as_deref(),
            superior: entry.superior.as_ref(),
            role: entry.role.as_deref(),
            skills: &entry.skills,
            silent_s: now.since(entry.last_seen).as_secs_f64(),
        });
        serde_json::to_vec(&RosterForm { head: head(&self.header, now), robots: robots.collect() })
    }
}

/// The trust in a modality: 0 none of its weight is used, 1 all of it.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "only its schema is used")]
struct Trust(#[schemars(range(min = 0, max = 1))] f64);

/// One vector per robot: its rows of the leading singular vectors of the Katz similarity.
#[derive(Serialize, JsonSchema)]
pub(crate) struct EmbeddingForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The robots, ordered by name: row i of `embedding` is that of robot i.
    robots: &'a [RobotId],
    /// Length of each vector.
    dimension: u32,
    /// The vectors.
    embedding: Vec<&'a [f64]>,
    /// Robots that the leading singular vectors do not see: no division can be read off their row.
    unseen: Vec<&'a RobotId>,
    /// Robots that one modality alone relates to others, where several relate robots of the fleet: nothing confirms
    /// their place.
    provisional: Vec<&'a RobotId>,
    /// Katz centrality of each robot: the weight of all walks that begin at it, 1 for one without any
    /// relation.
    centrality: &'a [f64],
    /// The weight of each modality, with the trust in it.
    #[serde(serialize_with = "as_object")]
    #[schemars(with = "BTreeMap<Modality, f64>")]
    weights: Vec<(&'a Modality, f64)>,
    /// By how much the weight of each modality is multiplied, because its ties lie far from each other in
    /// the similarity of the other modalities; 1 if it is not doubted.
    #[serde(serialize_with = "as_object")]
    #[schemars(with = "BTreeMap<Modality, Trust>")]
    trust: Vec<(&'a Modality, f64)>,
    /// What it rests on and how exact it is.
    quality: &'a EmbeddingQuality,
}

impl EdgeJson for Embedding {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let unseen = self.robots.iter().zip(&self.without_embedding).filter(|(_, unseen)| **unseen);
        let provisional = self.robots.iter().zip(&self.provisional).filter(|(_, marked)| **marked);
        serde_json::to_vec(&EmbeddingForm {
            head: head(&self.header, now),
            robots: &self.robots,
            dimension: self.dimension,
            embedding: self.values.chunks(self.dimension.max(1) as usize).collect(),
            unseen: unseen.map(|(robot, _)| robot).collect(),
            provisional: provisional.map(|(robot, _)| robot).collect(),
            centrality: &self.centrality,
            weights: self.graphs.iter().map(|graph| (&graph.modality, graph.weight)).collect(),
            trust: self.graphs.iter().map(|graph| (&graph.modality, graph.trust)).collect(),
            quality: &self.quality,
        })
    }
}

/// How near one robot is to another in the fused graph: what `embedding?katz=from,to` is answered with.
#[derive(Serialize, JsonSchema)]
pub(crate) struct KatzForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// Where the walks begin.
    from: &'a RobotId,
    /// Where they end.
    to: &'a RobotId,
    /// The Katz similarity: the weight of all walks, each step damped by the decay.
    #[schemars(range(min = 0))]
    similarity: f64,
    /// The weight of the walks whose first step is of each modality; they sum to the similarity.
    #[serde(serialize_with = "as_object")]
    #[schemars(with = "BTreeMap<Modality, f64>")]
    shares: &'a [(Modality, f64)],
    /// The decay.
    alpha: f64,
    /// How it was come by.
    method: PairMethod,
    /// How exact it is: for the method `cached`, how far the similarity of all pairs is from solving its
    /// equation, by a random vector; for `column`, how much is missing at most.
    residual: f64,
}

impl EdgeJson for PairSimilarity {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&KatzForm {
            head: head(&self.header, now),
            from: &self.from,
            to: &self.to,
            similarity: self.similarity,
            shares: &self.shares,
            alpha: self.alpha,
            method: self.method,
            residual: self.residual,
        })
    }
}

/// All wishes of operators, published with every change.
#[derive(Serialize, JsonSchema)]
pub(crate) struct WishesForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The wishes, ordered by operator and id.
    #[schemars(length(max = MAX_WISHES))]
    wishes: &'a [StandingWish],
}

impl EdgeJson for WishList {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&WishesForm { head: head(&self.header, now), wishes: &self.wishes })
    }
}

/// A wish, as a get of its key is answered.
#[derive(Serialize, JsonSchema)]
pub(crate) struct WishReportForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The wish.
    #[serde(flatten)]
    wish: &'a StandingWish,
}

impl EdgeJson for WishReport {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&WishReportForm { head: head(&self.header, now), wish: &self.wish })
    }
}

/// Why a robot is in its team: what a get of `why?robot=` is answered with. The head is that of the embedding by which
/// the scores are computed.
#[derive(Serialize, JsonSchema)]
pub(crate) struct WhyForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    #[serde(flatten)]
    reason: &'a Reason,
}

impl EdgeJson for Why {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&WhyForm { head: head(&self.header, now), reason: &self.reason })
    }
}

/// What a refusal is worth to whoever asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProblemCode {
    /// What was sent is wrong, or is not there. The same again is refused again.
    Refused,
    /// The service cannot do it now. The same may be sent again in a moment.
    Unavailable,
    /// It is done, and is not on the disk: a restart forgets it.
    Unstored,
}

/// Why a get is refused: the answer of the kind that Zenoh calls an error reply.
#[derive(Debug, Serialize, JsonSchema)]
pub struct Problem<'a> {
    /// What is wrong and what would be right; begins with the field where one is wrong.
    error: String,
    /// The path of the field, with dots; in parentheses where it is no field of the content.
    field: &'a str,
    /// What whoever asked may do.
    code: ProblemCode,
}

impl<'a> Problem<'a> {
    /// A problem with one field.
    #[must_use]
    pub fn new(field: &'a str, problem: &str) -> Self {
        Self::with_code(ProblemCode::Refused, field, problem)
    }

    /// A problem that passes.
    #[must_use]
    pub fn unavailable(field: &'a str, problem: &str) -> Self {
        Self::with_code(ProblemCode::Unavailable, field, problem)
    }

    /// What was asked for is done, and could not be stored.
    #[must_use]
    pub fn unstored(field: &'a str, problem: &str) -> Self {
        Self::with_code(ProblemCode::Unstored, field, problem)
    }

    /// A problem of any kind.
    #[must_use]
    pub fn with_code(code: ProblemCode, field: &'a str, problem: &str) -> Self {
        Self { error: format!("{field}: {problem}"), field, code }
    }

    /// The JSON form.
    #[must_use]
    pub fn to_json(&self) -> String {
        json!(self).to_string()
    }
}
