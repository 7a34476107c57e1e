//! The payload of a get that changes a wish: the wish as JSON, or `null` to withdraw it.

use muster_model::command::{Action, CommandOutcome};
use muster_model::id::{OperatorId, WishId};
use muster_model::settings::{SettingsError, from_value};
use muster_model::wish::Wish;
use serde_json::Value;

/// Largest payload in bytes: all robots that a wish may name with the longest ids, and a note, fit.
pub const MAX_WISH_BYTES: usize = 16 * 1024;

/// What a get asks for.
#[derive(Debug, Clone, PartialEq)]
pub enum WishChange {
    /// The wish is put, in place of the one with its name.
    Put(Wish),
    /// The wish is withdrawn.
    Withdraw,
}

/// Reads and checks a payload.
///
/// # Errors
/// Names the field that is wrong, and what would be right.
pub fn decode(payload: &[u8]) -> Result<WishChange, SettingsError> {
    let refused = |problem: String| SettingsError::new("(wish)", problem);
    if payload.len() > MAX_WISH_BYTES {
        return Err(refused(format!("may have at most {MAX_WISH_BYTES} bytes")));
    }
    let value: Value =
        serde_json::from_slice(payload).map_err(|error| refused(format!("is no JSON: {error}")))?;
    match value {
        Value::Null => Ok(WishChange::Withdraw),
        Value::Object(_) => Ok(WishChange::Put(from_value::<Wish>(value)?.checked()?)),
        _ => Err(refused(
            "must be an object such as {\"kind\": \"lock\", \"team\": \"t2\"}".to_owned(),
        )),
    }
}

/// What a command that was carried out did to a wish: which one, by its operator and id, and how. Nothing if it was about
/// something else, or is too long to be remembered whole.
#[must_use]
pub fn changed_by(outcome: &CommandOutcome) -> Option<(OperatorId, WishId, WishChange)> {
    let operator = outcome.operator.clone();
    match serde_json::from_str(&outcome.action).ok()? {
        Action::Wish { id, wish } => {
            let wish = from_value::<Wish>(Value::Object(wish)).ok()?.checked().ok()?;
            Some((operator, id, WishChange::Put(wish)))
        }
        Action::Withdraw { id } => Some((operator, id, WishChange::Withdraw)),
        Action::Set(_) | Action::Acknowledge { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_payload_is_a_wish_or_null() {
        assert_eq!(decode(b"null"), Ok(WishChange::Withdraw));
        let lock = decode(br#"{"kind": "lock", "team": "t2"}"#);
        assert!(matches!(lock, Ok(WishChange::Put(_))), "{lock:?}");
        for (wrong, field) in [
            (&b"[1]"[..], "(wish)"),
            (b"{", "(wish)"),
            (&[b' '; MAX_WISH_BYTES + 1], "(wish)"),
            (br#"{"kind": "lock"}"#, "team"),
            (br#"{"kind": "hold"}"#, "kind"),
        ] {
            assert_eq!(decode(wrong).unwrap_err().field, field);
        }
    }
}
