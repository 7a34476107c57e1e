//! The hash of a message type: RIHS01, the first ROS Interface Hashing Standard (REP-2016).
//!
//! It is the SHA-256 of the type description as JSON, in the form that `rosidl_generator_type_description` writes: with
//! a blank after each colon and comma, without default values, and with all types that it refers to, sorted by name.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};

use sha2::{Digest, Sha256};

use crate::definition::{Arity, Element, Primitive};
use crate::layout::{Field, Layout};

/// What stands before the digits.
const PREFIX: &str = "RIHS01_";

/// What Humble writes, which knows no hashes.
const NOT_SUPPORTED: &str = "TypeHashNotSupported";

/// The hash of a message type.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TypeHash {
    /// The 32 bytes of the hash.
    Rihs01([u8; 32]),
    /// The publisher knows no hashes, as in Humble.
    NotSupported,
}

/// The text is no hash of a type.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a hash of a type is {PREFIX} with 64 digits of 0-9 a-f, or {NOT_SUPPORTED}")]
pub struct HashError;

impl fmt::Display for TypeHash {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotSupported => formatter.write_str(NOT_SUPPORTED),
            Self::Rihs01(bytes) => {
                formatter.write_str(PREFIX)?;
                bytes.iter().try_for_each(|byte| write!(formatter, "{byte:02x}"))
            }
        }
    }
}

impl fmt::Debug for TypeHash {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{self}")
    }
}

impl std::str::FromStr for TypeHash {
    type Err = HashError;

    fn from_str(text: &str) -> Result<Self, HashError> {
        if text == NOT_SUPPORTED {
            return Ok(Self::NotSupported);
        }
        let digits = text.strip_prefix(PREFIX).ok_or(HashError)?.as_bytes();
        let mut bytes = [0; 32];
        if digits.len() != 2 * bytes.len() {
            return Err(HashError);
        }
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            for digit in pair {
                let value = match digit {
                    b'0'..=b'9' => digit - b'0',
                    b'a'..=b'f' => digit - b'a' + 10,
                    _ => return Err(HashError),
                };
                *byte = *byte << 4 | value;
            }
        }
        Ok(Self::Rihs01(bytes))
    }
}

impl TypeHash {
    /// That of a message type.
    #[must_use]
    pub fn of(layout: &Layout) -> Self {
        Self::Rihs01(Sha256::digest(description(layout).as_bytes()).into())
    }
}

/// The type description as JSON. Names are identifiers, so that nothing is to be escaped.
fn description(layout: &Layout) -> String {
    let mut referred = BTreeMap::new();
    refer(layout, &mut referred);
    let mut text = String::from("{\"type_description\": ");
    describe(layout, &mut text);
    text.push_str(", \"referenced_type_descriptions\": [");
    for (number, layout) in referred.values().enumerate() {
        text.push_str(if number == 0 { "" } else { ", " });
        describe(layout, &mut text);
    }
    text.push_str("]}");
    text
}

/// Gathers the types that a type refers to. Each is visited once, however often it is named.
fn refer<'a>(layout: &'a Layout, found: &mut BTreeMap<&'a crate::TypeName, &'a Layout>) {
    for field in layout.fields() {
        if let Element::Nested(nested) = &field.kind.element
            && found.insert(nested.name(), nested).is_none()
        {
            refer(nested, found);
        }
    }
}

fn describe(layout: &Layout, text: &mut String) {
    // Writing to a text does not fail.
    let _ = write!(text, "{{\"type_name\": \"{}\", \"fields\": [", layout.name());
    for (number, field) in layout.fields().iter().enumerate() {
        text.push_str(if number == 0 { "" } else { ", " });
        describe_field(field, text);
    }
    text.push_str("]}");
}

fn describe_field(field: &Field, text: &mut String) {
    let (element, string_capacity, nested) = match &field.kind.element {
        Element::Nested(nested) => (1, 0, nested.name().to_string()),
        Element::Primitive(primitive) => (primitive_id(*primitive), 0, String::new()),
        Element::Text { is_wide, bound: None } => (17 + u32::from(*is_wide), 0, String::new()),
        Element::Text { is_wide, bound: Some(bound) } => {
            (21 + u32::from(*is_wide), *bound, String::new())
        }
    };
    // The constants of type_description_interfaces/msg/FieldType come in blocks of 48.
    let (block, capacity) = match field.kind.arity {
        Arity::One => (0, 0),
        Arity::Array(length) => (48, length),
        Arity::Sequence { bound: Some(bound) } => (96, bound),
        Arity::Sequence { bound: None } => (144, 0),
    };
    let _ = write!(
        text,
        "{{\"name\": \"{}\", \"type\": {{\"type_id\": {}, \"capacity\": {capacity}, \"string_capacity\": \
         {string_capacity}, \"nested_type_name\": \"{nested}\"}}}}",
        field.name,
        element + block,
    );
}

const fn primitive_id(primitive: Primitive) -> u32 {
    match primitive {
        Primitive::Int8 => 2,
        Primitive::Uint8 => 3,
        Primitive::Int16 => 4,
        Primitive::Uint16 => 5,
        Primitive::Int32 => 6,
        Primitive::Uint32 => 7,
        Primitive::Int64 => 8,
        Primitive::Uint64 => 9,
        Primitive::Float32 => 10,
        Primitive::Float64 => 11,
        Primitive::Bool => 15,
        Primitive::Byte => 16,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::name::TypeName;

    fn hash(catalog: &Catalog, name: &str) -> String {
        let name = TypeName::parse(name).unwrap();
        TypeHash::of(&catalog.layout(&name).unwrap()).to_string()
    }

    #[test]
    fn hashes_are_those_of_ros() {
        // Keys as rmw_zenoh of Jazzy writes them hold this one.
        let string = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let standard = Catalog::standard();
        assert_eq!(hash(&standard, "std_msgs/msg/String"), string);
        // The same fields under another name have another hash: that of Lyrical's talker.
        let mut catalog = Catalog::default();
        let name = TypeName::parse("example_interfaces/msg/String").unwrap();
        catalog.add(&name, "string data").unwrap();
        let example = "RIHS01_5509d866a579951f2fc6c19577c32605ba16f308cae7b498341d79536d4eb06b";
        assert_eq!(hash(&catalog, "example_interfaces/msg/String"), example);
    }

    #[test]
    fn texts_of_hashes_are_read_and_written_alike() {
        let text = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        for text in [text, NOT_SUPPORTED] {
            assert_eq!(text.parse::<TypeHash>().unwrap().to_string(), text);
        }
        let upper = text.replace("df", "DF");
        for wrong in
            ["", "RIHS01_", &text[..70], &format!("{text}0"), &upper, &text.replace("01", "02")]
        {
            assert_eq!(wrong.parse::<TypeHash>(), Err(HashError), "{wrong}");
        }
    }
}
