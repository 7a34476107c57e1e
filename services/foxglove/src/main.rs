//! The `muster-foxglove` process: the core of this crate in its shell.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_foxglove::shell::main()
}
