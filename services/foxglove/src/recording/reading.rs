//! Reads recordings, also those that were cut, were damaged, or were made to do harm.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read};
use std::ops::ControlFlow;

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use muster_model::limits::MAX_ID_LENGTH;

use super::{Entry, MAX_TOPICS, METADATA, lengths};

/// Longest record that is read, in bytes: the longest message of the bus. A chunk is kept whole, packed and unpacked, and is
/// no longer: the recorder ends it after about a megabyte.
const MAX_RECORD_BYTES: usize = 64 * 1024 * 1024;

/// What the topics of robots begin with. Only they are played.
const TOPICS: &str = "/robot/";

/// Longest topic that is kept, in bytes: a robot, a modality, and what stands around them.
const MAX_TOPIC_BYTES: usize = 2 * MAX_ID_LENGTH + 32;

/// The compression of chunks, the only one that the recorder writes.
const LZ4: &str = "lz4";

/// What is read of a recording.
#[derive(Debug)]
pub enum Item<'a> {
    /// What was recorded.
    Facts(&'a BTreeMap<String, String>),
    /// A message of a robot.
    Message(Entry<'a>),
}

/// How a file ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// As it should.
    Whole,
    /// Before its end: the recorder was killed. What came before is there.
    Cut,
    /// With something that cannot be read, and why. What came before is there.
    Damaged(String),
    /// The reader wanted no more.
    Stopped,
}

/// Why no more of a file is read.
enum Halt {
    End(End),
    Error(McapError),
}

impl From<McapError> for Halt {
    fn from(error: McapError) -> Self {
        Self::Error(error)
    }
}

/// Takes records in the order of the file.
struct Taking<F> {
    take: F,
    topics: BTreeMap<u16, String>,
    has_messages: bool,
}

impl<F: FnMut(Item<'_>) -> ControlFlow<()>> Taking<F> {
    fn record(&mut self, opcode: u8, data: &[u8]) -> Result<(), Halt> {
        // The parser of the library panics at some attachments: it is asked for what is used, and for nothing else.
        if !matches!(opcode, op::CHANNEL | op::MESSAGE | op::METADATA) {
            return Ok(());
        }
        let flow = match parsed(opcode, data)? {
            Record::Channel(channel) => {
                let topic = channel.topic;
                self.topics.remove(&channel.id);
                let is_wanted = topic.starts_with(TOPICS) && topic.len() <= MAX_TOPIC_BYTES;
                if is_wanted && self.topics.len() < MAX_TOPICS {
                    self.topics.insert(channel.id, topic);
                }
                ControlFlow::Continue(())
            }
            Record::Metadata(metadata) if metadata.name == METADATA => {
                (self.take)(Item::Facts(&metadata.metadata))
            }
            Record::Message { header, data } => match self.topics.get(&header.channel_id) {
                Some(topic) => {
                    self.has_messages = true;
                    (self.take)(Item::Message(Entry { topic, at: header.log_time, bytes: &data }))
                }
                None => ControlFlow::Continue(()),
            },
            _ => ControlFlow::Continue(()),
        };
        if flow.is_break() { Err(Halt::End(End::Stopped)) } else { Ok(()) }
    }

    /// Takes the records of a chunk, or none of them if it is damaged.
    fn chunk(&mut self, data: &[u8]) -> Result<(), Halt> {
        let Record::Chunk { header, .. } = parsed(op::CHUNK, data)? else {
            return Ok(());
        };
        // The reader of the library miscounts chunks that are not compressed.
        if header.compression != LZ4 {
            return Err(McapError::UnsupportedCompression(header.compression).into());
        }
        let options = options()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true);
        let mut reader = LinearReader::new_with_options(options);
        // A chunk by itself is a file without its begin and its end.
        let length = u64::try_from(data.len()).unwrap_or(u64::MAX).to_le_bytes();
        let mut rest = (&[op::CHUNK][..]).chain(&length[..]).chain(data);
        while let Some(event) = reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let count = rest.read(reader.insert(wanted)).map_err(McapError::from)?;
                    reader.notify_read(count);
                }
                LinearReadEvent::Record { opcode, data } => self.record(opcode, data)?,
            }
        }
        Ok(())
    }
}

/// Reads a record whose texts are as long as they say.
fn parsed(opcode: u8, record: &[u8]) -> Result<Record<'_>, McapError> {
    if lengths::fit(opcode, record) {
        mcap::parse_record(opcode, record)
    } else {
        let problem = "a text is longer than its record";
        Err(std::io::Error::new(ErrorKind::InvalidData, problem).into())
    }
}

fn options() -> LinearReaderOptions {
    LinearReaderOptions::default().with_record_length_limit(MAX_RECORD_BYTES)
}

/// Reads what robots said in a recording from its begin, message by message.
///
/// # Errors
/// If the file cannot be read, or is none. One that ends too early, or has damage behind its first message, is no error.
pub fn read(
    mut file: impl Read,
    take: impl FnMut(Item<'_>) -> ControlFlow<()>,
) -> Result<End, McapError> {
    let mut taking = Taking { take, topics: BTreeMap::new(), has_messages: false };
    match read_all(&mut file, &mut taking) {
        Halt::End(end) => Ok(end),
        Halt::Error(error) if taking.has_messages => Ok(End::Damaged(error.to_string())),
        Halt::Error(error) => Err(error),
    }
}

fn read_all<F: FnMut(Item<'_>) -> ControlFlow<()>>(
    file: &mut impl Read,
    taking: &mut Taking<F>,
) -> Halt {
    let mut reader = LinearReader::new_with_options(options().with_emit_chunks(true));
    let mut is_recording = false;
    while let Some(event) = reader.next_event() {
        let taken = match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                match file.read(reader.insert(wanted)) {
                    Ok(count) => reader.notify_read(count),
                    Err(error) => return Halt::Error(error.into()),
                }
                continue;
            }
            // What follows is the index.
            Ok(LinearReadEvent::Record { opcode: op::DATA_END, .. }) => break,
            Ok(LinearReadEvent::Record { opcode: op::CHUNK, data }) => taking.chunk(data),
            Ok(LinearReadEvent::Record { opcode, data }) => taking.record(opcode, data),
            // A file that was cut within a record, or between two; one that never began is none.
            Err(McapError::UnexpectedEof) if is_recording => Err(Halt::End(End::Cut)),
            Err(error) => Err(Halt::Error(error)),
        };
        if let Err(halt) = taken {
            return halt;
        }
        is_recording = true;
    }
    Halt::End(End::Whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages(file: &[u8]) -> (Vec<(String, u64)>, Result<End, McapError>) {
        let mut all = Vec::new();
        let end = read(file, |item| {
            if let Item::Message(entry) = item {
                all.push((entry.topic.to_owned(), entry.at));
            }
            ControlFlow::Continue(())
        });
        (all, end)
    }

    fn framed(opcode: u8, body: &[u8]) -> Vec<u8> {
        let length = u64::try_from(body.len()).unwrap();
        [&[opcode][..], &length.to_le_bytes(), body].concat()
    }

    fn channel(number: u16, topic: &str) -> Vec<u8> {
        let text = |text: &str| {
            [&u32::try_from(text.len()).unwrap().to_le_bytes()[..], text.as_bytes()].concat()
        };
        let numbers = [number.to_le_bytes(), [0; 2]].concat();
        framed(op::CHANNEL, &[numbers, text(topic), text("json"), vec![0; 4]].concat())
    }

    fn message(number: u16, at: u64) -> Vec<u8> {
        let times = [at.to_le_bytes(), at.to_le_bytes()].concat();
        framed(op::MESSAGE, &[&number.to_le_bytes()[..], &[0; 4], &times, b"{}"].concat())
    }

    fn chunk(compression: &str, records: &[u8], length: u64) -> Vec<u8> {
        let name = u32::try_from(compression.len()).unwrap().to_le_bytes();
        let head = [&[0; 16][..], &length.to_le_bytes(), &[0; 4], &name, compression.as_bytes()];
        let head = [&head.concat()[..], &length.to_le_bytes()].concat();
        framed(op::CHUNK, &[&head[..], records].concat())
    }

    fn made_of(parts: &[Vec<u8>]) -> (Vec<(String, u64)>, Result<End, McapError>) {
        messages(&[mcap::MAGIC, &parts.concat()].concat())
    }

    #[test]
    fn an_attachment_without_its_sum_is_no_panic() {
        for length in 0..40 {
            let parts = [
                framed(op::ATTACHMENT, &vec![0; length]),
                channel(1, "/robot/r/pose"),
                message(1, 5),
            ];
            let (all, end) = made_of(&parts);
            assert_eq!((all.len(), end.unwrap()), (1, End::Cut), "{length}");
        }
    }

    #[test]
    fn a_chunk_that_no_recorder_writes_is_refused() {
        let inside = message(1, 5);
        for length in 0..=u64::try_from(inside.len()).unwrap() {
            assert!(made_of(&[chunk("", &inside, length)]).1.is_err(), "{length}");
            assert!(made_of(&[chunk("zstd", &inside, length)]).1.is_err(), "{length}");
            let _ = made_of(&[chunk("lz4", &inside, length)]);
        }
    }

    #[test]
    fn what_came_before_the_damage_is_read() {
        let good = [channel(1, "/robot/r/pose"), message(1, 5)];
        let bad = [chunk("zstd", b"", 0), framed(op::CHANNEL, b"ab"), framed(op::CHUNK, b"ab")];
        for bad in bad {
            assert!(made_of(std::slice::from_ref(&bad)).1.is_err(), "it is no recording");
            let (all, end) = made_of(&[&good[..], &[bad, message(1, 6)]].concat());
            assert_eq!(all, [("/robot/r/pose".to_owned(), 5)]);
            assert!(matches!(end, Ok(End::Damaged(_))), "{end:?}");
        }
    }

    #[test]
    fn only_topics_of_robots_are_kept_and_none_that_is_too_long() {
        let long = format!("/robot/{}", "r".repeat(MAX_TOPIC_BYTES));
        let topics = ["/tf", "/json/teams", &long, "/robot/r/pose"];
        let numbers = 0_u16..;
        let parts: Vec<Vec<u8>> = numbers
            .zip(topics)
            .flat_map(|(number, topic)| [channel(number, topic), message(number, number.into())])
            .collect();
        let (all, end) = made_of(&parts);
        assert_eq!((all, end.unwrap()), (vec![("/robot/r/pose".to_owned(), 3)], End::Cut));
        // A recording never calls a topic otherwise; a file that does loses it.
        let renamed = [channel(1, "/robot/r/pose"), channel(1, "/tf"), message(1, 5)];
        assert_eq!(made_of(&renamed).0, []);
    }
}
