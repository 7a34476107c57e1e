//! The auditor on a bench: what it judges by what, what it tells, and when.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "this is a test, and so are its helpers"
)]

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use muster_auditor::{Auditor, Job};
use muster_machine::{Command, Core, Driver, Event, QueryId, START_FETCH, Start, Stored};
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
        for command in self.driver.step(self.now, event) {
            match command {
                Command::Publish(Message::Audit(audit)) => self.audits.push(audit),
                Command::Publish(Message::Event(event)) => self.events.push(event.kind),
                Command::Publish(Message::Settings(..)) | Command::Store(_) => {}
                Command::Publish(other) => panic!("{other:?}"),
                Command::Reply { query, answer, .. } => self.replies.push((query, answer)),
                Command::Run(job) => self.jobs.push_back(job),
                Command::Fetch { fetch, patterns } => self.fetches.push((fetch, patterns)),
            }
        }
        assert!(self.jobs.len() <= 1, "one job at a time");
        if !self.hold {
            self.run_job();
        }
    }

    fn run_job(&mut self) {
        if let Some(job) = self.jobs.pop_front() {
            self.jobs_run += 1;
            self.step(Event::Done(Auditor::run(job)));
        }
    }

    fn wait(&mut self, seconds: f64) {
        self.now = self.now.after(Duration::from_secs_f64(seconds));
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

#[test]
fn the_wiring_is_that_of_the_role() {
    let served = Auditor::wiring().served;
    assert!(served.contains(&(Pattern::One(Key::Audit), true)));
    for witnessed in [
        Pattern::One(Key::Teams),
        Pattern::One(Key::JsonTeams),
        Pattern::RobotTeams,
        Pattern::One(Key::Embedding),
        Pattern::One(Key::Roster),
    ] {
        assert!(served.contains(&(witnessed.clone(), false)), "{witnessed:?}");
    }
}

#[test]
fn nothing_is_said_before_the_term_has_begun() {
    let mut bench = Bench::new();
    bench.step(Event::Started);
    assert_eq!((bench.fetches.len(), bench.fetches[0].0), (1, START_FETCH));
    assert_eq!(bench.fetches[0].1.len(), 4);
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    bench.wait(100.0);
    assert!(bench.audits.is_empty() && bench.events.is_empty() && bench.jobs_run == 0);
    bench.step(Event::Fetched { fetch: START_FETCH, messages: vec![] });
    assert_eq!(bench.events, [EventKind::ServiceStarted { term: 1 }]);
    assert_eq!(bench.audit().header.revision, revision(1));
}

#[test]
fn a_division_is_judged_in_both_spaces() {
    let mut bench = Bench::begun(vec![]);
    bench.hear(roster(
        1,
        &[
            ("a", "map", Some([0.0, 0.0, 0.0])),
            ("b", "map", Some([0.0, 9.0, 2.0])),
            ("c", "other", Some([1.0, 1.0, 0.0])),
            ("d", "map", Some([5.0, 5.0, 1.0])),
            ("e", "map", None),
            ("f", "map", Some([4.0, 0.0, f64::NAN])),
            ("g", "map", Some([7.0, 5.0, 1.0])),
            ("loose", "other", Some([7.0, 5.0, 1.0])),
        ],
    ));
    let rows: Rows<'_> = &[
        ("a", [0.0, 0.0]),
        ("b", [0.5, 0.1]),
        ("c", [1.0, 0.3]),
        ("d", [0.9, -0.4]),
        ("e", [0.2, 0.7]),
        ("f", [0.3, 0.3]),
        ("g", [2.0, 2.0]),
        ("loose", [9.0, 9.0]),
    ];
    bench.hear(embedding(1, rows));
    bench.wait(0.5);
    bench.hold = true;
    bench.hear(teams(4, 1, &[("t1", "a d"), ("t2", "b c e"), ("t3", "f"), ("t10", "g")], "loose"));
    bench.wait(0.2);
    bench.run_job();
    let audit = bench.audit();
    assert_eq!((audit.teams, audit.embedding), (revision(4), revision(1)));
    let stage = audit.header.stages.last().unwrap();
    assert_eq!(stage.stage, ServiceName::Auditor);
    assert_eq!(stage.published.since(stage.received).as_millis(), 200);
    assert_eq!(audit.header.oldest, Some(START));

    let points: Vec<Vec<f64>> = rows[..7].iter().map(|row| row.1.to_vec()).collect();
    let labels = [1, 2, 2, 1, 2, 3, 10];
    check_report(&audit.in_embedding, &["a", "b", "c", "d", "e", "f", "g"], &points, &labels);
    assert_eq!(audit.in_embedding.space, Space::Embedding);
    let singleton = |name: &str| {
        audit.in_embedding.per_robot.iter().find(|(r, _)| r.as_str() == name).unwrap().1
    };
    assert_eq!((singleton("f"), singleton("g")), (0.0, 0.0));
    let points =
        [[0.0, 0.0, 0.0], [0.0, 9.0, 2.0], [5.0, 5.0, 1.0], [7.0, 5.0, 1.0]].map(|p| p.to_vec());
    check_report(&audit.in_physical, &["a", "b", "d", "g"], &points, &[1, 2, 1, 10]);
    assert_eq!(audit.in_physical.space, Space::Physical);
}

#[test]
fn fewer_than_two_teams_are_not_judged() {
    let mut bench = Bench::begun(vec![]);
    bench.hear(embedding(1, FOUR));
    for (epoch, division) in (1..).zip([&[][..], &[("t1", "a b c d")][..]]) {
        bench.hear(teams(epoch, 1, division, ""));
        let audit = bench.audits.pop().unwrap();
        assert_eq!(audit.verdict, Verdict::Undefined);
        for report in [&audit.in_embedding, &audit.in_physical] {
            assert_eq!(report.mean, None);
            assert!(report.per_robot.is_empty() && report.per_team.is_empty());
        }
    }
    assert!(bench.status().state.starts_with("undefined"));
    // Teams of robots that the embedding does not know are as good as none.
    bench.hear(teams(3, 1, &[("t1", "a b"), ("t2", "x y")], ""));
    assert_eq!(bench.audits.pop().unwrap().verdict, Verdict::Undefined);
}

#[test]
fn the_verdict_follows_the_thresholds() {
    let (mut bench, audit) = judged();
    assert_eq!(audit.verdict, Verdict::Good);
    assert_eq!(bench.status().state, "good, mean silhouette 0.84");
    // New thresholds judge the old silhouettes at once, without a job.
    bench.ask("service/auditor/settings", Some(r#"{"good":0.95}"#)).unwrap();
    assert_eq!(bench.audit().verdict, Verdict::Fair);
    bench.ask("service/auditor/settings", Some(r#"{"poor":0.9}"#)).unwrap();
    assert_eq!(bench.audit().verdict, Verdict::Poor);
    assert_eq!(bench.jobs_run, 1);
    assert!(bench.ask("service/auditor/settings", Some(r#"{"good":0.1}"#)).is_err());
    assert!(bench.audits.is_empty());
}

#[test]
fn an_unchanged_division_is_told_every_second_without_a_job() {
    let (mut bench, first) = judged();
    for epoch in 2..8 {
        bench.wait(0.1);
        bench.hear(embedding(epoch, FOUR));
        bench.hear(teams(epoch, epoch, PAIRS, ""));
    }
    assert!(bench.audits.is_empty());
    assert_eq!(bench.driver.deadline(), Some(START.after(Duration::from_secs(1))));
    bench.wait(0.45);
    let again = bench.audit();
    assert_eq!((again.teams, again.embedding), (revision(7), revision(7)), "as fresh as its data");
    assert_eq!(again.header.revision, revision(2));
    assert_eq!(again.in_embedding, first.in_embedding);
    // With nothing new at all it goes on, and grows older.
    bench.wait(1.0);
    assert_eq!(bench.audit().header.oldest, Some(START));
    assert_eq!(bench.jobs_run, 1);
    // New positions are something new.
    let positions = [("a", "map", Some([0.0; 3])), ("c", "map", Some([1.0; 3]))];
    bench.hear(roster(8, &positions));
    bench.hear(embedding(8, FOUR));
    bench.hear(teams(8, 8, PAIRS, ""));
    assert_eq!(bench.audit().in_physical.mean, Some(0.0));
    bench.hear(teams(9, 8, CROSSED, ""));
    assert!(bench.audit().in_embedding.mean.unwrap() < 0.0);
    assert_eq!(bench.counter("divisions_judged"), 3);
}

#[test]
fn the_roster_is_that_of_the_embedding_or_else_the_newest() {
    let at = |x: f64| {
        [
            ("a", "map", Some([0.0; 3])),
            ("b", "map", Some([1.0, 0.0, 0.0])),
            ("c", "map", Some([x, 0.0, 0.0])),
        ]
    };
    let mut bench = Bench::begun(vec![]);
    bench.hear(roster(1, &at(9.0)));
    bench.hear(roster(2, &at(3.0)));
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    let own = bench.audit().in_physical.mean.unwrap();
    let expected = |x: f64| {
        let points = [vec![0.0], vec![1.0], vec![x]];
        naive(&points, &[1, 1, 2]).iter().sum::<f64>() / 3.0
    };
    assert!((own - expected(9.0)).abs() < 1e-12);
    bench.hear(embedding(5, FOUR));
    bench.hear(teams(2, 5, PAIRS, ""));
    assert!((bench.audit().in_physical.mean.unwrap() - expected(3.0)).abs() < 1e-12);
    // The right one comes late.
    bench.hear(roster(4, &at(5.0)));
    assert!(bench.audits.is_empty());
    bench.hear(roster(5, &at(7.0)));
    assert!((bench.audit().in_physical.mean.unwrap() - expected(7.0)).abs() < 1e-12);
}

#[test]
fn of_two_frames_with_equally_many_robots_the_first_by_name_counts() {
    let mut bench = Bench::begun(vec![]);
    let at = |x: f64| Some([x, 0.0, 0.0]);
    bench.hear(roster(
        1,
        &[
            ("a", "hall", at(0.0)),
            ("b", "yard", at(1.0)),
            ("c", "hall", at(2.0)),
            ("d", "yard", at(3.0)),
        ],
    ));
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    let names: Vec<String> =
        bench.audit().in_physical.per_robot.iter().map(|(robot, _)| robot.to_string()).collect();
    assert_eq!(names, ["a", "c"]);
}

#[test]
fn a_division_waits_for_its_embedding() {
    let mut bench = Bench::begun(vec![]);
    bench.hear(teams(1, 1, PAIRS, ""));
    assert_eq!(bench.jobs_run, 0);
    assert_eq!(bench.status().state, "waiting for the embedding of a division");
    bench.wait(0.1);
    bench.hear(embedding(1, FOUR));
    assert_eq!(bench.audit().teams, revision(1));
    assert!(bench.fetches.is_empty());

    // One that does not come is asked for, again and again, and not for ever anew.
    bench.hear(embedding(3, FOUR));
    bench.hear(teams(2, 2, CROSSED, ""));
    bench.wait(0.1);
    bench.hear(teams(3, 2, CROSSED, ""));
    bench.wait(0.15);
    assert_eq!(bench.fetches.len(), 1);
    assert_eq!(bench.fetches[0].1.len(), 2);
    bench.step(Event::Fetched { fetch: bench.fetches[0].0, messages: vec![] });
    bench.audits.clear();
    bench.wait(0.5);
    assert_eq!(bench.fetches.len(), 1);
    bench.wait(0.5);
    assert_eq!(bench.fetches.len(), 2);
    // Whoever still has it answers, though a newer one is there.
    bench.audits.clear();
    let messages = vec![teams(3, 2, CROSSED, ""), embedding(2, FOUR)];
    bench.step(Event::Fetched { fetch: bench.fetches[0].0, messages });
    let audit = bench.audit();
    assert_eq!((audit.teams, audit.embedding), (revision(3), revision(2)));
    assert_eq!(bench.counter("messages_old"), 0);
}

#[test]
fn an_embedding_is_kept_until_its_division_comes() {
    let mut bench = Bench::begun(vec![]);
    let moved = |epoch: u64| [("a", [epoch as f64, 0.0]), ("b", [0.0, 1.0])];
    for epoch in 1..=40 {
        bench.hear(embedding(epoch, &moved(epoch)));
    }
    bench.hear(teams(1, 9, &[("t1", "a"), ("t2", "b")], ""));
    assert_eq!(bench.audit().embedding, revision(9));
    bench.hear(teams(2, 1, &[("t1", "a"), ("t2", "b")], ""));
    assert!(bench.audits.is_empty(), "that one is forgotten");
    bench.hear(teams(3, 40, &[("t1", "a"), ("t2", "b")], ""));
    assert_eq!(bench.audit().embedding, revision(40));
}

#[test]
fn a_restart_judges_what_others_remember() {
    let (_, last) = judged();
    let last = Arc::new(Audit {
        header: Header { revision: Revision { term: 7, epoch: 3 }, ..last.header.clone() },
        ..Audit::clone(&last)
    });
    let mut bench = Bench::begun(vec![Message::Audit(Arc::clone(&last))]);
    assert_eq!(bench.ask("audit", None).unwrap(), [Message::Audit(last.clone())]);
    assert_eq!(bench.driver.deadline(), None);
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    assert_eq!(bench.audit().header.revision, Revision { term: 8, epoch: 1 });

    // Answers come in any order.
    let messages = vec![
        teams(2, 1, PAIRS, ""),
        Message::Audit(last),
        embedding(1, FOUR),
        teams(1, 0, CROSSED, ""),
    ];
    let mut bench = Bench::begun(messages);
    assert_eq!(bench.audit().teams, revision(2));
    assert_eq!(bench.counter("messages_old"), 0);
}

#[test]
fn old_terms_and_epochs_are_dropped() {
    let (mut bench, _) = judged();
    bench.hear(embedding(5, FOUR));
    bench.hear(teams(5, 5, CROSSED, ""));
    bench.audit();
    bench.hear(teams(4, 5, PAIRS, ""));
    bench.hear(teams(5, 5, PAIRS, ""));
    bench.hear(embedding(4, FOUR));
    assert_eq!(bench.counter("messages_old"), 2);
    let Message::Teams { teams: mut old, mirror } = teams(900, 5, PAIRS, "") else { panic!() };
    Arc::make_mut(&mut old).header.revision.term = 0;
    bench.hear(Message::Teams { teams: old, mirror });
    assert_eq!(bench.counter("messages_old"), 3);
    assert!(bench.audits.is_empty());
}

#[test]
fn lasting_bad_quality_raises_one_alert() {
    let (mut bench, _) = judged();
    bench.hear(teams(2, 1, CROSSED, ""));
    assert!(bench.audit().verdict == Verdict::Poor && bench.events.is_empty());
    bench.wait(2.9);
    assert!(bench.events.is_empty());
    assert_eq!(bench.driver.deadline(), Some(START.after(Duration::from_secs(3))));
    bench.wait(0.1);
    assert!(matches!(bench.events[..], [EventKind::QualityLow { mean }] if mean < 0.0));
    for _ in 0..5 {
        bench.wait(2.0);
    }
    bench.hear(teams(3, 1, PAIRS, ""));
    assert!(matches!(bench.events[..], [_, EventKind::QualityRecovered { mean }] if mean > 0.3));
    assert_eq!(bench.counter("alerts"), 1);
    // A short dip is none.
    bench.hear(teams(4, 1, CROSSED, ""));
    bench.wait(2.0);
    bench.hear(teams(5, 1, PAIRS, ""));
    bench.wait(2.0);
    bench.hear(teams(6, 1, CROSSED, ""));
    bench.wait(2.0);
    assert_eq!(bench.events.len(), 2);
}

#[test]
fn a_failed_job_changes_nothing() {
    let (mut bench, first) = judged();
    bench.hold = true;
    bench.hear(teams(2, 1, CROSSED, ""));
    bench.jobs.clear();
    bench.step(Event::JobFailed("out of luck".to_owned()));
    assert_eq!(bench.events, [EventKind::JobFailed { reason: "out of luck".to_owned() }]);
    assert_eq!(bench.counter("jobs_failed"), 1);
    bench.hear(teams(3, 1, CROSSED, ""));
    assert!(bench.jobs.is_empty(), "it would fail again");
    bench.wait(1.0);
    let again = bench.audit();
    assert_eq!((again.teams, &again.in_embedding), (revision(1), &first.in_embedding));
    bench.hear(embedding(2, &[("a", [1e200, 0.0]), ("b", [0.0, 0.0])]));
    bench.hear(teams(4, 2, &[("t1", "a"), ("t2", "b")], ""));
    bench.run_job();
    assert!(
        matches!(&bench.events[1], EventKind::JobFailed { reason } if reason.contains("large"))
    );
}

#[test]
fn the_newest_division_follows_a_running_job() {
    let mut bench = Bench::begun(vec![]);
    bench.hold = true;
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, PAIRS, ""));
    bench.hear(teams(2, 1, CROSSED, ""));
    bench.hear(teams(3, 1, &[("t1", "a"), ("t2", "b c d")], ""));
    bench.hear(embedding(2, FOUR));
    bench.run_job();
    assert_eq!(bench.audit().teams, revision(1));
    bench.run_job();
    assert_eq!(bench.audit().teams, revision(3));
    assert!(bench.jobs.is_empty());
}

#[test]
fn every_get_has_exactly_one_answer() {
    let mut bench = Bench::new();
    let all = [
        "audit",
        "json/audit",
        "teams",
        "embedding",
        "roster",
        "robot/*/team",
        "robot/a/team",
        "x",
    ];
    for selector in all {
        assert!(bench.ask(selector, None).unwrap().is_empty(), "{selector}");
    }
    assert_eq!(bench.status().state, "waiting for a division");
    bench.step(Event::Started);
    bench.step(Event::Fetched { fetch: START_FETCH, messages: vec![] });
    bench.hear(roster(1, &[("a", "map", None)]));
    bench.hear(embedding(1, FOUR));
    bench.hear(teams(1, 1, &[("t1", "a b"), ("t2", "c")], "d"));
    let answers = [
        ("audit", 1),
        ("json/*", 2),
        ("json/audit", 1),
        ("*", 4),
        ("robot/*/team", 4),
        ("robot/d/team", 1),
        ("robot/x/team", 0),
    ];
    for (selector, count) in answers {
        assert_eq!(bench.ask(selector, None).unwrap().len(), count, "{selector}");
    }
    assert!(matches!(bench.ask("teams", None).unwrap()[..], [Message::Teams { .. }]));
    assert!(matches!(bench.ask("embedding", None).unwrap()[..], [Message::Embedding(_)]));
    assert!(matches!(bench.ask("roster", None).unwrap()[..], [Message::Roster(_)]));
    assert_eq!(bench.ask("service/auditor/settings", None).unwrap().len(), 1);
    assert_eq!(bench.ask("**", None).unwrap().len(), 1);
}

#[test]
fn refused_packets_are_told_of() {
    let mut bench = Bench::begun(vec![]);
    bench.events.clear();
    let rejection =
        Rejection { robot: None, key: "muster/v1/f/teams".into(), reason: "broken".into() };
    bench.step(Event::Rejected(rejection));
    // Contradictions do not pass the decoder; if one did, it would not pass here.
    bench.hear(teams(1, 1, &[("t1", "a"), ("t1", "b")], ""));
    assert!(matches!(bench.events[0], EventKind::Quarantined { count: 1, .. }));
    assert_eq!((bench.counter("messages_refused"), bench.jobs_run), (2, 0));
}

#[test]
fn after_a_lost_link_the_missed_is_fetched() {
    let (mut bench, _) = judged();
    bench.step(Event::LinkLost);
    bench.step(Event::LinkRestored);
    assert_eq!((bench.fetches.len(), bench.fetches[0].1.len()), (1, 3));
    bench.audit();
    let messages = vec![teams(2, 2, CROSSED, ""), embedding(2, FOUR)];
    bench.step(Event::Fetched { fetch: bench.fetches[0].0, messages });
    assert_eq!(bench.audit().teams, revision(2));
}

proptest! {
    #[test]
    fn silhouettes_are_those_of_the_definition(
        robots in prop::collection::vec(((-3_i8..4, -3_i8..4), 0_usize..4), 2..14)
    ) {
        let names: Vec<String> = (0..robots.len()).map(|i| format!("r{i:02}")).collect();
        let points: Vec<[f64; 2]> =
            robots.iter().map(|((x, y), _)| [f64::from(*x), f64::from(*y)]).collect();
        let rows: Vec<(&str, [f64; 2])> =
            names.iter().map(String::as_str).zip(points.iter().copied()).collect();
        let members: Vec<(String, String)> = (0..4)
            .map(|team| {
                let own = names.iter().zip(&robots).filter(|(_, robot)| robot.1 == team);
                let own: Vec<&str> = own.map(|(name, _)| name.as_str()).collect();
                (format!("t{team}"), own.join(" "))
            })
            .filter(|(_, own)| !own.is_empty())
            .collect();
        let division: Vec<(&str, &str)> =
            members.iter().map(|(team, own)| (team.as_str(), own.as_str())).collect();
        let mut bench = Bench::begun(vec![]);
        bench.hear(embedding(1, &rows));
        bench.hear(teams(1, 1, &division, ""));
        let audit = bench.audit();
        if division.len() < 2 {
            prop_assert_eq!(audit.verdict, Verdict::Undefined);
        } else {
            let points: Vec<Vec<f64>> = points.iter().map(|point| point.to_vec()).collect();
            let labels: Vec<usize> = robots.iter().map(|robot| robot.1).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            check_report(&audit.in_embedding, &names, &points, &labels);
        }
    }
}
