//! A small `ingest` that tells the truth, and a bench that carries out what the core wants.

// Each test file uses a part of it, and clippy's allowance for tests ends at `#[test]`.
#![allow(clippy::unwrap_used, clippy::panic, dead_code, unreachable_pub)]

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use muster_embedder::{Embedder, Job};
use muster_machine::{
    Command, Core, Driver, Event, QueryId, START_FETCH, Start, Stopwatch, Stored, TERM_FETCH,
};
use muster_model::embedding::Embedding;
use muster_model::event::EventKind;
use muster_model::graph::{GraphDelta, GraphReplica, GraphRow, Node};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, Modality, RobotId, ServiceName};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::EmbedderSettings;
use muster_model::time::Tick;
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::{Key, KeySpace, Message, Pattern, Request};

/// Seconds since the epoch at which every test begins, in microseconds.
const BEGIN: Tick = Tick(1_000_000_000_000);

pub fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub fn modality(name: &str) -> Modality {
    Modality::new(name).unwrap()
}

pub fn space() -> KeySpace {
    KeySpace::new(FleetId::new("f").unwrap())
}

/// What one frame puts on the bus: the graphs that changed, then the roster.
#[derive(Debug, Clone)]
pub struct Told {
    pub graphs: Vec<Arc<GraphDelta>>,
    pub roster: Arc<Roster>,
}

impl Told {
    pub fn graph(&self, name: &str) -> Message {
        let found = self.graphs.iter().find(|delta| delta.modality == modality(name));
        Message::Graph(found.unwrap().clone())
    }

    pub fn roster(&self) -> Message {
        Message::Roster(self.roster.clone())
    }

    pub fn messages(&self) -> impl Iterator<Item = Message> {
        self.graphs.iter().cloned().map(Message::Graph).chain([self.roster()])
    }
}

/// The truth, and what has been told of it.
#[derive(Debug, Default)]
pub struct Ingest {
    revision: Revision,
    next_node: Node,
    robots: BTreeMap<RobotId, Node>,
    edges: BTreeMap<Modality, BTreeMap<(RobotId, RobotId), f64>>,
    pub told: BTreeMap<Modality, GraphReplica>,
    last: Option<Arc<Roster>>,
}

impl Ingest {
    pub fn new(names: &[&str]) -> Self {
        let edges = names.iter().map(|name| (modality(name), BTreeMap::new())).collect();
        Self { revision: Revision { term: 1, epoch: 0 }, edges, ..Self::default() }
    }

    /// A fleet of two cliques of which each is related by every modality.
    pub fn two_cliques(names: &[&str], size: usize) -> Self {
        let mut ingest = Self::new(names);
        for name in names {
            ingest.clique(name, "a", size, 1.0);
            ingest.clique(name, "b", size, 0.9);
        }
        ingest
    }

    pub fn clique(&mut self, name: &str, prefix: &str, size: usize, weight: f64) {
        for i in 0..size {
            self.join(&format!("{prefix}{i}"));
        }
        for i in 0..size {
            for j in (0..size).filter(|j| *j != i) {
                self.edge(name, &format!("{prefix}{i}"), &format!("{prefix}{j}"), weight);
            }
        }
    }

    /// A new holder of the role: other node numbers, snapshots first.
    pub fn restart(&mut self) {
        self.revision = Revision { term: self.revision.term + 1, epoch: 0 };
        self.told.clear();
        self.last = None;
        self.next_node = 0;
        for node in self.robots.values_mut().rev() {
            *node = self.next_node;
            self.next_node += 1;
        }
    }

    pub fn join(&mut self, name: &str) {
        if let std::collections::btree_map::Entry::Vacant(entry) = self.robots.entry(robot(name)) {
            entry.insert(self.next_node);
            self.next_node += 1;
        }
    }

    pub fn leave(&mut self, name: &str) {
        self.robots.remove(&robot(name));
        for edges in self.edges.values_mut() {
            edges.retain(|(from, to), _| *from != robot(name) && *to != robot(name));
        }
    }

    /// Sets an edge between robots that are there; zero takes it away.
    pub fn edge(&mut self, name: &str, from: &str, to: &str, weight: f64) {
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

    pub fn count(&self) -> usize {
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
    pub fn frame(&mut self, now: Tick) -> Told {
        self.revision.epoch += 1;
        let mut graphs = Vec::new();
        for name in self.edges.keys().cloned().collect::<Vec<_>>() {
            let wanted = self.wanted(&name);
            let delta = match self.told.get(&name) {
                None => wanted.snapshot(self.header(now), name.clone()),
                Some(old) => difference(old, &wanted, self.header(now), &name),
            };
            let is_new = !self.told.contains_key(&name);
            if is_new || !is_empty(&delta) {
                self.told.entry(name).or_default().apply(&delta).unwrap();
                graphs.push(Arc::new(delta));
            }
        }
        let entry = |(robot, node): (&RobotId, &Node)| RosterEntry {
            node: *node,
            robot: robot.clone(),
            presence: Presence::Active,
            position: None,
            heading: None,
            frame: None,
            superior: None,
            role: None,
            last_seen: now,
        };
        let roster = Arc::new(Roster {
            header: self.header(now),
            robots: self.robots.iter().map(entry).collect(),
            graphs: self.told.iter().map(|(name, told)| (name.clone(), told.revision())).collect(),
        });
        self.last = Some(roster.clone());
        Told { graphs, roster }
    }

    /// What a get is answered with.
    pub fn answer(&self, patterns: &[Pattern]) -> Vec<Message> {
        let Some(roster) = &self.last else { return Vec::new() };
        let snapshot = |name: &Modality| {
            let snapshot = self.told.get(name)?.snapshot(roster.header.clone(), name.clone());
            Some(Message::Graph(Arc::new(snapshot)))
        };
        let mut messages = Vec::new();
        for pattern in patterns {
            match pattern {
                Pattern::One(Key::Roster) => messages.push(Message::Roster(roster.clone())),
                Pattern::One(Key::Graph(name)) => messages.extend(snapshot(name)),
                Pattern::Graphs => messages.extend(self.told.keys().filter_map(snapshot)),
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

/// The core with a shell in a few lines.
pub struct Bench {
    pub driver: Driver<Embedder>,
    pub now: Tick,
    pub published: Vec<Arc<Embedding>>,
    pub events: Vec<EventKind>,
    pub stored: Vec<Stored>,
    /// Jobs that wait to be run, if they are not run at once.
    pub jobs: VecDeque<Job>,
    pub hold_jobs: bool,
    /// Fetches of rosters and graphs that wait.
    pub fetches: VecDeque<(u32, Vec<Pattern>)>,
    /// How often the own last output was looked after.
    pub term_fetches: usize,
    /// Fetches of the clusterer's settings alone that wait.
    pub settings_fetches: VecDeque<u32>,
    pub replies: Vec<(QueryId, Result<Vec<Message>, String>)>,
    queries: u64,
}

impl Bench {
    /// A core that has seen no event.
    pub fn new(settings: EmbedderSettings) -> Self {
        let start = Start {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("i").unwrap(),
            now: BEGIN,
            settings,
            stored: Stored::default(),
        };
        Self {
            driver: Driver::new(start),
            now: BEGIN,
            published: Vec::new(),
            events: Vec::new(),
            stored: Vec::new(),
            jobs: VecDeque::new(),
            hold_jobs: false,
            fetches: VecDeque::new(),
            term_fetches: 0,
            settings_fetches: VecDeque::new(),
            replies: Vec::new(),
            queries: 0,
        }
    }

    /// A core that has started and whose first fetch was answered so.
    pub fn started(settings: EmbedderSettings, answers: Vec<Message>) -> Self {
        let mut bench = Self::new(settings);
        bench.step(Event::Started);
        assert_eq!(bench.fetches.pop_front().unwrap().0, START_FETCH);
        bench.step(Event::Fetched { fetch: START_FETCH, messages: answers });
        bench
    }

    /// The same with default settings and an empty bus.
    pub fn fresh() -> Self {
        Self::started(EmbedderSettings::default(), Vec::new())
    }

    pub fn step(&mut self, event: Event<<Embedder as Core>::Done>) {
        let mut in_doubt = None;
        for command in self.driver.step(self.now, event) {
            match command {
                Command::Fetch { fetch, patterns }
                    if patterns == [Pattern::One(Key::Holder(ServiceName::Embedder))] =>
                {
                    in_doubt = Some(fetch);
                }
                Command::Publish(Message::Embedding(embedding)) => {
                    assert_eq!(embedding.check(), Ok(()));
                    if let Some(last) = self.published.last() {
                        assert!(last.header.revision < embedding.header.revision);
                    }
                    self.published.push(embedding);
                }
                Command::Publish(Message::Event(event)) => self.events.push(event.kind),
                Command::Publish(_) => {}
                Command::Reply { query, answer, .. } => self.replies.push((query, answer)),
                Command::Run(job) => self.jobs.push_back(job),
                Command::Fetch { fetch: TERM_FETCH, patterns } => {
                    assert_eq!(patterns, [Pattern::One(Key::Embedding)]);
                    self.term_fetches += 1;
                }
                Command::Fetch { fetch, patterns } if patterns == [settings()] => {
                    self.settings_fetches.push_back(fetch);
                }
                Command::Fetch { fetch, patterns } => self.fetches.push_back((fetch, patterns)),
                Command::Store(stored) => self.stored.push(stored),
            }
        }
        // Nobody else holds the role.
        if let Some(fetch) = in_doubt {
            self.step(Event::Fetched { fetch, messages: Vec::new() });
        }
        assert!(self.jobs.len() <= 1, "one job runs at a time");
        if !self.hold_jobs {
            self.run_job();
        }
    }

    /// Runs the job that waits, if one does.
    pub fn run_job(&mut self) {
        if let Some(job) = self.jobs.pop_front() {
            self.step(Event::Done(Embedder::run(job, &mut Stopwatch::still())));
        }
    }

    pub fn receive(&mut self, message: Message) {
        self.step(Event::Received(message));
    }

    pub fn deliver(&mut self, told: &Told) {
        told.messages().for_each(|message| self.receive(message));
    }

    /// The next frame of the fleet, a tenth of a second later, whole.
    pub fn frame(&mut self, ingest: &mut Ingest) -> Told {
        self.pass(0.1);
        let told = ingest.frame(self.now);
        self.deliver(&told);
        told
    }

    /// Lets time pass, with a timeout whenever one is due.
    pub fn pass(&mut self, seconds: f64) {
        let end = self.now.after(Duration::from_secs_f64(seconds));
        let mut timeouts = 0;
        while let Some(due) = self.driver.deadline().filter(|due| *due <= end) {
            self.now = self.now.max(due);
            self.step(Event::Timeout);
            timeouts += 1;
            assert!(timeouts < 1000, "the core asks for timeouts without end");
        }
        self.now = end;
    }

    /// Answers the fetches that wait with the truth; how many there were.
    pub fn answer_fetches(&mut self, ingest: &Ingest) -> usize {
        let mut count = 0;
        while let Some((fetch, patterns)) = self.fetches.pop_front() {
            self.step(Event::Fetched { fetch, messages: ingest.answer(&patterns) });
            count += 1;
        }
        count
    }

    /// Asks, and requires one answer.
    pub fn ask(&mut self, key: &str, payload: Option<&str>) -> Result<Vec<Message>, String> {
        self.queries += 1;
        let query = QueryId(self.queries);
        let payload = payload.map(|text| text.as_bytes().to_vec());
        let request = Request::new(format!("muster/v1/f/{key}"), "", payload).unwrap();
        let before = self.replies.len();
        self.step(Event::Query { query, request });
        assert_eq!(self.replies.len(), before + 1);
        let (answered, answer) = self.replies[before].clone();
        assert_eq!(answered, query);
        answer
    }

    pub fn set(&mut self, patch: &str) {
        self.ask("service/embedder/settings", Some(patch)).unwrap();
    }

    pub fn told_teams(&mut self, settings: &str) {
        self.receive(announced(settings));
    }

    pub fn counter(&mut self, name: &str) -> u64 {
        match self.ask("service/embedder/status", None).unwrap().pop() {
            Some(Message::Status(status)) => status.counters.get(name).copied().unwrap_or(0),
            other => panic!("{other:?} is no status"),
        }
    }

    pub fn state(&mut self) -> String {
        match self.ask("service/embedder/status", None).unwrap().pop() {
            Some(Message::Status(status)) => status.state,
            other => panic!("{other:?} is no status"),
        }
    }

    pub fn last(&self) -> &Embedding {
        self.published.last().unwrap()
    }

    /// How often a failure was told.
    pub fn failures(&self) -> usize {
        self.events.iter().filter(|kind| matches!(kind, EventKind::JobFailed { .. })).count()
    }

    pub fn quarantined(&self) -> Vec<&EventKind> {
        let is = |kind: &&EventKind| matches!(kind, EventKind::Quarantined { .. });
        self.events.iter().filter(is).collect()
    }
}

/// The vector of a robot.
pub fn row<'a>(embedding: &'a Embedding, name: &str) -> &'a [f64] {
    let at = embedding.robots.binary_search(&robot(name)).unwrap();
    let dimension = embedding.dimension as usize;
    &embedding.values[at * dimension..(at + 1) * dimension]
}

pub fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}

/// Largest difference between the inner products of rows: zero if one embedding is the other turned.
pub fn difference_of_shape(left: &Embedding, right: &Embedding) -> f64 {
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

/// Where the clusterer's settings stand.
pub fn settings() -> Pattern {
    Pattern::One(Key::Settings(ServiceName::Clusterer))
}

/// Settings of the clusterer as it announces them.
pub fn announced(settings: &str) -> Message {
    announced_at(Revision { term: 1, epoch: 1 }, settings)
}

/// The same, beside a certain output of the clusterer.
pub fn announced_at(revision: Revision, settings: &str) -> Message {
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
    }))
}
