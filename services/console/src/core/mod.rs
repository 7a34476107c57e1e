//! The core: everything that is decided about browsers, without sockets, clock or bus.

mod browser;
mod fetches;
mod fleet;
pub mod frame;
pub mod limits;
mod news;
mod orders;
mod problem;
mod projection;
pub mod proposal;
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
use serde_json::{Value, json};

use crate::image::Edges;

pub use self::browser::Role;
use self::browser::{Browser, Sort};
pub use self::fetches::Fetch;
use self::fetches::Fetches;
use self::fleet::Fleet;
use self::limits::MAX_BROWSERS;
pub use self::problem::{Problem, ProblemKind};
use self::projection::Axes;
pub use self::request::{ProposalOrder, ProposalStep, Question};
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
    Answer(Ticket, Result<Value, Problem>),
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
    /// Ask for a proposal, or decide on one.
    Propose(Ticket, ProposalOrder),
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
    sort: Sort,
    /// Whether it may change the fleet.
    is_command: bool,
}

/// The console.
#[derive(Debug)]
pub struct Console {
    name: FleetId,
    version: &'static str,
    /// Where the image below the map lies; none if there is none.
    image: Option<Edges>,
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

impl Console {
    /// A console of a fleet, without browsers and without a link.
    #[must_use]
    pub fn new(name: FleetId, version: &'static str) -> Self {
        let mut topics = Topics::default();
        topics.change(Topic::Fleet);
        Self {
            name,
            version,
            image: None,
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

    /// The same with an image below its map.
    #[must_use]
    pub fn with_image(self, image: Option<Edges>) -> Self {
        Self { image, ..self }
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
            "services": ServiceName::ALL, "image": self.image,
        }});
        let mut browser = Browser::new(role, now);
        browser.reply(hello.to_string().into());
        self.browsers.insert(id, browser);
    }

    fn close(&mut self, id: BrowserId) {
        self.browsers.remove(&id);
        // A command that was sent is carried out or not, whoever still listens; its answer finds no one.
    }
}
