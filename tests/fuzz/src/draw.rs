//! Draws messages out of bytes: few robots, small revisions and awkward numbers, so that what is
//! drawn often fits together and never must.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_model::audit::{Audit, Flapping, Quality, SilhouetteMethod, SilhouetteReport, Space};
use muster_model::command::{CommandOutcome, SettingsChange};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingGraph, EmbeddingMode, EmbeddingQuality};
use muster_model::graph::{GraphDelta, GraphRow};
use muster_model::header::{Header, Revision};
use muster_model::id::{
    CommandId, FleetId, Modality, OperatorId, RobotId, ServiceName, SkillId, TeamId,
};
use muster_model::observation::{Link, Links, Pose, Rank, Relation, Report};
use muster_model::remembered::RememberedTeams;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::teams::{Limited, Member, Team, TeamCountScore, TeamNeed, Teams};
use muster_model::time::Tick;
use muster_wire::Message;
use muster_wire::envelope::AnnouncedSettings;

/// Most robots that are drawn.
const ROBOTS: u8 = 6;

/// Modalities that are drawn.
const MODALITIES: [&str; 4] = ["connectivity", "hierarchy", "spatial", "thermal"];

/// Numbers that break things, and some that do not.
const NUMBERS: [f64; 16] = [
    0.0,
    1.0,
    -1.0,
    0.5,
    2.0,
    1e-12,
    -0.0,
    1e6,
    4e7,
    1e300,
    -1e300,
    5e-324,
    f64::MAX,
    f64::NAN,
    f64::INFINITY,
    0.1,
];

/// Bytes as choices, from the front; zeros once they are used up.
#[derive(Debug)]
pub(crate) struct Draw<'a>(pub(crate) &'a [u8]);

impl<'a> Draw<'a> {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    pub(crate) fn below(&mut self, count: u8) -> u8 {
        self.byte() % count
    }

    pub(crate) fn number16(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// So many bytes as there are by a length of two bytes; fewer where the input ends.
    pub(crate) fn block(&mut self) -> &'a [u8] {
        let length = usize::from(self.number16()).min(self.0.len());
        let (block, rest) = self.0.split_at(length);
        self.0 = rest;
        block
    }

    fn chance(&mut self) -> bool {
        self.byte() & 1 == 1
    }

    fn number64(&mut self) -> u64 {
        match self.byte() {
            255 => u64::from_le_bytes(std::array::from_fn(|_| self.byte())),
            small => u64::from(small),
        }
    }

    fn maybe<T>(&mut self, draw: impl FnOnce(&mut Self) -> T) -> Option<T> {
        self.chance().then(|| draw(self))
    }

    fn some<T>(&mut self, most: u8, mut draw: impl FnMut(&mut Self) -> T) -> Vec<T> {
        (0..self.below(most + 1)).map(|_| draw(self)).collect()
    }

    fn number(&mut self) -> f64 {
        match self.byte() {
            choice @ 0..16 => NUMBERS[usize::from(choice)],
            16 => f64::from_le_bytes(std::array::from_fn(|_| self.byte())),
            other => f64::from(other) / 16.0 - 8.0,
        }
    }

    /// Mostly a weight, sometimes none.
    fn weight(&mut self) -> f64 {
        match self.byte() {
            0..8 => self.number(),
            other => f64::from(other) / 255.0,
        }
    }

    fn robot(&mut self) -> RobotId {
        RobotId::new(format!("r{}", self.below(ROBOTS))).unwrap()
    }

    /// Robots in order, each at most once.
    fn robots(&mut self) -> Vec<RobotId> {
        let chosen = self.byte();
        let robots = (0..ROBOTS).filter(|number| chosen & (1 << number) != 0);
        robots.map(|number| RobotId::new(format!("r{number}")).unwrap()).collect()
    }

    fn modality(&mut self) -> Modality {
        Modality::new(MODALITIES[usize::from(self.below(4))]).unwrap()
    }

    /// One of a few skills, so that needs and robots often have the same.
    fn skill(&mut self) -> SkillId {
        let name = ["medic", "relay", "scout", "tow"][usize::from(self.below(4))];
        SkillId::new(name).unwrap()
    }

    fn skills(&mut self) -> Vec<SkillId> {
        self.some(3, Self::skill)
    }

    fn text(&mut self) -> String {
        match self.below(8) {
            0..4 => "map".to_owned(),
            4 => String::new(),
            5 => "ä\n\u{1b}[31m".to_owned(),
            6 => "x".repeat(usize::from(self.byte())),
            _ => String::from_utf8_lossy(&[self.byte(), self.byte(), self.byte()]).into_owned(),
        }
    }
}

/// What was drawn: reports may have any content, also one that no service accepts.
#[derive(Debug)]
pub(crate) enum Drawn {
    Report(RobotId, Report),
    Message(Message),
}

/// Draws messages that continue those before.
#[derive(Debug, Default)]
pub(crate) struct Author {
    graphs: BTreeMap<Modality, Revision>,
    roster: Revision,
    embedding: Revision,
    teams: Revision,
    last: Revision,
}

impl Author {
    /// A message of any kind that a core reads.
    pub(crate) fn message(&mut self, now: Tick, draw: &mut Draw<'_>) -> Drawn {
        let which = draw.below(11);
        if which < 4 {
            let robot = draw.robot();
            let report = match which {
                0 => pose(draw).into(),
                1 => links(draw).into(),
                2 => rank(draw).into(),
                _ => {
                    let relation = relation(&robot, draw);
                    (draw.modality(), relation).into()
                }
            };
            return Drawn::Report(robot, report);
        }
        Drawn::Message(match which {
            4 => Message::Graph(Arc::new(self.graph(now, draw))),
            5 => Message::Roster(Checked::new_unchecked(self.roster(now, draw))),
            6 => Message::Embedding(Checked::new_unchecked(self.embedding(now, draw))),
            7 => Message::Teams {
                teams: Checked::new_unchecked(self.teams(now, draw)),
                mirror: false,
            },
            8 => Message::Audit(Arc::new(self.audit(now, draw))),
            9 => Message::Outcome(Arc::new(self.outcome(now, draw))),
            _ => Message::Settings(Box::new(self.settings(now, draw))),
        })
    }

    /// Mostly the next one, sometimes any.
    fn revision(&mut self, draw: &mut Draw<'_>) -> Revision {
        let revision = match draw.below(8) {
            0 => Revision { term: draw.number64(), epoch: draw.number64() },
            1 => self.last,
            2 => Revision { term: self.last.term + 1, epoch: 0 },
            _ => Revision { term: self.last.term.max(1), epoch: self.last.epoch + 1 },
        };
        if revision.term < 1 << 40 && revision.epoch < 1 << 40 {
            self.last = revision;
        }
        revision
    }

    /// Mostly the given one.
    fn named(&mut self, known: Revision, draw: &mut Draw<'_>) -> Revision {
        if draw.below(8) == 0 { self.revision(draw) } else { known }
    }

    fn header(&mut self, now: Tick, draw: &mut Draw<'_>) -> Header {
        let revision = self.revision(draw);
        let tick = |draw: &mut Draw<'_>| match draw.below(8) {
            0 => Tick(u64::MAX),
            1 => Tick(0),
            ago => Tick(now.0.saturating_sub(u64::from(ago) * 100_000)),
        };
        Header {
            fleet: FleetId::new("alpha").unwrap(),
            revision,
            oldest: draw.maybe(tick),
            newest: draw.maybe(tick),
            stages: Vec::new(),
        }
    }

    /// A delta of a graph.
    pub(crate) fn graph(&mut self, now: Tick, draw: &mut Draw<'_>) -> GraphDelta {
        let modality = draw.modality();
        let header = self.header(now, draw);
        let known = self.graphs.insert(modality.clone(), header.revision).unwrap_or_default();
        let base = draw.maybe(|draw| self.named(known, draw));
        // Mostly the same node for a robot.
        let node = |draw: &mut Draw<'_>| match draw.below(8) {
            7 => u32::from(draw.byte()),
            number => u32::from(number),
        };
        let nodes_added = if draw.chance() {
            let robots = draw.robots().into_iter();
            robots.map(|robot| (robot.as_str()[1..].parse().unwrap(), robot)).collect()
        } else {
            draw.some(3, |draw| (node(draw), draw.robot()))
        };
        GraphDelta {
            header,
            modality,
            base,
            nodes_added,
            nodes_removed: draw.some(2, node),
            rows: draw.some(6, |draw| {
                let source = node(draw);
                let mut edges = draw.some(5, |draw| (node(draw), draw.weight()));
                if draw.below(8) != 0 {
                    edges.sort_by_key(|(target, _)| *target);
                    edges.dedup_by_key(|(target, _)| *target);
                }
                GraphRow { source, edges }
            }),
        }
    }

    fn roster(&mut self, now: Tick, draw: &mut Draw<'_>) -> Roster {
        let header = self.header(now, draw);
        self.roster = header.revision;
        let robots = draw.robots().into_iter().map(|robot| RosterEntry {
            node: robot.as_str()[1..].parse().unwrap(),
            robot,
            presence: if draw.below(4) == 0 { Presence::Stale } else { Presence::Active },
            position: draw.maybe(|draw| [draw.number(), draw.number(), draw.number()]),
            heading: draw.maybe(Draw::number),
            frame: draw.maybe(Draw::text),
            superior: draw.maybe(Draw::robot),
            role: draw.maybe(Draw::text),
            skills: draw.skills().into_iter().collect::<BTreeSet<_>>().into_iter().collect(),
            last_seen: Tick(now.0 - u64::from(draw.byte()) * 10_000),
        });
        let robots = robots.collect();
        let listed = draw.byte();
        let graphs: Vec<_> = self.graphs.clone().into_iter().collect();
        let graphs = graphs.into_iter().enumerate().filter(|(at, _)| listed & (1 << at) == 0);
        let graphs: Vec<_> = graphs.map(|(_, graph)| graph).collect();
        let graphs = graphs.into_iter().map(|(name, at)| (name, self.named(at, draw))).collect();
        Roster { header, robots, graphs }
    }

    fn embedding(&mut self, now: Tick, draw: &mut Draw<'_>) -> Embedding {
        let header = self.header(now, draw);
        self.embedding = header.revision;
        let robots = draw.robots();
        let dimension = match draw.below(8) {
            0 => u32::from(draw.byte()),
            other => u32::from(other % 4),
        };
        let values = robots.len() * dimension as usize;
        let graphs: Vec<_> = self.graphs.clone().into_iter().collect();
        let roster = self.named(self.roster, draw);
        let graph = |(modality, revision)| EmbeddingGraph {
            modality,
            revision,
            weight: draw.weight(),
            trust: draw.weight(),
        };
        let graphs = graphs.into_iter().map(graph).collect();
        Embedding {
            header,
            roster,
            graphs,
            dimension,
            values: (0..values.min(256)).map(|_| draw.number()).collect(),
            without_embedding: robots.iter().map(|_| draw.below(4) == 1).collect(),
            provisional: robots.iter().map(|_| draw.below(4) == 1).collect(),
            centrality: robots.iter().map(|_| draw.number()).collect(),
            robots,
            quality: EmbeddingQuality {
                spectral_radius: (draw.number(), draw.number()),
                alpha: draw.number(),
                singular_values: draw.some(3, Draw::number),
                next_singular_value: draw.number(),
                residual: draw.number(),
                katz_residual: draw.number(),
                gap: draw.number(),
                ambiguous: draw.chance(),
                mode: EmbeddingMode::Dense,
                teams_shown: draw.maybe(|draw| u32::from(draw.below(20))),
                team_scores: draw.some(3, Draw::number),
                stage_us: [0; 3],
            },
        }
    }

    fn teams(&mut self, now: Tick, draw: &mut Draw<'_>) -> Teams {
        let header = self.header(now, draw);
        self.teams = header.revision;
        let mut teams = Vec::new();
        let mut used = Vec::new();
        for number in 0..draw.below(4) {
            let mut robots = draw.robots();
            robots.retain(|robot| !used.contains(robot));
            let Some(leader) = robots.first().cloned() else { continue };
            used.extend(robots.iter().cloned());
            teams.push(Team {
                id: TeamId::numbered(draw.number64().saturating_add(number.into())),
                members: robots
                    .into_iter()
                    .map(|robot| Member { robot, margin: draw.number() })
                    .collect(),
                leader: if draw.below(8) == 0 { draw.robot() } else { leader },
                centroid: draw.some(4, Draw::number),
            });
        }
        let mut unassigned = draw.robots();
        unassigned.retain(|robot| !used.contains(robot));
        Teams {
            header,
            embedding: self.named(self.embedding, draw),
            requested: u32::from(draw.byte()),
            considered: draw.some(3, |draw| TeamCountScore {
                teams: u32::from(draw.byte()),
                score: draw.number(),
            }),
            teams,
            unassigned,
            stale: draw.robots(),
            inertia: draw.number(),
            changes: Vec::new(),
            next_team: draw.number64(),
            limited: draw.maybe(|draw| Limited {
                optimal: draw.byte() % 2 == 0,
                gap: draw.number(),
                conflict: None,
                prices: Vec::new(),
                skill_prices: Vec::new(),
                jointly: draw.robots(),
            }),
            needs: draw.some(2, |draw| TeamNeed {
                team: TeamId::numbered(draw.number64()),
                skill: draw.skill(),
                min: u32::from(draw.byte()),
                max: None,
                soft: draw.byte() % 2 == 0,
                have: u32::from(draw.byte()),
            }),
            provisional: draw.robots(),
            held: Vec::new(),
            remembered: RememberedTeams {
                last: draw
                    .robots()
                    .into_iter()
                    .map(|robot| (robot, TeamId::numbered(draw.number64())))
                    .collect(),
                ended: draw.some(2, |draw| (TeamId::numbered(draw.number64()), draw.robots())),
                newcomers_from: draw.number64(),
            },
        }
    }

    fn audit(&mut self, now: Tick, draw: &mut Draw<'_>) -> Audit {
        let report = |space, draw: &mut Draw<'_>| SilhouetteReport {
            space,
            mean: draw.maybe(Draw::number),
            method: SilhouetteMethod::Sampled,
            standard_error: draw.number(),
            per_team: draw.some(2, |draw| (TeamId::numbered(draw.number64()), draw.number())),
            per_robot: draw.some(3, |draw| (draw.robot(), draw.number())),
            detail_method: SilhouetteMethod::SquaredExact,
        };
        Audit {
            header: self.header(now, draw),
            teams: self.named(self.teams, draw),
            embedding: self.named(self.embedding, draw),
            in_embedding: report(Space::Embedding, draw),
            in_physical: report(Space::Physical, draw),
            quality: Quality::Fair,
            flapping: Flapping::default(),
            graphs: None,
            per_team: Vec::new(),
            losses: Vec::new(),
        }
    }

    /// What another instance says of a command that changed settings.
    fn outcome(&mut self, now: Tick, draw: &mut Draw<'_>) -> CommandOutcome {
        let fields = match draw.below(6) {
            0 => draw.text(),
            1 => format!("{{\"teams\":{}}}", draw.number64()),
            2 => format!("{{\"size\":{{\"max\":{}}}}}", draw.byte()),
            3 => format!("{{\"size\":{{\"min\":{}}},\"teams\":null}}", draw.byte()),
            4 => "{\"size.min\":{\"a\":1}}".to_owned(),
            _ => "{\"restarts\":3,\"nothing\":1}".to_owned(),
        };
        let at = match draw.below(8) {
            0 => Tick(draw.number64()),
            ago => Tick(now.0.saturating_sub(u64::from(ago))),
        };
        CommandOutcome {
            header: self.header(now, draw),
            service: ServiceName::Clusterer,
            operator: OperatorId::new("kim").unwrap(),
            id: CommandId::new(format!("c{}", draw.below(8))).unwrap(),
            expires: now.as_seconds() + 60.0,
            based_on: None,
            action: "\"set\"".to_owned(),
            refused: None,
            answer: None,
            may_be_repeated: false,
            changed: Some(SettingsChange { at, fields }),
        }
    }

    fn settings(&mut self, now: Tick, draw: &mut Draw<'_>) -> AnnouncedSettings {
        let changed = match draw.below(4) {
            0 => BTreeMap::from([(draw.text(), Tick(draw.number64()))]),
            1 => BTreeMap::from([("teams".to_owned(), now)]),
            _ => BTreeMap::new(),
        };
        AnnouncedSettings {
            header: self.header(now, draw),
            service: ServiceName::Clusterer,
            changed,
            settings: match draw.below(4) {
                0 => draw.text(),
                1 => format!("{{\"teams\":{}}}", draw.number64()),
                _ => format!(
                    "{{\"teams\":{},\"restarts\":4,\"init\":\"kmeans++\",\"max_iterations\":9,\
                     \"seed\":0,\"hysteresis\":0.0,\"heartbeat_s\":1.0}}",
                    draw.number64()
                ),
            },
        }
    }
}

type Provenance = (Option<f64>, Option<String>, Option<u64>);

fn provenance(draw: &mut Draw<'_>) -> Provenance {
    (draw.maybe(Draw::number), draw.maybe(Draw::text), draw.maybe(Draw::number64))
}

fn pose(draw: &mut Draw<'_>) -> Pose {
    let (stamp, boot, seq) = provenance(draw);
    Pose {
        x: draw.number(),
        y: draw.number(),
        z: draw.maybe(Draw::number),
        heading: draw.maybe(Draw::number),
        frame: draw.maybe(Draw::text),
        stamp,
        boot,
        seq,
    }
}

fn links(draw: &mut Draw<'_>) -> Links {
    let (stamp, boot, seq) = provenance(draw);
    let links = draw.robots().into_iter().map(|peer| Link { peer, quality: draw.weight() });
    Links { links: links.collect(), stamp, boot, seq }
}

fn rank(draw: &mut Draw<'_>) -> Rank {
    let (stamp, boot, seq) = provenance(draw);
    Rank {
        superior: draw.maybe(Draw::robot),
        weight: draw.maybe(Draw::weight),
        role: draw.maybe(Draw::text),
        skills: draw.maybe(Draw::skills),
        stamp,
        boot,
        seq,
    }
}

fn relation(from: &RobotId, draw: &mut Draw<'_>) -> Relation {
    let (stamp, boot, seq) = provenance(draw);
    let edges = draw.robots().into_iter().map(|to| (from.clone(), to, draw.weight()));
    Relation { edges: edges.collect(), stamp, boot, seq }
}
