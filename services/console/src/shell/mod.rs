//! The shell: flags, sockets, the bus and the clock around the core.

mod fleet;
mod http;
mod options;
mod page;
mod run;
mod socket;

pub use self::options::main;
pub use self::page::LocalPage;
