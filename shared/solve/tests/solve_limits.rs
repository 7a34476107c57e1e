//! Limits, wishes and needs of a file: against all divisions of small fleets, and what is said of them.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::BTreeSet;

use clap::Parser;
use muster_model::settings::ClustererSettings;
use muster_solve::{LimitOptions, Options, SolveError, Solved};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

/// What a file gives, as the JSON of the command.
fn solve(text: &str) -> Result<Value, SolveError> {
    let solved = Solved::new(text.as_bytes(), Options::default())?;
    Ok(serde_json::from_str(&solved.to_json().unwrap()).unwrap())
}

/// The message with which a file is refused.
fn refused(file: &Value) -> String {
    solve(&file.to_string()).unwrap_err().to_string()
}

fn with(mut file: Value, changes: Value) -> Value {
    for (key, value) in changes.as_object().unwrap() {
        if value.is_null() {
            file.as_object_mut().unwrap().remove(key);
        } else {
            file[key] = value.clone();
        }
    }
    file
}

fn names(count: usize) -> Vec<String> {
    (0..count).map(|number| format!("r{number}")).collect()
}

/// Two groups of four that a weak tie joins.
fn two_groups() -> Value {
    let mut edges = vec![json!(["r3", "r4", 0.2]), json!(["r4", "r3", 0.2])];
    for first in [0, 4] {
        let near = (first..first + 4).flat_map(|i| (first..first + 4).map(move |j| (i, j)));
        edges.extend(
            near.filter(|(i, j)| i != j).map(|(i, j)| json!([format!("r{i}"), format!("r{j}"), 1])),
        );
    }
    json!({"robots": names(8), "teams": 2, "modalities": [{"name": "m", "edges": edges}]})
}

fn labels(json: &Value) -> Vec<usize> {
    serde_json::from_value(json["labels"].clone()).unwrap()
}

/// The robots of each team, by its id.
fn teams(json: &Value) -> Vec<(String, Vec<usize>)> {
    let ids: Vec<Option<String>> = serde_json::from_value(json["ids"].clone()).unwrap();
    let labels = labels(json);
    let ids = ids.into_iter().enumerate().filter_map(|(label, id)| Some((label, id?)));
    let robots = |label| (0..labels.len()).filter(|at| labels[*at] == label).collect();
    let mut all: Vec<_> = ids.map(|(label, id)| (id, robots(label))).collect();
    all.sort();
    all
}

#[test]
fn without_anything_asked_nothing_is_said_of_it() {
    let json = solve(&two_groups().to_string()).unwrap();
    assert!(json.get("optimal").is_none() && json.get("ids").is_none());
}

#[test]
fn sizes_wishes_and_needs_are_obeyed_and_the_output_says_how_well() {
    let file = with(two_groups(), json!({"size": {"min": 3, "max": 5}}));
    let json = solve(&file.to_string()).unwrap();
    let sizes: Vec<usize> = teams(&json).iter().map(|(_, robots)| robots.len()).collect();
    assert_eq!(sizes, [4, 4]);
    assert_eq!((&json["optimal"], &json["gap"]), (&json!(true), &json!(0.0)));
    assert_eq!(json["ids"], json!(["t1", "t2"]));

    let file = with(
        two_groups(),
        json!({"size": {"max": 4}, "wishes": [{"kind": "pin", "robots": ["r0"], "team": "t2"},
            {"kind": "apart", "robots": ["r0", "r1"]}, {"kind": "reserve", "robots": ["r7"]},
            {"kind": "pin", "robots": ["r2"], "team": "t9"}],
            "skills": {"r4": ["medic"], "r5": ["medic"]},
            "needs": [{"skill": "medic", "per_team": {"min": 1}}]}),
    );
    let json = solve(&file.to_string()).unwrap();
    let teams = teams(&json);
    let of = |robot: usize| teams.iter().find(|(_, robots)| robots.contains(&robot));
    assert_eq!(of(0).unwrap().0, "t2");
    assert_ne!(of(0), of(1));
    assert_ne!(of(4), of(5));
    assert_eq!(of(7), None);
    assert_eq!(json["wishes"][3]["wish"], "pin-r2-t9");
    assert_eq!(json["wishes"][3]["reason"], "team t9 is not there");
    assert_eq!(json["unassigned"], json!(["r7"]));
    assert_eq!(json["silhouette"]["per_robot"][7], Value::Null);
    assert_eq!(json["silhouette"]["per_robot"].as_array().unwrap().len(), 8);
    assert_eq!(json["needs"][0]["have"], 1);
    let states: Vec<&Value> =
        json["wishes"].as_array().unwrap().iter().map(|wish| &wish["state"]).collect();
    assert_eq!(states, ["active", "active", "active", "waiting"]);
    let summary = Solved::new(file.to_string().as_bytes(), Options::default()).unwrap().summary();
    assert!(summary.contains("limits            ") && summary.contains("t2 ("), "{summary}");
}

#[test]
fn what_nothing_satisfies_is_refused_with_the_arithmetic() {
    let asked = |changes: Value| refused(&with(two_groups(), changes));
    let text = asked(json!({"size": {"max": 3}}));
    assert!(text.ends_with("8 robots may only be in t1 and t2, which hold 6"), "{text}");
    let text = asked(json!({"size": {"min": 5}}));
    assert!(text.ends_with("t1 and t2 need 10 robots, and 8 may be there"), "{text}");
    let text = asked(json!({"needs": [{"skill": "medic", "per_team": {"min": 1}}],
                            "ranks": null, "skills": {"r1": ["medic"]}}));
    assert!(text.contains("1 robot with medic for 2 teams, which need 2"), "{text}");
    let pin = |robot: &str| json!({"kind": "pin", "robots": [robot], "team": "t1"});
    let text = asked(json!({"team_size": {"t1": {"max": 1}}, "wishes": [pin("r0"), pin("r1"),
        {"kind": "ban", "robots": ["r5"], "team": "t1"}]}));
    // Without either of the two pins something satisfies the rest; the ban has no part in it.
    assert!(text.contains("pin-r0-t1 and pin-r1-t1") && !text.contains("ban"), "{text}");
    for one in ["r0", "r1"] {
        let rest =
            with(two_groups(), json!({"team_size": {"t1": {"max": 1}}, "wishes": [pin(one)]}));
        assert!(solve(&rest.to_string()).is_ok());
    }
}

#[test]
fn what_makes_no_sense_is_refused_by_its_field() {
    for (changes, field) in [
        (json!({"size": {"min": 4, "max": 2}}), "size.max: "),
        (json!({"size": [1, 2]}), "size: "),
        (json!({"team_size": {"t1": {"least": 2}}}), "team_size.t1.least: "),
        (json!({"needs": [{"skill": "medic"}]}), "needs[0]: "),
        (json!({"skills": {"nobody": ["medic"]}}), "skills.nobody: nobody is not among"),
        (json!({"wishes": [{"kind": "pin", "robots": ["r1"]}]}), "wishes[0].team: "),
        (json!({"wishes": [{"kind": "reserve", "robots": ["x"]}]}), "wishes[0].robots: x is not"),
        (json!({"wishes": [{"kind": "lock", "team": "t1"}]}), "wishes[0].kind: "),
        (json!({"teams": null, "labels": [0, 0, 0, 0, 1, 1, 1, 1], "size": {"max": 4}}), "size: "),
    ] {
        let text = refused(&with(two_groups(), changes));
        assert!(text.starts_with(field), "{field}: {text}");
    }
}

#[derive(Parser)]
struct Flags {
    #[command(flatten)]
    limits: LimitOptions,
}

#[test]
fn flags_ask_for_the_same_as_a_file() {
    let flags = ["solve", "--size", "3..5", "--wish", "apart r1 r0", "--wish", "pin r0 t2"];
    let flags = flags.into_iter().chain(["--without", "r7", "--team-size", "t2=4"]);
    let limits = Flags::try_parse_from(flags).unwrap().limits;
    let by_flags = Solved::asked(
        two_groups().to_string().as_bytes(),
        Options::default(),
        &limits,
        &mut |_| {},
    );
    let file = with(
        two_groups(),
        json!({"size": {"min": 3, "max": 5}, "team_size": {"t2": {"min": 4, "max": 4}},
            "wishes": [{"kind": "apart", "robots": ["r0", "r1"]},
                       {"kind": "pin", "robots": ["r0"], "team": "t2"},
                       {"kind": "reserve", "robots": ["r7"]}]}),
    );
    let by_file = Solved::new(file.to_string().as_bytes(), Options::default()).unwrap();
    assert_eq!(by_flags.unwrap().to_json().unwrap(), by_file.to_json().unwrap());
    for wrong in ["", "lock t1", "pin r0", "apart r0", "keep r0", "pin R0 t1"] {
        assert!(Flags::try_parse_from(["solve", "--wish", wrong]).is_err(), "{wrong}");
    }
    let labelled = with(two_groups(), json!({"teams": null, "labels": [0, 0, 0, 0, 1, 1, 1, 1]}));
    let refusal =
        Solved::asked(labelled.to_string().as_bytes(), Options::default(), &limits, &mut |_| {});
    assert!(refusal.unwrap_err().to_string().starts_with("--size: must not be given"));
}

#[test]
fn a_saved_fleet_is_divided_within_its_limits_and_wishes() {
    let graph = json!({"fleet": "f", "modality": "m", "robots": names(8),
        "edges": two_groups()["modalities"][0]["edges"]});
    let mut settings = serde_json::to_value(ClustererSettings::default()).unwrap();
    settings["teams"] = json!(2);
    settings["size"] = json!({"min": null, "max": 5});
    settings["needs"] = json!([{"skill": "medic", "per_team": {"min": 1}}]);
    let robot = |name: &str, presence: &str| {
        json!({"robot": name, "presence": presence,
        "skills": ["medic"], "position": null})
    };
    let status = json!({"fleet": "f", "robot_tokens": 8, "robots":
        [robot("r0", "active"), robot("r1", "active"), robot("r6", "stale")]});
    let wish = |kind: &str| {
        json!({"operator": "o", "id": "w", "state": "active", "reason": null,
        "wish": {"kind": kind, "robots": ["r4", "r5"], "team": null, "expires": null, "note": null}})
    };
    let lines = |all: &[&Value]| all.iter().map(|line| format!("{line}\n")).collect::<String>();
    let json = solve(&lines(&[&graph, &settings, &status, &wish("apart")])).unwrap();
    let teams = teams(&json);
    let of = |robot: usize| teams.iter().position(|(_, robots)| robots.contains(&robot));
    assert_ne!(of(0), of(1), "the stale medic fills no need");
    assert_ne!(of(4), of(5));
    let text = solve(&lines(&[&graph, &settings])).unwrap_err().to_string();
    assert!(text.starts_with("needs: ") && text.contains("muster status --json"), "{text}");
}

/// What a random small fleet asks.
struct Asked {
    file: Value,
    teams: usize,
    size: [usize; 2],
    wishes: Vec<Value>,
    medics: BTreeSet<usize>,
    needs: [usize; 2],
}

fn random(seed: u64) -> Asked {
    let mut draw = ChaCha8Rng::seed_from_u64(seed);
    let robots = draw.random_range(3..=7);
    let teams = draw.random_range(2..=3.min(robots));
    let mut edges = Vec::new();
    for i in 0..robots {
        for j in 0..robots {
            if i != j && draw.random_bool(0.7) {
                edges.push(json!([format!("r{i}"), format!("r{j}"), draw.random_range(0.1..2.0)]));
            }
        }
        // No one is alone.
        edges.push(json!([format!("r{i}"), format!("r{}", (i + 1) % robots), 0.3]));
    }
    let mut seen = BTreeSet::new();
    edges.retain(|edge| seen.insert((edge[0].to_string(), edge[1].to_string())));
    let least = draw.random_range(0..=2);
    let size = [least, least + draw.random_range(0..=3_usize).max(1)];
    let name = |at: usize| format!("r{at}");
    let mut wishes = Vec::new();
    for _ in 0..draw.random_range(0..=3) {
        let [one, other] = [draw.random_range(0..robots), draw.random_range(0..robots)];
        let team = format!("t{}", draw.random_range(1..=teams));
        wishes.push(match draw.random_range(0..5) {
            0 => json!({"kind": "pin", "robots": [name(one)], "team": team}),
            1 => json!({"kind": "ban", "robots": [name(one)], "team": team}),
            2 if one != other => json!({"kind": "together", "robots": [name(one), name(other)]}),
            3 if one != other => json!({"kind": "apart", "robots": [name(one), name(other)]}),
            _ => json!({"kind": "reserve", "robots": [name(one)]}),
        });
    }
    let medics: BTreeSet<usize> = (0..robots).filter(|_| draw.random_bool(0.5)).collect();
    let needs = match draw.random_range(0..3) {
        0 => [1, robots],
        1 => [0, 1],
        _ => [0, robots],
    };
    let skills: serde_json::Map<String, Value> =
        medics.iter().map(|at| (name(*at), json!(["medic"]))).collect();
    let file = json!({"robots": names(robots), "teams": teams, "dimension": 4, "restarts": 5,
        "modalities": [{"name": "m", "edges": edges}], "wishes": wishes, "skills": skills,
        "emit": ["embedding", "diagnostics"],
        "size": {"min": size[0], "max": size[1]},
        "needs": [{"skill": "medic", "per_team": {"min": needs[0], "max": needs[1]}}]});
    Asked { file, teams, size, wishes, medics, needs }
}

impl Asked {
    /// Whether robots, those in no team left out, may be in these teams.
    fn allows(&self, place: &[Option<usize>], teams: &[usize]) -> bool {
        let robot = |name: &Value| name.as_str().unwrap()[1..].parse::<usize>().unwrap();
        let sizes = teams.iter().all(|team| {
            let members = || (0..place.len()).filter(|at| place[*at] == Some(*team));
            let medics = members().filter(|at| self.medics.contains(at)).count();
            (self.size[0]..=self.size[1]).contains(&members().count())
                && (self.needs[0]..=self.needs[1]).contains(&medics)
        });
        sizes
            && self.wishes.iter().all(|wish| {
                let robots: Vec<usize> =
                    wish["robots"].as_array().unwrap().iter().map(robot).collect();
                let team = wish["team"].as_str().map(|id| id[1..].parse::<usize>().unwrap() - 1);
                let of = |at: usize| place[robots[at]];
                let is_there = team.is_none_or(|team| teams.contains(&team));
                match wish["kind"].as_str().unwrap() {
                    "pin" => !is_there || of(0) == team,
                    "ban" => of(0) != team,
                    "together" => of(0) == of(1) && of(0).is_some(),
                    "apart" => of(0).is_none() || of(0) != of(1),
                    _ => of(0).is_none(),
                }
            })
    }

    fn reserved(&self) -> BTreeSet<usize> {
        let reserves = self.wishes.iter().filter(|wish| wish["kind"] == "reserve");
        reserves.map(|wish| wish["robots"][0].as_str().unwrap()[1..].parse().unwrap()).collect()
    }

    /// All divisions of the robots into teams.
    fn all(&self, teams: &[usize]) -> Vec<Vec<Option<usize>>> {
        let robots = self.file["robots"].as_array().unwrap().len();
        let reserved = self.reserved();
        let mut all = vec![Vec::new()];
        for robot in 0..robots {
            let here: Vec<Option<usize>> = match reserved.contains(&robot) {
                true => vec![None],
                false => teams.iter().map(|team| Some(*team)).collect(),
            };
            all = all
                .iter()
                .flat_map(|place: &Vec<Option<usize>>| {
                    here.iter().map(move |team| [place.as_slice(), &[*team]].concat())
                })
                .collect();
        }
        all.retain(|place| self.allows(place, teams));
        all
    }
}

#[test]
fn small_fleets_are_divided_as_the_best_of_all_divisions() {
    let (mut divided, mut refused) = (0, 0);
    for seed in 0..400 {
        let asked = random(seed);
        let all: Vec<usize> = (0..asked.teams).collect();
        let placed = asked.file["robots"].as_array().unwrap().len() - asked.reserved().len();
        if placed < asked.teams {
            continue;
        }
        let json = match solve(&asked.file.to_string()) {
            Err(SolveError::Conflict(text)) => {
                assert!(asked.all(&all).is_empty(), "{seed}: {text}: {}", asked.file);
                refused += 1;
                continue;
            }
            other => other.unwrap(),
        };
        assert_eq!(json["diagnostics"]["unseen"], json!([]), "{seed}");
        divided += 1;
        let teams = teams(&json);
        let number = |id: &str| id[1..].parse::<usize>().unwrap() - 1;
        let present: Vec<usize> = teams.iter().map(|(id, _)| number(id)).collect();
        let x: Vec<Vec<f64>> = serde_json::from_value(json["embedding"].clone()).unwrap();
        let mut place = vec![None; x.len()];
        for (id, robots) in &teams {
            robots.iter().for_each(|robot| place[*robot] = Some(number(id)));
        }
        assert!(asked.allows(&place, &all), "{seed}: {place:?} of {}", asked.file);
        let centre = |team: usize| {
            let rows: Vec<&Vec<f64>> =
                (0..place.len()).filter(|at| place[*at] == Some(team)).map(|at| &x[at]).collect();
            let mean = |at: usize| rows.iter().map(|row| row[at]).sum::<f64>() / rows.len() as f64;
            (0..x[0].len()).map(mean).collect::<Vec<f64>>()
        };
        let centres: Vec<(usize, Vec<f64>)> =
            present.iter().map(|team| (*team, centre(*team))).collect();
        let cost = |place: &[Option<usize>]| -> f64 {
            let of = |(at, team): (usize, &Option<usize>)| {
                let (_, centre) = centres.iter().find(|centre| Some(centre.0) == *team)?;
                Some(x[at].iter().zip(centre).map(|(x, c)| (x - c).powi(2)).sum::<f64>())
            };
            place.iter().enumerate().filter_map(of).sum()
        };
        let best = asked.all(&present).iter().map(|place| cost(place)).fold(f64::MAX, f64::min);
        let own = cost(&place);
        let inertia = json["inertia"].as_f64().unwrap();
        assert!((own - inertia).abs() < 1e-9 * own.max(1.0), "{seed}");
        let tolerance = 1e-6 * own.max(1e-3);
        let gap = json["gap"].as_f64().unwrap();
        assert!(own * (1.0 - gap) <= best + tolerance, "{seed}: {own} {best}");
        if json["optimal"] == true {
            assert!(own <= best + tolerance, "{seed}: {own} {best}");
        }
    }
    assert!(divided > 80 && refused > 40, "{divided} divided, {refused} refused");
}
