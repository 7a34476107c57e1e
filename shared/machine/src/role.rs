//! What all cores share: the term that they hold, the settings, events, and counters.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::event::{Event as FleetEvent, EventKind, Severity};
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, RobotId, ServiceName};
use muster_model::role::{Claim, Standing};
use muster_model::settings::Settings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::envelope::{AnnouncedSettings, MAX_SMALL_PAYLOAD};
use muster_wire::json::Problem;
use muster_wire::{Key, KeySpace, Message, Pattern, Rejection, Request};
use serde_json::{Map, Value};

use crate::core::{Effect, Effects, Event, QueryId, Start, Stored};
use crate::tenure::{Decision, Heard, Tenure};

/// The number of the fetch that every core makes as it starts: its own last output and what it reads.
pub const START_FETCH: u32 = 0;

/// The number of the fetch by which [`Role::advance`] looks after its own last output.
pub const TERM_FETCH: u32 = u32::MAX;

/// The number of the fetch by which an instance that stood by takes over: the same as
/// [`START_FETCH`] to its core, but nobody is waited for.
pub(crate) const TAKE_OVER_FETCH: u32 = u32::MAX - 2;

/// The number of the fetch by which a holder in doubt asks who holds.
const DOUBT_FETCH: u32 = u32::MAX - 3;

/// How often a holder looks whether its readers have seen a higher revision than its own, which is
/// so when its start could not ask them: they would drop all that it says.
const TERM_CHECK: Duration = Duration::from_secs(5);

/// How soon it looks again when they have. Another holder that lives goes on meanwhile, and is left
/// alone.
const TERM_CHECK_AGAIN: Duration = Duration::from_secs(1);

/// How long refused messages of one robot and key are only counted after one was told of: an
/// offender must not flood the event stream.
const QUARANTINE_SILENCE: Duration = Duration::from_secs(2);

/// How many robots and keys are watched for such repetition at once; beyond it, further offenders
/// are counted and not told of until others have been silent.
const MAX_OFFENDERS: usize = 256;

/// Largest patch of settings in bytes.
const MAX_PATCH: usize = MAX_SMALL_PAYLOAD;

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

#[derive(Debug, Clone)]
struct Offender {
    told: Tick,
    untold: u64,
}

impl<S: Settings> Role<S> {
    /// A holder that has not begun its term. Stored fields that do not fit the settings any more are
    /// dropped, and told of once the term begins; a service with an old state starts all the same.
    #[must_use]
    pub fn new(service: ServiceName, start: Start<S>) -> Self {
        let mut stored = start.stored;
        let (settings, dropped) = restore(&start.settings, &stored.patch);
        stored.patch = difference(&start.settings, &settings);
        Self {
            space: KeySpace::new(start.fleet),
            service,
            tenure: Tenure::new(start.instance, start.now),
            started: start.now,
            revision: Revision { term: stored.term, epoch: 0 },
            event_epoch: 0,
            base: start.settings,
            settings,
            stored,
            dropped,
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

    /// Whether the answers to what [`Role::ask`] asked are those with which the term is to begin.
    #[must_use]
    pub fn is_beginning(&self) -> bool {
        self.beginning
    }

    /// Asks the bus for what the role begins with: what the core wants, who holds, and with which
    /// settings. The answers come as [`START_FETCH`].
    pub fn ask<J>(&mut self, mut patterns: Vec<Pattern>, effects: &mut Effects<J>) {
        self.asking = true;
        let fetch = if self.waited { TAKE_OVER_FETCH } else { START_FETCH };
        patterns.extend([Key::Holder(self.service), Key::Settings(self.service)].map(Pattern::One));
        effects.push(Effect::Fetch { fetch, patterns });
    }

    /// Looks at an event before the core does. What concerns the role alone is kept back; an instance
    /// that is to take over or to begin again is handed [`Event::Started`].
    #[must_use]
    pub fn attend<D, J>(
        &mut self,
        now: Tick,
        event: Event<D>,
        effects: &mut Effects<J>,
    ) -> Turn<D> {
        let mut events = Vec::new();
        if self.tenure.attend(now) {
            self.tenure.doubt();
            if self.tenure.is_linked() {
                self.ask_holder(effects);
            }
            // Whoever waits for robots could not hear them.
            events.push(Event::LinkLost);
        }
        match event {
            Event::Received(Message::Claim(claim)) => {
                match self.tenure.hear(now, &claim, false, self.revision.term) {
                    Heard::Noted => {}
                    Heard::StandDown => return self.stand_down(),
                    Heard::Raise(revision) => {
                        self.raise = Some(revision);
                        events.push(Event::Fetched { fetch: TERM_FETCH, messages: Vec::new() });
                    }
                }
            }
            Event::Received(Message::ServiceToken { instance, alive, .. }) => {
                self.tenure.token(now, instance, alive);
            }
            Event::Received(Message::Settings(announced)) if announced.service == self.service => {
                self.adopt(&announced, effects);
            }
            Event::Fetched { fetch: DOUBT_FETCH, messages } => {
                if self.hear_answers(now, &messages) == Heard::StandDown {
                    return self.stand_down();
                }
                if self.tenure.is_linked() && self.standing() == Standing::Doubtful {
                    self.tenure.confirmed(now);
                    events.push(Event::LinkRestored);
                }
            }
            Event::Fetched { fetch: START_FETCH | TAKE_OVER_FETCH, messages }
                if self.asking && !self.is_holding() =>
            {
                self.asking = false;
                self.hear_answers(now, &messages);
                let (own, messages): (Vec<_>, Vec<_>) =
                    messages.into_iter().partition(|message| self.is_own(message));
                match self.tenure.decide(now, self.waited) {
                    Decision::Wait => return Turn::Events(events),
                    Decision::StandBy => {
                        for message in own {
                            if let Message::Settings(announced) = message {
                                self.adopt(&announced, effects);
                            }
                        }
                    }
                    Decision::Begin => self.beginning = true,
                }
                events.push(Event::Fetched { fetch: START_FETCH, messages });
            }
            Event::LinkLost => {
                self.tenure.link_lost();
                events.push(Event::LinkLost);
            }
            Event::LinkRestored => {
                self.tenure.link_restored(now);
                match self.standing() {
                    Standing::Doubtful => self.ask_holder(effects),
                    Standing::Starting if self.waited && !self.asking => {
                        self.tenure.stand_by();
                        events.push(Event::LinkRestored);
                    }
                    Standing::Starting if !self.asking => {
                        events.extend([Event::LinkRestored, Event::Started]);
                    }
                    _ => events.push(Event::LinkRestored),
                }
            }
            event => events.push(event),
        }
        if self.tenure.takes_over(now) {
            self.waited = true;
            events.push(Event::Started);
        }
        Turn::Events(events)
    }

    fn ask_holder<J>(&self, effects: &mut Effects<J>) {
        let patterns = vec![Pattern::One(Key::Holder(self.service))];
        effects.push(Effect::Fetch { fetch: DOUBT_FETCH, patterns });
    }

    /// Hears the claims among answers to a get.
    fn hear_answers(&mut self, now: Tick, messages: &[Message]) -> Heard {
        let mut heard = Heard::Noted;
        for message in messages {
            if let Message::Claim(claim) = message
                && claim.service == self.service
            {
                let this = self.tenure.hear(now, claim, true, self.revision.term);
                if this == Heard::StandDown {
                    heard = this;
                }
            }
        }
        heard
    }

    fn is_own(&self, message: &Message) -> bool {
        match message {
            Message::Claim(_) => true,
            Message::Settings(announced) => announced.service == self.service,
            _ => false,
        }
    }

    fn stand_down<D>(&mut self) -> Turn<D> {
        self.tenure.restart();
        self.check_at = None;
        self.higher = None;
        self.raise = None;
        self.beginning = false;
        self.waited = false;
        Turn::StandDown
    }

    /// An instance that stands by takes the settings of the holder over, so that what an operator has
    /// changed outlives the holder. Settings that do not fit this program are left where they are.
    fn adopt<J>(&mut self, announced: &AnnouncedSettings, effects: &mut Effects<J>) {
        if matches!(self.standing(), Standing::Holding | Standing::Doubtful) {
            return;
        }
        let told = serde_json::from_str(&announced.settings).ok();
        let Some(settings) = told.and_then(|told| self.settings.patched(&told).ok()) else {
            self.count("settings_not_adopted");
            return;
        };
        let patch = difference(&self.base, &settings);
        self.settings = settings;
        if patch != self.stored.patch {
            self.stored.patch = patch;
            effects.push(Effect::Store(self.stored.clone()));
        }
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

    /// Claims the role when it is time, and looks after the own last output on the bus when it is time,
    /// or at once after a lost link.
    pub fn advance<J>(&mut self, now: Tick, own: Pattern, effects: &mut Effects<J>) {
        if self.tenure.claims(now) {
            effects.publish(self.claim(now));
        }
        if self.is_holding() && self.check_at.is_some_and(|at| at <= now) {
            self.check_at = Some(now.after(TERM_CHECK));
            effects.push(Effect::Fetch { fetch: TERM_FETCH, patterns: vec![own] });
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

    /// Refuses the content of a message, as [`Role::quarantine`] does.
    pub fn refuse<J>(&mut self, now: Tick, key: &Key, reason: &str, effects: &mut Effects<J>) {
        let rejection = Rejection::new(&self.space, &self.space.format(key), reason);
        self.quarantine(now, rejection, effects);
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

    /// Counts a refused message, and tells of it unless the term has not begun or its robot and key
    /// have just been told of.
    pub fn quarantine<J>(&mut self, now: Tick, rejection: Rejection, effects: &mut Effects<J>) {
        self.count("messages_refused");
        if !self.has_term() {
            return;
        }
        let Rejection { robot, key, reason } = rejection;
        let offence = (robot.clone(), key.clone());
        if let Some(offender) = self.offenders.get_mut(&offence) {
            offender.untold += 1;
            if now.since(offender.told) < QUARANTINE_SILENCE {
                return;
            }
        } else {
            if self.offenders.len() >= MAX_OFFENDERS {
                self.offenders.retain(|_, offender| now.since(offender.told) < QUARANTINE_SILENCE);
            }
            if self.offenders.len() >= MAX_OFFENDERS {
                return;
            }
            self.offenders.insert(offence.clone(), Offender { told: now, untold: 1 });
        }
        let Some(offender) = self.offenders.get_mut(&offence) else { return };
        offender.told = now;
        let count = std::mem::take(&mut offender.untold);
        let kind = EventKind::Quarantined { robot, key, reason, count };
        self.tell(now, Severity::Warning, kind, effects);
    }

    /// Answers gets of the settings and the status. A get with a payload changes the settings, as a
    /// whole or not at all; what is returned tells the core that they changed.
    ///
    /// Gets of other keys are handed back.
    pub fn answer<J>(
        &mut self,
        now: Tick,
        query: QueryId,
        request: Request,
        state: &str,
        effects: &mut Effects<J>,
    ) -> Answered {
        if request.selects(&self.space, &Key::Holder(self.service)) && request.is_exact() {
            let answer = if self.is_holding() { vec![self.claim(now)] } else { Vec::new() };
            effects.push(Effect::Reply { query, request, answer: Ok(answer) });
            return Answered::Done;
        }
        if request.selects(&self.space, &Key::Settings(self.service))
            && self.standing() == Standing::Standby
        {
            // The holder answers; two answers to one change would be one too many.
            effects.push(Effect::Reply { query, request, answer: Ok(Vec::new()) });
            return Answered::Done;
        }
        if request.selects(&self.space, &Key::Settings(self.service)) {
            let (answer, changed) = match &request.payload {
                None => (Ok(vec![self.settings_message(now)]), false),
                Some(_) if !request.is_exact() => {
                    let problem = "settings are changed on exactly one key, without wildcards";
                    (Err(error_json("(key)", problem)), false)
                }
                Some(payload) => match self.change_settings(payload) {
                    Ok(()) => (Ok(vec![self.settings_message(now)]), true),
                    Err(error) => (Err(error), false),
                },
            };
            if changed {
                // The shell stores before it answers: what is confirmed survives a crash.
                effects.push(Effect::Store(self.stored.clone()));
            }
            effects.push(Effect::Reply { query, request, answer });
            if changed {
                self.count("settings_changed");
                if !self.has_term() {
                    // The term begins with an announcement.
                    return Answered::SettingsChanged;
                }
                effects.publish(self.settings_message(now));
                let kind = EventKind::SettingsChanged { settings: self.settings_json() };
                self.tell(now, Severity::Info, kind, effects);
            }
            return if changed { Answered::SettingsChanged } else { Answered::Done };
        }
        if request.selects(&self.space, &Key::Status(self.service)) {
            let answer = Ok(vec![Message::Status(Box::new(self.status(now, state)))]);
            effects.push(Effect::Reply { query, request, answer });
            return Answered::Done;
        }
        Answered::NotOurs(query, request)
    }

    fn change_settings(&mut self, payload: &[u8]) -> Result<(), String> {
        if payload.len() > MAX_PATCH {
            return Err(error_json("(patch)", &format!("may have at most {MAX_PATCH} bytes")));
        }
        let patch: Value = serde_json::from_slice(payload)
            .map_err(|error| error_json("(patch)", &format!("is no JSON: {error}")))?;
        let settings = self
            .settings
            .patched(&patch)
            .map_err(|error| error_json(&error.field, &error.problem))?;
        self.stored.patch = difference(&self.base, &settings);
        self.settings = settings;
        Ok(())
    }

    fn settings_json(&self) -> String {
        serde_json::to_string(&self.settings).unwrap_or_default()
    }

    fn settings_message(&self, now: Tick) -> Message {
        Message::Settings(Box::new(AnnouncedSettings {
            header: self.own_header(now, self.revision),
            service: self.service,
            settings: self.settings_json(),
        }))
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

/// What the core has to do about an event.
#[derive(Debug)]
pub enum Turn<D> {
    /// To take these events in, in order.
    Events(Vec<Event<D>>),
    /// To forget what it has told, and to begin again with [`Event::Started`]: another instance holds
    /// the role.
    StandDown,
}

/// What became of a get.
#[derive(Debug)]
pub enum Answered {
    /// It is answered.
    Done,
    /// It is answered, and the settings are new.
    SettingsChanged,
    /// It is of another key and must be answered by the core.
    NotOurs(QueryId, Request),
}

fn error_json(field: &str, problem: &str) -> String {
    Problem::new(field, problem).to_json()
}

/// The settings with those fields of a stored patch that still fit, and the names of the others. The
/// whole patch is tried first, since fields may fit only together.
fn restore<S: Settings>(base: &S, patch: &Map<String, Value>) -> (S, Vec<String>) {
    if let Ok(settings) = base.patched(&Value::Object(patch.clone())) {
        return (settings, Vec::new());
    }
    let (mut settings, mut dropped) = (base.clone(), Vec::new());
    for (field, value) in patch {
        let one = Map::from_iter([(field.clone(), value.clone())]);
        match settings.patched(&Value::Object(one)) {
            Ok(patched) => settings = patched,
            Err(_) => dropped.push(muster_wire::message::quoted(field)),
        }
    }
    (settings, dropped)
}

/// The fields in which settings differ from what file and flags say: what a restart must restore.
fn difference<S: Settings>(base: &S, settings: &S) -> Map<String, Value> {
    match (serde_json::to_value(base), serde_json::to_value(settings)) {
        (Ok(Value::Object(base)), Ok(Value::Object(settings))) => {
            settings.into_iter().filter(|(name, value)| base.get(name) != Some(value)).collect()
        }
        _ => Map::new(),
    }
}
