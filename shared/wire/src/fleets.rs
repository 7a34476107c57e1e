//! Names of several fleets at once: what a process serves that serves more than one.

use std::fmt;
use std::str::FromStr;

use muster_model::id::FleetId;
use muster_model::limits::MAX_ID_LENGTH;
use serde::{Deserialize, Deserializer};

use crate::key::{Pattern, ROOT, below};

/// The name of a fleet, or a pattern of such names: `*` stands for any characters, also for none.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct FleetPattern(String);

/// Why a text is no pattern of fleets.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{text:?} names no fleets: write a name of at most {MAX_ID_LENGTH} of a-z, 0-9, _ and -, with * for any characters"
)]
pub struct FleetPatternError {
    /// The text, fit for a log line.
    pub text: String,
}

impl FromStr for FleetPattern {
    type Err = FleetPatternError;

    fn from_str(text: &str) -> Result<Self, FleetPatternError> {
        let is_part = |c| matches!(c, 'a'..='z' | '0'..='9' | '_' | '-' | '*');
        if text.is_empty() || text.len() > MAX_ID_LENGTH || !text.chars().all(is_part) {
            return Err(FleetPatternError { text: crate::packet::quoted(text) });
        }
        let mut pattern = text.to_owned();
        while pattern.contains("**") {
            pattern = pattern.replace("**", "*");
        }
        Ok(Self(pattern))
    }
}

impl<'de> Deserialize<'de> for FleetPattern {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

impl From<&FleetId> for FleetPattern {
    fn from(fleet: &FleetId) -> Self {
        Self(fleet.as_str().to_owned())
    }
}

impl fmt::Display for FleetPattern {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl FleetPattern {
    /// The one fleet that is meant; none if it is a pattern of several.
    #[must_use]
    pub fn single(&self) -> Option<FleetId> {
        FleetId::new(&self.0).ok()
    }

    /// The pattern of all fleets whose names begin with a text, which must be a part of a name.
    #[must_use]
    pub fn beginning_with(prefix: &str) -> Self {
        Self(format!("{prefix}*"))
    }

    /// Whether a name is meant.
    #[must_use]
    pub fn matches(&self, name: &str) -> bool {
        let mut parts = self.0.split('*');
        let Some(mut rest) = parts.next().and_then(|first| name.strip_prefix(first)) else {
            return false;
        };
        let mut parts = parts.peekable();
        if parts.peek().is_none() {
            return rest.is_empty();
        }
        while let Some(part) = parts.next() {
            if parts.peek().is_none() {
                return rest.ends_with(part);
            }
            let Some(at) = rest.find(part) else { return false };
            rest = &rest[at + part.len()..];
        }
        true
    }

    /// The key expression of a set of keys of all fleets that are meant.
    #[must_use]
    pub fn keys(&self, pattern: &Pattern) -> String {
        // Zenoh writes `*` for a whole chunk alone.
        let chunk = if self.0 == "*" { self.0.clone() } else { self.0.replace('*', "$*") };
        below(&format!("{ROOT}/{chunk}/"), pattern)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(text: &str) -> FleetPattern {
        text.parse().unwrap()
    }

    #[test]
    fn a_pattern_matches_what_its_stars_stand_for() {
        for (text, matching, others) in [
            ("alpha", &["alpha"][..], &["alpha1", "alph", "beta"][..]),
            ("*", &["alpha", "a"], &[]),
            ("site-*", &["site-", "site-7"], &["site", "a-site-7"]),
            ("*-north", &["a-north"], &["a-north-1"]),
            ("s*-*-1", &["site-north-1", "s--1", "s-1-1"], &["s-1", "site-north-2"]),
            ("a**b", &["ab", "aXb"], &["a"]),
        ] {
            for name in matching {
                assert!(pattern(text).matches(name), "{text} {name}");
            }
            for name in others {
                assert!(!pattern(text).matches(name), "{text} {name}");
            }
        }
    }

    #[test]
    fn only_parts_of_names_and_stars_are_patterns() {
        for text in ["", "A", "a/b", "a.b", "$*", &"a".repeat(MAX_ID_LENGTH + 1)] {
            assert!(text.parse::<FleetPattern>().is_err(), "{text}");
        }
        assert_eq!(pattern("alpha").single().unwrap().as_str(), "alpha");
        assert_eq!(pattern("alpha*").single(), None);
    }

    #[test]
    fn the_key_expression_is_that_of_the_bus() {
        assert_eq!(pattern("*").keys(&Pattern::Everything), "muster/v1/*/**");
        assert_eq!(pattern("site-*").keys(&Pattern::RobotTokens), "muster/v1/site-$*/robot/*");
        assert_eq!(pattern("a").keys(&Pattern::UnknownStreams), "muster/v1/a/robot/*/*");
    }
}
