//! Settings that operators change while a service runs, and what a service answers of itself.

use muster_model::event::{EventKind, Severity};
use muster_model::header::Revision;
use muster_model::role::Standing;
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::envelope::{AnnouncedSettings, MAX_SMALL_PAYLOAD};
use muster_wire::json::Problem;
use muster_wire::{Key, Message, Request};
use serde_json::{Map, Value};

use super::Role;
use crate::core::{Effect, Effects, QueryId};

/// Largest patch of settings in bytes.
const MAX_PATCH: usize = MAX_SMALL_PAYLOAD;

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

impl<S: Settings> Role<S> {
    /// An instance that stands by takes the settings of the holder over, so that what an operator has
    /// changed outlives the holder. Settings that do not fit this program are left where they are, and
    /// so are those of an older place than the ones in force, unless these claim a later one than the
    /// holder that is followed itself: nobody stands behind them.
    pub(super) fn adopt<J>(&mut self, announced: &AnnouncedSettings, effects: &mut Effects<J>) {
        if matches!(self.standing(), Standing::Holding | Standing::Doubtful) {
            return;
        }
        let revision = announced.header.revision;
        if revision.term == 0 {
            // It has no term itself, and may know less than this one.
            return;
        }
        let is_holders = |holder: &Revision| holder.term == revision.term && *holder < self.adopted;
        if revision < self.adopted && !self.tenure.followed().as_ref().is_some_and(is_holders) {
            self.count("settings_old");
            return;
        }
        let told = serde_json::from_str(&announced.settings).ok();
        let Some(settings) = told.and_then(|told| self.settings.patched(&told).ok()) else {
            self.count("settings_not_adopted");
            return;
        };
        let patch = difference(&self.base, &settings);
        self.settings = settings;
        self.adopted = revision;
        if patch != self.stored.patch {
            self.stored.patch = patch;
            effects.push(Effect::Store(self.stored.clone()));
        }
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

    /// The settings in force. Those of an instance without a term stand at the first of all places, so
    /// that no other instance takes them over.
    pub(super) fn settings_message(&self, now: Tick) -> Message {
        let revision = if self.has_term() { self.revision } else { Revision::default() };
        Message::Settings(Box::new(AnnouncedSettings {
            header: self.own_header(now, revision),
            service: self.service,
            settings: self.settings_json(),
        }))
    }
}

fn error_json(field: &str, problem: &str) -> String {
    Problem::new(field, problem).to_json()
}

/// The settings with those fields of a stored patch that still fit, and the names of the others. The
/// whole patch is tried first, since fields may fit only together.
pub(super) fn restore<S: Settings>(base: &S, patch: &Map<String, Value>) -> (S, Vec<String>) {
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
pub(super) fn difference<S: Settings>(base: &S, settings: &S) -> Map<String, Value> {
    match (serde_json::to_value(base), serde_json::to_value(settings)) {
        (Ok(Value::Object(base)), Ok(Value::Object(settings))) => {
            settings.into_iter().filter(|(name, value)| base.get(name) != Some(value)).collect()
        }
        _ => Map::new(),
    }
}
