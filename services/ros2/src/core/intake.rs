//! Samples of ROS on their way to reports: the newest of each robot and topic waits for the next tick.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use muster_model::bridge::TopicFault;
use muster_model::id::RobotId;
use muster_model::observation::{CheckedReport, Provenance, Report};
use muster_model::time::Tick;
use muster_ros::key::parse_dds_key;
use muster_ros::{Attachment, Dialect, Gid, TopicKey, TypeHash, Value, cdr};
use muster_wire::{Packet, Source};

use super::extract::{self, Problem, Stamped};
use super::frames::{Frames, MAX_ROBOT_FRAMES, MAX_SHARED_FRAMES, Number};
use super::robots::{Robots, SWITCH_AFTER, Stream};
use crate::config::{Content, Setup};

/// Most topics of robots that are read: a fleet of 5,000 robots has four each.
const MAX_KEYS: usize = 65_536;

/// Most bytes of samples that wait for the next tick: poses of 5,000 robots have less than 5 MB, and one sample may have
/// 256 KiB.
const MAX_WAITING_BYTES: usize = 64 * 1024 * 1024;

/// How long a topic without data is remembered, so that those of robots that are gone take no memory. One that holds
/// something stays for as long as its robot brings poses, since what was said once holds for as long.
const FORGET_AFTER: Duration = Duration::from_secs(60);

/// How long a static transform of a tree that all robots share stays after it last arrived: its publisher is asked for it
/// every ten seconds, and one that is silent for so long is gone.
const FORGET_STATIC_AFTER: Duration = Duration::from_secs(3600);

/// How long the odometry of a robot that starts may wait for its transforms before that is a fault.
const START_TIME: Duration = Duration::from_secs(2);

/// How often what is not needed any more is looked for.
const FORGET_EVERY: Duration = Duration::from_secs(10);

/// A sample that is not taken.
#[derive(Debug)]
pub(super) struct Refused {
    /// Its key.
    pub(super) key: String,
    /// Why.
    pub(super) problem: Problem,
}

/// One topic of one robot, or one that all share.
#[derive(Debug)]
struct Topic {
    source: usize,
    /// The name in ROS; empty where all robots share the topic.
    name: String,
    /// 0 with a bridge of DDS, which knows none.
    domain: u32,
    /// None where all robots share the topic.
    robot: Option<RobotId>,
    first: Tick,
    last: Tick,
    /// The newest sample that is not taken yet.
    waiting: Option<Waiting>,
    authors: Authors,
    /// The key in its parts; none with a bridge of DDS.
    key: Option<TopicKey>,
    /// What holds until something else is said: links, or a superior. It may have been said once, and is put again for
    /// services that lost it. With when it was last put.
    holds: Option<(Report, Tick)>,
}

impl Topic {
    /// Whether it is remembered.
    fn stays(&self, now: Tick, robots: &Robots) -> bool {
        let has_posed = |robot| robots.has_posed(now, robot, FORGET_AFTER);
        now.since(self.last) <= FORGET_AFTER
            || (self.holds.is_some() && self.robot.as_ref().is_some_and(has_posed))
    }
}

/// Most publishers of one topic that are remembered as replaced: of more, two programs alternate in any case.
const MAX_REPLACED: usize = 8;

/// How many messages in a row may be late. A network reorders a few; a program that numbers by hand may give all one number.
const MAX_LATE: u32 = 10;

/// Late messages that come more rarely than this do not count: a network may repeat one, and a program that numbers by hand
/// puts more often.
const LATE_WITHIN: Duration = Duration::from_secs(5);

/// How long the publisher that counts may leave unanswered what another one answers until it is gone. Publishers are asked
/// every ten seconds, so that it has missed two rounds by then: one answer may be lost.
const GONE_AFTER: Duration = Duration::from_secs(15);

/// The publishers of a topic of one robot. One counts at a time: the last that appeared, since a robot that starts again has
/// a publisher of another name. One that was replaced and goes on alternates with the other, and is refused while
/// messages of that one come, as `ingest` would.
///
/// A message that was kept says nothing of who appeared last: its publisher counts only if there is no other, or if that one is
/// gone and it is new.
#[derive(Debug, Default)]
struct Authors {
    current: Option<Author>,
    replaced: Vec<Gid>,
    /// Those that counted once, the newest last: what they keep is older than what replaced them.
    earlier: VecDeque<Gid>,
}

#[derive(Debug)]
struct Author {
    gid: Gid,
    /// The number of its newest message.
    sequence: i64,
    /// How many messages in a row were none newer, but for those that were kept.
    late: u32,
    last: Tick,
    /// Since when others answer what they keep, and this one does not.
    unanswered: Option<Tick>,
}

impl Authors {
    /// Whether a message is the newest of the publisher that counts. All that is kept comes again and again, and a put may
    /// come late.
    fn accept(
        &mut self,
        now: Tick,
        attachment: &Attachment,
        is_kept: bool,
    ) -> Result<bool, String> {
        let Attachment { gid, sequence, .. } = *attachment;
        if let Some(current) = &mut self.current {
            if current.gid == gid {
                let pause = now.since(std::mem::replace(&mut current.last, now));
                current.unanswered = None;
                let is_newer = sequence > current.sequence;
                if is_newer {
                    (current.sequence, current.late) = (sequence, 0);
                } else if is_kept {
                    return Ok(false);
                } else if pause < LATE_WITHIN {
                    current.late += 1;
                }
                return if current.late < MAX_LATE {
                    Ok(is_newer)
                } else {
                    Err(format!("the numbers of its publisher do not grow: {sequence} came again"))
                };
            }
            if is_kept {
                let since = *current.unanswered.get_or_insert(now);
                if self.earlier.contains(&gid) || now.since(since) <= GONE_AFTER {
                    return Ok(false);
                }
            }
            if now.since(current.last) > SWITCH_AFTER {
                self.replaced.clear();
            } else if self.replaced.contains(&gid) {
                return Err(format!(
                    "two programs publish this topic: {}, which came last, counts, and {gid} does not; end one of them",
                    current.gid
                ));
            } else if self.replaced.len() < MAX_REPLACED {
                self.replaced.push(current.gid);
            }
            self.earlier.retain(|earlier| *earlier != current.gid);
            self.earlier.push_back(current.gid);
            if self.earlier.len() > MAX_REPLACED {
                self.earlier.pop_front();
            }
        }
        self.current = Some(Author { gid, sequence, late: 0, last: now, unanswered: None });
        Ok(true)
    }
}

/// A topic that is read from now on, or no longer.
#[derive(Debug)]
pub(super) enum Reading {
    Begins(TopicKey),
    Ends(TopicKey),
}

#[derive(Debug)]
struct Waiting {
    payload: Vec<u8>,
    attachment: Option<Attachment>,
}

/// The topics and frames of all robots.
#[derive(Debug)]
pub(super) struct Intake {
    setup: Arc<Setup>,
    /// Names this run, where publishers have no names.
    boot: String,
    /// By source and key: several sources may read different fields of one message. Each has every message of its own.
    topics: BTreeMap<(usize, String), Topic>,
    /// By domain and name of the robot in ROS; the name is empty where all robots share a tree.
    frames: BTreeMap<(u32, String), Frames>,
    robots: Robots,
    /// How many samples were taken. It numbers those without a number of their own, over all robots and topics, so that it
    /// goes on where a topic is forgotten and comes again.
    taken: u64,
    /// How many bytes wait, over all topics.
    waiting_bytes: usize,
    forget_due: Tick,
    /// What the graph of ROS is not shown yet.
    readings: Vec<Reading>,
}

impl Intake {
    pub(super) fn new(setup: Arc<Setup>, boot: String) -> Self {
        Self {
            setup,
            boot,
            topics: BTreeMap::new(),
            frames: BTreeMap::new(),
            robots: Robots::default(),
            taken: 0,
            waiting_bytes: 0,
            forget_due: Tick::default(),
            readings: Vec::new(),
        }
    }

    /// The number of a further report that has none of its publisher. It grows over all robots and kinds of reports.
    pub(super) fn number(&mut self) -> u64 {
        self.taken += 1;
        self.taken
    }

    /// What robots have said that holds until they say something else, if it was last put before `every`, of those that have
    /// brought a pose within a time. Once said, it may be lost on its way to the fleet, or by services that all start again.
    pub(super) fn repeat(
        &mut self,
        now: Tick,
        every: Duration,
        within: Duration,
    ) -> Vec<(RobotId, Report)> {
        let Self { setup, boot, topics, robots, taken, .. } = self;
        let mut reports = Vec::new();
        for topic in topics.values_mut() {
            let (Some(robot), Some((report, put))) = (&topic.robot, &mut topic.holds) else {
                continue;
            };
            if now.since(*put) < every {
                continue;
            }
            let stream = setup.sources.get(topic.source).and_then(|one| Stream::of(&one.content));
            let is_read = |stream| robots.source(robot, stream) == Some(topic.source);
            if stream.is_some_and(is_read) && robots.has_posed(now, robot, within) {
                *put = now;
                *taken += 1;
                let (boot, seq) = (Some(boot.clone()), Some(*taken));
                let provenance = Provenance { stamp: None, boot, seq };
                reports.push((robot.clone(), report.clone().with_provenance(provenance)));
            }
        }
        reports
    }

    /// The topics that are read since this was last asked, and those that are no longer.
    pub(super) fn take_readings(&mut self) -> Vec<Reading> {
        std::mem::take(&mut self.readings)
    }

    pub(super) fn robots(&self) -> &Robots {
        &self.robots
    }

    /// How many topics are known; one counts for each source that reads it.
    pub(super) fn topics(&self) -> usize {
        self.topics.len()
    }

    /// How many frames have a transform, in all trees.
    pub(super) fn frames(&self) -> usize {
        self.frames.values().map(Frames::len).sum()
    }

    /// A sample of a source arrived, as it was put or as its publisher kept it. Transforms are taken at once, all else waits
    /// for [`Intake::take`].
    pub(super) fn receive(
        &mut self,
        now: Tick,
        source: usize,
        packet: Packet,
        is_kept: bool,
    ) -> Result<(), Refused> {
        let Packet { key, payload, attachment, source: from, .. } = packet;
        if from != Source::Put {
            return Ok(());
        }
        let place = (source, key);
        let refuse = |problem: Problem| Refused { key: place.1.clone(), problem };
        let payload = payload
            .map_err(|size| refuse(format!("{size} bytes are too many for one message").into()))?;
        let attachment = match self.setup.dialect {
            Dialect::Ros2Dds => None,
            Dialect::RmwZenoh => Some(attachment.map_or_else(
                || Err(refuse(Problem::new(TopicFault::NoAttachment, NO_ATTACHMENT))),
                |bytes| parse_attachment(bytes.as_bytes()).map_err(|text| refuse(text.into())),
            )?),
        };
        if !self.topics.contains_key(&place) {
            let topic = self.open(now, source, &place.1).map_err(&refuse)?;
            self.readings.extend(topic.key.clone().map(Reading::Begins));
            self.topics.insert(place.clone(), topic);
        }
        let Some(topic) = self.topics.get_mut(&place) else { return Ok(()) };
        topic.last = now;
        let setup = &self.setup;
        let Some(description) = setup.sources.get(topic.source) else { return Ok(()) };
        if let Content::Transforms { is_static } = description.content {
            let value = cdr::decode(&description.layout, &payload);
            let value = value.map_err(|error| refuse(error.to_string().into()))?;
            let limit = if topic.robot.is_some() { MAX_ROBOT_FRAMES } else { MAX_SHARED_FRAMES };
            let frames = self.frames.entry((topic.domain, topic.name.clone()));
            let frames = frames.or_insert_with(|| Frames::new(limit));
            let number = attachment.map(|a| Number { publisher: a.gid, sequence: a.sequence });
            let taken = take_transforms(now, frames, &value, is_static, number);
            return taken.map_err(|text| refuse(text.into()));
        }
        if let Some(attachment) = &attachment
            && !topic
                .authors
                .accept(now, attachment, is_kept)
                .map_err(|text| refuse(text.into()))?
        {
            return Ok(());
        }
        let replaced = topic.waiting.as_ref().map_or(0, |waiting| waiting.payload.len());
        let bytes = self.waiting_bytes.saturating_sub(replaced).saturating_add(payload.len());
        if bytes > MAX_WAITING_BYTES {
            return Err(refuse(format!("more than {MAX_WAITING_BYTES} bytes may not wait").into()));
        }
        self.waiting_bytes = bytes;
        topic.waiting = Some(Waiting { payload, attachment });
        Ok(())
    }

    /// The topic of a key that was not seen before.
    fn open(&mut self, now: Tick, source: usize, key: &str) -> Result<Topic, Problem> {
        let description = self.setup.sources.get(source).ok_or("this is no source")?;
        let (topic, parsed) = match self.setup.dialect {
            Dialect::RmwZenoh => {
                let parsed = TopicKey::parse(key).map_err(|error| error.to_string())?;
                if parsed.type_name != *description.layout.name() {
                    return Err(format!("the type is {}", parsed.type_name).into());
                }
                if parsed.hash != description.hash && parsed.hash != TypeHash::NotSupported {
                    let reason = format!(
                        "the robot has another definition of {} than this bridge: its hash is {}, not {}; add its .msg \
                         text as definition",
                        parsed.type_name, parsed.hash, description.hash
                    );
                    return Err(Problem::new(TopicFault::TypeHash, reason));
                }
                (parsed.topic.clone(), Some(parsed))
            }
            Dialect::Ros2Dds => {
                let key = match &self.setup.namespace {
                    Some(namespace) => {
                        let rest = key.strip_prefix(namespace.as_str());
                        rest.and_then(|rest| rest.strip_prefix('/')).unwrap_or(key)
                    }
                    None => key,
                };
                (parse_dds_key(key).map_err(|error| error.to_string())?, None)
            }
        };
        let name = description.topic.robot_of(topic.as_str()).ok_or("this is another topic")?;
        let domain = parsed.as_ref().map_or(0, |key| key.domain);
        if self.topics.len() >= MAX_KEYS {
            return Err(format!("more than {MAX_KEYS} topics are not read").into());
        }
        let robot = (!name.is_empty()).then(|| self.robots.join(name, domain)).transpose()?;
        let name = name.to_owned();
        let authors = Authors::default();
        Ok(Topic {
            source,
            name,
            domain,
            robot,
            first: now,
            last: now,
            waiting: None,
            authors,
            key: parsed,
            holds: None,
        })
    }

    /// The reports of the newest samples that were not taken yet, and what is refused of them.
    pub(super) fn take(&mut self, now: Tick) -> (Vec<(RobotId, Report)>, Vec<Refused>) {
        let (mut reports, mut refused) = (Vec::new(), Vec::new());
        self.waiting_bytes = 0;
        // Sources come as the file lists them: of each robot and stream the first that brings something is read.
        for ((_, key), topic) in &mut self.topics {
            let Some(waiting) = topic.waiting.take() else { continue };
            let (Some(robot), Some(source)) = (&topic.robot, self.setup.sources.get(topic.source))
            else {
                continue;
            };
            let Some(stream) = Stream::of(&source.content) else { continue };
            if !self.robots.is_read(now, robot, stream, topic.source) {
                continue;
            }
            self.taken += 1;
            // What is put again needs a number that grows, which that of its message does not.
            let numbered = waiting.attachment.filter(|_| stream == Stream::Pose);
            let stamped = Stamped {
                now,
                boot: numbered.map_or_else(|| self.boot.clone(), |a| a.gid.to_string()),
                seq: numbered.map_or(self.taken, |a| a.sequence.unsigned_abs()),
            };
            let tree = if self.setup.prefix.is_some() { "" } else { topic.name.as_str() };
            let frames = self.frames.get(&(topic.domain, tree.to_owned()));
            let report = read(&self.setup, source, topic, frames, &waiting.payload, stamped)
                .and_then(|report| {
                    // What the fleet would refuse anyway, with the name of the field.
                    let checked = CheckedReport::new(robot.clone(), report);
                    Ok(checked.map_err(|error| error.to_string())?.into_parts())
                });
            match report {
                Ok(report) => {
                    if stream != Stream::Pose {
                        topic.holds = Some((report.1.clone(), now));
                    }
                    self.robots.reported(now, robot, stream, topic.source);
                    reports.push(report);
                }
                Err(problem) if problem.may_pass() && now.since(topic.first) <= START_TIME => {}
                Err(problem) => refused.push(Refused { key: key.clone(), problem }),
            }
        }
        self.forget(now);
        (reports, refused)
    }

    /// Drops what is not needed any more, now and then.
    fn forget(&mut self, now: Tick) {
        if now < self.forget_due {
            return;
        }
        self.forget_due = now.after(FORGET_EVERY);
        let mut gone = Vec::new();
        self.topics.retain(|_, topic| {
            let stays = topic.stays(now, &self.robots);
            if !stays {
                gone.extend(topic.key.take());
            }
            stays
        });
        // A topic is read for as long as any source reads it.
        let read: BTreeSet<_> =
            self.topics.values().filter_map(|topic| topic.key.as_ref()).collect();
        gone.retain(|key| !read.contains(key));
        self.readings.extend(gone.into_iter().map(Reading::Ends));
        let stay: BTreeSet<&RobotId> =
            self.topics.values().filter_map(|topic| topic.robot.as_ref()).collect();
        self.robots.keep(&stay);
        let places = self.robots.places();
        self.frames.retain(|(domain, name), frames| {
            if name.is_empty() {
                frames.forget(now, FORGET_AFTER, Some(FORGET_STATIC_AFTER));
                return !frames.is_empty();
            }
            // A static transform comes once: it stays for as long as its robot has any topic.
            frames.forget(now, FORGET_AFTER, None);
            places.contains(&(*domain, name.as_str()))
        });
    }
}

/// The attachment of a message; publishers count from 1, and those of some programs from 0.
fn parse_attachment(bytes: &[u8]) -> Result<Attachment, String> {
    let attachment = Attachment::parse(bytes).map_err(|error| error.to_string())?;
    match attachment.sequence {
        0.. => Ok(attachment),
        number => {
            Err(format!("the number of the message is {number}; publishers count from 0 or 1"))
        }
    }
}

/// What a robot reports by the bytes of a message.
fn read(
    setup: &Setup,
    source: &crate::config::Source,
    topic: &Topic,
    frames: Option<&Frames>,
    payload: &[u8],
    stamped: Stamped,
) -> Result<Report, Problem> {
    let value = cdr::decode(&source.layout, payload).map_err(|error| error.to_string())?;
    extract::report(setup, &source.content, &topic.name, frames, &value, stamped)
}

/// Why a message without an attachment is not taken.
const NO_ATTACHMENT: &str = "the message has no attachment, so that rmw_zenoh drops it as well; does a program put it \
     by hand, or is the dialect ros2dds?";

/// Takes the transforms of a message that are right.
fn take_transforms(
    now: Tick,
    frames: &mut Frames,
    message: &Value,
    is_static: bool,
    number: Option<Number>,
) -> Result<(), String> {
    let mut problem = Ok(());
    for transform in extract::transforms(message)? {
        let taken = transform.and_then(|named| {
            let extract::NamedTransform { parent, child, transform } = named;
            let taken = frames.receive(now, parent, child, transform, is_static, number);
            taken.map_err(|error| error.to_string())
        });
        problem = problem.and(taken);
    }
    problem
}
