//! Which team keeps which id.

use super::*;

#[test]
fn ids_stay_when_the_vectors_turn_over() {
    let (mut bench, first) =
        divided(teams(3), &embedding(1, &[("a b", WEST), ("c d", EAST), ("e f", NORTH)]));
    assert_eq!(short(&first), "t1: a b | t2: c d | t3: e f");
    let places = [WEST, EAST, NORTH, [-1.0, 0.0], [5.0, 5.0]];
    for (epoch, shift) in (2..).zip(1..places.len()) {
        let at = |i: usize| places[(i + shift) % places.len()];
        // Another seed would number the clusters otherwise, too.
        bench.get("service/clusterer/settings", Some(&format!("{{\"seed\":{epoch}}}"))).unwrap();
        bench.take();
        bench.receive_embedding(&embedding(
            epoch,
            &[("a b", at(0)), ("c d", at(1)), ("e f", at(2))],
        ));
        let sent = bench.take();
        assert!(sent.teams[0].0.same_division(&first));
        assert!(sent.changes().is_empty() && sent.robots.is_empty());
    }
}

#[test]
fn ids_and_numbers_outlive_the_process() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST)]);
    let (mut bench, _) = divided(teams(2), &first);
    bench.get("service/clusterer/settings", Some("{\"teams\":1}")).unwrap();
    assert_eq!(short(&bench.division()), "t1: a b c d");
    // So late that the team before is forgotten.
    bench.wait(61.0);
    bench.take();
    bench.get("service/clusterer/settings", Some("{\"teams\":2}")).unwrap();
    let last = bench.division();
    assert_eq!(short(&last), "t1: a b | t3: c d");

    // An older division of an older term is on the bus, too.
    let old = Teams {
        header: header(0, 900),
        next_team: 1,
        ..Teams::clone(&divided(teams(2), &embedding(1, &[("a c", WEST), ("b d", EAST)])).1)
    };
    let messages = vec![mirrored(&last), mirrored(&Checked::new_unchecked(old))];
    let mut next = Bench::restored(teams(2), messages);
    // The last good answer is served, but not published as if it were new.
    assert!(next.take().teams.is_empty());
    assert_eq!(next.get("teams", None).unwrap().len(), 1);
    assert_eq!(next.get("robot/a/team", None).unwrap().len(), 1);
    assert_eq!(next.status().state, "waiting for the robots of the last division");
    assert_eq!(next.host.deadline(), Some(START.after(muster_service::RENEWAL_INTERVAL)));

    next.receive_embedding(&again(&first, 1, 2));
    let sent = next.take();
    assert_eq!(short(&sent.division()), "t1: a b | t3: c d");
    assert_eq!(sent.division().header.revision, Revision { term: 2, epoch: 1 });
    assert!(sent.changes().is_empty());
    assert_eq!(sent.informed_robots(), "a b c d", "a new leader informs everyone");
    next.get("service/clusterer/settings", Some("{\"teams\":3}")).unwrap();
    let ids: Vec<String> = next.division().teams.iter().map(|team| team.id.to_string()).collect();
    // Without a disk, some numbers are left out: others may remember less than was published.
    assert_eq!(ids.last().unwrap(), "t54", "{ids:?}");
}

#[test]
fn a_fleet_that_is_gone_leaves_no_team() {
    let (mut bench, _) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.receive_embedding(&embedding(2, &[]));
    let sent = bench.take();
    assert_eq!(changes_in_short(&sent.changes()), ["died t1", "died t2"]);
    assert_eq!((sent.division().teams.len(), sent.division().next_team), (0, 3));
    assert_eq!(bench.status().state, "0 teams of 0 robots");
    bench.receive_embedding(&embedding(3, &[("a b", WEST), ("c d", EAST)]));
    assert_eq!(short(&bench.division()), "t1: a b | t2: c d");
}

#[test]
fn splits_mergers_births_and_deaths_are_reported() {
    let (mut bench, _) = divided(teams(1), &embedding(1, &[("a b c", WEST), ("d e", EAST)]));
    bench.get("service/clusterer/settings", Some("{\"teams\":2}")).unwrap();
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: a b c | t2: d e");
    assert_eq!(
        changes_in_short(&sent.changes()),
        ["split t1 t2", "moved d t1 t2", "moved e t1 t2"]
    );

    bench.get("service/clusterer/settings", Some("{\"teams\":3}")).unwrap();
    bench.take();
    bench.receive_embedding(&embedding(2, &[("a b c", WEST), ("d e", EAST), ("n1 n2 n3", NORTH)]));
    let division = bench.division();
    assert_eq!(division.teams.len(), 3);
    let newest = division.teams.last().unwrap();
    assert_eq!(newest.members.len(), 3, "{}", short(&division));

    bench.get("service/clusterer/settings", Some("{\"teams\":2}")).unwrap();
    bench.take();
    bench.receive_embedding(&embedding(3, &[("a b c d e", WEST), ("n1 n2 n3", NORTH)]));
    let before = bench.division();
    let west = before.robot_team(&robot("a")).unwrap().team.unwrap();
    assert_eq!(before.robot_team(&robot("e")).unwrap().team, Some(west.clone()));
    bench.receive_embedding(&embedding(4, &[("a b", WEST), ("c d e", EAST)]));
    let sent = bench.take();
    let north = &before.teams.iter().find(|team| team.id != west).unwrap().id;
    assert!(changes_in_short(&sent.changes()).contains(&format!("died {north}")));
    assert!(bench.counter("team_changes") > 5);
}

#[test]
fn a_team_that_ended_by_another_number_of_teams_lives_again() {
    let three = [("x y z", WEST), ("a b c", [0.2, 0.0]), ("e f", [9.0, 9.0])];
    let (mut bench, first) = divided(teams(3), &embedding(1, &three));
    let mut set = |many: u32| {
        bench.get("service/clusterer/settings", Some(&format!("{{\"teams\":{many}}}"))).unwrap();
        bench.take().division()
    };
    assert_eq!(set(2).teams.len(), 2);
    let back = set(3);
    assert_eq!((short(&back), back.next_team), (short(&first), 4));
    assert_eq!(changes_in_short(&back.changes)[0], "split t1 t3");
}

#[test]
fn a_platoon_that_comes_back_one_by_one_keeps_its_id() {
    let (mut bench, first) = divided(teams(2), &embedding(1, &[("x y", WEST), ("a b c", EAST)]));
    let id = first.robot_team(&robot("a")).unwrap().team;
    bench.receive_embedding(&embedding(2, &[("x", WEST), ("y", NORTH)]));
    for (epoch, names) in (3..).zip(["c", "c b", "c b a"]) {
        bench.wait(10.0);
        bench.take();
        bench.receive_embedding(&embedding(epoch, &[("x y", WEST), (names, EAST)]));
        assert_eq!(bench.division().robot_team(&robot("c")).unwrap().team, id);
    }
    // The team lives on in one robot; those who come back outvote a stranger who joined it.
    bench.receive_embedding(&embedding(6, &[("x y", WEST), ("c", EAST)]));
    bench.take();
    bench.receive_embedding(&embedding(7, &[("x y c", WEST), ("a b", EAST)]));
    assert_eq!(bench.division().robot_team(&robot("a")).unwrap().team, id);
}
