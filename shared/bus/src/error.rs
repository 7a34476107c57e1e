//! Why an endpoint is refused, and why a session does not open.

/// A text that is no endpoint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{endpoint:?} {problem}; write one like tcp/192.168.1.10:7447")]
pub struct EndpointError {
    /// The text, fit for a log line.
    pub endpoint: String,
    /// What is wrong with it.
    pub problem: &'static str,
}

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
