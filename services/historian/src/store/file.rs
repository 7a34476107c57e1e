//! How the file is found, opened, checked and put aside.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use muster_model::history::Coverage;
use muster_model::id::FleetId;
use rusqlite::{Connection, ErrorCode, OptionalExtension as _};

use super::reading;

/// Version of the schema, in `PRAGMA user_version`. Tables and columns may be added within a version.
pub const SCHEMA_VERSION: i32 = 1;

/// What says that a file is a history, in `PRAGMA application_id`: "Must".
const APPLICATION_ID: i32 = 0x4d75_7374;

/// Most instances of one fleet that record on one host. More are a mistake of whoever starts them.
const MAX_FILES: usize = 8;

/// Largest file that is checked as a whole when it is opened: larger ones take longer than a start may. Damage in
/// those is found when it is read.
const MAX_CHECKED_BYTES: u64 = 64 * 1024 * 1024;

/// Bytes beside the file that are given up when the disk is full: so much may the journal grow while records are
/// deleted.
const RESERVE_BYTES: usize = 1024 * 1024;

/// Bytes that must fit on the disk before it counts as having room again: twice the reserve, so that a disk on the
/// border is not reported again and again.
const ROOM_BYTES: usize = 2 * RESERVE_BYTES;

/// Most bytes of records in memory, whatever the settings are: nobody expects a demonstration to take more.
pub(super) const MAX_MEMORY_BYTES: u64 = 64 * 1024 * 1024;

/// Most pages of a file, by SQLite.
const MAX_PAGES: i64 = 4_294_967_294;

/// How long a transaction waits for a program that reads the file: readers never wait for it.
const BUSY_TIMEOUT: Duration = Duration::from_secs(2);

const SCHEMA: &str = include_str!("schema.sql");

/// Tables that came later within the version.
const LATER_SCHEMA: &str = include_str!("positions.sql");

/// An open file, and what is in it.
pub(super) type Opened = (Connection, Coverage);

/// Why a file is not opened.
enum Unopened {
    /// It is of another program, version or fleet.
    Foreign(String),
    /// What is in it cannot be read.
    Damaged(String),
    /// Anything else; another attempt may do.
    Failed(rusqlite::Error),
}

impl From<rusqlite::Error> for Unopened {
    fn from(error: rusqlite::Error) -> Self {
        if is_damage(&error) { Self::Damaged(error.to_string()) } else { Self::Failed(error) }
    }
}

impl Unopened {
    /// Why the content of a history is not read: statements that do not fit its tables are a sign of damage as well.
    fn of_content(error: rusqlite::Error) -> Self {
        let misfits = matches!(error, rusqlite::Error::SqlInputError { .. })
            || error.sqlite_error_code() == Some(ErrorCode::Unknown);
        if misfits { Self::Damaged(error.to_string()) } else { error.into() }
    }
}

impl std::fmt::Display for Unopened {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Foreign(text) | Self::Damaged(text) => formatter.write_str(text),
            Self::Failed(error) => error.fmt(formatter),
        }
    }
}

/// The file of this instance, and its lock.
#[derive(Debug)]
pub(super) struct HistoryFile {
    path: PathBuf,
    fleet: Option<FleetId>,
    /// Held as long as the process runs, however it ends.
    _lock: File,
}

impl HistoryFile {
    /// Takes the first file of a folder that no other process has taken.
    ///
    /// # Errors
    /// If the folder cannot be written, or all files are taken.
    pub(super) fn lock(folder: &Path) -> Result<Self, String> {
        let shown = folder.display();
        std::fs::create_dir_all(folder).map_err(|error| {
            format!("cannot make the folder {shown}: {error}; make the state directory writable")
        })?;
        for number in 1..=MAX_FILES {
            let name = if number == 1 { "history".to_owned() } else { format!("history-{number}") };
            let path = folder.join(format!("{name}.lock"));
            let lock = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
            let lock = lock.map_err(|error| {
                format!(
                    "cannot open {}: {error}; make the state directory writable",
                    path.display()
                )
            })?;
            match lock.try_lock() {
                Ok(()) => {
                    let path = folder.join(format!("{name}.sqlite"));
                    return Ok(Self { path, fleet: None, _lock: lock });
                }
                Err(TryLockError::WouldBlock) => {}
                Err(TryLockError::Error(error)) => {
                    return Err(format!("cannot lock {}: {error}", path.display()));
                }
            }
        }
        Err(format!(
            "{MAX_FILES} instances record in {shown} already; end some, or give them state directories of \
             their own"
        ))
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Opens the file; one that is damaged is put aside first, and the text says so.
    ///
    /// # Errors
    /// If it cannot be opened, or is of a newer version or another fleet; the text names the remedy.
    pub(super) fn open(&mut self, fleet: &FleetId) -> Result<(Opened, Option<String>), String> {
        self.fleet = Some(fleet.clone());
        match self.try_open(fleet) {
            Ok(opened) => Ok((opened, None)),
            Err(Unopened::Damaged(why)) => {
                let notice = self.put_aside(&why)?;
                match self.open_again() {
                    Ok(opened) => Ok((opened, Some(notice))),
                    // The next attempt finds no damage.
                    Err(problem) => Err(format!("{problem}; {notice}")),
                }
            }
            Err(Unopened::Foreign(problem)) => Err(problem),
            Err(Unopened::Failed(error)) => Err(format!(
                "cannot open {}: {error}; make the state directory writable and free space on its disk",
                self.path.display()
            )),
        }
    }

    /// Opens a new file in place of one that was put aside.
    ///
    /// # Errors
    /// If it cannot be made.
    pub(super) fn open_again(&self) -> Result<Opened, String> {
        let fleet = self.fleet.as_ref().ok_or("the history was never open")?;
        let opened = self.try_open(fleet);
        opened.map_err(|error| format!("cannot make {}: {error}", self.path.display()))
    }

    /// Opens the file and reads what is in it, so that damage shows now; makes a new one if there is none.
    fn try_open(&self, fleet: &FleetId) -> Result<Opened, Unopened> {
        let connection = Connection::open(&self.path)?;
        connection.busy_timeout(BUSY_TIMEOUT)?;
        check_kind(&connection, &self.path, fleet)?;
        prepare(&connection, fleet)?;
        check(&connection, &self.path)?;
        connection.execute_batch(LATER_SCHEMA)?;
        let coverage = reading::coverage(&connection).map_err(Unopened::of_content)?;
        Ok((connection, coverage))
    }

    /// Renames a damaged file, with its journal, to `….bad`. One that is gone already needs no other name.
    ///
    /// # Errors
    /// If it cannot be renamed.
    pub(super) fn put_aside(&self, why: &str) -> Result<String, String> {
        let shown = self.path.display();
        let bad = suffixed(&self.path, ".bad");
        match std::fs::rename(&self.path, &bad) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(format!("{shown} is damaged ({why}) and cannot be renamed: {error}"));
            }
            _ => {}
        }
        // The journal belongs to the old file, and would be taken for one of the new.
        let _ = std::fs::rename(suffixed(&self.path, "-wal"), suffixed(&bad, "-wal"));
        let _ = std::fs::remove_file(suffixed(&self.path, "-shm"));
        Ok(format!(
            "{shown} is damaged ({why}); it is renamed to {}, and a new one begins. `sqlite3 … .recover` may \
             read what is left of it",
            bad.display()
        ))
    }

    fn reserve(&self) -> PathBuf {
        self.path.with_extension("reserve")
    }

    /// Makes the reserve, if it is not there.
    ///
    /// # Errors
    /// That the disk is full, and the remedy.
    pub(super) fn keep_reserve(&self) -> Result<(), String> {
        let path = self.reserve();
        if std::fs::metadata(&path).is_ok_and(|found| found.len() == RESERVE_BYTES as u64) {
            return Ok(());
        }
        let made = || -> std::io::Result<()> {
            let mut file = File::create(&path)?;
            file.write_all(&vec![0; ROOM_BYTES])?;
            file.sync_all()?;
            file.set_len(RESERVE_BYTES as u64)
        };
        made().map_err(|_| {
            self.give_up_reserve();
            self.shortage()
        })
    }

    /// Gives the bytes of the reserve back to the disk.
    pub(super) fn give_up_reserve(&self) {
        let _ = std::fs::remove_file(self.reserve());
    }

    pub(super) fn shortage(&self) -> String {
        format!(
            "the disk of {} is full: the oldest minutes of the history go as new ones come. Free space on it, or \
             lower max_mb below what the disk has",
            self.path.display()
        )
    }
}

fn suffixed(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

/// A store in memory.
///
/// # Errors
/// If SQLite has no memory.
pub(super) fn open_in_memory(fleet: &FleetId) -> Result<Opened, String> {
    let opened = Connection::open_in_memory().and_then(|connection| {
        prepare(&connection, fleet)?;
        let coverage = reading::coverage(&connection)?;
        Ok((connection, coverage))
    });
    opened.map_err(|error| format!("the history in memory cannot be made: {error}"))
}

/// Sets what is set for a connection, and makes the tables of a new file.
fn prepare(connection: &Connection, fleet: &FleetId) -> rusqlite::Result<()> {
    // The first two hold for a new file alone, and must come before its first page.
    connection.pragma_update(None, "page_size", 4096)?;
    connection.pragma_update(None, "auto_vacuum", "INCREMENTAL")?;
    connection.query_row("PRAGMA journal_mode = WAL", [], |_| Ok(()))?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    // The journal is brought into the file after each transaction, and keeps its room: a full disk needs no more.
    connection.query_row("PRAGMA wal_autocheckpoint = 0", [], |_| Ok(()))?;
    connection.query_row("PRAGMA journal_size_limit = 1048576", [], |_| Ok(()))?;
    let version: i32 = connection.query_row("PRAGMA user_version", [], |row| row.get(0))?;
    if version == 0 {
        let making = connection.unchecked_transaction()?;
        making.execute_batch(SCHEMA)?;
        making.execute_batch(LATER_SCHEMA)?;
        making.execute(
            "INSERT INTO meta (key, value) VALUES ('fleet', ?1), ('sequence', 0)",
            [fleet.as_str()],
        )?;
        making.pragma_update(None, "application_id", APPLICATION_ID)?;
        making.pragma_update(None, "user_version", SCHEMA_VERSION)?;
        making.commit()?;
    }
    Ok(())
}

/// Brings the journal into the file, as far as readers allow. True if they allow all of it.
pub(super) fn checkpoint(connection: &Connection) -> rusqlite::Result<bool> {
    connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |row| {
        let (pages, settled): (i64, i64) = (row.get(1)?, row.get(2)?);
        Ok(pages == settled)
    })
}

/// Lets the file grow, or holds it at the size that it has.
pub(super) fn may_grow(connection: &Connection, grows: bool) -> rusqlite::Result<()> {
    let pages: i64 = if grows {
        MAX_PAGES
    } else {
        connection.query_row("PRAGMA page_count", [], |row| row.get(0))?
    };
    connection.query_row(&format!("PRAGMA max_page_count = {pages}"), [], |_| Ok(()))
}

/// Finds damage in a file that is small enough to be read as a whole.
fn check(connection: &Connection, path: &Path) -> rusqlite::Result<()> {
    if std::fs::metadata(path).is_ok_and(|found| found.len() > MAX_CHECKED_BYTES) {
        return Ok(());
    }
    let found: String = connection.query_row("PRAGMA quick_check(1)", [], |row| row.get(0))?;
    if found == "ok" {
        return Ok(());
    }
    let code = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_CORRUPT);
    Err(rusqlite::Error::SqliteFailure(code, Some(found)))
}

/// A file of another program, version or fleet is left as it is. Nothing may be written before this.
fn check_kind(connection: &Connection, path: &Path, fleet: &FleetId) -> Result<(), Unopened> {
    let shown = path.display();
    let number = |pragma: &str| -> rusqlite::Result<i32> {
        connection.query_row(&format!("PRAGMA {pragma}"), [], |row| row.get(0))
    };
    let (application, version) = (number("application_id")?, number("user_version")?);
    if application != APPLICATION_ID {
        let count = "SELECT count(*) FROM sqlite_schema";
        let tables: i64 = connection.query_row(count, [], |row| row.get(0))?;
        // A file in which nothing is yet is to become a history.
        if (application, version, tables) == (0, 0, 0) {
            return Ok(());
        }
        return Err(Unopened::Foreign(format!("{shown} is no history of a fleet; move it away")));
    }
    if version > SCHEMA_VERSION {
        return Err(Unopened::Foreign(format!(
            "{shown} has version {version}, and this program writes version {SCHEMA_VERSION}; use the program \
             that wrote it, or move the file away"
        )));
    }
    if version < 1 {
        return Err(Unopened::Damaged(format!("it has version {version}")));
    }
    let of = connection
        .query_row("SELECT value FROM meta WHERE key = 'fleet'", [], |row| row.get::<_, String>(0))
        .optional()
        .map_err(Unopened::of_content)?;
    match of {
        Some(of) if of == fleet.as_str() => Ok(()),
        Some(of) => {
            Err(Unopened::Foreign(format!("{shown} is the history of fleet {of}; move it away")))
        }
        None => Err(Unopened::Damaged("it is of no fleet".to_owned())),
    }
}

/// Whether an error says that a file is damaged: it is no database, or a value cannot be what we wrote.
pub(super) fn is_damage(error: &rusqlite::Error) -> bool {
    use rusqlite::Error::{
        FromSqlConversionFailure, IntegralValueOutOfRange, InvalidColumnType, Utf8Error,
    };
    match error {
        FromSqlConversionFailure(..)
        | IntegralValueOutOfRange(..)
        | InvalidColumnType(..)
        | Utf8Error(..) => true,
        _ => matches!(
            error.sqlite_error_code(),
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase)
        ),
    }
}
