//! One robot: the last observation of each of its streams, and its presence.
//!
//! A robot is *stale* when its last pose is older than `stale_after_s`, or, without a pose, when its
//! last sign of life is; a liveliness token keeps a robot without a pose from becoming stale. (A lost token
//! needs no rule of its own for a robot with a pose: its last pose is older than the loss.) It is
//! *gone* when its last sign of life is older than `gone_after_s`, whatever its token says, because a
//! process that hangs keeps its token; only a robot that has a token and no pose may stay silent.
//!
//! Where silence proves nothing (nothing could be received, or an ambiguous report was refused) the grace
//! period starts again. That makes no stale robot active, and changes no age.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::graph::Node;
use muster_model::id::{Modality, RobotId};
use muster_model::observation::Stream;
use muster_model::roster::{Presence, RosterEntry};
use muster_model::settings::IngestSettings;
use muster_model::time::{Tick, seconds};

use crate::admission::{Content, Gate, Strength, Tie};

/// Where a robot is.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    /// Metres east, north, up.
    pub(crate) position: [f64; 3],
    /// Radians.
    pub(crate) heading: Option<f64>,
    /// The frame, named.
    pub(crate) frame: String,
    /// When the pose was received.
    pub(crate) received: Tick,
}

/// The state of a robot's liveliness token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Token {
    /// None was received.
    Unknown,
    /// It is there.
    Alive,
    /// It was there, and was lost at this moment.
    Lost(Tick),
}

/// One robot.
#[derive(Debug)]
pub(crate) struct Robot {
    /// Its number in the graphs.
    pub(crate) node: Node,
    /// Its presence as last published.
    pub(crate) presence: Presence,
    /// When anything was last received from it.
    pub(crate) last_seen: Tick,
    /// The grace period before it is stale starts no earlier, while it is active.
    stale_grace_start: Tick,
    /// The grace period before it is gone starts no earlier.
    gone_grace_start: Tick,
    token: Token,
    /// Where it is, if it ever reported that.
    pub(crate) pose: Option<Placed>,
    /// Its superior.
    pub(crate) tie: Tie,
    edges: BTreeMap<Stream, Vec<(RobotId, Strength)>>,
    /// The order and rate of each stream on which a report was accepted in this run.
    pub(crate) gates: BTreeMap<Stream, Gate>,
}

/// How long a robot may be silent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GracePeriods {
    stale_after: Duration,
    gone_after: Duration,
}

impl From<&IngestSettings> for GracePeriods {
    fn from(settings: &IngestSettings) -> Self {
        Self {
            stale_after: seconds(settings.stale_after_s),
            gone_after: seconds(settings.gone_after_s),
        }
    }
}

/// What changed by an observation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Change {
    /// The robot was not known before.
    pub(crate) joined: bool,
    /// The roster entry of the robot is new, not counting when it was last seen.
    pub(crate) roster: bool,
    /// The input of the graph of the stream is new.
    pub(crate) graph: bool,
}

/// How the presence of a robot changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Transition {
    /// It has been silent for too long.
    Stale,
    /// Its reports arrive again.
    Recovered,
    /// It is not part of the fleet any more.
    Left,
}

impl Robot {
    /// A robot that has just joined.
    pub(crate) fn new(node: Node, now: Tick, token: Token) -> Self {
        Self {
            node,
            presence: Presence::Active,
            last_seen: now,
            stale_grace_start: now,
            gone_grace_start: now,
            token,
            pose: None,
            tie: Tie::default(),
            edges: BTreeMap::new(),
            gates: BTreeMap::new(),
        }
    }

    /// A message of it was accepted.
    pub(crate) fn mark_seen(&mut self, now: Tick) {
        self.last_seen = now;
    }

    /// An ambiguous message was refused on a stream: it may have been the robot's own.
    pub(crate) fn extend_grace_for(&mut self, now: Tick, stream: &Stream) {
        self.gone_grace_start = now;
        if self.pose.is_none() || *stream == Stream::Pose {
            self.stale_grace_start = now;
        }
    }

    /// Nothing could be received from it until now.
    pub(crate) fn extend_grace(&mut self, now: Tick) {
        self.stale_grace_start = now;
        self.gone_grace_start = now;
    }

    /// Its silence proved nothing: it is active again. Whether it was stale.
    pub(crate) fn take_stale_back(&mut self) -> bool {
        let was_stale = self.presence == Presence::Stale;
        self.presence = Presence::Active;
        was_stale
    }

    /// Restores what the last roster of the term before says of it. A token that is there after a restart
    /// was there before and is no sign of life.
    ///
    /// A robot that was active gets the whole grace period again, because nothing could be received from
    /// it. A robot that was stale does not: it must leave even if restarts follow each other.
    pub(crate) fn restore(&mut self, now: Tick, last_seen: Tick, presence: Presence) {
        if !self.has_reported() {
            self.last_seen = last_seen;
        }
        self.presence = presence;
        if presence == Presence::Active {
            self.extend_grace(now);
        } else {
            self.stale_grace_start = Tick::default();
            self.gone_grace_start = Tick::default();
        }
    }

    /// Its token is there. A token that was known is no sign of life. A token that comes back is that of a
    /// restarted process, whose reports have an order of their own.
    pub(crate) fn token_appeared(&mut self, now: Tick) {
        match self.token {
            Token::Alive => return,
            Token::Lost(_) => {
                self.mark_seen(now);
                for gate in self.gates.values_mut() {
                    gate.allow_restart();
                }
            }
            Token::Unknown if self.has_reported() => self.mark_seen(now),
            // The robot joins by its token, or was restored and had its token all the time.
            Token::Unknown => {}
        }
        self.token = Token::Alive;
    }

    /// Its token was lost.
    pub(crate) fn token_lost(&mut self, now: Tick) {
        if self.token == Token::Alive {
            self.token = Token::Lost(now);
        }
    }

    /// Whether its token is there.
    pub(crate) fn has_token(&self) -> bool {
        self.token == Token::Alive
    }

    fn last_sign(&self) -> Tick {
        match self.token {
            Token::Lost(at) => self.last_seen.max(at),
            Token::Unknown | Token::Alive => self.last_seen,
        }
    }

    fn stale_at(&self, grace: GracePeriods) -> Option<Tick> {
        let sign = match (&self.pose, self.token) {
            (Some(pose), _) => pose.received,
            (None, Token::Alive) => return None,
            (None, _) => self.last_sign(),
        };
        let start = match self.presence {
            Presence::Active => sign.max(self.stale_grace_start),
            Presence::Stale => sign,
        };
        Some(start.after(grace.stale_after))
    }

    fn gone_at(&self, grace: GracePeriods) -> Option<Tick> {
        let may_be_silent = self.pose.is_none() && self.token == Token::Alive;
        let sign = self.last_sign().max(self.gone_grace_start);
        (!may_be_silent).then(|| sign.after(grace.gone_after))
    }

    /// When its presence changes next if nothing more is received from it.
    pub(crate) fn presence_deadline(&self, grace: GracePeriods) -> Option<Tick> {
        let stale = self.stale_at(grace).filter(|_| self.presence == Presence::Active);
        stale.into_iter().chain(self.gone_at(grace)).min()
    }

    /// Brings the presence up to date.
    pub(crate) fn update_presence(&mut self, now: Tick, grace: GracePeriods) -> Option<Transition> {
        if self.gone_at(grace).is_some_and(|at| at <= now) {
            return Some(Transition::Left);
        }
        let stale = self.stale_at(grace).is_some_and(|at| at <= now);
        let (presence, transition) = match self.presence {
            Presence::Active if stale => (Presence::Stale, Transition::Stale),
            Presence::Stale if !stale => (Presence::Active, Transition::Recovered),
            Presence::Active | Presence::Stale => return None,
        };
        self.presence = presence;
        Some(transition)
    }

    /// Whether a report of it was accepted in this run.
    pub(crate) fn has_reported(&self) -> bool {
        !self.gates.is_empty()
    }

    /// Whether a report on a stream was accepted in this run.
    pub(crate) fn has_reported_on(&self, stream: &Stream) -> bool {
        self.gates.contains_key(stream)
    }

    /// Replaces the last report of a stream.
    pub(crate) fn apply(&mut self, received: Tick, stream: Stream, content: Content) -> Change {
        let mut change = Change::default();
        match content {
            Content::Pose { position, heading, frame } => {
                let old = self.pose.as_ref();
                change.graph = old.is_none_or(|old| old.position != position || old.frame != frame);
                change.roster = change.graph || old.is_none_or(|old| old.heading != heading);
                self.pose = Some(Placed { position, heading, frame, received });
            }
            Content::Rank(tie) => {
                let same_superior = self.tie.superior == tie.superior;
                let weighs = tie.superior.is_some() && self.tie.weight != tie.weight;
                change.graph = !same_superior || weighs;
                change.roster =
                    !same_superior || self.tie.role != tie.role || self.tie.skills != tie.skills;
                self.tie = tie;
            }
            Content::Edges(edges) => {
                change.graph = self.edges(&stream) != edges;
                self.edges.insert(stream, edges);
            }
        }
        change
    }

    /// The other ends of the edges that it has reported on a stream, ordered by name.
    pub(crate) fn edges(&self, stream: &Stream) -> &[(RobotId, Strength)] {
        self.edges.get(stream).map_or(&[], Vec::as_slice)
    }

    /// Its roster entry.
    pub(crate) fn entry(&self, name: &RobotId) -> RosterEntry {
        let pose = self.pose.as_ref();
        RosterEntry {
            node: self.node,
            robot: name.clone(),
            presence: self.presence,
            position: pose.map(|pose| pose.position),
            heading: pose.and_then(|pose| pose.heading),
            frame: pose.map(|pose| pose.frame.clone()),
            superior: self.tie.superior.clone(),
            role: self.tie.role.clone(),
            skills: self.tie.skills.clone(),
            last_seen: self.last_seen,
        }
    }

    /// Drops its reports of modalities that are no longer declared.
    pub(crate) fn keep_modalities(&mut self, declared: &[Modality]) {
        let is_declared = |stream: &Stream| match stream {
            Stream::Relation(modality) => declared.contains(modality),
            built_in => Stream::BUILT_IN.contains(built_in),
        };
        self.edges.retain(|stream, _| is_declared(stream));
        self.gates.retain(|stream, _| is_declared(stream));
    }
}
