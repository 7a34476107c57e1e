//! What the corpus has begun with: messages that are frozen in golden files, built-in settings, files
//! that the manual shows, and what the services tell each other of a simulated fleet.

use std::collections::VecDeque;
use std::path::Path;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_machine::recording::{Entry, Head, Input, Output};
use muster_machine::{Command, Core, Driver, Event, Start, Stopwatch, Stored};
use muster_model::id::{FleetId, InstanceId};
use muster_model::observation::{CheckedReport, Report};
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, IngestSettings,
};
use muster_model::time::Tick;
use muster_scenario::{Fleet, FleetOptions, ScenarioKind};
use muster_wire::recording::{Bytes, Put, Received, begin, frame};
use muster_wire::{Format, Message, Rejection, Request};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::cores::KEYS;
use crate::packets::{BINARY, NOW, space};

/// One input for a target.
#[derive(Debug)]
pub struct Seed {
    /// Which target.
    pub target: &'static str,
    /// What it is, as a file name.
    pub name: String,
    /// The input.
    pub bytes: Vec<u8>,
}

/// Files of `muster solve`, as the manual has them.
const SOLVE: [&str; 5] = [
    r#"{"robots":["r1","r2","r3","r4"],"modalities":[{"name":"radio","edges":[["r1","r2",1],["r2","r1",1],["r3","r4",1],["r4","r3",1]]}],"teams":2}"#,
    r#"{"robots":["r1","r2","r3"],"modalities":[{"name":"spatial","weight":0.4,"matrix":[[0,1,0],[1,0,0],[0,0,0]]},{"name":"hierarchy","weight":0.6,"edges":[["r1","r3",1.0]]}],"alpha":{"fraction":0.5},"dimension":"auto","teams":2,"emit":["katz","embedding","diagnostics"]}"#,
    r#"{"robots":["r1","r2"],"teams":1,"poses":{"r1":{"x":0,"y":0},"r2":{"x":3,"y":4,"z":0}},"links":{"r1":[{"peer":"r2","quality":0.9}]},"ranks":{"r2":{"superior":"r1"}},"weights":{"spatial":0.5,"connectivity":0.25,"hierarchy":0.25},"spatial":{"width":2.0},"connectivity":{"unit":"quality"}}"#,
    r#"{"robots":["r1","r2","r3"],"modalities":[{"name":"m","matrix":[[0,1,0],[0,0,1],[1,0,0]]}],"normalize":"none","scale":"none","rows":"none","init":"random","restarts":1,"seed":7,"alpha":0.2,"dimension":4,"teams":2}"#,
    r#"{"robots":["r1","r2","r3"],"modalities":[{"name":"m","edges":[["r1","r2",0.5],["r2","r3",2]]}],"labels":[0,1,1]}"#,
];

const PATHS: [&str; 9] = [
    "robot/r1",
    "robot/r1/pose",
    "robot/r1/relation/thermal",
    "graph/spatial",
    "roster",
    "json/teams",
    "service/ingest/settings",
    "service/clusterer/host-1",
    "robot/*/pose",
];

const REQUESTS: [&str; 8] = [
    "~/teams\nformat=json\n",
    "~/**\n\n",
    "muster/*/alpha/robot/*/team\nformat=bincode\n",
    "~/graph/spa$*\nx=1;format=json\n",
    "**/$*a$*i$*/**\n\n",
    "~/service/clusterer/settings\n\n{\"teams\":3}",
    "**/**/*/team$*\n\n",
    "~/teams\nformat=xml\n",
];

/// What a robot is told, as the manual has it, and where it has no team.
const TOLD: [&str; 2] = [
    r#"{"fleet":"alpha","term":1,"epoch":42,"data_age_s":0.08,"stages":[{"stage":"clusterer","received":1795208990.1,"published":1795208990.2}],"robot":"r1","team":"t1","members":["r1","r2"],"leader":"r1","confidence":0.6}"#,
    r#"{"fleet":"alpha","term":1,"epoch":42,"data_age_s":null,"stages":[],"robot":"r1","team":null,"members":null,"leader":null,"confidence":0,"later":[]}"#,
];

/// All seeds.
///
/// # Panics
/// If the golden files are not where they belong.
#[must_use]
pub fn all() -> Vec<Seed> {
    let mut seeds = golden();
    let mut add = |target, name: String, bytes: &[u8]| {
        seeds.push(Seed { target, name, bytes: bytes.to_vec() });
    };
    for (number, json) in TOLD.iter().enumerate() {
        add("told", format!("json-{number}"), format!("p~robot/r1/team\n\n{json}").as_bytes());
    }
    for (number, path) in PATHS.iter().enumerate() {
        add("key", format!("key-{number}"), format!("~{path}").as_bytes());
    }
    for (number, request) in REQUESTS.iter().enumerate() {
        add("request", format!("request-{number}"), request.as_bytes());
    }
    for (number, file) in SOLVE.iter().enumerate() {
        add("solve", format!("manual-{number}"), format!("\0{file}").as_bytes());
        add("solve", format!("manual-{number}-normalized"), format!("\u{1}{file}").as_bytes());
    }
    let defaults = [
        serde_json::to_string(&IngestSettings::default()),
        serde_json::to_string(&EmbedderSettings::default()),
        serde_json::to_string(&ClustererSettings::default()),
        serde_json::to_string(&AuditorSettings::default()),
    ];
    for (service, settings) in (0_u8..).zip(defaults) {
        let settings = settings.unwrap();
        let bytes = [&[service], settings.as_bytes(), b"\n{\"teams\":3}"].concat();
        add("settings", format!("default-{service}"), &bytes);
        let file = format!("{{\"term\":3,\"patch\":{settings}}}");
        add("stored", format!("default-{service}"), &[&[service], file.as_bytes()].concat());
    }
    for target in ["replica", "ingest", "embedder", "clusterer", "auditor"] {
        for number in 0..4 {
            let mut random = ChaCha8Rng::seed_from_u64(number);
            let mut bytes = vec![0; 200 * (number as usize + 1)];
            random.fill_bytes(&mut bytes);
            add(target, format!("random-{number}"), &bytes);
        }
    }
    seeds.extend(told());
    seeds.extend(recordings());
    seeds
}

/// A recording with an entry of each kind, as a file and as the contents of its frames.
fn recordings() -> Vec<Seed> {
    let put = Put {
        key: "muster/v1/alpha/event".to_owned(),
        encoding: BINARY.to_owned(),
        payload: Bytes(vec![1, 2, 3]),
    };
    let token = Received::Token { key: "muster/v1/alpha/robot/r1".to_owned(), alive: true };
    let request = Request::new("muster/v1/alpha/teams", "format=json", None).unwrap();
    let inputs = [
        Input::Started,
        Input::Received(Received::Put(put.clone())),
        Input::Rejected(Rejection::new(&space(), "k", "r")),
        Input::Timeout,
        Input::Done(vec![5, 9]),
        Input::JobFailed(vec![5], "a panic".to_owned()),
        Input::Fetched(1, vec![token]),
        Input::Query(7, request),
        Input::LinkLost,
        Input::LinkRestored,
    ];
    let outputs = vec![
        Output::Published(Ok(vec![put.clone()])),
        Output::Replied(7, Err("no".to_owned())),
        Output::Ran,
        Output::Fetched(1, vec!["muster/v1/alpha/*".to_owned()]),
        Output::Stored("{}".to_owned()),
    ];
    let mut entries: Vec<_> =
        inputs.into_iter().map(|input| Entry::Event { tick: NOW, input }).collect();
    entries.push(Entry::Outputs(outputs));
    entries.push(Entry::End("4 GiB".to_owned()));
    let start = Start {
        fleet: FleetId::new("alpha").unwrap(),
        instance: InstanceId::new("seed-1").unwrap(),
        now: NOW,
        settings: AuditorSettings::default(),
        stored: Stored::default(),
    };
    let head = Head::new::<Auditor>(&start, "a host".to_owned()).unwrap();
    let mut file = begin(&head).unwrap();
    let mut contents = Vec::new();
    let mut add = |content: &[u8]| {
        contents.extend(u16::try_from(content.len()).unwrap().to_le_bytes());
        contents.extend(content);
    };
    add(&serde_json::to_vec(&head).unwrap());
    for entry in &entries {
        let framed = frame(entry).unwrap();
        // A frame begins with its length and its checksum.
        add(&framed[8..]);
        file.extend(framed);
    }
    assert_eq!(crate::recording::framed(&contents), file);
    let seed = |name: &str, bytes| Seed { target: "recording", name: name.to_owned(), bytes };
    let cut = file[..file.len() - 3].to_vec();
    vec![
        seed("file", [vec![0], file].concat()),
        seed("broken-off", [vec![0], cut].concat()),
        seed("frames", [vec![1], contents].concat()),
    ]
}

/// The golden messages, as packets and by themselves.
fn golden() -> Vec<Seed> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/wire/tests/golden");
    let mut seeds = Vec::new();
    let keys = [
        ("pose", "robot/r1/pose"),
        ("links", "robot/r1/links"),
        ("rank", "robot/r2/rank"),
        ("relation", "robot/r1/relation/thermal"),
        ("graph", "graph/hierarchy"),
        ("roster", "roster"),
        ("embedding", "embedding"),
        ("teams", "teams"),
        ("robot_team", "robot/r1/team"),
        ("audit", "audit"),
        ("event", "event"),
        ("event_change", "event"),
        ("settings", "service/clusterer/settings"),
    ];
    for (place, (name, key)) in keys.into_iter().enumerate() {
        let hex = std::fs::read_to_string(folder.join(format!("{name}.hex"))).unwrap();
        let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
        let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16);
        let bytes: Vec<u8> = digits.chunks(2).map(|pair| byte(pair).unwrap()).collect();
        let mut add = |target, name: &str, bytes| {
            seeds.push(Seed { target, name: name.to_owned(), bytes });
        };
        add("envelope", name, bytes[2..].to_vec());
        let head = format!("p~{key}\n{BINARY}\n");
        add("packet", name, [head.as_bytes(), &bytes].concat());
        if name == "robot_team" {
            add("told", name, [head.as_bytes(), &bytes].concat());
        }
        if place < 4 {
            let json = std::fs::read_to_string(folder.join(format!("{name}.json"))).unwrap();
            let head = format!("p~{key}\n\n{json}");
            add("packet", &format!("{name}-json"), head.into_bytes());
            let stream = u8::try_from(place).unwrap();
            add("edge_json", name, [&[stream], json.as_bytes()].concat());
        }
    }
    for letter in ["a", "g", "d", "c"] {
        let bytes = format!("{letter}~robot/r1\n\n").into_bytes();
        seeds.push(Seed { target: "packet", name: format!("token-{letter}"), bytes });
    }
    seeds
}

/// Inputs of cores: what the service before each tells of a small fleet, with time passing.
fn told() -> Vec<Seed> {
    let options = FleetOptions { robots: 5, teams: 2, ..FleetOptions::default() };
    let fleet = Fleet::new(ScenarioKind::Clusters, options).unwrap();
    let mut said = Vec::new();
    for second in 0..3 {
        for robot in fleet.observe(f64::from(second)) {
            let reports = [robot.pose.into(), robot.links.into(), robot.rank.into()];
            said.extend(reports.map(|report: Report| {
                Message::Report(CheckedReport::new(robot.robot.clone(), report).unwrap())
            }));
        }
    }
    let graphs = tell::<Ingest>(&said);
    let embeddings = tell::<Embedder>(&graphs);
    let rosters: Vec<_> =
        graphs.iter().filter(|message| matches!(message, Message::Roster(_))).cloned().collect();
    let with = |more: &[Message]| [&rosters[..1], &more[..more.len().min(3)]].concat();
    let teams = tell::<Clusterer>(&[&*rosters, &*embeddings].concat());
    let teams: Vec<_> =
        teams.into_iter().filter(|message| matches!(message, Message::Teams { .. })).collect();
    let all = [&embeddings[..1], &teams[..2]].concat();
    [
        ("ingest", inputs(&said)),
        ("embedder", inputs(&graphs)),
        ("clusterer", inputs(&with(&embeddings))),
        ("auditor", inputs(&with(&all))),
    ]
    .map(|(target, bytes)| Seed { target, name: "pipeline".to_owned(), bytes })
    .into()
}

/// Messages as the input of a core: each as a raw packet, with a timeout and the end of a job.
fn inputs(messages: &[Message]) -> Vec<u8> {
    // The first fetch is answered with nothing.
    let mut bytes = vec![8, 0];
    for message in messages {
        let out = message.encode(message.keys().0, Format::Binary, NOW).unwrap();
        let key = out.key.to_string();
        let Some(place) = KEYS.iter().position(|known| *known == key) else { continue };
        if bytes.len() + out.payload.len() > 3500 {
            break;
        }
        bytes.extend([5, u8::try_from(place).unwrap()]);
        bytes.extend(u16::try_from(out.payload.len()).unwrap().to_le_bytes());
        bytes.extend(&out.payload);
        // Half a second passes, a deadline is met, a job ends, somebody asks for everything.
        bytes.extend([0, 0xF4, 1, 1, 10, 9, 0, 1]);
    }
    bytes
}

/// What a core tells of messages, two a tenth of a second.
fn tell<C: Core>(messages: &[Message]) -> Vec<Message> {
    let mut driver = Driver::<C>::new(Start {
        fleet: FleetId::new("alpha").unwrap(),
        instance: InstanceId::new("seed-1").unwrap(),
        now: NOW,
        settings: C::Settings::default(),
        stored: Stored::default(),
    });
    let mut told = Vec::new();
    let mut now = NOW;
    let mut step = |now: Tick, event: Event<C::Done>| {
        let mut events = VecDeque::from([event]);
        while let Some(event) = events.pop_front() {
            for command in driver.step(now, event) {
                match command {
                    Command::Run(job) => {
                        events.push_back(Event::Done(C::run(job, &mut Stopwatch::still())))
                    }
                    Command::Fetch { fetch, .. } => {
                        events.push_back(Event::Fetched { fetch, messages: Vec::new() });
                    }
                    Command::Publish(Message::Event(_) | Message::Settings(_)) => {}
                    Command::Publish(message) => told.push(message),
                    Command::Reply { .. } | Command::Store(_) => {}
                }
            }
        }
    };
    step(now, Event::Started);
    for message in messages {
        step(now, Event::Received(message.clone()));
        now = Tick(now.0 + 50_000);
        step(now, Event::Timeout);
    }
    step(Tick(now.0 + 1_000_000), Event::Timeout);
    told
}
