//! What a history is kept in: the trait of a store, the queue in which records wait for it, and a store in memory.
//!
//! The runtime drives a [`Recorder`] on a thread of its own, with a store in a file. The simulation drives the same
//! recorder with [`MemoryRecords`] on a virtual disk, which answers the same.

mod memory;
mod queue;
mod recorder;

use muster_model::history::{Coverage, Entry, Page, Query, Retention};

pub use memory::{DivisionHead, MemoryRecords, PastPositions, past_division};
pub use queue::{MAX_BATCH_RECORDS, RecordQueue};
pub use recorder::{COMMIT_INTERVAL, RETRY_INTERVAL, Recorder, Step};

/// Most bytes of the rows of one answer, about: a quarter of the largest message. Those that do not fit are asked for
/// behind them.
pub const MAX_PAGE_BYTES: usize = 16 * 1024 * 1024;

/// Why records are not written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WriteError {
    /// There is no room. The oldest records have gone as far as that may help; it is worth trying again.
    #[error("{0}")]
    Full(String),
    /// The file was damaged. It is put aside, and the store is empty now.
    #[error("{0}")]
    Damaged(String),
    /// Anything else; it is worth trying again later.
    #[error("{0}")]
    Failed(String),
}

/// A store of records. Nothing of it may be called on a thread that must not wait.
pub trait Records: Send {
    /// Writes records in one transaction: all of them are on the disk when this returns, or none is.
    ///
    /// # Errors
    /// Why not; the text names the file and the remedy.
    fn write(&mut self, entries: &[Entry]) -> Result<(), WriteError>;

    /// What is on the disk.
    fn coverage(&self) -> Coverage;

    /// Forgets what is too old or too much, in part where it is a lot. True if something is left to forget.
    ///
    /// # Errors
    /// As for [`Records::write`].
    fn retain(&mut self, retention: &Retention) -> Result<bool, WriteError>;

    /// Answers a question.
    ///
    /// # Errors
    /// If the store cannot be read; the text names the file.
    fn answer(&mut self, query: &Query) -> Result<Page, String>;

    /// Which file was found damaged and put aside as the store was opened; told once.
    fn take_damage(&mut self) -> Option<String> {
        None
    }

    /// Whether less is kept than should be, since the disk is full; the text names the remedy. It is asked from
    /// time to time, and may try whether there is room again.
    fn shortage(&mut self) -> Option<String> {
        None
    }
}
