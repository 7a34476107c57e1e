//! The `muster-ingest` process: the core of this crate in the common shell.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_runtime::service::main::<muster_ingest::Ingest>(
        "Turns the streams of the robots into one weighted directed graph per modality",
    )
}
