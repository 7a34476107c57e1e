//! Reads a file, or a live fleet that was saved, and checks it.

use std::io::Read;
use std::path::Path;

use super::error::{MAX_FILE_BYTES, SolveError};
use super::options::Options;
use super::problem::{self, Problem};
use super::{file, saved};

/// A text as a checked input.
pub(crate) fn parse(text: &[u8], options: Options) -> Result<Problem, SolveError> {
    match file::read(text) {
        Ok(file) => problem::check(file, options),
        Err(error) => match saved::SavedFleet::read(text)? {
            Some(fleet) => fleet.into_problem(options),
            None => Err(error),
        },
    }
}

pub(crate) fn read(path: &Path) -> Result<Vec<u8>, SolveError> {
    if path == Path::new("-") {
        return read_limited(std::io::stdin().lock());
    }
    read_limited(std::fs::File::open(path).map_err(SolveError::Read)?)
}

fn read_limited(source: impl Read) -> Result<Vec<u8>, SolveError> {
    let mut text = Vec::new();
    source.take(MAX_FILE_BYTES + 1).read_to_end(&mut text).map_err(SolveError::Read)?;
    if text.len() as u64 > MAX_FILE_BYTES { Err(SolveError::Size) } else { Ok(text) }
}
