//! The fleet: what the robots truly are and do, what they put on the bus, and what they know of their
//! team.
//!
//! Motion, links and ranks come from `shared/scenario`; each robot has habits of its own (JSON or
//! binary, with or without stamps, sequences and a token) and leaves, returns, jumps and changes its
//! superior as planned.

use std::collections::BTreeMap;

use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId, SkillId};
use muster_model::observation::{CheckedReport, Links, Pose, Rank, Relation, Report};
use muster_scenario::{Fleet, FleetOptions, RobotObservation, ScenarioKind};
use muster_wire::{Format, Key, KeySpace, Message, Packet};
use serde_json::Value;

use super::chance::{Chance, Purpose};
use super::clock::{HostClock, MS, Micros, SECOND};
use super::router::LinkId;

/// Time step of the scenario: robots that report in between repeat themselves.
const SCENARIO_STEP: Micros = 200 * MS;

/// After so long without a report that it accepts, a robot goes by one with a lower revision: services have
/// started again.
const SERVICES_RESTARTED: Micros = 10 * SECOND;

/// What a report of its team is to a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reception {
    /// It is newer than what the robot knows.
    News,
    /// It is what the robot knows, or not for it.
    Known,
    /// It is older, and so is everything that came since that moment.
    Refused { since: Micros },
}

/// One stream of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RobotStream {
    Pose,
    Links,
    Rank,
    Relation,
}

impl RobotStream {
    pub(crate) const ALL: [Self; 4] = [Self::Pose, Self::Links, Self::Rank, Self::Relation];
}

/// What a robot has received of its team and goes by.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TeamReport {
    pub(crate) revision: Revision,
    pub(crate) team: Option<String>,
    pub(crate) members: Option<Vec<String>>,
    pub(crate) leader: Option<String>,
}

/// One robot.
#[derive(Debug)]
pub(crate) struct Robot {
    pub(crate) name: RobotId,
    pub(crate) link: LinkId,
    pub(crate) machine_clock: HostClock,
    /// Whether its software runs.
    pub(crate) runs: bool,
    /// Counts the runs of its software.
    pub(crate) life: u32,
    pub(crate) has_token: bool,
    json: bool,
    stamps: bool,
    counts: bool,
    boots: bool,
    seq: u64,
    relates: bool,
    /// How long after one pose the next one follows.
    period: Micros,
    off: [f64; 2],
    superior: Option<Option<usize>>,
    /// The newest that it has received of its team.
    pub(crate) team_report: Option<TeamReport>,
    /// When it last received a report that it accepted …
    received: Micros,
    /// … and since when it has received older ones alone, if it has.
    refused_since: Option<Micros>,
    chance: Chance,
}

/// All robots.
#[derive(Debug)]
pub(crate) struct Robots {
    pub(crate) all: Vec<Robot>,
    scenario: Fleet,
    moment: Option<Micros>,
    observed: Vec<RobotObservation>,
}

/// What a robot can do, by its number: of six robots two are medics and two are relays, one of them both.
fn skills(robot: usize) -> Option<Vec<SkillId>> {
    let names: &[&str] = match robot % 6 {
        0 => &["medic"],
        3 => &["relay", "medic"],
        4 => &["relay"],
        _ => return None,
    };
    Some(names.iter().filter_map(|name| SkillId::new(name).ok()).collect())
}

impl Robots {
    /// The fleet of a seed. The first robot's link has the number `first_link`.
    pub(crate) fn new(seed: u64, robots: usize, first_link: LinkId) -> Self {
        let mut chance = Chance::new(seed, Purpose::Fleet, 0);
        let kind = chance.pick(&ScenarioKind::ALL).copied().unwrap_or(ScenarioKind::Random);
        let kind = if robots < 8 { ScenarioKind::Random } else { kind };
        let options = FleetOptions {
            robots: robots.max(2),
            teams: if robots < 8 { 1 } else { 2 + chance.below(2) },
            seed,
            noise_m: chance.real(0.0, 0.5),
            radio_range_m: chance.real(20.0, 80.0),
        };
        #[expect(clippy::expect_used, reason = "a simulation without robots would prove nothing")]
        let scenario = Fleet::new(kind, options).expect("every seed has a fleet");
        let names = scenario.robots().iter().take(robots).cloned();
        let all =
            names.enumerate().map(|(number, name)| Robot::new(seed, number, name, first_link));
        let all = all.collect();
        Self { all, scenario, moment: None, observed: Vec::new() }
    }

    /// Brings the scenario to a moment.
    pub(crate) fn observe(&mut self, moment: Micros) {
        let moment = moment - moment % SCENARIO_STEP;
        if self.moment != Some(moment) {
            self.moment = Some(moment);
            #[expect(clippy::cast_precision_loss, reason = "a run lasts minutes")]
            let seconds = moment as f64 / SECOND as f64;
            self.observed = self.scenario.observe(seconds);
        }
    }

    /// Where a robot is now, as it would report.
    pub(crate) fn position(&self, robot: usize) -> Option<[f64; 3]> {
        let (observed, robot) = (self.observed.get(robot)?, self.all.get(robot)?);
        Some([observed.pose.x + robot.off[0], observed.pose.y + robot.off[1], 0.0])
    }

    /// The superior of a robot now.
    pub(crate) fn superior(&self, robot: usize) -> Option<RobotId> {
        match self.all.get(robot)?.superior {
            Some(changed) => Some(self.all.get(changed?)?.name.clone()),
            None => self.observed.get(robot)?.rank.superior.clone(),
        }
    }

    /// The robots whose software runs.
    pub(crate) fn alive(&self) -> BTreeMap<&RobotId, usize> {
        let alive = self.all.iter().enumerate().filter(|(_, robot)| robot.runs);
        alive.map(|(number, robot)| (&robot.name, number)).collect()
    }

    /// What a robot reports now on one of its streams; none if it has nothing to report there.
    pub(crate) fn report(
        &mut self,
        space: &KeySpace,
        now: Micros,
        robot: usize,
        stream: RobotStream,
    ) -> Option<Packet> {
        let place = self.position(robot)?;
        let superior = self.superior(robot);
        let peer = self.all.get((robot + 1) % self.all.len().max(1))?.name.clone();
        let observed = self.observed.get(robot)?;
        let own = self.all.get_mut(robot).filter(|own| own.runs)?;
        own.seq += 1;
        let name = own.name.clone();
        let stamp = own.stamps.then(|| own.machine_clock.wall(now).as_seconds());
        let boot = own.boots.then(|| format!("run{}", own.life));
        let seq = own.counts.then_some(own.seq);
        let report: Report = match stream {
            RobotStream::Pose => {
                let [x, y, z] = place;
                let pose = observed.pose.clone();
                Pose { x, y, z: Some(z), stamp, boot, seq, ..pose }.into()
            }
            RobotStream::Links => {
                let links = observed.links.links.clone();
                Links { links, stamp, boot, seq }.into()
            }
            RobotStream::Rank => {
                let rank = observed.rank.clone();
                Rank { superior, stamp, boot, seq, skills: skills(robot), ..rank }.into()
            }
            RobotStream::Relation => {
                let edges = if own.relates && peer != name {
                    vec![(name.clone(), peer, 0.5)]
                } else {
                    vec![]
                };
                let modality = Modality::new("thermal").ok()?;
                (modality, Relation { edges, stamp, boot, seq }).into()
            }
        };
        let message = Message::Report(CheckedReport::new(name, report).ok()?);
        packet(space, &message, if own.json { Format::Json } else { Format::Binary })
    }

    /// When a robot reports on a stream again.
    pub(crate) fn next_report(&mut self, robot: usize, stream: RobotStream) -> Micros {
        let Some(robot) = self.all.get_mut(robot) else { return SECOND };
        let period = match stream {
            RobotStream::Pose => robot.period,
            RobotStream::Links => SECOND,
            RobotStream::Rank | RobotStream::Relation => 2 * SECOND,
        };
        period + robot.chance.between(0, 20 * MS)
    }

    /// A robot receives a report of its team; what that is to it. It goes back to an older division only
    /// after [`SERVICES_RESTARTED`] without another one, as the robot in Python of the documents does, and
    /// ignores what it cannot read: any client may put that.
    pub(crate) fn receive(&mut self, robot: usize, packet: &Packet, now: Micros) -> Reception {
        let Some(robot) = self.all.get_mut(robot).filter(|robot| robot.runs) else {
            return Reception::Known;
        };
        let Some(report) = packet.payload.as_ref().ok().and_then(|bytes| read_team_report(bytes))
        else {
            return Reception::Known;
        };
        let last = robot.team_report.as_ref().map(|last| last.revision);
        if last > Some(report.revision) && now < robot.received + SERVICES_RESTARTED {
            return Reception::Refused { since: *robot.refused_since.get_or_insert(now) };
        }
        robot.refused_since = None;
        robot.received = now;
        let is_news = last != Some(report.revision);
        robot.team_report = Some(report);
        if is_news { Reception::News } else { Reception::Known }
    }
}

/// Reads a report of a team, as a robot in any language would.
pub(crate) fn read_team_report(bytes: &[u8]) -> Option<TeamReport> {
    let value: Value = serde_json::from_slice(bytes).ok()?;
    let text = |name: &str| value.get(name)?.as_str().map(str::to_owned);
    let names = |list: &Vec<Value>| {
        list.iter().map(|name| name.as_str().map(str::to_owned)).collect::<Option<Vec<_>>>()
    };
    Some(TeamReport {
        revision: Revision {
            term: value.get("term")?.as_u64()?,
            epoch: value.get("epoch")?.as_u64()?,
        },
        team: text("team"),
        members: value.get("members").and_then(Value::as_array).and_then(names),
        leader: text("leader"),
    })
}

/// A message as its sender puts it.
pub(crate) fn packet(space: &KeySpace, message: &Message, format: Format) -> Option<Packet> {
    let (key, _) = message.keys();
    let outbound = message.encode(key, format, muster_model::time::Tick(0)).ok()?;
    Some(outbound.into_packet(space))
}

impl Robot {
    fn new(seed: u64, number: usize, name: RobotId, first_link: LinkId) -> Self {
        let mut chance = Chance::new(seed, Purpose::Robot, number);
        let seconds = |chance: &mut Chance| {
            i64::try_from(chance.between(0, 4_000_000)).unwrap_or_default() - 2_000_000
        };
        let ahead = seconds(&mut chance);
        let counts = chance.percent(75);
        Self {
            name,
            link: first_link + number,
            machine_clock: HostClock { ahead, drift: seconds(&mut chance) / 10_000 },
            runs: false,
            life: 0,
            has_token: chance.percent(80),
            json: chance.percent(60),
            stamps: chance.percent(60),
            counts,
            // A sequence that begins again without a boot id is accepted only after a while.
            boots: counts && chance.percent(85),
            seq: 0,
            relates: chance.percent(50),
            period: chance.between(100, 400) * MS,
            off: [0.0; 2],
            superior: None,
            team_report: None,
            received: 0,
            refused_since: None,
            chance,
        }
    }

    /// The key of its token, if it declares one.
    pub(crate) fn token(&self, space: &KeySpace) -> Option<String> {
        self.has_token.then(|| space.format(&Key::RobotToken(self.name.clone())))
    }

    /// Its software begins to run.
    pub(crate) fn start(&mut self) {
        self.runs = true;
        self.life += 1;
        self.seq = 0;
        self.team_report = None;
        self.refused_since = None;
    }

    /// It is somewhere else from now on.
    pub(crate) fn jump(&mut self, by: [i64; 2]) {
        #[expect(clippy::cast_precision_loss, reason = "some metres")]
        let by = by.map(|metres| metres as f64);
        self.off = [self.off[0] + by[0], self.off[1] + by[1]];
    }

    /// It answers to another one from now on.
    pub(crate) fn promote(&mut self, superior: Option<usize>) {
        self.superior = Some(superior);
    }
}
