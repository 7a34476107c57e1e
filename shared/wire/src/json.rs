//! The JSON form of messages at the edge, for dashboards and robots in any language.
//!
//! Every object begins with the same head: `fleet`, `term`, `epoch`, `data_age_s` (age of the oldest
//! robot data behind it when it was written; null where there is none) and `stages` (each service passed, with the seconds
//! since the Unix epoch at which it received and published).

use muster_model::audit::{Audit, SilhouetteReport, Space, Verdict};
use muster_model::embedding::{Embedding, EmbeddingQuality};
use muster_model::event::{Event, Severity};
use muster_model::graph::GraphDelta;
use muster_model::header::Header;
use muster_model::id::{FleetId, Modality, RobotId, ServiceName, TeamId};
use muster_model::roster::Roster;
use muster_model::teams::{RobotTeam, Teams};
use muster_model::time::Tick;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};

/// The head of every JSON message.
#[derive(Debug, Serialize)]
struct Head<'a> {
    fleet: &'a FleetId,
    term: u64,
    epoch: u64,
    data_age_s: Option<f64>,
    stages: Vec<Stage>,
}

/// A stage with its times in seconds since the Unix epoch.
#[derive(Debug, Serialize)]
struct Stage {
    stage: ServiceName,
    received: f64,
    published: f64,
}

fn head(header: &Header, now: Tick) -> Head<'_> {
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

impl EdgeJson for Teams {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        #[derive(Serialize)]
        struct Form<'a> {
            #[serde(flatten)]
            head: Head<'a>,
            teams: Vec<TeamForm<'a>>,
            unassigned: &'a [RobotId],
            stale: &'a [RobotId],
        }
        #[derive(Serialize)]
        struct TeamForm<'a> {
            id: &'a TeamId,
            members: Vec<&'a RobotId>,
            leader: &'a RobotId,
        }
        let teams = self.teams.iter().map(|team| TeamForm {
            id: &team.id,
            members: team.members.iter().map(|member| &member.robot).collect(),
            leader: &team.leader,
        });
        serde_json::to_vec(&Form {
            head: head(&self.header, now),
            teams: teams.collect(),
            unassigned: &self.unassigned,
            stale: &self.stale,
        })
    }
}

impl EdgeJson for RobotTeam {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        #[derive(Serialize)]
        struct Form<'a> {
            #[serde(flatten)]
            head: Head<'a>,
            robot: &'a RobotId,
            team: Option<&'a TeamId>,
            members: Option<&'a [RobotId]>,
            leader: Option<&'a RobotId>,
            confidence: f64,
        }
        serde_json::to_vec(&Form {
            head: head(&self.header, now),
            robot: &self.robot,
            team: self.team.as_ref(),
            members: self.members.as_deref(),
            leader: self.leader.as_ref(),
            confidence: self.confidence,
        })
    }
}

#[derive(Serialize)]
struct SilhouetteForm<'a> {
    space: Space,
    mean: Option<f64>,
    #[serde(serialize_with = "as_object")]
    per_team: &'a [(TeamId, f64)],
    #[serde(serialize_with = "as_object")]
    per_robot: &'a [(RobotId, f64)],
}

fn silhouette_form(report: &SilhouetteReport) -> SilhouetteForm<'_> {
    SilhouetteForm {
        space: report.space,
        mean: report.mean,
        per_team: &report.per_team,
        per_robot: &report.per_robot,
    }
}

impl EdgeJson for Audit {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        #[derive(Serialize)]
        struct Form<'a> {
            #[serde(flatten)]
            head: Head<'a>,
            space: Space,
            silhouette: SilhouetteForm<'a>,
            physical: SilhouetteForm<'a>,
            verdict: Verdict,
        }
        serde_json::to_vec(&Form {
            head: head(&self.header, now),
            space: self.in_embedding.space,
            silhouette: silhouette_form(&self.in_embedding),
            physical: silhouette_form(&self.in_physical),
            verdict: self.verdict,
        })
    }
}

impl EdgeJson for Event {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        #[derive(Serialize)]
        struct Form<'a> {
            #[serde(flatten)]
            head: Head<'a>,
            source: ServiceName,
            severity: Severity,
            #[serde(flatten)]
            kind: Map<String, Value>,
        }
        let kind = named_variant("event", serde_json::to_value(&self.kind)?);
        serde_json::to_vec(&Form {
            head: head(&self.header, now),
            source: self.source,
            severity: self.severity,
            kind,
        })
    }
}

/// Turns `{"variant": {fields}}`, nested ones too, into `{name: "variant", fields}`: the form that a
/// reader in any language expects.
fn named_variant(name: &str, value: Value) -> Map<String, Value> {
    let Value::Object(object) = value else { return Map::new() };
    let Some((variant, content)) = object.into_iter().next() else { return Map::new() };
    let mut named = Map::from_iter([(name.to_owned(), Value::String(variant.clone()))]);
    match content {
        Value::Object(_) if variant == "team_changed" => {
            named.extend(named_variant("change", content));
        }
        Value::Object(fields) => named.extend(fields),
        _ => {}
    }
    named
}

impl EdgeJson for GraphDelta {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        #[derive(Serialize)]
        struct Form<'a> {
            #[serde(flatten)]
            head: Head<'a>,
            modality: &'a Modality,
            robots: Vec<&'a RobotId>,
            edges: Vec<(&'a RobotId, &'a RobotId, f64)>,
        }
        let names: std::collections::BTreeMap<_, _> =
            self.nodes_added.iter().map(|(node, robot)| (*node, robot)).collect();
        let edges = self.rows.iter().flat_map(|row| {
            row.edges.iter().filter_map(|(target, weight)| {
                Some((*names.get(&row.source)?, *names.get(target)?, *weight))
            })
        });
        serde_json::to_vec(&Form {
            head: head(&self.header, now),
            modality: &self.modality,
            robots: names.values().copied().collect(),
            edges: edges.collect(),
        })
    }
}

impl EdgeJson for Roster {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        #[derive(Serialize)]
        struct Form<'a> {
            #[serde(flatten)]
            head: Head<'a>,
            robots: Vec<Value>,
        }
        let robots = self.robots.iter().map(|entry| {
            json!({
                "robot": entry.robot, "presence": entry.presence, "position": entry.position,
                "heading": entry.heading, "frame": entry.frame, "superior": entry.superior,
                "role": entry.role, "silent_s": now.since(entry.last_seen).as_secs_f64(),
            })
        });
        serde_json::to_vec(&Form { head: head(&self.header, now), robots: robots.collect() })
    }
}

impl EdgeJson for Embedding {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        #[derive(Serialize)]
        struct Form<'a> {
            #[serde(flatten)]
            head: Head<'a>,
            robots: &'a [RobotId],
            dimension: u32,
            embedding: Vec<&'a [f64]>,
            unseen: Vec<&'a RobotId>,
            weights: Map<String, Value>,
            quality: &'a EmbeddingQuality,
        }
        let unseen = self.robots.iter().zip(&self.unseen).filter(|(_, unseen)| **unseen);
        let weights = self.graphs.iter().map(|(name, _, weight)| (name.to_string(), json!(weight)));
        serde_json::to_vec(&Form {
            head: head(&self.header, now),
            robots: &self.robots,
            dimension: self.dimension,
            embedding: self.values.chunks(self.dimension.max(1) as usize).collect(),
            unseen: unseen.map(|(robot, _)| robot).collect(),
            weights: weights.collect(),
            quality: &self.quality,
        })
    }
}
