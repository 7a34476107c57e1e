//! There is one method: the live cores, `muster solve` on their graphs, and the experiments divide alike.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};

use muster_experiments::methods::Recipe;
use muster_experiments::moving::pipeline::{AllSettings, Pipeline};
use muster_experiments::system::MODALITIES;
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, Modality, RobotId};
use muster_model::observation::{CheckedReport, Link, Links, Pose, Rank, Report};
use muster_model::settings::{ClustererSettings, TeamCount};
use muster_model::time::Tick;
use muster_numeric::matrix::SparseMatrix;
use muster_solve::{Options, Solved};
use muster_wire::Message;
use muster_wire::json::EdgeJson;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde_json::Value;

const FLEETS: u64 = 200;

/// Starts of k-means for all three: so many find the best division, and not that of a lucky start.
const RESTARTS: u32 = 300;

/// Inertia of rows that are equal but for what a search leaves.
const ROUNDING: f64 = 1e-12;

/// Most fleets of which no more than K can be compared.
const MAX_ARBITRARY_FLEETS: usize = 2;

/// When the services lead: any moment after they have asked the bus for their last output.
const START: Tick = Tick(10_000_000);

/// Virtual time after which a fleet that does not move is at rest.
const REST_TIME: Tick = Tick(14_000_000);

/// What one fleet reports, and how many teams are asked for.
struct Reports {
    robots: Vec<RobotId>,
    messages: Vec<Message>,
    teams: u32,
    groups: usize,
}

fn report(robot: &RobotId, report: impl Into<Report>) -> Message {
    Message::Report(CheckedReport::new(robot.clone(), report).unwrap())
}

/// A fleet of 2 to 300 robots in some groups, each of which reports some of the three modalities.
fn reports(seed: u64) -> Reports {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    // As many small fleets as large ones, on a scale of ratios.
    let count = (2.0 * 150.0_f64.powf(chance.random::<f64>())).round() as usize;
    let (groups, teams) = (chance.random_range(1..=8_usize), chance.random_range(1..=6_u32));
    let has = loop {
        let has = [(); 3].map(|()| chance.random_bool(0.65));
        // Orders alone give all who have the same superior the same row: rounding alone would separate them.
        if has[0] || has[1] {
            break has;
        }
    };
    let robots: Vec<RobotId> =
        (0..count).map(|robot| RobotId::new(format!("r{robot:03}")).unwrap()).collect();
    let centres: Vec<[f64; 2]> =
        (0..groups).map(|_| [(); 2].map(|()| 120.0 * chance.random::<f64>())).collect();
    let group = |robot: usize| robot % groups;
    let places: Vec<[f64; 2]> = (0..count)
        .map(|robot| centres[group(robot)].map(|at| at + 24.0 * chance.random::<f64>()))
        .collect();
    let mut messages = Vec::new();
    for (robot, name) in robots.iter().enumerate() {
        let mut reports = |has: bool| has && chance.random_bool(0.96);
        let (pose, links, rank) = (reports(has[0]), reports(has[1]), reports(has[2]));
        if pose {
            messages.push(report(name, Pose::at(places[robot][0], places[robot][1])));
        }
        if links {
            let mut peers = BTreeSet::new();
            // The neighbours in the group, and some others.
            peers.extend(robot.checked_sub(groups));
            peers.insert(robot + groups);
            for _ in 0..2 {
                let near = groups * chance.random_range(0..count.div_ceil(groups)) + group(robot);
                let any = chance.random_range(0..count);
                peers.insert(if chance.random_bool(0.95) { near } else { any });
            }
            let peers = peers.into_iter().filter(|peer| *peer < count && *peer != robot);
            let links: Vec<Link> = peers
                .map(|peer| Link { peer: robots[peer].clone(), quality: chance.random::<f64>() })
                .collect();
            let links = Links { links, stamp: None, boot: None, seq: None };
            messages.push(report(name, links));
        }
        if rank {
            let superior = (robot >= groups).then(|| {
                let rounds = robot / groups;
                robots[groups * chance.random_range(0..rounds) + group(robot)].clone()
            });
            let weight = Some(0.5 + chance.random::<f64>());
            messages.push(report(name, Rank { weight, ..Rank::under(superior) }));
        }
    }
    Reports { robots, messages, teams, groups }
}

/// A division, and K.
#[derive(Debug)]
struct Divided {
    rank: usize,
    inertia: f64,
    /// Robots of each team, and those without one as one more.
    teams: BTreeSet<BTreeSet<RobotId>>,
}

impl Divided {
    fn is_same(&self, other: &Self) -> bool {
        self.rank == other.rank && self.teams == other.teams
    }

    /// Whether fewer rows are distinct than teams are asked for, so that rounding decides which of several
    /// equal robots is split off.
    fn is_arbitrary(&self) -> bool {
        self.inertia < ROUNDING
    }

    fn new(
        rank: usize,
        inertia: f64,
        labels: impl IntoIterator<Item = (RobotId, Option<u64>)>,
    ) -> Self {
        let mut teams: BTreeMap<Option<u64>, BTreeSet<RobotId>> = BTreeMap::new();
        for (robot, label) in labels {
            teams.entry(label).or_default().insert(robot);
        }
        Self { rank, inertia, teams: teams.into_values().collect() }
    }
}

fn clusterer(reports: &Reports) -> ClustererSettings {
    let Reports { teams, .. } = *reports;
    // A single problem has no division before that could be kept.
    let teams = TeamCount::Fixed(teams);
    ClustererSettings { teams, restarts: RESTARTS, hysteresis: 0.0, ..ClustererSettings::default() }
}

/// What the cores of all services make of the reports once the fleet is at rest.
fn live(reports: &Reports) -> (Divided, Pipeline) {
    let settings = AllSettings { clusterer: clusterer(reports), ..AllSettings::default() };
    let mut pipeline = Pipeline::new(START, settings).unwrap();
    pipeline.advance(Tick(10_500_000));
    reports.messages.iter().for_each(|message| pipeline.receive(message.clone()));
    pipeline.advance(REST_TIME);
    let teams = pipeline.teams.clone().unwrap();
    let labels = teams.teams.iter().zip(0..).flat_map(|(team, number)| {
        team.members.iter().map(move |member| (member.robot.clone(), Some(number)))
    });
    let unassigned = teams.unassigned.iter().map(|robot| (robot.clone(), None));
    let rank = pipeline.dimension as usize / 2;
    (Divided::new(rank, teams.inertia, labels.chain(unassigned)), pipeline)
}

/// The lines of `muster graph --json` and `muster set clusterer --json`.
fn saved(reports: &Reports, pipeline: &Pipeline) -> String {
    let header = Header {
        fleet: FleetId::new("moving").unwrap(),
        revision: Revision::default(),
        oldest: None,
        newest: None,
        stages: Vec::new(),
    };
    let graph = |(modality, graph): (&Modality, &muster_model::graph::GraphReplica)| {
        let snapshot = graph.snapshot(header.clone(), modality.clone());
        String::from_utf8(snapshot.to_json(REST_TIME).unwrap()).unwrap()
    };
    let mut lines: Vec<String> = pipeline.graphs.iter().map(graph).collect();
    lines.push(serde_json::to_string(&clusterer(reports)).unwrap());
    lines.join("\n")
}

/// The division, and whether the singular value behind those that are used is as large, so that which directions
/// make up the vectors is arbitrary.
fn solved(reports: &Reports, pipeline: &Pipeline) -> (Divided, bool) {
    let text = saved(reports, pipeline);
    let solved = Solved::new(text.as_bytes(), Options::default()).unwrap();
    let json: Value = serde_json::from_str(&solved.to_json().unwrap()).unwrap();
    let rank = json["singular_values"].as_array().unwrap().len();
    let teams = json["teams"].as_object().unwrap();
    let label = |(robot, label): (&String, &Value)| (RobotId::new(robot).unwrap(), label.as_u64());
    let ambiguous = json["decomposition"]["ambiguous"].as_bool().unwrap();
    (Divided::new(rank, json["inertia"].as_f64().unwrap(), teams.iter().map(label)), ambiguous)
}

fn experimented(reports: &Reports, pipeline: &Pipeline) -> Divided {
    let mut recipe = Recipe::live();
    recipe.clustering.starts = RESTARTS as usize;
    // Robots that report nothing and that no other robot names are not known.
    let known: BTreeSet<&RobotId> =
        pipeline.graphs.values().flat_map(|graph| graph.nodes().values()).collect();
    let robots: Vec<RobotId> = known.into_iter().cloned().collect();
    let graphs = MODALITIES.map(|name| {
        let modality = Modality::new(name).unwrap();
        let graph = pipeline.graphs.get(&modality);
        let edges = graph.into_iter().flat_map(|graph| {
            let place = |node: &u32| robots.binary_search(&graph.nodes()[node]).unwrap();
            graph.rows().iter().flat_map(move |(from, edges)| {
                edges.iter().map(move |(to, weight)| (place(from), place(to), *weight))
            })
        });
        let matrix = SparseMatrix::from_triplets(robots.len(), edges).unwrap();
        let upward = if modality == Modality::hierarchy() { recipe.upward } else { 0.0 };
        matrix.with_reverse(upward).unwrap()
    });
    let found = recipe.divide(&graphs, reports.teams as usize, 0).unwrap();
    let labels = found.labels.into_iter().map(|label| Some(label as u64));
    let rank = found.vectors.unwrap().cols() / 2;
    Divided::new(rank, 0.0, robots.iter().cloned().zip(labels))
}

/// What is different, if anything is; whether only K could be compared.
fn compare(seed: u64) -> (Option<String>, bool) {
    let reports = reports(seed);
    let (live, pipeline) = live(&reports);
    let (solved, is_ambiguous) = solved(&reports, &pipeline);
    let experimented = experimented(&reports, &pipeline);
    let is_arbitrary = live.is_arbitrary();
    // With more groups than teams, several divisions are about as good, and rounding chooses.
    let is_as_good = reports.groups > reports.teams as usize
        && live.rank == solved.rank
        && (live.inertia - solved.inertia).abs() <= 1e-3 * live.inertia;
    let same = |other: &Divided| {
        let of_equal_rows = is_arbitrary && other.is_arbitrary() && live.rank == other.rank;
        live.is_same(other) || of_equal_rows || is_ambiguous || is_as_good
    };
    let all = [&solved, &experimented];
    let different = !all.iter().all(|other| same(other));
    let what = different.then(|| {
        format!(
            "fleet {seed}, {} robots in {} groups, {} teams: K {} {} {}, inertia {} {}, same teams {} {}",
            reports.robots.len(),
            reports.groups,
            reports.teams,
            live.rank,
            solved.rank,
            experimented.rank,
            live.inertia,
            solved.inertia,
            live.teams == solved.teams,
            live.teams == experimented.teams,
        )
    });
    let is_same = all.iter().all(|other| live.is_same(other));
    (what, !different && !is_same)
}

#[test]
fn live_cores_solve_and_experiments_divide_alike() {
    let found: Vec<_> = (0..FLEETS).into_par_iter().map(compare).collect();
    let different: Vec<&str> = found.iter().filter_map(|(what, _)| what.as_deref()).collect();
    assert!(different.is_empty(), "{} of {FLEETS}:\n{}", different.len(), different.join("\n"));
    let arbitrary = found.iter().filter(|(_, arbitrary)| *arbitrary).count();
    assert!(arbitrary <= MAX_ARBITRARY_FLEETS, "{arbitrary} of {FLEETS} are arbitrary");
}
