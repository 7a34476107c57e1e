//! From bytes to values.

use std::sync::Arc;

use super::{ByteOrder, CdrError, HEADER_BYTES, MAX_MESSAGE_BYTES, MAX_PADDING, Place, padding};
use crate::definition::{Arity, Element, FieldType, Primitive};
use crate::layout::{Layout, element_min_bytes, is_bytes};
use crate::value::Value;

/// Reads a message.
///
/// The memory that is taken is bounded by the bytes: a count is believed only if so many values fit into those that are
/// left.
///
/// # Errors
/// Says what is wrong and in which field.
pub fn decode(layout: &Layout, bytes: &[u8]) -> Result<Value, CdrError> {
    if bytes.len() > MAX_MESSAGE_BYTES {
        return Err(CdrError::TooLong(bytes.len()));
    }
    let (header, body) =
        bytes.split_first_chunk::<HEADER_BYTES>().ok_or(CdrError::Short(Place::default()))?;
    // The last two bytes are options, which plain CDR has none of; some writers note their padding there.
    let order = match header[..2] {
        [0, 0] => ByteOrder::Big,
        [0, 1] => ByteOrder::Little,
        _ => return Err(CdrError::Header([header[0], header[1]])),
    };
    let mut reader = Reader { body, at: 0, order };
    let value = reader.message(layout)?;
    let rest = body.len() - reader.at;
    if rest > MAX_PADDING { Err(CdrError::Rest(rest)) } else { Ok(value) }
}

/// The bytes behind the header, and how many of them are read.
struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    order: ByteOrder,
}

impl<'a> Reader<'a> {
    fn message(&mut self, layout: &Layout) -> Result<Value, CdrError> {
        let fields = layout.fields();
        let mut values = Vec::with_capacity(fields.len());
        for field in fields {
            let value = self.field(&field.kind).map_err(|error| error.within(&field.name))?;
            values.push(value);
        }
        Ok(Value::Struct(values))
    }

    fn field(&mut self, kind: &FieldType<Arc<Layout>>) -> Result<Value, CdrError> {
        let count = match kind.arity {
            Arity::One => return self.element(&kind.element),
            Arity::Array(length) => length as usize,
            Arity::Sequence { bound } => {
                let count = self.length()?;
                if bound.is_some_and(|bound| count > bound as usize) {
                    return Err(CdrError::Count { place: Place::default(), count });
                }
                count
            }
        };
        if is_bytes(&kind.element) {
            return Ok(Value::Bytes(self.take(count)?.to_vec()));
        }
        // Every value takes at least a byte.
        let least = count.saturating_mul(element_min_bytes(&kind.element));
        if least > self.body.len() - self.at {
            return Err(match kind.arity {
                Arity::Sequence { .. } => CdrError::Count { place: Place::default(), count },
                _ => CdrError::Short(Place::default()),
            });
        }
        let mut values = Vec::with_capacity(count);
        for number in 0..count {
            let value = self.element(&kind.element);
            values.push(value.map_err(|error| error.within(&format!("[{number}]")))?);
        }
        Ok(Value::List(values))
    }

    fn element(&mut self, element: &Element<Arc<Layout>>) -> Result<Value, CdrError> {
        match element {
            Element::Primitive(primitive) => self.primitive(*primitive),
            Element::Text { is_wide: false, bound } => self.text(*bound),
            Element::Text { is_wide: true, bound } => self.wide_text(*bound),
            Element::Nested(layout) => self.message(layout),
        }
    }

    fn primitive(&mut self, primitive: Primitive) -> Result<Value, CdrError> {
        Ok(match primitive {
            Primitive::Bool => match self.number::<1>()? {
                [0] => Value::Bool(false),
                [1] => Value::Bool(true),
                _ => return Err(CdrError::Bool(Place::default())),
            },
            Primitive::Byte | Primitive::Uint8 => Value::Uint(self.number::<1>()?[0].into()),
            Primitive::Int8 => Value::Int(i8::from_le_bytes(self.number()?).into()),
            Primitive::Int16 => Value::Int(i16::from_le_bytes(self.number()?).into()),
            Primitive::Uint16 => Value::Uint(u16::from_le_bytes(self.number()?).into()),
            Primitive::Int32 => Value::Int(i32::from_le_bytes(self.number()?).into()),
            Primitive::Uint32 => Value::Uint(u32::from_le_bytes(self.number()?).into()),
            Primitive::Int64 => Value::Int(i64::from_le_bytes(self.number()?)),
            Primitive::Uint64 => Value::Uint(u64::from_le_bytes(self.number()?)),
            Primitive::Float32 => Value::F32(f32::from_le_bytes(self.number()?)),
            Primitive::Float64 => Value::F64(f64::from_le_bytes(self.number()?)),
        })
    }

    fn text(&mut self, bound: Option<u32>) -> Result<Value, CdrError> {
        let fail = || CdrError::Text(Place::default());
        let length = self.length()?;
        // Some writers give an empty string no zero.
        if length == 0 {
            return Ok(Value::Text(String::new()));
        }
        let (last, text) = self.take(length)?.split_last().ok_or_else(fail)?;
        let text = std::str::from_utf8(text).map_err(|_| fail())?;
        if *last != 0 || bound.is_some_and(|bound| text.len() > bound as usize) {
            return Err(fail());
        }
        Ok(Value::Text(text.to_owned()))
    }

    fn wide_text(&mut self, bound: Option<u32>) -> Result<Value, CdrError> {
        let fail = || CdrError::Text(Place::default());
        let count = self.length()?;
        if bound.is_some_and(|bound| count > bound as usize) {
            return Err(fail());
        }
        if count > (self.body.len() - self.at) / 4 {
            return Err(CdrError::Count { place: Place::default(), count });
        }
        let mut units = Vec::with_capacity(count);
        for _ in 0..count {
            let unit = u32::from_le_bytes(self.number()?);
            units.push(u16::try_from(unit).map_err(|_| fail())?);
        }
        String::from_utf16(&units).map(Value::Text).map_err(|_| fail())
    }

    /// A length that stands before values.
    fn length(&mut self) -> Result<usize, CdrError> {
        // Where it does not fit, more are announced than any message has.
        Ok(usize::try_from(u32::from_le_bytes(self.number()?)).unwrap_or(usize::MAX))
    }

    /// The bytes of a number, aligned to its size, the lowest first.
    fn number<const SIZE: usize>(&mut self) -> Result<[u8; SIZE], CdrError> {
        self.take(padding(self.at, SIZE))?;
        let mut bytes = [0; SIZE];
        bytes.copy_from_slice(self.take(SIZE)?);
        if self.order == ByteOrder::Big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let rest = &self.body[self.at..];
        let taken = rest.get(..count).ok_or(CdrError::Short(Place::default()))?;
        self.at += count;
        Ok(taken)
    }
}
