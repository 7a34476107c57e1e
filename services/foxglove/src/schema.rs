//! The JSON Schema of the bus as viewers read it.
//!
//! Lichtblick and Foxglove read a part of JSON Schema: an object whose fields each have one plain type, without references
//! and choices. What has no such form is left out; the messages still have it, and no message contradicts the schema.

use serde_json::{Map, Value, json};

/// Parts within parts beyond which nothing is described: no message is as deep, and a schema may name itself.
const MAX_DEPTH: usize = 16;

/// The schema of a message of the bus by its name; none if there is no such message, or it is no object.
#[must_use]
pub fn for_viewers(name: &str) -> Option<Value> {
    let document = serde_json::from_slice(muster_wire::schema::text()).ok()?;
    let whole = muster_wire::schema::one(&document, name)?;
    let mut plain = plain(&whole, &whole, 0)?;
    plain["title"] = json!(name);
    Some(plain)
}

/// A part of a schema with one plain type; none if it has no such form.
fn plain(part: &Value, whole: &Value, depth: usize) -> Option<Value> {
    if depth > MAX_DEPTH {
        return None;
    }
    if let Some(name) = part.get("$ref").and_then(Value::as_str) {
        let named = whole.get("$defs")?.get(name.strip_prefix("#/$defs/")?)?;
        return plain(named, whole, depth + 1);
    }
    for choice in ["anyOf", "oneOf", "allOf"] {
        if let Some(options) = part.get(choice).and_then(Value::as_array) {
            let is_null = |option: &&Value| option.get("type").is_some_and(|kind| kind == "null");
            let mut options = options.iter().filter(|option| !is_null(option));
            let first = plain(options.next()?, whole, depth + 1)?;
            // Choices of one type, as texts with descriptions of their own, are of that type.
            let is_same = |option: &Value| {
                plain(option, whole, depth + 1).is_some_and(|plain| plain["type"] == first["type"])
            };
            let is_one = options.all(is_same);
            return is_one.then(|| {
                if first["type"] == "string" { json!({"type": "string"}) } else { first }
            });
        }
    }
    let kind = match part.get("type") {
        Some(Value::String(kind)) => kind.as_str(),
        Some(Value::Array(kinds)) => {
            kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null")?
        }
        _ => match part.get("const").or_else(|| part.get("enum")?.as_array()?.first())? {
            Value::String(_) => "string",
            _ => return None,
        },
    };
    match kind {
        "boolean" | "string" | "number" | "integer" => Some(json!({ "type": kind })),
        "object" => {
            let fields = part.get("properties")?.as_object()?.iter();
            let fields = fields
                .filter_map(|(name, field)| Some((name.clone(), plain(field, whole, depth + 1)?)));
            Some(json!({"type": "object", "properties": fields.collect::<Map<_, _>>()}))
        }
        "array" => {
            let items = plain(part.get("items")?, whole, depth + 1)?;
            // They read no lists of lists.
            (items["type"] != "array").then(|| json!({"type": "array", "items": items}))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names what viewers would not read.
    fn wrong(schema: &Value, at: &str) -> Vec<String> {
        let kind = schema["type"].as_str().unwrap_or_default();
        match kind {
            "boolean" | "string" | "number" | "integer" => Vec::new(),
            "object" => {
                let fields = schema["properties"].as_object().unwrap();
                fields
                    .iter()
                    .flat_map(|(name, field)| wrong(field, &format!("{at}.{name}")))
                    .collect()
            }
            "array" if schema["items"]["type"] != "array" => wrong(&schema["items"], at),
            _ => vec![at.to_owned()],
        }
    }

    #[test]
    fn every_message_of_services_and_robots_has_a_schema_that_viewers_read() {
        let document = serde_json::from_slice(muster_wire::schema::text()).unwrap();
        for name in
            ["audit", "teams", "roster", "alerts", "event", "pose", "links", "rank", "graph"]
        {
            assert!(muster_wire::schema::names(&document).any(|known| known == name), "{name}");
            let schema = for_viewers(name).unwrap();
            assert_eq!(schema["type"], "object", "{name}");
            assert!(wrong(&schema, name).is_empty(), "{:?}", wrong(&schema, name));
        }
        assert!(for_viewers("no such message").is_none());
    }

    #[test]
    fn the_quality_has_its_numbers() {
        let schema = for_viewers("audit").unwrap();
        let fields = &schema["properties"];
        assert_eq!(fields["silhouette"]["properties"]["mean"]["type"], "number");
        assert_eq!(fields["flapping"]["properties"]["returns_per_robot_minute"]["type"], "number");
        assert_eq!(fields["verdict"]["type"], "string");
        assert_eq!(fields["data_age_s"]["type"], "number");
    }

    #[test]
    fn a_schema_that_names_itself_has_an_end() {
        let whole = json!({"$defs": {"a": {"$ref": "#/$defs/a"}}, "$ref": "#/$defs/a"});
        assert_eq!(plain(&whole, &whole, 0), None);
    }
}
