//! The shell around a small core, over a real router: jobs that panic, deadlines under traffic, gets,
//! and what is kept.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_machine::recording::{Head, Input};
use muster_machine::replay::{ReplayError, Step, compare};
use muster_machine::{
    Answered, Core, Delivery, Effect, Effects, Event, Role, Start, Stopwatch, Subscription, Wiring,
};
use muster_model::event::{EventKind, Severity};
use muster_model::id::{InstanceId, ServiceName};
use muster_model::observation::Stream;
use muster_model::role::Standing;
use muster_model::settings::ClustererSettings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_runtime::bus::{Answer, Ask, Bus, Patience};
use muster_runtime::config::{Mode, ProcessArgs, ProcessConfig};
use muster_runtime::inbox::Inbox;
use muster_runtime::observe::Observatory;
use muster_runtime::recording::RecordTo;
use muster_runtime::shell::{self, ServiceOptions};
use muster_runtime::stop;
use muster_runtime::store::Store;
use muster_wire::recording::Reader;
use muster_wire::{Key, Message, Outbound, Pattern};

/// How often the core below wants to be woken.
const BEAT: Duration = Duration::from_millis(50);

/// A core that starts a job which panics, and counts its timeouts by setting its team number.
struct Probe {
    role: Role<ClustererSettings>,
    next: Tick,
    beats: u64,
}

impl Core for Probe {
    type Settings = ClustererSettings;
    type Job = &'static str;
    type Done = &'static str;
    const SERVICE: ServiceName = ServiceName::Clusterer;

    fn wiring() -> Wiring {
        Wiring {
            subscriptions: vec![Subscription {
                pattern: Pattern::Stream(Stream::Pose),
                delivery: Delivery::Latest,
            }],
            ..Wiring::default()
        }
    }

    fn new(start: Start<ClustererSettings>) -> Self {
        let next = start.now;
        Self { role: Role::new(Self::SERVICE, start), next, beats: 0 }
    }

    fn handle(
        &mut self,
        now: Tick,
        event: Event<&'static str>,
        effects: &mut Effects<&'static str>,
    ) {
        match event {
            Event::Started => self.role.begin_term(now, None, effects),
            Event::Received(Message::Report(report)) => {
                assert!(report.robot().as_str() != "cursed", "a pose that must not be");
                self.role.count("poses");
            }
            Event::Timeout => {
                self.beats += 1;
                self.next = now.after(BEAT);
                self.role.count("beats");
                if self.beats == 1 {
                    effects.push(Effect::Start("panic"));
                }
            }
            Event::JobFailed(reason) => {
                let kind = EventKind::JobFailed { reason };
                self.role.tell(now, Severity::Error, kind, effects);
                effects.push(Effect::Start("calm"));
            }
            Event::Done(text) => {
                let kind = EventKind::JobFailed { reason: format!("then {text}") };
                self.role.tell(now, Severity::Info, kind, effects);
            }
            Event::Query { query, request } => {
                if let Answered::NotOurs(query, request) =
                    self.role.answer(now, query, request, "probing", effects)
                {
                    effects.push(Effect::Reply { query, request, answer: Ok(Vec::new()) });
                }
            }
            _ => {}
        }
    }

    fn standing(&self) -> Standing {
        self.role.standing()
    }

    fn deadline(&self) -> Option<Tick> {
        Some(self.next)
    }

    fn status(&self, now: Tick) -> ServiceStatus {
        self.role.status(now, "probing")
    }

    fn run(job: &'static str, _: &mut Stopwatch) -> &'static str {
        assert!(job == "calm", "a job that panics on purpose");
        job
    }
}

fn config(mode: Mode, flags: &[(&str, &str)]) -> ProcessConfig {
    let mut args = ProcessArgs { mode: Some(mode), ..ProcessArgs::default() };
    for (flag, value) in flags {
        match *flag {
            "listen" => args.listen = Some(vec![(*value).to_owned()]),
            _ => args.connect = Some(vec![(*value).to_owned()]),
        }
    }
    ProcessConfig::resolve(&args, mode, &|_| None).unwrap()
}

/// A router, and the bus of a client of it.
async fn bus() -> (Bus, ProcessConfig) {
    let router = config(Mode::Router, &[("listen", "tcp/127.0.0.1:0")]);
    let router = Bus::open(&router, Patience::Forever).await.unwrap();
    let endpoint = router.locators().await[0].clone();
    (router, config(Mode::Client, &[("connect", &endpoint)]))
}

/// One that shows nothing.
fn observatory() -> Observatory {
    Observatory::open(&config(Mode::Client, &[]), &[]).unwrap()
}

fn options(store: Store) -> ServiceOptions<ClustererSettings> {
    ServiceOptions {
        instance: InstanceId::of_process("test", 1, 1),
        settings: ClustererSettings::default(),
        store,
        record: None,
        observer: observatory().observer(ServiceName::Clusterer),
    }
}

async fn status(bus: &Bus, counter: &str) -> u64 {
    let key = Key::Status(ServiceName::Clusterer);
    let answers = bus.get(&Pattern::One(key), ask(None)).await.unwrap();
    let Some(Answer::Packet(packet)) = answers.first() else { return 0 };
    let status: serde_json::Value =
        serde_json::from_slice(packet.payload.as_ref().unwrap()).unwrap();
    status["counters"][counter].as_u64().unwrap_or_default()
}

fn ask(payload: Option<&[u8]>) -> Ask<'_> {
    Ask { parameters: "", payload, within: Duration::from_secs(3), everybody: false }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_a_job_becomes_an_event_and_the_service_goes_on() {
    let (_router, client) = bus().await;
    let watcher = Bus::open(&client, Patience::Forever).await.unwrap();
    let inbox = Arc::new(Inbox::<muster_model::event::Event>::default());
    let (space, events) = (watcher.space().clone(), Arc::clone(&inbox));
    let take = move |packet: muster_wire::Packet| {
        if let Ok(Message::Event(event)) = Message::decode(&space, &packet) {
            events.push(packet.key, event, 1, Delivery::Queue(64));
        }
    };
    watcher.subscribe(&Pattern::One(Key::Event), take).await.unwrap();
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, Patience::Forever).await.unwrap();
    let store = Store::new(None, watcher.space().fleet(), ServiceName::Clusterer);
    let service = tokio::spawn(shell::run::<Probe>(bus, options(store), stop));
    let mut reasons = Vec::new();
    let start = Instant::now();
    while reasons.len() < 2 {
        assert!(start.elapsed() < Duration::from_secs(10), "{reasons:?}");
        let _ = tokio::time::timeout(Duration::from_millis(100), inbox.arrived()).await;
        while let Some(event) = inbox.pop() {
            if let EventKind::JobFailed { reason } = event.kind {
                reasons.push(reason);
            }
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
    let talker = Bus::open(&client, Patience::Forever).await.unwrap();
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, Patience::Forever).await.unwrap();
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
async fn a_setting_is_on_disk_before_it_is_confirmed_or_the_failure_is_told() {
    let (_router, client) = bus().await;
    let asker = Bus::open(&client, Patience::Forever).await.unwrap();
    let directory = tempfile::tempdir().unwrap();
    let fleet = asker.space().fleet().clone();
    let store = Store::new(Some(directory.path()), &fleet, ServiceName::Clusterer);
    let (stopper, stop) = stop::channel();
    let bus = Bus::open(&client, Patience::Forever).await.unwrap();
    let service = tokio::spawn(shell::run::<Probe>(bus, options(store.clone()), stop));
    let settings = Pattern::One(Key::Settings(ServiceName::Clusterer));
    let start = Instant::now();
    while asker.get(&settings, ask(None)).await.unwrap().is_empty() {
        assert!(start.elapsed() < Duration::from_secs(10));
    }
    for teams in 3..20_u32 {
        let patch = format!("{{\"teams\":{teams}}}");
        let answers = asker.get(&settings, ask(Some(patch.as_bytes()))).await.unwrap();
        assert!(matches!(answers[0], Answer::Packet(_)), "{answers:?}");
        assert_eq!(store.load().patch["teams"], teams);
    }
    // A file where the folder should be: nothing can be kept any more.
    std::fs::remove_dir_all(directory.path().join(fleet.as_str())).unwrap();
    std::fs::write(directory.path().join(fleet.as_str()), "").unwrap();
    let answers = asker.get(&settings, ask(Some(b"{\"teams\":7}"))).await.unwrap();
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
    let talker = Bus::open(&client, Patience::Forever).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (_stopper, stop) = stop::channel();
    let bus = Bus::open(&client, Patience::Forever).await.unwrap();
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
    assert!(difference.step.outputs.is_none());
    assert!(
        matches!(&difference.now, Err(ReplayError::Panicked(said)) if said.contains("must not"))
    );
    let has = |what: &dyn Fn(&Input) -> bool| steps.iter().any(|step| what(&step.input));
    assert!(has(&|input| matches!(input, Input::JobFailed(_, said) if said.contains("purpose"))));
    assert!(has(&|input| matches!(input, Input::Timeout)));
    assert!(has(&|input| matches!(input, Input::Query(..))));
}
