//! Viewers of Foxglove and the program that serves them, with the core that ships: viewers that read fast, slowly or never,
//! that begin and end to watch, and that change parameters; a program that is killed, cut off, and read-only in half of
//! the seeds.
//!
//! As the console, it hears what crosses the router and has no say in the fleet: settings are those of services of its
//! own, so that the same seed leads to the same fleet with and without viewers.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_client::{Freshness, Publication, Staleness, Via};
use muster_foxglove::limits::{MAX_TURN_MESSAGES, MAX_WAITING_MESSAGES, PARAMETERS_WITHIN};
use muster_foxglove::scene::Message as Sent;
use muster_foxglove::{
    Access, Bridge, Fetch, Input, Output, Parameter, RequestId, Stale, TEAMS, Topic, WEIGHTS,
};
use muster_model::audit::Audit;
use muster_model::id::{FleetId, Modality, OperatorId, ServiceName};
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_wire::Message;
use serde_json::{Value, json};

use super::chance::{Chance, Purpose};
use super::clock::{HostClock, MS, Micros, SECOND};
use super::oracle::viewed::{Viewed, Viewer};
use super::oracle::{Verified, breach};
use super::page::Pace;
use super::world::{Event, World};

/// Of a hundred seeds, those with viewers.
const VIEWERS_PERCENT: u64 = 30;

/// A fast viewer, two slow ones, and one that has stopped. What waits for a viewer is a second of what a fleet at rest sends
/// on all topics.
const PACES: [Pace; 4] =
    [Pace::Within(30 * MS), Pace::Within(250 * MS), Pace::Within(700 * MS), Pace::Never];

/// How many viewers there are.
const VIEWERS: usize = 4;

/// How often the core learns that time passes, as the shell lets it.
const TURN: Micros = 50 * MS;

/// How long a reader of the fleet waits for something newer: the default of clients.
const STALE_AFTER: Duration = Duration::from_secs(5);

/// How often the newest message is looked at although nothing says that it changed, as the shell does.
const LOOK_EVERY: Micros = SECOND;

/// Between two things that a viewer does.
const BETWEEN: (Micros, Micros) = (200 * MS, 3 * SECOND);

/// How long a command, a get or a question takes.
const ANSWER_TIME: (Micros, Micros) = (5 * MS, 2 * SECOND);

/// How long after the last fault all viewers know the settings: two times that they are asked for, and both answers.
const PARAMETERS_KNOWN: Micros = 15 * SECOND;

/// Of a hundred seeds, those in which the program is killed; the same of its link, which is cut.
const DISTURBED_PERCENT: u64 = 40;

/// What happens to the program or to one of its viewers.
#[derive(Debug)]
pub(crate) enum ViewerEvent {
    /// Time passes for the core.
    Turn,
    /// The newest messages are looked at.
    Look,
    /// A viewer connects.
    Connects,
    /// A viewer reads what waits for it.
    Reads { viewer: usize },
    /// A viewer does something.
    Acts { viewer: usize },
    /// A service answers a command.
    Answered { life: u32, ticket: u64, service: ServiceName, patch: Value },
    /// What was asked for comes.
    Fetched { life: u32, fetch: Fetch },
    /// The newest message of a kind comes, as the answer to a get.
    Got { life: u32, what: Kind },
    /// Someone else changes settings.
    OthersChange,
    /// The program is killed and starts again.
    Restarts,
    /// Its link is lost, or is back.
    Link(bool),
}

/// What is followed of the fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Roster,
    Teams,
    Audit,
}

/// The newest of each, as the client of the shell keeps it.
#[derive(Debug)]
struct Followed {
    roster: Freshness<Roster>,
    teams: Freshness<Teams>,
    audit: Freshness<Audit>,
}

impl Followed {
    fn new(now: Instant, linked: bool) -> Self {
        Self {
            roster: Freshness::new(now, STALE_AFTER, linked),
            teams: Freshness::new(now, STALE_AFTER, linked),
            audit: Freshness::new(now, STALE_AFTER, linked),
        }
    }
}

/// What crossed the router last of each kind.
#[derive(Debug, Clone, Default)]
struct LastMessages {
    roster: Option<Arc<Roster>>,
    teams: Option<Arc<Teams>>,
    audit: Option<Arc<Audit>>,
}

/// The program and its viewers.
#[derive(Debug)]
pub(crate) struct Viewers {
    /// Whether the seed has any.
    are_there: bool,
    core: Bridge,
    fleet: FleetId,
    access: Access,
    /// Counts the processes.
    life: u32,
    link: bool,
    followed: Followed,
    /// What answers gets.
    last: LastMessages,
    graphs: BTreeMap<Modality, Arc<muster_model::graph::GraphDelta>>,
    viewers: BTreeMap<usize, Viewer>,
    next_viewer: usize,
    next_request: RequestId,
    /// The topics that are offered.
    offered: BTreeSet<Topic>,
    /// What was given to the core as watched.
    watched: BTreeSet<Topic>,
    /// The settings as their services have them.
    settings: BTreeMap<ServiceName, Value>,
    judge: Viewed,
    chance: Chance,
    clock: HostClock,
    /// The beginning of the run by a clock that only differences are taken of.
    zero: Instant,
    /// Since when viewers only read.
    rests_since: Option<Micros>,
}

impl Viewers {
    pub(crate) fn new(seed: u64, fleet: &FleetId) -> Self {
        let mut chance = Chance::new(seed, Purpose::Viewers, 0);
        let are_there = chance.percent(VIEWERS_PERCENT);
        let kim = OperatorId::new("kim").ok().filter(|_| chance.percent(50));
        let access = kim.map_or(Access::ReadOnly, Access::Changes);
        let zero = Instant::now();
        let clusterer = json!({"teams": 2, "dwell_s": 1.0});
        let embedder = json!({"weights": {"spatial": 0.5, "hierarchy": 0.5}});
        Self {
            are_there,
            core: Bridge::new(fleet.clone(), access.clone()),
            fleet: fleet.clone(),
            access,
            life: 0,
            link: false,
            followed: Followed::new(zero, false),
            last: LastMessages::default(),
            graphs: BTreeMap::new(),
            viewers: BTreeMap::new(),
            next_viewer: 0,
            next_request: 0,
            offered: BTreeSet::new(),
            watched: BTreeSet::new(),
            settings: BTreeMap::from([
                (ServiceName::Clusterer, clusterer),
                (ServiceName::Embedder, embedder),
            ]),
            judge: Viewed::default(),
            chance,
            clock: HostClock::default(),
            zero,
            rests_since: None,
        }
    }

    /// What is on the agenda at first.
    pub(crate) fn agenda(&mut self, storm: Micros) -> Vec<(Micros, ViewerEvent)> {
        if !self.are_there {
            return Vec::new();
        }
        let chance = &mut self.chance;
        let mut agenda = vec![
            (0, ViewerEvent::Turn),
            (LOOK_EVERY, ViewerEvent::Look),
            (10 * MS, ViewerEvent::Link(true)),
        ];
        for _ in 0..VIEWERS {
            agenda.push((chance.between(0, 3 * SECOND), ViewerEvent::Connects));
        }
        for _ in 0..chance.below(4) {
            agenda.push((chance.between(SECOND, storm), ViewerEvent::OthersChange));
        }
        if chance.percent(DISTURBED_PERCENT) {
            agenda.push((chance.between(storm / 4, storm), ViewerEvent::Restarts));
        }
        if chance.percent(DISTURBED_PERCENT) {
            let at = chance.between(storm / 4, storm);
            agenda.push((at, ViewerEvent::Link(false)));
            agenda.push((at + chance.between(SECOND, 3 * SECOND), ViewerEvent::Link(true)));
        }
        agenda
    }

    fn tick(&self, now: Micros) -> Tick {
        self.clock.wall(now)
    }

    fn instant(&self, now: Micros) -> Instant {
        self.zero + Duration::from_micros(now)
    }

    /// The topics that somebody watches.
    fn subscribed(&self) -> BTreeSet<Topic> {
        self.viewers.values().flat_map(|viewer| viewer.watches.keys().cloned()).collect()
    }

    /// Whether the seed has any.
    pub(crate) fn are_there(&self) -> bool {
        self.are_there
    }

    /// From here on viewers only read, so that what they show can be compared.
    pub(crate) fn rest(&mut self, now: Micros) {
        self.rests_since = Some(now);
    }

    /// What each viewer that reads shows is what all agree on.
    pub(crate) fn check_agreement(&self, now: Micros, roster: &Roster, teams: &Teams) -> Verified {
        for (number, viewer) in self.viewers.iter().filter(|(_, viewer)| viewer.reads()) {
            self.judge.check_scene(now, *number, viewer, roster, teams)?;
            if self.rests_since.is_some_and(|since| now >= since + PARAMETERS_KNOWN) {
                viewer.check_parameters(*number, &self.settings)?;
            }
        }
        Ok(())
    }

    /// What a viewer does next.
    fn act(&mut self, number: usize, now: Micros) -> Vec<Input> {
        let request = self.next_request;
        let offered: Vec<Topic> = self.offered.iter().cloned().collect();
        let Some(viewer) = self.viewers.get_mut(&number) else { return Vec::new() };
        let chance = &mut self.chance;
        let topic = chance.pick(&offered).cloned().unwrap_or(Topic::Teams);
        match chance.below(8) {
            0..3 => {
                if viewer.watches.contains_key(&topic) {
                    return Vec::new();
                }
                viewer.watches.insert(topic.clone(), now);
                vec![Input::Subscribed(topic)]
            }
            3 => {
                // The first one watches the teams all the time.
                if number > 0 || topic != Topic::Teams {
                    viewer.unwatch(&topic);
                }
                Vec::new()
            }
            4 => {
                self.next_request += 1;
                self.judge.asked(request, now, number);
                vec![Input::Get(request, Vec::new())]
            }
            _ => {
                self.next_request += 1;
                self.judge.asked(request, now, number);
                let value = match chance.below(5) {
                    0 => (WEIGHTS, json!({"spatial": 1.0})),
                    1 => ("clusterer.seed", json!(7)),
                    teams => (TEAMS, json!(teams)),
                };
                let parameter = Parameter { name: value.0.to_owned(), value: Some(value.1) };
                vec![Input::Set(request, vec![parameter])]
            }
        }
    }
}

impl World {
    /// Something happens to viewers.
    pub(super) fn viewer_event(&mut self, event: ViewerEvent) {
        match event {
            ViewerEvent::Turn => {
                let watched = if self.mutator.watches_all() {
                    self.viewers.offered.clone()
                } else {
                    self.viewers.subscribed()
                };
                self.viewers.watched.clone_from(&watched);
                self.at_viewers(Input::Watched(watched));
                self.follow_for_viewers();
                self.at_viewers(Input::Tick);
                let limit = Micros::try_from(PARAMETERS_WITHIN.as_micros()).unwrap_or_default();
                let checked = self.viewers.judge.check_answered(self.now, limit + 2 * TURN);
                self.require(checked);
                self.viewers_later(TURN, ViewerEvent::Turn);
            }
            ViewerEvent::Look => {
                self.look_for_viewers([true; 3]);
                self.viewers_later(LOOK_EVERY, ViewerEvent::Look);
            }
            ViewerEvent::Connects => self.connect_viewer(),
            ViewerEvent::Reads { viewer } => {
                let Some(viewer_now) = self.viewers.viewers.get_mut(&viewer) else { return };
                viewer_now.read(self.now);
                if let Pace::Within(most) = viewer_now.pace {
                    self.viewers_later(most, ViewerEvent::Reads { viewer });
                }
            }
            ViewerEvent::Acts { viewer } => {
                if self.viewers.rests_since.is_some() {
                    return;
                }
                for input in self.viewers.act(viewer, self.now) {
                    self.at_viewers(input);
                }
                let after = self.viewers.chance.between(BETWEEN.0, BETWEEN.1);
                self.viewers_later(after, ViewerEvent::Acts { viewer });
            }
            ViewerEvent::Answered { life, ticket, service, patch } => {
                self.service_answers_viewers(life, ticket, service, &patch);
            }
            ViewerEvent::Fetched { life, fetch } if life == self.viewers.life => {
                let is_there = self.viewers.link
                    && (self.viewers.rests_since.is_some() || self.viewers.chance.percent(85));
                let found = match &fetch {
                    _ if !is_there => None,
                    Fetch::Settings(service) => {
                        let settings = self.viewers.settings.get(service).cloned();
                        settings.map(|settings| Input::Settings(*service, settings))
                    }
                    Fetch::Graph(modality) => {
                        self.viewers.graphs.get(modality).cloned().map(Input::Graph)
                    }
                };
                self.at_viewers(found.unwrap_or(Input::Unfetched(fetch)));
            }
            ViewerEvent::Got { life, what } if life == self.viewers.life && self.viewers.link => {
                let LastMessages { roster, teams, audit } = self.viewers.last.clone();
                match what {
                    Kind::Roster => {
                        roster.into_iter().for_each(|new| self.roster_for_viewers(&new, Via::Reply))
                    }
                    Kind::Teams => {
                        teams.into_iter().for_each(|new| self.teams_for_viewers(&new, Via::Reply))
                    }
                    Kind::Audit => {
                        audit.into_iter().for_each(|new| self.audit_for_viewers(&new, Via::Reply))
                    }
                }
            }
            ViewerEvent::Fetched { .. } | ViewerEvent::Got { .. } => {}
            ViewerEvent::OthersChange => {
                let teams = self.viewers.chance.between(1, 9);
                if let Some(settings) = self.viewers.settings.get_mut(&ServiceName::Clusterer) {
                    settings["teams"] = json!(teams);
                }
            }
            ViewerEvent::Restarts => self.restart_viewers(),
            ViewerEvent::Link(link) => self.link_viewers(link),
        }
    }

    fn viewers_later(&mut self, after: Micros, event: ViewerEvent) {
        self.schedule(self.now + after, Event::Viewer(event));
    }

    fn connect_viewer(&mut self) {
        let viewers = &mut self.viewers;
        let number = viewers.next_viewer;
        viewers.next_viewer += 1;
        let pace = viewers.chance.pick(&PACES).copied().unwrap_or(Pace::Never);
        // The first one reads, or nothing would be compared.
        let pace = if number == 0 { PACES[0] } else { pace };
        let mut viewer = Viewer::new(pace);
        let topics = [Topic::Teams, Topic::Transforms];
        viewer.watches.extend(topics.iter().map(|topic| (topic.clone(), self.now)));
        viewers.viewers.insert(number, viewer);
        self.log.line(self.now, format_args!("viewer {number} connects, reads {pace:?}"));
        self.at_viewers(Input::Joined);
        for topic in topics {
            self.at_viewers(Input::Subscribed(topic));
        }
        let request = self.viewers.next_request;
        self.viewers.next_request += 1;
        self.viewers.judge.asked(request, self.now, number);
        self.at_viewers(Input::Get(request, Vec::new()));
        if let Pace::Within(most) = pace {
            self.viewers_later(most, ViewerEvent::Reads { viewer: number });
        }
        self.viewers_later(SECOND, ViewerEvent::Acts { viewer: number });
    }

    fn restart_viewers(&mut self) {
        self.log.line(self.now, format_args!("the program for viewers is started again"));
        let now = self.viewers.instant(self.now);
        let viewers = &mut self.viewers;
        viewers.core = Bridge::new(viewers.fleet.clone(), viewers.access.clone());
        viewers.life += 1;
        viewers.followed = Followed::new(now, viewers.link);
        viewers.offered.clear();
        viewers.judge = Viewed::default();
        let gone = std::mem::take(&mut viewers.viewers);
        for _ in gone {
            let after = self.viewers.chance.between(250 * MS, 2 * SECOND);
            self.viewers_later(after, ViewerEvent::Connects);
        }
        self.at_viewers(Input::Link(self.viewers.link));
    }

    fn link_viewers(&mut self, link: bool) {
        let now = self.viewers.instant(self.now);
        let followed = &mut self.viewers.followed;
        self.viewers.link = link;
        let changed = [
            followed.roster.set_link(now, link),
            followed.teams.set_link(now, link),
            followed.audit.set_link(now, link),
        ];
        self.at_viewers(Input::Link(link));
        self.look_for_viewers(changed);
    }

    /// Time passes for the reader of the fleet, which asks for what it misses.
    fn follow_for_viewers(&mut self) {
        let now = self.viewers.instant(self.now);
        let followed = &mut self.viewers.followed;
        let changed = [
            followed.roster.advance(now),
            followed.teams.advance(now),
            followed.audit.advance(now),
        ];
        let gets = [
            (Kind::Roster, followed.roster.take_get(now)),
            (Kind::Teams, followed.teams.take_get(now)),
            (Kind::Audit, followed.audit.take_get(now)),
        ];
        self.look_for_viewers(changed);
        let life = self.viewers.life;
        for (what, _) in gets.into_iter().filter(|(_, is_due)| *is_due) {
            let after = self.viewers.chance.between(MS, 200 * MS);
            self.viewers_later(after, ViewerEvent::Got { life, what });
        }
    }

    /// Passes on the newest of what has changed.
    fn look_for_viewers(&mut self, changed: [bool; 3]) {
        let followed = &self.viewers.followed;
        let mut inputs = Vec::new();
        if changed[0]
            && let Some(new) = followed.roster.latest()
        {
            inputs.push(Input::Roster(Arc::clone(&new.value), stale(new.stale)));
        }
        if changed[1]
            && let Some(new) = followed.teams.latest()
        {
            inputs.push(Input::Teams(Arc::clone(&new.value), stale(new.stale)));
        }
        if changed[2]
            && let Some(new) = followed.audit.latest()
        {
            inputs.push(Input::Audit(Arc::clone(&new.value), stale(new.stale)));
        }
        for input in inputs {
            self.at_viewers(input);
        }
    }

    /// The program receives what crosses the router.
    pub(super) fn viewers_receive(&mut self, message: &Message) {
        match message {
            Message::Roster(roster) => {
                let roster = Arc::new(roster.as_ref().clone());
                self.viewers.last.roster = Some(Arc::clone(&roster));
                self.roster_for_viewers(&roster, Via::Put);
            }
            Message::Teams { teams, .. } => {
                let mut teams = teams.as_ref().clone();
                if self.mutator.blinds_viewers() {
                    teams.teams.iter_mut().for_each(|team| drop(team.members.pop()));
                }
                let teams = Arc::new(teams);
                self.viewers.last.teams = Some(Arc::clone(&teams));
                self.teams_for_viewers(&teams, Via::Put);
            }
            Message::Audit(audit) => {
                self.viewers.last.audit = Some(Arc::clone(audit));
                self.audit_for_viewers(audit, Via::Put);
            }
            Message::Graph(graph) if graph.base.is_none() => {
                self.viewers.graphs.insert(graph.modality.clone(), Arc::clone(graph));
            }
            Message::Event(event) if self.viewers.link => {
                self.at_viewers(Input::Event(Box::new(event.clone())));
            }
            _ => {}
        }
    }

    fn roster_for_viewers(&mut self, roster: &Arc<Roster>, via: Via) {
        let now = self.viewers.instant(self.now);
        if self.viewers.link && receive(&mut self.viewers.followed.roster, now, roster, via) {
            self.look_for_viewers([true, false, false]);
        }
    }

    fn teams_for_viewers(&mut self, teams: &Arc<Teams>, via: Via) {
        let now = self.viewers.instant(self.now);
        if self.viewers.link && receive(&mut self.viewers.followed.teams, now, teams, via) {
            self.look_for_viewers([false, true, false]);
        }
    }

    fn audit_for_viewers(&mut self, audit: &Arc<Audit>, via: Via) {
        let now = self.viewers.instant(self.now);
        if self.viewers.link && receive(&mut self.viewers.followed.audit, now, audit, via) {
            self.look_for_viewers([false, false, true]);
        }
    }

    /// A service does what it was commanded to, or refuses it and says why; sometimes it confirms something else.
    fn service_answers_viewers(
        &mut self,
        life: u32,
        ticket: u64,
        service: ServiceName,
        patch: &Value,
    ) {
        let viewers = &mut self.viewers;
        let answer = if viewers.chance.percent(30) || !viewers.link {
            Err(format!("teams: refused by the service, number {ticket}"))
        } else {
            let settings = viewers.settings.entry(service).or_insert_with(|| json!({}));
            for (name, value) in patch.as_object().into_iter().flatten() {
                settings[name.as_str()] = value.clone();
            }
            Ok(settings.clone())
        };
        if life != viewers.life {
            return;
        }
        let is_wishful = self.mutator.is_wishful();
        let viewers = &mut self.viewers;
        viewers.judge.answered(ticket, &answer);
        let answer = if is_wishful { Ok(json!({"teams": 99})) } else { answer };
        self.at_viewers(Input::Answer(ticket, answer));
    }

    /// The core takes an input, and what it orders is done and judged.
    fn at_viewers(&mut self, input: Input) {
        let now = self.viewers.tick(self.now);
        self.viewers.judge.takes(&input);
        let outputs = self.viewers.core.handle(now, input);
        let sent = outputs.iter().filter(|output| matches!(output, Output::Send(..))).count();
        if sent > MAX_TURN_MESSAGES {
            let promise = "a viewer that reads misses nothing";
            self.require(breach(promise, format!("{sent} messages come at once")));
        }
        for output in outputs {
            let is_sent = matches!(output, Output::Send(..));
            for _ in 1..if is_sent { self.mutator.repetitions() } else { 1 } {
                self.viewers_order(output.clone());
            }
            self.viewers_order(output);
        }
    }

    fn viewers_order(&mut self, output: Output) {
        let life = self.viewers.life;
        let checked = match output {
            Output::Offer(topic) => {
                self.viewers.offered.insert(topic);
                Ok(())
            }
            Output::Send(topic, message) => self.send_to_viewers(&topic, message),
            Output::Say(..) | Output::Unsay(_) => Ok(()),
            Output::Publish(parameters) => {
                for viewer in self.viewers.viewers.values_mut() {
                    viewer.show(&parameters);
                }
                self.viewers.judge.shows(&parameters)
            }
            Output::Respond(request, parameters) => {
                let answered = self.viewers.judge.responds(request, &parameters);
                if let Ok(viewer) = &answered
                    && let Some(viewer) = self.viewers.viewers.get_mut(viewer)
                {
                    viewer.show(&parameters);
                }
                answered.map(|_| ())
            }
            Output::Refuse(request, reason) => {
                let reason = if self.mutator.is_curt() { String::new() } else { reason };
                self.viewers.judge.refuses(request, &reason)
            }
            Output::Command(ticket, _, service, patch) => {
                let after = self.viewers.chance.between(ANSWER_TIME.0, ANSWER_TIME.1);
                let event = ViewerEvent::Answered { life, ticket, service, patch };
                self.viewers_later(after, event);
                let may_change = matches!(self.viewers.access, Access::Changes(_));
                self.viewers.judge.commands(ticket, service, may_change)
            }
            Output::Fetch(fetch) => {
                let after = self.viewers.chance.between(ANSWER_TIME.0, ANSWER_TIME.1);
                self.viewers_later(after, ViewerEvent::Fetched { life, fetch });
                Ok(())
            }
        };
        self.require(checked);
    }

    /// A message goes to all who watch its topic. For each viewer a few wait; the oldest makes room.
    fn send_to_viewers(&mut self, topic: &Topic, message: Sent) -> Verified {
        let message = Arc::new(self.mutator.drawn(message));
        self.stats.scenes += 1;
        self.viewers.judge.sends(self.now, topic)?;
        let mut has_viewer = false;
        for (number, viewer) in &mut self.viewers.viewers {
            if viewer.watches.contains_key(topic) {
                has_viewer = true;
                let is_lost = viewer.queue(topic, &message, MAX_WAITING_MESSAGES);
                if is_lost && viewer.pace == PACES[0] {
                    let seen = format!("viewer {number}, which reads at once");
                    return breach("a viewer that reads misses nothing", seen);
                }
            }
        }
        if has_viewer {
            return Ok(());
        }
        breach("nothing is made that no viewer watches", format!("{topic:?}"))
    }
}

/// Takes a message; true if the newest one is another one, or stale in another way.
fn receive<T: Publication + Clone>(
    followed: &mut Freshness<T>,
    now: Instant,
    message: &Arc<T>,
    via: Via,
) -> bool {
    followed.receive(now, message.as_ref().clone(), via)
}

fn stale(staleness: Option<Staleness>) -> Stale {
    staleness.map(|staleness| match staleness {
        Staleness::LinkLost => "link_lost",
        Staleness::Silent => "silent",
        Staleness::Restarted => "restarted",
    })
}

/// What waits for a viewer.
pub(crate) type Waiting = VecDeque<(Topic, Arc<Sent>)>;
