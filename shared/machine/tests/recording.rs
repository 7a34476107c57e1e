//! Every kind of event and command comes back from a recording, and a core that does something else
//! is found out.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::fmt::Write as _;
use std::ops::ControlFlow;

use muster_machine::recording::{Entry, Head, Input, Output};
use muster_machine::replay::{Comparison, Ending, Replay, ReplayError, compare, panic_text};
use muster_machine::{
    Answered, Command, Core, Driver, Effect, Effects, Event, QueryId, Role, Start, Stopwatch,
    Stored, Wiring,
};
use muster_model::event::{EventKind, Severity};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::observation::{CheckedReport, Pose, Report};
use muster_model::role::Standing;
use muster_model::settings::ClustererSettings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::recording::{Bytes, Put, Reader, Received, begin, frame};
use muster_wire::{Key, KeySpace, Message, Pattern, Rejection, Request};
use proptest::prelude::*;

/// A core that shows everything that cores do. `SECOND` is the same with one number changed.
struct Small<const SECOND: bool> {
    role: Role<ClustererSettings>,
    heard: f64,
}

impl<const SECOND: bool> Core for Small<SECOND> {
    type Settings = ClustererSettings;
    type Job = f64;
    type Done = String;
    const SERVICE: ServiceName = ServiceName::Clusterer;

    fn wiring() -> Wiring {
        Wiring::default()
    }

    fn new(start: Start<ClustererSettings>) -> Self {
        Self { role: Role::new(Self::SERVICE, start), heard: 0.0 }
    }

    fn handle(&mut self, now: Tick, event: Event<String>, effects: &mut Effects<f64>) {
        let told = match event {
            Event::Started => {
                let patterns = vec![Pattern::One(Key::Teams), Pattern::Graphs];
                effects.push(Effect::Fetch { fetch: 0, patterns });
                return;
            }
            Event::Fetched { messages, .. } => {
                self.role.begin_term(now, None, effects);
                format!("{} messages", messages.len())
            }
            Event::Received(Message::Report(report)) => {
                let (robot, Report::Pose(pose)) = report.into_parts() else { return };
                assert!(robot.as_str() != "cursed", "a pose that must not be");
                self.heard += pose.x + f64::from(u8::from(SECOND && pose.x > 40.0));
                effects.push(Effect::Start(self.heard));
                return;
            }
            Event::Received(other) => format!("{other:?}"),
            Event::Rejected(rejection) => return self.role.quarantine(now, rejection, effects),
            Event::Query { query, request } => {
                if let Answered::NotOurs(query, request) =
                    self.role.answer(now, query, request, "small", effects)
                {
                    effects.push(Effect::Reply { query, request, answer: Err("no".to_owned()) });
                }
                return;
            }
            Event::Done(done) => done,
            Event::JobFailed(said) => said,
            Event::Timeout => "timeout".to_owned(),
            Event::LinkLost => "lost".to_owned(),
            Event::LinkRestored => "restored".to_owned(),
        };
        let kind = EventKind::JobFailed { reason: told };
        self.role.tell(now, Severity::Info, kind, effects);
    }

    fn standing(&self) -> Standing {
        self.role.standing()
    }

    fn deadline(&self) -> Option<Tick> {
        None
    }

    fn status(&self, now: Tick) -> ServiceStatus {
        self.role.status(now, "small")
    }

    fn run(heard: f64, stopwatch: &mut Stopwatch) -> String {
        let first = stopwatch.lap();
        assert!(heard < 1e6, "more than a job bears");
        format!("{heard} after {first} and {}", stopwatch.lap())
    }
}

fn space() -> KeySpace {
    KeySpace::new(FleetId::new("alpha").unwrap())
}

fn start() -> Start<ClustererSettings> {
    let mut stored = Stored { term: 7, ..Stored::default() };
    stored.patch.insert("teams".to_owned(), 3.into());
    Start {
        fleet: space().fleet().clone(),
        instance: InstanceId::of_process("h", 1, 1),
        now: Tick(1_000_000),
        settings: ClustererSettings { hysteresis: 0.1 + 0.2, ..ClustererSettings::default() },
        stored,
    }
}

fn pose(robot: &str, x: f64) -> Message {
    let (heading, frame, stamp) = (None, None, None);
    let pose = Pose { x, y: 0.0, z: None, heading, frame, stamp, boot: None, seq: None };
    Message::Report(CheckedReport::new(RobotId::new(robot).unwrap(), pose).unwrap())
}

/// Runs a core as a shell does, and writes its recording.
struct Recorder {
    driver: Driver<Small<false>>,
    now: Tick,
    bytes: Vec<u8>,
    job: Option<f64>,
}

impl Recorder {
    fn new() -> Self {
        let start = start();
        let head = Head::new::<Small<false>>(&start, "here".to_owned()).unwrap();
        let driver = Driver::new(start);
        Self { driver, now: Tick(1_000_000), bytes: begin(&head).unwrap(), job: None }
    }

    fn step(&mut self, event: Event<String>, laps: &[u64]) {
        self.now.0 += 1500;
        let entry = Entry::event(&space(), self.now, &event, laps).unwrap();
        self.bytes.extend(frame(&entry).unwrap());
        let commands = self.driver.step(self.now, event);
        self.bytes.extend(frame(&Entry::outputs(&space(), self.now, &commands)).unwrap());
        for command in commands {
            if let Command::Run(job) = command {
                self.job = Some(job);
            }
        }
    }

    fn end_job(&mut self) {
        let Some(job) = self.job.take() else { return };
        let mut time = 5;
        let mut stopwatch = Stopwatch::reading(move || {
            time *= 3;
            time
        });
        let run = std::panic::AssertUnwindSafe(|| Small::<false>::run(job, &mut stopwatch));
        let event = match std::panic::catch_unwind(run) {
            Ok(done) => Event::Done(done),
            Err(panic) => Event::JobFailed(panic_text(panic.as_ref())),
        };
        self.step(event, stopwatch.laps());
    }

    fn ask(&mut self, id: u64, key: Key, parameters: &str, payload: Option<&str>) {
        let payload = payload.map(|text| text.as_bytes().to_vec());
        let request = Request::new(space().format(&key), parameters, payload).unwrap();
        self.step(Event::Query { query: QueryId(id), request }, &[]);
    }
}

/// A life in which everything happens that can happen to a core.
fn life() -> Recorder {
    let mut life = Recorder::new();
    life.step(Event::Started, &[]);
    let messages = vec![pose("r1", 1.0), pose("r2", -0.1)];
    life.step(Event::Fetched { fetch: 0, messages }, &[]);
    life.step(Event::Received(pose("r1", 40.5)), &[]);
    life.end_job();
    life.step(Event::Received(pose("r1", 2e6)), &[]);
    life.end_job();
    let robot = RobotId::new("r1").unwrap();
    life.step(Event::Received(Message::RobotToken { robot: robot.clone(), alive: true }), &[]);
    let rejection =
        Rejection { robot: Some(robot), key: "k".to_owned(), reason: "wrong".to_owned() };
    life.step(Event::Rejected(rejection), &[]);
    life.step(Event::Timeout, &[]);
    life.step(Event::LinkLost, &[]);
    life.step(Event::LinkRestored, &[]);
    life.ask(1, Key::Settings(ServiceName::Clusterer), "", Some("{\"teams\":4}"));
    life.ask(2, Key::Settings(ServiceName::Clusterer), "format=bincode", None);
    life.ask(3, Key::Status(ServiceName::Clusterer), "format=json", None);
    life.ask(4, Key::Teams, "", None);
    life
}

fn read(bytes: &[u8]) -> (Head, Vec<Entry>) {
    let (mut reader, head) = Reader::open(bytes).unwrap();
    let entries = std::iter::from_fn(|| reader.next_entry().unwrap());
    (head, entries.collect())
}

fn write(head: &Head, entries: &[Entry]) -> Vec<u8> {
    let mut bytes = begin(head).unwrap();
    entries.iter().for_each(|entry| bytes.extend(frame(entry).unwrap()));
    bytes
}

fn replay<C: Core>(bytes: &[u8], until: u64) -> Result<Comparison, ReplayError> {
    let (mut reader, head) = Reader::open(bytes).unwrap();
    compare::<C>(head, || reader.next_entry(), until, |_| ControlFlow::Continue(()))
}

#[test]
fn a_whole_life_comes_out_the_same() {
    let life = life();
    let compared = replay::<Small<false>>(&life.bytes, u64::MAX).unwrap();
    assert_eq!(compared.difference, None);
    assert_eq!((compared.events, compared.jobs), (15, 2));
    assert_eq!(compared.ending, Ending::BrokenOff(None));
    // Every kind of event and of command was in it, so that nothing is shown by its absence.
    let (head, entries) = read(&life.bytes);
    assert_eq!(head, Head::new::<Small<false>>(&start(), "here".to_owned()).unwrap());
    let text = format!("{entries:?}");
    for kind in [
        "Started",
        "Received(Put",
        "Received(Token",
        "Rejected",
        "Timeout",
        "Done([30, 90])",
        "JobFailed([30]",
        "Fetched(0, [Put",
        "Query",
        "LinkLost",
        "LinkRestored",
        "Published(Ok([Put",
        "Replied(1, Ok([Put",
        "Replied(4, Err",
        "Ran",
        "Fetched(0, [\"",
        "Stored(",
    ] {
        assert!(text.contains(kind), "no {kind} in {text}");
    }
    let mut told = life.bytes.clone();
    told.extend(frame(&Entry::End("enough".to_owned())).unwrap());
    let ended = replay::<Small<false>>(&told, u64::MAX).unwrap();
    assert_eq!(ended.ending, Ending::Told("enough".to_owned()));
    let early = replay::<Small<false>>(&told, 3).unwrap();
    assert_eq!((early.events, early.ending), (3, Ending::NotReached));
}

/// Another core is on the same course until the first pose beyond forty, and only there.
#[test]
fn the_first_event_at_which_a_core_differs_is_found() {
    let life = life();
    let compared = replay::<Small<true>>(&life.bytes, u64::MAX).unwrap();
    let difference = compared.difference.unwrap();
    assert_eq!(difference.step.number, 4, "the job's end is where it shows");
    assert!(matches!(difference.step.input, Input::Done(_)));
    assert_ne!(difference.now.unwrap(), difference.step.outputs.unwrap());
}

#[test]
fn every_output_that_is_changed_is_found_where_it_stands() {
    let (head, entries) = read(&life().bytes);
    let mut changed = 0;
    for (at, entry) in entries.iter().enumerate() {
        let Entry::Outputs(outputs) = entry else { continue };
        for output in 0..outputs.len() {
            let mut outputs = outputs.clone();
            match &mut outputs[output] {
                Output::Published(Ok(puts)) | Output::Replied(_, Ok(puts)) => {
                    let Bytes(payload) = &mut puts[0].payload;
                    *payload.last_mut().unwrap() ^= 1;
                }
                Output::Published(Err(text))
                | Output::Replied(_, Err(text))
                | Output::Stored(text) => text.push('!'),
                Output::Fetched(_, patterns) => patterns.clear(),
                Output::Ran => outputs.clear(),
            }
            changed += 1;
            let mut entries = entries.clone();
            entries[at] = Entry::Outputs(outputs);
            let compared = replay::<Small<false>>(&write(&head, &entries), u64::MAX).unwrap();
            assert_eq!(compared.difference.unwrap().step.number, at as u64 / 2 + 1);
        }
    }
    assert!(changed > 15, "{changed}");
}

#[test]
fn a_core_that_panics_does_so_again_where_its_recording_breaks_off() {
    let mut life = life();
    let cursed = Event::Received(pose("cursed", 1.0));
    let entry = Entry::event::<String>(&space(), life.now, &cursed, &[]).unwrap();
    // The shell writes the event down before it hands it over, and nothing after it.
    life.bytes.extend(frame(&entry).unwrap());
    let compared = replay::<Small<false>>(&life.bytes, u64::MAX).unwrap();
    let difference = compared.difference.unwrap();
    assert_eq!(difference.step.number, 16);
    assert_eq!(difference.step.outputs, None);
    let Err(ReplayError::Panicked(said)) = difference.now else { panic!("{difference:?}") };
    assert!(said.contains("must not be"), "{said}");
    // A good event whose outputs were not written any more is no difference.
    let mut cut = self::life();
    let entry = Entry::event(&space(), cut.now, &Event::<String>::Timeout, &[]).unwrap();
    cut.bytes.extend(frame(&entry).unwrap());
    let compared = replay::<Small<false>>(&cut.bytes, u64::MAX).unwrap();
    assert_eq!((compared.difference, compared.events), (None, 16));
}

#[test]
fn jobs_that_end_otherwise_are_told() {
    let new = || Replay::<Small<false>>::new(read(&life().bytes).0).unwrap();
    let why = |replay: &mut Replay<_>, input| match replay.step(Tick(2), input) {
        Err(ReplayError::Astray(why)) => why,
        other => panic!("{other:?}"),
    };
    assert!(why(&mut new(), Input::Done(vec![1, 2])).contains("none was started"));
    let after = |x: f64, input: Input| {
        let mut replay = new();
        let heard = Received::new(&space(), &pose("r1", x)).unwrap();
        assert_eq!(replay.step(Tick(1), Input::Received(heard)), Ok(vec![Output::Ran]));
        why(&mut replay, input)
    };
    assert!(after(1.0, Input::Done(vec![1])).contains("1 times then, 2 times now"));
    assert!(after(1.0, Input::JobFailed(vec![1, 2], "x".to_owned())).contains("ends well now"));
    assert!(after(2e6, Input::Done(vec![1])).contains("panics now"));
    assert!(after(2e6, Input::JobFailed(vec![1], "x".to_owned())).contains("then with \"x\""));
}

#[test]
fn what_does_not_fit_together_is_unreadable() {
    let (head, entries) = read(&life().bytes);
    let why =
        |head: &Head, entries: &[Entry]| match replay::<Small<false>>(&write(head, entries), 99) {
            Err(ReplayError::Unreadable(why)) => why,
            other => panic!("{other:?}"),
        };
    let other = Head { service: ServiceName::Auditor, ..head.clone() };
    assert!(why(&other, &entries).contains("auditor"));
    let other = Head { settings: serde_json::json!({"teams": "many"}), ..head.clone() };
    assert!(why(&other, &entries).contains("settings"));
    assert!(why(&head, &entries[1..]).contains("event 1"));
    let twice = [&entries[..1], &entries[..1]].concat();
    assert!(why(&head, &twice).contains("another event"));
    let strange = Put {
        key: "muster/v1/alpha/robot/r1/pose".to_owned(),
        encoding: "application/json".to_owned(),
        payload: Bytes(b"{\"x\":1}".to_vec()),
    };
    let strange = [Entry::Event { tick: Tick(1), input: Input::Received(Received::Put(strange)) }];
    assert!(why(&head, &strange).contains("not understood"));
}

/// The bytes of every kind of entry are frozen: a recording of last year must be understood. A
/// deliberate change is a new `VERSION` of recordings; then run with `UPDATE_GOLDEN=1`.
#[test]
fn the_bytes_of_entries_are_frozen() {
    let put = || Put {
        key: "muster/v1/alpha/teams".to_owned(),
        encoding: "application/json".to_owned(),
        payload: Bytes(b"{}".to_vec()),
    };
    let token = Received::Token { key: "muster/v1/alpha/robot/r1".to_owned(), alive: true };
    let robot = Some(RobotId::new("r1").unwrap());
    let rejection = Rejection { robot, key: "k".to_owned(), reason: "wrong".to_owned() };
    let ask = |parameters| Request::new("a/*", parameters, Some(vec![7])).unwrap().narrowed("a/b");
    let inputs = [
        Input::Started,
        Input::Received(Received::Put(put())),
        Input::Received(token.clone()),
        Input::Rejected(rejection),
        Input::Timeout,
        Input::Done(vec![1, 300, 70_000]),
        Input::JobFailed(vec![2], "said".to_owned()),
        Input::Fetched(3, vec![token, Received::Put(put())]),
        Input::Query(4, ask("format=json")),
        Input::Query(5, ask("format=bincode")),
        Input::Query(6, ask("")),
        Input::LinkLost,
        Input::LinkRestored,
    ];
    let outputs = vec![
        Output::Published(Ok(vec![put(), put()])),
        Output::Published(Err("too large".to_owned())),
        Output::Replied(4, Ok(vec![put()])),
        Output::Replied(5, Err("no".to_owned())),
        Output::Ran,
        Output::Fetched(6, vec!["a/*".to_owned()]),
        Output::Stored("{}".to_owned()),
    ];
    let tick = Tick(1_795_208_990_000_000);
    let mut entries: Vec<_> = inputs.map(|input| Entry::Event { tick, input }).into();
    entries.extend([Entry::Outputs(outputs), Entry::End("enough".to_owned())]);
    let mut text = String::new();
    for entry in &entries {
        for byte in frame(entry).unwrap() {
            write!(text, "{byte:02x}").unwrap();
        }
        text.push('\n');
    }
    let (head, _) = read(&life().bytes);
    assert_eq!(read(&write(&head, &entries)), (head, entries));
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/entries.hex");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(path, &text).unwrap();
    }
    assert_eq!(std::fs::read_to_string(path).unwrap(), text, "entries are written differently");
}

/// The checksum of `wire`, so that strange contents pass it.
fn with_checksum(content: &[u8]) -> Vec<u8> {
    let mut sum = 0xcbf2_9ce4_8422_2325_u64;
    for byte in content {
        sum = (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    }
    let folded = ((sum ^ (sum >> 32)) & u64::from(u32::MAX)) as u32;
    let length = u32::try_from(content.len()).unwrap();
    [&length.to_le_bytes()[..], &folded.to_le_bytes(), content].concat()
}

#[test]
fn the_checksum_here_is_that_of_the_recordings() {
    let bytes = frame(&Entry::End("x".to_owned())).unwrap();
    assert_eq!(with_checksum(&bytes[8..]), bytes);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Damage that the checksum does not show, as somebody may do it on purpose.
    #[test]
    fn no_forged_entry_panics(
        at in any::<prop::sample::Index>(),
        cut in prop::option::of(any::<prop::sample::Index>()),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        random in prop::collection::vec(any::<u8>(), 0..40),
    ) {
        let (head, entries) = read(&life().bytes);
        let at = at.index(entries.len());
        let mut content = frame(&entries[at]).unwrap()[8..].to_vec();
        for (flipped, value) in flips {
            let flipped = flipped.index(content.len());
            content[flipped] = value;
        }
        if let Some(cut) = cut {
            content.truncate(cut.index(content.len()));
        }
        for content in [content, random] {
            let mut bytes = write(&head, &entries[..at]);
            bytes.extend(with_checksum(&content));
            entries[at + 1..].iter().for_each(|entry| bytes.extend(frame(entry).unwrap()));
            // A core that panics on what was forged is caught as well, and told of.
            if let Ok(compared) = replay::<Small<false>>(&bytes, u64::MAX) {
                prop_assert!(compared.events <= 15);
            }
        }
    }
}
