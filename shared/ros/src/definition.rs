//! The `.msg` text of a message type: what it says, line by line. Types that it names are not looked up here.

use crate::literal::Literal;
use crate::name::{NameError, TypeName, check_identifier};

/// Longest text of definitions in bytes: those of all messages of ROS together have as many.
pub const MAX_TEXT_BYTES: usize = 256 * 1024;

/// Most fields of one type. The largest of the standard messages has 20.
pub const MAX_FIELDS: usize = 1024;

/// Most elements of an array, and of a sequence or string that has a bound.
pub const MAX_LENGTH: u32 = 1 << 20;

/// How many `=` at least separate definitions that stand in one text. ROS writes 80.
const SEPARATOR_LENGTH: usize = 79;

/// A type without parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Primitive {
    /// `bool`.
    Bool,
    /// `byte`, eight bits without a meaning.
    Byte,
    /// `int8`.
    Int8,
    /// `uint8`, or `char`, which is the same in ROS 2.
    Uint8,
    /// `int16`.
    Int16,
    /// `uint16`.
    Uint16,
    /// `int32`.
    Int32,
    /// `uint32`.
    Uint32,
    /// `int64`.
    Int64,
    /// `uint64`.
    Uint64,
    /// `float32`.
    Float32,
    /// `float64`.
    Float64,
}

impl Primitive {
    fn of_name(name: &str) -> Option<Self> {
        Some(match name {
            "bool" => Self::Bool,
            "byte" => Self::Byte,
            "int8" => Self::Int8,
            "uint8" | "char" => Self::Uint8,
            "int16" => Self::Int16,
            "uint16" => Self::Uint16,
            "int32" => Self::Int32,
            "uint32" => Self::Uint32,
            "int64" => Self::Int64,
            "uint64" => Self::Uint64,
            "float32" => Self::Float32,
            "float64" => Self::Float64,
            _ => return None,
        })
    }

    /// How many bytes a value has, which is also what its place is a multiple of.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::Bool | Self::Byte | Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 => 8,
        }
    }
}

/// What one value of a field is. `N` stands for another message type: its name, or its layout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Element<N> {
    /// A value without parts.
    Primitive(Primitive),
    /// A string, or a wide one of UTF-16.
    Text {
        /// Whether it is a `wstring`.
        is_wide: bool,
        /// Most characters; none: as many as one likes.
        bound: Option<u32>,
    },
    /// Another message.
    Nested(N),
}

/// How many values a field has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arity {
    /// One.
    One,
    /// So many, always.
    Array(u32),
    /// As many as the message says.
    Sequence {
        /// Most of them; none: as many as one likes.
        bound: Option<u32>,
    },
}

/// The type of a field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldType<N> {
    /// What each value is.
    pub element: Element<N>,
    /// How many values there are.
    pub arity: Arity,
}

/// A field as its definition has it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FieldDefinition {
    pub(crate) name: String,
    pub(crate) kind: FieldType<TypeName>,
    /// What it is where a program sets nothing.
    pub(crate) default: Option<Literal>,
}

/// A message type as its text defines it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Definition {
    pub(crate) name: TypeName,
    pub(crate) fields: Vec<FieldDefinition>,
    /// Names and values of its constants.
    pub(crate) constants: Vec<(String, Literal)>,
}

/// What is wrong with a line of a definition.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LineError {
    /// There is a type without a name.
    #[error("a line has a type and a name")]
    Name,
    /// A name breaks the rule.
    #[error(transparent)]
    Identifier(#[from] NameError),
    /// A bound or length is none.
    #[error("a length is a whole number from 1 to {MAX_LENGTH}")]
    Length,
    /// Brackets or bounds stand where none may.
    #[error("a type has the form TYPE, TYPE[], TYPE[N] or TYPE[<=N], and string may be string<=N")]
    Form,
    /// A value is none of its type.
    #[error("the value is none of this type")]
    Value,
    /// The type has a field or constant of this name already.
    #[error("the name stands there twice")]
    Twice,
    /// The type has too many fields.
    #[error("a type may have at most {MAX_FIELDS} fields and constants")]
    TooMany,
    /// A separator is followed by something else than the name of a type.
    #[error("after a line of = stands MSG: PACKAGE/TYPE; IDL is not read")]
    Separator,
}

/// Why a text defines no message type.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DefinitionError {
    /// The text is longer than [`MAX_TEXT_BYTES`].
    #[error("definitions may have at most {MAX_TEXT_BYTES} bytes, these have {0}")]
    TooLong(usize),
    /// A line is wrong.
    #[error("line {line}: {problem}")]
    Line {
        /// Its number, from 1.
        line: usize,
        /// What is wrong.
        problem: LineError,
    },
}

/// Reads the text of a type, and of the types that follow in it after separators.
///
/// # Errors
/// Names the line.
pub(crate) fn parse(name: &TypeName, text: &str) -> Result<Vec<Definition>, DefinitionError> {
    if text.len() > MAX_TEXT_BYTES {
        return Err(DefinitionError::TooLong(text.len()));
    }
    let empty = |name| Definition { name, fields: Vec::new(), constants: Vec::new() };
    let mut done = Vec::new();
    let mut current = empty(name.clone());
    let mut after_separator = false;
    for (number, line) in text.lines().enumerate() {
        let wrong = |problem| DefinitionError::Line { line: number + 1, problem };
        let line = without_comment(line).trim();
        if line.is_empty() {
            continue;
        }
        if line.len() >= SEPARATOR_LENGTH && line.bytes().all(|byte| byte == b'=') {
            after_separator = true;
        } else if after_separator {
            let name = line.strip_prefix("MSG:").ok_or(wrong(LineError::Separator))?.trim();
            let name = TypeName::parse(name).map_err(|error| wrong(error.into()))?;
            done.push(std::mem::replace(&mut current, empty(name)));
            after_separator = false;
        } else {
            current.add_line(line).map_err(wrong)?;
        }
    }
    done.push(current);
    Ok(done)
}

/// The part of a line before `#`. One in quotes is part of a value.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    let mut escaped = false;
    for (at, c) in line.char_indices() {
        match (c, quote) {
            _ if escaped => escaped = false,
            ('\\', Some(_)) => escaped = true,
            ('"' | '\'', None) => quote = Some(c),
            (c, Some(open)) if c == open => quote = None,
            ('#', None) => return &line[..at],
            _ => {}
        }
    }
    // An apostrophe of a comment is no quote: one that never closes does not count.
    if quote.is_some() { line.split('#').next().unwrap_or_default() } else { line }
}

impl Definition {
    fn add_line(&mut self, line: &str) -> Result<(), LineError> {
        if self.fields.len() + self.constants.len() >= MAX_FIELDS {
            return Err(LineError::TooMany);
        }
        let (kind, rest) = line.split_once(char::is_whitespace).ok_or(LineError::Name)?;
        let kind = self.parse_type(kind)?;
        let rest = rest.trim_start();
        let end = rest.find(|c: char| c.is_whitespace() || c == '=').unwrap_or(rest.len());
        let (name, rest) = rest.split_at(end);
        check_identifier(name)?;
        if self.fields.iter().any(|field| field.name == name)
            || self.constants.iter().any(|(other, _)| other == name)
        {
            return Err(LineError::Twice);
        }
        let rest = rest.trim_start();
        if let Some(value) = rest.strip_prefix('=') {
            let value = Literal::of_constant(&kind, value.trim()).ok_or(LineError::Value)?;
            self.constants.push((name.to_owned(), value));
            return Ok(());
        }
        let default = match rest {
            "" => None,
            text => Some(Literal::of_default(&kind, text).ok_or(LineError::Value)?),
        };
        self.fields.push(FieldDefinition { name: name.to_owned(), kind, default });
        Ok(())
    }

    fn parse_type(&self, text: &str) -> Result<FieldType<TypeName>, LineError> {
        let (element, arity) = match text.split_once('[') {
            None => (text, Arity::One),
            Some((element, length)) => {
                let length = length.strip_suffix(']').ok_or(LineError::Form)?;
                let arity = match (length, length.strip_prefix("<=")) {
                    ("", _) => Arity::Sequence { bound: None },
                    (_, Some(bound)) => Arity::Sequence { bound: Some(parse_length(bound)?) },
                    _ => Arity::Array(parse_length(length)?),
                };
                (element, arity)
            }
        };
        Ok(FieldType { element: self.parse_element(element)?, arity })
    }

    fn parse_element(&self, text: &str) -> Result<Element<TypeName>, LineError> {
        let (name, bound) = match text.split_once("<=") {
            Some((name, bound)) => (name, Some(parse_length(bound)?)),
            None => (text, None),
        };
        if let "string" | "wstring" = name {
            return Ok(Element::Text { is_wide: name == "wstring", bound });
        }
        if bound.is_some() {
            return Err(LineError::Form);
        }
        if let Some(primitive) = Primitive::of_name(name) {
            return Ok(Element::Primitive(primitive));
        }
        let name = match name {
            // The one type that is named without its package everywhere.
            "Header" => TypeName::new("std_msgs", name)?,
            _ if name.contains('/') => TypeName::parse(name)?,
            _ => TypeName::new(self.name.package(), name)?,
        };
        Ok(Element::Nested(name))
    }
}

fn parse_length(text: &str) -> Result<u32, LineError> {
    let length: u32 = text.parse().map_err(|_| LineError::Length)?;
    if (1..=MAX_LENGTH).contains(&length) { Ok(length) } else { Err(LineError::Length) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_all(text: &str) -> Result<Vec<Definition>, DefinitionError> {
        parse(&TypeName::parse("own_msgs/msg/Own").unwrap(), text)
    }

    fn problem(text: &str) -> LineError {
        match parse_all(text) {
            Err(DefinitionError::Line { line, problem }) => {
                assert_eq!(line, text.lines().count(), "{text}");
                problem
            }
            other => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn every_form_of_a_field_is_read() {
        let text = "# A comment, it's one\n\n\
            bool flag\n\
            \tfloat64\t x 1.5 # metres\n\
            char letter\n\
            byte[] raw\n\
            uint8[4] bytes [1, 2, 3, 4]\n\
            int16[<=3] few\n\
            string name \"a # b\"\n\
            string<=5[<=2] short\n\
            wstring wide\n\
            Header header\n\
            Own2[] more\n\
            geometry_msgs/Point at\n\
            geometry_msgs/msg/Point[2] ends\n\
            int32 LARGEST=7\n\
            string WORD= 'it is' \n";
        let own = parse_all(text).unwrap().pop().unwrap();
        let nested = |name: &str| Element::Nested(TypeName::parse(name).unwrap());
        let primitive = Element::Primitive;
        let (one, any) = (Arity::One, Arity::Sequence { bound: None });
        let bounded = |bound| Arity::Sequence { bound: Some(bound) };
        let text = |is_wide, bound| Element::Text { is_wide, bound };
        let expected = [
            ("flag", primitive(Primitive::Bool), one),
            ("x", primitive(Primitive::Float64), one),
            ("letter", primitive(Primitive::Uint8), one),
            ("raw", primitive(Primitive::Byte), any),
            ("bytes", primitive(Primitive::Uint8), Arity::Array(4)),
            ("few", primitive(Primitive::Int16), bounded(3)),
            ("name", text(false, None), one),
            ("short", text(false, Some(5)), bounded(2)),
            ("wide", text(true, None), one),
            ("header", nested("std_msgs/Header"), one),
            ("more", nested("own_msgs/Own2"), any),
            ("at", nested("geometry_msgs/Point"), one),
            ("ends", nested("geometry_msgs/Point"), Arity::Array(2)),
        ];
        assert_eq!(own.fields.len(), expected.len());
        for (field, (name, element, arity)) in own.fields.iter().zip(expected) {
            assert_eq!(field.name, name);
            assert_eq!(field.kind, FieldType { element, arity }, "{name}");
        }
        assert_eq!(own.fields[1].default, Some(Literal::Float(1.5)));
        assert_eq!(own.fields[6].default, Some(Literal::Text("a # b".to_owned())));
        assert_eq!(own.constants[0], ("LARGEST".to_owned(), Literal::Integer(7)));
        assert_eq!(own.constants[1], ("WORD".to_owned(), Literal::Text("it is".to_owned())));
    }

    #[test]
    fn several_definitions_stand_in_one_text() {
        let line = "=".repeat(80);
        let text =
            format!("A a\n{line}\nMSG: own_msgs/A\nint32 x\n{line}\nMSG: b_msgs/msg/B\nA a\n");
        let found = parse_all(&text).unwrap();
        let names: Vec<_> = found.iter().map(|one| one.name.to_string()).collect();
        assert_eq!(names, ["own_msgs/msg/Own", "own_msgs/msg/A", "b_msgs/msg/B"]);
        let nested = Element::Nested(TypeName::parse("b_msgs/A").unwrap());
        assert_eq!(found[2].fields[0].kind.element, nested, "in the package of its own definition");
        assert_eq!(problem(&format!("{line}\nIDL: a/b")), LineError::Separator);
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, expected) in [
            ("int32", LineError::Name),
            ("int32 x\nint32 x", LineError::Twice),
            ("int32 x\nint32 x=1", LineError::Twice),
            ("int32 1x", LineError::Identifier(NameError::Identifier)),
            ("a/b/c x", LineError::Identifier(NameError::Type)),
            ("int32[ x", LineError::Form),
            ("int32[3]] x", LineError::Length),
            ("int32[0] x", LineError::Length),
            ("int32[-1] x", LineError::Length),
            ("int32[<=1048577] x", LineError::Length),
            ("int32<=4 x", LineError::Form),
            ("string<=x y", LineError::Length),
            ("uint8 x 256", LineError::Value),
            ("bool x=2", LineError::Value),
            ("Other x=2", LineError::Value),
            ("int32[2] x [1]", LineError::Value),
            ("string<=2 s \"abc\"", LineError::Value),
        ] {
            assert_eq!(problem(text), expected, "{text}");
        }
        let many: String = (0..=MAX_FIELDS).map(|i| format!("bool b{i}\n")).collect();
        assert_eq!(problem(&many), LineError::TooMany);
        let long = " ".repeat(MAX_TEXT_BYTES + 1);
        assert_eq!(parse_all(&long), Err(DefinitionError::TooLong(MAX_TEXT_BYTES + 1)));
    }
}
