//! The last embeddings and rosters, for the divisions that name them.

use std::collections::VecDeque;

use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::roster::Roster;

/// Most messages that are kept: three seconds at ten per second, longer than a division takes.
const MAX_MESSAGES: usize = 32;

/// A message that comes in the order of its revision.
pub(crate) trait Revised {
    fn revision(&self) -> Revision;
}

impl Revised for Embedding {
    fn revision(&self) -> Revision {
        self.header.revision
    }
}

impl Revised for Roster {
    fn revision(&self) -> Revision {
        self.header.revision
    }
}

/// What became of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Acceptance {
    /// It is dropped: a newer one was there.
    Old,
    /// It is kept, now or before, and the newest division does not rest on it.
    Kept,
    /// There may be something to score now.
    Wanted,
}

/// The newest messages of one kind, in the order of their revisions.
#[derive(Debug)]
pub(crate) struct History<T>(VecDeque<Checked<T>>);

impl<T> Default for History<T> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<T: Revised> History<T> {
    /// Keeps a message. One that is older than the newest is kept only if it is wanted.
    pub(crate) fn keep(&mut self, message: Checked<T>, wanted: Option<Revision>) -> Acceptance {
        let kept = &mut self.0;
        let revision = message.revision();
        let is_wanted = wanted == Some(revision);
        match kept.binary_search_by_key(&revision, |message| message.revision()) {
            Ok(_) => return Acceptance::Kept,
            Err(at) if at == kept.len() || is_wanted => kept.insert(at, message),
            Err(_) => return Acceptance::Old,
        }
        if kept.len() > MAX_MESSAGES {
            // What is wanted stays, however old it is.
            let removed = usize::from(kept.front().map(|message| message.revision()) == wanted);
            kept.remove(removed);
        }
        if is_wanted { Acceptance::Wanted } else { Acceptance::Kept }
    }

    /// The message of a revision.
    pub(crate) fn find(&self, revision: Revision) -> Option<&Checked<T>> {
        let at = self.0.binary_search_by_key(&revision, |message| message.revision()).ok()?;
        self.0.get(at)
    }

    /// The newest message.
    pub(crate) fn newest(&self) -> Option<&Checked<T>> {
        self.0.back()
    }

    /// Drops those before a revision that is there.
    pub(crate) fn drop_before(&mut self, revision: Revision) {
        if self.find(revision).is_some() {
            self.0.retain(|message| message.revision() >= revision);
        }
    }

    /// All of them, the oldest first.
    pub(crate) fn iter(&self) -> impl ExactSizeIterator<Item = &Checked<T>> {
        self.0.iter()
    }
}
