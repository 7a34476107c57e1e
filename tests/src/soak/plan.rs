//! What happens in a run: all of it follows from the seed and the length.

use std::fmt;
use std::time::Duration;

use crate::access::Security;
use crate::cluster::SERVICES;
use crate::relay::Link;
use crate::simulation::chance::{Chance, Purpose};

/// How long a fleet is taken to need after a fault, for the length of a plan.
const RECOVERY_TIME: Duration = Duration::from_secs(3);

/// How soon there is fresh data after a service was started again, in seconds, as the README promises.
const SERVICE_FRESH_WITHIN_S: f64 = 5.0;

/// The same after links, routers and floods: a link that Zenoh has not noticed to be lost must be opened again.
const LINK_FRESH_WITHIN_S: f64 = 10.0;

/// The same after everything has started again: robots must have found the router and are awaited.
const ALL_FRESH_WITHIN_S: f64 = 15.0;

/// How long the division may pause in a fault that leaves router, services and their links alone, or that a
/// standby makes up for.
const MAX_PAUSE_S: f64 = 5.0;

/// A fleet and its faults.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// What it was drawn from.
    pub seed: u64,
    /// Whether members show certificates.
    pub security: Security,
    /// Whether there are two instances of each service.
    pub has_standbys: bool,
    /// How many groups of robots stand apart.
    pub groups: usize,
    /// How many robots there are in all of them.
    pub robots: usize,
    /// Whether the number of teams is set, or chosen by the relations.
    pub sets_teams: bool,
    /// What happens, one after the other.
    pub steps: Vec<Step>,
}

/// One fault, or two at the same time. The fleet is whole again before the next step begins.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// The faults.
    pub faults: Vec<Fault>,
    /// How long nothing happens before.
    pub quiet: Duration,
}

/// Something that breaks.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// What breaks.
    pub kind: Kind,
    /// How long after the begin of its step.
    pub after: Duration,
    /// For how long.
    pub lasts: Duration,
}

/// What breaks.
#[derive(Debug, Clone, PartialEq)]
pub enum Kind {
    /// Instances of services end, by SIGTERM or SIGKILL, and are started again.
    Killed { instances: Vec<String>, is_polite: bool },
    /// Instances of services are stopped by a signal, and continued.
    Stopped { instances: Vec<String> },
    /// The router ends, by SIGTERM or SIGKILL, and is started again.
    RouterKilled { is_polite: bool },
    /// The router is stopped by a signal, and continued.
    RouterStopped,
    /// The link of some robots is cut or silent.
    RobotsCut { host: Host, link: Link },
    /// The link of the services is cut or silent.
    BaseCut { link: Link },
    /// Some robots end without a word and are started again.
    RobotsKilled { host: Host },
    /// Everything at the base ends, and is started again with its disks; perhaps the robots as well.
    Everything { is_polite: bool, with_robots: bool },
    /// The disk of the first instances is full; one of them is killed and started again meanwhile.
    DiskFull { killed: String },
    /// A stranger puts garbage on every key.
    Garbage,
    /// A stranger declares tokens of so many robots, and drops them.
    Tokens { robots: usize },
    /// A stranger puts poses for so many robots of its own, as fast as it can.
    Poses { robots: usize },
}

/// Where robots are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Host {
    /// One whole group of robots, behind a link of its own.
    Group,
    /// Some robots of the other groups, behind another link.
    Mixed,
}

impl Kind {
    /// How soon after its end the division must be whole and fresh, in seconds.
    pub(super) fn fresh_within_s(&self) -> f64 {
        match self {
            Self::Killed { .. } | Self::Stopped { .. } | Self::DiskFull { .. } => {
                SERVICE_FRESH_WITHIN_S
            }
            Self::Everything { .. } => ALL_FRESH_WITHIN_S,
            _ => LINK_FRESH_WITHIN_S,
        }
    }

    /// How long the division may pause meanwhile, in seconds; none if that has no limit but the fault's end.
    pub(super) fn max_pause_s(&self, has_standbys: bool) -> Option<f64> {
        let flows = match self {
            Self::RobotsCut { .. } | Self::RobotsKilled { .. } => true,
            Self::Garbage | Self::Tokens { .. } | Self::Poses { .. } => true,
            Self::Killed { instances, .. } | Self::Stopped { instances } => {
                has_standbys && instances.len() == 1
            }
            _ => false,
        };
        flows.then_some(MAX_PAUSE_S)
    }

    /// Whether a second fault may happen at the same time: the promises of both are still plain.
    fn is_combined(&self) -> bool {
        !matches!(self, Self::Everything { .. } | Self::DiskFull { .. })
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let signal = |is_polite: &bool| if *is_polite { "SIGTERM" } else { "SIGKILL" };
        let robots = |host: &Host| match host {
            Host::Group => "a whole group of robots",
            Host::Mixed => "robots of several groups",
        };
        let broken = |link: &Link| if *link == Link::Cut { "cut" } else { "silent" };
        match self {
            Self::Killed { instances, is_polite } => {
                write!(out, "{} to {}", signal(is_polite), instances.join(", "))
            }
            Self::Stopped { instances } => write!(out, "SIGSTOP to {}", instances.join(", ")),
            Self::RouterKilled { is_polite } => write!(out, "{} to the router", signal(is_polite)),
            Self::RouterStopped => write!(out, "SIGSTOP to the router"),
            Self::RobotsCut { host, link } => {
                write!(out, "link of {} {}", robots(host), broken(link))
            }
            Self::BaseCut { link } => write!(out, "link of the services {}", broken(link)),
            Self::RobotsKilled { host } => write!(out, "SIGKILL to {}", robots(host)),
            Self::Everything { is_polite, with_robots } => {
                let robots = if *with_robots { ", robots as well" } else { "" };
                write!(out, "{} to router and all services{robots}", signal(is_polite))
            }
            Self::DiskFull { killed } => write!(out, "disk full, and SIGKILL to {killed}"),
            Self::Garbage => write!(out, "flood of garbage on every key"),
            Self::Tokens { robots } => write!(out, "flood of {robots} robot tokens"),
            Self::Poses { robots } => write!(out, "flood of poses of {robots} strange robots"),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}, {:.1} s", self.kind, self.lasts.as_secs_f64())?;
        if self.after.is_zero() {
            return Ok(());
        }
        write!(out, ", {:.1} s later", self.after.as_secs_f64())
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "seed {}: {} robots in {} groups, {}, {} instance(s) of each service, number of teams {}",
            self.seed,
            self.robots,
            self.groups,
            match self.security {
                Security::Plain => "plain bus",
                Security::Secured => "secured bus",
            },
            if self.has_standbys { 2 } else { 1 },
            if self.sets_teams { "set" } else { "chosen by the relations" },
        )?;
        for (number, step) in self.steps.iter().enumerate() {
            writeln!(out, "{:>4}  {step}", number + 1)?;
        }
        Ok(())
    }
}

impl fmt::Display for Step {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let faults: Vec<String> = self.faults.iter().map(Fault::to_string).collect();
        out.write_str(&faults.join("; and "))
    }
}

impl Step {
    /// From the begin of the first fault to the end of the last.
    pub(super) fn lasts(&self) -> Duration {
        let ends = self.faults.iter().map(|fault| fault.after + fault.lasts);
        ends.max().unwrap_or_default()
    }

    /// How soon after the last fault the division must be whole and fresh, in seconds.
    pub(super) fn fresh_within_s(&self) -> f64 {
        let each = self.faults.iter().map(|fault| fault.kind.fresh_within_s());
        each.fold(0.0, f64::max)
    }

    /// How long the division may pause, in seconds: as long as each of its faults allows, if each does.
    pub(super) fn max_pause_s(&self, has_standbys: bool) -> Option<f64> {
        let mut longest = 0.0_f64;
        for fault in &self.faults {
            longest = longest.max(fault.kind.max_pause_s(has_standbys)?);
        }
        // Two faults may follow each other.
        Some(if self.faults.len() > 1 { 2.0 * longest } else { longest })
    }
}

/// The kinds of faults. A plan deals all of them in an order of its own before it deals one again.
const DECK: [Card; 18] = [
    Card::KillOne,
    Card::KillOne,
    Card::KillSome,
    Card::KillAll,
    Card::StopOne,
    Card::StopOne,
    Card::RouterKilled,
    Card::RouterStopped,
    Card::RobotsCut,
    Card::RobotsCut,
    Card::RobotsCutLong,
    Card::BaseCut,
    Card::RobotsKilled,
    Card::Everything,
    Card::DiskFull,
    Card::Garbage,
    Card::Tokens,
    Card::Poses,
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Card {
    KillOne,
    KillSome,
    KillAll,
    StopOne,
    RouterKilled,
    RouterStopped,
    RobotsCut,
    RobotsCutLong,
    BaseCut,
    RobotsKilled,
    Everything,
    DiskFull,
    Garbage,
    Tokens,
    Poses,
}

/// The plan of a seed for a run of about so long. The bus is drawn as well, unless it is given. A longer plan of
/// the same seed begins with the shorter one.
#[must_use]
pub fn plan(seed: u64, length: Duration, security: Option<Security>) -> Plan {
    let mut fleet = Chance::new(seed, Purpose::Soak, 0);
    let drawn = if fleet.percent(50) { Security::Secured } else { Security::Plain };
    let groups = 2 + fleet.below(3);
    let mut plan = Plan {
        seed,
        security: security.unwrap_or(drawn),
        has_standbys: fleet.percent(50),
        groups,
        // Four or more of each group, so that a team lives on without some of them.
        robots: groups * (4 + fleet.below(2)),
        sets_teams: fleet.percent(50),
        steps: Vec::new(),
    };
    let mut chance = Chance::new(seed, Purpose::Soak, 1);
    let mut planned = Duration::ZERO;
    let mut cards: Vec<Card> = Vec::new();
    while planned < length || plan.steps.is_empty() {
        if cards.is_empty() {
            cards = DECK.to_vec();
        }
        let card = cards.swap_remove(chance.below(cards.len()));
        let mut faults = vec![fault(card, plan.has_standbys, &mut chance)];
        let second = DECK[chance.below(DECK.len())];
        let another = fault(second, plan.has_standbys, &mut chance);
        let is_double = chance.percent(20);
        let fits = |fault: &Fault| fault.kind.is_combined() && fault.lasts < Duration::from_secs(7);
        if is_double && faults.iter().all(fits) && fits(&another) && another.kind != faults[0].kind
        {
            let after = part_of(&faults[0].lasts, &mut chance);
            faults.push(Fault { after, ..another });
        }
        let quiet = ms(chance.between(1000, 3000));
        let step = Step { faults, quiet };
        planned += step.lasts() + step.quiet + RECOVERY_TIME;
        plan.steps.push(step);
    }
    plan
}

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn part_of(time: &Duration, chance: &mut Chance) -> Duration {
    time.mul_f64(chance.real(0.1, 1.0))
}

/// The instances that a fault of services may hit.
fn instances(has_standbys: bool) -> Vec<String> {
    let first = SERVICES.map(str::to_owned);
    let second = SERVICES.iter().filter(|_| has_standbys).map(|service| second(service));
    first.into_iter().chain(second).collect()
}

/// The name of the second instance of a service.
pub(super) fn second(service: &str) -> String {
    format!("{service}-2")
}

fn fault(card: Card, has_standbys: bool, chance: &mut Chance) -> Fault {
    let all = instances(has_standbys);
    let some = |chance: &mut Chance, count: usize| -> Vec<String> {
        let mut left = all.clone();
        (0..count.min(left.len())).map(|_| left.swap_remove(chance.below(left.len()))).collect()
    };
    let is_polite = chance.percent(40);
    let host = if chance.percent(50) { Host::Group } else { Host::Mixed };
    let link = if chance.percent(50) { Link::Cut } else { Link::Silent };
    let (kind, least_ms, most_ms) = match card {
        Card::KillOne => (Kind::Killed { instances: some(chance, 1), is_polite }, 100, 5000),
        Card::KillSome => {
            let count = 2 + chance.below(2);
            (Kind::Killed { instances: some(chance, count), is_polite }, 100, 5000)
        }
        Card::KillAll => (Kind::Killed { instances: all.clone(), is_polite }, 100, 5000),
        Card::StopOne => (Kind::Stopped { instances: some(chance, 1) }, 300, 8000),
        Card::RouterKilled => (Kind::RouterKilled { is_polite }, 100, 8000),
        Card::RouterStopped => (Kind::RouterStopped, 300, 6000),
        Card::RobotsCut => (Kind::RobotsCut { host, link }, 300, 6000),
        Card::RobotsCutLong => (Kind::RobotsCut { host, link }, 12_000, 20_000),
        Card::BaseCut => (Kind::BaseCut { link }, 300, 10_000),
        Card::RobotsKilled => (Kind::RobotsKilled { host }, 100, 6000),
        Card::Everything => {
            let with_robots = chance.percent(30);
            (Kind::Everything { is_polite, with_robots }, 200, 6000)
        }
        Card::DiskFull => {
            let killed = SERVICES[chance.below(SERVICES.len())].to_owned();
            (Kind::DiskFull { killed }, 2000, 6000)
        }
        Card::Garbage => (Kind::Garbage, 2000, 5000),
        Card::Tokens => (Kind::Tokens { robots: 500 + chance.below(1500) }, 2000, 5000),
        Card::Poses => (Kind::Poses { robots: 1 + chance.below(4) }, 2000, 6000),
    };
    Fault { kind, after: Duration::ZERO, lasts: ms(chance.between(least_ms, most_ms)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE: Duration = Duration::from_secs(60);

    #[test]
    fn the_same_seed_gives_the_same_plan_and_a_longer_one_begins_with_it() {
        for seed in 0..50 {
            let short = plan(seed, MINUTE, None);
            assert_eq!(short, plan(seed, MINUTE, None));
            let long = plan(seed, 10 * MINUTE, None);
            assert!(long.steps.len() > short.steps.len());
            assert_eq!(long.steps[..short.steps.len()], short.steps);
            let plain = plan(seed, MINUTE, Some(Security::Plain));
            assert_eq!((plain.security, &plain.steps), (Security::Plain, &short.steps));
        }
        assert_ne!(plan(1, MINUTE, None).steps, plan(2, MINUTE, None).steps);
    }

    #[test]
    fn ten_minutes_have_every_kind_of_fault() {
        for seed in 0..20 {
            let text = plan(seed, 10 * MINUTE, None).to_string();
            let kinds = ["SIGTERM", "SIGKILL", "SIGSTOP", "router", "link of", "disk", "garbage"];
            for kind in [&kinds[..], &["tokens", "strange", "all services"]].concat() {
                assert!(text.contains(kind), "{kind} is missing in {text}");
            }
        }
    }
}
