//! What goes wrong in a run, and when: a list that follows from the seed, and of which any part can be
//! left out when a failure is shrunk.

use std::fmt;

use muster_model::id::ServiceName;

use super::Scale;
use super::busy::Load;
use super::chance::{Chance, Purpose};
use super::clock::{MS, Micros, SECOND};
use super::ros::{RosFault, ros_plan};

/// How much quiet a fleet has before the first fault, so that there is something to break.
const QUIET_TIME: Micros = 2 * SECOND;

/// In how many of a hundred runs the power is cut once all agree.
const POWER_CUT_PERCENT: u64 = 25;

/// In how many of a hundred runs a whole team is cut off once all agree.
const TEAM_CUT_PERCENT: u64 = 25;

/// In how many of a hundred runs all hosts are busy with other work, and nothing else goes wrong with services.
const BUSY_PERCENT: u64 = 8;

/// For how long of the storm they are: longer than a division may be old then.
const BUSY_TIME: Micros = 12 * SECOND;

/// What is connected to the router by a link of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Place {
    /// The host of one instance of a service.
    Service(ServiceName, usize),
    /// The host of a robot, by number.
    Robot(usize),
}

impl fmt::Display for Place {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Service(service, instance) => write!(formatter, "{service}/{instance}"),
            Self::Robot(robot) => write!(formatter, "robot {robot}"),
        }
    }
}

/// What an attacker puts on robots' keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Rubbish {
    /// Bytes without meaning, also as binary messages.
    Noise,
    /// JSON that is almost right: wrong fields, numbers out of range, endless nesting.
    AlmostRight,
    /// More bytes than a robot may put.
    TooLarge,
    /// Wild keys, keys of nothing, deletions, unknown encodings.
    WrongKey,
    /// Good messages in another robot's name.
    Forged,
    /// Messages for the keys of services, which robots must not put.
    AsService,
}

impl Rubbish {
    const ALL: [Self; 6] = [
        Self::Noise,
        Self::AlmostRight,
        Self::TooLarge,
        Self::WrongKey,
        Self::Forged,
        Self::AsService,
    ];
}

/// An output whose term can be forged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OutputKind {
    Roster,
    Graph,
    Embedding,
    Teams,
    Audit,
    Settings,
}

impl OutputKind {
    const ALL: [Self; 6] =
        [Self::Roster, Self::Graph, Self::Embedding, Self::Teams, Self::Audit, Self::Settings];
}

/// How high a forged term is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Forgery {
    /// So many terms higher.
    Higher(u64),
    /// The highest that services believe; [`Forgery::Higher`] by two where clocks are far apart.
    Bound,
    /// The highest that the protocol can carry.
    Largest,
}

impl Forgery {
    const ALL: [Self; 5] =
        [Self::Higher(1), Self::Higher(2), Self::Higher(1 << 20), Self::Bound, Self::Largest];
}

/// What an operator does about a proposal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Then {
    /// Makes it the division, by ordinary commands.
    Accept,
    /// Makes it the division while nothing else changes.
    AcceptAtRest,
    Drop,
    /// Looks at it now and then.
    Forget,
}

/// One thing that goes wrong, or that people and robots do. Spans are in microseconds.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Fault {
    /// A link loses, repeats, delays and, if it `reorders`, mixes what it carries.
    Storm { at: Place, lasts: Micros, loss: u64, copies: u64, delay: Micros, reorders: bool },
    /// A link is cut: at once and noticed by both ends, or silently.
    Cut { at: Place, lasts: Micros, clean: bool },
    /// The router is restarted: every link is cut at once.
    Router { lasts: Micros },
    /// A service is killed, and started again after a while.
    Kill { at: Place, lasts: Micros },
    /// A service is killed, loses its disk, and is started again.
    LostDisk { at: Place, lasts: Micros },
    /// All services are killed at once, and started again within a while; their disks may be lost with
    /// them.
    Blackout { lasts: Micros, disks: bool },
    /// All services are killed at once when all agree after the storm, and started again within a while.
    PowerCut { lasts: Micros },
    /// The links of all robots of a team are cut when all agree after the storm, and are back after a while.
    TeamCut { lasts: Micros, clean: bool },
    /// An attacker repeats the last message on the key of a service with a higher term.
    ForgedTerm { what: OutputKind, term: Forgery },
    /// A service is stopped as by SIGSTOP, and continues after a while.
    Hang { at: Place, lasts: Micros },
    /// A service takes long over every event.
    Slow { at: Place, lasts: Micros, each: Micros },
    /// Jobs of a service take long.
    SlowJobs { at: Place, lasts: Micros, each: Micros },
    /// All hosts are busy with other work.
    Busy { lasts: Micros, load: Load },
    /// Every job of a service that ends within the span has panicked.
    Panics { at: Place, lasts: Micros },
    /// The wall clock of a host is set, by so many microseconds.
    Clock { at: Place, by: i64 },
    /// A robot leaves for a while: with its token withdrawn, or by losing its power.
    Leave { robot: usize, lasts: Micros, politely: bool },
    /// A robot leaves and does not come back.
    LeaveForGood { robot: usize },
    /// The software of a robot is restarted.
    Reboot { robot: usize },
    /// A robot answers to another one from now on.
    Promote { robot: usize, superior: Option<usize> },
    /// A robot is somewhere else from now on.
    Jump { robot: usize, by: [i64; 2] },
    /// A robot reports the same many times at once.
    Burst { robot: usize, count: usize },
    /// An attacker puts rubbish.
    Rubbish { robot: usize, kind: Rubbish, count: usize },
    /// Robots appear that report one pose each and nothing after.
    Ghosts { count: usize },
    /// An operator changes settings.
    Set { service: ServiceName, patch: String },
    /// An operator puts or withdraws a wish about a robot.
    Wish { id: &'static str, robot: usize, wish: &'static str },
    /// An operator asks what the teams would be, and does something about the answer.
    Propose {
        operator: &'static str,
        id: &'static str,
        robot: usize,
        asked: &'static str,
        then: Then,
    },
    /// Operators ask for many proposals at once.
    ProposeMany { count: usize },
    /// An operator asks what the teams would be once all agree, and accepts it.
    ProposeAtRest { robot: usize, asked: &'static str },
    /// The disk for the records of a historian is full for a while; until all agree if no time is given.
    FullDisk { at: Place, lasts: Option<Micros> },
    /// An operator sets what stops every job of the embedder, and mends it after a while.
    BadAlpha { lasts: Micros },
    /// Something goes wrong with robots of ROS or their bridge.
    Ros(RosFault),
}

/// When something goes wrong.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Injection {
    /// Its number in the plan of the seed.
    pub(crate) number: usize,
    /// When it begins.
    pub(crate) at: Micros,
    /// What it is.
    pub(crate) fault: Fault,
}

impl Fault {
    /// For how long a fault may keep an instance from receiving the lease renewals of another one of its
    /// service, or lets it receive forged ones, and of which service; of all if none is named.
    pub(crate) const fn hides_renewals(&self) -> Option<(Option<ServiceName>, Micros)> {
        let (at, lasts) = match self {
            Self::Storm { at, lasts, .. }
            | Self::Cut { at, lasts, .. }
            | Self::LostDisk { at, lasts }
            | Self::Hang { at, lasts }
            | Self::Slow { at, lasts, .. } => (*at, *lasts),
            Self::Router { lasts } | Self::Blackout { lasts, .. } | Self::Busy { lasts, .. } => {
                return Some((None, *lasts));
            }
            Self::ForgedTerm { .. } => return Some((None, 0)),
            _ => return None,
        };
        match at {
            Place::Service(service, _) => Some((Some(service), lasts)),
            Place::Robot(_) => None,
        }
    }

    /// Whether it concerns robots alone, so that services go on dividing.
    const fn is_of_robots(&self) -> bool {
        match self {
            Self::Storm { at, .. } | Self::Cut { at, .. } | Self::Clock { at, .. } => {
                matches!(at, Place::Robot(_))
            }
            Self::Leave { .. }
            | Self::LeaveForGood { .. }
            | Self::Reboot { .. }
            | Self::Promote { .. }
            | Self::Jump { .. }
            | Self::Burst { .. }
            | Self::Rubbish { .. }
            | Self::Ghosts { .. }
            | Self::Wish { .. }
            | Self::Ros(_) => true,
            _ => false,
        }
    }

    /// The kind in one word, for counting.
    pub(crate) const fn kind(&self) -> &'static str {
        match self {
            Self::Storm { .. } => "storm",
            Self::Cut { clean: true, .. } => "clean cut",
            Self::Cut { clean: false, .. } => "silent cut",
            Self::Router { .. } => "router restart",
            Self::Kill { .. } => "kill",
            Self::LostDisk { .. } => "lost disk",
            Self::Blackout { disks: true, .. } => "blackout",
            Self::Blackout { disks: false, .. } => "blackout without disks",
            Self::PowerCut { .. } => "power cut",
            Self::TeamCut { .. } => "team cut off",
            Self::ForgedTerm { .. } => "forged term",
            Self::Hang { .. } => "hang",
            Self::Slow { .. } => "slow service",
            Self::SlowJobs { .. } => "slow jobs",
            Self::Busy { .. } => "busy hosts",
            Self::Panics { .. } => "job panics",
            Self::Clock { .. } => "clock set",
            Self::Leave { .. } => "robot leaves and returns",
            Self::LeaveForGood { .. } => "robot leaves",
            Self::Reboot { .. } => "robot reboots",
            Self::Promote { .. } => "rank change",
            Self::Jump { .. } => "jump",
            Self::Burst { .. } => "burst",
            Self::Rubbish { .. } => "rubbish",
            Self::Ghosts { .. } => "ghosts",
            Self::Set { .. } => "settings",
            Self::Wish { .. } => "wish",
            Self::Propose { .. } => "proposal",
            Self::ProposeMany { .. } => "many proposals",
            Self::ProposeAtRest { .. } => "proposal at rest",
            Self::BadAlpha { .. } => "bad alpha",
            Self::FullDisk { .. } => "full disk",
            Self::Ros(fault) => fault.kind(),
        }
    }
}

impl fmt::Display for Injection {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { number, fault, .. } = self;
        write!(formatter, "fault {number}: {}: ", fault.kind())?;
        match fault {
            Fault::Storm { at, lasts, loss, copies, delay, reorders } => {
                let order = if *reorders { ", mixes" } else { "" };
                let (lasts, delay) = (Span(*lasts), Span(*delay));
                write!(
                    formatter,
                    "{at} for {lasts}: loses {loss} %, repeats {copies} %, delays up to {delay}{order}"
                )
            }
            Fault::Cut { at, lasts, .. }
            | Fault::Kill { at, lasts }
            | Fault::LostDisk { at, lasts }
            | Fault::Hang { at, lasts }
            | Fault::Panics { at, lasts } => write!(formatter, "{at} for {}", Span(*lasts)),
            Fault::ForgedTerm { what, term } => write!(formatter, "{what:?}, {term:?}"),
            Fault::Router { lasts }
            | Fault::BadAlpha { lasts }
            | Fault::Blackout { lasts, .. }
            | Fault::PowerCut { lasts }
            | Fault::TeamCut { lasts, .. } => write!(formatter, "for {}", Span(*lasts)),
            Fault::FullDisk { at, lasts: Some(lasts) } => {
                write!(formatter, "{at} for {}", Span(*lasts))
            }
            Fault::FullDisk { at, lasts: None } => write!(formatter, "{at} until all agree"),
            Fault::Slow { at, lasts, each } | Fault::SlowJobs { at, lasts, each } => {
                write!(formatter, "{at} for {}: {} each", Span(*lasts), Span(*each))
            }
            Fault::Busy { lasts, load } => write!(formatter, "for {}: {load}", Span(*lasts)),
            Fault::Clock { at, by } => write!(formatter, "{at} by {by} µs"),
            Fault::Leave { robot, lasts, politely } => {
                let how = if *politely { "politely" } else { "without withdrawing its token" };
                write!(formatter, "{robot} for {}, {how}", Span(*lasts))
            }
            Fault::LeaveForGood { robot } | Fault::Reboot { robot } => write!(formatter, "{robot}"),
            Fault::Promote { robot, superior } => {
                write!(formatter, "{robot} answers to {superior:?}")
            }
            Fault::Jump { robot, by: [x, y] } => write!(formatter, "{robot} by {x}, {y} m"),
            Fault::Burst { robot, count } => write!(formatter, "{robot}, {count} messages"),
            Fault::Rubbish { robot, kind, count } => {
                write!(formatter, "{kind:?} about robot {robot}, {count} messages")
            }
            Fault::Ghosts { count } | Fault::ProposeMany { count } => write!(formatter, "{count}"),
            Fault::Propose { operator, id, robot, asked, then } => {
                write!(formatter, "{operator}/{id} about robot {robot}: {asked}, then {then:?}")
            }
            Fault::ProposeAtRest { robot, asked } => {
                write!(formatter, "about robot {robot}: {asked}")
            }
            Fault::Set { service, patch } => write!(formatter, "{service} {patch}"),
            Fault::Wish { id, robot, wish } => write!(formatter, "{id} of robot {robot}: {wish}"),
            Fault::Ros(fault) => write!(formatter, "{fault}"),
        }
    }
}

/// A span or moment, written in seconds.
pub(crate) struct Span(pub(crate) Micros);

impl fmt::Display for Span {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}.{:06} s", self.0 / SECOND, self.0 % SECOND)
    }
}

/// Patches that leave a fleet able to work, by service.
const PATCHES: [(ServiceName, &[&str]); 4] = [
    (
        ServiceName::Ingest,
        &[
            r#"{"tick_hz":4.0}"#,
            r#"{"tick_hz":20.0}"#,
            r#"{"stale_after_s":1.0}"#,
            r#"{"stale_after_s":3.0,"gone_after_s":6.0}"#,
            r#"{"gone_after_s":4.0}"#,
            r#"{"spatial":{"kernel":"exponential"}}"#,
            r#"{"spatial":{"radius_m":60.0}}"#,
            r#"{"spatial":{"all_pairs_up_to":3,"neighbours":3}}"#,
            r#"{"max_rate_hz":40.0}"#,
            r#"{"modalities":["thermal"]}"#,
            r#"{"modalities":["thermal","radar"]}"#,
            r#"{"modalities":[]}"#,
            r#"{"tick_hz":0}"#,
        ],
    ),
    (
        ServiceName::Embedder,
        &[
            r#"{"alpha":{"fraction":0.25}}"#,
            r#"{"alpha":{"fraction":0.9}}"#,
            r#"{"dimension":2}"#,
            r#"{"dimension":6}"#,
            r#"{"dimension":"auto"}"#,
            r#"{"scale":"none"}"#,
            r#"{"rows":"none"}"#,
            r#"{"normalize":"none"}"#,
            r#"{"weights":{"spatial":1.0}}"#,
            r#"{"weights":{"hierarchy":0.5,"connectivity":0.5}}"#,
            r#"{"weights":{}}"#,
            r#"{"weights":{"spatial":0.7}}"#,
        ],
    ),
    (
        ServiceName::Clusterer,
        &[
            r#"{"teams":1}"#,
            r#"{"teams":2}"#,
            r#"{"teams":3}"#,
            r#"{"teams":4}"#,
            r#"{"teams":7}"#,
            r#"{"teams":"auto"}"#,
            r#"{"teams":{"from":2,"to":5}}"#,
            r#"{"dwell_s":0}"#,
            r#"{"dwell_s":2.0}"#,
            r#"{"hysteresis":0.0}"#,
            r#"{"restarts":5}"#,
            r#"{"seed":7}"#,
            r#"{"heartbeat_s":0.5}"#,
            r#"{"heartbeat_s":2.0}"#,
            r#"{"init":"random"}"#,
            r#"{"teams":0}"#,
        ],
    ),
    (
        ServiceName::Auditor,
        &[
            r#"{"good":0.7,"poor":0.4}"#,
            r#"{"alert_after_s":0.0}"#,
            r#"{"poor":-0.5}"#,
            r#"{"good":"x"}"#,
        ],
    ),
];

/// Settings of the clusterer that an operator sets in some seeds.
struct Patches {
    /// Of a hundred seeds, those in which they are set.
    percent: u64,
    /// Most changes in one seed.
    most: u64,
    patches: &'static [&'static str],
}

/// Limits on the robots of teams. Some cannot be satisfied, and are refused; others cannot once robots come or leave.
const LIMITS: Patches = Patches {
    percent: 30,
    most: 4,
    patches: &[
        r#"{"size":{"max":4}}"#,
        r#"{"size":{"max":6}}"#,
        r#"{"size":{"min":2}}"#,
        r#"{"size":{"min":2,"max":5}}"#,
        r#"{"size":{"min":3},"teams":2}"#,
        r#"{"team_size":{"t1":{"max":3},"t2":{"min":2}}}"#,
        r#"{"size":null}"#,
        r#"{"size":null,"team_size":null}"#,
    ],
};

/// Needs of teams. Some can never be filled, and are refused; others cannot once robots are stale or leave.
const NEEDS: Patches = Patches {
    percent: 30,
    most: 4,
    patches: &[
        r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#,
        r#"{"needs":[{"skill":"medic","per_team":{"min":1,"max":2}}],"teams":2}"#,
        r#"{"needs":[{"skill":"medic","per_team":{"min":1}},{"skill":"relay","per_team":{"min":1}}]}"#,
        r#"{"needs":[{"skill":"relay","per_team":{"min":1},"soft":true}],"teams":3}"#,
        r#"{"needs":[{"skill":"medic","team":"t2","per_team":{"min":2}}]}"#,
        r#"{"needs":[{"skill":"relay","per_team":{"min":2}}]}"#,
        r#"{"needs":null}"#,
    ],
};

/// Of a hundred seeds, those in which an operator has wishes.
const WISHES_PERCENT: u64 = 30;

/// Most changes of wishes in one seed.
const MAX_WISHES: u64 = 8;

/// Wishes about a robot. Some wait for a team that is not there, some contradict others or limits and are refused.
const WISHES: [&str; 6] = [
    r#"{"kind":"pin","robots":["ROBOT"],"team":"t1"}"#,
    r#"{"kind":"pin","robots":["ROBOT"],"team":"t2"}"#,
    r#"{"kind":"ban","robots":["ROBOT"],"team":"t1"}"#,
    r#"{"kind":"reserve","robots":["ROBOT"]}"#,
    r#"{"kind":"lock","team":"t1"}"#,
    "null",
];

/// Of a hundred seeds, those in which something happens to historians.
const HISTORIANS_PERCENT: u64 = 40;

/// By how many microseconds the clock of its host may go back.
const HOUR: i64 = 3_600_000_000;

/// Most of that in one seed.
const MAX_HISTORIAN_FAULTS: u64 = 5;

/// Of a hundred seeds, those in which operators ask for proposals.
const PROPOSALS_PERCENT: u64 = 40;

/// Most proposals of one seed, without those that are asked for at once.
const MAX_PROPOSALS: u64 = 6;

/// Most proposals at once: more than there may be.
const MANY_PROPOSALS: usize = 26;

/// What operators ask for. Some ask what nothing satisfies, or what makes no sense, and are refused.
const ASKED: [&str; 10] = [
    r#"{"teams":2}"#,
    r#"{"teams":3}"#,
    r#"{"teams":{"from":1,"to":4}}"#,
    r#"{"size":{"max":4}}"#,
    r#"{"size":{"min":2}}"#,
    r#"{"without":["ROBOT"]}"#,
    r#"{"teams":2,"without":["ROBOT"]}"#,
    r#"{"weights":{"spatial":1.0}}"#,
    r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#,
    r#"{"size":{"min":4,"max":2}}"#,
];

/// What is asked for at rest: what one command accepts, and what changes no vectors.
const ASKED_AT_REST: [&str; 6] = [
    r#"{"size":{"max":3}}"#,
    r#"{"size":{"max":2}}"#,
    r#"{"size":{"min":3}}"#,
    r#"{"without":["ROBOT"]}"#,
    r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#,
    r#"{"teams":2}"#,
];

/// The plan of a seed, in order of time. Nothing that heals by itself outlasts the storm.
pub(crate) fn plan(seed: u64, scale: &Scale, places: &[Place]) -> Vec<Injection> {
    let mut chance = Chance::new(seed, Purpose::Plan, 0);
    let end = scale.storm;
    let mut injections = Vec::new();
    let begin = QUIET_TIME.min(end / 4);
    // Some seeds are rough and some nearly calm: what hides in a crowd of faults shows alone.
    let most = [1, 4, 10, 25, 40][chance.below(5)];
    for _ in 0..chance.between(0, most) {
        let at = chance.between(begin, end.saturating_sub(MS).max(begin));
        let fault = draw(&mut chance, scale, places, end - at.min(end));
        injections.push(Injection { number: 0, at, fault });
    }
    let seconds = if scale.ghosts > 0 { end / SECOND } else { 0 };
    injections.extend((0..seconds).map(|second| {
        let fault = Fault::Ghosts { count: scale.ghosts };
        Injection { number: 0, at: second * SECOND, fault }
    }));
    // A chance of its own: whether there is a power cut has no bearing on the storm before it.
    let mut power = Chance::new(seed, Purpose::Plan, 1);
    if power.percent(POWER_CUT_PERCENT) {
        let fault = Fault::PowerCut { lasts: power.between(50 * MS, 3 * SECOND) };
        injections.push(Injection { number: 0, at: begin, fault });
    }
    let chance = &mut Chance::new(seed, Purpose::Plan, 3);
    injections.extend(settings(chance, &LIMITS, begin, end));
    let chance = &mut Chance::new(seed, Purpose::Plan, 4);
    injections.extend(wishes(chance, scale.robots, begin, end));
    let chance = &mut Chance::new(seed, Purpose::Plan, 5);
    injections.extend(settings(chance, &NEEDS, begin, end));
    let chance = &mut Chance::new(seed, Purpose::Plan, 6);
    injections.extend(historians(chance, scale.instances, begin, end));
    let chance = &mut Chance::new(seed, Purpose::Plan, 7);
    injections.extend(proposals(chance, scale, begin, end));
    let mut busy = Chance::new(seed, Purpose::Plan, 2);
    if busy.percent(BUSY_PERCENT) && end > begin {
        injections.retain(|injection| {
            injection.fault.is_of_robots() || matches!(injection.fault, Fault::PowerCut { .. })
        });
        let load = Load::draw(&mut busy);
        let fault = Fault::Busy { lasts: BUSY_TIME.min(end - begin), load };
        injections.push(Injection { number: 0, at: begin, fault });
    }
    injections.sort_by_key(|injection| injection.at);
    // Behind all others, whose numbers give them their chance.
    let ros = ros_plan(seed, scale.ros, scale.robots, begin, end);
    injections.extend(ros.into_iter().map(|(at, fault)| {
        let fault = Fault::Ros(fault);
        Injection { number: 0, at, fault }
    }));
    let mut cut = Chance::new(seed, Purpose::Plan, 8);
    if cut.percent(TEAM_CUT_PERCENT) {
        let fault =
            Fault::TeamCut { lasts: cut.between(SECOND, 25 * SECOND), clean: cut.percent(50) };
        injections.push(Injection { number: 0, at: begin, fault });
    }
    for (number, injection) in injections.iter_mut().enumerate() {
        injection.number = number;
    }
    injections
}

/// Settings of the clusterer that an operator sets in some seeds, from a chance of their own.
fn settings(chance: &mut Chance, patches: &Patches, begin: Micros, end: Micros) -> Vec<Injection> {
    if !chance.percent(patches.percent) || end <= begin {
        return Vec::new();
    }
    let count = chance.between(1, patches.most);
    let mut all = Vec::new();
    for _ in 0..count {
        let at = chance.between(begin, end.saturating_sub(MS).max(begin));
        let patch = chance.pick(patches.patches).copied().unwrap_or("{}").to_owned();
        let fault = Fault::Set { service: ServiceName::Clusterer, patch };
        all.push(Injection { number: 0, at, fault });
    }
    all
}

/// Wishes that an operator puts and withdraws, in some seeds, from a chance of their own.
fn wishes(chance: &mut Chance, robots: usize, begin: Micros, end: Micros) -> Vec<Injection> {
    if !chance.percent(WISHES_PERCENT) || end <= begin {
        return Vec::new();
    }
    let mut all = Vec::new();
    for _ in 0..chance.between(1, MAX_WISHES) {
        let at = chance.between(begin, end.saturating_sub(MS).max(begin));
        let id = chance.pick(&["w1", "w2", "w3"]).copied().unwrap_or("w1");
        let wish = chance.pick(&WISHES).copied().unwrap_or("null");
        let fault = Fault::Wish { id, robot: chance.below(robots), wish };
        all.push(Injection { number: 0, at, fault });
    }
    all
}

/// What happens to historians in some seeds, from a chance of its own: their disks are full, and they are killed.
fn historians(chance: &mut Chance, instances: usize, begin: Micros, end: Micros) -> Vec<Injection> {
    if !chance.percent(HISTORIANS_PERCENT) || end <= begin {
        return Vec::new();
    }
    let mut all = Vec::new();
    for _ in 0..chance.between(1, MAX_HISTORIAN_FAULTS) {
        let at = chance.between(begin, end.saturating_sub(MS).max(begin));
        let place = Place::Service(ServiceName::Historian, chance.below(instances));
        let lasts = chance.between(50 * MS, 8 * SECOND).min(end - at);
        if chance.percent(20) {
            // Its host starts again with a clock that is an hour behind.
            let fault = Fault::Clock { at: place, by: -HOUR };
            all.push(Injection { number: 0, at, fault });
            let fault = Fault::Kill { at: place, lasts: lasts / 2 };
            all.push(Injection { number: 0, at, fault });
            continue;
        }
        let fault = match chance.below(10) {
            0..5 => Fault::Kill { at: place, lasts: lasts / 2 },
            5..8 => Fault::FullDisk { at: place, lasts: Some(lasts) },
            _ => Fault::FullDisk { at: place, lasts: None },
        };
        all.push(Injection { number: 0, at, fault });
    }
    all
}

/// What operators ask planners in some seeds, from a chance of its own, and what happens to planners meanwhile.
fn proposals(chance: &mut Chance, scale: &Scale, begin: Micros, end: Micros) -> Vec<Injection> {
    if !chance.percent(PROPOSALS_PERCENT) || end <= begin {
        return Vec::new();
    }
    let mut all = Vec::new();
    for _ in 0..chance.between(1, MAX_PROPOSALS) {
        let at = chance.between(begin, end.saturating_sub(MS).max(begin));
        let then = [Then::Accept, Then::Drop, Then::Forget, Then::Forget][chance.below(4)];
        let operator = chance.pick(&["alice", "bob"]).copied().unwrap_or("alice");
        let id = chance.pick(&["p1", "p2", "p3"]).copied().unwrap_or("p1");
        let asked = chance.pick(&ASKED).copied().unwrap_or("{}");
        let robot = chance.below(scale.robots);
        let fault = Fault::Propose { operator, id, robot, asked, then };
        all.push(Injection { number: 0, at, fault });
    }
    if chance.percent(25) {
        let at = chance.between(begin, end.saturating_sub(MS).max(begin));
        let fault = Fault::ProposeMany { count: 1 + chance.below(MANY_PROPOSALS) };
        all.push(Injection { number: 0, at, fault });
    }
    if chance.percent(60) {
        let asked = chance.pick(&ASKED_AT_REST).copied().unwrap_or("{}");
        let fault = Fault::ProposeAtRest { robot: chance.below(scale.robots), asked };
        all.push(Injection { number: 0, at: begin, fault });
    }
    for _ in 0..chance.below(4) {
        let starts = chance.between(begin, end.saturating_sub(MS).max(begin));
        let at = Place::Service(ServiceName::Planner, chance.below(scale.instances));
        let lasts = chance.between(50 * MS, 6 * SECOND).min(end - starts);
        let fault = match chance.below(6) {
            0..3 => Fault::Kill { at, lasts: lasts / 2 },
            3 => Fault::Cut { at, lasts, clean: chance.percent(50) },
            4 => Fault::SlowJobs { at, lasts, each: chance.between(50, 4000) * MS },
            _ => Fault::Panics { at, lasts },
        };
        all.push(Injection { number: 0, at: starts, fault });
    }
    all
}

fn draw(chance: &mut Chance, scale: &Scale, places: &[Place], room: Micros) -> Fault {
    let services: Vec<Place> =
        places.iter().copied().filter(|place| matches!(place, Place::Service(..))).collect();
    let any = Place::Service(ServiceName::Ingest, 0);
    let service = chance.pick(&services).copied().unwrap_or(any);
    let place =
        if chance.percent(60) { service } else { chance.pick(places).copied().unwrap_or(service) };
    let robots = scale.robots;
    let robot = chance.below(robots);
    let mut span = |low: Micros, high: Micros| chance.between(low, high).min(room);
    let (short, long, whole) =
        (span(50 * MS, 3 * SECOND), span(SECOND, 12 * SECOND), span(SECOND, 30 * SECOND));
    match chance.below(100) {
        0..18 => Fault::Storm {
            at: place,
            lasts: whole,
            loss: chance.between(0, 40),
            copies: chance.between(0, 30),
            delay: chance.between(0, 600) * MS,
            reorders: chance.percent(70),
        },
        18..24 => Fault::Cut { at: place, lasts: short, clean: chance.percent(50) },
        24..31 => Fault::Cut { at: place, lasts: long, clean: chance.percent(50) },
        31..34 => Fault::Router { lasts: short },
        34..44 => Fault::Kill { at: service, lasts: short },
        44..46 => Fault::Kill { at: service, lasts: long },
        46..47 => Fault::LostDisk { at: service, lasts: short },
        47..49 => Fault::Blackout { lasts: short, disks: chance.percent(50) },
        49..51 => Fault::ForgedTerm {
            what: chance.pick(&OutputKind::ALL).copied().unwrap_or(OutputKind::Roster),
            term: chance.pick(&Forgery::ALL).copied().unwrap_or(Forgery::Largest),
        },
        51..55 => Fault::Hang { at: service, lasts: if chance.percent(50) { short } else { long } },
        55..58 => Fault::Slow { at: service, lasts: long, each: chance.between(5, 200) * MS },
        58..61 => Fault::SlowJobs { at: service, lasts: long, each: chance.between(50, 2500) * MS },
        61..65 => Fault::Panics { at: service, lasts: long },
        65..69 => {
            let by = i64::try_from(chance.between(0, 8_000_000)).unwrap_or_default() - 4_000_000;
            Fault::Clock { at: place, by: if chance.percent(20) { by * 1000 } else { by } }
        }
        69..75 => Fault::Leave { robot, lasts: long, politely: chance.percent(50) },
        75..77 => Fault::LeaveForGood { robot },
        77..80 => Fault::Reboot { robot },
        80..84 => Fault::Promote {
            robot,
            superior: Some(chance.below(robots)).filter(|superior| *superior != robot),
        },
        84..87 => {
            let mut metres = || i64::try_from(chance.between(0, 200)).unwrap_or_default() - 100;
            Fault::Jump { robot, by: [metres(), metres()] }
        }
        87..89 => Fault::Burst { robot, count: chance.below(150) },
        89..93 => Fault::Rubbish {
            robot,
            kind: chance.pick(&Rubbish::ALL).copied().unwrap_or(Rubbish::Noise),
            count: chance.below(20) + 1,
        },
        93..95 => Fault::Ghosts { count: chance.below(12) + 1 },
        95..96 => Fault::BadAlpha { lasts: long },
        _ => {
            let (service, patches) = PATCHES[chance.below(PATCHES.len())];
            let patch = chance.pick(patches).copied().unwrap_or("{}").to_owned();
            Fault::Set { service, patch }
        }
    }
}
