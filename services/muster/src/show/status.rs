//! `muster status`: services and robots of the live fleet.

use std::sync::Arc;

use muster_client::model::id::FleetId;
use muster_client::{Client, Error, ServiceInstance};
use muster_model::audit::Audit;
use muster_model::embedding::EmbeddingGraph;
use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_model::roster::{Presence, Roster};
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_wire::message::quoted;
use serde_json::json;

use super::ShowArgs;
use super::audit::flapping;
use super::page::{Column, Page};
use super::watch::{Polled, Shown, follow, print};
use crate::console::{self, exit_error, reply};

/// Most robots that have left that are shown in words: a few lines of a terminal.
const MAX_DEPARTED_SHOWN: usize = 24;

/// What is known of a fleet.
#[derive(Debug)]
struct FleetStatus {
    fleet: FleetId,
    services: Vec<ServiceStatus>,
    /// Instances that are on the bus and do not reply.
    silent: Vec<ServiceInstance>,
    /// How many robots have joined.
    joined: usize,
    roster: Option<Arc<Roster>>,
    /// The graphs that the newest embedding was made from.
    modalities: Vec<EmbeddingGraph>,
    audit: Option<Arc<Audit>>,
}

/// Shows services and robots, once or every second.
///
/// # Errors
/// If no router answers.
pub(crate) async fn run(args: &ShowArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let fleet = &config.fleet.value;
    let client = console::open(config).await?;
    let first = status(client.clone(), fleet.clone()).await.map_err(exit_error)?;
    if args.watch {
        let (asking, fleet) = (client.clone(), fleet.clone());
        let ask = move || {
            let asked = status(asking.clone(), fleet.clone());
            // A link that is cut answers with nothing for a while before it counts as lost.
            async move { Ok(Some(asked.await?).filter(|status| !status.is_empty())) }
        };
        return follow(&client, Polled::start(&client, first, ask), args.json).await;
    }
    client.close().await;
    print(&first, args.json)?;
    if first.services.is_empty() && first.joined == 0 {
        let problem = format!("no service answers for fleet {fleet}; is --fleet right?");
        return Err(ExitError::unreachable(problem).into());
    }
    Ok(())
}

/// Asks all instances; twice if one does not reply: a get may be lost while links or leaders change.
async fn status(client: Client, fleet: FleetId) -> Result<FleetStatus, Error> {
    let status = status_once(&client, &fleet).await?;
    if status.silent.is_empty() { Ok(status) } else { status_once(&client, &fleet).await }
}

async fn status_once(client: &Client, fleet: &FleetId) -> Result<FleetStatus, Error> {
    let (services, running, joined, roster, embedding, audit) = tokio::try_join!(
        client.get_statuses(None),
        client.get_instances(),
        client.get_joined_robots(),
        async { reply(client.get_roster().await) },
        async { reply(client.get_embedding().await) },
        async { reply(client.get_audit().await) },
    )?;
    let replied =
        |token: &ServiceInstance| services.iter().any(|status| status.instance == token.instance);
    let silent = running.into_iter().filter(|token| !replied(token)).collect();
    let (fleet, joined) = (fleet.clone(), joined.len());
    let modalities = embedding.map(|embedding| embedding.graphs.clone()).unwrap_or_default();
    Ok(FleetStatus { fleet, services, silent, joined, roster, modalities, audit })
}

/// What an instance does in its service, in a word.
pub(crate) fn role(standing: ReplicaState) -> &'static str {
    match standing {
        ReplicaState::Starting => "starting",
        ReplicaState::Standby => "standby",
        ReplicaState::Suspect => "suspect",
        ReplicaState::Leading => "leader",
    }
}

impl FleetStatus {
    /// Whether nothing of the fleet answers.
    fn is_empty(&self) -> bool {
        self.services.is_empty() && self.silent.is_empty() && self.joined == 0
    }

    fn absent(&self) -> Vec<ServiceName> {
        let absent =
            |name: &ServiceName| !self.services.iter().any(|status| status.service == *name);
        ServiceName::PIPELINE.into_iter().filter(absent).collect()
    }

    fn silent(&self) -> Vec<String> {
        let name = |token: &ServiceInstance| format!("{} {}", token.service, token.instance);
        self.silent.iter().map(name).collect()
    }

    fn services(&self, page: &Page) -> Vec<String> {
        let columns = [
            Column::kept("service"),
            Column::kept("instance"),
            Column::kept("role"),
            Column::dropped("term", 1),
            Column::dropped("epoch", 4),
            Column::dropped("up", 2),
            Column::dropped("refused", 3),
            Column::kept("activity"),
        ];
        let row = |status: &ServiceStatus| {
            let refused = status.counters.get("messages_refused").copied().unwrap_or_default();
            vec![
                status.service.to_string(),
                status.instance.to_string(),
                role(status.standing).to_owned(),
                status.revision.term.to_string(),
                status.revision.epoch.to_string(),
                format!("{} s", status.now.since(status.started).as_secs()),
                refused.to_string(),
                // Any client may answer a get: control characters are removed before they are printed.
                quoted(&status.state),
            ]
        };
        page.table(&columns, self.services.iter().map(row))
    }

    fn robots(&self) -> String {
        let Some(roster) = &self.roster else {
            return "no roster: ingest has not published one".to_owned();
        };
        let count =
            |presence| roster.robots.iter().filter(|entry| entry.presence == presence).count();
        let unplaced = roster.robots.iter().filter(|entry| entry.position.is_none()).count();
        format!(
            "{} robots: {} active, {} stale; {unplaced} without a position; {} with a token",
            roster.robots.len(),
            count(Presence::Active),
            count(Presence::Stale),
            self.joined,
        )
    }
}

/// The robots that have left lately, with how long ago; nothing if none has. Of several instances of ingest
/// the leader knows best.
fn departed(services: &[ServiceStatus]) -> Option<String> {
    let ingest = ingest(services)?;
    let (listed, others) = ingest.departed.split_at(ingest.departed.len().min(MAX_DEPARTED_SHOWN));
    let shown = listed.iter().map(|departure| {
        let ago = ingest.now.since(departure.left).as_secs();
        let ago = if ago < 60 { format!("{ago} s") } else { format!("{} min", ago / 60) };
        format!("{} ({ago} ago)", departure.robot)
    });
    let mut shown: Vec<_> = shown.collect();
    if !others.is_empty() {
        shown.push(format!("and {} more, see --json", others.len()));
    }
    (!shown.is_empty()).then(|| format!("left within the last hour: {}", shown.join(", ")))
}

/// The status of the ingest that leads; of any if none does.
fn ingest(services: &[ServiceStatus]) -> Option<&ServiceStatus> {
    let all = services.iter().filter(|status| status.service == ServiceName::Ingest);
    all.max_by_key(|status| status.standing == ReplicaState::Leading)
}

/// The weight of each modality, and the trust in it where that is not whole.
fn modalities(graphs: &[EmbeddingGraph]) -> String {
    let modality = |graph: &EmbeddingGraph| {
        let trust = match graph.trust {
            trust if graph.is_doubted() => format!(" (trust {trust:.2}, IN DOUBT)"),
            trust if trust < 1.0 => format!(" (trust {trust:.2})"),
            _ => String::new(),
        };
        format!("{} {:.2}{trust}", graph.modality, graph.weight)
    };
    let all: Vec<_> = graphs.iter().map(modality).collect();
    format!("weights: {}", all.join(", "))
}

impl Shown for FleetStatus {
    const PUBLISHER: &'static str = "the fleet";

    fn lines(&self, page: &Page, _: Tick) -> Vec<String> {
        let mut lines = vec![format!("fleet {}", self.fleet)];
        lines.extend(self.services(page));
        let absent = self.absent().into_iter();
        lines.extend(
            absent.map(|name| format!("{name} does not answer; start it with `muster up {name}`")),
        );
        let silent = self.silent().into_iter();
        lines.extend(silent.map(|name| format!("{name} is on the bus and does not answer")));
        lines.push(self.robots());
        lines.extend(departed(&self.services));
        if !self.modalities.is_empty() {
            lines.push(modalities(&self.modalities));
        }
        lines.extend(self.audit.iter().map(|audit| flapping(&audit.flapping)));
        lines
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let robots = self.roster.iter().flat_map(|roster| &roster.robots).map(|entry| {
            json!({
                "robot": entry.robot, "presence": entry.presence, "position": entry.position,
                "frame": entry.frame, "superior": entry.superior, "role": entry.role,
                "skills": entry.skills,
                "silent_s": now.since(entry.last_seen).as_secs_f64(),
            })
        });
        let modalities = self.modalities.iter().map(|graph| {
            json!({"modality": graph.modality, "weight": graph.weight, "trust": graph.trust})
        });
        let line = json!({
            "fleet": self.fleet, "services": self.services, "absent": self.absent(),
            "silent": self.silent(), "robot_tokens": self.joined,
            "robots": robots.collect::<Vec<_>>(),
            "departed": ingest(&self.services).map_or(&[][..], |status| &status.departed),
            "modalities": modalities.collect::<Vec<_>>(),
            "flapping": self.audit.as_ref().map(|audit| &audit.flapping),
        });
        Ok(format!("{line}\n").into_bytes())
    }

    fn same(&self, _: &Self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use muster_model::header::Revision;
    use muster_model::id::{InstanceId, Modality, RobotId};
    use muster_model::status::Departure;
    use serde_json::Value;

    use super::super::page::tests::{WIDTHS, assert_fits, page};
    use super::*;

    #[test]
    fn the_table_fits_the_terminal_and_keeps_what_matters_most() {
        let status = |service| ServiceStatus {
            fleet: FleetId::new("alpha").unwrap(),
            service,
            instance: InstanceId::new("base-station-1234567").unwrap(),
            version: "0.1.0".to_owned(),
            started: Tick(0),
            now: Tick(123_456_000_000),
            standing: ReplicaState::Leading,
            revision: Revision { term: 12, epoch: 1_234_567 },
            state: "200 robots in 5 teams, hierarchy missing, and a text that is long".to_owned(),
            counters: BTreeMap::new(),
            departed: Vec::new(),
        };
        let fleet = FleetStatus {
            fleet: FleetId::new("alpha").unwrap(),
            services: [ServiceName::Ingest, ServiceName::Clusterer].map(status).to_vec(),
            silent: vec![],
            joined: 3,
            roster: None,
            modalities: vec![],
            audit: None,
        };
        for width in WIDTHS {
            let lines = fleet.lines(&page(width), Tick(0));
            let (table, below) = lines.split_at(lines.len() - 3);
            assert_fits(table, width);
            let text = lines.join("\n");
            for name in ["ingest", "clusterer", "leader", "hierarchy"] {
                assert!(text.contains(name), "{width}: {name} is missing\n{text}");
            }
            assert_eq!(text.contains("epoch"), width >= 120, "{text}");
            assert_eq!(below[0], "embedder does not answer; start it with `muster up embedder`");
        }
    }

    #[test]
    fn who_has_left_is_shown_with_when_and_bounded() {
        let status = |standing, count: u64| ServiceStatus {
            fleet: FleetId::new("alpha").unwrap(),
            service: ServiceName::Ingest,
            instance: InstanceId::new("base").unwrap(),
            version: "0.1.0".to_owned(),
            started: Tick(0),
            now: Tick(10_000_000_000),
            standing,
            revision: Revision::default(),
            state: String::new(),
            counters: BTreeMap::new(),
            departed: (0..count)
                .map(|number| Departure {
                    robot: RobotId::new(format!("r{number}")).unwrap(),
                    left: Tick(10_000_000_000 - 50_000_000 * (number + 1)),
                })
                .collect(),
        };
        assert_eq!(departed(&[status(ReplicaState::Leading, 0)]), None);
        let both = [status(ReplicaState::Leading, 2), status(ReplicaState::Standby, 1)];
        let shown = departed(&both).unwrap();
        assert_eq!(shown, "left within the last hour: r0 (50 s ago), r1 (1 min ago)");
        let many = departed(&[status(ReplicaState::Leading, 30)]).unwrap();
        assert!(many.ends_with(", and 6 more, see --json"), "{many}");
        let fleet = FleetStatus {
            fleet: FleetId::new("alpha").unwrap(),
            services: both.to_vec(),
            silent: vec![],
            joined: 0,
            roster: None,
            modalities: vec![],
            audit: None,
        };
        let lines = fleet.lines(&page(WIDTHS[0]), Tick(0));
        assert!(lines.contains(&shown), "{lines:?}");
        let json = serde_json::from_slice::<Value>(&fleet.json(Tick(0)).unwrap()).unwrap();
        assert_eq!(json["departed"].as_array().map(Vec::len), Some(2), "{json}");
    }

    #[test]
    fn a_modality_in_doubt_stands_out() {
        let graph = |modality, weight, trust| EmbeddingGraph {
            modality,
            revision: Revision::default(),
            weight,
            trust,
        };
        let graphs = [
            graph(Modality::spatial(), 0.5, 1.0),
            graph(Modality::connectivity(), 0.3, 0.6),
            graph(Modality::hierarchy(), 0.06, 0.2),
        ];
        assert_eq!(
            modalities(&graphs),
            "weights: spatial 0.50, connectivity 0.30 (trust 0.60), \
             hierarchy 0.06 (trust 0.20, IN DOUBT)"
        );
    }
}
