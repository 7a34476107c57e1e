//! Recordings in MCAP, which come from others, and what of them is played.

use std::ops::ControlFlow;

use muster_foxglove::recording::MAX_TOPICS;
use muster_foxglove::recording::play::{Pace, Reports, Step, overview};
use muster_foxglove::recording::reading::{End, Item, read};
use muster_model::id::FleetId;

use crate::{Outcome, allocation, text};

/// What a file begins with.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// The numbers of records that are read.
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const CHUNK: u8 = 0x06;
const METADATA: u8 = 0x0c;

/// Longest error about a file, in characters.
const MAX_ERROR: usize = 1000;

/// Memory that a file of any length may take: a chunk that says how long it is unpacked, which may be the longest record of
/// the bus, packed and unpacked.
const MAX_HELD: usize = 160 * 1024 * 1024;

/// Whether the rest is a file behind its begin, or records that are framed here: no chance finds eight bytes of a length.
pub(crate) fn mcap(data: &[u8]) -> Outcome {
    let Some((is_framed, rest)) = data.split_first() else { return Outcome::Refused };
    let records = if is_framed & 1 == 1 { framed(rest, true) } else { rest.to_vec() };
    let file = [MAGIC, &records].concat();
    allocation::at_most(MAX_HELD, "reading a recording", || play(&file))
}

/// Records of their number, their length in two bytes, and their content. That of a chunk is records again.
fn framed(mut parts: &[u8], with_chunks: bool) -> Vec<u8> {
    let mut file = Vec::new();
    while let [opcode, low, high, rest @ ..] = parts {
        let length = usize::from(u16::from_le_bytes([*low, *high])).min(rest.len());
        let (content, rest) = rest.split_at(length);
        match *opcode {
            CHUNK if with_chunks => file.extend(record(CHUNK, &chunk(&framed(content, false)))),
            opcode => file.extend(record(opcode, content)),
        }
        parts = rest;
    }
    file
}

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

fn string(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// A chunk of LZ4 whose only block is stored as it is.
fn chunk(records: &[u8]) -> Vec<u8> {
    // The magic of LZ4, its flags, and the checksum of these; then the block, whose highest bit says that it is stored.
    let head = [0x04, 0x22, 0x4d, 0x18, 0x60, 0x40, 0x82];
    let stored = (records.len() as u32 | 1 << 31).to_le_bytes();
    let packed = [&head[..], &stored, records, &[0; 4]].concat();
    let lengths = (records.len() as u64).to_le_bytes();
    let packed_length = (packed.len() as u64).to_le_bytes();
    [&[0; 16][..], &lengths, &[0; 4], &string("lz4"), &packed_length, &packed].concat()
}

/// Reads a file twice, as a replay does.
fn play(file: &[u8]) -> Outcome {
    let reports = Reports::new(FleetId::new("replay-f").unwrap());
    let overview = match overview(file, &reports) {
        Ok(overview) => overview,
        Err(error) => {
            text::check(&error.to_string(), MAX_ERROR);
            return Outcome::Refused;
        }
    };
    if let End::Damaged(why) = &overview.end {
        text::check(why, MAX_ERROR);
    }
    let mut pace = Pace::new(&overview, 2.0);
    let (mut count, mut put) = (0, 0);
    let mut topics = std::collections::BTreeSet::new();
    let end = read(file, |item| {
        let Item::Message(entry) = item else { return ControlFlow::Continue(()) };
        count += 1;
        assert!(entry.topic.starts_with("/robot/"), "{} is no topic of a robot", entry.topic);
        topics.insert(entry.topic.to_owned());
        let Some((robot, report)) = reports.of(&entry) else { return ControlFlow::Continue(()) };
        let (first, last) = overview.span.unwrap();
        assert!((first..=last).contains(&entry.at), "{} is not in {first} to {last}", entry.at);
        for (after, step) in pace.steps(entry.at, robot, report) {
            // Times of centuries in nanoseconds are rounded.
            let latest = (last - first) as f64 / 2e9;
            assert!(
                after.as_secs_f64() <= latest * (1.0 + 1e-9) + 1e-9,
                "{step:?} after {after:?}"
            );
            put += usize::from(matches!(step, Step::Put(..)));
        }
        ControlFlow::Continue(())
    });
    assert_eq!(end.unwrap(), overview.end, "a file ends otherwise when it is read again");
    assert!(topics.len() <= MAX_TOPICS && put <= count);
    Outcome::accepted_if(put > 0)
}

/// Files of the kinds of records, in chunks and without, with what is none of a robot among it.
pub(crate) fn seeds() -> Vec<(String, Vec<u8>)> {
    let part = |opcode: u8, content: &[u8]| {
        [&[opcode][..], &(content.len() as u16).to_le_bytes(), content].concat()
    };
    let channel = |number: u16, topic: &str| {
        let content =
            [&number.to_le_bytes()[..], &[0; 2], &string(topic), &string("json"), &[0; 4]];
        part(CHANNEL, &content.concat())
    };
    let message = |number: u16, at: u64, json: &str| {
        let times = [at.to_le_bytes(), at.to_le_bytes()].concat();
        part(MESSAGE, &[&number.to_le_bytes()[..], &[0; 4], &times, json.as_bytes()].concat())
    };
    let pairs = [string("fleet"), string("alpha")].concat();
    let pairs = [&(pairs.len() as u32).to_le_bytes()[..], &pairs].concat();
    let facts = part(METADATA, &[string("muster"), pairs].concat());
    let records = [
        channel(1, "/robot/r1/pose"),
        channel(2, "/robot/r2/links"),
        channel(3, "/json/teams"),
        message(1, 1_000_000_000, r#"{"x":1.0,"y":2.0}"#),
        message(2, 1_500_000_000, r#"{"links":[{"peer":"r1","quality":0.5}]}"#),
        message(3, 1_600_000_000, "{}"),
        message(1, 9_000_000_000, r#"{"x":3.0,"y":2.0}"#),
    ];
    let records = records.concat();
    let chunked = [facts.clone(), part(CHUNK, &records)].concat();
    let plain = [facts, records].concat();
    vec![
        ("chunk".to_owned(), [&[1], &chunked[..]].concat()),
        ("records".to_owned(), [&[1], &plain[..]].concat()),
        ("file".to_owned(), [&[0], &framed(&chunked, true)[..]].concat()),
    ]
}
