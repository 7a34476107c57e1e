//! One robot: the last observation of each of its streams, and how sure it is that it is there.
//!
//! A robot is *stale* when its last pose is older than `stale_after_s`, or, without a pose, when its
//! last sign is; a liveliness token keeps a robot without a pose from growing stale. (A lost token
//! needs no rule of its own for a robot with a pose: its last pose is older than the loss.) It is
//! *gone* when its last sign is older than `gone_after_s`, whatever its token says, because a process
//! that hangs keeps its token; only a robot that has a token and no pose may stay silent.
//!
//! Where silence says nothing (nobody could be heard, or what was heard is in doubt) a robot is
//! *spared*: its grace begins anew. That makes no stale robot active, and changes no age.

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
    /// When it was received.
    pub(crate) received: Tick,
}

/// What the bus says of a robot's liveliness token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Token {
    /// Nothing.
    Unseen,
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
    /// What was last told of its presence.
    pub(crate) presence: Presence,
    /// When anything was last received from it.
    pub(crate) heard: Tick,
    /// Until it is stale, its grace before that does not begin earlier.
    spared_stale: Tick,
    /// Its grace before it is gone does not begin earlier.
    spared_gone: Tick,
    token: Token,
    /// Where it is, if it ever said so.
    pub(crate) pose: Option<Placed>,
    /// Whom it answers to.
    pub(crate) tie: Tie,
    edges: BTreeMap<Stream, Vec<(RobotId, Strength)>>,
    /// What passed on each stream that was heard in this run.
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
    /// What the roster says of the robot is new, beside when it was last heard.
    pub(crate) roster: bool,
    /// What the graph of the stream is made of is new.
    pub(crate) graph: bool,
}

/// How the presence of a robot changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Transition {
    /// It has been silent for too long.
    Stale,
    /// It is heard again.
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
            heard: now,
            spared_stale: now,
            spared_gone: now,
            token,
            pose: None,
            tie: Tie::default(),
            edges: BTreeMap::new(),
            gates: BTreeMap::new(),
        }
    }

    /// A message of it was let in.
    pub(crate) fn hear(&mut self, now: Tick) {
        self.heard = now;
    }

    /// A message of it was refused that may have been its own.
    pub(crate) fn doubt(&mut self, now: Tick, stream: &Stream) {
        self.spared_gone = now;
        if self.pose.is_none() || *stream == Stream::Pose {
            self.spared_stale = now;
        }
    }

    /// Nothing could be heard of it until now.
    pub(crate) fn extend_grace(&mut self, now: Tick) {
        self.spared_stale = now;
        self.spared_gone = now;
    }

    /// Takes over what was last told of it in the term before. A token that is there after a restart
    /// was there before and is no sign of life.
    ///
    /// Whoever was active could not be heard until now. Whoever was stale was given up on before, and
    /// must leave even if the restarts do not end.
    pub(crate) fn restore(&mut self, now: Tick, last_seen: Tick, presence: Presence) {
        if !self.has_said_anything() {
            self.heard = last_seen;
        }
        self.presence = presence;
        if presence == Presence::Active {
            self.extend_grace(now);
        } else {
            self.spared_stale = Tick::default();
            self.spared_gone = Tick::default();
        }
    }

    /// Its token is there. If that was known, it says nothing new. One that comes back is that of a
    /// process that began anew, with an order of its own.
    pub(crate) fn show_token(&mut self, now: Tick) {
        match self.token {
            Token::Alive => return,
            Token::Lost(_) => {
                self.hear(now);
                for gate in self.gates.values_mut() {
                    gate.excuse();
                }
            }
            Token::Unseen if self.has_said_anything() => self.hear(now),
            // It joins by its token, or was restored and had its token all the time.
            Token::Unseen => {}
        }
        self.token = Token::Alive;
    }

    /// Its token was lost.
    pub(crate) fn lose_token(&mut self, now: Tick) {
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
            Token::Lost(at) => self.heard.max(at),
            Token::Unseen | Token::Alive => self.heard,
        }
    }

    fn stale_at(&self, grace: GracePeriods) -> Option<Tick> {
        let sign = match (&self.pose, self.token) {
            (Some(pose), _) => pose.received,
            (None, Token::Alive) => return None,
            (None, _) => self.last_sign(),
        };
        let spared = match self.presence {
            Presence::Active => sign.max(self.spared_stale),
            Presence::Stale => sign,
        };
        Some(spared.after(grace.stale_after))
    }

    fn gone_at(&self, grace: GracePeriods) -> Option<Tick> {
        let may_be_silent = self.pose.is_none() && self.token == Token::Alive;
        let sign = self.last_sign().max(self.spared_gone);
        (!may_be_silent).then(|| sign.after(grace.gone_after))
    }

    /// When its presence changes next if nothing more is heard of it.
    pub(crate) fn next_judgement(&self, grace: GracePeriods) -> Option<Tick> {
        let stale = self.stale_at(grace).filter(|_| self.presence == Presence::Active);
        stale.into_iter().chain(self.gone_at(grace)).min()
    }

    /// Brings the presence up to date.
    pub(crate) fn judge(&mut self, now: Tick, grace: GracePeriods) -> Option<Transition> {
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

    /// Whether any stream was heard in this run.
    pub(crate) fn has_said_anything(&self) -> bool {
        !self.gates.is_empty()
    }

    /// Whether a stream was heard in this run.
    pub(crate) fn has_spoken(&self, stream: &Stream) -> bool {
        self.gates.contains_key(stream)
    }

    /// Puts a report in place of the one before.
    pub(crate) fn take(&mut self, received: Tick, stream: Stream, content: Content) -> Change {
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
                change.roster = !same_superior || self.tie.role != tie.role;
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

    /// What the roster says of it.
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
            last_seen: self.heard,
        }
    }

    /// Forgets what it said of modalities that are not declared any more.
    pub(crate) fn keep_modalities(&mut self, declared: &[Modality]) {
        let is_declared = |stream: &Stream| match stream {
            Stream::Relation(modality) => declared.contains(modality),
            built_in => Stream::BUILT_IN.contains(built_in),
        };
        self.edges.retain(|stream, _| is_declared(stream));
        self.gates.retain(|stream, _| is_declared(stream));
    }
}
