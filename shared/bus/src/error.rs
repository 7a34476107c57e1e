//! Why a session does not open.

/// Why a session does not open.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A value or a file of the configuration is wrong.
    #[error("{0}")]
    Config(String),
    /// No router answers, or the address to listen at is taken.
    #[error("{0}")]
    Unreachable(String),
    /// Something else failed.
    #[error("opening the bus failed: {0}")]
    Failed(String),
}
