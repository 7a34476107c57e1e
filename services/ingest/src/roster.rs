//! All robots that are known: who joins, who is judged when, who leaves.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::graph::Node;
use muster_model::id::{Modality, RobotId};
use muster_model::limits::MAX_GRAPH_EDGES;
use muster_model::observation::Stream;
use muster_model::roster::{Presence, RosterEntry};
use muster_model::settings::IngestSettings;
use muster_model::time::Tick;

use crate::admission::{Content, Gate, Observed, Refusal};
use crate::robot::{Change, GracePeriods, Robot, Token, Transition};

/// All robots that are known.
#[derive(Debug, Default)]
pub(crate) struct Fleet {
    robots: BTreeMap<RobotId, Robot>,
    next_node: Node,
    /// How many edges all robots together have reported on each stream.
    edges: BTreeMap<Stream, usize>,
    /// Robots that left and whose token is still there.
    hung: BTreeSet<RobotId>,
    /// No presence changes before this; none if it never does.
    next_judgement: Option<Tick>,
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

    /// Robots that are known, and those that left and whose token is still there.
    pub(crate) fn record_count(&self) -> usize {
        self.robots.len() + self.hung.len()
    }

    /// Edges that the robots have reported.
    pub(crate) fn reported_edge_count(&self) -> usize {
        self.edges.values().sum()
    }

    /// How many edges the robots would have reported on a stream with this of one robot, unless that
    /// is more than its graph may have. Edges to robots that are not known count, because they may
    /// come. Who reports fewer than before is always let in.
    fn edges_with(
        &self,
        name: &RobotId,
        stream: &Stream,
        content: &Content,
    ) -> Result<usize, String> {
        let before = self.robots.get(name).map_or(0, |robot| robot.edges(stream).len());
        let added = content.edge_count();
        let others = self.edges.get(stream).copied().unwrap_or(0).saturating_sub(before);
        let edges = others.saturating_add(added);
        if added > before && edges as u64 > MAX_GRAPH_EDGES {
            let field = stream.list_field();
            return Err(format!(
                "{field}: all robots together would report more than {MAX_GRAPH_EDGES}, which fit no \
                 message; let each report only its strongest"
            ));
        }
        Ok(edges)
    }

    /// Takes over what a robot said on a stream before a restart, unless it was heard on it since.
    pub(crate) fn recall(
        &mut self,
        received: Tick,
        name: &RobotId,
        stream: Stream,
        content: Content,
    ) {
        let Ok(edges) = self.edges_with(name, &stream, &content) else { return };
        let robot = self.robots.get_mut(name).filter(|robot| !robot.has_spoken(&stream));
        if let Some(robot) = robot {
            robot.take(received, stream.clone(), content);
            self.edges.insert(stream, edges);
        }
    }

    /// Counts reported edges anew: robots have gone, or what they said was forgotten.
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
    pub(crate) fn next_judgement(&self) -> Option<Tick> {
        self.next_judgement
    }

    /// How many robots are stale.
    pub(crate) fn stale_count(&self) -> usize {
        self.robots.values().filter(|robot| robot.presence == Presence::Stale).count()
    }

    /// Lets an observation in, or refuses it and stays as it is, but for the grace with a robot
    /// whose messages are in doubt.
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
        if matches!(passed, Err(Refusal::Doubtful(_)))
            && let Some(robot) = self.robots.get_mut(name)
        {
            robot.doubt(now, &stream);
        }
        passed?;
        let (robot, joined) = self.find_or_join(now, name, settings)?;
        robot.gates.entry(stream.clone()).or_insert(fresh);
        robot.hear(now);
        let change = robot.take(now, stream.clone(), content);
        self.edges.insert(stream, edges);
        self.newest_message = Some(now);
        self.expect(name, settings.into());
        Ok(Change { joined, roster: change.roster || joined, ..change })
    }

    /// Takes in that a token appeared or was lost. One that was known to be there says nothing new,
    /// and that of a robot that left although it had its token does not bring the robot back.
    pub(crate) fn token(
        &mut self,
        now: Tick,
        name: &RobotId,
        alive: bool,
        settings: &IngestSettings,
    ) -> Result<Change, Refusal> {
        let mut change = Change::default();
        if !alive {
            self.hung.remove(name);
            if let Some(robot) = self.robots.get_mut(name) {
                robot.lose_token(now);
            }
        } else if !self.hung.contains(name) {
            let (robot, joined) = self.find_or_join(now, name, settings)?;
            robot.show_token(now);
            change = Change { joined, roster: joined, graph: joined };
        }
        self.expect(name, settings.into());
        Ok(change)
    }

    /// The robot, given the next node number if it is new.
    pub(crate) fn find_or_join(
        &mut self,
        now: Tick,
        name: &RobotId,
        settings: &IngestSettings,
    ) -> Result<(&mut Robot, bool), Refusal> {
        let joins = !self.robots.contains_key(name);
        if joins && self.robots.len() >= settings.max_robots as usize {
            let most = settings.max_robots;
            return Err(format!("the fleet is full: max_robots is {most}").into());
        }
        let node = self.next_node;
        if joins {
            self.next_node = node.checked_add(1).ok_or_else(|| {
                "no node number is left in this term; restart ingest to begin another".to_owned()
            })?;
        }
        let token = if joins && self.hung.remove(name) { Token::Alive } else { Token::Unseen };
        let robot = self.robots.entry(name.clone());
        Ok((robot.or_insert_with(|| Robot::new(node, now, token)), joins))
    }

    /// Makes sure that a robot is judged in time.
    pub(crate) fn expect(&mut self, name: &RobotId, grace: GracePeriods) {
        let next = self.robots.get(name).and_then(|robot| robot.next_judgement(grace));
        self.next_judgement = self.next_judgement.into_iter().chain(next).min();
    }

    /// Judges every robot at the next opportunity.
    pub(crate) fn judge_soon(&mut self, now: Tick) {
        self.next_judgement = Some(now);
    }

    /// Judges one robot that may have recovered.
    pub(crate) fn has_recovered(&mut self, now: Tick, name: &RobotId, grace: GracePeriods) -> bool {
        let stale = self.robots.get_mut(name).filter(|robot| robot.presence == Presence::Stale);
        let recovered =
            stale.is_some_and(|robot| robot.judge(now, grace) == Some(Transition::Recovered));
        if recovered {
            self.expect(name, grace);
        }
        recovered
    }

    /// Judges all robots, and lets those go that are gone.
    pub(crate) fn judge(
        &mut self,
        now: Tick,
        settings: &IngestSettings,
    ) -> Vec<(RobotId, Transition)> {
        let grace = GracePeriods::from(settings);
        let mut transitions = Vec::new();
        self.next_judgement = None;
        for (name, robot) in &mut self.robots {
            let transition = robot.judge(now, grace);
            transitions.extend(transition.map(|transition| (name.clone(), transition)));
            if transition != Some(Transition::Left) {
                let next = robot.next_judgement(grace);
                self.next_judgement = self.next_judgement.into_iter().chain(next).min();
            }
        }
        for (name, transition) in &transitions {
            if *transition != Transition::Left {
                continue;
            }
            let left = self.robots.remove(name);
            let has_token = left.is_some_and(|robot| robot.has_token());
            if has_token && self.hung.len() < settings.max_robots as usize {
                self.hung.insert(name.clone());
            }
        }
        if transitions.iter().any(|(_, transition)| *transition == Transition::Left) {
            self.count_edges();
        }
        transitions
    }

    /// Nobody could be heard until now: everybody's grace begins anew.
    pub(crate) fn extend_all_grace(&mut self, now: Tick) {
        for robot in self.robots.values_mut() {
            robot.extend_grace(now);
        }
        self.judge_soon(now);
    }

    /// Gives every robot a new node: a new term begins.
    pub(crate) fn renumber(&mut self) {
        self.next_node = 0;
        for robot in self.robots.values_mut() {
            robot.node = self.next_node;
            self.next_node += 1;
        }
    }

    /// Takes out those who have joined by their token alone, unless they are to stay.
    pub(crate) fn hang_quiet(&mut self, stays: impl Fn(&RobotId) -> bool) {
        let hung = &mut self.hung;
        self.robots.retain(|name, robot| {
            let hangs = !robot.has_said_anything() && robot.has_token() && !stays(name);
            if hangs {
                hung.insert(name.clone());
            }
            !hangs
        });
        self.count_edges();
    }

    /// Forgets what was said of modalities that are not declared any more.
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
            let Err(Refusal::Wrong(reason)) = report(&mut fleet, name, links) else { panic!() };
            assert!(reason.starts_with("links: ") && reason.contains("strongest"), "{reason}");
        }
        assert!(!fleet.robots.contains_key(&robot("r3")));
        assert_eq!(
            fleet.robots[&robot("r1")].edges(&Stream::Links).len(),
            4,
            "what was let in stays"
        );
        report(&mut fleet, "r2", 1).unwrap();
        assert_eq!(fleet.edges[&Stream::Links], most - 1);
    }

    #[test]
    fn who_leaves_makes_room() {
        let mut fleet = Fleet::default();
        report(&mut fleet, "r1", 3).unwrap();
        report(&mut fleet, "r1", 2).unwrap();
        assert_eq!(fleet.reported_edge_count(), 2);
        let later = NOW.after(std::time::Duration::from_secs(11));
        fleet.judge(later, &IngestSettings::default());
        assert_eq!(fleet.reported_edge_count(), 0);
    }
}
