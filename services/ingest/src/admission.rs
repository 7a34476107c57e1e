//! What is accepted: content by the settings of the fleet, order and rate by stream.

use std::collections::VecDeque;
use std::time::Duration;

use muster_model::id::{Modality, RobotId, SkillId};
use muster_model::limits::MAX_GRAPH_EDGES;
use muster_model::observation::{
    Link, Links, ObservationError, Pose, Provenance, Rank, Relation, Report, Stream,
};
use muster_model::settings::{ConnectivitySettings, IngestSettings, LinkUnit};
use muster_model::time::{Tick, seconds};
use muster_relation::hierarchy::DEFAULT_TIE;
use muster_relation::{link_weight, signal_weight};

/// How many runs of a robot's software are remembered as over, per stream. A late message comes from
/// the run before, or from a few before that if the robot restarts in a loop; more would let a robot
/// that names its runs at random fill the memory.
const REMEMBERED_BOOTS: usize = 8;

/// How many seconds' worth of messages may come at once: a link that stalled delivers in a burst.
const BURST_S: f64 = 1.0;

/// How often a late message must follow an accepted one for two programs to be the reason. Chance delays come
/// once; two programs with the same rate reach this within three of their periods.
const TURNS_OF_TWO_PROGRAMS: u32 = 3;

/// Longest time between two such turns: two of the slowest periods of robots that put regularly.
const TURNS_WITHIN: Duration = Duration::from_secs(10);

/// A robot's clock that is further off than this is not set at all. That is counted, not refused, and
/// says nothing of the order: age is measured by the receiver's clock.
const ABSURD_STAMP: Duration = Duration::from_secs(86_400);

/// The counter of the messages of a stream that were accepted.
pub(crate) const fn accepted(stream: &Stream) -> &'static str {
    match stream {
        Stream::Pose => "poses_accepted",
        Stream::Links => "links_accepted",
        Stream::Rank => "ranks_accepted",
        Stream::Relation(_) => "relations_accepted",
    }
}

/// Where the edges of a report lead, seen from the robot that reports them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    /// To the robot.
    Incoming,
    /// From the robot.
    Outgoing,
}

/// Where the edges of a stream's reports lead; none if its reports are no lists of edges.
pub(crate) const fn direction(stream: &Stream) -> Option<Direction> {
    match stream {
        Stream::Links => Some(Direction::Incoming),
        Stream::Relation(_) => Some(Direction::Outgoing),
        Stream::Pose | Stream::Rank => None,
    }
}

/// A report, made ready for the graphs.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Content {
    /// Where the robot is.
    Pose {
        /// Metres east, north, up.
        position: [f64; 3],
        /// Radians.
        heading: Option<f64>,
        /// The frame, named.
        frame: String,
    },
    /// Its superior.
    Rank(Tie),
    /// The other ends of edges, ordered by name, without those that have no weight under any settings.
    Edges(Vec<(RobotId, Strength)>),
}

/// The strength of an edge as it was reported: what a signal is worth follows the settings, which may
/// change after the report.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Strength {
    /// A weight.
    Weight(f64),
    /// A signal strength in dBm.
    Signal(f64),
}

impl Strength {
    /// The weight of the edge.
    pub(crate) fn weight(self, settings: &ConnectivitySettings) -> f64 {
        match self {
            Self::Weight(weight) => weight,
            Self::Signal(dbm) => signal_weight(settings, dbm),
        }
    }
}

impl Content {
    /// How many edges it may lead to.
    pub(crate) fn edge_count(&self) -> usize {
        match self {
            Self::Edges(edges) => edges.len(),
            Self::Pose { .. } | Self::Rank(_) => 0,
        }
    }
}

/// The superior of a robot, its role and its skills.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tie {
    /// The superior; none at the top.
    pub(crate) superior: Option<RobotId>,
    /// How strongly it is tied to the superior.
    pub(crate) weight: f64,
    /// What it is within its unit.
    pub(crate) role: Option<String>,
    /// What it can do, ordered by name.
    pub(crate) skills: Vec<SkillId>,
}

impl Default for Tie {
    fn default() -> Self {
        Self { superior: None, weight: DEFAULT_TIE, role: None, skills: Vec::new() }
    }
}

/// A report that fits the settings: its order and rate are still to be checked.
#[derive(Debug)]
pub(crate) struct Observed {
    /// Where it belongs.
    pub(crate) stream: Stream,
    /// Its place in the order of the robot's reports.
    pub(crate) provenance: Provenance,
    /// Its content.
    pub(crate) content: Content,
}

/// Why a message is refused.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(crate) enum Refusal {
    /// It is a duplicate, or comes after a later one.
    #[error("replayed or out of order: {0}")]
    Late(&'static str),
    /// It looks late, but the robot itself may have restarted. Such messages are accepted once they have come
    /// for `stale_after_s`; until then they only extend the robot's grace period.
    #[error("replayed or out of order: {0}")]
    Ambiguous(&'static str),
    /// Messages of the robot come late and in order by turns: two programs count on their own.
    #[error(
        "two programs put as {robot}: give each robot an id of its own, or end one of the two ({reason})"
    )]
    TwoPrograms {
        /// The robot.
        robot: RobotId,
        /// How this message is out of order.
        reason: &'static str,
    },
    /// The robot has put more messages per second than this on the stream.
    #[error("rate: at most {0} messages per second")]
    Rate(f64),
    /// A pose is in a frame that the settings do not name.
    #[error("frame: {frame:?} is not known; there are {known}")]
    Frame {
        /// The frame of the pose.
        frame: String,
        /// The frames of the settings.
        known: String,
    },
    /// A link is out of range for the unit of the settings.
    #[error(transparent)]
    Link(#[from] ObservationError),
    /// The settings do not declare the modality.
    #[error("modality {0} is not declared in the settings of ingest")]
    Modality(Modality),
    /// The graph of the stream would have too many edges.
    #[error(
        "{field}: all robots together would report more than {MAX_GRAPH_EDGES}, which fit no message; let \
         each report only its strongest"
    )]
    Edges {
        /// The field of the report that lists them.
        field: &'static str,
    },
    /// As many robots have joined as the settings allow.
    #[error("the fleet is full: max_robots is {0}")]
    FleetFull(u32),
    /// Every node number of the term is given.
    #[error("no node number is left in this term; restart ingest to begin another")]
    NoNodeLeft,
}

/// Ready for the graphs: ordered by name.
fn in_order<T>(mut edges: Vec<(RobotId, T)>) -> Vec<(RobotId, T)> {
    edges.sort_unstable_by(|left, right| left.0.cmp(&right.0));
    edges
}

/// Checks a report against the settings.
///
/// # Errors
/// Names the field that does not fit them, and what would.
pub(crate) fn observed(settings: &IngestSettings, report: Report) -> Result<Observed, Refusal> {
    let (stream, provenance) = (report.stream(), report.provenance());
    let content = match report {
        Report::Pose(pose) => self::pose(settings, pose)?,
        Report::Links(links) => self::links(settings, links)?,
        Report::Rank(rank) => self::rank(rank),
        Report::Relation(modality, relation) => self::relation(settings, &modality, relation)?,
    };
    Ok(Observed { stream, provenance, content })
}

/// The content of a pose.
pub(crate) fn pose(settings: &IngestSettings, pose: Pose) -> Result<Content, Refusal> {
    let frame = match pose.frame {
        None => settings.frames.first().cloned().unwrap_or_default(),
        Some(frame) if settings.frames.contains(&frame) => frame,
        Some(frame) => {
            let known = settings.frames.join(", ");
            return Err(Refusal::Frame { frame, known });
        }
    };
    let position = [pose.x, pose.y, pose.z.unwrap_or(0.0)];
    Ok(Content::Pose { position, heading: pose.heading, frame })
}

fn links(settings: &IngestSettings, links: Links) -> Result<Content, Refusal> {
    let mut edges = Vec::new();
    for Link { peer, quality } in links.links {
        let weight = link_weight(&settings.connectivity, quality);
        match (settings.connectivity.unit, weight?) {
            (LinkUnit::RssiDbm, _) => edges.push((peer, Strength::Signal(quality))),
            (LinkUnit::Quality | LinkUnit::DeliveryRatio, 0.0) => {}
            (LinkUnit::Quality | LinkUnit::DeliveryRatio, weight) => {
                edges.push((peer, Strength::Weight(weight)));
            }
        }
    }
    Ok(Content::Edges(in_order(edges)))
}

/// The content of a rank.
pub(crate) fn rank(rank: Rank) -> Content {
    let weight = rank.weight.unwrap_or(DEFAULT_TIE);
    let mut skills = rank.skills.unwrap_or_default();
    skills.sort_unstable();
    Content::Rank(Tie { superior: rank.superior, weight, role: rank.role, skills })
}

fn relation(
    settings: &IngestSettings,
    modality: &Modality,
    relation: Relation,
) -> Result<Content, Refusal> {
    if !settings.modalities.contains(modality) {
        return Err(Refusal::Modality(modality.clone()));
    }
    let edges = relation.edges.into_iter().filter(|(_, _, weight)| *weight > 0.0);
    let edges = edges.map(|(_, to, weight)| (to, Strength::Weight(weight)));
    Ok(Content::Edges(in_order(edges.collect())))
}

/// Whether a robot's clock was not set when it wrote this.
pub(crate) fn has_absurd_stamp(now: Tick, provenance: &Provenance) -> bool {
    let limit = ABSURD_STAMP.as_secs_f64();
    provenance.stamp.is_some_and(|stamp| (stamp - now.as_seconds()).abs() > limit)
}

/// Judges order and rate of one stream of one robot.
///
/// A refused message takes nothing of the allowance, so that a flood of what is refused anyway does
/// not shut out the robot's good messages. Nothing that anybody can put shuts a robot out for good,
/// but for a forged sequence within its own boot.
#[derive(Debug)]
pub(crate) struct Gate {
    allowance: f64,
    passed: Tick,
    run: Run,
    left: VecDeque<Run>,
    late_since: Option<Tick>,
    may_restart: bool,
    turns: Turns,
}

/// How often late messages and accepted ones have followed each other. One late message may have been
/// delayed, and some in a row are those of a robot that restarted; two programs that put as one robot take turns.
#[derive(Debug, Default)]
struct Turns {
    count: u32,
    /// Whether the last message was late.
    is_late: bool,
    /// When the last turn was.
    last: Option<Tick>,
}

impl Turns {
    fn passed(&mut self) {
        self.is_late = false;
    }

    fn late(&mut self, now: Tick) {
        if std::mem::replace(&mut self.is_late, true) {
            return;
        }
        let goes_on = self.last.is_some_and(|last| now.since(last) < TURNS_WITHIN);
        self.count = if goes_on { self.count.saturating_add(1) } else { 1 };
        self.last = Some(now);
    }
}

/// How far one run of a robot's software has come.
#[derive(Debug, Default)]
struct Run {
    boot: Option<String>,
    seq: Option<u64>,
    stamp: Option<f64>,
}

/// How a message is out of order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Late {
    /// By what the robot states: never accepted.
    Proven(&'static str),
    /// By a sequence without a boot, or by stamps: a robot that restarted, or whose clock was set
    /// back, looks the same.
    Unproven(&'static str),
    /// It goes on with a run that was followed by another. Whether that other one was the robot's
    /// shows in whether it goes on.
    Followed,
}

impl Run {
    /// Whether a message of the run comes after a later one.
    fn late(&self, boot: Option<&String>, seq: Option<u64>, stamp: Option<f64>) -> Option<Late> {
        match (seq, self.seq, stamp, self.stamp) {
            (Some(seq), Some(last), ..) if seq <= last => {
                let reason = if seq == last { "seq was seen before" } else { "seq goes back" };
                Some(if boot.is_some() { Late::Proven(reason) } else { Late::Unproven(reason) })
            }
            (Some(_), Some(_), ..) => None,
            (_, _, Some(stamp), Some(last)) => {
                (stamp < last).then_some(Late::Unproven("stamp goes back"))
            }
            _ => None,
        }
    }
}

impl Gate {
    /// A gate that no message has passed yet.
    pub(crate) fn new(now: Tick, settings: &IngestSettings) -> Self {
        Self {
            allowance: capacity(settings),
            passed: now,
            run: Run::default(),
            left: VecDeque::new(),
            late_since: None,
            may_restart: false,
            turns: Turns::default(),
        }
    }

    /// Whether the last messages show that two programs put as the robot.
    pub(crate) fn is_contested(&self) -> bool {
        self.turns.count >= TURNS_OF_TWO_PROGRAMS
    }

    /// The robot has restarted: the next message need not follow the last one.
    pub(crate) fn allow_restart(&mut self) {
        self.may_restart = true;
    }

    /// Lets a message pass or refuses it.
    pub(crate) fn pass(
        &mut self,
        now: Tick,
        provenance: &Provenance,
        settings: &IngestSettings,
    ) -> Result<(), Refusal> {
        let Provenance { boot, seq, stamp } = provenance;
        let stamp = stamp.filter(|_| !has_absurd_stamp(now, provenance));
        let returns = boot
            .as_ref()
            .and_then(|boot| self.left.iter().position(|run| run.boot.as_ref() == Some(boot)));
        let boots = boot.is_some() && *boot != self.run.boot;
        // A message without a boot id belongs to the boot that was named last.
        let late = match returns.and_then(|at| self.left.get(at)) {
            Some(run) => run.late(boot.as_ref(), *seq, stamp).or(Some(Late::Followed)),
            None if boots => None,
            None => self.run.late(boot.as_ref(), *seq, stamp),
        };
        if let Err(refusal) = self.check_order(now, late, seconds(settings.stale_after_s)) {
            self.turns.late(now);
            return Err(refusal);
        }
        let refill = now.since(self.passed).as_secs_f64() * settings.max_rate_hz;
        let allowance = (self.allowance + refill).min(capacity(settings));
        if allowance < 1.0 {
            return Err(Refusal::Rate(settings.max_rate_hz));
        }
        self.allowance = allowance - 1.0;
        self.passed = now;
        self.late_since = None;
        self.may_restart = false;
        self.turns.passed();
        if boots {
            let run = returns.and_then(|at| self.left.remove(at)).unwrap_or_default();
            let left = std::mem::replace(&mut self.run, run);
            if left.boot.is_some() {
                self.left.push_back(left);
            }
            if self.left.len() > REMEMBERED_BOOTS {
                self.left.pop_front();
            }
            self.run.boot.clone_from(boot);
        }
        if matches!(late, Some(Late::Unproven(_))) {
            self.run.seq = None;
            self.run.stamp = None;
        }
        self.run.seq = seq.or(self.run.seq);
        self.run.stamp = stamp.or(self.run.stamp);
        Ok(())
    }

    /// Refuses a late message, unless such messages have come for so long that they are the robot's own.
    fn check_order(
        &mut self,
        now: Tick,
        late: Option<Late>,
        grace: Duration,
    ) -> Result<(), Refusal> {
        let (reason, may_restart) = match late {
            None => return Ok(()),
            Some(Late::Proven(reason)) => {
                return Err(Refusal::Late(reason));
            }
            Some(Late::Unproven(reason)) => {
                let since = *self.late_since.get_or_insert(now);
                (reason, self.may_restart || now.since(since) >= grace)
            }
            Some(Late::Followed) => {
                let reason = "this boot was followed by another one";
                (reason, now.since(self.passed) >= grace)
            }
        };
        if may_restart { Ok(()) } else { Err(Refusal::Ambiguous(reason)) }
    }
}

fn capacity(settings: &IngestSettings) -> f64 {
    (settings.max_rate_hz * BURST_S).max(1.0)
}
