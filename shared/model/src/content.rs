//! Checked content of messages between services, and why content is refused.

use std::ops::Deref;
use std::sync::Arc;

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

/// The content of a message, with the rules that it must satisfy by itself, whatever its reader holds.
pub trait Content {
    /// Checks shapes, order and numbers.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    fn check(&self) -> Result<(), ContentError>;
}

/// Content that satisfies [`Content::check`], shared by all who hold it.
#[derive(Debug, PartialEq)]
pub struct Checked<T>(Arc<T>);

impl<T: Content> Checked<T> {
    /// Checks content that came from outside.
    ///
    /// # Errors
    /// As [`Content::check`].
    pub fn new(content: T) -> Result<Self, ContentError> {
        content.check()?;
        Ok(Self(Arc::new(content)))
    }
}

impl<T> Checked<T> {
    /// Content that satisfies the rules by construction: the output of the service that calls this. Tests
    /// also make faulty messages by it.
    #[must_use]
    pub fn new_unchecked(content: T) -> Self {
        Self(Arc::new(content))
    }

    /// Whether both are the same allocation.
    #[must_use]
    pub fn ptr_eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// The shared content.
    #[must_use]
    pub fn into_arc(self) -> Arc<T> {
        self.0
    }
}

impl<T: Clone> Checked<T> {
    /// The content to change, for tests that make faulty messages.
    pub fn make_mut_unchecked(&mut self) -> &mut T {
        Arc::make_mut(&mut self.0)
    }
}

impl<T> Clone for Checked<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> Deref for Checked<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T> AsRef<T> for Checked<T> {
    fn as_ref(&self) -> &T {
        &self.0
    }
}
