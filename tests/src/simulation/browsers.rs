//! The console and its browsers: fast ones, slow ones, some that draw nothing any more, viewers that try to command, and a
//! console that is started again.
//!
//! The console hears what crosses the router, and has no say in the fleet: what browsers command is counted and
//! answered, so that the same seed leads to the same fleet with and without them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_console::limits::MAX_LOST;
use muster_console::{BrowserId, Console, Fetch, Input, Output, ProposalStep, Role, Ticket};
use muster_model::id::{FleetId, OperatorId};
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Packet};
use serde_json::{Value, json};

use super::chance::{Chance, Purpose};
use super::clock::{HostClock, MS, Micros, SECOND};
use super::oracle::{Verified, breach};
use super::page::{Pace, Page};
use super::world::{Event, World};

/// How many browsers are open.
const BROWSERS: usize = 5;

/// How often the core is told that time passes, as the real shell does.
const CONSOLE_TICK: Micros = 100 * MS;

/// Between two messages of a browser.
const BETWEEN_MESSAGES: (Micros, Micros) = (200 * MS, 4 * SECOND);

/// How long a command or question takes.
const ANSWER_TIME: (Micros, Micros) = (5 * MS, 3 * SECOND);

/// When a browser that was closed opens again.
const REOPENING: (Micros, Micros) = (250 * MS, 2 * SECOND);

/// When what a browser sent must be answered, if it draws: the longest answer, two turns, and some more.
const ANSWERED_WITHIN: Micros = 12 * SECOND;

/// Consoles that are started again in the storm, in a hundred runs.
const RESTARTED_PERCENT: u64 = 40;

/// The largest answer to a question, in bytes: a few of them do not fit into the room of one browser.
const MAX_ANSWER: u64 = 600 * 1024;

/// Large answers, in a hundred.
const LARGE_PERCENT: u64 = 10;

/// What happens to the console or to one of its browsers.
#[derive(Debug)]
pub(crate) enum BrowserEvent {
    /// Time passes.
    Tick,
    /// A browser opens.
    Opens,
    /// It has drawn a turn.
    Draws { browser: BrowserId, turn: u64 },
    /// It sends something.
    Sends { browser: BrowserId },
    /// A command or a question is answered.
    Answered { life: u32, ticket: Ticket, bytes: u64 },
    /// What all browsers are shown is not there.
    Unfetched { life: u32, fetch: Fetch },
    /// The console is killed and started again.
    Restarts,
    /// The link of the console is lost, or is back.
    Link(bool),
}

/// The console and its browsers.
#[derive(Debug)]
pub(crate) struct Browsers {
    console: Console,
    fleet: FleetId,
    /// Counts the consoles that were started.
    life: u32,
    link: bool,
    pages: BTreeMap<BrowserId, Page>,
    next: BrowserId,
    chance: Chance,
    clock: HostClock,
    roster: Option<Arc<Roster>>,
    teams: Option<Arc<Teams>>,
    /// Every robot that this console has received in a roster.
    seen: BTreeSet<String>,
}

impl Browsers {
    pub(crate) fn new(seed: u64, fleet: &FleetId) -> Self {
        Self {
            console: Console::new(fleet.clone(), "simulated"),
            fleet: fleet.clone(),
            life: 0,
            link: false,
            pages: BTreeMap::new(),
            next: 1,
            chance: Chance::new(seed, Purpose::Console, 0),
            clock: HostClock::default(),
            roster: None,
            teams: None,
            seen: BTreeSet::new(),
        }
    }

    /// What is on the agenda at first.
    pub(crate) fn agenda(&mut self, storm: Micros) -> Vec<(Micros, BrowserEvent)> {
        let chance = &mut self.chance;
        let mut agenda = vec![(0, BrowserEvent::Tick), (10 * MS, BrowserEvent::Link(true))];
        for _ in 0..BROWSERS {
            agenda.push((chance.between(0, 3 * SECOND), BrowserEvent::Opens));
        }
        if chance.percent(RESTARTED_PERCENT) {
            agenda.push((chance.between(storm / 4, storm), BrowserEvent::Restarts));
        }
        if chance.percent(RESTARTED_PERCENT) {
            let at = chance.between(storm / 4, storm);
            agenda.push((at, BrowserEvent::Link(false)));
            agenda.push((at + chance.between(SECOND, 3 * SECOND), BrowserEvent::Link(true)));
        }
        agenda
    }

    fn tick(&self, now: Micros) -> Tick {
        self.clock.wall(now)
    }

    /// What a console takes from the bus, as the client passes it on.
    fn inputs(&self) -> Vec<Input> {
        let roster = self.roster.clone().map(|roster| Input::Roster(roster, None));
        let teams = self.teams.clone().map(|teams| Input::Teams(teams, None));
        roster.into_iter().chain(teams).collect()
    }

    /// Each browser that draws shows the division that was published last, and no robot is hidden.
    pub(crate) fn check_agreement(&self, published: Option<&Teams>) -> Verified {
        let Some(published) = published else { return Ok(()) };
        let expected: BTreeMap<&str, &str> =
            published.assignments().map(|(robot, team)| (robot.as_str(), team.as_str())).collect();
        for (id, page) in self.pages.iter().filter(|(_, page)| page.pace != Pace::Never) {
            let shown = page.teams();
            if shown != expected {
                let seen = format!("browser {id} shows {shown:?} and not {expected:?}");
                return breach("browsers that draw show the division that all agree on", seen);
            }
        }
        Ok(())
    }

    fn check_hidden(&self, id: BrowserId) -> Verified {
        let Some(page) = self.pages.get(&id) else { return Ok(()) };
        let shown = page.robots();
        // Of too many lost ones, those that left first are forgotten.
        let hidden = self.seen.iter().find(|robot| !shown.contains(robot.as_str()));
        match hidden {
            Some(robot) if self.seen.len() <= MAX_LOST && !shown.is_empty() => breach(
                "no browser hides a robot that was lost",
                format!("browser {id} hides {robot}"),
            ),
            _ => Ok(()),
        }
    }

    /// Whoever commands is an operator at an open browser.
    fn check_operator(&self, operator: &OperatorId) -> Verified {
        let is_open = |page: &Page| page.role == Role::Operator(operator.clone());
        if self.pages.values().any(is_open) {
            return Ok(());
        }
        breach("only operators command", format!("{operator} commands, and is not there"))
    }

    fn check_answered(&self, now: Micros) -> Verified {
        for (id, page) in self.pages.iter().filter(|(_, page)| page.pace != Pace::Never) {
            if let Some((number, at)) =
                page.unanswered.iter().find(|(_, at)| **at + ANSWERED_WITHIN < now)
            {
                let seen = format!("{number} of browser {id} waits since {at}");
                return breach("whatever a browser asks for is answered", seen);
            }
        }
        Ok(())
    }

    /// What a browser sends next.
    fn message(&mut self, now: Micros, browser: BrowserId) -> Option<String> {
        let chance = &mut self.chance;
        let page = self.pages.get_mut(&browser)?;
        let set = |id| json!({"command": {"id": id, "service": "clusterer", "action": {"set": {"teams": 2}}}});
        let message = match chance.below(8) {
            0 | 1 => set(page.next_id(now)),
            2 => json!({"ask": {"id": page.next_id(now), "why": "r1"}}),
            3 => json!({"ask": {"id": page.next_id(now), "history": "of=events;limit=10"}}),
            4 => {
                json!({"propose": {"id": page.next_id(now), "name": "p1", "step": {"ask": {"teams": 2}}}})
            }
            5 => json!({"propose": {"id": page.next_id(now), "name": "p1", "step": "accept"}}),
            6 => json!({"view": {"links": {"modality": "spatial"}}}),
            _ => json!({"credit": 0}),
        };
        Some(message.to_string())
    }
}

impl World {
    /// Something happens to the console.
    pub(super) fn browser_event(&mut self, event: BrowserEvent) {
        match event {
            BrowserEvent::Tick => {
                self.at_console(Input::Tick);
                let answered = self.browsers.check_answered(self.now);
                self.require(answered);
                self.later(CONSOLE_TICK, BrowserEvent::Tick);
            }
            BrowserEvent::Opens => self.open_browser(),
            BrowserEvent::Draws { browser, turn } => {
                let drawn =
                    self.browsers.pages.get_mut(&browser).is_some_and(|page| page.draw(turn));
                if drawn {
                    self.at_console(Input::Text(browser, json!({"credit": turn}).to_string()));
                }
            }
            BrowserEvent::Sends { browser } => {
                if let Some(text) = self.browsers.message(self.now, browser) {
                    self.at_console(Input::Text(browser, text));
                    let after =
                        self.browsers.chance.between(BETWEEN_MESSAGES.0, BETWEEN_MESSAGES.1);
                    self.later(after, BrowserEvent::Sends { browser });
                }
            }
            BrowserEvent::Answered { life, ticket, bytes } if life == self.browsers.life => {
                let text = "x".repeat(usize::try_from(bytes).unwrap_or_default());
                self.at_console(Input::Answer(ticket, Ok(Value::String(text))));
            }
            BrowserEvent::Unfetched { life, fetch } if life == self.browsers.life => {
                self.at_console(Input::Unfetched(fetch));
            }
            BrowserEvent::Answered { .. } | BrowserEvent::Unfetched { .. } => {}
            BrowserEvent::Restarts => self.restart_console(),
            BrowserEvent::Link(link) => {
                self.browsers.link = link;
                self.at_console(Input::Link(link));
                if link {
                    self.browsers.inputs().into_iter().for_each(|input| self.at_console(input));
                }
            }
        }
    }

    fn later(&mut self, after: Micros, event: BrowserEvent) {
        self.schedule(self.now + after, Event::Browser(event));
    }

    fn open_browser(&mut self) {
        let browsers = &mut self.browsers;
        let id = browsers.next;
        browsers.next += 1;
        let pace = browsers.chance.pick(&Pace::ALL).copied().unwrap_or(Pace::Never);
        let operator = OperatorId::new("kim").ok().filter(|_| browsers.chance.percent(60));
        let role = operator.map_or(Role::Viewer, Role::Operator);
        browsers.pages.insert(id, Page::new(role.clone(), pace));
        self.log.line(self.now, format_args!("browser {id} opens: {role:?}, draws {pace:?}"));
        self.at_console(Input::Opened(id, role));
        self.later(SECOND, BrowserEvent::Sends { browser: id });
    }

    fn restart_console(&mut self) {
        self.log.line(self.now, format_args!("the console is started again"));
        let browsers = &mut self.browsers;
        browsers.console = Console::new(browsers.fleet.clone(), "simulated");
        browsers.life += 1;
        // Whom the console before it knew as lost, no one knows any more.
        browsers.seen.clear();
        let closed = std::mem::take(&mut browsers.pages);
        for _ in closed {
            self.reopen_browser();
        }
        self.at_console(Input::Link(self.browsers.link));
        self.browsers.inputs().into_iter().for_each(|input| self.at_console(input));
    }

    fn reopen_browser(&mut self) {
        let after = self.browsers.chance.between(REOPENING.0, REOPENING.1);
        self.later(after, BrowserEvent::Opens);
    }

    /// The console and the program for viewers receive what crosses the router.
    pub(super) fn watchers_receive(&mut self, packet: &Packet) {
        let wanted = match self.space.parse(&packet.key) {
            Ok(Key::Roster | Key::Teams | Key::Audit | Key::Alerts) => true,
            Ok(Key::Graph(_) | Key::Event) if self.viewers.are_there() => false,
            _ => return,
        };
        // No one believes what cannot be read.
        let Ok(message) = Message::decode(&self.space, packet) else { return };
        if wanted {
            self.console_receives(&message);
        }
        if self.viewers.are_there() {
            self.viewers_receive(&message);
        }
    }

    fn console_receives(&mut self, message: &Message) {
        let browsers = &mut self.browsers;
        let input = match message {
            Message::Roster(roster) => {
                let roster = Arc::new(roster.as_ref().clone());
                browsers.roster = Some(Arc::clone(&roster));
                Input::Roster(roster, None)
            }
            Message::Teams { teams, .. } => {
                let mut teams = teams.as_ref().clone();
                if self.mutator.misleads() {
                    teams.teams.iter_mut().for_each(|team| drop(team.members.pop()));
                }
                let teams = Arc::new(teams);
                browsers.teams = Some(Arc::clone(&teams));
                Input::Teams(teams, None)
            }
            Message::Audit(audit) => Input::Audit(Arc::clone(audit), None),
            Message::Alerts(alerts) => Input::Alerts(Arc::clone(alerts), None),
            _ => return,
        };
        if browsers.link {
            self.at_console(input);
        }
    }

    /// The console takes an input, and what it orders is done.
    fn at_console(&mut self, input: Input) {
        let browsers = &mut self.browsers;
        if let Input::Roster(roster, _) = &input {
            browsers.seen.extend(roster.robots.iter().map(|entry| entry.robot.to_string()));
        }
        let now = browsers.tick(self.now);
        for output in browsers.console.handle(now, input) {
            self.console_orders(output);
        }
        let browsers = &self.browsers;
        let mut all = browsers.pages.iter();
        let checked: Verified =
            all.try_for_each(|(id, page)| page.check_bytes(browsers.console.waiting_bytes(*id)));
        self.require(checked);
    }

    fn console_orders(&mut self, output: Output) {
        let life = self.browsers.life;
        let answer_in = self.browsers.chance.between(ANSWER_TIME.0, ANSWER_TIME.1);
        match output {
            Output::Text(id, text) => {
                let Some(page) = self.browsers.pages.get_mut(&id) else { return };
                let (received, pace) = (page.text(&text), page.pace);
                match received {
                    Ok(Some(turn)) => {
                        if let Pace::Within(most) = pace {
                            let after = self.browsers.chance.between(MS, most);
                            self.later(after, BrowserEvent::Draws { browser: id, turn });
                        }
                    }
                    Ok(None) => {}
                    Err(breach) => self.require(Err(breach)),
                }
            }
            Output::Frame(id, frame) => {
                let page = self.browsers.pages.get_mut(&id);
                let checked = page.map_or(Ok(()), |page| page.frame(&frame));
                self.require(checked.and_then(|()| self.browsers.check_hidden(id)));
            }
            Output::Close(id, reason) => {
                self.log.line(self.now, format_args!("browser {id} is closed: {reason}"));
                self.browsers.pages.remove(&id);
                self.reopen_browser();
            }
            Output::Command(ticket, command) => {
                let checked = self.browsers.check_operator(&command.operator);
                self.require(checked);
                self.later(answer_in, BrowserEvent::Answered { life, ticket, bytes: 2 });
            }
            Output::Propose(ticket, order) => {
                let checked = self.browsers.check_operator(&order.operator);
                self.require(checked);
                let bytes = if matches!(order.step, ProposalStep::Ask(_)) { 200 } else { 2 };
                self.later(answer_in, BrowserEvent::Answered { life, ticket, bytes });
            }
            Output::Ask(ticket, _) => {
                let is_large = self.browsers.chance.percent(LARGE_PERCENT);
                let bytes =
                    if is_large { self.browsers.chance.between(2, MAX_ANSWER) } else { 200 };
                self.later(answer_in, BrowserEvent::Answered { life, ticket, bytes });
            }
            Output::Fetch(fetch) => {
                self.later(answer_in, BrowserEvent::Unfetched { life, fetch });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A console with one browser that draws.
    fn browsers(role: Role) -> Browsers {
        let mut browsers = Browsers::new(0, &FleetId::new("fleet").unwrap());
        browsers.pages.insert(1, Page::new(role, Pace::Within(MS)));
        browsers
    }

    fn promise(checked: Verified) -> &'static str {
        checked.unwrap_err().promise
    }

    #[test]
    fn a_robot_that_is_hidden_is_seen() {
        let mut browsers = browsers(Role::Viewer);
        let names =
            json!({"topic": "names", "data": {"names": 1, "of": 1, "from": 0, "robots": [["r1"]]}});
        browsers.pages.get_mut(&1).unwrap().text(&names.to_string()).unwrap();
        browsers.seen.insert("r1".to_owned());
        assert_eq!(browsers.check_hidden(1), Ok(()));
        browsers.seen.insert("r2".to_owned());
        assert_eq!(promise(browsers.check_hidden(1)), "no browser hides a robot that was lost");
    }

    #[test]
    fn a_question_without_an_answer_is_seen() {
        let mut browsers = browsers(Role::Viewer);
        browsers.pages.get_mut(&1).unwrap().next_id(5);
        assert_eq!(browsers.check_answered(5 + ANSWERED_WITHIN), Ok(()));
        assert_eq!(
            promise(browsers.check_answered(6 + ANSWERED_WITHIN)),
            "whatever a browser asks for is answered"
        );
    }

    #[test]
    fn a_command_of_a_viewer_is_seen() {
        let kim = OperatorId::new("kim").unwrap();
        assert_eq!(browsers(Role::Operator(kim.clone())).check_operator(&kim), Ok(()));
        let of_viewer = browsers(Role::Viewer).check_operator(&kim);
        assert_eq!(promise(of_viewer), "only operators command");
    }
}
