//! How a host answers gets: the schema, the leader, settings and status by itself, the rest by its core.

use muster_model::event::{EventKind, Severity};
use muster_model::role::ReplicaState;
use muster_model::term::date_of;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Outbound, Packet, Request, schema};

use super::Host;
use crate::core::{Context, Core, View};
use crate::facilities::ReplyKind;
use crate::gets::Get;
use crate::io::{Command, GetId, IncomingGet, Reply};
use crate::replica::settings::{Patched, problem_json};

impl<C: Core> Host<C> {
    pub(super) fn get(&mut self, incoming: IncomingGet) {
        self.confirm_leadership();
        let IncomingGet { get, selector, narrowed, parameters, payload } = incoming;
        let request = match Request::new(selector, &parameters, payload) {
            Ok(request) => request,
            Err(problem) => {
                let problem = problem.to_string();
                return self.answer_unopened(get, Err(problem_json("(parameters)", &problem)));
            }
        };
        let request = match narrowed {
            Some(served) => request.narrowed(served),
            None => request,
        };
        if request.exact_key(self.space()) == Some(Key::Schema) {
            let schema = Outbound::schema(schema::text()).into_packet(self.space());
            return self.answer_unopened(get, Ok(vec![schema]));
        }
        match self.facilities.gets.open(get, request) {
            Ok(get) => self.answer_opened(get),
            Err(problem) => self.answer_unopened(get, Err(problem)),
        }
    }

    /// Answers a get that asks for nothing of this instance's own.
    fn answer_unopened(&mut self, get: GetId, answer: Result<Vec<Packet>, String>) {
        let reply = Reply { get, answer, messages: Vec::new() };
        self.facilities.commands.push(Command::Reply(reply));
    }

    fn answer_opened(&mut self, get: Get) {
        let key = get.request.exact_key(self.space());
        if Self::changes_without_command(&get.request, key.as_ref()) {
            return self.refuse_change(get);
        }
        if let Some(get) = self.answer_commands(get) {
            self.answer(get);
        }
    }

    pub(super) fn answer(&mut self, get: Get) {
        let facilities = &mut self.facilities;
        let space = facilities.replica.space.clone();
        let selects = |key: &Key| get.request.selects(&space, key);
        if get.request.is_exact() && selects(&Key::Lease(C::SERVICE)) {
            let is_leading = facilities.replica.election.is_leading();
            let renewal = is_leading.then(|| facilities.replica.renewal(facilities.now));
            facilities.reply(get.id, Ok(renewal.into_iter().collect()), ReplyKind::Plain);
        } else if selects(&Key::Settings(C::SERVICE)) {
            self.answer_settings(get);
        } else if selects(&Key::Status(C::SERVICE)) {
            let mut status = self.status(self.facilities.now);
            let held = self.memory_use();
            let counts = [
                ("held_robots", held.robots),
                ("held_edges", held.edges),
                ("held_messages", held.messages),
            ];
            let counts = counts.map(|(name, count)| (name.to_owned(), count as u64));
            status.counters.extend(counts);
            status.counters.extend(self.process_counters.clone());
            let status = Message::Status(Box::new(status));
            Context::<C>(&mut self.facilities).reply(get, vec![status]);
        } else {
            self.core.on_get(&mut Context(&mut self.facilities), get);
        }
    }

    /// Answers a get of the settings; one that carries a command out has a payload, which changes them, as a whole or not
    /// at all.
    fn answer_settings(&mut self, get: Get) {
        let facilities = &mut self.facilities;
        if facilities.replica.election.state() == ReplicaState::Standby {
            // The leader answers; two answers to one change would be one too many.
            return Context::<C>(facilities).reply(get, Vec::new());
        }
        let Some(payload) = &get.request.payload else {
            let settings = facilities.replica.settings_message(facilities.now);
            return Context::<C>(facilities).reply(get, vec![settings]);
        };
        if !get.request.is_exact() {
            let problem = "settings are changed on exactly one key, without wildcards";
            return Context::<C>(facilities).reply_error(get, problem_json("(key)", problem));
        }
        let payload = payload.clone();
        let patched = match self.checked_settings(&payload) {
            Ok(patched) => patched,
            Err(problem) => {
                return Context::<C>(&mut self.facilities).reply_error(get, problem);
            }
        };
        let facilities = &mut self.facilities;
        let pending = facilities.operator_commands.pending(get.id);
        let sent = pending.as_ref().map(|pending| Tick::of_seconds(pending.command.sent));
        let sent = date_of(sent.unwrap_or(facilities.now));
        let change = facilities.replica.settings.change(&patched, sent);
        pending.into_iter().for_each(|pending| pending.changed = Some(change.clone()));
        // What came of a command is stored together with what it has changed.
        let settings = facilities.replica.settings_message(facilities.now);
        facilities.reply(get.id, Ok(vec![settings]), ReplyKind::ConfirmsStore);
        facilities.replica.add("settings_changed", 1);
        self.settings_changed();
    }

    /// The settings with a patch, if it makes sense and the core can work with it.
    fn checked_settings(&self, payload: &[u8]) -> Result<Patched<C::Settings>, String> {
        let facilities = &self.facilities;
        let patched = facilities.replica.settings.patched(payload)?;
        let checked = self.core.check_settings(&View(facilities), &patched.settings);
        checked.map_err(|error| problem_json(&error.field, &error.problem))?;
        Ok(patched)
    }

    /// Announces changed settings, and lets the core work with them.
    pub(super) fn settings_changed(&mut self) {
        let facilities = &mut self.facilities;
        if facilities.replica.election.has_term() {
            facilities.announce_settings();
            let settings = facilities.replica.settings.to_json();
            let kind = EventKind::SettingsChanged { settings };
            facilities.publish_operator_event(Severity::Info, kind);
        }
        // Without a term, the term will begin with an announcement.
        self.core.on_settings(&mut Context(&mut self.facilities));
    }
}
