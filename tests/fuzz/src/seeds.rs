//! The seeds of the corpus: messages that are frozen in golden files, built-in settings, files
//! that the manual shows, and what the services publish of a simulated fleet.

use std::path::Path;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::history::{self, Page, Query, Record, Retention, Rows, Subject};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName};
use muster_model::observation::{CheckedReport, Report};
use muster_model::role::ReplicaState;
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, IngestSettings,
};
use muster_model::time::Tick;
use muster_scenario::{Fleet, FleetOptions, ScenarioKind};
use muster_service::recording::{Entry, Head};
use muster_service::testkit::Bench;
use muster_service::{
    Arrival, Ask, AskId, Command, Core, GetId, IncomingGet, Input, Publication, Reply, Start,
    Stored,
};
use muster_wire::recording::{begin, frame};
use muster_wire::{Format, Key, Message, Packet, Pattern};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::cores::{KEYS, PLANNER_KEYS};
use crate::packets::{BINARY, NOW};

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
const SOLVE: [&str; 6] = [
    r#"{"robots":["r1","r2","r3","r4"],"modalities":[{"name":"radio","edges":[["r1","r2",1],["r2","r1",1],["r3","r4",1],["r4","r3",1]]}],"teams":2}"#,
    r#"{"robots":["r1","r2","r3"],"modalities":[{"name":"spatial","weight":0.4,"matrix":[[0,1,0],[1,0,0],[0,0,0]]},{"name":"hierarchy","weight":0.6,"edges":[["r1","r3",1.0]]}],"alpha":{"fraction":0.5},"dimension":"auto","teams":2,"emit":["katz","embedding","diagnostics"]}"#,
    r#"{"robots":["r1","r2"],"teams":1,"poses":{"r1":{"x":0,"y":0},"r2":{"x":3,"y":4,"z":0}},"links":{"r1":[{"peer":"r2","quality":0.9}]},"ranks":{"r2":{"superior":"r1"}},"weights":{"spatial":0.5,"connectivity":0.25,"hierarchy":0.25},"spatial":{"width":2.0},"connectivity":{"unit":"quality"}}"#,
    r#"{"robots":["r1","r2","r3"],"modalities":[{"name":"m","matrix":[[0,1,0],[0,0,1],[1,0,0]]}],"normalize":"none","scale":"none","rows":"none","init":"random","restarts":1,"seed":7,"alpha":0.2,"dimension":4,"teams":2}"#,
    r#"{"robots":["r1","r2","r3"],"modalities":[{"name":"m","edges":[["r1","r2",0.5],["r2","r3",2]]}],"labels":[0,1,1]}"#,
    r#"{"robots":["r1","r2","r3","r4"],"modalities":[{"name":"m","matrix":[[0,1,0,0],[1,0,1,0],[0,0,0,1],[0,0,1,0]]}],"teams":2,"size":{"min":1,"max":2},"team_size":{"t1":{"max":1}},"needs":[{"skill":"medic","per_team":{"min":1}}],"skills":{"r1":["medic"],"r3":["medic"]},"wishes":[{"kind":"apart","robots":["r1","r2"]},{"kind":"reserve","robots":["r4"]}]}"#,
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

/// The team of a robot, as the manual has it, and where it has none.
const ROBOT_TEAMS: [&str; 2] = [
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
    for (number, json) in ROBOT_TEAMS.iter().enumerate() {
        let bytes = format!("p~robot/r1/team\n\n{json}").into_bytes();
        add("robot_team", format!("json-{number}"), &bytes);
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
    for target in ["replica", "ingest", "embedder", "clusterer", "auditor", "planner"] {
        for number in 0..4 {
            let mut random = ChaCha8Rng::seed_from_u64(number);
            let mut bytes = vec![0; 200 * (number as usize + 1)];
            random.fill_bytes(&mut bytes);
            add(target, format!("random-{number}"), &bytes);
        }
    }
    let ros = crate::ros::seeds().into_iter();
    seeds.extend(ros.map(|(name, bytes)| Seed { target: "ros", name, bytes }));
    let mcap = crate::mcap::seeds().into_iter();
    seeds.extend(mcap.map(|(name, bytes)| Seed { target: "mcap", name, bytes }));
    seeds.extend(pipeline());
    seeds.extend(recordings());
    seeds
}

/// A recording with an entry of each kind, as a file and as the contents of its frames.
fn recordings() -> Vec<Seed> {
    let key = |path: &str| format!("muster/v1/alpha/{path}");
    let packet = Packet::put(key("event"), BINARY.to_owned(), vec![1, 2, 3]);
    let cut = Packet { payload: Err(2 << 20), ..packet.clone() };
    let token = Packet::token(key("robot/r1"), true);
    let get = IncomingGet {
        get: GetId(7),
        selector: key("teams"),
        narrowed: Some(key("*")),
        parameters: "format=json".to_owned(),
        payload: Some(b"{}".to_vec()),
    };
    let gap = Record::Gap { from: Tick(1), until: Tick(2), records: 3 };
    let record = Box::new(history::Entry { at: NOW, record: gap });
    let page = Page { rows: Rows::Divisions(Vec::new()), before: Some(3) };
    let inputs = [
        Input::Started { linked: true },
        Input::Arrived(Arrival::encoded(packet.clone())),
        Input::Arrived(Arrival::encoded(cut)),
        Input::Timer,
        Input::JobEnded { laps: vec![5, 9], panic: None },
        Input::JobEnded { laps: vec![5], panic: Some("a panic".to_owned()) },
        Input::Answered { ask: AskId(1), answers: vec![Arrival::encoded(token)] },
        Input::Get(get),
        Input::LinkLost,
        Input::LinkRestored,
        Input::Stored { error: Some("no".to_owned()) },
        Input::Restored(vec![1, 2]),
        Input::Kept { error: Some("no".to_owned()) },
        Input::Found { lookup: 1, page: Ok(page) },
        Input::Recorded(Box::default()),
        Input::ProcessCounters([("inbox_dropped".to_owned(), 3)].into()),
    ];
    let packets = vec![packet];
    let commands = vec![
        Command::Publish(Publication {
            packets: packets.clone(),
            is_lease_renewal: false,
            message: None,
        }),
        Command::Reply(Reply { get: GetId(7), answer: Ok(packets), messages: Vec::new() }),
        Command::Reply(Reply { get: GetId(8), answer: Err("no".to_owned()), messages: Vec::new() }),
        Command::RunJob,
        Command::Ask(Ask {
            ask: AskId(1),
            pattern: Pattern::Graphs,
            within: Duration::from_secs(1),
            further_within: Some(Duration::from_millis(300)),
        }),
        Command::Keep(vec![3, 4]),
        Command::KeptIsUnusable("no".to_owned()),
        Command::Store(Stored {
            lacks_settings: true,
            term: 3,
            patch: [("teams".to_owned(), 3.into())].into_iter().collect(),
            commands: Vec::new(),
            changed: [("teams".to_owned(), Tick(9))].into_iter().collect(),
        }),
        Command::ReplicaState(ReplicaState::Standby),
        Command::DeclareToken(Key::Roster),
        Command::WithdrawToken(Key::Settings(ServiceName::Auditor)),
        Command::Append(record),
        Command::LookUp { lookup: 1, query: Query::of(Subject::Divisions) },
        Command::Retain(Retention { before: Tick(1), max_bytes: 2 }),
        Command::Unencodable("no".to_owned()),
    ];
    let mut entries: Vec<_> =
        inputs.into_iter().map(|input| Entry::Input { tick: NOW, input }).collect();
    entries.push(Entry::Commands(commands));
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
        ("wishes", "wishes"),
        ("alerts", "alerts"),
        ("command_outcome", "command/clusterer/kim/c1"),
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
        if name == "teams" {
            let (numbers, nothing) = (300_u64.to_le_bytes(), 0_u32.to_le_bytes());
            let head = [&numbers[..], &nothing].concat();
            add("kept", "division", [&head[..], &bytes].concat());
            add("kept", "numbers", head);
        }
        if name == "wishes" {
            let length = u32::try_from(bytes.len()).unwrap();
            let head = [300_u64.to_le_bytes().as_slice(), &length.to_le_bytes()].concat();
            add("kept", "wishes", [&head[..], &bytes].concat());
        }
        if name == "robot_team" {
            add("robot_team", name, [head.as_bytes(), &bytes].concat());
        }
        if place < 4 {
            let json = std::fs::read_to_string(folder.join(format!("{name}.json"))).unwrap();
            let head = format!("p~{key}\n\n{json}");
            add("packet", &format!("{name}-json"), head.into_bytes());
            let stream = u8::try_from(place).unwrap();
            add("edge_json", name, [&[stream], json.as_bytes()].concat());
        }
    }
    let json = std::fs::read_to_string(folder.join("katz.json")).unwrap();
    let bytes = format!("p~embedding\n\n{json}").into_bytes();
    seeds.push(Seed { target: "katz", name: "katz-json".to_owned(), bytes });
    let json = std::fs::read_to_string(folder.join("why.json")).unwrap();
    let bytes = format!("p~why\n\n{json}").into_bytes();
    seeds.push(Seed { target: "why", name: "why-json".to_owned(), bytes });
    let json = r#"{"instance": "host-1", "version": "0.1.0", "robots": 2, "received": 70, "reported": 20, "refused_topics": 1,
        "refused": [{"topic": "0/r3/odom", "fault": "no_chain", "reason": "no transforms lead to map"}]}"#;
    let bytes = format!("p~bridge/host-1\n\n{json}").into_bytes();
    seeds.push(Seed { target: "bridge", name: "bridge-json".to_owned(), bytes });
    let json = std::fs::read_to_string(folder.join("proposal.json")).unwrap();
    let bytes = format!("p~propose/alice/p1\n\n{json}").into_bytes();
    seeds.push(Seed { target: "proposal", name: "proposal-json".to_owned(), bytes });
    let request =
        r#"{"teams":{"from":2,"to":4},"weights":{"spatial":1},"size":{"min":2},"without":["r7"]}"#;
    let bytes = request.as_bytes().to_vec();
    seeds.push(Seed { target: "proposal", name: "proposal-request".to_owned(), bytes });
    for letter in ["a", "g", "d", "c"] {
        let bytes = format!("{letter}~robot/r1\n\n").into_bytes();
        seeds.push(Seed { target: "packet", name: format!("token-{letter}"), bytes });
    }
    seeds
}

/// Inputs of cores: what the service before each publishes of a small fleet, with time passing.
fn pipeline() -> Vec<Seed> {
    let options = FleetOptions { robots: 5, teams: 2, ..FleetOptions::default() };
    let fleet = Fleet::new(ScenarioKind::Clusters, options).unwrap();
    // The keys of the cores' target name robots r0 to r3.
    let renamed = |robot: &RobotId| {
        let number = fleet.robots().iter().position(|other| other == robot).unwrap();
        RobotId::new(format!("r{number}")).unwrap()
    };
    let mut reported = Vec::new();
    for second in 0..3 {
        for mut robot in fleet.observe(f64::from(second)) {
            for link in &mut robot.links.links {
                link.peer = renamed(&link.peer);
            }
            robot.rank.superior = robot.rank.superior.as_ref().map(renamed);
            let reports = [robot.pose.into(), robot.links.into(), robot.rank.into()];
            reported.extend(reports.map(|report: Report| {
                Message::Report(CheckedReport::new(renamed(&robot.robot), report).unwrap())
            }));
        }
    }
    let graphs = publish::<Ingest>(&reported);
    let embeddings = publish::<Embedder>(&graphs);
    let rosters: Vec<_> =
        graphs.iter().filter(|message| matches!(message, Message::Roster(_))).cloned().collect();
    let teams: Vec<_> = publish::<Clusterer>(&[&*rosters, &*embeddings].concat())
        .into_iter()
        .filter(|message| matches!(message, Message::Teams { .. }))
        .collect();
    let clusterer_inputs = [&rosters[..1], &embeddings[..3]].concat();
    // The last of each belong to the same frame.
    let last = |messages: &[Message]| messages.last().unwrap().clone();
    let auditor_inputs = [last(&rosters), last(&embeddings), last(&teams)];
    [
        ("ingest", inputs(&reported)),
        ("embedder", inputs(&graphs)),
        ("clusterer", inputs(&clusterer_inputs)),
        ("auditor", inputs(&auditor_inputs)),
        ("planner", planner_inputs(&graphs, &embeddings, &teams)),
    ]
    .map(|(target, bytes)| Seed { target, name: "pipeline".to_owned(), bytes })
    .into()
}

/// What a planner follows of the first frame, a get of a proposal, and the settings that it is computed with.
fn planner_inputs(graphs: &[Message], embeddings: &[Message], teams: &[Message]) -> Vec<u8> {
    let place = |key: &str| {
        let place = PLANNER_KEYS.iter().position(|known| *known == key).unwrap();
        u8::try_from(place).unwrap()
    };
    let block =
        |bytes: &[u8]| [&u16::try_from(bytes.len()).unwrap().to_le_bytes()[..], bytes].concat();
    let encoded = |message: &Message| {
        let out = message.encode(message.keys().0, Format::Binary, NOW).unwrap();
        [&[place(&out.key.to_string())][..], &block(&out.payload)].concat()
    };
    let end = graphs.iter().position(|message| matches!(message, Message::Roster(_))).unwrap();
    let frame = graphs[..=end].iter().chain(embeddings.first()).chain(teams.first());
    // The first fetch is answered with nothing.
    let mut bytes = vec![8, 0];
    for message in frame {
        bytes.push(5);
        bytes.extend(encoded(message));
    }
    // Half a second passes; a get asks for two teams; its fetch is answered, and the job ends.
    bytes.extend([0, 0xF4, 1, 1, 9, 0, 4]);
    bytes.extend(block(&[0]));
    bytes.extend([8, 2]);
    bytes.extend(encoded(&announced::<Clusterer>()));
    bytes.extend(encoded(&announced::<Embedder>()));
    bytes.push(10);
    bytes
}

/// The settings that a service announces when it begins to lead.
fn announced<C: Core>() -> Message {
    let fleet = FleetId::new("alpha").unwrap();
    let instance = InstanceId::new("seed-1").unwrap();
    let bench = Bench::<C>::leading(fleet, instance, NOW, C::Settings::default(), Vec::new());
    let mut published = bench.published.into_iter();
    published.find(|message| matches!(message, Message::Settings(_))).unwrap()
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
        // Half a second passes, a deadline is met, a job ends, a get asks for everything.
        bytes.extend([0, 0xF4, 1, 1, 10, 9, 0, 1]);
    }
    bytes
}

/// What a service publishes after messages that arrive every twentieth of a second.
fn publish<C: Core>(messages: &[Message]) -> Vec<Message> {
    let fleet = FleetId::new("alpha").unwrap();
    let instance = InstanceId::new("seed-1").unwrap();
    let mut bench = Bench::<C>::leading(fleet, instance, NOW, C::Settings::default(), Vec::new());
    for message in messages {
        bench.receive(message.clone());
        bench.wait(0.05);
        bench.answer_all(Vec::new());
    }
    bench.wait(1.0);
    let is_output = |message: &Message| {
        !matches!(message, Message::Event(_) | Message::Settings(_) | Message::LeaseRenewal(_))
    };
    bench.published.into_iter().filter(is_output).collect()
}
