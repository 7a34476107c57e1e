//! Whole teams that are absent for a while: their seats are kept.

use std::time::Duration;

use muster_service::Input;

use super::*;

/// Three teams, each with parts of its own that a fourth or third team could be made of.
const CAMPS: [(&str, [f64; 2]); 4] = [
    ("a b c d e", [0.0, 0.0]),
    ("m n o p", [9.0, 0.0]),
    ("w x y z", [0.0, 9.0]),
    ("q r s", [9.0, 9.0]),
];

/// The robots of a camp stand in a row: more teams than camps are always a better division.
fn camps(epoch: u64, present: &str, scores: &[f64]) -> Checked<Embedding> {
    let mut rows = Vec::new();
    for (names, place) in CAMPS {
        for (i, name) in names.split_whitespace().enumerate() {
            if present.split_whitespace().any(|there| there == name) {
                let apart = f64::from(u32::try_from(i).unwrap());
                rows.push((robot(name), vec![place[0] + apart, place[1] + 0.1 * apart], false));
            }
        }
    }
    let mut embedding = Embedding::clone(&from_rows(1, epoch, rows));
    let best = (1..).zip(scores).max_by(|left, right| left.1.total_cmp(right.1));
    embedding.quality.teams_shown = best.map(|(teams, _)| teams);
    embedding.quality.team_scores = scores.to_vec();
    Checked::new_unchecked(embedding)
}

const ALL: &str = "a b c d m n o p w x y z";
const WITHOUT: &str = "a b c d m n o p";
const TWO: [f64; 4] = [0.1, 0.6, 0.2, 0.1];
const THREE: [f64; 4] = [0.1, 0.2, 0.6, 0.1];
const WHOLE: &str = "t1: a b c d | t2: m n o p | t3: w x y z";
const REST: &str = "t1: a b c d | t2: m n o p";

fn settings(teams: TeamCount) -> ClustererSettings {
    ClustererSettings { teams, restarts: 10, ..ClustererSettings::default() }
}

/// The division that holds.
fn held(bench: &mut Bench) -> Checked<Teams> {
    match &bench.get("teams", None).unwrap()[..] {
        [Message::Teams { teams, .. }] => teams.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_team_that_is_cut_off_moves_nobody_else_and_comes_back_as_what_it_was() {
    let range = TeamCount::Between { from: 3, to: 5 };
    for wanted in [TeamCount::Fixed(3), TeamCount::Auto, range] {
        let (mut bench, first) = divided(settings(wanted), &camps(1, ALL, &THREE));
        assert_eq!(short(&first), WHOLE, "{wanted}");
        let mut epoch = 1;
        let mut receive = |bench: &mut Bench, present: &str, scores: &[f64]| {
            epoch += 1;
            bench.wait(0.1);
            bench.receive_embedding(&camps(epoch, present, scores));
            held(bench)
        };
        // They leave and come back one after the other.
        for present in ["a b c d m n o p w x y", "a b c d m n o p y"] {
            let left = receive(&mut bench, present, &THREE);
            assert!(left.teams.len() == 3 && short(&left).starts_with(REST), "{}", short(&left));
        }
        // What the others show without them is no evidence.
        for scores in [&TWO, &THREE] {
            for _ in 0..50 {
                let rest = receive(&mut bench, WITHOUT, scores);
                assert_eq!(short(&rest), REST, "{wanted}");
            }
        }
        let present = ["a b c d m n o p z", "a b c d m n o p w z", ALL];
        for (present, team) in present.iter().zip(["t3: z", "t3: w z", "t3: w x y z"]) {
            let back = receive(&mut bench, present, &THREE);
            assert_eq!(short(&back), format!("{REST} | {team}"), "{wanted}");
        }
        assert_eq!(bench.counter("moves_held"), 0, "{wanted}");
    }
}

/// Half of a team stands apart and could be the team that it was before that; the other half is near a third one.
#[test]
fn half_of_a_team_does_not_become_a_remembered_one_while_another_is_absent() {
    let mut epoch = 0;
    let mut standing = |groups: &[&str]| {
        epoch += 1;
        let place = |at: usize| f64::from(u32::try_from(at).unwrap());
        let rows = groups.iter().enumerate().flat_map(|(group, names)| {
            let names = names.split_whitespace().enumerate();
            names.map(move |(i, name)| {
                let row = vec![9.0 * place(group) + 0.1 * place(i), 5.0];
                (robot(name), row, false)
            })
        });
        let mut rows: Vec<_> = rows.collect();
        rows.sort_by(|left, right| left.0.cmp(&right.0));
        from_rows(1, epoch, rows)
    };
    let first = standing(&["a b c", "o p q", "r s v x"]);
    let (mut bench, _) = divided(settings(TeamCount::Fixed(3)), &first);
    let mut receive = |groups: &[&str]| {
        for _ in 0..20 {
            bench.receive_embedding(&standing(groups));
            bench.wait(0.1);
        }
        short(&held(&mut bench))
    };
    assert_eq!(receive(&["a b", "c", "o p q r s v x"]), "t1: a b | t3: o p q r s v x | t4: c");
    assert_eq!(receive(&["a b c", "o p q r s v", "x"]), "t1: a b c | t3: o p q r s v | t5: x");
    assert_eq!(receive(&["o p q r s v", "x"]), "t3: o p q r s v | t5: x", "t1 is absent");
    for _ in 0..5 {
        assert_eq!(receive(&["o p q", "r s v x"]), "t3: o p q r s v | t5: x");
    }
    assert_eq!(receive(&["a b c", "o p q r s v", "x"]), "t1: a b c | t3: o p q r s v | t5: x");
}

/// A need that no team fills must not keep a team from its id.
#[test]
fn a_team_that_comes_back_keeps_its_id_where_no_robot_has_what_is_needed() {
    let (mut bench, first) = divided(settings(TeamCount::Fixed(3)), &camps(1, ALL, &THREE));
    assert_eq!(short(&first), WHOLE);
    let needs = r#"{"needs":[{"skill":"medic","per_team":{"min":1},"soft":true}]}"#;
    bench.receive_roster(roster(1, ALL));
    bench.get("service/clusterer/settings", Some(needs)).unwrap();
    let mut epoch = 1;
    let mut receive = |bench: &mut Bench, present: &str| {
        epoch += 1;
        bench.wait(0.5);
        bench.receive_embedding(&camps(epoch, present, &THREE));
        short(&held(bench))
    };
    for _ in 0..4 {
        assert_eq!(receive(&mut bench, WITHOUT), REST);
    }
    for (present, team) in [("z", "t3: z"), ("w z", "t3: w z"), ("w x y z", "t3: w x y z")] {
        let division = receive(&mut bench, &format!("{WITHOUT} {present}"));
        assert_eq!(division, format!("{REST} | {team}"));
    }
}

/// Who leads next after the one that divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    /// Its own process, started again.
    Restarted,
    /// A standby that has received its divisions.
    Standby,
    /// A standby whose link was lost while the robots left: it has received the last division alone.
    StandbyOfTheLast,
}

/// Neither a restart of everything nor a standby that takes over forgets a team that is absent.
#[test]
fn a_team_that_is_absent_keeps_its_seat_and_its_id_with_the_next_leader() {
    let again = |embedding: &Checked<Embedding>, epoch| again(embedding, 2, epoch);
    let range = TeamCount::Between { from: 2, to: 5 };
    for wanted in [TeamCount::Fixed(3), TeamCount::Auto, range] {
        for who in [Next::Restarted, Next::Standby, Next::StandbyOfTheLast] {
            let (mut before, first) = divided(settings(wanted), &camps(1, ALL, &THREE));
            assert_eq!(short(&first), WHOLE, "{wanted}");
            let mut standby = Bench::new(settings(wanted));
            standby.input(Input::Started { linked: true });
            if who == Next::Standby {
                standby.receive(mirrored(&first));
            }
            for epoch in 2..20 {
                before.wait(0.5);
                before.receive_embedding(&camps(epoch, WITHOUT, &TWO));
            }
            let last = held(&mut before);
            assert_eq!(short(&last), REST, "{wanted}");
            standby.now = before.now;
            standby.receive(mirrored(&last));
            let kept = if who == Next::Restarted { &before.kept } else { &standby.kept };
            let kept = kept.clone();
            let mut next = Bench::new(settings(wanted));
            next.input(Input::Restored(kept.unwrap()));
            next.start(vec![]);
            // What the others show without it is no evidence for the next leader either.
            for (epoch, scores) in (2..).zip([&TWO, &THREE, &[0.6, 0.2, 0.1, 0.1]].repeat(30)) {
                next.receive_embedding(&again(&camps(1, WITHOUT, scores), epoch));
                next.wait(0.4);
                assert_eq!(short(&held(&mut next)), REST, "{wanted}, {who:?}");
            }
            next.receive_embedding(&again(&camps(1, ALL, &THREE), 200));
            next.wait(1.0);
            assert_eq!(short(&held(&mut next)), WHOLE, "{wanted}, {who:?}");
        }
    }
}

/// A division that was begun while a team was remembered, and is published when it is not.
#[test]
fn a_division_that_takes_long_names_no_team_that_was_absent_for_too_long() {
    let (mut bench, _) = divided(settings(TeamCount::Fixed(3)), &camps(1, ALL, &THREE));
    bench.wait(0.1);
    bench.receive_embedding(&camps(2, WITHOUT, &TWO));
    assert!(!held(&mut bench).remembered.ended.is_empty());
    bench.wait(59.0);
    bench.hold_jobs = true;
    bench.receive_embedding(&camps(3, "a b c d m n o", &TWO));
    bench.now = bench.now.after(Duration::from_secs(2));
    bench.run_job();
    let remembered = &held(&mut bench).remembered;
    let last: Vec<_> = remembered.last.iter().map(|(robot, _)| robot.as_str()).collect();
    assert!(last == ["p"] && remembered.ended.is_empty(), "{remembered:?}");
}

/// It was cut off for a few seconds, too short for its robots to leave the fleet, but long enough for what they report of links to
/// pass.
#[test]
fn a_team_that_was_silent_stays_as_it_is_until_all_of_its_robots_have_reported_again() {
    let settings = ClustererSettings { dwell_s: 0.0, ..settings(TeamCount::Fixed(3)) };
    let all = |mark: &str, robots: &str| {
        let robots = robots.split_whitespace().map(|name| format!("{name}{mark}"));
        robots.collect::<Vec<_>>().join(" ")
    };
    // The first one of it that reports is elsewhere for a moment by what is known of the others.
    let astray = |epoch| {
        let mut embedding = Embedding::clone(&camps(epoch, ALL, &THREE));
        let at = embedding.robots.iter().position(|name| name.as_str() == "z").unwrap();
        embedding.values[2 * at..2 * at + 2].copy_from_slice(&[9.0, 0.0]);
        Checked::new_unchecked(embedding)
    };
    for (mark, is_whole) in [("?", true), ("", false)] {
        let (mut bench, first) = divided(settings.clone(), &camps(1, ALL, &THREE));
        assert_eq!(short(&first), WHOLE);
        let others = format!("{} {}", all("", WITHOUT), all(mark, "w x y"));
        bench.receive_roster(roster(1, &format!("{others} z?")));
        bench.wait(4.0);
        bench.receive_roster(roster(2, &format!("{others} z")));
        bench.receive_embedding(&astray(2));
        let stays = short(&held(&mut bench)) == WHOLE;
        assert_eq!(stays, is_whole, "{}", short(&held(&mut bench)));
        if is_whole {
            // What lasts is followed.
            for epoch in 3..90 {
                bench.wait(0.1);
                bench.receive_embedding(&astray(epoch));
            }
            assert_ne!(short(&held(&mut bench)), WHOLE);
        }
    }
}

/// A link that comes back lets one robot through after the other, each as its program connects.
#[test]
fn the_first_robot_of_a_team_that_returns_waits_for_the_others_in_its_team() {
    for wanted in [TeamCount::Auto, TeamCount::Between { from: 2, to: 5 }] {
        let (mut bench, first) = divided(settings(wanted), &camps(1, ALL, &THREE));
        assert_eq!(short(&first), WHOLE, "{wanted}");
        let mut epoch = 1;
        let mut receive = |bench: &mut Bench, present: &str, scores: &[f64]| {
            epoch += 1;
            bench.wait(0.1);
            bench.receive_embedding(&camps(epoch, present, scores));
            held(bench)
        };
        for _ in 0..100 {
            assert_eq!(short(&receive(&mut bench, WITHOUT, &TWO)), REST, "{wanted}");
        }
        // One robot alone is no team by the evidence.
        for _ in 0..25 {
            let back = receive(&mut bench, "a b c d m n o p z", &TWO);
            assert_eq!(short(&back), format!("{REST} | t3: z"), "{wanted}");
        }
        assert_eq!(short(&receive(&mut bench, ALL, &THREE)), WHOLE, "{wanted}");
        for _ in 0..50 {
            assert_eq!(short(&receive(&mut bench, ALL, &THREE)), WHOLE, "{wanted}");
        }
        // Then the evidence decides again.
        for _ in 0..20 {
            receive(&mut bench, ALL, &TWO);
        }
        assert_eq!(held(&mut bench).teams.len(), 2, "{wanted}");
    }
}

/// What a robot that returns first reports of the others is little: by its vector it may stand anywhere.
#[test]
fn robots_of_a_team_that_returns_are_told_their_team_wherever_their_vectors_are_at_first() {
    for wanted in [TeamCount::Fixed(3), TeamCount::Between { from: 3, to: 5 }, TeamCount::Auto] {
        let (mut bench, first) = divided(settings(wanted), &camps(1, ALL, &THREE));
        assert_eq!(short(&first), WHOLE, "{wanted}");
        let mut epoch = 1;
        let receive = |bench: &mut Bench, embedding: Checked<Embedding>| {
            bench.wait(0.1);
            bench.receive_embedding(&embedding);
            held(bench)
        };
        let mut next = || {
            epoch += 1;
            epoch
        };
        for _ in 0..100 {
            let rest = receive(&mut bench, camps(next(), WITHOUT, &TWO));
            assert_eq!(short(&rest), REST, "{wanted}");
        }
        for (present, team) in [("a b c d m n o p z", "t3: z"), ("a b c d m n o p w z", "t3: w z")]
        {
            for _ in 0..10 {
                let mut embedding = Embedding::clone(&camps(next(), present, &TWO));
                let dimension = embedding.dimension as usize;
                for row in 8..embedding.robots.len() {
                    // Among the robots of the first camp.
                    embedding.values[row * dimension] = 1.4;
                    embedding.values[row * dimension + 1] = 0.2;
                }
                let back = receive(&mut bench, Checked::new_unchecked(embedding));
                assert_eq!(short(&back), format!("{REST} | {team}"), "{wanted}");
            }
        }
        for _ in 0..50 {
            let whole = receive(&mut bench, camps(next(), ALL, &THREE));
            assert_eq!(short(&whole), WHOLE, "{wanted}");
        }
    }
}

/// The robots of the team that returned have gone elsewhere, and then the whole fleet stands still.
#[test]
fn robots_that_stand_still_are_divided_again_once_a_team_that_returned_is_whole() {
    let (mut bench, _) = divided(settings(TeamCount::Fixed(3)), &camps(1, ALL, &THREE));
    bench.wait(0.1);
    bench.receive_embedding(&camps(2, WITHOUT, &TWO));
    bench.wait(1.0);
    let elsewhere = |epoch: u64| {
        let mut embedding = Embedding::clone(&camps(epoch, ALL, &THREE));
        let dimension = embedding.dimension as usize;
        for row in 8..embedding.robots.len() {
            // Among the robots of the first camp.
            embedding.values[row * dimension] = 1.4;
            embedding.values[row * dimension + 1] = 0.2;
        }
        Checked::new_unchecked(embedding)
    };
    bench.receive_embedding(&elsewhere(3));
    assert_eq!(short(&held(&mut bench)), WHOLE);
    bench.wait(6.0);
    let settled = short(&held(&mut bench));
    assert_ne!(settled, WHOLE);
    // So it is by the next frame with the same vectors, and after a restart.
    bench.receive_embedding(&elsewhere(4));
    bench.wait(6.0);
    assert_eq!(short(&held(&mut bench)), settled);
}

#[test]
fn an_absent_team_is_the_reason_for_fewer_teams_and_not_reported_as_another_one() {
    let (mut bench, _) = divided(settings(TeamCount::Fixed(3)), &camps(1, ALL, &[]));
    bench.receive_embedding(&camps(2, WITHOUT, &[]));
    let sent = bench.take();
    assert_eq!((sent.division().requested, sent.division().teams.len()), (3, 2));
    let reasons = sent.events.iter().filter_map(|kind| match kind {
        EventKind::FewerTeams { requested: 3, formed: 2, reason } => Some(reason.as_str()),
        _ => None,
    });
    assert_eq!(reasons.collect::<Vec<_>>(), ["all robots of 1 other team are absent"]);
}

#[test]
fn a_seat_is_given_up_when_the_team_is_forgotten() {
    let (mut bench, _) = divided(settings(TeamCount::Fixed(3)), &camps(1, ALL, &[]));
    bench.receive_embedding(&camps(2, WITHOUT, &[]));
    assert_eq!(short(&held(&mut bench)), REST);
    bench.wait(59.0);
    bench.take();
    bench.receive_embedding(&camps(3, "a b c m n o p", &[]));
    assert_eq!(held(&mut bench).teams.len(), 2);
    bench.wait(1.5);
    bench.take();
    bench.receive_embedding(&camps(4, WITHOUT, &[]));
    assert_eq!(held(&mut bench).teams.len(), 3, "three teams are asked for");
}

/// They were in every embedding, and only the roster tells that nothing is known of them. What relates them to others comes again
/// within seconds.
#[test]
fn robots_that_left_and_are_back_by_the_next_roster_stay_in_their_team() {
    let placed = |epoch: u64, without: &str| {
        let mut roster = roster(epoch, ALL);
        for entry in &mut roster.robots {
            let is_known = !without.contains(entry.robot.as_str());
            entry.position = is_known.then_some([0.0; 3]);
        }
        roster
    };
    let moved = |epoch: u64| {
        let mut embedding = Embedding::clone(&camps(epoch, ALL, &THREE));
        let dimension = embedding.dimension as usize;
        // d is among the robots of the second camp.
        embedding.values[3 * dimension] = 10.5;
        Checked::new_unchecked(embedding)
    };
    for (without, stays) in [("w", true), ("", false)] {
        let (mut bench, first) = divided(settings(TeamCount::Fixed(3)), &camps(1, ALL, &THREE));
        assert_eq!(short(&first), WHOLE);
        bench.receive_roster(placed(2, ""));
        bench.wait(0.1);
        bench.receive_roster(placed(3, without));
        for epoch in 3..30 {
            bench.receive_embedding(&moved(epoch));
            bench.wait(0.1);
        }
        assert_eq!(short(&held(&mut bench)) == WHOLE, stays);
        for epoch in 30..100 {
            bench.receive_embedding(&moved(epoch));
            bench.wait(0.1);
        }
        let lasting = "t1: a b c | t2: d m n o p | t3: w x y z";
        assert_eq!(short(&held(&mut bench)), lasting, "it has lasted");
    }
}

/// Without the seat another number of teams is wanted, and the vectors would divide the same number otherwise.
#[test]
fn the_others_are_divided_again_once_when_a_seat_is_given_up() {
    let far = |epoch: u64| {
        let mut embedding = Embedding::clone(&camps(epoch, WITHOUT, &[0.1, 0.1, 0.2, 0.6]));
        let dimension = embedding.dimension as usize;
        let last = (embedding.robots.len() - 1) * dimension;
        embedding.values[last..last + 2].fill(60.0);
        Checked::new_unchecked(embedding)
    };
    let range = TeamCount::Between { from: 3, to: 5 };
    for (wanted, count) in [(TeamCount::Auto, 4), (range, 4), (TeamCount::Fixed(3), 3)] {
        let settings = ClustererSettings { dwell_s: 0.1, ..settings(wanted) };
        let (mut bench, _) = divided(settings, &camps(1, ALL, &THREE));
        bench.receive_embedding(&camps(2, WITHOUT, &TWO));
        bench.wait(10.0);
        bench.take();
        let mut found = vec![short(&held(&mut bench))];
        for epoch in 3..63 {
            bench.receive_embedding(&far(epoch));
            bench.wait(1.0);
            let teams = bench.take().teams;
            found.extend(teams.iter().map(|(teams, _)| short(teams)));
            found.dedup();
        }
        assert_eq!((found.len(), &*found[0]), (2, REST), "{wanted}: {found:?}");
        assert_eq!(held(&mut bench).teams.len(), count, "{wanted}");
    }
}

/// A robot leaves, the link is lost a moment later, and more teams are shown once it is back.
#[test]
fn the_others_are_divided_again_once_when_the_link_was_lost_meanwhile() {
    for offline_s in [0.5, 2.0, 10.0, 40.0] {
        let (mut bench, _) = divided(settings(TeamCount::Auto), &camps(1, ALL, &THREE));
        let mut left = Embedding::clone(&camps(2, "a b c m n o p w x y z", &[0.1, 0.1, 0.2, 0.6]));
        let last = (left.robots.len() - 1) * left.dimension as usize;
        left.values[last..last + 2].fill(60.0);
        bench.receive_embedding(&Checked::new_unchecked(left));
        bench.wait(0.2);
        bench.input(Input::LinkLost);
        bench.wait(offline_s);
        bench.take();
        let mut found = vec!["t1: a b c | t2: m n o p | t3: w x y z".to_owned()];
        bench.input(Input::LinkRestored);
        for _ in 0..100 {
            bench.wait(0.1);
            found.extend(bench.take().teams.iter().map(|(teams, _)| short(teams)));
            found.dedup();
        }
        assert_eq!(found.len(), 2, "after {offline_s} s: {found:?}");
    }
}

#[test]
fn robots_that_no_team_knows_get_a_free_seat_if_the_evidence_is_for_it() {
    let (relief, one) = ("a b c d m n o p q r s", "a b c d e m n o p");
    for (present, scores, wanted) in [
        (relief, &THREE, "t1: a b c d | t2: m n o p | t4: q r s"),
        (one, &TWO, "t1: a b c d e | t2: m n o p"),
    ] {
        let (mut bench, _) = divided(settings(TeamCount::Fixed(3)), &camps(1, ALL, &THREE));
        bench.receive_embedding(&camps(2, WITHOUT, &TWO));
        assert_eq!(short(&held(&mut bench)), REST);
        for epoch in 3..60 {
            bench.wait(0.1);
            bench.take();
            bench.receive_embedding(&camps(epoch, present, scores));
        }
        assert_eq!(short(&held(&mut bench)), wanted);
    }
}

/// With a robot that no team knows the evidence is for two teams, while those of the third one leave one after the other.
#[test]
fn robots_that_no_team_knows_end_no_team_while_its_robots_leave() {
    for wanted in [TeamCount::Fixed(3), TeamCount::Auto] {
        let (mut bench, _) = divided(settings(wanted), &camps(1, ALL, &THREE));
        let mut epoch = 1;
        for (left, third) in [("w x y", "t3: w x y"), ("w x", "t3: w x"), ("w", "t3: w")] {
            for _ in 0..9 {
                epoch += 1;
                bench.wait(0.1);
                bench.receive_embedding(&camps(epoch, &format!("{WITHOUT} e {left}"), &TWO));
                let expected = format!("t1: a b c d e | t2: m n o p | {third}");
                assert_eq!(short(&held(&mut bench)), expected, "{wanted}");
            }
        }
    }
}

#[test]
fn who_returns_without_relations_is_not_told_that_it_has_no_team() {
    let all = [("a b", WEST), ("x y", EAST)];
    let (mut bench, _) = divided(settings(TeamCount::Fixed(2)), &embedding(1, &all));
    bench.receive_embedding(&embedding(2, &[("a b", WEST)]));
    bench.wait(2.0);
    bench.take();
    bench.receive_embedding(&embedding(3, &[("a b", WEST), ("x!", EAST)]));
    bench.wait(0.5);
    bench.receive_embedding(&embedding(4, &[("a b", WEST), ("x! y", EAST)]));
    bench.wait(0.4);
    assert!(bench.take().robots.iter().all(|told| told.team.is_some()));
    bench.receive_embedding(&embedding(5, &all));
    assert_eq!(short(&held(&mut bench)), "t1: a b | t2: x y");
    assert!(bench.take().robots.iter().all(|told| told.team.is_some()));
    // Who has none after a second has none.
    bench.receive_embedding(&embedding(6, &[("a b", WEST)]));
    bench.wait(0.1);
    bench.receive_embedding(&embedding(7, &[("a b", WEST), ("x!", EAST)]));
    bench.wait(1.1);
    assert_eq!(short(&held(&mut bench)), "t1: a b | - x");
}

/// The job after the wait fails: the wait is over all the same, and nothing is due until the job is tried again.
#[test]
fn a_failed_job_after_a_wait_for_relations_keeps_no_processor_busy() {
    let all = [("a b", WEST), ("x y", EAST)];
    let (mut bench, _) = divided(settings(TeamCount::Fixed(2)), &embedding(1, &all));
    bench.receive_embedding(&embedding(2, &[("a b", WEST)]));
    bench.wait(0.1);
    bench.hold_jobs = true;
    bench.receive_embedding(&embedding(3, &[("a b", WEST), ("x!", EAST)]));
    bench.wait(1.1);
    assert!(bench.job.is_some(), "the robot was awaited for long enough");
    bench.panic_job("out of luck");
    let mut woken = 0;
    let until = bench.now.after(Duration::from_millis(900));
    while let Some(due) = bench.host.deadline().filter(|due| *due < until) {
        woken += 1;
        assert!(woken < 20, "the clusterer is woken again and again");
        bench.now = due;
        bench.input(Input::Timer);
    }
    bench.wait(1.0);
    assert!(bench.job.is_some(), "it is tried again");
}

/// All robots are replaced by others, which come one camp after the other.
#[test]
fn no_seat_is_kept_for_teams_of_which_no_robot_met_those_that_are_there() {
    let fixed = settings(TeamCount::Fixed(2));
    let (mut bench, first) = divided(fixed, &camps(1, "a b c d m n o p", &TWO));
    assert_eq!(short(&first), REST);
    bench.wait(1.0);
    bench.receive_embedding(&camps(2, "", &[]));
    assert!(held(&mut bench).teams.is_empty());
    bench.wait(1.0);
    bench.receive_embedding(&camps(3, "w x", &[1.0]));
    // Two robots of one camp are two teams, as two were asked for. With the other camp there, the evidence is for one.
    for epoch in 4..80 {
        bench.wait(0.1);
        bench.receive_embedding(&camps(epoch, "w x y z q r s", &[0.6, 0.4]));
    }
    assert_eq!(held(&mut bench).teams.len(), 2, "{}", short(&held(&mut bench)));
    // Those who left return: their teams are theirs, and no more than two were asked for.
    for epoch in 80..160 {
        bench.wait(0.1);
        bench.receive_embedding(&camps(epoch, "a b c d m n o p w x y z q r s", &TWO));
    }
    assert_eq!(held(&mut bench).teams.len(), 2, "{}", short(&held(&mut bench)));
}
