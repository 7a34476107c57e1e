//! What crosses links, and what the router knows: which link has declared which liveliness token, and which gets
//! are under way.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_wire::Packet;

/// A link, by number.
pub(crate) type LinkId = usize;

/// A get on the bus, by number.
pub(crate) type BusGetId = u64;

/// What a link carries.
#[derive(Debug, Clone)]
pub(crate) enum Carried {
    /// A message.
    Put(Arc<Packet>),
    /// A liveliness token is declared or withdrawn; on the way down: appeared or is gone.
    Token { key: Arc<str>, alive: bool },
    /// A get.
    Get { get: BusGetId, asked: Arc<BusGet> },
    /// One server's whole answer.
    Answer { get: BusGetId, answer: Arc<Answer> },
    /// All servers that were asked have answered.
    Complete { get: BusGetId },
}

/// A get on the bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct BusGet {
    pub(crate) selector: String,
    pub(crate) parameters: &'static str,
    pub(crate) payload: Option<Vec<u8>>,
}

/// What one server answers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Answer {
    Packets(Vec<Packet>),
    Error(String),
}

impl Answer {
    /// The packets, if it is no error.
    pub(crate) fn packets(&self) -> Option<&[Packet]> {
        match self {
            Self::Packets(packets) => Some(packets),
            Self::Error(_) => None,
        }
    }
}

impl Carried {
    /// Declarations are never lost on a link that is up.
    pub(crate) fn is_declaration(&self) -> bool {
        matches!(self, Self::Token { .. })
    }

    /// Answers of gets have less priority than what is published.
    pub(crate) fn is_answer(&self) -> bool {
        matches!(self, Self::Answer { .. } | Self::Complete { .. })
    }

    /// Gets and their answers have numbers, by which repetitions are seen.
    pub(crate) fn may_be_repeated(&self) -> bool {
        matches!(self, Self::Put(_))
    }
}

/// A get that is under way.
#[derive(Debug)]
struct OpenGet {
    asker: LinkId,
    /// How many servers have not answered; none until the router has passed the get on.
    open: Option<usize>,
}

/// What the router knows.
#[derive(Debug, Default)]
pub(crate) struct Router {
    /// The link that declared each token.
    tokens: BTreeMap<Arc<str>, BTreeSet<LinkId>>,
    gets: BTreeMap<BusGetId, OpenGet>,
    next_get: BusGetId,
}

impl Router {
    /// A token was declared or withdrawn. True if its followers are to be notified.
    pub(crate) fn token(&mut self, link: LinkId, key: &Arc<str>, alive: bool) -> bool {
        if alive {
            let owners = self.tokens.entry(Arc::clone(key)).or_default();
            owners.insert(link) && owners.len() == 1
        } else {
            let Some(owners) = self.tokens.get_mut(key) else { return false };
            let withdrawn = owners.remove(&link) && owners.is_empty();
            if owners.is_empty() {
                self.tokens.remove(key);
            }
            withdrawn
        }
    }

    /// The tokens of one link.
    pub(crate) fn tokens_of(&self, link: LinkId) -> Vec<Arc<str>> {
        let own = self.tokens.iter().filter(|(_, owners)| owners.contains(&link));
        own.map(|(key, _)| Arc::clone(key)).collect()
    }

    /// All tokens that are there.
    pub(crate) fn tokens(&self) -> Vec<Arc<str>> {
        self.tokens.keys().cloned().collect()
    }

    /// A get begins.
    pub(crate) fn begin_get(&mut self, asker: LinkId) -> BusGetId {
        self.next_get += 1;
        self.gets.insert(self.next_get, OpenGet { asker, open: None });
        self.next_get
    }

    /// The get is passed on to so many servers. True if no server has the key.
    pub(crate) fn pass_on(&mut self, get: BusGetId, servers: usize) -> bool {
        self.gets.get_mut(&get).is_some_and(|get| {
            get.open = Some(servers);
            servers == 0
        })
    }

    /// A server has answered: the link that asked, and whether that was the last answer.
    pub(crate) fn answered(&mut self, get: BusGetId) -> Option<(LinkId, bool)> {
        let get = self.gets.get_mut(&get)?;
        let open = get.open?.saturating_sub(1);
        get.open = Some(open);
        Some((get.asker, open == 0))
    }

    /// The get has ended for the link that asked.
    pub(crate) fn end_get(&mut self, get: BusGetId) {
        self.gets.remove(&get);
    }
}

/// Whether a pattern includes a key or another pattern. The only wild chunk is `*`, which is all that
/// services declare.
pub(crate) fn includes(pattern: &str, key: &str) -> bool {
    matches(pattern.as_bytes(), key.as_bytes(), false)
}

/// Whether two patterns have a key in common.
pub(crate) fn intersects(left: &str, right: &str) -> bool {
    matches(left.as_bytes(), right.as_bytes(), true)
}

/// Compares byte by byte, since every message is compared with every subscription: splitting both took a fifth of a run.
fn matches(mut left: &[u8], mut right: &[u8], right_is_pattern: bool) -> bool {
    loop {
        (left, right) = match (left, right) {
            ([], []) => return true,
            ([b'*', left @ ..], right) => (left, after_chunk(right)),
            (left, [b'*', right @ ..]) if right_is_pattern => (after_chunk(left), right),
            ([l, left @ ..], [r, right @ ..]) if l == r => (left, right),
            _ => return false,
        };
    }
}

/// What comes after the first chunk, with its slash.
fn after_chunk(key: &[u8]) -> &[u8] {
    let end = key.iter().position(|byte| *byte == b'/').unwrap_or(key.len());
    &key[end..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_include_and_intersect_as_on_the_bus() {
        assert!(includes("a/*/pose", "a/r1/pose") && !includes("a/*/pose", "a/r1/links"));
        assert!(!includes("a/*", "a/b/c") && !includes("a/b", "a/*"));
        assert!(intersects("a/graph/spatial", "a/graph/*") && intersects("a/*", "a/*"));
        assert!(!intersects("a/graph/*", "a/*"));
    }

    #[test]
    fn a_token_that_two_hold_is_gone_when_both_have_left() {
        let mut router = Router::default();
        let key: Arc<str> = "k".into();
        assert!(router.token(1, &key, true) && !router.token(2, &key, true));
        assert!(!router.token(1, &key, false) && router.tokens().len() == 1);
        assert!(router.token(2, &key, false) && router.tokens().is_empty());
    }
}
