//! Packets on any key, in any encoding, from any source.

use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::command::CommandOutcome;
use muster_model::embedding::Embedding;
use muster_model::event::Event;
use muster_model::graph::GraphDelta;
use muster_model::id::{FleetId, Modality};
use muster_model::observation::Stream;
use muster_model::role::LeaseRenewal;
use muster_model::roster::Roster;
use muster_model::teams::{RobotTeam, Teams};
use muster_model::time::Tick;
use muster_model::wish::WishList;
use muster_wire::envelope::{AnnouncedSettings, BinaryMessage, MAGIC, VERSION, decode, encode};
use muster_wire::message::MAX_REASON;
use muster_wire::proposal::ProposalChange;
use muster_wire::report::{decode_unchecked, encode_unchecked};
use muster_wire::{Format, Key, KeySpace, Message, Packet, Rejection, Source};

use crate::{Outcome, allocation, text};

/// The moment at which messages are written.
pub(crate) const NOW: Tick = Tick(1_795_208_990_000_000);

/// The encoding of binary packets.
pub(crate) const BINARY: &str = "application/octet-stream;bincode";

/// Longest key or reason of a refusal, in characters.
const MAX_REFUSAL: usize = 120;

/// Longest text about the parameters of a get: a name that is cut short and a sentence.
const MAX_PROBLEM: usize = 300;

/// Bytes that decoding a packet may hold for each byte of it: the smallest entry of a roster has
/// eleven bytes on the bus and some two hundred in memory, and vectors grow by doubling.
const BYTES_PER_INPUT_BYTE: usize = 64;

/// Bytes that it may hold beyond that: serde trusts the count of a list for one mebibyte, and lists
/// contain lists.
const BASE_BYTES: usize = 4 << 20;

/// Most memory in bytes that an input of a length may take.
pub(crate) const fn may_hold(length: usize) -> usize {
    BYTES_PER_INPUT_BYTE * length + BASE_BYTES
}

/// The keys of all targets.
pub(crate) fn space() -> KeySpace {
    KeySpace::new(FleetId::new("alpha").unwrap())
}

/// Reads a packet within its bounds of memory, and checks the texts of a refusal.
fn read<T>(
    packet: &Packet,
    what: &str,
    decode: impl FnOnce(&Packet) -> Result<T, Rejection>,
) -> Result<T, Rejection> {
    let length = packet.payload.as_ref().map_or(0, Vec::len) + packet.key.len();
    let result = allocation::at_most(may_hold(length), what, || decode(packet));
    if let Err(rejection) = &result {
        text::check(&rejection.key, MAX_REFUSAL);
        text::check(&rejection.reason, MAX_REASON);
    }
    result
}

/// Decodes a packet, and checks what became of it.
pub(crate) fn decoded(space: &KeySpace, packet: &Packet) -> Result<Message, Rejection> {
    let result = read(packet, "decoding a packet", |packet| Message::decode(space, packet));
    if let Ok(message) = &result {
        check_message(space, packet, message);
    }
    result
}

fn check_message(space: &KeySpace, packet: &Packet, message: &Message) {
    let (key, mirror) = message.keys();
    assert_eq!(space.format(&key), packet.key, "a message has another key than it came from");
    let json = message.encode(key.clone(), Format::Json, NOW).unwrap();
    if let Message::RobotToken { .. } = message {
        return;
    }
    if !matches!(message, Message::Settings(_)) {
        let _: serde_json::Value = serde_json::from_slice(&json.payload).unwrap();
    }
    if let Some(mirror) = mirror {
        message.encode(mirror, Format::Json, NOW).unwrap();
    }
    // Numbers that are not finite are equal to nothing, so that bytes are compared.
    let again = message.encode(key, Format::Binary, NOW).unwrap();
    let read = as_packet(space, &again.payload, &again.encoding, &packet.key);
    assert_eq!(written(&read), again.payload, "another message is read back");
    if message.header().is_none() {
        let read = as_packet(space, &json.payload, &json.encoding, &packet.key);
        assert_eq!(read, *message, "another message is read back from JSON");
    }
}

fn as_packet(space: &KeySpace, payload: &[u8], encoding: &str, key: &str) -> Message {
    let packet = Packet::put(key, encoding, payload);
    Message::decode(space, &packet).unwrap()
}

fn written(message: &Message) -> Vec<u8> {
    message.encode(message.keys().0, Format::Binary, NOW).unwrap().payload
}

/// A source in one letter, the key (`~` for the prefix of the fleet), a line feed, the encoding, a
/// line feed, and the payload.
fn foreign(data: &[u8]) -> Option<Packet> {
    let (source, rest) = data.split_first()?;
    let (key, rest) = text::line(rest);
    let (encoding, payload) = text::line(rest);
    let key = String::from_utf8_lossy(key);
    let key = match key.strip_prefix('~') {
        Some(tail) => format!("muster/v1/alpha/{tail}"),
        None => key.into_owned(),
    };
    Some(Packet {
        key,
        encoding: String::from_utf8_lossy(encoding).into_owned(),
        source: match source {
            b'd' => Source::Delete,
            b'a' => Source::TokenAlive,
            b'g' => Source::TokenGone,
            _ => Source::Put,
        },
        payload: if *source == b'c' { Err(payload.len() << 10) } else { Ok(payload.to_vec()) },
        attachment: None,
    })
}

/// A packet as [`foreign`] reads it, for a service.
pub(crate) fn packet(data: &[u8]) -> Outcome {
    let decoded = foreign(data).map(|packet| decoded(&space(), &packet));
    Outcome::accepted_if(decoded.is_some_and(|decoded| decoded.is_ok()))
}

/// A packet as [`foreign`] reads it, for a console that asked for the similarity of a pair.
pub(crate) fn katz(data: &[u8]) -> Outcome {
    let Some(packet) = foreign(data) else { return Outcome::Refused };
    let space = space();
    let decode = |packet: &Packet| muster_wire::katz::decode(&space, packet, NOW);
    let Ok(pair) = read(&packet, "reading a similarity", decode) else { return Outcome::Refused };
    assert_eq!(space.format(&Key::Embedding), packet.key, "a similarity comes from another key");
    let shares = pair.shares.iter().map(|(_, share)| *share);
    for number in shares.chain([pair.similarity, pair.alpha, pair.residual]) {
        assert!(number.is_finite() && number >= 0.0, "{number}");
    }
    let out =
        Message::Katz(Box::new(pair.clone())).encode(Key::Embedding, Format::Json, NOW).unwrap();
    let mut again = decode(&Packet { payload: Ok(out.payload), ..packet }).unwrap();
    // JSON has moments as seconds, rounded.
    assert_eq!(again.header.revision, pair.header.revision);
    again.header = pair.header.clone();
    assert_eq!(again, pair, "another similarity is read back");
    Outcome::Accepted
}

/// A packet as [`foreign`] reads it, for a console that asked why a robot is in its team, and the parameters of such a
/// question.
pub(crate) fn why(data: &[u8]) -> Outcome {
    if let Ok(parameters) = std::str::from_utf8(data)
        && let Err(error) = muster_wire::why::robot(parameters)
    {
        text::check(&error.to_string(), MAX_PROBLEM);
    }
    let Some(packet) = foreign(data) else { return Outcome::Refused };
    let space = space();
    let decode = |packet: &Packet| muster_wire::why::decode(&space, packet, NOW);
    let Ok(why) = read(&packet, "reading a reason", decode) else { return Outcome::Refused };
    assert_eq!(space.format(&Key::Why), packet.key, "a reason comes from another key");
    let out = Message::Why(Box::new(why.clone())).encode(Key::Why, Format::Json, NOW).unwrap();
    let again = decode(&Packet { payload: Ok(out.payload), ..packet }).unwrap();
    assert_eq!(again.reason, why.reason, "another reason is read back");
    // What decided is found for any numbers.
    let decided = why.reason.decided();
    assert!(!decided.text.is_empty());
    Outcome::Accepted
}

/// A packet as [`foreign`] reads it, for an operator who asked what a bridge refuses.
pub(crate) fn bridge(data: &[u8]) -> Outcome {
    let Some(packet) = foreign(data) else { return Outcome::Refused };
    let space = space();
    let decode = |packet: &Packet| muster_wire::bridge::decode(&space, packet);
    let Ok(state) = read(&packet, "reading the state of a bridge", decode) else {
        return Outcome::Refused;
    };
    let key = space.format(&Key::Bridge(state.instance.clone()));
    assert_eq!(key, packet.key, "a state comes from another key");
    for refused in &state.refused {
        text::check(&refused.topic, MAX_PROBLEM);
        text::check(&refused.reason, MAX_REASON);
    }
    let again = decode(&muster_wire::bridge::encode(&space, state.clone())).unwrap();
    assert_eq!((again.instance, again.robots), (state.instance, state.robots));
    assert!(again.refused.len() <= state.refused.len());
    Outcome::Accepted
}

/// A packet as [`foreign`] reads it, for a console that asked what the teams would be, and the payload of such a question.
pub(crate) fn proposal(data: &[u8]) -> Outcome {
    let mut outcome = Outcome::Refused;
    match muster_wire::proposal::decode_request(data) {
        Ok(ProposalChange::Ask(asked)) => {
            let again = serde_json::to_vec(&*asked).unwrap();
            let again = muster_wire::proposal::decode_request(&again);
            assert_eq!(again, Ok(ProposalChange::Ask(asked)), "another request is read back");
            outcome = Outcome::Accepted;
        }
        Ok(ProposalChange::Drop) => {}
        Err(error) => {
            text::check(&error.field, MAX_REFUSAL);
            text::check(&error.problem, MAX_PROBLEM + MAX_REFUSAL);
        }
    }
    let Some(packet) = foreign(data) else { return outcome };
    let space = space();
    let decode = |packet: &Packet| muster_wire::proposal::decode(&space, packet, NOW);
    let Ok(report) = read(&packet, "reading a proposal", decode) else { return outcome };
    let key = Key::Proposal(report.proposal.operator.clone(), report.proposal.id.clone());
    assert_eq!(space.format(&key), packet.key, "a proposal comes from another key");
    let message = Message::Proposal(Box::new(report.clone()));
    let out = message.encode(key, Format::Json, NOW).unwrap();
    let again = decode(&Packet { payload: Ok(out.payload), ..packet }).unwrap();
    assert_eq!(again.proposal, report.proposal, "another proposal is read back");
    Outcome::Accepted
}

/// A packet as [`foreign`] reads it, for a robot that reads its team.
pub(crate) fn robot_team(data: &[u8]) -> Outcome {
    let Some(packet) = foreign(data) else { return Outcome::Refused };
    let space = space();
    let decode = |packet: &Packet| muster_wire::refused::decode(&space, packet, NOW);
    if let Ok(refused) = read(&packet, "reading the refusals of a robot", decode) {
        let key = Key::RobotRefused(refused.robot.clone());
        assert_eq!(space.format(&key), packet.key, "a robot reads the refusals of another key");
        text::check(&refused.key, MAX_REFUSAL);
        text::check(&refused.reason, MAX_REASON);
        return Outcome::Accepted;
    }
    let decode = |packet: &Packet| muster_wire::robot_team::decode(&space, packet, NOW);
    let Ok(team) = read(&packet, "reading the team of a robot", decode) else {
        return Outcome::Refused;
    };
    let key = Key::RobotTeam(team.robot.clone());
    assert_eq!(space.format(&key), packet.key, "a robot reads the team of another key");
    assert!((0.0..=1.0).contains(&team.confidence), "{}", team.confidence);
    let message = Message::RobotTeam(team.clone());
    for format in [Format::Binary, Format::Json] {
        let out = message.encode(key.clone(), format, NOW).unwrap();
        let again = Packet {
            encoding: out.encoding.into_owned(),
            payload: Ok(out.payload),
            ..packet.clone()
        };
        let mut again = decode(&again).unwrap();
        if format == Format::Json {
            // JSON has moments as seconds, rounded, and not when the newest data came.
            assert_eq!(again.header.revision, team.header.revision);
            again.header = team.header.clone();
        }
        assert_eq!(again, team, "a robot reads something else in another form");
    }
    Outcome::Accepted
}

/// Decodes bytes within their bounds of memory, and what is written of the result again.
fn recoded<T, E: std::error::Error>(
    bytes: &[u8],
    what: &str,
    decode: impl Fn(&[u8]) -> Result<T, E>,
    encode: impl Fn(&T) -> Vec<u8>,
) -> Outcome {
    match allocation::at_most(may_hold(bytes.len()), what, || decode(bytes)) {
        Err(error) => {
            assert!(error.to_string().chars().count() <= 1024, "{error}");
            Outcome::Refused
        }
        Ok(content) => {
            let again = encode(&content);
            assert_eq!(encode(&decode(&again).unwrap()), again);
            Outcome::Accepted
        }
    }
}

/// A kind, and a content in bincode.
pub(crate) fn envelope(data: &[u8]) -> Outcome {
    fn of<T: BinaryMessage>(bytes: &[u8]) -> Outcome {
        recoded(bytes, T::KIND.name, decode::<T>, |content| encode(content).unwrap())
    }
    fn of_stream(stream: &Stream, bytes: &[u8]) -> Outcome {
        let decode = |bytes: &[u8]| decode_unchecked(stream, bytes);
        recoded(bytes, stream.name(), decode, |(robot, report)| {
            encode_unchecked(robot, report).unwrap().payload
        })
    }
    let Some((kind, content)) = data.split_first() else { return Outcome::Refused };
    let kind = kind % 19;
    let bytes = [&[MAGIC, VERSION, kind], content].concat();
    match kind {
        1 => of_stream(&Stream::Pose, &bytes),
        2 => of_stream(&Stream::Links, &bytes),
        3 | 17 => of_stream(&Stream::Rank, &bytes),
        4 => of_stream(&Stream::Relation(Modality::spatial()), &bytes),
        5 => of::<GraphDelta>(&bytes),
        6 => of::<Roster>(&bytes),
        7 => of::<Embedding>(&bytes),
        8 => of::<Teams>(&bytes),
        9 => of::<RobotTeam>(&bytes),
        10 => of::<Audit>(&bytes),
        11 => of::<Event>(&bytes),
        12 => of::<AnnouncedSettings>(&bytes),
        13 => of::<LeaseRenewal>(&bytes),
        14 => of::<WishList>(&bytes),
        16 => of::<Alerts>(&bytes),
        18 => of::<CommandOutcome>(&bytes),
        // The head itself is foreign.
        _ => of::<Event>(content),
    }
}

/// A stream in one byte, and what a robot puts there in JSON.
pub(crate) fn edge_json(data: &[u8]) -> Outcome {
    let Some((stream, json)) = data.split_first() else { return Outcome::Refused };
    let key = match stream % 4 {
        0 => "robot/r1/pose",
        1 => "robot/r1/links",
        2 => "robot/r2/rank",
        _ => "robot/r1/relation/thermal",
    };
    let packet = Packet::put(format!("muster/v1/alpha/{key}"), "", json);
    Outcome::accepted_if(decoded(&space(), &packet).is_ok())
}
