//! Message types with all types that they are made of: what bytes are read and written by.

use std::sync::Arc;

use crate::definition::{Arity, Element, FieldType, Primitive};
use crate::literal::Literal;
use crate::name::TypeName;
use crate::value::Value;

/// What a type without fields has instead, as in ROS: C++ knows no empty structure.
pub(crate) const PLACEHOLDER: &str = "structure_needs_at_least_one_member";

/// A field of a message type.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type.
    pub kind: FieldType<Arc<Layout>>,
    /// What it is where a program sets nothing; none: zero, or empty.
    default: Option<Literal>,
}

impl Field {
    pub(crate) fn new(
        name: String,
        kind: FieldType<Arc<Layout>>,
        default: Option<Literal>,
    ) -> Self {
        Self { name, kind, default }
    }

    /// Least bytes that the field takes, without padding.
    pub(crate) fn min_bytes(&self) -> usize {
        let element = element_min_bytes(&self.kind.element);
        match self.kind.arity {
            Arity::One => element,
            Arity::Array(length) => element.saturating_mul(length as usize),
            Arity::Sequence { .. } => 4,
        }
    }

    fn initial(&self) -> Value {
        let element = &self.kind.element;
        if let Some(default) = &self.default {
            return default.to_value(element);
        }
        let is_bytes = is_bytes(element);
        match self.kind.arity {
            Arity::One => initial(element),
            Arity::Array(length) if is_bytes => Value::Bytes(vec![0; length as usize]),
            Arity::Array(length) => Value::List(vec![initial(element); length as usize]),
            Arity::Sequence { .. } if is_bytes => Value::Bytes(Vec::new()),
            Arity::Sequence { .. } => Value::List(Vec::new()),
        }
    }
}

/// Least bytes that one value takes, without padding.
pub(crate) fn element_min_bytes(element: &Element<Arc<Layout>>) -> usize {
    match element {
        Element::Primitive(primitive) => primitive.size(),
        // The length.
        Element::Text { .. } => 4,
        Element::Nested(layout) => layout.min_bytes,
    }
}

/// Whether many such values are held as bytes.
pub(crate) fn is_bytes<N>(element: &Element<N>) -> bool {
    matches!(element, Element::Primitive(Primitive::Uint8 | Primitive::Byte))
}

fn initial(element: &Element<Arc<Layout>>) -> Value {
    match element {
        Element::Nested(layout) => layout.initial(),
        Element::Text { .. } => Value::Text(String::new()),
        Element::Primitive(primitive) => match primitive {
            Primitive::Bool => Value::Bool(false),
            Primitive::Float32 => Value::F32(0.0),
            Primitive::Float64 => Value::F64(0.0),
            Primitive::Int8 | Primitive::Int16 | Primitive::Int32 | Primitive::Int64 => {
                Value::Int(0)
            }
            _ => Value::Uint(0),
        },
    }
}

/// A message type with all types that it is made of. A [`Catalog`](crate::Catalog) makes it.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    name: TypeName,
    fields: Vec<Field>,
    min_bytes: usize,
}

impl Layout {
    pub(crate) fn new(name: TypeName, mut fields: Vec<Field>) -> Self {
        if fields.is_empty() {
            let element = Element::Primitive(Primitive::Uint8);
            let kind = FieldType { element, arity: Arity::One };
            fields.push(Field::new(PLACEHOLDER.to_owned(), kind, None));
        }
        let min_bytes = fields.iter().map(Field::min_bytes).fold(0, usize::saturating_add);
        Self { name, fields, min_bytes }
    }

    /// The type.
    #[must_use]
    pub fn name(&self) -> &TypeName {
        &self.name
    }

    /// Its fields, at least one.
    #[must_use]
    pub fn fields(&self) -> &[Field] {
        &self.fields
    }

    /// Least bytes of a message, without padding.
    pub(crate) fn min_bytes(&self) -> usize {
        self.min_bytes
    }

    /// A message whose fields have their defaults, or else are zero or empty.
    #[must_use]
    pub fn initial(&self) -> Value {
        Value::Struct(self.fields.iter().map(Field::initial).collect())
    }
}
