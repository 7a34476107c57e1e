//! The `muster-ros2` process: the core of this crate in its shell.

use std::process::ExitCode;

fn main() -> ExitCode {
    muster_ros2::shell::main()
}
