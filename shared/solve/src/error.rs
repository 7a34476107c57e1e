//! What is wrong with an input.

/// Largest file that is read: the matrix of the largest fleet that is decomposed whole in short decimals
/// fits, and so do a dozen edges for each of a million robots.
pub(crate) const MAX_FILE_BYTES: u64 = 1 << 30;

/// Longest error message in characters; the rest of it is text of the file.
const MAX_MESSAGE: usize = 800;

/// What is wrong with the input.
#[derive(Debug, thiserror::Error)]
pub enum SolveError {
    /// The file cannot be read.
    #[error("cannot be read: {0}")]
    Read(std::io::Error),
    /// The file is larger than [`MAX_FILE_BYTES`].
    #[error("has more than {MAX_FILE_BYTES} bytes")]
    Size,
    /// A field is wrong.
    #[error("{field}: {problem}")]
    Field {
        /// Its path, such as `modalities[1].matrix[0][2]`.
        field: String,
        /// What is wrong and what would be right.
        problem: String,
    },
    /// Nothing satisfies limits, wishes and needs together.
    #[error("nothing satisfies what is asked of the teams: {0}")]
    Conflict(
        /// What contradicts each other, with the numbers.
        String,
    ),
    /// The text is no JSON, or lacks a field.
    #[error("{0}")]
    Json(String),
}

/// An error of one field.
pub(crate) fn refuse<T>(
    field: impl Into<String>,
    problem: impl Into<String>,
) -> Result<T, SolveError> {
    Err(SolveError::Field { field: tidy(&field.into()), problem: tidy(&problem.into()) })
}

/// Text of the file as it may stand on a terminal: control characters escaped, and not too long.
pub(crate) fn tidy(text: &str) -> String {
    let mut tidied = String::new();
    let mut length = 0;
    for character in text.chars() {
        if length >= MAX_MESSAGE {
            tidied.push('…');
            break;
        }
        let before = tidied.len();
        if character.is_control() {
            tidied.extend(character.escape_default());
            length += tidied.len() - before;
        } else {
            tidied.push(character);
            length += 1;
        }
    }
    tidied
}
