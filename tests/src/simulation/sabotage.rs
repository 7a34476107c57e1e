//! Faults of the code under test that are made on purpose, to prove that the simulation finds them.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::header::Revision;
use muster_model::id::{RobotId, ServiceName, TeamId};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_wire::{Format, Key, KeySpace, Message, Packet};

/// What is broken on purpose. Each only shows after a fault of some kind, so that there is something
/// to find when a failing run is shrunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sabotage {
    /// The clusterer puts a robot into two places once a service was killed.
    RobotTwice,
    /// The clusterer forgets a robot once a service was killed.
    RobotForgotten,
    /// The auditor's silhouettes are off by a millionth once a link was in bad weather.
    WrongSilhouette,
    /// The auditor publishes a mean that is no number once a robot has left.
    NotANumber,
    /// The bus delivers an embedding of a lower term as the newest once a service was killed.
    OldTermAsNewest,
    /// The auditor hears nothing any more once a link was cut.
    DeafAuditor,
    /// The clusterer changes the leaders with every heartbeat, once settings were changed.
    Restless,
    /// The clusterer takes a robot out of its team with every heartbeat, once settings were changed.
    Fickle,
    /// Ingest gives every other roster the revision of the one before, once a service was killed.
    RevisionTwice,
    /// Whoever takes over but the clusterer goes on with the term of the holder before, once a service
    /// was killed.
    TermTwice,
    /// The embedder names an older roster than before, once a service was killed.
    OlderRoster,
    /// The auditor sees no positions any more once a link was cut.
    NoPositions,
}

impl Sabotage {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::RobotTwice,
        Self::RobotForgotten,
        Self::WrongSilhouette,
        Self::NotANumber,
        Self::OldTermAsNewest,
        Self::DeafAuditor,
        Self::Restless,
        Self::Fickle,
        Self::RevisionTwice,
        Self::TermTwice,
        Self::OlderRoster,
        Self::NoPositions,
    ];

    /// The kinds of faults after which it shows.
    #[must_use]
    pub const fn after(self) -> &'static [&'static str] {
        match self {
            Self::RobotTwice
            | Self::RobotForgotten
            | Self::OldTermAsNewest
            | Self::RevisionTwice
            | Self::TermTwice
            | Self::OlderRoster => &["kill"],
            Self::WrongSilhouette => &["storm"],
            Self::NotANumber => &["robot leaves", "robot leaves and returns", "robot reboots"],
            Self::DeafAuditor | Self::NoPositions => &["clean cut", "silent cut"],
            Self::Restless | Self::Fickle => &["settings"],
        }
    }
}

/// How many epochs a term is continued later that another holder has begun: more than a run has.
const LATER: u64 = 1 << 20;

/// Breaks things.
#[derive(Debug)]
pub(crate) struct Saboteur {
    sabotage: Option<Sabotage>,
    active: bool,
    published: u64,
    /// The leaders that it has made up in the last division.
    leaders: BTreeMap<TeamId, RobotId>,
    /// The robot that it has taken out of its team in the last division.
    taken_out: Option<RobotId>,
    /// The inertia of the last division, which tells the vectors behind it, in bits.
    inertia: Option<u64>,
    /// A revision that it comes back to.
    old: Option<Revision>,
}

impl Saboteur {
    pub(crate) fn new(sabotage: Option<Sabotage>) -> Self {
        Self {
            sabotage,
            active: false,
            published: 0,
            leaders: BTreeMap::new(),
            taken_out: None,
            inertia: None,
            old: None,
        }
    }

    /// A fault has happened.
    pub(crate) fn sees(&mut self, kind: &str) {
        self.active |= self.sabotage.is_some_and(|sabotage| sabotage.after().contains(&kind));
    }

    /// What a core publishes, as a broken one would.
    pub(crate) fn core(&mut self, message: Message) -> Message {
        let Some(sabotage) = self.sabotage.filter(|_| self.active) else { return message };
        match (sabotage, message) {
            (Sabotage::RobotTwice, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                if let Some(robot) = teams.teams.first().and_then(|team| team.members.first()) {
                    teams.unassigned = vec![robot.robot.clone()];
                }
                Message::Teams { teams: Arc::new(teams), mirror }
            }
            (Sabotage::RobotForgotten, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                for team in &mut teams.teams {
                    // A team without its leader would not even be understood.
                    team.members.retain(|member| member.robot == team.leader);
                }
                Message::Teams { teams: Arc::new(teams), mirror }
            }
            (Sabotage::Restless, Message::Teams { teams, mirror }) => {
                self.published += 1;
                self.leaders.clear();
                let mut teams = Teams::clone(&teams);
                for team in &mut teams.teams {
                    let other = team.members.iter().map(|member| &member.robot);
                    let other = other.filter(|robot| **robot != team.leader).max().cloned();
                    if let Some(other) = other.filter(|_| self.published.is_multiple_of(2)) {
                        team.leader = other.clone();
                        self.leaders.insert(team.id.clone(), other);
                    }
                }
                Message::Teams { teams: Arc::new(teams), mirror }
            }
            (Sabotage::Restless, Message::RobotTeam(mut told)) => {
                let leader = told.team.as_ref().and_then(|team| self.leaders.get(team));
                told.leader = leader.cloned().or(told.leader);
                Message::RobotTeam(told)
            }
            (Sabotage::Fickle, Message::Teams { teams, mirror }) => {
                // Only where the same vectors were divided again: otherwise others may find it first.
                let inertia = Some(teams.inertia.to_bits());
                let again = std::mem::replace(&mut self.inertia, inertia) == inertia;
                self.taken_out = None;
                let mut teams = Teams::clone(&teams);
                let follower = teams.teams.iter_mut().find_map(|team| {
                    let at = team.members.iter().position(|member| member.robot != team.leader)?;
                    again.then(|| team.members.remove(at).robot)
                });
                if let Some(robot) = follower {
                    teams.unassigned.push(robot.clone());
                    teams.unassigned.sort();
                    self.taken_out = Some(robot);
                }
                Message::Teams { teams: Arc::new(teams), mirror }
            }
            (Sabotage::Fickle, Message::RobotTeam(mut told)) => {
                if let Some(robot) = &self.taken_out {
                    if told.robot == *robot {
                        (told.team, told.leader, told.members) = (None, None, None);
                    } else if let Some(members) = &mut told.members {
                        members.retain(|member| member != robot);
                    }
                }
                Message::RobotTeam(told)
            }
            (Sabotage::RevisionTwice, Message::Roster(mut roster)) => {
                let header = &mut Arc::make_mut(&mut roster).header;
                match self.old.take() {
                    Some(old) => header.revision = old,
                    None => self.old = Some(header.revision),
                }
                Message::Roster(roster)
            }
            (Sabotage::TermTwice, mut message) => {
                let revision = match &mut message {
                    Message::Roster(roster) => &mut Arc::make_mut(roster).header.revision,
                    Message::Embedding(embedding) => &mut Arc::make_mut(embedding).header.revision,
                    Message::Audit(audit) => &mut Arc::make_mut(audit).header.revision,
                    _ => return message,
                };
                if revision.term > 1 {
                    *revision = Revision { term: revision.term - 1, epoch: revision.epoch + LATER };
                }
                message
            }
            (Sabotage::OlderRoster, Message::Embedding(mut embedding)) => {
                self.published += 1;
                let old = *self.old.get_or_insert(embedding.roster);
                if self.published.is_multiple_of(3) {
                    Arc::make_mut(&mut embedding).roster = old;
                }
                Message::Embedding(embedding)
            }
            (Sabotage::NoPositions, Message::Audit(mut audit)) => {
                let report = &mut Arc::make_mut(&mut audit).in_physical;
                (report.mean, report.per_team, report.per_robot) = (None, Vec::new(), Vec::new());
                Message::Audit(audit)
            }
            (Sabotage::WrongSilhouette, Message::Audit(audit)) => {
                let mut audit = audit.as_ref().clone();
                if let Some((_, score)) = audit.in_embedding.per_robot.first_mut() {
                    *score = (*score - 1e-6).max(-1.0);
                }
                Message::Audit(audit.into())
            }
            (Sabotage::NotANumber, Message::Audit(audit)) => {
                let mut audit = audit.as_ref().clone();
                audit.in_embedding.mean = audit.in_embedding.mean.map(|_| f64::NAN);
                Message::Audit(audit.into())
            }
            (_, message) => message,
        }
    }

    /// What the bus makes of a message.
    pub(crate) fn bus(&mut self, space: &KeySpace, packet: Packet, now: Tick) -> Packet {
        let old = self.active && self.sabotage == Some(Sabotage::OldTermAsNewest);
        if !old || packet.key != space.format(&Key::Embedding) {
            return packet;
        }
        let Ok(Message::Embedding(embedding)) = Message::decode(space, &packet) else {
            return packet;
        };
        let mut embedding = embedding.as_ref().clone();
        embedding.header.revision.term += 1;
        let message = Message::Embedding(embedding.into());
        match message.encode(Key::Embedding, Format::Binary, now) {
            Ok(outbound) => Packet { payload: Ok(outbound.payload), ..packet },
            Err(_) => packet,
        }
    }

    /// Whether a service hears nothing.
    pub(crate) fn deafens(&self, service: ServiceName) -> bool {
        self.active
            && self.sabotage == Some(Sabotage::DeafAuditor)
            && service == ServiceName::Auditor
    }
}
