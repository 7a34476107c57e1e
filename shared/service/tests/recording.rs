//! Every kind of input and command comes back from a recording, and a core that does something else
//! is found out.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::time::Duration;

use crate::small::{self, CHANGED, ONE_LEADS, Small, order, pose, space};
use muster_model::event::Severity;
use muster_model::header::Revision;
use muster_model::history::{
    self, DivisionRow, EventRow, LeaveReason, Page, Query, Record, RecordingReport, Retention,
    Rows, SnapshotCause, Subject,
};
use muster_model::id::{InstanceId, RobotId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::settings::ClustererSettings;
use muster_model::time::Tick;
use muster_service::recording::{Entry, Head, commands_frame, input_frame};
use muster_service::replay::{Comparison, Ending, Replay, ReplayError, compare, panic_text};
use muster_service::testkit::command_of;
use muster_service::{
    Arrival, Ask, AskId, Command, Core, GetId, Host, IncomingGet, Input, Publication, Reply, Start,
    Stopwatch, Stored,
};
use muster_wire::recording::{Reader, begin, frame};
use muster_wire::{Key, Message, Packet, Pattern, Source};
use proptest::prelude::*;

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

/// A packet as it comes off the bus.
fn arrival(message: &Message) -> Arrival {
    Arrival::encoded(message.to_packet(&space()))
}

fn arrived(message: &Message) -> Input {
    Input::Arrived(arrival(message))
}

fn refused() -> Input {
    let key = "muster/v1/alpha/robot/r1/pose".to_owned();
    let packet = Packet::put(key, "application/json".to_owned(), b"{\"x\":1}".to_vec());
    Input::Arrived(Arrival::encoded(packet))
}

/// Runs a host as a shell does, and writes its recording.
struct Recorder {
    host: Host<Small<ONE_LEADS>>,
    now: Tick,
    bytes: Vec<u8>,
    inputs: u64,
    job: Option<f64>,
    asks: VecDeque<Ask>,
    stores: usize,
}

impl Recorder {
    fn new() -> Self {
        let start = start();
        let head = Head::new::<Small<ONE_LEADS>>(&start, "here".to_owned()).unwrap();
        Self {
            host: Host::new(start),
            now: Tick(1_000_000),
            bytes: begin(&head).unwrap(),
            inputs: 0,
            job: None,
            asks: VecDeque::new(),
            stores: 0,
        }
    }

    fn step(&mut self, input: Input) {
        self.now.0 += 1500;
        self.inputs += 1;
        self.bytes.extend(input_frame(self.now, &input).unwrap());
        let commands = self.host.handle(self.now, input);
        self.bytes.extend(commands_frame(&commands).unwrap());
        for command in commands {
            match command {
                Command::RunJob => self.job = self.host.take_job(),
                Command::Ask(ask) => self.asks.push_back(ask),
                Command::Store(_) => self.stores += 1,
                _ => {}
            }
        }
    }

    fn answer_all(&mut self) {
        while let Some(ask) = self.asks.pop_front() {
            let of_host = matches!(
                ask.pattern,
                Pattern::One(Key::Lease(_) | Key::Settings(_)) | Pattern::Commands(_)
            );
            let answers = if of_host { Vec::new() } else { vec![arrival(&pose("r1", -0.1))] };
            self.step(Input::Answered { ask: ask.ask, answers });
        }
    }

    fn store(&mut self, error: Option<&str>) {
        assert_ne!(self.stores, 0);
        self.stores -= 1;
        self.step(Input::Stored { error: error.map(str::to_owned) });
    }

    fn end_job(&mut self) {
        let job = self.job.take().unwrap();
        let mut time = 5;
        let mut stopwatch = Stopwatch::reading(move || {
            time *= 3;
            time
        });
        let run = std::panic::AssertUnwindSafe(|| Small::<ONE_LEADS>::run(job, &mut stopwatch));
        let panic = match std::panic::catch_unwind(run) {
            Ok(done) => {
                self.host.finish_job(done);
                None
            }
            Err(panic) => Some(panic_text(panic.as_ref())),
        };
        self.step(Input::JobEnded { laps: stopwatch.laps().to_vec(), panic });
    }

    fn get(&mut self, id: u64, key: Key, parameters: &str) {
        self.step(Input::Get(IncomingGet {
            get: GetId(id),
            selector: space().format(&key),
            narrowed: None,
            parameters: parameters.to_owned(),
            payload: None,
        }));
    }

    fn set(&mut self, id: u64, patch: &str) {
        let key = Key::Settings(ServiceName::Clusterer).to_string();
        let (key, command) = command_of(self.now, &key, "c1", patch).unwrap();
        self.step(Input::Get(IncomingGet {
            get: GetId(id),
            selector: format!("muster/v1/{}/{key}", space().fleet()),
            narrowed: None,
            parameters: String::new(),
            payload: Some(command.into_bytes()),
        }));
    }
}

/// A life in which everything happens that can happen to a service.
fn life() -> Recorder {
    let mut life = Recorder::new();
    life.step(Input::Started { linked: true });
    life.answer_all();
    life.store(None);
    life.step(arrived(&pose("r1", 40.5)));
    life.end_job();
    life.step(arrived(&pose("r1", 2e6)));
    life.end_job();
    life.step(arrived(&small::token("other", true)));
    life.step(refused());
    life.step(Input::Timer);
    life.step(Input::LinkLost);
    life.step(Input::LinkRestored);
    life.now.0 += 1_000_000;
    life.answer_all();
    life.step(Input::Timer);
    life.set(1, "{\"teams\":4}");
    life.get(2, Key::Settings(ServiceName::Clusterer), "format=bincode");
    life.store(Some("no space left"));
    life.step(Input::ProcessCounters(BTreeMap::from([("threads".to_owned(), 2)])));
    life.get(3, Key::Status(ServiceName::Clusterer), "format=json");
    life.get(4, Key::Teams, "");
    for name in ["output", "fetch", "declare", "append", "lookup", "retain", "withdraw"] {
        life.step(arrived(&order(name)));
    }
    life.step(Input::Found { lookup: 5, page: Err("gone".to_owned()) });
    life.step(Input::Recorded(Box::default()));
    life
}

/// How many inputs [`life`] has.
const INPUTS: u64 = 34;

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
    assert_eq!(life.inputs, INPUTS);
    let compared = replay::<Small<ONE_LEADS>>(&life.bytes, u64::MAX).unwrap();
    assert_eq!(compared.difference, None);
    assert_eq!((compared.inputs, compared.jobs), (INPUTS, 2));
    assert_eq!(compared.ending, Ending::BrokenOff(None));
    // Every kind of input and of command was in it, so that nothing is shown by its absence.
    let (head, entries) = read(&life.bytes);
    assert_eq!(head, Head::new::<Small<ONE_LEADS>>(&start(), "here".to_owned()).unwrap());
    let text = format!("{entries:?}");
    for kind in [
        "Started { linked: true }",
        "source: Put",
        "source: TokenAlive",
        "Timer",
        "JobEnded { laps: [30, 90], panic: None }",
        "JobEnded { laps: [30], panic: Some",
        "Answered {",
        "Get(IncomingGet",
        "LinkLost",
        "LinkRestored",
        "Stored { error: None }",
        "Stored { error: Some",
        "Found {",
        "Recorded(RecordingReport {",
        "ProcessCounters(",
        "Publish(Publication { packets: [Packet",
        "is_lease_renewal: true",
        "is_lease_renewal: false",
        "Reply(Reply { get: GetId(1), answer: Err",
        "Reply(Reply { get: GetId(2), answer: Ok([Packet",
        "Reply(Reply { get: GetId(4), answer: Err",
        "RunJob",
        "Ask(Ask {",
        "Store(Stored {",
        "ReplicaState(Suspect)",
        "ReplicaState(Leading)",
        "DeclareToken(",
        "WithdrawToken(",
        "Append(Entry {",
        "Retain(Retention {",
        "LookUp {",
    ] {
        assert!(text.contains(kind), "no {kind} in {text}");
    }
    let mut stated = life.bytes.clone();
    stated.extend(frame(&Entry::End("enough".to_owned())).unwrap());
    let ended = replay::<Small<ONE_LEADS>>(&stated, u64::MAX).unwrap();
    assert_eq!(ended.ending, Ending::Stated("enough".to_owned()));
    let early = replay::<Small<ONE_LEADS>>(&stated, 3).unwrap();
    assert_eq!((early.inputs, early.ending), (3, Ending::NotReached));
}

/// Another core is on the same course until the first pose beyond forty, and only there.
#[test]
fn the_first_input_at_which_a_core_differs_is_found() {
    let life = life();
    let compared = replay::<Small<CHANGED>>(&life.bytes, u64::MAX).unwrap();
    let difference = compared.difference.unwrap();
    assert_eq!(difference.step.number, 9, "the job's end is where it shows");
    assert!(matches!(difference.step.input, Input::JobEnded { .. }));
    assert_ne!(difference.now.unwrap(), difference.step.commands.unwrap());
}

fn spoil(packet: &mut Packet) {
    *packet.payload.as_mut().unwrap().last_mut().unwrap() ^= 1;
}

#[test]
fn every_command_that_is_changed_is_found_where_it_is() {
    let (head, entries) = read(&life().bytes);
    let mut changed = 0;
    for (at, entry) in entries.iter().enumerate() {
        let Entry::Commands(commands) = entry else { continue };
        for command in 0..commands.len() {
            let mut commands = commands.clone();
            match &mut commands[command] {
                Command::Publish(publication) => spoil(&mut publication.packets[0]),
                Command::Reply(Reply { answer: Ok(packets), .. }) => spoil(&mut packets[0]),
                Command::Reply(Reply { answer: Err(text), .. })
                | Command::Unencodable(text)
                | Command::KeptIsUnusable(text) => {
                    text.push('!');
                }
                Command::RunJob => commands.clear(),
                Command::Ask(ask) => ask.within += Duration::from_secs(1),
                Command::Store(stored) => stored.term += 1,
                Command::Keep(content) => content.push(1),
                Command::ReplicaState(state) => *state = ReplicaState::Starting,
                Command::DeclareToken(key) | Command::WithdrawToken(key) => *key = Key::Teams,
                Command::Append(entry) => entry.at.0 += 1,
                Command::Retain(retention) => retention.max_bytes += 1,
                Command::LookUp { lookup, .. } => *lookup += 1,
            }
            changed += 1;
            let mut entries = entries.clone();
            entries[at] = Entry::Commands(commands);
            let compared = replay::<Small<ONE_LEADS>>(&write(&head, &entries), u64::MAX).unwrap();
            assert_eq!(compared.difference.unwrap().step.number, at as u64 / 2 + 1);
        }
    }
    assert!(changed > 30, "{changed}");
}

#[test]
fn a_core_that_panics_does_so_again_where_its_recording_breaks_off() {
    let mut life = life();
    // The shell writes the input down before the host takes it, and nothing after it.
    life.bytes.extend(input_frame(life.now, &arrived(&pose("cursed", 1.0))).unwrap());
    let compared = replay::<Small<ONE_LEADS>>(&life.bytes, u64::MAX).unwrap();
    let difference = compared.difference.unwrap();
    assert_eq!(difference.step.number, INPUTS + 1);
    assert_eq!(difference.step.commands, None);
    let Err(ReplayError::Panicked(text)) = difference.now else { panic!("{difference:?}") };
    assert!(text.contains("must not be"), "{text}");
    // A good input whose commands were not written any more is no difference.
    let mut cut = self::life();
    cut.bytes.extend(input_frame(cut.now, &Input::Timer).unwrap());
    let compared = replay::<Small<ONE_LEADS>>(&cut.bytes, u64::MAX).unwrap();
    assert_eq!((compared.difference, compared.inputs), (None, INPUTS + 1));
}

#[test]
fn jobs_that_end_otherwise_are_reported() {
    let ended = |laps: &[u64], panic: Option<&str>| Input::JobEnded {
        laps: laps.to_vec(),
        panic: panic.map(str::to_owned),
    };
    /// One that has led for a moment.
    fn leading() -> Replay<Small<ONE_LEADS>> {
        let (head, entries) = read(&life().bytes);
        let mut replay = Replay::new(head).unwrap();
        for entry in &entries[..12] {
            if let Entry::Input { tick, input } = entry {
                replay.step(*tick, input.clone()).unwrap();
            }
        }
        replay
    }
    let why = |replay: &mut Replay<_>, input| match replay.step(Tick(1_010_000), input) {
        Err(ReplayError::Astray(why)) => why,
        other => panic!("{other:?}"),
    };
    assert!(why(&mut leading(), ended(&[1, 2], None)).contains("none was started"));
    let after = |x: f64, input: Input| {
        let mut replay = leading();
        let commands = replay.step(Tick(1_010_000), arrived(&pose("r1", x)));
        assert_eq!(commands, Ok(vec![Command::RunJob]));
        why(&mut replay, input)
    };
    assert!(after(1.0, ended(&[1], None)).contains("1 times then, 2 times now"));
    assert!(after(1.0, ended(&[1, 2], Some("x"))).contains("ends well now"));
    assert!(after(2e6, ended(&[1], None)).contains("panics now"));
    assert!(after(2e6, ended(&[1], Some("x"))).contains("then with \"x\""));
}

#[test]
fn what_does_not_fit_together_is_unreadable() {
    let (head, entries) = read(&life().bytes);
    let why = |head: &Head, entries: &[Entry]| match replay::<Small<ONE_LEADS>>(
        &write(head, entries),
        99,
    ) {
        Err(ReplayError::Unreadable(why)) => why,
        other => panic!("{other:?}"),
    };
    let other = Head { service: ServiceName::Auditor, ..head.clone() };
    assert!(why(&other, &entries).contains("auditor"));
    let other = Head { settings: serde_json::json!({"teams": "many"}), ..head.clone() };
    assert!(why(&other, &entries).contains("settings"));
    assert!(why(&head, &entries[1..]).contains("input 1"));
    let twice = [&entries[..1], &entries[..1]].concat();
    assert!(why(&head, &twice).contains("another input"));
}

/// A recording holds packets as they came: what was refused then is refused again.
#[test]
fn a_packet_that_was_not_understood_is_not_understood_again() {
    let mut recorder = Recorder::new();
    for _ in 0..2 {
        recorder.step(refused());
    }
    let compared = replay::<Small<ONE_LEADS>>(&recorder.bytes, u64::MAX).unwrap();
    assert_eq!((compared.difference, compared.inputs), (None, 2));
}

/// The bytes of every kind of entry are frozen: a recording of last year must be read. A
/// deliberate change is a new `VERSION` of recordings; then run with `UPDATE_GOLDEN=1`.
#[test]
fn the_bytes_of_entries_are_frozen() {
    let put = || {
        let (key, encoding) = ("muster/v1/alpha/teams", "application/json");
        Packet::put(key, encoding, *b"{}")
    };
    let token = |alive| Packet::token("muster/v1/alpha/robot/r1", alive);
    let get = |get, narrowed: Option<&str>, payload| {
        Input::Get(IncomingGet {
            get: GetId(get),
            selector: "a/*".to_owned(),
            narrowed: narrowed.map(str::to_owned),
            parameters: "format=json".to_owned(),
            payload,
        })
    };
    let robot = || RobotId::new("r1").unwrap();
    let entry = history::Entry {
        at: Tick(70_000),
        record: Record::Left {
            robot: robot(),
            last_seen: Tick(60_000),
            reason: LeaveReason::Silent,
        },
    };
    let division = DivisionRow {
        sequence: 7,
        at: Tick(70_000),
        revision: Revision { term: 3, epoch: 4 },
        requested: 2,
        teams: 1,
        robots: 9,
        changed: 1,
        snapshot: Some(SnapshotCause::Gap),
    };
    let page = Page { rows: Rows::Divisions(vec![division]), before: Some(7) };
    let event = EventRow {
        sequence: 8,
        at: Tick(80_000),
        source: ServiceName::Ingest,
        revision: Revision { term: 3, epoch: 5 },
        severity: Severity::Info,
        event: "robot_left".to_owned(),
        detail: "{}".to_owned(),
    };
    let events = Page { rows: Rows::Events(vec![event]), before: None };
    let report = RecordingReport { lost: 5, ..RecordingReport::default() };
    let inputs = [
        Input::Started { linked: false },
        Input::Arrived(Arrival::encoded(put())),
        Input::Arrived(Arrival::encoded(Packet { payload: Err(70_000), ..put() })),
        Input::Arrived(Arrival::encoded(Packet { source: Source::Delete, ..put() })),
        Input::Arrived(Arrival::encoded(token(true))),
        Input::Arrived(Arrival::encoded(token(false))),
        Input::Timer,
        Input::JobEnded { laps: vec![1, 300, 70_000], panic: None },
        Input::JobEnded { laps: vec![2], panic: Some("said".to_owned()) },
        Input::Answered { ask: AskId(3), answers: vec![Arrival::encoded(put())] },
        get(4, Some("a/b"), Some(vec![7])),
        get(5, None, None),
        Input::LinkLost,
        Input::LinkRestored,
        Input::Stored { error: None },
        Input::Stored { error: Some("full".to_owned()) },
        Input::Restored(vec![1, 2, 3]),
        Input::Kept { error: None },
        Input::Kept { error: Some("full".to_owned()) },
        Input::Found { lookup: 6, page: Ok(page) },
        Input::Found { lookup: 7, page: Ok(events) },
        Input::Found { lookup: 8, page: Err("gone".to_owned()) },
        Input::ProcessCounters(BTreeMap::from([("threads".to_owned(), 2)])),
        Input::Recorded(Box::new(report)),
    ];
    let publication = |is_lease_renewal| {
        let packets = vec![put(), put()];
        Command::Publish(Publication { packets, is_lease_renewal, message: None })
    };
    let reply =
        |get, answer| Command::Reply(Reply { get: GetId(get), answer, messages: Vec::new() });
    let ask = |pattern| {
        Command::Ask(Ask {
            ask: AskId(6),
            pattern,
            within: Duration::from_secs(1),
            further_within: None,
        })
    };
    let commands = vec![
        publication(false),
        publication(true),
        reply(4, Ok(vec![put()])),
        reply(5, Err("no".to_owned())),
        Command::RunJob,
        ask(Pattern::Graphs),
        ask(Pattern::One(Key::Lease(ServiceName::Auditor))),
        Command::Store(start().stored),
        Command::Keep(vec![4, 5]),
        Command::KeptIsUnusable("damaged".to_owned()),
        Command::ReplicaState(ReplicaState::Starting),
        Command::ReplicaState(ReplicaState::Standby),
        Command::ReplicaState(ReplicaState::Suspect),
        Command::ReplicaState(ReplicaState::Leading),
        Command::DeclareToken(Key::Teams),
        Command::WithdrawToken(Key::Teams),
        Command::Append(Box::new(entry)),
        Command::LookUp { lookup: 6, query: Query::of(Subject::Robot(robot())) },
        Command::Unencodable("too large".to_owned()),
        Command::Retain(Retention { before: Tick(1), max_bytes: 2 }),
    ];
    let tick = Tick(1_795_208_990_000_000);
    let mut entries: Vec<_> = inputs.map(|input| Entry::Input { tick, input }).into();
    entries.extend([Entry::Commands(commands), Entry::End("enough".to_owned())]);
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

    /// Damage that the checksum does not show, as an attacker may do it.
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
            // A core that panics on what was forged is caught as well, and reported.
            if let Ok(compared) = replay::<Small<ONE_LEADS>>(&bytes, u64::MAX) {
                prop_assert!(compared.inputs <= INPUTS);
            }
        }
    }
}
