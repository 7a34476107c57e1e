//! What operators command is done once, by whom they say they are, and remembered.

use std::sync::Arc;
use std::time::Duration;

use crate::small::{self, Driven, ONE_LEADS, START, renewal, settings, settings_sent, token};
use muster_model::command::{CommandOutcome, MAX_REMEMBERED_COMMANDS, MAX_REMEMBERED_REFUSALS};
use muster_model::event::EventKind;
use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_model::settings::ClustererSettings;
use muster_service::{Command, GetId, IncomingGet, Input, Stored};
use muster_wire::Message;
use serde_json::{Value, json};

/// Sends a command and returns its answer.
fn command(driven: &mut Driven, key: &str, content: &Value) -> Result<Value, String> {
    let before = driven.replies.len();
    let get = GetId(1000 + before as u64);
    driven.input(Input::Get(IncomingGet {
        get,
        selector: format!("muster/v1/alpha/command/clusterer/{key}"),
        narrowed: None,
        parameters: String::new(),
        payload: (!content.is_null()).then(|| content.to_string().into_bytes()),
    }));
    assert_eq!(driven.replies.len(), before + 1, "one answer");
    let answer = driven.replies[before].answer.clone()?;
    let Some(packet) = answer.first() else { return Ok(Value::Null) };
    assert_eq!(packet.key, format!("muster/v1/alpha/command/clusterer/{key}"));
    Ok(serde_json::from_slice(packet.payload.as_ref().unwrap()).unwrap())
}

fn set(driven: &mut Driven, key: &str, patch: &Value) -> Result<Value, String> {
    let now = driven.now.as_seconds();
    let content = json!({"sent": now, "expires": now + 60.0, "action": {"set": patch}});
    command(driven, key, &content)
}

fn outcomes(driven: &Driven) -> Vec<Arc<CommandOutcome>> {
    let outcome = |message: &Message| match message {
        Message::Outcome(outcome) => Some(Arc::clone(outcome)),
        _ => None,
    };
    driven.commanded.iter().filter_map(outcome).collect()
}

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

/// A standby of a leader that had five teams, which has confirmed another number, and the outcome of that command.
fn after_a_change(teams: u32) -> (Driven<ONE_LEADS>, Arc<CommandOutcome>) {
    let mut leader = Driven::<ONE_LEADS>::leading();
    // The settings that the standby has were sent before.
    leader.wait(0.1);
    set(&mut leader, "kim/c1", &json!({"teams": teams})).unwrap();
    let outcome = outcomes(&leader)[0].clone();
    let Revision { term, epoch } = outcome.header.revision;
    let standby = Driven::answered(vec![renewal("a", term, epoch), settings(term, epoch, 5)]);
    assert_eq!((standby.host.replica_state(), standby.teams()), (ReplicaState::Standby, 5));
    (standby, outcome)
}

/// The leader is gone, and no instance answers.
fn take_over(driven: &mut Driven<ONE_LEADS>) {
    driven.receive(token("a", true));
    driven.receive(token("a", false));
    driven.wait(0.5);
    driven.answer_all(Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
}

#[test]
fn a_change_whose_announcement_was_lost_with_the_leader_holds_by_its_outcome() {
    let (mut standby, outcome) = after_a_change(7);
    standby.receive(Message::Outcome(Arc::clone(&outcome)));
    assert_eq!(standby.teams(), 5, "the leader says what holds");
    take_over(&mut standby);
    assert_eq!((standby.teams(), standby.announced()[0]), (7, 7));
    // What the leader announced later counts, and no change before that.
    let (mut standby, outcome) = after_a_change(7);
    let Revision { term, epoch } = outcome.header.revision;
    standby.receive(Message::Outcome(outcome));
    standby.receive(settings(term, epoch, 7));
    standby.receive(settings(term, epoch + 1, 6));
    take_over(&mut standby);
    assert_eq!(standby.teams(), 6);
}

/// A leader that has published nothing changes its settings under one revision.
#[test]
fn a_change_from_before_the_settings_of_the_same_revision_does_not_come_back() {
    let mut leader = Driven::<ONE_LEADS>::leading();
    set(&mut leader, "kim/c1", &json!({"teams": 7})).unwrap();
    leader.wait(1.0);
    let outcome = outcomes(&leader)[0].clone();
    let Revision { term, epoch } = outcome.header.revision;
    let later = settings_sent(leader.now, term, epoch, 6);
    let mut standby = Driven::<ONE_LEADS>::answered(vec![renewal("a", term, epoch), later]);
    standby.receive(Message::Outcome(outcome));
    take_over(&mut standby);
    assert_eq!(standby.teams(), 6);
}

/// It led with settings from before the change, and has confirmed another one since, which says nothing of the first.
#[test]
fn a_change_that_a_leader_did_not_know_counts_after_its_restart() {
    let (mut standby, outcome) = after_a_change(7);
    take_over(&mut standby);
    set(&mut standby, "kim/c2", &json!({"restarts": 9})).unwrap();
    let stored = standby.stored.clone();
    let said = Message::Outcome(outcome);
    let new = Driven::<ONE_LEADS>::restarted(stored.clone(), vec![said.clone()]);
    assert_eq!((new.host.replica_state(), new.teams()), (ReplicaState::Leading, 7));
    let mut new = Driven::<ONE_LEADS>::restarted(stored, Vec::new());
    new.receive(said);
    assert_eq!((new.teams(), new.host.core().restarts), (7, 9));
}

#[test]
fn a_leader_that_is_back_says_what_it_had_confirmed() {
    let mut old = Driven::<ONE_LEADS>::leading();
    set(&mut old, "kim/c1", &json!({"teams": 7})).unwrap();
    let said = outcomes(&old);
    old.receive(token("a", true));
    // What is not answered is asked for again for two seconds.
    for epoch in 5..11 {
        old.receive(renewal("a", said[0].header.revision.term + 1, epoch));
        old.answer_all(Vec::new());
        old.wait(0.5);
    }
    assert_eq!(old.host.replica_state(), ReplicaState::Standby);
    // What it says once may be lost: it says it with three renewals as it follows the new leader, once more when what it asked
    // then is answered, and with three more renewals.
    for epoch in 11..20 {
        old.receive(renewal("a", said[0].header.revision.term + 1, epoch));
        old.wait(0.5);
    }
    assert_eq!(outcomes(&old), vec![Arc::clone(&said[0]); 8]);

    let (mut new, outcome) = after_a_change(7);
    take_over(&mut new);
    assert_eq!((new.teams(), new.announced().pop()), (5, Some(5)));
    new.receive(Message::Outcome(Arc::clone(&outcome)));
    assert_eq!((new.teams(), new.announced()), (7, vec![7]));
    new.receive(Message::Outcome(outcome));
    assert!(new.announced().is_empty(), "it was known");

    // What was commanded since stays, and so do settings that are of after the change.
    let (mut new, outcome) = after_a_change(7);
    take_over(&mut new);
    set(&mut new, "lee/c9", &json!({"teams": 9})).unwrap();
    new.receive(Message::Outcome(outcome));
    assert_eq!(new.teams(), 9);
    let (mut new, outcome) = after_a_change(7);
    let Revision { term, epoch } = outcome.header.revision;
    new.receive(settings(term, epoch + 1, 6));
    take_over(&mut new);
    new.receive(Message::Outcome(outcome));
    assert_eq!(new.teams(), 6);
}

#[test]
fn an_outcome_from_before_the_settings_on_the_disk_changes_nothing_after_a_restart_of_everything() {
    let mut leader = Driven::<ONE_LEADS>::leading();
    set(&mut leader, "kim/c1", &json!({"teams": 7})).unwrap();
    set(&mut leader, "kim/c2", &json!({"teams": 6})).unwrap();
    let said = outcomes(&leader);
    let Revision { term, epoch } = said[1].header.revision;
    // A standby that was cut off missed the first command, and has the settings of after the second.
    let answers = vec![renewal("a", term, epoch), settings_sent(leader.now, term, epoch, 6)];
    let mut standby = Driven::<ONE_LEADS>::answered(answers);
    standby.receive(Message::Outcome(Arc::clone(&said[1])));
    let stored = standby.stored.clone();
    assert_eq!(stored.commands.len(), 1);
    let restarted = |answers: Vec<Message>| Driven::<ONE_LEADS>::restarted(stored.clone(), answers);
    // Another instance gives it the outcome of the first before it leads, or afterwards.
    let new = restarted(vec![Message::Outcome(Arc::clone(&said[0]))]);
    assert_eq!((new.host.replica_state(), new.teams()), (ReplicaState::Leading, 6));
    let mut new = restarted(Vec::new());
    new.receive(Message::Outcome(Arc::clone(&said[0])));
    assert_eq!((new.host.replica_state(), new.teams()), (ReplicaState::Leading, 6));
}

/// Two led for a while, and both carried out both commands of an operator. Of the second one, the outcome of the leader
/// with the higher term is lost.
#[test]
fn a_command_that_was_replaced_by_a_later_one_does_not_come_back_with_a_higher_term() {
    let mut leader = Driven::<ONE_LEADS>::leading();
    set(&mut leader, "kim/c1", &json!({"teams": 7})).unwrap();
    leader.wait(1.0);
    set(&mut leader, "kim/c2", &json!({"teams": 6})).unwrap();
    let said = outcomes(&leader);
    let Revision { term, epoch } = said[1].header.revision;
    let answers = vec![renewal("a", term, epoch), settings(term, epoch, 6)];
    let mut standby = Driven::<ONE_LEADS>::answered(answers);
    standby.receive(Message::Outcome(Arc::clone(&said[1])));
    let mut first = CommandOutcome::clone(&said[0]);
    first.header.revision = Revision { term: term + 1, epoch: 0 };
    let first = Message::Outcome(Arc::new(first));
    let stored = Stored { term: term + 1, ..standby.stored.clone() };
    let new = Driven::<ONE_LEADS>::restarted(stored.clone(), vec![first.clone()]);
    assert_eq!((new.host.replica_state(), new.teams()), (ReplicaState::Leading, 6));
    let mut new = Driven::<ONE_LEADS>::restarted(stored, Vec::new());
    new.receive(first);
    assert_eq!((new.host.replica_state(), new.teams()), (ReplicaState::Leading, 6));
}

/// The leader has published nothing yet, so that its settings have the same revision before and after the change. An instance that
/// starts waits two seconds for answers that are lost, and has received those settings long before.
#[test]
fn an_answer_from_before_a_change_does_not_replace_the_settings_of_the_same_revision() {
    let mut starting = Driven::<ONE_LEADS>::new();
    starting.now = START.before(Duration::from_secs(2));
    starting.input(Input::Started { linked: true });
    let mut leader = Driven::<ONE_LEADS>::leading();
    set(&mut leader, "kim/c1", &json!({"teams": 7})).unwrap();
    let Revision { term, epoch } = outcomes(&leader)[0].header.revision;
    starting.receive(settings(term, epoch, 5));
    starting.receive(settings(term, epoch, 7));
    assert_eq!(starting.teams(), 7);
    starting.now = START;
    let before = settings_sent(START.before(Duration::from_secs(2)), term, epoch, 5);
    starting.answer_all(vec![renewal("a", term, epoch), before]);
    assert_eq!((starting.host.replica_state(), starting.teams()), (ReplicaState::Standby, 7));
}

/// The leader was killed, and another one, which had been cut off and never received its term, was the only one for a while.
#[test]
fn a_change_that_a_leader_of_a_lower_term_has_confirmed_holds_after_a_restart() {
    let mut cut_off = Driven::<ONE_LEADS>::leading();
    set(&mut cut_off, "kim/c1", &json!({"teams": 7})).unwrap();
    let confirmed = outcomes(&cut_off)[0].clone();
    let killed = Stored { term: confirmed.header.revision.term + 1, ..Stored::default() };
    let answers = vec![Message::Outcome(Arc::clone(&confirmed))];
    let new = Driven::<ONE_LEADS>::restarted(killed.clone(), answers);
    assert_eq!((new.host.replica_state(), new.teams()), (ReplicaState::Leading, 7));
    // What a leader announces counts more than what is on the disk.
    let term = killed.term + 1;
    let answers = vec![renewal("a", term, 1), settings(term, 1, 5)];
    let mut standby = Driven::<ONE_LEADS>::restarted(killed, answers);
    standby.receive(Message::Outcome(confirmed));
    take_over(&mut standby);
    assert_eq!(standby.teams(), 5);
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

/// Both changes have the revision of a leader that has published nothing.
#[test]
fn a_change_after_the_stored_one_holds_though_its_leader_has_published_nothing_in_between() {
    let mut cut_off = Driven::<ONE_LEADS>::leading();
    set(&mut cut_off, "kim/c1", &json!({"teams": 7})).unwrap();
    let stored = Stored { term: cut_off.stored.term + 1, ..cut_off.stored.clone() };
    assert_eq!(stored.commands.len(), 1);
    cut_off.wait(1.0);
    set(&mut cut_off, "kim/c2", &json!({"teams": 6})).unwrap();
    let said = outcomes(&cut_off);
    assert_eq!(said[0].header.revision, said[1].header.revision);
    for (outcomes, teams) in [(&said[..1], 7), (&said[..], 6)] {
        let answers = outcomes.iter().cloned().map(Message::Outcome).collect();
        let new = Driven::<ONE_LEADS>::restarted(stored.clone(), answers);
        assert_eq!((new.host.replica_state(), new.teams()), (ReplicaState::Leading, teams));
    }
}

/// That it has led, and was killed, makes its settings no better.
#[test]
fn a_leader_that_knows_no_settings_of_the_fleet_announces_none_after_a_restart_either() {
    let announced = |driven: &Driven<ONE_LEADS>| -> Option<u64> {
        let of_settings = |message: &Message| {
            let Message::Settings(announced) = message else { return None };
            Some(announced.header.revision.term)
        };
        driven.published.iter().rev().find_map(of_settings)
    };
    let led = Driven::<ONE_LEADS>::leading();
    let mut again = Driven::<ONE_LEADS>::restarted(led.stored.clone(), Vec::new());
    assert_eq!((again.host.replica_state(), announced(&again)), (ReplicaState::Leading, Some(0)));
    // What an operator changes is the fleet's.
    set(&mut again, "kim/c1", &json!({"teams": 7})).unwrap();
    let after = Driven::<ONE_LEADS>::restarted(again.stored.clone(), Vec::new());
    assert_eq!(announced(&after), Some(again.stored.term + 1));
    // So is what a leader announces, even where nothing in it is new.
    let standby = || {
        let answers = vec![renewal("a", led.stored.term + 1, 5)];
        Driven::<ONE_LEADS>::restarted(led.stored.clone(), answers)
    };
    let Message::Settings(mut same) = settings(led.stored.term + 1, 5, 5) else { unreachable!() };
    same.settings = serde_json::to_string(&ClustererSettings::default()).unwrap();
    let mut follower = standby();
    follower.receive(Message::Settings(same));
    assert!(standby().stored.lacks_settings && !follower.stored.lacks_settings);
}

/// Two that did not hear each other have begun the same term, and an operator's commands have reached one each.
#[test]
fn a_change_that_another_leader_of_the_same_term_has_confirmed_holds_unless_a_later_one_replaced_it()
 {
    let [mut first, mut second] = [(), ()].map(|()| Driven::<ONE_LEADS>::leading());
    set(&mut first, "kim/c1", &json!({"teams": 7})).unwrap();
    let said = outcomes(&first)[0].clone();
    second.receive(Message::Outcome(Arc::clone(&said)));
    assert_eq!(second.teams(), 7);
    second.wait(1.0);
    set(&mut second, "kim/c2", &json!({"teams": 6})).unwrap();
    let answer = outcomes(&second)[0].clone();
    assert_eq!(answer.header.revision.term, said.header.revision.term);
    first.receive(Message::Outcome(Arc::clone(&answer)));
    assert_eq!(first.teams(), 6);
    // The earlier one does not come back.
    let mut third = Driven::<ONE_LEADS>::leading();
    third.wait(1.0);
    set(&mut third, "kim/c3", &json!({"teams": 8})).unwrap();
    third.receive(Message::Outcome(said));
    assert_eq!(third.teams(), 8);
}

/// What it asked as it began may be answered seconds after it has received a renewal, and its leader may be gone by then.
#[test]
fn an_instance_that_is_back_says_what_it_had_confirmed_as_soon_as_it_follows_a_leader() {
    let mut old = Driven::<ONE_LEADS>::leading();
    set(&mut old, "kim/c1", &json!({"teams": 7})).unwrap();
    let said = outcomes(&old);
    let mut back = Driven::<ONE_LEADS>::with_stored(old.stored.clone());
    back.input(Input::Started { linked: true });
    back.receive(token("a", true));
    assert_eq!(outcomes(&back), Vec::new());
    back.receive(renewal("a", said[0].header.revision.term + 1, 5));
    assert_eq!(back.host.replica_state(), ReplicaState::Standby);
    assert_eq!(outcomes(&back), said);
}

/// It asks what there is for two seconds, and its leader may be gone by then.
#[test]
fn a_change_that_its_own_leader_could_not_hear_of_holds_when_an_instance_leads_again() {
    let mut old = Driven::<ONE_LEADS>::leading();
    set(&mut old, "kim/c0", &json!({"teams": 5})).unwrap();
    set(&mut old, "kim/c1", &json!({"teams": 7})).unwrap();
    let term = outcomes(&old)[0].header.revision.term + 1;
    old.receive(token("a", true));
    old.receive(renewal("a", term, 5));
    assert_eq!(old.host.replica_state(), ReplicaState::Starting);
    old.receive(settings(term, 5, 5));
    assert_eq!(old.teams(), 5);
    old.receive(token("a", false));
    old.wait(3.0);
    old.answer_all(Vec::new());
    assert_eq!((old.host.replica_state(), old.teams()), (ReplicaState::Leading, 7));
}

/// An instance that has confirmed 5 teams and then 7, stood down for a leader that has another number, and receives renewals and settings
/// of that one.
fn following_after_a_change(renewals: u64, teams: u32) -> Driven<ONE_LEADS> {
    let mut old = Driven::<ONE_LEADS>::leading();
    set(&mut old, "kim/c0", &json!({"teams": 5})).unwrap();
    set(&mut old, "kim/c1", &json!({"teams": 7})).unwrap();
    let term = outcomes(&old)[0].header.revision.term + 1;
    old.receive(token("a", true));
    old.receive(renewal("a", term, 5));
    old.wait(3.0);
    old.answer_all(vec![renewal("a", term, 5), settings(term, 5, teams)]);
    for epoch in 6..6 + renewals {
        old.receive(renewal("a", term, epoch));
        old.receive(settings(term, epoch, teams));
        old.wait(0.5);
    }
    assert_eq!((old.host.replica_state(), old.teams()), (ReplicaState::Standby, teams));
    old.receive(token("a", false));
    old.wait(3.0);
    old.answer_all(Vec::new());
    assert_eq!(old.host.replica_state(), ReplicaState::Leading);
    old
}

/// What it says of that to the new leader may be lost, and the leader right after it.
#[test]
fn a_change_holds_that_was_said_to_a_leader_that_has_not_announced_it() {
    assert_eq!(following_after_a_change(1, 5).teams(), 7);
}

/// A leader that has received it for seconds and announces something else has been given another command since.
#[test]
fn a_change_that_a_leader_has_long_received_holds_no_more() {
    assert_eq!(following_after_a_change(5, 5).teams(), 5);
}

/// It has been given another command by the time, which this instance has not received.
#[test]
fn a_change_does_not_hold_against_a_number_that_there_was_not_before() {
    assert_eq!(following_after_a_change(1, 6).teams(), 6);
}

/// The term of the leader that [`back_above_its_leader`] finds.
const LOWER: u64 = 8;

/// An instance that has led a higher term than the leader that it finds, and has confirmed 7 teams to that one's 5.
fn back_above_its_leader() -> Driven<ONE_LEADS> {
    let mut old = Driven::<ONE_LEADS>::leading();
    set(&mut old, "kim/c1", &json!({"teams": 7})).unwrap();
    let mut stored = Stored { term: LOWER + 1, ..old.stored.clone() };
    for outcome in &mut stored.commands {
        outcome.header.revision.term = stored.term;
    }
    let answers = vec![renewal("a", LOWER, 5), settings(LOWER, 5, 5)];
    let mut back = Driven::<ONE_LEADS>::restarted(stored, answers);
    assert_eq!((back.host.replica_state(), back.teams()), (ReplicaState::Standby, 7));
    back.receive(token("a", true));
    back
}

/// A leader that was cut off begins again with an old term, as the only one. Who has led since takes over with what it knows.
#[test]
fn settings_of_a_leader_of_a_lower_term_do_not_replace_those_of_the_term_on_the_disk() {
    let mut back = back_above_its_leader();
    for epoch in 6..9 {
        back.receive(settings(LOWER, epoch, 5));
        back.receive(renewal("a", LOWER, epoch));
        back.wait(0.5);
        back.answer_all(vec![settings(LOWER, epoch, 5)]);
    }
    assert_eq!((back.host.replica_state(), back.teams()), (ReplicaState::Leading, 7));
}

/// Until it is replaced, a leader of a lower term confirms changes as any other. What it has confirmed as a suspect is known to
/// whoever asks alone.
#[test]
fn a_change_that_a_leader_of_a_lower_term_confirms_holds_after_it_is_replaced() {
    let mut other = Driven::<ONE_LEADS>::leading();
    other.wait(1.0);
    set(&mut other, "kim/c2", &json!({"teams": 4})).unwrap();
    let mut confirmed = CommandOutcome::clone(&outcomes(&other)[0]);
    confirmed.header.revision = Revision { term: LOWER, epoch: 5 };
    let confirmed = Message::Outcome(Arc::new(confirmed));
    for is_published in [true, false] {
        let mut back = back_above_its_leader();
        if is_published {
            back.receive(confirmed.clone());
        }
        for epoch in 6..9 {
            back.receive(renewal("a", LOWER, epoch));
            back.wait(0.5);
            let answered = (!is_published).then(|| confirmed.clone());
            back.answer_all([settings(LOWER, epoch, 4)].into_iter().chain(answered).collect());
        }
        assert_eq!((back.host.replica_state(), back.teams()), (ReplicaState::Leading, 4));
    }
}

/// What is said again is taken for what its sender has answered.
#[test]
fn a_leader_that_is_back_says_nothing_that_another_leader_of_its_term_has_answered() {
    let [mut other, mut old] = [(), ()].map(|()| Driven::<ONE_LEADS>::leading());
    set(&mut other, "kim/c1", &json!({"teams": 7})).unwrap();
    let said = outcomes(&other)[0].clone();
    old.receive(Message::Outcome(Arc::clone(&said)));
    old.receive(token("a", true));
    for epoch in 5..20 {
        old.receive(renewal("a", said.header.revision.term + 1, epoch));
        old.answer_all(Vec::new());
        old.wait(0.5);
    }
    assert_eq!(old.host.replica_state(), ReplicaState::Standby);
    assert_eq!(outcomes(&old), Vec::new());
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
    take_over(&mut leader);
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
