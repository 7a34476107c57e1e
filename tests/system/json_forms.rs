//! The JSON of every command has the form that its golden file holds: fields and types, not values.
//!
//! Which commands there are is read from their help, so that one with `--json` and no golden form is noticed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Duration;

use muster_tests::SOON;
use muster_tests::client::{division, now};
use muster_tests::cluster::Cluster;
use muster_tests::ports::free_endpoint;
use muster_tests::process::run;
use serde_json::{Map, Value, json};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "2", "--robots", "8"];

/// Objects whose keys are names of robots, teams, modalities or services, and no fields.
const MAPS: [&str; 6] = ["per_robot", "per_team", "weights", "team_size", "shares", "counters"];

/// Words that name a form of a command, beside its flags.
const NAMED: [&str; 4] = ["spatial", "auditor", "clusterer", "historian"];

fn golden_file() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("system/json_forms.json")
}

/// The names of types that a value may have, or the forms of what it is made of.
fn form(name: &str, value: &Value) -> Value {
    match value {
        Value::Null => json!({"is": ["null"]}),
        Value::Bool(_) => json!({"is": ["bool"]}),
        Value::Number(_) => json!({"is": ["number"]}),
        Value::String(_) => json!({"is": ["string"]}),
        Value::Array(all) => {
            let each = all.iter().map(|one| form(name, one)).fold(json!({}), joined);
            json!({"is": ["list"], "each": each})
        }
        Value::Object(fields) if MAPS.contains(&name) => {
            let each = fields.values().map(|one| form("", one)).fold(json!({}), joined);
            json!({"is": ["map"], "each": each})
        }
        Value::Object(fields) => {
            let fields: Map<String, Value> =
                fields.iter().map(|(name, one)| (name.clone(), form(name, one))).collect();
            json!({"is": ["object"], "fields": fields})
        }
    }
}

/// One form that allows both.
fn joined(left: Value, right: Value) -> Value {
    let types = |of: &Value| -> BTreeSet<String> {
        let names = of["is"].as_array().into_iter().flatten();
        names.filter_map(|name| name.as_str().map(str::to_owned)).collect()
    };
    let mut all = json!({"is": types(&left).union(&types(&right)).collect::<Vec<_>>()});
    if let Some(each) = both(&left["each"], &right["each"]) {
        all["each"] = each;
    }
    let names = |of: &Value| -> Vec<String> {
        of["fields"].as_object().into_iter().flat_map(Map::keys).cloned().collect()
    };
    let known: BTreeSet<String> = names(&left).into_iter().chain(names(&right)).collect();
    if left["fields"].is_object() || right["fields"].is_object() {
        let mut fields = Map::new();
        for name in known {
            let (before, after) = (&left["fields"][&name], &right["fields"][&name]);
            let mut field = both(before, after).unwrap_or_default();
            let is_new = |one: &Value, whole: &Value| one.is_null() && whole["fields"].is_object();
            if is_new(before, &left) || is_new(after, &right) {
                field["optional"] = json!(true);
            }
            fields.insert(name, field);
        }
        all["fields"] = Value::Object(fields);
    }
    if [&left, &right].iter().any(|of| of["optional"] == json!(true)) {
        all["optional"] = json!(true);
    }
    all
}

fn both(left: &Value, right: &Value) -> Option<Value> {
    match (left.is_null(), right.is_null()) {
        (true, true) => None,
        (false, true) => Some(left.clone()),
        (true, false) => Some(right.clone()),
        (false, false) => Some(joined(left.clone(), right.clone())),
    }
}

/// Whether a form is one that another allows.
fn fits(path: &str, found: &Value, golden: &Value) -> Result<(), String> {
    for name in found["is"].as_array().into_iter().flatten() {
        let is_known = golden["is"].as_array().is_some_and(|all| all.contains(name));
        if !is_known {
            return Err(format!("{path} is a {name}, and may be one of {}", golden["is"]));
        }
    }
    if found["each"]["is"].is_array() {
        fits(&format!("{path}[]"), &found["each"], &golden["each"])?;
    }
    if let (Some(found), Some(golden)) = (found["fields"].as_object(), golden["fields"].as_object())
    {
        for (name, one) in found {
            let path = format!("{path}.{name}");
            let wanted = golden.get(name).ok_or_else(|| format!("{path} is new"))?;
            fits(&path, one, wanted)?;
        }
        let missing = |(name, of): &(&String, &Value)| {
            of["optional"] != json!(true) && !found.contains_key(*name)
        };
        if let Some((name, _)) = golden.iter().find(missing) {
            return Err(format!("{path}.{name} is not there"));
        }
    }
    Ok(())
}

/// Every command that prints JSON, by its words.
fn commands_with_json(words: &[String], found: &mut BTreeSet<String>) {
    let arguments: Vec<&str> = words.iter().map(String::as_str).chain(["--help"]).collect();
    let (_, help, _) = run("muster", &arguments, SOON).unwrap();
    let mut is_commands = false;
    for line in help.lines() {
        if line.trim_start().starts_with("--json") {
            found.insert(words.join(" "));
        }
        if !line.starts_with(' ') {
            is_commands = line == "Commands:";
        } else if is_commands
            && let Some(word) = line.strip_prefix("  ").filter(|rest| !rest.starts_with(' '))
            && let Some(word) = word.split_whitespace().next().filter(|word| *word != "help")
        {
            commands_with_json(&[words, &[word.to_owned()]].concat(), found);
        }
    }
}

/// The JSON that a command has printed: one value, or one in each line.
fn printed(out: &str) -> Vec<Value> {
    match serde_json::from_str(out) {
        Ok(whole) => vec![whole],
        Err(_) => out
            .lines()
            .map(|line| {
                serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))
            })
            .collect(),
    }
}

/// The flag by which a team is asked for more robots than the fleet has.
const TOO_MANY: &str = "--team-size";

/// A command, and the further forms that it has.
type Asked<'a> = (&'a str, Vec<Vec<&'a str>>);

#[tokio::test(flavor = "multi_thread")]
async fn the_json_of_every_command_has_its_golden_form() {
    let records = tempfile::tempdir().unwrap();
    let settings = [
        ("clusterer", "teams=2"),
        ("clusterer", "needs=[{\"skill\":\"medic\",\"per_team\":{\"min\":1}}]"),
        ("auditor", "singleton=100"),
        ("auditor", "alert_after_s=0.0"),
    ];
    let mut cluster = Cluster::start("alpha", &settings).unwrap();
    cluster.start_service("historian").unwrap();
    cluster.start_service("planner").unwrap();
    let client = cluster.client().await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let alerts = client.watch("json/alerts").await.unwrap();
    let states = client.watch("history/*/state").await.unwrap();
    let robots = cluster.robots(&SCENARIO).unwrap();
    teams.until("teams", SOON, |value| division(value).len() == 8).await.unwrap();
    let open = |value: &Value| value["open"].as_array().is_some_and(|all| !all.is_empty());
    let list = alerts.until("an alert", SOON, open).await.unwrap();
    let alert = list["open"][0]["id"].to_string();
    let names: Vec<String> = division(&teams.newest().unwrap()).into_keys().collect();
    let (first, second) = (names[0].as_str(), names[1].as_str());
    let moment = format!("{:.6}", now());
    let through =
        |state: &Value| state["recorded_through"].as_u64() > Some((now() * 1e6) as u64 - 500_000);
    let _ = states.until("a recording", SOON, through).await;

    let saved = cluster.folder().join("graph.json");
    let (_, graph, _) = cluster.muster(&["graph", "--json"]).unwrap();
    std::fs::write(&saved, graph).unwrap();
    let saved = saved.to_str().unwrap().to_owned();
    let pin = format!("pin {first} t1");
    let endpoint = free_endpoint().unwrap();
    let recording = records.path().join("core.rec");
    record(&recording);
    let recording = recording.to_str().unwrap();

    let asked: Vec<Asked<'_>> = vec![
        ("status", vec![vec![]]),
        ("teams", vec![vec![]]),
        ("audit", vec![vec![]]),
        ("graph", vec![vec![], vec!["spatial"], vec!["--katz", first, second]]),
        ("why", vec![vec![first]]),
        ("alerts", vec![vec![]]),
        ("alerts ack", vec![vec![&alert]]),
        (
            "set",
            vec![
                vec!["clusterer"],
                vec!["clusterer", "restarts=9"],
                vec!["auditor"],
                vec!["historian"],
            ],
        ),
        ("wish pin", vec![vec![first, "t1", "--note", "a note"]]),
        ("wish ban", vec![vec!["nobody", "t2"]]),
        ("wish together", vec![vec!["nobody", "noone"]]),
        ("wish apart", vec![vec!["nobody", "noone"]]),
        ("wish lock", vec![vec!["t9"]]),
        ("wish reserve", vec![vec!["other"]]),
        ("wish list", vec![vec![]]),
        ("wish withdraw", vec![vec!["reserve-other"]]),
        (
            "history",
            vec![vec![], vec!["--as-of", &moment], vec!["--robot", first], vec!["--team", "t1"]],
        ),
        ("events", vec![vec![]]),
        ("robots", vec![vec![]]),
        ("tune", vec![vec!["--draws", "2"]]),
        ("doctor", vec![vec!["--listen-for", "1"]]),
        (
            "solve",
            vec![
                vec![&saved],
                vec![&saved, "--estimate"],
                vec![&saved, "--size", "1..", "--wish", &pin],
                vec![&saved, TOO_MANY, "t1=9.."],
            ],
        ),
        (
            "propose",
            vec![vec!["--teams", "3", "--id", "p1"], vec!["--without", second, "--id", "p2"]],
        ),
        ("propose show", vec![vec!["p1"]]),
        ("propose list", vec![vec![]]),
        ("propose drop", vec![vec!["p2"]]),
        ("propose accept", vec![vec!["p1"]]),
        ("replay-core", vec![vec![recording]]),
        (
            "demo",
            vec![vec!["--robots", "6", "--teams", "2", "--seconds", "12", "--listen", &endpoint]],
        ),
    ];
    let (mut found, mut ran) = (BTreeMap::new(), BTreeSet::new());
    let mut with_json = BTreeSet::new();
    commands_with_json(&[], &mut with_json);
    for (command, forms) in &asked {
        if !with_json.contains(*command) {
            continue;
        }
        ran.insert((*command).to_owned());
        for rest in forms {
            let words: Vec<&str> =
                command.split(' ').chain(rest.iter().copied()).chain(["--json"]).collect();
            let is_offline = ["solve", "replay-core", "demo"].contains(command);
            let (code, out, err) = if is_offline {
                run("muster", &words, Duration::from_secs(60)).unwrap()
            } else {
                cluster.muster(&words).unwrap()
            };
            // A doctor with findings says so, and `solve` where nothing satisfies what is asked.
            let may_fail = *command == "doctor" || words.contains(&TOO_MANY);
            assert!(code == Some(0) || may_fail, "{words:?}: {code:?} {err}");
            let form = printed(&out).iter().map(|one| form("", one)).fold(json!({}), joined);
            // A form of a command is named by its flags and settings, and not by its robots.
            let named = |word: &&str| word.starts_with("--") || NAMED.contains(word);
            let words = rest.iter().copied().filter(named);
            let name = std::iter::once(*command).chain(words).collect::<Vec<_>>().join(" ");
            let form = found.remove(&name).map_or(form.clone(), |before| joined(before, form));
            found.insert(name, form);
        }
    }
    drop(robots);
    assert_eq!(
        ran, with_json,
        "every command with --json has a golden form, in the list of this test"
    );
    compare(found);
}

/// Compares with the golden file; with `UPDATE_GOLDEN=1` what is found is added to it.
fn compare(found: BTreeMap<String, Value>) {
    let text = std::fs::read_to_string(golden_file()).unwrap_or_else(|_| "{}".to_owned());
    let mut golden: BTreeMap<String, Value> = serde_json::from_str(&text).unwrap();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        golden.retain(|name, _| found.contains_key(name));
        for (name, form) in found {
            let form = golden.remove(&name).map_or(form.clone(), |before| joined(before, form));
            golden.insert(name, form);
        }
        let text = serde_json::to_string_pretty(&golden).unwrap();
        std::fs::write(golden_file(), text + "\n").unwrap();
        return;
    }
    let names = |all: &BTreeMap<String, Value>| all.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&found), names(&golden), "UPDATE_GOLDEN=1 adds what is new");
    for (name, form) in &found {
        if let Err(problem) = fits("", form, &golden[name]) {
            panic!("muster {name} --json: {problem}; UPDATE_GOLDEN=1 if that is wanted");
        }
    }
}

/// A recording of a service that has received nothing but its start.
fn record(path: &std::path::Path) {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let router = muster_tests::cluster::start_router(&endpoint, folder.path()).unwrap();
    let name = path.parent().unwrap().to_str().unwrap();
    let arguments = ["--fleet", "alpha", "--connect", &endpoint, "--record", name];
    let mut service =
        muster_tests::process::Process::start("muster-clusterer", &arguments, &[], folder.path())
            .unwrap();
    std::thread::sleep(Duration::from_secs(3));
    service.signal("TERM").unwrap();
    service.wait(SOON).unwrap();
    drop(router);
    let made = std::fs::read_dir(path.parent().unwrap()).unwrap().next().unwrap().unwrap().path();
    std::fs::rename(made, path).unwrap();
}

#[test]
fn forms_are_joined_and_compared_by_fields_and_types() {
    let of = |value: Value| form("", &value);
    let golden = joined(of(json!({"a": 1, "b": [{"c": null}]})), of(json!({"a": 2, "b": []})));
    assert_eq!(fits("", &of(json!({"a": 7, "b": [{"c": null}, {"c": null}]})), &golden), Ok(()));
    let problem = |value: Value| fits("", &of(value), &golden).unwrap_err();
    assert_eq!(problem(json!({"a": 7})), ".b is not there");
    assert_eq!(problem(json!({"a": 7, "b": [], "d": 1})), ".d is new");
    assert!(problem(json!({"a": "7", "b": []})).starts_with(".a is a \"string\""));
    assert!(problem(json!({"a": 7, "b": [{"c": 1}]})).starts_with(".b[].c is a \"number\""));
    let some = joined(golden, of(json!({"a": 1, "b": [], "d": 1})));
    assert_eq!(fits("", &of(json!({"a": 7, "b": []})), &some), Ok(()));
    let maps = form("", &json!({"per_robot": {"r1": 1.0}}));
    assert_eq!(fits("", &form("", &json!({"per_robot": {"r2": 2.0, "r3": 1.0}})), &maps), Ok(()));
}
