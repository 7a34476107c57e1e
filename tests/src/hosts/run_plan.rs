//! Lets one fault happen to a running fleet on three hosts, and measures what its users see.

use std::collections::BTreeSet;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::fault::{Fault, GONE_S, Kind, LATE_ELSEWHERE_S, LATE_S, STALE_S, WHOLE_WITHIN_S};
use super::lab::{Host, Lab};
use super::record::Record;
use crate::client::{Division, division, now};
use crate::cluster::SERVICES;
use crate::process::{Process, program};

const FLEET: &str = "hosts";

/// What robots behind a narrow link are configured with.
const NARROW_LINK: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/narrow-link.json5");

/// Robots of the fleet, in two groups.
const ROBOTS: usize = 12;

/// How long a fleet may take from nothing to teams, on a busy machine.
const FORMED_WITHIN: Duration = Duration::from_secs(40);

/// Time without a change before a fault, so that its effects differ from those of the start.
const QUIET_TIME: Duration = Duration::from_secs(2);

/// How long a fleet is watched once it is whole again: contradictions may come later.
const WATCHED: Duration = Duration::from_secs(2);

/// How often a waiting test looks again.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// What was measured. Times are in seconds; those of what happens in a fault count from its begin,
/// those of the recovery from its end.
#[derive(Debug, Clone)]
pub struct Measured {
    /// The fault.
    pub fault: Fault,
    /// How long it really lasted.
    pub lasted: f64,
    /// When the first robot was marked stale, as a console at the router received it.
    pub stale: Option<f64>,
    /// When the last robot that left had left.
    pub gone: Option<f64>,
    /// Which robots left.
    pub left: BTreeSet<String>,
    /// Which robots are on the robots' host.
    pub on_robots_host: BTreeSet<String>,
    /// When a console at the router received the whole fleet as before, from fresh data.
    pub whole: Option<f64>,
    /// The same for a console on the robots' host.
    pub whole_on_board: Option<f64>,
    /// The longest time without a division for the console at the router.
    pub pause: f64,
    /// The same for the one on the robots' host.
    pub pause_on_board: f64,
    /// Greatest age of the data behind a division during the fault.
    pub oldest_data: f64,
    /// How long poses from the robots' host were on their way in the fault: half of them at most, and
    /// all.
    pub late: Option<(f64, f64)>,
    /// Poses from the robots' host that arrived at the router per second in the fault.
    pub poses_hz: f64,
    /// The same of the robots on the router's host, which no fault of a link is in the way of.
    pub late_elsewhere: Option<(f64, f64)>,
    /// Gets of the division in the fault that were answered at the router, and how many were asked.
    pub answered: (usize, usize),
    /// Messages that came by the key of another, to either console.
    pub misplaced: usize,
    /// What contradicted the division from before the fault.
    pub contradictions: Vec<String>,
}

/// The parts of a running fleet. They end in this order.
struct World {
    router: Option<Process>,
    console: Process,
    on_board: Process,
    relay: Option<Process>,
    _others: Vec<Process>,
    lab: Lab,
    folder: TempDir,
}

fn endpoint() -> String {
    format!("tcp/{}:7447", Host::Router.address())
}

fn start(
    lab: &Lab,
    folder: &Path,
    host: Host,
    name: &str,
    arguments: &[&str],
) -> anyhow::Result<Process> {
    let mut command = lab.command(host, &program(name)?);
    command.args(arguments);
    Process::start_command(name, command, folder)
}

/// The names of the robots that run on the robots' host, of robots with their groups. Half of each group, so
/// that both teams live on without them; all robots where the link is narrow, so that it is; or one group.
fn on_the_robots_host(fault: &Fault, robots: &[(String, String)]) -> Vec<String> {
    let names = robots.iter().map(|(robot, _)| robot.clone());
    let last = robots.iter().map(|(_, group)| group).max();
    match fault.kind {
        Kind::Narrow(_) => names.collect(),
        Kind::TeamPulled => {
            let of_last = robots.iter().filter(|(_, group)| Some(group) == last);
            of_last.map(|(robot, _)| robot.clone()).collect()
        }
        _ => names.step_by(2).collect(),
    }
}

impl World {
    fn start(fault: &Fault) -> anyhow::Result<(Self, BTreeSet<String>)> {
        let lab = Lab::new()?;
        let folder = tempfile::tempdir()?;
        let relay = match fault.kind {
            Kind::Slow => Some(lab.relay(Host::Robots, folder.path())?),
            _ => None,
        };
        let router = Some(Self::start_router(&lab, folder.path())?);
        let endpoint = endpoint();
        let bus = ["--fleet", FLEET, "--connect", &endpoint];
        let mut others = Vec::new();
        let teams = fault.teams().to_string();
        let setting = format!("teams={teams}");
        let state = folder.path().join("state").to_string_lossy().into_owned();
        for service in SERVICES {
            let mut arguments = [&bus[..], &["--state-directory", &state]].concat();
            if service == "clusterer" {
                arguments.extend(["--set", &setting]);
            }
            let name = format!("muster-{service}");
            others.push(start(&lab, folder.path(), Host::Base, &name, &arguments)?);
        }
        let count = ROBOTS.to_string();
        let scenario = ["robot", "--scenario", "clusters", "--robots", &count, "--teams", &teams];
        let list = [&scenario[..], &["--list"]].concat();
        let (_, list, _) = crate::process::run("muster", &list, Duration::from_secs(20))?;
        let robot = |line: &str| {
            let (robot, group) = line.split_once(' ')?;
            Some((robot.to_owned(), group.to_owned()))
        };
        let robots: Vec<(String, String)> = list.lines().filter_map(robot).collect();
        let here = on_the_robots_host(fault, &robots);
        let names = robots.iter().map(|(robot, _)| robot);
        let there: Vec<_> = names.filter(|robot| !here.contains(robot)).cloned().collect();
        for (host, robots) in [(Host::Robots, &here), (Host::Router, &there)] {
            if !robots.is_empty() {
                let only = robots.join(",");
                let mut arguments = [&scenario[..], &["--only", &only], &bus].concat();
                if matches!(fault.kind, Kind::Narrow(_)) {
                    arguments.extend(["--zenoh-config", NARROW_LINK]);
                }
                others.push(start(&lab, folder.path(), host, "muster", &arguments)?);
            }
        }
        let observed = [endpoint.as_str(), FLEET];
        // The observer that receives poses and gets runs where it does not load the link of the robots' host.
        let all = [&observed[..], &["all"]].concat();
        let console = start(&lab, folder.path(), Host::Router, "observer", &all)?;
        let on_board = start(&lab, folder.path(), Host::Robots, "observer", &observed)?;
        let world = Self { router, console, on_board, relay, _others: others, lab, folder };
        Ok((world, there.into_iter().collect()))
    }

    fn start_router(lab: &Lab, folder: &Path) -> anyhow::Result<Process> {
        start(lab, folder, Host::Router, "muster", &["router", "--listen", &endpoint()])
    }

    /// Waits until both observers have received all robots in so many teams.
    fn formed(&self, teams: usize) -> anyhow::Result<Division> {
        let begin = Instant::now();
        loop {
            let [console, on_board] = [&self.console, &self.on_board].map(|observer| {
                let record = Record::read(&observer.output());
                record.teams(0.0).next_back().map(|seen| division(&seen.value))
            });
            if let Some(division) = console
                && on_board.as_ref() == Some(&division)
                && division.len() == ROBOTS
                && division.values().all(Option::is_some)
                && division.values().collect::<BTreeSet<_>>().len() == teams
            {
                return Ok(division);
            }
            ensure!(
                begin.elapsed() < FORMED_WITHIN,
                "no teams are formed:\n{}\n{}",
                self.logs(),
                self.console.output()
            );
            sleep(LOOK_EVERY);
        }
    }

    fn logs(&self) -> String {
        let others = self._others.iter().chain(&self.router);
        others.map(Process::output).collect::<Vec<_>>().join("\n")
    }

    fn signal_relay(&self, signal: &str) -> anyhow::Result<()> {
        self.relay.as_ref().context("the link has no relay")?.signal(signal)
    }

    fn router(&mut self) -> anyhow::Result<&mut Process> {
        self.router.as_mut().context("there is no router")
    }

    fn begin(&mut self, kind: Kind) -> anyhow::Result<()> {
        match kind {
            Kind::Pulled(host) => self.lab.pull(host),
            Kind::TeamPulled => self.lab.pull(Host::Robots),
            Kind::Lost(host) => self.lab.lose(host),
            Kind::Narrow(rate) => self.lab.limit(Host::Robots, rate),
            Kind::Slow => self.signal_relay("USR1"),
            Kind::RouterKilled => self.router()?.kill(),
            Kind::RouterStopped => self.router()?.signal("STOP"),
        }
    }

    fn end(&mut self, kind: Kind) -> anyhow::Result<()> {
        match kind {
            Kind::Pulled(host) => self.lab.plug(host),
            Kind::TeamPulled => self.lab.plug(Host::Robots),
            Kind::Lost(host) => self.lab.find(host),
            Kind::Narrow(_) => self.lab.widen(Host::Robots),
            Kind::Slow => self.signal_relay("USR2"),
            Kind::RouterKilled => {
                self.router = Some(Self::start_router(&self.lab, self.folder.path())?);
                Ok(())
            }
            Kind::RouterStopped => self.router()?.signal("CONT"),
        }
    }
}

/// Lets a fault happen to a fresh fleet.
///
/// # Errors
/// If the fleet cannot be started, or forms no teams before the fault.
pub fn run(fault: Fault) -> anyhow::Result<Measured> {
    let (mut world, there) = World::start(&fault)?;
    let wanted = world.formed(fault.teams())?;
    sleep(QUIET_TIME);
    ensure!(
        world.formed(fault.teams())? == wanted,
        "the teams change before the fault:\n{}",
        world.logs()
    );

    let begin = now();
    world.begin(fault.kind)?;
    sleep(fault.lasts);
    world.end(fault.kind)?;
    let healed = now();
    let limit = Duration::from_secs_f64(WHOLE_WITHIN_S * 2.0);
    let waited = Instant::now();
    loop {
        let [console, on_board] = [&world.console, &world.on_board]
            .map(|observer| Record::read(&observer.output()).whole(&wanted, healed));
        if (console.is_some() && on_board.is_some()) || waited.elapsed() > limit {
            break;
        }
        sleep(LOOK_EVERY);
    }
    sleep(WATCHED);
    let end = now();
    if let Some(folder) = std::env::var_os("MUSTER_HOSTS_LOGS") {
        let folder = Path::new(&folder).join(fault.name);
        std::fs::create_dir_all(&folder)?;
        for entry in std::fs::read_dir(world.folder.path())? {
            let entry = entry?;
            if entry.file_type()?.is_file() {
                std::fs::copy(entry.path(), folder.join(entry.file_name()))?;
            }
        }
    }
    let console = Record::read(&world.console.output());
    let on_board = Record::read(&world.on_board.output());
    let after_begin = |at: Option<f64>| at.map(|at| at - begin);
    let after_end = |at: Option<f64>| at.map(|at| at - healed);
    let late = console.lateness(begin + 1.0, healed, &there);
    let here: BTreeSet<_> =
        wanted.keys().filter(|robot| !there.contains(*robot)).cloned().collect();
    let late_elsewhere = console.lateness(begin + 1.0, healed, &here);
    let half_and_all = |late: &[f64]| late.get(late.len() / 2).copied().zip(late.last().copied());
    let mut contradictions = console.contradictions(&wanted, &there, begin);
    // Robots that are cut off may leave; the others are always there.
    contradictions.extend(on_board.contradictions(&wanted, &there, begin));
    Ok(Measured {
        fault,
        lasted: healed - begin,
        stale: after_begin(console.first_event("robot_stale", begin)),
        gone: after_begin(console.last_event("robot_left", begin)),
        left: console.robots_of("robot_left", begin),
        on_robots_host: here,
        whole: after_end(console.whole(&wanted, healed)),
        whole_on_board: after_end(on_board.whole(&wanted, healed)),
        pause: console.longest_pause(begin, end),
        pause_on_board: on_board.longest_pause(begin, end),
        oldest_data: console.oldest_data(begin, healed),
        late: half_and_all(&late),
        late_elsewhere: half_and_all(&late_elsewhere),
        poses_hz: late.len() as f64 / (healed - begin - 1.0).max(1.0),
        answered: console.answered(begin, healed),
        misplaced: console.misplaced(begin) + on_board.misplaced(begin),
        contradictions,
    })
}

impl Measured {
    /// Every promise that was not kept, in words.
    #[must_use]
    pub fn broken(&self) -> Vec<String> {
        let mut broken = self.contradictions.clone();
        let mut hold = |kept: bool, promise: &str| {
            if !kept {
                broken.push(format!("{promise}: {self:?}"));
            }
        };
        let between = |at: Option<f64>, (least, most): (f64, f64)| {
            at.is_some_and(|at| (least..=most).contains(&at))
        };
        let within = |at: Option<f64>| at.is_some_and(|at| at <= WHOLE_WITHIN_S);
        hold(within(self.whole), "the fleet is whole again in time");
        hold(within(self.whole_on_board), "robots receive that in time");
        if self.fault.cuts_robots_off() {
            hold(between(self.stale, STALE_S), "silent robots are marked stale in time");
        }
        if self.fault.lets_robots_leave() {
            hold(between(self.gone, GONE_S), "silent robots leave in time");
            hold(self.left == self.on_robots_host, "all silent robots leave, and no others");
        } else {
            hold(self.left.is_empty(), "no robot leaves");
        }
        // With all robots behind a narrow link there are no other links to be held up.
        if self.fault.is_of_a_link() && self.on_robots_host.len() < ROBOTS {
            let on_time = |(_, all)| all <= LATE_ELSEWHERE_S;
            hold(self.late_elsewhere.is_some_and(on_time), "other links are not held up");
        }
        if matches!(self.fault.kind, Kind::Narrow(_) | Kind::Slow) {
            hold(self.late.is_some_and(|(_, all)| all <= LATE_S), "newer poses replace what waits");
        }
        // A link that is too narrow may be lost for a while, and one that loses packets waits longer with
        // each time that it loses the same one; their robots are silent then.
        let falters = matches!(self.fault.kind, Kind::Narrow(_) | Kind::Slow);
        if !self.fault.cuts_robots_off() && !falters {
            hold(self.stale.is_none(), "no robot is marked stale");
        }
        if self.fault.lets_base_speak() {
            hold(self.pause <= 3.0, "divisions are published meanwhile");
            let (answered, asked) = self.answered;
            hold(answered == asked, "gets are answered meanwhile");
        }
        broken
    }

    /// What was measured, for programs.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "fault": self.fault.name,
            "lasted_s": self.lasted,
            "stale_s": self.stale,
            "gone_s": self.gone,
            "left": self.left,
            "whole_s": self.whole,
            "whole_on_board_s": self.whole_on_board,
            "pause_s": self.pause,
            "pause_on_board_s": self.pause_on_board,
            "oldest_data_s": self.oldest_data,
            "late_s": self.late.map(|(half, all)| [half, all]),
            "late_elsewhere_s": self.late_elsewhere.map(|(half, all)| [half, all]),
            "poses_hz": self.poses_hz,
            "answered": self.answered.0,
            "asked": self.answered.1,
            "misplaced": self.misplaced,
            "contradictions": self.contradictions.len(),
        })
    }

    /// The head of the table.
    #[must_use]
    pub fn head() -> &'static str {
        "| fault | stale | gone | pause | recovered | pause, robots' host | recovered, robots' host |\n\
         | --- | --- | --- | --- | --- | --- | --- |"
    }

    /// Its line in the table.
    #[must_use]
    pub fn line(&self) -> String {
        let time = |at: Option<f64>| at.map_or("–".to_owned(), |at| format!("{at:.1}"));
        let what = self.fault.what;
        let (stale, gone) = (time(self.stale), time(self.gone));
        let (whole, on_board) = (time(self.whole), time(self.whole_on_board));
        let (pause, pause_on_board) = (self.pause, self.pause_on_board);
        format!(
            "| {what} | {stale} | {gone} | {pause:.1} | {whole} | {pause_on_board:.1} | {on_board} |"
        )
    }
}

/// Lets the fault of a name happen, and fails where a promise was not kept.
///
/// # Errors
/// Names every promise that was broken.
pub fn check(fault: Fault) -> anyhow::Result<Measured> {
    let measured = run(fault)?;
    let broken = measured.broken();
    if broken.is_empty() {
        return Ok(measured);
    }
    bail!("{}: {}", fault.name, broken.join("\n"))
}
