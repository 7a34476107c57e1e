//! Graphs to deltas and whole frames, and when a frame is due.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use muster_model::content::Checked;
use muster_model::graph::{GraphDelta, GraphRow, Node};
use muster_model::header::{Header, Revision};
use muster_model::id::{Modality, RobotId};
use muster_model::observation::Stream;
use muster_model::roster::{Presence, Roster};
use muster_model::settings::IngestSettings;
use muster_model::time::{Tick, seconds};
use muster_service::Context;
use muster_wire::{Key, KeySpace, Message, Request};

use crate::Ingest;
use crate::graphs::{Places, changed_rows, spatial_rows};
use crate::robot::Robot;
use crate::roster::Fleet;

/// Longest time between two rosters, even if nothing changes: a roster says when each robot was last seen, and
/// repairs one that was lost. Slower frames have slower heartbeats.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// After each frame follows a pause of at least three times as long as it took to make and publish: on an
/// overloaded host the frame rate falls, so that `ingest` keeps receiving and its readers keep working.
const MAX_LOAD_DIVISOR: u32 = 4;

/// Longest time that a frame counts as having taken, so that a host that hung during one soon makes the next.
const MAX_FRAME_TIME: Duration = Duration::from_millis(250);

/// By how much timers come late on a machine with little to do. Frames that are late by no more do not move those after
/// them: a fleet that moves all the time has exactly as many a second as are set, and who puts just before one frame
/// puts just before the next.
const TIMER_DELAY: Duration = Duration::from_millis(5);

/// One graph as it was last published.
#[derive(Debug, Default)]
struct Graph {
    /// The head of the last delta; none before the first.
    header: Option<Header>,
    /// The rows that have edges, ordered by source.
    rows: Vec<GraphRow>,
    /// Whether what the graph is made of has changed since.
    dirty: bool,
}

/// What changed in one graph.
struct Step {
    base: Option<Revision>,
    changed: Vec<GraphRow>,
    rows: Option<Vec<GraphRow>>,
}

/// Which nodes came and went since the last frame.
#[derive(Default)]
struct NodeStep {
    added: Vec<(Node, RobotId)>,
    removed: Vec<Node>,
}

/// The last frame, and what changed since.
#[derive(Debug, Default)]
pub(crate) struct Frames {
    graphs: BTreeMap<Stream, Graph>,
    nodes: BTreeMap<Node, RobotId>,
    roster: Option<Checked<Roster>>,
    roster_dirty: bool,
    members_dirty: bool,
    /// The declared modalities, if they are new.
    declared: Option<Vec<Modality>>,
    changed: Option<Tick>,
    attempted: Option<Tick>,
    /// When a frame was begun whose end is not known yet.
    making: Option<Tick>,
    /// How long the last frame took.
    took: Duration,
    published: Option<Tick>,
}

impl Frames {
    /// What a stream's graph is made of has changed.
    pub(crate) fn touch(&mut self, now: Tick, stream: &Stream) {
        if let Some(graph) = self.graphs.get_mut(stream) {
            graph.dirty = true;
            self.changed.get_or_insert(now);
        }
    }

    /// What the roster says has changed.
    pub(crate) fn touch_roster(&mut self, now: Tick) {
        self.roster_dirty = true;
        self.changed.get_or_insert(now);
    }

    /// Robots came or went, with all edges that name them.
    pub(crate) fn touch_members(&mut self, now: Tick) {
        self.members_dirty = true;
        self.touch_all(now);
    }

    /// Settings are new: everything may be. Declared modalities come and go with the next frame, so
    /// that gets are answered with a whole frame until then.
    pub(crate) fn declare(&mut self, now: Tick, modalities: &[Modality]) {
        self.declared = Some(modalities.to_vec());
        self.touch_all(now);
    }

    fn touch_all(&mut self, now: Tick) {
        for graph in self.graphs.values_mut() {
            graph.dirty = true;
        }
        self.touch_roster(now);
    }

    /// A moment after the last frame was made and published: that of the next input.
    pub(crate) fn published(&mut self, now: Tick) {
        if let Some(begun) = self.making.take() {
            self.took = now.since(begun).min(MAX_FRAME_TIME);
        }
    }

    /// When an input is wanted only to learn how long the last frame took.
    pub(crate) fn publishing(&self) -> Option<Tick> {
        self.making
    }

    /// When the next frame is due.
    pub(crate) fn due(&self, settings: &IngestSettings) -> Option<Tick> {
        let heartbeat = self.published.map(|published| published.after(HEARTBEAT));
        let wanted = self.changed.into_iter().chain(heartbeat).min()?;
        Some(self.allowed(settings).map_or(wanted, |allowed| allowed.max(wanted)))
    }

    /// When the next frame may be made at the earliest.
    fn allowed(&self, settings: &IngestSettings) -> Option<Tick> {
        let pause = period(settings).max(self.took.saturating_mul(MAX_LOAD_DIVISOR));
        self.attempted.map(|last| last.after(pause))
    }

    /// Makes a frame: the deltas of the graphs that changed, then the roster. Nothing if nothing has
    /// changed and the last roster is recent.
    pub(crate) fn make(
        &mut self,
        context: &mut Context<'_, Ingest>,
        fleet: &Fleet,
    ) -> Vec<Message> {
        let now = context.now();
        let allowed = self.allowed(context.settings());
        let in_time = allowed.filter(|allowed| now.since(*allowed) <= TIMER_DELAY);
        self.attempted = Some(in_time.unwrap_or(now));
        self.making = Some(now);
        self.changed = None;
        if let Some(declared) = self.declared.take() {
            self.step_declared(declared);
        }
        let nodes = if std::mem::take(&mut self.members_dirty) {
            self.step_nodes(fleet)
        } else {
            NodeStep::default()
        };
        let steps = self.step_graphs(&nodes, fleet, context.settings());
        let is_recent = self.published.is_some_and(|published| now.since(published) < HEARTBEAT);
        if steps.is_empty() && !self.roster_dirty && is_recent {
            return Vec::new();
        }
        self.roster_dirty = false;
        self.published = Some(now);
        let header = header(context, fleet);
        let mut messages = self.publish_graphs(&nodes, steps, &header);
        let mut graphs: Vec<_> = self
            .graphs
            .iter()
            .filter_map(|(stream, graph)| {
                Some((stream.modality(), graph.header.as_ref()?.revision))
            })
            .collect();
        graphs.sort_unstable_by(|left, right| left.0.cmp(&right.0));
        let roster = Checked::new_unchecked(Roster { header, robots: fleet.entries(), graphs });
        self.roster = Some(roster.clone());
        messages.push(Message::Roster(roster));
        context.count("frames_published");
        messages
    }

    fn step_nodes(&mut self, fleet: &Fleet) -> NodeStep {
        let nodes: BTreeMap<_, _> =
            fleet.robots().iter().map(|(name, robot)| (robot.node, name.clone())).collect();
        let added = nodes.iter().filter(|(node, _)| !self.nodes.contains_key(node));
        let removed = self.nodes.keys().filter(|node| !nodes.contains_key(node));
        let step = NodeStep {
            added: added.map(|(node, name)| (*node, name.clone())).collect(),
            removed: removed.copied().collect(),
        };
        self.nodes = nodes;
        step
    }

    /// Brings the graphs in line with the declared modalities.
    fn step_declared(&mut self, declared: Vec<Modality>) {
        let declared = declared.into_iter().map(Stream::Relation);
        let streams: BTreeSet<_> = Stream::BUILT_IN.into_iter().chain(declared).collect();
        self.graphs.retain(|stream, _| streams.contains(stream));
        for stream in streams {
            self.graphs.entry(stream).or_insert_with(|| Graph { dirty: true, ..Graph::default() });
        }
    }

    /// What changed in which graph.
    fn step_graphs(
        &mut self,
        nodes: &NodeStep,
        fleet: &Fleet,
        settings: &IngestSettings,
    ) -> BTreeMap<Stream, Step> {
        let mut dirty = self.graphs.iter().filter(|(_, graph)| graph.dirty);
        let names_are_needed = dirty.any(|(stream, _)| *stream != Stream::Pose);
        let places = names_are_needed.then(|| Places::new(fleet));
        let mut steps = BTreeMap::new();
        for (stream, graph) in &mut self.graphs {
            let rows = std::mem::take(&mut graph.dirty).then(|| match (stream, &places) {
                (Stream::Pose, _) => Ok(spatial_rows(fleet, settings)),
                (stream, Some(places)) => places.rows(fleet, stream, settings),
                (_, None) => Ok(Vec::new()),
            });
            // Accepted reports satisfy the rules of edges; if they did not, the last good graph stands.
            let rows = rows.and_then(Result::ok);
            let changed = rows
                .as_ref()
                .map_or_else(Vec::new, |rows| changed_rows(&graph.rows, rows, &nodes.removed));
            let base = graph.header.as_ref().map(|header| header.revision);
            let nodes_changed = !nodes.added.is_empty() || !nodes.removed.is_empty();
            if base.is_none() || nodes_changed || !changed.is_empty() {
                steps.insert(stream.clone(), Step { base, changed, rows });
            }
        }
        steps
    }

    fn publish_graphs(
        &mut self,
        nodes: &NodeStep,
        steps: BTreeMap<Stream, Step>,
        header: &Header,
    ) -> Vec<Message> {
        let mut messages = Vec::new();
        for (stream, step) in steps {
            let Some(graph) = self.graphs.get_mut(&stream) else { continue };
            if let Some(rows) = step.rows {
                graph.rows = rows;
            }
            graph.header = Some(header.clone());
            let delta = match step.base {
                None => snapshot(header.clone(), stream.modality(), &self.nodes, &graph.rows),
                Some(base) => GraphDelta {
                    header: header.clone(),
                    modality: stream.modality(),
                    base: Some(base),
                    nodes_added: nodes.added.clone(),
                    nodes_removed: nodes.removed.clone(),
                    rows: step.changed,
                },
            };
            messages.push(Message::Graph(Arc::new(delta)));
        }
        messages
    }

    /// Edges of the graphs as they were last published.
    pub(crate) fn edge_count(&self) -> usize {
        self.graphs.values().flat_map(|graph| &graph.rows).map(|row| row.edges.len()).sum()
    }

    /// How many rosters are kept.
    pub(crate) fn roster_count(&self) -> usize {
        usize::from(self.roster.is_some())
    }

    /// What a get is answered with: the last roster and whole graphs, as far as they are selected.
    pub(crate) fn answer(&self, space: &KeySpace, request: &Request) -> Vec<Message> {
        let mut messages = Vec::new();
        for (stream, graph) in &self.graphs {
            let Some(header) = &graph.header else { continue };
            let modality = stream.modality();
            if request.selects(space, &Key::Graph(modality.clone())) {
                let delta = snapshot(header.clone(), modality, &self.nodes, &graph.rows);
                messages.push(Message::Graph(Arc::new(delta)));
            }
        }
        let roster = self.roster.iter().filter(|_| request.selects(space, &Key::Roster));
        messages.extend(roster.cloned().map(Message::Roster));
        messages
    }
}

fn period(settings: &IngestSettings) -> Duration {
    seconds(1.0 / settings.tick_hz)
}

fn header(context: &mut Context<'_, Ingest>, fleet: &Fleet) -> Header {
    let received = fleet.newest_message().unwrap_or(context.now());
    let all_stale = fleet.robots().values().all(|robot| robot.presence == Presence::Stale);
    let counts = |robot: &&Robot| all_stale || robot.presence == Presence::Active;
    let pose_received = |robot: &Robot| robot.pose.as_ref().map(|pose| pose.received);
    let poses = || fleet.robots().values().filter(counts).filter_map(pose_received);
    Header {
        fleet: context.fleet().clone(),
        revision: context.next_revision(),
        oldest: poses().min(),
        newest: poses().max(),
        stages: vec![context.stage(received)],
    }
}

fn snapshot(
    header: Header,
    modality: Modality,
    nodes: &BTreeMap<Node, RobotId>,
    rows: &[GraphRow],
) -> GraphDelta {
    GraphDelta {
        header,
        modality,
        base: None,
        nodes_added: nodes.iter().map(|(node, name)| (*node, name.clone())).collect(),
        nodes_removed: Vec::new(),
        rows: rows.to_vec(),
    }
}
