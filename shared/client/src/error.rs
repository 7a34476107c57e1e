//! What can go wrong, each with its remedy.

use muster_bus::OpenError;
use muster_model::id::{FleetId, IdError, RobotId, ServiceName};
use muster_model::observation::ObservationError;

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
    /// A part of a proposal was refused, so that it is not applied.
    #[error("the proposal is not applied: {reason}{}", left_text(left))]
    NotApplied {
        /// Why one of its commands was refused.
        reason: Box<Error>,
        /// What was applied before and could not be taken back.
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
    format!("; what could not be taken back still holds: {}", parts.join(", "))
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
