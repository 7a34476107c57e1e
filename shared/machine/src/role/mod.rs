//! What all cores share: the term that they hold, the settings, events, and counters.

mod attend;
mod offenders;
mod settings;

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::event::{Event as FleetEvent, EventKind, Severity};
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, RobotId, ServiceName};
use muster_model::role::{Claim, Standing};
use muster_model::settings::Settings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::{KeySpace, Message, Pattern};

pub use self::attend::Turn;
use self::offenders::Offender;
pub use self::settings::Answered;
use self::settings::{difference, restore};
use crate::core::{Effect, Effects, Start, Stored};
use crate::tenure::Tenure;

/// The number of the fetch that every core makes as it starts: its own last output and what it reads.
pub const START_FETCH: u32 = 0;

/// The number of the fetch by which [`Role::advance`] looks after its own last output.
pub const TERM_FETCH: u32 = u32::MAX;

/// How often a holder looks whether its readers have seen a higher revision than its own, which is
/// so when its start could not ask them: they would drop all that it says. As often it announces its
/// settings again: an instance that missed a change would bring the old ones back as it takes over.
const TERM_CHECK: Duration = Duration::from_secs(5);

/// How soon it looks again when they have. Another holder that lives goes on meanwhile, and is left
/// alone.
const TERM_CHECK_AGAIN: Duration = Duration::from_secs(1);

/// An instance of a service: where it stands towards the role, its place among the outputs, its
/// settings.
#[derive(Debug, Clone)]
pub struct Role<S> {
    space: KeySpace,
    service: ServiceName,
    tenure: Tenure,
    started: Tick,
    revision: Revision,
    event_epoch: u64,
    base: S,
    settings: S,
    stored: Stored,
    dropped: Vec<String>,
    /// The place of the announcement that the settings are from: one before it is not gone back to.
    adopted: Revision,
    /// The fetches of a holder in doubt that are under way.
    doubts: u32,
    /// Whether the bus was asked and has not answered yet.
    asking: bool,
    /// Whether the next asking is that of an instance that had its turn to take over.
    waited: bool,
    /// Whether the answers are there with which the term is to begin.
    beginning: bool,
    /// A revision of another instance in the same term, to be passed.
    raise: Option<Revision>,
    check_at: Option<Tick>,
    higher: Option<Revision>,
    counters: BTreeMap<&'static str, u64>,
    offenders: BTreeMap<(Option<RobotId>, String), Offender>,
}

impl<S: Settings> Role<S> {
    /// A holder that has not begun its term. Stored fields that do not fit the settings any more are
    /// dropped, and told of once the term begins; a service with an old state starts all the same.
    #[must_use]
    pub fn new(service: ServiceName, start: Start<S>) -> Self {
        let mut stored = start.stored;
        let (settings, dropped) = restore(&start.settings, &stored.patch);
        stored.patch = difference(&start.settings, &settings);
        let revision = Revision { term: stored.term, epoch: 0 };
        Self {
            space: KeySpace::new(start.fleet),
            service,
            tenure: Tenure::new(start.instance, start.now),
            started: start.now,
            revision,
            event_epoch: 0,
            base: start.settings,
            settings,
            stored,
            dropped,
            adopted: revision,
            doubts: 0,
            asking: false,
            waited: false,
            beginning: false,
            raise: None,
            check_at: None,
            higher: None,
            counters: BTreeMap::new(),
            offenders: BTreeMap::new(),
        }
    }

    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> &S {
        &self.settings
    }

    /// The fleet.
    #[must_use]
    pub fn fleet(&self) -> &FleetId {
        self.space.fleet()
    }

    /// The key space of the fleet.
    #[must_use]
    pub fn space(&self) -> &KeySpace {
        &self.space
    }

    /// The last output's place.
    #[must_use]
    pub fn revision(&self) -> Revision {
        self.revision
    }

    /// Where the instance stands towards the role.
    #[must_use]
    pub fn standing(&self) -> Standing {
        self.tenure.standing()
    }

    /// Whether the instance holds the role beyond doubt, so that outputs are published.
    #[must_use]
    pub fn is_holding(&self) -> bool {
        self.standing() == Standing::Holding
    }

    /// Begins a term above every term that was seen on the bus or held on this host.
    pub fn begin_term<J>(&mut self, now: Tick, seen: Option<Revision>, effects: &mut Effects<J>) {
        let seen = seen.map_or(0, |revision| revision.term);
        let seen = seen.max(self.stored.term).max(self.tenure.highest_claimed());
        self.revision = Revision { term: seen.saturating_add(1), epoch: 0 };
        self.event_epoch = 0;
        self.stored.term = self.revision.term;
        self.tenure.begun(now);
        self.beginning = false;
        self.waited = false;
        self.raise = None;
        self.check_at = Some(now.after(TERM_CHECK));
        self.higher = None;
        effects.push(Effect::Store(self.stored.clone()));
        let term = self.revision.term;
        self.tell(now, Severity::Info, EventKind::ServiceStarted { term }, effects);
        effects.publish(self.settings_message(now));
        for field in std::mem::take(&mut self.dropped) {
            self.tell(now, Severity::Warning, EventKind::SettingDropped { field }, effects);
        }
    }

    /// Claims the role when it is time. Looks after the own last output on the bus and announces the
    /// settings when that is time, or at once after a lost link or a doubt: what was announced in it
    /// nobody has heard.
    pub fn advance<J>(&mut self, now: Tick, own: Pattern, effects: &mut Effects<J>) {
        if self.tenure.claims(now) {
            effects.publish(self.claim(now));
        }
        if self.is_holding() && self.check_at.is_some_and(|at| at <= now) {
            self.check_at = Some(now.after(TERM_CHECK));
            effects.push(Effect::Fetch { fetch: TERM_FETCH, patterns: vec![own] });
            effects.publish(self.settings_message(now));
        }
    }

    /// The link is back: others may have taken the role meanwhile.
    pub fn link_restored(&mut self, now: Tick) {
        if self.check_at.is_some() {
            self.check_at = Some(now);
        }
    }

    /// Takes in what [`TERM_FETCH`] has found. True if a new term has begun, because readers have
    /// seen a revision above the own one from nobody who still goes on: everything is to be
    /// published anew.
    #[must_use]
    pub fn checked<J>(&mut self, now: Tick, found: &[Message], effects: &mut Effects<J>) -> bool {
        if let Some(revision) = self.raise.take() {
            self.begin_term(now, Some(revision), effects);
            return true;
        }
        let revisions = found.iter().filter_map(|message| Some(message.header()?.revision));
        let higher = revisions.max().filter(|found| self.is_holding() && *found > self.revision);
        if higher.is_some() && higher == self.higher {
            self.begin_term(now, higher, effects);
            return true;
        }
        if higher.is_some() {
            self.check_at = Some(now.after(TERM_CHECK_AGAIN));
        }
        self.higher = higher;
        false
    }

    /// When [`Role::attend`] or [`Role::advance`] has something to do.
    #[must_use]
    pub fn deadline(&self) -> Option<Tick> {
        let check = self.check_at.filter(|_| self.is_holding());
        check.into_iter().chain(self.tenure.deadline()).min()
    }

    /// What the holder tells the other instances.
    fn claim(&self, now: Tick) -> Message {
        Message::Claim(Box::new(Claim {
            header: self.own_header(now, self.revision),
            service: self.service,
            instance: self.tenure.instance().clone(),
        }))
    }

    /// The place of the next output.
    pub fn next_revision(&mut self) -> Revision {
        self.revision.epoch = self.revision.epoch.saturating_add(1);
        self.revision
    }

    /// The stage of this service for a header.
    #[must_use]
    pub fn stage(&self, received: Tick, published: Tick) -> StageTime {
        StageTime { stage: self.service, received, published }
    }

    /// Counts something by a name.
    pub fn count(&mut self, name: &'static str) {
        self.count_many(name, 1);
    }

    /// Counts several of something by a name.
    pub fn count_many(&mut self, name: &'static str, many: u64) {
        let counter = self.counters.entry(name).or_default();
        *counter = counter.saturating_add(many);
    }

    /// Publishes an event; nothing before the term has begun.
    pub fn tell<J>(
        &mut self,
        now: Tick,
        severity: Severity,
        kind: EventKind,
        effects: &mut Effects<J>,
    ) {
        if !self.has_term() {
            return;
        }
        self.event_epoch = self.event_epoch.saturating_add(1);
        effects.publish(Message::Event(FleetEvent {
            header: self
                .own_header(now, Revision { term: self.revision.term, epoch: self.event_epoch }),
            source: self.service,
            severity,
            kind,
        }));
    }

    /// The head of what the service says of itself, with no robot's data behind it.
    fn own_header(&self, now: Tick, revision: Revision) -> Header {
        Header {
            fleet: self.fleet().clone(),
            revision,
            oldest: None,
            newest: None,
            stages: vec![self.stage(now, now)],
        }
    }

    /// What the service tells of itself.
    #[must_use]
    pub fn status(&self, now: Tick, state: &str) -> ServiceStatus {
        let counters = self.counters.iter().map(|(name, count)| ((*name).to_owned(), *count));
        ServiceStatus {
            fleet: self.fleet().clone(),
            service: self.service,
            instance: self.tenure.instance().clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            started: self.started,
            now,
            standing: self.standing(),
            revision: self.tenure.followed().unwrap_or(self.revision),
            state: if self.standing() == Standing::Standby {
                "stands by".to_owned()
            } else {
                state.to_owned()
            },
            counters: counters.collect(),
        }
    }

    /// Whether the instance has begun a term and not stood down since.
    #[must_use]
    pub fn has_term(&self) -> bool {
        matches!(self.standing(), Standing::Holding | Standing::Doubtful)
    }
}
