//! `FIELD=VALUE` pairs of a command line as a patch of settings.

use serde_json::{Map, Value};

/// Reads `field=value` pairs, with dots for nested fields, into a patch. A value is JSON where it can
/// be read as such, and a text otherwise.
///
/// # Errors
/// Names the pair that has no `=`.
pub fn parse_assignments(assignments: &[String]) -> Result<Value, String> {
    let mut patch = Map::new();
    for assignment in assignments {
        let Some((path, text)) = assignment.split_once('=') else {
            return Err(format!("{assignment:?}: must be FIELD=VALUE, such as teams=3"));
        };
        let value = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()));
        let mut chunks: Vec<&str> = path.trim().split('.').collect();
        let last = chunks.pop().unwrap_or_default();
        let mut table = &mut patch;
        for chunk in chunks {
            let inner = table.entry(chunk).or_insert_with(|| Value::Object(Map::new()));
            let Value::Object(inner) = inner else {
                return Err(format!("{path}: is named as a value and as a table"));
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
