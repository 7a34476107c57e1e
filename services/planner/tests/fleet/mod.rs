//! A fleet at rest: graphs, vectors and division, made by the method itself.

// Clippy's allowance for tests ends at `#[test]`.
#![allow(clippy::unwrap_used, clippy::panic, dead_code, unreachable_pub)]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_division::division::{Job, Staying, divide};
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::number::Situation;
use muster_division::rules::{Asked, TeamRules};
use muster_division::seats::Arrivals;
use muster_method::Graph;
use muster_method::embedding::Frames;
use muster_method::params::{EmbeddingParams, Pace};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::graph::{GraphDelta, GraphReplica, GraphRow, Node};
use muster_model::header::{Header, Revision};
use muster_model::id::{
    FleetId, Modality, OperatorId, RobotId, ServiceName, SkillId, TeamId, WishId,
};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::{ClustererSettings, EmbedderSettings, Settings as _};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, Wish, WishKind, WishList, WishState};
use muster_wire::Message;
use muster_wire::envelope::AnnouncedSettings;
use serde_json::{Value, json};

/// The moment of the tests.
pub const NOW: Tick = Tick(1_000_000_000_000);

pub fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub fn name(name: &str) -> OperatorId {
    OperatorId::new(name).unwrap()
}

/// Names with spaces between them.
pub fn names(robots: &[RobotId]) -> String {
    robots.iter().map(RobotId::as_str).collect::<Vec<_>>().join(" ")
}

/// The teams of a division as `t1: a0 a1`.
pub fn teams(division: &Teams) -> Vec<String> {
    let members = |team: &muster_model::teams::Team| {
        names(&team.members.iter().map(|member| member.robot.clone()).collect::<Vec<_>>())
    };
    division.teams.iter().map(|team| format!("{}: {}", team.id, members(team))).collect()
}

fn header(epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("f").unwrap(),
        revision: Revision { term: 7, epoch },
        oldest: Some(NOW),
        newest: Some(NOW),
        stages: vec![],
    }
}

/// A modality, and the weight of the edge between two robots by their places.
type Edges<'a> = (&'a str, &'a dyn Fn(usize, usize) -> f64);

/// A fleet.
pub struct Fleet {
    robots: Vec<RobotId>,
    positions: Vec<[f64; 3]>,
    skills: BTreeMap<RobotId, Vec<SkillId>>,
    graphs: BTreeMap<Modality, GraphReplica>,
    clusterer: ClustererSettings,
    embedder: EmbedderSettings,
    wishes: Vec<StandingWish>,
    is_divided: bool,
    answers_settings: bool,
}

impl Fleet {
    fn new(robots: Vec<(String, [f64; 3])>, edges: &[Edges<'_>]) -> Self {
        let mut robots: Vec<(RobotId, [f64; 3])> =
            robots.into_iter().map(|(name, at)| (robot(&name), at)).collect();
        robots.sort_by(|left, right| left.0.cmp(&right.0));
        let (robots, positions): (Vec<_>, Vec<_>) = robots.into_iter().unzip();
        let graph = |(name, weight): &Edges<'_>| {
            let name = Modality::new(name).unwrap();
            let row = |source: usize| {
                let others = (0..robots.len()).filter(|other| *other != source);
                let edges = others.map(|other| (other as Node, weight(source, other)));
                let edges = edges.filter(|(_, weight)| *weight > 0.0).collect();
                GraphRow { source: source as Node, edges }
            };
            let nodes = robots.iter().enumerate();
            let whole = GraphDelta {
                header: header(1),
                modality: name.clone(),
                base: None,
                nodes_added: nodes.map(|(node, robot)| (node as Node, robot.clone())).collect(),
                nodes_removed: vec![],
                rows: (0..robots.len()).map(row).filter(|row| !row.edges.is_empty()).collect(),
            };
            let mut graph = GraphReplica::default();
            graph.apply(&whole).unwrap();
            (name, graph)
        };
        let graphs = edges.iter().map(graph).collect();
        Self {
            robots,
            positions,
            skills: BTreeMap::new(),
            graphs,
            clusterer: ClustererSettings::default(),
            embedder: EmbedderSettings::default(),
            wishes: vec![],
            is_divided: true,
            answers_settings: true,
        }
    }

    /// Four cliques of three, `a`, `b`, `c` and `d`: `a` and `b`, and `c` and `d`, are loosely related.
    pub fn of_groups() -> Self {
        let at = |group: usize, place: usize| {
            [10.0 * group as f64 + if group > 1 { 40.0 } else { 0.0 }, place as f64, 0.0]
        };
        let robots = (0..12).map(|i| {
            let (group, place) = (i / 3, i % 3);
            (format!("{}{place}", ["a", "b", "c", "d"][group]), at(group, place))
        });
        let weight = |left: usize, right: usize| match (left / 3, right / 3) {
            (left, right) if left == right => 1.0,
            (left, right) if left / 2 == right / 2 => 0.2,
            _ => 0.01,
        };
        Self::new(robots.collect(), &[("spatial", &weight)])
    }

    /// Eight robots: by their places two rows, by their links two halves of both rows. Only places count.
    pub fn of_rows_and_columns() -> Self {
        let robots = (0..8).map(|i| {
            let (row, column) = (i / 4, i % 4);
            (format!("r{row}c{column}"), [column as f64, 20.0 * row as f64, 0.0])
        });
        let rows = |left: usize, right: usize| if left / 4 == right / 4 { 1.0 } else { 0.05 };
        let halves = |left: usize, right: usize| {
            if left % 4 / 2 == right % 4 / 2 { 1.0 } else { 0.05 }
        };
        let mut fleet =
            Self::new(robots.collect(), &[("spatial", &rows), ("connectivity", &halves)]);
        let weights = json!({"weights": {"spatial": 1.0, "connectivity": 0.0}});
        let weights = fleet.embedder.patched(&weights);
        fleet.embedder = weights.unwrap();
        fleet
    }

    /// The fleet is divided into so many teams.
    pub fn with_teams(mut self, teams: &Value) -> Self {
        self.clusterer = self.clusterer.patched(&json!({"teams": teams})).unwrap();
        self
    }

    pub fn with_skill(mut self, name: &str, skill: &str) -> Self {
        self.skills.entry(robot(name)).or_default().push(SkillId::new(skill).unwrap());
        self
    }

    pub fn with_wish(mut self, kind: &str, robots: &[&str], team: Option<&str>) -> Self {
        let kind: WishKind = serde_json::from_value(json!(kind)).unwrap();
        let id = WishId::new(format!("w{}", self.wishes.len())).unwrap();
        let wish = Wish {
            kind,
            robots: robots.iter().map(|name| robot(name)).collect(),
            team: team.map(|team| TeamId::new(team).unwrap()),
            expires: None,
            note: None,
        };
        let operator = name("alice");
        self.wishes.push(StandingWish {
            operator,
            id,
            wish,
            state: WishState::Active,
            reason: None,
        });
        self
    }

    pub fn without_division(mut self) -> Self {
        self.is_divided = false;
        self
    }

    /// Settings are not answered from now on.
    pub fn forget_settings(&mut self) {
        self.answers_settings = false;
    }

    fn roster(&self) -> Roster {
        let entry = |(node, robot): (usize, &RobotId)| RosterEntry {
            node: node as Node,
            robot: robot.clone(),
            presence: Presence::Active,
            position: Some(self.positions[node]),
            heading: None,
            frame: None,
            superior: None,
            role: None,
            skills: self.skills.get(robot).cloned().unwrap_or_default(),
            last_seen: NOW,
        };
        Roster {
            header: header(1),
            robots: self.robots.iter().enumerate().map(entry).collect(),
            graphs: self
                .graphs
                .iter()
                .map(|(name, graph)| (name.clone(), graph.revision()))
                .collect(),
        }
    }

    /// The live vectors.
    pub fn embedding(&self) -> Embedding {
        let params = EmbeddingParams {
            seed: 1,
            ..EmbeddingParams::new(&self.embedder, self.clusterer.teams, Pace::AtRest)
        };
        let graphs = self.graphs.iter();
        let graphs =
            graphs.map(|(name, graph)| (name.clone(), Graph::Replica(Arc::new(graph.clone()))));
        let frame =
            muster_method::Frame { robots: self.robots.clone().into(), graphs: graphs.collect() };
        let found =
            Frames::default().embed(&frame, &params.check().unwrap(), None, &mut |_| {}).unwrap();
        let shown = &found.decomposition.teams;
        Embedding {
            header: header(2),
            roster: header(1).revision,
            graphs: vec![],
            robots: self.robots.clone(),
            dimension: u32::try_from(found.x.cols()).unwrap(),
            values: found.x.into_data(),
            without_embedding: found.without_embedding,
            provisional: found.provisional,
            centrality: vec![1.0; self.robots.len()],
            quality: EmbeddingQuality {
                spectral_radius: (1.0, 1.0),
                alpha: 0.5,
                next_singular_value: 0.0,
                residual: 0.0,
                katz_residual: 0.0,
                gap: 1.0,
                ambiguous: false,
                mode: EmbeddingMode::Dense,
                teams_shown: (!shown.scores.is_empty()).then_some(shown.teams),
                team_scores: shown.scores.clone(),
                stage_us: [0; 3],
                singular_values: vec![],
            },
        }
    }

    fn rules(&self, previous: Option<&Teams>) -> Option<TeamRules> {
        let needs = Needs::of(&self.clusterer, Some(&self.roster()), previous);
        TeamRules::of(&self.clusterer, Asked::of(self.wishes.iter()), needs)
    }

    fn divided(&self, previous: Option<Checked<Teams>>) -> Teams {
        let embedding = Checked::new_unchecked(self.embedding());
        let memory = Memory::default();
        let rules = self.rules(previous.as_deref());
        let mut situation = Situation {
            now: NOW,
            division: previous.as_deref(),
            divided_into: None,
            memory: &memory,
            arrivals: Arrivals::default(),
            embedding: &embedding,
        };
        let number = situation.evidence(self.clusterer.teams, rules.as_ref());
        let rules =
            rules.map(|rules| Arc::new(rules.resolved(previous.as_deref(), &memory, &embedding)));
        let job = Job {
            embedding,
            teams: number.best(),
            requested: number.best(),
            same_number: number.demand.current == Some(number.best()),
            staying: Staying::None,
            renewed: BTreeSet::new(),
            settings: self.clusterer.clone(),
            rules,
            previous,
            memory: Arc::new(memory),
        };
        Teams { header: header(3), ..divide(&job).unwrap() }
    }

    /// The live division: that of a fleet which has been at rest for a while.
    pub fn live(&self) -> Teams {
        let first = Checked::new_unchecked(self.divided(None));
        self.divided(Some(first))
    }

    /// What the services have published.
    pub fn messages(&self) -> Vec<Message> {
        let graph = |(name, graph): (&Modality, &GraphReplica)| {
            Message::Graph(Arc::new(graph.snapshot(header(1), name.clone())))
        };
        let mut messages: Vec<Message> = self.graphs.iter().map(graph).collect();
        messages.push(Message::Roster(Checked::new_unchecked(self.roster())));
        messages.push(Message::Embedding(Checked::new_unchecked(self.embedding())));
        if self.is_divided {
            let teams = Checked::new_unchecked(self.live());
            messages.push(Message::Teams { teams, mirror: false });
        }
        messages
    }

    /// Settings and wishes, as their services answer.
    pub fn settings(&self) -> Vec<Message> {
        if !self.answers_settings {
            return vec![];
        }
        let announced = |service, settings: String| {
            let (header, changed) = (header(4), BTreeMap::new());
            Message::Settings(Box::new(AnnouncedSettings { header, service, settings, changed }))
        };
        let wishes = WishList { header: header(5), wishes: self.wishes.clone() };
        vec![
            announced(ServiceName::Clusterer, serde_json::to_string(&self.clusterer).unwrap()),
            announced(ServiceName::Embedder, serde_json::to_string(&self.embedder).unwrap()),
            Message::Wishes(Checked::new_unchecked(wishes)),
        ]
    }
}
