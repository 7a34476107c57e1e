//! Keys and attachments of other programs on the same bus: a ROS 2 bridge, a dashboard.
//!
//! Muster's own keys are typed ([`Key`](crate::Key)). A bridge to other programs uses keys that
//! those programs define, so that only their form is checked here: they are canonical key
//! expressions, and none stands under `muster/`, where only [`KeySpace`](crate::KeySpace) writes keys.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Longest foreign key in bytes. A ROS 2 key holds a domain, a topic, a type and a hash, of which none
/// has more than 255 bytes.
pub const MAX_FOREIGN_KEY_BYTES: usize = 1024;

/// Largest attachment in bytes. Attachments hold sequence numbers, times and ids: those of ROS 2 have
/// 33 bytes.
pub const MAX_ATTACHMENT_BYTES: usize = 1024;

/// The first chunk of Muster's own keys.
const OWN_ROOT: &str = "muster";

/// The second chunk of each of them.
const OWN_VERSION: &str = "v1";

/// Why a text is no [`ForeignKey`] or no [`ForeignPattern`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ForeignKeyError {
    /// The text has more than [`MAX_FOREIGN_KEY_BYTES`] bytes.
    #[error("a key may have at most {MAX_FOREIGN_KEY_BYTES} bytes, this has {0}")]
    TooLong(usize),
    /// The text is empty, begins or ends with `/`, or contains `//`.
    #[error("a key must not be empty, nor begin or end with a slash, nor contain two in a row")]
    EmptyChunk,
    /// The text contains a character that no key may contain here.
    #[error("a key may not contain {0:?}")]
    Character(char),
    /// The wildcards of the pattern are not in canonical form.
    #[error(
        "the wildcards of {0:?} are not canonical: use * for one chunk, ** for any number, $* within \
         a chunk, and */** instead of **/*"
    )]
    Wildcards(String),
    /// The first chunk of the pattern has wildcards, and so might match Muster's own keys.
    #[error(
        "where the first chunk of a pattern has wildcards, the second must be another one than {OWN_VERSION} and have none"
    )]
    WildRoot,
    /// The key stands under `muster/`.
    #[error("keys under {OWN_ROOT}/ are Muster's own")]
    Own,
}

/// One key outside of `muster/`: a canonical key expression without wildcards.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct ForeignKey(String);

/// A set of keys outside of `muster/v1/`: a canonical key expression whose first or second chunk has no wildcards.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct ForeignPattern(String);

impl ForeignKey {
    /// Checks and wraps the text of a key.
    ///
    /// # Errors
    /// [`ForeignKeyError`] if the text is no canonical key without wildcards, or stands under `muster/`.
    pub fn new(text: impl Into<String>) -> Result<Self, ForeignKeyError> {
        let text = text.into();
        if let Some(wild) = text.chars().find(|c| matches!(c, '*' | '$')) {
            return Err(ForeignKeyError::Character(wild));
        }
        check(&text)?;
        Ok(Self(text))
    }

    /// The text of the key.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl ForeignPattern {
    /// Checks and wraps the text of a key expression.
    ///
    /// # Errors
    /// [`ForeignKeyError`] if the text is no canonical key expression, might match keys of Muster's, or stands under
    /// `muster/`.
    pub fn new(text: impl Into<String>) -> Result<Self, ForeignKeyError> {
        let text = text.into();
        check(&text)?;
        let is_wild = |chunk: &str| chunk.contains(['*', '$']);
        let mut chunks = text.split('/');
        let root = chunks.next().unwrap_or_default();
        if is_wild(root) {
            let second = chunks.clone().next();
            let is_other = second.is_some_and(|chunk| !is_wild(chunk) && chunk != OWN_VERSION);
            if !is_canonical(root) || root == "**" || !is_other {
                return Err(ForeignKeyError::WildRoot);
            }
        }
        let mut after_double = false;
        for chunk in chunks {
            if !is_canonical(chunk) || after_double && matches!(chunk, "*" | "**") {
                return Err(ForeignKeyError::Wildcards(text));
            }
            after_double = chunk == "**";
        }
        Ok(Self(text))
    }

    /// The text of the key expression.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for ForeignKey {
    type Error = ForeignKeyError;

    fn try_from(text: String) -> Result<Self, ForeignKeyError> {
        Self::new(text)
    }
}

impl TryFrom<String> for ForeignPattern {
    type Error = ForeignKeyError;

    fn try_from(text: String) -> Result<Self, ForeignKeyError> {
        Self::new(text)
    }
}

impl fmt::Display for ForeignKey {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl fmt::Display for ForeignPattern {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

/// What keys and patterns have in common.
fn check(text: &str) -> Result<(), ForeignKeyError> {
    if text.len() > MAX_FOREIGN_KEY_BYTES {
        return Err(ForeignKeyError::TooLong(text.len()));
    }
    if text.split('/').any(str::is_empty) {
        return Err(ForeignKeyError::EmptyChunk);
    }
    // `?` and `#` end the key of a selector; control characters would forge lines of logs.
    if let Some(bad) = text.chars().find(|c| matches!(c, '?' | '#') || c.is_control()) {
        return Err(ForeignKeyError::Character(bad));
    }
    if text.split('/').next() == Some(OWN_ROOT) {
        return Err(ForeignKeyError::Own);
    }
    Ok(())
}

/// Whether the wildcards of one chunk have the one form that the bus allows.
fn is_canonical(chunk: &str) -> bool {
    if matches!(chunk, "*" | "**") {
        return true;
    }
    !chunk.replace("$*", "").contains(['*', '$']) && !chunk.contains("$*$*") && chunk != "$*"
}

/// There are more than [`MAX_ATTACHMENT_BYTES`] bytes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("an attachment may have at most {MAX_ATTACHMENT_BYTES} bytes, this has {size}")]
pub struct AttachmentError {
    /// How many bytes there are.
    pub size: usize,
}

/// A few bytes that travel with a message and are no part of its payload.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<u8>")]
pub struct Attachment(Vec<u8>);

impl TryFrom<Vec<u8>> for Attachment {
    type Error = AttachmentError;

    fn try_from(bytes: Vec<u8>) -> Result<Self, AttachmentError> {
        Self::new(bytes)
    }
}

impl Attachment {
    /// Checks the size and wraps the bytes.
    ///
    /// # Errors
    /// [`AttachmentError`] if there are more than [`MAX_ATTACHMENT_BYTES`].
    pub fn new(bytes: impl Into<Vec<u8>>) -> Result<Self, AttachmentError> {
        let bytes = bytes.into();
        if bytes.len() > MAX_ATTACHMENT_BYTES {
            return Err(AttachmentError { size: bytes.len() });
        }
        Ok(Self(bytes))
    }

    /// The bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// The bytes, by value.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key::{Key, KeySpace, Pattern};
    use muster_model::id::FleetId;

    #[test]
    fn a_foreign_key_is_written_as_it_is_and_never_read_as_a_key_of_the_fleet() {
        let space = KeySpace::new(FleetId::new("alpha").unwrap());
        for text in
            ["0/chatter/std_msgs::msg::dds_::String_/RIHS01_ab", "@ros2_lv/0", "rt", "musters"]
        {
            let key = ForeignKey::new(text).unwrap();
            assert_eq!((key.as_str(), key.to_string().as_str()), (text, text));
            assert_eq!(space.format(&Key::Foreign(key)), text);
            assert!(space.parse(text).is_err());
        }
    }

    #[test]
    fn what_is_no_canonical_foreign_key_is_refused() {
        use ForeignKeyError::{Character, EmptyChunk, Own, TooLong};
        let long = "k".repeat(MAX_FOREIGN_KEY_BYTES + 1);
        for (text, error) in [
            ("", EmptyChunk),
            ("/a", EmptyChunk),
            ("a/", EmptyChunk),
            ("a//b", EmptyChunk),
            ("a/*", Character('*')),
            ("a$b", Character('$')),
            ("a?b", Character('?')),
            ("a#b", Character('#')),
            ("a\nb", Character('\n')),
            ("muster", Own),
            ("muster/v1/alpha/teams", Own),
            (&long, TooLong(MAX_FOREIGN_KEY_BYTES + 1)),
        ] {
            assert_eq!(ForeignKey::new(text), Err(error), "{text:?}");
        }
        assert!(ForeignKey::new(&long[1..]).is_ok());
    }

    #[test]
    fn patterns_are_canonical_and_match_no_key_of_muster() {
        let space = KeySpace::new(FleetId::new("alpha").unwrap());
        for text in ["0/*", "0/**", "0/*/**", "0/**/a/**", "0/a$*b", "0/$*b$*", "0/chatter"] {
            let pattern = ForeignPattern::new(text).unwrap();
            assert_eq!(space.pattern(&Pattern::Foreign(pattern)), text);
        }
        for text in ["0/**/*", "0/**/**", "0/$*", "0/a$*$*", "0/a*", "0/***", "0/a$", "0/$*$"] {
            assert_eq!(ForeignPattern::new(text), Err(ForeignKeyError::Wildcards(text.into())));
        }
        // A bridge puts the topics of robots under their names.
        for text in ["*/odom", "r$*/odom/**", "*/fmu/out/*"] {
            assert!(ForeignPattern::new(text).is_ok(), "{text}");
        }
        for text in [
            "*",
            "**",
            "*/v1/alpha/teams",
            "m$*",
            "$*",
            "*/*",
            "*/v$*/x",
            "**/odom",
            "$*/odom",
            "*/**",
        ] {
            assert_eq!(ForeignPattern::new(text), Err(ForeignKeyError::WildRoot), "{text}");
        }
        assert_eq!(ForeignPattern::new("muster/**"), Err(ForeignKeyError::Own));
        assert_eq!(ForeignPattern::new("a//*"), Err(ForeignKeyError::EmptyChunk));
    }

    #[test]
    fn attachments_are_bounded() {
        let largest = vec![7; MAX_ATTACHMENT_BYTES];
        let attachment = Attachment::new(largest.clone()).unwrap();
        assert_eq!(attachment.as_bytes(), largest);
        assert_eq!(attachment.into_bytes(), largest);
        let size = MAX_ATTACHMENT_BYTES + 1;
        assert_eq!(Attachment::new(vec![7; size]), Err(AttachmentError { size }));
    }
}
