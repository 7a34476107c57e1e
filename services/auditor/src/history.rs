//! The last embeddings and rosters, for the divisions that name them.

use std::collections::VecDeque;
use std::sync::Arc;

use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::roster::Roster;

/// Most messages that are kept: three seconds at ten per second, longer than a division takes.
const MOST: usize = 32;

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

/// What became of a message that came in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Taken {
    /// It is dropped: a newer one was there.
    Old,
    /// It is there, and the newest division does not rest on it; or was there before; or is
    /// refused.
    Kept,
    /// There may be something to judge now.
    Wanted,
}

/// The newest messages of one kind, in the order of their revisions.
#[derive(Debug)]
pub(crate) struct History<T>(VecDeque<Arc<T>>);

impl<T> Default for History<T> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<T: Revised> History<T> {
    /// Keeps a message. One that is older than the newest is kept only if it is wanted.
    pub(crate) fn keep(&mut self, message: Arc<T>, wanted: Option<Revision>) -> Taken {
        let kept = &mut self.0;
        let revision = message.revision();
        let is_wanted = wanted == Some(revision);
        match kept.binary_search_by_key(&revision, |message| message.revision()) {
            Ok(_) => return Taken::Kept,
            Err(at) if at == kept.len() || is_wanted => kept.insert(at, message),
            Err(_) => return Taken::Old,
        }
        if kept.len() > MOST {
            // What is wanted stays, however old it is.
            let removed = usize::from(kept.front().map(|message| message.revision()) == wanted);
            kept.remove(removed);
        }
        if is_wanted { Taken::Wanted } else { Taken::Kept }
    }

    /// The message of a revision.
    pub(crate) fn find(&self, revision: Revision) -> Option<&Arc<T>> {
        let at = self.0.binary_search_by_key(&revision, |message| message.revision()).ok()?;
        self.0.get(at)
    }

    /// The newest message.
    pub(crate) fn newest(&self) -> Option<&Arc<T>> {
        self.0.back()
    }

    /// Drops those before a revision that is there.
    pub(crate) fn drop_before(&mut self, revision: Revision) {
        if self.find(revision).is_some() {
            self.0.retain(|message| message.revision() >= revision);
        }
    }

    /// All of them, the oldest first.
    pub(crate) fn iter(&self) -> impl ExactSizeIterator<Item = &Arc<T>> {
        self.0.iter()
    }
}
