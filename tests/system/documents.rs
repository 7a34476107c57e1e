//! The documents are true of the programs: links lead somewhere, lists are complete, defaults are true.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use muster_model::id::{Modality, ServiceName};
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, HistorianSettings, IngestSettings,
    PlannerSettings, default_weight,
};
use muster_tests::hosts::fault::FAULTS;
use muster_tests::hosts::run_plan::Measured;
use muster_tests::ports::free_endpoint;
use muster_tests::process::run;
use serde_json::{Map, Value, json};

use crate::languages::blocks;

const OPERATORS_MANUAL: &str = "services/README.md";
const COMMANDS: &str = "services/muster/README.md";

/// How long a command without a bus may take.
const COMMAND_WITHIN: Duration = Duration::from_secs(20);

/// How long a demo of 20 s may take.
const DEMO_WITHIN: Duration = Duration::from_secs(60);

/// Most lines of the first document: what does not fit belongs into one that it links.
const README_LINES: usize = 150;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

fn read(document: &str) -> String {
    std::fs::read_to_string(root().join(document)).expect(document)
}

/// Every Markdown file of the repository.
fn documents(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name == "target" || name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            found.extend(documents(&path));
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
    found
}

/// The names of the headings of a document, as links have them.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let anchor = |line: &str| -> String {
        let kept = |letter: &char| letter.is_alphanumeric() || matches!(letter, ' ' | '-' | '_');
        let line = line.trim_start_matches('#').trim().to_lowercase();
        line.chars().filter(kept).map(|letter| if letter == ' ' { '-' } else { letter }).collect()
    };
    headings.map(anchor).collect()
}

#[test]
fn every_link_between_documents_leads_somewhere() {
    let documents = documents(&root());
    let mut links = 0;
    for document in &documents {
        let text = std::fs::read_to_string(document).unwrap();
        for part in text.split("](").skip(1) {
            let target = part.split([')', '\n']).next().unwrap();
            if target.starts_with("http") {
                continue;
            }
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            let path = match file {
                "" => document.clone(),
                file => document.parent().unwrap().join(file),
            };
            assert!(path.exists(), "{}: {target} does not exist", document.display());
            if !anchor.is_empty() {
                let text = std::fs::read_to_string(&path).unwrap();
                let found = anchors(&text).contains(anchor);
                assert!(found, "{}: {target} names no heading", document.display());
            }
            links += 1;
        }
    }
    assert!(links > 20 && documents.len() > 8, "{links} links in {} documents", documents.len());
}

#[test]
fn the_readme_is_short() {
    let lines = read("README.md").lines().count();
    assert!(lines <= README_LINES, "{lines} lines");
}

#[test]
fn the_demo_prints_the_teams_that_the_readme_shows() {
    let endpoint = free_endpoint().unwrap();
    let arguments = ["demo", "--seconds", "20", "--listen", &endpoint, "--state-directory", "none"];
    let (code, out, err) = run("muster", &arguments, DEMO_WITHIN).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let shown = &blocks("README.md", "demo")[0];
    // The names of the robots, and nothing that a clock decides.
    let rows: Vec<&str> = shown.lines().filter(|line| line.contains("-lead")).collect();
    assert_eq!(rows.len(), 2);
    for row in rows {
        let words: Vec<&str> = row.split_whitespace().collect();
        let printed = out.lines().any(|line| line.split_whitespace().eq(words.iter().copied()));
        assert!(printed, "{row} is not printed:\n{out}");
    }
}

/// The rows of the first table after a marker: each as its cells.
fn rows(document: &str, marker: &str) -> Vec<Vec<String>> {
    let text = read(document);
    let (_, text) = text.split_once(marker).expect(marker);
    text.lines()
        .skip_while(|line| !line.starts_with("| ---"))
        .skip(1)
        .take_while(|line| line.starts_with('|'))
        .map(|line| {
            line.trim_matches('|').split(" | ").map(|cell| cell.trim().to_owned()).collect()
        })
        .collect()
}

/// The texts between backticks.
fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// The first names of all rows.
fn names(rows: &[Vec<String>]) -> BTreeSet<String> {
    rows.iter().flat_map(|row| quoted(&row[0])).collect()
}

#[test]
fn the_operators_manual_names_every_setting() {
    let defaults = [
        serde_json::to_value(IngestSettings::default()),
        serde_json::to_value(EmbedderSettings::default()),
        serde_json::to_value(ClustererSettings::default()),
        serde_json::to_value(AuditorSettings::default()),
        serde_json::to_value(HistorianSettings::default()),
        serde_json::to_value(PlannerSettings::default()),
    ];
    let rows = rows(OPERATORS_MANUAL, "| service | settings |");
    assert_eq!(rows.len(), ServiceName::ALL.len());
    let services = ServiceName::ALL.map(ServiceName::as_str);
    for ((row, service), default) in rows.iter().zip(services).zip(defaults) {
        assert_eq!(row[0], service);
        let named: BTreeSet<String> = quoted(&row[1]).into_iter().collect();
        let default = default.unwrap();
        let fields: BTreeSet<String> = default.as_object().unwrap().keys().cloned().collect();
        assert_eq!(named, fields, "{service}");
    }
}

/// The weights follow from the fleet, so that no value in the configuration shows them.
#[test]
fn the_configuration_states_the_weights_that_are_built_in() {
    let text = read("deploy/muster.toml");
    for modality in [Modality::spatial(), Modality::connectivity(), Modality::hierarchy()] {
        let weight = default_weight(&modality, 1.0);
        let stated = format!("{modality} {weight}");
        let flat = text.replace("\n# ", " ");
        assert!(flat.contains(&stated), "deploy/muster.toml must state {stated:?}");
    }
}

#[test]
fn the_operators_manual_names_every_finding_of_the_doctor() {
    let mut source = String::new();
    for file in std::fs::read_dir(root().join("services/muster/src/doctor/findings")).unwrap() {
        source += &std::fs::read_to_string(file.unwrap().path()).unwrap();
    }
    let named = names(&rows(OPERATORS_MANUAL, "| `id` | finding |"));
    for name in &named {
        assert!(source.contains(&format!("\"{name}\"")), "no finding is called {name}");
    }
    assert!(named.len() > 20, "{named:?}");
}

#[test]
fn the_table_of_faults_names_each_that_is_measured() {
    let rows = rows(OPERATORS_MANUAL, "# Faults, and what you see");
    let named: Vec<&str> = rows.iter().map(|row| row[0].as_str()).collect();
    assert_eq!(named, FAULTS.map(|fault| fault.what));
    assert!(read(OPERATORS_MANUAL).contains(Measured::head()));
}

#[test]
fn every_command_is_described_and_exists() {
    let (code, help, _) = run("muster", &["--help"], COMMAND_WITHIN).unwrap();
    assert_eq!(code, Some(0));
    let (_, commands) = help.split_once("Commands:\n").unwrap();
    let commands: BTreeSet<String> = commands
        .lines()
        .take_while(|line| !line.is_empty())
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect();
    let described: BTreeSet<String> =
        rows(COMMANDS, "# The command").iter().map(|row| quoted(&row[0]).remove(0)).collect();
    assert_eq!(described, commands);
}

/// What `muster solve --json` writes for a file.
fn solved(file: &Value) -> Result<Value, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fleet.json");
    std::fs::write(&path, file.to_string()).unwrap();
    let arguments = ["solve", "--json", path.to_str().unwrap()];
    let (code, out, err) = run("muster", &arguments, COMMAND_WITHIN).unwrap();
    if code == Some(0) { Ok(serde_json::from_str(&out).unwrap()) } else { Err(err) }
}

/// A fleet in which every option changes something: two groups of unlike weights, and a lone robot.
fn fleet() -> Value {
    let edges = json!([
        ["a", "b", 1],
        ["b", "a", 0.5],
        ["b", "c", 0.7],
        ["c", "a", 0.2],
        ["d", "e", 2],
        ["e", "d", 1],
        ["e", "f", 0.3],
        ["f", "d", 1],
        ["c", "d", 0.1]
    ]);
    json!({
        "robots": ["a", "b", "c", "d", "e", "f"],
        "modalities": [{"name": "radio", "edges": edges}],
        "emit": ["embedding", "diagnostics"]
    })
}

fn with(mut file: Value, key: &str, value: Value) -> Value {
    file[key] = value;
    file
}

#[test]
fn the_format_of_solve_is_complete_and_its_defaults_are_true() {
    let rows = rows(COMMANDS, "<!-- solve input -->");
    let error = solved(&json!({"robots": ["a"], "undescribed": 1})).unwrap_err();
    let (_, fields) = error.split_once("expected one of").unwrap();
    assert_eq!(names(&rows), quoted(fields).into_iter().collect());

    let plain = solved(&fleet()).unwrap();
    let mut compared = BTreeSet::new();
    for row in &rows {
        let [default] = quoted(&row[2]).try_into().unwrap_or([String::new()]);
        let Ok(default) = serde_json::from_str::<Value>(&default) else { continue };
        let key = quoted(&row[0]).remove(0);
        if key == "emit" {
            let silent = solved(&with(fleet(), &key, default)).unwrap();
            let keys = |value: &Value| value.as_object().unwrap().len();
            assert_eq!(keys(&silent) + 2, keys(&plain), "nothing is added by default");
        } else {
            let explicit = solved(&with(fleet(), &key, default)).unwrap();
            assert_eq!(explicit, plain, "{key} has another default");
        }
        compared.insert(key);
    }
    let wanted = ["alpha", "dimension", "emit", "init", "normalize", "restarts", "rows", "scale"];
    let wanted = wanted.into_iter().chain(["seed", "teams"]).map(str::to_owned).collect();
    assert_eq!(compared, wanted);

    // What is asked of the teams adds how the division stands to that.
    let asked = with(fleet(), "size", json!({"max": 6}));
    let all = solved(&with(asked, "emit", json!(["katz", "embedding", "diagnostics"]))).unwrap();
    let written: BTreeSet<String> = all.as_object().unwrap().keys().cloned().collect();
    let described = names(&self::rows(COMMANDS, "<!-- solve output -->"));
    assert_eq!(described, written);
}

#[test]
fn the_examples_of_solve_and_both_recipes_of_the_paper_are_accepted() {
    let example: Value = serde_json::from_str(&blocks(COMMANDS, "solve")[0]).unwrap();
    assert!(solved(&example).is_ok());

    let recipe: Map<String, Value> =
        serde_json::from_str(&blocks(COMMANDS, "the paper, offline")[0]).unwrap();
    let plain = solved(&fleet()).unwrap();
    for (key, value) in &recipe {
        let one = solved(&with(fleet(), key, value.clone())).unwrap();
        // Start and number of restarts may find the same division; one modality has nothing to contradict.
        let is_drawn = matches!(key.as_str(), "init" | "restarts" | "trusted");
        assert!(is_drawn || one != plain, "{key} is the default, and so not needed");
    }
    let mut stated = fleet();
    recipe.iter().for_each(|(key, value)| stated[key] = value.clone());
    let by_preset = solved(&with(fleet(), "preset", json!("paper"))).unwrap();
    assert_eq!(solved(&stated).unwrap(), by_preset, "the preset stands for other keys");
    let mut live = Map::new();
    for line in blocks(OPERATORS_MANUAL, "the paper, live")[0].lines() {
        let line = line.replace('\'', "");
        let mut words = line.split(' ').skip(2);
        let service = words.next().unwrap();
        for assignment in words {
            let set = format!("{service}.{assignment}");
            let arguments = ["up", "--set", &set, "--check-config"];
            let (code, _, err) = run("muster", &arguments, COMMAND_WITHIN).unwrap();
            assert_eq!(code, Some(0), "{set}: {err}");
            let (key, value) = assignment.split_once('=').unwrap();
            let value = serde_json::from_str(value).unwrap_or_else(|_| json!(value));
            live.insert(key.to_owned(), value);
        }
    }
    // A file of graphs has no reciprocity unless it is given.
    assert_eq!(live.remove("reciprocity"), Some(json!({})));
    assert_eq!(live, recipe, "live and offline differ");
}
