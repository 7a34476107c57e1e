//! How long a pose takes until the team computed from it is received, over real processes.
//!
//! A router, the four services, and robots are processes of their own ([`run_plan`]); the robots march in
//! squads, each with a phase of its own ([`squads`], [`drive`]). A listener on the same router receives
//! what robots and consoles receive ([`listen`]). Which poses a division is computed from is not estimated: the
//! heading of each pose is its number, rosters repeat it, and the head of a division names the frame of
//! the roster by the moment in which `ingest` made it ([`follow`]). [`echo`] is the round trip of a
//! message of the same size through the router alone, [`traffic`] what each key carries, and [`report`] writes what was
//! measured.
//!
//! All clocks are that of one host.

pub mod drive;
pub mod echo;
pub mod follow;
pub mod listen;
pub mod report;
pub mod run_plan;
pub mod squads;
pub mod traffic;

/// The moment in microseconds since 1970, as in the messages of the services.
#[must_use]
pub fn now_us() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    u64::try_from(since.unwrap_or_default().as_micros()).unwrap_or(u64::MAX)
}

/// The name of a robot.
#[must_use]
pub fn robot_name(robot: usize) -> String {
    format!("r{robot:06}")
}

/// The robot of a name.
#[must_use]
pub fn robot_of(name: &str) -> Option<usize> {
    name.strip_prefix('r')?.parse().ok()
}
