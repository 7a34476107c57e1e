//! Follows rosters and graphs into frames that belong together, and knows when to ask the bus.
//!
//! A roster comes after the graphs of its frame and lists the revision of each. Once every listed
//! graph is at exactly that revision, roster and graphs are one consistent [`Frame`]. What is missing
//! is fetched, one fetch at a time; deltas that arrive meanwhile wait for it (see [`WaitingDeltas`]).
//! Revisions go forward only, with one exception: a graph that stays ahead of the rosters is rolled back to
//! what they list (see [`Follower::roll_back`]).

mod waiting;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use muster_model::content::Checked;
use muster_model::graph::{GraphDelta, GraphError, GraphReplica};
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId};
use muster_model::limits::MAX_GRAPHS;
use muster_model::roster::Roster;
use muster_model::time::Tick;
use muster_wire::{Key, KeySpace, Message, Pattern, Request};

use waiting::WaitingDeltas;

use crate::MemoryUse;

/// Least time between the starts of two fetches.
const FETCH_INTERVAL: Duration = Duration::from_millis(500);

/// How long the answers of a fetch are waited for. After each fetch that brought no snapshot of a graph that it
/// asked for, the next one is given twice as long, until there is a frame: on a busy host the snapshot of a large
/// fleet takes its time, and whoever gives up on it asks for another one. A snapshot that came in time and did not
/// suffice is no reason to wait longer: a lost question would then be waited for as long.
const FETCH_TIMEOUT: Duration = Duration::from_secs(1);

/// How often that is doubled at most.
const MAX_DOUBLINGS: u32 = 3;

/// Grace period of a graph that is behind the roster without a known gap: its delta may wait in a queue
/// while the roster, on another key, has overtaken it.
const BEHIND_GRACE: Duration = Duration::from_millis(50);

/// Grace period of a graph that is ahead of the roster: the roster of its frame is on the way.
const AHEAD_GRACE: Duration = Duration::from_secs(1);

/// How often a roster is asked for while none is known: `ingest` may be gone, and the readers that answer
/// in its place publish nothing by themselves.
const ROSTER_FETCH_INTERVAL: Duration = Duration::from_secs(2);

/// One consistent state of the fleet.
#[derive(Debug)]
pub struct Frame {
    /// The robots of the fleet.
    pub roster: Checked<Roster>,
    /// When the last part arrived.
    pub received: Tick,
    /// The robots of the roster, ordered by name. The same allocation as in the frame before while
    /// no robot comes or goes.
    pub robots: Arc<[RobotId]>,
    /// The graphs that the roster lists, in its order and at its revisions.
    pub graphs: Vec<(Modality, Arc<GraphReplica>)>,
}

/// What became of a message that is not refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Acceptance {
    /// It was applied.
    Applied,
    /// It is what is known already.
    Known,
    /// It is older than what is known.
    Old,
    /// A delta starts from a revision that was never received; the graph is to be fetched.
    Gap,
    /// It is of one modality more than a fleet may have.
    Ignored,
}

/// One graph that is followed. The replica is shared with frames and copied when it changes.
#[derive(Debug, Default)]
struct Followed {
    graph: Arc<GraphReplica>,
    gap: bool,
    /// Deltas from beyond the gap.
    waiting: WaitingDeltas,
}

impl Followed {
    /// Applies the deltas that have waited for the revision that the graph has now. One that contradicts the
    /// graph is dropped: a fetch repairs what it leaves.
    fn catch_up(&mut self) {
        while let Some(delta) = self.waiting.next(self.graph.revision()) {
            if Arc::make_mut(&mut self.graph).apply(&delta).is_err() {
                break;
            }
        }
        self.gap &= !self.waiting.is_empty();
    }
}

/// How far the graphs are from the newest roster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Distance {
    None,
    Ahead,
    Behind,
    Gap,
}

/// Rosters and graphs as far as they are known.
#[derive(Debug, Default)]
pub struct Follower {
    graphs: BTreeMap<Modality, Followed>,
    roster: Option<Checked<Roster>>,
    frame: Option<Arc<Frame>>,
    /// Since when the graphs have not been those of the newest roster.
    apart_since: Option<Tick>,
    /// Whether a fetch is under way.
    is_fetching: bool,
    fetched: Tick,
    /// Graphs that the fetch has asked for and that it has brought no snapshot of.
    awaited: BTreeSet<Modality>,
    /// How many fetches have ended without all snapshots since the last frame.
    fetches_in_vain: u32,
    /// Whether everything is to be fetched, whatever is known.
    refresh: bool,
}

impl Follower {
    /// Whether a roster is known, complete or not.
    pub fn has_roster(&self) -> bool {
        self.roster.is_some()
    }

    /// What is held of rosters and graphs, with those of the newest frame.
    pub fn memory_use(&self) -> MemoryUse {
        let frame = self.frame.as_deref();
        let framed = frame.into_iter().flat_map(|frame| &frame.graphs).map(|(_, graph)| graph);
        let graphs = self.graphs.values().map(|followed| &followed.graph).chain(framed);
        let waiting = self.graphs.values().map(|followed| followed.waiting.edge_count());
        let rosters = self.roster.as_ref().into_iter().chain(frame.map(|frame| &frame.roster));
        let sizes: Vec<usize> = rosters.map(|roster| roster.robots.len()).collect();
        MemoryUse {
            robots: sizes.iter().sum(),
            edges: graphs.map(|graph| graph.edge_count()).chain(waiting).sum(),
            messages: sizes.len(),
            offenders: 0,
        }
    }

    /// The newest consistent state.
    pub fn frame(&self) -> Option<&Arc<Frame>> {
        self.frame.as_ref()
    }

    /// What a get is answered with: the newest roster, and the newest state of each graph that it
    /// lists. Either says by its own revision how new it is.
    pub fn answer(&self, space: &KeySpace, request: &Request) -> Vec<Message> {
        let Some(roster) = &self.roster else { return Vec::new() };
        let mut messages = Vec::new();
        if request.selects(space, &Key::Roster) {
            messages.push(Message::Roster(roster.clone()));
        }
        for (name, _) in &roster.graphs {
            let known = self.graphs.get(name).map(|followed| &followed.graph);
            let Some(graph) = known.filter(|graph| graph.revision() > Revision::default()) else {
                continue;
            };
            if request.selects(space, &Key::Graph(name.clone())) {
                let snapshot = graph.snapshot(roster.header.clone(), name.clone());
                messages.push(Message::Graph(Arc::new(snapshot)));
            }
        }
        messages
    }

    /// Accepts a delta or snapshot of a graph.
    ///
    /// # Errors
    /// Why the delta is refused; the graph stays as it was.
    pub fn accept_graph(&mut self, delta: &Arc<GraphDelta>) -> Result<Acceptance, GraphError> {
        if delta.base.is_none() {
            self.awaited.remove(&delta.modality);
        }
        let known = self.graphs.contains_key(&delta.modality);
        if !known && !self.has_room_for(&delta.modality) {
            return Ok(Acceptance::Ignored);
        }
        let followed = self.graphs.entry(delta.modality.clone()).or_default();
        match Arc::make_mut(&mut followed.graph).apply(delta) {
            Ok(()) => {
                followed.gap &= delta.base.is_some();
                followed.catch_up();
                Ok(Acceptance::Applied)
            }
            Err(GraphError::Old(at)) if delta.header.revision == at => Ok(Acceptance::Known),
            Err(GraphError::Old(_)) => Ok(Acceptance::Old),
            Err(GraphError::Gap { .. }) => {
                followed.gap = true;
                followed.waiting.add(delta);
                Ok(Acceptance::Gap)
            }
            Err(error @ GraphError::Inconsistent(_)) => {
                if !known {
                    self.graphs.remove(&delta.modality);
                }
                Err(error)
            }
        }
    }

    /// Replaces a graph by a fetched snapshot of an earlier revision; whether it was replaced.
    ///
    /// That needs a roster that lists exactly the snapshot's revision, and graphs that have differed from
    /// the rosters for longer than a roster is under way. Then no leader has published the later
    /// revision: it was forged, or published in a term that was lost.
    pub fn roll_back(&mut self, now: Tick, snapshot: &GraphDelta) -> bool {
        let at = (&snapshot.modality, snapshot.header.revision);
        let listed = |roster: &Checked<Roster>| {
            roster.graphs.iter().any(|(name, revision)| (name, *revision) == at)
        };
        if snapshot.base.is_some()
            || !self.roster.as_ref().is_some_and(listed)
            || self.apart_since.is_none_or(|since| since.after(AHEAD_GRACE) > now)
            || self.distance(at.0, at.1) != Distance::Ahead
        {
            return false;
        }
        let mut graph = GraphReplica::default();
        if graph.apply(snapshot).is_err() {
            return false;
        }
        let followed = Followed { graph: Arc::new(graph), ..Followed::default() };
        self.graphs.insert(snapshot.modality.clone(), followed);
        true
    }

    /// Whether one more graph may be followed. One that the roster lists displaces one that it does
    /// not list, so that no flood of invented modalities keeps the fleet's own out.
    fn has_room_for(&mut self, modality: &Modality) -> bool {
        if self.graphs.len() < MAX_GRAPHS {
            return true;
        }
        let listed = |name: &Modality| lists(self.roster.as_deref(), name);
        if !listed(modality) {
            return false;
        }
        let foreign = self.graphs.keys().find(|name| !listed(name)).cloned();
        foreign.is_some_and(|name| self.graphs.remove(&name).is_some())
    }

    /// Accepts a roster.
    pub fn accept_roster(&mut self, roster: Checked<Roster>) -> Acceptance {
        if let Some(have) = &self.roster {
            match roster.header.revision.cmp(&have.header.revision) {
                std::cmp::Ordering::Less => return Acceptance::Old,
                std::cmp::Ordering::Equal => return Acceptance::Known,
                std::cmp::Ordering::Greater => {}
            }
        }
        self.roster = Some(roster);
        Acceptance::Applied
    }

    /// Makes a frame if roster and graphs belong together now; whether there is a new one.
    pub fn make_frame(&mut self, now: Tick) -> bool {
        let Some(roster) = &self.roster else { return false };
        let is_at = |(name, revision): &(Modality, _)| {
            self.graphs.get(name).is_some_and(|followed| followed.graph.revision() == *revision)
        };
        if !roster.graphs.iter().all(is_at) {
            self.apart_since.get_or_insert(now);
            return false;
        }
        self.apart_since = None;
        let last = self.frame.as_ref();
        if last.is_some_and(|frame| frame.roster.header.revision == roster.header.revision) {
            return false;
        }
        self.graphs.retain(|name, _| lists(Some(roster), name));
        let names = roster.robots.iter().map(|entry| &entry.robot);
        let robots = match last {
            Some(frame) if frame.robots.iter().eq(names.clone()) => frame.robots.clone(),
            _ => names.cloned().collect(),
        };
        let graph =
            |(name, _): &(Modality, _)| Some((name.clone(), self.graphs.get(name)?.graph.clone()));
        let graphs = roster.graphs.iter().filter_map(graph).collect();
        let roster = roster.clone();
        self.fetches_in_vain = 0;
        self.frame = Some(Arc::new(Frame { roster, received: now, robots, graphs }));
        true
    }

    /// A fetch begins: one of [`Follower::fetch`], or the inquiry of the service.
    pub fn fetch_begun(&mut self, now: Tick) {
        self.is_fetching = true;
        self.fetched = now;
        self.awaited.clear();
    }

    /// The fetch has ended and its answers have been accepted. What it did not repair shows by the
    /// revisions that the roster lists.
    pub fn fetch_ended(&mut self) {
        if std::mem::take(&mut self.is_fetching) {
            if !self.awaited.is_empty() {
                self.fetches_in_vain = self.fetches_in_vain.saturating_add(1);
            }
            self.graphs.values_mut().for_each(|followed| followed.gap = false);
        }
    }

    /// Fetches everything again: messages of the meantime were not received.
    pub fn refresh(&mut self) {
        self.refresh = true;
        self.is_fetching = false;
    }

    /// When a fetch is wanted; none while all is well or one is under way.
    pub fn fetch_due(&self) -> Option<Tick> {
        if self.is_fetching {
            return None;
        }
        if self.refresh {
            return Some(Tick::default());
        }
        let Some(roster) = &self.roster else {
            return Some(self.fetched.after(ROSTER_FETCH_INTERVAL));
        };
        let worst = roster.graphs.iter().map(|(name, at)| self.distance(name, *at)).max_by_key(
            |distance| match distance {
                Distance::None => 0,
                Distance::Ahead => 1,
                Distance::Behind => 2,
                Distance::Gap => 3,
            },
        );
        let since = self.apart_since.unwrap_or_default();
        let wanted = match worst? {
            Distance::None => return None,
            Distance::Ahead => since.after(AHEAD_GRACE),
            Distance::Behind => since.after(BEHIND_GRACE),
            Distance::Gap => Tick::default(),
        };
        Some(wanted.max(self.fetched.after(FETCH_INTERVAL)))
    }

    /// What the fetch asks for that is due, and how long it waits for answers; it counts as begun.
    pub fn fetch(&mut self, now: Tick) -> Option<(Vec<Pattern>, Duration)> {
        if self.fetch_due()? > now {
            return None;
        }
        let mut patterns = vec![Pattern::One(Key::Roster)];
        let mut awaited = BTreeSet::new();
        match &self.roster {
            Some(roster) if !self.refresh => {
                let apart =
                    |(name, at): &&(Modality, _)| self.distance(name, *at) != Distance::None;
                awaited.extend(roster.graphs.iter().filter(apart).map(|(name, _)| name.clone()));
                patterns.extend(awaited.iter().cloned().map(|name| Pattern::One(Key::Graph(name))));
            }
            roster => {
                let listed = roster.iter().flat_map(|roster| &roster.graphs);
                awaited.extend(listed.map(|(name, _)| name.clone()));
                patterns.push(Pattern::Graphs);
            }
        }
        self.refresh = false;
        self.fetch_begun(now);
        self.awaited = awaited;
        let within = FETCH_TIMEOUT * 2_u32.pow(self.fetches_in_vain.min(MAX_DOUBLINGS));
        Some((patterns, within))
    }

    fn distance(&self, name: &Modality, listed: Revision) -> Distance {
        let Some(followed) = self.graphs.get(name) else { return Distance::Behind };
        match followed.graph.revision().cmp(&listed) {
            _ if followed.gap => Distance::Gap,
            std::cmp::Ordering::Less => Distance::Behind,
            std::cmp::Ordering::Equal => Distance::None,
            std::cmp::Ordering::Greater => Distance::Ahead,
        }
    }
}

/// Whether a roster lists a modality. Its list is ordered by name.
fn lists(roster: Option<&Roster>, modality: &Modality) -> bool {
    roster.is_some_and(|roster| {
        roster.graphs.binary_search_by(|(name, _)| name.cmp(modality)).is_ok()
    })
}
