//! What is divided, and when.

use super::*;

#[test]
fn the_first_division_is_whole() {
    let mut bench = Bench::leading(teams(2));
    bench.take();
    bench.receive_roster(roster(1, "a b c d e f"));
    bench.now = START.after(std::time::Duration::from_secs(2));
    bench.hold_jobs = true;
    bench.receive_embedding(&embedding(7, &[("b d f", WEST), ("a c e", EAST)]));
    bench.wait(0.25);
    bench.run_job();
    let sent = bench.take();
    let division = sent.division();
    assert!(sent.teams[0].1, "the first division is mirrored");
    assert_eq!(short(&division), "t1: a c e | t2: b d f");
    assert_eq!(division.header.revision, Revision { term: 1, epoch: 1 });
    assert_eq!(division.embedding, Revision { term: 1, epoch: 7 });
    assert_eq!((division.requested, division.next_team), (2, 3));
    assert!(division.inertia > 0.0 && division.inertia < 1e-4);
    assert!(division.teams.iter().all(|team| team.centroid.len() == 2));
    let margins = division.teams.iter().flat_map(|team| team.members.iter().map(|m| m.margin));
    assert!(margins.into_iter().all(|margin| margin > 0.99 && margin <= 1.0));
    let stage = division.header.stages.last().unwrap();
    assert_eq!(stage.stage, ServiceName::Clusterer);
    assert_eq!(stage.published.since(stage.received).as_millis(), 250);
    assert_eq!(division.header.oldest, Some(START));
    assert_eq!(changes_in_short(&sent.changes()), ["born t1", "born t2"]);
    assert_eq!(division.changes, sent.changes());
    assert_eq!(sent.informed_robots(), "a b c d e f");
    assert_eq!(Some(sent.robots[0].clone()), division.robot_team(&sent.robots[0].robot));
    assert_eq!(bench.status().state, "2 teams of 6 robots");
}

#[test]
fn an_unchanged_embedding_is_not_divided_again() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, division) = divided(teams(2), &first);
    for epoch in 2..6 {
        bench.wait(0.1);
        bench.receive_embedding(&again(&first, 1, epoch));
    }
    assert_eq!(bench.jobs_run, 1);
    assert!(bench.take().teams.is_empty());
    bench.wait(1.0);
    let sent = bench.take();
    let repeated = sent.division();
    assert!(repeated.same_division(&division));
    assert_eq!(repeated.embedding, Revision { term: 1, epoch: 5 }, "it is as fresh as its data");
    assert_eq!(repeated.teams, division.teams);
    assert!(repeated.changes.is_empty() && sent.events.is_empty());
    // The same in the next term of the embedder, and after the same patch of settings.
    bench.receive_embedding(&again(&first, 2, 1));
    bench.get("service/clusterer/settings", Some("{\"heartbeat_s\":2.0,\"teams\":2}")).unwrap();
    assert_eq!(bench.jobs_run, 1);
    // What does matter starts a job.
    bench.get("service/clusterer/settings", Some("{\"restarts\":11}")).unwrap();
    assert_eq!(bench.jobs_run, 2);
}

#[test]
fn the_same_input_gives_the_same_output() {
    let first = embedding(1, &[("a b c d", WEST), ("e f g", EAST), ("h i", NORTH)]);
    let next = embedding(2, &[("a b c", WEST), ("d e f g", EAST), ("h i", NORTH)]);
    let run = || {
        let mut bench = Bench::leading(teams(4));
        bench.receive_embedding(&first);
        bench.receive_embedding(&next);
        std::mem::take(&mut bench.published)
    };
    assert_eq!(run(), run());
}

#[test]
fn noise_on_the_border_moves_no_robot() {
    let line = |epoch, middle: f64| {
        let at = |name: &str, x: f64| (robot(name), vec![x, 0.0], false);
        from_rows(
            1,
            epoch,
            vec![at("a", 0.0), at("b", 0.1), at("m", middle), at("y", 0.9), at("z", 1.0)],
        )
    };
    let (mut bench, first) = divided(teams(2), &line(1, 0.499));
    for epoch in 2..20 {
        bench.receive_embedding(&line(epoch, if epoch % 2 == 0 { 0.503 } else { 0.497 }));
        assert!(bench.division().same_division(&first), "epoch {epoch}");
    }
    bench.receive_embedding(&line(20, 0.8));
    assert_eq!(short(&bench.division()), "t1: a b | t2: m y z");
}

#[test]
fn unseen_robots_have_no_team_and_may_come_back() {
    let (mut bench, first) = divided(teams(2), &embedding(1, &[("a b c!", WEST), ("d e", EAST)]));
    assert_eq!(short(&first), "t1: a b | t2: d e | - c");
    assert_eq!(first.robot_team(&robot("c")).unwrap().team, None);

    bench.receive_embedding(&embedding(2, &[("a b c", WEST), ("d! e", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a b c | t2: e | - d");
    assert_eq!(changes_in_short(&sent.changes()), ["moved c - t1", "moved d t2 -"]);
    assert_eq!(sent.informed_robots(), "a b c d e");

    bench.receive_embedding(&embedding(3, &[("a b c", WEST), ("d e", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a b c | t2: d e");
    assert_eq!(changes_in_short(&sent.changes()), ["moved d - t2"]);
    assert_eq!(sent.informed_robots(), "d e");
}

#[test]
fn more_teams_than_places_are_reported_once() {
    let few = |sent: &common::Published| {
        let few = |kind: &EventKind| match kind {
            EventKind::FewerTeams { requested, formed, reason } => {
                Some((*requested, *formed, reason.clone()))
            }
            _ => None,
        };
        sent.events.iter().filter_map(few).collect::<Vec<_>>()
    };
    let mut bench = Bench::leading(teams(4));
    bench.receive_embedding(&embedding(1, &[("a", WEST), ("b", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a | t2: b");
    assert_eq!(sent.division().requested, 4);
    assert_eq!(few(&sent), [(4, 2, "only 2 robots can be placed".to_owned())]);
    bench.receive_embedding(&embedding(2, &[("a", WEST), ("b", NORTH)]));
    assert!(few(&bench.take()).is_empty());
    // Six robots at two places are two teams.
    let at = |name: &str, place: [f64; 2]| (robot(name), place.to_vec(), false);
    let rows: Vec<_> = ["a", "b", "c"].map(|n| at(n, WEST)).into_iter().collect();
    let rows = [rows, ["d", "e", "f"].map(|n| at(n, EAST)).into_iter().collect()].concat();
    bench.receive_embedding(&from_rows(1, 3, rows));
    let sent = bench.take();
    assert_eq!(sent.division().teams.len(), 2);
    assert!(few(&sent).is_empty(), "still 2 of 4");
    bench.receive_embedding(&embedding(4, &[("a!", WEST), ("b!", NORTH)]));
    let sent = bench.take();
    assert_eq!(few(&sent), [(4, 0, "nothing relates the robots to each other".to_owned())]);
    assert_eq!(short(&sent.division()), "- a b");
    bench.receive_embedding(&embedding(5, &[]));
    assert!(few(&bench.take()).is_empty(), "still 0 of 4");
    bench.receive_embedding(&embedding(6, &[("a b c d", WEST)]));
    assert_eq!(bench.division().teams.len(), 4);
    bench.receive_embedding(&embedding(7, &[]));
    assert_eq!(few(&bench.take()), [(4, 0, "there are no robots".to_owned())]);
}

#[test]
fn a_failed_job_changes_nothing() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, division) = divided(teams(2), &first);
    bench.hold_jobs = true;
    let bad = embedding(2, &[("a c", WEST), ("b d", EAST)]);
    bench.receive_embedding(&bad);
    bench.panic_job("out of luck");
    let sent = bench.take();
    assert_eq!(
        sent.events,
        [EventKind::JobFailed { reason: "the job panicked: out of luck".to_owned() }]
    );
    assert_eq!(bench.counter("jobs_failed"), 1);
    // The same data would fail again, for now.
    bench.receive_embedding(&again(&bad, 1, 3));
    assert!(bench.job.is_none());
    bench.wait(1.0);
    assert!(bench.job.is_some(), "a panic is tried again");
    bench.panic_job("still");
    bench.published.retain(|message| !matches!(message, Message::RobotTeam(_)));
    let sent = bench.take();
    assert!(sent.events.is_empty(), "not reported again so soon");
    let repeated = sent.division();
    assert!(repeated.same_division(&division));
    assert_eq!(
        repeated.embedding,
        Revision { term: 1, epoch: 1 },
        "of the data that it is made of"
    );
    assert_eq!(bench.get("teams", None).unwrap().len(), 1);
    bench.receive_embedding(&embedding(4, &[("a d", WEST), ("b c", EAST)]));
    bench.run_job();
    assert_eq!(bench.take().teams.len(), 1);
}

#[test]
fn what_cannot_be_divided_fails_without_a_panic() {
    let (mut bench, _) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.receive_embedding(&embedding(2, &[("a b", [1e200, 0.0]), ("c d", EAST)]));
    let sent = bench.take();
    assert!(sent.teams.is_empty());
    assert!(
        matches!(&sent.events[..], [EventKind::JobFailed { reason }] if reason.contains("large"))
    );
    let broken = Embedding { without_embedding: vec![], ..(*embedding(3, &[("a", WEST)])).clone() };
    let broken = Message::Embedding(Checked::new_unchecked(broken));
    let space = muster_wire::KeySpace::new(header(1, 1).fleet);
    bench.receive_packet(broken.to_packet(&space));
    let sent = bench.take();
    assert!(
        matches!(&sent.events[..], [EventKind::Quarantined { key, .. }] if key.ends_with("embedding"))
    );
    assert_eq!((bench.counter("embeddings_received"), bench.counter("messages_refused")), (2, 1));
}

#[test]
fn old_terms_and_epochs_are_dropped() {
    let (mut bench, division) = divided(teams(2), &embedding(5, &[("a b", WEST), ("c d", EAST)]));
    let other = embedding(4, &[("a c", WEST), ("b d", EAST)]);
    bench.receive_embedding(&other);
    bench.receive_embedding(&again(&other, 0, 99));
    bench.receive_embedding(&again(&other, 1, 5));
    assert!(bench.take().teams.is_empty());
    assert_eq!(bench.counter("messages_old"), 2, "the same revision twice is not old");
    let Message::Teams { teams, .. } = &bench.get("teams", None).unwrap()[0] else { panic!() };
    assert_eq!(*teams, division);
    bench.receive_embedding(&again(&other, 2, 1));
    assert_eq!(bench.jobs_run, 2);
}

#[test]
fn the_newest_embedding_follows_a_running_job() {
    let mut bench = Bench::leading(teams(2));
    bench.take();
    bench.hold_jobs = true;
    bench.receive_embedding(&embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.receive_embedding(&embedding(2, &[("a c", WEST), ("b d", EAST)]));
    bench.receive_embedding(&embedding(3, &[("a b", WEST), ("c", EAST)]));
    bench.run_job();
    assert_eq!(bench.division().embedding.epoch, 1);
    bench.run_job();
    assert_eq!(bench.division().embedding.epoch, 3);
    assert!(bench.job.is_none());
    assert_eq!(bench.counter("jobs_started"), 2);
    // What comes with the same data while the job runs makes its output fresh.
    let fourth = embedding(4, &[("a b", EAST), ("c", WEST)]);
    bench.receive_embedding(&fourth);
    bench.receive_embedding(&again(&fourth, 1, 5));
    bench.run_job();
    assert_eq!(bench.division().embedding.epoch, 5);
    assert!(bench.job.is_none());
}
