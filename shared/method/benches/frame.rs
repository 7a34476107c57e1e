//! A frame of a fleet that marches: what trust in each modality and the choice of the number of teams take.
//!
//! `neither` holds all trust at 1 and divides into a given number of teams; the other benchmarks add one or both.

#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark fails by panicking")]

use std::collections::BTreeMap;
use std::hint::black_box;
use std::sync::Arc;

use divan::Bencher;
use muster_method::embedding::Frames;
use muster_method::params::{EmbeddingParams, Pace, ValidEmbeddingParams};
use muster_method::{Frame, Graph};
use muster_model::id::{Modality, RobotId};
use muster_model::observation::Link;
use muster_model::settings::{EmbedderSettings, IngestSettings, TeamCount, Trusted};
use muster_numeric::matrix::SparseMatrix;
use muster_relation::{Edge, connectivity_edges, hierarchy_edges, spatial_edges};
use muster_scenario::{Fleet, FleetOptions, ScenarioKind};

/// Robots of the fleets: divided from all triplets, by a search of the leading ones, and by one that takes most of a tick.
const SIZES: [usize; 3] = [50, 500, 2000];

/// Squads that march.
const TEAMS: u32 = 5;

/// Seconds between two frames of a live fleet.
const TICK_S: f64 = 0.1;

/// Frames before those that are timed: the first ones search from nothing.
const WARM_UP_FRAMES: u32 = 20;

fn main() {
    divan::main();
}

/// A fleet whose robots move from frame to frame. Links and ranks stay, as they do between two reports.
struct March {
    fleet: Fleet,
    robots: Arc<[RobotId]>,
    links: Graph,
    ranks: Graph,
    frames: u32,
}

impl March {
    fn new(robots: usize) -> Self {
        let options = FleetOptions { robots, teams: TEAMS as usize, ..FleetOptions::default() };
        let fleet = Fleet::new(ScenarioKind::Crossing, options).unwrap();
        let mut robots: Vec<RobotId> = fleet.robots().to_vec();
        robots.sort();
        let place: BTreeMap<&RobotId, u32> = robots.iter().zip(0..).collect();
        let reporters = || fleet.robots().iter().map(|robot| place[robot]);
        let quality = |link: &Link| (place[&link.peer], link.quality);
        let links: Vec<(u32, Vec<(u32, f64)>)> = reporters()
            .zip(fleet.links(0.0))
            .map(|(robot, links)| (robot, links.links.iter().map(quality).collect()))
            .collect();
        let links = connectivity_edges(links.iter().map(|(robot, links)| (*robot, &links[..])));
        let ranks = reporters().zip(fleet.ranks(0.0)).map(|(robot, rank)| {
            (robot, rank.superior.as_ref().map(|superior| place[superior]), None)
        });
        let ranks = hierarchy_edges(ranks);
        let graph = |edges: Vec<Edge>| graph(robots.len(), edges);
        let (links, ranks) = (graph(links.unwrap()), graph(ranks.unwrap()));
        drop(place);
        Self { robots: robots.into(), links, ranks, fleet, frames: 0 }
    }

    fn next(&mut self) -> Frame {
        self.frames += 1;
        let poses = self.fleet.poses(f64::from(self.frames) * TICK_S);
        let places = poses.iter().map(|pose| [pose.x, pose.y, pose.z.unwrap_or(0.0)]);
        let mut placed: Vec<_> = self.fleet.robots().iter().zip(places).collect();
        placed.sort_by_key(|(robot, _)| *robot);
        let positions: Vec<[f64; 3]> = placed.into_iter().map(|(_, at)| at).collect();
        let settings = IngestSettings::default().spatial;
        let spatial = graph(positions.len(), spatial_edges(&positions, &settings));
        Frame {
            robots: Arc::clone(&self.robots),
            graphs: vec![
                (Modality::connectivity(), self.links.clone()),
                (Modality::hierarchy(), self.ranks.clone()),
                (Modality::spatial(), spatial),
            ],
        }
    }
}

fn graph(robots: usize, edges: Vec<Edge>) -> Graph {
    let edges = edges.into_iter().map(|(from, to, weight)| (from as usize, to as usize, weight));
    Graph::Matrix(Arc::new(SparseMatrix::from_triplets(robots, edges).unwrap()))
}

fn params(teams: TeamCount, trusted: Trusted) -> ValidEmbeddingParams {
    let settings = EmbedderSettings { trusted, ..EmbedderSettings::default() };
    EmbeddingParams::new(&settings, teams, Pace::Moving).check().unwrap()
}

fn frames(bencher: Bencher<'_, '_>, robots: usize, teams: TeamCount, trusted: Trusted) {
    let mut march = March::new(robots);
    let mut frames = Frames::default();
    let params = params(teams, trusted);
    for _ in 0..WARM_UP_FRAMES {
        frames.embed(&march.next(), &params, None, &mut |_| {}).unwrap();
    }
    bencher.with_inputs(|| march.next()).bench_local_values(|frame| {
        black_box(frames.embed(&frame, &params, None, &mut |_| {}).unwrap())
    });
}

const FIXED: TeamCount = TeamCount::Fixed(TEAMS);

#[divan::bench(args = SIZES, max_time = 5)]
fn neither(bencher: Bencher<'_, '_>, robots: usize) {
    frames(bencher, robots, FIXED, Trusted::All);
}

#[divan::bench(args = SIZES, max_time = 5)]
fn trust(bencher: Bencher<'_, '_>, robots: usize) {
    frames(bencher, robots, FIXED, Trusted::default());
}

#[divan::bench(args = SIZES, max_time = 5)]
fn number_of_teams(bencher: Bencher<'_, '_>, robots: usize) {
    frames(bencher, robots, TeamCount::Auto, Trusted::All);
}

#[divan::bench(args = SIZES, max_time = 5)]
fn number_of_teams_from_4_to_6(bencher: Bencher<'_, '_>, robots: usize) {
    frames(bencher, robots, TeamCount::Between { from: 4, to: 6 }, Trusted::All);
}

#[divan::bench(args = SIZES, max_time = 5)]
fn both(bencher: Bencher<'_, '_>, robots: usize) {
    frames(bencher, robots, TeamCount::Auto, Trusted::default());
}
