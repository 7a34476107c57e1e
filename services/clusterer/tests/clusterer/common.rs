//! A clusterer on the common bench, and the messages that it receives.

use std::collections::BTreeSet;
use std::ops::{Deref, DerefMut};

use muster_clusterer::Clusterer;
use muster_model::content::{Checked, Content};
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::event::EventKind;
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName, SkillId};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::ClustererSettings;
use muster_model::teams::{RobotTeam, TeamChange, Teams};
use muster_model::time::Tick;
use muster_service::{Start, Stored, testkit};
use muster_wire::Message;

pub const START: Tick = Tick(1_000_000_000);

pub struct Bench(testkit::Bench<Clusterer>);

impl Deref for Bench {
    type Target = testkit::Bench<Clusterer>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl DerefMut for Bench {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl Bench {
    /// One to which nothing has happened.
    pub fn new(settings: ClustererSettings) -> Self {
        Self::begun(START, settings)
    }

    /// The same, whose process begins at another time.
    pub fn begun(now: Tick, settings: ClustererSettings) -> Self {
        Self(testkit::Bench::new(Start {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::new("i").unwrap(),
            now,
            settings,
            stored: Stored::default(),
        }))
    }

    /// One that leads and found nothing on the bus.
    pub fn leading(settings: ClustererSettings) -> Self {
        Self::restored(settings, vec![])
    }

    /// One that leads and found messages on the bus.
    pub fn restored(settings: ClustererSettings, messages: Vec<Message>) -> Self {
        let mut bench = Self::new(settings);
        bench.start(messages);
        bench
    }

    pub fn receive_embedding(&mut self, embedding: &Checked<Embedding>) {
        self.receive(Message::Embedding(embedding.clone()));
    }

    pub fn receive_roster(&mut self, roster: Roster) {
        self.receive(Message::Roster(Checked::new_unchecked(roster)));
    }

    /// What was published since the last call.
    pub fn take(&mut self) -> Published {
        assert!(self.unencodable.is_empty());
        let mut published = Published::default();
        for message in self.published.drain(..) {
            match message {
                Message::Teams { teams, mirror } => {
                    assert_eq!(teams.check(), Ok(()));
                    published.teams.push((teams, mirror));
                }
                Message::RobotTeam(team) => published.robots.push(team),
                Message::Event(event) => published.events.push(event.kind),
                Message::Settings(..) => published.settings += 1,
                Message::LeaseRenewal(..) | Message::Wishes(_) => {}
                other => panic!("{other:?}"),
            }
        }
        published
    }

    /// The one division that was published since the last call.
    pub fn division(&mut self) -> Checked<Teams> {
        self.take().division()
    }
}

#[derive(Default, Debug)]
pub struct Published {
    pub teams: Vec<(Checked<Teams>, bool)>,
    pub robots: Vec<RobotTeam>,
    pub events: Vec<EventKind>,
    pub settings: usize,
}

impl Published {
    pub fn division(&self) -> Checked<Teams> {
        assert_eq!(self.teams.len(), 1, "exactly one division in {self:?}");
        self.teams[0].0.clone()
    }

    pub fn changes(&self) -> Vec<TeamChange> {
        let change = |kind: &EventKind| match kind {
            EventKind::TeamChanged(change) => Some(change.clone()),
            _ => None,
        };
        self.events.iter().filter_map(change).collect()
    }

    pub fn informed_robots(&self) -> String {
        let names: BTreeSet<&str> = self.robots.iter().map(|team| team.robot.as_str()).collect();
        assert_eq!(names.len(), self.robots.len(), "no robot is informed twice");
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
/// other; a name that ends in `!` has no embedding.
pub fn embedding(epoch: u64, groups: &[(&str, [f64; 2])]) -> Checked<Embedding> {
    let mut rows: Vec<(RobotId, Vec<f64>, bool)> = Vec::new();
    for (names, place) in groups {
        for (i, name) in names.split_whitespace().enumerate() {
            let without = name.ends_with('!');
            let apart = f64::from(u32::try_from(i).unwrap()) * 1e-3;
            let name = robot(name.trim_end_matches('!'));
            rows.push((name, vec![place[0] + apart, place[1] - apart * apart], without));
        }
    }
    from_rows(1, epoch, rows)
}

pub fn from_rows(
    term: u64,
    epoch: u64,
    mut rows: Vec<(RobotId, Vec<f64>, bool)>,
) -> Checked<Embedding> {
    rows.sort_by(|left, right| left.0.cmp(&right.0));
    Checked::new_unchecked(Embedding {
        header: header(term, epoch),
        roster: Revision { term, epoch },
        graphs: vec![],
        robots: rows.iter().map(|row| row.0.clone()).collect(),
        dimension: 2,
        values: rows.iter().flat_map(|row| row.1.clone()).collect(),
        without_embedding: rows.iter().map(|row| row.2).collect(),
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
    })
}

/// The same data, later.
pub fn again(embedding: &Embedding, term: u64, epoch: u64) -> Checked<Embedding> {
    Checked::new_unchecked(Embedding { header: header(term, epoch), ..embedding.clone() })
}

/// A roster: `"a<b"` answers to b, `"a:medic,relay"` has two skills, `"a?"` is stale.
pub fn roster(epoch: u64, robots: &str) -> Roster {
    let mut entries: Vec<RosterEntry> = robots
        .split_whitespace()
        .enumerate()
        .map(|(node, text)| {
            let stale = text.ends_with('?');
            let text = text.trim_end_matches('?');
            let (text, skills) = text.split_once(':').unwrap_or((text, ""));
            let skills = skills.split(',').filter(|name| !name.is_empty());
            let mut skills: Vec<_> = skills.map(|name| SkillId::new(name).unwrap()).collect();
            skills.sort_unstable();
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
                skills,
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
pub fn changes_in_short(changes: &[TeamChange]) -> Vec<String> {
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
