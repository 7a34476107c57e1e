//! What goes wrong with robots of ROS and with their bridge, from a chance of its own: seeds without them are as they were.

use std::fmt;

use super::super::chance::{Chance, Purpose};
use super::super::clock::{MS, Micros, SECOND};
use super::super::plan::Span;

/// Of a hundred seeds, those with robots of ROS.
const ROS_PERCENT: u64 = 12;

/// Most robots of ROS in one seed.
const MAX_ROS_ROBOTS: u64 = 4;

/// Most of their faults in one seed.
const MAX_ROS_FAULTS: u64 = 14;

/// What is put on topics of robots that are none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RosRubbish {
    /// Bytes without meaning on the topic of a good robot.
    Noise,
    /// Odometry of a robot that has no transforms.
    Stranger,
    /// A message without an attachment.
    Unnumbered,
    /// A type that no one knows by this hash.
    OtherHash,
}

impl RosRubbish {
    const ALL: [Self; 4] = [Self::Noise, Self::Stranger, Self::Unnumbered, Self::OtherHash];
}

/// One thing that goes wrong. Spans are in microseconds.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RosFault {
    /// The bridge is killed, and started again after a while.
    Kill { lasts: Micros },
    /// The bridge is stopped as by SIGSTOP, and continues after a while.
    Hang { lasts: Micros },
    /// The link of the bridge to the fleet is cut.
    Cut { lasts: Micros, clean: bool },
    /// That link loses, repeats, delays and mixes what it carries.
    Storm { lasts: Micros, loss: u64, copies: u64, delay: Micros },
    /// Nothing of ROS reaches the bridge.
    BusCut { lasts: Micros },
    /// The link of a robot to the bus of ROS loses, repeats, delays and mixes what it carries.
    Weather { robot: usize, lasts: Micros, loss: u64, copies: u64, delay: Micros },
    /// The programs of a robot are restarted: their publishers have other names.
    Restart { robot: usize, lasts: Micros },
    /// A robot leaves and does not come back.
    Leave { robot: usize },
    /// The localisation of a robot says nothing for a while; never again if no time is given.
    Lost { robot: usize, lasts: Option<Micros> },
    /// Another program publishes the odometry of a robot as well.
    Second { robot: usize, lasts: Micros },
    /// The clock of a robot is set, by so many microseconds.
    Clock { robot: usize, by: i64 },
    /// A robot answers to another one from now on.
    Promote { robot: usize, superior: Option<usize> },
    /// Messages come that no bridge may take.
    Rubbish { robot: usize, kind: RosRubbish, count: usize },
}

impl RosFault {
    /// The kind in few words, for counting.
    pub(crate) const fn kind(&self) -> &'static str {
        match self {
            Self::Kill { .. } => "bridge killed",
            Self::Hang { .. } => "bridge hangs",
            Self::Cut { clean: true, .. } => "bridge cut off",
            Self::Cut { clean: false, .. } => "bridge cut off silently",
            Self::Storm { .. } => "bridge in bad weather",
            Self::BusCut { .. } => "ROS cut off",
            Self::Weather { .. } => "ROS in bad weather",
            Self::Restart { .. } => "ROS robot restarts",
            Self::Leave { .. } => "ROS robot leaves",
            Self::Lost { lasts: Some(_), .. } => "transforms pause",
            Self::Lost { lasts: None, .. } => "transforms stop",
            Self::Second { .. } => "second publisher",
            Self::Clock { .. } => "clock of ROS set",
            Self::Promote { .. } => "rank change in ROS",
            Self::Rubbish { .. } => "rubbish in ROS",
        }
    }
}

impl fmt::Display for RosFault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kill { lasts }
            | Self::Hang { lasts }
            | Self::Cut { lasts, .. }
            | Self::BusCut { lasts } => write!(formatter, "for {}", Span(*lasts)),
            Self::Storm { lasts, loss, copies, delay } => {
                weather(formatter, *lasts, *loss, *copies, *delay)
            }
            Self::Weather { robot, lasts, loss, copies, delay } => {
                write!(formatter, "ros{robot} ")?;
                weather(formatter, *lasts, *loss, *copies, *delay)
            }
            Self::Restart { robot, lasts } | Self::Second { robot, lasts } => {
                write!(formatter, "ros{robot} for {}", Span(*lasts))
            }
            Self::Leave { robot } => write!(formatter, "ros{robot}"),
            Self::Lost { robot, lasts: Some(lasts) } => {
                write!(formatter, "ros{robot} for {}", Span(*lasts))
            }
            Self::Lost { robot, lasts: None } => write!(formatter, "ros{robot} for good"),
            Self::Clock { robot, by } => write!(formatter, "ros{robot} by {by} µs"),
            Self::Promote { robot, superior } => {
                write!(formatter, "ros{robot} answers to {superior:?}")
            }
            Self::Rubbish { robot, kind, count } => {
                write!(formatter, "{kind:?} about ros{robot}, {count} messages")
            }
        }
    }
}

fn weather(
    formatter: &mut fmt::Formatter<'_>,
    lasts: Micros,
    loss: u64,
    copies: u64,
    delay: Micros,
) -> fmt::Result {
    let (lasts, delay) = (Span(lasts), Span(delay));
    write!(
        formatter,
        "for {lasts}: loses {loss} %, repeats {copies} %, delays up to {delay}, mixes"
    )
}

/// How many robots of ROS a seed has.
pub(crate) fn ros_robots(seed: u64) -> usize {
    let mut chance = Chance::new(seed, Purpose::Ros, 0);
    if !chance.percent(ROS_PERCENT) {
        return 0;
    }
    usize::try_from(chance.between(1, MAX_ROS_ROBOTS)).unwrap_or_default()
}

/// The faults of a seed with so many robots of ROS, each with its moment.
pub(crate) fn ros_plan(
    seed: u64,
    robots: usize,
    natives: usize,
    begin: Micros,
    end: Micros,
) -> Vec<(Micros, RosFault)> {
    if robots == 0 || end <= begin {
        return Vec::new();
    }
    let mut chance = Chance::new(seed, Purpose::Plan, 8);
    let mut all = Vec::new();
    for _ in 0..chance.between(0, MAX_ROS_FAULTS) {
        let at = chance.between(begin, end.saturating_sub(MS).max(begin));
        all.push((at, draw(&mut chance, robots, natives, end - at)));
    }
    all
}

fn draw(chance: &mut Chance, robots: usize, natives: usize, room: Micros) -> RosFault {
    let robot = chance.below(robots);
    let mut span = |low: Micros, high: Micros| chance.between(low, high).min(room);
    let (short, long) = (span(50 * MS, 3 * SECOND), span(SECOND, 9 * SECOND));
    let loss = chance.between(0, 40);
    let copies = chance.between(0, 30);
    let delay = chance.between(0, 600) * MS;
    match chance.below(100) {
        0..16 => RosFault::Kill { lasts: short },
        16..22 => RosFault::Hang { lasts: if chance.percent(50) { short } else { long } },
        22..30 => RosFault::Cut { lasts: long, clean: chance.percent(50) },
        30..38 => RosFault::Storm { lasts: long, loss, copies, delay },
        38..44 => RosFault::BusCut { lasts: long },
        44..58 => RosFault::Weather { robot, lasts: long, loss, copies, delay },
        58..66 => RosFault::Restart { robot, lasts: short },
        66..68 => RosFault::Leave { robot },
        68..75 => RosFault::Lost { robot, lasts: Some(long) },
        75..79 => RosFault::Lost { robot, lasts: None },
        79..84 => RosFault::Second { robot, lasts: long },
        84..87 => {
            let by = i64::try_from(chance.between(0, 8_000_000)).unwrap_or_default() - 4_000_000;
            RosFault::Clock { robot, by: by * 1000 }
        }
        87..93 => {
            let superior = Some(chance.below(natives.max(1))).filter(|_| chance.percent(80));
            RosFault::Promote { robot, superior }
        }
        _ => RosFault::Rubbish {
            robot,
            kind: chance.pick(&RosRubbish::ALL).copied().unwrap_or(RosRubbish::Noise),
            count: chance.below(20) + 1,
        },
    }
}
