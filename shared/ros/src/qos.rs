//! Quality of service, in the short form in which `rmw_zenoh` writes it into tokens.
//!
//! The numbers are those of the enumerations of `rmw/types.h`. What a publisher leaves at the default of `rmw_zenoh` is
//! left out (`qos_to_keyexpr` in `liveliness_utils.cpp`).

use std::fmt;

/// Whether lost messages are sent again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reliability {
    /// As the system has it.
    SystemDefault,
    /// They are.
    Reliable,
    /// They are not.
    BestEffort,
    /// It is not known.
    Unknown,
    /// The best that the others offer.
    BestAvailable,
}

/// Whether those that come late get older messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Durability {
    /// As the system has it.
    SystemDefault,
    /// They get what the publisher keeps.
    TransientLocal,
    /// They do not.
    Volatile,
    /// It is not known.
    Unknown,
    /// The best that the others offer.
    BestAvailable,
}

/// What is kept of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum History {
    /// As the system has it.
    SystemDefault,
    /// The last ones.
    KeepLast,
    /// All.
    KeepAll,
    /// It is not known.
    Unknown,
}

/// How it is noticed that a publisher is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Liveliness {
    /// As the system has it.
    SystemDefault,
    /// By the middleware.
    Automatic,
    /// By the node, which says so. ROS has given it up.
    ManualByNode,
    /// By the publisher, which says so.
    ManualByTopic,
    /// It is not known.
    Unknown,
    /// The best that the others offer.
    BestAvailable,
}

macro_rules! numbered {
    ($name:ident: $($variant:ident)+) => {
        impl $name {
            /// All, in the order of their numbers in ROS.
            const ALL: &[Self] = &[$(Self::$variant),+];

            fn from_number(number: u64) -> Option<Self> {
                Self::ALL.get(usize::try_from(number).ok()?).copied()
            }
        }
    };
}

numbered!(Reliability: SystemDefault Reliable BestEffort Unknown BestAvailable);
numbered!(Durability: SystemDefault TransientLocal Volatile Unknown BestAvailable);
numbered!(History: SystemDefault KeepLast KeepAll Unknown);
numbered!(Liveliness: SystemDefault Automatic ManualByNode ManualByTopic Unknown BestAvailable);

/// A duration as ROS has it in a quality of service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QosDuration {
    /// Whole seconds.
    pub seconds: u64,
    /// Nanoseconds beyond.
    pub nanoseconds: u64,
}

impl QosDuration {
    /// What ROS writes for no limit: the most nanoseconds that fit into an `int64`.
    pub const INFINITE: Self = Self { seconds: 9_223_372_036, nanoseconds: 854_775_807 };
}

/// The quality of service of a publisher or subscription.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Whether lost messages are sent again.
    pub reliability: Reliability,
    /// Whether those that come late get older messages.
    pub durability: Durability,
    /// What is kept of messages.
    pub history: History,
    /// How many messages are kept.
    pub depth: u64,
    /// Longest time between messages.
    pub deadline: QosDuration,
    /// How long a message is of use.
    pub lifespan: QosDuration,
    /// How it is noticed that a publisher is gone.
    pub liveliness: Liveliness,
    /// After what time.
    pub lease: QosDuration,
}

/// The defaults of `rmw_zenoh` (`qos.cpp`), which the short form leaves out. Those of a ROS program have a depth of 10.
impl Default for Qos {
    fn default() -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::Volatile,
            history: History::KeepLast,
            depth: 42,
            deadline: QosDuration::INFINITE,
            lifespan: QosDuration::INFINITE,
            liveliness: Liveliness::Automatic,
            lease: QosDuration::INFINITE,
        }
    }
}

/// The text is no quality of service in the short form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "a quality of service has the form RELIABILITY:DURABILITY:HISTORY,DEPTH:DEADLINE:LIFESPAN:LIVELINESS in numbers, \
     as in ::,10:,:,:,,"
)]
pub struct QosError;

impl fmt::Display for Qos {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let default = Self::default();
        let number =
            |value: u64, default: u64| (value != default).then_some(value).map(|v| v.to_string());
        let numbers = |own: QosDuration, default: QosDuration| {
            let seconds = number(own.seconds, default.seconds).unwrap_or_default();
            let nanoseconds = number(own.nanoseconds, default.nanoseconds).unwrap_or_default();
            format!("{seconds},{nanoseconds}")
        };
        write!(
            formatter,
            "{}:{}:{},{}:{}:{}:{},{}",
            number(self.reliability as u64, default.reliability as u64).unwrap_or_default(),
            number(self.durability as u64, default.durability as u64).unwrap_or_default(),
            number(self.history as u64, default.history as u64).unwrap_or_default(),
            number(self.depth, default.depth).unwrap_or_default(),
            numbers(self.deadline, default.deadline),
            numbers(self.lifespan, default.lifespan),
            number(self.liveliness as u64, default.liveliness as u64).unwrap_or_default(),
            numbers(self.lease, default.lease),
        )
    }
}

impl std::str::FromStr for Qos {
    type Err = QosError;

    fn from_str(text: &str) -> Result<Self, QosError> {
        let parts: Vec<&str> = text.split(':').collect();
        // Further parts are those of a later version.
        let [reliability, durability, history, deadline, lifespan, liveliness, ..] = parts[..]
        else {
            return Err(QosError);
        };
        let default = Self::default();
        let (history, depth) = history.split_once(',').ok_or(QosError)?;
        let (liveliness, lease) = liveliness.split_once(',').ok_or(QosError)?;
        Ok(Self {
            reliability: choice(reliability, default.reliability, Reliability::from_number)?,
            durability: choice(durability, default.durability, Durability::from_number)?,
            history: choice(history, default.history, History::from_number)?,
            depth: choice(depth, default.depth, Some)?,
            deadline: duration(deadline, default.deadline)?,
            lifespan: duration(lifespan, default.lifespan)?,
            liveliness: choice(liveliness, default.liveliness, Liveliness::from_number)?,
            lease: duration(lease, default.lease)?,
        })
    }
}

/// A number that stands for something, or the default where there is none.
fn choice<T>(text: &str, default: T, read: fn(u64) -> Option<T>) -> Result<T, QosError> {
    if text.is_empty() {
        return Ok(default);
    }
    // `parse` would take a plus sign.
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    let number = text.parse().ok().filter(|_| digits);
    number.and_then(read).ok_or(QosError)
}

fn duration(text: &str, default: QosDuration) -> Result<QosDuration, QosError> {
    let (seconds, nanoseconds) = text.split_once(',').ok_or(QosError)?;
    Ok(QosDuration {
        seconds: choice(seconds, default.seconds, Some)?,
        nanoseconds: choice(nanoseconds, default.nanoseconds, Some)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_short_form_is_that_of_captured_tokens() {
        let default = Qos::default();
        let depth = |depth| Qos { depth, ..default };
        // As rmw_zenoh of Jazzy writes them.
        for (text, qos) in [
            ("::,:,:,:,,", default),
            ("::,10:,:,:,,", depth(10)),
            ("2::,10:,:,:,,", Qos { reliability: Reliability::BestEffort, ..depth(10) }),
            (":1:,10:,:,:,,", Qos { durability: Durability::TransientLocal, ..depth(10) }),
            ("::2,10:,:,:,,", Qos { history: History::KeepAll, ..depth(10) }),
        ] {
            assert_eq!(text.parse(), Ok(qos), "{text}");
            assert_eq!(qos.to_string(), text);
        }
    }

    #[test]
    fn every_field_survives() {
        let duration = |seconds| QosDuration { seconds, nanoseconds: seconds + 1 };
        let qos = Qos {
            reliability: Reliability::Unknown,
            durability: Durability::BestAvailable,
            history: History::SystemDefault,
            depth: u64::MAX,
            deadline: duration(1),
            lifespan: duration(3),
            liveliness: Liveliness::ManualByTopic,
            lease: duration(0),
        };
        assert_eq!(qos.to_string(), "3:4:0,18446744073709551615:1,2:3,4:3,0,1");
        assert_eq!(qos.to_string().parse(), Ok(qos));
    }

    #[test]
    fn other_texts_are_refused() {
        for text in [
            "",
            "::",
            "::,10",
            "::10:,:,:,,",
            "::,10:,:,:,",
            "9::,:,:,:,,",
            "::,+1:,:,:,,",
            "a::,:,:,:,,",
        ] {
            assert_eq!(text.parse::<Qos>(), Err(QosError), "{text}");
        }
        assert!("::,10:,:,:,,:more".parse::<Qos>().is_ok(), "a later version may say more");
    }
}
