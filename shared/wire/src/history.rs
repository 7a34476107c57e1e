//! What is asked of a history, as the parameters of a get, and what is read of its answers.

use std::fmt::Write as _;

use muster_model::event::EventKind;
use muster_model::history::{HistoryAnswer, Query, RecordingState, Subject};
use muster_model::limits::MAX_HISTORY_ROWS;
use muster_model::time::Tick;

use crate::decode::{self, DecodeError};
use crate::json;
use crate::key::{Key, KeySpace};
use crate::packet::{Packet, Rejection, Source, quoted};

/// Rows of an answer, unless the get asks for another number.
pub const DEFAULT_ROWS: u32 = 1000;

/// Latest moment that may be asked for, in seconds since 1970: the year 2255, up to which microseconds are exact.
const MAX_SECONDS: f64 = 9.0e9;

/// Why the parameters of a get are no question to a history.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct QueryError {
    /// The parameter that is wrong.
    pub field: String,
    /// What is wrong, and what would be right.
    pub problem: String,
}

fn refuse<T>(field: &str, problem: String) -> Result<T, QueryError> {
    Err(QueryError { field: quoted(field), problem })
}

fn moment(field: &str, text: &str) -> Result<Tick, QueryError> {
    let seconds = text.parse::<f64>().ok().filter(|value| (0.0..=MAX_SECONDS).contains(value));
    match seconds {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked to be positive and far below the largest number"
        )]
        Some(seconds) => Ok(Tick((seconds * 1e6).round() as u64)),
        None => refuse(
            field,
            format!("{:?} must be seconds since 1970, such as 1795208990.5", quoted(text)),
        ),
    }
}

fn id<T: std::str::FromStr<Err = muster_model::id::IdError>>(
    field: &str,
    text: &str,
) -> Result<T, QueryError> {
    text.parse().or_else(|error| refuse(field, format!("{error}")))
}

fn number<T: std::str::FromStr>(field: &str, text: &str, range: &str) -> Result<T, QueryError> {
    let problem = || format!("{:?} must be a whole number{range}", quoted(text));
    text.parse().or_else(|_| refuse(field, problem()))
}

/// Reads the parameters of a get of a history.
///
/// # Errors
/// Names the parameter that is unknown, wrong, or does not fit the others.
pub fn query(parameters: &str) -> Result<Query, QueryError> {
    let (mut of, mut as_of, mut robot, mut team, mut event) = (None, None, None, None, None);
    let mut query = Query { limit: DEFAULT_ROWS, ..Query::of(Subject::Divisions) };
    for parameter in parameters.split([';', '&']).filter(|parameter| !parameter.is_empty()) {
        let (name, text) = parameter.split_once('=').unwrap_or((parameter, ""));
        match name {
            "of" => of = Some(text),
            "as_of" => as_of = Some(moment(name, text)?),
            "robot" => robot = Some(id(name, text)?),
            "team" => team = Some(id(name, text)?),
            "event" => event = Some(quoted(text)),
            "since" => query.since = Some(moment(name, text)?),
            "until" => query.until = Some(moment(name, text)?),
            "before" => query.before = Some(number(name, text, "")?),
            "limit" => {
                let range = format!(" from 1 to {MAX_HISTORY_ROWS}");
                query.limit = number(name, text, &range)?;
                if !(1..=MAX_HISTORY_ROWS).contains(&query.limit) {
                    return refuse(name, format!("must be a whole number{range}"));
                }
            }
            // What every get may have.
            "format" => {}
            _ => {
                let known = "of, as_of, robot, team, event, since, until, before, limit";
                return refuse(name, format!("is no parameter; there are {known}"));
            }
        }
    }
    query.subject = match (of, as_of, robot, team, event) {
        (None, Some(moment), None, None, None) => Subject::AsOf(moment),
        (None, None, Some(robot), None, None) => Subject::Robot(robot),
        (None, None, None, Some(team), None) => Subject::Team(team),
        (None | Some("divisions"), None, None, None, None) => Subject::Divisions,
        (Some("events"), None, None, None, event) => Subject::Events(event),
        (Some("robots"), None, robot, None, None) => Subject::Robots(robot),
        (Some(other), ..) if !["divisions", "events", "robots"].contains(&other) => {
            return refuse(
                "of",
                format!("{:?} must be divisions, events or robots", quoted(other)),
            );
        }
        _ => {
            let problem = "ask for one of as_of, robot, team, of=divisions, of=events (with event) and \
                           of=robots (with robot)";
            return refuse("(parameters)", problem.to_owned());
        }
    };
    if query.since.is_some_and(|since| query.until.is_some_and(|until| until < since)) {
        return refuse("until", "must not be before since".to_owned());
    }
    Ok(query)
}

/// The parameters that ask a question.
#[must_use]
pub fn parameters(query: &Query) -> String {
    let mut text = match &query.subject {
        Subject::AsOf(moment) => format!("as_of={:.6}", moment.as_seconds()),
        Subject::Divisions => "of=divisions".to_owned(),
        Subject::Robot(robot) => format!("robot={robot}"),
        Subject::Team(team) => format!("team={team}"),
        Subject::Events(None) => "of=events".to_owned(),
        Subject::Events(Some(kind)) => format!("of=events;event={kind}"),
        Subject::Robots(None) => "of=robots".to_owned(),
        Subject::Robots(Some(robot)) => format!("of=robots;robot={robot}"),
    };
    // Writing to a string does not fail.
    for (name, moment) in [("since", query.since), ("until", query.until)] {
        if let Some(moment) = moment {
            let _ = write!(text, ";{name}={:.6}", moment.as_seconds());
        }
    }
    if let Some(before) = query.before {
        let _ = write!(text, ";before={before}");
    }
    let _ = write!(text, ";limit={}", query.limit);
    text
}

/// An event as a history keeps it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EventText {
    /// Its kind, as `event` of `json/event`.
    pub kind: String,
    /// The fields of its kind, as a JSON object.
    pub detail: String,
}

/// The kind of an event, and its fields as `json/event` has them.
#[must_use]
pub fn event_text(kind: &EventKind) -> EventText {
    let mut fields = json::event_fields(kind);
    let kind = match fields.remove("event") {
        Some(serde_json::Value::String(kind)) => kind,
        _ => String::new(),
    };
    EventText { kind, detail: serde_json::Value::Object(fields).to_string() }
}

fn payload<'a>(
    space: &KeySpace,
    packet: &'a Packet,
    is_meant: fn(&Key) -> bool,
) -> Result<&'a [u8], DecodeError> {
    let key = space.parse(&packet.key)?;
    if !is_meant(&key) {
        return Err(DecodeError::NotRead);
    }
    if packet.source != Source::Put {
        return Err(DecodeError::Deleted);
    }
    decode::payload(packet, &key)
}

fn rejection(space: &KeySpace, packet: &Packet, error: &DecodeError) -> Rejection {
    Rejection::new(space, &packet.key, error.to_string())
}

/// Reads an answer of a history.
///
/// # Errors
/// A [`Rejection`] if the key is another one, or the content is no answer.
pub fn answer(space: &KeySpace, packet: &Packet) -> Result<HistoryAnswer, Rejection> {
    let read = || -> Result<HistoryAnswer, DecodeError> {
        let bytes = payload(space, packet, |key| matches!(key, Key::History(_)))?;
        Ok(serde_json::from_slice(bytes)?)
    };
    read().map_err(|error| rejection(space, packet, &error))
}

/// Reads how far a recording goes.
///
/// # Errors
/// A [`Rejection`] if the key is another one, or the content is not of this form.
pub fn state(space: &KeySpace, packet: &Packet) -> Result<RecordingState, Rejection> {
    let read = || -> Result<RecordingState, DecodeError> {
        let bytes = payload(space, packet, |key| matches!(key, Key::HistoryState(_)))?;
        Ok(serde_json::from_slice(bytes)?)
    };
    read().map_err(|error| rejection(space, packet, &error))
}

#[cfg(test)]
mod tests {
    use muster_model::id::{RobotId, TeamId};

    use super::*;

    #[test]
    fn a_question_is_read_back_from_its_parameters() {
        let robot = RobotId::new("r1").unwrap();
        for subject in [
            Subject::AsOf(Tick(1_795_208_990_123_456)),
            Subject::Divisions,
            Subject::Robot(robot.clone()),
            Subject::Team(TeamId::new("t2").unwrap()),
            Subject::Events(None),
            Subject::Events(Some("robot_left".to_owned())),
            Subject::Robots(None),
            Subject::Robots(Some(robot)),
        ] {
            let whole = Query {
                since: Some(Tick(1_795_208_990_000_001)),
                until: Some(Tick(1_795_208_990_999_999)),
                before: Some(17),
                limit: 5,
                ..Query::of(subject.clone())
            };
            for asked in [whole, Query::of(subject)] {
                assert_eq!(query(&parameters(&asked)), Ok(asked));
            }
        }
        assert_eq!(query("").unwrap().limit, DEFAULT_ROWS);
    }

    #[test]
    fn a_wrong_parameter_is_named_with_the_remedy() {
        for (wrong, field, remedy) in [
            ("as_of=yesterday", "as_of", "seconds since 1970"),
            ("as_of=-1", "as_of", "seconds since 1970"),
            ("since=1e99", "since", "seconds since 1970"),
            ("since=nan", "since", "seconds since 1970"),
            ("since=5;until=4", "until", "since"),
            ("robot=R 1", "robot", "a-z"),
            ("team=", "team", "at least one"),
            ("of=poses", "of", "events"),
            ("of=events;team=t1", "(parameters)", "of=events"),
            ("as_of=1;robot=r1", "(parameters)", "one of"),
            ("before=x", "before", "whole number"),
            ("limit=0", "limit", "10000"),
            ("limit=10001", "limit", "10000"),
            ("sinze=5", "sinze", "since"),
        ] {
            let error = query(wrong).unwrap_err();
            assert_eq!(error.field, field, "{wrong}");
            assert!(error.problem.contains(remedy), "{wrong}: {error}");
        }
    }

    #[test]
    fn an_event_is_kept_as_it_stands_in_json() {
        let kind = EventKind::RobotLeft { robot: RobotId::new("r1").unwrap() };
        let text = event_text(&kind);
        assert_eq!((text.kind.as_str(), text.detail.as_str()), ("robot_left", r#"{"robot":"r1"}"#));
    }
}
