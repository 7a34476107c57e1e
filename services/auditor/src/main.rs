//! The `muster-auditor` process: the core of this crate in the common shell.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_runtime::service::main::<muster_auditor::Auditor>(
        "Scores every division by silhouettes, independent of the service that made it",
    )
}
