//! Whatever is on the bus, decoding names what is wrong and does nothing else.

use crate::samples;
use muster_model::id::FleetId;
use muster_wire::envelope::{MAGIC, VERSION};
use muster_wire::{Format, KeySpace, Message, Packet, Source};
use proptest::prelude::*;

fn space() -> KeySpace {
    KeySpace::new(samples::fleet())
}

fn packet(key: &str, encoding: &str, payload: Vec<u8>) -> Packet {
    Packet::put(format!("muster/v1/alpha/{key}"), encoding, payload)
}

fn reason(packet: &Packet) -> String {
    Message::decode(&space(), packet).unwrap_err().reason
}

const BINARY: &str = "application/octet-stream;bincode";

const KEYS: [&str; 14] = [
    "robot/r1/pose",
    "robot/r1/links",
    "robot/r1/rank",
    "robot/r1/relation/thermal",
    "robot/r1/team",
    "robot/r1",
    "graph/spatial",
    "roster",
    "embedding",
    "teams",
    "audit",
    "event",
    "service/ingest/settings",
    "service/ingest/status",
];

/// Every message of the samples in binary form, with its key.
fn valid() -> Vec<Packet> {
    samples::all()
        .into_iter()
        .filter_map(|(_, message)| {
            let out = message.encode(message.keys().0, Format::Binary, samples::NOW).ok()?;
            Some(packet(&out.key.to_string(), &out.encoding, out.payload))
        })
        .collect()
}

#[test]
fn trailing_bytes_truncation_and_other_versions_are_refused() {
    for good in valid() {
        let bytes = good.payload.clone().unwrap();
        let with = |payload: Vec<u8>| reason(&Packet { payload: Ok(payload), ..good.clone() });
        assert!(with([bytes.clone(), vec![0]].concat()).contains("follow"));
        for length in 0..bytes.len() {
            with(bytes[..length].to_vec());
        }
        let mut other = bytes.clone();
        other[1] = VERSION + 1;
        assert!(with(other).contains("version"));
        let mut other = bytes.clone();
        other[2] = 200;
        assert!(with(other).contains("kind"));
        let mut other = bytes;
        other[0] = b'{';
        assert!(with(other).contains(&format!("0x{MAGIC:02X}")));
    }
}

#[test]
fn a_count_that_promises_more_than_there_is_does_not_allocate() {
    // A vector of 2⁶⁴−1 elements in nine bytes, at the place of the first vector of each kind.
    for kind in 1..=12 {
        for prefix in 0..16 {
            let mut bytes = vec![MAGIC, VERSION, kind];
            bytes.extend(vec![0; prefix]);
            bytes.extend([253, 255, 255, 255, 255, 255, 255, 255, 255]);
            for key in KEYS {
                assert!(Message::decode(&space(), &packet(key, BINARY, bytes.clone())).is_err());
            }
        }
    }
}

#[test]
fn deep_nesting_huge_payloads_and_numbers_out_of_range_are_refused() {
    let deep = "[".repeat(100_000).into_bytes();
    for key in KEYS {
        assert!(Message::decode(&space(), &packet(key, "", deep.clone())).is_err(), "{key}");
    }
    let huge = vec![b' '; 2 << 20];
    assert!(reason(&packet("robot/r1/pose", "", huge)).contains("limit"));
    let cut = Packet { payload: Err(2 << 20), ..packet("robot/r1/pose", "", Vec::new()) };
    assert!(reason(&cut).contains("limit"));
    for number in ["NaN", "Infinity", "-Infinity", "1e999", "\"1\"", "null", "1e8"] {
        let json = format!("{{\"x\":{number},\"y\":0}}");
        assert!(
            Message::decode(&space(), &packet("robot/r1/pose", "", json.into_bytes())).is_err()
        );
    }
}

#[test]
fn a_message_in_the_name_of_another_is_refused() {
    let as_other = |good: &Packet, key: &str| {
        reason(&Packet { key: format!("muster/v1/alpha/{key}"), ..good.clone() })
    };
    let all = valid();
    assert!(as_other(&all[0], "robot/r2/pose").contains("speaks for r2"));
    assert!(as_other(&all[3], "robot/r2/relation/thermal").contains("speaks for r2"));
    assert!(as_other(&all[4], "graph/spatial").contains("modalities"));
    let json = r#"{"edges":[["r2","r1",1.0]]}"#.as_bytes().to_vec();
    assert!(reason(&packet("robot/r1/relation/thermal", "", json)).contains("r2"));

    let beta = KeySpace::new(FleetId::new("beta").unwrap());
    let names_fleet =
        |packet: &&Packet| !packet.key.ends_with("settings") && !packet.key.ends_with("rank");
    for good in all.iter().skip(4).filter(names_fleet) {
        let moved = Packet { key: good.key.replace("alpha", "beta"), ..good.clone() };
        let refused = Message::decode(&beta, &moved).unwrap_err();
        assert!(refused.reason.contains("fleet"), "{} {}", moved.key, refused.reason);
    }
}

#[test]
fn wild_keys_deletes_and_strange_encodings_are_refused() {
    let json = br#"{"x":1,"y":2}"#.to_vec();
    assert!(reason(&packet("robot/*/pose", "", json.clone())).contains("wild"));
    let delete = Packet { source: Source::Delete, ..packet("robot/r1/pose", "", json.clone()) };
    assert!(reason(&delete).contains("deleted"));
    assert!(reason(&packet("robot/r1/pose", "image/png", json.clone())).contains("image/png"));
    assert!(reason(&packet("teams", "", json.clone())).contains("binary"));
    let token = Packet { source: Source::TokenAlive, ..packet("robot/r1/pose", "", json) };
    assert!(reason(&token).contains("token"));
}

#[test]
fn foreign_text_reaches_no_reason_unescaped_or_at_length() {
    let key = format!("robot/r1/{}\n\u{1b}[31m", "x".repeat(10_000));
    let refused = Message::decode(&space(), &packet(&key, "a\nb", Vec::new())).unwrap_err();
    // A key is cut short by itself; a reason holds whole sentences around its pieces of foreign text.
    for (text, limit) in [(&refused.key, 120), (&refused.reason, 250)] {
        assert!(text.chars().count() <= limit && !text.chars().any(char::is_control), "{text:?}");
    }
    assert!(refused.reason.ends_with("relation/{modality}"), "{}", refused.reason);
    assert!(refused.reason.matches('x').count() <= 120, "{}", refused.reason);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn arbitrary_bytes_never_panic(
        key in prop::sample::select(&KEYS[..]),
        binary in any::<bool>(),
        kind in 0_u8..16,
        bytes in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let headed = [vec![MAGIC, VERSION, kind], bytes.clone()].concat();
        let encoding = if binary { BINARY } else { "" };
        let _ = Message::decode(&space(), &packet(key, encoding, headed));
        let _ = Message::decode(&space(), &packet(key, encoding, bytes));
    }

    #[test]
    fn flipped_bits_never_panic(which in 0_usize..13, at in any::<prop::sample::Index>(), bit in 0_u8..8) {
        let all = valid();
        let good = &all[which % all.len()];
        let mut bytes = good.payload.clone().unwrap();
        let at = at.index(bytes.len());
        bytes[at] ^= 1 << bit;
        if let Ok(message) = Message::decode(&space(), &Packet { payload: Ok(bytes), ..good.clone() }) {
            // What decodes can be written again.
            message.encode(message.keys().0, Format::Binary, samples::NOW).unwrap();
        }
    }

    #[test]
    fn arbitrary_keys_never_panic(key in "\\PC{0,80}") {
        let _ = space().parse(&key);
        let _ = space().parse(&format!("muster/v1/alpha/{key}"));
    }
}
