//! Modalities that contradict all others lose their weight, and get it back.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_method::embedding::{Embedded, Frames, embed};
use muster_method::params::{EmbeddingParams, Pace};
use muster_method::{Frame, Graph};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{EmbedderSettings, Trusted};
use muster_numeric::matrix::SparseMatrix;

const TEAMS: usize = 4;
const SIZE: usize = 8;
const ROBOTS: usize = TEAMS * SIZE;

/// What the ranks go by.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Ranks {
    /// The first robot of each team commands it.
    ByTeam,
    /// All robots with the same place within their teams answer to one of them.
    ByKind,
    /// As by team, but for one robot that answers to the leader of another.
    OneWrong,
    /// There are none.
    Missing,
}

/// A fleet of teams in which the places and the links of each robot are near those of its team.
fn frame(ranks: Ranks) -> Frame {
    let team = |robot: usize| robot / SIZE;
    let pairs = || (0..ROBOTS).flat_map(|i| (0..ROBOTS).map(move |j| (i, j)));
    let near = |within: f64, across: f64| {
        let weight = |(i, j): (usize, usize)| if team(i) == team(j) { within } else { across };
        let edges = pairs().filter(|(i, j)| i != j);
        SparseMatrix::from_triplets(ROBOTS, edges.map(|pair| (pair.0, pair.1, weight(pair))))
            .unwrap()
    };
    let superior = |robot: usize| match ranks {
        Ranks::ByKind => robot % SIZE,
        Ranks::OneWrong if robot == 9 => 0,
        _ => team(robot) * SIZE,
    };
    let orders = (0..ROBOTS).filter(|robot| superior(*robot) != *robot);
    let orders = orders.map(|robot| (superior(robot), robot, 1.0));
    let mut graphs = vec![
        (Modality::connectivity(), near(0.9, 0.2)),
        (Modality::hierarchy(), SparseMatrix::from_triplets(ROBOTS, orders).unwrap()),
        (Modality::spatial(), near(0.8, 0.01)),
    ];
    if ranks == Ranks::Missing {
        graphs.remove(1);
    }
    Frame {
        robots: (0..ROBOTS).map(|i| RobotId::new(format!("r{i:02}")).unwrap()).collect(),
        graphs: graphs.into_iter().map(|(name, g)| (name, Graph::Matrix(Arc::new(g)))).collect(),
    }
}

fn once(frame: &Frame, settings: &EmbedderSettings) -> Embedded {
    embed(frame, &EmbeddingParams::once(settings, TEAMS).check().unwrap(), &mut |_| {}).unwrap()
}

#[test]
fn right_ranks_are_trusted_and_those_by_kind_are_not() {
    let settings = EmbedderSettings::default();
    let right = once(&frame(Ranks::ByTeam), &settings);
    assert!(right.trust.iter().all(|trust| trust.factor == 1.0), "{:?}", right.trust);
    assert!(right.trust.iter().all(|trust| trust.disagreeing.is_empty()));

    let wrong = once(&frame(Ranks::ByKind), &settings);
    let factors: Vec<f64> = wrong.trust.iter().map(|trust| trust.factor).collect();
    assert_eq!(factors, [1.0, 0.0, 1.0]);
    assert_eq!(wrong.weights[1], 0.0);
    assert!((wrong.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    assert_eq!(wrong.trust[1].disagreeing.len(), 8);
    assert!(wrong.trust[1].agreement.unwrap() < 0.55);
}

#[test]
fn a_modality_that_the_operator_trusts_keeps_its_weight() {
    for trusted in [Trusted::All, Trusted::Only(BTreeSet::from([Modality::hierarchy()]))] {
        let settings = EmbedderSettings { trusted, ..EmbedderSettings::default() };
        let found = once(&frame(Ranks::ByKind), &settings);
        assert_eq!(found.trust[1].factor, 1.0);
        assert!((found.weights[1] - 0.6).abs() < 1e-12, "{:?}", found.weights);
    }
}

#[test]
fn two_modalities_do_not_say_which_is_wrong() {
    let found = once(&frame(Ranks::Missing), &EmbedderSettings::default());
    assert!(found.trust.iter().all(|trust| trust.factor == 1.0 && trust.agreement.is_none()));
}

#[test]
fn a_single_wrong_rank_hardly_ties() {
    // What the ranks have in the similarity of the robot and the leader of the other team.
    let by_ranks = |settings: &EmbedderSettings| {
        let mut frames = Frames::default();
        let params = EmbeddingParams::once(settings, TEAMS).check().unwrap();
        let frame = frame(Ranks::OneWrong);
        frames.embed(&frame, &params, None, &mut |_| {}).unwrap();
        let pair = [frame.robots[9].clone(), frame.robots[0].clone()];
        let shares = frames.compare(&[pair]).remove(0).unwrap().shares;
        shares.into_iter().find(|(name, _)| *name == Modality::hierarchy()).unwrap().1
    };
    let doubted = by_ranks(&EmbedderSettings::default());
    let all = EmbedderSettings { trusted: Trusted::All, ..EmbedderSettings::default() };
    let trusted = by_ranks(&all);
    assert!(doubted < 0.35 * trusted, "{doubted} {trusted}");
}

#[test]
fn a_live_fleet_follows_ranks_that_become_wrong_and_right_again() {
    let settings = EmbedderSettings::default();
    let params = EmbeddingParams::new(&settings, TEAMS, Pace::Moving).check().unwrap();
    let mut frames = Frames::default();
    let mut factors = Vec::new();
    for ranks in [Ranks::ByTeam, Ranks::ByKind, Ranks::ByTeam] {
        let mut last = BTreeMap::new();
        // Twenty frames: all robots are examined ten times, and old findings are forgotten.
        for _ in 0..20 {
            let frame = frame(ranks);
            let found = frames.embed(&frame, &params, None, &mut |_| {}).unwrap();
            let names = frame.graphs.iter().map(|(name, _)| name.clone());
            last = names.zip(found.trust).collect();
        }
        factors.push(last[&Modality::hierarchy()].factor);
    }
    assert_eq!(factors, [1.0, 0.0, 1.0]);
}

#[test]
fn robots_that_join_and_leave_do_not_disturb_the_trust() {
    let params = EmbeddingParams::new(&EmbedderSettings::default(), TEAMS, Pace::Moving);
    let params = params.check().unwrap();
    let mut frames = Frames::default();
    let whole = frame(Ranks::ByKind);
    for round in 0..6 {
        // Every other frame lacks a robot in the middle of the list.
        let kept: Vec<usize> = (0..ROBOTS).filter(|robot| round % 2 == 0 || *robot != 13).collect();
        let part = |graph: &Graph| {
            let Graph::Matrix(matrix) = graph else { unreachable!() };
            let place = |robot: usize| kept.iter().position(|kept| *kept == robot);
            let edges = matrix.triplets().filter_map(|(i, j, w)| Some((place(i)?, place(j)?, w)));
            Graph::Matrix(Arc::new(SparseMatrix::from_triplets(kept.len(), edges).unwrap()))
        };
        let frame = Frame {
            robots: kept.iter().map(|robot| whole.robots[*robot].clone()).collect(),
            graphs: whole.graphs.iter().map(|(name, graph)| (name.clone(), part(graph))).collect(),
        };
        let found = frames.embed(&frame, &params, None, &mut |_| {}).unwrap();
        assert_eq!(found.trust[1].factor, 0.0, "frame {round}");
        assert!(found.trust[1].disagreeing.iter().all(|robot| frame.robots.contains(robot)));
    }
}
