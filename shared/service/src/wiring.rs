//! The keys that a service reads and serves, and how many of its instances publish.

use muster_wire::Pattern;

/// How packets of a subscription wait for the core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// One slot per key; a newer packet replaces the waiting one.
    Latest,
    /// A queue of at most so many packets per key; a newer packet drops the oldest. For deltas,
    /// whose gaps the core detects and repairs with a fetch.
    Queue(usize),
}

/// One subscription.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Subscription {
    /// Which keys.
    pub pattern: Pattern,
    /// How packets wait.
    pub delivery: Delivery,
}

/// Whose output a served key holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Authority {
    /// The service's own output. The leader's answer alone suffices.
    Own,
    /// The last output of another service that this one received: an answer in case that service is
    /// gone.
    Cached,
}

/// One key expression that a service answers gets for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServedKey {
    /// Which keys.
    pub pattern: Pattern,
    /// Whose output they hold.
    pub authority: Authority,
}

impl ServedKey {
    /// A key of the service's own output.
    #[must_use]
    pub fn own(pattern: Pattern) -> Self {
        Self { pattern, authority: Authority::Own }
    }

    /// A key of another service's output.
    #[must_use]
    pub fn cached(pattern: Pattern) -> Self {
        Self { pattern, authority: Authority::Cached }
    }
}

/// Which keys a service subscribes to, and which it serves.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Wiring {
    /// Subscriptions.
    pub subscriptions: Vec<Subscription>,
    /// Liveliness tokens that it follows.
    pub tokens: Vec<Pattern>,
    /// Keys that it answers gets for.
    pub served: Vec<ServedKey>,
    /// Keys that it gets now and then, beside those that it subscribes to and its own output.
    pub fetched: Vec<Pattern>,
}

impl Wiring {
    /// Whether the service puts to each robot its team.
    #[must_use]
    pub fn puts_robot_teams(&self) -> bool {
        self.served.contains(&ServedKey::own(Pattern::RobotTeams))
    }
}

/// How many instances of a service publish.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Replication {
    /// One instance leads and publishes; the others are standbys and take over.
    OneLeads,
    /// Every instance works for itself, such as a recorder or a console: there is no election.
    EveryInstance,
}
