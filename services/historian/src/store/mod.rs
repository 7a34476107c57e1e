//! The file of a history: an SQLite database that other programs read while it is written.
//!
//! A transaction is on the disk as a whole or not at all: the journal is a write-ahead log, synchronised with every
//! transaction, and brought into the file after it. Where the file cannot grow, a reserve beside it is given up, the
//! oldest whole minutes are deleted, and the file keeps the size that it has: their pages are used again, without a
//! byte more of the disk, until there is room.

mod file;
mod forgetting;
mod reading;
mod values;
mod writing;

use std::path::Path;

use muster_model::history::{Coverage, Entry, Page, Query, Retention};
use muster_model::id::{FleetId, InstanceId};
use muster_service::records::{Records, WriteError};
use rusqlite::{Connection, ErrorCode};

use file::HistoryFile;
pub use file::SCHEMA_VERSION;
use writing::Position;

/// Most times that the oldest minutes are deleted for one transaction.
const MAX_ATTEMPTS: usize = 8;

/// The extended code of SQLite for a write that the system refuses for another reason than a full disk, such as a
/// limit on the size of files.
const WRITE_REFUSED: i32 = 778;

/// A damaged file in whose place there is no new one yet.
#[derive(Debug)]
enum Broken {
    /// It still has its name. Why it is damaged.
    There(String),
    /// It is put aside. What is said of that.
    Aside(String),
}

/// A store of records in a file, or in memory where there is no folder.
#[derive(Debug)]
pub struct FileRecords {
    /// None of a store in memory.
    file: Option<HistoryFile>,
    connection: Connection,
    /// While there is one, the connection leads to no file.
    broken: Option<Broken>,
    instance: InstanceId,
    coverage: Coverage,
    position: Position,
    /// Why less is kept than should be.
    shortage: Option<String>,
    damage: Option<String>,
}

/// Opens the store of an instance, as the runtime wants it.
///
/// # Errors
/// If the file cannot be opened; the text names it and the remedy.
#[cfg(feature = "binary")]
pub fn open(place: &muster_runtime::records::RecordPlace) -> Result<Box<dyn Records>, String> {
    let records = FileRecords::open(place.folder.as_deref(), &place.fleet, &place.instance)?;
    Ok(Box::new(records))
}

impl FileRecords {
    /// Opens the first file of a folder that no other instance uses, or makes a new one. A damaged file is put aside.
    /// Without a folder, records last as long as the store.
    ///
    /// # Errors
    /// If no file can be opened; the text names it and the remedy.
    pub fn open(
        folder: Option<&Path>,
        fleet: &FleetId,
        instance: &InstanceId,
    ) -> Result<Self, String> {
        let (file, (connection, coverage), damage) = match folder {
            Some(folder) => {
                let mut file = HistoryFile::lock(folder)?;
                let (opened, damage) = file.open(fleet)?;
                (Some(file), opened, damage)
            }
            None => (None, file::open_in_memory(fleet)?, None),
        };
        let position = Position::after(&coverage);
        let mut store = Self {
            file,
            connection,
            broken: None,
            instance: instance.clone(),
            coverage,
            position,
            shortage: None,
            damage,
        };
        store.keep_reserve();
        Ok(store)
    }

    /// Where the file is; none of a store in memory.
    #[must_use]
    pub fn path(&self) -> Option<&Path> {
        self.file.as_ref().map(HistoryFile::path)
    }

    fn name(&self) -> String {
        self.path().map_or_else(|| "the history in memory".to_owned(), |p| p.display().to_string())
    }

    fn problem(&self, what: &str, error: &rusqlite::Error) -> String {
        format!("{} {what}: {error}", self.name())
    }

    /// What follows from an error: a damaged file is put aside, and a new one begins.
    fn failed(&mut self, error: &rusqlite::Error) -> WriteError {
        if file::is_damage(error) {
            // The file must not be open as it is renamed.
            if let Ok(none) = Connection::open_in_memory() {
                self.connection = none;
            }
            self.coverage = Coverage::default();
            self.begin_anew(Broken::There(error.to_string()))
        } else if is_full(error) {
            WriteError::Full(self.problem(
                "cannot grow; free space on its disk, or lower max_mb below what the disk has",
                error,
            ))
        } else {
            WriteError::Failed(self.problem("cannot be written", error))
        }
    }

    /// Makes a new file in place of a broken one. Where that fails, the next write tries it again.
    fn begin_anew(&mut self, broken: Broken) -> WriteError {
        let Some(file) = &self.file else {
            return WriteError::Failed("the history in memory is damaged".to_owned());
        };
        let aside = match broken {
            Broken::Aside(notice) => Ok(notice),
            Broken::There(why) => {
                file.put_aside(&why).map_err(|problem| (Broken::There(why), problem))
            }
        };
        let begun = aside.and_then(|notice| match file.open_again() {
            Ok(opened) => Ok((opened, notice)),
            Err(problem) => Err((Broken::Aside(notice), problem)),
        });
        match begun {
            Ok(((connection, coverage), notice)) => {
                self.connection = connection;
                // Numbers are never given twice, in a new file neither.
                let before = std::mem::replace(&mut self.position, Position::after(&coverage));
                self.position.skip_behind(&before);
                self.coverage = coverage;
                WriteError::Damaged(notice)
            }
            Err((broken, problem)) => {
                self.broken = Some(broken);
                WriteError::Failed(problem)
            }
        }
    }

    /// Keeps the reserve beside the file, and notes whether there is room for it. With room, the file may grow.
    fn keep_reserve(&mut self) {
        let Some(file) = &self.file else { return };
        self.shortage = file.keep_reserve().err();
        if self.shortage.is_none()
            && let Err(error) = file::may_grow(&self.connection, true)
        {
            self.shortage = Some(self.problem("cannot be written", &error));
        }
    }

    fn begin_shortage(&mut self) {
        if let Some(file) = &self.file {
            file.give_up_reserve();
            self.shortage.get_or_insert_with(|| file.shortage());
        }
    }

    /// Brings the journal into the file. Where that cannot grow, the oldest minutes go until it need not.
    fn settle(&mut self) -> rusqlite::Result<()> {
        for _ in 0..MAX_ATTEMPTS {
            match file::checkpoint(&self.connection) {
                Err(error) if is_full(&error) => {}
                settled => {
                    if self.shortage.is_some() {
                        file::may_grow(&self.connection, false)?;
                    }
                    return settled.map(drop);
                }
            }
            if self.shortage.is_none() {
                // The reserve may be enough.
                self.begin_shortage();
                continue;
            }
            self.make_room()?;
            forgetting::vacuum_all(&self.connection)?;
        }
        Ok(())
    }

    /// Deletes the oldest minutes, so that their pages can be used. True if there was something to delete.
    fn make_room(&mut self) -> rusqlite::Result<bool> {
        self.begin_shortage();
        let forgot = forgetting::oldest_minutes(&mut self.connection)?;
        self.coverage.recorded_from = reading::recorded_from(&self.connection)?;
        Ok(forgot)
    }
}

fn is_full(error: &rusqlite::Error) -> bool {
    match error {
        rusqlite::Error::SqliteFailure(failure, _) => {
            failure.code == ErrorCode::DiskFull || failure.extended_code == WRITE_REFUSED
        }
        _ => false,
    }
}

impl Records for FileRecords {
    fn write(&mut self, entries: &[Entry]) -> Result<(), WriteError> {
        if let Some(broken) = self.broken.take() {
            return Err(self.begin_anew(broken));
        }
        // A file that may not grow, and has no minutes to give, would refuse everything for ever.
        if self.shortage.is_some() {
            self.keep_reserve();
        }
        for _ in 0..MAX_ATTEMPTS {
            let written = writing::write(
                &mut self.connection,
                &self.instance,
                (&self.coverage, &self.position),
                entries,
            );
            match written {
                Ok((coverage, position)) => {
                    (self.coverage, self.position) = (coverage, position);
                    // What is in the journal is on the disk; the next transaction meets what is wrong.
                    let _ = self.settle();
                    return Ok(());
                }
                Err(error) if is_full(&error) && self.make_room().unwrap_or(false) => {}
                Err(error) => return Err(self.failed(&error)),
            }
        }
        Err(WriteError::Full(format!(
            "{}: the oldest minutes made no room for what is to be written; free space on its disk",
            self.name()
        )))
    }

    fn coverage(&self) -> Coverage {
        self.coverage.clone()
    }

    fn retain(&mut self, retention: &Retention) -> Result<bool, WriteError> {
        if let Some(broken) = self.broken.take() {
            return Err(self.begin_anew(broken));
        }
        let limit = match self.file {
            Some(_) => retention.max_bytes,
            None => retention.max_bytes.min(file::MAX_MEMORY_BYTES),
        };
        let retention = Retention { max_bytes: limit, ..*retention };
        let is_short = self.shortage.is_some();
        let forgotten = forgetting::retain(&mut self.connection, &retention, is_short);
        let forgotten = forgotten.and_then(|more| {
            self.coverage.recorded_from = reading::recorded_from(&self.connection)?;
            self.coverage.bytes = reading::bytes(&self.connection)?;
            Ok(more)
        });
        forgotten.map_err(|error| self.failed(&error))
    }

    fn answer(&mut self, query: &Query) -> Result<Page, String> {
        if self.broken.is_some() {
            return Err(format!("{} is damaged, and there is no new one yet", self.name()));
        }
        reading::answer(&self.connection, query)
            .map_err(|error| self.problem("cannot be read", &error))
    }

    fn shortage(&mut self) -> Option<String> {
        if self.shortage.is_some() {
            self.keep_reserve();
        }
        self.shortage.clone()
    }

    fn take_damage(&mut self) -> Option<String> {
        self.damage.take()
    }
}
