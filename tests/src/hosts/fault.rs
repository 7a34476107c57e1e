//! The faults, and what is promised under each.

use std::time::Duration;

use super::lab::Host;

/// What breaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The cable of a host is pulled.
    Pulled(Host),
    /// The cable of the robots' host is pulled, where all robots of one of three teams are.
    TeamPulled,
    /// Every packet from and to a host is dropped silently.
    Lost(Host),
    /// The link of the robots' host is narrowed to so many kbit/s, and they are configured for that.
    Narrow(u32),
    /// Packets of the robots' host are late, and some are lost.
    Slow,
    /// The router is killed, and later started again.
    RouterKilled,
    /// The router is stopped by a signal, and later continued.
    RouterStopped,
}

/// A fault of a running fleet, and for how long.
#[derive(Debug, Clone, Copy)]
pub struct Fault {
    /// What names it on the command line.
    pub name: &'static str,
    /// What happens, in words.
    pub what: &'static str,
    /// What breaks.
    pub kind: Kind,
    /// How long it lasts.
    pub lasts: Duration,
}

const fn fault(name: &'static str, what: &'static str, kind: Kind, seconds: u64) -> Fault {
    Fault { name, what, kind, lasts: Duration::from_secs(seconds) }
}

/// Every fault that is tested, in the order of the table.
pub const FAULTS: [Fault; 14] = [
    fault(
        "robots-pulled-3",
        "cable of the robots' host pulled, 3 s",
        Kind::Pulled(Host::Robots),
        3,
    ),
    fault("robots-pulled-20", "the same, 20 s", Kind::Pulled(Host::Robots), 20),
    fault("team-pulled-20", "the same with one of three whole teams, 20 s", Kind::TeamPulled, 20),
    fault(
        "robots-lost-3",
        "packets of the robots' host dropped silently, 3 s",
        Kind::Lost(Host::Robots),
        3,
    ),
    fault("robots-lost-20", "the same, 20 s", Kind::Lost(Host::Robots), 20),
    fault("base-pulled-3", "cable of the services' host pulled, 3 s", Kind::Pulled(Host::Base), 3),
    fault("base-pulled-20", "the same, 20 s", Kind::Pulled(Host::Base), 20),
    fault(
        "base-lost-20",
        "packets of the services' host dropped silently, 20 s",
        Kind::Lost(Host::Base),
        20,
    ),
    fault("narrow-64", "link of the robots' host limited to 64 kbit/s, 15 s", Kind::Narrow(64), 15),
    fault(
        "slow",
        "link of the robots' host with 200 ± 50 ms delay and 5 % loss, 15 s",
        Kind::Slow,
        15,
    ),
    fault("router-killed-1", "router killed, restarted after 1 s", Kind::RouterKilled, 1),
    fault("router-killed-15", "router killed, restarted after 15 s", Kind::RouterKilled, 15),
    fault("router-stopped-5", "router stopped by a signal, 5 s", Kind::RouterStopped, 5),
    fault("router-stopped-1", "router stopped by a signal, 1 s", Kind::RouterStopped, 1),
];

/// What a robot is promised to be marked after, without a sign of it: 2 s by the settings, and what
/// the machine of the tests may be late.
pub const STALE_S: (f64, f64) = (1.5, 6.0);

/// The same for when it leaves: 10 s by the settings.
pub const GONE_S: (f64, f64) = (9.0, 15.0);

/// How soon after the end of a fault the fleet is whole again from fresh data.
pub const WHOLE_WITHIN_S: f64 = 10.0;

/// How late a pose is at most that no fault is in the way of: a link that is closed must not hold up
/// the others.
pub const LATE_ELSEWHERE_S: f64 = 3.0;

/// How late a pose is at most over a link that is narrow or slow. About a second's worth waits, and TCP
/// may repeat a packet more than once; what may not be is a delay that grows with the time.
pub const LATE_S: f64 = 10.0;

impl Fault {
    /// The fault of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        FAULTS.into_iter().find(|fault| fault.name == name)
    }

    /// How many teams the fleet has.
    #[must_use]
    pub fn teams(&self) -> usize {
        if self.kind == Kind::TeamPulled { 3 } else { 2 }
    }

    /// Whether it cuts the robots' host off, so that its robots are missed.
    #[must_use]
    pub fn cuts_robots_off(&self) -> bool {
        matches!(
            self.kind,
            Kind::Pulled(Host::Robots) | Kind::TeamPulled | Kind::Lost(Host::Robots)
        )
    }

    /// Whether it cuts the robots' host off so long that its robots leave.
    #[must_use]
    pub fn lets_robots_leave(&self) -> bool {
        self.cuts_robots_off() && self.lasts > Duration::from_secs(10)
    }

    /// Whether only a link is at fault, and the router runs.
    #[must_use]
    pub fn is_of_a_link(&self) -> bool {
        !matches!(self.kind, Kind::RouterKilled | Kind::RouterStopped)
    }

    /// Whether the router lives and reaches the services, so that divisions are published meanwhile.
    #[must_use]
    pub fn lets_base_speak(&self) -> bool {
        self.cuts_robots_off() || matches!(self.kind, Kind::Narrow(_) | Kind::Slow)
    }
}
