//! A host on a bench, for tests, fuzzing and experiments: time stands still unless it is moved, jobs
//! run at once unless they are held, and the bus holds what the caller answers.

use std::time::Duration;

use muster_model::event::EventKind;
use muster_model::id::{FleetId, InstanceId};
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::{Key, KeySpace, Message, Packet, Pattern, Rejection};
use serde_json::{Value, json};

use crate::core::Core;
use crate::host::Host;
use crate::io::{Arrival, Ask, Command, GetId, IncomingGet, Input, Reply};
use crate::start::{Start, Stored};
use crate::stopwatch::Stopwatch;

/// How long an instance repeats unanswered questions before it begins from nothing.
pub const START_RETRY_TIME: Duration = Duration::from_secs(2);

/// Most inputs that one call of a bench leads to; more are a loop.
const MAX_INPUTS_PER_CALL: usize = 100_000;

/// A host and everything that it wanted done.
pub struct Bench<C: Core> {
    /// The host.
    pub host: Host<C>,
    /// The moment of the bench.
    pub now: Tick,
    /// What was published, oldest first, but for `commanded`.
    pub published: Vec<Message>,
    /// What the host has published of commands, oldest first: outcomes, and their events.
    pub commanded: Vec<Message>,
    /// Questions that wait for [`Bench::answer`].
    pub asks: Vec<Ask>,
    /// What is kept over a restart.
    pub stored: Stored,
    /// What the core keeps over a restart, if it keeps anything.
    pub kept: Option<Vec<u8>>,
    /// Answers of gets, oldest first.
    pub replies: Vec<Reply>,
    /// Faults of the program: messages without a form on the bus.
    pub unencodable: Vec<String>,
    /// All other commands, oldest first: tokens, records, changes of the replica's state.
    pub others: Vec<Command>,
    /// Jobs wait in `job` instead of being run at once.
    pub hold_jobs: bool,
    /// State waits for [`Input::Stored`] or [`Input::Kept`], with its command in `others`, instead of being kept at once.
    pub hold_stores: bool,
    /// Queries for the current leader and the last commands wait in `asks`, instead of going unanswered at once.
    pub hold_leader_queries: bool,
    /// The job that waits.
    pub job: Option<C::Job>,
    /// How many jobs were run.
    pub jobs_run: usize,
    space: KeySpace,
    next_get: u64,
}

impl<C: Core> Bench<C> {
    /// A host to which nothing has happened.
    #[must_use]
    pub fn new(start: Start<C::Settings>) -> Self {
        let space = KeySpace::new(start.fleet.clone());
        Self {
            now: start.now,
            stored: start.stored.clone(),
            host: Host::new(start),
            published: Vec::new(),
            commanded: Vec::new(),
            asks: Vec::new(),
            kept: None,
            replies: Vec::new(),
            unencodable: Vec::new(),
            others: Vec::new(),
            hold_jobs: false,
            hold_stores: false,
            hold_leader_queries: false,
            job: None,
            jobs_run: 0,
            space,
            next_get: 0,
        }
    }

    /// A host of a fleet and instance that leads from a moment on, with answers of the bus. What it
    /// published on the way is there.
    #[must_use]
    pub fn leading(
        fleet: FleetId,
        instance: InstanceId,
        now: Tick,
        settings: C::Settings,
        answers: Vec<Message>,
    ) -> Self {
        let start = Start { fleet, instance, now, settings, stored: Stored::default() };
        let mut bench = Self::new(start);
        bench.start(answers);
        bench
    }

    /// Starts the instance so that its inquiry ends now, with these answers: it began to ask a moment
    /// before, since most of its questions are not answered.
    pub fn start(&mut self, answers: Vec<Message>) {
        let until = self.now;
        self.now = until.before(START_RETRY_TIME);
        self.input(Input::Started { linked: true });
        let mut answers = Some(answers);
        loop {
            for ask in std::mem::take(&mut self.asks) {
                let answers =
                    if self.now < until { Vec::new() } else { answers.take().unwrap_or_default() };
                self.answer(&ask, answers);
            }
            if self.now >= until && self.asks.is_empty() {
                break;
            }
            self.now = self.host.deadline().map_or(until, |due| due.min(until));
            self.input(Input::Timer);
        }
    }

    /// Answers one question. It need not be one of [`Bench::asks`] any more.
    pub fn answer(&mut self, ask: &Ask, answers: Vec<Message>) {
        let of_message = |message| Arrival::of_message(&self.space, message);
        let answers = answers.into_iter().map(of_message).collect();
        self.input(Input::Answered { ask: ask.ask, answers });
    }

    /// Answers all questions that wait: the first with these messages, the others with none.
    pub fn answer_all(&mut self, answers: Vec<Message>) {
        let asks = std::mem::take(&mut self.asks);
        self.answer_fetch(asks, answers);
    }

    /// The key expressions of the questions that wait.
    #[must_use]
    pub fn asked(&self) -> Vec<Pattern> {
        self.asks.iter().map(|ask| ask.pattern.clone()).collect()
    }

    /// Takes the questions that wait, those of one fetch together.
    pub fn take_fetches(&mut self) -> Vec<Vec<Ask>> {
        // The questions of a fetch are numbered in a row, after the fetch itself.
        let follows = |before: &Ask, next: &Ask| before.ask.0 + 1 == next.ask.0;
        std::mem::take(&mut self.asks).chunk_by(follows).map(<[Ask]>::to_vec).collect()
    }

    /// Answers the questions of one fetch: the first with these messages, the others with none.
    pub fn answer_fetch(&mut self, fetch: Vec<Ask>, answers: Vec<Message>) {
        let mut answers = Some(answers);
        for ask in fetch {
            self.answer(&ask, answers.take().unwrap_or_default());
        }
    }

    /// Answers the next question of the leader what readers have seen of its output. Time passes until
    /// it is asked.
    ///
    /// # Panics
    /// If it is not asked within ten seconds.
    pub fn answer_term_check(&mut self, seen: Vec<Message>) {
        let of_output = |ask: &Ask| ask.pattern == Pattern::One(C::output());
        for _ in 0..100 {
            if let Some(at) = self.asks.iter().position(of_output) {
                let ask = self.asks.remove(at);
                return self.answer(&ask, seen);
            }
            self.wait(0.1);
        }
        assert!(self.asks.iter().any(of_output), "the readers are not asked");
    }

    /// A message arrives.
    pub fn receive(&mut self, message: Message) {
        self.input(Input::Arrived(Arrival::of_message(&self.space, message)));
    }

    /// A packet arrives.
    pub fn receive_packet(&mut self, packet: Packet) {
        self.input(Input::Arrived(Arrival::decoded(&self.space, packet)));
    }

    /// A refused packet arrives.
    pub fn receive_refused(&mut self, rejection: Rejection) {
        self.input(Input::Arrived(Arrival::of_rejection(rejection)));
    }

    /// Hands an input to the host and carries out what follows.
    ///
    /// # Panics
    /// If the host starts a second job while one runs, or inputs follow each other without end.
    pub fn input(&mut self, input: Input) {
        let mut inputs = std::collections::VecDeque::from([input]);
        for _ in 0..MAX_INPUTS_PER_CALL {
            let Some(input) = inputs.pop_front() else { return };
            for command in self.host.handle(self.now, input) {
                match command {
                    Command::Publish(publication) => {
                        let of_command = publication.message.as_ref().is_some_and(is_of_command);
                        let list =
                            if of_command { &mut self.commanded } else { &mut self.published };
                        list.extend(publication.message);
                    }
                    Command::Reply(reply) => self.replies.push(reply),
                    Command::RunJob => {
                        assert!(self.job.is_none(), "one job at a time");
                        self.job = self.host.take_job();
                    }
                    Command::Ask(ask)
                        if !self.hold_leader_queries && is_of_host::<C>(&ask.pattern) =>
                    {
                        inputs.push_back(Input::Answered { ask: ask.ask, answers: Vec::new() });
                    }
                    Command::Ask(ask) => self.asks.push(ask),
                    Command::Store(stored) if !self.hold_stores => {
                        self.stored = stored;
                        inputs.push_back(Input::Stored { error: None });
                    }
                    Command::Keep(content) if !self.hold_stores => {
                        self.kept = Some(content);
                        inputs.push_back(Input::Kept { error: None });
                    }
                    Command::Unencodable(problem) => self.unencodable.push(problem),
                    other => self.others.push(other),
                }
            }
            if !self.hold_jobs
                && let Some(job) = self.job.take()
            {
                inputs.push_back(self.finish(job));
            }
        }
        assert!(inputs.is_empty(), "inputs follow each other without end");
    }

    fn finish(&mut self, job: C::Job) -> Input {
        self.jobs_run += 1;
        self.host.finish_job(C::run(job, &mut Stopwatch::still()));
        Input::JobEnded { laps: Vec::new(), panic: None }
    }

    /// Runs the job that waits, and those that follow unless they are held.
    pub fn run_job(&mut self) {
        if let Some(job) = self.job.take() {
            let ended = self.finish(job);
            self.input(ended);
        }
    }

    /// The job that waits panics.
    pub fn panic_job(&mut self, text: &str) {
        self.job = None;
        self.input(Input::JobEnded { laps: Vec::new(), panic: Some(text.to_owned()) });
    }

    /// Lets time pass, with a timer whenever the host wants one. The process runs all the while.
    pub fn wait(&mut self, seconds: f64) {
        let until = self.now.after(Duration::from_secs_f64(seconds));
        for _ in 0..MAX_INPUTS_PER_CALL {
            let Some(due) = self.host.deadline().filter(|due| *due <= until) else { break };
            self.now = self.now.max(due);
            self.input(Input::Timer);
        }
        let due = self.host.deadline();
        assert!(due.is_none_or(|due| due > until), "woken again and again, and does nothing");
        self.now = until;
    }

    /// Gets a key of the fleet, which is written without the prefix that all keys have. A payload for settings, a wish or
    /// the alerts goes in a command of its own, and what is returned is what its key answers.
    ///
    /// # Errors
    /// The error text that the get is answered with.
    ///
    /// # Panics
    /// If the get is not answered exactly once.
    pub fn get(&mut self, selector: &str, payload: Option<&str>) -> Result<Vec<Message>, String> {
        let (selector, parameters) = selector.split_once('?').unwrap_or((selector, ""));
        self.next_get += 1;
        let id = format!("c{}", self.next_get);
        let command = payload.and_then(|payload| command_of(self.now, selector, &id, payload));
        let (selector, payload) = match &command {
            Some((key, command)) => (key.as_str(), Some(command.as_str())),
            None => (selector, payload),
        };
        let get = GetId(self.next_get);
        let before = self.replies.len();
        self.input(Input::Get(IncomingGet {
            get,
            selector: format!("muster/v1/{}/{selector}", self.space.fleet()),
            narrowed: None,
            parameters: parameters.to_owned(),
            payload: payload.map(|text| text.as_bytes().to_vec()),
        }));
        let answered = self.replies.len() - before;
        assert_eq!(answered, 1, "exactly one answer to {selector}");
        let reply = self.replies.remove(before);
        assert_eq!(reply.get, get, "the answer is to another get");
        reply.answer.map(|_| reply.messages)
    }

    /// The status of the service.
    #[must_use]
    pub fn status(&self) -> ServiceStatus {
        self.host.status(self.now)
    }

    /// One counter of the status; 0 if it was never counted.
    #[must_use]
    pub fn counter(&self, name: &str) -> u64 {
        self.status().counters.get(name).copied().unwrap_or(0)
    }

    /// The keys of the fleet.
    #[must_use]
    pub fn space(&self) -> &KeySpace {
        &self.space
    }
}

/// Whether a message is about a command.
fn is_of_command(message: &Message) -> bool {
    match message {
        Message::Outcome(_) => true,
        Message::Event(event) => matches!(event.kind, EventKind::Commanded { .. }),
        _ => false,
    }
}

/// Whether a question is the host's own.
fn is_of_host<C: Core>(pattern: &Pattern) -> bool {
    *pattern == Pattern::One(Key::Lease(C::SERVICE)) || *pattern == Pattern::Commands(C::SERVICE)
}

/// How long the commands of tests are valid, in seconds.
const COMMAND_VALID_S: f64 = 60.0;

/// The key and the payload of the command that does what a payload on another key is about; none if nothing does, or the
/// payload is none that a command could carry.
#[must_use]
pub fn command_of(now: Tick, selector: &str, id: &str, payload: &str) -> Option<(String, String)> {
    let value: Value = serde_json::from_str(payload).ok()?;
    let chunks: Vec<&str> = selector.split('/').collect();
    let (service, operator, action) = match chunks[..] {
        ["service", service, "settings"] => (service, "operator", json!({ "set": value })),
        ["wish", operator, id] if value.is_null() => {
            ("clusterer", operator, json!({"withdraw": {"id": id}}))
        }
        ["wish", operator, id] => {
            ("clusterer", operator, json!({"wish": {"id": id, "wish": value}}))
        }
        ["alerts"] => {
            let operator = value.get("operator")?.as_str()?;
            return Some((
                format!("command/auditor/{operator}/{id}"),
                sent(now, &json!({"acknowledge": {"alert": value.get("alert")?}})),
            ));
        }
        _ => return None,
    };
    Some((format!("command/{service}/{operator}/{id}"), sent(now, &action)))
}

/// A command that is sent now.
fn sent(now: Tick, action: &Value) -> String {
    let now = now.as_seconds();
    json!({"sent": now, "expires": now + COMMAND_VALID_S, "action": action}).to_string()
}
