//! What an operator sends to acknowledge an alert, and reads of the list of alerts.

use muster_model::alert::AcknowledgeAlert;

use crate::envelope::MAX_SMALL_PAYLOAD;

/// Why an acknowledgement is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AcknowledgementError {
    /// It is longer than is read.
    #[error("the payload has {0} bytes; an acknowledgement has at most {MAX_SMALL_PAYLOAD}")]
    TooLarge(usize),
    /// It is not of its form.
    #[error("the payload must be an object such as {{\"operator\":\"kim\",\"alert\":7}}: {0}")]
    Form(String),
}

/// Reads the payload of a get that acknowledges an alert.
///
/// # Errors
/// Names the field that is missing, unknown or wrong.
pub fn read_acknowledgement(payload: &[u8]) -> Result<AcknowledgeAlert, AcknowledgementError> {
    if payload.len() > MAX_SMALL_PAYLOAD {
        return Err(AcknowledgementError::TooLarge(payload.len()));
    }
    serde_json::from_slice(payload).map_err(|error| AcknowledgementError::Form(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_with_an_acknowledgement_is_named() {
        let sound = read_acknowledgement(br#"{"alert": 7, "operator": "kim"}"#).unwrap();
        assert_eq!((sound.alert, sound.operator.as_str()), (7, "kim"));
        for (payload, named) in [
            ("{}", "operator"),
            (r#"{"operator": "kim"}"#, "alert"),
            (r#"{"operator": "Kim!", "alert": 7}"#, "a-z 0-9"),
            (r#"{"operator": "kim", "alert": -7}"#, "-7"),
            (r#"{"operator": "kim", "alert": 7, "note": ""}"#, "note"),
            ("seven", "such as {\"operator\":\"kim\",\"alert\":7}"),
        ] {
            let error = read_acknowledgement(payload.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
        assert!(read_acknowledgement(&[b' '; MAX_SMALL_PAYLOAD + 1]).is_err());
    }
}
