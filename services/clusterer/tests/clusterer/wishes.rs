//! Wishes of operators: they are granted, or say why not; they outlive the process and the leader.

use muster_model::settings::TeamSize;
use muster_model::wish::{StandingWish, WishState};
use muster_service::testkit::command_of;
use serde_json::{Value, json};

use super::*;

fn put(bench: &mut Bench, name: &str, wish: &Value) -> Result<StandingWish, String> {
    let answer = bench.get(&format!("wish/{name}"), Some(&wish.to_string()))?;
    let [Message::Wish(report)] = &answer[..] else { panic!("{answer:?}") };
    assert_eq!(format!("{}/{}", report.wish.operator, report.wish.id), name);
    Ok(report.wish.clone())
}

fn pin(robots: &[&str], team: &str) -> Value {
    json!({"kind": "pin", "robots": robots, "team": team})
}

fn group(kind: &str, robots: &[&str]) -> Value {
    json!({"kind": kind, "robots": robots})
}

/// The wishes that the leader answers with, as `alice/p1 active`.
fn states(bench: &mut Bench) -> Vec<String> {
    let answer = bench.get("wishes", None).unwrap();
    let Some(Message::Wishes(list)) = answer.first() else { return Vec::new() };
    let state = |one: &StandingWish| format!("{}/{} {:?}", one.operator, one.id, one.state);
    list.wishes.iter().map(state).collect()
}

fn six(epoch: u64) -> Checked<Embedding> {
    embedding(epoch, &[("a b c", WEST), ("x y z", EAST)])
}

fn fixed() -> ClustererSettings {
    ClustererSettings { heartbeat_s: 4.0, dwell_s: 0.5, ..teams(2) }
}

const FREE: &str = "t1: a b c | t2: x y z";

#[test]
fn a_pin_is_granted_at_once_and_gone_when_it_is_withdrawn() {
    let (mut bench, before) = divided(fixed(), &six(1));
    assert_eq!(short(&before), FREE);
    let answer = put(&mut bench, "alice/p1", &pin(&["a"], "t2")).unwrap();
    assert_eq!(answer.state, WishState::Waiting);
    let sent = bench.take();
    assert_eq!(short(&sent.division()), "t1: b c | t2: a x y z", "without the dwell of robots");
    assert!(sent.division().limited.as_ref().unwrap().conflict.is_none());
    let named = |state| EventKind::WishChanged {
        operator: "alice".parse().unwrap(),
        id: "p1".parse().unwrap(),
        state,
    };
    assert!(sent.events.contains(&named(WishState::Active)), "{:?}", sent.events);
    assert_eq!(states(&mut bench), ["alice/p1 Active"]);
    // It holds in every division, and the robot that it names does not even wait.
    bench.receive_embedding(&embedding(2, &[("a b c", EAST), ("x y z", WEST)]));
    let division = bench.division();
    let place = |name: &str| division.robot_team(&robot(name)).unwrap().team.unwrap();
    assert_eq!(place("a"), TeamId::numbered(2), "{}", short(&division));
    let gone = put(&mut bench, "alice/p1", &Value::Null).unwrap();
    assert_eq!(gone.state, WishState::Withdrawn);
    assert!(states(&mut bench).is_empty());
    let error = put(&mut bench, "alice/p1", &Value::Null).unwrap_err();
    assert!(error.contains("alice/p1 is not there"), "{error}");
}

/// Robots that are there do not go without a team for one that is not.
#[test]
fn a_wish_that_the_others_cannot_obey_without_it_takes_the_seat_of_an_absent_team() {
    let ban = json!({"kind": "ban", "robots": ["c"], "team": "t1"});
    let (mut bench, _) = divided(fixed(), &six(1));
    bench.wait(0.1);
    bench.receive_embedding(&embedding(2, &[("a b c", WEST)]));
    bench.wait(1.0);
    assert_eq!(short(&bench.division()), "t1: a b c", "the seat of the other team is kept");
    put(&mut bench, "alice/b1", &ban).unwrap();
    let division = bench.division();
    assert_eq!(short(&division), "t1: a b | t3: c");
    assert_eq!(division.limited.as_ref().unwrap().conflict, None);
    assert_eq!(states(&mut bench), ["alice/b1 Active"]);
    // It stays so, as it is after a restart, of which no seat is known.
    assert_eq!(settle(&mut bench, &[("a b c", WEST)]), "t1: a b | t3: c");
}

/// The last division after the same robots were divided again a few times, as when one of them moves a little.
fn settle(bench: &mut Bench, groups: &[(&str, [f64; 2])]) -> String {
    let mut last = None;
    for _ in 0..4 {
        bench.wait(1.0);
        bench.receive_embedding(&embedding(bench.now.0, groups));
        bench.wait(1.0);
        last = bench.take().teams.pop().or(last);
    }
    short(&last.expect("a division in eight seconds").0)
}

#[test]
fn a_pin_moves_its_robot_and_no_other() {
    let small = [("a b c", WEST), ("x y z", EAST)];
    let large = [("a b c d e", WEST), ("m n o p", NORTH), ("v w x y z", EAST)];
    for (groups, free, pinned) in [
        (&small[..], FREE, "t1: b c | t2: a x y z"),
        (
            &large,
            "t1: a b c d e | t2: m n o p | t3: v w x y z",
            "t1: b c d e | t2: a m n o p | t3: v w x y z",
        ),
    ] {
        let count = u32::try_from(groups.len()).unwrap();
        let settings = ClustererSettings { heartbeat_s: 4.0, dwell_s: 0.5, ..teams(count) };
        let (mut bench, before) = divided(settings, &embedding(1, groups));
        assert_eq!(short(&before), free);
        put(&mut bench, "alice/p1", &pin(&["a"], "t2")).unwrap();
        assert_eq!(short(&bench.division()), pinned);
        assert_eq!(
            settle(&mut bench, groups),
            pinned,
            "two teams that swap their ids move all their robots"
        );
        // Another wish is no reason either.
        let last = groups.last().unwrap().0.split(' ').next_back().unwrap();
        put(&mut bench, "alice/r", &json!({"kind": "reserve", "robots": [last]})).unwrap();
        let pinned = format!("{} | - {last}", pinned.replace(&format!(" {last}"), ""));
        assert_eq!(settle(&mut bench, groups), pinned);
        put(&mut bench, "alice/p1", &Value::Null).unwrap();
        put(&mut bench, "alice/r", &Value::Null).unwrap();
        assert_eq!(settle(&mut bench, groups), free);
    }
}

#[test]
fn a_whole_team_that_is_pinned_elsewhere_makes_the_others_make_room() {
    let groups = [("a b c", WEST), ("x y z", EAST)];
    let (mut bench, _) = divided(fixed(), &embedding(1, &groups));
    put(&mut bench, "alice/p1", &pin(&["a", "b", "c"], "t2")).unwrap();
    assert_eq!(settle(&mut bench, &groups), "t1: x y z | t2: a b c");
}

#[test]
fn every_kind_is_granted() {
    let (mut bench, _) = divided(fixed(), &six(1));
    for (wish, wanted) in [
        (json!({"kind": "ban", "robots": ["a"], "team": "t1"}), "t1: b c | t2: a x y z"),
        (json!({"kind": "reserve", "robots": ["a"]}), "t1: b c | t2: x y z | - a"),
        (group("together", &["a", "x"]), ""),
        (group("apart", &["a", "b"]), ""),
    ] {
        put(&mut bench, "alice/w", &wish).unwrap();
        let division = bench.division();
        let place = |name: &str| division.robot_team(&robot(name)).unwrap().team;
        match wish["kind"].as_str().unwrap() {
            "together" => assert_eq!(place("a"), place("x"), "{}", short(&division)),
            "apart" => assert_ne!(place("a"), place("b"), "{}", short(&division)),
            _ => assert_eq!(short(&division), wanted),
        }
        assert_eq!(states(&mut bench), ["alice/w Active"], "{wish}");
        put(&mut bench, "alice/w", &Value::Null).unwrap();
        bench.wait(1.0);
        bench.take();
        // Back to where they were.
        bench.receive_embedding(&six(bench.now.0));
        bench.wait(1.0);
        bench.take();
    }
}

#[test]
fn the_robots_of_a_locked_team_stay() {
    let settings = ClustererSettings { dwell_s: 0.0, ..fixed() };
    let (mut bench, _) = divided(settings, &six(1));
    put(&mut bench, "alice/l", &json!({"kind": "lock", "team": "t1"})).unwrap();
    bench.take();
    bench.receive_embedding(&embedding(2, &[("a", WEST), ("b c x y z", EAST)]));
    assert_eq!(short(&bench.division()), FREE);
    put(&mut bench, "alice/l", &Value::Null).unwrap();
    assert_eq!(short(&bench.division()), "t1: a | t2: b c x y z");
}

/// Its limit had another robot put into the place of one in the reserve, so that not both can be locked in it.
#[test]
fn a_robot_that_comes_back_to_a_locked_team_without_a_place_is_not_locked_in_it() {
    let groups = [("a b c", WEST), ("m x y z", EAST)];
    let three = TeamSize { min: Some(3), max: Some(3) };
    let limits = ClustererSettings { team_size: [(TeamId::numbered(1), three)].into(), ..fixed() };
    let (mut bench, before) = divided(limits, &embedding(1, &groups));
    assert_eq!(short(&before), "t1: a b c | t2: m x y z");
    put(&mut bench, "alice/l", &json!({"kind": "lock", "team": "t1"})).unwrap();
    put(&mut bench, "alice/r", &json!({"kind": "reserve", "robots": ["a"]})).unwrap();
    assert_eq!(settle(&mut bench, &groups), "t1: b c m | t2: x y z | - a");
    put(&mut bench, "alice/r", &Value::Null).unwrap();
    let back = settle(&mut bench, &groups);
    assert_eq!(back, "t1: b c m | t2: a x y z", "as after a restart");
}

#[test]
fn a_team_whose_robots_are_all_in_reserve_has_no_seat() {
    let settings = ClustererSettings { teams: TeamCount::Fixed(3), ..fixed() };
    let first = embedding(1, &[("a b c d", WEST), ("m", NORTH), ("x y z", EAST)]);
    let (mut bench, before) = divided(settings, &first);
    assert_eq!(short(&before), "t1: a b c d | t2: m | t3: x y z");
    put(&mut bench, "alice/r", &json!({"kind": "reserve", "robots": ["m"]})).unwrap();
    let sent = bench.take();
    assert_eq!(sent.teams.len(), 1, "the same robots are divided once: {sent:?}");
    let division = sent.division();
    assert_eq!((division.requested, division.teams.len()), (3, 3), "{}", short(&division));
    assert_eq!(division.unassigned, [robot("m")]);
    // Nothing changes after that, also once the team is forgotten.
    bench.wait(70.0);
    bench.receive_embedding(&again(&first, 1, 2));
    for (teams, _) in bench.take().teams {
        assert_eq!(short(&teams), short(&division));
    }
}

#[test]
fn a_team_does_not_come_back_with_a_robot_that_may_not_be_in_it() {
    let (mut bench, before) = divided(fixed(), &embedding(1, &[("a", WEST), ("m", EAST)]));
    assert_eq!(short(&before), "t1: a | t2: m");
    put(&mut bench, "alice/w", &json!({"kind": "reserve", "robots": ["m"]})).unwrap();
    assert_eq!(short(&bench.division()), "t1: a | - m");
    put(&mut bench, "alice/w", &json!({"kind": "ban", "robots": ["m"], "team": "t2"})).unwrap();
    for (teams, _) in bench.take().teams {
        assert!(teams.robot_team(&robot("m")).unwrap().team != Some(TeamId::numbered(2)));
    }
    assert_eq!(settle(&mut bench, &[("a", WEST), ("m", EAST)]), "t1: a | t3: m");
}

#[test]
fn a_wish_for_who_is_not_there_waits() {
    let (mut bench, _) = divided(fixed(), &six(1));
    let waits = put(&mut bench, "alice/p1", &pin(&["r9"], "t2")).unwrap();
    assert_eq!(waits.state, WishState::Waiting);
    put(&mut bench, "alice/p2", &pin(&["a"], "t7")).unwrap();
    put(&mut bench, "bob/t", &group("together", &["a", "q"])).unwrap();
    assert_eq!(states(&mut bench), ["alice/p1 Waiting", "alice/p2 Waiting", "bob/t Waiting"]);
    let answer = bench.get("wish/alice/p1", None).unwrap();
    let [Message::Wish(report)] = &answer[..] else { panic!("{answer:?}") };
    assert_eq!(report.wish.reason.as_deref(), Some("r9 is not there"));
    bench.take();
    bench.receive_embedding(&embedding(2, &[("a b c r9", WEST), ("x y z", EAST)]));
    assert_eq!(short(&bench.division()), "t1: a b c | t2: r9 x y z");
    assert_eq!(states(&mut bench)[0], "alice/p1 Active");
}

#[test]
fn a_wish_for_a_team_that_comes_back_is_granted_once_it_is_there() {
    let (mut bench, _) = divided(fixed(), &six(1));
    bench.receive_embedding(&embedding(2, &[("a b c", WEST)]));
    assert_eq!(short(&bench.division()), "t1: a b c");
    put(&mut bench, "alice/p", &pin(&["a"], "t2")).unwrap();
    assert_eq!(states(&mut bench), ["alice/p Waiting"]);
    bench.wait(1.0);
    bench.take();
    bench.receive_embedding(&six(3));
    bench.wait(0.1);
    let last = bench.take().teams.last().unwrap().0.clone();
    assert_eq!(short(&last), "t1: b c | t2: a x y z");
    assert_eq!(states(&mut bench), ["alice/p Active"]);
}

#[test]
fn a_wish_that_contradicts_others_is_refused_with_them() {
    let settings = ClustererSettings { size: TeamSize { min: None, max: Some(4) }, ..fixed() };
    let (mut bench, _) = divided(settings, &six(1));
    put(&mut bench, "alice/p1", &pin(&["a"], "t2")).unwrap();
    let error = put(&mut bench, "bob/p", &pin(&["a"], "t1")).unwrap_err();
    assert!(error.contains("alice/p1") && error.contains("bob/p"), "{error}");
    let error = put(&mut bench, "bob/p", &pin(&["b", "x", "y", "z"], "t2")).unwrap_err();
    assert!(error.contains("5 robots may only be in t2, which holds 4"), "{error}");
    assert!(error.contains("(wishes alice/p1 and bob/p)"), "{error}");
    let error = put(&mut bench, "bob/r", &json!({"kind": "reserve", "robots": ["a"]})).unwrap_err();
    assert!(error.contains("alice/p1") && error.contains("bob/r"), "{error}");
    let error = put(&mut bench, "bob/t", &group("apart", &["a", "b", "c"])).unwrap_err();
    assert!(error.contains("bob/t"), "{error}");
    assert_eq!(states(&mut bench), ["alice/p1 Active"]);
    for (name, payload, named) in [
        ("alice/p2", json!({"kind": "pin", "robots": ["a"]}), "team"),
        ("alice/p2", json!({"kind": "reserve", "robots": ["a"], "expires": 5.0}), "expires"),
        ("alice/p2", json!([1]), "action.wish"),
    ] {
        let error = put(&mut bench, name, &payload).unwrap_err();
        assert!(error.contains(named), "{payload}: {error}");
    }
    let limit = r#"{"size":{"max":3}}"#;
    bench.get("service/clusterer/settings", Some(limit)).unwrap();
    let error = bench.get("service/clusterer/settings", Some(r#"{"teams":1}"#)).unwrap_err();
    assert!(error.contains("which holds 3"), "{error}");
}

#[test]
fn wishes_of_which_robots_come_and_make_them_contradict_say_so() {
    let settings = ClustererSettings { size: TeamSize { min: None, max: Some(4) }, ..fixed() };
    let (mut bench, _) = divided(settings, &six(1));
    put(&mut bench, "alice/p", &pin(&["p", "q", "r", "s", "u"], "t2")).unwrap();
    bench.take();
    bench.receive_embedding(&embedding(2, &[("a b c", WEST), ("x y z p q", EAST)]));
    assert_eq!(states(&mut bench), ["alice/p Active"]);
    bench.receive_embedding(&embedding(3, &[("a", WEST), ("p q r s u", EAST)]));
    let sent = bench.take();
    let last = sent.teams.last().unwrap().0.clone();
    let conflict = last.limited.as_ref().unwrap().conflict.clone().unwrap();
    assert!(
        conflict.contains("5 robots may only be in t2, which holds 4 (wish alice/p)"),
        "{conflict}"
    );
    assert_eq!(states(&mut bench), ["alice/p Conflicting"]);
    assert!(last.teams.iter().all(|team| team.members.len() <= 4), "{}", short(&last));
    put(&mut bench, "alice/p", &Value::Null).unwrap();
    assert!(bench.take().events.iter().any(|kind| matches!(kind, EventKind::FeasibleAgain { .. })));
}

#[test]
fn a_wish_expires() {
    let (mut bench, _) = divided(fixed(), &six(1));
    let at = bench.now.as_seconds() + 10.0;
    let wish = json!({"kind": "pin", "robots": ["a"], "team": "t2", "expires": at});
    put(&mut bench, "alice/p", &wish).unwrap();
    bench.wait(9.0);
    assert_eq!(states(&mut bench), ["alice/p Active"]);
    bench.take();
    bench.wait(2.0);
    assert_eq!(states(&mut bench), ["alice/p Expired"]);
    let last = bench.take().teams.last().unwrap().0.clone();
    assert_eq!(last.limited, None, "nothing is asked any more");
    bench.wait(3700.0);
    assert!(states(&mut bench).is_empty());
}

#[test]
fn a_wish_is_on_disk_before_it_is_confirmed_and_there_after_a_restart() {
    let (mut bench, _) = divided(fixed(), &six(1));
    bench.hold_stores = true;
    let replies = bench.replies.len();
    let wish = pin(&["a"], "t2").to_string();
    let (key, command) = command_of(bench.now, "wish/alice/p", "first", &wish).unwrap();
    let get = muster_service::IncomingGet {
        get: muster_service::GetId(999),
        selector: format!("muster/v1/f/{key}"),
        narrowed: None,
        parameters: String::new(),
        payload: Some(command.into_bytes()),
    };
    bench.input(Input::Get(get));
    assert_eq!(bench.replies.len(), replies, "it is not on disk yet");
    bench.hold_stores = false;
    bench.input(Input::Kept { error: None });
    assert_eq!(bench.replies.len(), replies + 1);
    put(&mut bench, "alice/q", &pin(&["b"], "t2")).unwrap();
    let kept = bench.kept.clone().unwrap();
    let division = bench.take().teams.last().unwrap().0.clone();
    let mut next = Bench::new(fixed());
    next.now = bench.now;
    next.input(Input::Restored(kept));
    next.start(vec![mirrored(&division), Message::Embedding(six(1))]);
    assert_eq!(states(&mut next), ["alice/p Active", "alice/q Active"]);
    assert_eq!(short(&next.take().teams.last().unwrap().0), short(&division));
}

#[test]
fn a_wish_that_could_not_be_written_is_not_confirmed_when_it_is_put_again() {
    let (mut bench, _) = divided(fixed(), &six(1));
    bench.hold_stores = true;
    let put = |bench: &mut Bench, get: u64| {
        let wish = pin(&["a"], "t2").to_string();
        let (key, command) =
            command_of(bench.now, "wish/alice/p", &format!("c{get}"), &wish).unwrap();
        bench.input(Input::Get(muster_service::IncomingGet {
            get: muster_service::GetId(get),
            selector: format!("muster/v1/f/{key}"),
            narrowed: None,
            parameters: String::new(),
            payload: Some(command.into_bytes()),
        }));
    };
    // The outcome of each command is written as well.
    let written = |bench: &mut Bench, error: Option<&str>| {
        bench.input(Input::Kept { error: error.map(str::to_owned) });
        for _ in 0..4 {
            bench.input(Input::Stored { error: None });
        }
        let replies = std::mem::take(&mut bench.replies);
        replies.iter().map(|reply| reply.answer.is_ok()).collect::<Vec<_>>()
    };
    bench.replies.clear();
    put(&mut bench, 991);
    assert_eq!(written(&mut bench, Some("the disk is full")), [false]);
    put(&mut bench, 992);
    for _ in 0..4 {
        bench.input(Input::Stored { error: None });
    }
    let replies = std::mem::take(&mut bench.replies);
    assert_eq!(replies.iter().map(|reply| reply.answer.is_ok()).collect::<Vec<_>>(), [false]);
    bench.wait(11.0);
    bench.input(Input::Kept { error: None });
    put(&mut bench, 993);
    for _ in 0..4 {
        bench.input(Input::Stored { error: None });
    }
    assert!(bench.replies.last().unwrap().answer.is_ok(), "it was written again");
}

#[test]
fn a_standby_knows_the_wishes_and_takes_them_over() {
    let (mut leader, _) = divided(fixed(), &six(1));
    put(&mut leader, "alice/p", &pin(&["a"], "t2")).unwrap();
    let list = leader.get("wishes", None).unwrap();
    let division = leader.take().teams.last().unwrap().0.clone();
    let found = vec![mirrored(&division), list[0].clone(), Message::Embedding(six(1))];
    let mut next = Bench::restored(fixed(), found);
    assert_eq!(states(&mut next), ["alice/p Active"]);
    assert_eq!(short(&next.take().teams.last().unwrap().0), "t1: b c | t2: a x y z");
}

/// The list may be of a later division than the one that is found, as where that one was forged.
#[test]
fn a_wish_is_not_said_to_be_granted_by_a_division_that_does_not_grant_it() {
    let (mut leader, before) = divided(fixed(), &six(1));
    put(&mut leader, "alice/p", &pin(&["a"], "t2")).unwrap();
    let list = leader.get("wishes", None).unwrap();
    assert_eq!(states(&mut leader), ["alice/p Active"]);
    let found = vec![mirrored(&before), list[0].clone(), Message::Embedding(six(1))];
    let next = Bench::restored(fixed(), found);
    let published = next.published.iter().filter_map(|message| match message {
        Message::Wishes(list) => Some(list.wishes[0].state),
        _ => None,
    });
    assert_eq!(published.collect::<Vec<_>>(), [WishState::Waiting, WishState::Active]);
}

/// The leader was lost after it had confirmed a wish, and its list was never received; or it had withdrawn one.
#[test]
fn a_wish_that_was_confirmed_by_a_leader_whose_list_was_lost_counts() {
    let (mut leader, _) = divided(fixed(), &six(1));
    let list = |leader: &mut Bench| leader.get("wishes", None).unwrap()[0].clone();
    let none = list(&mut leader);
    put(&mut leader, "alice/p", &pin(&["a"], "t2")).unwrap();
    let with_wish = list(&mut leader);
    let outcomes = |leader: &mut Bench| leader.get("command/clusterer/*/*", None).unwrap();
    let put_it = outcomes(&mut leader);
    let division = mirrored(&leader.take().teams.last().unwrap().0);
    let next = |list: &Message, outcomes: Vec<Message>| {
        let embedding = Message::Embedding(six(1));
        let found = [vec![division.clone(), list.clone(), embedding], outcomes].concat();
        let mut next = Bench::restored(fixed(), found);
        (states(&mut next), next.counter("wishes_recovered"))
    };
    let active = vec!["alice/p Active".to_owned()];
    assert_eq!(next(&none, put_it.clone()), (active.clone(), 1));
    assert_eq!(next(&with_wish, put_it), (active, 0), "the list has it");
    put(&mut leader, "alice/p", &Value::Null).unwrap();
    assert_eq!(next(&with_wish, outcomes(&mut leader)), (vec![], 1));
    let without_wish = list(&mut leader);
    assert_eq!(next(&without_wish, outcomes(&mut leader)), (vec![], 0), "the list has it");
}

/// A standby may have a wish on its disk that a leader put which has lost it.
#[test]
fn a_leader_without_wishes_says_so_when_it_begins() {
    let (mut bench, _) = divided(fixed(), &six(1));
    let list = bench.get("wishes", None).unwrap();
    assert!(matches!(&list[..], [Message::Wishes(list)] if list.wishes.is_empty()), "{list:?}");
}

/// A leader that is a suspect answers still, and publishes nothing.
#[test]
fn the_last_wish_that_is_withdrawn_without_a_link_is_gone_for_all_when_the_link_is_back() {
    let (mut bench, _) = divided(fixed(), &six(1));
    put(&mut bench, "alice/p", &pin(&["a"], "t2")).unwrap();
    bench.input(Input::LinkLost);
    bench.published.clear();
    put(&mut bench, "alice/p", &Value::Null).unwrap();
    let lists = |bench: &Bench| -> Vec<usize> {
        let wishes = bench.published.iter().filter_map(|message| match message {
            Message::Wishes(list) => Some(list.wishes.len()),
            _ => None,
        });
        wishes.collect()
    };
    assert!(lists(&bench).is_empty());
    bench.input(Input::LinkRestored);
    assert_eq!(lists(&bench).first(), Some(&0));
}

/// A wish of a property test: its kind, up to three robots and a team.
fn drawn() -> impl Strategy<Value = Value> {
    let robots = prop::collection::btree_set(0_u8..10, 2..4);
    (0_usize..6, robots, 1_u8..4).prop_map(|(kind, robots, team)| {
        let robots: Vec<String> = robots.into_iter().map(|robot| format!("r{robot}")).collect();
        let team = format!("t{team}");
        match kind {
            0 => json!({"kind": "pin", "robots": robots[..1], "team": team}),
            1 => json!({"kind": "ban", "robots": robots, "team": team}),
            2 => json!({"kind": "together", "robots": robots}),
            3 => json!({"kind": "apart", "robots": robots}),
            4 => json!({"kind": "lock", "team": team}),
            _ => json!({"kind": "reserve", "robots": robots[..1]}),
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    /// Whatever is wished and wherever robots go: an active wish is granted by the division.
    #[test]
    fn an_active_wish_is_granted(
        wishes in prop::collection::vec(drawn(), 1..6),
        max in prop::option::of(3_u32..8),
        frames in prop::collection::vec(
            prop::collection::vec(prop::option::weighted(0.85, (-2_i8..3, -2_i8..3)), 10),
            1..8,
        ),
    ) {
        let settings = ClustererSettings {
            size: TeamSize { min: None, max },
            restarts: 3,
            ..ClustererSettings { dwell_s: 0.5, ..teams(3) }
        };
        let mut bench = Bench::leading(settings);
        let mut wishes = wishes.into_iter();
        for (epoch, places) in (1..).zip(frames) {
            let rows = places.into_iter().enumerate().filter_map(|(i, place)| {
                let (x, y) = place?;
                Some((robot(&format!("r{i}")), vec![f64::from(x), f64::from(y)], false))
            });
            bench.receive_embedding(&from_rows(1, epoch, rows.collect()));
            bench.wait(1.0);
            if let Some(wish) = wishes.next() {
                // It may be refused.
                let _ = put(&mut bench, &format!("alice/w{epoch}"), &wish);
            }
            bench.wait(0.3);
            bench.take();
            let answer = bench.get("teams", None).unwrap();
            let Some(Message::Teams { teams, .. }) = answer.first() else { continue };
            let answer = bench.get("wishes", None).unwrap();
            let Some(Message::Wishes(list)) = answer.first() else { continue };
            let place = |robot: &RobotId| teams.robot_team(robot).map(|team| team.team);
            for one in list.wishes.iter().filter(|one| one.state == WishState::Active) {
                let placed: Vec<_> = one.wish.robots.iter().filter_map(place).collect();
                let in_teams: Vec<_> = placed.iter().flatten().collect();
                let distinct: BTreeSet<_> = in_teams.iter().collect();
                let team = one.wish.team.as_ref();
                let granted = match one.wish.kind.name() {
                    "pin" => in_teams.iter().all(|place| Some(*place) == team),
                    "ban" => in_teams.iter().all(|place| Some(*place) != team),
                    "together" => distinct.len() <= 1,
                    "apart" => distinct.len() == in_teams.len(),
                    "reserve" => in_teams.is_empty(),
                    _ => true,
                };
                prop_assert!(granted, "{:?} in {}", one, short(teams));
            }
            let conflict = teams.limited.as_ref().and_then(|limited| limited.conflict.as_ref());
            let is_settled = |one: &StandingWish| match one.state {
                WishState::Conflicting => conflict.is_some(),
                // A division follows at once where that is all it waits for.
                WishState::Waiting => {
                    teams.teams.is_empty() || one.reason.as_deref() != Some("the next division")
                }
                _ => true,
            };
            prop_assert!(
                list.wishes.iter().all(is_settled),
                "{:?} in {}", list.wishes, short(teams)
            );
        }
    }
}

/// One team by the evidence, and two while one of two robots may not be in it: a team in which nobody may be any more is
/// not waited for.
#[test]
fn a_team_in_which_no_robot_may_be_makes_room_for_another_at_once() {
    let settings = ClustererSettings { teams: TeamCount::Auto, ..fixed() };
    let two = |epoch| {
        let mut embedding = Embedding::clone(&embedding(epoch, &[("a b", WEST)]));
        embedding.quality.teams_shown = Some(1);
        embedding.quality.team_scores = vec![0.48, -0.4];
        Checked::new_unchecked(embedding)
    };
    let (mut bench, _) = divided(settings.clone(), &two(1));
    put(&mut bench, "alice/w1", &json!({"kind": "ban", "robots": ["b"], "team": "t1"})).unwrap();
    bench.wait(1.0);
    assert_eq!(short(&bench.take().teams.pop().unwrap().0), "t1: a | t2: b");
    put(&mut bench, "alice/w2", &json!({"kind": "pin", "robots": ["a"], "team": "t2"})).unwrap();
    bench.wait(2.0);
    let mut seen: Vec<String> = bench.take().teams.iter().map(|(teams, _)| short(teams)).collect();
    seen.dedup();
    assert_eq!(seen, ["t2: a | t3: b", "t2: a b"]);

    // The same where the team of the pin is only to come.
    let (mut bench, _) = divided(settings, &two(1));
    put(&mut bench, "alice/w1", &json!({"kind": "pin", "robots": ["b"], "team": "t2"})).unwrap();
    bench.wait(1.0);
    assert_eq!(short(&bench.take().teams.pop().unwrap().0), "t1: a b");
    put(&mut bench, "alice/w2", &json!({"kind": "ban", "robots": ["a"], "team": "t1"})).unwrap();
    bench.wait(2.0);
    let mut seen: Vec<String> = bench.take().teams.iter().map(|(teams, _)| short(teams)).collect();
    seen.dedup();
    assert_eq!(seen, ["t2: b | t3: a", "t2: a b"]);
}
