//! The `muster-historian` process: the core of this crate in the common shell, with its file.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_runtime::service::main_recording::<muster_historian::Historian>(
        "Records what the fleet was, in a file that other programs read",
        muster_historian::open,
    )
}
