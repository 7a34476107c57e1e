//! The auditor on a bench: what it judges by what, what it tells, and when.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "this is a test, and so are its helpers"
)]

mod judging;
mod properties;
mod service;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use muster_auditor::{Auditor, Job};
use muster_machine::{
    Command, Core, Driver, Event, QueryId, START_FETCH, Start, Stopwatch, Stored, TERM_FETCH,
};
use muster_model::audit::{Audit, SilhouetteReport, Space, Verdict};
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::event::EventKind;
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName, TeamId};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::AuditorSettings;
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;
use muster_wire::{Key, Message, Pattern, Rejection, Request};
use proptest::prelude::*;

const START: Tick = Tick(1_000_000_000);

struct Bench {
    driver: Driver<Auditor>,
    now: Tick,
    hold: bool,
    jobs: VecDeque<Job>,
    jobs_run: usize,
    audits: Vec<Arc<Audit>>,
    events: Vec<EventKind>,
    fetches: Vec<(u32, Vec<Pattern>)>,
    queries: u64,
    replies: Vec<(QueryId, Result<Vec<Message>, String>)>,
}

impl Bench {
    fn new() -> Self {
        let start = Start {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("i").unwrap(),
            now: START,
            settings: AuditorSettings::default(),
            stored: Stored::default(),
        };
        Self {
            driver: Driver::new(start),
            now: START,
            hold: false,
            jobs: VecDeque::new(),
            jobs_run: 0,
            audits: Vec::new(),
            events: Vec::new(),
            fetches: Vec::new(),
            queries: 0,
            replies: Vec::new(),
        }
    }

    /// One that has begun its term with messages on the bus.
    fn begun(messages: Vec<Message>) -> Self {
        let mut bench = Self::new();
        bench.step(Event::Started);
        bench.fetches.clear();
        bench.step(Event::Fetched { fetch: START_FETCH, messages });
        bench
    }

    fn step(&mut self, event: Event<<Auditor as Core>::Done>) {
        let mut in_doubt = None;
        for command in self.driver.step(self.now, event) {
            match command {
                Command::Publish(Message::Audit(audit)) => self.audits.push(audit),
                Command::Publish(Message::Event(event)) => self.events.push(event.kind),
                Command::Publish(Message::Settings(..) | Message::Claim(..))
                | Command::Store(_) => {}
                Command::Publish(other) => panic!("{other:?}"),
                Command::Reply { query, answer, .. } => self.replies.push((query, answer)),
                Command::Run(job) => self.jobs.push_back(job),
                Command::Fetch { fetch, patterns }
                    if patterns == [Pattern::One(Key::Holder(ServiceName::Auditor))] =>
                {
                    in_doubt = Some(fetch);
                }
                Command::Fetch { fetch, patterns } => self.fetches.push((fetch, patterns)),
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

    fn run_job(&mut self) {
        if let Some(job) = self.jobs.pop_front() {
            self.jobs_run += 1;
            self.step(Event::Done(Auditor::run(job, &mut Stopwatch::still())));
        }
    }

    fn wait(&mut self, seconds: f64) {
        let end = self.now.after(Duration::from_secs_f64(seconds));
        // The process runs all the while, whatever else happens.
        while self.now < end {
            self.now = self.now.after(Duration::from_millis(400)).min(end);
            let instance = InstanceId::of_process("other", 1, 1);
            let (service, alive) = (ServiceName::Auditor, false);
            self.step(Event::Received(Message::ServiceToken { service, instance, alive }));
        }
        if self.driver.deadline().is_some_and(|due| due <= self.now) {
            self.step(Event::Timeout);
        }
    }

    fn hear(&mut self, message: Message) {
        self.step(Event::Received(message));
    }

    /// The one judgement that was told since the last look.
    fn audit(&mut self) -> Arc<Audit> {
        assert_eq!(self.audits.len(), 1, "exactly one audit");
        self.audits.pop().unwrap()
    }

    fn ask(&mut self, selector: &str, payload: Option<&str>) -> Result<Vec<Message>, String> {
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

    fn status(&mut self) -> muster_model::status::ServiceStatus {
        match self.ask("service/auditor/status", None).unwrap().as_slice() {
            [Message::Status(status)] => (**status).clone(),
            other => panic!("{other:?}"),
        }
    }

    fn counter(&mut self, name: &str) -> u64 {
        self.status().counters.get(name).copied().unwrap_or(0)
    }
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

fn revision(epoch: u64) -> Revision {
    Revision { term: 1, epoch }
}

fn header(epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("f").unwrap(),
        revision: revision(epoch),
        oldest: Some(START),
        newest: Some(START),
        stages: vec![],
    }
}

type Rows<'a> = &'a [(&'a str, [f64; 2])];

fn embedding(epoch: u64, rows: Rows<'_>) -> Message {
    Message::Embedding(Arc::new(Embedding {
        header: header(epoch),
        roster: revision(epoch + 100),
        graphs: vec![],
        robots: rows.iter().map(|row| robot(row.0)).collect(),
        dimension: 2,
        values: rows.iter().flat_map(|row| row.1).collect(),
        unseen: vec![false; rows.len()],
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
    }))
}

/// The roster of the embedding of an epoch: `(name, frame, place)`.
fn roster(epoch: u64, robots: &[(&str, &str, Option<[f64; 3]>)]) -> Message {
    let entry = |(name, frame, position): &(&str, &str, Option<[f64; 3]>)| RosterEntry {
        node: 0,
        robot: robot(name),
        presence: Presence::Active,
        position: *position,
        heading: None,
        frame: Some((*frame).to_owned()),
        superior: None,
        role: None,
        last_seen: START,
    };
    let robots = robots.iter().map(entry).collect();
    Message::Roster(Arc::new(Roster { header: header(epoch + 100), robots, graphs: vec![] }))
}

/// A division of the embedding of an epoch: `("t1", "a b c")`.
fn teams(epoch: u64, of: u64, teams: &[(&str, &str)], unassigned: &str) -> Message {
    let teams = teams.iter().map(|(id, names)| {
        let members: Vec<Member> = names
            .split_whitespace()
            .map(|name| Member { robot: robot(name), margin: 0.5 })
            .collect();
        let leader = members[0].robot.clone();
        Team { id: TeamId::new(id).unwrap(), members, leader, centroid: vec![] }
    });
    let teams = Teams {
        header: header(epoch),
        embedding: revision(of),
        requested: 2,
        teams: teams.collect(),
        unassigned: unassigned.split_whitespace().map(robot).collect(),
        stale: vec![],
        inertia: 0.0,
        changes: vec![],
        next_team: 9,
    };
    Message::Teams { teams: Arc::new(teams), mirror: false }
}

const FOUR: Rows<'static> =
    &[("a", [0.0, 0.0]), ("b", [0.1, 0.0]), ("c", [1.0, 0.0]), ("d", [1.0, 0.2])];
const PAIRS: &[(&str, &str)] = &[("t1", "a b"), ("t2", "c d")];
const CROSSED: &[(&str, &str)] = &[("t1", "a c"), ("t2", "b d")];

fn judged() -> (Bench, Arc<Audit>) {
    let mut bench = Bench::begun(vec![]);
    bench.events.clear();
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    let audit = bench.audit();
    (bench, audit)
}

/// Rousseeuw's definition, word for word.
fn naive(points: &[Vec<f64>], labels: &[usize]) -> Vec<f64> {
    let distance = |i: usize, j: usize| {
        points[i].iter().zip(&points[j]).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt()
    };
    let mean_to = |i: usize, label: usize| {
        let others: Vec<usize> =
            (0..points.len()).filter(|j| *j != i && labels[*j] == label).collect();
        let sum: f64 = others.iter().map(|j| distance(i, *j)).sum();
        (!others.is_empty()).then(|| sum / others.len() as f64)
    };
    let all: std::collections::BTreeSet<usize> = labels.iter().copied().collect();
    (0..points.len())
        .map(|i| {
            let Some(a) = mean_to(i, labels[i]) else { return 0.0 };
            let others = all.iter().filter(|label| **label != labels[i]);
            let b = others.filter_map(|label| mean_to(i, *label)).fold(f64::INFINITY, f64::min);
            if a.max(b) > 0.0 { (b - a) / a.max(b) } else { 0.0 }
        })
        .collect()
}

fn check_report(report: &SilhouetteReport, robots: &[&str], points: &[Vec<f64>], labels: &[usize]) {
    let expected = naive(points, labels);
    let names: Vec<&str> = report.per_robot.iter().map(|(robot, _)| robot.as_str()).collect();
    assert_eq!(names, robots);
    for ((robot, value), expected) in report.per_robot.iter().zip(&expected) {
        assert!((value - expected).abs() < 1e-12, "{robot}: {value} {expected}");
    }
    let mean = expected.iter().sum::<f64>() / expected.len() as f64;
    assert!((report.mean.unwrap() - mean).abs() < 1e-12);
    for (team, value) in &report.per_team {
        let label = team.as_str()[1..].parse::<usize>().unwrap();
        let own: Vec<f64> =
            expected.iter().zip(labels).filter(|(_, l)| **l == label).map(|(v, _)| *v).collect();
        assert!((value - own.iter().sum::<f64>() / own.len() as f64).abs() < 1e-12);
    }
    let mut teams = labels.to_vec();
    teams.sort_unstable();
    teams.dedup();
    assert_eq!(report.per_team.len(), teams.len());
}
