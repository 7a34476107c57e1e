//! A clusterer on a bench: time stands still unless it is moved, jobs run when they are let.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use muster_clusterer::{Clusterer, Job};
use muster_machine::{
    Command, Core, Driver, Event, QueryId, START_FETCH, Start, Stopwatch, Stored,
};
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::event::EventKind;
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::ClustererSettings;
use muster_model::teams::{RobotTeam, TeamChange, Teams};
use muster_model::time::Tick;
use muster_wire::{Message, Pattern, Request};

pub const START: Tick = Tick(1_000_000_000);

pub struct Bench {
    pub driver: Driver<Clusterer>,
    pub now: Tick,
    pub jobs: VecDeque<Job>,
    pub jobs_run: usize,
    /// Jobs wait in `jobs` instead of being run at once.
    pub hold: bool,
    pub sent: Vec<Message>,
    pub fetches: Vec<(u32, Vec<Pattern>)>,
    pub stored: Option<Stored>,
    queries: u64,
    replies: Vec<(QueryId, Result<Vec<Message>, String>)>,
}

impl Bench {
    /// One that has seen no event yet.
    pub fn new(settings: ClustererSettings) -> Self {
        Self::with(settings, Stored::default())
    }

    pub fn with(settings: ClustererSettings, stored: Stored) -> Self {
        let start = Start {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("i").unwrap(),
            now: START,
            settings,
            stored,
        };
        Self {
            driver: Driver::new(start),
            now: START,
            jobs: VecDeque::new(),
            jobs_run: 0,
            hold: false,
            sent: Vec::new(),
            fetches: Vec::new(),
            stored: None,
            queries: 0,
            replies: Vec::new(),
        }
    }

    /// One that has begun its term with nothing on the bus, and has forgotten what it said.
    pub fn begun(settings: ClustererSettings) -> Self {
        Self::restored(settings, vec![])
    }

    /// One that has begun its term with messages on the bus.
    pub fn restored(settings: ClustererSettings, messages: Vec<Message>) -> Self {
        let mut bench = Self::new(settings);
        bench.step(Event::Started);
        bench.step(Event::Fetched { fetch: START_FETCH, messages });
        bench
    }

    pub fn step(&mut self, event: Event<<Clusterer as Core>::Done>) {
        let mut in_doubt = None;
        for command in self.driver.step(self.now, event) {
            match command {
                Command::Publish(message) => self.sent.push(message),
                Command::Reply { query, answer, .. } => self.replies.push((query, answer)),
                Command::Run(job) => self.jobs.push_back(job),
                Command::Fetch { fetch, patterns }
                    if patterns
                        == [Pattern::One(muster_wire::Key::Holder(ServiceName::Clusterer))] =>
                {
                    in_doubt = Some(fetch);
                }
                Command::Fetch { fetch, patterns } => self.fetches.push((fetch, patterns)),
                Command::Store(stored) => self.stored = Some(stored),
            }
        }
        // Nobody else holds the role.
        if let Some(fetch) = in_doubt {
            self.step(Event::Fetched { fetch, messages: Vec::new() });
        }
        assert!(self.jobs.len() <= 1, "one job at a time");
        if !self.hold {
            self.run_job();
        }
    }

    /// Runs the job that waits, and those that follow unless they are held.
    pub fn run_job(&mut self) {
        if let Some(job) = self.jobs.pop_front() {
            self.jobs_run += 1;
            self.step(Event::Done(Clusterer::run(job, &mut Stopwatch::still())));
        }
    }

    pub fn wait(&mut self, seconds: f64) {
        let end = self.now.after(std::time::Duration::from_secs_f64(seconds));
        // The process runs all the while, whatever else happens.
        while self.now < end {
            self.now = self.now.after(std::time::Duration::from_millis(400)).min(end);
            let instance = InstanceId::of_process("other", 1, 1);
            let (service, alive) = (ServiceName::Clusterer, false);
            self.step(Event::Received(Message::ServiceToken { service, instance, alive }));
        }
        if self.driver.deadline().is_some_and(|due| due <= self.now) {
            self.step(Event::Timeout);
        }
    }

    pub fn hear(&mut self, embedding: &Arc<Embedding>) {
        self.step(Event::Received(Message::Embedding(Arc::clone(embedding))));
    }

    pub fn hear_roster(&mut self, roster: Roster) {
        self.step(Event::Received(Message::Roster(Arc::new(roster))));
    }

    /// Asks, and returns the answer, of which there is exactly one.
    pub fn ask(&mut self, selector: &str, payload: Option<&str>) -> Result<Vec<Message>, String> {
        self.queries += 1;
        let query = QueryId(self.queries);
        let payload = payload.map(|text| text.as_bytes().to_vec());
        let request = Request::new(format!("muster/v1/f/{selector}"), "", payload).unwrap();
        self.step(Event::Query { query, request });
        assert_eq!(self.replies.len(), 1, "exactly one answer to {selector}");
        let (answered, answer) = self.replies.pop().unwrap();
        assert_eq!(answered, query);
        answer
    }

    pub fn counter(&mut self, name: &str) -> u64 {
        self.status().counters.get(name).copied().unwrap_or(0)
    }

    pub fn status(&mut self) -> muster_model::status::ServiceStatus {
        match self.ask("service/clusterer/status", None).unwrap().as_slice() {
            [Message::Status(status)] => (**status).clone(),
            other => panic!("{other:?}"),
        }
    }

    /// What was sent since the last look.
    pub fn take(&mut self) -> Sent {
        let mut sent = Sent::default();
        for message in self.sent.drain(..) {
            match message {
                Message::Teams { teams, mirror } => {
                    assert_eq!(teams.check(), Ok(()));
                    sent.teams.push((teams, mirror));
                }
                Message::RobotTeam(told) => sent.robots.push(told),
                Message::Event(event) => sent.events.push(event.kind),
                Message::Settings(..) => sent.settings += 1,
                Message::Claim(..) => {}
                other => panic!("{other:?}"),
            }
        }
        sent
    }

    /// The one division that was sent since the last look.
    pub fn division(&mut self) -> Arc<Teams> {
        self.take().division()
    }
}

#[derive(Default, Debug)]
pub struct Sent {
    pub teams: Vec<(Arc<Teams>, bool)>,
    pub robots: Vec<RobotTeam>,
    pub events: Vec<EventKind>,
    pub settings: usize,
}

impl Sent {
    pub fn division(&self) -> Arc<Teams> {
        assert_eq!(self.teams.len(), 1, "exactly one division in {self:?}");
        Arc::clone(&self.teams[0].0)
    }

    pub fn changes(&self) -> Vec<TeamChange> {
        let change = |kind: &EventKind| match kind {
            EventKind::TeamChanged(change) => Some(change.clone()),
            _ => None,
        };
        self.events.iter().filter_map(change).collect()
    }

    pub fn robots_told(&self) -> String {
        let names: BTreeSet<&str> = self.robots.iter().map(|told| told.robot.as_str()).collect();
        assert_eq!(names.len(), self.robots.len(), "nobody is told twice");
        names.into_iter().collect::<Vec<_>>().join(" ")
    }
}

pub fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub fn header(term: u64, epoch: u64) -> Header {
    let stage = |stage| StageTime { stage, received: START, published: START };
    Header {
        fleet: FleetId::new("f").unwrap(),
        revision: Revision { term, epoch },
        oldest: Some(START),
        newest: Some(START),
        stages: vec![stage(ServiceName::Ingest), stage(ServiceName::Embedder)],
    }
}

/// An embedding of term 1: `(names, place)` puts some robots at one place, a bit apart from each
/// other; a name that ends in `!` is unseen.
pub fn embedding(epoch: u64, groups: &[(&str, [f64; 2])]) -> Arc<Embedding> {
    let mut rows: Vec<(RobotId, Vec<f64>, bool)> = Vec::new();
    for (names, place) in groups {
        for (i, name) in names.split_whitespace().enumerate() {
            let unseen = name.ends_with('!');
            let apart = f64::from(u32::try_from(i).unwrap()) * 1e-3;
            let name = robot(name.trim_end_matches('!'));
            rows.push((name, vec![place[0] + apart, place[1] - apart * apart], unseen));
        }
    }
    from_rows(1, epoch, rows)
}

pub fn from_rows(
    term: u64,
    epoch: u64,
    mut rows: Vec<(RobotId, Vec<f64>, bool)>,
) -> Arc<Embedding> {
    rows.sort_by(|left, right| left.0.cmp(&right.0));
    Arc::new(Embedding {
        header: header(term, epoch),
        roster: Revision { term, epoch },
        graphs: vec![],
        robots: rows.iter().map(|row| row.0.clone()).collect(),
        dimension: 2,
        values: rows.iter().flat_map(|row| row.1.clone()).collect(),
        unseen: rows.iter().map(|row| row.2).collect(),
        centrality: vec![1.0; rows.len()],
        quality: EmbeddingQuality {
            spectral_radius: (1.0, 1.0),
            alpha: 0.5,
            singular_values: vec![1.0],
            next_singular_value: 0.1,
            residual: 0.0,
            katz_residual: 0.0,
            gap: 0.9,
            ambiguous: false,
            mode: EmbeddingMode::Dense,
            stage_us: [0; 3],
        },
    })
}

/// The same data, later.
pub fn again(embedding: &Embedding, term: u64, epoch: u64) -> Arc<Embedding> {
    Arc::new(Embedding { header: header(term, epoch), ..embedding.clone() })
}

/// A roster: `"a<b"` answers to b, `"a?"` is stale.
pub fn roster(epoch: u64, robots: &str) -> Roster {
    let mut entries: Vec<RosterEntry> = robots
        .split_whitespace()
        .enumerate()
        .map(|(node, text)| {
            let stale = text.ends_with('?');
            let text = text.trim_end_matches('?');
            let (name, superior) = match text.split_once('<') {
                Some((name, superior)) => (name, Some(robot(superior))),
                None => (text, None),
            };
            RosterEntry {
                node: u32::try_from(node).unwrap(),
                robot: robot(name),
                presence: if stale { Presence::Stale } else { Presence::Active },
                position: None,
                heading: None,
                frame: None,
                superior,
                role: None,
                last_seen: START,
            }
        })
        .collect();
    entries.sort_by(|left, right| left.robot.cmp(&right.robot));
    Roster { header: header(1, epoch), robots: entries, graphs: vec![] }
}

/// A division in short: `t1: a b | t2: c d | - e`.
pub fn short(teams: &Teams) -> String {
    let mut parts: Vec<String> = teams
        .teams
        .iter()
        .map(|team| {
            let names: Vec<_> = team.members.iter().map(|m| m.robot.as_str()).collect();
            format!("{}: {}", team.id, names.join(" "))
        })
        .collect();
    if !teams.unassigned.is_empty() {
        let names: Vec<_> = teams.unassigned.iter().map(RobotId::as_str).collect();
        parts.push(format!("- {}", names.join(" ")));
    }
    parts.join(" | ")
}

/// The leaders in the order of the teams.
pub fn leaders(teams: &Teams) -> Vec<&str> {
    teams.teams.iter().map(|team| team.leader.as_str()).collect()
}

/// Changes in short: `born t1`, `split t1 t2`, `merged t2 t1`, `died t3`, `moved a t1 t2`.
pub fn told(changes: &[TeamChange]) -> Vec<String> {
    changes
        .iter()
        .map(|change| match change {
            TeamChange::Born { team } => format!("born {team}"),
            TeamChange::Died { team } => format!("died {team}"),
            TeamChange::Split { from, into } => format!("split {from} {into}"),
            TeamChange::Merged { from, into } => format!("merged {from} {into}"),
            TeamChange::Moved { robot, from, to } => {
                let name = |team: &Option<muster_model::id::TeamId>| {
                    team.as_ref().map_or("-".to_owned(), ToString::to_string)
                };
                format!("moved {robot} {} {}", name(from), name(to))
            }
        })
        .collect()
}
