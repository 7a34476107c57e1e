//! What can be seen of a fleet from one place on the bus, in a few seconds.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use muster_machine::Delivery;
use muster_model::event::{Event, EventKind};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::observation::Stream;
use muster_model::role::Standing;
use muster_model::roster::{Presence, Roster};
use muster_model::settings::{ClustererSettings, IngestSettings};
use muster_model::status::ServiceStatus;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_runtime::bus::{Answer, Ask, Bus};
use muster_runtime::clock::Clock;
use muster_runtime::inbox::Inbox;
use muster_wire::message::quoted;
use muster_wire::{Key, Message, Pattern};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use crate::ask::{self, ANSWER_WITHIN};

/// Most robots whose poses are listened to: enough to see a clock that is off, and no load on the
/// bus of a large fleet.
const MAX_SAMPLED: usize = 32;

/// How soon a service must answer for its clock to be compared with ours: half of that is the error.
const CLOCK_WITHIN: Duration = Duration::from_millis(400);

/// Most events that are kept while listening.
const MAX_EVENTS: usize = 1024;

/// One running instance of a service.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Instance {
    pub(super) service: ServiceName,
    pub(super) instance: InstanceId,
    pub(super) version: String,
    pub(super) standing: Standing,
    pub(super) term: u64,
    /// Seconds by which its clock is ahead of ours; none if its answer took too long to tell.
    pub(super) clock_offset_s: Option<f64>,
}

/// Another fleet on the same bus.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Other {
    pub(super) fleet: FleetId,
    pub(super) services: usize,
    pub(super) robots: usize,
}

/// What is seen of a fleet.
#[derive(Debug)]
pub(super) struct Look {
    pub(super) now: Tick,
    pub(super) fleet: FleetId,
    pub(super) instances: Vec<Instance>,
    /// The statuses before listening, and after it.
    pub(super) before: Vec<ServiceStatus>,
    pub(super) after: Vec<ServiceStatus>,
    /// Tokens of services.
    pub(super) tokens: BTreeSet<(ServiceName, InstanceId)>,
    /// Tokens of robots.
    pub(super) robot_tokens: BTreeSet<RobotId>,
    pub(super) others: Vec<Other>,
    /// Who answered for it, and what; an empty answer is one.
    pub(super) roster: Option<Arc<Roster>>,
    pub(super) embedding: bool,
    pub(super) teams: Option<Arc<Teams>>,
    /// The settings that services tell.
    pub(super) ingest: Option<IngestSettings>,
    pub(super) clusterer: Option<ClustererSettings>,
    /// What the services told while we listened.
    pub(super) events: Vec<Event>,
    /// Seconds by which stamps of robots were ahead of our clock when they arrived.
    pub(super) robot_clocks: BTreeMap<RobotId, f64>,
    /// How long that was.
    pub(super) listened: Duration,
}

impl Look {
    /// The robots in numbers.
    pub(super) fn robots(&self) -> Value {
        let entries = self.roster.iter().flat_map(|roster| &roster.robots);
        let count = |right: fn(&muster_model::roster::RosterEntry) -> bool| {
            entries.clone().filter(|entry| right(entry)).count()
        };
        json!({
            "known": count(|_| true),
            "active": count(|entry| entry.presence == Presence::Active),
            "stale": count(|entry| entry.presence == Presence::Stale),
            "placed": count(|entry| entry.position.is_some()),
            "tokens": self.robot_tokens.len(),
        })
    }

    /// The newest status of a service's holder, or of anybody who answers for it.
    pub(super) fn status(&self, service: ServiceName) -> Option<&ServiceStatus> {
        let all = self.after.iter().filter(|status| status.service == service);
        all.max_by_key(|status| (status.standing == Standing::Holding, status.revision))
    }
}

/// Looks and listens.
///
/// # Errors
/// If the session is closed.
pub(super) async fn look(bus: &Bus, listen_for: Duration) -> anyhow::Result<Look> {
    let clock = Clock::start();
    let events = events(bus).await?;
    let ((before, instances), tokens, robot_tokens, all_tokens, rosters) = tokio::try_join!(
        statuses(bus, &clock),
        bus.tokens(&Pattern::ServiceTokens, ANSWER_WITHIN),
        bus.tokens(&Pattern::RobotTokens, ANSWER_WITHIN),
        bus.tokens_of_all_fleets(ANSWER_WITHIN),
        ask::messages(bus, &Pattern::One(Key::Roster)),
    )?;
    let known: BTreeSet<RobotId> =
        robot_tokens.iter().filter_map(|key| key.robot().cloned()).collect();
    let entries = rosters.iter().filter_map(roster_of).flat_map(|roster| roster.robots.clone());
    let sampled: BTreeSet<RobotId> =
        known.iter().cloned().chain(entries.map(|entry| entry.robot)).take(MAX_SAMPLED).collect();
    let clocks = Arc::new(Mutex::new(BTreeMap::new()));
    for robot in sampled {
        listen_to(bus, robot, clock, &clocks).await?;
    }
    tokio::time::sleep(listen_for).await;
    // What may have changed while we listened is asked for at the end.
    let ((after, _), rosters, embeddings, divisions, ingest, clusterer) = tokio::try_join!(
        statuses(bus, &clock),
        ask::messages(bus, &Pattern::One(Key::Roster)),
        ask::messages(bus, &Pattern::One(Key::Embedding)),
        ask::messages(bus, &Pattern::One(Key::Teams)),
        settings(bus, ServiceName::Ingest),
        settings(bus, ServiceName::Clusterer),
    )?;
    let newest = |all: Vec<Message>| all.into_iter().max_by_key(ask::revision);
    let fleet = bus.space().fleet().clone();
    let robot_clocks = clocks.lock().unwrap_or_else(PoisonError::into_inner).clone();
    Ok(Look {
        now: clock.now(),
        instances,
        before,
        after,
        tokens: tokens
            .into_iter()
            .filter_map(|key| match key {
                Key::ServiceToken(service, instance) => Some((service, instance)),
                _ => None,
            })
            .collect(),
        robot_tokens: known,
        others: others(all_tokens, &fleet),
        roster: newest(rosters).as_ref().and_then(roster_of).cloned(),
        embedding: !embeddings.is_empty(),
        teams: newest(divisions).and_then(|message| match message {
            Message::Teams { teams, .. } => Some(teams),
            _ => None,
        }),
        ingest,
        clusterer,
        events: std::iter::from_fn(|| events.pop()).collect(),
        robot_clocks,
        listened: listen_for,
        fleet,
    })
}

fn roster_of(message: &Message) -> Option<&Arc<Roster>> {
    match message {
        Message::Roster(roster) => Some(roster),
        _ => None,
    }
}

/// What all services tell of themselves.
async fn statuses(bus: &Bus, clock: &Clock) -> anyhow::Result<(Vec<ServiceStatus>, Vec<Instance>)> {
    let (mut statuses, mut instances) = (Vec::new(), Vec::new());
    let all = ServiceName::ALL.map(|service| status(bus, clock, service));
    let [first, second, third, fourth] = all;
    let answers = tokio::try_join!(first, second, third, fourth)?;
    for (status, clock_offset_s) in [answers.0, answers.1, answers.2, answers.3].concat() {
        instances.push(Instance {
            service: status.service,
            instance: status.instance.clone(),
            // Anybody may answer a get: what is printed is made harmless.
            version: quoted(&status.version),
            standing: status.standing,
            term: status.revision.term,
            clock_offset_s,
        });
        statuses.push(status);
    }
    instances.sort_by(|left, right| {
        (left.service, &left.instance).cmp(&(right.service, &right.instance))
    });
    Ok((statuses, instances))
}

/// What the instances of one service tell of themselves, each with the offset of its clock.
async fn status(
    bus: &Bus,
    clock: &Clock,
    service: ServiceName,
) -> anyhow::Result<Vec<(ServiceStatus, Option<f64>)>> {
    let ask =
        Ask { parameters: "format=json", payload: None, within: ANSWER_WITHIN, everybody: true };
    let (begun, asked) = (Instant::now(), clock.now());
    let answers = bus.get(&Pattern::One(Key::Status(service)), ask).await?;
    let took = begun.elapsed();
    // Answers come together: one that is slow makes it unknown when the others were written.
    let middle = (took < CLOCK_WITHIN).then(|| asked.after(took / 2).as_seconds());
    let read = |answer| match answer {
        Answer::Packet(packet) => {
            serde_json::from_slice::<ServiceStatus>(&packet.payload.ok()?).ok()
        }
        Answer::Error(_) => None,
    };
    let statuses = answers.into_iter().filter_map(read);
    let own = statuses.filter(|status| status.service == service);
    Ok(own
        .map(|status| {
            let offset = middle.map(|middle| status.now.as_seconds() - middle);
            (status, offset)
        })
        .collect())
}

/// The settings that a service tells.
async fn settings<S: DeserializeOwned>(
    bus: &Bus,
    service: ServiceName,
) -> anyhow::Result<Option<S>> {
    let told = ask::messages(bus, &Pattern::One(Key::Settings(service))).await?;
    Ok(told.into_iter().find_map(|message| match message {
        Message::Settings(announced) => serde_json::from_str(&announced.settings).ok(),
        _ => None,
    }))
}

async fn events(bus: &Bus) -> anyhow::Result<Arc<Inbox<Event>>> {
    let inbox = Arc::new(Inbox::default());
    let (space, taking) = (bus.space().clone(), Arc::clone(&inbox));
    bus.subscribe(&Pattern::One(Key::Event), move |packet| {
        if let Ok(Message::Event(event)) = Message::decode(&space, &packet)
            && matches!(event.kind, EventKind::Quarantined { .. } | EventKind::JobFailed { .. })
        {
            taking.push(packet.key, event, 1, Delivery::Queue(MAX_EVENTS));
        }
    })
    .await?;
    Ok(inbox)
}

/// Compares the stamps of a robot's poses with our clock, as they arrive.
async fn listen_to(
    bus: &Bus,
    robot: RobotId,
    clock: Clock,
    clocks: &Arc<Mutex<BTreeMap<RobotId, f64>>>,
) -> anyhow::Result<()> {
    let (space, clocks) = (bus.space().clone(), Arc::clone(clocks));
    bus.subscribe(&Pattern::One(Key::Stream(robot, Stream::Pose)), move |packet| {
        let Ok(Message::Report(report)) = Message::decode(&space, &packet) else { return };
        let (robot, report) = report.into_parts();
        let Some(stamp) = report.provenance().stamp else { return };
        let offset = stamp - clock.now().as_seconds();
        let mut clocks = clocks.lock().unwrap_or_else(PoisonError::into_inner);
        // The way of a message only makes stamps older: the least delayed one tells most.
        let best = clocks.entry(robot).or_insert(offset);
        *best = best.max(offset);
    })
    .await
}

fn others(tokens: Vec<(FleetId, Key)>, own: &FleetId) -> Vec<Other> {
    let mut fleets: BTreeMap<FleetId, (usize, usize)> = BTreeMap::new();
    for (fleet, key) in tokens {
        let (services, robots) = fleets.entry(fleet).or_default();
        match key {
            Key::ServiceToken(..) => *services += 1,
            Key::RobotToken(_) => *robots += 1,
            _ => {}
        }
    }
    fleets.remove(own);
    let other = |(fleet, (services, robots))| Other { fleet, services, robots };
    fleets.into_iter().map(other).collect()
}
