//! What is recorded when, what is published of it, and how gets are answered: the core in its host, with records in
//! memory.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::time::Duration;

use muster_historian::Historian;
use muster_model::audit::{Audit, Flapping, Quality, SilhouetteReport, Space};
use muster_model::content::Checked;
use muster_model::event::{Event, EventKind, Severity};
use muster_model::header::{Header, Revision};
use muster_model::history::{
    LeaveReason, Query, Record, RecordingReport, RecordingState, Rows, SnapshotCause, Subject,
};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName, TeamId};
use muster_model::remembered::RememberedTeams;
use muster_model::roster::{Roster, RosterEntry};
use muster_model::settings::HistorianSettings;
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;
use muster_service::records::{MemoryRecords, RecordQueue, Records, WriteError};
use muster_service::testkit::Bench;
use muster_service::{Command, GetId, IncomingGet, Input};
use muster_wire::Message;
use muster_wire::envelope::AnnouncedSettings;

const NOW: Tick = Tick(1_795_208_980_000_000);
const S: Duration = Duration::from_secs(1);

fn fleet() -> FleetId {
    FleetId::new("alpha").unwrap()
}

fn instance() -> InstanceId {
    InstanceId::new("h-1").unwrap()
}

fn robot(number: usize) -> RobotId {
    RobotId::new(format!("r{number:05}")).unwrap()
}

fn header(epoch: u64) -> Header {
    let revision = Revision { term: 1_795_208_000, epoch };
    Header { fleet: fleet(), revision, oldest: None, newest: None, stages: Vec::new() }
}

/// A division whose teams have these robots.
fn division(epoch: u64, teams: &[&[usize]]) -> Message {
    let teams = teams.iter().enumerate().map(|(number, members)| Team {
        id: TeamId::numbered(number as u64 + 1),
        members: members.iter().map(|r| Member { robot: robot(*r), margin: 0.5 }).collect(),
        leader: robot(members[0]),
        centroid: vec![0.0],
    });
    let teams = Teams {
        header: header(epoch),
        embedding: Revision::default(),
        requested: 2,
        considered: Vec::new(),
        teams: teams.collect(),
        unassigned: Vec::new(),
        stale: Vec::new(),
        inertia: 0.0,
        changes: Vec::new(),
        next_team: 9,
        limited: None,
        needs: vec![],
        provisional: vec![],
        held: vec![],
        remembered: RememberedTeams::default(),
    };
    Message::Teams { teams: Checked::new(teams).unwrap(), mirror: false }
}

fn audit(epoch: u64, mean: f64, quality: Quality) -> Message {
    let in_embedding =
        SilhouetteReport { mean: Some(mean), ..SilhouetteReport::undefined(Space::Embedding) };
    Message::Audit(std::sync::Arc::new(Audit {
        graphs: None,
        losses: vec![],
        per_team: vec![],
        header: header(epoch),
        teams: header(epoch).revision,
        embedding: Revision::default(),
        in_embedding,
        in_physical: SilhouetteReport::undefined(Space::Physical),
        quality,
        flapping: Flapping::default(),
    }))
}

fn roster(epoch: u64, robots: impl Iterator<Item = usize>) -> Message {
    let entry = |number: usize| RosterEntry::active(number as u32, robot(number), Tick(NOW.0 - 7));
    let robots = robots.map(entry).collect();
    Message::Roster(
        Checked::new(Roster { header: header(epoch), robots, graphs: Vec::new() }).unwrap(),
    )
}

fn event(epoch: u64) -> Message {
    let kind = EventKind::RobotLeft { robot: robot(1) };
    let source = ServiceName::Ingest;
    Message::Event(Event { header: header(epoch), source, severity: Severity::Warning, kind })
}

/// The core with a store, which writes whenever it is told to.
struct Recording {
    bench: Bench<Historian>,
    queue: RecordQueue,
    store: MemoryRecords,
    appended: Vec<Record>,
}

impl Recording {
    fn start(answers: Vec<Message>) -> Self {
        Self::start_with(HistorianSettings::default(), answers)
    }

    fn start_with(settings: HistorianSettings, answers: Vec<Message>) -> Self {
        let bench = Bench::leading(fleet(), instance(), NOW, settings, answers);
        let (queue, store) = (RecordQueue::default(), MemoryRecords::default());
        let mut recording = Self { bench, queue, store, appended: Vec::new() };
        recording.carry_out();
        recording
    }

    /// Carries out what the core wants of the store.
    fn carry_out(&mut self) {
        loop {
            let commands = std::mem::take(&mut self.bench.others);
            if commands.is_empty() {
                return;
            }
            for command in commands {
                match command {
                    Command::Append(entry) => {
                        self.appended.push(entry.record.clone());
                        self.queue.push(*entry);
                    }
                    Command::LookUp { lookup, query } => {
                        let page = self.store.answer(&query);
                        self.bench.input(Input::Found { lookup, page });
                    }
                    Command::Retain(retention) => {
                        self.store.retain(&retention).unwrap();
                    }
                    _ => {}
                }
            }
        }
    }

    /// Writes what waits, as the thread of the runtime does, and reports it.
    fn write(&mut self) {
        let written = self.store.write(self.queue.batch());
        if written.is_ok() {
            self.queue.written();
        }
        let report = RecordingReport {
            coverage: self.store.coverage(),
            problem: written.err().map(|error| error.to_string()),
            lost: self.queue.take_lost(),
            damaged: None,
        };
        self.bench.input(Input::Recorded(Box::new(report)));
        self.carry_out();
    }

    fn receive(&mut self, message: Message) {
        self.bench.receive(message);
        self.carry_out();
    }

    fn pass(&mut self, duration: Duration) {
        self.bench.now = self.bench.now.after(duration);
        self.bench.input(Input::Timer);
        self.carry_out();
    }

    fn take(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.appended)
    }

    fn states(&mut self) -> Vec<RecordingState> {
        let published = std::mem::take(&mut self.bench.published);
        published
            .into_iter()
            .filter_map(|message| match message {
                Message::HistoryState(state) => Some(*state),
                _ => None,
            })
            .collect()
    }

    fn events(&mut self) -> Vec<EventKind> {
        let published = std::mem::take(&mut self.bench.published);
        published
            .into_iter()
            .filter_map(|message| match message {
                Message::Event(event) => Some(event.kind),
                _ => None,
            })
            .collect()
    }

    fn rows(&mut self, subject: Subject) -> Rows {
        self.store.answer(&Query::of(subject)).unwrap().rows
    }
}

fn snapshots(records: &[Record]) -> Vec<Option<SnapshotCause>> {
    let snapshot = |record: &Record| match record {
        Record::Division(division) => Some(division.snapshot),
        _ => None,
    };
    records.iter().filter_map(snapshot).collect()
}

#[test]
fn divisions_are_recorded_when_they_change_and_as_a_whole_every_ten_minutes() {
    let mut recording = Recording::start(vec![division(1, &[&[1, 2], &[3]])]);
    assert_eq!(snapshots(&recording.take()), [Some(SnapshotCause::Start)]);
    recording.pass(60 * S);
    recording.receive(division(2, &[&[1, 2], &[3]]));
    assert!(recording.take().is_empty(), "the same division changes nothing");
    recording.receive(division(3, &[&[1], &[2, 3]]));
    let [Record::Division(change)] = &recording.take()[..] else { panic!() };
    let moved: Vec<_> = change.places.iter().map(|place| place.robot.clone()).collect();
    assert_eq!((change.snapshot, moved), (None, vec![robot(2)]));
    let lines: Vec<_> =
        change.lines.iter().map(|line| (line.team.as_str(), line.members)).collect();
    assert_eq!(lines, [("t1", 1), ("t2", 2)]);
    recording.receive(division(2, &[&[1, 2, 3]]));
    assert!(recording.take().is_empty(), "an older division is none");
    recording.pass(540 * S);
    assert_eq!(snapshots(&recording.take()), [Some(SnapshotCause::Periodic)]);
    recording.pass(599 * S);
    assert!(recording.take().is_empty());
    recording.write();
    let Rows::AsOf(Some(first)) = recording.rows(Subject::AsOf(NOW)) else { panic!() };
    assert_eq!(first.teams[0].members, [robot(1), robot(2)]);
    let Rows::AsOf(Some(last)) = recording.rows(Subject::AsOf(NOW.after(61 * S))) else { panic!() };
    assert_eq!(last.teams[0].members, [robot(1)]);
    let Rows::Robot(places) = recording.rows(Subject::Robot(robot(2))) else { panic!() };
    let teams: Vec<_> = places.iter().map(|p| p.team.as_ref().unwrap().to_string()).collect();
    assert_eq!(teams, ["t2", "t1"]);
    let Rows::Team(rows) = recording.rows(Subject::Team(TeamId::numbered(2))) else { panic!() };
    assert_eq!((rows[0].came.as_slice(), rows[0].members), (&[robot(2)][..], 2));
}

#[test]
fn scores_are_recorded_at_most_once_in_an_interval_unless_the_verdict_changes() {
    let mut recording = Recording::start(vec![audit(1, 0.6, Quality::Good)]);
    assert_eq!(recording.take().len(), 1);
    recording.receive(audit(2, 0.61, Quality::Good));
    recording.receive(audit(3, 0.62, Quality::Good));
    assert!(recording.take().is_empty());
    recording.receive(audit(4, 0.3, Quality::Fair));
    assert!(matches!(&recording.take()[..], [Record::Audit(audit)] if audit.mean == Some(0.3)));
    recording.receive(audit(5, 0.31, Quality::Fair));
    recording.pass(9 * S);
    assert!(recording.take().is_empty());
    recording.pass(S);
    assert!(matches!(&recording.take()[..], [Record::Audit(audit)] if audit.mean == Some(0.31)));
    recording.pass(60 * S);
    assert!(recording.take().is_empty(), "nothing has changed");
}

/// A roster of robots at places, in metres east.
fn roster_at(epoch: u64, east: &[f64]) -> Message {
    let Message::Roster(roster) = roster(epoch, 0..east.len()) else { panic!() };
    let mut roster = Roster::clone(&roster);
    for (entry, east) in roster.robots.iter_mut().zip(east) {
        entry.position = Some([*east, 2.0, 0.0]);
    }
    Message::Roster(Checked::new(roster).unwrap())
}

#[test]
fn positions_are_recorded_where_robots_have_moved_and_found_as_of_a_moment() {
    let positions = |recording: &mut Recording| -> Vec<(bool, Vec<i64>)> {
        let of = |record: &Record| match record {
            Record::Positions(positions) => {
                let east = positions.robots.iter().map(|(_, [east, _])| *east).collect();
                Some((positions.is_whole, east))
            }
            _ => None,
        };
        recording.take().iter().filter_map(of).collect()
    };
    let mut recording = Recording::start(vec![roster_at(1, &[0.0, 10.0, 20.0])]);
    recording.receive(division(1, &[&[0, 1], &[2]]));
    assert_eq!(positions(&mut recording), [(true, vec![0, 1000, 2000])]);
    // Noise is no motion, and a record comes once in an interval.
    recording.receive(roster_at(2, &[0.4, 10.0, 20.0]));
    recording.pass(30 * S);
    recording.receive(roster_at(3, &[0.4, 10.2, 20.0]));
    assert_eq!(positions(&mut recording), []);
    recording.pass(29 * S);
    recording.receive(roster_at(4, &[3.0, 10.0, 20.0]));
    assert_eq!(positions(&mut recording), []);
    recording.pass(S);
    recording.receive(roster_at(5, &[3.0, 10.0, 20.0]));
    assert_eq!(positions(&mut recording), [(false, vec![300])]);
    // A robot that has moved once is not recorded again for its noise.
    recording.receive(roster_at(6, &[3.1, 10.0, 20.0]));
    recording.pass(30 * S);
    assert_eq!(positions(&mut recording), []);
    recording.receive(roster_at(7, &[9.0, 19.0, 20.0]));
    recording.pass(30 * S);
    assert_eq!(positions(&mut recording), [(true, vec![900, 1900, 2000])]);
    recording.write();
    let mut east_at = |back: Duration| {
        let moment = recording.bench.now.before(back);
        let Rows::AsOf(Some(past)) = recording.rows(Subject::AsOf(moment)) else { panic!() };
        past.positions.values().map(|[east, _]| *east).collect::<Vec<_>>()
    };
    assert_eq!(east_at(Duration::ZERO), [9.0, 19.0, 20.0]);
    assert_eq!(east_at(S), [3.0, 10.0, 20.0], "from the whole record and the last one");
    assert_eq!(east_at(61 * S), [0.0, 10.0, 20.0]);
    // Every hour all of them are recorded, wherever they are.
    recording.pass(3600 * S);
    assert_eq!(positions(&mut recording), [(true, vec![900, 1900, 2000])]);
    // None where the setting says so.
    let never = HistorianSettings { positions_interval_s: 0.0, ..HistorianSettings::default() };
    let mut recording = Recording::start_with(never, vec![roster_at(1, &[0.0, 10.0])]);
    recording.pass(60 * S);
    recording.receive(roster_at(2, &[90.0, 190.0]));
    assert_eq!(positions(&mut recording), []);
}

#[test]
fn robots_that_join_and_leave_are_recorded_with_the_reason() {
    let mut recording = Recording::start(vec![roster(1, 0..3)]);
    assert_eq!(recording.take(), [Record::Present(vec![robot(0), robot(1), robot(2)])]);
    for number in [0, 1] {
        recording.receive(Message::RobotToken { robot: robot(number), alive: true });
    }
    recording.receive(Message::RobotToken { robot: robot(0), alive: false });
    recording.receive(roster(2, 2..5));
    let left =
        |number, reason| Record::Left { robot: robot(number), last_seen: Tick(NOW.0 - 7), reason };
    let expected = [
        left(0, LeaveReason::Disconnected),
        left(1, LeaveReason::Silent),
        Record::Joined(robot(3)),
        Record::Joined(robot(4)),
    ];
    assert_eq!(recording.take(), expected);
    recording.receive(roster(1, 0..1));
    assert!(recording.take().is_empty(), "an older roster is none");
    recording.write();
    let Rows::Robots(stays) = recording.rows(Subject::Robots(Some(robot(1)))) else { panic!() };
    let stay = &stays[0];
    assert_eq!((stay.joined, stay.left, stay.reason), (None, Some(NOW), Some(LeaveReason::Silent)));
}

#[test]
fn events_are_recorded_as_they_stand_in_json_and_settings_when_they_change() {
    let mut recording = Recording::start(Vec::new());
    recording.receive(event(7));
    let [Record::Event(recorded)] = &recording.take()[..] else { panic!() };
    assert_eq!((recorded.kind.as_str(), recorded.revision.epoch), ("robot_left", 7));
    assert_eq!(recorded.detail, r#"{"robot":"r00001"}"#);
    let settings = |epoch, text: &str| {
        Message::Settings(Box::new(AnnouncedSettings {
            header: header(epoch),
            service: ServiceName::Clusterer,
            settings: text.to_owned(),
            changed: BTreeMap::new(),
        }))
    };
    recording.receive(settings(1, "{\"teams\":3}"));
    recording.receive(settings(2, "{\"teams\":3}"));
    recording.receive(settings(3, "{\"teams\":4}"));
    assert_eq!(recording.take().len(), 2, "the second says the same");
}

#[test]
fn how_far_the_recording_goes_is_published_once_it_is_on_the_disk() {
    let mut recording = Recording::start(Vec::new());
    recording.receive(event(7));
    assert!(recording.states().is_empty());
    recording.write();
    let states = recording.states();
    let [state] = &states[..] else { panic!("{states:?}") };
    assert_eq!(state.coverage.recorded_through, Some(NOW));
    assert_eq!(state.coverage.events[0].revision.epoch, 7);
    assert_eq!((state.lost, &state.degraded), (0, &None));
    let status = recording.bench.host.status(NOW);
    assert_eq!(status.counters["recorded_through"], NOW.0);
}

#[test]
fn a_full_disk_is_told_once_and_after_a_loss_everything_is_recorded_as_a_whole() {
    let mut recording = Recording::start(vec![division(1, &[&[1, 2], &[3]]), roster(1, 1..4)]);
    recording.write();
    recording.take();
    recording.events();
    recording.store.fails = Some(WriteError::Full("the disk is full".to_owned()));
    for epoch in 0..3 {
        recording.receive(event(epoch));
        recording.write();
    }
    let told = recording.events();
    let degraded = EventKind::HistoryDegraded { reason: "the disk is full".to_owned() };
    assert_eq!(told, [degraded]);
    assert_eq!(recording.bench.host.status(NOW).counters["history_degraded"], 1);
    // So much waits that the oldest minutes go.
    for number in 0..70_000 {
        recording.receive(event(number));
    }
    recording.take();
    recording.write();
    let whole = recording.take();
    assert_eq!(snapshots(&whole), [Some(SnapshotCause::Gap)]);
    assert!(
        whole.iter().any(|record| matches!(record, Record::Present(robots) if robots.len() == 3))
    );
    recording.store.fails = None;
    recording.write();
    let told = recording.events();
    let recovered =
        |kind: &EventKind| matches!(kind, EventKind::HistoryRecovered { lost } if *lost > 60_000);
    assert!(told.len() == 1 && recovered(&told[0]), "{told:?}");
    assert!(!recording.bench.host.status(NOW).counters.contains_key("history_degraded"));
    while !recording.queue.is_empty() {
        recording.write();
    }
    let Rows::AsOf(Some(last)) = recording.rows(Subject::AsOf(NOW)) else { panic!() };
    assert_eq!(last.teams.len(), 2);
}

#[test]
fn after_a_loss_or_damage_scores_and_settings_are_recorded_again() {
    let mut recording = Recording::start(vec![audit(1, 0.6, Quality::Good)]);
    let settings = "{\"teams\":3}".to_owned();
    recording.receive(Message::Settings(Box::new(AnnouncedSettings {
        header: header(4),
        service: ServiceName::Clusterer,
        settings: settings.clone(),
        changed: BTreeMap::new(),
    })));
    recording.take();
    let (service, revision) = (ServiceName::Clusterer, header(4).revision);
    let again = Record::Settings { service, revision, settings };
    let lost = RecordingReport { lost: 1, ..RecordingReport::default() };
    let damaged =
        RecordingReport { damaged: Some("put aside".to_owned()), ..RecordingReport::default() };
    for report in [lost, damaged] {
        recording.bench.input(Input::Recorded(Box::new(report)));
        recording.carry_out();
        let records = recording.take();
        assert!(records.contains(&again), "{records:?}");
        let is_audit =
            |record: &Record| matches!(record, Record::Audit(of) if of.mean == Some(0.6));
        assert!(records.iter().any(is_audit), "{records:?}");
    }
    recording.bench.input(Input::Recorded(Box::default()));
    recording.carry_out();
    assert!(recording.take().is_empty(), "nothing was lost");
}

#[test]
fn a_damaged_file_is_told_once_there_is_somebody_to_tell() {
    let mut recording = Recording::start(Vec::new());
    recording.events();
    let report =
        RecordingReport { damaged: Some("put aside".to_owned()), ..RecordingReport::default() };
    recording.bench.input(Input::Recorded(Box::new(report)));
    let damaged = EventKind::HistoryDamaged { reason: "put aside".to_owned() };
    assert_eq!(recording.events(), [damaged]);
}

#[test]
fn gets_are_answered_by_the_instance_that_they_name_or_by_all() {
    let mut recording = Recording::start(vec![division(1, &[&[1, 2], &[3]])]);
    recording.write();
    let mut ask = |key: &str, parameters: &str| {
        recording.bench.input(Input::Get(IncomingGet {
            get: GetId(1),
            selector: format!("muster/v1/alpha/{key}"),
            narrowed: None,
            parameters: parameters.to_owned(),
            payload: None,
        }));
        recording.carry_out();
        let reply = recording.bench.replies.pop().unwrap();
        reply.answer.map(|packets| {
            let one = |packet: muster_wire::Packet| {
                let json: serde_json::Value =
                    serde_json::from_slice(&packet.payload.unwrap()).unwrap();
                (packet.key, json)
            };
            packets.into_iter().map(one).collect::<Vec<_>>()
        })
    };
    let at = format!("as_of={}", NOW.as_seconds() + 1.0);
    for key in ["history/*", "history/h-1"] {
        let answers = ask(key, &at).unwrap();
        let [(from, answer)] = &answers[..] else { panic!("{answers:?}") };
        assert_eq!(from, "muster/v1/alpha/history/h-1");
        assert_eq!(answer["rows"]["as_of"]["teams"][0]["id"], "t1");
        assert_eq!(answer["recorded_through"], NOW.0);
    }
    assert_eq!(ask("history/other", &at), Ok(Vec::new()));
    let states = ask("history/*/state", "").unwrap();
    assert_eq!(states[0].1["recorded_through"], NOW.0);
    assert_eq!(ask("history/**", "").unwrap().len(), 2, "the rows and the state");
    let problem = ask("history/*", "as_of=noon").unwrap_err();
    assert!(
        problem.contains("\"field\":\"as_of\"") && problem.contains("seconds since 1970"),
        "{problem}"
    );
}

#[test]
fn ten_thousand_robots_come_and_go_with_flat_memory() {
    let mut recording = Recording::start(Vec::new());
    let (mut held, mut epoch) = (Vec::new(), 0);
    for round in 0..20 {
        let robots = round * 500..(round + 1) * 500;
        for number in robots.clone() {
            recording.receive(Message::RobotToken { robot: robot(number), alive: true });
        }
        let members: Vec<usize> = robots.clone().collect();
        epoch += 1;
        recording.receive(roster(epoch, robots.clone()));
        recording.receive(division(epoch, &[&members[..250], &members[250..]]));
        recording.receive(audit(epoch, 0.5, Quality::Good));
        held.push(recording.bench.host.memory_use());
        for number in robots {
            recording.receive(Message::RobotToken { robot: robot(number), alive: false });
        }
        epoch += 1;
        recording.receive(roster(epoch, 0..0));
        recording.write();
        recording.pass(5 * S);
    }
    assert!(held.iter().all(|now| *now == held[0]), "{held:?}");
    let Rows::Robots(stays) = recording.rows(Subject::Robots(None)) else { panic!() };
    assert_eq!(stays.len(), 10_000);
    let why = stays.iter().filter(|stay| stay.reason == Some(LeaveReason::Disconnected)).count();
    assert_eq!(why, 10_000);
}
