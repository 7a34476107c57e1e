//! The bytes of every message are frozen: a robot of last year must be understood.
//!
//! A deliberate change of the schema is a new `VERSION`; then run with `UPDATE_GOLDEN=1`.

use crate::samples;
use std::fmt::Write as _;
use std::path::PathBuf;

use muster_wire::{Format, KeySpace, Message, Packet};

fn check(name: &str, content: &str) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, content).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_else(|_| panic!("no file {name}"));
    assert_eq!(content, golden, "{name} is written differently than before");
}

fn hex(bytes: &[u8]) -> String {
    let mut text = String::new();
    for line in bytes.chunks(32) {
        for byte in line {
            write!(text, "{byte:02x}").unwrap();
        }
        text.push('\n');
    }
    text
}

#[test]
fn the_binary_form_of_every_message_is_frozen_and_read_back() {
    let space = KeySpace::new(samples::fleet());
    for (name, message) in samples::all() {
        if matches!(
            message,
            Message::Status(_)
                | Message::Katz(_)
                | Message::Why(_)
                | Message::Proposal(_)
                | Message::Refused(_)
                | Message::History(_)
                | Message::HistoryState(_)
                | Message::Wish(_)
        ) {
            continue;
        }
        let outbound = message.encode(message.keys().0, Format::Binary, samples::NOW).unwrap();
        check(&format!("{name}.hex"), &hex(&outbound.payload));
        let packet = outbound.into_packet(&space);
        assert_eq!(Message::decode(&space, &packet), Ok(message), "{name}");
    }
}

#[test]
fn the_json_form_of_every_message_is_frozen() {
    for (name, message) in samples::all() {
        let outbound = message.encode(message.keys().0, Format::Json, samples::NOW).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&outbound.payload).unwrap();
        check(
            &format!("{name}.json"),
            &format!("{}\n", serde_json::to_string_pretty(&value).unwrap()),
        );
    }
}

/// What `muster propose` reads.
#[test]
fn the_json_form_of_a_proposal_is_read_back() {
    let space = KeySpace::new(samples::fleet());
    let found = samples::all().into_iter().find_map(|(_, message)| match message {
        Message::Proposal(report) => Some(report),
        _ => None,
    });
    let message = Message::Proposal(found.unwrap());
    let outbound = message.encode(message.keys().0, Format::Json, samples::NOW).unwrap();
    let packet = outbound.into_packet(&space);
    let read = muster_wire::proposal::decode(&space, &packet, samples::NOW).unwrap();
    let Message::Proposal(sent) = message else { unreachable!("it was one") };
    assert_eq!(read.proposal, sent.proposal);
    let elsewhere = Packet { key: packet.key.replace("/p1", "/p2"), ..packet };
    let refused = muster_wire::proposal::decode(&space, &elsewhere, samples::NOW).unwrap_err();
    assert!(refused.reason.contains("different proposals"), "{}", refused.reason);
}

/// What `muster history`, `events` and `robots` print with `--json`, and a get of a history is answered with.
#[test]
fn the_json_form_of_every_answer_of_a_history_is_frozen_and_read_back() {
    let space = KeySpace::new(samples::fleet());
    for (name, rows) in samples::history_rows() {
        let message = samples::history_of(rows);
        let outbound = message.encode(message.keys().0, Format::Json, samples::NOW).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&outbound.payload).unwrap();
        let text = format!("{}\n", serde_json::to_string_pretty(&value).unwrap());
        check(&format!("history_{name}.json"), &text);
        let read = muster_wire::history::answer(&space, &outbound.into_packet(&space)).unwrap();
        assert_eq!(Message::History(Box::new(read)), message, "{name}");
    }
}

#[test]
fn robots_are_understood_in_json() {
    let space = KeySpace::new(samples::fleet());
    for (name, message) in samples::all().into_iter().take(4) {
        let outbound = message.encode(message.keys().0, Format::Json, samples::NOW).unwrap();
        for encoding in ["application/json", "", "zenoh/bytes", "zenoh/string", "text/plain"] {
            let packet =
                Packet::put(space.format(&outbound.key), encoding, outbound.payload.clone());
            assert_eq!(
                Message::decode(&space, &packet).as_ref(),
                Ok(&message),
                "{name} {encoding}"
            );
        }
    }
}
