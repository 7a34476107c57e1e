//! Mutants: faults of the code under test that are made on purpose, to prove that the oracle finds them.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::content::Checked;
use muster_model::header::Revision;
use muster_model::id::{CommandId, RobotId, ServiceName, TeamId};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use serde_json::Value;

use super::clock::{BEGINNING, SECOND};
use muster_wire::envelope::EnvelopeError;
use muster_wire::{Format, Key, KeySpace, Message, Packet};

/// What is broken on purpose. Each only shows after a fault of some kind, so that there is something
/// to find when a failing run is shrunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mutant {
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
    /// The auditor receives no messages any more once a link was cut.
    IsolatedAuditor,
    /// The clusterer changes the leaders with every heartbeat, once settings were changed.
    Restless,
    /// The clusterer takes a robot out of its team with every heartbeat, once settings were changed.
    Fickle,
    /// Ingest gives every other roster the revision of the one before, once a service was killed.
    RevisionTwice,
    /// Every new leader except the clusterer keeps the term of the former leader, once a service
    /// was killed.
    TermTwice,
    /// The embedder names an older roster than before, once a service was killed.
    OlderRoster,
    /// The auditor sees no positions any more once a link was cut.
    NoPositions,
    /// Every service except the clusterer counts its terms from one again once all had lost their disks.
    TermsFromOne,
    /// Robots are sent terms as if they had been counted from one again.
    DeafRobots,
    /// Every leader except the clusterer goes above any term that an attacker forged.
    UnbelievedTerm,
    /// What the clusterer keeps on disk is not there once the power was cut.
    Forgetful,
    /// The embedder receives nothing that is published any more once the hosts were busy.
    StarvedEmbedder,
    /// The clusterer puts all robots into the first team, whatever the limits are, once settings were changed.
    Overfull,
    /// A service carries its first command out again in place of the next ones, once settings were changed.
    Repetitive,
    /// The clusterer says of every team that it has one robot more with a needed skill, once settings were changed.
    Boastful,
}

impl Mutant {
    /// All of them.
    pub const ALL: [Self; 20] = [
        Self::RobotTwice,
        Self::RobotForgotten,
        Self::WrongSilhouette,
        Self::NotANumber,
        Self::OldTermAsNewest,
        Self::IsolatedAuditor,
        Self::Restless,
        Self::Fickle,
        Self::RevisionTwice,
        Self::TermTwice,
        Self::OlderRoster,
        Self::NoPositions,
        Self::TermsFromOne,
        Self::DeafRobots,
        Self::UnbelievedTerm,
        Self::Forgetful,
        Self::StarvedEmbedder,
        Self::Overfull,
        Self::Repetitive,
        Self::Boastful,
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
            Self::IsolatedAuditor | Self::NoPositions => &["clean cut", "silent cut"],
            Self::Restless | Self::Fickle | Self::Overfull | Self::Repetitive | Self::Boastful => {
                &["settings"]
            }
            Self::TermsFromOne | Self::DeafRobots => &["blackout without disks"],
            Self::UnbelievedTerm => &["forged term"],
            Self::Forgetful => &["power cut"],
            Self::StarvedEmbedder => &["busy hosts"],
        }
    }
}

/// How many epochs later a term is continued that another leader began: more than a run has.
const CONTINUED_EPOCHS: u64 = 1 << 20;

/// By how much terms are lower that are counted from one: some days less than the clocks of a run show.
const CLOCK_TERMS: u64 = BEGINNING / SECOND - (1 << 20);

/// How much higher a term is that nobody believes.
const UNBELIEVED_TERMS: u64 = 1 << 40;

/// The revision of the main output of a service other than the clusterer.
fn revision_of(message: &mut Message) -> Option<&mut Revision> {
    let header = match message {
        Message::Roster(roster) => &mut roster.make_mut_unchecked().header,
        Message::Embedding(embedding) => &mut embedding.make_mut_unchecked().header,
        Message::Audit(audit) => &mut Arc::make_mut(audit).header,
        _ => return None,
    };
    Some(&mut header.revision)
}

/// What a robot is sent, with a term that is counted from one; other packets as they are.
fn with_counted_term(packet: Packet) -> Packet {
    let is_for_robot = packet.key.contains("/robot/") && packet.key.ends_with("/team");
    let bytes = packet.payload.as_ref().ok().filter(|_| is_for_robot);
    let value = bytes.and_then(|bytes| serde_json::from_slice::<Value>(bytes).ok());
    let Some(mut value) = value else { return packet };
    if let Some(term) = value.get("term").and_then(Value::as_u64) {
        value["term"] = term.saturating_sub(CLOCK_TERMS).into();
    }
    Packet { payload: Ok(value.to_string().into_bytes()), ..packet }
}

/// Makes the faults of a mutant.
#[derive(Debug)]
pub(crate) struct Mutator {
    mutant: Option<Mutant>,
    active: bool,
    published: u64,
    /// The leaders that it has made up in the last division.
    leaders: BTreeMap<TeamId, RobotId>,
    /// The robot that it has taken out of its team in the last division.
    taken_out: Option<RobotId>,
    /// The inertia of the last division, in bits: it identifies the vectors that were divided.
    inertia: Option<u64>,
    /// A revision that it comes back to.
    old: Option<Revision>,
    /// The terms that new leaders keep, by key.
    kept: BTreeMap<String, KeptTerm>,
    /// The first command that each service has carried out.
    first_commands: BTreeMap<ServiceName, CommandId>,
}

/// The term of a leader that those after it keep.
#[derive(Debug)]
struct KeptTerm {
    /// The newest that a leader began.
    given: Revision,
    /// What is published instead of its term …
    term: u64,
    /// … and how many epochs later.
    epochs: u64,
}

impl Mutator {
    pub(crate) fn new(mutant: Option<Mutant>) -> Self {
        Self {
            mutant,
            active: false,
            published: 0,
            leaders: BTreeMap::new(),
            taken_out: None,
            inertia: None,
            old: None,
            kept: BTreeMap::new(),
            first_commands: BTreeMap::new(),
        }
    }

    /// A fault has happened.
    pub(crate) fn fault(&mut self, kind: &str) {
        self.active |= self.mutant.is_some_and(|mutant| mutant.after().contains(&kind));
    }

    /// What a core publishes, as a mutant would, and the packets of that.
    ///
    /// # Errors
    /// If it has no form on the bus.
    pub(crate) fn published(
        &mut self,
        space: &KeySpace,
        message: Message,
        packets: Vec<Packet>,
        now: Tick,
    ) -> Result<(Message, Vec<Packet>), EnvelopeError> {
        if !self.active {
            self.note_term(&message);
        }
        let Some(mutant) = self.mutant.filter(|_| self.active) else {
            return Ok((message, packets));
        };
        let message = self.mutated(mutant, message);
        let outbound = message.publish(now)?.into_iter();
        let packets = outbound.map(|outbound| outbound.into_packet(space)).collect();
        Ok((message, packets))
    }

    /// Notes the highest term of each key before the faults begin.
    fn note_term(&mut self, message: &Message) {
        let Some(given) = message.header().map(|header| header.revision) else { return };
        let key = message.keys().0.to_string();
        if self.kept.get(&key).is_none_or(|kept| given.term > kept.term) {
            self.kept.insert(key, KeptTerm { given, term: given.term, epochs: 0 });
        }
    }

    fn mutated(&mut self, mutant: Mutant, message: Message) -> Message {
        match (mutant, message) {
            (Mutant::RobotTwice, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                if let Some(robot) = teams.teams.first().and_then(|team| team.members.first()) {
                    teams.unassigned = vec![robot.robot.clone()];
                }
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::RobotForgotten, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                for team in &mut teams.teams {
                    // A team without its leader would not even be decoded.
                    team.members.retain(|member| member.robot == team.leader);
                }
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Restless, Message::Teams { teams, mirror }) => {
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
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Restless, Message::RobotTeam(mut report)) => {
                let leader = report.team.as_ref().and_then(|team| self.leaders.get(team));
                report.leader = leader.cloned().or(report.leader);
                Message::RobotTeam(report)
            }
            (Mutant::Fickle, Message::Teams { teams, mirror }) => {
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
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Fickle, Message::RobotTeam(mut report)) => {
                if let Some(robot) = &self.taken_out {
                    if report.robot == *robot {
                        (report.team, report.leader, report.members) = (None, None, None);
                    } else if let Some(members) = &mut report.members {
                        members.retain(|member| member != robot);
                    }
                }
                Message::RobotTeam(report)
            }
            (Mutant::Overfull, Message::Teams { teams, mirror }) if teams.limited.is_some() => {
                let mut teams = Teams::clone(&teams);
                // Readers would refuse prices of teams that are not there.
                teams.limited.iter_mut().for_each(|limited| limited.prices.clear());
                let others = teams.teams.split_off(teams.teams.len().min(1));
                if let Some(first) = teams.teams.first_mut() {
                    first.members.extend(others.into_iter().flat_map(|team| team.members));
                    first.members.sort_by(|left, right| left.robot.cmp(&right.robot));
                }
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Repetitive, Message::Outcome(mut outcome)) => {
                let own = outcome.id.clone();
                let first = self.first_commands.entry(outcome.service).or_insert(own);
                Arc::make_mut(&mut outcome).id.clone_from(first);
                Message::Outcome(outcome)
            }
            (Mutant::Boastful, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                teams.needs.iter_mut().for_each(|need| need.have += 1);
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::RevisionTwice, Message::Roster(mut roster)) => {
                let header = &mut roster.make_mut_unchecked().header;
                match self.old.take() {
                    Some(old) => header.revision = old,
                    None => self.old = Some(header.revision),
                }
                Message::Roster(roster)
            }
            (Mutant::TermTwice, mut message) => {
                let key = message.keys().0.to_string();
                if let Some(revision) = revision_of(&mut message)
                    && let Some(kept) = self.kept.get_mut(&key)
                    && revision.term >= kept.given.term
                {
                    if revision.term > kept.given.term {
                        kept.epochs += CONTINUED_EPOCHS;
                        kept.given = *revision;
                    }
                    revision.term = kept.term;
                    revision.epoch += kept.epochs;
                }
                message
            }
            (Mutant::TermsFromOne, mut message) => {
                if let Some(Revision { term, .. }) = revision_of(&mut message) {
                    *term = term.saturating_sub(CLOCK_TERMS).max(1);
                }
                message
            }
            (Mutant::UnbelievedTerm, mut message) => {
                if let Some(Revision { term, .. }) = revision_of(&mut message) {
                    *term += UNBELIEVED_TERMS;
                }
                message
            }
            (Mutant::OlderRoster, Message::Embedding(mut embedding)) => {
                self.published += 1;
                let old = *self.old.get_or_insert(embedding.roster);
                if self.published.is_multiple_of(3) {
                    embedding.make_mut_unchecked().roster = old;
                }
                Message::Embedding(embedding)
            }
            (Mutant::NoPositions, Message::Audit(mut audit)) => {
                let report = &mut Arc::make_mut(&mut audit).in_physical;
                (report.mean, report.per_team, report.per_robot) = (None, Vec::new(), Vec::new());
                Message::Audit(audit)
            }
            (Mutant::WrongSilhouette, Message::Audit(audit)) => {
                let mut audit = audit.as_ref().clone();
                if let Some((_, score)) = audit.in_embedding.per_robot.first_mut() {
                    *score = (*score - 1e-6).max(-1.0);
                }
                Message::Audit(audit.into())
            }
            (Mutant::NotANumber, Message::Audit(audit)) => {
                let mut audit = audit.as_ref().clone();
                audit.in_embedding.mean = audit.in_embedding.mean.map(|_| f64::NAN);
                Message::Audit(audit.into())
            }
            (_, message) => message,
        }
    }

    /// What the bus does with a packet.
    pub(crate) fn carried(&mut self, space: &KeySpace, packet: Packet, now: Tick) -> Packet {
        if self.active && self.mutant == Some(Mutant::DeafRobots) {
            return with_counted_term(packet);
        }
        let old = self.active && self.mutant == Some(Mutant::OldTermAsNewest);
        if !old || packet.key != space.format(&Key::Embedding) {
            return packet;
        }
        let Ok(Message::Embedding(embedding)) = Message::decode(space, &packet) else {
            return packet;
        };
        let mut embedding = embedding.as_ref().clone();
        embedding.header.revision.term += 1;
        let message = Message::Embedding(Checked::new_unchecked(embedding));
        match message.encode(Key::Embedding, Format::Binary, now) {
            Ok(outbound) => Packet { payload: Ok(outbound.payload), ..packet },
            Err(_) => packet,
        }
    }

    /// Whether disks lose what cores keep.
    pub(crate) fn forgets(&self) -> bool {
        self.active && self.mutant == Some(Mutant::Forgetful)
    }

    /// Whether a service receives nothing.
    pub(crate) fn isolates(&self, service: ServiceName) -> bool {
        let isolated = match self.mutant {
            Some(Mutant::IsolatedAuditor) => ServiceName::Auditor,
            Some(Mutant::StarvedEmbedder) => ServiceName::Embedder,
            _ => return false,
        };
        self.active && service == isolated
    }
}
