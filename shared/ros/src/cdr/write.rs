//! From values to bytes.

use std::sync::Arc;

use super::{ByteOrder, CdrError, HEADER_BYTES, MAX_MESSAGE_BYTES, Place, padding};
use crate::definition::{Arity, Element, FieldType, Primitive};
use crate::layout::Layout;
use crate::value::Value;

/// Writes a message.
///
/// # Errors
/// Names the field whose value is none of its type; or the message is too long.
pub fn encode(layout: &Layout, value: &Value, order: ByteOrder) -> Result<Vec<u8>, CdrError> {
    let mut writer = Writer { bytes: order.header().to_vec(), order };
    writer.message(layout, value)?;
    if writer.bytes.len() > MAX_MESSAGE_BYTES {
        return Err(CdrError::TooLong(writer.bytes.len()));
    }
    Ok(writer.bytes)
}

/// The bytes so far, with the header.
struct Writer {
    bytes: Vec<u8>,
    order: ByteOrder,
}

fn wrong<T>() -> Result<T, CdrError> {
    Err(CdrError::Value(Place::default()))
}

impl Writer {
    fn message(&mut self, layout: &Layout, value: &Value) -> Result<(), CdrError> {
        let fields = layout.fields();
        let Value::Struct(values) = value else { return wrong() };
        if values.len() != fields.len() {
            return wrong();
        }
        for (field, value) in fields.iter().zip(values) {
            self.field(&field.kind, value).map_err(|error| error.within(&field.name))?;
        }
        Ok(())
    }

    fn field(&mut self, kind: &FieldType<Arc<Layout>>, value: &Value) -> Result<(), CdrError> {
        if kind.arity == Arity::One {
            return self.element(&kind.element, value);
        }
        let count = match value {
            Value::List(values) => values.len(),
            Value::Bytes(bytes) => bytes.len(),
            _ => return wrong(),
        };
        match kind.arity {
            Arity::Array(length) if count != length as usize => return wrong(),
            Arity::Sequence { bound: Some(bound) } if count > bound as usize => return wrong(),
            Arity::Sequence { .. } => self.length(count)?,
            Arity::One | Arity::Array(_) => {}
        }
        match (value, &kind.element) {
            (Value::Bytes(bytes), Element::Primitive(Primitive::Uint8 | Primitive::Byte)) => {
                self.bytes.extend(bytes);
                Ok(())
            }
            (Value::List(values), element) => {
                for (number, value) in values.iter().enumerate() {
                    let written = self.element(element, value);
                    written.map_err(|error| error.within(&format!("[{number}]")))?;
                }
                Ok(())
            }
            _ => wrong(),
        }
    }

    fn element(&mut self, element: &Element<Arc<Layout>>, value: &Value) -> Result<(), CdrError> {
        match (element, value) {
            (Element::Nested(layout), value) => self.message(layout, value),
            (Element::Text { is_wide, bound }, Value::Text(text)) => {
                self.text(*is_wide, *bound, text)
            }
            (Element::Primitive(primitive), value) => self.primitive(*primitive, value),
            _ => wrong(),
        }
    }

    fn primitive(&mut self, primitive: Primitive, value: &Value) -> Result<(), CdrError> {
        match (primitive, value) {
            (Primitive::Bool, Value::Bool(value)) => self.number([u8::from(*value)]),
            (Primitive::Float32, Value::F32(value)) => self.number(value.to_le_bytes()),
            (Primitive::Float64, Value::F64(value)) => self.number(value.to_le_bytes()),
            (primitive, Value::Int(value)) => self.integer(primitive, (*value).into())?,
            (primitive, Value::Uint(value)) => self.integer(primitive, (*value).into())?,
            _ => return wrong(),
        }
        Ok(())
    }

    /// A whole number that fits its type, whether or not it has a sign there.
    fn integer(&mut self, primitive: Primitive, value: i128) -> Result<(), CdrError> {
        if Value::of_integer(primitive, value).is_none() {
            return wrong();
        }
        // The lowest bytes are those of the number in its own size.
        let [a, b, c, d, e, f, g, h, ..] = value.to_le_bytes();
        match primitive.size() {
            1 => self.number([a]),
            2 => self.number([a, b]),
            4 => self.number([a, b, c, d]),
            _ => self.number([a, b, c, d, e, f, g, h]),
        }
        Ok(())
    }

    fn text(&mut self, is_wide: bool, bound: Option<u32>, text: &str) -> Result<(), CdrError> {
        let fits = |length: usize| bound.is_none_or(|bound| length <= bound as usize);
        if is_wide {
            let units: Vec<u16> = text.encode_utf16().collect();
            if !fits(units.len()) {
                return Err(CdrError::Text(Place::default()));
            }
            self.length(units.len())?;
            units.into_iter().for_each(|unit| self.number(u32::from(unit).to_le_bytes()));
            return Ok(());
        }
        if !fits(text.len()) {
            return Err(CdrError::Text(Place::default()));
        }
        self.length(text.len() + 1)?;
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
        Ok(())
    }

    fn length(&mut self, length: usize) -> Result<(), CdrError> {
        let length = u32::try_from(length).map_err(|_| CdrError::TooLong(length))?;
        self.number(length.to_le_bytes());
        Ok(())
    }

    /// The bytes of a number, the lowest first, aligned to its size.
    fn number<const SIZE: usize>(&mut self, mut bytes: [u8; SIZE]) {
        let at = self.bytes.len() - HEADER_BYTES;
        self.bytes.resize(self.bytes.len() + padding(at, SIZE), 0);
        if self.order == ByteOrder::Big {
            bytes.reverse();
        }
        self.bytes.extend(bytes);
    }
}
