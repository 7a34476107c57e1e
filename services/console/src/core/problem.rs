//! Why something has no answer, and what may have come of it.

/// Why a command or a question has no answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// What may have come of it.
    pub kind: ProblemKind,
    /// Why, for people.
    pub reason: String,
}

/// What may have come of what has no answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProblemKind {
    /// Nothing: it makes no sense, or is not allowed.
    Refused,
    /// Nothing for now: the same may be sent again.
    Unavailable,
    /// It holds, and a restart of the service may forget it.
    Unstored,
    /// It may hold.
    Unknown,
}

impl ProblemKind {
    /// The field of a reply that has the reason.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Refused => "refused",
            Self::Unavailable => "unavailable",
            Self::Unstored => "unstored",
            Self::Unknown => "unknown",
        }
    }
}

impl Problem {
    /// Nothing was done, for this reason.
    #[must_use]
    pub fn refused(reason: impl Into<String>) -> Self {
        Self { kind: ProblemKind::Refused, reason: reason.into() }
    }
}
