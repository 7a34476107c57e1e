//! The core: everything that is decided about browsers, without sockets, clock or bus.

mod browser;
mod fetches;
mod fleet;
pub mod frame;
pub mod limits;
mod projection;
mod request;
mod topics;
mod turn;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::command::Action;
use muster_model::embedding::{Embedding, EmbeddingGraph};
use muster_model::event::Event;
use muster_model::graph::GraphDelta;
use muster_model::header::Revision;
use muster_model::id::{FleetId, Modality, OperatorId, RobotId, ServiceName};
use muster_model::roster::Roster;
use muster_model::status::ServiceStatus;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_model::wish::StandingWish;
use muster_wire::message::plain_reason;
use muster_wire::{Format, Key, Message};
use serde_json::{Map, Value, json};

use self::browser::Browser;
pub use self::browser::Role;
pub use self::fetches::Fetch;
use self::fetches::Fetches;
use self::fleet::Fleet;
use self::limits::{MAX_BROWSERS, MAX_EVENTS, MAX_MESSAGE_BYTES, MAX_PENDING};
use self::projection::Axes;
pub use self::request::Question;
use self::request::{AskRequest, CommandRequest, Request};
use self::topics::{Topic, Topics};
use self::turn::Cached;

/// Names a browser among all that were ever opened.
pub type BrowserId = u64;

/// Names a command or question until it is answered.
pub type Ticket = u64;

/// Why a message that services publish again and again may not be valid any more.
pub type Stale = Option<&'static str>;

/// What happens.
#[derive(Debug)]
pub enum Input {
    /// Time passes. It comes several times a second, whatever else happens.
    Tick,
    /// The link to the router is there, or is lost.
    Link(bool),
    /// The newest roster.
    Roster(Arc<Roster>, Stale),
    /// The newest division.
    Teams(Arc<Teams>, Stale),
    /// The newest audit.
    Audit(Arc<Audit>, Stale),
    /// The newest list of alerts.
    Alerts(Arc<Alerts>, Stale),
    /// Something happened in the fleet.
    Event(Box<Event>),
    /// The states of all instances of services.
    Statuses(Vec<ServiceStatus>),
    /// The settings of the services that answer.
    Settings(BTreeMap<ServiceName, Value>),
    /// All wishes.
    Wishes(Vec<StandingWish>),
    /// The newest embedding.
    Embedding(Arc<Embedding>),
    /// The newest snapshot of a graph.
    Graph(Arc<GraphDelta>),
    /// Nothing answered.
    Unfetched(Fetch),
    /// A browser has opened.
    Opened(BrowserId, Role),
    /// A browser sent a text.
    Text(BrowserId, String),
    /// A browser is gone.
    Closed(BrowserId),
    /// What came of a command or a question: the answer, or why there is none.
    Answer(Ticket, Result<Value, String>),
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Send a text to a browser.
    Text(BrowserId, Arc<str>),
    /// Send a frame to a browser.
    Frame(BrowserId, Arc<[u8]>),
    /// Close a browser, for this reason.
    Close(BrowserId, &'static str),
    /// Command a service.
    Command(Ticket, Command),
    /// Ask something.
    Ask(Ticket, Question),
    /// Ask for what all browsers are shown.
    Fetch(Fetch),
}

/// A command of an operator.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// Who commands.
    pub operator: OperatorId,
    /// Which service carries it out.
    pub service: ServiceName,
    /// What is commanded.
    pub action: Action,
    /// The division that the operator had seen.
    pub based_on: Option<Revision>,
}

/// A command or question that waits for its answer.
#[derive(Debug)]
struct Pending {
    browser: BrowserId,
    /// How the browser names it.
    id: u64,
    is_command: bool,
}

/// The console.
#[derive(Debug)]
pub struct Console {
    name: FleetId,
    version: &'static str,
    browsers: BTreeMap<BrowserId, Browser>,
    fleet: Fleet,
    link: bool,
    stale: BTreeMap<&'static str, Stale>,
    audit: Option<Arc<Audit>>,
    alerts: Option<Arc<Alerts>>,
    statuses: Vec<ServiceStatus>,
    settings: BTreeMap<ServiceName, Value>,
    wishes: Vec<StandingWish>,
    /// Events with their numbers, the newest last.
    events: VecDeque<(u64, Arc<Value>)>,
    axes: Axes,
    embedding: Vec<(RobotId, Option<[f64; 2]>)>,
    /// What the embedding was made of.
    weights: Vec<EmbeddingGraph>,
    graphs: BTreeMap<Modality, Arc<GraphDelta>>,
    topics: Topics,
    /// The list of the missing that the topic has.
    missing: Value,
    frames: Cached,
    fetches: Fetches,
    pending: BTreeMap<Ticket, Pending>,
    next_ticket: Ticket,
}

/// A message as it stands on the bus, in JSON; null if it cannot be written.
fn bus_json(message: &Message, key: Key, now: Tick) -> Value {
    let encoded = message.encode(key, Format::Json, now).ok();
    encoded.and_then(|encoded| serde_json::from_slice(&encoded.payload).ok()).unwrap_or_default()
}

impl Console {
    /// A console of a fleet, without browsers and without a link.
    #[must_use]
    pub fn new(name: FleetId, version: &'static str) -> Self {
        let mut topics = Topics::default();
        topics.change(Topic::Fleet);
        Self {
            name,
            version,
            browsers: BTreeMap::new(),
            fleet: Fleet::default(),
            link: false,
            stale: BTreeMap::new(),
            audit: None,
            alerts: None,
            statuses: Vec::new(),
            settings: BTreeMap::new(),
            wishes: Vec::new(),
            events: VecDeque::new(),
            axes: Axes::default(),
            embedding: Vec::new(),
            weights: Vec::new(),
            graphs: BTreeMap::new(),
            topics,
            missing: Value::Null,
            frames: Cached::default(),
            fetches: Fetches::default(),
            pending: BTreeMap::new(),
            next_ticket: 0,
        }
    }

    /// How many browsers are open.
    #[must_use]
    pub fn browsers(&self) -> usize {
        self.browsers.len()
    }

    /// Whether a router is linked.
    #[must_use]
    pub fn is_linked(&self) -> bool {
        self.link
    }

    /// What waits for a browser in the core, in bytes; 0 for one that is not open. What it was sent and has not read
    /// is at most one turn ([`limits::MAX_TURN_BYTES`]).
    #[must_use]
    pub fn waiting_bytes(&self, browser: BrowserId) -> usize {
        self.browsers.get(&browser).map_or(0, Browser::waiting_bytes)
    }

    /// Takes one input, and returns what is to be done.
    pub fn handle(&mut self, now: Tick, input: Input) -> Vec<Output> {
        let mut outputs = Vec::new();
        match input {
            Input::Tick => self.pass(now, &mut outputs),
            Input::Link(link) => {
                self.link = link;
                self.topics.change(Topic::Fleet);
                // What was asked over the lost link is asked again.
                self.fetches.again();
            }
            Input::Opened(id, role) => self.open(now, id, role, &mut outputs),
            Input::Text(id, text) => self.receive(now, id, &text, &mut outputs),
            Input::Closed(id) => self.close(id),
            Input::Answer(ticket, answer) => self.answer(ticket, answer),
            Input::Unfetched(fetch) => self.fetches.answered(&fetch),
            other => self.learn(now, other),
        }
        self.fetch(now, &mut outputs);
        self.turns(now, &mut outputs);
        outputs
    }

    /// Takes what is new of the fleet.
    fn learn(&mut self, now: Tick, input: Input) {
        match input {
            Input::Roster(roster, stale) => {
                self.fresh("roster", stale);
                let modalities = |roster: &Roster| roster.graphs.len();
                if self
                    .fleet
                    .roster()
                    .is_none_or(|before| modalities(before) != modalities(&roster))
                {
                    self.topics.change(Topic::Fleet);
                }
                self.fleet.follow_roster(now, roster);
                self.list_missing();
                self.frames.change_robots();
            }
            Input::Teams(teams, stale) => {
                self.fresh("teams", stale);
                self.fleet.follow_teams(teams);
                self.topics.change(Topic::Teams);
                self.frames.change_robots();
            }
            Input::Audit(audit, stale) => {
                self.fresh("audit", stale);
                self.audit = Some(audit);
                self.topics.change(Topic::Audit);
            }
            Input::Alerts(alerts, stale) => {
                self.fresh("alerts", stale);
                if self.alerts.as_ref().is_none_or(|before| before.open != alerts.open) {
                    self.topics.change(Topic::Alerts);
                }
                self.alerts = Some(alerts);
            }
            Input::Event(event) => self.note(now, *event),
            Input::Statuses(statuses) => {
                self.fetches.answered(&Fetch::Statuses);
                self.statuses = statuses;
                self.topics.change(Topic::Services);
            }
            Input::Settings(settings) => {
                self.fetches.answered(&Fetch::Settings);
                // A service that does not answer has those that it had; that it does not lead is shown apart.
                let mut all = self.settings.clone();
                all.extend(settings);
                if self.settings != all || self.topics.version(Topic::Settings) == 0 {
                    self.settings = all;
                    self.topics.change(Topic::Settings);
                }
            }
            Input::Wishes(wishes) => {
                self.fetches.answered(&Fetch::Wishes);
                if self.fleet.follow_wishes(&wishes) {
                    self.frames.change_robots();
                }
                if self.wishes != wishes || self.topics.version(Topic::Wishes) == 0 {
                    self.wishes = wishes;
                    self.topics.change(Topic::Wishes);
                }
            }
            Input::Embedding(embedding) => {
                self.fetches.answered(&Fetch::Embedding);
                self.fetches.answered(&Fetch::Weights);
                if self.weights != embedding.graphs {
                    self.weights.clone_from(&embedding.graphs);
                    self.topics.change(Topic::Fleet);
                }
                let places = self.axes.project(&embedding);
                self.embedding = embedding.robots.iter().cloned().zip(places).collect();
                self.frames.change_robots();
            }
            Input::Graph(graph) => {
                self.fetches.answered(&Fetch::Graph(graph.modality.clone()));
                self.graphs.insert(graph.modality.clone(), graph);
                self.frames.change_links();
            }
            _ => {}
        }
    }

    fn list_missing(&mut self) {
        let missing = self.fleet.missing();
        if missing != self.missing {
            self.missing = missing;
            self.topics.change(Topic::Lost);
        }
    }

    fn fresh(&mut self, what: &'static str, stale: Stale) {
        if self.stale.insert(what, stale) != Some(stale) {
            self.topics.change(Topic::Fleet);
        }
    }

    /// Keeps an event, and asks at once for what it says has changed.
    fn note(&mut self, now: Tick, event: Event) {
        let value = bus_json(&Message::Event(event), Key::JsonEvent, now);
        let kind = value.get("event").and_then(Value::as_str).unwrap_or_default();
        if matches!(kind, "commanded" | "settings_changed" | "wish_changed") {
            self.fetches.soon(&[Fetch::Settings, Fetch::Wishes]);
        }
        let number = self.events.back().map_or(1, |(number, _)| number + 1);
        self.events.push_back((number, Arc::new(json!({"at": now.as_seconds(), "event": value}))));
        while self.events.len() > MAX_EVENTS {
            self.events.pop_front();
        }
    }

    fn pass(&mut self, now: Tick, outputs: &mut Vec<Output>) {
        if self.fleet.forget(now) {
            self.fleet.relist();
            self.list_missing();
            self.frames.change_robots();
        }
        let stalled =
            |(id, browser): (&BrowserId, &Browser)| browser.is_stalled(now).then_some(*id);
        let stalled: Vec<BrowserId> = self.browsers.iter().filter_map(stalled).collect();
        for id in stalled {
            self.close(id);
            outputs.push(Output::Close(id, "nothing was drawn for too long"));
        }
    }

    fn open(&mut self, now: Tick, id: BrowserId, role: Role, outputs: &mut Vec<Output>) {
        if self.browsers.len() >= MAX_BROWSERS {
            return outputs.push(Output::Close(id, "too many browsers are open"));
        }
        let (role_name, operator) = match &role {
            Role::Viewer => ("viewer", None),
            Role::Operator(name) => ("operator", Some(name.clone())),
        };
        let hello = json!({"topic": "hello", "data": {
            "fleet": self.name, "role": role_name, "operator": operator, "version": self.version,
            "services": ServiceName::ALL,
        }});
        let mut browser = Browser::new(role, now);
        browser.reply(hello.to_string().into());
        self.browsers.insert(id, browser);
    }

    fn close(&mut self, id: BrowserId) {
        self.browsers.remove(&id);
        // A command that was sent is carried out or not, whoever still listens; its answer finds nobody.
    }

    fn receive(&mut self, now: Tick, id: BrowserId, text: &str, outputs: &mut Vec<Output>) {
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
            Err(problem) => {
                // The page of this version sends nothing that cannot be read; whatever sent it is told what is wrong.
                let problem = plain_reason(&problem);
                let text = json!({"topic": "problem", "data": problem}).to_string();
                browser.reply(text.into());
            }
        }
    }

    /// Answers a browser; what does not fit into the room of its replies is replaced by a sentence.
    fn reply(&mut self, id: BrowserId, request: u64, answer: Result<&Value, &str>) {
        let Some(browser) = self.browsers.get_mut(&id) else { return };
        let text = match answer {
            Ok(answer) => json!({"topic": "reply", "data": {"id": request, "answer": answer}}),
            Err(problem) => json!({"topic": "reply", "data": {"id": request, "refused": problem}}),
        };
        if !browser.reply(text.to_string().into()) {
            let refused = "the answer is too long to be shown; ask for less";
            let text = json!({"topic": "reply", "data": {"id": request, "refused": refused}});
            browser.reply(text.to_string().into());
        }
    }

    fn command(
        &mut self,
        now: Tick,
        id: BrowserId,
        request: CommandRequest,
        outputs: &mut Vec<Output>,
    ) {
        let CommandRequest { id: number, service, based_on, action } = request;
        let Some(browser) = self.browsers.get_mut(&id) else { return };
        let Role::Operator(operator) = browser.role.clone() else {
            let refused = "a viewer cannot command; sign in with the token of an operator";
            return self.reply(id, number, Err(refused));
        };
        let refused = if browser.pending >= MAX_PENDING {
            Some("too many commands wait for their answer")
        } else if !browser.may_command(now) {
            Some("too many commands within a minute; wait a moment")
        } else if !self.link {
            Some("the link to the router is lost; nothing was sent")
        } else {
            None
        };
        if let Some(refused) = refused {
            return self.reply(id, number, Err(refused));
        }
        let ticket = self.ticket(id, number, true);
        let command = Command { operator, service, action, based_on };
        outputs.push(Output::Command(ticket, command));
    }

    fn ask(&mut self, now: Tick, id: BrowserId, ask: &AskRequest, outputs: &mut Vec<Output>) {
        let Some(browser) = self.browsers.get_mut(&id) else { return };
        let question = if browser.pending >= MAX_PENDING {
            Err("too many questions wait for their answer".to_owned())
        } else if !browser.may_command(now) {
            Err("too many questions within a minute; wait a moment".to_owned())
        } else {
            ask.question()
        };
        match question {
            Ok(question) => {
                let ticket = self.ticket(id, ask.id, false);
                outputs.push(Output::Ask(ticket, question));
            }
            Err(problem) => self.reply(id, ask.id, Err(&plain_reason(&problem))),
        }
    }

    fn ticket(&mut self, browser: BrowserId, id: u64, is_command: bool) -> Ticket {
        self.next_ticket += 1;
        self.pending.insert(self.next_ticket, Pending { browser, id, is_command });
        if let Some(browser) = self.browsers.get_mut(&browser) {
            browser.pending += 1;
        }
        self.next_ticket
    }

    fn answer(&mut self, ticket: Ticket, answer: Result<Value, String>) {
        let Some(pending) = self.pending.remove(&ticket) else { return };
        if pending.is_command {
            self.fetches.soon(&[Fetch::Settings, Fetch::Wishes]);
        }
        if let Some(browser) = self.browsers.get_mut(&pending.browser) {
            browser.pending = browser.pending.saturating_sub(1);
        }
        let problem = answer.as_ref().err().map(|problem| plain_reason(problem));
        let answer = answer.as_ref().map_err(|_| problem.as_deref().unwrap_or_default());
        self.reply(pending.browser, pending.id, answer);
    }

    fn fetch(&mut self, now: Tick, outputs: &mut Vec<Output>) {
        if !self.link || self.browsers.is_empty() {
            return;
        }
        let mut wanted = vec![Fetch::Statuses, Fetch::Settings, Fetch::Wishes];
        let is_shown = self.browsers.values().any(|browser| browser.view.embedding);
        wanted.push(if is_shown { Fetch::Embedding } else { Fetch::Weights });
        let shown = self.browsers.values().filter_map(|browser| browser.view.links.as_ref());
        let mut modalities: Vec<&Modality> = shown.map(|links| &links.modality).collect();
        modalities.sort_unstable();
        modalities.dedup();
        // A modality that the fleet does not have is not asked for.
        let known = self.fleet.roster().map(|roster| &roster.graphs);
        let is_known = |modality: &&Modality| {
            known.is_some_and(|graphs| graphs.iter().any(|(known, _)| known == *modality))
        };
        wanted.extend(modalities.into_iter().filter(is_known).cloned().map(Fetch::Graph));
        outputs.extend(self.fetches.due(now, wanted).into_iter().map(Output::Fetch));
    }

    /// The text of a topic.
    fn topic(&mut self, topic: Topic, now: Tick) -> Arc<str> {
        let (fleet, name, link, stale) = (&self.fleet, &self.name, self.link, &self.stale);
        let weight = |graph: &EmbeddingGraph| json!({"modality": graph.modality, "weight": graph.weight, "trust": graph.trust});
        let weights: Vec<Value> = self.weights.iter().map(weight).collect();
        let (audit, alerts, missing) = (&self.audit, &self.alerts, &self.missing);
        let (statuses, settings, wishes) = (&self.statuses, &self.settings, &self.wishes);
        self.topics.text(topic, || match topic {
            Topic::Fleet => {
                let graphs = fleet.roster().map(|roster| roster.graphs.as_slice());
                let modalities = graphs.unwrap_or_default().iter().map(|(modality, _)| modality);
                json!({
                    "fleet": name, "link": link, "stale": stale,
                    "modalities": modalities.collect::<Vec<_>>(), "weights": weights,
                })
            }
            Topic::Teams => fleet.division().unwrap_or_default(),
            Topic::Audit => audit.as_ref().map_or(Value::Null, |audit| {
                let mut brief = (**audit).clone();
                brief.in_embedding.per_robot.clear();
                brief.in_physical.per_robot.clear();
                bus_json(&Message::Audit(Arc::new(brief)), Key::JsonAudit, now)
            }),
            Topic::Alerts => alerts.as_ref().map_or(Value::Null, |alerts| {
                bus_json(&Message::Alerts(Arc::clone(alerts)), Key::JsonAlerts, now)
            }),
            Topic::Wishes => json!(wishes),
            Topic::Services => json!({"at": now.as_seconds(), "instances": statuses}),
            Topic::Settings => {
                let named = settings.iter();
                let named = named.map(|(service, value)| (service.to_string(), value.clone()));
                Value::Object(Map::from_iter(named))
            }
            Topic::Lost => missing.clone(),
        })
    }
}
