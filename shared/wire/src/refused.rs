//! Why messages of a robot are refused, as the robot reads it in JSON.

use muster_model::id::RobotId;
use muster_model::refused::Refused;
use muster_model::time::Tick;
use serde::Deserialize;

use crate::decode::{self, DecodeError};
use crate::key::{Key, KeySpace};
use crate::packet::{Format, Packet, Rejection, Source, plain_reason, quoted};

/// The JSON form after its head. Unknown fields are ignored, so that a robot can read newer services.
#[derive(Deserialize)]
struct Form {
    robot: RobotId,
    key: String,
    reason: String,
    count: u64,
}

/// Reads and checks what a robot learns of its refused messages. `now` is the moment of arrival. Texts
/// have no control characters and are cut short, whoever has put them.
///
/// # Errors
/// A [`Rejection`] if the key is another one or of another fleet, the content does not decode, or names
/// another fleet or robot than the key.
pub fn decode(space: &KeySpace, packet: &Packet, now: Tick) -> Result<Refused, Rejection> {
    read(space, packet, now).map_err(|error| Rejection::new(space, &packet.key, error.to_string()))
}

fn read(space: &KeySpace, packet: &Packet, now: Tick) -> Result<Refused, DecodeError> {
    let key = space.parse(&packet.key)?;
    let bytes = decode::payload(packet, &key)?;
    let Key::RobotRefused(robot) = key else { return Err(DecodeError::NotRead) };
    if packet.source != Source::Put {
        return Err(DecodeError::Deleted);
    }
    if decode::format(packet)? == Format::Binary {
        return Err(DecodeError::NotJson);
    }
    let form: Form = serde_json::from_slice(bytes)?;
    if form.robot != robot {
        return Err(DecodeError::TeamRobot { key: robot, message: form.robot });
    }
    let header = decode::header_from_json(bytes, now)?;
    decode::check_header(space, &header)?;
    Ok(Refused {
        header,
        robot,
        key: quoted(&form.key),
        reason: plain_reason(&form.reason),
        count: form.count,
    })
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision, StageTime};
    use muster_model::id::{FleetId, ServiceName};

    use super::*;
    use crate::message::Message;
    use crate::packet::MAX_REASON;

    const NOW: Tick = Tick(10_000_000);

    fn space() -> KeySpace {
        KeySpace::new(FleetId::new("alpha").unwrap())
    }

    fn sample(fleet: &str, robot: &str) -> Refused {
        let stage = StageTime { stage: ServiceName::Ingest, received: NOW, published: NOW };
        Refused {
            header: Header {
                fleet: FleetId::new(fleet).unwrap(),
                revision: Revision { term: 3, epoch: 44 },
                oldest: None,
                newest: None,
                stages: vec![stage],
            },
            robot: RobotId::new(robot).unwrap(),
            key: format!("muster/v1/alpha/robot/{robot}/pose"),
            reason: "x: must be finite".to_owned(),
            count: 2,
        }
    }

    fn packet(refused: Refused) -> Packet {
        let key = Key::RobotRefused(RobotId::new("r1").unwrap());
        let message = Message::Refused(Box::new(refused));
        message.encode(key, Format::Json, NOW).unwrap().into_packet(&space())
    }

    #[test]
    fn a_robot_reads_what_ingest_writes() {
        let refused = sample("alpha", "r1");
        assert_eq!(decode(&space(), &packet(refused.clone()), NOW), Ok(refused));
    }

    #[test]
    fn what_is_of_another_robot_or_fleet_or_no_json_is_refused() {
        let reason = |packet: &Packet| decode(&space(), packet, NOW).unwrap_err().reason;
        assert!(reason(&packet(sample("alpha", "r2"))).contains("r2"));
        assert!(reason(&packet(sample("beta", "r1"))).contains("beta"));
        let right = packet(sample("alpha", "r1"));
        let elsewhere = Packet { key: "muster/v1/alpha/robot/r1/team".to_owned(), ..right.clone() };
        assert!(!reason(&elsewhere).is_empty());
        assert!(!reason(&Packet { payload: Ok(b"[]".to_vec()), ..right.clone() }).is_empty());
        assert!(!reason(&Packet { source: Source::Delete, ..right.clone() }).is_empty());
        let binary = Packet { encoding: "application/octet-stream".to_owned(), ..right };
        assert!(reason(&binary).contains("JSON"));
    }

    #[test]
    fn texts_are_fit_for_a_terminal() {
        let reason = format!("\u{1b}[2J{}", "x".repeat(10_000));
        let read = decode(&space(), &packet(Refused { reason, ..sample("alpha", "r1") }), NOW);
        let reason = read.unwrap().reason;
        assert!(reason.starts_with('\u{FFFD}') && reason.chars().count() == MAX_REASON, "{reason}");
    }
}
