//! The settings in force: what file and flags say, what operators have changed, and what a standby
//! adopts from its leader.

use std::collections::BTreeMap;

use muster_model::command::SettingsChange;
use muster_model::header::Revision;
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::envelope::{AnnouncedSettings, MAX_SMALL_PAYLOAD};
use muster_wire::json::Problem;
use muster_wire::message::quoted;
use serde_json::{Map, Value};

use super::changes::Changes;
use super::lease::RENEWAL_INTERVAL;

/// Largest patch of settings in bytes.
const MAX_PATCH_BYTES: usize = MAX_SMALL_PAYLOAD;

/// How many of its next lease renewals a leader sends together with its settings, after a change and after it has begun. One
/// announcement may be lost, and the leader right after it: the standby would then lead with the old settings. A leader
/// that stands down for a new one receives the announcement of that before it follows it. Three more within 1.5 s are
/// rarely all lost, and a leader is rarely lost so soon.
const REPEATED_ANNOUNCEMENTS: u8 = 3;

/// How often a standby asks one leader for its settings, with the interval of renewals in between: by then the leader
/// announces them by itself.
const MAX_QUERIES: u8 = 10;

/// The settings of one instance.
#[derive(Debug)]
pub(crate) struct ReplicaSettings<S> {
    /// By defaults, file, environment and flags.
    base: S,
    current: S,
    /// What makes `current` of `base`: what operators have changed, and what the leader has by its own file and flags.
    changes: Changes,
    /// Stored fields that do not fit the settings any more.
    dropped: Vec<String>,
    /// The term of the leader whose announcement the rest of the settings is from. They do not change within a term.
    adopted: u64,
    /// Whether the settings are those that the fleet had, as far as this instance can know: it had stored
    /// some, has adopted them, or an operator has changed them since.
    are_known: bool,
    /// An announcement of a higher term than that of the followed leader: a new leader's, if its renewal
    /// follows, else forged.
    of_next_leader: Option<AnnouncedSettings>,
    /// How many lease renewals are still to be followed by an announcement.
    announcements_left: u8,
    /// Whether a leader was received that has no settings of the fleet either.
    are_lost: bool,
    /// What a standby asks its leader.
    queries: Queries,
    /// Whether the settings are those from the disk still. Which leaders they had followed is not known then.
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
    /// It is older than what is in force, and has no later change.
    Old,
    /// It does not fit this program.
    Misfit,
    /// Its sender has no term, and may know less than this instance. It has no later change.
    WithoutTerm,
    /// It is not of the leader that this instance follows. It waits for the renewal of a new one.
    NotLeaders,
}

/// What became of changes that were received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Merging {
    /// There is nothing in them that was not known, or is later than what was.
    Known,
    /// They are kept, and the settings in force are the same.
    Unchanged,
    /// The settings in force have changed.
    Changed,
}

impl<S: Settings> ReplicaSettings<S> {
    /// The settings with the stored patch and the dates of its changes, which are those of the fleet in the term `known` (none if they were never known).
    /// No date after `latest` is believed. Fields that do not fit are dropped: a service with an old state starts all the same.
    pub(crate) fn new(
        base: S,
        patch: &Map<String, Value>,
        changed: &BTreeMap<String, Tick>,
        known: Option<u64>,
        latest: Tick,
    ) -> Self {
        let mut changes = Changes::stored::<S>(patch, changed, latest);
        let current = changes.applied_to(&base);
        let dropped = changes.drop_misfits::<S>().iter().map(|path| quoted(path)).collect();
        Self {
            base,
            current,
            changes,
            dropped,
            adopted: known.unwrap_or_default(),
            are_known: known.is_some(),
            of_next_leader: None,
            announcements_left: 0,
            are_lost: false,
            queries: Queries::default(),
            are_from_disk: true,
        }
    }

    pub(crate) fn current(&self) -> &S {
        &self.current
    }

    /// What a restart must restore: the fields in which the settings differ from file and flags, and all that operators have changed.
    pub(crate) fn patch(&self) -> Map<String, Value> {
        self.changes.patch()
    }

    /// When operators have changed them.
    pub(crate) fn dates(&self) -> BTreeMap<String, Tick> {
        self.changes.dates()
    }

    /// The same of the changes that are in force, which are announced.
    pub(crate) fn dates_in_force(&self) -> BTreeMap<String, Tick> {
        self.changes.dates_in_force()
    }

    /// The names of stored fields that did not fit; given once.
    pub(crate) fn take_dropped(&mut self) -> Vec<String> {
        std::mem::take(&mut self.dropped)
    }

    /// The settings as JSON.
    pub(crate) fn to_json(&self) -> String {
        serde_json::to_string(&self.current).unwrap_or_default()
    }

    /// An instance that stood down after this term goes by announcements from then on.
    pub(crate) fn stood_down(&mut self, term: u64) {
        self.adopted = term;
        self.are_from_disk = false;
        self.of_next_leader = None;
        self.announcements_left = 0;
        self.are_lost = false;
        self.queries = Queries::default();
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
        if self.adopted >= leader.term || self.are_lost {
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

    /// The term of the leader that the settings are from.
    pub(crate) fn adopted(&self) -> u64 {
        self.adopted
    }

    /// The settings with a patch, which holds as a whole or not at all.
    ///
    /// # Errors
    /// The JSON text of a [`Problem`] that names the field and the remedy.
    pub(crate) fn patched(&self, payload: &[u8]) -> Result<Patched<S>, String> {
        if payload.len() > MAX_PATCH_BYTES {
            let problem = format!("may have at most {MAX_PATCH_BYTES} bytes");
            return Err(problem_json("(patch)", &problem));
        }
        let patch: Value = serde_json::from_slice(payload)
            .map_err(|error| problem_json("(patch)", &format!("is no JSON: {error}")))?;
        let patched = self.current.patched(&patch);
        let settings = patched.map_err(|error| problem_json(&error.field, &error.problem))?;
        let Value::Object(patch) = patch else {
            return Err(problem_json("(patch)", "is no object"));
        };
        Ok(Patched { patch, settings })
    }

    /// An operator has changed the settings by a command that was sent at a moment. Returns the change.
    pub(crate) fn change(&mut self, patched: &Patched<S>, sent: Tick) -> SettingsChange {
        let change = self.changes.command(&patched.patch, &patched.settings, sent);
        self.current = self.changes.applied_to(&self.base);
        self.are_known = true;
        self.repeat_announcement();
        change
    }

    /// Receives what an operator has changed at another instance.
    pub(crate) fn merge_change(&mut self, change: &SettingsChange) -> Merging {
        let is_new = self.changes.merge_change::<S>(change);
        self.merged(is_new)
    }

    /// Receives the changes in settings that another instance has announced.
    pub(crate) fn merge_announced(&mut self, announced: &AnnouncedSettings) -> Merging {
        let is_new = self
            .read(announced)
            .is_some_and(|theirs| self.merge_fields(announced, &theirs.fields()));
        self.merged(is_new)
    }

    fn read(&self, announced: &AnnouncedSettings) -> Option<S> {
        let read = serde_json::from_str(&announced.settings).ok()?;
        self.current.patched(&read).ok()
    }

    fn merge_fields(
        &mut self,
        announced: &AnnouncedSettings,
        theirs: &BTreeMap<String, Value>,
    ) -> bool {
        announced.changed.iter().fold(false, |is_new, (path, at)| {
            let value = theirs.get(path);
            value.is_some_and(|value| self.changes.merge(path, *at, value)) || is_new
        })
    }

    fn merged(&mut self, is_new: bool) -> Merging {
        if !is_new {
            return Merging::Known;
        }
        let settings = self.changes.applied_to(&self.base);
        let is_same = settings == self.current;
        self.current = settings;
        if is_same { Merging::Unchanged } else { Merging::Changed }
    }

    /// The changes in force that another instance has not announced, or dates before.
    pub(crate) fn changed_since(&self, announced: &AnnouncedSettings) -> BTreeMap<String, Tick> {
        let mut dates = self.changes.dates_in_force();
        dates.retain(|path, at| announced.changed.get(path).is_none_or(|theirs| theirs < at));
        dates
    }

    /// The settings are announced now, and with the next lease renewals.
    pub(crate) fn repeat_announcement(&mut self) {
        self.announcements_left = REPEATED_ANNOUNCEMENTS;
    }

    /// Whether the settings are announced again, now that the lease is renewed.
    pub(crate) fn are_announced_again(&mut self) -> bool {
        let is_due = self.announcements_left > 0;
        self.announcements_left = self.announcements_left.saturating_sub(1);
        is_due
    }

    /// Adopts the leader's settings, so that what an operator has changed outlives the leader: changes that are later than
    /// those that are known, and all that no operator has changed.
    /// Settings that do not fit this program are left where they are. What no operator has changed is not adopted of an older
    /// term than the one in force, unless the term in force is above the followed leader's own: then
    /// no leader published it. While a leader is followed, an announcement of a higher term waits for the
    /// renewal of that term: a forged one has none, and must not replace what an operator changed.
    pub(crate) fn adopt(
        &mut self,
        announced: &AnnouncedSettings,
        followed: Option<Revision>,
    ) -> Adoption {
        let revision = announced.header.revision;
        if followed.is_some_and(|leader| leader.term < revision.term) {
            self.of_next_leader = Some(announced.clone());
            return Adoption::NotLeaders;
        }
        let Some(theirs) = self.read(announced) else { return Adoption::Misfit };
        let theirs = theirs.fields();
        let is_new = self.merge_fields(announced, &theirs);
        if let Some(why) = self.is_not_followed(revision.term, followed) {
            let merging = self.merged(is_new);
            return if merging == Merging::Known { why } else { Adoption::Changed };
        }
        let before = self.changes.clone();
        let own = self.base.fields();
        for (path, value) in &theirs {
            if !announced.changed.contains_key(path) {
                self.changes.follow(path, Some(value).filter(|value| own.get(path) != Some(value)));
            }
        }
        self.current = self.changes.applied_to(&self.base);
        self.adopted = revision.term;
        self.are_from_disk = false;
        let were_known = std::mem::replace(&mut self.are_known, true);
        let is_same = !is_new && self.changes == before && were_known;
        if is_same { Adoption::Unchanged } else { Adoption::Changed }
    }

    /// Why what no operator has changed is not adopted; none if it is.
    fn is_not_followed(&self, term: u64, followed: Option<Revision>) -> Option<Adoption> {
        if term == 0 {
            return Some(Adoption::WithoutTerm);
        }
        // The term on the disk is one that was led, so that its settings are newer. Who has them takes over.
        let is_leaders = !self.are_from_disk && followed.is_some_and(|leader| leader.term == term);
        (term < self.adopted && !is_leaders).then_some(Adoption::Old)
    }

    /// The followed leader has renewed its lease. Returns the announcement that waited for that, if one
    /// did.
    pub(crate) fn renewed(&mut self, leader: Revision) -> Option<AnnouncedSettings> {
        self.of_next_leader.take_if(|waiting| waiting.header.revision.term <= leader.term)
    }
}

/// Settings that a patch leads to.
#[derive(Debug)]
pub(crate) struct Patched<S> {
    patch: Map<String, Value>,
    pub(crate) settings: S,
}

/// The JSON text of a problem with a field.
pub(crate) fn problem_json(field: &str, problem: &str) -> String {
    Problem::new(field, problem).to_json()
}
