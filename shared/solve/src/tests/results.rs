//! What a solve reports, meanwhile and in the end.

use serde_json::{Value, json};

use super::*;
use crate::options::PathChoice;
use crate::output;
use crate::{Solved, Step};

#[test]
fn each_step_is_reported_when_it_begins_and_each_round_and_restart_when_it_is_done() {
    let steps = |file: &Value, options| {
        let mut reported = Vec::new();
        Solved::watched(file.to_string().as_bytes(), options, &mut |step| reported.push(step))
            .unwrap();
        reported
    };
    let file = with(plain(6, &cliques(&[3, 3]), 0.25), json!({"teams": 2, "restarts": 3}));
    let kmeans = |done| Step::KMeans { done, restarts: 3 };
    let before = [Step::Fuse, Step::SpectralRadius, Step::Katz, Step::Svd];
    let after = [kmeans(0), kmeans(1), kmeans(2), kmeans(3), Step::Silhouettes];
    let options = Options::default();
    assert_eq!(steps(&file, options), [&before[..], &after].concat());
    let judged = with(file, json!({"teams": null, "labels": [0, 0, 0, 1, 1, 1]}));
    assert_eq!(steps(&judged, options), [&before[..], &[Step::Silhouettes]].concat());
    let options = Options { path: PathChoice::InverseFree, ..options };
    let reported = steps(&with(judged, json!({"emit": []})), options);
    assert_eq!(reported[..3], [Step::Fuse, Step::SpectralRadius, Step::SEARCH]);
    assert_eq!(reported.last(), Some(&Step::Silhouettes));
    let rounds = &reported[3..reported.len() - 1];
    assert!(!rounds.is_empty());
    for (done, step) in rounds.iter().enumerate() {
        let Step::Search { round, open, rank } = *step else { panic!("{step}") };
        assert_eq!(round, done + 1);
        assert!(open <= rank && (open == 0) == (round == rounds.len()), "{step}");
    }
}

#[test]
fn the_json_has_its_keys_in_order_and_full_precision() {
    let file = plain(3, &ring(3), 0.3);
    let (problem, solution) = solve(&file.to_string()).unwrap();
    let text = output::to_json(&problem, &solution).unwrap();
    let keys = [
        "robots",
        "self_loops",
        "modalities",
        "name",
        "weight",
        "trust",
        "agreement",
        "in_doubt",
        "rho",
        "alpha",
        "katz",
        "singular_values",
        "decomposition",
        "path",
        "residual",
        "gap",
        "angle_bound",
        "ambiguous",
        "converged",
        "embedding",
        "labels",
        "teams",
        "requested",
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
    let expected = [
        "alpha",
        "decomposition",
        "inertia",
        "labels",
        "modalities",
        "requested",
        "rho",
        "robots",
        "self_loops",
        "silhouette",
        "singular_values",
        "teams",
    ];
    let found: Vec<_> = read.as_object().unwrap().keys().map(String::as_str).collect();
    let mut sorted = found.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, expected);
}

#[test]
fn the_number_of_teams_is_chosen_unless_it_is_given() {
    let file = with(plain(9, &cliques(&[3, 3, 3]), 0.25), json!({"teams": null, "emit": []}));
    let chosen = |options: Options, file: &Value| {
        let solved = Solved::new(file.to_string().as_bytes(), options).unwrap();
        let json: Value = serde_json::from_str(&solved.to_json().unwrap()).unwrap();
        (json["requested"].as_u64(), json["considered"].clone(), solved.summary())
    };
    let (teams, considered, summary) = chosen(Options::default(), &file);
    assert_eq!((teams, considered.as_array().unwrap().len()), (Some(3), 9));
    assert!(considered[2]["score"].as_f64().unwrap() > 0.4, "{considered}");
    assert!(summary.contains("3 (chosen by modularity; scores: 3 "), "{summary}");
    let flag = Options { teams: Some(2.into()), ..Options::default() };
    let (teams, considered, summary) = chosen(flag, &file);
    assert_eq!((teams, considered), (Some(2), Value::Null));
    assert!(summary.contains("teams             2\n"), "{summary}");
    let range = with(file, json!({"teams": {"from": 4, "to": 6}}));
    let (teams, considered, _) = chosen(Options::default(), &range);
    assert!((4..=6).contains(&teams.unwrap()));
    assert_eq!(considered.as_array().unwrap().len(), 3);
    let nothing = with(plain(3, &[], 0.5), json!({"teams": null, "emit": []}));
    let (teams, _, summary) = chosen(Options::default(), &nothing);
    assert_eq!(teams, Some(1));
    assert!(summary.contains("1 (nothing to choose by)"), "{summary}");
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

#[test]
fn the_help_names_the_defaults_that_hold() {
    let embedder = json!(muster_model::settings::EmbedderSettings::default());
    let clusterer = json!(muster_model::settings::ClustererSettings::default());
    let line = |key: &str| {
        let mut lines = crate::AFTER_HELP.lines();
        lines.find(|line| line.starts_with(&format!("  {key} "))).unwrap()
    };
    for (settings, key) in [
        (&embedder, "normalize"),
        (&embedder, "alpha"),
        (&embedder, "dimension"),
        (&embedder, "scale"),
        (&embedder, "rows"),
        (&clusterer, "init"),
    ] {
        let value = settings[key].to_string().replace(':', ": ");
        let line = line(key);
        let (before, _) = line.split_once("(default)").unwrap();
        assert!(before.contains(&value), "{key}: {value} in {line}");
    }
    assert!(crate::AFTER_HELP.contains(&format!("{}, and 0 where", embedder["self_loops"])));
    for key in ["restarts", "seed"] {
        let wanted = format!("{key} ({})", clusterer[key]);
        assert!(line("init").contains(&wanted), "{wanted}");
    }
}
