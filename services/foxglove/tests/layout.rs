//! The layout that operators import names what there is.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeSet;

use muster_foxglove::Topic;
use muster_foxglove::schema::for_viewers;
use muster_model::id::Modality;
use serde_json::Value;

/// All texts of a document that begin as topics do, and all names of fields that do.
fn topics(value: &Value, found: &mut BTreeSet<String>) {
    let mut add = |text: &str| {
        if text.starts_with('/') {
            found.insert(text.to_owned());
        }
    };
    match value {
        Value::String(text) => add(text),
        Value::Array(all) => all.iter().for_each(|value| topics(value, found)),
        Value::Object(fields) => {
            fields.keys().for_each(|name| add(name));
            fields.values().for_each(|value| topics(value, found));
        }
        _ => {}
    }
}

#[test]
fn the_layout_fits_the_topics_and_their_fields() {
    let layout: Value =
        serde_json::from_str(include_str!("../../../deploy/foxglove/layout.json")).unwrap();
    let mut named = BTreeSet::new();
    topics(&layout, &mut named);
    let links = Modality::BUILT_IN.map(|name| Topic::Links(Modality::new(name).unwrap()));
    let offered: BTreeSet<String> =
        Topic::ALWAYS.into_iter().chain(links).map(|topic| topic.name()).collect();
    let quality = for_viewers("audit").unwrap();
    for path in &named {
        let (topic, fields) = path.split_once('.').unwrap_or((path, ""));
        assert!(offered.contains(topic), "{path}");
        let mut schema = &quality;
        for field in fields.split('.').filter(|field| !field.is_empty()) {
            schema = &schema["properties"][field];
        }
        assert!(fields.is_empty() || schema["type"] == "number", "{path} is no number: {schema}");
    }
    for topic in offered.iter().filter(|topic| *topic != "/tf") {
        assert!(named.iter().any(|path| path.starts_with(topic)), "{topic} is not shown");
    }
    // Each panel that is laid out has a configuration.
    let panels = layout["configById"].as_object().unwrap();
    let text = layout["layout"].to_string();
    for panel in panels.keys() {
        assert!(text.contains(&format!("\"{panel}\"")), "{panel} is not laid out");
    }
}
