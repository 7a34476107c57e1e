//! Closed forms, refusals by name, and texts that nobody would write.

use muster_numeric::matrix::DenseMatrix;
use serde_json::{Value, json};

use super::method::{self, Solution};
use super::output;
use super::problem::Problem;
use super::step::Step;
use super::{SolveError, Solved, parse};

fn solve(text: &str) -> Result<(Problem, Solution), SolveError> {
    let problem = parse(text.as_bytes(), false)?;
    let solution = method::solve(&problem, &mut |_| {})?;
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
    let katz: &DenseMatrix = solution.katz.as_ref().unwrap();
    for i in 0..katz.rows() {
        for j in 0..katz.cols() {
            assert_near(katz.get(i, j).unwrap(), expected(i, j), &format!("S[{i}][{j}]"));
        }
    }
}

fn assert_values(solution: &Solution, expected: &[f64]) {
    assert_eq!(solution.singular_values.len(), expected.len());
    for (found, expected) in solution.singular_values.iter().zip(expected) {
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

#[test]
fn a_directed_path_has_no_radius_and_powers_of_alpha() {
    let path: Vec<_> = (0..5).map(|i| (i, i + 1)).collect();
    let solution = solved(&plain(6, &path, 2.0));
    assert_eq!((solution.radius.value, solution.radius.acyclic), (0.0, true));
    assert_katz(&solution, |i, j| if j > i { 2f64.powi((j - i) as i32) } else { 0.0 });
    // 1/ρ does not exist; the fraction is taken of 1/‖A‖₂ = 1.
    let fraction = with(plain(6, &path, 2.0), json!({"alpha": {"fraction": 0.25}}));
    assert_near(solved(&fraction).alpha, 0.25, "α");
}

#[test]
fn a_directed_ring_is_circulant() {
    let (n, a) = (7, 0.6_f64);
    let solution = solved(&plain(n, &ring(n), a));
    assert_near(solution.radius.value, 1.0, "ρ");
    let around = 1.0 - a.powi(n as i32);
    assert_katz(&solution, |i, j| {
        let steps = if j > i { j - i } else { n + j - i };
        a.powi(steps as i32) / around
    });
    // The eigenvalues of S are αω/(1 − αω) for the n-th roots of unity ω, and S is normal.
    let angle = |k: usize| 2.0 * std::f64::consts::PI * k as f64 / n as f64;
    let modulus = |k| a / (1.0 - 2.0 * a * f64::cos(angle(k)) + a * a).sqrt();
    let mut expected: Vec<f64> = (0..n).map(modulus).collect();
    expected.sort_by(|l, r| r.total_cmp(l));
    assert_values(&solution, &expected);
}

#[test]
fn a_star_has_two_singular_values() {
    let (leaves, a) = (9, 0.25_f64);
    let edges: Vec<_> = (1..=leaves).flat_map(|leaf| [(0, leaf), (leaf, 0)]).collect();
    let file = plain(leaves + 1, &edges, a);
    let solution = solved(&file);
    let n = leaves as f64;
    assert_near(solution.radius.value, n.sqrt(), "ρ");
    let damped = 1.0 - a * a * n;
    assert_katz(&solution, |i, j| match (i, j) {
        (0, 0) => a * a * n / damped,
        (0, _) | (_, 0) => a / damped,
        _ => a * a / damped,
    });
    let walk = a * n.sqrt();
    let mut expected = vec![walk / (1.0 - walk), walk / (1.0 + walk)];
    assert_values(&solved(&with(file.clone(), json!({"dimension": 4}))), &expected);
    expected.resize(leaves + 1, 0.0);
    assert_values(&solution, &expected);
    // The rule stops where the rank ends.
    assert_eq!(solved(&with(file, json!({"dimension": "auto"}))).singular_values.len(), 2);
}

#[test]
fn a_complete_graph_is_ambiguous_behind_its_first_value() {
    let (n, a) = (6, 0.1_f64);
    let file = plain(n, &cliques(&[n]), a);
    let solution = solved(&file);
    let rho = (n - 1) as f64;
    assert_near(solution.radius.value, rho, "ρ");
    let first = a * rho / (1.0 - a * rho);
    let other = a / (1.0 + a);
    assert_katz(&solution, |i, j| {
        let own = if i == j { -other } else { 0.0 };
        (first + other) / n as f64 + own
    });
    let mut expected = vec![other; n];
    expected[0] = first;
    assert_values(&solution, &expected);
    let cut = solved(&with(file.clone(), json!({"dimension": 4})));
    assert!(cut.ambiguous && cut.gap.abs() < 1e-12);
    assert!(cut.warnings[0].contains("coincide"), "{:?}", cut.warnings);
    let first = solved(&with(file, json!({"dimension": 2})));
    assert!(!first.ambiguous && first.warnings.is_empty());
}

#[test]
fn two_cliques_are_two_teams_and_their_silhouettes_are_known() {
    let file = with(
        plain(6, &cliques(&[3, 3]), 0.25),
        json!({"scale": "sqrt-sigma", "rows": "unit", "dimension": "auto", "teams": 2}),
    );
    let solution = solved(&file);
    // Per clique σ₁ = αρ/(1 − αρ) with ρ = 2.
    assert_values(&solution, &[1.0, 1.0]);
    assert_eq!(solution.labels, [0, 0, 0, 1, 1, 1]);
    assert!(solution.inertia < 1e-24);
    let silhouette = solution.silhouette.unwrap();
    assert_near(silhouette.mean, 1.0, "mean");

    // Two points, at a distance of √2: rows of length 1 at right angles.
    let wrong = json!({"teams": null, "labels": [7, 7, 7, 7, 2, 2]});
    let solution = solved(&with(file.clone(), wrong));
    assert_eq!(solution.labels, [7, 7, 7, 7, 2, 2]);
    assert_near(solution.inertia, 1.5, "inertia");
    let silhouette = solution.silhouette.unwrap();
    let expected = [2.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, -1.0, 1.0, 1.0];
    for (found, expected) in silhouette.per_point.iter().zip(expected) {
        assert_near(*found, expected, "silhouette");
    }
    assert_near(silhouette.mean, 0.5, "mean");
    assert_eq!(silhouette.per_cluster.iter().map(|c| c.0).collect::<Vec<_>>(), [2, 7]);
    assert_near(silhouette.per_cluster[1].1, 0.25, "label 7");

    // Equal rows cannot be told apart: three teams cannot be made of two points.
    let three = solved(&with(file, json!({"teams": 3, "dimension": 4})));
    assert_eq!(three.labels, [0, 0, 0, 1, 1, 1]);
    assert!(three.warnings[0].contains("only 2"), "{:?}", three.warnings);
}

#[test]
fn robots_that_the_embedding_does_not_see_are_named_and_clustered() {
    let file = with(
        plain(8, &cliques(&[3, 3]), 0.1),
        json!({"dimension": 4, "rows": "unit", "scale": "sqrt-sigma", "teams": 3}),
    );
    let solution = solved(&file);
    assert_eq!(solution.labels, [0, 0, 0, 1, 1, 1, 2, 2]);
    assert_eq!(solution.unseen, [false, false, false, false, false, false, true, true]);
    assert!(solution.warnings[0].contains("r6, r7"), "{:?}", solution.warnings);
    assert_near(solution.silhouette.unwrap().per_point[7], 1.0, "of two equal rows");

    let nothing = solved(&with(plain(3, &[], 0.5), json!({"teams": 2})));
    assert_eq!(nothing.labels, [0, 0, 0]);
    assert!(nothing.silhouette.is_none());
    assert_eq!(nothing.warnings.len(), 2);
}

#[test]
fn one_robot_is_one_team() {
    let alone = solved(&json!({"robots": ["r1"], "teams": 1,
        "modalities": [{"name": "m", "matrix": [[0.0]]}]}));
    assert_eq!((alone.labels.as_slice(), alone.inertia), ([0].as_slice(), 0.0));
    let of_itself = solved(&json!({"robots": ["r1"], "teams": 1, "emit": ["katz"], "alpha": 0.25,
        "modalities": [{"name": "m", "matrix": [[2.0]]}], "normalize": "none"}));
    assert_near(of_itself.radius.value, 2.0, "ρ");
    assert_katz(&of_itself, |_, _| 1.0);
}

#[test]
fn matrix_and_edges_say_the_same_and_weights_add_up() {
    let entry = |part: Value| {
        json!({"robots": ["a", "b", "c"], "modalities": part, "teams": 2, "normalize": "none",
               "alpha": 0.2, "emit": ["katz"]})
    };
    let matrices = json!([
        {"name": "x", "weight": 0.4, "matrix": [[0, 1, 0], [1, 0, 0], [0, 0, 0]]},
        {"name": "y", "weight": 0.6, "matrix": [[0, 0, 1], [0, 0, 0], [0, 0, 0]]}]);
    let edges = json!([
        {"name": "x", "weight": 0.4, "edges": [["a", "b", 1], ["b", "a", 1.0], ["c", "a", 0]]},
        {"name": "y", "weight": 0.6, "edges": [["a", "c", 1]]}]);
    let (left, right) = (solved(&entry(matrices)), solved(&entry(edges)));
    assert_eq!(left.katz, right.katz);
    // The walks a→b, a→c and a→b→a→…: with x = 0.2·0.4 and y = 0.2·0.6.
    let (x, y) = (0.08, 0.12);
    let around = 1.0 - x * x;
    let expected =
        [[x * x / around, x / around, y / around], [x / around, x * x / around, x * y / around]];
    assert_katz(&left, |i, j| expected.get(i).map_or(0.0, |row| row[j]));

    // Equal weights where none is given, whatever their sum where that is wanted.
    let free = |weights: [Option<f64>; 2]| {
        entry(json!([{"name": "x", "weight": weights[0], "edges": [["a", "b", 1]]},
                     {"name": "y", "weight": weights[1], "edges": [["a", "c", 1]]}]))
    };
    assert_near(solved(&free([None, None])).katz.unwrap().get(0, 2).unwrap(), 0.1, "S");
    let text = free([Some(1.0), Some(3.0)]).to_string();
    assert!(refused(&text).starts_with("modalities: the weights sum to 4 "), "{}", refused(&text));
    let graphs = parse(text.as_bytes(), true).unwrap().graphs;
    assert_eq!((graphs[0].weight, graphs[1].weight), (0.25, 0.75));
    let zero = free([Some(0.0), Some(0.0)]).to_string();
    assert!(parse(zero.as_bytes(), true).unwrap_err().to_string().starts_with("modalities: "));
    assert!(refused(&free([Some(1.0), None]).to_string()).starts_with("modalities[1].weight: "));
}

#[test]
fn observations_become_the_live_graphs() {
    let file = json!({
        "robots": ["a", "b", "c"], "teams": 2, "normalize": "none", "alpha": 0.1, "emit": ["katz"],
        "poses": {"a": {"x": 0, "y": 0}, "b": {"x": 3, "y": 4, "frame": "map"}},
        "links": {"a": [{"peer": "b", "quality": 0.5}]},
        "ranks": {"b": {"superior": "a", "weight": 2.0}, "a": {"superior": null}},
        "weights": {"spatial": 0.5, "connectivity": 0.25, "hierarchy": 0.25},
    });
    let parsed = parse(file.to_string().as_bytes(), false).unwrap();
    let edges: Vec<Vec<_>> =
        parsed.graphs.iter().map(|graph| graph.matrix.triplets().collect()).collect();
    // One nearest-neighbour distance is half a width.
    let near = (-0.125_f64).exp();
    assert_eq!(edges[0], [(0, 1, near), (1, 0, near)]);
    assert_eq!(edges[1], [(1, 0, 0.5)], "from the one who is heard");
    assert_eq!(edges[2], [(0, 1, 2.0)], "from the superior");

    let changed = with(
        file.clone(),
        json!({"spatial": {"kernel": "exponential", "width": 1.0},
        "connectivity": {"unit": "rssi_dbm"},
        "links": {"a": [{"peer": "b", "quality": -65.0}]}}),
    );
    let parsed = parse(changed.to_string().as_bytes(), false).unwrap();
    assert_near(parsed.graphs[0].matrix.weight(0, 1), (-1.0_f64).exp(), "kernel");
    assert_near(parsed.graphs[1].matrix.weight(1, 0), 0.5, "dBm");

    let refusals = [
        (json!({"weights": {"spatial": 1.0, "radio": 0.0}}), "weights.radio: "),
        (json!({"weights": {"spatial": 0.5}}), "weights: the weights sum to 0.5 "),
        (json!({"weights": {"spatial": -0.5}}), "weights.spatial: "),
        (json!({"poses": {"z": {"x": 0, "y": 0}}}), "poses.z: z is not among"),
        (json!({"poses": {"a": {"x": 0}}}), "poses.a: missing field `y`"),
        (json!({"poses": {"a": [0, 0]}}), "poses.a: invalid type: sequence"),
        (json!({"poses": {"a": {"x": 0, "y": 0, "up": 1}}}), "poses.a.up: unknown field `up`"),
        (json!({"poses": {"a": {"x": 0, "y": 1e9}}}), "poses.a.y: "),
        (
            json!({"poses": {"a": {"x": 0, "y": 0}, "b": {"x": 0, "y": 0, "frame": "odom"}}}),
            "poses.b.frame: ",
        ),
        (json!({"links": {"a": [{"peer": "b", "quality": 2}]}}), "links.a[0].quality: "),
        (json!({"links": {"a": [{"peer": "a", "quality": 1}]}}), "links.a[0].peer: "),
        (json!({"links": {"a": [{"peer": "x", "quality": 1}]}}), "links.a[0].peer: x is not"),
        (
            json!({"links": {"a": [{"peer": "b", "quality": 1}, {"peer": "b", "quality": 1}]}}),
            "links.a[1].peer: b is named twice",
        ),
        (json!({"ranks": {"a": {"superior": "a"}}}), "ranks.a.superior: "),
        (json!({"ranks": {"a": {"superior": "q"}}}), "ranks.a.superior: q is not"),
        (json!({"ranks": {"a": {"superior": "b", "weight": -1}}}), "ranks.a.weight: "),
        (json!({"spatial": {"width": 0}}), "spatial.width: "),
        (json!({"spatial": {"wide": 1}}), "spatial.wide: "),
        (json!({"connectivity": {"unit": "miles"}}), "connectivity.unit: "),
        (json!({"poses": null, "weights": null, "spatial": {}}), "spatial: needs \"poses\""),
        (json!({"modalities": []}), "poses: must not stand beside \"modalities\""),
    ];
    for (changes, start) in refusals {
        let message = refused(&with(file.clone(), changes).to_string());
        assert!(message.starts_with(start), "{start:?} but {message}");
    }
    let twice = r#"{"robots": ["a"], "teams": 1, "ranks": {"a": {}, "a": {}}}"#;
    assert!(refused(twice).starts_with("ranks: a is named twice"), "{}", refused(twice));
}

#[test]
fn every_mistake_is_named_by_its_field() {
    let file = json!({
        "robots": ["r1", "r2", "r3"], "teams": 2,
        "modalities": [{"name": "x", "weight": 0.5, "edges": [["r1", "r2", 1], ["r2", "r1", 1]]},
                       {"name": "y", "weight": 0.5, "matrix": [[0, 1, 0], [1, 0, 0], [0, 0, 0]]}],
    });
    assert!(solve(&file.to_string()).is_ok());
    let one = |entry: Value| json!({"modalities": [entry]});
    let edges = |edges: Value| one(json!({"name": "x", "edges": edges}));
    let matrix = |matrix: Value| one(json!({"name": "x", "matrix": matrix}));
    let refusals = [
        (json!({"team": 2}), "team: unknown field `team`"),
        (json!({"robots": null}), "missing field `robots`"),
        (json!({"robots": []}), "robots: "),
        (json!({"robots": ["r1", "r2", "r1"]}), "robots[2]: r1 is named twice"),
        (json!({"robots": ["r1", "R2", "r3"]}), "robots[1]: an id may hold only"),
        (json!({"robots": ["r1", "", "r3"]}), "robots[1]: "),
        (json!({"robots": "r1"}), "robots: "),
        (json!({"modalities": null}), "modalities: is missing"),
        (json!({"modalities": []}), "modalities: "),
        (json!({"modalities": {}}), "modalities: "),
        (json!({"modalities": [["x", 1.0, null, []]]}), "modalities[0]: invalid type: sequence"),
        (one(json!({"name": "x"})), "modalities[0]: lacks"),
        (one(json!({"name": "x", "edges": [], "matrix": []})), "modalities[0]: has both"),
        (one(json!({"edges": []})), "modalities[0]: missing field `name`"),
        (one(json!({"name": "X", "edges": []})), "modalities[0].name: "),
        (one(json!({"name": "x", "edges": [], "heavy": 1})), "modalities[0].heavy: "),
        (one(json!({"name": "x", "edges": [], "weight": -1})), "modalities[0].weight: "),
        (one(json!({"name": "x", "edges": [], "weight": "1"})), "modalities[0].weight: "),
        (one(json!({"name": "x", "edges": [], "weight": 0.9})), "modalities: the weights sum"),
        (
            json!({"modalities": [{"name": "x", "edges": []}, {"name": "x", "edges": []}]}),
            "modalities[1].name: ",
        ),
        (matrix(json!([[0, 0, 0], [0, 0, 0]])), "modalities[0].matrix: "),
        (matrix(json!([[0, 0, 0], [0, 0], [0, 0, 0]])), "modalities[0].matrix[1]: "),
        (matrix(json!([[0, 0, 0], [0, 0, 0], [0, -1, 0]])), "modalities[0].matrix[2][1]: "),
        (matrix(json!([[0, 0, "1"], [0, 0, 0], [0, 0, 0]])), "modalities[0].matrix[0][2]: "),
        (matrix(json!([[0, 0, 1e200], [0, 0, 0], [0, 0, 0]])), "modalities[0].matrix[0][2]: "),
        (matrix(json!([[0, 0, 1e-200], [0, 0, 0], [0, 0, 0]])), "modalities[0].matrix[0][2]: "),
        (edges(json!([["r1", "r2"]])), "modalities[0].edges[0]: "),
        (edges(json!([["r1", "r2", 1, 1]])), "modalities[0].edges[0]"),
        (edges(json!([["r1", "r9", 1]])), "modalities[0].edges[0][1]: r9 is not among"),
        (edges(json!([["r9", "r1", 1]])), "modalities[0].edges[0][0]: "),
        (edges(json!([["r1", "r2", -1]])), "modalities[0].edges[0][2]: "),
        (edges(json!([["r1", "r2", null]])), "modalities[0].edges[0][2]: "),
        (
            edges(json!([["r1", "r2", 1], ["r2", "r1", 1], ["r1", "r2", 0]])),
            "modalities[0].edges[2]: the edge from r1 to r2 is given twice",
        ),
        (json!({"weights": {"x": 1}}), "weights: must not stand beside \"modalities\""),
        (json!({"spatial": {}}), "spatial: must not stand beside \"modalities\""),
        (json!({"normalize": "norm"}), "normalize: "),
        (json!({"scale": "sqrt"}), "scale: "),
        (json!({"rows": 1}), "rows: "),
        (json!({"alpha": 0}), "alpha: "),
        (json!({"alpha": -1}), "alpha: "),
        (json!({"alpha": "0.5"}), "alpha: "),
        (json!({"alpha": 1}), "alpha: 1 must be less than 1/ρ = "),
        (json!({"alpha": {"fraction": 1}}), "alpha.fraction: "),
        (json!({"alpha": {"fraction": 0}}), "alpha.fraction: "),
        (json!({"alpha": {"part": 0.5}}), "alpha.part: "),
        (json!({"alpha": {"fraction": 0.5, "of": 1}}), "alpha.of: "),
        (json!({"dimension": 3}), "dimension: "),
        (json!({"dimension": 0}), "dimension: "),
        (json!({"dimension": 8}), "dimension: "),
        (json!({"dimension": -2}), "dimension: "),
        (json!({"dimension": "all"}), "dimension: "),
        (json!({"teams": 0}), "teams: "),
        (json!({"teams": 4}), "teams: 4 teams cannot be made of 3 robots"),
        (json!({"teams": 2.5}), "teams: "),
        (json!({"teams": null}), "teams: is missing"),
        (json!({"labels": [0, 0, 1]}), "teams: must not stand beside \"labels\""),
        (json!({"teams": null, "labels": [0, 1]}), "labels: "),
        (json!({"teams": null, "labels": [0, 1, -1]}), "labels[2]: "),
        (json!({"teams": null, "labels": [0, 1, "a"]}), "labels[2]: "),
        (json!({"init": "best"}), "init: "),
        (json!({"restarts": 0}), "restarts: "),
        (json!({"seed": -1}), "seed: "),
        (json!({"emit": ["all"]}), "emit[0]: "),
        (json!({"emit": "katz"}), "emit: "),
    ];
    for (changes, start) in refusals {
        let message = refused(&with(file.clone(), changes).to_string());
        assert!(message.starts_with(start), "{start:?} but {message}");
    }
    let message = refused(&with(file, json!({"alpha": 2.5})).to_string());
    assert!(
        message.starts_with("alpha: 2.5 must be less than 1/ρ = ") && message.contains("(ρ = ")
    );
}

#[test]
fn numbers_that_json_lacks_are_called_so() {
    for word in ["NaN", "nan", "Infinity", "-Infinity", "inf", "-inf", "-nan", "1e999", "-1e999"] {
        let text = format!(
            "{{\"robots\": [\"a\"], \"teams\": 1,\n \"modalities\": [{{\"name\": \"x\", \
             \"matrix\": [[{word}]]}}]}}"
        );
        let message = refused(&text);
        assert!(message.starts_with("modalities[0].matrix[0][0]: "), "{word}: {message}");
        assert!(message.contains("NaN and Infinity are no JSON"), "{word}: {message}");
    }
    let other = refused("{\"robots\": [name]}");
    assert!(!other.contains("NaN"), "{other}");
}

#[test]
fn what_is_no_object_or_more_than_one_is_refused() {
    for text in ["", " ", "[]", "3", "null", "{", "{}", "\"x\"", "\u{feff}", "{} {}", "[[[[[[["] {
        assert!(!refused(text).is_empty(), "{text:?}");
    }
    let file = plain(2, &[(0, 1)], 0.5).to_string();
    assert!(solve(&file).is_ok());
    assert!(solve(&format!("\u{feff}{file}\n")).is_ok());
    assert!(refused(&format!("{file}{file}")).contains("trailing"));
    assert!(refused(&"[".repeat(100_000)).len() < 1000);
    let nested = format!("{{\"robots\": {}", "[".repeat(100_000));
    assert!(refused(&nested).starts_with("robots"));
    // What comes from the file does no harm to a terminal.
    let message = refused("{\"\\u001b[31m\": 1}");
    assert!(!message.contains('\u{1b}'), "{message:?}");
    assert!(refused(&format!("{{\"{}\": 1}}", "k".repeat(1_000_000))).len() < 10_000);
}

#[test]
fn each_step_is_told_when_it_begins_and_each_restart_when_it_is_done() {
    let steps = |file: &Value| {
        let mut told = Vec::new();
        Solved::watched(file.to_string().as_bytes(), false, &mut |step| told.push(step)).unwrap();
        told
    };
    let file = with(plain(6, &cliques(&[3, 3]), 0.25), json!({"teams": 2, "restarts": 3}));
    let kmeans = |done| Step::KMeans { done, restarts: 3 };
    let before = [Step::Fuse, Step::SpectralRadius, Step::Katz, Step::Svd];
    let after = [kmeans(0), kmeans(1), kmeans(2), kmeans(3), Step::Silhouettes];
    assert_eq!(steps(&file), [&before[..], &after].concat());
    let judged = with(file, json!({"teams": null, "labels": [0, 0, 0, 1, 1, 1]}));
    assert_eq!(steps(&judged), [&before[..], &[Step::Silhouettes]].concat());
}

#[test]
fn the_json_has_its_keys_in_order_and_full_precision() {
    let file = plain(3, &ring(3), 0.3);
    let (problem, solution) = solve(&file.to_string()).unwrap();
    let text = output::to_json(&problem, &solution).unwrap();
    let keys = [
        "robots",
        "rho",
        "alpha",
        "katz",
        "singular_values",
        "embedding",
        "labels",
        "teams",
        "inertia",
        "silhouette",
        "mean",
        "per_team",
        "per_robot",
        "diagnostics",
    ];
    let places: Vec<_> =
        keys.iter().map(|key| text.find(&format!("\"{key}\":")).unwrap()).collect();
    assert!(places.is_sorted(), "{text}");
    let read: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(read["silhouette"], json!({"mean": null, "per_team": [], "per_robot": []}));
    assert_eq!(read["teams"], json!({"r0": 0, "r1": 0, "r2": 0}));
    for (found, exact) in read["embedding"].as_array().unwrap().iter().zip(0..) {
        let row: Vec<f64> = serde_json::from_value(found.clone()).unwrap();
        assert_eq!(row, solution.embedding.row(exact), "bit by bit");
    }

    let bare = with(file, json!({"emit": []}));
    let (problem, solution) = solve(&bare.to_string()).unwrap();
    let read: Value = serde_json::from_str(&output::to_json(&problem, &solution).unwrap()).unwrap();
    let expected =
        ["alpha", "inertia", "labels", "rho", "robots", "silhouette", "singular_values", "teams"];
    let found: Vec<_> = read.as_object().unwrap().keys().map(String::as_str).collect();
    let mut sorted = found.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, expected);
}

#[test]
fn the_summary_names_what_matters() {
    let file = with(
        plain(6, &cliques(&[3, 3]), 0.25),
        json!({"rows": "unit", "dimension": "auto", "teams": 2, "alpha": {"fraction": 0.5}}),
    );
    let (problem, solution) = solve(&file.to_string()).unwrap();
    let text = output::summary(&problem, &solution);
    for part in ["ρ 2\n", "0.25 (fraction 0.5 of 1/ρ)", "r0 r1 r2", "r3 r4 r5", "1.000", "gap"] {
        assert!(text.contains(part), "{part:?} in\n{text}");
    }
}

#[test]
fn rounded_numbers_keep_six_digits() {
    let pairs = [
        (0.0, "0"),
        (1.0, "1"),
        (-2.5, "-2.5"),
        (0.1 + 0.2, "0.3"),
        (123_456.7, "123457"),
        (100_000.0, "100000"),
        (0.001_234_567_8, "0.00123457"),
        (1e-9, "1.000e-9"),
        (2.5e7, "2.500e7"),
    ];
    for (value, text) in pairs {
        assert_eq!(output::rounded(value), text);
    }
}

/// A small generator of its own (splitmix64): the cases are the same on every machine.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.roll() % bound.max(1) as u64) as usize
    }

    fn one_of<T: Clone>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())].clone()
    }

    /// A value such as might stand anywhere in a file.
    fn value(&mut self, depth: usize) -> Value {
        let numbers = [0.0, -0.0, 1.0, 0.5, -1.0, 1e-300, 1e-100, 1e99, 1e100, 1e308, 3.0, 1e6];
        let words = ["r0", "r1", "r2", "none", "unit", "auto", "katz", "", "R", "spectral", "m"];
        match self.below(if depth == 0 { 6 } else { 9 }) {
            0 => Value::Null,
            1 => json!(self.one_of(&[true, false])),
            2 => json!(self.one_of(&numbers)),
            3 => json!(self.roll() >> self.below(64)),
            4 => json!(self.below(6)),
            5 => json!(self.one_of(&words)),
            6 | 7 => (0..self.below(4)).map(|_| self.value(depth - 1)).collect(),
            _ => {
                let keys = ["fraction", "name", "weight", "matrix", "edges", "x", "y", "superior"];
                let entry =
                    |dice: &mut Self| (dice.one_of(&keys).to_owned(), dice.value(depth - 1));
                Value::Object((0..self.below(4)).map(|_| entry(self)).collect())
            }
        }
    }

    /// Some value inside of `value` becomes another one.
    fn spoil(&mut self, value: &mut Value) {
        let deeper = self.below(4) > 0;
        match value {
            Value::Array(items) if deeper && !items.is_empty() => {
                let at = self.below(items.len());
                self.spoil(&mut items[at]);
            }
            Value::Object(fields) if deeper && !fields.is_empty() => {
                let at = self.below(fields.len());
                if let Some(field) = fields.values_mut().nth(at) {
                    self.spoil(field);
                }
            }
            _ => *value = self.value(3),
        }
    }

    /// A file that might be right.
    fn file(&mut self) -> Value {
        let robots = 1 + self.below(6);
        let weight = |dice: &mut Self| {
            let wild = 10f64.powi(dice.below(200) as i32 - 100);
            dice.one_of(&[0.0, 0.0, 1.0, 0.3, 2.0, 1e-100, 1e100, wild])
        };
        let matrix: Vec<Vec<f64>> =
            (0..robots).map(|_| (0..robots).map(|_| weight(self)).collect()).collect();
        let edges: Vec<Value> = (0..robots)
            .map(|i| json!([format!("r{i}"), format!("r{}", self.below(robots)), weight(self)]))
            .collect();
        let mut file = json!({
            "robots": names(robots),
            "normalize": self.one_of(&["none", "spectral"]),
            "scale": self.one_of(&["none", "sqrt-sigma"]),
            "rows": self.one_of(&["none", "unit"]),
            "alpha": self.one_of(&[json!(0.2), json!({"fraction": 0.5}), json!({"fraction": 1e-9}),
                                   json!({"fraction": 0.999_999}), json!(1e-90), json!(1e90)]),
            "dimension": self.one_of(&[json!("auto"), json!(2), json!(2 * robots)]),
            "init": self.one_of(&["kmeans++", "random"]),
            "restarts": 3, "seed": self.roll(), "emit": ["katz", "embedding", "diagnostics"],
        });
        let more = match self.below(3) {
            0 => json!({"modalities": [{"name": "m", "weight": 0.25, "matrix": matrix},
                                       {"name": "e", "weight": 0.75, "edges": edges}]}),
            1 => json!({"modalities": [{"name": "m", "matrix": matrix}]}),
            _ => json!({
                "poses": {"r0": {"x": weight(self), "y": 1e-30}},
                "links": {"r0": [{"peer": "r1", "quality": weight(self)}]},
                "ranks": {"r0": {"superior": "r1", "weight": weight(self)}},
                "spatial": {"radius_m": 3.0, "all_pairs_up_to": self.below(4)},
            }),
        };
        file = with(file, more);
        if self.below(4) == 0 {
            with(file, json!({"labels": (0..robots).map(|_| self.below(3)).collect::<Vec<_>>()}))
        } else {
            with(file, json!({"teams": 1 + self.below(robots)}))
        }
    }
}

/// Every text is either solved, with finite numbers, or refused with a message.
fn never_panics(text: &[u8]) -> bool {
    let solved = parse(text, true).and_then(|problem| {
        let solution = method::solve(&problem, &mut |_| {})?;
        Ok((problem, solution))
    });
    match solved {
        Ok((problem, solution)) => {
            let numbers = solution.embedding.data().iter().chain(&solution.singular_values);
            let found = [solution.radius.value, solution.alpha, solution.inertia, solution.gap];
            assert!(numbers.chain(&found).all(|number| number.is_finite()));
            assert!(!output::summary(&problem, &solution).is_empty());
            let json = output::to_json(&problem, &solution).unwrap();
            let read: Value = serde_json::from_str(&json).unwrap();
            let silhouettes = read["silhouette"]["per_robot"].as_array().unwrap();
            assert!(silhouettes.iter().all(Value::is_number), "{json}");
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

/// How many texts of each kind are tried; more by the environment, for a long run by hand.
fn cases() -> usize {
    let wanted = std::env::var("MUSTER_SOLVE_CASES").ok();
    wanted.and_then(|count| count.parse().ok()).unwrap_or(1500)
}

#[test]
fn files_of_any_numbers_are_solved_or_refused() {
    let mut dice = Dice(1);
    let mut solved = 0;
    for _ in 0..cases() {
        solved += usize::from(never_panics(dice.file().to_string().as_bytes()));
    }
    assert!(solved > cases() / 10, "only {solved} of {} were any use", cases());
}

#[test]
fn spoiled_files_are_solved_or_refused() {
    let mut dice = Dice(2);
    for _ in 0..cases() {
        let mut file = dice.file();
        for _ in 0..=dice.below(2) {
            dice.spoil(&mut file);
        }
        never_panics(file.to_string().as_bytes());
        never_panics(dice.value(5).to_string().as_bytes());
    }
}

#[test]
fn spoiled_texts_are_solved_or_refused() {
    let mut dice = Dice(3);
    for _ in 0..cases() {
        let mut text = dice.file().to_string().into_bytes();
        for _ in 0..=dice.below(3) {
            let at = dice.below(text.len());
            match dice.below(4) {
                0 => text.truncate(at),
                1 => text[at..].rotate_left(1),
                2 => {
                    let words: [&[u8]; 5] = [b"NaN", b"[[[[", b"-Infinity", b"1e999", b"\xff\n"];
                    text.splice(at..at, dice.one_of(&words).iter().copied()).for_each(drop);
                }
                _ => text[at] = dice.roll() as u8,
            }
            text.push(b'}');
        }
        never_panics(&text);
    }
}
