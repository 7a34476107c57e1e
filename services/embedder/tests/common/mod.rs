//! A small `ingest` that publishes the truth, and an embedder on the common bench.

// Each test file uses a part of it, and clippy's allowance for tests ends at `#[test]`.
use std::collections::{BTreeMap, VecDeque};
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use muster_embedder::Embedder;
use muster_model::content::{Checked, Content};
use muster_model::embedding::Embedding;
use muster_model::event::EventKind;
use muster_model::graph::{GraphDelta, GraphReplica, GraphRow, Node};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, Modality, RobotId, ServiceName};
use muster_model::roster::{Roster, RosterEntry};
use muster_model::settings::{Alpha, EmbedderSettings, Normalization};
use muster_model::time::Tick;
use muster_service::{Ask, Input, Start, Stored, testkit};
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::{Key, KeySpace, Message, Pattern};

/// Seconds since the epoch at which every test begins, in microseconds.
const BEGIN: Tick = Tick(1_000_000_000_000);

pub(crate) fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub(crate) fn modality(name: &str) -> Modality {
    Modality::new(name).unwrap()
}

/// Settings of which closed forms are known: graphs divided by their norms, without self-loops, αρ a half.
pub(crate) fn closed_forms() -> EmbedderSettings {
    EmbedderSettings {
        normalize: Normalization::Spectral,
        self_loops: 0.0,
        alpha: Alpha::Fraction { fraction: 0.5 },
        ..EmbedderSettings::default()
    }
}

/// What one frame puts on the bus: the graphs that changed, then the roster.
#[derive(Debug, Clone)]
pub(crate) struct Published {
    pub(crate) graphs: Vec<Arc<GraphDelta>>,
    pub(crate) roster: Checked<Roster>,
}

impl Published {
    pub(crate) fn graph(&self, name: &str) -> Message {
        let found = self.graphs.iter().find(|delta| delta.modality == modality(name));
        Message::Graph(found.unwrap().clone())
    }

    pub(crate) fn roster(&self) -> Message {
        Message::Roster(self.roster.clone())
    }

    pub(crate) fn messages(&self) -> impl Iterator<Item = Message> {
        self.graphs.iter().cloned().map(Message::Graph).chain([self.roster()])
    }
}

/// The truth, and what has been published of it.
#[derive(Debug, Default)]
pub(crate) struct Ingest {
    revision: Revision,
    next_node: Node,
    robots: BTreeMap<RobotId, Node>,
    edges: BTreeMap<Modality, BTreeMap<(RobotId, RobotId), f64>>,
    pub(crate) published: BTreeMap<Modality, GraphReplica>,
    last: Option<Checked<Roster>>,
}

impl Ingest {
    pub(crate) fn new(names: &[&str]) -> Self {
        let edges = names.iter().map(|name| (modality(name), BTreeMap::new())).collect();
        Self { revision: Revision { term: 1, epoch: 0 }, edges, ..Self::default() }
    }

    /// A fleet of two cliques of which each is related by every modality.
    pub(crate) fn two_cliques(names: &[&str], size: usize) -> Self {
        let mut ingest = Self::new(names);
        for name in names {
            ingest.clique(name, "a", size, 1.0);
            ingest.clique(name, "b", size, 0.9);
        }
        ingest
    }

    pub(crate) fn clique(&mut self, name: &str, prefix: &str, size: usize, weight: f64) {
        for i in 0..size {
            self.join(&format!("{prefix}{i}"));
        }
        for i in 0..size {
            for j in (0..size).filter(|j| *j != i) {
                self.edge(name, &format!("{prefix}{i}"), &format!("{prefix}{j}"), weight);
            }
        }
    }

    /// A new leader: other node numbers, snapshots first.
    pub(crate) fn restart(&mut self) {
        self.revision = Revision { term: self.revision.term + 1, epoch: 0 };
        self.published.clear();
        self.last = None;
        self.next_node = 0;
        for node in self.robots.values_mut().rev() {
            *node = self.next_node;
            self.next_node += 1;
        }
    }

    pub(crate) fn join(&mut self, name: &str) {
        if let std::collections::btree_map::Entry::Vacant(entry) = self.robots.entry(robot(name)) {
            entry.insert(self.next_node);
            self.next_node += 1;
        }
    }

    pub(crate) fn leave(&mut self, name: &str) {
        self.robots.remove(&robot(name));
        for edges in self.edges.values_mut() {
            edges.retain(|(from, to), _| *from != robot(name) && *to != robot(name));
        }
    }

    /// Sets an edge between robots that are there; zero takes it away.
    pub(crate) fn edge(&mut self, name: &str, from: &str, to: &str, weight: f64) {
        let ends = (robot(from), robot(to));
        if !self.robots.contains_key(&ends.0) || !self.robots.contains_key(&ends.1) {
            return;
        }
        let edges = self.edges.entry(modality(name)).or_default();
        if weight > 0.0 {
            edges.insert(ends, weight)
        } else {
            edges.remove(&ends)
        };
    }

    pub(crate) fn count(&self) -> usize {
        self.robots.len()
    }

    fn header(&self, now: Tick) -> Header {
        Header {
            fleet: FleetId::new("f").unwrap(),
            revision: self.revision,
            oldest: Some(now),
            newest: Some(now),
            stages: Vec::new(),
        }
    }

    fn wanted(&self, name: &Modality) -> GraphReplica {
        let mut rows: BTreeMap<Node, Vec<(Node, f64)>> = BTreeMap::new();
        for ((from, to), weight) in &self.edges[name] {
            rows.entry(self.robots[from]).or_default().push((self.robots[to], *weight));
        }
        let row = |(source, mut edges): (Node, Vec<(Node, f64)>)| {
            edges.sort_by_key(|edge| edge.0);
            GraphRow { source, edges }
        };
        let mut graph = GraphReplica::default();
        let whole = GraphDelta {
            header: self.header(BEGIN),
            modality: name.clone(),
            base: None,
            nodes_added: self.robots.iter().map(|(robot, node)| (*node, robot.clone())).collect(),
            nodes_removed: Vec::new(),
            rows: rows.into_iter().map(row).collect(),
        };
        graph.apply(&whole).unwrap();
        graph
    }

    /// The next frame.
    pub(crate) fn frame(&mut self, now: Tick) -> Published {
        self.revision.epoch += 1;
        let mut graphs = Vec::new();
        for name in self.edges.keys().cloned().collect::<Vec<_>>() {
            let wanted = self.wanted(&name);
            let delta = match self.published.get(&name) {
                None => wanted.snapshot(self.header(now), name.clone()),
                Some(old) => difference(old, &wanted, self.header(now), &name),
            };
            let is_new = !self.published.contains_key(&name);
            if is_new || !is_empty(&delta) {
                self.published.entry(name).or_default().apply(&delta).unwrap();
                graphs.push(Arc::new(delta));
            }
        }
        let entry =
            |(robot, node): (&RobotId, &Node)| RosterEntry::active(*node, robot.clone(), now);
        let roster = Checked::new_unchecked(Roster {
            header: self.header(now),
            robots: self.robots.iter().map(entry).collect(),
            graphs: self
                .published
                .iter()
                .map(|(name, graph)| (name.clone(), graph.revision()))
                .collect(),
        });
        self.last = Some(roster.clone());
        Published { graphs, roster }
    }

    /// What a get is answered with.
    pub(crate) fn answer(&self, patterns: &[Pattern]) -> Vec<Message> {
        let Some(roster) = &self.last else { return Vec::new() };
        let snapshot = |name: &Modality| {
            let snapshot = self.published.get(name)?.snapshot(roster.header.clone(), name.clone());
            Some(Message::Graph(Arc::new(snapshot)))
        };
        let mut messages = Vec::new();
        for pattern in patterns {
            match pattern {
                Pattern::One(Key::Roster) => messages.push(Message::Roster(roster.clone())),
                Pattern::One(Key::Graph(name)) => messages.extend(snapshot(name)),
                Pattern::Graphs => messages.extend(self.published.keys().filter_map(snapshot)),
                _ => {}
            }
        }
        messages
    }
}

fn difference(
    old: &GraphReplica,
    new: &GraphReplica,
    header: Header,
    name: &Modality,
) -> GraphDelta {
    let gone = |node: &&Node| !new.nodes().contains_key(node);
    let came = |(node, _): &(&Node, &RobotId)| !old.nodes().contains_key(node);
    // What a node that goes takes along is left out of the rows.
    let stays = |edges: &Vec<(Node, f64)>| {
        let kept = edges.iter().filter(|(to, _)| new.nodes().contains_key(to));
        kept.copied().collect::<Vec<_>>()
    };
    let sources = new.nodes().keys();
    let rows = sources.filter_map(|source| {
        let before = old.rows().get(source).map(stays).unwrap_or_default();
        let edges = new.rows().get(source).cloned().unwrap_or_default();
        (before != edges).then_some(GraphRow { source: *source, edges })
    });
    GraphDelta {
        header,
        modality: name.clone(),
        base: Some(old.revision()),
        nodes_added: new.nodes().iter().filter(came).map(|(n, r)| (*n, r.clone())).collect(),
        nodes_removed: old.nodes().keys().filter(gone).copied().collect(),
        rows: rows.collect(),
    }
}

fn is_empty(delta: &GraphDelta) -> bool {
    delta.nodes_added.is_empty() && delta.nodes_removed.is_empty() && delta.rows.is_empty()
}

/// An embedder on the common bench, with what it published and asks for in order.
pub(crate) struct Bench {
    kit: testkit::Bench<Embedder>,
    pub(crate) published: Vec<Checked<Embedding>>,
    pub(crate) events: Vec<EventKind>,
    /// Fetches of rosters and graphs that wait.
    pub(crate) fetches: VecDeque<Vec<Ask>>,
    /// Questions what readers have seen of the output that wait.
    pub(crate) term_checks: VecDeque<Vec<Ask>>,
    /// Fetches of the clusterer's settings alone that wait.
    pub(crate) settings_fetches: VecDeque<Vec<Ask>>,
}

impl Deref for Bench {
    type Target = testkit::Bench<Embedder>;

    fn deref(&self) -> &Self::Target {
        &self.kit
    }
}

impl DerefMut for Bench {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.kit
    }
}

impl Bench {
    /// One to which nothing has happened.
    pub(crate) fn new(settings: EmbedderSettings) -> Self {
        let start = Start {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("i").unwrap(),
            now: BEGIN,
            settings,
            stored: Stored::default(),
        };
        Self {
            kit: testkit::Bench::new(start),
            published: Vec::new(),
            events: Vec::new(),
            fetches: VecDeque::new(),
            term_checks: VecDeque::new(),
            settings_fetches: VecDeque::new(),
        }
    }

    /// One that leads, and whose inquiry two seconds ago is answered now.
    pub(crate) fn started(settings: EmbedderSettings, answers: Vec<Message>) -> Self {
        let mut bench = Self::new(settings);
        bench.kit.start(answers);
        bench.read();
        bench
    }

    /// One that begins after a power cut with what it has kept: no one answers its inquiry.
    pub(crate) fn restarted(settings: EmbedderSettings, kept: Vec<u8>) -> Self {
        let mut bench = Self::new(settings);
        bench.kit.input(Input::Restored(kept));
        bench.kit.start(Vec::new());
        bench.read();
        bench
    }

    /// The same with default settings and an empty bus.
    pub(crate) fn fresh() -> Self {
        Self::started(EmbedderSettings::default(), Vec::new())
    }

    /// Sorts what was published and asked for since the last call.
    fn read(&mut self) {
        assert!(self.unencodable.is_empty());
        for message in std::mem::take(&mut self.kit.published) {
            match message {
                Message::Embedding(embedding) => {
                    assert_eq!(embedding.check(), Ok(()));
                    if let Some(last) = self.published.last() {
                        assert!(last.header.revision < embedding.header.revision);
                    }
                    self.published.push(embedding);
                }
                Message::Event(event) => self.events.push(event.kind),
                Message::Settings(_) | Message::LeaseRenewal(_) => {}
                other => panic!("the embedder does not publish {other:?}"),
            }
        }
        for fetch in self.kit.take_fetches() {
            match patterns(&fetch)[..] {
                [Pattern::One(Key::Embedding)] => self.term_checks.push_back(fetch),
                [Pattern::One(Key::Settings(ServiceName::Clusterer))] => {
                    self.settings_fetches.push_back(fetch);
                }
                _ => self.fetches.push_back(fetch),
            }
        }
    }

    pub(crate) fn input(&mut self, input: Input) {
        self.kit.input(input);
        self.read();
    }

    /// Runs the job that waits, if one does.
    pub(crate) fn run_job(&mut self) {
        self.kit.run_job();
        self.read();
    }

    pub(crate) fn panic_job(&mut self, said: &str) {
        self.kit.panic_job(said);
        self.read();
    }

    pub(crate) fn receive(&mut self, message: Message) {
        self.kit.receive(message);
        self.read();
    }

    /// A message arrives as a packet, and is decoded.
    pub(crate) fn receive_encoded(&mut self, message: &Message) {
        let space = KeySpace::new(FleetId::new("f").unwrap());
        self.kit.receive_packet(message.to_packet(&space));
        self.read();
    }

    pub(crate) fn deliver(&mut self, frame: &Published) {
        frame.messages().for_each(|message| self.receive(message));
    }

    /// The next frame of the fleet, a tenth of a second later, whole.
    pub(crate) fn frame(&mut self, ingest: &mut Ingest) -> Published {
        self.wait(0.1);
        let frame = ingest.frame(self.now);
        self.deliver(&frame);
        frame
    }

    pub(crate) fn wait(&mut self, seconds: f64) {
        self.kit.wait(seconds);
        self.read();
    }

    pub(crate) fn answer_fetch(&mut self, fetch: Vec<Ask>, answers: Vec<Message>) {
        self.kit.answer_fetch(fetch, answers);
        self.read();
    }

    /// Answers the fetches that wait with the truth; how many there were.
    pub(crate) fn answer_fetches(&mut self, ingest: &Ingest) -> usize {
        let mut count = 0;
        while let Some(fetch) = self.fetches.pop_front() {
            let answers = ingest.answer(&patterns(&fetch));
            self.answer_fetch(fetch, answers);
            count += 1;
        }
        count
    }

    pub(crate) fn get(&mut self, key: &str, payload: Option<&str>) -> Result<Vec<Message>, String> {
        let answer = self.kit.get(key, payload);
        self.read();
        answer
    }

    pub(crate) fn set(&mut self, patch: &str) {
        self.get("service/embedder/settings", Some(patch)).unwrap();
    }

    /// The clusterer announces its settings.
    pub(crate) fn receive_teams(&mut self, settings: &str) {
        self.receive(announced(settings));
    }

    pub(crate) fn state(&mut self) -> String {
        match self.get("service/embedder/status", None).unwrap().pop() {
            Some(Message::Status(status)) => status.state,
            other => panic!("{other:?} is no status"),
        }
    }

    pub(crate) fn last(&self) -> &Embedding {
        self.published.last().unwrap()
    }

    /// How often a failure was reported.
    pub(crate) fn failures(&self) -> usize {
        self.events.iter().filter(|kind| matches!(kind, EventKind::JobFailed { .. })).count()
    }

    pub(crate) fn quarantined(&self) -> Vec<&EventKind> {
        let is = |kind: &&EventKind| matches!(kind, EventKind::Quarantined { .. });
        self.events.iter().filter(is).collect()
    }
}

/// What a fetch asks for.
pub(crate) fn patterns(fetch: &[Ask]) -> Vec<Pattern> {
    fetch.iter().map(|ask| ask.pattern.clone()).collect()
}

/// The vector of a robot.
pub(crate) fn row<'a>(embedding: &'a Embedding, name: &str) -> &'a [f64] {
    let at = embedding.robots.binary_search(&robot(name)).unwrap();
    let dimension = embedding.dimension as usize;
    &embedding.values[at * dimension..(at + 1) * dimension]
}

pub(crate) fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}

/// Largest difference between the inner products of rows: zero if one embedding is the other turned.
pub(crate) fn difference_of_shape(left: &Embedding, right: &Embedding) -> f64 {
    assert_eq!((&left.robots, left.dimension), (&right.robots, right.dimension));
    let rows = |embedding: &Embedding| -> Vec<Vec<f64>> {
        let dimension = embedding.dimension.max(1) as usize;
        embedding.values.chunks(dimension).map(<[f64]>::to_vec).collect()
    };
    let (left, right) = (rows(left), rows(right));
    let mut worst = 0.0_f64;
    for i in 0..left.len() {
        for j in 0..left.len() {
            worst = worst.max((dot(&left[i], &left[j]) - dot(&right[i], &right[j])).abs());
        }
    }
    worst
}

/// The key of the clusterer's settings.
pub(crate) fn settings() -> Pattern {
    Pattern::One(Key::Settings(ServiceName::Clusterer))
}

/// Settings of the clusterer as it announces them.
pub(crate) fn announced(settings: &str) -> Message {
    announced_at(Revision { term: 1, epoch: 1 }, settings)
}

/// The same, with the revision of a certain output of the clusterer.
pub(crate) fn announced_at(revision: Revision, settings: &str) -> Message {
    Message::Settings(Box::new(AnnouncedSettings {
        header: Header {
            fleet: FleetId::new("f").unwrap(),
            revision,
            oldest: None,
            newest: None,
            stages: Vec::new(),
        },
        service: ServiceName::Clusterer,
        settings: settings.to_owned(),
        changed: BTreeMap::new(),
    }))
}
