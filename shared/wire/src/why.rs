//! Why a robot is in its team: what a get of `why?robot=` asks, and the JSON reply as consoles read it.

use muster_model::content::Content;
use muster_model::id::RobotId;
use muster_model::time::Tick;
use muster_model::why::{Reason, Why};

use crate::decode::{self, DecodeError};
use crate::key::{Key, KeySpace};
use crate::packet::{Packet, Rejection, quoted};

/// Why the parameters of a get are no question for a reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct QuestionError {
    /// The parameter that is wrong.
    pub field: String,
    /// What is wrong, and what would be right.
    pub problem: String,
}

fn refuse<T>(field: &str, problem: String) -> Result<T, QuestionError> {
    Err(QuestionError { field: quoted(field), problem })
}

/// The robot that the parameters of a get of `why` ask about.
///
/// # Errors
/// Names the parameter that is missing, unknown, wrong or there twice.
pub fn robot(parameters: &str) -> Result<RobotId, QuestionError> {
    let mut robot: Option<RobotId> = None;
    for parameter in parameters.split([';', '&']).filter(|parameter| !parameter.is_empty()) {
        let (name, text) = parameter.split_once('=').unwrap_or((parameter, ""));
        match name {
            "robot" if robot.is_some() => {
                return refuse(name, "must name one robot, as in why?robot=r7".to_owned());
            }
            "robot" => match text.parse() {
                Ok(named) => robot = Some(named),
                Err(error) => return refuse(name, format!("{error}")),
            },
            // What every get may have.
            "format" => {}
            _ => return refuse(name, "is unknown; a reason takes robot".to_owned()),
        }
    }
    robot.map_or_else(|| refuse("robot", "must name a robot, as in why?robot=r7".to_owned()), Ok)
}

/// Decodes the reply to a get of `why?robot=`. The age of the data that JSON names counts from `now`, the moment of
/// arrival. Unknown fields are ignored, so that a console reads what newer services send.
///
/// # Errors
/// A [`Rejection`] if the key is not `why` of this fleet, the content is not of this form, or contradicts itself.
pub fn decode(space: &KeySpace, packet: &Packet, now: Tick) -> Result<Why, Rejection> {
    read(space, packet, now).map_err(|error| Rejection::new(space, &packet.key, error.to_string()))
}

fn read(space: &KeySpace, packet: &Packet, now: Tick) -> Result<Why, DecodeError> {
    let key = space.parse(&packet.key)?;
    let bytes = decode::payload(packet, &key)?;
    if key != Key::Why {
        return Err(DecodeError::NotRead);
    }
    let reason: Reason = serde_json::from_slice(bytes)?;
    let why = Why { header: decode::header_from_json(bytes, now)?, reason };
    decode::check_header(space, &why.header)?;
    why.check()?;
    Ok(why)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_names_one_robot() {
        assert_eq!(robot("robot=r7").unwrap().as_str(), "r7");
        assert_eq!(robot("format=json;robot=r7&").unwrap().as_str(), "r7");
        for (parameters, start) in [
            ("", "robot: must name"),
            ("format=json", "robot: must name"),
            ("robot=", "robot: "),
            ("robot=R 7", "robot: "),
            ("robot=r1;robot=r2", "robot: must name one"),
            ("robots=r7", "robots: is unknown"),
            ("\u{0}=\u{1b}", ""),
        ] {
            let error = robot(parameters).unwrap_err().to_string();
            assert!(error.starts_with(start), "{parameters:?}: {error}");
            assert!(!error.chars().any(char::is_control), "{error}");
        }
    }
}
