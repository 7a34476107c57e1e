//! Values that stand in definitions: constants and defaults.

use crate::definition::{Arity, Element, FieldType, MAX_LENGTH, Primitive};
use crate::value::Value;

/// A value as a definition has it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Literal {
    Bool(bool),
    Integer(i128),
    Float(f64),
    Text(String),
    List(Vec<Self>),
}

impl Literal {
    /// Reads the value of a constant. A string needs no quotes.
    pub(crate) fn of_constant<N>(kind: &FieldType<N>, text: &str) -> Option<Self> {
        match (&kind.element, kind.arity) {
            (Element::Text { .. }, Arity::One) => {
                Some(Self::Text(unquoted(text).unwrap_or_else(|| text.to_owned())))
            }
            (_, Arity::One) => Self::of_element(&kind.element, text),
            _ => None,
        }
    }

    /// Reads the default of a field.
    pub(crate) fn of_default<N>(kind: &FieldType<N>, text: &str) -> Option<Self> {
        let (least, most) = match kind.arity {
            Arity::One => return Self::of_element(&kind.element, text),
            Arity::Array(length) => (length, length),
            Arity::Sequence { bound } => (0, bound.unwrap_or(MAX_LENGTH)),
        };
        let inner = text.strip_prefix('[')?.strip_suffix(']')?.trim();
        let mut values = Vec::new();
        for part in parts(inner) {
            values.push(Self::of_element(&kind.element, part.trim())?);
        }
        let count = u32::try_from(values.len()).ok()?;
        (least..=most).contains(&count).then_some(Self::List(values))
    }

    fn of_element<N>(element: &Element<N>, text: &str) -> Option<Self> {
        match element {
            Element::Nested(_) => None,
            Element::Text { bound, .. } => {
                let text = unquoted(text)?;
                let most = bound.map_or(usize::MAX, |bound| bound as usize);
                (text.chars().count() <= most).then_some(Self::Text(text))
            }
            Element::Primitive(Primitive::Bool) => match text {
                "1" => Some(Self::Bool(true)),
                "0" => Some(Self::Bool(false)),
                _ if text.eq_ignore_ascii_case("true") => Some(Self::Bool(true)),
                _ if text.eq_ignore_ascii_case("false") => Some(Self::Bool(false)),
                _ => None,
            },
            Element::Primitive(Primitive::Float32 | Primitive::Float64) => {
                text.parse().ok().map(Self::Float)
            }
            Element::Primitive(primitive) => {
                let value = integer(text)?;
                Value::of_integer(*primitive, value).map(|_| Self::Integer(value))
            }
        }
    }

    /// The value of a field whose default this is.
    pub(crate) fn to_value<N>(&self, element: &Element<N>) -> Value {
        match (self, element) {
            (Self::Bool(value), _) => Value::Bool(*value),
            (Self::Text(text), _) => Value::Text(text.clone()),
            (Self::Integer(value), Element::Primitive(primitive)) => {
                Value::of_integer(*primitive, *value).unwrap_or(Value::Int(0))
            }
            #[allow(clippy::cast_possible_truncation, reason = "a float32 has fewer digits")]
            (Self::Float(value), Element::Primitive(Primitive::Float32)) => {
                Value::F32(*value as f32)
            }
            (Self::Float(value), _) => Value::F64(*value),
            (Self::Integer(value), _) => Value::Int(i64::try_from(*value).unwrap_or(0)),
            (Self::List(values), Element::Primitive(Primitive::Uint8 | Primitive::Byte)) => {
                let byte = |literal: &Self| match literal {
                    Self::Integer(value) => u8::try_from(*value).unwrap_or(0),
                    _ => 0,
                };
                Value::Bytes(values.iter().map(byte).collect())
            }
            (Self::List(values), _) => {
                Value::List(values.iter().map(|value| value.to_value(element)).collect())
            }
        }
    }
}

/// A whole number: decimal, or with a prefix hexadecimal, octal or binary.
fn integer(text: &str) -> Option<i128> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    // A second sign is none of a number's.
    if !digits.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let (radix, digits) = match digits.get(..2) {
        Some("0x" | "0X") => (16, &digits[2..]),
        Some("0o" | "0O") => (8, &digits[2..]),
        Some("0b" | "0B") => (2, &digits[2..]),
        _ => (10, digits),
    };
    if digits.starts_with(['+', '-']) {
        return None;
    }
    i128::from_str_radix(digits, radix).ok()?.checked_mul(sign)
}

/// A text in quotes, without them.
fn unquoted(text: &str) -> Option<String> {
    let quote = text.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    let inner = text.strip_prefix(quote)?.strip_suffix(quote)?;
    let mut plain = String::with_capacity(inner.len());
    let mut characters = inner.chars();
    while let Some(c) = characters.next() {
        match c {
            '\\' => plain.push(match characters.next()? {
                'n' => '\n',
                't' => '\t',
                'r' => '\r',
                other => other,
            }),
            _ if c == quote => return None,
            _ => plain.push(c),
        }
    }
    Some(plain)
}

/// The parts of a list, separated by commas outside of quotes.
fn parts(text: &str) -> Vec<&str> {
    if text.is_empty() {
        return Vec::new();
    }
    let (mut found, mut begin, mut quote, mut escaped) = (Vec::new(), 0, None, false);
    for (at, c) in text.char_indices() {
        match (c, quote) {
            _ if escaped => escaped = false,
            ('\\', Some(_)) => escaped = true,
            ('"' | '\'', None) => quote = Some(c),
            (c, Some(open)) if c == open => quote = None,
            (',', None) => {
                found.push(&text[begin..at]);
                begin = at + 1;
            }
            _ => {}
        }
    }
    found.push(&text[begin..]);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(primitive: Primitive, text: &str) -> Option<Literal> {
        let element: Element<()> = Element::Primitive(primitive);
        Literal::of_default(&FieldType { element, arity: Arity::One }, text)
    }

    #[test]
    fn numbers_fit_their_types() {
        assert_eq!(of(Primitive::Int8, "-128"), Some(Literal::Integer(-128)));
        assert_eq!(
            of(Primitive::Uint64, "18446744073709551615"),
            Some(Literal::Integer(u64::MAX.into()))
        );
        assert_eq!(of(Primitive::Int32, "0x10"), Some(Literal::Integer(16)));
        assert_eq!(of(Primitive::Float32, "1e3"), Some(Literal::Float(1000.0)));
        assert_eq!(of(Primitive::Bool, "True"), Some(Literal::Bool(true)));
        for (primitive, text) in [
            (Primitive::Int8, "128"),
            (Primitive::Uint8, "-1"),
            (Primitive::Uint64, "18446744073709551616"),
            (Primitive::Int64, "1.5"),
            (Primitive::Int64, "--1"),
            (Primitive::Int64, "0x-1"),
            (Primitive::Int64, ""),
            (Primitive::Float64, "one"),
            (Primitive::Bool, "yes"),
        ] {
            assert_eq!(of(primitive, text), None, "{primitive:?} {text}");
        }
    }

    #[test]
    fn lists_and_quotes_are_read() {
        let any = Arity::Sequence { bound: None };
        let texts =
            FieldType::<()> { element: Element::Text { is_wide: false, bound: None }, arity: any };
        let text = |text: &str| Literal::Text(text.to_owned());
        let list = Literal::of_default(&texts, r#"["a, b", 'it\'s', ""]"#);
        assert_eq!(list, Some(Literal::List(vec![text("a, b"), text("it's"), text("")])));
        assert_eq!(Literal::of_default(&texts, "[]"), Some(Literal::List(Vec::new())));
        for wrong in ["[a]", "[\"a\"", "\"a\"", "[\"a\",]", "[\"a\"b\"]"] {
            assert_eq!(Literal::of_default(&texts, wrong), None, "{wrong}");
        }
    }
}
