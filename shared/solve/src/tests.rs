//! Tests of the whole method, by what they look at, with what they have in common.

mod closed_forms;
mod files;
mod hostile;
mod paths;
mod presets;
mod results;
mod saved;
mod small;

use muster_numeric::matrix::DenseMatrix;
use serde_json::{Value, json};

use super::method::{self, Solution};
use super::path::path_of;
use super::problem::Problem;
use super::{Options, SolveError, parse};

fn solve(text: &str) -> Result<(Problem, Solution), SolveError> {
    solve_with(text, Options::default())
}

fn solve_with(text: &str, options: Options) -> Result<(Problem, Solution), SolveError> {
    let problem = parse(text.as_bytes(), options)?;
    let path = path_of(&problem, options.path)?;
    let solution = method::solve(&problem, path, &mut |_| {})?;
    Ok((problem, solution))
}

fn solved(file: &Value) -> Solution {
    solve(&file.to_string()).unwrap().1
}

/// The message with which a file is refused.
fn refused(text: &str) -> String {
    solve(text).map(|_| ()).unwrap_err().to_string()
}

fn names(count: usize) -> Vec<String> {
    (0..count).map(|number| format!("r{number}")).collect()
}

/// A file in the plain form of the method: one graph of edges of weight 1.
fn plain(robots: usize, edges: &[(usize, usize)], alpha: f64) -> Value {
    let edges: Vec<_> =
        edges.iter().map(|(i, j)| json!([format!("r{i}"), format!("r{j}"), 1])).collect();
    json!({
        "robots": names(robots), "modalities": [{"name": "m", "edges": edges}],
        "normalize": "none", "scale": "none", "rows": "none", "alpha": alpha,
        "dimension": 2 * robots, "teams": 1, "emit": ["katz", "embedding", "diagnostics"],
    })
}

fn with(mut file: Value, changes: Value) -> Value {
    if let (Value::Object(file), Value::Object(changes)) = (&mut file, changes) {
        for (key, value) in changes {
            if value.is_null() {
                file.remove(&key)
            } else {
                file.insert(key, value)
            };
        }
    }
    file
}

fn assert_near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs().max(1.0), "{what}: {found}");
}

fn assert_katz(solution: &Solution, expected: impl Fn(usize, usize) -> f64) {
    let katz: &DenseMatrix = solution.decomposition.similarity.as_ref().unwrap();
    for i in 0..katz.rows() {
        for j in 0..katz.cols() {
            assert_near(katz.get(i, j).unwrap(), expected(i, j), &format!("S[{i}][{j}]"));
        }
    }
}

fn assert_values(solution: &Solution, expected: &[f64]) {
    let found = &solution.decomposition.svd.sigma;
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_near(*found, *expected, "σ");
    }
}

fn ring(robots: usize) -> Vec<(usize, usize)> {
    (0..robots).map(|i| (i, (i + 1) % robots)).collect()
}

fn cliques(sizes: &[usize]) -> Vec<(usize, usize)> {
    let mut edges = Vec::new();
    let mut first = 0;
    for size in sizes {
        let range = first..first + size;
        edges.extend(range.clone().flat_map(|i| range.clone().map(move |j| (i, j))));
        first += size;
    }
    edges.retain(|(i, j)| i != j);
    edges
}
