//! Records of a service in the order of time, in a database file of its own.

use std::path::{Path, PathBuf};

use anyhow::Context;
use muster_model::id::{FleetId, ServiceName};
use muster_service::{Record, RecordRange};
use redb::{Database, ReadableDatabase, ReadableTable, ReadableTableMetadata, TableDefinition};

/// Records by moment (microseconds since 1970) and number.
const RECORDS: TableDefinition<'_, (u64, u64), &[u8]> = TableDefinition::new("records");

/// Most records that are kept; the oldest is dropped. A few weeks of events of a busy fleet.
const MAX_RECORDS: u64 = 1_000_000;

/// Most records of one lookup: what a console shows, many times over.
const MAX_RECORDS_PER_LOOKUP: usize = 10_000;

/// Most bytes of one lookup: a quarter of the largest message.
const MAX_BYTES_PER_LOOKUP: usize = 16 * 1024 * 1024;

/// The records of one service. The database is opened with the first record or lookup, since most
/// services have none.
#[derive(Debug)]
pub struct RecordStore {
    path: Option<PathBuf>,
    database: Option<Database>,
    next_number: u64,
}

impl RecordStore {
    /// The file `{directory}/{fleet}/{service}.records`; without a directory, records last as long as
    /// the process.
    #[must_use]
    pub fn new(directory: Option<&Path>, fleet: &FleetId, service: ServiceName) -> Self {
        let name = format!("{service}.records");
        let path = directory.map(|directory| directory.join(fleet.as_str()).join(name));
        Self { path, database: None, next_number: 0 }
    }

    fn database(&mut self) -> anyhow::Result<&Database> {
        if self.database.is_none() {
            let database = match &self.path {
                Some(path) => {
                    let directory = path.parent().unwrap_or(Path::new("."));
                    std::fs::create_dir_all(directory).with_context(|| {
                        format!("cannot make the directory {}", directory.display())
                    })?;
                    Database::create(path)
                        .with_context(|| format!("cannot open {}", path.display()))?
                }
                None => Database::builder()
                    .create_with_backend(redb::backends::InMemoryBackend::new())?,
            };
            let writing = database.begin_write()?;
            {
                let table = writing.open_table(RECORDS)?;
                let last = table.last()?.map(|(key, _)| key.value().1);
                self.next_number = last.map_or(0, |number| number + 1);
            }
            writing.commit()?;
            self.database = Some(database);
        }
        self.database.as_ref().context("the database is closed")
    }

    /// Appends a record. It is on the disk when this returns.
    ///
    /// # Errors
    /// If the database cannot be opened or written.
    pub fn append(&mut self, record: &Record) -> anyhow::Result<()> {
        self.database()?;
        let number = self.next_number;
        self.next_number += 1;
        let writing = self.database()?.begin_write()?;
        {
            let mut table = writing.open_table(RECORDS)?;
            table.insert((record.at, number), record.content.as_slice())?;
            while table.len()? > MAX_RECORDS {
                table.pop_first()?;
            }
        }
        writing.commit()?;
        Ok(())
    }

    /// The newest records of a range, oldest first.
    ///
    /// # Errors
    /// If the database cannot be opened or read.
    pub fn look_up(&mut self, range: &RecordRange) -> anyhow::Result<Vec<Record>> {
        if range.from >= range.until {
            return Ok(Vec::new());
        }
        let reading = self.database()?.begin_read()?;
        let table = reading.open_table(RECORDS)?;
        let limit = range.limit.min(MAX_RECORDS_PER_LOOKUP);
        let (mut records, mut bytes) = (Vec::new(), 0);
        for entry in table.range((range.from, 0)..(range.until, 0))?.rev().take(limit) {
            let (key, content) = entry?;
            bytes += content.value().len();
            if bytes > MAX_BYTES_PER_LOOKUP {
                break;
            }
            records.push(Record { at: key.value().0, content: content.value().to_vec() });
        }
        records.reverse();
        Ok(records)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(at: u64, content: &str) -> Record {
        Record { at, content: content.as_bytes().to_vec() }
    }

    fn all(store: &mut RecordStore) -> Vec<Record> {
        store.look_up(&RecordRange { from: 0, until: u64::MAX, limit: 100 }).unwrap()
    }

    #[test]
    fn records_survive_a_restart_in_order_of_time() {
        let folder = tempfile::tempdir().unwrap();
        let fleet = FleetId::new("f").unwrap();
        let open = || RecordStore::new(Some(folder.path()), &fleet, ServiceName::Auditor);
        let mut store = open();
        for (at, content) in [(5, "b"), (3, "a"), (5, "c")] {
            store.append(&record(at, content)).unwrap();
        }
        drop(store);
        let mut store = open();
        store.append(&record(5, "d")).unwrap();
        let expected = [record(3, "a"), record(5, "b"), record(5, "c"), record(5, "d")];
        assert_eq!(all(&mut store), expected);
    }

    #[test]
    fn a_lookup_gives_the_newest_of_its_range() {
        let mut store = RecordStore::new(None, &FleetId::new("f").unwrap(), ServiceName::Auditor);
        for at in 0..10 {
            store.append(&record(at, "x")).unwrap();
        }
        let range = RecordRange { from: 2, until: 8, limit: 3 };
        let found = store.look_up(&range).unwrap();
        assert_eq!(found.iter().map(|record| record.at).collect::<Vec<_>>(), [5, 6, 7]);
        let nothing = RecordRange { from: 8, until: 2, limit: 3 };
        assert!(store.look_up(&nothing).unwrap().is_empty());
    }
}
