//! The `muster-clusterer` process: the core of this crate in the common shell.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_runtime::service::main::<muster_clusterer::Clusterer>(
        "Divides the embedded robots into teams with lasting identities",
    )
}
