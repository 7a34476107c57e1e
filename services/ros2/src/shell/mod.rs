//! The shell: flags, both buses and the clock around the core.

mod options;
mod queue;
mod run;

pub use self::options::main;
