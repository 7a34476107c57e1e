//! The schema of the edge is frozen, so that every change of it is seen, and describes the samples'
//! fields one by one.
//!
//! Whether it describes what services write is tested against whole processes, with a validator that
//! somebody else wrote.

use crate::samples;
use std::collections::BTreeSet;
use std::path::Path;

use muster_model::event::EventKind;
use muster_model::id::ServiceName;
use muster_wire::{Format, schema};
use serde_json::{Value, json};

fn document() -> Value {
    serde_json::from_slice(schema::text()).unwrap()
}

#[test]
fn the_schema_of_the_edge_is_frozen() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/schema.json");
    let text = format!("{}\n", serde_json::to_string_pretty(&document()).unwrap());
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap();
    assert_eq!(text, golden, "the schema is another than before; see it with UPDATE_GOLDEN=1");
}

#[test]
fn every_message_and_every_part_is_there_once_and_refers_to_what_is_there() {
    let document = document();
    let names: Vec<_> = schema::names(&document).collect();
    let mut wanted = vec![
        "alerts",
        "audit",
        "claim",
        "embedding",
        "error",
        "event",
        "graph",
        "katz",
        "links",
        "pose",
        "rank",
    ];
    wanted.extend(["wish", "wish_report", "wishes", "why", "proposal", "proposal_request"]);
    wanted.extend(["refused", "relation", "robot_team", "roster", "status", "teams"]);
    wanted.extend(["history", "history_state", "command", "command_outcome", "bridge"]);
    let mut wanted: Vec<String> = wanted.into_iter().map(str::to_owned).collect();
    for service in ServiceName::ALL {
        wanted.extend([format!("{service}_settings"), format!("{service}_settings_patch")]);
    }
    wanted.sort();
    assert_eq!(names, wanted);
    for name in names {
        let alone = schema::one(&document, name).unwrap();
        let text = alone.to_string();
        for target in text.split("\"#/$defs/").skip(1) {
            let target = target.split('"').next().unwrap();
            assert!(alone["$defs"].get(target).is_some(), "{name} lacks {target}");
        }
        assert!(alone["description"].as_str().is_some_and(|text| text.len() > 20), "{name}");
    }
    assert_eq!(schema::one(&document, "RobotId"), None);
}

/// The fields that a schema of an object names, those of its choices too.
fn fields(schema: &Value) -> BTreeSet<&str> {
    let own = schema["properties"].as_object().into_iter().flatten().map(|(name, _)| name.as_str());
    let choices = schema["oneOf"].as_array().into_iter().flatten().flat_map(fields);
    own.chain(choices).collect()
}

#[test]
fn every_field_has_a_description() {
    fn look(path: &str, schema: &Value, without: &mut Vec<String>) {
        for (name, field) in schema["properties"].as_object().into_iter().flatten() {
            let path = format!("{path}.{name}");
            let described = ["description", "const"].iter().any(|key| field.get(key).is_some());
            if !described && name != "space" && name != "severity" {
                without.push(path.clone());
            }
            look(&path, field, without);
        }
        for choice in schema["oneOf"].as_array().into_iter().flatten() {
            // A choice of one field describes that field itself.
            let fields = choice["properties"].as_object().filter(|fields| fields.len() == 1);
            match fields.filter(|_| choice.get("description").is_some()) {
                Some(fields) => fields.values().for_each(|field| look(path, field, without)),
                None => look(path, choice, without),
            }
        }
    }
    let document = document();
    let mut without = Vec::new();
    for (name, part) in document["$defs"].as_object().unwrap() {
        look(name, part, &mut without);
    }
    assert_eq!(without, Vec::<String>::new());
}

#[test]
fn the_fields_of_the_samples_are_those_of_the_schema() {
    let document = document();
    for (name, message) in samples::all() {
        let schema = match name {
            "event_change" => "event",
            // A rank without skills leaves them out.
            "rank" => continue,
            "skilled_rank" => "rank",
            // The sample's settings are none that a service has.
            "settings" => continue,
            name => name,
        };
        let outbound = message.encode(message.keys().0, Format::Json, samples::NOW).unwrap();
        let value: Value = serde_json::from_slice(&outbound.payload).unwrap();
        let part = &document["$defs"][schema];
        let known = fields(part);
        let written: BTreeSet<_> = value.as_object().unwrap().keys().map(String::as_str).collect();
        if part.get("oneOf").is_none() {
            assert_eq!(written, known, "{name}");
        }
        assert!(written.is_subset(&known), "{name}: {written:?}");
    }
}

#[test]
fn every_kind_of_event_is_a_choice() {
    let document = document();
    let choices = document["$defs"]["event"]["oneOf"].as_array().unwrap();
    let kinds: BTreeSet<_> = choices
        .iter()
        .filter_map(|choice| choice["properties"]["event"]["const"].as_str())
        .collect();
    let plain = serde_json::to_value(EventKind::QualityLow { mean: 0.1 }).unwrap();
    assert_eq!(plain, json!({ "quality_low": { "mean": 0.1 } }));
    assert!(kinds.contains("quality_low") && kinds.contains("team_changed"), "{kinds:?}");
    let changes =
        choices.iter().filter_map(|choice| choice["properties"]["change"]["const"].as_str());
    assert_eq!(changes.collect::<Vec<_>>(), ["born", "died", "split", "merged", "moved"]);
}
