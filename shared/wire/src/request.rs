//! Gets: which keys they select, in which form they want the answer.

use std::fmt;

use muster_model::id::RobotId;
use serde::{Deserialize, Serialize};

use crate::key::{Key, KeySpace};
use crate::packet::{Format, quoted};

/// Longest text of a get's parameters that is read: `format=json` and a few more.
pub(crate) const MAX_PARAMETERS: usize = 1024;

/// Why the parameters of a get are refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// They are longer than is read.
    #[error("parameters may have at most {MAX_PARAMETERS} bytes")]
    TooLong,
    /// The form of the answer is unknown.
    #[error("format {0:?} is unknown; ask for json or bincode")]
    Format(String),
    /// `katz` does not name two robots.
    #[error("katz: {0:?} must name two robots, as in katz=r1,r2")]
    Katz(String),
}

/// A get as a service receives it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    selector: String,
    exact: bool,
    /// The form that `?format=` asks for; none if the get leaves it to the key.
    pub format: Option<Format>,
    /// The two robots whose Katz similarity `?katz=` asks for instead of the embedding: from, to.
    pub katz: Option<[RobotId; 2]>,
    /// What follows the `?`, for keys that have parameters of their own.
    pub parameters: String,
    /// What the get carries, such as a patch of settings.
    pub payload: Option<Vec<u8>>,
}

impl Request {
    /// Reads a get.
    ///
    /// # Errors
    /// If the parameters ask for a form that there is not, or for something else than a pair of robots;
    /// the text names the remedy.
    pub fn new(
        selector: impl Into<String>,
        parameters: &str,
        payload: Option<Vec<u8>>,
    ) -> Result<Self, RequestError> {
        if parameters.len() > MAX_PARAMETERS {
            return Err(RequestError::TooLong);
        }
        let (mut format, mut katz) = (None, None);
        for parameter in parameters.split([';', '&']) {
            match parameter.split_once('=') {
                Some(("format", "json")) => format = Some(Format::Json),
                Some(("format", "bincode" | "binary")) => format = Some(Format::Binary),
                Some(("format", other)) => {
                    return Err(RequestError::Format(other.chars().take(32).collect()));
                }
                Some(("katz", names)) => katz = Some(pair(names)?),
                _ => {}
            }
        }
        let selector = selector.into();
        let exact = !selector.contains('*');
        let parameters = parameters.to_owned();
        Ok(Self { selector, exact, format, katz, parameters, payload })
    }

    /// The part of the get that one server of several is to answer: a wild get reaches each server
    /// of a service, and each answers for its own keys alone.
    #[must_use]
    pub fn narrowed(self, selector: impl Into<String>) -> Self {
        Self { selector: selector.into(), ..self }
    }

    /// Whether the get named exactly one key. What changes something must.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        self.exact
    }

    /// The one key that the get names; none if it is wild, or names no key of the fleet.
    #[must_use]
    pub fn exact_key(&self, space: &KeySpace) -> Option<Key> {
        space.parse(&self.selector).ok()
    }

    /// Whether the get names several commands at once, or its part that one server of commands is to answer does.
    #[must_use]
    pub fn names_commands(&self, space: &KeySpace) -> bool {
        !self.exact && self.selector.starts_with(&space.commands())
    }

    /// Whether the get selects a key.
    #[must_use]
    pub fn selects(&self, space: &KeySpace, key: &Key) -> bool {
        let text = space.format(key);
        let selector: Vec<&str> = self.selector.split('/').collect();
        let key: Vec<&str> = text.split('/').collect();
        chunks_match(&selector, &key)
    }
}

impl fmt::Display for Request {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&quoted(&self.selector))?;
        match self.format {
            Some(Format::Json) => formatter.write_str("?format=json")?,
            Some(Format::Binary) => formatter.write_str("?format=bincode")?,
            None => {}
        }
        if let Some([from, to]) = &self.katz {
            write!(formatter, "?katz={from},{to}")?;
        }
        match &self.payload {
            Some(payload) => write!(formatter, " {}", quoted(&String::from_utf8_lossy(payload))),
            None => Ok(()),
        }
    }
}

/// Two names with a comma between them.
fn pair(names: &str) -> Result<[RobotId; 2], RequestError> {
    let id = |name: &str| name.parse::<RobotId>().ok();
    let pair = names.split_once(',').and_then(|(from, to)| Some([id(from)?, id(to)?]));
    pair.ok_or_else(|| RequestError::Katz(quoted(names)))
}

/// Whether a key expression of chunks, `*` (one chunk) and `**` (any number) matches a plain key.
/// Partial wildcards (`$*`) match within one chunk.
///
/// The dynamic programme over (chunk of the expression, chunk of the key) takes no more than the
/// product of the lengths, whatever the expression.
fn chunks_match(selector: &[&str], key: &[&str]) -> bool {
    let mut reachable = vec![false; key.len() + 1];
    reachable[0] = true;
    for chunk in selector {
        if *chunk == "**" {
            for at in 1..=key.len() {
                reachable[at] |= reachable[at - 1] && !is_verbatim(key[at - 1]);
            }
        } else {
            for at in (0..key.len()).rev() {
                reachable[at + 1] = reachable[at] && chunk_matches(chunk, key[at]);
            }
            reachable[0] = false;
        }
    }
    reachable[key.len()]
}

/// Whether no wildcard matches a chunk: those that begin with `@` are only matched by themselves.
fn is_verbatim(chunk: &str) -> bool {
    chunk.starts_with('@')
}

fn chunk_matches(chunk: &str, key: &str) -> bool {
    if is_verbatim(key) {
        return chunk == key;
    }
    if chunk == "*" {
        return true;
    }
    let mut parts = chunk.split("$*");
    let Some(rest) = parts.next().and_then(|first| key.strip_prefix(first)) else {
        return false;
    };
    let mut rest = rest;
    let mut last: Option<&str> = None;
    for part in parts {
        if let Some(part) = last {
            match rest.find(part) {
                Some(at) => rest = &rest[at + part.len()..],
                None => return false,
            }
        }
        last = Some(part);
    }
    last.map_or(rest.is_empty(), |part| rest.ends_with(part))
}

#[cfg(test)]
mod tests {
    use muster_model::id::FleetId;

    use super::*;

    fn selects(selector: &str, key: &str) -> bool {
        let space = KeySpace::new(FleetId::new("f").unwrap());
        let key = space.parse(&format!("muster/v1/f/{key}")).unwrap();
        Request::new(selector, "", None).unwrap().selects(&space, &key)
    }

    #[test]
    fn wild_gets_select_what_they_should() {
        assert!(selects("muster/v1/f/teams", "teams"));
        assert!(!selects("muster/v1/f/teams", "audit"));
        assert!(selects("muster/v1/f/*", "teams"));
        assert!(!selects("muster/v1/f/*", "json/teams"));
        assert!(selects("muster/v1/f/**", "json/teams"));
        assert!(selects("**/teams", "json/teams"));
        assert!(selects("**", "teams"));
        assert!(selects("muster/v1/f/robot/*/team", "robot/r1/team"));
        assert!(selects("muster/*/f/graph/spa$*", "graph/spatial"));
        assert!(selects("muster/*/f/graph/$*a$*l", "graph/spatial"));
        assert!(!selects("muster/*/f/graph/$*x$*", "graph/spatial"));
        assert!(!selects("muster/v1/g/**", "teams"));
        assert!(selects("muster/**/f/**/**/teams", "teams"));
    }

    #[test]
    fn the_form_is_read_from_the_parameters() {
        let format = |text: &str| Request::new("a", text, None).map(|request| request.format);
        assert_eq!(format(""), Ok(None));
        assert_eq!(format("format=json"), Ok(Some(Format::Json)));
        assert_eq!(format("x=1;format=bincode"), Ok(Some(Format::Binary)));
        assert!(format("format=xml").unwrap_err().to_string().contains("json"));
    }

    #[test]
    fn a_pair_is_read_from_the_parameters() {
        let pair = |text: &str| Request::new("a", text, None).map(|request| request.katz);
        let [r1, r2] = ["r1", "r2"].map(|name| RobotId::new(name).unwrap());
        assert_eq!(pair("format=json"), Ok(None));
        assert_eq!(pair("format=json;katz=r1,r2"), Ok(Some([r1, r2])));
        for wrong in ["katz=", "katz=r1", "katz=r1,", "katz=r1,r2,r3", "katz=R 1,r2"] {
            let error = pair(wrong).unwrap_err().to_string();
            assert!(error.starts_with("katz: ") && error.contains("katz=r1,r2"), "{error}");
        }
    }
}
