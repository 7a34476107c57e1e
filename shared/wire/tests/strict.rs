//! Every JSON message is read by a parser that refuses a name that stands twice in one object. Most parsers
//! accept it, and differ in which of the two they keep.

use crate::samples;
use std::collections::BTreeSet;
use std::fmt;

use muster_model::event::{Event, EventKind, Severity};
use muster_model::id::ServiceName;
use muster_wire::{Format, Message, schema};
use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};

/// Any JSON value without a name that stands twice in one object.
struct Strict;

impl<'de> Deserialize<'de> for Strict {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(StrictVisitor)
    }
}

struct StrictVisitor;

impl<'de> Visitor<'de> for StrictVisitor {
    type Value = Strict;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("JSON")
    }

    fn visit_bool<E>(self, _: bool) -> Result<Strict, E> {
        Ok(Strict)
    }

    fn visit_u64<E>(self, _: u64) -> Result<Strict, E> {
        Ok(Strict)
    }

    fn visit_i64<E>(self, _: i64) -> Result<Strict, E> {
        Ok(Strict)
    }

    fn visit_f64<E>(self, _: f64) -> Result<Strict, E> {
        Ok(Strict)
    }

    fn visit_str<E>(self, _: &str) -> Result<Strict, E> {
        Ok(Strict)
    }

    fn visit_unit<E>(self) -> Result<Strict, E> {
        Ok(Strict)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Strict, A::Error> {
        while values.next_element::<Strict>()?.is_some() {}
        Ok(Strict)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Strict, A::Error> {
        let mut names = BTreeSet::new();
        while let Some((name, _)) = fields.next_entry::<String, Strict>()? {
            if names.contains(&name) {
                return Err(A::Error::custom(format!("{name:?} stands twice")));
            }
            names.insert(name);
        }
        Ok(Strict)
    }
}

fn check(name: &str, message: &Message) {
    let outbound = message.encode(message.keys().0, Format::Json, samples::NOW).unwrap();
    let read = serde_json::from_slice::<Strict>(&outbound.payload);
    let text = String::from_utf8_lossy(&outbound.payload);
    read.unwrap_or_else(|error| panic!("{name}: {error}: {text}"));
}

fn event(kind: EventKind) -> Message {
    let header = samples::header(46);
    Message::Event(Event { header, source: ServiceName::Ingest, severity: Severity::Info, kind })
}

#[test]
fn no_name_stands_twice_in_a_message() {
    for (name, message) in samples::all() {
        check(name, &message);
    }
    for kind in samples::event_kinds() {
        check(&format!("{kind:?}"), &event(kind));
    }
    serde_json::from_slice::<Strict>(schema::text()).unwrap();
}

#[test]
fn the_parser_refuses_what_others_let_pass() {
    for wrong in [r#"{"a": 1, "a": 1}"#, r#"{"a": [{"b": null, "c": 1.5, "b": "x"}]}"#] {
        assert!(serde_json::from_str::<Strict>(wrong).is_err(), "{wrong}");
    }
    serde_json::from_str::<Strict>(r#"{"a": {"b": true}, "b": [-1, {"a": 0}]}"#).unwrap();
}

#[test]
fn every_kind_of_event_has_a_sample() {
    let document: serde_json::Value = serde_json::from_slice(schema::text()).unwrap();
    let choices = document["$defs"]["event"]["oneOf"].as_array().unwrap();
    let known = choices.iter().filter_map(|choice| choice["properties"]["event"]["const"].as_str());
    let sampled: BTreeSet<String> = samples::event_kinds()
        .into_iter()
        .map(|kind| {
            let kind = serde_json::to_value(kind).unwrap();
            kind.as_object().unwrap().keys().next().unwrap().clone()
        })
        .collect();
    assert_eq!(sampled, known.map(str::to_owned).collect());
}
