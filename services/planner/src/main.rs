//! The `muster-planner` process: the core of this crate in the common shell.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_runtime::service::main::<muster_planner::Planner>(
        "Says what the teams would be with other settings or without some robots",
    )
}
