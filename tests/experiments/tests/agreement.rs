//! The baselines against the libraries that others take: networkx and scikit-learn.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a helper of tests that fails has found a fault"
)]

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use muster_experiments::formations::{Formation, Radio};
use muster_experiments::methods::girvan_newman::girvan_newman;
use muster_experiments::methods::lle::locally_linear_embedding;
use muster_experiments::random_systems::{campus, planted};
use muster_experiments::score::adjusted_rand_index;
use muster_experiments::system::{Nearness, System};
use muster_numeric::matrix::DenseMatrix;
use serde_json::{Value, json};

/// The answers of Python to questions.
fn ask(questions: &[Value]) -> Vec<Value> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = here.join("../../target/peers/bin/python");
    let mut child = Command::new(&python)
        .arg(here.join("tests/agreement.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap_or_else(|error| {
            panic!(
                "{}: {error}; tests/run installs it, or `python3 -m venv target/peers && \
                 target/peers/bin/python -m pip install -r tests/peers/requirements.txt`",
                python.display()
            )
        });
    let questions = serde_json::to_vec(questions).unwrap();
    child.stdin.take().unwrap().write_all(&questions).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Formations and random systems, in which all are neighbours of neighbours.
fn connected() -> Vec<System> {
    let formations = Formation::all().unwrap();
    let marching = formations
        .iter()
        .flat_map(|formation| Radio::ALL.map(|radio| formation.marching(radio, 11)));
    let random = (10..=50).step_by(20).map(|robots| campus(robots, 3));
    marching.chain(random).collect()
}

/// All that is divided.
fn systems() -> Vec<System> {
    connected().into_iter().chain((2..=6).map(|teams| planted(teams, 5).0)).collect()
}

#[test]
fn girvan_newman_divides_as_networkx_does() {
    let (mut questions, mut found) = (Vec::new(), Vec::new());
    for system in systems() {
        for graph in system.graphs(&Nearness::Inverse).unwrap() {
            let edges: Vec<_> = graph.triplets().map(|(i, j, _)| (i, j)).collect();
            for teams in [2, 3, 5] {
                let nodes = graph.nodes();
                questions.push(json!({
                    "do": "girvan_newman", "nodes": nodes, "edges": edges, "teams": teams,
                }));
                found.push(girvan_newman(nodes, &edges, teams));
            }
        }
    }
    let answers = ask(&questions);
    assert_eq!(answers.len(), found.len());
    for ((answer, found), question) in answers.iter().zip(&found).zip(&questions) {
        let wanted: Vec<usize> = serde_json::from_value(answer.clone()).unwrap();
        let wanted: Vec<_> = wanted.into_iter().map(Some).collect();
        let same = adjusted_rand_index(found, &wanted).unwrap();
        assert!(same > 1.0 - 1e-12, "{same}: {found:?} for {wanted:?} of {question}");
    }
}

#[test]
fn locally_linear_embedding_is_scikit_learns() {
    const NEIGHBOURS: usize = 5;
    const DIMENSION: usize = 2;
    let (mut questions, mut found) = (Vec::new(), Vec::new());
    // Where neighbours fall into parts, each part has coordinates of no weight, and any are as good.
    for system in connected() {
        // Distances to all others: what the spatial graph is made of, without ties.
        let n = system.robots();
        let rows: Vec<Vec<f64>> =
            (0..n).map(|i| (0..n).map(|j| system.distance(i, j)).collect()).collect();
        questions.push(json!({
            "do": "lle", "points": rows, "neighbours": NEIGHBOURS, "dimension": DIMENSION,
        }));
        let rows = DenseMatrix::from_rows(&rows).unwrap();
        found.push(locally_linear_embedding(&rows, NEIGHBOURS, DIMENSION).unwrap());
    }
    for (at, (answer, found)) in ask(&questions).into_iter().zip(&found).enumerate() {
        let wanted: Vec<Vec<f64>> = serde_json::from_value(answer).unwrap();
        // Axes may point either way, and two of about the same weight may be turned: products of rows do
        // not see that.
        for (i, row) in wanted.iter().enumerate() {
            for (j, other) in wanted.iter().enumerate() {
                let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                let off = dot(row, other) - dot(found.row(i), found.row(j));
                assert!(off.abs() < 1e-6, "system {at}, robots {i}, {j}: {off}");
            }
        }
    }
}
