//! A message as a tree of values.

use crate::definition::Primitive;

/// A value of a field, or a whole message. The [`Layout`](crate::Layout) says what it stands for.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A `bool`.
    Bool(bool),
    /// A signed whole number of any size.
    Int(i64),
    /// A whole number without sign, of any size; a `byte` as well.
    Uint(u64),
    /// A `float32`.
    F32(f32),
    /// A `float64`.
    F64(f64),
    /// A string, wide or not.
    Text(String),
    /// An array or sequence of `uint8` or `byte`.
    Bytes(Vec<u8>),
    /// An array or sequence of anything else.
    List(Vec<Value>),
    /// A message: one value per field, in the order of the fields.
    Struct(Vec<Value>),
}

impl Value {
    /// The number as a value of a type; none if it does not fit, or the type is none of whole numbers.
    #[must_use]
    pub(crate) fn of_integer(primitive: Primitive, number: i128) -> Option<Self> {
        let (least, most): (i128, i128) = match primitive {
            Primitive::Int8 => (i8::MIN.into(), i8::MAX.into()),
            Primitive::Int16 => (i16::MIN.into(), i16::MAX.into()),
            Primitive::Int32 => (i32::MIN.into(), i32::MAX.into()),
            Primitive::Int64 => (i64::MIN.into(), i64::MAX.into()),
            Primitive::Uint8 | Primitive::Byte => (0, u8::MAX.into()),
            Primitive::Uint16 => (0, u16::MAX.into()),
            Primitive::Uint32 => (0, u32::MAX.into()),
            Primitive::Uint64 => (0, u64::MAX.into()),
            Primitive::Bool | Primitive::Float32 | Primitive::Float64 => return None,
        };
        if !(least..=most).contains(&number) {
            None
        } else if least < 0 {
            i64::try_from(number).ok().map(Self::Int)
        } else {
            u64::try_from(number).ok().map(Self::Uint)
        }
    }

    /// A number as a float, whichever type it has; none for anything else. Numbers beyond 2^53 are rounded.
    #[must_use]
    #[allow(clippy::cast_precision_loss, reason = "documented")]
    pub fn as_f64(&self) -> Option<f64> {
        match self {
            Self::Int(value) => Some(*value as f64),
            Self::Uint(value) => Some(*value as f64),
            Self::F32(value) => Some(f64::from(*value)),
            Self::F64(value) => Some(*value),
            _ => None,
        }
    }

    /// A whole number; none for anything else, or if it does not fit.
    #[must_use]
    pub fn as_i64(&self) -> Option<i64> {
        match self {
            Self::Int(value) => Some(*value),
            Self::Uint(value) => i64::try_from(*value).ok(),
            _ => None,
        }
    }

    /// A text; none for anything else.
    #[must_use]
    pub fn as_text(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    /// The values of a list; none for anything else, and for bytes.
    #[must_use]
    pub fn as_list(&self) -> Option<&[Self]> {
        if let Self::List(values) = self { Some(values) } else { None }
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::F64(value)
    }
}

impl From<f32> for Value {
    fn from(value: f32) -> Self {
        Self::F32(value)
    }
}

impl From<i32> for Value {
    fn from(value: i32) -> Self {
        Self::Int(value.into())
    }
}

impl From<u32> for Value {
    fn from(value: u32) -> Self {
        Self::Uint(value.into())
    }
}

impl From<u8> for Value {
    fn from(value: u8) -> Self {
        Self::Uint(value.into())
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Bool(value)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}
