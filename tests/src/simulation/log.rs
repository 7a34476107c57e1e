//! What happened in a run, line by line.

use std::fmt::{self, Write as _};

use super::clock::Micros;
use super::plan::Span;

/// Most lines that are kept: some minutes of a small fleet.
const MAX_LINES: usize = 400_000;

/// Most characters of a message that are shown: a division of a small fleet is shorter.
const MAX_TEXT: usize = 4000;

/// The log of a run. Nothing is written unless it is to be read.
#[derive(Debug, Default)]
pub(crate) struct Log {
    lines: Option<Vec<String>>,
}

impl Log {
    /// A log that keeps its lines, or none.
    pub(crate) fn new(kept: bool) -> Self {
        Self { lines: kept.then(Vec::new) }
    }

    /// Whether lines are kept, so that it is worth the trouble to make them.
    pub(crate) fn is_kept(&self) -> bool {
        self.lines.is_some()
    }

    /// Writes a line.
    pub(crate) fn line(&mut self, now: Micros, text: fmt::Arguments<'_>) {
        if let Some(lines) = self.lines.as_mut().filter(|lines| lines.len() < MAX_LINES) {
            let mut line = format!("{:>12}  ", Span(now).to_string());
            // Writing to a text cannot fail.
            let _ = line.write_fmt(text);
            lines.push(line);
        }
    }

    /// All lines.
    pub(crate) fn into_lines(self) -> Vec<String> {
        self.lines.unwrap_or_default()
    }
}

/// What bytes say, if they are JSON; no more than fits into a line.
pub(crate) fn readable(bytes: &[u8]) -> &str {
    let text = std::str::from_utf8(bytes).unwrap_or_default();
    let end = text.char_indices().nth(MAX_TEXT).map_or(text.len(), |(end, _)| end);
    if text.starts_with('{') { &text[..end] } else { "" }
}

/// A short name for bytes, so that logs of two runs differ where the bytes do.
pub(crate) fn digest(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193))
}
