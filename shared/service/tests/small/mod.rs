//! A small core that does everything that cores do, and a host of it that is driven by hand.

use std::collections::BTreeMap;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::time::Duration;

use muster_model::command::CommandOutcome;
use muster_model::content::Checked;
use muster_model::event::{EventKind, Severity};
use muster_model::header::{Header, Revision};
use muster_model::history::{Page, Query, Record, RecordingReport, Retention, Subject};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::observation::{CheckedReport, Pose, Report};
use muster_model::remembered::RememberedTeams;
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_model::settings::{ClustererSettings, TeamCount};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_service::testkit::{Bench, command_of};
use muster_service::{
    Ask, Connectivity, Context, Core, Get, GetId, IncomingGet, Input, JobEnd, Replication, Start,
    Stopwatch, Stored, View, Wiring,
};
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::{ForeignKey, Key, KeySpace, Message, Packet, Pattern};
use serde_json::{Value, json};

/// Stands for settings without a fixed number of teams, such as the default ones.
pub(crate) const AUTO: u32 = 0;

fn count(settings: &ClustererSettings) -> u32 {
    settings.teams.fixed().unwrap_or(AUTO)
}

pub(crate) const START: Tick = Tick(1_000_000_000);

/// One instance leads.
pub(crate) const ONE_LEADS: u8 = 0;
/// The same with one number changed.
pub(crate) const CHANGED: u8 = 1;
/// Every instance works for itself, and asks for nothing first.
pub(crate) const EVERY_INSTANCE: u8 = 2;

/// A core that writes down what happens to it, and reports it by events. Tokens of robots with certain
/// names make it do certain things.
pub(crate) struct Small<const KIND: u8> {
    pub(crate) log: Vec<String>,
    /// The number of teams in the settings in force; [`AUTO`] by default.
    pub(crate) teams: u32,
    /// The starts of k-means in the settings in force.
    pub(crate) restarts: u32,
    sum: f64,
    gets: Vec<Get>,
}

impl<const KIND: u8> Small<KIND> {
    fn report(&mut self, context: &mut Context<'_, Self>, text: String) {
        self.log.push(text.clone());
        context.publish_event(Severity::Info, EventKind::JobFailed { reason: text });
    }

    fn obey(&mut self, context: &mut Context<'_, Self>, order: &str) {
        let key = || Key::RobotToken(RobotId::new("other").unwrap());
        match order {
            "fetch" => context.fetch(7, vec![Pattern::One(Key::Roster), Pattern::Graphs]),
            "append" => context.append(Record::Present(Vec::new())),
            "lookup" => context.look_up(5, Query::of(Subject::Divisions)),
            "retain" => context.retain(Retention { before: Tick(1), max_bytes: 2 }),
            "declare" => context.declare_token(key()),
            "withdraw" => context.withdraw_token(key()),
            "abandon" => context.abandon_job(),
            "hasty" => {
                let slot = context.free_job_slot().unwrap();
                context.start_job(slot, 0.0);
                context.abandon_job();
            }
            "output" => {
                let header = header(context.next_revision());
                context.publish(output(header));
            }
            other => panic!("{other}"),
        }
    }

    fn start(&mut self, context: &mut Context<'_, Self>) {
        match context.free_job_slot() {
            Some(slot) => context.start_job(slot, self.sum),
            None => self.log.push("busy".to_owned()),
        }
    }
}

impl<const KIND: u8> Core for Small<KIND> {
    type Settings = ClustererSettings;
    type Fetch = u8;
    type Job = f64;
    type Done = String;
    const SERVICE: ServiceName = ServiceName::Clusterer;
    const REPLICATION: Replication =
        if KIND == EVERY_INSTANCE { Replication::EveryInstance } else { Replication::OneLeads };

    fn wiring() -> Wiring {
        Wiring::default()
    }

    fn initial() -> Vec<Pattern> {
        if KIND == EVERY_INSTANCE {
            return Vec::new();
        }
        vec![Pattern::One(Key::Teams), Pattern::Graphs]
    }

    fn output() -> Key {
        Key::Teams
    }

    fn is_output(message: &Message) -> bool {
        matches!(message, Message::Teams { .. })
    }

    fn new(_now: Tick, settings: &ClustererSettings) -> Self {
        let (teams, restarts) = (count(settings), settings.restarts);
        Self { log: Vec::new(), teams, restarts, sum: 0.0, gets: Vec::new() }
    }

    fn on_lead(&mut self, context: &mut Context<'_, Self>, answers: Vec<Message>) {
        self.report(context, format!("leads with {} messages", answers.len()));
    }

    fn on_follow(&mut self, context: &mut Context<'_, Self>, answers: Vec<Message>) {
        self.report(context, format!("follows with {} messages", answers.len()));
    }

    fn on_stand_down(&mut self, context: &mut Context<'_, Self>) {
        self.report(context, "stands down".to_owned());
    }

    fn on_new_term(&mut self, context: &mut Context<'_, Self>, found: Vec<Message>) {
        self.report(context, format!("new term with {} messages", found.len()));
    }

    fn on_message(&mut self, context: &mut Context<'_, Self>, message: Message) {
        match message {
            Message::Report(report) => {
                let (robot, Report::Pose(pose)) = report.into_parts() else { return };
                assert!(robot.as_str() != "cursed", "a pose that must not be");
                self.sum += pose.x + f64::from(u8::from(KIND == CHANGED && pose.x > 40.0));
                self.start(context);
            }
            Message::RobotToken { robot, alive: true } => self.obey(context, robot.as_str()),
            other => self.report(context, format!("{other:?}")),
        }
    }

    /// Answers another program on its own key, with its attachment.
    fn on_foreign(&mut self, context: &mut Context<'_, Self>, packet: Packet) {
        let key = ForeignKey::new(format!("{}/reply", packet.key)).unwrap();
        let payload = packet.payload.unwrap();
        context.publish_foreign(&key, &packet.encoding, payload, packet.attachment);
    }

    /// A get of the embedding waits for a job.
    fn on_get(&mut self, context: &mut Context<'_, Self>, get: Get) {
        if get.request.selects(context.space(), &Key::Embedding) {
            self.gets.push(get);
        } else {
            context.reply_error(get, "no");
        }
    }

    fn on_answers(&mut self, context: &mut Context<'_, Self>, fetch: u8, answers: Vec<Message>) {
        self.report(context, format!("fetch {fetch} has {} answers", answers.len()));
    }

    fn on_timer(&mut self, context: &mut Context<'_, Self>) {
        self.report(context, "timer".to_owned());
    }

    fn on_job(&mut self, context: &mut Context<'_, Self>, end: JobEnd<String>) {
        for get in std::mem::take(&mut self.gets) {
            context.reply(get, Vec::new());
        }
        match end {
            JobEnd::Finished(text) | JobEnd::Panicked(text) => self.report(context, text),
        }
    }

    fn on_job_slot_free(&mut self, context: &mut Context<'_, Self>) {
        self.report(context, "the slot is free".to_owned());
        self.start(context);
    }

    fn on_records(
        &mut self,
        context: &mut Context<'_, Self>,
        lookup: u64,
        page: Result<Page, String>,
    ) {
        let found = page.map_or_else(|error| error, |page| format!("{:?}", page.rows));
        self.report(context, format!("lookup {lookup} finds {found}"));
    }

    fn on_recorded(&mut self, context: &mut Context<'_, Self>, report: RecordingReport) {
        self.report(context, format!("recorded {} records", report.coverage.sequence));
    }

    fn on_settings(&mut self, context: &mut Context<'_, Self>) {
        self.report(context, "settings".to_owned());
    }

    fn on_connectivity(&mut self, context: &mut Context<'_, Self>, connectivity: Connectivity) {
        self.report(context, format!("{connectivity:?}"));
    }

    fn after_input(&mut self, context: &mut Context<'_, Self>) {
        self.teams = count(context.settings());
        self.restarts = context.settings().restarts;
    }

    fn deadline(&self, _view: &View<'_, Self>) -> Option<Tick> {
        None
    }

    fn state(&self, _view: &View<'_, Self>) -> String {
        "small".to_owned()
    }

    fn run(sum: f64, stopwatch: &mut Stopwatch) -> String {
        let first = stopwatch.lap();
        assert!(sum < 1e6, "more than a job bears");
        format!("{sum} after {first} and {}", stopwatch.lap())
    }
}

pub(crate) fn space() -> KeySpace {
    KeySpace::new(FleetId::new("alpha").unwrap())
}

pub(crate) fn instance(host: &str) -> InstanceId {
    InstanceId::of_process(host, 1, 1)
}

pub(crate) fn header(revision: Revision) -> Header {
    let (fleet, stages) = (space().fleet().clone(), Vec::new());
    Header { fleet, revision, oldest: None, newest: None, stages }
}

/// An output of the core.
pub(crate) fn output(header: Header) -> Message {
    let teams = Teams {
        header,
        embedding: Revision::default(),
        requested: 0,
        considered: vec![],
        teams: Vec::new(),
        unassigned: Vec::new(),
        stale: Vec::new(),
        inertia: 0.0,
        changes: Vec::new(),
        next_team: 1,
        limited: None,
        needs: vec![],
        provisional: vec![],
        held: vec![],
        remembered: RememberedTeams::default(),
    };
    Message::Teams { teams: Checked::new_unchecked(teams), mirror: false }
}

pub(crate) fn pose(robot: &str, x: f64) -> Message {
    let (heading, frame, stamp) = (None, None, None);
    let pose = Pose { x, y: 0.0, z: None, heading, frame, stamp, boot: None, seq: None };
    Message::Report(CheckedReport::new(RobotId::new(robot).unwrap(), pose).unwrap())
}

/// Makes the core do something.
pub(crate) fn order(order: &str) -> Message {
    Message::RobotToken { robot: RobotId::new(order).unwrap(), alive: true }
}

pub(crate) fn token(host: &str, alive: bool) -> Message {
    Message::ServiceToken { service: ServiceName::Clusterer, instance: instance(host), alive }
}

pub(crate) fn renewal(host: &str, term: u64, epoch: u64) -> Message {
    Message::LeaseRenewal(Box::new(LeaseRenewal {
        header: header(Revision { term, epoch }),
        service: ServiceName::Clusterer,
        instance: instance(host),
    }))
}

/// Settings that a leader has announced, or answered. No operator has changed them.
pub(crate) fn settings(term: u64, epoch: u64, teams: u32) -> Message {
    settings_with((term, epoch), teams, BTreeMap::new())
}

/// Settings of a leader whose number of teams an operator has changed at a moment.
pub(crate) fn settings_changed(changed: Tick, term: u64, epoch: u64, teams: u32) -> Message {
    settings_with((term, epoch), teams, BTreeMap::from([("teams".to_owned(), changed)]))
}

fn settings_with(
    (term, epoch): (u64, u64),
    teams: u32,
    changed: BTreeMap<String, Tick>,
) -> Message {
    let teams = TeamCount::Fixed(teams);
    let settings = ClustererSettings { teams, ..ClustererSettings::default() };
    Message::Settings(Box::new(AnnouncedSettings {
        header: header(Revision { term, epoch }),
        service: ServiceName::Clusterer,
        settings: serde_json::to_string(&settings).unwrap(),
        changed,
    }))
}

pub(crate) fn get(id: u64, key: &Key, payload: Option<&str>) -> Input {
    let command =
        payload.and_then(|payload| command_of(START, &key.to_string(), &format!("c{id}"), payload));
    let (key, payload) = match command {
        Some((key, command)) => (key, Some(command)),
        None => (key.to_string(), payload.map(str::to_owned)),
    };
    Input::Get(IncomingGet {
        get: GetId(id),
        selector: format!("muster/v1/{}/{key}", space().fleet()),
        narrowed: None,
        parameters: String::new(),
        payload: payload.map(String::into_bytes),
    })
}

/// A bench that runs no job by itself, and answers no question for the leader.
pub(crate) struct Driven<const KIND: u8 = ONE_LEADS>(Bench<Small<KIND>>);

impl<const KIND: u8> Deref for Driven<KIND> {
    type Target = Bench<Small<KIND>>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<const KIND: u8> DerefMut for Driven<KIND> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl<const KIND: u8> Driven<KIND> {
    pub(crate) fn new() -> Self {
        Self::with_stored(Stored::default())
    }

    pub(crate) fn with_stored(stored: Stored) -> Self {
        let mut bench = Bench::new(Start {
            fleet: space().fleet().clone(),
            instance: instance("b"),
            now: START,
            settings: ClustererSettings::default(),
            stored,
        });
        (bench.hold_jobs, bench.hold_leader_queries) = (true, true);
        Self(bench)
    }

    /// One that has asked the bus, and whose last questions are answered now.
    pub(crate) fn answered(messages: Vec<Message>) -> Self {
        Self::restarted(Stored::default(), messages)
    }

    /// The same with what it has on its disk.
    pub(crate) fn restarted(stored: Stored, messages: Vec<Message>) -> Self {
        let mut driven = Self::with_stored(stored);
        driven.now = START.before(Duration::from_secs(2));
        driven.input(Input::Started { linked: true });
        driven.now = START;
        driven.answer_all(messages);
        driven
    }

    /// One that leads. What it did on the way is forgotten.
    pub(crate) fn leading() -> Self {
        let mut driven = Self::answered(Vec::new());
        assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
        driven.published.clear();
        driven.others.clear();
        driven
    }

    /// The questions who leads, which do not wait afterwards.
    pub(crate) fn leader_queries(&mut self) -> Vec<Ask> {
        let of_leader =
            |ask: &mut Ask| ask.pattern == Pattern::One(Key::Lease(ServiceName::Clusterer));
        self.asks.extract_if(.., of_leader).collect()
    }

    /// Lets time pass; the process runs all the while.
    pub(crate) fn wait(&mut self, seconds: f64) {
        let end = self.now.after(Duration::from_secs_f64(seconds));
        while self.now < end {
            self.now = self.now.after(Duration::from_millis(500)).min(end);
            self.input(Input::Timer);
        }
    }

    /// What the core wrote down after so many lines.
    pub(crate) fn log_after(&self, count: usize) -> &[String] {
        &self.host.core().log[count..]
    }

    pub(crate) fn logged(&self) -> usize {
        self.host.core().log.len()
    }

    pub(crate) fn teams(&self) -> u32 {
        self.host.core().teams
    }

    /// The numbers of teams in the settings that were announced since the last call.
    pub(crate) fn announced(&mut self) -> Vec<u32> {
        let mut announced = Vec::new();
        for message in self.published.drain(..) {
            if let Message::Settings(settings) = message {
                let settings: ClustererSettings = serde_json::from_str(&settings.settings).unwrap();
                announced.push(count(&settings));
            }
        }
        announced
    }
}

/// Sends a command and returns its answer.
pub(crate) fn command(driven: &mut Driven, key: &str, content: &Value) -> Result<Value, String> {
    let before = driven.replies.len();
    let get = GetId(1000 + before as u64);
    driven.input(Input::Get(IncomingGet {
        get,
        selector: format!("muster/v1/alpha/command/clusterer/{key}"),
        narrowed: None,
        parameters: String::new(),
        payload: (!content.is_null()).then(|| content.to_string().into_bytes()),
    }));
    assert_eq!(driven.replies.len(), before + 1, "one answer");
    let answer = driven.replies[before].answer.clone()?;
    let Some(packet) = answer.first() else { return Ok(Value::Null) };
    assert_eq!(packet.key, format!("muster/v1/alpha/command/clusterer/{key}"));
    Ok(serde_json::from_slice(packet.payload.as_ref().unwrap()).unwrap())
}

/// Sends a command that changes settings, by a right clock.
pub(crate) fn set(driven: &mut Driven, key: &str, patch: &Value) -> Result<Value, String> {
    let now = driven.now.as_seconds();
    let content = json!({"sent": now, "expires": now + 60.0, "action": {"set": patch}});
    command(driven, key, &content)
}

/// What it has published of commands.
pub(crate) fn outcomes(driven: &Driven) -> Vec<Arc<CommandOutcome>> {
    let outcome = |message: &Message| match message {
        Message::Outcome(outcome) => Some(Arc::clone(outcome)),
        _ => None,
    };
    driven.commanded.iter().filter_map(outcome).collect()
}

/// The leader is gone, and no instance answers.
pub(crate) fn take_over(driven: &mut Driven) {
    driven.receive(token("a", true));
    driven.receive(token("a", false));
    driven.wait(0.5);
    driven.answer_all(Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
}
