//! Needs of teams: they are filled, or the division and an event say why not.

use muster_model::settings::{Need, SkillCount};
use muster_model::teams::TeamNeed;

use super::*;

fn need(skill: &str, min: u32, max: Option<u32>) -> Need {
    let skill = SkillId::new(skill).unwrap();
    Need { skill, team: None, per_team: SkillCount { min, max }, soft: false }
}

/// So many teams that need some skills. A robot that is to be elsewhere goes at once, so that needs are all that holds one.
fn needing(count: u32, needs: &[Need]) -> ClustererSettings {
    ClustererSettings { needs: needs.to_vec(), heartbeat_s: 4.0, ..teams(count) }
}

fn set(bench: &mut Bench, patch: &str) -> Result<(), String> {
    bench.get("service/clusterer/settings", Some(patch)).map(|_| ())
}

/// One with robots and their roster.
fn bench(settings: ClustererSettings, rows: &Checked<Embedding>, robots: &str) -> Bench {
    let mut bench = Bench::leading(settings);
    bench.receive_roster(roster(1, robots));
    bench.receive_embedding(rows);
    bench
}

/// What the teams have of what they need: `t1 medic 1/1`, with a tilde where it is soft.
fn filled(teams: &Teams) -> String {
    let one = |need: &TeamNeed| {
        let soft = if need.soft { "~" } else { "" };
        format!("{} {} {}/{}{soft}", need.team, need.skill, need.have, need.min)
    };
    teams.needs.iter().map(one).collect::<Vec<_>>().join(", ")
}

fn conflict(teams: &Teams) -> Option<&str> {
    teams.limited.as_ref().expect("needs hold").conflict.as_deref()
}

/// The events of needs: `t1 medic: m2, m1 is silent`.
fn replaced(events: &[EventKind]) -> Vec<String> {
    let one = |kind: &EventKind| match kind {
        EventKind::NeedFilled { team, skill, robots, reason } => {
            let names: Vec<_> = robots.iter().map(RobotId::as_str).collect();
            Some(format!("{team} {skill}: {}, {reason}", names.join(" ")))
        }
        _ => None,
    };
    events.iter().filter_map(one).collect()
}

const ALL: &str = "a b c d x y z w";

fn eight() -> Checked<Embedding> {
    embedding(1, &[("a b c d", WEST), ("w x y z", EAST)])
}

#[test]
fn a_division_without_needs_says_nothing_of_them() {
    let mut bench = bench(teams(2), &eight(), "a:medic b c d w x y z");
    let division = bench.division();
    assert_eq!((division.limited.clone(), division.needs.clone()), (None, vec![]));
}

#[test]
fn every_team_has_the_robot_that_it_needs() {
    let robots = "a:medic b:medic c d w x y z";
    let mut bench = bench(teams(2), &eight(), robots);
    assert_eq!(short(&bench.division()), "t1: a b c d | t2: w x y z");
    set(&mut bench, r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#).unwrap();
    let published = bench.take();
    let division = published.division();
    assert_eq!(short(&division), "t1: a c d | t2: b w x y z", "the one who is nearer goes");
    assert_eq!(filled(&division), "t1 medic 1/1, t2 medic 1/1");
    assert_eq!(conflict(&division), None);
    assert!(division.limited.as_ref().unwrap().optimal);
    assert_eq!(replaced(&published.events), ["t2 medic: b, it had 0 of 1"]);
    set(&mut bench, r#"{"needs":null}"#).unwrap();
    let division = bench.division();
    assert_eq!((division.limited.clone(), filled(&division)), (None, String::new()));
}

#[test]
fn a_team_has_no_more_than_it_may_have_and_its_own_need_goes_before_that_of_all() {
    let robots = "a:medic b:medic c:medic d w x y z";
    let mut bench = bench(needing(2, &[need("medic", 0, Some(2))]), &eight(), robots);
    assert_eq!(filled(&bench.division()), "t1 medic 2/0, t2 medic 1/0");
    let patch = r#"{"needs":[{"skill":"medic","per_team":{"min":1}},
        {"skill":"medic","team":"t1","per_team":{"min":0,"max":0}}]}"#;
    set(&mut bench, patch).unwrap();
    assert_eq!(filled(&bench.division()), "t1 medic 0/0, t2 medic 3/1");
    let patch = r#"{"needs":[{"skill":"medic","per_team":{"min":0,"max":1}}]}"#;
    let error = set(&mut bench, patch).unwrap_err();
    let numbers = "3 robots with medic may only be in t1 and t2, which hold 2";
    assert!(error.contains(numbers) && error.contains(r#""field":"needs""#), "{error}");
}

#[test]
fn needs_that_the_fleet_can_never_fill_are_refused_with_numbers() {
    let rows = embedding(1, &[("a b c", WEST), ("x y z", EAST), ("u v w", NORTH)]);
    let mut bench = bench(teams(3), &rows, "a:medic b:medic c u v w x y z:medic?");
    let needs = r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#;
    let error = set(&mut bench, needs).unwrap_err();
    assert!(error.contains("2 robots with medic for 3 teams, which need 3"), "{error}");
    assert!(error.contains(r#""field":"needs""#), "{error}");
    let relay = r#"{"needs":[{"skill":"relay","team":"t2","per_team":{"min":1}}]}"#;
    let error = set(&mut bench, relay).unwrap_err();
    assert!(error.contains("0 robots with relay for 1 team, which needs 1"), "{error}");
    let absent = r#"{"needs":[{"skill":"relay","team":"t9","per_team":{"min":1}}]}"#;
    set(&mut bench, absent).unwrap();
    // Soft ones are filled as far as can be.
    let soft = r#"{"needs":[{"skill":"medic","per_team":{"min":1},"soft":true}]}"#;
    set(&mut bench, soft).unwrap();
    let (division, _) = bench.take().teams.last().unwrap().clone();
    assert_eq!(conflict(&division), None);
    assert_eq!(division.needs.iter().map(|need| need.have).sum::<u32>(), 2);
    assert!(filled(&division).contains("0/1~"), "{}", filled(&division));
}

#[test]
fn another_robot_comes_when_the_only_one_falls_silent_and_the_event_says_why() {
    // x is the only medic in the east, and b and c are two in the west.
    let settings = ClustererSettings { dwell_s: 5.0, ..needing(2, &[need("medic", 1, None)]) };
    let mut bench = bench(settings, &eight(), "a b:medic c:medic d w x:medic y z");
    assert_eq!(short(&bench.division()), "t1: a b c d | t2: w x y z");
    bench.receive_roster(roster(2, "a b:medic c:medic d w x:medic? y z"));
    let published = bench.take();
    let (division, _) = published.teams.last().unwrap();
    assert_eq!(filled(division), "t1 medic 1/1, t2 medic 1/1", "no dwell keeps it");
    assert_eq!(short(division), "t1: a b d | t2: c w x y z");
    assert_eq!(replaced(&published.events), ["t2 medic: c, x is silent"]);
    // It returns: both may stay, and nobody moves for it.
    bench.receive_roster(roster(3, "a b:medic c:medic d w x:medic y z"));
    let last = bench.take();
    assert!(replaced(&last.events).is_empty(), "{:?}", last.events);
    // The robot leaves the fleet.
    bench.wait(10.0);
    bench.take();
}

#[test]
fn while_needs_cannot_be_filled_the_division_goes_on_and_says_why() {
    let settings = needing(2, &[need("medic", 1, None)]);
    let mut bench = bench(settings, &eight(), "a:medic b c d w x:medic y z");
    assert_eq!(conflict(&bench.division()), None);
    bench.receive_roster(roster(2, "a:medic b c d w x:medic? y z"));
    let published = bench.take();
    let (division, _) = published.teams.last().unwrap();
    let reason = "1 robot with medic for 2 teams, which need 2";
    assert_eq!(conflict(division), Some(reason));
    assert_eq!(filled(division), "t1 medic 1/1, t2 medic 0/1");
    let infeasible = EventKind::Infeasible { reason: reason.to_owned() };
    assert!(published.events.contains(&infeasible), "{:?}", published.events);
    // The division goes on: a robot that is elsewhere goes there, and the one medic stays where it is needed.
    bench.receive_embedding(&embedding(2, &[("a b c", WEST), ("d w x y z", EAST)]));
    let division = bench.division();
    assert_eq!(short(&division), "t1: a b c | t2: d w x y z");
    assert_eq!(conflict(&division), Some(reason));
    // What has nothing to do with it is no reason to refuse a change, and what makes it worse is.
    assert_eq!(set(&mut bench, r#"{"size":{"max":6}}"#), Ok(()));
    assert!(set(&mut bench, r#"{"size":{"max":3}}"#).unwrap_err().contains("which hold 6"));
    let worse = r#"{"needs":[{"skill":"medic","per_team":{"min":2}}]}"#;
    assert!(set(&mut bench, worse).unwrap_err().contains("which need 4"));
    bench.take();
    bench.receive_roster(roster(3, "a:medic b c d w x:medic y z"));
    let published = bench.take();
    let (division, _) = published.teams.last().unwrap();
    assert_eq!(conflict(division), None);
    let again = |kind: &EventKind| matches!(kind, EventKind::FeasibleAgain { .. });
    assert!(published.events.iter().any(again), "{:?}", published.events);
}

#[test]
fn a_team_whose_robots_are_all_silent_gets_nobody_sent_after_it() {
    let settings = needing(2, &[need("medic", 1, None)]);
    let mut bench = bench(settings, &eight(), "a:medic b:medic c d w x:medic y z");
    bench.take();
    bench.receive_roster(roster(2, "a:medic b:medic c d w? x:medic? y? z?"));
    let published = bench.take();
    let (division, _) = published.teams.last().unwrap();
    assert_eq!(short(division), "t1: a b c d | t2: w x y z");
    assert_eq!((filled(division).as_str(), conflict(division)), ("t1 medic 2/1", None));
    // One of them is back, and the medic is not.
    bench.receive_roster(roster(3, "a:medic b:medic c d w x:medic? y? z?"));
    let published = bench.take();
    let (division, _) = published.teams.last().unwrap();
    assert_eq!(filled(division), "t1 medic 1/1, t2 medic 1/1");
}

#[test]
fn one_robot_fills_the_needs_of_all_its_skills() {
    let needs = [need("medic", 1, None), need("relay", 1, None)];
    let robots = "a:medic,relay b:medic c:relay d w x y z";
    let mut bench = bench(needing(2, &needs), &eight(), robots);
    let division = bench.division();
    assert_eq!(conflict(&division), None);
    let all = "t1 medic 1/1, t1 relay 1/1, t2 medic 1/1, t2 relay 1/1";
    assert_eq!(filled(&division), all, "{}", short(&division));
    // Two of one team must go together, so that a stays.
    assert_eq!(short(&division), "t1: a w x y z | t2: b c d");
    // Robots that are needed are not kept by the dwell.
    let patch = r#"{"dwell_s":5.0}"#;
    set(&mut bench, patch).unwrap();
    bench.take();
    bench.receive_roster(roster(2, "a:medic,relay? b:medic c:relay d w x y z:medic,relay"));
    let (division, _) = bench.take().teams.last().unwrap().clone();
    assert_eq!((filled(&division).as_str(), conflict(&division)), (all, None));
    // Too few for both: each team needs a robot of either skill, and b and c are with one.
    bench.receive_roster(roster(3, "a:medic,relay? b:medic c:relay d w x y z:medic"));
    let (division, _) = bench.take().teams.last().unwrap().clone();
    assert_eq!(conflict(&division), Some("1 robot with relay for 2 teams, which need 2"));
    let patch = r#"{"needs":[{"skill":"medic","per_team":{"min":1}},{"skill":"relay","team":"t1",
        "per_team":{"min":1}}],"size":{"max":6}}"#;
    assert_eq!(set(&mut bench, patch), Ok(()));
}

#[test]
fn needs_that_contradict_each_other_are_refused_by_name() {
    let needs = r#"{"needs":[{"skill":"medic","per_team":{"min":1,"max":1}},
        {"skill":"relay","per_team":{"min":1,"max":1}}]}"#;
    // Two have both skills, and one has one of them: one team would have two relays.
    let robots = "a:medic,relay b:medic,relay c:relay d w x y z";
    let mut bench = bench(teams(2), &eight(), robots);
    let error = set(&mut bench, needs).unwrap_err();
    assert!(error.contains("relay") && error.contains(r#""field":"needs""#), "{error}");
    // Pins come before needs that are asked later.
    let pins = r#"{"kind":"pin","robots":["a","b"],"team":"t1"}"#;
    bench.get("wish/alice/p1", Some(pins)).unwrap();
    let error =
        set(&mut bench, r#"{"needs":[{"skill":"medic","per_team":{"min":1}}]}"#).unwrap_err();
    assert!(error.contains("medic") && error.contains("alice/p1"), "{error}");
}

#[test]
fn a_number_of_teams_that_is_chosen_is_one_whose_needs_can_be_filled() {
    let settings = ClustererSettings {
        teams: TeamCount::Between { from: 1, to: 4 },
        ..needing(2, &[need("medic", 1, None)])
    };
    let rows = embedding(1, &[("a b c", WEST), ("x y z", EAST), ("u v w", NORTH)]);
    let mut rows = rows;
    rows.make_mut_unchecked().quality.teams_shown = Some(3);
    rows.make_mut_unchecked().quality.team_scores = vec![0.1, 0.5, 0.9, 0.2];
    let mut bench = bench(settings, &rows, "a:medic b c u v w x:medic y z");
    let division = bench.division();
    assert_eq!((division.teams.len(), conflict(&division)), (2, None));
    assert_eq!(filled(&division), "t1 medic 1/1, t2 medic 1/1");
}

#[test]
fn needs_wait_for_the_roster() {
    let mut bench = Bench::leading(needing(2, &[need("medic", 1, None)]));
    bench.receive_embedding(&eight());
    assert_eq!(bench.division().limited, None);
    bench.receive_roster(roster(1, "a:medic b:medic c d w x y z"));
    let (division, _) = bench.take().teams.last().unwrap().clone();
    assert_eq!(filled(&division), "t1 medic 1/1, t2 medic 1/1");
    let known: Vec<&str> = ALL.split_whitespace().collect();
    assert!(division.assignments().all(|(robot, _)| known.contains(&robot.as_str())));
}

/// Whether something divides robots with these skills into so many teams that each has what it needs.
fn is_possible(robots: &[(bool, bool)], teams: usize, needs: &[(u32, Option<u32>); 2]) -> bool {
    let count = u32::try_from(robots.len()).unwrap();
    (0..teams.pow(count)).any(|mut code| {
        let labels: Vec<usize> = robots
            .iter()
            .map(|_| {
                let label = code % teams;
                code /= teams;
                label
            })
            .collect();
        (0..teams).all(|team| {
            let have = |is_able: &dyn Fn(&(bool, bool)) -> bool| {
                let there = robots.iter().zip(&labels).filter(|(_, label)| **label == team);
                u32::try_from(there.filter(|(robot, _)| is_able(robot)).count()).unwrap()
            };
            let fits = |have: u32, (min, max): (u32, Option<u32>)| {
                have >= min && max.is_none_or(|max| have <= max)
            };
            fits(have(&|robot| robot.0), needs[0]) && fits(have(&|robot| robot.1), needs[1])
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn needs_are_filled_exactly_where_something_fills_them(
        robots in prop::collection::vec((-2_i8..3, -2_i8..3, prop::bool::ANY, prop::bool::ANY), 3..8),
        count in 1_u32..4,
        apart: bool,
        mins in (0_u32..3, 0_u32..2),
        maxes in (prop::option::of(0_u32..3), prop::option::of(0_u32..3)),
    ) {
        // Where skills are apart, the flow alone finds it; else the search.
        let skills: Vec<(bool, bool)> =
            robots.iter().map(|(.., medic, relay)| (*medic, *relay && !(apart && *medic))).collect();
        let maxes = (maxes.0.map(|room| mins.0 + room), maxes.1.map(|room| mins.1 + room));
        let needs = [(mins.0, maxes.0), (mins.1, maxes.1)];
        let settings =
            needing(count, &[need("medic", mins.0, maxes.0), need("relay", mins.1, maxes.1)]);
        let name = |at: usize| robot(&format!("r{at}"));
        let rows = robots.iter().enumerate().map(|(at, (x, y, ..))| {
            let apart = f64::from(u32::try_from(at).unwrap()) * 1e-3;
            (name(at), vec![f64::from(*x) + apart, f64::from(*y) - apart * apart], false)
        });
        let rows = from_rows(1, 1, rows.collect());
        let text: Vec<String> = skills.iter().enumerate().map(|(at, (medic, relay))| {
            let medic = if *medic { "medic" } else { "" };
            let relay = if *relay { "relay" } else { "" };
            format!("r{at}:{medic},{relay}")
        }).collect();
        let mut bench = bench(settings, &rows, &text.join(" "));
        let division = bench.division();
        let teams = (count as usize).min(robots.len());
        let possible = is_possible(&skills, teams, &needs);
        let wrong = |need: &&TeamNeed| {
            need.lacks() > 0 || need.max.is_some_and(|max| need.have > max)
        };
        let wrong = division.needs.iter().find(wrong);
        if needs.iter().all(|(min, max)| *min == 0 && max.is_none()) {
            prop_assert!(division.needs.is_empty());
        }
        prop_assert_eq!(conflict(&division).is_none(), possible, "{:?}", division);
        prop_assert!(!possible || wrong.is_none(), "{:?}", division);
        for need in &division.needs {
            let team = division.teams.iter().find(|team| team.id == need.team).unwrap();
            let is_able = |member: &&muster_model::teams::Member| {
                let (medic, relay) = skills[member.robot.as_str()[1..].parse::<usize>().unwrap()];
                if need.skill.as_str() == "medic" { medic } else { relay }
            };
            let have = team.members.iter().filter(is_able).count();
            prop_assert_eq!(need.have as usize, have);
        }
    }
}
