//! The core: everything that is decided about what viewers are sent, without sockets, clock or bus.

mod changing;
mod color;
mod fetches;
mod fleet;
mod hull;
pub mod limits;
mod links;
mod news;
mod parameters;
pub mod scene;
mod sending;
mod teams;
mod topic;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use muster_model::audit::Audit;
use muster_model::event::Event;
use muster_model::graph::GraphDelta;
use muster_model::id::{FleetId, Modality, OperatorId, ServiceName};
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use serde_json::Value;

use self::changing::{Change, Question};
pub use self::color::team_color;
pub use self::fetches::Fetch;
use self::fetches::Fetches;
use self::fleet::Fleet;
use self::links::Links;
use self::news::News;
use self::parameters::Confirmed;
pub use self::parameters::{Parameter, TEAMS, WEIGHTS, are_bounded};
use self::scene::{Level, Message};
use self::sending::Sent;
pub use self::topic::Topic;

/// Names a question or a change of a viewer until it is answered.
pub type RequestId = u64;

/// Names a command until it is answered.
pub type Ticket = u64;

/// Why a message that services publish again and again may not be valid any more.
pub type Stale = Option<&'static str>;

/// Who may change parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Access {
    /// No one.
    ReadOnly,
    /// Every viewer, under this name.
    Changes(OperatorId),
}

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
    /// Something happened in the fleet.
    Event(Box<Event>),
    /// The settings of a service.
    Settings(ServiceName, Value),
    /// The newest snapshot of a graph.
    Graph(Arc<GraphDelta>),
    /// Nothing answered.
    Unfetched(Fetch),
    /// The topics that somebody watches.
    Watched(BTreeSet<Topic>),
    /// A viewer has come.
    Joined,
    /// A viewer began to watch a topic.
    Subscribed(Topic),
    /// A viewer asks for parameters by name; for all, if it names none.
    Get(RequestId, Vec<String>),
    /// A viewer wants other parameters.
    Set(RequestId, Vec<Parameter>),
    /// What came of a command: all settings of the service, or why it was refused.
    Answer(Ticket, Result<Value, String>),
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Output {
    /// Offer a topic to all viewers from now on.
    Offer(Topic),
    /// Send a message to those who watch a topic.
    Send(Topic, Message),
    /// Say to all viewers what is wrong, in place of what was said under this name.
    Say(&'static str, Level, String),
    /// What was said under this name is over.
    Unsay(&'static str),
    /// Send parameters to those who follow them.
    Publish(Vec<Parameter>),
    /// Answer a viewer with parameters.
    Respond(RequestId, Vec<Parameter>),
    /// Say to a viewer why its change is refused.
    Refuse(RequestId, String),
    /// Change settings of a service, in the name of an operator.
    Command(Ticket, OperatorId, ServiceName, Value),
    /// Ask for something.
    Fetch(Fetch),
}

/// The fleet for viewers.
#[derive(Debug)]
pub struct Bridge {
    name: FleetId,
    access: Access,
    fleet: Fleet,
    link: bool,
    stale: BTreeMap<&'static str, &'static str>,
    audit: Option<Arc<Audit>>,
    links: BTreeMap<Modality, Links>,
    news: News,
    offered: BTreeSet<Topic>,
    watched: BTreeSet<Topic>,
    sent: Sent,
    said: BTreeMap<&'static str, String>,
    fetches: Fetches,
    confirmed: Confirmed,
    questions: VecDeque<Question>,
    changes: BTreeMap<RequestId, Change>,
    commands: BTreeMap<Ticket, (RequestId, ServiceName)>,
    next_ticket: Ticket,
}

impl Bridge {
    /// A bridge to a fleet, without viewers and without a link.
    #[must_use]
    pub fn new(name: FleetId, access: Access) -> Self {
        Self {
            name,
            access,
            fleet: Fleet::default(),
            link: false,
            stale: BTreeMap::new(),
            audit: None,
            links: BTreeMap::new(),
            news: News::default(),
            offered: BTreeSet::new(),
            watched: BTreeSet::new(),
            sent: Sent::default(),
            said: BTreeMap::new(),
            fetches: Fetches::default(),
            confirmed: Confirmed::default(),
            questions: VecDeque::new(),
            changes: BTreeMap::new(),
            commands: BTreeMap::new(),
            next_ticket: 0,
        }
    }

    /// Whether a router is linked.
    #[must_use]
    pub fn is_linked(&self) -> bool {
        self.link
    }

    /// Takes one input, and returns what is to be done.
    pub fn handle(&mut self, now: Tick, input: Input) -> Vec<Output> {
        let mut outputs = Vec::new();
        match input {
            Input::Tick => {
                self.fleet.forget(now);
                self.answer_questions(now, &mut outputs);
                self.fetch(now, &mut outputs);
                self.send(now, &mut outputs);
            }
            Input::Link(link) => {
                self.link = link;
                // What was asked over the lost link is asked again.
                self.fetches.again();
            }
            Input::Roster(roster, stale) => {
                self.fresh("roster", stale);
                self.fleet.follow_roster(now, roster);
                self.sent.change_robots();
            }
            Input::Teams(teams, stale) => {
                self.fresh("teams", stale);
                self.fleet.follow_teams(teams);
                self.sent.change_robots();
            }
            Input::Audit(audit, stale) => {
                self.fresh("audit", stale);
                let is_new = self
                    .audit
                    .as_ref()
                    .is_none_or(|known| known.header.revision != audit.header.revision);
                self.audit = Some(audit);
                // It is looked at every second, whether it is another one or not.
                if is_new {
                    self.sent.change(&Topic::Quality);
                }
            }
            Input::Event(event) => self.note(&event),
            Input::Settings(service, settings) => {
                self.fetches.answered(&Fetch::Settings(service));
                self.confirm(now, service, settings, &mut outputs);
            }
            Input::Graph(graph) => {
                self.fetches.answered(&Fetch::Graph(graph.modality.clone()));
                self.sent.change(&Topic::Links(graph.modality.clone()));
                self.links.insert(graph.modality.clone(), Links::of(&graph));
            }
            Input::Unfetched(fetch) => self.fetches.answered(&fetch),
            Input::Watched(watched) => {
                // A graph that no one watches is not kept: it would be old when somebody does again.
                self.links.retain(|modality, _| watched.contains(&Topic::Links(modality.clone())));
                self.watched = watched;
            }
            // What was said is said again, to whoever has just come.
            Input::Joined => self.said.clear(),
            Input::Subscribed(topic) => self.sent.change(&topic),
            Input::Get(id, names) => self.ask(now, id, names, &mut outputs),
            Input::Set(id, parameters) => self.set(id, &parameters, &mut outputs),
            Input::Answer(ticket, answer) => self.answer(now, ticket, answer, &mut outputs),
        }
        self.offer(&mut outputs);
        self.say(&mut outputs);
        outputs
    }

    /// Offers what there is from the start, and what the fleet has since.
    fn offer(&mut self, outputs: &mut Vec<Output>) {
        let graphs = self.fleet.roster().map_or(&[][..], |roster| &roster.graphs);
        let links = graphs.iter().map(|(modality, _)| Topic::Links(modality.clone()));
        // A roster has a bounded number of modalities, and what was once offered stays.
        for topic in Topic::ALWAYS.into_iter().chain(links) {
            if !self.offered.contains(&topic) {
                self.offered.insert(topic.clone());
                outputs.push(Output::Offer(topic));
            }
        }
    }

    fn fresh(&mut self, what: &'static str, stale: Stale) {
        match stale {
            Some(why) => self.stale.insert(what, why),
            None => self.stale.remove(what),
        };
    }

    fn note(&mut self, event: &Event) {
        if self.news.is_change_of_settings(event) {
            self.fetches.settings_soon();
        }
        if self.watched.contains(&Topic::Events) {
            self.news.note(event);
        }
    }

    fn fetch(&mut self, now: Tick, outputs: &mut Vec<Output>) {
        if !self.link {
            return;
        }
        let settings = parameters::SERVICES.into_iter().map(Fetch::Settings);
        let shown = self.watched.iter().filter_map(|topic| match topic {
            Topic::Links(modality) => Some(Fetch::Graph(modality.clone())),
            _ => None,
        });
        let wanted = settings.chain(shown).collect();
        outputs.extend(self.fetches.due(now, wanted).into_iter().map(Output::Fetch));
    }

    /// What whoever looks must know before all else.
    fn notices(&self) -> BTreeMap<&'static str, String> {
        let mut notices = BTreeMap::new();
        if muster_model::replay::is_replay(&self.name) {
            notices
                .insert("replay", format!("REPLAY: {} is a recording that is played", self.name));
        }
        if !self.link {
            notices
                .insert("link", "the link to the router is lost: what is shown is old".to_owned());
        } else if !self.stale.is_empty() {
            let stale: Vec<_> = self.stale.keys().copied().collect();
            let problem = format!("no service says anything newer: old are {}", stale.join(", "));
            notices.insert("stale", problem);
        }
        notices
    }

    fn say(&mut self, outputs: &mut Vec<Output>) {
        let notices = self.notices();
        if notices == self.said {
            return;
        }
        for (name, text) in &notices {
            if self.said.get(name) != Some(text) {
                outputs.push(Output::Say(name, Level::Warning, text.clone()));
            }
        }
        let over = self.said.keys().filter(|name| !notices.contains_key(*name));
        outputs.extend(over.map(|name| Output::Unsay(name)));
        self.said = notices;
        self.sent.change(&Topic::Teams);
    }
}
