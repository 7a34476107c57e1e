//! Writes recordings: chunks that are whole on the disk soon after they began.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufWriter, ErrorKind};
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};

use super::{Entry, MAX_TOPICS, METADATA};
use crate::messages::Form;

/// The name of the attachment with the whole JSON Schema of the bus.
pub const SCHEMA: &str = "muster-schema.json";

/// Most entries of the index that a file keeps in memory until its end; then the next file begins. They take about 150 MB:
/// six hours of a small fleet.
const MAX_INDEX_ENTRIES: usize = 4_000_000;

/// Highest number of a part: months of a small fleet, so that looking for a free number ends.
const MAX_PARTS: u32 = 10_000;

/// A recording that is written.
pub struct Recording {
    path: PathBuf,
    facts: BTreeMap<String, String>,
    writer: Writer<BufWriter<File>>,
    /// The same file, for what only the disk can promise.
    file: File,
    /// The number of each topic, and of its last message.
    topics: BTreeMap<String, (u16, u32)>,
    /// The topics of the present chunk.
    in_chunk: BTreeSet<u16>,
    index_entries: usize,
    /// How many files were begun.
    part: u32,
    messages: u64,
}

impl std::fmt::Debug for Recording {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let fields = (&self.path, self.messages);
        formatter.debug_tuple("Recording").field(&fields.0).field(&fields.1).finish()
    }
}

fn open(path: &Path) -> Result<(Writer<BufWriter<File>>, File), McapError> {
    // What was recorded is never written over.
    let file = File::options().write(true).create_new(true).open(path)?;
    let options = WriteOptions::new()
        .compression(Some(Compression::Lz4))
        // A chunk stays in memory until it is whole. Otherwise its head, which is written first and mended at the end, would
        // say after a kill that it is longer than any file.
        .disable_seeking(true)
        .profile("")
        .library(concat!("muster ", env!("CARGO_PKG_VERSION")));
    Ok((options.create(BufWriter::new(file.try_clone()?))?, file))
}

impl Recording {
    /// Begins a recording in a new file. `facts` say what is recorded.
    ///
    /// # Errors
    /// If the file is there already, or cannot be written.
    pub fn create(path: &Path, facts: BTreeMap<String, String>) -> Result<Self, McapError> {
        let (writer, file) = open(path)?;
        let mut recording = Self {
            path: path.to_owned(),
            facts,
            writer,
            file,
            topics: BTreeMap::new(),
            in_chunk: BTreeSet::new(),
            index_entries: 0,
            part: 1,
            messages: 0,
        };
        recording.begin()?;
        Ok(recording)
    }

    fn begin(&mut self) -> Result<(), McapError> {
        let metadata = Metadata { name: METADATA.to_owned(), metadata: self.facts.clone() };
        self.writer.write_metadata(&metadata)?;
        self.writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: SCHEMA.to_owned(),
            media_type: "application/schema+json".to_owned(),
            data: Cow::Borrowed(muster_wire::schema::text()),
        })?;
        self.flush()
    }

    /// Writes a message; false if the file has no room for one more topic. `form` is asked for when its topic is new.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(
        &mut self,
        entry: &Entry<'_>,
        form: impl FnOnce() -> Form,
    ) -> Result<bool, McapError> {
        if !self.topics.contains_key(entry.topic) {
            if self.topics.len() >= MAX_TOPICS {
                return Ok(false);
            }
            let Form { encoding, schema } = form();
            let schema = match schema {
                Some(schema) => {
                    self.writer.add_schema(&schema.name, &schema.encoding, &schema.data)?
                }
                None => 0,
            };
            let number =
                self.writer.add_channel(schema, entry.topic, &encoding, &BTreeMap::new())?;
            self.topics.insert(entry.topic.to_owned(), (number, 0));
        }
        let Some((channel, sequence)) = self.topics.get_mut(entry.topic) else { return Ok(false) };
        *sequence = sequence.wrapping_add(1);
        let header = MessageHeader {
            channel_id: *channel,
            sequence: *sequence,
            log_time: entry.at,
            publish_time: entry.at,
        };
        self.in_chunk.insert(*channel);
        self.writer.write_to_known_channel(&header, entry.bytes)?;
        self.messages += 1;
        Ok(true)
    }

    /// Ends the present chunk, and waits until it is on the disk: from then on no kill and no power cut loses it.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()?;
        self.file.sync_data()?;
        self.index_entries += self.in_chunk.len();
        self.in_chunk.clear();
        if self.index_entries >= MAX_INDEX_ENTRIES { self.next_part() } else { Ok(()) }
    }

    /// Ends this file, and goes on in the next one.
    fn next_part(&mut self) -> Result<(), McapError> {
        self.writer.finish()?;
        self.file.sync_all()?;
        let path = loop {
            self.part += 1;
            let path = part_of(&self.path, self.part);
            match open(&path) {
                Ok(opened) => {
                    (self.writer, self.file) = opened;
                    break path;
                }
                // Another recording has that part: the next number is taken.
                Err(McapError::Io(error))
                    if error.kind() == ErrorKind::AlreadyExists && self.part < MAX_PARTS => {}
                Err(error) => return Err(error),
            }
        };
        self.topics.clear();
        self.index_entries = 0;
        tracing::info!("the recording goes on in {}", path.display());
        self.begin()
    }

    /// Ends the recording with its index, and returns how many messages it has.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn finish(mut self) -> Result<u64, McapError> {
        self.writer.finish()?;
        self.file.sync_all()?;
        Ok(self.messages)
    }
}

/// The file with a later part of a recording: `run.mcap` goes on in `run.2.mcap`.
#[must_use]
pub fn part_of(path: &Path, part: u32) -> PathBuf {
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let ending = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    path.with_file_name(format!("{name}.{part}.{ending}"))
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "a test cuts the files that are read")]
mod tests {
    use std::ops::ControlFlow;

    use super::super::reading::{End, Item, read};
    use super::*;

    fn form() -> Form {
        crate::messages::json_form("pose")
    }

    fn messages(path: &Path) -> (Vec<(String, u64)>, Result<End, McapError>) {
        let mut all = Vec::new();
        let end = read(File::open(path).unwrap(), |item| {
            if let Item::Message(entry) = item {
                all.push((entry.topic.to_owned(), entry.at));
            }
            ControlFlow::Continue(())
        });
        (all, end)
    }

    #[test]
    fn what_was_flushed_is_read_wherever_the_file_is_cut() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let facts = BTreeMap::from([("fleet".to_owned(), "alpha".to_owned())]);
        let mut recording = Recording::create(&path, facts.clone()).unwrap();
        assert!(Recording::create(&path, facts.clone()).is_err(), "nothing is written over");
        let mut sizes = Vec::new();
        for chunk in 0..4_u64 {
            for at in 0..10 {
                let topic = format!("/robot/r{at}/pose");
                let entry =
                    Entry { topic: &topic, at: chunk * 10 + at, bytes: b"{\"x\":1.0,\"y\":2.0}" };
                assert!(recording.write(&entry, form).unwrap());
            }
            recording.flush().unwrap();
            sizes.push(usize::try_from(std::fs::metadata(&path).unwrap().len()).unwrap());
        }
        assert_eq!(recording.finish().unwrap(), 40);
        let (all, end) = messages(&path);
        assert_eq!((all.len(), end.unwrap()), (40, End::Whole));
        assert!(all.iter().map(|(_, at)| *at).eq(0..40));

        let bytes = std::fs::read(&path).unwrap();
        let cut = folder.path().join("cut.mcap");
        // The attachment is long; the messages stand behind it.
        let lengths = (0..bytes.len()).step_by(9_973);
        for length in lengths.chain((bytes.len() - 4_000..bytes.len()).step_by(13)) {
            std::fs::write(&cut, &bytes[..length]).unwrap();
            let (all, end) = messages(&cut);
            let flushed = sizes.iter().filter(|size| **size <= length).count();
            assert!(
                all.len() >= flushed * 10,
                "{} of {flushed} chunks in {length} bytes",
                all.len()
            );
            if flushed > 0 {
                assert!(matches!(end, Ok(End::Cut | End::Whole)), "{length}: {end:?}");
            }
        }
        std::fs::write(&cut, b"no recording").unwrap();
        assert!(messages(&cut).1.is_err());
    }

    #[test]
    fn a_recorder_that_is_killed_leaves_no_half_of_a_chunk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut recording = Recording::create(&path, BTreeMap::new()).unwrap();
        let write = |recording: &mut Recording, at: u64| {
            let text = format!("{{\"x\":{}.0,\"y\":{}.0}}", at * 7_919 % 1_000, at * 104_729 % 977);
            let entry = Entry { topic: "/robot/r1/pose", at, bytes: text.as_bytes() };
            recording.write(&entry, form).unwrap();
        };
        write(&mut recording, 0);
        recording.flush().unwrap();
        // Less than a chunk, and more than any buffer before the file.
        (1..6_000).for_each(|at| write(&mut recording, at));
        std::mem::forget(recording);
        let (all, end) = messages(&path);
        assert_eq!((all.len(), end.unwrap()), (1, End::Cut));
    }

    #[test]
    fn a_part_that_is_there_is_left_alone_and_the_next_number_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        std::fs::write(part_of(&path, 2), b"of another").unwrap();
        let mut recording = Recording::create(&path, BTreeMap::new()).unwrap();
        recording.next_part().unwrap();
        let entry = Entry { topic: "/robot/r1/pose", at: 7, bytes: b"{}" };
        recording.write(&entry, form).unwrap();
        recording.finish().unwrap();
        assert_eq!(std::fs::read(part_of(&path, 2)).unwrap(), b"of another");
        assert_eq!(messages(&part_of(&path, 3)).0, [("/robot/r1/pose".to_owned(), 7)]);
    }

    #[test]
    fn damage_is_an_error_and_no_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut recording = Recording::create(&path, BTreeMap::new()).unwrap();
        let entry = Entry { topic: "/robot/r1/pose", at: 1, bytes: b"{\"x\":1.0,\"y\":2.0}" };
        recording.write(&entry, form).unwrap();
        recording.finish().unwrap();
        let whole = std::fs::read(&path).unwrap();
        // The attachment is long and is not looked into; what comes before and behind it is.
        let places = (0..400).chain(whole.len() - 700..whole.len());
        for at in places {
            let mut bytes = whole.clone();
            bytes[at] ^= 0xff;
            std::fs::write(&path, &bytes).unwrap();
            let _ = messages(&path);
        }
    }

    #[test]
    fn a_later_part_has_its_number_before_the_ending() {
        assert_eq!(part_of(Path::new("/a/run.mcap"), 2), Path::new("/a/run.2.mcap"));
    }
}
