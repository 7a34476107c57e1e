//! What a robot is told of its team, as robots read it: in JSON, as it is put, or binary, on request.

use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, RobotId, ServiceName, TeamId};
use muster_model::limits::{MAX_MEMBERS_TOLD, MAX_REVISION};
use muster_model::teams::RobotTeam;
use muster_model::time::{Tick, seconds};
use serde::Deserialize;

use crate::envelope;
use crate::key::{Key, KeySpace};
use crate::packet::{Packet, Rejection, Source, format_of};
use crate::request::Format;

/// The JSON form. Fields that are not known are passed over, so that a robot understands services
/// that are newer than itself.
#[derive(Deserialize)]
struct Form {
    fleet: FleetId,
    term: u64,
    epoch: u64,
    data_age_s: Option<f64>,
    stages: Vec<Stage>,
    robot: RobotId,
    team: Option<TeamId>,
    members: Option<Vec<RobotId>>,
    leader: Option<RobotId>,
    confidence: f64,
}

#[derive(Deserialize)]
struct Stage {
    stage: ServiceName,
    received: f64,
    published: f64,
}

/// Understands what a robot is told of its team. The age of the data that JSON names counts from
/// `now`, the moment of arrival.
///
/// # Errors
/// A [`Rejection`] if the key is no robot's team or of another fleet, the content does not decode or
/// contradicts itself, or it speaks of another fleet or robot than the key.
pub fn decode(space: &KeySpace, packet: &Packet, now: Tick) -> Result<RobotTeam, Rejection> {
    understand(space, packet, now).map_err(|reason| Rejection::new(space, &packet.key, reason))
}

fn understand(space: &KeySpace, packet: &Packet, now: Tick) -> Result<RobotTeam, String> {
    let key = space.parse(&packet.key).map_err(|error| error.to_string())?;
    let limit = key.payload_limit();
    let Key::RobotTeam(robot) = key else {
        return Err("no robot is told its team on this key".to_owned());
    };
    if packet.source != Source::Put {
        return Err("nothing is deleted on this key".to_owned());
    }
    let bytes = match &packet.payload {
        Ok(bytes) if bytes.len() <= limit => bytes,
        Ok(bytes) => return Err(format!("{} bytes are more than {limit}", bytes.len())),
        Err(size) => return Err(format!("{size} bytes are more than {limit}")),
    };
    let told = match format_of(&packet.encoding) {
        Some(Format::Json) => from_json(bytes, now)?,
        Some(Format::Binary) => envelope::decode(bytes).map_err(|error| error.to_string())?,
        None => return Err("the encoding is unknown".to_owned()),
    };
    if told.robot != robot {
        return Err(format!("robot: the key speaks to {robot}, the message to {}", told.robot));
    }
    if told.header.fleet != *space.fleet() {
        let (ours, theirs) = (space.fleet(), &told.header.fleet);
        return Err(format!("fleet: the key speaks for {ours}, the message for {theirs}"));
    }
    check(&told)?;
    Ok(told)
}

fn from_json(bytes: &[u8], now: Tick) -> Result<RobotTeam, String> {
    let form: Form = serde_json::from_slice(bytes)
        .map_err(|error| format!("this is not the JSON it should be: {error}"))?;
    let moment = |at: f64| Tick(0).after(seconds(at));
    let oldest = form.data_age_s.map(|age| Tick(now.0.saturating_sub(moment(age).0)));
    let stages = form.stages.into_iter().map(|stage| StageTime {
        stage: stage.stage,
        received: moment(stage.received),
        published: moment(stage.published),
    });
    Ok(RobotTeam {
        header: Header {
            fleet: form.fleet,
            revision: Revision { term: form.term, epoch: form.epoch },
            oldest,
            newest: None,
            stages: stages.collect(),
        },
        robot: form.robot,
        team: form.team,
        members: form.members,
        leader: form.leader,
        confidence: form.confidence,
    })
}

fn check(told: &RobotTeam) -> Result<(), String> {
    let revision = told.header.revision;
    if revision.term.max(revision.epoch) >= MAX_REVISION {
        return Err(format!("term and epoch must be below {MAX_REVISION}"));
    }
    if !(0.0..=1.0).contains(&told.confidence) {
        return Err("confidence: must be a number from 0 to 1".to_owned());
    }
    if told.team.is_some() != told.leader.is_some() {
        return Err("leader: a team has one, and no team has none".to_owned());
    }
    let Some(members) = &told.members else { return Ok(()) };
    if members.len() > MAX_MEMBERS_TOLD {
        return Err(format!("members: may be at most {MAX_MEMBERS_TOLD}"));
    }
    if !members.is_sorted_by(|left, right| left < right) {
        return Err("members: must be ordered by name, each once".to_owned());
    }
    if told.team.is_some() != members.contains(&told.robot) {
        return Err("members: must hold the robot itself if it has a team".to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
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
        let told = Message::RobotTeam(sample());
        let outbound = told.encode(key.clone(), format, Tick(10_000_000)).unwrap();
        outbound.into_packet(&space())
    }

    #[test]
    fn a_robot_reads_what_services_write_in_both_forms() {
        for format in [Format::Json, Format::Binary] {
            let told = decode(&space(), &packet(format), Tick(10_000_000)).unwrap();
            assert_eq!(told, sample(), "{format:?}");
        }
    }

    #[test]
    fn the_age_of_the_data_counts_from_the_arrival_whatever_the_clocks_say() {
        let told = decode(&space(), &packet(Format::Json), Tick(90_000_000)).unwrap();
        assert_eq!(told.header.data_age_s(Tick(90_500_000)), Some(1.5));
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
    fn a_newer_field_is_passed_over_and_nonsense_is_refused_by_name() {
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
