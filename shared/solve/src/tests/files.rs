//! What a file may hold, and the errors of everything else.

use serde_json::{Value, json};

use super::*;

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
    assert_eq!(left.decomposition.similarity, right.decomposition.similarity);
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
    assert_near(
        solved(&free([None, None])).decomposition.similarity.unwrap().get(0, 2).unwrap(),
        0.1,
        "S",
    );
    let text = free([Some(1.0), Some(3.0)]).to_string();
    assert!(refused(&text).starts_with("modalities: the weights sum to 4 "), "{}", refused(&text));
    let normalised = Options { normalize_weights: true, ..Options::default() };
    let graphs = parse(text.as_bytes(), normalised).unwrap().graphs;
    assert_eq!((graphs[0].weight, graphs[1].weight), (0.25, 0.75));
    let zero = free([Some(0.0), Some(0.0)]).to_string();
    assert!(
        parse(zero.as_bytes(), normalised).unwrap_err().to_string().starts_with("modalities: ")
    );
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
    let parsed = parse(file.to_string().as_bytes(), Options::default()).unwrap();
    let edges: Vec<Vec<_>> =
        parsed.graphs.iter().map(|graph| graph.matrix.triplets().collect()).collect();
    // Each is the other's only neighbour, and a width is 0.85 of their distance.
    let near = (-0.5 / (0.85_f64 * 0.85)).exp();
    assert_eq!(edges[0].iter().map(|(i, j, _)| (*i, *j)).collect::<Vec<_>>(), [(0, 1), (1, 0)]);
    edges[0].iter().for_each(|(_, _, weight)| assert_near(*weight, near, "near"));
    assert_eq!(edges[1], [(1, 0, 0.5)], "from the sender");
    assert_eq!(edges[2], [(0, 1, 2.0), (1, 0, 1.0)], "from the superior, and half as much back");

    let changed = with(
        file.clone(),
        json!({"spatial": {"kernel": "exponential", "width": 1.0},
        "connectivity": {"unit": "rssi_dbm"}, "reciprocity": {},
        "links": {"a": [{"peer": "b", "quality": -65.0}]}}),
    );
    let parsed = parse(changed.to_string().as_bytes(), Options::default()).unwrap();
    assert_near(parsed.graphs[0].matrix.weight(0, 1), (-1.0_f64).exp(), "kernel");
    assert_near(parsed.graphs[1].matrix.weight(1, 0), 0.5, "dBm");
    assert_eq!(parsed.graphs[2].matrix.triplets().collect::<Vec<_>>(), [(0, 1, 2.0)], "down only");
    let mut unweighted = file.clone();
    unweighted.as_object_mut().unwrap().remove("weights");
    let parsed = parse(unweighted.to_string().as_bytes(), Options::default()).unwrap();
    for (graph, weight) in parsed.graphs.iter().zip([0.35, 0.05, 0.6]) {
        assert_near(graph.weight, weight, "as in the live fleet");
    }

    let without_edges = with(unweighted, json!({"ranks": {"a": {"superior": null}}}));
    let parsed = parse(without_edges.to_string().as_bytes(), Options::default()).unwrap();
    for (graph, weight) in parsed.graphs.iter().zip([0.875, 0.125, 0.0]) {
        assert_near(graph.weight, weight, "ranks that relate nobody");
    }

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
        (json!({"reciprocity": {"hierarchy": 2}}), "reciprocity.hierarchy: "),
        (json!({"reciprocity": {"radio": 0.5}}), "reciprocity.radio: is no modality"),
        (json!({"trusted": ["radio"]}), "trusted.radio: is no modality"),
        (json!({"poses": null, "weights": null, "spatial": {}}), "spatial: needs \"poses\""),
        (json!({"modalities": []}), "poses: must not be given with \"modalities\""),
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
            "modalities[0].edges[2]: the edge from r1 to r2 is given twice, first as edges[0]",
        ),
        (
            edges(json!([
                ["r3", "r1", 1],
                ["r1", "r2", 1],
                ["r3", "r1", 1],
                ["r1", "r2", 1],
                ["r3", "r1", 1]
            ])),
            "modalities[0].edges[2]: the edge from r3 to r1 is given twice, first as edges[0]",
        ),
        (edges(json!([["r1", "R2", 1]])), "modalities[0].edges[0][1]: an id may hold only"),
        (edges(json!([["r1", 2, 1]])), "modalities[0].edges[0][1]: invalid type: integer `2`"),
        (edges(json!([["r1", "r2", "1"]])), "modalities[0].edges[0][2]: invalid type: string"),
        (edges(json!({"r1": "r2"})), "modalities[0].edges: invalid type: map"),
        (json!({"weights": {"x": 1}}), "weights: must not be given with \"modalities\""),
        (json!({"spatial": {}}), "spatial: must not be given with \"modalities\""),
        (json!({"normalize": "norm"}), "normalize: "),
        (json!({"preset": "hope"}), "preset: unknown variant `hope`, expected `paper`"),
        (json!({"self_loops": -0.5}), "self_loops: must be a number from 0 to 4, not -0.5"),
        (json!({"self_loops": 4.5}), "self_loops: "),
        (json!({"self_loops": "half"}), "self_loops: "),
        (json!({"trusted": "none"}), "trusted: must be \"all\" or a list of modalities"),
        (json!({"trusted": ["x", "z"]}), "trusted.z: is no modality of this file: x, y"),
        (json!({"trusted": ["X"]}), "trusted: "),
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
        (json!({"teams": {"from": 4, "to": 5}}), "teams: 4 teams cannot be made of 3 robots"),
        (json!({"teams": {"from": 2, "to": 1}}), "teams.to: "),
        (json!({"teams": "many"}), "teams: "),
        (json!({"labels": [0, 0, 1]}), "teams: must not be given with \"labels\""),
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
