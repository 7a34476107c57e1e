//! What an instance does with the settings of its service, and when a suspicion ends.

use std::time::Duration;

use crate::small::{
    self, ONE_LEADS, START, header, output, renewal, settings, settings_changed, token,
};
use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_service::{Ask, Input, Stored};
use muster_wire::{Key, Message, Pattern};

type Driven = small::Driven<ONE_LEADS>;

const SETTINGS: Key = Key::Settings(ServiceName::Clusterer);

fn receive_settings(driven: &mut Driven, term: u64, epoch: u64, teams: u32) -> u32 {
    driven.receive(settings(term, epoch, teams));
    driven.teams()
}

fn cut_off(driven: &mut Driven) {
    driven.input(Input::LinkLost);
    driven.input(Input::LinkRestored);
}

#[test]
fn a_leader_announces_its_settings_at_intervals() {
    let mut driven = Driven::leading();
    // Whoever stands down for it has received the first announcement too early.
    for _ in 0..2 {
        driven.wait(0.5);
        assert_eq!(driven.announced(), [small::AUTO]);
    }
    driven.wait(3.5);
    assert!(driven.announced().is_empty());
    driven.wait(0.5);
    assert_eq!(driven.announced(), [small::AUTO]);
    driven.wait(10.0);
    assert_eq!(driven.announced().len(), 2);
}

#[test]
fn changed_settings_are_announced_again_with_the_next_renewals() {
    let mut driven = Driven::leading();
    driven.input(small::get(1, &SETTINGS, Some(r#"{"teams":7}"#)));
    assert_eq!(driven.announced(), [7]);
    for _ in 0..3 {
        driven.wait(0.5);
        assert_eq!(driven.announced(), [7]);
    }
    driven.wait(2.0);
    assert!(driven.announced().is_empty());
}

#[test]
fn what_a_suspect_changed_is_announced_once_it_leads_again() {
    let mut driven = Driven::leading();
    driven.input(Input::LinkLost);
    let logged = driven.logged();
    driven.input(small::get(1, &SETTINGS, Some(r#"{"teams":7}"#)));
    assert_eq!(driven.log_after(logged), ["settings"]);
    driven.input(Input::LinkRestored);
    assert!(driven.announced().is_empty());
    let query = driven.leader_queries().remove(0);
    driven.answer(&query, Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
    assert_eq!(driven.announced(), [7]);
}

#[test]
fn a_standby_adopts_the_newest_settings() {
    let mut driven = Driven::answered(vec![renewal("a", 7, 5), settings(7, 5, 5)]);
    assert_eq!((driven.host.replica_state(), driven.teams()), (ReplicaState::Standby, 5));
    assert_eq!(receive_settings(&mut driven, 6, 9, 3), 5, "a leader before");
    assert_eq!(receive_settings(&mut driven, 7, 5, 6), 6);
    assert_eq!(receive_settings(&mut driven, 6, 9, 3), 6);
}

/// The standby takes over with what it has adopted: an operator's change would be lost.
#[test]
fn a_standby_adopts_no_settings_of_a_higher_term_than_its_leaders() {
    let mut driven = Driven::answered(vec![renewal("a", 7, 5), settings(7, 5, 5)]);
    assert_eq!(receive_settings(&mut driven, 1 << 20, 1, 9), 5, "forged");
    assert_eq!(receive_settings(&mut driven, 7, 5, 6), 6, "the leader's own go on");
    // Settings of a new leader may overtake its first renewal, and count from then on.
    assert_eq!(receive_settings(&mut driven, 8, 0, 3), 6);
    driven.receive(token("c", true));
    driven.receive(renewal("c", 8, 0));
    assert_eq!(driven.teams(), 3);
}

#[test]
fn an_announcement_that_was_overtaken_does_not_bring_old_settings_back() {
    let mut driven = Driven::answered(vec![renewal("a", 7, 5), settings(7, 5, 5)]);
    let changed = |seconds: u64| START.after(Duration::from_secs(seconds));
    driven.receive(settings_changed(changed(2), 7, 9, 2));
    assert_eq!(driven.teams(), 2);
    driven.receive(settings_changed(changed(1), 7, 9, 3));
    assert_eq!(receive_settings(&mut driven, 7, 9, 5), 2);
}

#[test]
fn an_instance_that_led_adopts_the_settings_of_the_new_leader() {
    let mut driven = Driven::leading();
    driven.receive(small::order("output"));
    driven.input(small::get(1, &SETTINGS, Some(r#"{"teams":7}"#)));
    cut_off(&mut driven);
    let query = driven.leader_queries().remove(0);
    driven.answer(&query, vec![renewal("a", 2, 5)]);
    assert_eq!(driven.host.replica_state(), ReplicaState::Starting);
    assert_eq!(receive_settings(&mut driven, 1, 0, 3), 7, "of before its own");
    assert_eq!(receive_settings(&mut driven, 2, 5, 5), 7, "an operator has changed it");
    let later = settings_changed(driven.now.after(Duration::from_secs(1)), 2, 5, 5);
    driven.receive(later);
    assert_eq!(driven.teams(), 5);
}

/// In a split brain, the one that was cut off has begun the higher term, and an operator has changed settings
/// at the other one, which everybody could reach.
#[test]
fn a_change_at_the_leader_that_was_reached_outlives_one_that_led_unheard() {
    let mut driven = Driven::answered(vec![renewal("a", 7, 5), settings(7, 5, 5)]);
    // The link is dead, and not lost yet.
    driven.wait(2.5);
    let questions = std::mem::take(&mut driven.asks);
    driven.answer_fetch(questions, Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
    cut_off(&mut driven);
    driven.receive(token("a", true));
    driven.receive(renewal("a", 7, 9));
    assert_eq!(driven.host.replica_state(), ReplicaState::Starting);
    assert_eq!(receive_settings(&mut driven, 7, 9, 3), 3);
    for query in driven.leader_queries() {
        driven.answer(&query, Vec::new());
    }
    assert_ne!(driven.host.replica_state(), ReplicaState::Leading, "the query was of before");
    // Readers may have received its term all the same: it takes over, with the settings.
    for epoch in 10..13 {
        driven.receive(renewal("a", 7, epoch));
    }
    let questions = std::mem::take(&mut driven.asks);
    driven.answer_fetch(questions, vec![renewal("a", 7, 12), settings(7, 12, 3)]);
    assert_eq!(driven.teams(), 3);
}

#[test]
fn an_instance_that_takes_over_adopts_what_a_suspect_could_not_announce() {
    let driven = Driven::answered(vec![settings(7, 5, 5)]);
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
    assert_eq!(driven.teams(), 5);
}

/// A leader whose link is back just as another instance is about to begin was not there when that asked.
#[test]
fn an_instance_that_is_about_to_lead_asks_once_more_where_another_one_has_appeared() {
    let mut driven = Driven::new();
    driven.now = START.before(Duration::from_secs(2));
    driven.input(Input::Started { linked: true });
    driven.receive(token("c", true));
    driven.now = START;
    driven.answer_all(Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Starting);
    // Tokens that come and go keep it from leading no longer than that.
    driven.receive(token("c", false));
    driven.receive(token("c", true));
    driven.answer_all(vec![settings(7, 5, 5)]);
    driven.wait(3.0);
    driven.answer_all(vec![settings(7, 5, 5)]);
    assert_eq!((driven.host.replica_state(), driven.teams()), (ReplicaState::Leading, 5));
}

#[test]
fn the_settings_of_an_instance_without_a_term_are_answered_and_not_adopted() {
    let mut driven = Driven::new();
    driven.input(small::get(1, &SETTINGS, None));
    let answer = &driven.replies[0].messages;
    assert_eq!(answer[0].header().unwrap().revision, Revision::default());
    let mut other = Driven::answered(vec![renewal("a", 7, 5), settings(0, 0, 9)]);
    assert_eq!(other.teams(), small::AUTO);
    assert_eq!(receive_settings(&mut other, 0, 0, 9), small::AUTO);
    let leader = Driven::answered(vec![settings(0, 0, 9)]);
    assert_eq!(leader.teams(), small::AUTO);
}

#[test]
fn a_standby_leaves_gets_of_settings_to_the_leader() {
    let mut driven = Driven::answered(vec![renewal("a", 7, 5)]);
    for payload in [None, Some(r#"{"teams":7}"#)] {
        driven.input(small::get(1, &SETTINGS, payload));
        assert_eq!(driven.replies.pop().unwrap().answer, Ok(Vec::new()));
    }
    assert_eq!(driven.teams(), small::AUTO);
}

/// A query on a link that the other end has given up is never answered.
#[test]
fn a_paused_leader_is_suppressed_until_its_link_has_proved_sound() {
    let paused = || {
        let mut driven = Driven::leading();
        driven.receive(token("a", true));
        driven.now = driven.now.after(Duration::from_secs(3));
        driven.input(Input::Timer);
        let query = driven.leader_queries().remove(0);
        driven.answer(&query, Vec::new());
        assert_eq!(driven.host.replica_state(), ReplicaState::Suspect);
        driven
    };
    let mut linked = paused();
    linked.wait(1.0);
    assert_eq!(linked.host.replica_state(), ReplicaState::Leading);

    let mut cut_off = paused();
    cut_off.input(Input::LinkLost);
    cut_off.wait(60.0);
    assert_eq!(cut_off.host.replica_state(), ReplicaState::Suspect);
    cut_off.input(Input::LinkRestored);
    let query = cut_off.leader_queries().remove(0);
    cut_off.answer(&query, vec![renewal("a", 2, 1)]);
    assert_eq!(cut_off.host.replica_state(), ReplicaState::Starting);
}

#[test]
fn a_pause_is_reported_as_a_pause() {
    let mut driven = Driven::leading();
    let logged = driven.logged();
    driven.now = driven.now.after(Duration::from_secs(3));
    driven.input(Input::Timer);
    assert_eq!(driven.log_after(logged), ["Paused", "timer"]);
    let query = driven.leader_queries().remove(0);
    driven.answer(&query, Vec::new());
    assert_eq!(driven.log_after(logged), ["Paused", "timer", "Online"]);
    cut_off(&mut driven);
    let query = driven.leader_queries().remove(0);
    driven.answer(&query, Vec::new());
    assert_eq!(driven.log_after(logged + 3), ["Offline", "Online"]);
}

/// What others have sent meanwhile is handled only now.
#[test]
fn a_standby_that_was_paused_takes_silence_for_no_proof() {
    let mut driven = Driven::answered(vec![renewal("a", 7, 5)]);
    let logged = driven.logged();
    driven.now = driven.now.after(Duration::from_secs(30));
    driven.input(Input::Timer);
    assert_eq!(driven.host.replica_state(), ReplicaState::Standby);
    assert_eq!(driven.log_after(logged), ["Paused", "Online", "timer"]);
    driven.input(Input::LinkLost);
    driven.now = driven.now.after(Duration::from_secs(30));
    driven.input(Input::Timer);
    assert_eq!(driven.log_after(logged + 3), ["Offline", "timer"], "it is not back");
}

/// A renewal that arrived before the link was lost is handled after that.
#[test]
fn an_instance_that_stands_down_without_a_link_is_offline_still() {
    let mut driven = Driven::leading();
    driven.receive(token("c", true));
    driven.input(Input::LinkLost);
    let logged = driven.logged();
    driven.receive(renewal("c", 1, 5));
    assert_eq!(driven.host.replica_state(), ReplicaState::Suspect, "it leads without a link not");
    driven.receive(renewal("c", 2, 5));
    assert_eq!(driven.host.replica_state(), ReplicaState::Starting);
    let log = driven.log_after(logged);
    assert_eq!(log.last().map(String::as_str), Some("Offline"), "{log:?}");
    driven.input(Input::LinkRestored);
    assert_eq!(driven.log_after(logged).last().map(String::as_str), Some("Online"));
}

/// Both have begun the same term while they could not reach each other.
#[test]
fn a_suspect_that_raises_its_term_is_online_again() {
    let mut driven = Driven::leading();
    cut_off(&mut driven);
    driven.receive(token("c", true));
    let logged = driven.logged();
    driven.receive(renewal("c", 1, 0));
    assert_eq!(driven.log_after(logged), ["Online", "new term with 0 messages"]);
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
    assert_eq!(driven.host.status(driven.now).revision.term, 2);
}

#[test]
fn a_leader_that_raises_its_term_was_online_all_the_time() {
    let mut driven = Driven::leading();
    driven.receive(token("c", true));
    let logged = driven.logged();
    driven.receive(renewal("c", 1, 0));
    assert_eq!(driven.log_after(logged), ["new term with 0 messages"]);
}

#[test]
fn a_query_from_before_the_newest_cause_ends_no_suspicion() {
    let mut driven = Driven::leading();
    cut_off(&mut driven);
    cut_off(&mut driven);
    let queries = driven.leader_queries();
    assert_eq!(queries.len(), 2);
    driven.answer(&queries[0], Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Suspect);
    driven.answer(&queries[1], vec![renewal("a", 2, 1)]);
    assert_eq!(driven.host.replica_state(), ReplicaState::Starting);
}

#[test]
fn a_term_is_raised_only_when_readers_have_seen_the_same_higher_revision_twice() {
    let seen = |term| output(header(Revision { term, epoch: 1 }));
    let mut driven = Driven::leading();
    let logged = driven.logged();
    for term in [8, 9] {
        driven.wait(5.0);
        driven.answer_all(vec![seen(term)]);
        assert_eq!(driven.host.status(driven.now).revision.term, 1);
    }
    driven.wait(1.0);
    driven.answer_all(vec![seen(9)]);
    assert_eq!(driven.host.status(driven.now).revision.term, 10);
    assert_eq!(driven.log_after(logged).last().unwrap(), "new term with 1 messages");
}

/// Both were down, and the one that has lost its disk is the first to run again: its term, by the clock, is
/// above that of the other one, which has what operators changed.
#[test]
fn a_leader_without_state_is_replaced_by_an_instance_that_has_it() {
    let patch = || serde_json::json!({"teams": 5}).as_object().unwrap().clone();
    let begun_with = |stored: Stored| {
        let mut bench = small::Driven::<ONE_LEADS>::with_stored(stored);
        bench.now = START.before(Duration::from_secs(2));
        bench.input(Input::Started { linked: true });
        bench.now = START;
        bench.answer_all(vec![renewal("a", 900, 1)]);
        bench
    };
    // One that was a standby all the time has settings and no term.
    for term in [7, 0] {
        let mut driven = begun_with(Stored { term, patch: patch(), ..Stored::default() });
        driven.receive(token("a", true));
        assert_eq!((driven.host.replica_state(), driven.teams()), (ReplicaState::Standby, 5));
        assert_eq!(receive_settings(&mut driven, 0, 0, 3), 5);
        driven.receive(renewal("a", 900, 2));
        driven.answer_all(vec![renewal("a", 900, 2)]);
        assert_eq!((driven.host.replica_state(), driven.teams()), (ReplicaState::Leading, 5));
        assert_eq!(driven.host.status(driven.now).revision.term, 901);
    }
    // One without state has nothing to bring back, and one that has adopted the leader's stays a standby.
    let mut fresh = begun_with(Stored::default());
    assert_eq!(receive_settings(&mut fresh, 0, 0, 3), small::AUTO);
    assert!(fresh.asks.is_empty());
    let mut follower = begun_with(Stored { term: 7, patch: patch(), ..Stored::default() });
    assert_eq!(receive_settings(&mut follower, 900, 3, 4), 4);
    assert_eq!(receive_settings(&mut follower, 0, 0, 3), 4);
    assert!(follower.asks.is_empty());
}

/// The answer to its first question and all announcements since were lost: whoever leads next must know them all the same.
#[test]
fn a_standby_asks_for_the_settings_of_its_leader_until_they_come() {
    let asked = |driven: &mut Driven| -> Vec<Ask> {
        let of_settings = |ask: &mut Ask| ask.pattern == Pattern::One(SETTINGS);
        driven.asks.extract_if(.., of_settings).collect()
    };
    let mut driven = Driven::answered(vec![renewal("a", 7, 5)]);
    driven.receive(token("a", true));
    assert!(asked(&mut driven).is_empty(), "it has just asked");
    let pass = |driven: &mut Driven, epoch: u64| {
        driven.wait(0.5);
        driven.receive(renewal("a", 7, epoch));
        asked(driven)
    };
    for epoch in [6, 7] {
        let questions = pass(&mut driven, epoch);
        assert_eq!(questions.len(), 1);
        driven.answer(&questions[0], Vec::new());
    }
    let question = pass(&mut driven, 8).remove(0);
    driven.answer(&question, vec![settings(7, 8, 5)]);
    assert_eq!((driven.host.replica_state(), driven.teams()), (ReplicaState::Standby, 5));
    assert!((9..30).all(|epoch| pass(&mut driven, epoch).is_empty()));
    // One that never answers is asked for some seconds, and each leader again.
    let mut driven = Driven::answered(vec![renewal("a", 7, 5)]);
    driven.receive(token("a", true));
    let questions: usize = (6..40).map(|epoch| pass(&mut driven, epoch).len()).sum();
    assert_eq!(questions, 10);
    driven.receive(token("c", true));
    driven.receive(renewal("c", 8, 0));
    driven.wait(0.5);
    assert_eq!(asked(&mut driven).len(), 1);
}

/// What operators changed is on the disk of the leader before alone, and comes back with it.
#[test]
fn an_instance_that_never_received_the_settings_of_its_leader_announces_none() {
    let successor = |announced: Option<Message>| {
        let mut driven = Driven::answered(vec![renewal("a", 7, 5)]);
        driven.receive(token("a", true));
        announced.into_iter().for_each(|announced| driven.receive(announced));
        driven.receive(token("a", false));
        driven.wait(0.5);
        driven.answer_all(Vec::new());
        assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
        let of_settings = |message: &Message| {
            let Message::Settings(announced) = message else { return None };
            Some(announced.header.revision.term)
        };
        driven.published.iter().find_map(of_settings)
    };
    assert_eq!(successor(None), Some(0));
    assert_eq!(successor(Some(settings(7, 5, 5))), Some(8));
    assert_eq!(successor(Some(settings(0, 0, 5))), Some(8), "its leader had none");
}
