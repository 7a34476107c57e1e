//! What ROS 2 puts on a bus: keys, tokens, attachments, definitions and CDR.

use std::sync::{Arc, LazyLock};

use muster_ros::cdr::{decode, encode};
use muster_ros::key::parse_dds_key;
use muster_ros::{
    Attachment, ByteOrder, Catalog, Layout, Path, Token, TopicKey, TypeHash, TypeName, Value,
};

use crate::{Outcome, allocation, text};

/// Longest error, in characters: it may name all fields of a type.
const MAX_ERROR: usize = 4096;

/// Memory per byte of a message: each may be a value of 32 bytes in a list of its own.
const BYTES_PER_BYTE: usize = 128;

/// Memory beyond: what fixed arrays of the built-in types hold.
const BASE_BYTES: usize = 1 << 20;

/// The built-in types.
static LAYOUTS: LazyLock<Vec<Arc<Layout>>> = LazyLock::new(|| {
    let catalog = Catalog::standard();
    catalog.types().map(|name| catalog.layout(name).unwrap()).collect()
});

/// In one byte what is read, and the bytes of it.
pub(crate) fn ros(data: &[u8]) -> Outcome {
    let Some((what, bytes)) = data.split_first() else { return Outcome::Refused };
    let given = String::from_utf8_lossy(bytes);
    match what {
        b'k' => written(TopicKey::parse(&given), &given),
        b'd' => Outcome::accepted_if(parse_dds_key(&given).is_ok()),
        b't' => written(Token::parse(&given), &given),
        b'p' => written(given.parse::<Path>(), &given),
        b'a' => attachment(bytes),
        b'm' => definition(&given),
        what => message(usize::from(*what), bytes),
    }
}

/// What is read is written as it was.
fn written<T: ToString, E: std::error::Error>(read: Result<T, E>, given: &str) -> Outcome {
    match read {
        Ok(value) => {
            // Numbers of a path may have zeros before them, and a quality of service its defaults.
            let again = value.to_string();
            assert!(again.len() <= given.len(), "{given:?} is written as {again:?}");
            Outcome::Accepted
        }
        Err(error) => {
            text::check(&error.to_string(), MAX_ERROR);
            Outcome::Refused
        }
    }
}

fn attachment(bytes: &[u8]) -> Outcome {
    let read = Attachment::parse(bytes);
    if let Ok(attachment) = read {
        assert_eq!(attachment.to_bytes().as_slice(), bytes);
    }
    Outcome::accepted_if(read.is_ok())
}

/// The text of definitions. What has a layout has a hash, and a first message that is read back.
fn definition(given: &str) -> Outcome {
    let mut catalog = Catalog::standard();
    let name = TypeName::new("own_msgs", "Own").unwrap();
    if let Err(error) = catalog.add(&name, given) {
        text::check(&error.to_string(), MAX_ERROR);
        return Outcome::Refused;
    }
    let layout = match catalog.layout(&name) {
        Ok(layout) => layout,
        Err(error) => {
            text::check(&error.to_string(), MAX_ERROR);
            return Outcome::Refused;
        }
    };
    assert_ne!(TypeHash::of(&layout), TypeHash::NotSupported);
    if let Ok(bytes) = encode(&layout, &layout.initial(), ByteOrder::Big) {
        assert!(decode(&layout, &bytes).is_ok(), "{given}");
    }
    Outcome::Accepted
}

/// A message of a built-in type. What is read is written and read back as the same.
fn message(number: usize, bytes: &[u8]) -> Outcome {
    let layout = &LAYOUTS[number % LAYOUTS.len()];
    let limit = BYTES_PER_BYTE * bytes.len() + BASE_BYTES;
    let value: Value = match allocation::at_most(limit, "reading CDR", || decode(layout, bytes)) {
        Ok(value) => value,
        Err(error) => {
            text::check(&error.to_string(), MAX_ERROR);
            return Outcome::Refused;
        }
    };
    for order in [ByteOrder::Little, ByteOrder::Big] {
        let again = encode(layout, &value, order).unwrap();
        let read = decode(layout, &again).unwrap();
        assert_eq!(encode(layout, &read, order).unwrap(), again);
    }
    Outcome::Accepted
}

/// Seeds: one of each, and a message of each built-in type.
pub(crate) fn seeds() -> Vec<(String, Vec<u8>)> {
    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    let key = format!("k0/r1/chatter/std_msgs::msg::dds_::String_/{HASH}");
    let token = format!(
        "t@ros2_lv/0/9ad20db4c929c8189ca587de2f90c2e2/0/4/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/{HASH}/:1:,10:,:,:,,"
    );
    let separator = "=".repeat(80);
    let definition = format!(
        "mint32 A=7\nstring<=5 s \"a b\" # c\nfloat64[3] x [1, 2.5, -3]\nLink[<=2] links\n{separator}\nMSG: own_msgs/Link\n\
         wstring w\nuint8[] data\ngeometry_msgs/Pose pose"
    );
    let attachment =
        [b"a\x15\0\0\0\0\0\0\0\x58\xd1\xb2\x4c\xf9\xa2\xdc\x18\x10", [7; 16].as_slice()];
    let mut seeds = vec![
        ("key".to_owned(), key.into_bytes()),
        ("key-dds".to_owned(), b"dr1/odom".to_vec()),
        ("token".to_owned(), token.into_bytes()),
        ("path".to_owned(), b"plinks[1].pose.position.x".to_vec()),
        ("definition".to_owned(), definition.into_bytes()),
        ("attachment".to_owned(), attachment.concat()),
    ];
    for (number, layout) in (0_u8..).zip(LAYOUTS.iter()) {
        let bytes = encode(layout, &layout.initial(), ByteOrder::Little).unwrap();
        seeds.push((format!("message-{number}"), [&[number], &bytes[..]].concat()));
    }
    seeds
}
