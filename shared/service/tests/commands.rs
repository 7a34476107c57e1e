//! What operators command is done once, by whom they say they are, and remembered.

use std::sync::Arc;
use std::time::Duration;

use crate::small::{self, Driven, ONE_LEADS, command, outcomes, renewal, set, settings, token};
use muster_model::command::{CommandOutcome, MAX_REMEMBERED_COMMANDS, MAX_REMEMBERED_REFUSALS};
use muster_model::event::EventKind;
use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_service::{Command, GetId, IncomingGet, Input, Stored};
use muster_wire::Message;
use serde_json::{Value, json};

#[test]
fn a_command_is_carried_out_once_and_its_first_answer_is_given_again() {
    let mut driven = Driven::leading();
    let first = set(&mut driven, "kim/c1", &json!({"teams": 7})).unwrap();
    assert_eq!(
        (&first["operator"], &first["id"], &first["service"], &first["refused"]),
        (&json!("kim"), &json!("c1"), &json!("clusterer"), &Value::Null)
    );
    assert_eq!(first["action"], json!({"set": {"teams": 7}}));
    assert_eq!(first["answer"]["teams"], 7);
    set(&mut driven, "lee/c1", &json!({"teams": 8})).unwrap();
    // It arrives again, late; what others have commanded since stays.
    let again = set(&mut driven, "kim/c1", &json!({"teams": 7})).unwrap();
    assert_eq!((again["answer"]["teams"].as_u64(), driven.teams()), (Some(7), 8));
    assert_eq!(driven.counter("commands"), 2);
    let asked = command(&mut driven, "kim/c1", &Value::Null).unwrap();
    assert_eq!((&asked["id"], &asked["answer"]), (&again["id"], &again["answer"]));
    assert_eq!(command(&mut driven, "kim/c2", &Value::Null).unwrap(), Value::Null);
    let names: Vec<String> = outcomes(&driven).iter().map(|o| o.operator.to_string()).collect();
    assert_eq!(names, ["kim", "lee"]);
}

#[test]
fn what_a_suspect_has_answered_is_published_once_it_leads_again() {
    let mut driven = Driven::leading();
    driven.input(Input::LinkLost);
    set(&mut driven, "kim/c1", &json!({"teams": 7})).unwrap();
    driven.input(Input::LinkRestored);
    assert_eq!(outcomes(&driven), Vec::new());
    let query = driven.leader_queries().remove(0);
    driven.answer(&query, Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
    assert_eq!(outcomes(&driven).len(), 1);
    // The history has it from the events, of which readers expect higher and higher numbers.
    let events = |messages: &[Message]| -> Vec<(u64, &'static str)> {
        let name = |message: &Message| match message {
            Message::Event(event) => {
                let name = match event.kind {
                    EventKind::SettingsChanged { .. } => "changed",
                    EventKind::Commanded { .. } => "commanded",
                    _ => return None,
                };
                Some((event.header.revision.epoch, name))
            }
            _ => None,
        };
        messages.iter().filter_map(name).collect()
    };
    let all = [events(&driven.published), events(&driven.commanded)].concat();
    assert_eq!(all.iter().map(|(_, name)| *name).collect::<Vec<_>>(), ["changed", "commanded"]);
    let online = driven.published.iter().rev().find_map(|message| match message {
        Message::Event(event) if matches!(event.kind, EventKind::JobFailed { .. }) => {
            Some(event.header.revision.epoch)
        }
        _ => None,
    });
    assert!(all.iter().all(|(number, _)| Some(*number) < online), "{all:?}, {online:?}");
}

#[test]
fn a_command_that_is_given_again_is_confirmed_only_if_it_is_on_the_disk() {
    let mut driven = Driven::leading();
    driven.hold_stores = true;
    let now = driven.now.as_seconds();
    let content = json!({"sent": now, "expires": now + 60.0, "action": {"set": {"teams": 7}}});
    let give = |driven: &mut Driven, get: u64| {
        driven.input(Input::Get(IncomingGet {
            get: GetId(get),
            selector: "muster/v1/alpha/command/clusterer/kim/c1".to_owned(),
            narrowed: None,
            parameters: String::new(),
            payload: Some(content.to_string().into_bytes()),
        }));
    };
    let answers = |driven: &mut Driven| -> Vec<bool> {
        std::mem::take(&mut driven.replies).iter().map(|reply| reply.answer.is_ok()).collect()
    };
    let full = || Input::Stored { error: Some("the disk is full".to_owned()) };
    for get in [1, 2] {
        give(&mut driven, get);
    }
    assert!(answers(&mut driven).is_empty(), "it is being written");
    driven.input(full());
    assert_eq!(answers(&mut driven), [false, false]);
    give(&mut driven, 3);
    assert!(answers(&mut driven).is_empty(), "it is written again");
    driven.input(full());
    assert_eq!(answers(&mut driven), [false]);
    give(&mut driven, 4);
    driven.input(Input::Stored { error: None });
    assert_eq!(answers(&mut driven), [true]);
    give(&mut driven, 5);
    assert_eq!(answers(&mut driven), [true]);
    assert_eq!((driven.teams(), driven.counter("commands")), (7, 1));
}

#[test]
fn a_command_that_is_refused_by_what_it_asks_is_remembered_as_well() {
    let mut driven = Driven::leading();
    let error = set(&mut driven, "kim/c1", &json!({"teams": 0})).unwrap_err();
    assert!(error.contains("teams"), "{error}");
    assert_eq!(set(&mut driven, "kim/c1", &json!({"teams": 4})).unwrap_err(), error);
    assert_eq!(driven.teams(), small::AUTO);
    let refused = outcomes(&driven)[0].refused.clone();
    assert_eq!(refused, Some(error));
}

#[test]
fn what_is_too_late_from_another_clock_or_of_a_later_term_is_refused_with_the_reason() {
    let mut driven = Driven::leading();
    let now = driven.now.as_seconds();
    let term = driven.status().revision.term;
    let content = |change: Value| {
        let mut content =
            json!({"sent": now, "expires": now + 60.0, "action": {"set": {"teams": 7}}});
        content.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        content
    };
    let right = content(json!({}));
    for (number, (change, field)) in [
        (json!({"sent": now - 60.0, "expires": now + 1.0}), "sent"),
        (json!({"sent": now + 60.0, "expires": now + 70.0}), "sent"),
        (json!({"sent": now - 20.0, "expires": now - 1.0}), "expires"),
        (json!({"expires": now + 6000.0}), "expires"),
        (json!({"based_on": {"term": term + 1, "epoch": 1}}), "based_on"),
        (json!({"action": {"acknowledge": {"alert": 3}}}), "action"),
        (json!({"action": {"sett": {}}}), "action"),
        (json!({"who": "kim"}), "who"),
    ]
    .into_iter()
    .enumerate()
    {
        let key = format!("kim/c{number}");
        let error = command(&mut driven, &key, &content(change)).unwrap_err();
        assert!(error.contains(field), "{field}: {error}");
        let asked = command(&mut driven, &key, &Value::Null).unwrap();
        // What could not be decoded has no action that could be shown.
        assert_eq!(asked["action"].is_null(), number > 5, "{asked}");
        assert_eq!(asked["refused"], serde_json::from_str::<Value>(&error).unwrap());
        assert_eq!(asked["may_be_repeated"], field == "based_on");
        if field != "based_on" {
            assert_eq!(command(&mut driven, &key, &right), Err(error), "it is final");
        }
    }
    assert_eq!(driven.teams(), small::AUTO);
    assert_eq!((outcomes(&driven).len(), driven.counter("commands")), (8, 0));
    // A division that the instance had not received yet is known in a moment.
    let based = json!({"based_on": {"term": term, "epoch": 9}});
    command(&mut driven, "kim/c4", &content(based)).unwrap();
    let asked = command(&mut driven, "kim/c4", &Value::Null).unwrap();
    assert_eq!((driven.teams(), &asked["refused"]), (7, &Value::Null));
    let events = driven.commanded.iter().filter(|message| {
        matches!(message, Message::Event(event) if matches!(event.kind, EventKind::Commanded { .. }))
    });
    assert_eq!(events.count(), 9, "eight that are refused, and the last");
}

#[test]
fn commands_are_remembered_over_a_restart_and_by_a_standby_that_takes_over() {
    let mut driven = Driven::leading();
    driven.hold_stores = true;
    let now = driven.now.as_seconds();
    let content = json!({"sent": now, "expires": now + 60.0, "action": {"set": {"teams": 7}}});
    driven.input(Input::Get(IncomingGet {
        get: GetId(1),
        selector: "muster/v1/alpha/command/clusterer/kim/c1".to_owned(),
        narrowed: None,
        parameters: String::new(),
        payload: Some(content.to_string().into_bytes()),
    }));
    assert!(driven.replies.is_empty(), "it is answered once it is on the disk");
    let stored = driven.others.iter().rev().find_map(|command| match command {
        Command::Store(stored) => Some(stored.clone()),
        _ => None,
    });
    let stored = stored.unwrap();
    let text = serde_json::to_string(&stored).unwrap();
    assert_eq!(serde_json::from_str::<Stored>(&text).unwrap(), stored);
    let outcome = outcomes(&driven)[0].clone();

    let mut again = Driven::<ONE_LEADS>::with_stored(stored);
    again.input(Input::Started { linked: true });
    again.now = again.now.after(Duration::from_secs(2));
    again.answer_all(Vec::new());
    assert_eq!(again.host.replica_state(), ReplicaState::Leading);
    set(&mut again, "lee/c2", &json!({"teams": 9})).unwrap();
    set(&mut again, "kim/c1", &json!({"teams": 7})).unwrap();
    assert_eq!(again.teams(), 9);

    let mut standby = Driven::<ONE_LEADS>::answered(vec![renewal("a", 7, 5)]);
    standby.receive(token("a", true));
    assert_eq!(set(&mut standby, "kim/c3", &json!({"teams": 3})), Ok(Value::Null));
    standby.receive(Message::Outcome(outcome));
    standby.receive(token("a", false));
    standby.wait(0.5);
    standby.answer_all(Vec::new());
    assert_eq!(standby.host.replica_state(), ReplicaState::Leading);
    let before = standby.teams();
    set(&mut standby, "kim/c1", &json!({"teams": 7})).unwrap();
    assert_eq!(standby.teams(), before);
}

#[test]
fn an_instance_that_starts_carries_nothing_out() {
    let mut driven = Driven::<ONE_LEADS>::new();
    driven.input(Input::Started { linked: true });
    let error = set(&mut driven, "kim/c1", &json!({"teams": 7})).unwrap_err();
    assert!(error.contains("starting"), "{error}");
}

#[test]
fn ids_are_remembered_until_they_expire_and_no_more_than_that() {
    let mut driven = Driven::leading();
    for number in 0..MAX_REMEMBERED_COMMANDS {
        set(&mut driven, &format!("kim/c{number}"), &json!({"teams": 7})).unwrap();
    }
    let error = set(&mut driven, "kim/one-more", &json!({"teams": 8})).unwrap_err();
    assert!(error.contains("too many commands"), "{error}");
    // It is published, and displaces nothing that was carried out, also not where a standby learns all this.
    let refused = outcomes(&driven).pop().unwrap();
    assert_eq!((refused.refused.clone(), refused.may_be_repeated), (Some(error), true));
    let mut standby = Driven::<ONE_LEADS>::answered(vec![renewal("a", 7, 5)]);
    standby.receive(token("a", true));
    for outcome in outcomes(&driven) {
        standby.receive(Message::Outcome(outcome));
    }
    standby.receive(token("a", false));
    standby.wait(0.5);
    standby.answer_all(Vec::new());
    assert_eq!(standby.host.replica_state(), ReplicaState::Leading);
    let oldest = command(&mut standby, "kim/c0", &Value::Null).unwrap();
    assert_eq!(oldest["answer"]["teams"], 7, "{oldest}");
    driven.now = driven.now.after(Duration::from_secs(61));
    set(&mut driven, "kim/one-more", &json!({"teams": 8})).unwrap();
    assert_eq!(driven.teams(), 8);
    let now = driven.now.as_seconds();
    let old = json!({"sent": now - 25.0, "expires": now - 1.0, "action": {"set": {"teams": 7}}});
    let error = command(&mut driven, "kim/c0", &old).unwrap_err();
    assert!(error.contains("expires"), "{error}");
    assert_eq!(ServiceName::Clusterer, outcomes(&driven)[0].service);
}

/// A program with a wrong clock neither takes memory nor displaces what was carried out.
#[test]
fn refused_commands_are_remembered_in_a_bounded_number_and_displace_none_that_was_carried_out() {
    let mut driven = Driven::leading();
    set(&mut driven, "kim/first", &json!({"teams": 7})).unwrap();
    set(&mut driven, "kim/second", &json!({"teams": 8})).unwrap();
    let now = driven.now.as_seconds();
    let late = json!({"sent": now, "expires": now - 1.0, "action": {"set": {"teams": 3}}});
    for number in 0..3 * MAX_REMEMBERED_COMMANDS {
        command(&mut driven, &format!("lee/c{number}"), &late).unwrap_err();
    }
    let known = |driven: &mut Driven, key: &str| command(driven, key, &Value::Null).unwrap();
    let numbers = 0..3 * MAX_REMEMBERED_COMMANDS;
    let kept = numbers.filter(|number| !known(&mut driven, &format!("lee/c{number}")).is_null());
    assert_eq!(kept.count(), MAX_REMEMBERED_REFUSALS);
    // Sent again, what was carried out first does not hide what came after it.
    set(&mut driven, "kim/first", &json!({"teams": 7})).unwrap();
    assert_eq!(driven.teams(), 8);
    for number in 2..MAX_REMEMBERED_COMMANDS {
        set(&mut driven, &format!("kim/c{number}"), &json!({"teams": 9})).unwrap();
    }
}

/// The operator asked all instances, and the next leader was too slow to look at it before it led.
#[test]
fn what_an_earlier_leader_has_refused_is_not_carried_out_by_the_next_one_from_a_late_copy() {
    let mut old = Driven::<ONE_LEADS>::leading();
    let problem = set(&mut old, "kim/c1", &json!({"teams": 0})).unwrap_err();
    let refused = outcomes(&old)[0].clone();
    let stored = Stored { term: old.stored.term, ..Stored::default() };
    let mut next = Driven::<ONE_LEADS>::restarted(stored, Vec::new());
    let term = next.status().revision.term;
    for (header_term, repeats) in [(term + 1, false), (term - 1, true)] {
        let mut said = CommandOutcome::clone(&refused);
        said.header.revision.term = header_term;
        next.receive(Message::Outcome(Arc::new(said)));
        let answer = set(&mut next, "kim/c1", &json!({"teams": 0})).unwrap_err();
        assert_eq!(answer, problem);
        assert_eq!(next.counter("commands_again"), u64::from(repeats));
        next = Driven::<ONE_LEADS>::restarted(
            Stored { term: old.stored.term, ..Stored::default() },
            Vec::new(),
        );
    }
}

/// Two led for a while, and an operator's command reached both. The clock of one was wrong, so that it refused the command.
#[test]
fn what_one_leader_has_carried_out_counts_where_another_one_has_refused_it() {
    let mut former = Driven::<ONE_LEADS>::leading();
    set(&mut former, "kim/c1", &json!({"teams": 7})).unwrap();
    let confirmed = outcomes(&former)[0].clone();
    let Revision { term, epoch } = confirmed.header.revision;
    let answers = vec![renewal("a", term, epoch), settings(term, epoch, 5)];
    let mut leader = Driven::<ONE_LEADS>::answered(answers);
    small::take_over(&mut leader);
    let now = leader.now.as_seconds();
    let content =
        json!({"sent": now - 60.0, "expires": now + 1.0, "action": {"set": {"teams": 7}}});
    command(&mut leader, "kim/c1", &content).unwrap_err();
    let refused = outcomes(&leader)[0].clone();
    assert_eq!(leader.teams(), 5);
    leader.receive(Message::Outcome(confirmed));
    assert_eq!(leader.teams(), 7);
    leader.receive(Message::Outcome(refused));
    assert!(command(&mut leader, "kim/c1", &Value::Null).unwrap()["refused"].is_null());
}
