//! The attachment that numbers the messages of a publisher of `rmw_zenoh`.
//!
//! `rmw_zenoh` drops a message without one. Its 33 bytes are a sequence number from 1, the nanoseconds since 1970 by
//! the publisher's clock, both little-endian, the length 16, and the [`Gid`] (`attachment_helpers.cpp` of
//! `ros2/rmw_zenoh`).

use std::fmt;

use twox_hash::XxHash3_128;

/// How many bytes an attachment has.
pub const ATTACHMENT_BYTES: usize = 33;

/// How many bytes a [`Gid`] has.
const GID_BYTES: usize = 16;

/// Names a publisher, for as long as its process lives: the hash of the key of its liveliness token, which holds the
/// id of the session. A publisher that starts again has another one.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Gid(pub [u8; GID_BYTES]);

impl Gid {
    /// That of the publisher whose liveliness token stands at a key: XXH3 with 128 bits, the low half first.
    #[must_use]
    pub fn of_token(key: &str) -> Self {
        Self(XxHash3_128::oneshot(key.as_bytes()).to_le_bytes())
    }
}

/// Hexadecimal digits.
impl fmt::Display for Gid {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(formatter, "{byte:02x}"))
    }
}

impl fmt::Debug for Gid {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Gid({self})")
    }
}

/// Which message of which publisher this is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attachment {
    /// Grows by one with each message of the publisher, from 1.
    pub sequence: i64,
    /// Nanoseconds since 1970 by the publisher's clock.
    pub stamp_ns: i64,
    /// The publisher.
    pub gid: Gid,
}

/// The bytes are no attachment of `rmw_zenoh`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "an attachment of rmw_zenoh has {ATTACHMENT_BYTES} bytes with a 16 before the last 16; this has {size} bytes"
)]
pub struct AttachmentError {
    /// How many bytes there are.
    pub size: usize,
}

impl Attachment {
    /// The bytes that travel with the message.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; ATTACHMENT_BYTES] {
        let mut bytes = [0; ATTACHMENT_BYTES];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.stamp_ns.to_le_bytes());
        bytes[16] = GID_BYTES as u8;
        bytes[17..].copy_from_slice(&self.gid.0);
        bytes
    }

    /// Reads the bytes.
    ///
    /// # Errors
    /// If they have another length or form.
    pub fn parse(bytes: &[u8]) -> Result<Self, AttachmentError> {
        let fail = AttachmentError { size: bytes.len() };
        let (sequence, rest) = bytes.split_first_chunk().ok_or(fail)?;
        let (stamp, rest) = rest.split_first_chunk().ok_or(fail)?;
        let (length, gid) = rest.split_first().ok_or(fail)?;
        let gid: [u8; GID_BYTES] = gid.try_into().map_err(|_| fail)?;
        if usize::from(*length) != GID_BYTES {
            return Err(fail);
        }
        let (sequence, stamp_ns) = (i64::from_le_bytes(*sequence), i64::from_le_bytes(*stamp));
        Ok(Self { sequence, stamp_ns, gid: Gid(gid) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tokens of publishers, and an attachment of each: the first two by `rmw_zenoh` 0.2.11 of Jazzy, the third by
    /// 0.10.6 of Lyrical.
    const CAPTURED: [(&str, &str, i64); 3] = [
        (
            "@ros2_lv/0/45000cc3452ec777e9664270c90b5af/0/4/MP/%/%/p_be/%q_best_effort/std_msgs::msg::dds_::String_/\
             RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/2::,10:,:,:,,",
            "150000000000000058d1b24cf9a2dc1810a4461b1ae3b3b1de4a54c9c5e9e88fd0",
            21,
        ),
        (
            "@ros2_lv/7/6977b59f87229328a8d406ad77b301a6/0/11/MP/%/%cell4/gw/%cell4%chatter/\
             std_msgs::msg::dds_::String_/\
             RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,",
            "1a00000000000000699e1332f9a2dc1810b7aef695b2cd04ba45f9eed0c4a6c584",
            26,
        ),
        (
            "@ros2_lv/0/1cdcdbd45bbff59f7a7a50283650fb64/0/10/MP/%/%/talker/%chatter/\
             example_interfaces::msg::dds_::String_/\
             RIHS01_5509d866a579951f2fc6c19577c32605ba16f308cae7b498341d79536d4eb06b/::,7:,:,:,,",
            "170000000000000007565979dda2dc181043fbe3d3dcfb9659b7a82d4478c8eca0",
            23,
        ),
    ];

    fn bytes(hex: &str) -> Vec<u8> {
        hex.as_bytes()
            .chunks(2)
            .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
            .collect()
    }

    #[test]
    fn captured_attachments_hold_the_gid_of_their_token_and_are_written_alike() {
        for (token, hex, sequence) in CAPTURED {
            let captured = bytes(hex);
            let attachment = Attachment::parse(&captured).unwrap();
            assert_eq!(attachment.sequence, sequence);
            assert_eq!(attachment.gid, Gid::of_token(token));
            assert_eq!(attachment.to_bytes().as_slice(), captured);
            // In the year 2026.
            assert_eq!(attachment.stamp_ns / 1_000_000_000 / 31_556_952, 56);
        }
    }

    #[test]
    fn other_bytes_are_refused() {
        let good = bytes(CAPTURED[0].1);
        for size in (0..ATTACHMENT_BYTES).chain([ATTACHMENT_BYTES + 1]) {
            let mut wrong = good.clone();
            wrong.resize(size, 0);
            assert_eq!(Attachment::parse(&wrong), Err(AttachmentError { size }));
        }
        let mut wrong = good;
        wrong[16] = 17;
        assert!(Attachment::parse(&wrong).is_err());
    }
}
