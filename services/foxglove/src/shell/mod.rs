//! The shell: flags, the server, the bus and the clock around the core.

pub(crate) mod fleet;
mod options;
mod run;
mod server;

pub use self::options::main;
