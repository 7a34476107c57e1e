//! The JSON Schema of plain fields with rules of their own.
//!
//! The types derive their schema; where a field is plainer than its rule (a text without control
//! characters, a weight within a tuple), it names one of these types, which have no values.
//! The bounds of numbers stand twice, in the schema and in `check`: a test of whole processes
//! compares the two at each bound.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};

use crate::id::{Modality, RobotId};
use crate::limits::{MAX_TEXT_LENGTH, MAX_WEIGHT};

fn text_schema(shortest: usize) -> Schema {
    json_schema!({
        "type": "string",
        "description": format!(
            "No control characters, and at most {MAX_TEXT_LENGTH} bytes of UTF-8: with characters \
             beyond ASCII fewer of them, which JSON Schema cannot say."
        ),
        "minLength": shortest,
        "maxLength": MAX_TEXT_LENGTH,
        "not": { "pattern": "[\\u0000-\\u001f\\u007f-\\u009f]" },
    })
}

/// A short free text that may be empty.
pub(crate) struct Text;

impl JsonSchema for Text {
    fn schema_name() -> Cow<'static, str> {
        "Text".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        text_schema(0)
    }
}

/// A short free text with at least one character.
pub(crate) struct Name;

impl JsonSchema for Name {
    fn schema_name() -> Cow<'static, str> {
        "Name".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        text_schema(1)
    }
}

/// From, to, and the weight of the edge.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "only its schema is used")]
pub(crate) struct RelationEdge(RobotId, RobotId, #[schemars(range(min = 0, max = MAX_WEIGHT))] f64);

/// A share of a whole.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "only its schema is used")]
pub(crate) struct Share(#[schemars(range(min = 0, max = 1))] f64);

/// A modality that is not built in.
pub(crate) struct DeclaredModality;

impl JsonSchema for DeclaredModality {
    fn schema_name() -> Cow<'static, str> {
        "DeclaredModality".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let built_in = Modality::BUILT_IN;
        json_schema!({
            "description": "A modality that is not built in.",
            "allOf": [generator.subschema_for::<Modality>()],
            "not": { "enum": built_in },
        })
    }
}
