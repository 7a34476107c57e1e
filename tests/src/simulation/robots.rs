//! The fleet: what the robots truly are and do, what they put on the bus, and what they believe of
//! their team.
//!
//! Motion, links and ranks come from `shared/scenario`; each robot has habits of its own (JSON or
//! binary, with or without stamps, sequences and a token) and leaves, returns, jumps and changes its
//! superior as the plan says.

use std::collections::BTreeMap;

use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId};
use muster_model::observation::{CheckedReport, Links, Pose, Rank, Relation, Report};
use muster_scenario::{Fleet, FleetOptions, RobotObservation, ScenarioKind};
use muster_wire::{Format, Key, KeySpace, Message, Packet};
use serde_json::Value;

use super::chance::{Chance, Purpose};
use super::clock::{HostClock, MS, Micros, SECOND};
use super::router::LinkId;

/// How often the story of the scenario goes on: robots that speak in between say the same again.
const STORY_STEP: Micros = 200 * MS;

/// One stream of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Speech {
    Pose,
    Links,
    Rank,
    Relation,
}

impl Speech {
    pub(crate) const ALL: [Self; 4] = [Self::Pose, Self::Links, Self::Rank, Self::Relation];
}

/// What a robot was told and believes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Told {
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
    pub(crate) host: HostClock,
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
    /// The newest that it was told of its team.
    pub(crate) told: Option<Told>,
    chance: Chance,
}

/// All robots.
#[derive(Debug)]
pub(crate) struct Robots {
    pub(crate) all: Vec<Robot>,
    story: Fleet,
    moment: Option<Micros>,
    observed: Vec<RobotObservation>,
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
        let story = Fleet::new(kind, options).expect("every seed has a fleet");
        let names = story.robots().iter().take(robots).cloned();
        let all =
            names.enumerate().map(|(number, name)| Robot::new(seed, number, name, first_link));
        let all = all.collect();
        Self { all, story, moment: None, observed: Vec::new() }
    }

    /// Brings the story to a moment.
    pub(crate) fn tell(&mut self, moment: Micros) {
        let moment = moment - moment % STORY_STEP;
        if self.moment != Some(moment) {
            self.moment = Some(moment);
            #[expect(clippy::cast_precision_loss, reason = "a run lasts minutes")]
            let seconds = moment as f64 / SECOND as f64;
            self.observed = self.story.observe(seconds);
        }
    }

    /// Where a robot is now, as it would say.
    pub(crate) fn position(&self, robot: usize) -> Option<[f64; 3]> {
        let (observed, robot) = (self.observed.get(robot)?, self.all.get(robot)?);
        Some([observed.pose.x + robot.off[0], observed.pose.y + robot.off[1], 0.0])
    }

    /// Whom a robot answers to now.
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

    /// What a robot says now on one of its streams; none if it has nothing to say there.
    pub(crate) fn say(
        &mut self,
        space: &KeySpace,
        now: Micros,
        robot: usize,
        speech: Speech,
    ) -> Option<Packet> {
        let place = self.position(robot)?;
        let superior = self.superior(robot);
        let peer = self.all.get((robot + 1) % self.all.len().max(1))?.name.clone();
        let observed = self.observed.get(robot)?;
        let speaker = self.all.get_mut(robot).filter(|speaker| speaker.runs)?;
        speaker.seq += 1;
        let name = speaker.name.clone();
        let stamp = speaker.stamps.then(|| speaker.host.wall(now).as_seconds());
        let boot = speaker.boots.then(|| format!("run{}", speaker.life));
        let seq = speaker.counts.then_some(speaker.seq);
        let report: Report = match speech {
            Speech::Pose => {
                let [x, y, z] = place;
                let pose = observed.pose.clone();
                Pose { x, y, z: Some(z), stamp, boot, seq, ..pose }.into()
            }
            Speech::Links => {
                let links = observed.links.links.clone();
                Links { links, stamp, boot, seq }.into()
            }
            Speech::Rank => {
                let rank = observed.rank.clone();
                Rank { superior, stamp, boot, seq, ..rank }.into()
            }
            Speech::Relation => {
                let edges = if speaker.relates && peer != name {
                    vec![(name.clone(), peer, 0.5)]
                } else {
                    vec![]
                };
                let modality = Modality::new("thermal").ok()?;
                (modality, Relation { edges, stamp, boot, seq }).into()
            }
        };
        let message = Message::Report(CheckedReport::new(name, report).ok()?);
        packet(space, &message, if speaker.json { Format::Json } else { Format::Binary })
    }

    /// When a robot speaks on a stream again.
    pub(crate) fn next_speech(&mut self, robot: usize, speech: Speech) -> Micros {
        let Some(robot) = self.all.get_mut(robot) else { return SECOND };
        let period = match speech {
            Speech::Pose => robot.period,
            Speech::Links => SECOND,
            Speech::Rank | Speech::Relation => 2 * SECOND,
        };
        period + robot.chance.between(0, 20 * MS)
    }

    /// A robot hears what it is told of its team; whether that is news. It never goes back to an older
    /// division, and cares for nothing that it cannot read: anybody may put that.
    pub(crate) fn hear(&mut self, robot: usize, packet: &Packet) -> bool {
        let Some(robot) = self.all.get_mut(robot).filter(|robot| robot.runs) else { return false };
        let Some(told) = packet.payload.as_ref().ok().and_then(|bytes| read_told(bytes)) else {
            return false;
        };
        if robot.told.as_ref().is_some_and(|last| last.revision >= told.revision) {
            return false;
        }
        robot.told = Some(told);
        true
    }
}

/// Reads what a robot is told, as a robot in any language would.
pub(crate) fn read_told(bytes: &[u8]) -> Option<Told> {
    let value: Value = serde_json::from_slice(bytes).ok()?;
    let text = |name: &str| value.get(name)?.as_str().map(str::to_owned);
    let names = |list: &Vec<Value>| {
        list.iter().map(|name| name.as_str().map(str::to_owned)).collect::<Option<Vec<_>>>()
    };
    Some(Told {
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
            host: HostClock { ahead, drift: seconds(&mut chance) / 10_000 },
            runs: false,
            life: 0,
            has_token: chance.percent(80),
            json: chance.percent(60),
            stamps: chance.percent(60),
            counts,
            // A sequence that begins anew without naming the run is let in after a while only.
            boots: counts && chance.percent(85),
            seq: 0,
            relates: chance.percent(50),
            period: chance.between(100, 400) * MS,
            off: [0.0; 2],
            superior: None,
            told: None,
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
        self.told = None;
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
