//! Random messages of any type, from a seed.

use muster_ros::definition::{Arity, Element, FieldType, Primitive};
use muster_ros::{Layout, Value};
use rand::{Rng, RngExt};

/// Most values of a sequence without a bound, and characters of a string.
const LONGEST: usize = 4;

/// Characters of one to four bytes, so that each length is met.
const CHARACTERS: [char; 7] = ['a', 'Z', '/', '_', 'é', '€', '𝄞'];

/// A message with random values in every field.
pub(crate) fn message(layout: &Layout, random: &mut impl Rng) -> Value {
    Value::Struct(layout.fields().iter().map(|field| value(&field.kind, random)).collect())
}

fn value(kind: &FieldType<std::sync::Arc<Layout>>, random: &mut impl Rng) -> Value {
    let count = match kind.arity {
        Arity::One => return element(&kind.element, random),
        Arity::Array(length) => length as usize,
        Arity::Sequence { bound } => {
            random.random_range(0..=bound.map_or(LONGEST, |bound| LONGEST.min(bound as usize)))
        }
    };
    if let Element::Primitive(Primitive::Uint8 | Primitive::Byte) = kind.element {
        return Value::Bytes((0..count).map(|_| random.random()).collect());
    }
    Value::List((0..count).map(|_| element(&kind.element, random)).collect())
}

fn element(element: &Element<std::sync::Arc<Layout>>, random: &mut impl Rng) -> Value {
    let primitive = match element {
        Element::Nested(layout) => return message(layout, random),
        Element::Text { bound, .. } => return Value::Text(text(*bound, random)),
        Element::Primitive(primitive) => *primitive,
    };
    match primitive {
        Primitive::Bool => Value::Bool(random.random()),
        Primitive::Int8 => Value::Int(random.random::<i8>().into()),
        Primitive::Int16 => Value::Int(random.random::<i16>().into()),
        Primitive::Int32 => Value::Int(random.random::<i32>().into()),
        Primitive::Int64 => Value::Int(random.random()),
        Primitive::Byte | Primitive::Uint8 => Value::Uint(random.random::<u8>().into()),
        Primitive::Uint16 => Value::Uint(random.random::<u16>().into()),
        Primitive::Uint32 => Value::Uint(random.random::<u32>().into()),
        Primitive::Uint64 => Value::Uint(random.random()),
        // Over many magnitudes; never a NaN, which is not equal to itself.
        Primitive::Float32 => Value::F32(random.random_range(-1e6_f32..1e6)),
        Primitive::Float64 => {
            Value::F64(random.random_range(-1.0..1.0) * 10_f64.powi(random.random_range(-30..30)))
        }
    }
}

fn text(bound: Option<u32>, random: &mut impl Rng) -> String {
    let most = bound.map_or(16, |bound| bound as usize);
    let mut text = String::new();
    for _ in 0..random.random_range(0..=LONGEST) {
        let next = CHARACTERS[random.random_range(0..CHARACTERS.len())];
        if text.len() + next.len_utf8() <= most {
            text.push(next);
        }
    }
    text
}
