//! Parameters that viewers ask for and change.

use muster_model::id::ServiceName;
use muster_model::time::Tick;
use muster_wire::message::plain_reason;
use serde_json::Value;

use super::limits::{MAX_PENDING_CHANGES, MAX_PENDING_QUESTIONS, PARAMETERS_WITHIN};
use super::parameters::Confirmed;
use super::{Access, Bridge, Output, Parameter, RequestId, Ticket};

/// Why nothing is changed by default.
const READ_ONLY: &str = "nothing was changed: viewers may only look; start muster-foxglove with --allow-changes, or use muster set";

/// Why nothing is commanded while no router is linked.
const UNLINKED: &str = "nothing was changed: the link to the router is lost";

/// A question for parameters that waits for the first settings.
#[derive(Debug)]
pub(super) struct Question {
    id: RequestId,
    names: Vec<String>,
    at: Tick,
}

/// A change that waits for its commands.
#[derive(Debug)]
pub(super) struct Change {
    names: Vec<String>,
    /// Commands without an answer.
    open: usize,
    problems: Vec<String>,
}

impl Bridge {
    pub(super) fn ask(
        &mut self,
        now: Tick,
        id: RequestId,
        names: Vec<String>,
        outputs: &mut Vec<Output>,
    ) {
        if self.confirmed.is_complete() || self.questions.len() >= MAX_PENDING_QUESTIONS {
            return outputs.push(Output::Respond(id, self.confirmed.some(&names)));
        }
        self.questions.push_back(Question { id, names, at: now });
    }

    /// Answers the questions that waited long enough, all of them once the settings are known.
    pub(super) fn answer_questions(&mut self, now: Tick, outputs: &mut Vec<Output>) {
        let is_complete = self.confirmed.is_complete();
        let is_due = |question: &Question| now.since(question.at) >= PARAMETERS_WITHIN;
        while self.questions.front().is_some_and(|question| is_complete || is_due(question)) {
            if let Some(Question { id, names, .. }) = self.questions.pop_front() {
                outputs.push(Output::Respond(id, self.confirmed.some(&names)));
            }
        }
    }

    /// Takes the settings of a service, and sends the parameters that are others than before.
    pub(super) fn confirm(
        &mut self,
        now: Tick,
        service: ServiceName,
        settings: Value,
        outputs: &mut Vec<Output>,
    ) {
        let changed = self.confirmed.confirm(service, settings);
        if !changed.is_empty() {
            outputs.push(Output::Publish(changed));
        }
        self.answer_questions(now, outputs);
    }

    pub(super) fn set(
        &mut self,
        id: RequestId,
        parameters: &[Parameter],
        outputs: &mut Vec<Output>,
    ) {
        let names: Vec<String> = parameters.iter().map(|one| one.name.clone()).collect();
        let patches = match &self.access {
            Access::ReadOnly => Err(READ_ONLY.to_owned()),
            Access::Changes(_) if !self.link => Err(UNLINKED.to_owned()),
            Access::Changes(_) if self.changes.len() >= MAX_PENDING_CHANGES => {
                Err("nothing was changed: too many changes wait for their answer".to_owned())
            }
            Access::Changes(operator) => {
                Confirmed::patches(parameters).map(|patches| (operator.clone(), patches))
            }
        };
        match patches {
            Ok((operator, patches)) if !patches.is_empty() => {
                let change = Change { names, open: patches.len(), problems: Vec::new() };
                self.changes.insert(id, change);
                for (service, patch) in patches {
                    self.next_ticket += 1;
                    self.commands.insert(self.next_ticket, (id, service));
                    let command =
                        Output::Command(self.next_ticket, operator.clone(), service, patch);
                    outputs.push(command);
                }
            }
            Ok(_) => self.end(id, &Change { names, open: 0, problems: Vec::new() }, outputs),
            Err(problem) => {
                self.end(id, &Change { names, open: 0, problems: vec![problem] }, outputs);
            }
        }
    }

    pub(super) fn answer(
        &mut self,
        now: Tick,
        ticket: Ticket,
        answer: Result<Value, String>,
        outputs: &mut Vec<Output>,
    ) {
        let Some((id, service)) = self.commands.remove(&ticket) else { return };
        // What was refused may have been changed by others meanwhile.
        self.fetches.settings_soon();
        let problem = match answer {
            Ok(settings) => {
                self.confirm(now, service, settings, outputs);
                None
            }
            Err(problem) => Some(plain_reason(&problem)),
        };
        let Some(change) = self.changes.get_mut(&id) else { return };
        change.problems.extend(problem);
        change.open = change.open.saturating_sub(1);
        if change.open == 0
            && let Some(change) = self.changes.remove(&id)
        {
            self.end(id, &change, outputs);
        }
    }

    /// Answers a change with what holds now, whether it was carried out or not, and says why not.
    fn end(&self, id: RequestId, change: &Change, outputs: &mut Vec<Output>) {
        let Change { names, problems, .. } = change;
        // No name would mean all parameters.
        let values = if names.is_empty() { Vec::new() } else { self.confirmed.some(names) };
        if !problems.is_empty() {
            outputs.push(Output::Refuse(id, problems.join("; ")));
            // A viewer shows what it has sent until it is sent something else.
            outputs.push(Output::Publish(values.clone()));
        }
        outputs.push(Output::Respond(id, values));
    }
}
