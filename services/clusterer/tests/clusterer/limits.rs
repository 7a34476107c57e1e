//! Limits on the robots of teams: they hold, or the division and an event say why not.

use muster_model::settings::TeamSize;
use muster_model::teams::HeldRobot;

use super::*;

/// So many teams, each with `min` to `max` robots.
fn limited(count: u32, min: Option<u32>, max: Option<u32>) -> ClustererSettings {
    ClustererSettings { size: TeamSize { min, max }, heartbeat_s: 4.0, ..teams(count) }
}

fn set(bench: &mut Bench, patch: &str) -> Result<(), String> {
    bench.get("service/clusterer/settings", Some(patch)).map(|_| ())
}

fn conflict(teams: &Teams) -> Option<&str> {
    teams.limited.as_ref().expect("limits hold").conflict.as_deref()
}

#[test]
fn a_division_without_limits_says_nothing_of_them() {
    let (_, first) = divided(teams(2), &embedding(1, &[("a b c d", WEST), ("x y", EAST)]));
    assert_eq!(first.limited, None);
}

#[test]
fn teams_have_no_more_robots_than_they_may_have() {
    let first = embedding(1, &[("a b c d", WEST), ("x y", EAST)]);
    let (mut bench, free) = divided(teams(2), &first);
    assert_eq!(short(&free), "t1: a b c d | t2: x y");
    set(&mut bench, r#"{"size":{"max":3}}"#).unwrap();
    let division = bench.division();
    // Who is nearest to the other team goes there.
    assert_eq!(short(&division), "t1: a b c | t2: d x y");
    let limited = division.limited.clone().unwrap();
    assert_eq!((limited.optimal, limited.gap, limited.conflict), (true, 0.0, None));
    set(&mut bench, r#"{"size":null}"#).unwrap();
    let division = bench.division();
    assert_eq!((short(&division), division.limited.clone()), (short(&free), None));
}

#[test]
fn teams_have_at_least_as_many_robots_as_they_must() {
    let first = embedding(1, &[("a b c d", WEST), ("x", EAST)]);
    let (_, division) = divided(limited(2, Some(2), None), &first);
    assert_eq!(short(&division), "t1: a b c | t2: d x");
}

/// Where fewer teams are made, none has the id of robots that are elsewhere.
#[test]
fn robots_that_stay_together_keep_their_id_where_two_other_teams_become_one() {
    let places = [("a b c", WEST), ("m n o", [0.5, 0.0]), ("x y z", [30.0, 30.0])];
    // No robot has what is needed, so that no team can have it under any id.
    let unfilled = r#"{"needs":[{"skill":"medic","per_team":{"min":1},"soft":true}]}"#;
    for (far, patch) in (0..3).flat_map(|far| [(far, "{}"), (far, unfilled)]) {
        let mut groups = places;
        groups[far].1 = [30.0, 30.0];
        groups[2].1 = if far == 2 { groups[2].1 } else { [0.3, 0.3] };
        let (mut bench, first) = divided(limited(3, None, Some(8)), &embedding(1, &groups));
        assert_eq!(short(&first), "t1: a b c | t2: m n o | t3: x y z");
        bench.receive_roster(roster(1, "a b c m n o x y z"));
        set(&mut bench, patch).unwrap();
        bench.take();
        set(&mut bench, r#"{"teams":2}"#).unwrap();
        let division = bench.division();
        assert_eq!(conflict(&division), None);
        let (alone, id) = (places[far].0, format!("t{}", far + 1));
        let of_id = division.teams.iter().find(|team| team.id.as_str() == id);
        let of_id = of_id.unwrap_or_else(|| panic!("{id}: {}", short(&division)));
        let names: Vec<&str> = of_id.members.iter().map(|member| member.robot.as_str()).collect();
        assert_eq!(names.join(" "), alone, "{}", short(&division));
    }
}

/// One after the other takes the id of another one that was left out.
#[test]
fn each_of_several_teams_that_are_left_out_keeps_its_id_where_most_of_its_robots_are() {
    let far = |at: f64| [at, at];
    let first = [
        ("a1 a2 a3 a4 a5", WEST),
        ("b1 b2 b3 b4 b5", far(10.0)),
        ("c1 c2 c3 c4 c5", far(20.0)),
        ("d1 d2 d3 d4 d5", far(30.0)),
        ("e1 e2 e3 e4", far(40.0)),
    ];
    let (mut bench, all) = divided(limited(5, None, Some(30)), &embedding(1, &first));
    assert_eq!(all.teams.len(), 5);
    set(&mut bench, r#"{"teams":3}"#).unwrap();
    bench.take();
    let second = [
        ("a1 a2 a3 a4 a5 b1 b2 b3 b4 b5 c1 c2 c3 c4 c5", WEST),
        ("d1 d2 d3 e1 e2 e3 e4", far(40.0)),
        ("d4 d5", far(80.0)),
    ];
    let mut from_five = Bench::restored(limited(3, None, Some(30)), vec![mirrored(&all)]);
    from_five.receive_embedding(&again(&embedding(2, &second), 2, 2));
    from_five.wait(3.0);
    let last = from_five.take().teams.pop().unwrap().0;
    let team_of = |robot: &str| {
        let of = last.assignments().find(|(name, _)| name.as_str() == robot);
        of.unwrap().1.to_string()
    };
    let ids = [team_of("a1"), team_of("d1"), team_of("d4")];
    assert_eq!(ids, ["t1", "t5", "t4"], "{}", short(&last));
}

/// They had left, and as they are back fewer teams are made than robots are from.
#[test]
fn a_team_that_returns_keeps_its_id_before_the_few_robots_that_join_it() {
    let settings = ClustererSettings { dwell_s: 0.0, ..limited(3, None, Some(8)) };
    let first = [("a b c", WEST), ("m n o", [9.0, 0.0]), ("v w x y z", [0.0, 9.0])];
    let (mut bench, all) = divided(settings, &embedding(1, &first));
    assert_eq!(short(&all), "t1: a b c | t2: m n o | t3: v w x y z");
    let mut epoch = 1;
    let mut receive = |bench: &mut Bench, groups: &[(&str, [f64; 2])]| {
        epoch += 1;
        bench.wait(0.5);
        bench.receive_embedding(&embedding(epoch, groups));
    };
    receive(&mut bench, &[("a b c", WEST), ("m n o", [9.0, 0.0])]);
    set(&mut bench, r#"{"teams":2}"#).unwrap();
    for _ in 0..4 {
        receive(&mut bench, &[("a b c m n", WEST), ("o", [9.0, 0.0])]);
    }
    let rest = bench.take().teams.pop().unwrap().0;
    assert_eq!(short(&rest), "t1: a b c m n | t2: o");
    for _ in 0..8 {
        receive(&mut bench, &[("a b c m n", WEST), ("o v w x y z", [9.0, 0.0])]);
    }
    let back = bench.take().teams.pop().unwrap().0;
    assert_eq!(short(&back), "t1: a b c m n | t3: o v w x y z");
}

#[test]
fn a_limit_is_that_of_the_team_that_keeps_the_id() {
    let first = embedding(1, &[("a b", WEST), ("x y z", EAST)]);
    let (mut bench, before) = divided(teams(2), &first);
    assert_eq!(short(&before), "t1: a b | t2: x y z");
    set(&mut bench, r#"{"team_size":{"t2":{"max":3},"t9":{"max":1}}}"#).unwrap();
    bench.take();
    // More robots come to the place of t2, and the places are exchanged.
    bench.receive_embedding(&embedding(2, &[("a b", EAST), ("x y z u v w", WEST)]));
    let division = bench.division();
    let t2 = &division.teams[1];
    assert_eq!((t2.id.as_str(), t2.members.len()), ("t2", 3));
    assert_eq!(conflict(&division), None);
    for name in ["x", "y", "z"] {
        assert!(t2.members.iter().any(|m| m.robot.as_str() == name), "{}", short(&division));
    }
}

#[test]
fn robots_that_are_kept_for_a_while_break_no_limit() {
    let settings = ClustererSettings { dwell_s: 0.5, ..limited(2, None, Some(4)) };
    let (mut bench, _) = divided(settings, &embedding(1, &[("a b c", WEST), ("x y z", EAST)]));
    // c goes east, where a place is free: it waits.
    bench.receive_embedding(&embedding(2, &[("a b", WEST), ("c x y z", EAST)]));
    assert_eq!(short(&bench.division()), "t1: a b c | t2: x y z");
    bench.wait(1.0);
    assert_eq!(short(&bench.division()), "t1: a b | t2: c x y z");
    // Two robots join in the west, and two that were there go: four places are there, so that they cannot wait.
    bench.receive_embedding(&embedding(3, &[("g h i c", WEST), ("a b", EAST), ("x y z", EAST)]));
    let division = bench.division();
    assert!(division.teams.iter().all(|team| team.members.len() <= 4), "{}", short(&division));
    assert_eq!(conflict(&division), Some("9 robots may only be in t1 and t2, which hold 8"));
}

#[test]
fn as_many_robots_are_kept_as_the_limits_let_stay() {
    let settings = ClustererSettings { dwell_s: 0.5, ..limited(2, None, Some(4)) };
    let first = embedding(1, &[("a b c", WEST), ("w x y z", EAST)]);
    let (mut bench, _) = divided(settings, &first);
    // z goes west and a goes east, and e joins in the east: it takes the place of z, which cannot wait. a can.
    let rows = [("a", EAST), ("b", WEST), ("c", WEST), ("e", EAST), ("w", EAST), ("x", EAST)];
    let rows = rows.into_iter().chain([("y", EAST), ("z", WEST)]);
    let rows = rows.map(|(name, place)| (robot(name), place.to_vec(), false)).collect();
    bench.receive_embedding(&from_rows(1, 2, rows));
    let division = bench.division();
    assert_eq!(conflict(&division), None);
    assert!(division.teams.iter().all(|team| team.members.len() <= 4), "{}", short(&division));
}

#[test]
fn what_nothing_satisfies_is_refused_with_its_arithmetic() {
    let first = embedding(1, &[("a b c d e", WEST), ("x y z", EAST)]);
    let (mut bench, _) = divided(teams(2), &first);
    let error = set(&mut bench, r#"{"size":{"max":3}}"#).unwrap_err();
    assert!(error.contains("8 robots may only be in t1 and t2, which hold 6"), "{error}");
    assert!(error.contains(r#""field":"size""#), "{error}");
    let error = set(&mut bench, r#"{"size":{"min":5}}"#).unwrap_err();
    assert!(error.contains("t1 and t2 need 10 robots, and 8 may be there"), "{error}");
    let patch = r#"{"team_size":{"t1":{"max":2},"t2":{"max":2}}}"#;
    let error = set(&mut bench, patch).unwrap_err();
    assert!(error.contains("which hold 4") && error.contains(r#""field":"team_size""#), "{error}");
    // The number of teams decides as well.
    set(&mut bench, r#"{"size":{"max":4}}"#).unwrap();
    let error = set(&mut bench, r#"{"teams":1}"#).unwrap_err();
    assert!(error.contains("8 robots may only be in t1, which holds 4"), "{error}");
    assert!(error.contains(r#""field":"teams""#), "{error}");
    assert!(set(&mut bench, r#"{"hysteresis":0.1}"#).is_ok(), "what has no bearing on limits");
}

#[test]
fn without_robots_any_limit_is_accepted() {
    let mut bench = Bench::leading(teams(2));
    set(&mut bench, r#"{"size":{"min":4}}"#).unwrap();
    bench.receive_embedding(&embedding(1, &[]));
    set(&mut bench, r#"{"size":{"min":5}}"#).unwrap();
    assert!(bench.take().events.iter().all(|kind| !matches!(kind, EventKind::Infeasible { .. })));
}

/// Of 10 robots no more than 9 have a place. The evidence for two teams would take theirs from a third of them.
#[test]
fn while_nothing_satisfies_the_limits_the_number_of_teams_stands_whatever_the_evidence_is() {
    let shown = |epoch, groups: &[(&str, [f64; 2])]| {
        let mut embedding = Embedding::clone(&embedding(epoch, groups));
        embedding.quality.teams_shown = Some(2);
        Checked::new_unchecked(embedding)
    };
    let settings = ClustererSettings {
        teams: TeamCount::Between { from: 1, to: 3 },
        ..limited(3, None, Some(3))
    };
    let groups = [("a b c", WEST), ("m n o", EAST), ("x y z", NORTH)];
    let (mut bench, before) = divided(settings, &shown(1, &groups));
    bench.receive_embedding(&shown(2, &[("a b c", WEST), ("m n o p", EAST), ("x y z", NORTH)]));
    bench.wait(5.0);
    let last = bench.take().teams.pop().unwrap().0;
    assert_eq!(short(&last), format!("{} | - p", short(&before)));
    assert!(conflict(&last).is_some());
}

#[test]
fn while_nothing_satisfies_the_limits_the_division_stands_and_an_event_says_why() {
    let settings = limited(2, None, Some(3));
    let (mut bench, _) = divided(settings, &embedding(1, &[("a b c", WEST), ("x y z", EAST)]));
    bench.receive_embedding(&embedding(2, &[("a b c j", WEST), ("k x y z", EAST)]));
    let sent = bench.take();
    let division = sent.division();
    assert_eq!(short(&division), "t1: a b c | t2: x y z | - j k");
    let reason = "8 robots may only be in t1 and t2, which hold 6";
    assert_eq!(conflict(&division), Some(reason));
    let infeasible = EventKind::Infeasible { reason: reason.to_owned() };
    assert!(sent.events.contains(&infeasible), "{:?}", sent.events);
    // One robot leaves: its place is taken, and the event is not repeated.
    bench.wait(1.0);
    bench.receive_embedding(&embedding(3, &[("b c j", WEST), ("k x y z", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: b c j | t2: x y z | - k");
    assert!(!sent.events.iter().any(|kind| matches!(kind, EventKind::Infeasible { .. })));
    bench.wait(1.0);
    bench.receive_embedding(&embedding(4, &[("b c j", WEST), ("k x z", EAST)]));
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: b c j | t2: k x z");
    let again =
        |kind: &EventKind| matches!(kind, EventKind::FeasibleAgain { after_s } if *after_s >= 2.0);
    assert!(sent.events.iter().any(again), "{:?}", sent.events);
}

#[test]
fn too_few_robots_leave_a_team_as_it_is() {
    let settings = limited(2, Some(3), None);
    let (mut bench, _) = divided(settings, &embedding(1, &[("a b c", WEST), ("x y z", EAST)]));
    bench.receive_embedding(&embedding(2, &[("a b c", WEST), ("x y", EAST)]));
    let division = bench.division();
    assert_eq!(short(&division), "t1: a b c | t2: x y");
    assert_eq!(conflict(&division), Some("t1 and t2 need 6 robots, and 5 may be there"));
}

#[test]
fn the_number_of_teams_is_one_that_the_limits_allow() {
    let automatic =
        |size| ClustererSettings { teams: TeamCount::Auto, size, heartbeat_s: 4.0, ..teams(1) };
    let scored = |scores: &[f64]| {
        let groups = [("a b c", WEST), ("m n", NORTH), ("x y z", EAST)];
        let mut embedding = Embedding::clone(&embedding(1, &groups));
        embedding.quality.teams_shown = Some(3);
        embedding.quality.team_scores = scores.to_vec();
        Checked::new_unchecked(embedding)
    };
    let scores = [0.1, 0.5, 0.9, 0.4];
    let (_, free) = divided(automatic(TeamSize::default()), &scored(&scores));
    assert_eq!((free.requested, free.teams.len()), (3, 3));
    let (_, three) = divided(automatic(TeamSize { min: Some(2), max: None }), &scored(&scores));
    assert_eq!((three.requested, conflict(&three)), (3, None));
    let (_, two) = divided(automatic(TeamSize { min: Some(3), max: None }), &scored(&scores));
    assert_eq!((two.requested, two.teams.len(), conflict(&two)), (2, 2, None));
    let (_, four) = divided(automatic(TeamSize { min: None, max: Some(2) }), &scored(&scores));
    assert_eq!((four.requested, four.teams.len(), conflict(&four)), (4, 4, None));
}

#[test]
fn a_team_that_is_too_small_makes_room_for_one_that_is_not() {
    let groups = [("a b c", WEST), ("x y", EAST)];
    let (mut bench, before) = divided(teams(2), &embedding(1, &groups));
    assert_eq!(short(&before), "t1: a b c | t2: x y");
    set(&mut bench, r#"{"team_size":{"t1":{"max":3}},"teams":1}"#).unwrap();
    let last = bench.take().teams.pop().unwrap().0;
    assert_eq!((short(&last).as_str(), conflict(&last)), ("t2: a b c x y", None));
}

/// Else it would be replaced by the team that its limit has brought about.
#[test]
fn where_the_number_is_chosen_a_team_with_limits_is_replaced_by_none_without() {
    let shown = |epoch, groups: &[(&str, [f64; 2])]| {
        let mut embedding = Embedding::clone(&embedding(epoch, groups));
        embedding.quality.teams_shown = Some(1);
        Checked::new_unchecked(embedding)
    };
    let team_size = [(TeamId::new("t1").unwrap(), TeamSize { min: None, max: Some(3) })];
    let settings =
        ClustererSettings { teams: TeamCount::Auto, team_size: team_size.into(), ..teams(1) };
    let (mut bench, one) = divided(settings, &shown(1, &[("a b c", WEST)]));
    assert_eq!(short(&one), "t1: a b c");
    for epoch in 2..5 {
        bench.receive_embedding(&shown(epoch, &[("a b c", WEST), ("x y", EAST)]));
        bench.wait(1.0);
        let last = bench.take().teams.pop().unwrap().0;
        assert_eq!(short(&last), "t1: a b c | t2: x y", "{epoch}");
        assert_eq!(conflict(&last), None);
    }
}

#[test]
fn a_division_that_was_made_before_the_limits_is_not_published_after_them() {
    let mut bench = Bench::leading(teams(2));
    bench.hold_jobs = true;
    bench.receive_embedding(&embedding(1, &[("a b c d", WEST), ("x y", EAST)]));
    set(&mut bench, r#"{"size":{"max":3}}"#).unwrap();
    bench.hold_jobs = false;
    bench.run_job();
    assert_eq!(short(&bench.division()), "t1: a b c | t2: d x y");
}

#[test]
fn a_standby_takes_over_with_the_division_and_its_conflict() {
    let settings = limited(2, None, Some(3));
    let (mut bench, _) =
        divided(settings.clone(), &embedding(1, &[("a b c", WEST), ("x y z", EAST)]));
    let more = embedding(2, &[("a b c j", WEST), ("x y z", EAST)]);
    bench.receive_embedding(&more);
    let stood = bench.division();
    let mut next = Bench::restored(settings, vec![mirrored(&stood), Message::Embedding(more)]);
    let sent = next.take();
    assert_eq!(short(&sent.division()), short(&stood));
    assert!(!sent.events.iter().any(|kind| matches!(kind, EventKind::Infeasible { .. })));
    next.receive_embedding(&embedding(3, &[("a b c", WEST), ("x y z", EAST)]));
    let again = |kind: &EventKind| matches!(kind, EventKind::FeasibleAgain { .. });
    assert!(next.take().events.iter().any(again));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    /// Robots on a grid come, move and go under any limits.
    #[test]
    fn limits_hold_or_the_division_says_why_not(
        count in 1_u32..5,
        min in prop::option::of(0_u32..5),
        room in prop::option::of(0_u32..6),
        own in prop::option::of((1_u64..4, 1_u32..6)),
        dwell_s in prop::sample::select(vec![0.0, 0.5]),
        frames in prop::collection::vec(
            prop::collection::vec(prop::option::weighted(0.8, (-2_i8..3, -2_i8..3)), 12),
            1..12,
        ),
    ) {
        let max = room.map(|room| (min.unwrap_or(0) + room).max(1));
        let mut settings =
            ClustererSettings { dwell_s, restarts: 3, ..limited(count, min, max) };
        if let Some((team, most)) = own {
            let size = TeamSize { min: Some(0), max: Some(most) };
            settings.team_size.insert(TeamId::numbered(team), size);
        }
        let has_limits = settings.has_limits();
        let mut bench = Bench::leading(settings.clone());
        for (epoch, places) in (1..).zip(frames) {
            let rows = places.into_iter().enumerate().filter_map(|(i, place)| {
                let (x, y) = place?;
                Some((robot(&format!("r{i:02}")), vec![f64::from(x), f64::from(y)], false))
            });
            bench.receive_embedding(&from_rows(1, epoch, rows.collect()));
            bench.wait(0.3);
            for (division, _) in bench.take().teams {
                prop_assert_eq!(division.limited.is_some(), has_limits);
                let Some(limited) = &division.limited else { continue };
                for team in &division.teams {
                    let size = settings.size_of(&team.id);
                    let robots = u32::try_from(team.members.len()).unwrap();
                    prop_assert!(size.max.is_none_or(|max| robots <= max), "{}", short(&division));
                    if limited.conflict.is_none() {
                        prop_assert!(robots >= size.least(), "{}", short(&division));
                    }
                }
                if limited.conflict.is_none() {
                    prop_assert!(division.unassigned.is_empty(), "{}", short(&division));
                    prop_assert!((0.0..1.0).contains(&limited.gap));
                }
            }
        }
    }
}

#[test]
fn the_prices_say_what_a_place_costs_and_who_is_kept_is_named() {
    let settings = ClustererSettings { dwell_s: 0.5, ..limited(2, None, Some(3)) };
    let (mut bench, division) =
        divided(settings, &embedding(1, &[("a b c d", WEST), ("x y", EAST)]));
    assert_eq!(short(&division), "t1: a b c | t2: d x y");
    let prices = &division.limited.as_ref().unwrap().prices;
    assert!(prices[0] > prices[1], "all four would be in the first team: {prices:?}");
    assert!(division.held.is_empty());
    // With a place more nobody needs to pay.
    set(&mut bench, r#"{"size":{"max":4}}"#).unwrap();
    let division = bench.division();
    assert_eq!((short(&division).as_str(), division.held.len()), ("t1: a b c d | t2: x y", 0));
    let prices = &division.limited.as_ref().unwrap().prices;
    assert!(prices.iter().all(|price| price.abs() < 1e-9), "{prices:?}");
    bench.receive_embedding(&embedding(2, &[("a b c", WEST), ("d x y", EAST)]));
    let division = bench.division();
    let held = vec![HeldRobot { robot: robot("d"), team: division.teams[1].id.clone() }];
    assert_eq!((short(&division).as_str(), &division.held), ("t1: a b c d | t2: x y", &held));
    bench.wait(0.6);
    let division = bench.division();
    assert_eq!((short(&division).as_str(), division.held.len()), ("t1: a b c | t2: d x y", 0));
}
