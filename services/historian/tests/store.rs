//! The file: it answers as the store in memory does, survives what befalls it, and stays within its limits.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![cfg(feature = "store")]

use std::path::Path;

use muster_historian::{FileRecords, Historian};
use muster_model::audit::Quality;
use muster_model::event::{Event, EventKind, Severity};
use muster_model::header::{Header, Revision};
use muster_model::history::{
    AuditRecord, DivisionRecord, Entry, EventRecord, LeaveReason, PastDivision, Place,
    PositionsRecord, Query, Record, Retention, Rows, SnapshotCause, Subject, TeamLine,
};
use muster_model::id::{CommandId, FleetId, InstanceId, OperatorId, RobotId, ServiceName, TeamId};
use muster_model::settings::HistorianSettings;
use muster_model::time::Tick;
use muster_service::Command;
use muster_service::records::{MemoryRecords, Records, WriteError};
use muster_service::testkit::Bench;
use muster_wire::Message;
use proptest::prelude::*;
use proptest::sample::Index;

const START: u64 = 1_795_208_980_000_000;
const MINUTE_US: u64 = 60_000_000;

fn open(folder: &Path) -> FileRecords {
    let fleet = FleetId::new("f").unwrap();
    FileRecords::open(Some(folder), &fleet, &InstanceId::new("i-1").unwrap()).unwrap()
}

fn robot(number: usize) -> RobotId {
    RobotId::new(format!("r{number}")).unwrap()
}

fn team(number: usize) -> TeamId {
    TeamId::new(format!("t{number}")).unwrap()
}

fn event(number: u64, length: usize) -> Record {
    Record::Event(EventRecord {
        source: ServiceName::Ingest,
        revision: Revision { term: 1, epoch: number },
        severity: Severity::Info,
        kind: if number.is_multiple_of(3) { "robot_left" } else { "robot_joined" }.to_owned(),
        detail: format!("{{\"x\":\"{}\"}}", "x".repeat(length)),
    })
}

/// A small fleet: the team of each robot, none if the division does not contain it.
type Teams = [Option<usize>; 6];

fn lines(teams: &Teams) -> Vec<TeamLine> {
    let members = |number| (0..teams.len()).filter(move |at| teams[*at] == Some(number));
    (0..3)
        .map(|number| TeamLine {
            team: team(number),
            leader: members(number).next().map(robot),
            members: members(number).count() as u32,
        })
        .collect()
}

fn division(before: &Teams, after: &Teams, epoch: u64, snapshot: Option<SnapshotCause>) -> Record {
    let changed = |at: &usize| snapshot.is_some() || before[*at] != after[*at];
    let places = (0..after.len()).filter(changed).filter(|at| {
        // A whole division lists who is in it.
        snapshot.is_none() || after[*at].is_some()
    });
    let place = |at: usize| Place {
        robot: robot(at),
        present: after[at].is_some(),
        team: after[at].map(team),
        stale: epoch.is_multiple_of(3),
        was: before[at].filter(|_| snapshot.is_none()).map(team),
    };
    let teams = lines(after).iter().filter(|line| line.members > 0).count() as u32;
    Record::Division(DivisionRecord {
        revision: Revision { term: 1, epoch },
        requested: 3,
        teams,
        robots: after.iter().flatten().count() as u32,
        snapshot,
        places: places.map(place).collect(),
        lines: lines(after)
            .into_iter()
            .filter(|line| snapshot.is_none() || line.members > 0)
            .collect(),
    })
}

/// What happens next in a random history.
#[derive(Debug, Clone)]
enum Happening {
    Move(Index, Option<usize>),
    Whole(bool),
    Audit(f64),
    Event(usize),
    Join(Index),
    Leave(Index),
    Present(u8),
    Reopen,
    Forget(u64),
    /// Robots are at other places; whether all are recorded.
    Survey([i64; 6], bool),
}

fn happening() -> impl Strategy<Value = (Happening, i64)> {
    let next = prop_oneof![
        8 => (any::<Index>(), prop::option::of(0_usize..3)).prop_map(|(at, to)| Happening::Move(at, to)),
        2 => any::<bool>().prop_map(Happening::Whole),
        2 => (-1.0..1.0).prop_map(Happening::Audit),
        3 => (0_usize..40).prop_map(Happening::Event),
        2 => any::<Index>().prop_map(Happening::Join),
        2 => any::<Index>().prop_map(Happening::Leave),
        1 => any::<u8>().prop_map(Happening::Present),
        1 => Just(Happening::Reopen),
        1 => (0_u64..90).prop_map(Happening::Forget),
        3 => (prop::array::uniform6(-3_i64..3), any::<bool>()).prop_map(|(at, whole)| Happening::Survey(at, whole)),
    ];
    // Now and then the clock goes back, by up to an hour.
    let step = prop_oneof![9 => 0_i64..400_000_000, 1 => -3_600_000_000_i64..0];
    (next, step)
}

/// All places at a moment, by going through the list.
fn naive(history: &[(Tick, Teams)], moment: Tick) -> Option<Teams> {
    history.iter().rev().find(|(at, _)| *at <= moment).map(|(_, teams)| *teams)
}

fn teams_of(division: &PastDivision) -> Teams {
    let mut teams = Teams::default();
    for past in &division.teams {
        for member in &past.members {
            let at = (0..teams.len()).find(|at| robot(*at) == *member).unwrap();
            teams[at] = (0..3).find(|number| team(*number) == past.id);
        }
    }
    teams
}

fn ask(store: &mut dyn Records, query: &Query) -> Rows {
    store.answer(query).unwrap().rows
}

/// All rows of a question, a few at a time.
fn all_pages(store: &mut dyn Records, subject: &Subject, limit: u32) -> Vec<Rows> {
    let (mut pages, mut before) = (Vec::new(), None);
    loop {
        let page = store.answer(&Query { before, limit, ..Query::of(subject.clone()) }).unwrap();
        pages.push(page.rows);
        match page.before {
            Some(next) => before = Some(next),
            None => return pages,
        }
    }
}

proptest! {
    // Each record waits for the disk.
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Over random histories, the division as of any moment is the last that was recorded until then, in the file as
    /// in memory, and both answer every question the same.
    #[test]
    fn the_file_and_the_memory_answer_the_same(
        happenings in prop::collection::vec(happening(), 1..80),
        moments in prop::collection::vec(any::<Index>(), 12),
        limit in 1_u32..6,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut file = open(folder.path());
        let mut memory = MemoryRecords::default();
        let (mut now, mut teams, mut epoch) = (START, Teams::default(), 0);
        let mut history: Vec<(Tick, Teams)> = Vec::new();
        let mut forgot = false;
        let mut surveys: Vec<(Tick, [i64; 6])> = Vec::new();
        let mut whole: Option<[i64; 6]> = None;
        let write = |file: &mut FileRecords, memory: &mut MemoryRecords, at, record| {
            let entries = [Entry { at: Tick(at), record }];
            file.write(&entries).unwrap();
            memory.write(&entries).unwrap();
        };
        write(&mut file, &mut memory, now, division(&teams, &teams, 0, Some(SnapshotCause::Start)));
        history.push((Tick(now), teams));
        for (happening, step) in &happenings {
            now = now.saturating_add_signed(*step);
            epoch += 1;
            let record = match happening {
                Happening::Move(at, to) => {
                    let before = teams;
                    teams[at.index(6)] = *to;
                    if before == teams { continue; }
                    history.push((Tick(now), teams));
                    division(&before, &teams, epoch, None)
                }
                Happening::Whole(periodic) => {
                    let cause = if *periodic { SnapshotCause::Periodic } else { SnapshotCause::Gap };
                    history.push((Tick(now), teams));
                    division(&teams, &teams, epoch, Some(cause))
                }
                Happening::Audit(mean) => Record::Audit(AuditRecord {
                    revision: Revision { term: 1, epoch },
                    division: Revision { term: 1, epoch },
                    mean: Some(*mean),
                    physical_mean: None,
                    verdict: Quality::Fair,
                    per_team: vec![(team(0), *mean), (team(1), -*mean)],
                }),
                Happening::Event(length) => event(epoch, *length),
                Happening::Join(at) => Record::Joined(robot(at.index(6))),
                Happening::Leave(at) => Record::Left {
                    robot: robot(at.index(6)),
                    last_seen: Tick(now - 5),
                    reason: LeaveReason::Silent,
                },
                Happening::Present(bits) => {
                    Record::Present((0..6).filter(|at| bits & (1 << at) != 0).map(robot).collect())
                }
                Happening::Survey(places, all) => {
                    surveys.push((Tick(now), *places));
                    let is_whole = *all || whole.is_none();
                    let base = whole.filter(|_| !is_whole);
                    if is_whole { whole = Some(*places); }
                    let is_there = |at: &usize| base.is_none_or(|base| base[*at] != places[*at]);
                    let robots = (0..6).filter(is_there).map(|at| (robot(at), [places[at], -7]));
                    Record::Positions(PositionsRecord { is_whole, robots: robots.collect() })
                }
                Happening::Reopen => {
                    drop(std::mem::replace(&mut file, FileRecords::open(
                        None, &FleetId::new("f").unwrap(), &InstanceId::new("i-1").unwrap(),
                    ).unwrap()));
                    file = open(folder.path());
                    continue;
                }
                Happening::Forget(minutes) => {
                    let before = Tick(now.saturating_sub(minutes * MINUTE_US));
                    let retention = Retention { before, max_bytes: u64::MAX };
                    while file.retain(&retention).unwrap() {}
                    memory.retain(&retention).unwrap();
                    forgot = true;
                    continue;
                }
            };
            write(&mut file, &mut memory, now, record);
        }
        // A store that was opened again knows what it still holds.
        let (of_file, of_memory) = (file.coverage(), memory.coverage());
        prop_assert_eq!(of_file.sequence, of_memory.sequence);
        prop_assert_eq!(of_file.recorded_through, of_memory.recorded_through);
        prop_assert_eq!(of_file.recorded_from, of_memory.recorded_from);
        if !forgot {
            prop_assert_eq!(of_file.division, of_memory.division);
            prop_assert_eq!(of_file.audit, of_memory.audit);
            prop_assert_eq!(of_file.events, of_memory.events);
        }
        for index in moments {
            let (at, _) = history[index.index(history.len())];
            for moment in [at.0 - 1, at.0, at.0 + 1, at.0 + 100_000_000].map(Tick) {
                let query = Query::of(Subject::AsOf(moment));
                let found = ask(&mut file, &query);
                prop_assert_eq!(&found, &ask(&mut memory, &query));
                let Rows::AsOf(found) = found else { panic!("{found:?}") };
                if let Some(found) = found.as_deref().filter(|_| !forgot) {
                    let survey = surveys.iter().rev().find(|(at, _)| *at <= moment);
                    prop_assert_eq!(found.positions_at, survey.map(|(at, _)| *at));
                    let (_, places) = survey.copied().unwrap_or_default();
                    for (name, [east, north]) in &found.positions {
                        let at = (0..6).find(|at| robot(*at) == *name).unwrap();
                        prop_assert_eq!((*east, *north), (places[at] as f64 / 100.0, -0.07));
                    }
                    let there = found.teams.iter().flat_map(|team| &team.members);
                    let there = there.chain(&found.unassigned).filter(|_| survey.is_some());
                    for name in there {
                        prop_assert!(found.positions.contains_key(name));
                    }
                }
                let found = found.as_deref().map(teams_of);
                if !forgot {
                    prop_assert_eq!(found, naive(&history, moment));
                } else if let Some(found) = found {
                    prop_assert!(history.iter().any(|(at, teams)| *at <= moment && *teams == found));
                }
            }
        }
        let subjects = [
            Subject::Divisions,
            Subject::Robot(robot(1)),
            Subject::Team(team(1)),
            Subject::Events(None),
            Subject::Events(Some("robot_left".to_owned())),
            Subject::Robots(None),
            Subject::Robots(Some(robot(2))),
        ];
        for subject in subjects {
            let pages = all_pages(&mut file, &subject, limit);
            prop_assert_eq!(&pages, &all_pages(&mut memory, &subject, limit), "{:?}", subject);
            let bounded = Query {
                since: Some(Tick(now - 600_000_000)),
                until: Some(Tick(now - 60_000_000)),
                ..Query::of(subject)
            };
            prop_assert_eq!(ask(&mut file, &bounded), ask(&mut memory, &bounded));
        }
    }
}

fn events_of(store: &mut dyn Records) -> usize {
    match ask(store, &Query::of(Subject::Events(None))) {
        Rows::Events(events) => events.len(),
        rows => panic!("{rows:?}"),
    }
}

#[test]
fn after_the_clock_went_back_rows_keep_their_order_and_a_moment_has_its_last_division() {
    let folder = tempfile::tempdir().unwrap();
    let hour = 60 * MINUTE_US;
    let first: Teams = [Some(0), Some(0), Some(1), Some(1), None, None];
    let second: Teams = [Some(0), Some(1), Some(1), Some(1), None, None];
    let mut store = open(folder.path());
    let whole = |teams: &Teams, epoch| division(teams, teams, epoch, Some(SnapshotCause::Start));
    store.write(&[Entry { at: Tick(START), record: whole(&first, 1) }]).unwrap();
    store.write(&[Entry { at: Tick(START + 1), record: event(1, 1) }]).unwrap();
    drop(store);
    // The host starts again, and its clock is an hour behind.
    let mut store = open(folder.path());
    store.write(&[Entry { at: Tick(START - hour), record: whole(&second, 2) }]).unwrap();
    store.write(&[Entry { at: Tick(START - hour + 1), record: event(2, 1) }]).unwrap();
    let as_of =
        |store: &mut FileRecords, moment| match ask(store, &Query::of(Subject::AsOf(Tick(moment))))
        {
            Rows::AsOf(found) => found.as_deref().map(teams_of),
            rows => panic!("{rows:?}"),
        };
    assert_eq!(as_of(&mut store, START), Some(second), "it was recorded later");
    assert_eq!(as_of(&mut store, START - hour), Some(second));
    assert_eq!(as_of(&mut store, START - hour - 1), None);
    let Rows::Events(events) = ask(&mut store, &Query::of(Subject::Events(None))) else { panic!() };
    let order: Vec<_> = events.iter().map(|event| (event.sequence, event.revision.epoch)).collect();
    assert_eq!(order, [(4, 2), (2, 1)]);
}

/// What a service says of a command that it refused reaches the file: who gave it, what it was, and why it was refused.
#[test]
fn a_refused_command_is_in_the_file_with_its_reason() {
    let (fleet, instance) = (FleetId::new("f").unwrap(), InstanceId::new("i-1").unwrap());
    let refused = r#"{"field":"teams","problem":"must be 1 to 1024"}"#;
    let commanded = |id: &str, refused: Option<&str>| EventKind::Commanded {
        operator: OperatorId::new("kim").unwrap(),
        command: CommandId::new(id).unwrap(),
        action: r#"{"set":{"teams":0}}"#.to_owned(),
        refused: refused.map(str::to_owned),
    };
    let settings = HistorianSettings::default();
    let (at, folder) = (Tick(START), tempfile::tempdir().unwrap());
    let mut bench = Bench::<Historian>::leading(fleet.clone(), instance, at, settings, Vec::new());
    for (epoch, kind) in (1..).zip([commanded("c1", Some(refused)), commanded("c2", None)]) {
        let revision = Revision { term: 1, epoch };
        let (oldest, newest, stages) = (None, None, Vec::new());
        let header = Header { fleet: fleet.clone(), revision, oldest, newest, stages };
        let (source, severity) = (ServiceName::Clusterer, Severity::Warning);
        bench.receive(Message::Event(Event { header, source, severity, kind }));
    }
    let entries = std::mem::take(&mut bench.others).into_iter();
    let entries: Vec<Entry> = entries
        .filter_map(|command| match command {
            Command::Append(entry) => Some(*entry),
            _ => None,
        })
        .collect();
    open(folder.path()).write(&entries).unwrap();
    // Another process reads it.
    let mut store = open(folder.path());
    let asked = Query::of(Subject::Events(Some("commanded".to_owned())));
    let Rows::Events(events) = ask(&mut store, &asked) else { panic!() };
    let details: Vec<serde_json::Value> =
        events.iter().rev().map(|event| serde_json::from_str(&event.detail).unwrap()).collect();
    assert_eq!(details.len(), 2);
    for (detail, (id, reason)) in details.iter().zip([("c1", Some(refused)), ("c2", None)]) {
        assert_eq!((&detail["operator"], &detail["command"]), (&"kim".into(), &id.into()));
        assert!(detail["action"].to_string().contains("teams"), "{detail}");
        assert_eq!(detail["refused"].is_null(), reason.is_none(), "{detail}");
        assert!(
            reason.is_none() || detail["refused"].to_string().contains("1 to 1024"),
            "{detail}"
        );
    }
}

#[test]
fn two_instances_of_a_host_have_files_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let first = open(folder.path());
    let second = open(folder.path());
    assert!(first.path().unwrap().ends_with("history.sqlite"));
    assert!(second.path().unwrap().ends_with("history-2.sqlite"));
    drop(first);
    assert!(open(folder.path()).path().unwrap().ends_with("history.sqlite"));
}

#[test]
fn a_damaged_file_is_put_aside_and_a_new_one_begins() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    for damage in ["no database at all", ""] {
        let mut store = open(folder.path());
        store.write(&[Entry { at: Tick(START), record: event(1, 10) }]).unwrap();
        drop(store);
        let mut bytes = std::fs::read(&path).unwrap();
        if damage.is_empty() {
            let half = bytes.len() / 2;
            bytes[4096..half].fill(0x55);
        } else {
            bytes = damage.repeat(500).into_bytes();
        }
        std::fs::write(&path, &bytes).unwrap();
        let mut store = open(folder.path());
        let notice = store.take_damage().unwrap();
        assert!(notice.contains("history.sqlite.bad") && store.take_damage().is_none(), "{notice}");
        assert!(folder.path().join("history.sqlite.bad").exists());
        assert_eq!(events_of(&mut store), 0);
        store.write(&[Entry { at: Tick(START), record: event(2, 10) }]).unwrap();
        drop(store);
        std::fs::remove_file(&path).unwrap();
    }
}

/// Damage that `quick_check` does not find, or is not asked for.
#[test]
fn a_file_whose_content_is_none_of_a_history_is_put_aside() {
    for damage in [
        "UPDATE events SET source = 'x'",
        "UPDATE divisions SET term = 'many'",
        "DELETE FROM meta WHERE key = 'fleet'",
        "UPDATE meta SET value = x'00' WHERE key = 'fleet'",
        "DROP TABLE events",
        "DROP TABLE meta",
        "PRAGMA user_version = 0",
        "",
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.sqlite");
        let mut store = open(folder.path());
        let start = division(&[None; 6], &[None; 6], 1, Some(SnapshotCause::Start));
        let entries = [start, event(1, 10)].map(|record| Entry { at: Tick(START), record });
        store.write(&entries).unwrap();
        drop(store);
        if damage.is_empty() {
            // A file that is too large to be read as a whole at the start.
            let mut bytes = std::fs::read(&path).unwrap();
            bytes[4096..].fill(0x55);
            std::fs::write(&path, &bytes).unwrap();
            let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
            file.set_len(65 * 1024 * 1024).unwrap();
        } else {
            rusqlite::Connection::open(&path).unwrap().execute_batch(damage).unwrap();
        }
        let mut store = open(folder.path());
        let notice = store.take_damage().unwrap();
        assert!(notice.contains("history.sqlite.bad"), "{damage}: {notice}");
        assert!(folder.path().join("history.sqlite.bad").exists());
        store.write(&[Entry { at: Tick(START), record: event(2, 10) }]).unwrap();
        assert_eq!(events_of(&mut store), 1, "{damage}");
    }
}

/// A new file cannot be made at first, since its damaged one cannot be renamed, and then since it cannot be opened.
#[test]
fn a_new_file_in_place_of_a_damaged_one_is_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path());
    let one = |number| [Entry { at: Tick(START + number), record: event(number, 10) }];
    store.write(&one(1)).unwrap();
    let path = store.path().unwrap().to_owned();
    let present = Entry { at: Tick(START), record: Record::Present(Vec::new()) };
    let damage = "INSERT INTO stays (robot, recorded_us) VALUES (x'ff', 0)";
    rusqlite::Connection::open(&path).unwrap().execute_batch(damage).unwrap();
    let in_the_way = ["bad", "journal"].map(|name| match name {
        "bad" => folder.path().join("history.sqlite.bad"),
        _ => folder.path().join("history.sqlite-journal"),
    });
    in_the_way.iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
    let failed = |written: Result<(), WriteError>, why: &str| match written {
        Err(WriteError::Failed(problem)) => assert!(problem.contains(why), "{problem}"),
        other => panic!("{other:?}"),
    };
    failed(store.write(&[present]), "cannot be renamed");
    failed(store.write(&one(2)), "cannot be renamed");
    assert_eq!(store.coverage().recorded_through, None, "it is in no file");
    let asked = store.answer(&Query::of(Subject::Divisions));
    assert!(asked.unwrap_err().contains("is damaged"));
    std::fs::remove_dir(&in_the_way[0]).unwrap();
    failed(store.write(&one(2)), "cannot make");
    failed(store.write(&one(2)), "cannot make");
    std::fs::remove_dir(&in_the_way[1]).unwrap();
    let begun = store.write(&one(2)).unwrap_err();
    assert!(matches!(&begun, WriteError::Damaged(notice) if notice.contains(".bad")), "{begun:?}");
    store.write(&one(2)).unwrap();
    assert_eq!((events_of(&mut store), store.coverage().sequence), (1, 2));
    assert_eq!(events_of(&mut open(folder.path())), 0, "another instance has a file of its own");
}

#[test]
fn damage_that_shows_while_it_is_written_leads_to_a_new_file_with_higher_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path());
    let many: Vec<_> =
        (0..3000).map(|n| Entry { at: Tick(START + n), record: event(n, 200) }).collect();
    store.write(&many).unwrap();
    // Another program empties the file behind our back: its pages are none of a database.
    let path = store.path().unwrap().to_owned();
    let other = rusqlite::Connection::open(&path).unwrap();
    other.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(())).unwrap();
    drop(other);
    let length = std::fs::metadata(&path).unwrap().len() as usize;
    std::fs::write(&path, vec![0x5a; length]).unwrap();
    let mut damaged = None;
    for number in 0..5000 {
        match store.write(&[Entry { at: Tick(START + number), record: event(number, 200) }]) {
            Ok(()) => {}
            Err(WriteError::Damaged(notice)) => {
                damaged = Some(notice);
                break;
            }
            Err(other) => panic!("{other}"),
        }
    }
    assert!(damaged.unwrap().contains("history.sqlite.bad"));
    store.write(&[Entry { at: Tick(START), record: event(1, 1) }]).unwrap();
    assert!(store.coverage().sequence > 3000 && events_of(&mut store) == 1);
}

#[test]
fn a_file_of_another_fleet_version_or_program_is_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    drop(open(folder.path()));
    let instance = InstanceId::new("i-1").unwrap();
    let refused = |fleet: &str| {
        let fleet = FleetId::new(fleet).unwrap();
        FileRecords::open(Some(folder.path()), &fleet, &instance).unwrap_err()
    };
    assert!(refused("other").contains("fleet f; move it away"));
    let path = folder.path().join("history.sqlite");
    let pragma = |text: &str| {
        rusqlite::Connection::open(&path).unwrap().execute_batch(text).unwrap();
    };
    pragma("PRAGMA user_version = 99");
    assert!(refused("f").contains("version 99"));
    pragma("PRAGMA user_version = 1; PRAGMA application_id = 7");
    assert!(refused("f").contains("no history"));
    assert!(!folder.path().join("history.sqlite.bad").exists());
}

#[test]
fn nothing_is_written_to_a_file_of_another_program_without_a_version() {
    for made in [
        "CREATE TABLE things (thing)",
        "CREATE TABLE things (thing); PRAGMA application_id = 7",
        "PRAGMA user_version = 3",
        "PRAGMA application_id = 7",
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.sqlite");
        rusqlite::Connection::open(&path).unwrap().execute_batch(made).unwrap();
        let before = std::fs::read(&path).unwrap();
        let (fleet, instance) = (FleetId::new("f").unwrap(), InstanceId::new("i-1").unwrap());
        let refused = FileRecords::open(Some(folder.path()), &fleet, &instance).unwrap_err();
        assert!(refused.contains("no history of a fleet; move it away"), "{made}: {refused}");
        assert!(std::fs::read(&path).unwrap() == before, "{made}");
    }
}

#[test]
fn a_file_that_is_older_than_positions_gets_their_tables() {
    let folder = tempfile::tempdir().unwrap();
    let mut teams = Teams::default();
    teams[0] = Some(0);
    let start = division(&teams, &teams, 1, Some(SnapshotCause::Start));
    open(folder.path()).write(&[Entry { at: Tick(START), record: start }]).unwrap();
    let path = folder.path().join("history.sqlite");
    let drop_tables = "DROP TABLE positions; DROP TABLE surveys";
    rusqlite::Connection::open(&path).unwrap().execute_batch(drop_tables).unwrap();
    let mut store = open(folder.path());
    let at = Tick(START + 1);
    let positions = PositionsRecord { is_whole: true, robots: vec![(robot(0), [150, -20])] };
    store.write(&[Entry { at, record: Record::Positions(positions) }]).unwrap();
    let Rows::AsOf(Some(found)) = ask(&mut store, &Query::of(Subject::AsOf(at))) else { panic!() };
    assert_eq!(found.positions_at, Some(at));
    assert_eq!(found.positions.into_iter().collect::<Vec<_>>(), [(robot(0), [1.5, -0.2])]);
}

#[test]
fn positions_go_with_their_minutes_but_for_those_that_others_rest_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path());
    let mut teams = Teams::default();
    teams[0] = Some(0);
    teams[1] = Some(0);
    let start = division(&teams, &teams, 1, Some(SnapshotCause::Start));
    let survey = |minute: u64, robots: &[usize]| {
        let place = |at: &usize| (robot(*at), [minute as i64, *at as i64]);
        let robots = robots.iter().map(place).collect();
        let positions = PositionsRecord { is_whole: minute == 0, robots };
        Entry { at: Tick(START + minute * MINUTE_US), record: Record::Positions(positions) }
    };
    let mut entries = vec![Entry { at: Tick(START), record: start }, survey(0, &[0, 1])];
    entries.extend((1..=600).map(|minute| survey(minute, &[0])));
    store.write(&entries).unwrap();
    let before = Tick(START + 500 * MINUTE_US);
    while store.retain(&Retention { before, max_bytes: u64::MAX }).unwrap() {}
    let path = folder.path().join("history.sqlite");
    let count = |table: &str| -> i64 {
        let count = format!("SELECT count(*) FROM {table}");
        rusqlite::Connection::open(&path).unwrap().query_row(&count, [], |row| row.get(0)).unwrap()
    };
    assert!((100..=103).contains(&count("surveys")), "{}", count("surveys"));
    assert!((101..=104).contains(&count("positions")), "{}", count("positions"));
    for minute in [501, 600] {
        let query = Query::of(Subject::AsOf(Tick(START + minute * MINUTE_US)));
        let Rows::AsOf(Some(found)) = ask(&mut store, &query) else { panic!() };
        let east: Vec<f64> = found.positions.values().map(|[east, _]| *east).collect();
        assert_eq!(east, [minute as f64 / 100.0, 0.0]);
    }
}

#[test]
fn the_scores_in_force_stay_when_their_minute_goes() {
    let folder = tempfile::tempdir().unwrap();
    let (mut file, mut memory) = (open(folder.path()), MemoryRecords::default());
    let teams: Teams = [Some(0), Some(0), Some(1), None, None, None];
    let at = |minute: u64, record| Entry { at: Tick(START + minute * MINUTE_US), record };
    let scores = |mean| {
        Record::Audit(AuditRecord {
            revision: Revision { term: 1, epoch: 1 },
            division: Revision { term: 1, epoch: 1 },
            mean: Some(mean),
            physical_mean: None,
            verdict: Quality::Fair,
            per_team: vec![(team(0), mean)],
        })
    };
    let whole = || division(&teams, &teams, 1, Some(SnapshotCause::Periodic));
    let entries =
        [at(0, whole()), at(0, scores(0.1)), at(1, scores(0.2)), at(9, whole()), at(10, whole())];
    let retention = Retention { before: Tick(START + 8 * MINUTE_US), max_bytes: u64::MAX };
    let stores: [&mut dyn Records; 2] = [&mut file, &mut memory];
    for store in stores {
        store.write(&entries).unwrap();
        while store.retain(&retention).unwrap() {}
        assert_eq!(store.coverage().recorded_from, Some(Tick(START + 9 * MINUTE_US)));
        let asked = Query::of(Subject::AsOf(Tick(START + 10 * MINUTE_US)));
        let Rows::AsOf(Some(found)) = ask(store, &asked) else { panic!() };
        let audit = found.audit.unwrap();
        assert_eq!((audit.mean, audit.per_team.len()), (Some(0.2), 1));
    }
    let path = file.path().unwrap();
    let count = "SELECT (SELECT count(*) FROM audits), (SELECT count(*) FROM audit_teams)";
    let left: (i64, i64) = rusqlite::Connection::open(path)
        .unwrap()
        .query_row(count, [], |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap();
    assert_eq!(left, (1, 1));
}

/// A clock that was a year ahead for some minutes.
#[test]
fn minutes_from_the_future_hold_back_no_others_and_take_no_stays_with_them() {
    let folder = tempfile::tempdir().unwrap();
    let (mut file, mut memory) = (open(folder.path()), MemoryRecords::default());
    let (ahead, at) = (365 * 24 * 60, |minute: u64| Tick(START + minute * MINUTE_US));
    let joined = |number, minute| Entry { at: at(minute), record: Record::Joined(robot(number)) };
    let left = |number, minute| {
        let (robot, last_seen, reason) = (robot(number), at(minute), LeaveReason::Silent);
        Entry { at: at(minute), record: Record::Left { robot, last_seen, reason } }
    };
    let mut entries = vec![joined(0, 0), left(0, 5)];
    entries.extend((0..5).map(|minute| Entry { at: at(ahead + minute), record: event(1, 1) }));
    entries.extend([joined(1, 20), left(1, 25), joined(2, 30), left(2, 35), joined(3, 40)]);
    let stores: [&mut dyn Records; 2] = [&mut file, &mut memory];
    for store in stores {
        store.write(&entries).unwrap();
        let mut retain = |minute, events, from, stays: &[usize]| {
            let retention = Retention { before: at(minute), max_bytes: u64::MAX };
            while store.retain(&retention).unwrap() {}
            assert_eq!(events_of(store), events, "until {minute}");
            assert_eq!(store.coverage().recorded_from, Some(at(from)), "until {minute}");
            let Rows::Robots(rows) = ask(store, &Query::of(Subject::Robots(None))) else {
                panic!()
            };
            let names: Vec<_> = rows.iter().rev().map(|row| row.robot.clone()).collect();
            let wanted: Vec<_> = stays.iter().map(|number| robot(*number)).collect();
            assert_eq!(names, wanted, "until {minute}");
        };
        retain(2, 5, 5, &[0, 1, 2, 3]);
        // What came before is old, and nothing behind it.
        retain(15, 5, ahead, &[1, 2, 3]);
        retain(28, 0, 30, &[2, 3]);
        retain(38, 0, 40, &[3]);
    }
}

/// A reserve that cannot be made stands for a disk that is full.
#[test]
fn with_a_lower_limit_a_full_disk_gets_room_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path());
    for minute in 0..40 {
        let at = |n: u64| Tick(START + minute * MINUTE_US + n);
        let entries: Vec<_> =
            (0..200).map(|n| Entry { at: at(n), record: event(n, 1000) }).collect();
        store.write(&entries).unwrap();
    }
    drop(store);
    let reserve = folder.path().join("history.reserve");
    std::fs::remove_file(&reserve).unwrap();
    std::fs::create_dir(&reserve).unwrap();
    let mut store = open(folder.path());
    assert!(store.shortage().is_some());
    let size = || std::fs::metadata(folder.path().join("history.sqlite")).unwrap().len();
    let (limit, before) = (2 * 1024 * 1024, size());
    assert!(before > 3 * limit, "{before}");
    let retention = Retention { before: Tick(0), max_bytes: limit };
    while store.retain(&retention).unwrap() {}
    assert!(size() <= limit && store.coverage().bytes == size(), "{}", size());
    let journal = folder.path().join("history.sqlite-wal");
    assert!(std::fs::metadata(journal).unwrap().len() <= 1024 * 1024, "it fits into the reserve");
    assert!(events_of(&mut store) > 200);
    store.write(&[Entry { at: Tick(START + 40 * MINUTE_US), record: event(1, 1) }]).unwrap();
}

#[test]
fn above_its_size_the_oldest_minutes_go_and_the_disk_gets_their_room_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path());
    let limit = 2 * 1024 * 1024;
    let mut largest = 0;
    for minute in 0..60 {
        let at = |n: u64| Tick(START + minute * MINUTE_US + n);
        let entries: Vec<_> =
            (0..200).map(|n| Entry { at: at(n), record: event(n, 1000) }).collect();
        store.write(&entries).unwrap();
        let retention = Retention { before: Tick(0), max_bytes: limit };
        while store.retain(&retention).unwrap() {}
        largest = largest.max(store.coverage().bytes);
    }
    assert!(largest < 2 * limit, "{largest}");
    let from = store.coverage().recorded_from.unwrap();
    assert!(from > Tick(START) && from < Tick(START + 60 * MINUTE_US));
    assert!(events_of(&mut store) > 200);
    // By age, nothing but the last minute stays.
    let before = Tick(START + 59 * MINUTE_US);
    while store.retain(&Retention { before, max_bytes: limit }).unwrap() {}
    assert_eq!(events_of(&mut store), 200);
}

#[test]
fn in_memory_there_is_no_file() {
    let fleet = FleetId::new("f").unwrap();
    let mut store = FileRecords::open(None, &fleet, &InstanceId::new("i-1").unwrap()).unwrap();
    store.write(&[Entry { at: Tick(START), record: event(1, 1) }]).unwrap();
    assert_eq!((events_of(&mut store), store.shortage()), (1, None));
    assert_eq!(store.path(), None);
}
