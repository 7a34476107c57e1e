//! The auditor on a bench: what it scores by what, what it publishes, and when.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "this is a test, and so are its helpers"
)]

mod alerts;
mod flapping;
mod properties;
mod scoring;
mod service;
mod teams;

use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_model::alert::Alerts;
use muster_model::audit::{Audit, Flapping, Quality, RobotReturns, SilhouetteReport, Space};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::event::EventKind;
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName, TeamId};
use muster_model::remembered::RememberedTeams;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::AuditorSettings;
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;
use muster_service::{Core, Input, ServedKey, Start, Stored, testkit};
use muster_wire::{Key, Message, Pattern, Rejection};
use proptest::prelude::*;

const START: Tick = Tick(1_000_000_000);

struct Bench {
    kit: testkit::Bench<Auditor>,
    audits: Vec<Arc<Audit>>,
    /// The newest list of alerts.
    alerts: Option<Arc<Alerts>>,
    events: Vec<EventKind>,
    /// The events of the list of alerts.
    alert_events: Vec<EventKind>,
}

impl Deref for Bench {
    type Target = testkit::Bench<Auditor>;

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
    fn new() -> Self {
        let kit = testkit::Bench::new(Start {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("i").unwrap(),
            now: START,
            settings: AuditorSettings::default(),
            stored: Stored::default(),
        });
        Self { kit, audits: Vec::new(), alerts: None, events: Vec::new(), alert_events: Vec::new() }
    }

    /// One that leads and found messages on the bus.
    fn leading(messages: Vec<Message>) -> Self {
        let mut bench = Self::new();
        bench.start(messages);
        bench
    }

    /// Sorts what was published since the last call.
    fn read(&mut self) -> &mut Self {
        assert!(self.unencodable.is_empty());
        for message in std::mem::take(&mut self.kit.published) {
            match message {
                Message::Audit(audit) => self.audits.push(audit),
                Message::Alerts(alerts) => self.alerts = Some(alerts),
                Message::Event(event) => match event.kind {
                    kind @ (EventKind::AlertRaised { .. }
                    | EventKind::AlertCleared { .. }
                    | EventKind::AlertAcknowledged { .. }
                    | EventKind::AlertsFolded { .. }) => self.alert_events.push(kind),
                    kind => self.events.push(kind),
                },
                Message::Settings(..) | Message::LeaseRenewal(..) => {}
                other => panic!("{other:?}"),
            }
        }
        self
    }

    /// The audits since [`Bench::audit`] or [`Bench::forget_audits`].
    fn audits(&mut self) -> &mut Vec<Arc<Audit>> {
        &mut self.read().audits
    }

    fn forget_audits(&mut self) {
        self.read().audits.clear();
    }

    /// The events since [`Bench::forget_events`].
    fn events(&mut self) -> &[EventKind] {
        &self.read().events
    }

    fn forget_events(&mut self) {
        self.read().events.clear();
    }

    /// The one audit that was published since the last call.
    fn audit(&mut self) -> Arc<Audit> {
        assert_eq!(self.audits().len(), 1, "exactly one audit");
        self.audits.pop().unwrap()
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
    Message::Embedding(Checked::new_unchecked(Embedding {
        header: header(epoch),
        roster: revision(epoch + 100),
        graphs: vec![],
        robots: rows.iter().map(|row| robot(row.0)).collect(),
        dimension: 2,
        values: rows.iter().flat_map(|row| row.1).collect(),
        without_embedding: vec![false; rows.len()],
        provisional: vec![false; rows.len()],
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
            teams_shown: None,
            team_scores: vec![],
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
        skills: vec![],
        last_seen: START,
    };
    let robots = robots.iter().map(entry).collect();
    Message::Roster(Checked::new_unchecked(Roster {
        header: header(epoch + 100),
        robots,
        graphs: vec![],
    }))
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
        considered: vec![],
        teams: teams.collect(),
        unassigned: unassigned.split_whitespace().map(robot).collect(),
        stale: vec![],
        inertia: 0.0,
        changes: vec![],
        next_team: 9,
        limited: None,
        needs: vec![],
        provisional: vec![],
        held: vec![],
        remembered: RememberedTeams::default(),
    };
    Message::Teams { teams: Checked::new_unchecked(teams), mirror: false }
}

const FOUR: Rows<'static> =
    &[("a", [0.0, 0.0]), ("b", [0.1, 0.0]), ("c", [1.0, 0.0]), ("d", [1.0, 0.2])];
const PAIRS: &[(&str, &str)] = &[("t1", "a b"), ("t2", "c d")];
const CROSSED: &[(&str, &str)] = &[("t1", "a c"), ("t2", "b d")];

fn scored() -> (Bench, Arc<Audit>) {
    let mut bench = Bench::leading(vec![]);
    bench.forget_events();
    bench.receive(embedding(1, FOUR));
    bench.receive(teams(1, 1, PAIRS, ""));
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
