//! After a restart: what other services still hold of the last leader's output.
//!
//! A roster holds positions and superiors, a connectivity graph holds link reports (an edge runs to
//! the robot that reported it), a hierarchy the strengths of ties, a declared graph the relations.
//! What was reported of robots that the fleet did not know is not in them and is lost until it is
//! reported again.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::graph::{GraphDelta, GraphReplica, Node};
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId};
use muster_model::observation::{Observation, Pose, Rank, Stream};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::IngestSettings;
use muster_model::time::{Tick, seconds};
use muster_relation::hierarchy::DEFAULT_TIE;
use muster_wire::Message;

use crate::admission::{self, Content, Direction, Strength, direction};
use crate::roster::Fleet;

/// What a robot reported on one stream.
type Reported = (Stream, Content);

/// Restores the fleet from the newest roster and its graphs. Streams with a report in this run stay as they
/// are. Returns the restored robots.
///
/// A robot that was stale stays stale: its `last_seen` may be later than its pose, but its pose was older than
/// `stale_after_s` when the roster was published. A robot that was active gets the whole grace period
/// again; `last_seen` and the age of the data do not change.
pub(crate) fn restore(
    now: Tick,
    messages: &[Message],
    settings: &IngestSettings,
    fleet: &mut Fleet,
) -> BTreeSet<RobotId> {
    let rosters = outputs(messages).filter_map(|(revision, roster, _)| Some((revision, roster?)));
    let newest = rosters.max_by_key(|(revision, _)| *revision).map(|(_, roster)| roster);
    let Some(roster) = newest.filter(|roster| has_distinct_nodes(roster)) else {
        return BTreeSet::new();
    };
    // A token of a robot that the roster does not list is that of a hanging process that had left, or of a
    // robot that joined while no `ingest` ran. Soon after the last roster the first is far more likely,
    // and would stay for ever as a robot; the second joins by its first report, and without one it has
    // no team. Long after the last roster the fleet may be another one: all tokens count as robots.
    let published = roster.header.stages.last().map_or(Tick::default(), |stage| stage.published);
    if now.since(published) < seconds(settings.gone_after_s) {
        let listed: BTreeSet<_> = roster.robots.iter().map(|entry| &entry.robot).collect();
        fleet.remove_without_reports(|robot| listed.contains(robot));
    }
    let graphs = remembered_graphs(messages, roster);
    let mut reported = reports_of_graphs(&graphs, settings);
    let ties = graphs.get(&Modality::hierarchy()).map(Ties::new);
    let mut restored = BTreeSet::new();
    for entry in &roster.robots {
        let Ok((robot, _)) = fleet.find_or_join(now, &entry.robot, settings) else { continue };
        let last_seen = entry.last_seen.min(now);
        robot.restore(now, last_seen, entry.presence);
        let received = match entry.presence {
            Presence::Active => last_seen,
            Presence::Stale => {
                last_seen.min(published.min(now).before(seconds(settings.stale_after_s)))
            }
        };
        let mut contents = reported.remove(&entry.robot).unwrap_or_default();
        contents.extend(pose_of(entry, settings).map(|pose| (Stream::Pose, pose)));
        contents.extend(rank_of(entry, ties.as_ref()).map(|rank| (Stream::Rank, rank)));
        for (stream, content) in contents {
            fleet.restore_report(received, &entry.robot, stream, content);
        }
        restored.insert(entry.robot.clone());
    }
    fleet.update_presence_soon(now);
    restored
}

/// Rosters and graphs with their revisions.
fn outputs(
    messages: &[Message],
) -> impl Iterator<Item = (Revision, Option<&Roster>, Option<&GraphDelta>)> {
    messages.iter().filter_map(|message| match message {
        Message::Roster(roster) => Some((roster.header.revision, Some(roster.as_ref()), None)),
        Message::Graph(delta) => Some((delta.header.revision, None, Some(delta.as_ref()))),
        _ => None,
    })
}

fn has_distinct_nodes(roster: &Roster) -> bool {
    let nodes: BTreeSet<_> = roster.robots.iter().map(|entry| entry.node).collect();
    nodes.len() == roster.robots.len()
}

/// The graphs that a roster lists. A graph of the same term and another frame is better than none: a rank may
/// have been reported only once, long ago.
fn remembered_graphs(messages: &[Message], roster: &Roster) -> BTreeMap<Modality, GraphReplica> {
    let names: BTreeMap<Node, &RobotId> =
        roster.robots.iter().map(|entry| (entry.node, &entry.robot)).collect();
    let agrees = |graph: &GraphReplica| {
        graph.nodes().iter().all(|(node, robot)| names.get(node).is_none_or(|name| *name == robot))
    };
    let mut graphs = BTreeMap::new();
    for (modality, listed) in &roster.graphs {
        let of_term = outputs(messages)
            .filter(|(revision, ..)| revision.term == listed.term)
            .filter_map(|(revision, _, delta)| Some((revision, delta?)))
            .filter(|(_, delta)| delta.modality == *modality && delta.base.is_none())
            .filter_map(|(revision, delta)| {
                let mut graph = GraphReplica::default();
                graph.apply(delta).ok()?;
                agrees(&graph).then_some((revision, graph))
            });
        let best = of_term.max_by_key(|(revision, _)| (revision == listed, *revision));
        graphs.extend(best.map(|(_, graph)| (modality.clone(), graph)));
    }
    graphs
}

/// What the robots must have reported for the graphs to be what they are.
fn reports_of_graphs(
    graphs: &BTreeMap<Modality, GraphReplica>,
    settings: &IngestSettings,
) -> BTreeMap<RobotId, Vec<Reported>> {
    let mut reported: BTreeMap<RobotId, Vec<Reported>> = BTreeMap::new();
    let declared = settings.modalities.iter().cloned().map(Stream::Relation);
    for stream in Stream::BUILT_IN.into_iter().chain(declared) {
        let graph = graphs.get(&stream.modality());
        let Some((graph, direction)) = graph.zip(direction(&stream)) else { continue };
        let mut edges: BTreeMap<&RobotId, Vec<(RobotId, Strength)>> = BTreeMap::new();
        for (from, to, weight) in named_edges(graph) {
            let (robot, other, weight) = match direction {
                Direction::Incoming => (to, from, weight.min(1.0)),
                Direction::Outgoing => (from, to, weight),
            };
            edges.entry(robot).or_default().push((other.clone(), Strength::Weight(weight)));
        }
        for (robot, mut edges) in edges {
            edges.sort_unstable_by(|left, right| left.0.cmp(&right.0));
            let content = (stream.clone(), Content::Edges(edges));
            reported.entry(robot.clone()).or_default().push(content);
        }
    }
    reported
}

/// How strongly robots are tied to their superiors.
struct Ties<'a> {
    robots: BTreeSet<&'a RobotId>,
    strengths: BTreeMap<(&'a RobotId, &'a RobotId), f64>,
}

impl<'a> Ties<'a> {
    fn new(hierarchy: &'a GraphReplica) -> Self {
        Self {
            robots: hierarchy.nodes().values().collect(),
            strengths: named_edges(hierarchy)
                .map(|(superior, robot, weight)| ((superior, robot), weight))
                .collect(),
        }
    }

    /// 0 for a known superior without an edge. The tie to an unknown superior is in no graph: it gets the
    /// default.
    fn strength(&self, superior: &RobotId, robot: &RobotId) -> f64 {
        let unknown = if self.robots.contains(superior) { 0.0 } else { DEFAULT_TIE };
        self.strengths.get(&(superior, robot)).copied().unwrap_or(unknown)
    }
}

/// The edges between different robots, by name.
fn named_edges(graph: &GraphReplica) -> impl Iterator<Item = (&RobotId, &RobotId, f64)> {
    let nodes = graph.nodes();
    let edges = graph.rows().iter().flat_map(|(source, edges)| {
        edges.iter().map(move |(target, weight)| (*source, *target, *weight))
    });
    edges.filter(|(source, target, _)| source != target).filter_map(|(source, target, weight)| {
        Some((nodes.get(&source)?, nodes.get(&target)?, weight))
    })
}

/// The pose of an entry, if the settings accept it.
fn pose_of(entry: &RosterEntry, settings: &IngestSettings) -> Option<Content> {
    let [x, y, z] = entry.position?;
    let pose = Pose {
        x,
        y,
        z: Some(z),
        heading: entry.heading,
        frame: entry.frame.clone(),
        stamp: None,
        boot: None,
        seq: None,
    };
    pose.check().ok()?;
    admission::pose(settings, pose).ok()
}

/// The rank of an entry, if it is valid.
fn rank_of(entry: &RosterEntry, ties: Option<&Ties<'_>>) -> Option<Content> {
    let superior = entry.superior.as_ref();
    let rank = Rank {
        superior: superior.cloned(),
        weight: superior.zip(ties).map(|(superior, ties)| ties.strength(superior, &entry.robot)),
        role: entry.role.clone(),
        skills: Some(entry.skills.clone()).filter(|skills| !skills.is_empty()),
        stamp: None,
        boot: None,
        seq: None,
    };
    rank.check().and_then(|()| rank.check_reporter(&entry.robot)).ok()?;
    Some(admission::rank(rank))
}
