//! How a host carries out commands: each once, by the get that does the same.

use std::sync::Arc;

use muster_model::command::{CommandOutcome, OperatorCommand};
use muster_model::event::{EventKind, Severity};
use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_model::settings::Settings;
use muster_model::wish::MAX_EXPIRY_S;
use muster_wire::command::{STARTING, carried_out_by, decode, remembered};
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::json::{Problem, ProblemCode};
use muster_wire::{Key, Message, Packet, Request};

use super::Host;
use crate::commands::{Admission, CommandName, Pending};
use crate::core::{Context, Core};
use crate::facilities::{Facilities, ReplyKind};
use crate::gets::{Get, encode_answer};
use crate::replica::settings::{Merging, problem_json};
use crate::wiring::Replication;

/// The action, as JSON, of a command that could not be decoded or was not looked at.
const UNKNOWN_ACTION: &str = "null";

/// What is answered to a change that is no command.
const NO_COMMAND: &str =
    "is changed by commands: get command/{service}/{operator}/{id} with the command as payload";

impl<C: Core> Host<C> {
    /// Answers a get of commands; one with a payload is a command. Returns the get if it is none of them.
    pub(super) fn answer_commands(&mut self, get: Get) -> Option<Get> {
        let space = self.facilities.replica.space.clone();
        let key = get.request.exact_key(&space);
        if get.request.payload.is_some() {
            return match key {
                Some(Key::Command(service, operator, id)) if service == C::SERVICE => {
                    self.command(get, (operator, id));
                    None
                }
                // A get of many keys that a queryable of commands was reached by.
                None if get.request.names_commands(&space) => {
                    let problem = "must name one command, without wildcards";
                    let problem = problem_json("(key)", problem);
                    Context::<C>(&mut self.facilities).reply_error(get, problem);
                    None
                }
                _ => Some(get),
            };
        }
        let commands = &self.facilities.operator_commands;
        let selected: Vec<Message> = commands
            .outcomes()
            .map(|outcome| Message::Outcome(Arc::clone(outcome)))
            .filter(|message| get.request.selects(&space, &message.keys().0))
            .collect();
        let is_of_commands = matches!(key, Some(Key::Command(..))) || !selected.is_empty();
        if !is_of_commands {
            return Some(get);
        }
        // The leader answers for all instances.
        let is_standby = self.facilities.replica.election.state() == ReplicaState::Standby;
        let answer = if is_standby { Vec::new() } else { selected };
        Context::<C>(&mut self.facilities).reply(get, answer);
        None
    }

    /// Whether a get changes something without being a command.
    pub(super) fn changes_without_command(request: &Request, key: Option<&Key>) -> bool {
        let is_changed = match key {
            Some(Key::Settings(service)) => *service == C::SERVICE,
            Some(Key::Wish(..)) => C::SERVICE == ServiceName::Clusterer,
            Some(Key::Alerts) => C::SERVICE == ServiceName::Auditor,
            _ => false,
        };
        is_changed && request.payload.is_some()
    }

    /// Refuses such a get.
    pub(super) fn refuse_change(&mut self, get: Get) {
        Context::<C>(&mut self.facilities).reply_error(get, problem_json("(key)", NO_COMMAND));
    }

    /// Remembers what another instance has answered to a command, so that it is not carried out again here, and
    /// so that a change that was confirmed is not lost with that instance.
    pub(super) fn learn_outcome(&mut self, outcome: Arc<CommandOutcome>) {
        let facilities = &mut self.facilities;
        let has_term = facilities.replica.election.has_term();
        // Where every instance leads, each carries commands out itself.
        if has_term && C::REPLICATION == Replication::EveryInstance {
            return;
        }
        if outcome.refused.is_some() {
            // The operator has that answer: a copy of the command that arrives late must not be carried out after it. It has changed
            // nothing, and any number of such may come: it is not worth a write.
            if !has_term || outcome.header.revision.term <= facilities.replica.revision().term {
                facilities.operator_commands.remember(outcome);
            }
            return;
        }
        let merging = match &outcome.changed {
            Some(change) => facilities.replica.settings.merge_change(change),
            // Whether a leader has what else another one has carried out, its core knows.
            None if has_term => return,
            None => Merging::Known,
        };
        let is_new = facilities.operator_commands.remember(outcome);
        if merging != Merging::Known {
            self.settings_merged(merging);
        } else if is_new {
            facilities.store();
        }
    }

    /// Settings were received that have later changes than this instance had.
    ///
    /// The core is not asked: the other instance has asked its own, and what may speak against a change passes. An instance
    /// that begins may not know yet what robots can do, for example, so that no need could be filled.
    pub(super) fn settings_merged(&mut self, merging: Merging) {
        let replica = &mut self.facilities.replica;
        if replica.election.has_term() {
            // Whoever has said them says them again until they are announced.
            replica.settings.repeat_announcement();
            if merging == Merging::Changed {
                replica.add("settings_recovered", 1);
                self.settings_changed();
            }
        }
        self.facilities.store();
    }

    /// Says the changes again that the leader does not have, as far as it has announced: what came of the commands, if that is
    /// remembered. There is no more to say than one for each field, so that a forged announcement draws no more than that either.
    pub(super) fn say_changes_since(&mut self, announced: &AnnouncedSettings) {
        let facilities = &mut self.facilities;
        let missing = facilities.replica.settings.changed_since(announced);
        if missing.is_empty() {
            return;
        }
        let is_missing = |outcome: &&Arc<CommandOutcome>| {
            let changed = outcome.changed.as_ref();
            changed.is_some_and(|changed| missing.values().any(|missing| *missing == changed.at))
        };
        let said: Vec<_> = facilities
            .operator_commands
            .outcomes()
            .filter(is_missing)
            .take(missing.len())
            .cloned()
            .collect();
        for outcome in said {
            facilities.publish(Message::Outcome(outcome));
        }
    }

    fn command(&mut self, get: Get, name: CommandName) {
        if self.facilities.replica.election.state() == ReplicaState::Standby {
            // The leader answers.
            return Context::<C>(&mut self.facilities).reply(get, Vec::new());
        }
        match self.begin_command(&get, name) {
            // The get goes on as the one that does the same.
            Ok(request) => self.answer(Get { id: get.id, request }),
            Err(NotBegun::Refused(problem)) => {
                Context::<C>(&mut self.facilities).reply_error(get, problem);
            }
            Err(NotBegun::Known(outcome)) => self.facilities.reply_again(get, &outcome),
        }
    }

    /// Checks a command and begins it. Returns the request that carries it out.
    fn begin_command(&mut self, get: &Get, name: CommandName) -> Result<Request, NotBegun> {
        let facilities = &mut self.facilities;
        let refused = |problem: Problem<'_>| Err(NotBegun::Refused(problem.to_json()));
        if !facilities.replica.election.has_term() {
            return refused(Problem::unavailable("(command)", STARTING));
        }
        match facilities.operator_commands.admit(facilities.now, &name) {
            Admission::New => {}
            Admission::Known(outcome) => return Err(NotBegun::Known(outcome)),
            Admission::Pending => {
                let problem = "is being carried out; ask again in a moment";
                return refused(Problem::unavailable("(command)", problem));
            }
            Admission::Full => {
                let problem = "too many commands within ten minutes; wait a while";
                let problem = Problem::unavailable("(command)", problem).to_json();
                let refusal = Refusal { command: None, problem, may_be_repeated: true };
                return Err(NotBegun::Refused(facilities.report_refusal(&name, refusal).1));
            }
        }
        let payload = get.request.payload.clone().unwrap_or_default();
        let command = match decode(&payload) {
            Ok(command) => command,
            Err(error) => {
                let problem = problem_json(&error.field, &error.problem);
                let refusal = Refusal { command: None, problem, may_be_repeated: false };
                return Err(NotBegun::Refused(facilities.refuse_command(&name, refusal)));
            }
        };
        let term = facilities.replica.revision().term;
        if let Err(wrong) = command.check(C::SERVICE, facilities.now, term) {
            let may_be_repeated = wrong.passes();
            let code =
                if may_be_repeated { ProblemCode::Unavailable } else { ProblemCode::Refused };
            let problem = Problem::with_code(code, wrong.field, &wrong.problem).to_json();
            let refusal = Refusal { command: Some(&command), problem, may_be_repeated };
            return Err(NotBegun::Refused(facilities.refuse_command(&name, refusal)));
        }
        let (key, payload) = carried_out_by(C::SERVICE, &name.0, &command.action);
        let text = facilities.replica.space.format(&key);
        let Ok(request) = Request::new(text, "format=json", Some(payload)) else {
            return refused(Problem::new("(command)", "has no form on the bus"));
        };
        facilities.gets.exchange(get.id, request.clone());
        facilities.replica.add("commands", 1);
        let pending = Pending { name, command, request: get.request.clone(), changed: None };
        facilities.operator_commands.begin(get.id, pending);
        Ok(request)
    }
}

/// Why a command does not begin.
enum NotBegun {
    /// It is refused.
    Refused(String),
    /// It was given before.
    Known(Arc<CommandOutcome>),
}

/// A command that is refused before it begins.
struct Refusal<'a> {
    /// What was commanded; none where that is not known.
    command: Option<&'a OperatorCommand>,
    /// Why, as JSON.
    problem: String,
    /// Whether the same id may be sent again.
    may_be_repeated: bool,
}

impl<S: Settings, F: Copy + Eq, J> Facilities<S, F, J> {
    /// The event of a command.
    fn report_command(&mut self, name: &CommandName, action: String, refused: Option<&str>) {
        let kind = EventKind::Commanded {
            operator: name.0.clone(),
            command: name.1.clone(),
            action,
            refused: refused.map(str::to_owned),
        };
        let severity = if refused.is_some() { Severity::Warning } else { Severity::Info };
        self.publish_operator_event(severity, kind);
    }

    /// Publishes to operators and standbys that a command is refused before it begins. Returns the outcome and the
    /// problem.
    fn report_refusal(
        &mut self,
        name: &CommandName,
        refusal: Refusal<'_>,
    ) -> (Arc<CommandOutcome>, String) {
        let Refusal { command, problem, may_be_repeated } = refusal;
        let action = command.map_or_else(|| UNKNOWN_ACTION.to_owned(), action_text);
        let outcome = Arc::new(CommandOutcome {
            header: self.replica.own_header(self.now, self.replica.revision()),
            service: self.replica.service,
            operator: name.0.clone(),
            id: name.1.clone(),
            // What the operator sent may be no time at all.
            expires: command.map_or(0.0, |command| command.expires.clamp(0.0, MAX_EXPIRY_S)),
            based_on: command.and_then(|command| command.based_on),
            action: action.clone(),
            refused: remembered(&problem).or_else(|| Some(problem_json("(command)", "is refused"))),
            answer: None,
            may_be_repeated,
            changed: None,
        });
        self.publish_outcome(&outcome);
        self.replica.add("commands_refused", 1);
        self.report_command(name, action, Some(&problem));
        (outcome, problem)
    }

    /// Refuses a command before it begins, and remembers that. It is on the disk with the next one that is carried out.
    /// Returns the problem.
    fn refuse_command(&mut self, name: &CommandName, refusal: Refusal<'_>) -> String {
        let (outcome, problem) = self.report_refusal(name, refusal);
        self.operator_commands.remember(outcome);
        problem
    }

    /// Answers a command that was given before as it was answered then, but for what was not on the disk then, or is
    /// not now.
    fn reply_again(&mut self, get: Get, outcome: &Arc<CommandOutcome>) {
        self.replica.add("commands_again", 1);
        if let Some(problem) = &outcome.refused {
            return self.reply(get.id, Err(problem.clone()), ReplyKind::Plain);
        }
        if self.store_again_at.is_some() {
            self.store();
        }
        let answer = vec![Message::Outcome(Arc::clone(outcome))];
        self.reply(get.id, Ok(answer), ReplyKind::ConfirmsStore);
    }

    /// Remembers what came of a command, tells standbys and operators, and returns what is answered.
    pub(crate) fn end_command(
        &mut self,
        pending: Pending,
        answer: Result<Vec<Packet>, String>,
    ) -> Result<Vec<Packet>, String> {
        let Pending { name, command, request, changed } = pending;
        if !self.replica.election.has_term() {
            // Another instance leads by now, and knows nothing of it.
            return answer;
        }
        let packet = answer.as_ref().ok().and_then(|packets| packets.first());
        let text = packet.and_then(|packet| packet.payload.as_ref().ok());
        let text = text.and_then(|bytes| std::str::from_utf8(bytes).ok());
        let outcome = Arc::new(CommandOutcome {
            header: self.replica.own_header(self.now, self.replica.revision()),
            service: self.replica.service,
            operator: name.0.clone(),
            id: name.1.clone(),
            expires: command.expires,
            based_on: command.based_on,
            action: action_text(&command),
            refused: answer.as_ref().err().map(|problem| {
                remembered(problem).unwrap_or_else(|| problem_json("(command)", "is refused"))
            }),
            answer: text.and_then(remembered),
            may_be_repeated: false,
            changed: changed
                .filter(|changed| answer.is_ok() && remembered(&changed.fields).is_some()),
        });
        self.operator_commands.remember(Arc::clone(&outcome));
        self.store();
        self.publish_outcome(&outcome);
        self.report_command(&name, outcome.action.clone(), outcome.refused.as_deref());
        answer?;
        let space = &self.replica.space;
        encode_answer(space, &request, &[Message::Outcome(outcome)], self.now)
    }
}

/// What was commanded, as JSON; its name alone if it is long.
fn action_text(command: &OperatorCommand) -> String {
    let text = serde_json::to_string(&command.action).ok();
    let text = text.as_deref().and_then(remembered);
    text.unwrap_or_else(|| format!("\"{}\"", command.action.name()))
}
