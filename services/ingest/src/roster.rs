//! All known robots: how they join, when their presence changes, how they leave.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::graph::Node;
use muster_model::id::{Modality, RobotId};
use muster_model::limits::{MAX_GRAPH_EDGES, MAX_SILENT_ROBOTS};
use muster_model::observation::Stream;
use muster_model::roster::{Presence, RosterEntry};
use muster_model::settings::IngestSettings;
use muster_model::time::Tick;

use crate::admission::{Content, Gate, Observed, Refusal};
use crate::robot::{Change, GracePeriods, Robot, Token, Transition};

/// All known robots.
#[derive(Debug, Default)]
pub(crate) struct Fleet {
    robots: BTreeMap<RobotId, Robot>,
    next_node: Node,
    /// How many edges all robots together have reported on each stream.
    edges: BTreeMap<Stream, usize>,
    /// Robots that joined by their token and have not reported; no more than [`MAX_SILENT_ROBOTS`].
    silent: BTreeSet<RobotId>,
    /// Names that have a token and are no robots of the fleet: they left although it was still there, or there
    /// were too many silent ones. No more than a fleet may have robots.
    lingering: BTreeSet<RobotId>,
    /// No presence changes before this; none if it never does.
    presence_deadline: Option<Tick>,
    newest_message: Option<Tick>,
}

impl Fleet {
    /// The robots, ordered by name.
    pub(crate) fn robots(&self) -> &BTreeMap<RobotId, Robot> {
        &self.robots
    }

    /// The entries of a roster, ordered by name.
    pub(crate) fn entries(&self) -> Vec<RosterEntry> {
        self.robots.iter().map(|(name, robot)| robot.entry(name)).collect()
    }

    /// Known robots, and names that have a token and are none.
    pub(crate) fn record_count(&self) -> usize {
        self.robots.len() + self.lingering.len()
    }

    /// Edges that the robots have reported.
    pub(crate) fn reported_edge_count(&self) -> usize {
        self.edges.values().sum()
    }

    /// How many edges all robots have reported on a stream once a robot's report is accepted.
    ///
    /// Edges to unknown robots count, because those may join. A report with fewer edges than the robot's last
    /// one is always accepted.
    ///
    /// # Errors
    /// If the graph of the stream may not have so many edges.
    fn edges_with(
        &self,
        name: &RobotId,
        stream: &Stream,
        content: &Content,
    ) -> Result<usize, Refusal> {
        let before = self.robots.get(name).map_or(0, |robot| robot.edges(stream).len());
        let added = content.edge_count();
        let others = self.edges.get(stream).copied().unwrap_or(0).saturating_sub(before);
        let edges = others.saturating_add(added);
        if added > before && edges as u64 > MAX_GRAPH_EDGES {
            return Err(Refusal::Edges { field: stream.list_field() });
        }
        Ok(edges)
    }

    /// Restores a report from before a restart, unless a newer one was accepted on its stream.
    pub(crate) fn restore_report(
        &mut self,
        received: Tick,
        name: &RobotId,
        stream: Stream,
        content: Content,
    ) {
        let Ok(edges) = self.edges_with(name, &stream, &content) else { return };
        let robot = self.robots.get_mut(name).filter(|robot| !robot.has_reported_on(&stream));
        if let Some(robot) = robot {
            robot.apply(received, stream.clone(), content);
            self.edges.insert(stream, edges);
        }
    }

    /// Counts the reported edges again: robots have left, or reports were dropped.
    fn count_edges(&mut self) {
        for (stream, edges) in &mut self.edges {
            *edges = self.robots.values().map(|robot| robot.edges(stream).len()).sum();
        }
        self.edges.retain(|_, edges| *edges > 0);
    }

    /// When the newest message was received.
    pub(crate) fn newest_message(&self) -> Option<Tick> {
        self.newest_message
    }

    /// No presence changes before this; none if it never does.
    pub(crate) fn presence_deadline(&self) -> Option<Tick> {
        self.presence_deadline
    }

    /// Whether a robot is stale. Of many the first is found soon: those that return together ask once each.
    pub(crate) fn has_stale(&self) -> bool {
        self.robots.values().any(|robot| robot.presence == Presence::Stale)
    }

    /// How many robots are stale.
    pub(crate) fn stale_count(&self) -> usize {
        self.robots.values().filter(|robot| robot.presence == Presence::Stale).count()
    }

    /// Accepts an observation.
    ///
    /// # Errors
    /// Why it is refused. An ambiguous one extends the grace period of its robot; nothing else changes.
    pub(crate) fn observe(
        &mut self,
        now: Tick,
        name: &RobotId,
        observed: Observed,
        settings: &IngestSettings,
    ) -> Result<Change, Refusal> {
        let Observed { stream, provenance, content } = observed;
        let edges = self.edges_with(name, &stream, &content)?;
        let known = self.robots.get_mut(name);
        let mut fresh = Gate::new(now, settings);
        let gate = known.and_then(|robot| robot.gates.get_mut(&stream)).unwrap_or(&mut fresh);
        let passed = gate.pass(now, &provenance, settings);
        let is_contested = gate.is_contested();
        if matches!(passed, Err(Refusal::Ambiguous(_)))
            && let Some(robot) = self.robots.get_mut(name)
        {
            robot.extend_grace_for(now, &stream);
        }
        match passed {
            Err(Refusal::Late(reason) | Refusal::Ambiguous(reason)) if is_contested => {
                return Err(Refusal::TwoPrograms { robot: name.clone(), reason });
            }
            passed => passed?,
        }
        let (robot, joined) = self.find_or_join(now, name, settings)?;
        robot.gates.entry(stream.clone()).or_insert(fresh);
        robot.mark_seen(now);
        let change = robot.apply(now, stream.clone(), content);
        self.edges.insert(stream, edges);
        self.silent.remove(name);
        self.newest_message = Some(now);
        self.schedule_presence_update(name, settings.into());
        Ok(Change { joined, roster: change.roster || joined, ..change })
    }

    /// A token appeared or was lost. A token that was known is no sign of life, and a robot that left
    /// although it had its token does not return by it. By tokens alone only so many robots join; the others do
    /// by their first report.
    ///
    /// # Errors
    /// If no more robots may join.
    pub(crate) fn token(
        &mut self,
        now: Tick,
        name: &RobotId,
        alive: bool,
        settings: &IngestSettings,
    ) -> Result<Change, Refusal> {
        let mut change = Change::default();
        if !alive {
            self.lingering.remove(name);
            if let Some(robot) = self.robots.get_mut(name) {
                robot.token_lost(now);
            }
        } else if !self.robots.contains_key(name) && self.silent.len() >= MAX_SILENT_ROBOTS {
            self.linger(name.clone(), settings);
        } else if !self.lingering.contains(name) {
            let (robot, joined) = self.find_or_join(now, name, settings)?;
            robot.token_appeared(now);
            if joined {
                self.silent.insert(name.clone());
            }
            change = Change { joined, roster: joined, graph: joined };
        }
        self.schedule_presence_update(name, settings.into());
        Ok(change)
    }

    /// Remembers that a name has a token and is no robot of the fleet, unless too many are remembered.
    fn linger(&mut self, name: RobotId, settings: &IngestSettings) {
        if self.lingering.len() < settings.max_robots as usize {
            self.lingering.insert(name);
        }
    }

    /// The robot, with the next node number if it is new, and whether it is.
    ///
    /// # Errors
    /// If no more robots may join.
    pub(crate) fn find_or_join(
        &mut self,
        now: Tick,
        name: &RobotId,
        settings: &IngestSettings,
    ) -> Result<(&mut Robot, bool), Refusal> {
        let joins = !self.robots.contains_key(name);
        if joins && self.robots.len() >= settings.max_robots as usize {
            return Err(Refusal::FleetFull(settings.max_robots));
        }
        let node = self.next_node;
        if joins {
            self.next_node = node.checked_add(1).ok_or(Refusal::NoNodeLeft)?;
        }
        let token =
            if joins && self.lingering.remove(name) { Token::Alive } else { Token::Unknown };
        let robot = self.robots.entry(name.clone());
        Ok((robot.or_insert_with(|| Robot::new(node, now, token)), joins))
    }

    /// Brings the deadline forward to the next change of a robot's presence.
    pub(crate) fn schedule_presence_update(&mut self, name: &RobotId, grace: GracePeriods) {
        let next = self.robots.get(name).and_then(|robot| robot.presence_deadline(grace));
        self.presence_deadline = self.presence_deadline.into_iter().chain(next).min();
    }

    /// Whether the presence of a robot changes within a time from now on if nothing more is received from it.
    pub(crate) fn changes_within(&self, now: Tick, time: Duration, grace: GracePeriods) -> bool {
        let until = now.after(time);
        let mut deadlines = self.robots.values().filter_map(|robot| robot.presence_deadline(grace));
        deadlines.any(|at| at <= until)
    }

    /// Makes the presence of all robots due.
    pub(crate) fn update_presence_soon(&mut self, now: Tick) {
        self.presence_deadline = Some(now);
    }

    /// Updates the presence of a robot that may have recovered; whether it has.
    pub(crate) fn has_recovered(&mut self, now: Tick, name: &RobotId, grace: GracePeriods) -> bool {
        let stale = self.robots.get_mut(name).filter(|robot| robot.presence == Presence::Stale);
        let recovered = stale
            .is_some_and(|robot| robot.update_presence(now, grace) == Some(Transition::Recovered));
        if recovered {
            self.schedule_presence_update(name, grace);
        }
        recovered
    }

    /// Updates the presence of all robots, and removes those that are gone.
    pub(crate) fn update_presence(
        &mut self,
        now: Tick,
        settings: &IngestSettings,
    ) -> Vec<(RobotId, Transition)> {
        let grace = GracePeriods::from(settings);
        let mut transitions = Vec::new();
        self.presence_deadline = None;
        for (name, robot) in &mut self.robots {
            let transition = robot.update_presence(now, grace);
            transitions.extend(transition.map(|transition| (name.clone(), transition)));
            if transition != Some(Transition::Left) {
                let next = robot.presence_deadline(grace);
                self.presence_deadline = self.presence_deadline.into_iter().chain(next).min();
            }
        }
        for (name, transition) in &transitions {
            if *transition != Transition::Left {
                continue;
            }
            let left = self.robots.remove(name);
            self.silent.remove(name);
            if left.is_some_and(|robot| robot.has_token()) {
                self.linger(name.clone(), settings);
            }
        }
        if transitions.iter().any(|(_, transition)| *transition == Transition::Left) {
            self.count_edges();
        }
        transitions
    }

    /// Nothing could be received until now: the grace period of every robot starts again.
    pub(crate) fn extend_all_grace(&mut self, now: Tick) {
        for robot in self.robots.values_mut() {
            robot.extend_grace(now);
        }
        self.update_presence_soon(now);
    }

    /// The silence of a robot proved nothing: it is active again. Whether it was stale.
    pub(crate) fn take_stale_back(&mut self, name: &RobotId) -> bool {
        self.robots.get_mut(name).is_some_and(Robot::take_stale_back)
    }

    /// Gives every robot a new node: a new term begins.
    pub(crate) fn renumber(&mut self) {
        self.next_node = 0;
        for robot in self.robots.values_mut() {
            robot.node = self.next_node;
            self.next_node += 1;
        }
    }

    /// Removes the robots that have joined by their token alone, unless they are to stay.
    pub(crate) fn remove_without_reports(&mut self, stays: impl Fn(&RobotId) -> bool) {
        let (lingering, silent) = (&mut self.lingering, &mut self.silent);
        self.robots.retain(|name, robot| {
            let leaves = !robot.has_reported() && robot.has_token() && !stays(name);
            if leaves {
                silent.remove(name);
                lingering.insert(name.clone());
            }
            !leaves
        });
        self.count_edges();
    }

    /// Drops reports of modalities that are no longer declared.
    pub(crate) fn keep_modalities(&mut self, declared: &[Modality]) {
        for robot in self.robots.values_mut() {
            robot.keep_modalities(declared);
        }
        self.count_edges();
    }
}

#[cfg(test)]
mod tests {
    use muster_model::observation::Provenance;

    use super::*;
    use crate::admission::Strength;

    const NOW: Tick = Tick(1_000_000_000_000);

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    /// Lets a robot report so many links.
    fn report(fleet: &mut Fleet, name: &str, links: usize) -> Result<Change, Refusal> {
        let peers =
            (0..links).map(|peer| (robot(&format!("p{peer}")), Strength::Weight(0.5))).collect();
        let provenance = Provenance { stamp: None, boot: None, seq: None };
        let observed =
            Observed { stream: Stream::Links, provenance, content: Content::Edges(peers) };
        fleet.observe(NOW, &robot(name), observed, &IngestSettings::default())
    }

    #[test]
    fn a_report_is_refused_that_would_take_its_graph_past_what_a_message_holds() {
        let mut fleet = Fleet::default();
        report(&mut fleet, "r1", 3).unwrap();
        report(&mut fleet, "r2", 2).unwrap();
        assert_eq!(fleet.reported_edge_count(), 5);
        // So many others that there is room for one more.
        let most = usize::try_from(MAX_GRAPH_EDGES).unwrap();
        fleet.edges.insert(Stream::Links, most - 1);
        report(&mut fleet, "r1", 4).unwrap();
        for (name, links) in [("r1", 5), ("r3", 1)] {
            let reason = report(&mut fleet, name, links).unwrap_err().to_string();
            assert!(reason.starts_with("links: ") && reason.contains("strongest"), "{reason}");
        }
        assert!(!fleet.robots.contains_key(&robot("r3")));
        assert_eq!(
            fleet.robots[&robot("r1")].edges(&Stream::Links).len(),
            4,
            "what was accepted stays"
        );
        report(&mut fleet, "r2", 1).unwrap();
        assert_eq!(fleet.edges[&Stream::Links], most - 1);
    }

    #[test]
    fn tokens_without_reports_do_not_fill_the_fleet() {
        let (mut fleet, settings) = (Fleet::default(), IngestSettings::default());
        let many = settings.max_robots as usize + 2 * MAX_SILENT_ROBOTS;
        let name = |number: usize| robot(&format!("s{number:06}"));
        let mut joined = 0;
        for number in 0..many {
            joined += usize::from(fleet.token(NOW, &name(number), true, &settings).unwrap().joined);
        }
        assert_eq!((joined, fleet.robots.len()), (MAX_SILENT_ROBOTS, MAX_SILENT_ROBOTS));
        assert_eq!(fleet.record_count(), MAX_SILENT_ROBOTS + settings.max_robots as usize);
        // One of them joins by its first report, and its token counts.
        let late = name(MAX_SILENT_ROBOTS);
        assert!(report(&mut fleet, late.as_str(), 1).unwrap().joined);
        assert!(fleet.robots[&late].has_token());
        // Their end frees everything.
        for number in 0..many {
            fleet.token(NOW, &name(number), false, &settings).unwrap();
        }
        let later = NOW.after(Duration::from_secs(60));
        fleet.update_presence(later, &settings);
        assert_eq!((fleet.record_count(), fleet.silent.len()), (0, 0));
    }

    #[test]
    fn a_robot_that_leaves_makes_room() {
        let mut fleet = Fleet::default();
        report(&mut fleet, "r1", 3).unwrap();
        report(&mut fleet, "r1", 2).unwrap();
        assert_eq!(fleet.reported_edge_count(), 2);
        let later = NOW.after(Duration::from_secs(11));
        fleet.update_presence(later, &IngestSettings::default());
        assert_eq!(fleet.reported_edge_count(), 0);
    }
}
