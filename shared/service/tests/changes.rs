//! What operators have changed of the settings holds, whichever instances have received it, and of two changes the later one.

use std::sync::Arc;
use std::time::Duration;

use crate::small::{
    Driven, ONE_LEADS, START, outcomes, renewal, set, settings, settings_changed, take_over, token,
};
use muster_model::command::CommandOutcome;
use muster_model::role::ReplicaState;
use muster_model::settings::ClustererSettings;
use muster_model::time::Tick;
use muster_service::Stored;
use muster_wire::Message;
use serde_json::json;

/// When a second has passed since the start.
fn second(number: f64) -> Tick {
    START.after(Duration::from_secs_f64(number))
}

/// What came of a command that another leader carried out a while after the start.
fn outcome_of(teams: u32, seconds: f64) -> Arc<CommandOutcome> {
    let mut leader = Driven::<ONE_LEADS>::leading();
    leader.wait(seconds);
    set(&mut leader, &format!("kim/c{teams}"), &json!({"teams": teams})).unwrap();
    let outcome = outcomes(&leader)[0].clone();
    assert_eq!(outcome.changed.as_ref().unwrap().at, second(seconds));
    outcome
}

/// A standby of a leader of that term, which has five teams by its file.
fn standby(term: u64) -> Driven<ONE_LEADS> {
    let mut standby = Driven::answered(vec![renewal("a", term, 5), settings(term, 5, 5)]);
    standby.receive(token("a", true));
    assert_eq!((standby.host.replica_state(), standby.teams()), (ReplicaState::Standby, 5));
    standby
}

#[test]
fn a_change_whose_announcement_was_lost_with_the_leader_holds_by_its_outcome() {
    let outcome = outcome_of(7, 1.0);
    let mut driven = standby(7);
    driven.receive(Message::Outcome(Arc::clone(&outcome)));
    assert_eq!((driven.teams(), driven.stored.changed["teams"]), (7, second(1.0)));
    take_over(&mut driven);
    assert_eq!((driven.teams(), driven.announced()[0]), (7, 7));
    // What was changed later counts, in whatever order and of whatever leader it comes.
    for later in [settings_changed(second(2.0), 7, 4, 6), settings_changed(second(2.0), 6, 9, 6)] {
        for first in [true, false] {
            let mut driven = standby(7);
            let said = [Message::Outcome(Arc::clone(&outcome)), later.clone()];
            let [one, other] = if first {
                said
            } else {
                let [one, other] = said;
                [other, one]
            };
            driven.receive(one);
            driven.receive(other);
            take_over(&mut driven);
            assert_eq!(driven.teams(), 6);
        }
    }
}

#[test]
fn what_a_leader_has_by_its_file_replaces_no_change_of_an_operator() {
    let mut driven = standby(7);
    driven.receive(settings(7, 6, 4));
    assert_eq!(driven.teams(), 4);
    driven.receive(Message::Outcome(outcome_of(7, 1.0)));
    driven.receive(settings(7, 7, 3));
    assert_eq!(driven.teams(), 7);
    driven.receive(token("b", true));
    driven.receive(renewal("b", 8, 0));
    driven.receive(settings(8, 0, 2));
    assert_eq!(driven.teams(), 7);
}

#[test]
fn a_standby_says_what_its_leader_does_not_have_until_that_announces_it() {
    let outcome = outcome_of(7, 1.0);
    let mut driven = standby(7);
    driven.receive(Message::Outcome(Arc::clone(&outcome)));
    assert_eq!(outcomes(&driven), Vec::new());
    for count in 1..20 {
        driven.receive(settings(7, 5 + count, 5));
        assert_eq!(outcomes(&driven), vec![Arc::clone(&outcome); usize::try_from(count).unwrap()]);
    }
    // Neither another leader's settings, nor those that have the change, nor a later one.
    driven.receive(settings(6, 9, 5));
    driven.receive(settings_changed(second(1.0), 7, 30, 7));
    driven.receive(settings_changed(second(1.5), 7, 31, 6));
    assert_eq!((outcomes(&driven).len(), driven.teams()), (19, 6));
}

#[test]
fn an_instance_that_is_back_says_what_it_had_confirmed_to_the_leader_that_it_finds() {
    let mut old = Driven::<ONE_LEADS>::leading();
    set(&mut old, "kim/c1", &json!({"teams": 7})).unwrap();
    let said = outcomes(&old);
    let term = said[0].header.revision.term + 1;
    // After a restart, and after it has stood down.
    let answers = vec![renewal("a", term, 5), settings(term, 5, 5)];
    let back = Driven::<ONE_LEADS>::restarted(old.stored.clone(), answers.clone());
    assert_eq!((back.host.replica_state(), back.teams()), (ReplicaState::Standby, 7));
    assert_eq!(outcomes(&back), said);
    old.receive(token("a", true));
    old.receive(renewal("a", term, 5));
    assert_eq!(old.host.replica_state(), ReplicaState::Starting);
    old.answer_all(answers);
    old.wait(2.5);
    old.answer_all(Vec::new());
    assert_eq!((old.host.replica_state(), old.teams()), (ReplicaState::Standby, 7));
    assert_eq!(outcomes(&old), [&said[0], &said[0]].map(Arc::clone));
}

#[test]
fn a_leader_takes_over_later_changes_of_others_and_announces_them() {
    let mut leader = Driven::<ONE_LEADS>::leading();
    leader.wait(1.0);
    set(&mut leader, "lee/c1", &json!({"teams": 9})).unwrap();
    leader.announced();
    leader.receive(Message::Outcome(outcome_of(6, 0.5)));
    assert_eq!((leader.teams(), leader.announced()), (9, vec![]), "it is older");
    let later = outcome_of(7, 1.5);
    leader.receive(Message::Outcome(Arc::clone(&later)));
    assert_eq!((leader.teams(), leader.announced()), (7, vec![7]));
    assert_eq!(leader.stored.changed["teams"], second(1.5));
    leader.receive(Message::Outcome(later));
    assert!(leader.announced().is_empty(), "it was known");
    // A leader that it does not know of yet, or one before it, has announced another.
    leader.receive(settings_changed(second(1.7), 90, 1, 8));
    assert_eq!((leader.teams(), leader.announced()), (8, vec![8]));
    leader.receive(settings(90, 2, 4));
    assert_eq!((leader.teams(), leader.counter("settings_recovered")), (8, 2));
    // What an operator changes now is later, whatever the clocks say.
    set(&mut leader, "lee/c2", &json!({"teams": 3, "restarts": 9})).unwrap();
    let both = outcomes(&leader).pop().unwrap();
    assert_eq!((leader.teams(), both.changed.as_ref().unwrap().at), (3, Tick(second(1.7).0 + 1)));
}

#[test]
fn changes_of_different_fields_do_not_depend_on_each_other() {
    let mut leader = Driven::<ONE_LEADS>::leading();
    leader.wait(3.0);
    set(&mut leader, "kim/c1", &json!({"restarts": 9})).unwrap();
    leader.receive(Message::Outcome(outcome_of(7, 1.0)));
    assert_eq!((leader.teams(), leader.host.core().restarts), (7, 9));
    let again = Driven::<ONE_LEADS>::restarted(leader.stored.clone(), Vec::new());
    assert_eq!((again.teams(), again.host.core().restarts), (7, 9));
    let mut again = Driven::<ONE_LEADS>::restarted(leader.stored.clone(), Vec::new());
    again.receive(Message::Outcome(outcome_of(6, 0.5)));
    again.receive(settings_changed(second(0.7), 7, 1, 5));
    assert_eq!(again.teams(), 7);
}

/// Two that did not receive each other have begun the same term, and an operator's commands have reached one each.
#[test]
fn of_two_leaders_of_one_term_the_later_command_counts() {
    let [mut first, mut second] = [(), ()].map(|()| Driven::<ONE_LEADS>::leading());
    set(&mut first, "kim/c1", &json!({"teams": 7})).unwrap();
    second.wait(1.0);
    set(&mut second, "kim/c2", &json!({"teams": 6})).unwrap();
    let said = [outcomes(&first)[0].clone(), outcomes(&second)[0].clone()];
    assert_eq!(said[0].header.revision.term, said[1].header.revision.term);
    for outcome in said {
        first.receive(Message::Outcome(Arc::clone(&outcome)));
        second.receive(Message::Outcome(outcome));
    }
    assert_eq!((first.teams(), second.teams()), (6, 6));
}

#[test]
fn dates_that_no_operator_can_have_sent_are_refused() {
    let mut driven = standby(7);
    let mut forged = CommandOutcome::clone(&outcome_of(9, 1.0));
    forged.changed.as_mut().unwrap().at = Tick(1 << 53);
    driven.receive(Message::Outcome(Arc::new(forged)));
    driven.receive(settings_changed(Tick(u64::MAX), 7, 6, 9));
    assert_eq!((driven.teams(), driven.counter("dates_refused")), (5, 2));
    // A damaged file keeps its values; the next change of any operator is later.
    let patch = json!({"teams": 9}).as_object().unwrap().clone();
    let changed = [("teams".to_owned(), Tick(u64::MAX))].into_iter().collect();
    let stored = Stored { term: 3, patch, changed, ..Stored::default() };
    let mut driven = Driven::<ONE_LEADS>::restarted(stored, Vec::new());
    assert_eq!(driven.teams(), 9);
    driven.receive(Message::Outcome(outcome_of(7, 1.0)));
    assert_eq!(driven.teams(), 7);
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

/// A leader that was cut off begins again with an old term, as the only one. Who has led since takes over with what it knows.
#[test]
fn an_instance_that_has_led_a_higher_term_takes_over_with_its_settings_and_what_was_changed_since()
{
    const LOWER: u64 = 8;
    let patch = json!({"teams": 7}).as_object().unwrap().clone();
    let stored = Stored { term: LOWER + 1, patch, ..Stored::default() };
    for (announced, teams) in
        [(settings(LOWER, 6, 5), 7), (settings_changed(second(1.0), LOWER, 6, 5), 5)]
    {
        let answers = vec![renewal("a", LOWER, 5), announced.clone()];
        let mut back = Driven::<ONE_LEADS>::restarted(stored.clone(), answers);
        assert_eq!((back.host.replica_state(), back.teams()), (ReplicaState::Standby, teams));
        back.receive(token("a", true));
        for epoch in 6..9 {
            back.receive(announced.clone());
            back.receive(renewal("a", LOWER, epoch));
            back.wait(0.5);
            back.answer_all(vec![announced.clone()]);
        }
        assert_eq!((back.host.replica_state(), back.teams()), (ReplicaState::Leading, teams));
    }
}
