//! What is divided when, and what is told of it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_machine::{
    Answered, Core, Delivery, Effect, Effects, Event, QueryId, Role, START_FETCH, Start,
    Subscription, Wiring,
};
use muster_model::embedding::Embedding;
use muster_model::event::{EventKind, Severity};
use muster_model::id::{RobotId, ServiceName};
use muster_model::roster::{Presence, Roster};
use muster_model::settings::ClustererSettings;
use muster_model::teams::Teams;
use muster_model::time::{Tick, seconds};
use muster_wire::envelope::MAX_SERVICE_PAYLOAD;
use muster_wire::{Key, Message, Pattern, Rejection, Request};

use crate::division::{Job, Outcome, divide, same_data};
use crate::leader::leaders;

/// The number of the fetch that is made when a lost link is back: what came meanwhile was missed.
const LINK_FETCH: u32 = 1;

/// Most changes of one division that are told as events: when a whole fleet is divided anew, the
/// division itself says it better than one event per robot. The others are counted.
const MAX_CHANGE_EVENTS: usize = 64;

/// Most names in all the answers to one get of robots' teams. Each robot is told all members of its
/// team, so that the answer for a whole fleet grows with the square of its teams.
const MAX_NAMES_ANSWERED: usize = 4_000_000;

/// An embedding, and when it was heard of.
#[derive(Debug, Clone)]
struct Heard {
    embedding: Arc<Embedding>,
    received: Tick,
}

/// What a division is made of.
#[derive(Debug, Clone)]
struct Task {
    heard: Heard,
    /// The settings without those that change no division.
    settings: ClustererSettings,
}

impl Task {
    fn is_same(&self, heard: &Heard, settings: &ClustererSettings) -> bool {
        self.settings == *settings && same_data(&self.heard.embedding, &heard.embedding)
    }
}

/// What this holder of the role has told.
#[derive(Debug)]
struct Told {
    /// The newest embedding with the data of the division.
    source: Heard,
    /// When the division was last told.
    published: Tick,
    /// When its JSON mirror was last told.
    mirrored: Tick,
}

/// Divides embeddings into teams.
#[derive(Debug)]
pub struct Clusterer {
    role: Role<ClustererSettings>,
    newest: Option<Heard>,
    roster: Option<Arc<Roster>>,
    running: Option<Task>,
    divided: Option<Task>,
    failed: Option<Task>,
    /// The last good answer; of the holder before until this one has its own.
    division: Option<Arc<Teams>>,
    told: Option<Told>,
    /// Whether every robot has been told of its team by this holder over this link.
    robots_told: bool,
    /// How many teams were asked for and formed when that was last told to be too few.
    fewer: Option<(u32, u32)>,
}

impl Clusterer {
    fn take_in(&mut self, now: Tick, message: Message, effects: &mut Effects<Job>) {
        match message {
            Message::Embedding(embedding) => self.take_embedding(now, embedding, effects),
            Message::Roster(roster) => self.take_roster(now, roster, effects),
            _ => {}
        }
    }

    fn take_embedding(&mut self, now: Tick, embedding: Arc<Embedding>, effects: &mut Effects<Job>) {
        let revision = embedding.header.revision;
        let last = self.newest.as_ref().map(|heard| heard.embedding.header.revision);
        if last.is_some_and(|last| revision <= last) {
            // The same one may well come twice: by subscription and by fetch.
            if last != Some(revision) {
                self.role.count("messages_old");
            }
            return;
        }
        if let Err(reason) = embedding.check() {
            let key = self.role.space().format(&Key::Embedding);
            let rejection = Rejection::new(self.role.space(), &key, reason);
            self.role.quarantine(now, rejection, effects);
            return;
        }
        self.role.count("embeddings_received");
        self.newest = Some(Heard { embedding, received: now });
        self.consider(effects);
    }

    fn take_roster(&mut self, now: Tick, roster: Arc<Roster>, effects: &mut Effects<Job>) {
        let revision = roster.header.revision;
        let last = self.roster.as_ref().map(|roster| roster.header.revision);
        if last.is_some_and(|last| revision <= last) {
            if last != Some(revision) {
                self.role.count("messages_old");
            }
            return;
        }
        self.roster = Some(roster);
        // Robots went silent, or command others now: the same labels, told anew.
        if let (Some(told), Some(division)) = (&self.told, &self.division) {
            let (leaders, stale) = self.roster_view(division);
            let led = division.teams.iter().zip(leaders);
            if stale != division.stale
                || led.into_iter().any(|(team, leader)| leader.is_some_and(|l| l != team.leader))
            {
                let source = told.source.clone();
                self.repeat(now, source, effects);
            }
        }
    }

    /// What the newest roster says of a division: the leader of each team, and who is stale.
    fn roster_view(&self, teams: &Teams) -> (Vec<Option<RobotId>>, Vec<RobotId>) {
        let roster = self.roster.as_deref();
        let leaders = leaders(&teams.teams, roster, self.division.as_deref());
        let silent: BTreeSet<&RobotId> = match roster {
            Some(roster) => roster
                .robots
                .iter()
                .filter(|entry| entry.presence == Presence::Stale)
                .map(|entry| &entry.robot)
                .collect(),
            None => self.division.iter().flat_map(|division| &division.stale).collect(),
        };
        if silent.is_empty() {
            return (leaders, Vec::new());
        }
        let mut stale: Vec<RobotId> = teams
            .assignments()
            .map(|(robot, _)| robot)
            .chain(&teams.unassigned)
            .filter(|robot| silent.contains(robot))
            .cloned()
            .collect();
        stale.sort_unstable();
        (leaders, stale)
    }

    /// Starts a job if there is something to divide that is neither divided nor failed.
    fn consider(&mut self, effects: &mut Effects<Job>) {
        if !self.role.is_holding() || self.running.is_some() {
            return;
        }
        let Some(newest) = &self.newest else { return };
        let settings = ClustererSettings { heartbeat_s: 1.0, ..self.role.settings().clone() };
        if self.divided.as_ref().is_some_and(|task| task.is_same(newest, &settings)) {
            if let Some(told) = &mut self.told {
                told.source = newest.clone();
            }
            return;
        }
        if self.failed.as_ref().is_some_and(|task| task.is_same(newest, &settings)) {
            return;
        }
        let job = Job {
            embedding: Arc::clone(&newest.embedding),
            settings: settings.clone(),
            previous: self.division.clone(),
        };
        self.running = Some(Task { heard: newest.clone(), settings });
        self.role.count("jobs_started");
        effects.push(Effect::Start(job));
    }

    fn finish(&mut self, now: Tick, result: Result<Teams, String>, effects: &mut Effects<Job>) {
        if let Some(task) = self.running.take() {
            match result {
                Ok(teams) => self.accept(now, task, teams, effects),
                Err(reason) => {
                    self.role.count("jobs_failed");
                    let kind = EventKind::JobFailed { reason };
                    self.role.tell(now, Severity::Error, kind, effects);
                    self.failed = Some(task);
                }
            }
        }
        self.consider(effects);
    }

    fn accept(&mut self, now: Tick, task: Task, teams: Teams, effects: &mut Effects<Job>) {
        // An embedding with the same data may have come while the job ran.
        let newer = self.newest.as_ref().filter(|h| same_data(&h.embedding, &task.heard.embedding));
        let source = newer.unwrap_or(&task.heard).clone();
        self.divided = Some(task);
        self.failed = None;
        let changes = teams.changes.clone();
        let shortage = shortage(&teams);
        self.publish(now, teams, source, effects);

        let many = changes.len();
        self.role.count_many("team_changes", many as u64);
        for change in changes.into_iter().take(MAX_CHANGE_EVENTS) {
            self.role.tell(now, Severity::Info, EventKind::TeamChanged(change), effects);
        }
        if let Some(untold) = many.checked_sub(MAX_CHANGE_EVENTS).filter(|untold| *untold > 0) {
            self.role.count_many("team_changes_untold", untold as u64);
        }
        match shortage {
            Some((requested, formed, reason)) if self.fewer != Some((requested, formed)) => {
                self.fewer = Some((requested, formed));
                let kind = EventKind::FewerTeams { requested, formed, reason };
                self.role.tell(now, Severity::Warning, kind, effects);
            }
            Some(_) => {}
            None => self.fewer = None,
        }
    }

    /// Tells the last division anew, as it stands by the newest roster.
    fn repeat(&mut self, now: Tick, source: Heard, effects: &mut Effects<Job>) {
        let Some(division) = &self.division else { return };
        let teams = Teams { changes: Vec::new(), ..Teams::clone(division) };
        self.publish(now, teams, source, effects);
    }

    fn publish(&mut self, now: Tick, teams: Teams, source: Heard, effects: &mut Effects<Job>) {
        let (leaders, stale) = self.roster_view(&teams);
        let mut teams = Teams { stale, ..teams };
        for (team, leader) in teams.teams.iter_mut().zip(leaders) {
            if let Some(leader) = leader {
                team.leader = leader;
            }
        }
        let revision = self.role.next_revision();
        let stage = self.role.stage(source.received, now);
        teams.embedding = source.embedding.header.revision;
        teams.header = source.embedding.header.next_stage(revision, stage);

        let heartbeat = seconds(self.role.settings().heartbeat_s);
        let before = self.division.as_deref();
        let mirrored = self.told.as_ref().map(|told| told.mirrored);
        let mirror = mirrored.is_none_or(|last| now.since(last) >= heartbeat)
            || before.is_none_or(|before| !before.same_division(&teams));
        let teams = Arc::new(teams);
        effects.publish(Message::Teams { teams: Arc::clone(&teams), mirror });
        self.role.count("divisions_published");

        for robot in robots_to_tell(&teams, before.filter(|_| self.robots_told)) {
            if let Some(told) = teams.robot_team(robot) {
                effects.publish(Message::RobotTeam(told));
            }
        }
        self.robots_told = true;
        let mirrored = if mirror { now } else { mirrored.unwrap_or(now) };
        self.told = Some(Told { source, published: now, mirrored });
        self.division = Some(teams);
    }

    fn begin(&mut self, now: Tick, messages: Vec<Message>, effects: &mut Effects<Job>) {
        for message in &messages {
            if let Message::Teams { teams, .. } = message {
                let last = self.division.as_ref().map(|division| division.header.revision);
                // Whatever is told was checked, but a division that contradicts itself would spoil
                // every later one.
                if last.is_none_or(|last| teams.header.revision > last) && teams.check().is_ok() {
                    self.division = Some(Arc::clone(teams));
                }
            }
        }
        let seen = self.division.as_ref().map(|division| division.header.revision);
        self.role.begin_term(now, seen, effects);
        for message in messages {
            self.take_in(now, message, effects);
        }
        self.consider(effects);
    }

    fn answer(&mut self, now: Tick, query: QueryId, request: Request, effects: &mut Effects<Job>) {
        let state = self.state();
        match self.role.answer(now, query, request, &state, effects) {
            Answered::Done => {}
            Answered::SettingsChanged => self.consider(effects),
            Answered::NotOurs(query, request) => {
                let answer = self.select(&request);
                effects.push(Effect::Reply { query, request, answer });
            }
        }
    }

    fn select(&self, request: &Request) -> Result<Vec<Message>, String> {
        let space = self.role.space();
        let selects = |key: &Key| request.selects(space, key);
        let mut messages = Vec::new();
        if let Some(teams) = &self.division {
            if selects(&Key::Teams) || selects(&Key::JsonTeams) {
                messages.push(Message::Teams { teams: Arc::clone(teams), mirror: true });
            }
            let mut names: usize = 0;
            let sizes = teams
                .teams
                .iter()
                .flat_map(|team| team.members.iter().map(|m| (&m.robot, team.members.len())))
                .chain(teams.unassigned.iter().map(|robot| (robot, 0)));
            let mut robots = Vec::new();
            for (robot, size) in sizes {
                if selects(&Key::RobotTeam(robot.clone())) {
                    names = names.saturating_add(size);
                    robots.push(robot);
                }
            }
            if names > MAX_NAMES_ANSWERED {
                return Err(format!(
                    "the teams of these robots name {names} members, which is more than one answer \
                     may hold; get {} or the team of one robot",
                    space.format(&Key::Teams)
                ));
            }
            messages.extend(
                robots.into_iter().filter_map(|r| teams.robot_team(r)).map(Message::RobotTeam),
            );
        }
        if let Some(newest) = &self.newest
            && selects(&Key::Embedding)
        {
            messages.push(Message::Embedding(Arc::clone(&newest.embedding)));
        }
        Ok(messages)
    }

    fn state(&self) -> String {
        match (&self.division, &self.newest) {
            (Some(division), Some(_)) => {
                let teams = division.teams.len();
                let assigned: usize = division.teams.iter().map(|team| team.members.len()).sum();
                let robots = assigned + division.unassigned.len();
                format!("{} of {}", counted(teams, "team"), counted(robots, "robot"))
            }
            (None, Some(_)) => "dividing the first embedding".to_owned(),
            (_, None) => "waiting for an embedding".to_owned(),
        }
    }
}

fn counted(many: usize, what: &str) -> String {
    if many == 1 { format!("1 {what}") } else { format!("{many} {what}s") }
}

/// How many teams were asked for, how many there are, and why, if they are too few.
fn shortage(teams: &Teams) -> Option<(u32, u32, String)> {
    let formed = u32::try_from(teams.teams.len()).unwrap_or(u32::MAX);
    if formed >= teams.requested {
        return None;
    }
    let placed: usize = teams.teams.iter().map(|team| team.members.len()).sum();
    let reason = if placed == 0 && teams.unassigned.is_empty() {
        "there are no robots".to_owned()
    } else if placed == 0 {
        "nothing relates the robots to each other".to_owned()
    } else if placed < teams.requested as usize {
        format!("only {} can be placed", counted(placed, "robot"))
    } else {
        format!("the robots' places differ in only {}", counted(formed as usize, "way"))
    };
    Some((teams.requested, formed, reason))
}

/// The robots whose team is another than before, or has other members or another leader; all if
/// nothing was told before.
fn robots_to_tell<'a>(teams: &'a Teams, before: Option<&Teams>) -> Vec<&'a RobotId> {
    let old: BTreeMap<_, _> =
        before.into_iter().flat_map(|b| b.teams.iter().map(|team| (&team.id, team))).collect();
    let changed = teams.teams.iter().filter(|team| {
        old.get(&team.id).is_none_or(|old| {
            old.leader != team.leader
                || old.members.len() != team.members.len()
                || old.members.iter().zip(&team.members).any(|(old, new)| old.robot != new.robot)
        })
    });
    let members = changed.flat_map(|team| team.members.iter().map(|member| &member.robot));
    let loose = teams.unassigned.iter().filter(|robot| {
        before.is_none_or(|before| before.unassigned.binary_search(robot).is_err())
    });
    members.chain(loose).collect()
}

impl Core for Clusterer {
    type Settings = ClustererSettings;
    type Job = Job;
    type Done = Outcome;
    const SERVICE: ServiceName = ServiceName::Clusterer;

    fn wiring() -> Wiring {
        let subscription = |key| Subscription {
            pattern: Pattern::One(key),
            delivery: Delivery::Latest,
            max_payload: MAX_SERVICE_PAYLOAD,
        };
        Wiring {
            subscriptions: vec![subscription(Key::Embedding), subscription(Key::Roster)],
            tokens: vec![],
            served: vec![
                (Pattern::One(Key::Teams), true),
                (Pattern::One(Key::JsonTeams), true),
                (Pattern::RobotTeams, true),
                (Pattern::One(Key::Embedding), false),
            ],
        }
    }

    fn new(start: Start<ClustererSettings>) -> Self {
        Self {
            role: Role::new(Self::SERVICE, start),
            newest: None,
            roster: None,
            running: None,
            divided: None,
            failed: None,
            division: None,
            told: None,
            robots_told: false,
            fewer: None,
        }
    }

    fn handle(&mut self, now: Tick, event: Event<Outcome>, effects: &mut Effects<Job>) {
        match event {
            Event::Started => effects.push(Effect::Fetch {
                fetch: START_FETCH,
                patterns: vec![
                    Pattern::One(Key::Teams),
                    Pattern::One(Key::Embedding),
                    Pattern::One(Key::Roster),
                ],
            }),
            Event::Fetched { fetch: START_FETCH, messages } if !self.role.is_holding() => {
                self.begin(now, messages, effects);
            }
            Event::Fetched { messages, .. } => {
                for message in messages {
                    self.take_in(now, message, effects);
                }
            }
            Event::Received(message) => self.take_in(now, message, effects),
            Event::Rejected(rejection) => self.role.quarantine(now, rejection, effects),
            Event::Timeout => {
                if self.deadline().is_some_and(|due| now >= due)
                    && let Some(told) = &self.told
                {
                    let source = told.source.clone();
                    self.repeat(now, source, effects);
                }
            }
            Event::Done(Outcome(result)) => self.finish(now, result, effects),
            Event::JobFailed(reason) => self.finish(now, Err(reason), effects),
            Event::Query { query, request } => self.answer(now, query, request, effects),
            Event::LinkLost => {}
            Event::LinkRestored => {
                effects.push(Effect::Fetch {
                    fetch: LINK_FETCH,
                    patterns: vec![Pattern::One(Key::Embedding), Pattern::One(Key::Roster)],
                });
                self.robots_told = false;
                if let Some(told) = &self.told {
                    let source = told.source.clone();
                    self.repeat(now, source, effects);
                }
            }
        }
    }

    fn deadline(&self) -> Option<Tick> {
        let told = self.told.as_ref()?;
        Some(told.published.after(seconds(self.role.settings().heartbeat_s)))
    }

    fn run(job: Job) -> Outcome {
        Outcome(divide(&job))
    }
}
