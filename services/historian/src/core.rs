//! What is recorded when, what is published of it, and how gets are answered.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::event::{Event, EventKind, Severity};
use muster_model::header::Revision;
use muster_model::history::{
    EventRecord, HistoryAnswer, Page, Record, RecordingReport, RecordingState, Retention,
    SnapshotCause,
};
use muster_model::id::ServiceName;
use muster_model::settings::HistorianSettings;
use muster_model::status::StatusGauge;
use muster_model::time::{Tick, seconds};
use muster_service::{
    Context, Core, Delivery, Get, JobEnd, MemoryUse, Replication, ServedKey, Stopwatch,
    Subscription, View, Wiring,
};
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::history::{event_text, query};
use muster_wire::json::Problem;
use muster_wire::message::plain_reason;
use muster_wire::{Key, Message, Pattern};

use crate::audits::Audits;
use crate::divisions::Divisions;
use crate::fleet::Fleet;
use crate::positions::Positions;

/// Most events that wait for the core: those of a fleet whose robots all change their team at once.
const QUEUE_EVENTS: usize = 4096;

/// Most divisions that wait for the core: a second of them. Only the newest must arrive, but each tells what
/// happened when.
const QUEUE_DIVISIONS: usize = 16;

/// Most settings of one service that wait for the core.
const QUEUE_SETTINGS: usize = 4;

/// Most gets that wait for the store at once.
const MAX_LOOKUPS: usize = 64;

/// How often old records are looked for.
const RETENTION_INTERVAL: Duration = Duration::from_secs(60);

/// Bytes of a megabyte.
const MEGABYTE: f64 = 1e6;

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// How many records were lost.
const RECORDS_LOST: &str = "records_lost";

/// Records what a fleet was.
#[derive(Debug, Default)]
pub struct Historian {
    divisions: Divisions,
    audits: Audits,
    fleet: Fleet,
    positions: Positions,
    /// The settings of each service as recorded, and which output of it announced them.
    settings: BTreeMap<ServiceName, (Revision, String)>,
    /// The newest report of the store.
    report: Option<RecordingReport>,
    /// How many records were lost since the start, and since recording was degraded.
    lost: u64,
    lost_degraded: u64,
    /// Whether operators have been told that recording is degraded.
    is_degraded: bool,
    /// A damaged file of which operators have not been told.
    damaged: Option<String>,
    /// What was last published.
    published: Option<RecordingState>,
    lookups: BTreeMap<u64, Get>,
    next_lookup: u64,
    retain_at: Tick,
}

type HistorianContext<'a> = Context<'a, Historian>;

impl Historian {
    fn receive(&mut self, context: &mut HistorianContext<'_>, message: Message) {
        match message {
            Message::Teams { teams, .. } => {
                if let Some(division) = self.divisions.receive(context.now(), teams) {
                    record(context, Record::Division(division));
                }
            }
            Message::Audit(audit) => self.audits.receive(context.now(), audit),
            Message::Roster(roster) => {
                for change in self.fleet.receive(context.now(), roster) {
                    record(context, change);
                }
            }
            Message::RobotToken { robot, alive } => self.fleet.token(robot, alive),
            Message::Event(event) => record(context, Record::Event(recorded(event))),
            Message::Settings(settings) => self.receive_settings(context, &settings),
            _ => {}
        }
    }

    fn receive_settings(
        &mut self,
        context: &mut HistorianContext<'_>,
        announced: &AnnouncedSettings,
    ) {
        // A leader without a term announces what nobody is to take over.
        let AnnouncedSettings { header, service, settings, .. } = announced;
        let known = self.settings.get(service).map(|(_, settings)| settings);
        if header.revision.term == 0 || known == Some(settings) {
            return;
        }
        let (service, revision, settings) = (*service, header.revision, settings.clone());
        self.settings.insert(service, (revision, settings.clone()));
        record(context, Record::Settings { service, revision, settings });
    }

    /// Records all that is in force once more: what was recorded of it may be lost, and services do not say it again.
    fn record_again(&mut self, context: &mut HistorianContext<'_>) {
        self.positions.forget();
        self.audits.forget();
        self.record_whole(context, SnapshotCause::Gap);
        for (service, (revision, settings)) in &self.settings {
            let (service, revision, settings) = (*service, *revision, settings.clone());
            record(context, Record::Settings { service, revision, settings });
        }
    }

    /// Records everything as a whole.
    fn record_whole(&mut self, context: &mut HistorianContext<'_>, cause: SnapshotCause) {
        let division = self.divisions.snapshot(context.now(), cause);
        let whole = division.map(Record::Division).into_iter();
        for entry in whole.chain(self.fleet.present().filter(|_| cause == SnapshotCause::Gap)) {
            record(context, entry);
        }
    }

    /// The state of the recording as it is published.
    fn state_message(&self, context: &HistorianContext<'_>) -> Option<RecordingState> {
        let report = self.report.as_ref()?;
        Some(RecordingState {
            fleet: context.fleet().clone(),
            instance: context.instance().clone(),
            coverage: report.coverage.clone(),
            lost: self.lost,
            degraded: report.problem.as_deref().map(plain_reason),
        })
    }

    fn publish_state(&mut self, context: &mut HistorianContext<'_>) {
        let state = self.state_message(context);
        if context.is_leading() && state != self.published {
            self.published.clone_from(&state);
            if let Some(state) = state {
                context.publish(Message::HistoryState(Box::new(state)));
            }
        }
    }

    /// Tells operators that a file was damaged, and that recording is degraded or is not any more.
    fn report_problem(&mut self, context: &mut HistorianContext<'_>) {
        let problem = self.report.as_ref().and_then(|report| report.problem.clone());
        context.set(StatusGauge::HistoryDegraded, u64::from(problem.is_some()));
        if !context.is_leading() {
            return;
        }
        if let Some(damaged) = self.damaged.take() {
            let reason = plain_reason(&damaged);
            context.publish_event(Severity::Error, EventKind::HistoryDamaged { reason });
        }
        if problem.is_some() == self.is_degraded {
            return;
        }
        self.is_degraded = problem.is_some();
        match problem {
            Some(problem) => {
                self.lost_degraded = self.lost;
                let reason = plain_reason(&problem);
                context.publish_event(Severity::Warning, EventKind::HistoryDegraded { reason });
            }
            None => {
                let lost = self.lost - self.lost_degraded;
                context.publish_event(Severity::Info, EventKind::HistoryRecovered { lost });
            }
        }
    }

    fn retain(&mut self, context: &mut HistorianContext<'_>) {
        self.retain_at = context.now().after(RETENTION_INTERVAL);
        let settings = context.settings();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "settings are checked to be positive and far below the largest number"
        )]
        let max_bytes = (settings.max_mb * MEGABYTE) as u64;
        let before = context.now().before(seconds(settings.keep_days * DAY_S));
        context.retain(Retention { before, max_bytes });
    }

    /// When scores of a division are recorded again.
    fn audit_due(&self, settings: &HistorianSettings) -> Option<Tick> {
        self.audits.due(seconds(settings.audit_interval_s))
    }

    fn look_up(&mut self, context: &mut HistorianContext<'_>, get: Get) {
        let asked = match query(&get.request.parameters) {
            Ok(asked) => asked,
            Err(error) => {
                let problem = Problem::new(&error.field, &error.problem).to_json();
                return context.reply_error(get, problem);
            }
        };
        if self.lookups.len() >= MAX_LOOKUPS {
            let problem = "too many gets wait for the history; ask again later";
            return context.reply_error(get, Problem::unavailable("(get)", problem).to_json());
        }
        self.next_lookup += 1;
        self.lookups.insert(self.next_lookup, get);
        context.look_up(self.next_lookup, asked);
    }
}

fn record(context: &mut HistorianContext<'_>, entry: Record) {
    context.count("records_made");
    context.append(entry);
}

fn recorded(event: Event) -> EventRecord {
    let text = event_text(&event.kind);
    EventRecord {
        source: event.source,
        revision: event.header.revision,
        severity: event.severity,
        kind: text.kind,
        detail: text.detail,
    }
}

impl Core for Historian {
    type Settings = HistorianSettings;
    type Fetch = std::convert::Infallible;
    type Job = std::convert::Infallible;
    type Done = std::convert::Infallible;
    const SERVICE: ServiceName = ServiceName::Historian;
    const REPLICATION: Replication = Replication::EveryInstance;

    fn wiring() -> Wiring {
        let subscription = |key, delivery| Subscription { pattern: Pattern::One(key), delivery };
        let mut subscriptions = vec![
            subscription(Key::Teams, Delivery::Queue(QUEUE_DIVISIONS)),
            subscription(Key::Audit, Delivery::Latest),
            subscription(Key::Roster, Delivery::Latest),
            subscription(Key::Event, Delivery::Queue(QUEUE_EVENTS)),
        ];
        subscriptions.extend(
            ServiceName::PIPELINE.map(|service| {
                subscription(Key::Settings(service), Delivery::Queue(QUEUE_SETTINGS))
            }),
        );
        Wiring {
            subscriptions,
            tokens: vec![Pattern::RobotTokens],
            fetched: vec![],
            served: [Pattern::Histories, Pattern::HistoryStates].map(ServedKey::own).to_vec(),
        }
    }

    fn initial() -> Vec<Pattern> {
        [Key::Teams, Key::Audit, Key::Roster].map(Pattern::One).to_vec()
    }

    fn output() -> Key {
        Key::Status(Self::SERVICE)
    }

    fn is_output(_: &Message) -> bool {
        false
    }

    fn new(_: Tick, _: &HistorianSettings) -> Self {
        Self::default()
    }

    fn on_lead(&mut self, context: &mut HistorianContext<'_>, mut answers: Vec<Message>) {
        answers.sort_by_key(|message| message.header().map(|header| header.revision));
        for message in answers {
            self.receive(context, message);
        }
        self.retain(context);
        self.report_problem(context);
        self.publish_state(context);
    }

    fn on_follow(&mut self, _: &mut HistorianContext<'_>, _: Vec<Message>) {}

    fn on_stand_down(&mut self, _: &mut HistorianContext<'_>) {}

    fn on_new_term(&mut self, _: &mut HistorianContext<'_>, _: Vec<Message>) {}

    fn on_message(&mut self, context: &mut HistorianContext<'_>, message: Message) {
        self.receive(context, message);
    }

    fn on_get(&mut self, context: &mut HistorianContext<'_>, get: Get) {
        let space = context.space();
        if get.request.selects(space, &Key::History(context.instance().clone())) {
            return self.look_up(context, get);
        }
        let state = self.state_message(context).map(Box::new).map(Message::HistoryState);
        context.reply(get, state.into_iter().collect());
    }

    fn on_records(
        &mut self,
        context: &mut HistorianContext<'_>,
        lookup: u64,
        page: Result<Page, String>,
    ) {
        let Some(get) = self.lookups.remove(&lookup) else { return };
        match page {
            Ok(Page { rows, before }) => {
                let coverage = self.report.as_ref().map(|report| &report.coverage);
                let answer = Message::History(Box::new(HistoryAnswer {
                    fleet: context.fleet().clone(),
                    instance: context.instance().clone(),
                    recorded_from: coverage.and_then(|coverage| coverage.recorded_from),
                    recorded_through: coverage.and_then(|coverage| coverage.recorded_through),
                    before,
                    rows,
                }));
                // A get with wildcards may ask for both; what it does not select is left out.
                let state = self.state_message(context).map(Box::new).map(Message::HistoryState);
                context.reply(get, [answer].into_iter().chain(state).collect());
            }
            Err(problem) => {
                let problem = Problem::new("(history)", &plain_reason(&problem)).to_json();
                context.reply_error(get, problem);
            }
        }
    }

    fn on_recorded(&mut self, context: &mut HistorianContext<'_>, report: RecordingReport) {
        context.set(
            StatusGauge::RecordedThrough,
            report.coverage.recorded_through.map_or(0, |at| at.0),
        );
        context.set(StatusGauge::HistoryBytes, report.coverage.bytes);
        context.add(RECORDS_LOST, report.lost);
        self.lost += report.lost;
        self.damaged = report.damaged.clone().or(self.damaged.take());
        // What comes next rests on nothing otherwise.
        if report.lost > 0 || report.damaged.is_some() {
            self.record_again(context);
        }
        self.report = Some(report);
        self.report_problem(context);
        self.publish_state(context);
    }

    fn on_settings(&mut self, context: &mut HistorianContext<'_>) {
        self.retain(context);
    }

    fn on_timer(&mut self, context: &mut HistorianContext<'_>) {
        let now = context.now();
        if self.divisions.due().is_some_and(|due| due <= now) {
            self.record_whole(context, SnapshotCause::Periodic);
        }
        if self.retain_at <= now && context.is_leading() {
            self.retain(context);
        }
    }

    fn on_job(&mut self, _: &mut HistorianContext<'_>, _: JobEnd<Self::Done>) {}

    fn after_input(&mut self, context: &mut HistorianContext<'_>) {
        let interval = seconds(context.settings().audit_interval_s);
        if let Some(audit) = self.audits.take(context.now(), interval) {
            record(context, Record::Audit(audit));
        }
        let interval = seconds(context.settings().positions_interval_s);
        if let Some(roster) = self.fleet.roster()
            && let Some(positions) = self.positions.take(context.now(), interval, roster)
        {
            record(context, Record::Positions(positions));
        }
    }

    fn deadline(&self, view: &View<'_, Self>) -> Option<Tick> {
        let retain = view.is_leading().then_some(self.retain_at);
        let audit = self.audit_due(view.settings());
        [self.divisions.due(), retain, audit].into_iter().flatten().min()
    }

    fn state(&self, _: &View<'_, Self>) -> String {
        match &self.report {
            None => "opening the history".to_owned(),
            Some(RecordingReport { problem: Some(problem), .. }) => {
                format!("degraded: {}", plain_reason(problem))
            }
            Some(report) => format!("recording, {} records so far", report.coverage.sequence),
        }
    }

    fn memory_use(&self) -> MemoryUse {
        MemoryUse {
            robots: self.fleet.robots() + self.divisions.robots() + self.positions.robots(),
            messages: self.settings.len() + self.lookups.len(),
            ..MemoryUse::default()
        }
    }

    fn run(job: Self::Job, _: &mut Stopwatch) -> Self::Done {
        job
    }
}
