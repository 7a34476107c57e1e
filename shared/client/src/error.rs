//! What can go wrong, each with its remedy.

use muster_bus::OpenError;
use muster_model::id::{FleetId, IdError, RobotId, ServiceName};
use muster_model::observation::ObservationError;
use muster_wire::json::ProblemCode;
use muster_wire::message::plain_reason;
use serde_json::Value;

use crate::propose::AppliedPart;

/// Why the client refuses or fails.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value of the caller is wrong. Nothing was sent.
    #[error("{field}: {problem}")]
    Input {
        /// The field, as it stands in JSON or in `Config`.
        field: &'static str,
        /// What is wrong and what would be right.
        problem: String,
    },
    /// The caller runs on no multi-threaded tokio runtime.
    #[error(
        "the bus needs tokio's multi-threaded runtime: use #[tokio::main] without a flavor, \
         #[tokio::test(flavor = \"multi_thread\")], or runtime::Builder::new_multi_thread()"
    )]
    Runtime,
    /// No router answered within `Config::connect_timeout`.
    #[error(
        "no router answers at {}; start one with `muster router`, or name another in \
         Config::routers", routers.join(", ")
    )]
    Unreachable {
        /// The endpoints of the routers.
        routers: Vec<String>,
    },
    /// Another process has joined the fleet as this robot.
    #[error(
        "robot: {robot} is in fleet {fleet} already; give each robot an id of its own, or end the \
         process that speaks for it"
    )]
    Taken {
        /// The robot.
        robot: RobotId,
        /// The fleet.
        fleet: FleetId,
    },
    /// No service replied to a get in time.
    #[error("no answer for {key} of fleet {fleet}; see `muster status` for what runs")]
    Unanswered {
        /// The key below the fleet's prefix, or the pattern.
        key: String,
        /// The fleet.
        fleet: FleetId,
    },
    /// The service runs and answers other gets, but not this one: the rules of a router drop it.
    #[error(
        "denied: {service} of fleet {fleet} runs, and the router does not let this client get or change \
         {key}; use the identity of an operator (--zenoh-config, Config::zenoh_config), and its name (--operator)"
    )]
    Denied {
        /// The service.
        service: ServiceName,
        /// The key below the fleet's prefix.
        key: String,
        /// The fleet.
        fleet: FleetId,
    },
    /// A service refused a get.
    #[error("{service} refuses: {reason}")]
    Refused {
        /// The service.
        service: ServiceName,
        /// What is wrong and what would be right, cut short, without control characters.
        reason: String,
    },
    /// A service cannot do what was asked for now, and may in a moment.
    #[error("{service} cannot do this now: {reason}")]
    Unavailable {
        /// The service.
        service: ServiceName,
        /// Why, cut short, without control characters.
        reason: String,
    },
    /// A service has carried a command out, and could not store it.
    #[error("{service} has done it, and a restart of it may forget that: {reason}")]
    Unstored {
        /// The service.
        service: ServiceName,
        /// Why, cut short, without control characters.
        reason: String,
    },
    /// A part of a proposal was not carried out, so that it is not applied.
    #[error("the proposal is not applied: {reason}{}", left_text(left))]
    NotApplied {
        /// Why one of its commands was not carried out.
        reason: Box<Error>,
        /// What was applied and could not be taken back, or may have been.
        left: Vec<AppliedPart>,
    },
    /// The robot has left, or the client was closed.
    #[error("the robot has left, or its client was closed")]
    Closed,
    /// The bus failed.
    #[error("the bus failed: {reason}")]
    Bus {
        /// The error of Zenoh or the operating system.
        reason: String,
    },
}

fn left_text(left: &[AppliedPart]) -> String {
    if left.is_empty() {
        return String::new();
    }
    let parts: Vec<String> = left.iter().map(ToString::to_string).collect();
    format!("; what could not be taken back may still hold: {}", parts.join(", "))
}

/// What an error reply says: its code, and the text fit for a terminal. Anybody may reply.
fn problem(reply: &str) -> (ProblemCode, String) {
    let value = serde_json::from_str::<Value>(reply).unwrap_or(Value::Null);
    let text = value.get("error").and_then(Value::as_str).unwrap_or(reply);
    let code = value.get("code").and_then(|code| serde_json::from_value(code.clone()).ok());
    (code.unwrap_or(ProblemCode::Refused), plain_reason(text))
}

impl Error {
    pub(crate) fn input(field: &'static str, problem: impl std::fmt::Display) -> Self {
        Self::Input { field, problem: problem.to_string() }
    }

    pub(crate) fn id(field: &'static str) -> impl Fn(IdError) -> Self {
        move |error| Self::input(field, error)
    }

    pub(crate) fn bus(error: impl std::fmt::Display) -> Self {
        Self::Bus { reason: format!("{error:#}") }
    }

    /// The error reply of a service.
    pub(crate) fn reply(service: ServiceName, reply: &str) -> Self {
        let (code, reason) = problem(reply);
        match code {
            ProblemCode::Refused => Self::Refused { service, reason },
            ProblemCode::Unavailable => Self::Unavailable { service, reason },
            ProblemCode::Unstored => Self::Unstored { service, reason },
        }
    }

    pub(crate) fn open(error: OpenError, routers: &[String]) -> Self {
        match error {
            OpenError::Config(problem) => {
                let named = problem.strip_prefix("zenoh_config ").unwrap_or(&problem);
                Self::input("zenoh_config", named)
            }
            OpenError::Unreachable(_) => Self::Unreachable { routers: routers.to_vec() },
            other => Self::bus(other),
        }
    }
}

impl From<ObservationError> for Error {
    fn from(error: ObservationError) -> Self {
        Self::Input { field: error.field, problem: error.problem }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_reply_says_what_may_be_done() {
        let error = |reply| Error::reply(ServiceName::Clusterer, reply);
        let refused = error(r#"{"error": "teams: too few", "field": "teams", "code": "refused"}"#);
        assert!(matches!(refused, Error::Refused { ref reason, .. } if reason == "teams: too few"));
        let starting = error(r#"{"error": "(command): is starting", "code": "unavailable"}"#);
        assert!(matches!(starting, Error::Unavailable { .. }), "{starting}");
        let unstored = error(r#"{"error": "(wish): it counts", "code": "unstored"}"#);
        assert!(matches!(unstored, Error::Unstored { .. }), "{unstored}");
        // Anybody may reply with anything.
        for reply in [r#"{"error": "x", "code": 7}"#, r#"{"code": "other"}"#, "null", "x"] {
            assert!(matches!(error(reply), Error::Refused { .. }), "{reply}");
        }
        let plain = error("plain\u{1b}[2J");
        assert!(matches!(plain, Error::Refused { ref reason, .. } if reason == "plain\u{FFFD}[2J"));
        let long = error(&"x".repeat(10_000));
        let is_short = |reason: &String| reason.len() == muster_wire::message::MAX_REASON;
        assert!(matches!(long, Error::Refused { ref reason, .. } if is_short(reason)));
    }
}
