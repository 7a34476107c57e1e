//! What is let in: content by the settings of the fleet, order and rate by stream.

use std::collections::VecDeque;
use std::time::Duration;

use muster_model::id::{Modality, RobotId};
use muster_model::observation::{Links, Observation, Pose, Provenance, Rank, Relation};
use muster_model::settings::IngestSettings;
use muster_model::time::{Tick, seconds};
use muster_relation::hierarchy::DEFAULT_TIE;
use muster_relation::link_weight;
use muster_wire::Key;

/// How many runs of a robot's software are remembered as over, per stream. A late message comes from
/// the run before, or from a few before that if the robot restarts in a loop; more would let a robot
/// that names its runs at random fill the memory.
const REMEMBERED_BOOTS: usize = 8;

/// How many seconds' worth of messages may come at once: a link that stalled delivers in a burst.
const BURST_S: f64 = 1.0;

/// A robot's clock that is further off than this is not set at all. That is counted, not refused:
/// age is judged by the receiver's clock.
const ABSURD_STAMP: Duration = Duration::from_secs(86_400);

/// One stream of one robot; each is the source of one graph.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Stream {
    /// Poses, for the spatial graph.
    Pose,
    /// Link reports, for connectivity.
    Links,
    /// Rank reports, for the hierarchy.
    Rank,
    /// Edges of a declared modality.
    Relation(Modality),
}

impl Stream {
    /// The key of the stream on the bus.
    pub(crate) fn key(&self, robot: &RobotId) -> Key {
        match self {
            Self::Pose => Key::Pose(robot.clone()),
            Self::Links => Key::Links(robot.clone()),
            Self::Rank => Key::Rank(robot.clone()),
            Self::Relation(modality) => Key::Relation(robot.clone(), modality.clone()),
        }
    }

    /// The graph that is made of the stream.
    pub(crate) fn modality(&self) -> Modality {
        match self {
            Self::Pose => Modality::spatial(),
            Self::Links => Modality::connectivity(),
            Self::Rank => Modality::hierarchy(),
            Self::Relation(modality) => modality.clone(),
        }
    }

    /// The counter of the messages that were let in.
    pub(crate) const fn accepted(&self) -> &'static str {
        match self {
            Self::Pose => "poses_accepted",
            Self::Links => "links_accepted",
            Self::Rank => "ranks_accepted",
            Self::Relation(_) => "relations_accepted",
        }
    }
}

/// An observation with its content checked and made ready for the graphs.
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
    /// Who is heard and how well, from 0 to 1, ordered by name and without zeros.
    Links(Vec<(RobotId, f64)>),
    /// Whom the robot answers to.
    Rank(Tie),
    /// Where edges of a declared modality lead to, ordered by name and without zeros.
    Relation(Modality, Vec<(RobotId, f64)>),
}

/// Whom a robot answers to, and what it is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tie {
    /// The superior; none at the top.
    pub(crate) superior: Option<RobotId>,
    /// How strongly it is tied to the superior.
    pub(crate) weight: f64,
    /// What it is within its unit.
    pub(crate) role: Option<String>,
}

impl Default for Tie {
    fn default() -> Self {
        Self { superior: None, weight: DEFAULT_TIE, role: None }
    }
}

/// What a robot said, checked by itself: order and rate are still to be judged.
#[derive(Debug)]
pub(crate) struct Observed {
    /// Where it belongs.
    pub(crate) stream: Stream,
    /// What it says of its order.
    pub(crate) provenance: Provenance,
    /// What it says.
    pub(crate) content: Content,
}

/// Why a message is refused.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// It is a repetition, or comes after a later one.
    Late(String),
    /// Anything else.
    Wrong(String),
}

impl From<String> for Refusal {
    fn from(reason: String) -> Self {
        Self::Wrong(reason)
    }
}

/// Ready for the graphs: ordered by name, and without what is worth nothing.
fn in_order(mut edges: Vec<(RobotId, f64)>) -> Vec<(RobotId, f64)> {
    edges.retain(|(_, weight)| *weight > 0.0);
    edges.sort_unstable_by(|left, right| left.0.cmp(&right.0));
    edges
}

fn observed<T: Observation>(
    stream: Stream,
    body: T,
    content: impl FnOnce(T) -> Result<Content, String>,
) -> Result<Observed, String> {
    // Packets off the bus were checked as they were decoded; the graphs must also hold in a
    // simulation that makes messages without bytes.
    body.check().map_err(|error| error.to_string())?;
    Ok(Observed { stream, provenance: body.provenance(), content: content(body)? })
}

/// Checks a pose.
pub(crate) fn pose(settings: &IngestSettings, pose: Pose) -> Result<Observed, String> {
    observed(Stream::Pose, pose, |pose| {
        let frame = match pose.frame {
            None => settings.frames.first().cloned().unwrap_or_default(),
            Some(frame) if settings.frames.contains(&frame) => frame,
            Some(frame) => {
                let known = settings.frames.join(", ");
                return Err(format!("frame: {frame:?} is not known; there are {known}"));
            }
        };
        let position = [pose.x, pose.y, pose.z.unwrap_or(0.0)];
        Ok(Content::Pose { position, heading: pose.heading, frame })
    })
}

/// Checks a link report and turns what it says into weights.
pub(crate) fn links(
    settings: &IngestSettings,
    robot: &RobotId,
    links: Links,
) -> Result<Observed, String> {
    observed(Stream::Links, links, |links| {
        if links.links.iter().any(|link| link.peer == *robot) {
            return Err("links.peer: a robot does not report that it hears itself".to_owned());
        }
        let weights = links.links.into_iter().map(|link| {
            let weight = link_weight(&settings.connectivity, link.quality)?;
            Ok((link.peer, weight))
        });
        let weights =
            weights.collect::<Result<Vec<_>, muster_model::observation::ObservationError>>();
        Ok(Content::Links(in_order(weights.map_err(|error| error.to_string())?)))
    })
}

/// Checks a rank report.
pub(crate) fn rank(robot: &RobotId, rank: Rank) -> Result<Observed, String> {
    observed(Stream::Rank, rank, |rank| {
        if rank.superior.as_ref() == Some(robot) {
            return Err("superior: a robot does not answer to itself; null is the top".to_owned());
        }
        let weight = rank.weight.unwrap_or(DEFAULT_TIE);
        Ok(Content::Rank(Tie { superior: rank.superior, weight, role: rank.role }))
    })
}

/// Checks the edges of a declared modality.
pub(crate) fn relation(
    settings: &IngestSettings,
    robot: &RobotId,
    modality: &Modality,
    relation: Relation,
) -> Result<Observed, String> {
    if !settings.modalities.contains(modality) {
        return Err(format!("modality {modality} is not declared in the settings of ingest"));
    }
    observed(Stream::Relation(modality.clone()), relation, |relation| {
        if let Some((from, ..)) = relation.edges.iter().find(|(from, ..)| from != robot) {
            return Err(format!("edges: the key speaks for {robot}, an edge for {from}"));
        }
        if relation.edges.iter().any(|(from, to, _)| from == to) {
            return Err("edges: a robot has no edge to itself".to_owned());
        }
        let edges = relation.edges.into_iter().map(|(_, to, weight)| (to, weight)).collect();
        Ok(Content::Relation(modality.clone(), in_order(edges)))
    })
}

/// Whether a robot's clock was not set when it wrote this.
pub(crate) fn has_absurd_stamp(now: Tick, provenance: &Provenance) -> bool {
    let limit = ABSURD_STAMP.as_secs_f64();
    provenance.stamp.is_some_and(|stamp| (stamp - now.as_seconds()).abs() > limit)
}

/// Judges order and rate of one stream of one robot.
///
/// A refused message takes nothing of the allowance, so that a flood of what is refused anyway does
/// not shut out the robot's good messages.
#[derive(Debug)]
pub(crate) struct Gate {
    allowance: f64,
    refilled: Tick,
    boot: Option<String>,
    left: VecDeque<String>,
    seq: Option<u64>,
    stamp: Option<f64>,
    late_since: Option<Tick>,
}

/// How a message is out of order.
struct Late {
    reason: &'static str,
    /// Whether what the robot says of itself proves it.
    proven: bool,
}

impl Gate {
    /// A gate that no message has passed yet.
    pub(crate) fn new(now: Tick, settings: &IngestSettings) -> Self {
        Self {
            allowance: capacity(settings),
            refilled: now,
            boot: None,
            left: VecDeque::new(),
            seq: None,
            stamp: None,
            late_since: None,
        }
    }

    /// Lets a message pass or refuses it.
    pub(crate) fn pass(
        &mut self,
        now: Tick,
        provenance: &Provenance,
        settings: &IngestSettings,
    ) -> Result<(), Refusal> {
        let late = self.late(provenance);
        if let Some(Late { reason, proven }) = &late {
            // Without boot id and sequence, a robot whose clock was set back or that restarted looks
            // like an old message. It must not be shut out for good.
            let since = *self.late_since.get_or_insert(now);
            if *proven || now.since(since) < seconds(settings.gone_after_s) {
                return Err(Refusal::Late(format!("replayed or out of order: {reason}")));
            }
        }
        let refill = now.since(self.refilled).as_secs_f64() * settings.max_rate_hz;
        let allowance = (self.allowance + refill).min(capacity(settings));
        if allowance < 1.0 {
            let rate = settings.max_rate_hz;
            return Err(Refusal::Wrong(format!("rate: at most {rate} messages per second")));
        }
        self.allowance = allowance - 1.0;
        self.refilled = now;
        self.late_since = None;
        let rebooted = provenance.boot.is_some() && provenance.boot != self.boot;
        if rebooted || late.is_some() {
            self.seq = None;
            self.stamp = None;
        }
        if rebooted {
            if self.left.len() >= REMEMBERED_BOOTS {
                self.left.pop_front();
            }
            self.left.extend(self.boot.take());
            self.boot.clone_from(&provenance.boot);
        }
        self.seq = provenance.seq.or(self.seq);
        self.stamp = provenance.stamp.or(self.stamp);
        Ok(())
    }

    /// Whether a message comes after a later one. One without a boot id belongs to the boot that was
    /// named last.
    fn late(&self, provenance: &Provenance) -> Option<Late> {
        if let Some(boot) = &provenance.boot
            && self.boot.as_ref() != Some(boot)
        {
            let reason = "this boot was followed by another one";
            return self.left.contains(boot).then_some(Late { reason, proven: true });
        }
        match (provenance.seq, self.seq, provenance.stamp, self.stamp) {
            (Some(seq), Some(last), ..) => {
                let reason = if seq == last { "seq was seen before" } else { "seq goes back" };
                (seq <= last).then_some(Late { reason, proven: provenance.boot.is_some() })
            }
            (_, _, Some(stamp), Some(last)) => {
                (stamp < last).then_some(Late { reason: "stamp goes back", proven: false })
            }
            _ => None,
        }
    }
}

fn capacity(settings: &IngestSettings) -> f64 {
    (settings.max_rate_hz * BURST_S).max(1.0)
}
