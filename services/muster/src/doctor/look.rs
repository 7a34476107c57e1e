//! What can be seen of a fleet from one place on the bus, in a few seconds.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_client::{
    Client, Error, Events, Feed, FleetPresence, ReceivedPose, RouterState, ServiceInstance,
};
use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::bridge::BridgeState;
use muster_model::embedding::Embedding;
use muster_model::event::{Event, EventKind};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::roster::{Presence, Roster};
use muster_model::settings::{AuditorSettings, ClustererSettings, IngestSettings};
use muster_model::status::ServiceStatus;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use muster_wire::ForeignPattern;
use muster_wire::message::quoted;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use tokio::time::timeout_at;

use super::findings::RosPrograms;
use crate::console::reply;

/// Most robots whose poses are received: enough to see a clock that is off, and no load on the bus of a
/// large fleet.
const MAX_SAMPLED_ROBOTS: usize = 32;

/// How soon a service must answer for its clock to be compared with ours: half of that is the error.
const CLOCK_TIMEOUT: Duration = Duration::from_millis(400);

/// The liveliness tokens of everything that runs ROS with `rmw_zenoh`.
const ROS_TOKENS: &str = "@ros2_lv/**";

/// Most events that are kept while listening.
const MAX_EVENTS: usize = 1024;

/// One running instance of a service.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Instance {
    pub(super) service: ServiceName,
    pub(super) instance: InstanceId,
    pub(super) version: String,
    pub(super) standing: ReplicaState,
    pub(super) term: u64,
    /// Seconds by which its clock is ahead of ours; none if its answer took too long.
    pub(super) clock_offset_s: Option<f64>,
}

/// Another fleet on the same bus.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Other {
    pub(super) fleet: FleetId,
    pub(super) services: usize,
    pub(super) robots: usize,
}

impl From<FleetPresence> for Other {
    fn from(FleetPresence { fleet, services, robots }: FleetPresence) -> Self {
        Self { fleet, services, robots }
    }
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
    /// Instances of services that are on the bus.
    pub(super) tokens: BTreeSet<ServiceInstance>,
    /// Robots that have joined.
    pub(super) robot_tokens: BTreeSet<RobotId>,
    pub(super) others: Vec<Other>,
    /// Programs of ROS on the bus.
    pub(super) ros: RosPrograms,
    /// The routers that say what they are.
    pub(super) routers: Vec<RouterState>,
    /// The bridges to robots of other protocols.
    pub(super) bridges: Vec<BridgeState>,
    /// What gets were answered with; an empty answer is one.
    pub(super) roster: Option<Arc<Roster>>,
    pub(super) embedding: Option<Arc<Embedding>>,
    pub(super) teams: Option<Arc<Teams>>,
    pub(super) audit: Option<Arc<Audit>>,
    pub(super) alerts: Option<Arc<Alerts>>,
    /// The settings that services answer with.
    pub(super) ingest: Option<IngestSettings>,
    pub(super) clusterer: Option<ClustererSettings>,
    pub(super) auditor: Option<AuditorSettings>,
    /// What was refused, failed or came into doubt while we listened.
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

    /// The status of a service's leader, or the newest of any other instance that answers.
    pub(super) fn status(&self, service: ServiceName) -> Option<&ServiceStatus> {
        let all = self.after.iter().filter(|status| status.service == service);
        all.max_by_key(|status| (status.standing == ReplicaState::Leading, status.revision))
    }
}

/// Looks and listens.
///
/// # Errors
/// If the client is closed.
pub(super) async fn look(
    client: &Client,
    fleet: &FleetId,
    listen_for: Duration,
) -> Result<Look, Error> {
    let clock = Clock::start();
    let events = client.events().await?;
    let ((before, instances), tokens, robot_tokens, fleets, ros, routers, roster) = tokio::try_join!(
        statuses(client, &clock),
        client.get_instances(),
        client.get_joined_robots(),
        client.get_fleets(),
        ros_programs(client),
        client.get_routers(),
        async { reply(client.get_roster().await) },
    )?;
    let known = robot_tokens.iter().cloned();
    let entries = roster.iter().flat_map(|roster| &roster.robots);
    let sampled: BTreeSet<RobotId> =
        known.chain(entries.map(|entry| entry.robot.clone())).take(MAX_SAMPLED_ROBOTS).collect();
    let poses = client.poses(sampled).await?;
    let until = tokio::time::Instant::now() + listen_for;
    let (events, robot_clocks) = tokio::join!(problems(events, until), clocks(poses, until));
    // What may have changed while we listened is asked for at the end.
    let ((after, _), roster, embedding, teams, audit, alerts, bridges, ingest, clusterer, auditor) =
        tokio::try_join!(
            statuses(client, &clock),
            async { reply(client.get_roster().await) },
            async { reply(client.get_embedding().await) },
            async { reply(client.get_teams().await) },
            async { reply(client.get_audit().await) },
            async { reply(client.get_alerts().await) },
            client.get_bridges(),
            settings(client, ServiceName::Ingest),
            settings(client, ServiceName::Clusterer),
            settings(client, ServiceName::Auditor),
        )?;
    let others = fleets.into_iter().filter(|other| other.fleet != *fleet).map(Other::from);
    Ok(Look {
        now: clock.now(),
        instances,
        before,
        after,
        tokens,
        robot_tokens,
        others: others.collect(),
        ros,
        routers,
        bridges,
        roster,
        embedding,
        teams,
        audit,
        alerts,
        ingest,
        clusterer,
        auditor,
        events,
        robot_clocks,
        listened: listen_for,
        fleet: fleet.clone(),
    })
}

/// The programs of ROS that have tokens.
async fn ros_programs(client: &Client) -> Result<RosPrograms, Error> {
    // The pattern is a constant, and right.
    let Ok(pattern) = ForeignPattern::new(ROS_TOKENS) else { return Ok(RosPrograms::default()) };
    Ok(RosPrograms::of_tokens(&client.get_foreign_tokens(&pattern).await?))
}

/// The statuses of all services, and their instances.
async fn statuses(
    client: &Client,
    clock: &Clock,
) -> Result<(Vec<ServiceStatus>, Vec<Instance>), Error> {
    let (mut statuses, mut instances) = (Vec::new(), Vec::new());
    let all = ServiceName::ALL.map(|service| status(client, clock, service));
    let [first, second, third, fourth, fifth, sixth] = all;
    let answers = tokio::try_join!(first, second, third, fourth, fifth, sixth)?;
    let answers = [answers.0, answers.1, answers.2, answers.3, answers.4, answers.5];
    for (status, clock_offset_s) in answers.concat() {
        instances.push(Instance {
            service: status.service,
            instance: status.instance.clone(),
            // Any client may answer a get: control characters are removed before they are printed.
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

/// The status of each instance of one service, with the offset of its clock.
async fn status(
    client: &Client,
    clock: &Clock,
    service: ServiceName,
) -> Result<Vec<(ServiceStatus, Option<f64>)>, Error> {
    let (begun, asked) = (Instant::now(), clock.now());
    let statuses = client.get_statuses(Some(service)).await?;
    let took = begun.elapsed();
    // Answers come together: one that is slow makes it unknown when the others were written.
    let middle = (took < CLOCK_TIMEOUT).then(|| asked.after(took / 2).as_seconds());
    let with_offset = |status: ServiceStatus| {
        let offset = middle.map(|middle| status.now.as_seconds() - middle);
        (status, offset)
    };
    Ok(statuses.into_iter().map(with_offset).collect())
}

/// The settings of a service; none if it does not answer, or with others than ours.
async fn settings<S: DeserializeOwned>(
    client: &Client,
    service: ServiceName,
) -> Result<Option<S>, Error> {
    match client.get_settings(service).await {
        Ok(settings) => Ok(serde_json::from_value(settings).ok()),
        Err(
            Error::Unanswered { .. }
            | Error::Unavailable { .. }
            | Error::Refused { .. }
            | Error::Denied { .. },
        ) => Ok(None),
        Err(error) => Err(error),
    }
}

/// What is refused, fails or comes into doubt until a moment.
async fn problems(mut events: Events, until: tokio::time::Instant) -> Vec<Event> {
    let mut problems = Vec::new();
    while let Ok(Ok(event)) = timeout_at(until, events.next()).await {
        let is_problem = matches!(
            event.kind,
            EventKind::Quarantined { .. }
                | EventKind::JobFailed { .. }
                | EventKind::ModalityDoubted { .. }
        );
        if is_problem && problems.len() < MAX_EVENTS {
            problems.push(event);
        }
    }
    problems
}

/// Compares the stamps of robots' poses with our clock until a moment.
async fn clocks(
    mut poses: Feed<ReceivedPose>,
    until: tokio::time::Instant,
) -> BTreeMap<RobotId, f64> {
    let mut clocks = BTreeMap::new();
    while let Ok(Ok(ReceivedPose { robot, pose, received })) = timeout_at(until, poses.next()).await
    {
        let Some(stamp) = pose.stamp else { continue };
        let offset = stamp - received.as_seconds();
        // The way of a message only makes stamps older: the least delayed one is the best estimate.
        let best = clocks.entry(robot).or_insert(offset);
        *best = best.max(offset);
    }
    clocks
}
