//! The settings in force: what file and flags say, what operators have changed, and what a standby
//! adopts from its leader.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use muster_model::command::CommandOutcome;
use muster_model::header::Revision;
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::envelope::{AnnouncedSettings, MAX_SMALL_PAYLOAD};
use muster_wire::json::Problem;
use muster_wire::message::quoted;
use serde_json::{Map, Value};

use crate::commands::CommandName;

use super::lease::RENEWAL_INTERVAL;
use super::missed_changes::{
    ConfirmedBy, MissedChange, MissedChanges, OutcomeMoment, confirmed_patch,
};

/// Largest patch of settings in bytes.
const MAX_PATCH_BYTES: usize = MAX_SMALL_PAYLOAD;

/// How many of its next lease renewals a leader sends together with its settings, after a change and after it has begun. One
/// announcement may be lost, and the leader right after it: the standby would then lead with the old settings. A leader
/// that stands down for a new one receives the announcement of that before it follows it. Three more within 1.5 s are
/// rarely all lost, and a leader is rarely lost so soon.
const REPEATED_ANNOUNCEMENTS: u8 = 3;

/// After how many lease renewals below it in a row the revision in force counts as forged. One or two that
/// an announcement has overtaken are normal.
const RENEWALS_BELOW: u8 = 3;

/// How long an announcement of a revision may be on its way while a later one of the same revision is received. One that seems
/// older than that is of an instance whose clock goes behind.
const LONGEST_DELAY: Duration = Duration::from_secs(5);

/// How often a standby asks one leader for its settings, with the interval of renewals in between: by then the leader
/// announces them by itself.
const MAX_QUERIES: u8 = 10;

/// The settings of one instance.
#[derive(Debug)]
pub(crate) struct ReplicaSettings<S> {
    /// By defaults, file, environment and flags.
    base: S,
    current: S,
    /// The fields in which `current` differs from `base`: what a restart must restore.
    patch: Map<String, Value>,
    /// Stored fields that do not fit the settings any more.
    dropped: Vec<String>,
    /// The revision of the announcement that the settings are from; an older one is not adopted.
    adopted: Revision,
    /// When that was sent, by the clock of its sender. A leader that has published nothing changes its settings without a new
    /// revision, and its announcements may arrive in another order.
    adopted_sent: Tick,
    /// How many renewals of the leader in a row were below that.
    renewals_below: u8,
    /// Whether the settings are those that the fleet had, as far as this instance can know: it had stored
    /// some, has adopted them, or an operator has changed them since.
    are_known: bool,
    /// An announcement of a higher term than that of the followed leader: a new leader's, if its renewal
    /// follows, else forged.
    of_next_leader: Option<AnnouncedSettings>,
    /// How many lease renewals are still to be followed by an announcement.
    announcements_left: u8,
    /// With how many renewals of its leader a standby says again what it had confirmed when it led.
    confirmations_left: u8,
    /// Whether a leader was received that has no settings of the fleet either.
    are_lost: bool,
    /// What a standby asks its leader.
    queries: Queries,
    /// What a standby knows of changes that its leader has confirmed, and not announced as far as it has received.
    missed: MissedChanges,
    /// The values that each field is known to have had when this instance led last, or began.
    own_values: BTreeMap<String, Vec<Value>>,
    /// The revision of the settings of another leader that were adopted last: no change of a lower one is missing.
    basis: Revision,
    /// When those were sent, by the clock of that leader.
    basis_sent: Tick,
    /// What was confirmed up to then is in the settings that were on the disk, and what this instance had confirmed itself.
    stored_with: OutcomeMoment,
    /// Whether the settings are those from the disk still. Which leaders they had followed is not known then: a change that
    /// is newer than what they go on from counts, even if a leader of a lower term has confirmed it, which was cut off and
    /// was the only one afterwards.
    are_from_disk: bool,
}

/// The questions of a standby for the settings of its leader.
#[derive(Debug, Default)]
struct Queries {
    /// The term of that leader.
    term: u64,
    left: u8,
    next: Tick,
}

/// What became of an announcement of the leader's settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Adoption {
    /// It is in force now, and what is stored of the settings has changed.
    Changed,
    /// It is in force, and was before.
    Unchanged,
    /// It is older than what is in force.
    Old,
    /// It does not fit this program.
    Misfit,
    /// Its sender has no term, and may know less than this instance.
    WithoutTerm,
    /// It is not of the leader that this instance follows. It waits for the renewal of a new one.
    NotLeaders,
}

impl<S: Settings> ReplicaSettings<S> {
    /// The settings with the stored patch, which are those of the fleet at `known` (none if they were never known). They go on from
    /// those that another leader sent at `basis`. Where that is not known, they have what came of commands up to `newest`. Fields that do
    /// not fit are dropped: a service with an old state starts all the same.
    pub(crate) fn new(
        base: S,
        patch: &Map<String, Value>,
        known: Option<Revision>,
        basis: Option<OutcomeMoment>,
        newest: OutcomeMoment,
    ) -> Self {
        let (current, dropped) = restore(&base, patch);
        let patch = difference(&base, &current);
        Self {
            base,
            current,
            patch,
            dropped,
            adopted: known.unwrap_or_default(),
            adopted_sent: Tick::default(),
            renewals_below: 0,
            are_known: known.is_some(),
            of_next_leader: None,
            announcements_left: 0,
            confirmations_left: 0,
            are_lost: false,
            queries: Queries::default(),
            missed: MissedChanges::default(),
            own_values: BTreeMap::new(),
            basis: basis.map(|basis| basis.revision).or(known).unwrap_or_default(),
            basis_sent: basis.map(|basis| basis.confirmed).unwrap_or_default(),
            stored_with: basis.unwrap_or(newest),
            are_from_disk: true,
        }
    }

    pub(crate) fn current(&self) -> &S {
        &self.current
    }

    pub(crate) fn patch(&self) -> &Map<String, Value> {
        &self.patch
    }

    /// The names of stored fields that did not fit; given once.
    pub(crate) fn take_dropped(&mut self) -> Vec<String> {
        std::mem::take(&mut self.dropped)
    }

    /// The settings as JSON.
    pub(crate) fn to_json(&self) -> String {
        serde_json::to_string(&self.current).unwrap_or_default()
    }

    /// An instance that stood down goes by announcements from its own last output on, and by what it had confirmed.
    pub(crate) fn stood_down(&mut self, revision: Revision) {
        self.adopted = revision;
        self.adopted_sent = Tick::default();
        self.are_from_disk = false;
        self.renewals_below = 0;
        self.of_next_leader = None;
        self.announcements_left = 0;
        self.are_lost = false;
        self.queries = Queries::default();
        self.missed = MissedChanges::default();
    }

    /// What this instance had `confirmed` when it led last counts until a new leader announces it, or could long have received it, or
    /// has changed the same since. By what it remembers of commands it knows which values the fields had before.
    pub(crate) fn had_confirmed<'a>(
        &mut self,
        confirmed: &[Arc<CommandOutcome>],
        remembered: impl Iterator<Item = &'a Arc<CommandOutcome>>,
    ) {
        self.own_values.clear();
        let all = [serde_json::to_value(&self.base), serde_json::to_value(&self.current)];
        let all = all.into_iter().filter_map(|settings| match settings {
            Ok(Value::Object(settings)) => Some(settings),
            _ => None,
        });
        let patches = remembered.filter_map(|outcome| confirmed_patch(outcome));
        for (field, value) in all.chain(patches).flatten() {
            self.own_values.entry(field).or_default().push(value);
        }
        for outcome in confirmed {
            self.missed.note(outcome, ConfirmedBy::Own);
        }
        self.repeat_confirmations();
    }

    /// The revision of the settings of another leader that were adopted last, and when they were sent.
    pub(crate) fn basis(&self) -> (Revision, Tick) {
        (self.basis, self.basis_sent)
    }

    /// An instance that does not lead has received the outcome of a command. `followed` is the last output of its leader. If that is
    /// below the settings that this instance has, the leader is replaced in a moment, and its term is `replaced` from then on; what it
    /// confirms until then is newer all the same, and so may be what it knows of the leaders before it.
    pub(crate) fn note_outcome(
        &mut self,
        outcome: &CommandOutcome,
        followed: Option<Revision>,
        replaced: Option<u64>,
    ) {
        let revision = outcome.header.revision;
        let known = if self.are_from_disk { self.stored_with.revision } else { self.adopted };
        // Two instances may have begun the same term. What one has confirmed since its last output is in no settings of the other.
        let is_by_followed = followed.is_some_and(|leader| {
            let is_above = leader.term < known.term || leader <= revision;
            leader.term == revision.term && is_above
        });
        let is_by_replaced = replaced.is_some_and(|term| revision.term <= term);
        let is_new = OutcomeMoment::of(outcome) > self.known_since();
        let confirmed_by = match (is_by_followed, is_by_replaced) {
            (true, _) => ConfirmedBy::Followed,
            (false, true) => ConfirmedBy::Replaced,
            (false, false) => ConfirmedBy::Other,
        };
        if is_new || revision < known && confirmed_by != ConfirmedBy::Other {
            self.missed.note(outcome, confirmed_by);
        }
    }

    /// What other leaders had confirmed up to then is in the settings.
    fn known_since(&self) -> OutcomeMoment {
        let basis = OutcomeMoment { revision: self.basis, confirmed: self.basis_sent };
        if self.are_from_disk { self.stored_with } else { basis }
    }

    /// The commands whose changes the settings lack, and are to have once this instance leads.
    pub(crate) fn missed_commands(&self) -> impl Iterator<Item = &CommandName> {
        self.missed.all().filter(|(_, patch)| self.lacks(patch)).map(|(name, _)| name)
    }

    /// The changes that were confirmed after the settings that this instance has, the oldest first; they are given once.
    pub(crate) fn take_missed(&mut self) -> Vec<MissedChange> {
        self.missed.take_since(self.known_since())
    }

    /// What another leader has changed after the settings that this one, of term `term`, goes on from. None if it is in them, or
    /// changed nothing, or if that leader has a higher term. Two instances may have begun the same term.
    pub(crate) fn missed_by(
        &self,
        outcome: &CommandOutcome,
        term: u64,
    ) -> Option<Map<String, Value>> {
        let revision = outcome.header.revision;
        let is_missed = revision.term <= term
            && revision >= self.basis
            && OutcomeMoment::of(outcome) > self.stored_with;
        confirmed_patch(outcome).filter(|patch| is_missed && !has(&self.current, patch))
    }

    /// Whether an instance that leads with these settings may announce them as the fleet's.
    pub(crate) fn are_known(&self) -> bool {
        self.are_known
    }

    /// A leader has announced settings without a term: it has lost those of the fleet, or there never were any.
    pub(crate) fn note_loss(&mut self) {
        self.are_lost = true;
    }

    /// This instance leads after another one. Settings that it has adopted are those of the fleet, and so are its own where
    /// no instance has others. Those of a leader that it never received are not: an instance that has kept them takes over.
    pub(crate) fn succeed(&mut self) {
        self.are_known |= self.are_lost;
    }

    /// Whether a standby asks its leader now: the answer to its first question and the announcement of the term may both be
    /// lost, and the leader right after that.
    pub(crate) fn are_asked_for(&mut self, now: Tick, leader: Revision) -> bool {
        if self.adopted.term >= leader.term || self.are_lost {
            return false;
        }
        if self.queries.term != leader.term {
            // What it asked as it began may still be answered.
            let next = now.after(RENEWAL_INTERVAL);
            self.queries = Queries { term: leader.term, left: MAX_QUERIES, next };
        }
        let is_due = self.queries.left > 0 && now >= self.queries.next;
        if is_due {
            self.queries.left -= 1;
            self.queries.next = now.after(RENEWAL_INTERVAL);
        }
        is_due
    }

    /// Whether an announcement of the same revision was adopted that was sent after this answer, which may have waited for
    /// others for any time.
    pub(crate) fn were_adopted_after(&self, answer: &AnnouncedSettings) -> bool {
        answer.header.revision == self.adopted && sent(answer) < self.adopted_sent
    }

    /// The revision of the announcement that the settings are from.
    pub(crate) fn adopted(&self) -> Revision {
        self.adopted
    }

    /// The settings with a patch, which holds as a whole or not at all.
    ///
    /// # Errors
    /// The JSON text of a [`Problem`] that names the field and the remedy.
    pub(crate) fn changed(&self, payload: &[u8]) -> Result<S, String> {
        if payload.len() > MAX_PATCH_BYTES {
            let problem = format!("may have at most {MAX_PATCH_BYTES} bytes");
            return Err(problem_json("(patch)", &problem));
        }
        let patch: Value = serde_json::from_slice(payload)
            .map_err(|error| problem_json("(patch)", &format!("is no JSON: {error}")))?;
        let patched = self.current.patched(&patch);
        patched.map_err(|error| problem_json(&error.field, &error.problem))
    }

    /// An operator has changed the settings.
    pub(crate) fn change(&mut self, settings: S) {
        self.accept(settings);
        self.are_known = true;
        self.repeat_announcement();
    }

    /// The settings are announced now, and with the next lease renewals.
    pub(crate) fn repeat_announcement(&mut self) {
        self.announcements_left = REPEATED_ANNOUNCEMENTS;
    }

    /// What this instance had confirmed is said again with the next renewals of its leader: what it says once may be lost.
    pub(crate) fn repeat_confirmations(&mut self) {
        self.confirmations_left = REPEATED_ANNOUNCEMENTS;
    }

    /// Whether a patch would change anything.
    pub(crate) fn lacks(&self, patch: &Map<String, Value>) -> bool {
        !has(&self.current, patch)
    }

    /// Whether it is said again, now that the leader has renewed its lease.
    pub(crate) fn are_confirmations_said_again(&mut self) -> bool {
        let is_due = self.confirmations_left > 0;
        self.confirmations_left = self.confirmations_left.saturating_sub(1);
        is_due
    }

    /// Whether the settings are announced again, now that the lease is renewed.
    pub(crate) fn are_announced_again(&mut self) -> bool {
        let is_due = self.announcements_left > 0;
        self.announcements_left = self.announcements_left.saturating_sub(1);
        is_due
    }

    fn accept(&mut self, settings: S) {
        self.patch = difference(&self.base, &settings);
        self.current = settings;
    }

    /// Adopts the leader's settings, so that what an operator has changed outlives the leader.
    /// Settings that do not fit this program are left where they are, and so are those of an older
    /// revision than the ones in force, unless the term in force is above the followed leader's own: then
    /// no leader published it. While a leader is followed, an announcement of a higher term waits for the
    /// renewal of that term: a forged one has none, and must not replace what an operator changed.
    pub(crate) fn adopt(
        &mut self,
        announced: &AnnouncedSettings,
        followed: Option<Revision>,
    ) -> Adoption {
        let revision = announced.header.revision;
        if revision.term == 0 {
            return Adoption::WithoutTerm;
        }
        if followed.is_some_and(|leader| leader.term < revision.term) {
            self.of_next_leader = Some(announced.clone());
            return Adoption::NotLeaders;
        }
        // The term on the disk is one that was led, so that its settings are newer. Who has them takes over.
        let is_leaders = |leader: Revision| {
            leader.term == revision.term && leader.term < self.adopted.term && !self.are_from_disk
        };
        if revision < self.adopted && !followed.is_some_and(is_leaders) {
            return Adoption::Old;
        }
        let sent = sent(announced);
        let is_overtaken =
            sent < self.adopted_sent && self.adopted_sent.since(sent) < LONGEST_DELAY;
        if revision == self.adopted && is_overtaken {
            return Adoption::Old;
        }
        let read = serde_json::from_str(&announced.settings).ok();
        let Some(settings) = read.and_then(|read| self.current.patched(&read).ok()) else {
            return Adoption::Misfit;
        };
        let (before, were_known) = (self.patch.clone(), self.are_known);
        self.accept(settings);
        self.adopted = revision;
        (self.basis, self.basis_sent) = (revision, sent);
        self.adopted_sent = sent;
        self.are_from_disk = false;
        self.are_known = true;
        let current = &self.current;
        let are_own_said = self.confirmations_left > 0;
        let (values, own) = (serde_json::to_value(current).unwrap_or_default(), &self.own_values);
        let is_unknown = |field: &str| {
            own.get(field)
                .is_none_or(|own| values.get(field).is_some_and(|value| !own.contains(value)))
        };
        let moment = OutcomeMoment { revision, confirmed: sent };
        self.missed.adopted(moment, are_own_said, |patch| has(current, patch), is_unknown);
        let is_same = self.patch == before && were_known;
        if is_same { Adoption::Unchanged } else { Adoption::Changed }
    }
}

impl<S: Settings> ReplicaSettings<S> {
    /// The followed leader has renewed its lease. Returns the announcement that waited for that, if one
    /// did.
    pub(crate) fn renewed(&mut self, leader: Revision) -> Option<AnnouncedSettings> {
        let is_below = leader < self.adopted;
        self.renewals_below = if is_below { self.renewals_below.saturating_add(1) } else { 0 };
        if self.renewals_below >= RENEWALS_BELOW {
            self.adopted = leader;
            self.adopted_sent = Tick::default();
            self.renewals_below = 0;
            if self.basis > leader {
                (self.basis, self.basis_sent) = (leader, Tick::default());
            }
        }
        self.of_next_leader.take_if(|waiting| waiting.header.revision.term <= leader.term)
    }
}

/// When settings were announced or answered, by the clock of their sender.
fn sent(announced: &AnnouncedSettings) -> Tick {
    announced.header.stages.last().map(|stage| stage.published).unwrap_or_default()
}

/// Whether a patch would change nothing.
fn has<S: Settings>(settings: &S, patch: &Map<String, Value>) -> bool {
    let patched = settings.patched(&Value::Object(patch.clone()));
    patched.is_ok_and(|patched| difference(settings, &patched).is_empty())
}

/// The JSON text of a problem with a field.
pub(crate) fn problem_json(field: &str, problem: &str) -> String {
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
            Err(_) => dropped.push(quoted(field)),
        }
    }
    (settings, dropped)
}

/// The fields in which settings differ from the base.
fn difference<S: Settings>(base: &S, settings: &S) -> Map<String, Value> {
    match (serde_json::to_value(base), serde_json::to_value(settings)) {
        (Ok(Value::Object(base)), Ok(Value::Object(settings))) => {
            settings.into_iter().filter(|(name, value)| base.get(name) != Some(value)).collect()
        }
        _ => Map::new(),
    }
}
