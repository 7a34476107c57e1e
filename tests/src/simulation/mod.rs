//! The whole fleet in one thread: the real hosts and cores of all services, robots, an operator and an
//! attacker around a virtual router, with virtual clocks, and with the faults that a seed decides.
//!
//! A run has a *storm*, in which the faults of its [`mod@plan`] happen, and a *quiet*, in which nothing
//! happens any more and all must come to agree; in one run of four the power of all services is cut then, and in one
//! of four a whole team is cut off, and they must agree on the same again. Messages cross links as the bytes that they are on the
//! bus, through the real bounded inbox, and each service is the one host that the real shell runs. What
//! is left to the simulation is the world around hosts: the network, disks, the time that jobs take, and
//! which of the inputs that wait comes first. After every event the [`oracle`] checks what was
//! published; what it knows of the promises is its own. The same seed leads to the same run, byte for
//! byte. [`shrink()`] makes a failing one short.
//!
//! Services are addressed as (service, instance), each on a machine of its own; every other seed has two
//! of each, of which one leads and the other is a standby; of the historian each records by itself, on a virtual disk that
//! outlives its process and may be full. Operators ask the planners what the teams would be. The console is the real core as
//! well, with browsers of every speed.

mod batch;
mod browsers;
mod busy;
pub(crate) mod chance;
mod clock;
mod faults;
mod host;
mod link;
mod log;
mod mutants;
mod network;
mod node;
mod operator;
pub(crate) mod oracle;
mod outages;
mod page;
mod plan;
mod proposer;
mod recording;
mod robots;
pub(crate) mod ros;
mod router;
mod scheduler;
mod shrink;
mod viewers;
mod world;

use std::collections::{BTreeMap, BTreeSet};

pub use batch::{Batch, Summary, run_batch};
pub use mutants::Mutant;
pub use shrink::{Effort, Shrunk, shrink};

use chance::{Chance, Purpose};
use clock::{MS, Micros, SECOND};
use plan::{Span, plan};
use world::{World, places};

/// The unit of the time to agreement: a frame of `ingest` at its default rate.
pub(crate) const TICK: Micros = 100 * MS;

/// How many ticks after the last fault all agree at the latest.
///
/// What can follow each other: links are back after 1 s; a leader whose readers know a higher revision
/// notices that within 5 s, once more a second later, each time after a fetch of at most 1 s (8 s);
/// robots that left have a grace period of at most 8 s after the link is back, at the same time; a
/// service that asks for the number of teams accepts a lower answer at the second time, after 20 s. A
/// last second or two bring the frame, its embedding, division and audit, and the team of each robot.
const AGREEMENT_TICKS: u64 = 300;

/// The length of one step of a storm.
const STEP: Micros = 10 * MS;

/// How a run is to be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Options {
    /// How many robots the plan is made for; by the seed if it is left out.
    pub robots: Option<usize>,
    /// How many of those there really are; all if it is left out.
    pub fleet: Option<usize>,
    /// How long the storm lasts, in steps of 10 ms.
    pub steps: u64,
    /// Which faults of the plan happen; all if it is left out.
    pub only: Option<BTreeSet<usize>>,
    /// How many robots appear in every second of the storm in addition to the plan, and report only once.
    pub ghosts: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { robots: None, fleet: None, steps: 1500, only: None, ghosts: 0 }
    }
}

impl Options {
    fn scale(&self, seed: u64) -> Scale {
        let mut chance = Chance::new(seed, Purpose::Fleet, 2);
        // Most fleets are small: every rule has to hold for them, and they take little time.
        let most = [3, 8, 8, 14][chance.below(4)];
        let drawn = 1 + chance.below(most);
        let robots = self.robots.unwrap_or(drawn).max(1);
        let fleet = self.fleet.unwrap_or(robots).min(robots);
        let instances = if seed.is_multiple_of(2) { 1 } else { 2 };
        let storm = self.steps.max(100) * STEP;
        let ros = ros::ros_robots(seed);
        Scale { robots, fleet, instances, storm, ghosts: self.ghosts, ros }
    }
}

/// The size of a run.
#[derive(Debug, Clone, Copy)]
struct Scale {
    robots: usize,
    fleet: usize,
    /// How many instances of each service there are.
    instances: usize,
    storm: Micros,
    ghosts: usize,
    /// How many robots of ROS there are, next to the others.
    ros: usize,
}

/// What a run was like, in numbers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Stats {
    /// How many events happened.
    pub events: u64,
    /// How long it was, in microseconds of its own time.
    pub simulated: u64,
    /// How many faults of each kind happened.
    pub faults: BTreeMap<&'static str, u64>,
    /// How many messages were lost, repeated, and overtaken on links in bad weather.
    pub lost: u64,
    /// See `lost`.
    pub repeated: u64,
    /// See `lost`.
    pub mixed: u64,
    /// How many jobs were made to panic.
    pub panics: u64,
    /// How many messages services published.
    pub published: u64,
    /// How many divisions there were.
    pub divisions: u64,
    /// How many takeovers there were by an instance that nothing had kept from the renewals of the former
    /// leader.
    pub takeovers: u64,
    /// The most robots at once that a clusterer remembered in addition to those of its division.
    pub remembered: usize,
    /// How many gets of a console that joined late were answered.
    pub joined: u64,
    /// How many proposals operators have read, how many were refused, and how many were accepted and compared with the
    /// division that came of it.
    pub proposals: u64,
    /// See `proposals`.
    pub proposals_refused: u64,
    /// See `proposals`.
    pub proposals_compared: u64,
    /// How many reports of robots of ROS a bridge has put, and how many messages were sent to viewers.
    pub bridged: u64,
    /// See `bridged`.
    pub scenes: u64,
    /// How long after the last fault all agreed, in microseconds.
    pub agreement: u64,
}

/// A broken promise.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// Which promise.
    pub promise: &'static str,
    /// What was seen.
    pub seen: String,
    /// When, in microseconds.
    pub at: u64,
    /// The faults that had happened by then.
    pub happened: BTreeSet<usize>,
    /// How many faults the plan had.
    pub planned: usize,
}

/// What became of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The seed.
    pub seed: u64,
    /// How many robots there were.
    pub robots: usize,
    /// In numbers.
    pub stats: Stats,
    /// The first broken promise, if there was one.
    pub failure: Option<Failure>,
    /// The faults that were left in the plan, in words.
    pub faults: Vec<String>,
    /// Every event, if that was wanted.
    pub log: Vec<String>,
}

/// Runs one seed.
#[must_use]
pub fn simulate(seed: u64, options: &Options, mutant: Option<Mutant>, logged: bool) -> Outcome {
    let scale = options.scale(seed);
    let mut injections = plan(seed, &scale, &places(&scale));
    let planned = injections.len();
    if let Some(only) = &options.only {
        injections.retain(|injection| only.contains(&injection.number));
    }
    let faults =
        injections.iter().map(|fault| format!("{:>12}  {fault}", Span(fault.at).to_string()));
    let faults = faults.collect();
    let times: Vec<(Micros, usize)> = injections.iter().map(|i| (i.at, i.number)).collect();
    let world = World::new(seed, &scale, injections, mutant, logged);
    let (stats, breach, log) = world.run();
    let failure = breach.map(|(breach, at)| Failure {
        promise: breach.promise,
        seen: breach.seen,
        at,
        happened: times.iter().filter(|(when, _)| *when <= at).map(|(_, n)| *n).collect(),
        planned,
    });
    Outcome { seed, robots: scale.fleet, stats, failure, faults, log }
}

/// The numbers of the faults in the plan of a seed that are of one of these kinds.
#[must_use]
pub fn fault_numbers(seed: u64, options: &Options, kinds: &[&str]) -> BTreeSet<usize> {
    let scale = options.scale(seed);
    let all = plan(seed, &scale, &places(&scale)).into_iter();
    all.filter(|one| kinds.contains(&one.fault.kind())).map(|one| one.number).collect()
}

/// Whether a fault of one of these kinds is in the plan of a seed.
#[must_use]
pub fn has_fault(seed: u64, options: &Options, kinds: &[&str]) -> bool {
    let scale = options.scale(seed);
    plan(seed, &scale, &places(&scale)).iter().any(|one| kinds.contains(&one.fault.kind()))
}

impl Outcome {
    /// The command that leads to the same run.
    #[must_use]
    pub fn command(&self, options: &Options) -> String {
        use std::fmt::Write as _;
        let mut command = format!(
            "cargo run -p muster-tests --bin simulate -- --seed {} --steps {} --log",
            self.seed, options.steps
        );
        let mut add = |flag: &str, value: Option<String>| {
            if let Some(value) = value {
                // Writing to a text cannot fail.
                let _ = write!(command, " --{flag} {value}");
            }
        };
        add(
            "ghosts",
            Some(options.ghosts).filter(|count| *count > 0).map(|count| count.to_string()),
        );
        add("robots", options.robots.map(|robots| robots.to_string()));
        add("fleet", options.fleet.map(|fleet| fleet.to_string()));
        let only = options.only.as_ref().map(|only| {
            let numbers: Vec<String> = only.iter().map(ToString::to_string).collect();
            if numbers.is_empty() { "none".to_owned() } else { numbers.join(",") }
        });
        add("only", only);
        command
    }
}

/// The longest time to agreement, in words.
#[must_use]
pub fn in_ticks(agreement: u64) -> String {
    #[expect(clippy::cast_precision_loss, reason = "some seconds")]
    let seconds = agreement as f64 / SECOND as f64;
    format!("{} ticks ({seconds:.1} s, limit {AGREEMENT_TICKS})", agreement.div_ceil(TICK))
}
