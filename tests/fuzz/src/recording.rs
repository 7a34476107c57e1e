//! Recordings of services, which come from others with their reports.

use muster_service::recording::{Entry, Head};
use muster_wire::recording::{MAGIC, Reader, RecordingError, VERSION, begin, frame};

use crate::packets::may_hold;
use crate::{Outcome, allocation, text};

/// Longest error about a recording, in characters.
const MAX_ERROR: usize = 1000;

/// Whether the rest is a file as it stands, or the contents of frames, each after its length in two
/// bytes, to which lengths and checksums are put that are right: no chance finds those.
pub(crate) fn recording(data: &[u8]) -> Outcome {
    let Some((is_framed, rest)) = data.split_first() else { return Outcome::Refused };
    let file = if is_framed & 1 == 1 { framed(rest) } else { rest.to_vec() };
    allocation::at_most(may_hold(file.len()), "reading a recording", || read(&file))
}

/// A file of contents.
pub(crate) fn framed(mut contents: &[u8]) -> Vec<u8> {
    let mut file = MAGIC.to_vec();
    file.push(VERSION);
    while let [low, high, rest @ ..] = contents {
        let length = usize::from(u16::from_le_bytes([*low, *high])).min(rest.len());
        let (content, rest) = rest.split_at(length);
        file.extend((content.len() as u32).to_le_bytes());
        file.extend(checksum(content).to_le_bytes());
        file.extend(content);
        contents = rest;
    }
    file
}

/// FNV-1a, folded to four bytes, as the format has it.
fn checksum(bytes: &[u8]) -> u32 {
    let sum = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |sum, byte| {
        (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    });
    (sum >> 32) as u32 ^ sum as u32
}

/// Reads a file to its end, or to where it is broken. What is read is written again, and read back as
/// the same.
fn read(file: &[u8]) -> Outcome {
    let (mut reader, head) = match Reader::open::<Head>(file) {
        Ok(opened) => opened,
        Err(error) => return refused(&error, file),
    };
    let mut copy = begin(&head).unwrap();
    let mut entries = Vec::new();
    let outcome = loop {
        match reader.next_entry::<Entry>() {
            Ok(Some(entry)) => {
                copy.extend(frame(&entry).unwrap());
                entries.push(entry);
            }
            Ok(None) => {
                assert_eq!(reader.offset(), file.len() as u64, "a part of the file is not read");
                break Outcome::Accepted;
            }
            Err(error) => break refused(&error, file),
        }
    };
    let (mut reader, again) = Reader::open::<Head>(copy.as_slice()).unwrap();
    assert_eq!(again, head);
    for entry in entries {
        assert_eq!(reader.next_entry::<Entry>().unwrap(), Some(entry));
    }
    assert_eq!(reader.next_entry::<Entry>().unwrap(), None);
    outcome
}

fn refused(error: &RecordingError, file: &[u8]) -> Outcome {
    text::check(&error.to_string(), MAX_ERROR);
    if let RecordingError::BreaksOff(at) | RecordingError::Damaged { at, .. } = error {
        assert!(*at <= file.len() as u64, "{at} is behind the end of the file");
    }
    Outcome::Refused
}
