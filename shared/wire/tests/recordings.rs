//! Recordings: nothing is lost in them, and no damage does harm.

use crate::samples;
use muster_model::id::{InstanceId, ServiceName};
use muster_wire::recording::{MAGIC, Reader, RecordingError, VERSION, begin, frame};
use muster_wire::{Format, KeySpace, Message, Packet, Source};
use proptest::prelude::*;

fn space() -> KeySpace {
    KeySpace::new(samples::fleet())
}

/// A message as it is read from a recording of the packet that brought it.
fn again(message: &Message) -> Result<Message, String> {
    let packet = message.to_packet(&space());
    let bytes = [begin(&"head").unwrap(), frame(&packet).unwrap()].concat();
    let (mut reader, _): (_, String) = Reader::open(bytes.as_slice()).unwrap();
    let read: Packet = reader.next_entry().unwrap().unwrap();
    assert_eq!(read, packet);
    assert!(reader.next_entry::<Packet>().unwrap().is_none());
    Message::decode(&space(), &read).map_err(|refused| refused.reason)
}

/// Every kind that a service can receive comes back as it was.
#[test]
fn every_message_that_is_received_comes_back_from_a_recording() {
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
            assert!(
                again(&message).is_err(),
                "no service receives what robots read or gets are answered with"
            );
        } else {
            assert_eq!(again(&message).as_ref(), Ok(&message), "{name}");
        }
    }
    for alive in [true, false] {
        let token = Message::RobotToken { robot: samples::robot("r1"), alive };
        assert_eq!(again(&token).as_ref(), Ok(&token));
        let instance = InstanceId::new("host-1").unwrap();
        let token = Message::ServiceToken { service: ServiceName::Auditor, instance, alive };
        assert_eq!(again(&token).as_ref(), Ok(&token));
    }
    let teams = samples::all().into_iter().find_map(|(_, message)| match message {
        Message::Teams { teams, .. } => Some(teams),
        _ => None,
    });
    // Whether there is a mirror is for the publisher alone: it is no part of what is received.
    let teams = teams.unwrap();
    let mirrored = Message::Teams { teams: teams.clone(), mirror: true };
    assert_eq!(again(&mirrored), Ok(Message::Teams { teams, mirror: false }));
}

/// A packet is recorded as it came, whatever it is.
#[test]
fn every_packet_comes_back_from_a_recording() {
    let packet = Packet::put("any key".to_owned(), "any encoding".to_owned(), vec![0, 1, 255]);
    for source in [Source::Put, Source::Delete, Source::TokenAlive, Source::TokenGone] {
        for payload in [Ok(Vec::new()), Ok(vec![7; 100]), Err(2 << 20)] {
            let packet = Packet { source, payload, ..packet.clone() };
            let bytes = [begin(&"head").unwrap(), frame(&packet).unwrap()].concat();
            let (mut reader, _): (_, String) = Reader::open(bytes.as_slice()).unwrap();
            assert_eq!(reader.next_entry().unwrap(), Some(packet));
        }
    }
}

/// What robots report in JSON is published and replayed in binary: whatever is accepted in JSON must
/// fit, and keep every bit.
fn through_json(tail: &str, payload: &str) -> Option<Message> {
    let key = format!("muster/v1/alpha/robot/r1/{tail}");
    let packet = Packet::put(key, "application/json".to_owned(), payload.as_bytes().to_vec());
    Message::decode(&space(), &packet).ok()
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_robots_report_in_json_comes_back_bit_for_bit(
        (x, y, stamp) in (-1e7..1e7_f64, any::<f64>(), any::<f64>()),
        qualities in prop::collection::vec(-120.0..1.0_f64, 0..40),
        seq in any::<u64>(),
    ) {
        let finite = |value: f64| if value.is_finite() { value } else { 0.5 };
        let (y, stamp) = (finite(y) % 1e7, finite(stamp).abs() % 1e12);
        let pose = format!("{{\"x\":{x},\"y\":{y:e},\"stamp\":{stamp:e},\"seq\":{seq}}}");
        let links: Vec<_> = qualities.iter().enumerate()
            .map(|(peer, quality)| format!("{{\"peer\":\"p{peer}\",\"quality\":{quality}}}"))
            .collect();
        let links = format!("{{\"links\":[{}]}}", links.join(","));
        for (tail, payload) in [("pose", pose), ("links", links)] {
            let message = through_json(tail, &payload);
            prop_assert!(message.is_some() || tail == "links", "{}", payload);
            if let Some(message) = message {
                prop_assert_eq!(again(&message), Ok(message));
            }
        }
    }

    #[test]
    fn no_damage_does_harm(
        cut in any::<prop::sample::Index>(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
    ) {
        let mut bytes = begin(&"head").unwrap();
        for (_, message) in samples::all() {
            bytes.extend(frame(&message.to_packet(&space())).unwrap());
        }
        let whole = bytes.clone();
        bytes.truncate(cut.index(bytes.len() + 1));
        for (at, value) in flips {
            if !bytes.is_empty() {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
        }
        let intact = bytes.iter().zip(&whole).take_while(|(a, b)| a == b).count();
        let Ok((mut reader, _)) = Reader::open::<String>(bytes.as_slice()) else { return Ok(()) };
        loop {
            let before = reader.offset();
            match reader.next_entry::<Packet>() {
                Ok(Some(_)) => prop_assert!(reader.offset() as usize <= intact, "damage is seen"),
                Ok(None) => break,
                Err(error) => {
                    prop_assert!(reader.offset() as usize > intact.min(before as usize));
                    prop_assert!(!error.to_string().is_empty());
                    break;
                }
            }
        }
    }

    #[test]
    fn random_bytes_are_no_recording(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(Reader::open::<String>(bytes.as_slice()).is_err());
        let with_magic = [MAGIC.as_slice(), &[VERSION], &bytes].concat();
        if let Ok((mut reader, _)) = Reader::open::<String>(with_magic.as_slice()) {
            let _ = reader.next_entry::<Vec<Packet>>();
        }
    }
}

#[test]
fn what_is_wrong_with_a_file_is_reported() {
    let open = |bytes: &[u8]| Reader::open::<String>(bytes).map(|_| ()).unwrap_err();
    assert!(matches!(open(b""), RecordingError::NotARecording));
    assert!(matches!(open(b"{\"robots\": []}"), RecordingError::NotARecording));
    let good = begin(&"head").unwrap();
    let mut other = good.clone();
    other[MAGIC.len()] = 9;
    assert!(open(&other).to_string().contains("version 9"));
    // Recordings of the first version hold other entries.
    other[MAGIC.len()] = 1;
    assert!(open(&other).to_string().contains("version 1"));
    assert!(matches!(open(&good[..good.len() - 1]), RecordingError::BreaksOff(9)));
    let huge = [good.as_slice(), &u32::MAX.to_le_bytes(), &[0; 4]].concat();
    let (mut reader, _) = Reader::open::<String>(huge.as_slice()).unwrap();
    let error = reader.next_entry::<Packet>().unwrap_err();
    assert!(matches!(error, RecordingError::Damaged { .. }), "{error}");
    // A length that promises what does not come must not be allocated for.
    let promised = [good.as_slice(), &200_000_000_u32.to_le_bytes(), &[0; 9]].concat();
    let (mut reader, _) = Reader::open::<String>(promised.as_slice()).unwrap();
    assert!(matches!(reader.next_entry::<Packet>(), Err(RecordingError::BreaksOff(_))));
}

/// The largest messages of robots that are accepted in JSON fit their binary form as well.
#[test]
fn the_largest_reports_can_be_recorded() {
    let name = |number: usize| format!("{number:0>64}");
    let peers: Vec<_> =
        (0..1024).map(|n| format!("{{\"peer\":\"{}\",\"quality\":1}}", name(n))).collect();
    let links = through_json("links", &format!("{{\"links\":[{}]}}", peers.join(","))).unwrap();
    assert_eq!(again(&links).as_ref(), Ok(&links));
    let edges: Vec<_> = (0..1024).map(|n| format!("[\"r1\",\"{}\",1]", name(n))).collect();
    let edges = format!("{{\"edges\":[{}]}}", edges.join(","));
    let relation = through_json("relation/thermal", &edges).unwrap();
    assert_eq!(again(&relation).as_ref(), Ok(&relation));
    assert!(relation.encode(relation.keys().0, Format::Binary, samples::NOW).is_ok());
}
