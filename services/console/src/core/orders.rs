//! What browsers send: credits, views, commands, questions and proposals, and what came of them.

use muster_model::id::OperatorId;
use muster_model::time::Tick;
use muster_wire::message::plain_reason;
use serde_json::{Value, json};

use super::browser::Sort;
use super::limits::MAX_MESSAGE_BYTES;
use super::problem::Problem;
use super::request::{self, AskRequest, CommandRequest, ProposeRequest, Request};
use super::{BrowserId, Command, Console, Fetch, Output, Pending, Role, Ticket};

/// Why nothing is sent while no router is linked.
const UNLINKED: &str = "the link to the router is lost; nothing was sent";

/// What stands in the place of an answer for which a browser has no room.
const TOO_LONG: &str = "the answer is too long to be shown; ask for less";

/// The reply to a request of a browser: the answer, or the reason under the name of what may have come of it.
fn reply_text(request: u64, answer: &Result<Value, Problem>) -> String {
    let data = match answer {
        Ok(answer) => json!({"id": request, "answer": answer}),
        Err(problem) => json!({"id": request, (problem.kind.name()): problem.reason}),
    };
    json!({"topic": "reply", "data": data}).to_string()
}

impl Console {
    pub(super) fn receive(
        &mut self,
        now: Tick,
        id: BrowserId,
        text: &str,
        outputs: &mut Vec<Output>,
    ) {
        let Some(browser) = self.browsers.get_mut(&id) else { return };
        let refusal = if text.len() > MAX_MESSAGE_BYTES {
            Some("a message was too long")
        } else if !browser.may_send(now) {
            Some("too many messages")
        } else {
            None
        };
        if let Some(refusal) = refusal {
            self.close(id);
            return outputs.push(Output::Close(id, refusal));
        }
        match request::read(text) {
            Ok(Request::Credit(turn)) => browser.credit(turn),
            Ok(Request::View(view)) => {
                browser.view = view;
                browser.frames = (0, 0);
            }
            Ok(Request::Command(command)) => self.command(now, id, command, outputs),
            Ok(Request::Ask(ask)) => self.ask(now, id, &ask, outputs),
            Ok(Request::Propose(propose)) => self.propose(now, id, propose, outputs),
            Err(problem) => {
                // The page of this version sends nothing that cannot be read; whatever sent it learns what is wrong.
                let problem = plain_reason(&problem);
                let text = json!({"topic": "problem", "data": problem}).to_string();
                browser.reply(text.into());
            }
        }
    }

    /// Answers a browser; what does not fit into the room of its replies is replaced by a sentence.
    fn reply(&mut self, pending: &Pending, answer: &Result<Value, Problem>) {
        let Some(browser) = self.browsers.get_mut(&pending.browser) else { return };
        if browser.reply(reply_text(pending.id, answer).into()) {
            return;
        }
        let short = match answer {
            // What was carried out must not be shown as refused.
            Ok(_) if pending.is_command => Ok(Value::Null),
            Ok(_) => Err(Problem::refused(TOO_LONG)),
            Err(problem) => Err(Problem { kind: problem.kind, reason: TOO_LONG.to_owned() }),
        };
        browser.reply(reply_text(pending.id, &short).into());
    }

    /// Refuses a request of a browser, of which nothing was sent.
    fn refuse(&mut self, id: BrowserId, request: u64, reason: &str) {
        let Some(browser) = self.browsers.get_mut(&id) else { return };
        browser.reply(reply_text(request, &Err(Problem::refused(reason))).into());
    }

    fn command(
        &mut self,
        now: Tick,
        id: BrowserId,
        request: CommandRequest,
        outputs: &mut Vec<Output>,
    ) {
        let CommandRequest { id: number, service, based_on, action } = request;
        let refused = "a viewer cannot command; sign in with the token of an operator";
        let operator = match self.operator(now, id, refused) {
            Ok(operator) => operator,
            Err(refused) => return self.refuse(id, number, refused),
        };
        let ticket = self.ticket(id, number, Sort::Order, true);
        let command = Command { operator, service, action, based_on };
        outputs.push(Output::Command(ticket, command));
    }

    /// The operator of a browser, if another order of it may be sent.
    fn operator(
        &mut self,
        now: Tick,
        id: BrowserId,
        of_viewer: &'static str,
    ) -> Result<OperatorId, &'static str> {
        let Some(browser) = self.browsers.get_mut(&id) else { return Err(of_viewer) };
        let Role::Operator(operator) = browser.role.clone() else { return Err(of_viewer) };
        let quota = browser.quota(Sort::Order);
        if quota.is_full() {
            Err("too many commands wait for their answer")
        } else if !quota.take(now) {
            Err("too many commands within a minute; wait a moment")
        } else if !self.link {
            Err(UNLINKED)
        } else {
            Ok(operator)
        }
    }

    /// Asks for a proposal, or decides on one: in the name of the operator, as proposals are read under it.
    fn propose(
        &mut self,
        now: Tick,
        id: BrowserId,
        request: ProposeRequest,
        outputs: &mut Vec<Output>,
    ) {
        let refused = "a viewer cannot propose; sign in with the token of an operator";
        let (number, accepts) = (request.id, request.step.accepts());
        let order = self.operator(now, id, refused).map_err(str::to_owned);
        match order.and_then(|operator| request.order(operator)) {
            Ok(order) => {
                let ticket = self.ticket(id, number, Sort::Order, accepts);
                outputs.push(Output::Propose(ticket, order));
            }
            Err(problem) => self.refuse(id, number, &plain_reason(&problem)),
        }
    }

    fn ask(&mut self, now: Tick, id: BrowserId, ask: &AskRequest, outputs: &mut Vec<Output>) {
        let Some(browser) = self.browsers.get_mut(&id) else { return };
        let quota = browser.quota(Sort::Question);
        let question = if quota.is_full() {
            Err("too many questions wait for their answer".to_owned())
        } else if !quota.take(now) {
            Err("too many questions within a minute; wait a moment".to_owned())
        } else {
            ask.question()
        };
        match question {
            Ok(question) => {
                let ticket = self.ticket(id, ask.id, Sort::Question, false);
                outputs.push(Output::Ask(ticket, question));
            }
            Err(problem) => self.refuse(id, ask.id, &plain_reason(&problem)),
        }
    }

    fn ticket(&mut self, browser: BrowserId, id: u64, sort: Sort, is_command: bool) -> Ticket {
        self.next_ticket += 1;
        self.pending.insert(self.next_ticket, Pending { browser, id, sort, is_command });
        if let Some(browser) = self.browsers.get_mut(&browser) {
            browser.quota(sort).begin();
        }
        self.next_ticket
    }

    pub(super) fn answer(&mut self, ticket: Ticket, answer: Result<Value, Problem>) {
        let Some(pending) = self.pending.remove(&ticket) else { return };
        if pending.is_command {
            self.fetches.soon(&[Fetch::Settings, Fetch::Wishes]);
        }
        if let Some(browser) = self.browsers.get_mut(&pending.browser) {
            browser.quota(pending.sort).end();
        }
        let plain =
            |Problem { kind, reason }: Problem| Problem { kind, reason: plain_reason(&reason) };
        self.reply(&pending, &answer.map_err(plain));
    }
}
