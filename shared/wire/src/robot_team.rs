//! The team of a robot, as robots read it: in JSON as it is published, or in binary form.

use muster_model::content::Content;
use muster_model::id::{RobotId, TeamId};
use muster_model::teams::RobotTeam;
use muster_model::time::Tick;
use serde::Deserialize;

use crate::decode::{self, DecodeError};
use crate::envelope;
use crate::key::{Key, KeySpace};
use crate::packet::{Format, Packet, Rejection, Source};

/// The JSON form after its head. Unknown fields are ignored, so that a robot can read newer services.
#[derive(Deserialize)]
struct Form {
    robot: RobotId,
    team: Option<TeamId>,
    members: Option<Vec<RobotId>>,
    leader: Option<RobotId>,
    confidence: f64,
}

/// Reads and checks the team of a robot. The age of the data in JSON counts back from
/// `now`, the moment of arrival.
///
/// # Errors
/// A [`Rejection`] if the key is no robot's team or of another fleet, the content does not decode or
/// contradicts itself, or names another fleet or robot than the key.
pub fn decode(space: &KeySpace, packet: &Packet, now: Tick) -> Result<RobotTeam, Rejection> {
    read(space, packet, now).map_err(|error| Rejection::new(space, &packet.key, error.to_string()))
}

fn read(space: &KeySpace, packet: &Packet, now: Tick) -> Result<RobotTeam, DecodeError> {
    let key = space.parse(&packet.key)?;
    let bytes = decode::payload(packet, &key)?;
    let Key::RobotTeam(robot) = key else { return Err(DecodeError::NotRead) };
    if packet.source != Source::Put {
        return Err(DecodeError::Deleted);
    }
    let team = match decode::format(packet)? {
        Format::Json => from_json(bytes, now)?,
        Format::Binary => envelope::decode(bytes)?,
    };
    if team.robot != robot {
        return Err(DecodeError::TeamRobot { key: robot, message: team.robot });
    }
    decode::check_header(space, &team.header)?;
    team.check()?;
    Ok(team)
}

fn from_json(bytes: &[u8], now: Tick) -> Result<RobotTeam, DecodeError> {
    let form: Form = serde_json::from_slice(bytes)?;
    Ok(RobotTeam {
        header: decode::header_from_json(bytes, now)?,
        robot: form.robot,
        team: form.team,
        members: form.members,
        leader: form.leader,
        confidence: form.confidence,
    })
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision, StageTime};
    use muster_model::id::{FleetId, ServiceName};

    use super::*;
    use crate::message::Message;
    use crate::packet::JSON;
    use serde_json::{Value, json};

    fn space() -> KeySpace {
        KeySpace::new(FleetId::new("alpha").unwrap())
    }

    fn sample() -> RobotTeam {
        let robot = RobotId::new("r1").unwrap();
        RobotTeam {
            header: Header {
                fleet: FleetId::new("alpha").unwrap(),
                revision: Revision { term: 3, epoch: 44 },
                oldest: Some(Tick(9_000_000)),
                newest: None,
                stages: vec![StageTime {
                    stage: ServiceName::Ingest,
                    received: Tick(9_500_000),
                    published: Tick(9_600_000),
                }],
            },
            robot: robot.clone(),
            team: Some(TeamId::numbered(1)),
            members: Some(vec![robot.clone(), RobotId::new("r2").unwrap()]),
            leader: Some(robot),
            confidence: 0.75,
        }
    }

    fn packet(format: Format) -> Packet {
        let key = Key::RobotTeam(RobotId::new("r1").unwrap());
        let team = Message::RobotTeam(sample());
        let outbound = team.encode(key.clone(), format, Tick(10_000_000)).unwrap();
        outbound.into_packet(&space())
    }

    #[test]
    fn a_robot_reads_what_services_write_in_both_forms() {
        for format in [Format::Json, Format::Binary] {
            let team = decode(&space(), &packet(format), Tick(10_000_000)).unwrap();
            assert_eq!(team, sample(), "{format:?}");
        }
    }

    #[test]
    fn the_age_of_the_data_counts_from_the_arrival_whatever_the_clocks_say() {
        let team = decode(&space(), &packet(Format::Json), Tick(90_000_000)).unwrap();
        assert_eq!(team.header.data_age_s(Tick(90_500_000)), Some(1.5));
    }

    fn with(change: impl Fn(&mut Value)) -> Result<RobotTeam, String> {
        let mut value: Value =
            serde_json::from_slice(packet(Format::Json).payload.as_ref().unwrap()).unwrap();
        change(&mut value);
        let payload = Ok(value.to_string().into_bytes());
        let packet = Packet { payload, encoding: JSON.to_owned(), ..packet(Format::Json) };
        decode(&space(), &packet, Tick(10_000_000)).map_err(|refused| refused.reason)
    }

    #[test]
    fn an_unknown_field_is_ignored_and_a_wrong_one_is_refused_by_name() {
        assert!(with(|value| value["new"] = json!(1)).is_ok());
        let wrong: [(&str, Value, &str); 9] = [
            ("fleet", json!("beta"), "fleet"),
            ("robot", json!("r2"), "robot"),
            ("team", json!(null), "leader"),
            ("leader", json!(null), "leader"),
            ("members", json!(["r2"]), "members"),
            ("members", json!(["r2", "r1"]), "members"),
            ("confidence", json!(1.5), "confidence"),
            ("term", json!(u64::MAX), "term"),
            ("team", json!("T 1"), "JSON"),
        ];
        for (field, value, named) in wrong {
            let reason = with(|whole| whole[field] = value.clone()).unwrap_err();
            assert!(reason.contains(named), "{field} {value}: {reason}");
        }
    }

    #[test]
    fn other_keys_deletions_and_floods_are_refused() {
        let good = packet(Format::Json);
        let now = Tick(10_000_000);
        let pose = Packet { key: "muster/v1/alpha/robot/r1/pose".to_owned(), ..good.clone() };
        let deleted = Packet { source: Source::Delete, ..good.clone() };
        let flood = Packet { payload: Ok(vec![b' '; 1 << 20]), ..good.clone() };
        let cut = Packet { payload: Err(1 << 30), ..good };
        for packet in [pose, deleted, flood, cut] {
            assert!(decode(&space(), &packet, now).is_err());
        }
    }
}
