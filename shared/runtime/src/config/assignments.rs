//! `FIELD=VALUE` pairs of a command line as a patch of settings.

use serde_json::{Map, Value};

/// A pair that is no assignment.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AssignmentError {
    /// It has no `=`.
    #[error("{assignment:?}: must be FIELD=VALUE, such as teams=3")]
    NoValue {
        /// The pair.
        assignment: String,
    },
    /// An earlier pair gives a part of the path another kind.
    #[error("{path}: is named as a value and as a table")]
    ValueAndTable {
        /// The field.
        path: String,
    },
}

/// Reads `field=value` pairs, with dots for nested fields, into a patch. A value is JSON where it can
/// be read as such, and a text otherwise.
///
/// # Errors
/// An [`AssignmentError`] that names the pair.
pub fn parse_assignments(assignments: &[String]) -> Result<Value, AssignmentError> {
    let mut patch = Map::new();
    for assignment in assignments {
        let Some((path, text)) = assignment.split_once('=') else {
            return Err(AssignmentError::NoValue { assignment: assignment.clone() });
        };
        let value = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()));
        let mut chunks: Vec<&str> = path.trim().split('.').collect();
        let last = chunks.pop().unwrap_or_default();
        let mut table = &mut patch;
        for chunk in chunks {
            let inner = table.entry(chunk).or_insert_with(|| Value::Object(Map::new()));
            let Value::Object(inner) = inner else {
                return Err(AssignmentError::ValueAndTable { path: path.to_owned() });
            };
            table = inner;
        }
        table.insert(last.to_owned(), value);
    }
    Ok(Value::Object(patch))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assignments_become_a_patch() {
        let parse = |text: &str| parse_assignments(&[text.to_owned()]);
        assert_eq!(parse("teams=3").unwrap(), serde_json::json!({"teams": 3}));
        assert_eq!(parse("init=random").unwrap(), serde_json::json!({"init": "random"}));
        assert_eq!(parse("a.b={\"c\":1}").unwrap(), serde_json::json!({"a": {"b": {"c": 1}}}));
        assert!(parse("teams").is_err());
    }
}
