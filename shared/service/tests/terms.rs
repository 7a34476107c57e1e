//! Terms that follow the clock, terms that are not believed, and what is said when state is lost.

use std::time::Duration;

use crate::small::{self, Driven, ONE_LEADS, Small, header, output, renewal, token};
use muster_model::event::{EventKind, Severity};
use muster_model::header::Revision;
use muster_model::limits::MAX_REVISION;
use muster_model::role::ReplicaState;
use muster_model::settings::ClustererSettings;
use muster_model::term::highest_term;
use muster_model::time::Tick;
use muster_service::testkit::Bench;
use muster_service::{Input, Start, Stored};
use muster_wire::Message;

/// A right clock: November 2026.
const RIGHT_S: u64 = 1_795_000_000;

const UNSET: Tick = Tick(40_000_000);

fn at(seconds: u64) -> Tick {
    Tick(seconds * 1_000_000)
}

fn seen(term: u64) -> Message {
    output(header(Revision { term, epoch: 3 }))
}

/// An instance that has begun to lead by a clock, with what it kept and what the bus answers.
fn leading(now: Tick, stored: u64, answers: Vec<Message>) -> Bench<Small<ONE_LEADS>> {
    let mut bench = Bench::new(Start {
        fleet: small::space().fleet().clone(),
        instance: small::instance("b"),
        now,
        settings: ClustererSettings::default(),
        stored: Stored { term: stored, ..Stored::default() },
    });
    bench.now = now.after(Duration::from_secs(2));
    bench.start(answers);
    bench
}

fn term(bench: &Bench<Small<ONE_LEADS>>) -> u64 {
    bench.status().revision.term
}

fn losses(bench: &Bench<Small<ONE_LEADS>>) -> Vec<&str> {
    let mut reasons = Vec::new();
    for message in &bench.published {
        if let Message::Event(event) = message
            && let EventKind::StateLost { reason } = &event.kind
        {
            assert_eq!(event.severity, Severity::Error);
            reasons.push(reason.as_str());
        }
    }
    reasons
}

#[test]
fn a_term_begins_at_the_seconds_of_the_clock_or_above_what_is_known() {
    let begun =
        |now: Tick, stored: u64, answers: Vec<Message>| term(&leading(now, stored, answers));
    assert_eq!(begun(at(RIGHT_S), 0, vec![]), RIGHT_S + 2, "without state");
    assert_eq!(begun(at(RIGHT_S), 7, vec![]), 8, "it counts on");
    assert_eq!(begun(at(RIGHT_S), RIGHT_S + 900, vec![]), RIGHT_S + 901, "its clock was ahead");
    assert_eq!(begun(at(RIGHT_S), 0, vec![seen(RIGHT_S + 70)]), RIGHT_S + 71);
    // A clock that cannot be right does not count.
    assert_eq!(begun(UNSET, 0, vec![]), 1);
    assert_eq!(begun(UNSET, 0, vec![seen(RIGHT_S)]), RIGHT_S + 1);
    assert_eq!(begun(UNSET, RIGHT_S, vec![]), RIGHT_S + 1);
    assert_eq!(begun(at(9_000_000_000), 0, vec![]), 1);
}

/// The reader that knew the term of the leader before may have restarted when another one that begins asks again.
#[test]
fn a_term_that_a_reader_knew_is_not_forgotten_when_the_bus_is_asked_again() {
    let mut bench: Bench<Small<ONE_LEADS>> = Bench::new(Start {
        fleet: small::space().fleet().clone(),
        instance: small::instance("b"),
        now: UNSET,
        settings: ClustererSettings::default(),
        stored: Stored { term: 5, ..Stored::default() },
    });
    bench.input(Input::Started { linked: true });
    bench.receive(token("c", true));
    bench.now = UNSET.after(Duration::from_secs(2));
    bench.answer_all(vec![seen(9)]);
    assert_eq!(bench.status().standing, ReplicaState::Starting, "it asks again");
    bench.answer_all(Vec::new());
    bench.wait(3.0);
    bench.answer_all(Vec::new());
    assert_eq!((bench.status().standing, term(&bench)), (ReplicaState::Leading, 10));
}

#[test]
fn a_term_that_no_clock_allows_is_refused_and_counted() {
    for now in [at(RIGHT_S), UNSET] {
        let mut bench = leading(now, 5, vec![seen(MAX_REVISION - 1)]);
        let begun = term(&bench);
        assert!(begun < RIGHT_S + 3 && bench.stored.term == begun, "{begun}");
        assert_eq!(bench.counter("answers_refused"), 1);
        bench.receive(seen(MAX_REVISION - 1));
        assert_eq!(bench.counter("terms_refused"), 2);
        bench.receive(token("a", true));
        bench.receive(renewal("a", MAX_REVISION - 1, 1));
        bench.wait(6.0);
        for _ in 0..3 {
            bench.answer_term_check(vec![seen(MAX_REVISION - 1)]);
            bench.wait(2.0);
        }
        assert_eq!((term(&bench), bench.stored.term), (begun, begun));
        assert_eq!(bench.counter("terms_refused"), 6, "the renewal and each answer");
        assert_eq!(bench.status().standing, ReplicaState::Leading);
    }
}

/// That one has received it of a leader that was lost before any other instance did.
#[test]
fn a_leader_begins_above_the_term_that_another_instance_has_stored() {
    let begun = |stored: u64| term(&leading(at(RIGHT_S), 5, vec![small::settings(0, stored, 5)]));
    assert_eq!(begun(9), 10);
    assert_eq!(begun(3), 6);
    assert_eq!(begun(MAX_REVISION - 1), 6, "no clock allows that one");
}

/// The highest term that is believed is followed by one more, which others believe a second later.
#[test]
fn a_forged_term_at_the_bound_does_not_leave_the_next_leader_refused() {
    for clock in [RIGHT_S, UNSET.as_seconds() as u64] {
        let bound = highest_term(at(clock + 2));
        let bench = leading(at(clock), 5, vec![seen(bound)]);
        assert_eq!((term(&bench), bench.stored.term), (bound + 1, bound + 1));
        assert_eq!(bench.counter("terms_refused"), 0);
        let refuses = |now: Tick| {
            let mut reader = leading(now, 5, vec![]);
            reader.receive(seen(bound + 1));
            reader.counter("terms_refused") == 1
        };
        assert!(refuses(at(clock)));
        assert!(!refuses(at(clock + 1)));
        // The next life goes on from there, and so does one that has lost that state.
        assert_eq!(term(&leading(at(clock + 4), bound + 1, vec![])), bound + 2);
        assert_eq!(term(&leading(at(clock + 4), 0, vec![seen(bound + 1)])), bound + 2);
        // A higher one is refused by the leader as well.
        assert!(term(&leading(at(clock), 5, vec![seen(bound + 1)])) <= clock.max(6) + 2);
    }
}

#[test]
fn a_stored_term_above_the_bound_is_damage() {
    let bound = highest_term(at(RIGHT_S));
    let sound = leading(at(RIGHT_S), bound, vec![]);
    assert_eq!((term(&sound), losses(&sound).len()), (bound + 1, 0));
    for damaged in [bound + 1, MAX_REVISION - 1, MAX_REVISION, u64::MAX] {
        let bench = leading(at(RIGHT_S), damaged, vec![]);
        assert_eq!((term(&bench), bench.stored.term), (RIGHT_S + 2, RIGHT_S + 2));
        let [reason] = losses(&bench)[..] else { panic!("{damaged}") };
        assert!(reason.contains(&damaged.to_string()), "{reason}");
        assert_eq!(bench.counter("state_lost"), 1);
    }
}

#[test]
fn a_loss_of_state_is_reported_where_it_shows() {
    // Nothing was stored, and nothing is known of an earlier output: a first start.
    let first = leading(at(RIGHT_S), 0, vec![]);
    assert_eq!((losses(&first).len(), first.counter("state_lost")), (0, 0));
    assert_eq!(first.counter("state_empty"), 1);
    let lost = leading(at(RIGHT_S), 0, vec![seen(RIGHT_S - 9)]);
    assert_eq!((losses(&lost).len(), lost.counter("state_lost")), (1, 1));
    let kept = leading(at(RIGHT_S), RIGHT_S - 9, vec![seen(RIGHT_S - 9)]);
    assert_eq!((losses(&kept).len(), kept.counter("state_empty")), (0, 0));
    // The shell could not read it; the instance does not lead yet.
    let mut damaged = Driven::<ONE_LEADS>::new();
    damaged.input(Input::Started { linked: true });
    damaged.input(Input::StateLost { reason: "the file is damaged".to_owned() });
    assert!(damaged.published.is_empty());
    damaged.now = damaged.now.after(Duration::from_secs(2));
    damaged.answer_all(Vec::new());
    assert_eq!(losses(&damaged), ["the file is damaged"]);
    // A standby that takes over on a new host has lost nothing.
    let mut standby = Driven::<ONE_LEADS>::answered(vec![renewal("a", 7, 5)]);
    standby.receive(token("a", true));
    standby.receive(token("a", false));
    standby.wait(0.5);
    standby.answer_all(vec![seen(7)]);
    assert_eq!((term(&standby), losses(&standby).len()), (8, 0));
}

#[test]
fn state_that_could_not_be_written_is_written_once_there_is_room() {
    let mut bench = leading(at(RIGHT_S), 0, vec![]);
    bench.input(Input::Stored { error: Some("the disk is full".to_owned()) });
    bench.wait(9.5);
    assert_eq!(bench.counter("state_unwritable"), 1);
    bench.wait(1.0);
    assert_eq!(bench.counter("state_unwritable"), 0, "it was written again");
    assert_eq!(losses(&bench).len(), 1);
}

#[test]
fn state_that_cannot_be_written_is_reported_once_until_it_can() {
    let mut bench = leading(at(RIGHT_S), 0, vec![]);
    for expected in [1, 1] {
        bench.input(Input::Stored { error: Some("the disk is full".to_owned()) });
        assert_eq!(losses(&bench).len(), expected);
        assert_eq!(bench.counter("state_unwritable"), 1);
    }
    bench.input(Input::Stored { error: None });
    assert_eq!(bench.counter("state_unwritable"), 0);
    bench.input(Input::Stored { error: Some("the disk is full".to_owned()) });
    assert_eq!(losses(&bench).len(), 2);
}

#[test]
fn an_instance_that_could_not_write_before_it_led_says_so_once_it_leads() {
    let mut driven = Driven::answered(vec![renewal("a", 7, 5)]);
    let full = || Input::Stored { error: Some("the disk is full".to_owned()) };
    driven.input(full());
    assert_eq!((losses(&driven).len(), driven.counter("state_unwritable")), (0, 1));
    driven.hold_stores = true;
    small::take_over(&mut driven);
    for _ in 0..3 {
        driven.input(full());
        driven.wait(10.0);
    }
    assert_eq!(losses(&driven).len(), 1, "{:?}", losses(&driven));
}

/// An instance that leads while its term is being written.
fn unstored() -> Bench<Small<ONE_LEADS>> {
    let mut bench = Bench::new(Start {
        fleet: small::space().fleet().clone(),
        instance: small::instance("b"),
        now: at(RIGHT_S),
        settings: ClustererSettings::default(),
        stored: Stored { term: 7, ..Stored::default() },
    });
    bench.hold_stores = true;
    bench.now = at(RIGHT_S + 2);
    bench.start(vec![]);
    bench
}

#[test]
fn nothing_of_a_term_is_published_before_it_is_on_the_disk() {
    let mut bench = unstored();
    assert_eq!((bench.status().standing, term(&bench)), (ReplicaState::Leading, 8));
    assert!(bench.published.is_empty(), "{:?}", bench.published);
    bench.input(Input::Stored { error: None });
    let started = EventKind::ServiceStarted { term: 8 };
    let is_start =
        |message: &Message| matches!(message, Message::Event(event) if event.kind == started);
    assert!(bench.published.first().is_some_and(is_start), "in order: {:?}", bench.published);
    assert!(bench.published.iter().any(|message| matches!(message, Message::LeaseRenewal(_))));
}

#[test]
fn a_disk_that_hangs_holds_a_term_up_for_a_second() {
    let mut bench = unstored();
    bench.now = bench.now.after(Duration::from_millis(999));
    bench.input(Input::Timer);
    assert!(bench.published.is_empty(), "{:?}", bench.published);
    bench.now = bench.now.after(Duration::from_millis(1));
    bench.input(Input::Timer);
    assert!(!bench.published.is_empty());
    bench.published.clear();
    bench.now = bench.now.after(Duration::from_secs(1));
    bench.input(Input::Timer);
    assert!(!bench.published.is_empty(), "and nothing waits after that");
}

/// Others count on what it publishes next having come after that: a delta of a graph follows the graph.
#[test]
fn what_waits_for_the_disk_when_the_link_is_lost_is_published_once_the_instance_leads_again() {
    for is_written in [true, false] {
        let mut bench = unstored();
        bench.input(Input::LinkLost);
        assert_eq!(bench.host.replica_state(), ReplicaState::Suspect);
        if is_written {
            bench.input(Input::Stored { error: None });
        }
        bench.wait(5.0);
        assert!(bench.published.is_empty(), "{:?}", bench.published);
        bench.input(Input::LinkRestored);
        bench.wait(5.0);
        assert_eq!((bench.status().standing, term(&bench)), (ReplicaState::Leading, 8));
        let started = EventKind::ServiceStarted { term: 8 };
        let is_start =
            |message: &Message| matches!(message, Message::Event(event) if event.kind == started);
        assert!(bench.published.first().is_some_and(is_start), "in order: {:?}", bench.published);
    }
}

#[test]
fn what_waits_for_the_disk_is_not_published_by_an_instance_that_stands_down() {
    let mut bench = unstored();
    bench.hold_leader_queries = true;
    bench.receive(token("a", true));
    bench.receive(renewal("a", 9, 1));
    assert_eq!(bench.host.replica_state(), ReplicaState::Starting);
    bench.input(Input::Stored { error: None });
    bench.wait(0.5);
    assert!(bench.published.is_empty(), "{:?}", bench.published);
}
