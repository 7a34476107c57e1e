//! The payload of a get that commands a service.

use muster_model::command::{Action, CommandOutcome, MAX_OUTCOME_TEXT, OperatorCommand};
use muster_model::header::Revision;
use muster_model::id::{CommandId, OperatorId, ServiceName};
use muster_model::settings::{SettingsError, from_value};
use muster_model::time::Tick;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value, json};

use crate::envelope::MAX_SMALL_PAYLOAD;
use crate::json::{EdgeJson, Head, head};
use crate::key::Key;

/// Largest payload in bytes: settings as large as a message may hold them, and any wish.
pub const MAX_COMMAND_BYTES: usize = MAX_SMALL_PAYLOAD;

/// Why an instance that does not lead yet refuses a command: it is to be sent again in a moment.
pub const STARTING: &str = "the service is starting; ask again in a moment";

/// Reads a payload.
///
/// # Errors
/// Names the field that is missing, unknown or of the wrong type.
pub fn decode(payload: &[u8]) -> Result<OperatorCommand, SettingsError> {
    let refused = |problem: String| SettingsError::new("(command)", problem);
    if payload.len() > MAX_COMMAND_BYTES {
        return Err(refused(format!("may have at most {MAX_COMMAND_BYTES} bytes")));
    }
    let value: Value =
        serde_json::from_slice(payload).map_err(|error| refused(format!("is no JSON: {error}")))?;
    if !value.is_object() {
        return Err(refused(
            "must be an object such as {\"sent\": 1.79e9, \"expires\": 1.79e9, \"action\": {\"set\": {\"teams\": 3}}}"
                .to_owned(),
        ));
    }
    from_value(value)
}

/// The key and the payload by which a service carries an action out.
#[must_use]
pub fn carried_out_by(
    service: ServiceName,
    operator: &OperatorId,
    action: &Action,
) -> (Key, Vec<u8>) {
    let (key, payload) = match action {
        Action::Set(patch) => (Key::Settings(service), Value::Object(patch.clone())),
        Action::Wish { id, wish } => {
            (Key::Wish(operator.clone(), id.clone()), Value::Object(wish.clone()))
        }
        Action::Withdraw { id } => (Key::Wish(operator.clone(), id.clone()), Value::Null),
        Action::Acknowledge { alert } => {
            (Key::Alerts, json!({"operator": operator.as_str(), "alert": alert}))
        }
    };
    (key, payload.to_string().into_bytes())
}

/// A text of an outcome; one that is longer than is remembered is left out.
#[must_use]
pub fn remembered(text: &str) -> Option<String> {
    (text.len() <= MAX_OUTCOME_TEXT).then(|| text.to_owned())
}

/// What came of a command.
#[derive(Serialize, JsonSchema)]
pub(crate) struct OutcomeForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    /// The service that was commanded.
    service: ServiceName,
    /// Who commanded.
    operator: &'a OperatorId,
    /// The id of the command.
    id: &'a CommandId,
    /// Seconds since the Unix epoch until which the id is remembered.
    expires: f64,
    /// The division that the operator had seen; null if it did not matter.
    based_on: Option<Revision>,
    /// What was commanded; its name alone if it is long.
    action: Value,
    /// Why it was refused; null if it was carried out.
    refused: Option<Value>,
    /// What the service answered; null if it was refused, or the answer is long.
    answer: Option<Value>,
    /// Whether the same id may be sent again: it was refused before it began, for a reason that passes.
    may_be_repeated: bool,
}

impl EdgeJson for CommandOutcome {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let read = |text: &String| serde_json::from_str(text).unwrap_or_else(|_| json!(text));
        serde_json::to_vec(&OutcomeForm {
            head: head(&self.header, now),
            service: self.service,
            operator: &self.operator,
            id: &self.id,
            expires: self.expires,
            based_on: self.based_on,
            action: read(&self.action),
            refused: self.refused.as_ref().map(read),
            answer: self.answer.as_ref().map(read),
            may_be_repeated: self.may_be_repeated,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_with_a_command_is_named() {
        let right = br#"{"sent": 1.79e9, "expires": 1.79e9, "action": {"withdraw": {"id": "w1"}}}"#;
        assert_eq!(decode(right).unwrap().action.name(), "withdraw");
        for (payload, field) in [
            (&b"{"[..], "(command)"),
            (b"[]", "(command)"),
            (&[b' '; MAX_COMMAND_BYTES + 1], "(command)"),
            (br#"{"sent": "now", "expires": 1, "action": {"set": {}}}"#, "sent"),
            (
                br#"{"sent": 1, "expires": 1, "action": {"withdraw": {"id": "W 1"}}}"#,
                "action.withdraw.id",
            ),
            (br#"{"sent": 1, "expires": 1, "action": {"sett": {}}}"#, "action"),
        ] {
            let error = decode(payload).unwrap_err();
            assert_eq!(error.field, field, "{error}");
        }
        for (payload, named) in [
            (&br#"{"sent": 1, "expires": 1}"#[..], "action"),
            (br#"{"sent": 1, "expires": 1, "action": {"set": {}}, "who": 1}"#, "who"),
        ] {
            let error = decode(payload).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
