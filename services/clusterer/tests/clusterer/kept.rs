//! What stands after a restart of everything, when nobody but the disk remembers the division.

use muster_model::id::InstanceId;
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_service::{Command, testkit};
use muster_wire::kept::KeptTeams;

use super::*;

const ALL: [(&str, [f64; 2]); 3] = [("a b c", WEST), ("m n o", EAST), ("x y z", NORTH)];

fn settings() -> ClustererSettings {
    ClustererSettings { dwell_s: 0.5, ..teams(3) }
}

/// The next process with what was on disk. Nobody answers it.
fn restarted(settings: ClustererSettings, kept: &[u8]) -> Bench {
    let mut bench = Bench::new(settings);
    bench.input(Input::Restored(kept.to_vec()));
    bench.start(vec![]);
    bench
}

/// The next process with what another one had on its disk, and the division of that; no robot is there yet.
fn restarted_without_robots() -> (Bench, Checked<Teams>) {
    let (bench, last) = divided(settings(), &embedding(1, &ALL));
    let mut next = restarted(settings(), &bench.kept.clone().unwrap());
    next.receive_embedding(&later(2, &[]));
    (next, last)
}

/// An embedding of the term after that in which the kept division was made.
fn later(epoch: u64, groups: &[(&str, [f64; 2])]) -> Checked<Embedding> {
    again(&embedding(epoch, groups), 2, epoch)
}

fn kept(bench: &Bench) -> KeptTeams {
    KeptTeams::decode(bench.kept.as_ref().expect("something is kept")).unwrap()
}

#[test]
fn ids_members_and_leaders_stand_though_robots_come_one_by_one() {
    // Their ids are not those that a first division gives.
    let (mut bench, _) = divided(settings(), &embedding(1, &ALL));
    bench.get("service/clusterer/settings", Some("{\"teams\":1}")).unwrap();
    bench.wait(61.0);
    bench.get("service/clusterer/settings", Some("{\"teams\":3}")).unwrap();
    bench.wait(1.0);
    let last = bench.take().teams.pop().unwrap().0;
    assert_ne!(short(&last), "t1: a b c | t2: m n o | t3: x y z");
    let mut next = restarted(settings(), &bench.kept.clone().unwrap());
    for (epoch, present) in (3..).zip([
        vec![("c", WEST), ("x", NORTH)],
        vec![("c", WEST), ("n", EAST), ("x y", NORTH)],
        vec![("a c", WEST), ("n", EAST), ("x y z", NORTH)],
    ]) {
        next.receive_embedding(&later(epoch, &present));
        next.wait(0.2);
        let sent = next.take();
        assert!(sent.teams.is_empty() && sent.robots.is_empty(), "they are awaited: {sent:?}");
    }
    next.receive_embedding(&later(9, &ALL));
    next.wait(0.8);
    assert!(next.take().teams.is_empty(), "what relates them may not be whole yet");
    next.wait(0.2);
    let sent = next.take();
    assert!(sent.changes().is_empty(), "{sent:?}");
    assert_eq!(
        (short(&sent.division()), leaders(&sent.division())),
        (short(&last), leaders(&last))
    );
}

#[test]
fn who_is_not_back_in_time_keeps_its_seat() {
    let (mut next, last) = restarted_without_robots();
    next.wait(15.0);
    assert!(next.take().teams.is_empty(), "no robot was there yet");
    let there = later(3, &[("a b c", WEST), ("x", NORTH)]);
    next.receive_embedding(&there);
    next.wait(1.9);
    assert!(next.take().teams.is_empty());
    next.wait(0.2);
    assert_eq!(short(&next.take().division()), "t1: a b c | t3: x");
    next.receive_embedding(&later(4, &ALL));
    assert!(next.take().division().same_division(&last));
}

/// Nothing more will come of it, however long it is waited for.
#[test]
fn a_robot_that_few_relations_stood_behind_before_is_not_awaited_for_more() {
    let marked = |embedding: Checked<Embedding>, name: &str| {
        let mut embedding = Embedding::clone(&embedding);
        embedding.provisional =
            embedding.robots.iter().map(|robot| robot.as_str() == name).collect();
        Checked::new_unchecked(embedding)
    };
    let (bench, last) = divided(settings(), &marked(embedding(1, &ALL), "a"));
    assert_eq!(last.provisional, [robot("a")]);
    for (name, is_awaited) in [("a", false), ("b", true)] {
        let mut next = restarted(settings(), &bench.kept.clone().unwrap());
        next.receive_embedding(&marked(later(2, &ALL), name));
        next.wait(1.6);
        assert_eq!(next.take().teams.is_empty(), is_awaited, "{name}");
    }
}

#[test]
fn who_comes_and_leaves_again_is_awaited_from_the_next_one_on() {
    let (bench, _) = divided(settings(), &embedding(1, &ALL));
    let mut next = restarted(settings(), &bench.kept.clone().unwrap());
    next.receive_embedding(&later(2, &[("a", WEST)]));
    next.wait(1.0);
    next.receive_embedding(&later(3, &[]));
    // It sleeps, and is not woken again and again for what has passed.
    next.wait(15.0);
    next.receive_embedding(&later(4, &[("x y z", NORTH)]));
    next.wait(1.9);
    assert!(next.take().teams.is_empty());
    next.wait(0.2);
    assert_eq!(short(&next.take().division()), "t3: x y z");
}

#[test]
fn nobody_is_awaited_where_the_services_before_have_lived_on() {
    let (bench, last) = divided(settings(), &embedding(1, &ALL));
    let on_disk = bench.kept.clone().unwrap();
    let mut with_embedder = restarted(settings(), &on_disk);
    with_embedder.receive_embedding(&embedding(2, &ALL));
    assert!(with_embedder.division().same_division(&last));
    // An `ingest` that has made frames for some seconds knows all its robots; a new one does not.
    for (epoch, is_awaited) in [(2, true), (1000, false)] {
        let mut with_ingest = restarted(settings(), &on_disk);
        with_ingest.receive_roster(roster(epoch, "a b c m n o x y z"));
        with_ingest.receive_embedding(&later(2, &ALL));
        let sent = with_ingest.take();
        assert_eq!(sent.teams.is_empty(), is_awaited, "{epoch} frames");
    }
}

#[test]
fn the_seat_of_a_team_that_was_absent_is_kept_for_a_minute() {
    let (mut bench, _) = divided(settings(), &embedding(1, &ALL));
    bench.receive_embedding(&embedding(2, &ALL[..2]));
    bench.wait(1.0);
    let last = bench.take().teams.pop().unwrap().0;
    assert_eq!(short(&last), "t1: a b c | t2: m n o");
    let mut next = restarted(settings(), &bench.kept.clone().unwrap());
    next.receive_embedding(&later(3, &ALL[..2]));
    next.wait(1.6);
    assert_eq!(short(&next.take().division()), short(&last), "no robot fills the seat");
    next.wait(61.0);
    next.take();
    let moved = [("a b c", WEST), ("m n", EAST), ("o", [0.9, 0.1])];
    next.receive_embedding(&later(4, &moved));
    next.wait(1.0);
    let teams = next.take().teams.pop().unwrap().0;
    assert_eq!(teams.teams.len(), 3, "{}", short(&teams));
}

/// Robots that are switched on long after the services are no fleet that was cut off.
#[test]
fn a_fleet_of_which_no_robot_is_there_is_awaited_for_a_while_only() {
    let (mut next, last) = restarted_without_robots();
    next.wait(19.5);
    assert!(next.take().teams.is_empty(), "they may come yet");
    next.wait(1.0);
    assert!(next.take().division().teams.is_empty());
    // Who comes within a minute has its team.
    next.wait(50.0);
    next.receive_embedding(&later(3, &ALL));
    next.wait(1.0);
    assert_eq!(short(&next.take().teams.pop().unwrap().0), short(&last));
}

/// Of two instances the one with the older file takes over: what the other one answers is from a disk as well.
#[test]
fn what_another_instance_has_from_its_disk_keeps_its_seats_as_well() {
    let (mut bench, _) = divided(settings(), &embedding(1, &ALL));
    let older = bench.kept.clone().unwrap();
    bench.receive_embedding(&embedding(2, &ALL[..2]));
    bench.wait(1.0);
    let last = bench.take().teams.pop().unwrap().0;
    let mut next = Bench::new(settings());
    next.input(Input::Restored(older));
    next.start(vec![mirrored(&last)]);
    next.receive_embedding(&later(3, &ALL[..2]));
    assert!(next.take().teams.is_empty(), "the robots are awaited");
    next.wait(1.6);
    assert_eq!(short(&next.take().division()), short(&last), "no robot fills the seat");
}

#[test]
fn no_number_is_given_twice_though_the_last_writes_are_lost() {
    let (mut bench, _) = divided(settings(), &embedding(1, &[("a b c", WEST)]));
    let on_disk = bench.kept.clone().unwrap();
    let mut highest = 0;
    for epoch in 2..20_u64 {
        // A minute later, another fleet: its teams are new ones. Nothing of it gets to the disk.
        bench.wait(61.0);
        let names = [format!("a{epoch} b{epoch}"), format!("c{epoch} d{epoch}")];
        bench.receive_embedding(&embedding(epoch, &[(&names[0], WEST), (&names[1], EAST)]));
        let last = bench.take().teams.pop().unwrap().0;
        highest = last.next_team;
    }
    assert!(highest > 30 && highest < kept(&bench).reserved, "{highest}");
    let mut next = restarted(settings(), &on_disk);
    next.receive_embedding(&later(30, &[("n1 n2", WEST), ("n3", EAST), ("a b c", NORTH)]));
    next.wait(1.6);
    let division = next.division();
    assert!(short(&division).starts_with("t1: a b c | "), "{}", short(&division));
    let number = |id: &TeamId| id.as_str()[1..].parse::<u64>().unwrap();
    assert!(division.teams[1..].iter().all(|team| number(&team.id) >= highest), "{division:?}");
}

#[test]
fn a_division_waits_until_its_numbers_are_on_disk_but_not_for_ever() {
    let mut bench = Bench::new(settings());
    bench.hold_stores = true;
    bench.start(vec![]);
    bench.input(Input::Stored { error: None });
    bench.receive_embedding(&embedding(1, &ALL));
    let keeps = |bench: &Bench| {
        bench.others.iter().filter(|command| matches!(command, Command::Keep(_))).count()
    };
    assert_eq!((bench.jobs_run, keeps(&bench)), (0, 1));
    bench.input(Input::Kept { error: None });
    assert_eq!(short(&bench.division()), "t1: a b c | t2: m n o | t3: x y z");

    let mut hanging = Bench::new(settings());
    hanging.hold_stores = true;
    hanging.start(vec![]);
    hanging.receive_embedding(&embedding(1, &ALL));
    hanging.wait(1.9);
    assert_eq!(hanging.jobs_run, 0);
    hanging.wait(0.2);
    assert_eq!(short(&hanging.take().teams[0].0), "t1: a b c | t2: m n o | t3: x y z");
}

#[test]
fn it_is_written_when_teams_change_and_not_with_every_frame() {
    let first = embedding(1, &ALL);
    let (mut bench, _) = divided(settings(), &first);
    bench.wait(1.0);
    let written = bench.counter("divisions_kept");
    bench.receive_embedding(&later(1, &ALL));
    bench.wait(1.5);
    assert_eq!(bench.counter("divisions_kept"), written + 1, "the embedder has begun anew");
    let written = written + 1;
    for epoch in 2..50 {
        bench.wait(0.1);
        let moved = [("a b c", WEST), ("m n o", [1.0, 0.01 * epoch as f64]), ("x y z", NORTH)];
        bench.receive_embedding(&later(epoch, &moved));
    }
    assert_eq!(bench.counter("divisions_kept"), written);
    bench.receive_embedding(&later(50, &[("a b c", WEST), ("m n o", EAST), ("x y", NORTH)]));
    let last = bench.take().teams.pop().unwrap().0;
    assert_eq!(bench.counter("divisions_kept"), written + 1);
    assert!(kept(&bench).teams.unwrap().same_division(&last));
}

#[test]
fn a_standby_keeps_what_it_receives_and_takes_over_from_it() {
    let (_, received) = divided(settings(), &embedding(1, &ALL));
    let mut numbered = Teams::clone(&received);
    numbered.next_team = 70;
    let received = Checked::new_unchecked(numbered);
    let mut standby = Bench::new(settings());
    standby.input(Input::Started { linked: true });
    standby.receive(mirrored(&received));
    assert_eq!(kept(&standby).teams, Some(received.clone()));
    assert!(kept(&standby).reserved > 70);
    let mut next = restarted(settings(), &standby.kept.clone().unwrap());
    next.receive_embedding(&later(2, &ALL));
    next.wait(1.6);
    assert!(next.division().same_division(&received));
    // Forged messages must not take the numbers that are left: neither by the next one, nor by those of
    // teams that are away.
    let last = TeamId::numbered(u64::MAX);
    let forgeries: [fn(&mut Teams, TeamId); 3] = [
        |teams, _| teams.next_team = u64::MAX,
        |teams, last| teams.remembered.last = vec![(robot("r"), last)],
        |teams, last| teams.remembered.ended = vec![(last, vec![robot("r")])],
    ];
    for (epoch, forge) in (1..).zip(forgeries) {
        let mut forged = Teams { header: header(9, epoch), ..Teams::clone(&received) };
        forge(&mut forged, last.clone());
        standby.receive(mirrored(&Checked::new_unchecked(forged)));
        standby.wait(10.0);
        assert!(kept(&standby).reserved < 1000);
        assert_eq!(kept(&standby).teams, Some(received.clone()), "forgery {epoch} is kept");
    }
}

#[test]
fn a_standby_gives_nobody_what_it_has_from_its_disk_alone() {
    let (bench, received) = divided(settings(), &embedding(1, &ALL));
    let mut standby = Bench::new(settings());
    standby.input(Input::Restored(bench.kept.clone().unwrap()));
    standby.now = START.before(testkit::START_RETRY_TIME);
    standby.input(Input::Started { linked: true });
    standby.now = START;
    standby.answer_all(vec![Message::LeaseRenewal(Box::new(LeaseRenewal {
        header: header(2, 0),
        service: ServiceName::Clusterer,
        instance: InstanceId::new("j").unwrap(),
    }))]);
    assert_eq!(standby.host.replica_state(), ReplicaState::Standby);
    assert_eq!(standby.get("teams", None).unwrap(), vec![]);
    standby.receive(mirrored(&received));
    assert_eq!(standby.get("teams", None).unwrap().len(), 1);
}

#[test]
fn a_division_that_a_service_remembers_is_newer_than_the_disk() {
    let (bench, _) = divided(settings(), &embedding(1, &ALL));
    let kept = bench.kept.clone().unwrap();
    let mut newer =
        Teams::clone(&bench_division(&embedding(1, &[("a b", WEST), ("c m n o x y z", EAST)])));
    newer.header = header(4, 1);
    let newer = Checked::new_unchecked(newer);
    let mut next = Bench::new(teams(2));
    next.input(Input::Restored(kept));
    next.start(vec![mirrored(&newer)]);
    match &next.get("teams", None).unwrap()[..] {
        [Message::Teams { teams, .. }] => assert_eq!(*teams, newer),
        other => panic!("{other:?}"),
    }
}

fn bench_division(embedding: &Checked<Embedding>) -> Checked<Teams> {
    divided(teams(2), embedding).1
}

#[test]
fn a_damaged_file_is_told_and_not_used() {
    let (bench, _) = divided(settings(), &embedding(1, &ALL));
    let mut damaged = bench.kept.clone().unwrap();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 4;
    let mut next = restarted(settings(), &damaged);
    let told = next.others.iter().find_map(|command| match command {
        Command::KeptIsUnusable(problem) => Some(problem.clone()),
        _ => None,
    });
    assert!(told.unwrap().contains("checksum"));
    next.receive_embedding(&later(1, &ALL));
    assert_eq!(short(&next.division()), "t1: a b c | t2: m n o | t3: x y z");
}

/// Robots are in the roster before they have said what they can do.
#[test]
fn a_confirmed_need_holds_for_an_instance_that_knows_no_skills_yet() {
    let (mut leader, _) = divided(settings(), &embedding(1, &ALL));
    leader.receive_roster(roster(2, "a:medic b c m:medic n o x:medic y z"));
    let needs = r#"{"needs": [{"skill": "medic", "per_team": {"min": 1}}]}"#;
    leader.get("service/clusterer/settings", Some(needs)).unwrap();
    let outcomes = leader.get("command/clusterer/*/*", None).unwrap();
    assert_eq!(outcomes.len(), 1, "{outcomes:?}");
    let mut next = Bench::new(settings());
    next.receive_roster(roster(2, "a b c m n o x y z"));
    next.receive_embedding(&embedding(1, &ALL));
    next.start(outcomes);
    let answer = next.get("service/clusterer/settings", None).unwrap();
    let [Message::Settings(announced)] = &answer[..] else { panic!("{answer:?}") };
    assert!(announced.settings.contains("medic"), "{}", announced.settings);
}
