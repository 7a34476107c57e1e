//! The search for better settings finds them, keeps good ones, and says what it cannot tune.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use muster_solve::{TuneOptions, Tuning};
use serde_json::{Value, json};

const OPTIONS: TuneOptions = TuneOptions { parts: 6, draws: 5, teams: Some(3) };

/// Three teams of eight by one modality, and other teams of as many by another one that is as plain.
fn fleet(weight_of_right: f64) -> String {
    let robots: Vec<String> = (0..24).map(|robot| format!("r{robot:02}")).collect();
    let edges = |near: &dyn Fn(usize, usize) -> f64| -> Vec<Value> {
        let pairs = (0..24).flat_map(|from| (0..24).map(move |to| (from, to)));
        let pairs = pairs.filter(|(from, to)| from != to);
        pairs.map(|(from, to)| json!([robots[from], robots[to], near(from, to)])).collect()
    };
    let right = |from: usize, to: usize| if from / 8 == to / 8 { 1.0 } else { 0.01 };
    // By this one all pairs are almost alike, and those of equal remainders a little nearer.
    let wrong = |from: usize, to: usize| if from % 3 == to % 3 { 1.0 } else { 0.6 };
    let file = json!({
        "robots": robots,
        "modalities": [
            {"name": "right", "weight": weight_of_right, "edges": edges(&right)},
            {"name": "wrong", "weight": 1.0 - weight_of_right, "edges": edges(&wrong)},
        ],
        "teams": 3,
    });
    file.to_string()
}

fn tuned(text: &str) -> Tuning {
    Tuning::new(text.as_bytes(), &OPTIONS, &mut |_| {}).unwrap()
}

#[test]
fn weights_that_divide_better_are_proposed() {
    let found = tuned(&fleet(0.03));
    let proposed = found.proposed().unwrap();
    let weights = &proposed.settings.weights;
    let of = |name: &str| weights.iter().find(|(other, _)| other.as_str() == name).unwrap().1;
    assert!(of("right") > of("wrong"), "{}", found.summary());
    assert!(proposed.silhouette > found.present.silhouette);
    assert!(proposed.stability >= found.present.stability);
    assert!(proposed.moved > 0);
    assert_eq!((found.robots, found.teams), (24, 3));
    // What is proposed is what the program applies and what it prints.
    let json = found.to_json();
    assert_eq!(json["proposed"], Tuning::patch(proposed));
    assert!(found.summary().contains("muster set embedder 'alpha="), "{}", found.summary());
    assert_eq!(json, tuned(&fleet(0.03)).to_json(), "the same fleet has the same result");
}

/// How many robots that `robots` names share a team, at most, in a division that is shown.
fn largest(json: &Value) -> u64 {
    json["largest_team"].as_u64().unwrap()
}

#[test]
fn every_division_respects_limits_and_wishes() {
    let mut file: Value = serde_json::from_str(&fleet(0.03)).unwrap();
    let free = tuned(&file.to_string()).to_json();
    assert!(free["best"].as_array().unwrap().iter().any(|entry| largest(entry) == 8), "{free}");
    file["size"] = json!({"min": 7, "max": 10});
    file["wishes"] = json!([{"kind": "reserve", "robots": ["r03", "r13"]}]);
    let found = tuned(&file.to_string());
    let json = found.to_json();
    let all = json["best"].as_array().unwrap().iter().chain([&json["present"]]);
    for entry in all {
        assert_eq!(entry["unassigned"], 2, "{entry}");
        assert!((8..=10).contains(&largest(entry)), "{entry}");
        // The teams of the right modality lose two robots and no more.
        assert!(entry["stability"].as_f64().is_some(), "{entry}");
    }
    let proposed = found.proposed().unwrap();
    assert!(proposed.silhouette > found.present.silhouette, "{}", found.summary());
    // Limits may leave room for another number of teams than the fleet shows.
    file["teams"] = json!({"from": 2, "to": 6});
    file["size"] = json!({"min": 5, "max": 6});
    let options = TuneOptions { teams: None, ..OPTIONS };
    let found = Tuning::new(file.to_string().as_bytes(), &options, &mut |_| {}).unwrap();
    assert_eq!(found.teams, 4, "22 robots in teams of 5 or 6");
    // What nothing satisfies is said with its numbers.
    file["size"] = json!({"min": 9});
    file["teams"] = json!(3);
    let refused = Tuning::new(file.to_string().as_bytes(), &OPTIONS, &mut |_| {}).unwrap_err();
    assert!(refused.to_string().contains("27"), "{refused}");
}

#[test]
fn each_division_is_shown_once() {
    let found = tuned(&fleet(0.5));
    let json = found.to_json();
    let moved = json["best"].as_array().unwrap().iter().filter(|entry| entry["moved"] == 0);
    assert!(moved.count() <= 1, "{}", found.summary());
}

#[test]
fn what_cannot_be_tuned_is_refused_with_the_remedy() {
    let refused = |text: &str, teams| {
        let options = TuneOptions { teams, ..OPTIONS };
        Tuning::new(text.as_bytes(), &options, &mut |_| {}).unwrap_err().to_string()
    };
    let few = r#"{"robots": ["a", "b"], "ranks": {"b": {"superior": "a"}}}"#;
    assert!(refused(few, None).contains("robots: 2 cannot be tuned: 5 to 10000 can"));
    let robots: Vec<String> = (0..8).map(|robot| format!("r{robot}")).collect();
    let one =
        json!({"robots": robots, "teams": 1, "ranks": {"r1": {"superior": "r0"}}}).to_string();
    assert!(refused(&one, None).contains("say how many with --teams"), "{}", refused(&one, None));
    assert!(refused(&one, Some(7)).contains("leave too few in each"));
    let labels = json!({"robots": robots, "labels": [0, 0, 0, 0, 1, 1, 1, 1],
                        "ranks": {"r1": {"superior": "r0"}}});
    assert!(refused(&labels.to_string(), None).starts_with("labels: "));
    assert!(refused("[]", None).len() > 3);
}
