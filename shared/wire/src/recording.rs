//! The bytes of a recording: a head, then one frame per entry.
//!
//! A file begins with [`MAGIC`] and the [`VERSION`] of the entries. Every frame is its length and a
//! checksum, four bytes each with the lowest first, and its content. The head is JSON, so that a
//! program of any version can say who wrote a file; entries are bincode. A file may break off
//! anywhere, as it does when the service is killed; the checksum distinguishes damage from that.

use std::io::Read;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::envelope::{self, EnvelopeError};

pub use crate::envelope::MAX_FRAME;
use crate::packet::quoted;

/// The first bytes of every recording.
pub const MAGIC: [u8; 8] = *b"\xB7mustrec";

/// Version of the entries. Any change of their types is a new version.
pub const VERSION: u8 = 5;

/// Length and checksum of a frame.
const FRAME_HEAD: usize = 8;

/// Largest head in bytes: names, settings, and a patch of them.
const MAX_HEAD: usize = 1024 * 1024;

/// Why a file is no recording, or not one that can be read on.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The first bytes are others.
    #[error("this is no recording of a service; --record makes one")]
    NotARecording,
    /// The entries have another form.
    #[error(
        "the recording has version {0}, and this program reads version {VERSION}; \
         use the program that wrote it"
    )]
    Version(u8),
    /// The file ends within a frame, as it does when the service was killed.
    #[error("the recording breaks off at byte {0}")]
    BreaksOff(u64),
    /// The bytes of a frame are not those that were written.
    #[error("the recording is damaged at byte {at}: {problem}")]
    Damaged {
        /// Where the frame begins.
        at: u64,
        /// What is wrong with it.
        problem: String,
    },
    /// The file cannot be read.
    #[error("the recording cannot be read: {0}")]
    Read(#[from] std::io::Error),
}

/// FNV-1a, folded to four bytes: damage is to be found, no attacker to be kept out.
fn checksum(bytes: &[u8]) -> u32 {
    let mut sum = 0xcbf2_9ce4_8422_2325_u64;
    for byte in bytes {
        sum = (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    }
    let [a, b, c, d, e, f, g, h] = sum.to_le_bytes();
    u32::from_le_bytes([a ^ e, b ^ f, c ^ g, d ^ h])
}

pub(crate) fn framed(content: &[u8], limit: usize) -> Result<Vec<u8>, EnvelopeError> {
    let size = content.len();
    let length = u32::try_from(size).ok().filter(|_| size <= limit);
    let Some(length) = length else { return Err(EnvelopeError::TooLarge { size, limit }) };
    let mut frame = Vec::with_capacity(FRAME_HEAD + size);
    frame.extend(length.to_le_bytes());
    frame.extend(checksum(content).to_le_bytes());
    frame.extend(content);
    Ok(frame)
}

/// The content of bytes that are one frame.
///
/// # Errors
/// What is wrong with them.
pub(crate) fn unframed(bytes: &[u8], limit: usize) -> Result<&[u8], String> {
    let (Some(head), Some(content)) = (bytes.get(..FRAME_HEAD), bytes.get(FRAME_HEAD..)) else {
        return Err("it breaks off".to_owned());
    };
    let &[a, b, c, d, e, f, g, h] = head else { return Err("it breaks off".to_owned()) };
    let (length, sum) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
    if content.len() > limit || content.len() != length as usize {
        return Err(format!("it has {} bytes and not {length}", content.len()));
    }
    if checksum(content) != sum {
        return Err("the checksum is another one".to_owned());
    }
    Ok(content)
}

/// What a file begins with.
///
/// # Errors
/// [`EnvelopeError`] if the head does not encode, or is too large.
pub fn begin(head: &impl Serialize) -> Result<Vec<u8>, EnvelopeError> {
    let head =
        serde_json::to_vec(head).map_err(|error| EnvelopeError::Encode(error.to_string()))?;
    let mut bytes = MAGIC.to_vec();
    bytes.push(VERSION);
    bytes.extend(framed(&head, MAX_HEAD)?);
    Ok(bytes)
}

/// One entry as a frame.
///
/// # Errors
/// [`EnvelopeError`] if the entry does not encode, or is larger than [`MAX_FRAME`].
pub fn frame(entry: &impl Serialize) -> Result<Vec<u8>, EnvelopeError> {
    framed(&envelope::pack(entry)?, MAX_FRAME)
}

/// Reads a recording from its beginning, one entry after the other.
#[derive(Debug)]
pub struct Reader<R> {
    input: R,
    offset: u64,
}

impl<R: Read> Reader<R> {
    /// Reads the head.
    ///
    /// # Errors
    /// [`RecordingError`] if this is no recording, or one of another version.
    pub fn open<H: DeserializeOwned>(input: R) -> Result<(Self, H), RecordingError> {
        let mut reader = Self { input, offset: 0 };
        let mut start = [0; MAGIC.len() + 1];
        if reader.fill(&mut start)? < start.len() || start[..MAGIC.len()] != MAGIC {
            return Err(RecordingError::NotARecording);
        }
        // The head's form is the same in all versions, but its fields may be others.
        let version = start[MAGIC.len()];
        if version != VERSION {
            return Err(RecordingError::Version(version));
        }
        let at = reader.offset;
        let content = reader.content(MAX_HEAD)?.ok_or(RecordingError::BreaksOff(at))?;
        // The text may hold arbitrary bytes of the file.
        let head = serde_json::from_slice(&content)
            .map_err(|error| RecordingError::Damaged { at, problem: quoted(&error.to_string()) })?;
        Ok((reader, head))
    }

    /// The next entry; none at the end of the file.
    ///
    /// # Errors
    /// [`RecordingError`] if the file breaks off or is damaged here; nothing can be read after it.
    pub fn next_entry<T: DeserializeOwned>(&mut self) -> Result<Option<T>, RecordingError> {
        let at = self.offset;
        let Some(content) = self.content(MAX_FRAME)? else { return Ok(None) };
        let entry = envelope::unpack(&content)
            .map_err(|error| RecordingError::Damaged { at, problem: error.to_string() })?;
        Ok(Some(entry))
    }

    /// How many bytes were read.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.offset
    }

    fn content(&mut self, limit: usize) -> Result<Option<Vec<u8>>, RecordingError> {
        let at = self.offset;
        let mut head = [0; FRAME_HEAD];
        match self.fill(&mut head)? {
            0 => return Ok(None),
            FRAME_HEAD => {}
            _ => return Err(RecordingError::BreaksOff(at)),
        }
        let [a, b, c, d, e, f, g, h] = head;
        let (length, sum) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        if length as usize > limit {
            let problem = format!("a frame of {length} bytes is more than the limit of {limit}");
            return Err(RecordingError::Damaged { at, problem });
        }
        // A length that is wrong costs no more memory than the file has bytes.
        let mut content = Vec::new();
        let read = self.input.by_ref().take(u64::from(length)).read_to_end(&mut content)?;
        self.offset += read as u64;
        if read < length as usize {
            return Err(RecordingError::BreaksOff(at));
        }
        if checksum(&content) != sum {
            let problem = "the checksum is another one".to_owned();
            return Err(RecordingError::Damaged { at, problem });
        }
        Ok(Some(content))
    }

    /// Reads until the buffer is full or the file ends, and returns how many bytes came.
    fn fill(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let mut filled = 0;
        while filled < buffer.len() {
            match self.input.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(read) => filled += read,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.offset += filled as u64;
        Ok(filled)
    }
}
