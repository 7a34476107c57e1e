//! The pulls of the modalities add up to the score that puts a robot into its team.

use std::sync::Arc;

use muster_method::division::divide;
use muster_method::embedding::Frames;
use muster_method::params::{DivisionParams, EmbeddingParams};
use muster_method::{Frame, Graph};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{EmbedderSettings, Normalization, RowScaling, SingularValueScaling};
use muster_numeric::matrix::SparseMatrix;
use proptest::prelude::*;

/// Graphs of 6 to 14 robots by two modalities, directed, with weights.
fn frames() -> impl Strategy<Value = Frame> {
    (6_usize..14).prop_flat_map(|robots| {
        let edge = move || (0..robots, 0..robots, 0.05_f64..2.0);
        let edges = move || prop::collection::vec(edge(), robots..4 * robots);
        (edges(), edges()).prop_map(move |(one, other)| {
            let graph = |edges: Vec<(usize, usize, f64)>| {
                let mut edges = edges;
                edges.sort_by_key(|edge| (edge.0, edge.1));
                edges.dedup_by_key(|edge| (edge.0, edge.1));
                edges.retain(|edge| edge.0 != edge.1);
                Graph::Matrix(Arc::new(SparseMatrix::from_triplets(robots, edges).unwrap()))
            };
            let names = (0..robots).map(|i| RobotId::new(format!("r{i:02}")).unwrap());
            Frame {
                robots: names.collect(),
                graphs: vec![
                    (Modality::connectivity(), graph(one)),
                    (Modality::spatial(), graph(other)),
                ],
            }
        })
    })
}

fn settings() -> impl Strategy<Value = EmbedderSettings> {
    let normalize = prop::sample::select(vec![Normalization::Degree, Normalization::None]);
    let scale = prop::sample::select(vec![
        SingularValueScaling::None,
        SingularValueScaling::SqrtSigma,
        SingularValueScaling::InverseSqrtSigma,
    ]);
    let rows = prop::sample::select(vec![RowScaling::Unit, RowScaling::None]);
    (normalize, scale, rows, prop::sample::select(vec![0.0, 0.5])).prop_map(
        |(normalize, scale, rows, self_loops)| EmbedderSettings {
            normalize,
            scale,
            rows,
            self_loops,
            ..EmbedderSettings::default()
        },
    )
}

proptest! {
    #[test]
    fn pulls_add_up_to_the_score_and_the_score_orders_the_distances(
        frame in frames(),
        settings in settings(),
    ) {
        let params = EmbeddingParams::once(&settings, 2).check().unwrap();
        let mut all = Frames::default();
        let Ok(found) = all.embed(&frame, &params, None, &mut |_| {}) else { return Ok(()) };
        let division = DivisionParams { restarts: 3, ..DivisionParams::default() };
        let division = division.check().unwrap();
        let divided = divide(&found.x, &found.without_embedding, &division, None, &mut |_| {});
        let divided = divided.unwrap();
        let svd = &found.decomposition.svd;
        for robot in 0..frame.robots.len() {
            let pulls = all.reasons(svd, params.power, params.rows, robot, &divided.labels);
            prop_assert_eq!(pulls.is_empty(), found.without_embedding[robot]);
            for pull in &pulls {
                let sum: f64 = pull.modalities.iter().map(|(_, pull)| pull).sum();
                let sum = sum + pull.itself + pull.spread;
                // The vectors are exact to rounding, so nothing is left.
                prop_assert!((sum - pull.score).abs() <= 1e-9 * (1.0 + pull.score.abs()), "{:?}", pull);
                let centre = divided.centroids.row(pull.team);
                let row = found.x.row(robot);
                let distance: f64 = row.iter().zip(centre).map(|(x, c)| (x - c).powi(2)).sum();
                let length: f64 = row.iter().map(|x| x * x).sum();
                prop_assert!((length - pull.score - distance).abs() <= 1e-9 * (1.0 + length));
            }
            prop_assert!(pulls.windows(2).all(|pair| pair[0].score >= pair[1].score));
            if divided.converged && let (Some(nearest), Some(own)) = (pulls.first(), divided.labels[robot]) {
                let own = pulls.iter().find(|pull| pull.team == own).unwrap();
                prop_assert!(own.score >= nearest.score - 1e-9);
            }
        }
    }
}

#[test]
fn a_robot_between_two_teams_is_drawn_to_each_by_another_modality() {
    // Two cliques of four; robot 8 hears the first one and stands with the second one.
    let clique = |first: usize, weight: f64| {
        let pairs =
            (first..first + 4).flat_map(move |i| (first..first + 4).map(move |j| (i, j, weight)));
        pairs.filter(|(i, j, _)| i != j)
    };
    let with = |others: std::ops::Range<usize>| others.flat_map(|j| [(8, j, 1.0), (j, 8, 1.0)]);
    let graph = |edges: Vec<(usize, usize, f64)>| {
        Graph::Matrix(Arc::new(SparseMatrix::from_triplets(9, edges).unwrap()))
    };
    let both = || clique(0, 1.0).chain(clique(4, 1.0));
    let frame = Frame {
        robots: (0..9).map(|i| RobotId::new(format!("r{i}")).unwrap()).collect(),
        graphs: vec![
            (Modality::connectivity(), graph(both().chain(with(0..4)).collect())),
            (Modality::spatial(), graph(both().chain(with(4..8)).collect())),
        ],
    };
    let params = EmbeddingParams::once(&EmbedderSettings::default(), 2).check().unwrap();
    let mut frames = Frames::default();
    let found = frames.embed(&frame, &params, None, &mut |_| {}).unwrap();
    let labels: Vec<_> = (0..9).map(|robot| Some(usize::from((4..8).contains(&robot)))).collect();
    let svd = &found.decomposition.svd;
    let pulls = frames.reasons(svd, params.power, params.rows, 8, &labels);
    let of = |team: usize, modality: &Modality| {
        let pull = pulls.iter().find(|pull| pull.team == team).unwrap();
        pull.modalities.iter().find(|(name, _)| name == modality).unwrap().1
    };
    assert_eq!(pulls.len(), 2);
    assert!(of(0, &Modality::connectivity()) > of(1, &Modality::connectivity()), "{pulls:?}");
    assert!(of(1, &Modality::spatial()) > of(0, &Modality::spatial()), "{pulls:?}");
    assert!(frames.reasons(svd, params.power, params.rows, 9, &labels).is_empty());
    assert!(frames.reasons(svd, params.power, params.rows, 0, &labels[1..]).is_empty());
    assert!(Frames::default().reasons(svd, params.power, params.rows, 0, &labels).is_empty());
}
