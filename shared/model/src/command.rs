//! What operators command: who, under which id, until when, and what came of it.
//!
//! A command is carried out once, however often it arrives. Its id is remembered for as long as it is valid; after that
//! it is refused because it has expired.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::content::{Content, ContentError, refuse};
use crate::header::{Header, Revision};
use crate::id::{CommandId, OperatorId, ServiceName, WishId};
use crate::time::Tick;
use crate::wish::{MAX_EXPIRY_S, Wish};

/// How long after it was sent a command may expire at the latest, in seconds: ids are remembered that long, and nobody
/// waits longer for what a click does.
pub const MAX_VALID_S: f64 = 600.0;

/// How far the clocks of an operator and a service may be apart, in seconds. Beyond, an expiry means something else to
/// either of them.
pub const MAX_CLOCK_OFFSET_S: f64 = 30.0;

/// Most commands of one service that are remembered at once: a person gives one in some seconds, so that hundreds within
/// ten minutes come from a program that should wait.
pub const MAX_REMEMBERED_COMMANDS: usize = 256;

/// Most refused commands of those that are remembered: a program with a wrong clock sends any number of them, and they must
/// not displace what was carried out.
pub const MAX_REMEMBERED_REFUSALS: usize = 64;

/// Longest answer, action or reason of a command that is remembered, in bytes.
pub const MAX_OUTCOME_TEXT: usize = 4096;

/// What is commanded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Action {
    /// Change these settings of the service; `null` resets a field to its default.
    Set(Map<String, Value>),
    /// Put a wish, in place of the one of this operator with its id.
    Wish {
        /// Its id.
        id: WishId,
        /// What is wished.
        #[schemars(with = "Wish")]
        wish: Map<String, Value>,
    },
    /// Take a wish of this operator away.
    Withdraw {
        /// Its id.
        id: WishId,
    },
    /// Say that the operator has seen an alert.
    Acknowledge {
        /// The number of the alert.
        alert: u64,
    },
}

impl Action {
    /// The service that carries it out; none if any may.
    #[must_use]
    pub const fn service(&self) -> Option<ServiceName> {
        match self {
            Self::Set(_) => None,
            Self::Wish { .. } | Self::Withdraw { .. } => Some(ServiceName::Clusterer),
            Self::Acknowledge { .. } => Some(ServiceName::Auditor),
        }
    }

    /// Its name in JSON.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Set(_) => "set",
            Self::Wish { .. } => "wish",
            Self::Withdraw { .. } => "withdraw",
            Self::Acknowledge { .. } => "acknowledge",
        }
    }
}

/// What an operator sends. The operator and the id stand in the key.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OperatorCommand {
    /// When it was sent by the operator's clock, in seconds since the Unix epoch.
    #[schemars(range(min = 0, max = MAX_EXPIRY_S))]
    pub sent: f64,
    /// Until when it may be carried out, in seconds since the Unix epoch; at most ten minutes after it was sent.
    #[schemars(range(min = 0, max = MAX_EXPIRY_S))]
    pub expires: f64,
    /// The division that the operator had seen; none if it does not matter.
    #[serde(default)]
    pub based_on: Option<Revision>,
    /// What is commanded.
    pub action: Action,
}

/// What is wrong with a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandProblem {
    /// The field.
    pub field: &'static str,
    /// What is wrong with it, and what would be right.
    pub problem: String,
}

impl CommandProblem {
    /// Whether the same command may be right in a moment: the instance has not received a division that the operator has
    /// seen. A clock or an expiry that was wrong stays wrong.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.field == "based_on"
    }
}

impl OperatorCommand {
    /// Refuses a command that makes no sense, has expired, comes from a clock that is far off, or is based on a later term
    /// than `term`.
    ///
    /// # Errors
    /// Names the field and the remedy.
    pub fn check(&self, service: ServiceName, now: Tick, term: u64) -> Result<(), CommandProblem> {
        let wrong = |field, problem| Err(CommandProblem { field, problem });
        for (field, time) in [("sent", self.sent), ("expires", self.expires)] {
            if !(0.0..=MAX_EXPIRY_S).contains(&time) {
                let problem =
                    format!("must be seconds since 1970, up to {MAX_EXPIRY_S}, not {time}");
                return wrong(field, problem);
            }
        }
        if let Some(other) = self.action.service().filter(|other| *other != service) {
            let problem = format!("{} is for {other}, not for {service}", self.action.name());
            return wrong("action", problem);
        }
        let now = now.as_seconds();
        let offset = self.sent - now;
        if offset.abs() > MAX_CLOCK_OFFSET_S {
            let side = if offset > 0.0 { "ahead of" } else { "behind" };
            let problem = format!(
                "the operator's clock is {:.0} s {side} that of {service}, and may be {MAX_CLOCK_OFFSET_S} s off: set \
                 the clocks",
                offset.abs()
            );
            return wrong("sent", problem);
        }
        if self.expires - self.sent > MAX_VALID_S {
            let problem = format!("may be at most {MAX_VALID_S} s after sent");
            return wrong("expires", problem);
        }
        if self.expires <= now {
            let problem = format!("was {:.1} s ago: send a new command", now - self.expires);
            return wrong("expires", problem);
        }
        if let Some(seen) = self.based_on
            && seen.term > term
            && service == ServiceName::Clusterer
        {
            let problem = format!(
                "the division of term {} is of a later term than that of this instance, {term}: ask again in a moment",
                seen.term
            );
            return wrong("based_on", problem);
        }
        Ok(())
    }
}

/// What came of a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CommandOutcome {
    /// The head of the message.
    pub header: Header,
    /// The service that was commanded.
    pub service: ServiceName,
    /// Who commanded.
    pub operator: OperatorId,
    /// The id of the command.
    pub id: CommandId,
    /// Until when the id is remembered, in seconds since the Unix epoch.
    pub expires: f64,
    /// The division that the operator had seen.
    pub based_on: Option<Revision>,
    /// What was commanded, as JSON.
    pub action: String,
    /// Why it was refused, as JSON; none if it was carried out.
    pub refused: Option<String>,
    /// What the service answered, as JSON; none if it was refused, or the answer is too long to be remembered.
    pub answer: Option<String>,
    /// Whether the same id may be sent again: it was refused before it began, for a reason that passes.
    #[serde(default)]
    pub may_be_repeated: bool,
    /// What it has changed of the settings; none if that is nothing, or more than is remembered.
    #[serde(default)]
    pub changed: Option<SettingsChange>,
}

/// A change of settings. Of two changes of a field the later one holds, whichever leaders have carried them out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettingsChange {
    /// When it counts as made: when the operator sent the command, or just after the last change of the same fields.
    pub at: Tick,
    /// The fields with their new values, as the JSON text of a patch.
    pub fields: String,
}

impl Content for CommandOutcome {
    /// The texts are no longer than they may be.
    fn check(&self) -> Result<(), ContentError> {
        let changed = self.changed.as_ref().map(|changed| &changed.fields);
        let texts = [Some(&self.action), self.refused.as_ref(), self.answer.as_ref(), changed];
        if texts.into_iter().flatten().any(|text| text.len() > MAX_OUTCOME_TEXT) {
            return refuse("outcome", "has a text that is longer than it may be");
        }
        if !(0.0..=MAX_EXPIRY_S).contains(&self.expires) {
            return refuse("expires", "must be seconds since 1970");
        }
        if self.may_be_repeated && self.refused.is_none() {
            return refuse("may_be_repeated", "is for refused commands alone");
        }
        if self.changed.is_some() && self.refused.is_some() {
            return refuse("changed", "is for commands that were carried out");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const NOW: f64 = 1_790_000_000.0;

    fn problem(change: Value) -> Option<&'static str> {
        let mut command =
            json!({"sent": NOW, "expires": NOW + 30.0, "action": {"set": {"teams": 3}}});
        if let (Value::Object(command), Value::Object(change)) = (&mut command, change) {
            command.extend(change);
        }
        let command: OperatorCommand = serde_json::from_value(command).unwrap();
        let now = Tick(0).after(std::time::Duration::from_secs_f64(NOW));
        command.check(ServiceName::Clusterer, now, 7).err().map(|problem| problem.field)
    }

    #[test]
    fn a_command_is_valid_for_a_while_and_within_a_term() {
        assert_eq!(problem(json!({})), None);
        assert_eq!(problem(json!({"sent": NOW - 29.0})), None);
        assert_eq!(problem(json!({"sent": NOW - 31.0})), Some("sent"));
        assert_eq!(problem(json!({"sent": NOW + 31.0, "expires": NOW + 40.0})), Some("sent"));
        assert_eq!(problem(json!({"sent": -1.0})), Some("sent"));
        assert_eq!(problem(json!({"expires": NOW})), Some("expires"));
        assert_eq!(problem(json!({"expires": NOW + 601.0})), Some("expires"));
        assert_eq!(problem(json!({"expires": 1.0e300})), Some("expires"));
        assert_eq!(problem(json!({"based_on": {"term": 7, "epoch": 99}})), None);
        assert_eq!(problem(json!({"based_on": {"term": 8, "epoch": 0}})), Some("based_on"));
        assert_eq!(problem(json!({"action": {"acknowledge": {"alert": 1}}})), Some("action"));
        assert_eq!(problem(json!({"action": {"withdraw": {"id": "w1"}}})), None);
    }
}
