//! What a file begins with: the live fleet, the plain mathematics, or the paper.

use muster_model::settings::{CentroidStart, Normalization, Trusted};
use serde_json::{Value, json};

use super::*;
use crate::options::Preset;
use crate::output;
use crate::problem::Division;

/// Two graphs that together, with equal weights, are a→b 2, b→a 2, b→c 2.
fn chain() -> Value {
    json!({"robots": ["a", "b", "c"], "teams": 2, "dimension": 4,
           "emit": ["katz", "embedding", "diagnostics"],
           "modalities": [{"name": "x", "edges": [["a", "b", 2], ["b", "a", 4]]},
                          {"name": "y", "edges": [["a", "b", 2], ["b", "c", 4]]}]})
}

/// Two groups of six by two modalities, while a third ties each robot to one of the other group.
fn contradicted() -> Value {
    let within = |step: usize| {
        let pairs = (0..12).map(move |i| (i, i / 6 * 6 + (i % 6 + step) % 6));
        pairs.map(|(i, j)| json!([format!("r{i}"), format!("r{j}"), 1])).collect::<Vec<_>>()
    };
    let [near, radio] = [2, 3].map(|step| [within(1), within(step)].concat());
    let across = (0..12).map(|i| json!([format!("r{i}"), format!("r{}", (i * 5 + 6) % 12), 1]));
    json!({"robots": names(12), "teams": 2, "emit": ["diagnostics"],
           "modalities": [{"name": "near", "edges": near},
                          {"name": "radio", "edges": radio},
                          {"name": "wrong", "edges": across.collect::<Vec<_>>()}]})
}

fn report(file: &Value) -> (Value, String) {
    let (problem, solution) = solve(&file.to_string()).unwrap();
    let json = output::to_json(&problem, &solution).unwrap();
    (serde_json::from_str(&json).unwrap(), output::summary(&problem, &solution))
}

#[test]
fn the_preset_of_the_paper_is_its_formula() {
    let in_file = with(chain(), json!({"preset": "paper"})).to_string();
    let (problem, by_file) = solve(&in_file).unwrap();
    let options = Options { preset: Some(Preset::Paper), ..Options::default() };
    let (_, by_option) = solve_with(&chain().to_string(), options).unwrap();
    assert_eq!(by_file.embedding, by_option.embedding);
    // αρ is a half, and S = (I − αA*)⁻¹ − I.
    assert_near(by_file.radius.value, 2.0, "ρ");
    assert_near(by_file.alpha, 0.25, "α");
    let expected =
        [[1.0 / 3.0, 2.0 / 3.0, 1.0 / 3.0], [2.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0], [0.0, 0.0, 0.0]];
    assert_katz(&by_file, |i, j| expected[i][j]);
    // The eigenvalues of S Sᵀ are (15 ± √153) / 18.
    assert_values(
        &by_file,
        &[(15.0 + 153_f64.sqrt()) / 18.0, (15.0 - 153_f64.sqrt()) / 18.0].map(f64::sqrt),
    );
    // The singular vectors as they come: the inner products of rows of [U, V] are U Uᵀ + V Vᵀ. U spans a and b,
    // V all that is orthogonal to (1, 0, −1).
    let products = [[1.5, 0.0, 0.5], [0.0, 2.0, 0.0], [0.5, 0.0, 0.5]];
    let x = &by_file.embedding;
    for (i, row) in products.iter().enumerate() {
        for (j, product) in row.iter().enumerate() {
            let found: f64 = x.row(i).iter().zip(x.row(j)).map(|(l, r)| l * r).sum();
            assert_near(found, *product, "XXᵀ");
        }
    }
    let Division::Wanted(settings) = &problem.division else { panic!("teams") };
    assert_eq!((settings.init, settings.restarts), (CentroidStart::Random, 1));
}

#[test]
fn keys_of_the_file_win_over_the_preset() {
    let given = json!({"preset": "paper", "self_loops": 1, "alpha": 0.1, "restarts": 9,
                       "normalize": "spectral", "trusted": ["x"]});
    let (problem, _) = solve(&with(chain(), given).to_string()).unwrap();
    let settings = &problem.settings;
    assert_eq!((settings.self_loops, settings.normalize), (1.0, Normalization::Spectral));
    assert!(matches!(&settings.trusted, Trusted::Only(names) if names.len() == 1));
    let Division::Wanted(settings) = &problem.division else { panic!("teams") };
    assert_eq!((settings.init, settings.restarts), (CentroidStart::Random, 9));
}

#[test]
fn observations_weigh_alike_and_lead_down_only_in_the_paper() {
    let file = json!({"robots": ["a", "b"], "teams": 1, "preset": "paper",
                      "poses": {"a": {"x": 0, "y": 0}, "b": {"x": 1, "y": 0}},
                      "ranks": {"b": {"superior": "a"}}});
    let (problem, _) = solve(&file.to_string()).unwrap();
    assert_eq!(problem.graphs.iter().map(|graph| graph.weight).collect::<Vec<_>>(), [0.5, 0.5]);
    assert_eq!(problem.graphs[1].matrix.triplets().collect::<Vec<_>>(), [(0, 1, 1.0)]);
}

#[test]
fn a_scale_of_its_own_asks_for_the_plain_mathematics() {
    for (changes, self_loops, is_trusted) in [
        (json!({}), 0.5, false),
        (json!({"normalize": "degree"}), 0.5, false),
        (json!({"normalize": "none"}), 0.0, true),
        (json!({"normalize": "spectral"}), 0.0, true),
        (json!({"normalize": "none", "self_loops": 2.0, "trusted": []}), 2.0, false),
        (json!({"self_loops": 0, "trusted": "all"}), 0.0, true),
    ] {
        let (problem, _) = solve(&with(contradicted(), changes).to_string()).unwrap();
        assert_eq!(problem.settings.self_loops, self_loops);
        assert_eq!(problem.settings.trusted == Trusted::All, is_trusted);
    }
}

#[test]
fn self_loops_are_those_of_robots_with_an_edge() {
    let file = json!({"robots": ["a", "b", "c"], "teams": 1, "normalize": "none", "self_loops": 0.5,
                      "alpha": 0.4, "emit": ["katz"],
                      "modalities": [{"name": "m", "edges": [["a", "b", 1], ["b", "a", 1]]}]});
    let found = solved(&file);
    assert_near(found.radius.value, 1.5, "ρ");
    // (I − αA*)⁻¹ of [[0.5, 1], [1, 0.5]] is [[0.8, 0.4], [0.4, 0.8]] / 0.48.
    let expected = [[0.8 / 0.48 - 1.0, 0.4 / 0.48], [0.4 / 0.48, 0.8 / 0.48 - 1.0]];
    assert_katz(&found, |i, j| expected.get(i).and_then(|row| row.get(j)).copied().unwrap_or(0.0));
}

#[test]
fn a_modality_that_contradicts_the_others_stands_out() {
    let (json, summary) = report(&contradicted());
    let [near, radio, wrong] = [0, 1, 2].map(|at| &json["modalities"][at]);
    assert_eq!((&near["trust"], &radio["trust"]), (&json!(1.0), &json!(1.0)));
    assert!(near["agreement"].as_f64().unwrap() > 0.7, "{near}");
    assert_eq!((&wrong["name"], &wrong["in_doubt"]), (&json!("wrong"), &json!(true)));
    assert_eq!((&wrong["trust"], &wrong["weight"]), (&json!(0.0), &json!(0.0)));
    assert_eq!(json["self_loops"], json!(0.5));
    assert!(summary.contains("wrong 0.00 IN DOUBT (agreement 0."), "{summary}");
    assert!(summary.contains("self-loops        0.5\n"), "{summary}");
    let disagreeing = json["diagnostics"]["disagreeing"].as_object().unwrap();
    assert_eq!(disagreeing.keys().collect::<Vec<_>>(), ["wrong"]);
    assert!(!disagreeing["wrong"].as_array().unwrap().is_empty());
    let (_, solution) = solve(&contradicted().to_string()).unwrap();
    assert!(solution.warnings[0].starts_with("modality wrong is in doubt: 0 % of its weight"));
    assert_eq!(solution.divided.labels, [[0; 6], [1; 6]].concat());

    let (json, summary) = report(&with(contradicted(), json!({"trusted": ["wrong"]})));
    assert_eq!(json["modalities"][2]["trust"], json!(1.0));
    assert!(json["modalities"][2]["agreement"].as_f64().unwrap() < 0.6);
    assert!(!summary.contains("IN DOUBT"), "{summary}");
    let (json, summary) = report(&with(contradicted(), json!({"trusted": "all"})));
    assert_eq!(json["modalities"][2]["agreement"], Value::Null);
    assert!(summary.contains("trust             1 for all, which were not compared"), "{summary}");
}
