//! The `muster-mcap` process: records a fleet, and plays a recording. `muster record` and `muster replay` start it.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_foxglove::recording::main()
}
