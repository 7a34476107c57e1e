//! Keys, and gets with their selectors and parameters.

use std::collections::HashMap;

use muster_wire::{Format, Request};

use crate::packets::space;
use crate::{Outcome, text};

/// Longest text that refuses parameters, in characters.
const MAX_ERROR: usize = 300;

/// Keys that selectors are tried on.
const KEYS: [&str; 12] = [
    "robot/r1",
    "robot/r1/pose",
    "robot/r1/relation/thermal",
    "robot/r1/team",
    "graph/spatial",
    "roster",
    "teams",
    "audit",
    "json/teams",
    "service/ingest/settings",
    "service/ingest/status",
    "service/ingest/host-1",
];

/// The text of a key, whole or (with `~`) below the prefix of the fleet.
pub(crate) fn key(data: &[u8]) -> Outcome {
    let given = String::from_utf8_lossy(data);
    let given = match given.strip_prefix('~') {
        Some(tail) => format!("muster/v1/alpha/{tail}"),
        None => given.into_owned(),
    };
    let key = match space().parse(&given) {
        Ok(key) => key,
        Err(error) => return refused(&error),
    };
    assert_eq!(space().format(&key), given, "a key is read that is written otherwise");
    assert_eq!(key.robot().is_some(), given.starts_with("muster/v1/alpha/robot/"));
    let request = Request::new(given, "", None).unwrap();
    assert!(request.is_exact() && request.selects(&space(), &key));
    assert_eq!(request.exact_key(&space()), Some(key));
    Outcome::Accepted
}

fn refused(error: &dyn std::error::Error) -> Outcome {
    text::check(&error.to_string(), MAX_ERROR);
    Outcome::Refused
}

/// A selector, a line feed, parameters, a line feed, and a payload.
pub(crate) fn request(data: &[u8]) -> Outcome {
    let (selector, rest) = text::line(data);
    let (parameters, payload) = text::line(rest);
    let selector = String::from_utf8_lossy(selector).replace('~', "muster/v1/alpha");
    let parameters = String::from_utf8_lossy(parameters);
    let request = match Request::new(selector.clone(), &parameters, Some(payload.to_vec())) {
        Ok(request) => request,
        Err(error) => return refused(&error),
    };
    let named = |form: &str| parameters.split([';', '&']).any(|part| part == form);
    assert!(request.format != Some(Format::Json) || named("format=json"));
    for key in KEYS {
        let text = format!("muster/v1/alpha/{key}");
        let key = space().parse(&text).unwrap();
        let expression: Vec<&str> = selector.split('/').collect();
        let chunks: Vec<&str> = text.split('/').collect();
        let expected = chunks_match(&expression, &chunks, &mut HashMap::new());
        assert_eq!(request.selects(&space(), &key), expected, "{selector:?} and {text}");
        if request.exact_key(&space()).as_ref() == Some(&key) {
            assert!(request.is_exact() && expected);
        }
    }
    Outcome::Accepted
}

/// What a key expression selects, by its definition: `**` is any number of chunks, `*` is one, `$*`
/// any characters within one.
fn chunks_match(
    expression: &[&str],
    key: &[&str],
    known: &mut HashMap<(usize, usize), bool>,
) -> bool {
    let at = (expression.len(), key.len());
    if let Some(known) = known.get(&at) {
        return *known;
    }
    let result = match (expression.split_first(), key.split_first()) {
        (None, _) => key.is_empty(),
        (Some((&"**", rest)), None) => chunks_match(rest, key, known),
        (Some((&"**", rest)), Some((_, tail))) => {
            chunks_match(rest, key, known) || chunks_match(expression, tail, known)
        }
        (Some(_), None) => false,
        (Some((chunk, rest)), Some((first, tail))) => {
            (*chunk == "*" || characters_match(chunk.as_bytes(), first.as_bytes()))
                && chunks_match(rest, tail, known)
        }
    };
    known.insert(at, result);
    result
}

/// Whether a chunk matches a plain one, by the table of all pairs of tails.
fn characters_match(chunk: &[u8], key: &[u8]) -> bool {
    let mut table = vec![vec![false; key.len() + 1]; chunk.len() + 1];
    table[chunk.len()][key.len()] = true;
    for i in (0..chunk.len()).rev() {
        for j in (0..=key.len()).rev() {
            table[i][j] = if chunk[i..].starts_with(b"$*") {
                table[i + 2][j] || (j < key.len() && table[i][j + 1])
            } else {
                j < key.len() && chunk[i] == key[j] && table[i + 1][j + 1]
            };
        }
    }
    table[0][0]
}
