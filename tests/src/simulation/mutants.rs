//! Mutants: faults of the code under test that are made on purpose, to prove that the oracle finds them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_model::content::Checked;
use muster_model::event::EventKind;
use muster_model::header::Revision;
use muster_model::history::{Entry, Record};
use muster_model::id::{CommandId, RobotId, ServiceName, TeamId};
use muster_model::observation::Pose;
use muster_model::time::Tick;
use serde_json::Value;

mod bridges;
mod kind;
pub(super) mod messages;
mod proposals;

pub use kind::Mutant;

use super::clock::{BEGINNING, SECOND};
use muster_wire::envelope::EnvelopeError;
use muster_wire::{Format, Key, KeySpace, Message, Packet};

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
    /// The event of the first alert that was raised.
    first_alert: Option<EventKind>,
    /// All robots that were in the team of each id that was published, and what it calls others instead.
    seen: BTreeMap<TeamId, BTreeSet<RobotId>>,
    /// Those of the last division.
    living: BTreeSet<TeamId>,
    renamed: BTreeMap<TeamId, TeamId>,
    /// The last proposal that was computed, and when it was read.
    proposal: Option<(Message, Tick)>,
    /// The first pose of each robot that came over a bridge, and what ROS was first shown by key.
    first_poses: BTreeMap<RobotId, Pose>,
    first_shown: BTreeMap<String, Vec<u8>>,
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
            first_alert: None,
            seen: BTreeMap::new(),
            living: BTreeSet::new(),
            renamed: BTreeMap::new(),
            proposal: None,
            first_poses: BTreeMap::new(),
            first_shown: BTreeMap::new(),
        }
    }

    /// Whether a mutant is at work.
    fn is(&self, mutant: Mutant) -> bool {
        self.active && self.mutant == Some(mutant)
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
            if let Message::Event(event) = &message {
                self.note_alert(&event.kind);
            }
        }
        let Some(mutant) = self.mutant.filter(|_| self.active) else {
            return Ok((message, packets));
        };
        let message = self.mutated(mutant, message);
        let outbound = message.publish(now)?.into_iter();
        let mut packets: Vec<Packet> =
            outbound.map(|outbound| outbound.into_packet(space)).collect();
        if mutant == Mutant::Garbled && matches!(message, Message::RobotTeam(_)) {
            let halved = |bytes: &mut Vec<u8>| bytes.truncate(bytes.len() / 2);
            packets.iter_mut().filter_map(|packet| packet.payload.as_mut().ok()).for_each(halved);
        }
        Ok((message, packets))
    }

    /// Notes the first alert that is raised.
    fn note_alert(&mut self, kind: &EventKind) {
        if matches!(kind, EventKind::AlertRaised { .. }) && self.first_alert.is_none() {
            self.first_alert = Some(kind.clone());
        }
    }

    /// Notes the highest term of each key before the faults begin.
    fn note_term(&mut self, message: &Message) {
        let Some(given) = message.header().map(|header| header.revision) else { return };
        let key = message.keys().0.to_string();
        if self.kept.get(&key).is_none_or(|kept| given.term > kept.term) {
            self.kept.insert(key, KeptTerm { given, term: given.term, epochs: 0 });
        }
    }

    /// What the bus does with a packet.
    pub(crate) fn carried(&mut self, space: &KeySpace, packet: Packet, now: Tick) -> Packet {
        if self.is(Mutant::DeafRobots) {
            return with_counted_term(packet);
        }
        let old = self.is(Mutant::OldTermAsNewest);
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
        self.is(Mutant::Forgetful)
    }

    /// Whether disks lose the last records at a kill.
    pub(crate) fn loses_records(&self) -> bool {
        self.is(Mutant::LostRecords)
    }

    /// Whether what a full disk refuses is taken for written.
    pub(crate) fn is_careless(&self) -> bool {
        self.is(Mutant::Careless)
    }

    /// Whether nothing is written any more once something was not.
    pub(crate) fn resigns(&self) -> bool {
        self.is(Mutant::Resigned)
    }

    /// Whether a record is left out.
    pub(crate) fn omits(&mut self, entry: &Entry) -> bool {
        let omits = self.is(Mutant::Forgotten);
        if !omits || !matches!(entry.record, Record::Event(_)) {
            return false;
        }
        self.published += 1;
        self.published.is_multiple_of(2)
    }

    /// What the historian records in place of an entry.
    pub(crate) fn recorded(&self, mut entry: Entry) -> Entry {
        if self.active
            && self.mutant == Some(Mutant::Falsifying)
            && let Record::Event(event) = &mut entry.record
        {
            event.kind = "something_else".to_owned();
        }
        entry
    }

    /// What is on the disk of what a core keeps.
    pub(crate) fn kept(&self, mut content: Vec<u8>) -> Vec<u8> {
        if self.is(Mutant::Corrupting) {
            content.iter_mut().for_each(|byte| *byte = !*byte);
        }
        content
    }

    /// Whether hosts do not announce where their instance stands.
    pub(crate) fn is_reticent(&self) -> bool {
        self.is(Mutant::Reticent)
    }

    /// Whether gets are answered twice.
    pub(crate) fn answers_twice(&self) -> bool {
        self.is(Mutant::Twofold)
    }

    /// Whether services answer before their state is on the disk.
    pub(crate) fn is_hasty(&self) -> bool {
        self.is(Mutant::Hasty)
    }

    /// Whether jobs are begun that no core has ordered.
    pub(crate) fn is_eager(&self) -> bool {
        self.is(Mutant::Eager)
    }

    /// Whether the console is misled about divisions.
    pub(crate) fn misleads(&self) -> bool {
        self.is(Mutant::Misled)
    }

    /// Whether a bridge to ROS does nothing once it was killed.
    pub(crate) fn stays_away(&self) -> bool {
        self.is(Mutant::Absent)
    }

    /// How many topics a bridge to ROS remembers beyond those that it has.
    pub(crate) fn hoards_topics(&self) -> usize {
        if self.is(Mutant::Retentive) { 1000 } else { 0 }
    }

    /// Whether a bridge to ROS names nothing that it refuses.
    pub(crate) fn is_secretive(&self) -> bool {
        self.is(Mutant::Secretive)
    }

    /// How many times the program for viewers sends each scene.
    pub(crate) fn repetitions(&self) -> usize {
        if self.is(Mutant::Wordy) { 5 } else { 1 }
    }

    /// Whether the program for viewers makes scenes that no viewer watches.
    pub(crate) fn watches_all(&self) -> bool {
        self.is(Mutant::Wasteful)
    }

    /// Whether the program for viewers is misled about divisions.
    pub(crate) fn blinds_viewers(&self) -> bool {
        self.is(Mutant::Blinded)
    }

    /// Whether a number of teams that no service confirmed is passed on to the program for viewers.
    pub(crate) fn is_wishful(&self) -> bool {
        self.is(Mutant::Wishful)
    }

    /// Whether viewers receive no reason when something is refused.
    pub(crate) fn is_curt(&self) -> bool {
        self.is(Mutant::Curt)
    }

    /// Whether a service receives nothing.
    pub(crate) fn isolates(&self, service: ServiceName) -> bool {
        let isolated = match self.mutant {
            Some(Mutant::IsolatedAuditor) => ServiceName::Auditor,
            Some(Mutant::Dependent) => ServiceName::Clusterer,
            Some(Mutant::StarvedEmbedder) => ServiceName::Embedder,
            _ => return false,
        };
        self.active && service == isolated
    }
}
