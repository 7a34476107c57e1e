//! Exit codes, the same for every program.

use std::fmt;
use std::process::ExitCode;

use crate::bus::OpenError;

/// Why a program ends without success.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// Something failed while it ran.
    Failure = 1,
    /// A flag, a file or a setting is wrong.
    Usage = 2,
    /// The bus cannot be reached, no answer came, or a service cannot do it now.
    Unreachable = 3,
    /// Nothing satisfies what is asked of the teams.
    Conflict = 4,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Their part of `--help`.
pub const HELP: &str = "Exit codes: 0 done, or stopped by a signal; 1 something failed while running, or a change was stopped before its answer; \
2 a flag, file or setting is wrong; 3 the bus cannot be reached, no answer came, or a service cannot do it now; 4 nothing satisfies the limits, wishes and needs of a solve.";

/// An error that knows its exit code.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct ExitError {
    /// The code to end with.
    pub exit: Exit,
    /// What went wrong and what to do.
    pub message: String,
}

impl ExitError {
    /// A wrong flag, file or setting.
    #[must_use]
    pub fn usage(message: impl fmt::Display) -> Self {
        Self { exit: Exit::Usage, message: message.to_string() }
    }

    /// An unreachable bus.
    #[must_use]
    pub fn unreachable(message: impl fmt::Display) -> Self {
        Self { exit: Exit::Unreachable, message: message.to_string() }
    }
}

/// Ends a `main`: writes the error with its causes to standard error, and chooses the code.
#[must_use]
pub fn finish(result: anyhow::Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A reader that has gone away, as in `muster teams | head -1`, is no failure.
            if is_broken_pipe(&error) {
                return ExitCode::SUCCESS;
            }
            eprintln!("error: {error:#}");
            exit_of(&error).into()
        }
    }
}

fn exit_of(error: &anyhow::Error) -> Exit {
    match (error.downcast_ref::<ExitError>(), error.downcast_ref::<OpenError>()) {
        (Some(error), _) => error.exit,
        (_, Some(OpenError::Config(_))) => Exit::Usage,
        (_, Some(OpenError::Unreachable(_))) => Exit::Unreachable,
        _ => Exit::Failure,
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause
            .downcast_ref::<std::io::Error>()
            .is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
    })
}
