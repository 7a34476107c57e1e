//! Bytes of messages: what is written is read back, and nothing else is taken for a message.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod random;

use std::sync::{Arc, LazyLock};

use muster_ros::cdr::{MAX_MESSAGE_BYTES, decode, encode};
use muster_ros::definition::{Arity, Element};
use muster_ros::{ByteOrder, Catalog, CdrError, Layout, TypeName, Value};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const ORDERS: [ByteOrder; 2] = [ByteOrder::Little, ByteOrder::Big];

/// Every form that a field can have.
const FORMS: &str = "bool flag\nbyte raw\nint8 a\nuint8 b\nint16 c\nuint16 d\nint32 e\nuint32 f\nint64 g\nuint64 h\n\
     float32 i\nfloat64 j\nstring k\nwstring l\nstring<=3 m\nwstring<=3 n\nbool[3] o\nuint8[3] p\nbyte[] q\n\
     float64[] r\nfloat64[2] s\nint16[<=2] t\nstring[] u\nwstring[] v\nstring<=4[<=2] w\nEmpty x\nEmpty[] y\n\
     geometry_msgs/Point[] z\nbool last";

static LAYOUTS: LazyLock<Vec<Arc<Layout>>> = LazyLock::new(|| {
    let mut catalog = Catalog::standard();
    catalog.add(&TypeName::parse("a/Forms").unwrap(), FORMS).unwrap();
    catalog.add(&TypeName::parse("a/Empty").unwrap(), "").unwrap();
    catalog.types().map(|name| catalog.layout(name).unwrap()).collect()
});

fn layout(text: &str) -> Arc<Layout> {
    let mut catalog = Catalog::standard();
    let name = TypeName::parse("a/A").unwrap();
    catalog.add(&name, text).unwrap();
    catalog.layout(&name).unwrap()
}

#[test]
fn what_is_written_is_read_back_in_both_orders() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for layout in LAYOUTS.iter() {
        for _ in 0..50 {
            let value = random::message(layout, &mut random);
            for order in ORDERS {
                let bytes = encode(layout, &value, order).unwrap();
                assert_eq!(decode(layout, &bytes).as_ref(), Ok(&value), "{}", layout.name());
            }
        }
        assert!(encode(layout, &layout.initial(), ByteOrder::Little).is_ok());
    }
}

#[test]
fn every_truncation_is_an_error() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for layout in LAYOUTS.iter() {
        for order in ORDERS {
            let bytes = encode(layout, &random::message(layout, &mut random), order).unwrap();
            for length in 0..bytes.len() {
                let error = decode(layout, &bytes[..length]).unwrap_err();
                let is_expected = matches!(error, CdrError::Short(_) | CdrError::Count { .. });
                assert!(is_expected, "{} of {} bytes: {error}", length, bytes.len());
            }
        }
    }
}

#[test]
fn bytes_that_follow_are_padding_or_another_type() {
    let layout = layout("uint8 x");
    let bytes = encode(&layout, &layout.initial(), ByteOrder::Little).unwrap();
    for (more, is_read) in [(0, true), (3, true), (4, false)] {
        let bytes = [bytes.clone(), vec![0; more]].concat();
        assert_eq!(decode(&layout, &bytes).is_ok(), is_read, "{more}");
    }
}

#[test]
fn numbers_stand_at_multiples_of_their_size() {
    let layout =
        layout("uint8 a\nfloat64 b\nuint8 c\nuint16 d\nuint8 e\nuint32 f\nfloat64[] g\nuint8 h");
    let mut value = layout.initial();
    let Value::Struct(fields) = &mut value else { panic!("{value:?}") };
    fields[1] = Value::F64(1.0);
    fields[3] = Value::Uint(0x0102);
    let little = encode(&layout, &value, ByteOrder::Little).unwrap();
    assert_eq!(
        little.len(),
        4 + 8 + 8 + 4 + 4 + 4 + 4 + 1,
        "an empty sequence aligns nothing behind it"
    );
    assert_eq!(little[4 + 8..4 + 16], 1.0_f64.to_le_bytes());
    assert_eq!(little[4 + 18..4 + 20], [2, 1]);
    let big = encode(&layout, &value, ByteOrder::Big).unwrap();
    assert_eq!((big[1], &big[4 + 18..4 + 20]), (0, &[1, 2][..]));
}

#[test]
fn lengths_are_checked_before_they_are_believed() {
    let many = u32::MAX.to_le_bytes();
    for text in ["float64[] x", "string x", "wstring x", "uint8[] x", "string[] x", "a/B[] x"] {
        let mut catalog = Catalog::default();
        let name = TypeName::parse("a/A").unwrap();
        catalog.add(&name, text).unwrap();
        catalog.add(&TypeName::parse("a/B").unwrap(), "bool x").unwrap();
        let layout = catalog.layout(&name).unwrap();
        let bytes = [&[0, 1, 0, 0][..], &many, &[0; 16]].concat();
        assert!(decode(&layout, &bytes).is_err(), "{text}");
    }
    let layout = layout("uint8[] x");
    let long = vec![0; MAX_MESSAGE_BYTES + 1];
    assert_eq!(decode(&layout, &long), Err(CdrError::TooLong(MAX_MESSAGE_BYTES + 1)));
    let value = Value::Struct(vec![Value::Bytes(vec![0; MAX_MESSAGE_BYTES])]);
    assert!(matches!(encode(&layout, &value, ByteOrder::Big), Err(CdrError::TooLong(_))));
}

#[test]
fn errors_name_the_field() {
    let layout = layout("geometry_msgs/TransformStamped[] all\nbool[2] flags\nstring<=2 short");
    let stamped = Catalog::standard();
    let stamped =
        stamped.layout(&TypeName::parse("geometry_msgs/TransformStamped").unwrap()).unwrap();
    let good = Value::Struct(vec![
        Value::List(vec![stamped.initial()]),
        Value::List(vec![Value::Bool(true), Value::Bool(false)]),
        Value::from("é"),
    ]);
    let bytes = encode(&layout, &good, ByteOrder::Little).unwrap();
    let text = |bytes: &[u8]| decode(&layout, bytes).unwrap_err().to_string();
    assert_eq!(
        text(&bytes[..91]),
        "all[0].transform.rotation.w: the bytes end before the message does"
    );
    let flags = bytes.windows(2).rposition(|pair| pair == [1, 0]).unwrap();
    let changed = |at: usize, byte: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = byte;
        bytes
    };
    assert_eq!(text(&changed(flags, 2)), "flags[0]: this is no bool");
    let short = bytes.len() - 3;
    for (at, byte) in [(short, b'a'), (short + 2, b'a'), (short - 4, 9)] {
        assert!(text(&changed(at, byte)).starts_with("short: "), "{at}");
    }
    assert!(text(&changed(1, 3)).starts_with("the bytes begin with"));
    let with = |number: usize, value: Value| {
        let mut wrong = good.clone();
        let Value::Struct(fields) = &mut wrong else { panic!("{wrong:?}") };
        fields[number] = value;
        encode(&layout, &wrong, ByteOrder::Little).unwrap_err().to_string()
    };
    assert!(with(1, Value::List(vec![Value::Bool(true)])).starts_with("flags: "));
    assert!(with(1, Value::List(vec![Value::Bool(true), Value::Int(1)])).starts_with("flags[1]: "));
    assert!(with(2, Value::from("abc")).starts_with("short: "));
    assert!(with(0, Value::Bytes(vec![0])).starts_with("all: "));
}

#[test]
fn whole_numbers_are_written_only_where_they_fit() {
    let layout = layout("int8 x\nuint64 y");
    let written = |x: Value, y: Value| {
        encode(&layout, &Value::Struct(vec![x, y]), ByteOrder::Big)
            .map_err(|error| error.to_string())
    };
    assert!(written(Value::Uint(127), Value::Int(5)).is_ok(), "the sign of the type decides");
    for (x, y) in [(128, 0), (-129, 0), (0, -1)] {
        assert!(written(Value::Int(x), Value::Int(y)).is_err(), "{x} {y}");
    }
}

/// Whether a float that is no number stands anywhere: it is not equal to itself.
fn has_floats(layout: &Layout) -> bool {
    layout.fields().iter().any(|field| match &field.kind.element {
        Element::Nested(nested) => has_floats(nested),
        Element::Primitive(primitive) => format!("{primitive:?}").starts_with("Float"),
        Element::Text { .. } => false,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn no_bytes_are_taken_for_what_they_are_not(
        number in any::<prop::sample::Index>(),
        order in 0..2_u8,
        mut bytes in prop::collection::vec(prop_oneof![Just(0), Just(1), any::<u8>()], 4..400),
    ) {
        let layout = number.get(&LAYOUTS);
        bytes[..2].copy_from_slice(&[0, order]);
        if let Ok(value) = decode(layout, &bytes) {
            for order in ORDERS {
                let written = encode(layout, &value, order).unwrap();
                prop_assert!(written.len() <= bytes.len() + 4 * count_texts(&value));
                let again = decode(layout, &written).unwrap();
                prop_assert!(again == value || has_floats(layout));
            }
        }
    }
}

/// How many strings there are: an empty one may come without its zero, and is written with it.
fn count_texts(value: &Value) -> usize {
    match value {
        Value::Text(_) => 1,
        Value::List(values) | Value::Struct(values) => values.iter().map(count_texts).sum(),
        _ => 0,
    }
}

#[test]
fn the_random_messages_meet_every_form() {
    let forms = LAYOUTS.iter().find(|layout| layout.name().name() == "Forms").unwrap();
    let arities: Vec<_> = forms.fields().iter().map(|field| field.kind.arity).collect();
    assert!(
        arities.contains(&Arity::Array(3)) && arities.contains(&Arity::Sequence { bound: Some(2) })
    );
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let values: Vec<_> = (0..50).map(|_| random::message(forms, &mut random)).collect();
    let has = |test: fn(&Value) -> bool| {
        values.iter().any(|value| matches!(value, Value::Struct(fields) if fields.iter().any(test)))
    };
    assert!(has(|value| matches!(value, Value::Text(text) if !text.is_ascii())));
    assert!(has(|value| matches!(value, Value::List(values) if values.is_empty())));
    assert!(has(|value| matches!(value, Value::Bytes(bytes) if bytes.len() > 3)));
}
