//! A live fleet without a last division gets the division that `muster solve` finds for its vectors.

use muster_model::settings::{TeamCount, TeamSize};
use muster_solve::{Options, Solved};
use serde_json::{Value, json};

use super::*;

/// A fleet of three groups, by a number that draws the weights and what is asked of it.
fn file(seed: u64) -> Value {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut draw = |below: u64| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    // Not in the order of the names, which is that of a live fleet.
    let names: Vec<String> = [7, 2, 9, 4, 1, 8, 3, 6, 5, 0].map(|at| format!("r{at}")).to_vec();
    let mut edges = Vec::new();
    for from in 0..names.len() {
        for to in (0..names.len()).filter(|to| *to != from) {
            let near = from % 3 == to % 3;
            let weight = if near { 10 + draw(10) } else { draw(4) };
            if weight > 0 {
                edges.push(json!([names[from], names[to], weight as f64 / 10.0]));
            }
        }
    }
    let mut wishes = Vec::new();
    for _ in 0..draw(4) {
        let [one, other] = [draw(10), draw(10)].map(|at| format!("r{at}"));
        wishes.push(match draw(5) {
            0 => json!({"kind": "pin", "robots": [one], "team": "t2"}),
            1 => json!({"kind": "ban", "robots": [one], "team": "t1"}),
            2 if one != other => json!({"kind": "together", "robots": [one, other]}),
            3 if one != other => json!({"kind": "apart", "robots": [one, other]}),
            _ => json!({"kind": "reserve", "robots": [one]}),
        });
    }
    let max = if draw(6) == 0 { 2 } else { 4 };
    json!({"robots": names, "modalities": [{"name": "m", "edges": edges}], "teams": 3,
        "emit": ["embedding", "diagnostics"], "wishes": wishes,
        "skills": {"r1": ["medic"], "r2": ["medic"], "r3": ["medic"], "r4": ["medic"]},
        "size": {"min": 2, "max": max}, "needs": [{"skill": "medic", "per_team": {"min": 1}}]})
}

/// The vectors of a solve as a message.
fn vectors(solved: &Value) -> Checked<Embedding> {
    let names = solved["robots"].as_array().unwrap().iter();
    let rows: Vec<Vec<f64>> = serde_json::from_value(solved["embedding"].clone()).unwrap();
    let without = |name: &Value| solved["diagnostics"]["unseen"].as_array().unwrap().contains(name);
    let dimension = rows[0].len();
    let rows =
        names.zip(rows).map(|(name, row)| (robot(name.as_str().unwrap()), row, without(name)));
    let embedding = from_rows(1, 1, rows.collect());
    let dimension = u32::try_from(dimension).unwrap();
    Checked::new_unchecked(Embedding { dimension, ..(*embedding).clone() })
}

/// The division of a live fleet of which the same is asked.
fn live(file: &Value, embedding: &Checked<Embedding>) -> Checked<Teams> {
    let size: TeamSize = serde_json::from_value(file["size"].clone()).unwrap();
    let needs = serde_json::from_value(file["needs"].clone()).unwrap();
    let defaults = ClustererSettings::default();
    let settings = ClustererSettings { teams: TeamCount::Fixed(3), size, needs, ..defaults };
    let mut bench = Bench::leading(settings);
    for (at, wish) in file["wishes"].as_array().unwrap().iter().enumerate() {
        bench.get(&format!("wish/alice/w{at}"), Some(&wish.to_string())).unwrap();
    }
    let robots = "r0 r1:medic r2:medic r3:medic r4:medic r5 r6 r7 r8 r9";
    bench.receive_roster(roster(1, robots));
    bench.receive_embedding(embedding);
    // Another one may follow, as the teams that wishes name are there.
    bench.take().teams.first().unwrap().0.clone()
}

/// A text without the names of wishes, which a file has none of.
fn nameless(text: &str) -> String {
    let is_name = |word: &str| {
        let kinds = ["alice/", "pin-", "ban-", "together-", "apart-", "reserve-"];
        kinds.iter().any(|kind| word.trim_start_matches('(').starts_with(kind))
    };
    text.split(' ')
        .map(|word| if is_name(word) { "name" } else { word })
        .collect::<Vec<_>>()
        .join(" ")
}

#[test]
fn limits_wishes_and_needs_give_the_division_of_the_live_fleet() {
    let (mut same, mut refused) = (0, 0);
    for seed in 0..40 {
        let file = file(seed);
        let free = {
            // The vectors do not depend on what is asked of the teams.
            let mut free = file.clone();
            for key in ["size", "needs", "wishes"] {
                free.as_object_mut().unwrap().remove(key);
            }
            Solved::new(free.to_string().as_bytes(), Options::default()).unwrap().to_json().unwrap()
        };
        let division = live(&file, &vectors(&serde_json::from_str(&free).unwrap()));
        let limited = division.limited.as_ref().unwrap();
        match Solved::new(file.to_string().as_bytes(), Options::default()) {
            Err(error) => {
                let conflict = nameless(limited.conflict.as_ref().unwrap());
                let error = nameless(&error.to_string());
                assert!(error.ends_with(&conflict), "{seed}: {error}\n{conflict}");
                refused += 1;
            }
            Ok(solved) => {
                let solved: Value = serde_json::from_str(&solved.to_json().unwrap()).unwrap();
                for (name, label) in solved["teams"].as_object().unwrap() {
                    let team = division.robot_team(&robot(name)).unwrap().team;
                    let id = &solved["ids"][usize::try_from(label.as_u64().unwrap()).unwrap()];
                    assert_eq!(*id, json!(team), "{seed}: {name} of {file}");
                }
                assert_eq!(solved["gap"], json!(limited.gap), "{seed}");
                assert_eq!(solved["optimal"], json!(limited.optimal), "{seed}");
                assert_eq!(solved["inertia"], json!(division.inertia), "{seed}");
                same += 1;
            }
        }
    }
    assert!(same > 15 && refused > 5, "{same} divided, {refused} refused");
}
