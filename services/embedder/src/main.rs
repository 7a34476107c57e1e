//! The `muster-embedder` process: the core of this crate in the common shell.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_runtime::service::main::<muster_embedder::Embedder>(
        "Fuses the graphs and embeds every robot by the singular vectors of the Katz similarity",
    )
}
