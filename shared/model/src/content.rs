//! Why the content of a message between services is refused.

/// A field contradicts another one, or is out of range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct ContentError {
    /// The field as it stands in JSON.
    pub field: &'static str,
    /// What is wrong with it, or what would be right.
    pub problem: &'static str,
}

pub(crate) fn refuse(field: &'static str, problem: &'static str) -> Result<(), ContentError> {
    Err(ContentError { field, problem })
}
