//! The shell around a small core, over a real router: jobs that panic, deadlines under traffic, gets,
//! and what is kept.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use common::{config, connected, passive_core, router};
use muster_model::event::{EventKind, Severity};
use muster_model::history::{Page, Query, Record, RecordingReport, Rows, Subject};
use muster_model::id::ServiceName;
use muster_model::observation::Stream;
use muster_model::settings::ClustererSettings;
use muster_model::time::Tick;
use muster_runtime::bus::{Answer, Ask, Bus, ConnectTimeout, Target, Urgency};
use muster_runtime::config::ProcessConfig;
use muster_runtime::recording::RecordTo;
use muster_runtime::shell::{self, ServiceOptions};
use muster_runtime::stop;
use muster_runtime::store::Store;
use muster_service::recording::Head;
use muster_service::replay::{ReplayError, Step, compare};
use muster_service::testkit::command_of;
use muster_service::{
    Context, Core, Delivery, Get, Input, JobEnd, Stopwatch, Subscription, View, Wiring,
};
use muster_wire::recording::Reader;
use muster_wire::{
    Attachment, ForeignKey, ForeignPattern, Key, Message, Outbound, Packet, Pattern,
};

/// How often the core below wants to be woken.
const BEAT: Duration = Duration::from_millis(50);

/// A core that starts a job which panics, counts its timers, and keeps a record.
struct Probe {
    next: Tick,
    beats: u64,
    wants_job: Option<&'static str>,
}

impl Core for Probe {
    passive_core!();

    type Settings = ClustererSettings;
    type Job = &'static str;
    type Done = &'static str;
    const SERVICE: ServiceName = ServiceName::Clusterer;

    fn wiring() -> Wiring {
        Wiring {
            subscriptions: [
                Pattern::Stream(Stream::Pose),
                Pattern::Foreign(ForeignPattern::new("other/topic").unwrap()),
            ]
            .map(|pattern| Subscription { pattern, delivery: Delivery::Latest })
            .to_vec(),
            ..Wiring::default()
        }
    }

    fn output() -> Key {
        Key::Teams
    }

    fn new(now: Tick, _: &ClustererSettings) -> Self {
        Self { next: now, beats: 0, wants_job: None }
    }

    fn on_lead(&mut self, context: &mut Context<'_, Self>, _: Vec<Message>) {
        context.declare_token(Key::RobotToken("probed".parse().unwrap()));
        context.append(Record::Joined("recorded".parse().unwrap()));
    }

    fn on_message(&mut self, context: &mut Context<'_, Self>, message: Message) {
        if let Message::Report(report) = message {
            assert!(report.robot().as_str() != "cursed", "a pose that must not be");
            context.count("poses");
        }
    }

    fn on_recorded(&mut self, context: &mut Context<'_, Self>, report: RecordingReport) {
        if report.coverage.sequence == 1 {
            context.look_up(7, Query::of(Subject::Robots(None)));
        }
    }

    fn on_records(
        &mut self,
        context: &mut Context<'_, Self>,
        lookup: u64,
        page: Result<Page, String>,
    ) {
        let Ok(Page { rows: Rows::Robots(rows), before: None }) = page else { panic!("{page:?}") };
        assert_eq!((lookup, rows[0].robot.as_str()), (7, "recorded"));
        context.count("lookups");
    }

    /// Answers another program on its own key, with its attachment.
    fn on_foreign(&mut self, context: &mut Context<'_, Self>, packet: Packet) {
        let key = ForeignKey::new("other/reply").unwrap();
        context.publish_foreign(&key, &packet.encoding, packet.payload.unwrap(), packet.attachment);
    }

    fn on_timer(&mut self, context: &mut Context<'_, Self>) {
        if context.now() < self.next {
            return;
        }
        self.beats += 1;
        self.next = context.now().after(BEAT);
        context.count("beats");
        if self.beats == 1 {
            self.wants_job = Some("panic");
        }
    }

    fn on_job(&mut self, context: &mut Context<'_, Self>, end: JobEnd<&'static str>) {
        let (severity, reason) = match end {
            JobEnd::Panicked(reason) => {
                self.wants_job = Some("calm");
                (Severity::Error, reason)
            }
            JobEnd::Finished(text) => (Severity::Info, format!("then {text}")),
        };
        context.publish_event(severity, EventKind::JobFailed { reason });
    }

    fn after_input(&mut self, context: &mut Context<'_, Self>) {
        if let Some(slot) = context.free_job_slot()
            && let Some(job) = self.wants_job.take()
        {
            context.start_job(slot, job);
        }
    }

    fn deadline(&self, _: &View<'_, Self>) -> Option<Tick> {
        Some(self.next)
    }

    fn run(job: &'static str, _: &mut Stopwatch) -> &'static str {
        assert!(job == "calm", "a job that panics on purpose");
        job
    }
}

/// A router, and the configuration of a client of it.
async fn bus() -> (Bus, ProcessConfig) {
    let (router, endpoint) = router().await;
    (router, config(connected(&endpoint)))
}

fn options(store: Store) -> ServiceOptions<ClustererSettings> {
    let options = common::options::<Probe>(ClustererSettings::default());
    ServiceOptions { store, ..options }
}

async fn status(bus: &Bus, counter: &str) -> u64 {
    let key = Key::Status(ServiceName::Clusterer);
    let answers = bus.get(&Pattern::One(key), ask(None)).await.unwrap();
    let Some(Answer::Packet(packet)) = answers.first() else { return 0 };
    let status: serde_json::Value =
        serde_json::from_slice(packet.payload.as_ref().unwrap()).unwrap();
    status["counters"][counter].as_u64().unwrap_or_default()
}

/// Commands a change of settings.
async fn set(asker: &Bus, patch: &str) -> Vec<Answer> {
    static SENT: AtomicU64 = AtomicU64::new(0);
    let now = Tick(0).after(SystemTime::now().duration_since(UNIX_EPOCH).unwrap());
    let id = format!("c{}", SENT.fetch_add(1, Ordering::Relaxed));
    let settings = Key::Settings(ServiceName::Clusterer).to_string();
    let (key, command) = command_of(now, &settings, &id, patch).unwrap();
    let key = asker.space().parse(&format!("muster/v1/{}/{key}", asker.space().fleet())).unwrap();
    asker.get(&Pattern::One(key), ask(Some(command.as_bytes()))).await.unwrap()
}

fn ask(payload: Option<&[u8]>) -> Ask<'_> {
    Ask {
        parameters: "",
        payload,
        within: Duration::from_secs(3),
        further_within: None,
        target: Target::Complete,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_a_job_becomes_an_event_and_the_service_goes_on() {
    let (_router, client) = bus().await;
    let watcher = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let (events, mut received) = tokio::sync::mpsc::channel(64);
    let space = watcher.space().clone();
    let receive = move |packet: Packet| {
        if let Ok(Message::Event(event)) = Message::decode(&space, &packet) {
            let _ = events.try_send(event);
        }
    };
    watcher.subscribe(&Pattern::One(Key::Event), receive).await.unwrap();
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let store = Store::new(None, watcher.space().fleet(), ServiceName::Clusterer);
    let service = tokio::spawn(shell::run::<Probe>(bus, options(store), stop));
    let mut reasons = Vec::new();
    let start = Instant::now();
    while reasons.len() < 2 {
        assert!(start.elapsed() < Duration::from_secs(10), "{reasons:?}");
        let event = tokio::time::timeout(Duration::from_millis(100), received.recv()).await;
        if let Ok(Some(event)) = event
            && let EventKind::JobFailed { reason } = event.kind
        {
            reasons.push(reason);
        }
    }
    assert!(reasons[0].contains("on purpose"), "{reasons:?}");
    assert_eq!(reasons[1], "then calm");
    stopper.stop();
    service.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn deadlines_are_met_under_steady_traffic() {
    let (_router, client) = bus().await;
    let talker = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let store = Store::new(None, talker.space().fleet(), ServiceName::Clusterer);
    let service = tokio::spawn(shell::run::<Probe>(bus, options(store), stop));
    let start = Instant::now();
    while status(&talker, "beats").await == 0 {
        assert!(start.elapsed() < Duration::from_secs(10));
    }
    let (before, start) = (status(&talker, "beats").await, Instant::now());
    let talking = talker.clone();
    let talk = tokio::task::spawn_blocking(move || {
        let pose = br#"{"x":1,"y":2}"#.to_vec();
        while start.elapsed() < Duration::from_secs(3) {
            let key = Key::Stream(muster_model::id::RobotId::new("r1").unwrap(), Stream::Pose);
            let message =
                Outbound { key, encoding: "".into(), payload: pose.clone(), attachment: None };
            talking.put(message).unwrap();
            std::thread::sleep(Duration::from_micros(700));
        }
    });
    talk.await.unwrap();
    let beats = status(&talker, "beats").await - before;
    let due = start.elapsed().as_millis() / BEAT.as_millis();
    assert!(status(&talker, "poses").await > 500);
    // Half of them: a shared machine may be late, starvation loses nearly all.
    assert!(u128::from(beats) * 2 > due, "{beats} of {due}");
    stopper.stop();
    service.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_setting_is_on_disk_before_it_is_confirmed_or_the_failure_is_reported() {
    let (_router, client) = bus().await;
    let asker = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let directory = tempfile::tempdir().unwrap();
    let fleet = asker.space().fleet().clone();
    let store = Store::new(Some(directory.path()), &fleet, ServiceName::Clusterer);
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let service = tokio::spawn(shell::run::<Probe>(bus, options(store.clone()), stop));
    let settings = Pattern::One(Key::Settings(ServiceName::Clusterer));
    let start = Instant::now();
    while asker.get(&settings, ask(None)).await.unwrap().is_empty() {
        assert!(start.elapsed() < Duration::from_secs(10));
    }
    for teams in 3..20_u32 {
        let patch = format!("{{\"teams\":{teams}}}");
        let answers = set(&asker, &patch).await;
        assert!(matches!(answers[0], Answer::Packet(_)), "{answers:?}");
        assert_eq!(store.load().patch["teams"], teams);
    }
    // A file where the folder should be: nothing can be kept any more.
    std::fs::remove_dir_all(directory.path().join(fleet.as_str())).unwrap();
    std::fs::write(directory.path().join(fleet.as_str()), "").unwrap();
    let answers = set(&asker, "{\"teams\":7}").await;
    let Answer::Error(problem) = &answers[0] else { panic!("{answers:?}") };
    assert!(problem.contains("will not survive"), "{problem}");
    stopper.stop();
    service.await.unwrap().unwrap();
}

/// The recording of a life with a panic in a job and the last one in the core itself: it is all there,
/// and happens again.
#[tokio::test(flavor = "multi_thread")]
async fn what_a_core_panicked_at_stands_in_its_recording() {
    let (_router, client) = bus().await;
    let talker = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (_stopper, stop) = stop::channel();
    let bus = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let mut options = options(Store::new(None, talker.space().fleet(), ServiceName::Clusterer));
    let path = folder.path().join("probe.rec");
    let to = RecordTo { path: path.clone(), several: false };
    options.record = Some(to.create(ServiceName::Clusterer, &options.instance).unwrap());
    let service = tokio::spawn(shell::run::<Probe>(bus, options, stop));
    let start = Instant::now();
    while status(&talker, "beats").await < 3 {
        assert!(start.elapsed() < Duration::from_secs(10));
    }
    for robot in ["r1", "cursed"] {
        let key = Key::Stream(muster_model::id::RobotId::new(robot).unwrap(), Stream::Pose);
        let payload = br#"{"x":1,"y":2}"#.to_vec();
        talker.put(Outbound { key, encoding: "".into(), payload, attachment: None }).unwrap();
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    let ended = tokio::time::timeout(Duration::from_secs(10), service).await.unwrap();
    assert!(ended.unwrap_err().is_panic());

    let file = std::fs::File::open(path).unwrap();
    let (mut reader, head) = Reader::open::<Head>(file).unwrap();
    let mut steps = Vec::new();
    let see = |step: &Step| {
        steps.push(step.clone());
        ControlFlow::Continue(())
    };
    let compared = compare::<Probe>(head, || reader.next_entry(), u64::MAX, see).unwrap();
    assert_eq!(compared.jobs, 2, "the one that panicked as well");
    let difference = compared.difference.unwrap();
    assert_eq!(difference.step, *steps.last().unwrap());
    assert!(difference.step.commands.is_none());
    assert!(
        matches!(&difference.now, Err(ReplayError::Panicked(text)) if text.contains("must not"))
    );
    let has = |what: &dyn Fn(&Input) -> bool| steps.iter().any(|step| what(&step.input));
    let panicked = |input: &Input| match input {
        Input::JobEnded { panic: Some(text), .. } => text.contains("purpose"),
        _ => false,
    };
    assert!(has(&panicked));
    assert!(has(&|input| matches!(input, Input::Timer)));
    assert!(has(&|input| matches!(input, Input::Get(..))));
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_are_declared_and_records_are_looked_up() {
    let (_router, client) = bus().await;
    let asker = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let store = Store::new(None, asker.space().fleet(), ServiceName::Clusterer);
    let service = tokio::spawn(shell::run::<Probe>(bus, options(store), stop));
    let start = Instant::now();
    while status(&asker, "lookups").await == 0 {
        assert!(start.elapsed() < Duration::from_secs(10));
    }
    let tokens = asker.tokens(&Pattern::RobotTokens, Duration::from_secs(3)).await.unwrap();
    assert_eq!(tokens, [Key::RobotToken("probed".parse().unwrap())]);
    stopper.stop();
    service.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn packets_of_other_programs_cross_the_bus_with_their_attachments() {
    let (_router, client) = bus().await;
    let other = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let (replies, mut received) = tokio::sync::mpsc::channel(64);
    let reply = Pattern::Foreign(ForeignPattern::new("other/reply").unwrap());
    other.subscribe(&reply, move |packet| drop(replies.try_send(packet))).await.unwrap();
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let store = Store::new(None, other.space().fleet(), ServiceName::Clusterer);
    let service = tokio::spawn(shell::run::<Probe>(bus, options(store), stop));
    let start = Instant::now();
    let packet = loop {
        assert!(start.elapsed() < Duration::from_secs(10));
        let attachment = Attachment::new([7; 33]).unwrap();
        let packet = Packet::put("other/topic", "application/cdr", [1, 2]);
        let packet = Packet { attachment: Some(attachment), ..packet };
        other.put_packet(packet, Urgency::Normal).unwrap();
        let reply = tokio::time::timeout(Duration::from_millis(200), received.recv()).await;
        if let Ok(Some(packet)) = reply {
            break packet;
        }
    };
    assert_eq!((packet.key.as_str(), packet.payload), ("other/reply", Ok(vec![1, 2])));
    assert_eq!(packet.encoding, "application/cdr");
    assert_eq!(packet.attachment.unwrap().as_bytes(), [7; 33]);
    stopper.stop();
    service.await.unwrap().unwrap();
}
