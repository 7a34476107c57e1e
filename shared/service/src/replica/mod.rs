//! One instance of a service among others: its place in the election, the term and revision of its
//! output, its settings, counters, and refused messages.

pub(crate) mod changes;
pub(crate) mod election;
pub(crate) mod lease;
pub(crate) mod peers;
pub(crate) mod refusals;
pub(crate) mod settings;

use std::collections::BTreeMap;

use muster_model::command::CommandOutcome;
use muster_model::event::{Event, EventKind, Severity};
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, RobotId, ServiceName};
use muster_model::refused::Refused;
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_model::settings::Settings;
use muster_model::status::{ServiceStatus, StatusGauge};
use muster_model::term::{clock_term, highest_term, latest_date};
use muster_model::time::Tick;
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::{KeySpace, Message};

use self::election::Election;
use self::refusals::Refusals;
use self::settings::ReplicaSettings;
use crate::start::{Start, Stored};
use crate::wiring::Replication;

/// One instance of a service.
#[derive(Debug)]
pub(crate) struct Replica<S> {
    pub(crate) space: KeySpace,
    pub(crate) service: ServiceName,
    pub(crate) election: Election,
    pub(crate) settings: ReplicaSettings<S>,
    pub(crate) refusals: Refusals,
    started: Tick,
    /// The term that was last begun on this host.
    stored_term: u64,
    /// The newest output of the service that any reader had when this instance asked. Those who ask again may be answered
    /// by fewer: a reader that has restarted since remembers nothing.
    seen_by_readers: Option<Revision>,
    /// The highest term that another instance has said to have, or to have on its disk.
    terms_of_others: u64,
    /// Why this instance has begun without the state that it kept before; taken once it is reported.
    pub(crate) state_loss: Option<String>,
    revision: Revision,
    event_epoch: u64,
    counters: BTreeMap<&'static str, u64>,
}

impl<S: Settings> Replica<S> {
    /// An instance with what it kept. A stored term that is not believed is damage: it is dropped, and the
    /// settings stay.
    pub(crate) fn new(service: ServiceName, replication: Replication, start: Start<S>) -> Self {
        let kept = start.stored.term;
        let stored_term = if kept <= highest_term(start.now) { kept } else { 0 };
        let damage = (kept != stored_term).then(|| {
            let highest = highest_term(start.now);
            format!("the stored term {kept} is above {highest}, so the file is damaged")
        });
        let revision = Revision { term: stored_term, epoch: 0 };
        // A standby that never led has settings of its leader, and no term.
        let is_of_leader = |outcome: &CommandOutcome| outcome.header.revision.term > 0;
        let has_some =
            !start.stored.patch.is_empty() || start.stored.commands.iter().any(is_of_leader);
        let are_settings_known = !start.stored.lacks_settings && (stored_term > 0 || has_some);
        // What works for itself may store nothing for a long time.
        let is_empty = kept == 0 && replication == Replication::OneLeads;
        let counters =
            is_empty.then_some((StatusGauge::StateEmpty.as_str(), 1)).into_iter().collect();
        Self {
            space: KeySpace::new(start.fleet),
            service,
            election: Election::new(start.instance, start.now, replication),
            settings: ReplicaSettings::new(
                start.settings,
                &start.stored.patch,
                &start.stored.changed,
                are_settings_known.then_some(stored_term),
                latest_date(start.now),
            ),
            refusals: Refusals::default(),
            started: start.now,
            stored_term,
            seen_by_readers: None,
            terms_of_others: 0,
            state_loss: damage,
            revision,
            event_epoch: 0,
            counters,
        }
    }

    pub(crate) fn fleet(&self) -> &FleetId {
        self.space.fleet()
    }

    /// The revision of the last output.
    pub(crate) fn revision(&self) -> Revision {
        self.revision
    }

    /// The revision of the next output.
    pub(crate) fn next_revision(&mut self) -> Revision {
        self.revision.epoch = self.revision.epoch.saturating_add(1);
        self.revision
    }

    /// Readers answer with outputs of the service. Returns the newest revision that any had, now or before.
    pub(crate) fn note_seen(
        &mut self,
        outputs: impl Iterator<Item = Revision>,
    ) -> Option<Revision> {
        self.seen_by_readers = self.seen_by_readers.into_iter().chain(outputs).max();
        self.seen_by_readers
    }

    /// An instance has answered with its settings, and says its term, or which one it has stored if it has none: no other one may
    /// have received it of a leader that was lost at once.
    pub(crate) fn note_term_of_other(&mut self, now: Tick, announced: &AnnouncedSettings) {
        let Revision { term, epoch: stored } = announced.header.revision;
        let term = if term == 0 { stored } else { term };
        if self.believes(now, term) {
            self.terms_of_others = self.terms_of_others.max(term);
        }
    }

    /// Whether a term is believed: one above the bound was forged, or its sender's clock is far off.
    pub(crate) fn believes(&self, now: Tick, term: u64) -> bool {
        term <= highest_term(now)
    }

    /// Begins a term above every believed term that was seen on the bus or held on this host. An instance
    /// that has stored none begins at the seconds of the clock at least, so that it cannot fall behind what
    /// it published before its state was lost. One that has stored a term counts on from there: another
    /// one with a later state then notices that it knows less, and takes over.
    pub(crate) fn begin_term(&mut self, now: Tick, seen: Option<Revision>) {
        let believed = seen.map(|revision| revision.term).filter(|term| self.believes(now, *term));
        let of_others = self.terms_of_others.max(self.election.highest_term());
        let known = believed.unwrap_or(0).max(self.stored_term).max(of_others);
        let term = known.saturating_add(1);
        let term = if self.stored_term == 0 { term.max(clock_term(now)) } else { term };
        if self.election.highest_term() > 0 {
            self.settings.succeed();
        }
        self.revision = Revision { term, epoch: 0 };
        self.event_epoch = 0;
        self.stored_term = self.revision.term;
        self.election.lead(now);
    }

    /// What is kept over a restart, without the commands.
    pub(crate) fn stored(&self) -> Stored {
        Stored {
            term: self.stored_term,
            patch: self.settings.patch(),
            changed: self.settings.dates(),
            lacks_settings: !self.settings.are_known(),
            commands: Vec::new(),
        }
    }

    /// The lease renewal that a leader publishes.
    pub(crate) fn renewal(&self, now: Tick) -> Message {
        Message::LeaseRenewal(Box::new(LeaseRenewal {
            header: self.own_header(now, self.revision),
            service: self.service,
            instance: self.election.instance().clone(),
        }))
    }

    /// The settings in force. Those of an instance without a term, or of one that leads without state,
    /// have no term, so that no other instance takes them over. Their epoch is the term that is stored here.
    pub(crate) fn settings_message(&self, now: Tick) -> Message {
        let counts = self.election.has_term() && self.settings.are_known();
        let without_term = Revision { term: 0, epoch: self.stored_term };
        let revision = if counts { self.revision } else { without_term };
        Message::Settings(Box::new(AnnouncedSettings {
            header: self.own_header(now, revision),
            service: self.service,
            settings: self.settings.to_json(),
            changed: self.settings.dates_in_force(),
        }))
    }

    /// The next event of the term.
    pub(crate) fn event(&mut self, now: Tick, severity: Severity, kind: EventKind) -> Message {
        self.event_epoch = self.event_epoch.saturating_add(1);
        let revision = Revision { term: self.revision.term, epoch: self.event_epoch };
        let header = self.own_header(now, revision);
        Message::Event(Event { header, source: self.service, severity, kind })
    }

    /// What a robot learns of its refused messages, with the next number of the events.
    pub(crate) fn refused(
        &mut self,
        now: Tick,
        robot: RobotId,
        key: String,
        reason: String,
        count: u64,
    ) -> Message {
        self.event_epoch = self.event_epoch.saturating_add(1);
        let revision = Revision { term: self.revision.term, epoch: self.event_epoch };
        let header = self.own_header(now, revision);
        Message::Refused(Box::new(Refused { header, robot, key, reason, count }))
    }

    /// The header of what the service publishes of itself, with no robot's data behind it.
    pub(crate) fn own_header(&self, now: Tick, revision: Revision) -> Header {
        Header {
            fleet: self.fleet().clone(),
            revision,
            oldest: None,
            newest: None,
            stages: vec![self.stage(now, now)],
        }
    }

    /// The stage of this service for a header.
    pub(crate) fn stage(&self, received: Tick, published: Tick) -> StageTime {
        StageTime { stage: self.service, received, published }
    }

    /// Adds to a counter.
    pub(crate) fn add(&mut self, counter: &'static str, count: u64) {
        let counter = self.counters.entry(counter).or_default();
        *counter = counter.saturating_add(count);
    }

    /// Says how things are.
    pub(crate) fn set(&mut self, gauge: StatusGauge, value: u64) {
        if value == 0 {
            self.counters.remove(gauge.as_str());
        } else {
            self.counters.insert(gauge.as_str(), value);
        }
    }

    /// Whether this host has stored no term.
    pub(crate) fn has_no_stored_term(&self) -> bool {
        self.stored_term == 0
    }

    /// What the service reports of itself, with a text that says what it is doing.
    pub(crate) fn status(&self, now: Tick, state: String) -> ServiceStatus {
        let counters = self.counters.iter().map(|(name, count)| ((*name).to_owned(), *count));
        let standing = self.election.state();
        ServiceStatus {
            fleet: self.fleet().clone(),
            service: self.service,
            instance: self.election.instance().clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            started: self.started,
            now,
            standing,
            revision: self.election.followed().unwrap_or(self.revision),
            state: if standing == ReplicaState::Standby { "standby".to_owned() } else { state },
            counters: counters.collect(),
            departed: Vec::new(),
        }
    }
}
