//! What the host does around any core: replies, gets, jobs, suppressed output, fetches, records.

use std::time::Duration;

use crate::small::{
    self, CHANGED, Driven, EVERY_INSTANCE, ONE_LEADS, Small, header, order, output, pose, renewal,
    settings, space, token,
};
use muster_model::event::EventKind;
use muster_model::header::Revision;
use muster_model::history::{
    Coverage, Entry, Page, Query, Record, RecordingReport, Retention, Rows, Subject,
};
use muster_model::id::{InstanceId, RobotId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::settings::ClustererSettings;
use muster_model::time::Tick;
use muster_service::inbox::{Inbox, Parcel};
use muster_service::testkit::Bench;
use muster_service::{Command, Delivery, GetId, IncomingGet, Input, Start, Stored, Wiring};
use muster_wire::{Attachment, ForeignPattern, Key, Message, Packet, Pattern, Source};

const SERVICE: ServiceName = ServiceName::Clusterer;

fn leading() -> Driven {
    Driven::leading()
}

fn ids(driven: &Driven) -> Vec<u64> {
    driven.replies.iter().map(|reply| reply.get.0).collect()
}

#[test]
fn replies_wait_for_what_is_being_stored_and_keep_their_order() {
    let mut driven = leading();
    driven.hold_stores = true;
    driven.input(small::get(1, &Key::Settings(SERVICE), Some(r#"{"teams":7}"#)));
    driven.input(small::get(2, &Key::Status(SERVICE), None));
    driven.input(small::get(3, &Key::Settings(SERVICE), Some(r#"{"teams":8}"#)));
    driven.input(small::get(4, &Key::Teams, None));
    assert!(driven.replies.is_empty());
    let stored: Vec<_> = driven.others.iter().collect();
    assert!(matches!(stored[..], [Command::Store(_), Command::Store(_)]), "{stored:?}");
    driven.input(Input::Stored { error: None });
    assert_eq!(ids(&driven), [1, 2]);
    driven.input(Input::Stored { error: None });
    assert_eq!(ids(&driven), [1, 2, 3, 4]);
    assert!(driven.replies[..3].iter().all(|reply| reply.answer.is_ok()));
    // With nothing to be stored, a reply waits for nothing.
    driven.input(small::get(5, &Key::Status(SERVICE), None));
    assert_eq!(ids(&driven), [1, 2, 3, 4, 5]);
    driven.input(Input::Stored { error: None });
    assert_eq!(ids(&driven), [1, 2, 3, 4, 5]);
}

#[test]
fn a_confirmation_of_what_could_not_be_stored_is_an_error() {
    let mut driven = leading();
    driven.hold_stores = true;
    driven.input(small::get(1, &Key::Settings(SERVICE), Some(r#"{"teams":7}"#)));
    driven.input(small::get(2, &Key::Status(SERVICE), None));
    driven.input(small::get(3, &Key::Settings(SERVICE), Some(r#"{"teams":8}"#)));
    driven.input(Input::Stored { error: Some("no space left".to_owned()) });
    assert_eq!(ids(&driven), [1, 2]);
    let error = driven.replies[0].answer.as_ref().unwrap_err();
    assert!(error.contains("will not survive a restart: no space left"), "{error}");
    assert!(driven.replies[0].messages.is_empty());
    assert!(driven.replies[1].answer.is_ok(), "it confirms nothing");
    driven.input(Input::Stored { error: None });
    assert!(driven.replies[2].answer.is_ok(), "stored in the end");
    assert_eq!(driven.teams(), 8, "settings hold all the same");
}

#[test]
fn the_term_is_stored_before_its_first_reply() {
    let mut driven = Driven::<ONE_LEADS>::new();
    driven.hold_stores = true;
    driven.now = driven.now.before(Duration::from_secs(2));
    driven.input(Input::Started { linked: true });
    driven.now = small::START;
    driven.answer_all(Vec::new());
    driven.input(small::get(1, &Key::Teams, None));
    assert!(driven.replies.is_empty());
    driven.input(Input::Stored { error: Some("no space left".to_owned()) });
    assert_eq!(driven.replies[0].answer, Err("no".to_owned()));
}

#[test]
fn every_get_is_answered_exactly_once() {
    let mut driven = leading();
    // The core answers this one later, with what the next job brings.
    driven.input(small::get(1, &Key::Embedding, None));
    assert!(driven.replies.is_empty());
    for (id, key) in (2..).zip([Key::Teams, Key::Schema, Key::Status(SERVICE), Key::Lease(SERVICE)])
    {
        driven.input(small::get(id, &key, None));
    }
    assert_eq!(ids(&driven), [2, 3, 4, 5]);
    driven.receive(pose("r1", 1.0));
    driven.run_job();
    assert_eq!(ids(&driven), [2, 3, 4, 5, 1]);
    driven.receive(pose("r1", 1.0));
    driven.run_job();
    assert_eq!(driven.replies.len(), 5);
}

#[test]
fn a_get_that_makes_no_sense_is_answered_with_an_error() {
    let mut driven = leading();
    let get = |get, selector: &str, parameters: &str, payload: Option<&str>| {
        Input::Get(IncomingGet {
            get: GetId(get),
            selector: selector.to_owned(),
            narrowed: None,
            parameters: parameters.to_owned(),
            payload: payload.map(|text| text.as_bytes().to_vec()),
        })
    };
    driven.input(get(1, "muster/v1/alpha/teams", "format=carrier-pigeon", None));
    driven.input(get(2, "muster/v1/alpha/service/*/settings", "", Some(r#"{"teams":7}"#)));
    driven.input(get(3, "muster/v1/alpha/command/clusterer/kim/c1", "", Some("{")));
    driven.input(get(4, "muster/v1/alpha/service/clusterer/settings", "", Some(r#"{"teams":7}"#)));
    driven.input(small::get(5, &Key::Settings(SERVICE), Some(r#"{"teams":0}"#)));
    assert_eq!(ids(&driven), [1, 2, 3, 4, 5]);
    let texts = ["parameters", "wildcards", "JSON", "commands", "teams"];
    for (reply, text) in driven.replies.iter().zip(texts) {
        let error = reply.answer.as_ref().unwrap_err();
        assert!(error.contains(text), "{error}");
    }
    assert_eq!(driven.teams(), small::AUTO);
}

#[test]
fn gets_that_wait_are_bounded() {
    let mut driven = leading();
    for id in 0..1000 {
        driven.input(small::get(id, &Key::Embedding, None));
    }
    let refused = driven.replies.len();
    assert_eq!(refused, 1000 - 512);
    assert!(driven.replies.iter().all(|reply| reply.answer.is_err()));
    driven.receive(pose("r1", 1.0));
    driven.run_job();
    assert_eq!(driven.replies.len(), 1000);
}

#[test]
fn the_result_of_an_abandoned_job_is_dropped_and_the_next_job_waits_for_its_end() {
    let mut driven = leading();
    driven.receive(pose("r1", 1.0));
    let job = driven.job.take().unwrap();
    assert!(driven.host.take_job().is_none(), "it is handed out once");
    driven.receive(order("abandon"));
    let logged = driven.logged();
    driven.receive(pose("r1", 2.0));
    assert_eq!(driven.log_after(logged), ["busy"]);
    assert!(driven.job.is_none());
    assert_eq!(job.to_string(), "1");
    driven.host.finish_job("dropped".to_owned());
    driven.input(Input::JobEnded { laps: Vec::new(), panic: None });
    assert_eq!(driven.log_after(logged), ["busy", "the slot is free"]);
    assert!(driven.job.is_some());
    driven.run_job();
    assert_eq!(driven.log_after(logged).last().unwrap(), "3 after 0 and 0");
}

#[test]
fn a_job_that_is_abandoned_before_it_runs_is_not_run() {
    let mut driven = leading();
    driven.receive(order("hasty"));
    assert!(driven.job.is_none());
    assert!(driven.host.take_job().is_none());
    driven.receive(pose("r1", 1.0));
    assert!(driven.job.is_some());
}

#[test]
fn a_job_that_panics_or_ends_without_a_result_is_reported() {
    let mut driven = leading();
    let logged = driven.logged();
    for panic in [Some("ouch\n".to_owned()), None] {
        driven.receive(pose("r1", 1.0));
        driven.job.take().unwrap();
        driven.input(Input::JobEnded { laps: Vec::new(), panic });
    }
    let log = driven.log_after(logged);
    assert_eq!(log[0], "the job panicked: ouch\u{FFFD}");
    assert!(log[1].contains("without a result"), "{log:?}");
    // The end of a job that does not run is the caller's mistake, and changes nothing.
    driven.input(Input::JobEnded { laps: Vec::new(), panic: None });
    assert_eq!(driven.log_after(logged).len(), 2);
}

#[test]
fn the_output_of_a_suspect_is_suppressed() {
    let mut driven = leading();
    driven.input(Input::LinkLost);
    assert_eq!(driven.host.replica_state(), ReplicaState::Suspect);
    driven.receive(order("output"));
    driven.receive(pose("r1", 1.0));
    driven.wait(10.0);
    assert!(driven.published.is_empty(), "neither output, nor events, nor lease renewals");
    assert!(driven.job.is_none(), "nor jobs");
    driven.input(Input::LinkRestored);
    driven.receive(order("output"));
    assert!(
        driven.published.is_empty(),
        "it does not know yet whether another instance has taken over"
    );
    let query = driven.leader_queries().remove(0);
    driven.answer(&query, Vec::new());
    driven.receive(order("output"));
    assert!(driven.published.iter().any(|message| matches!(message, Message::Teams { .. })));
    assert!(driven.published.iter().any(|message| matches!(message, Message::LeaseRenewal(_))));
    let states: Vec<_> = driven
        .others
        .iter()
        .map(|command| match command {
            Command::ReplicaState(state) => *state,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(states, [ReplicaState::Suspect, ReplicaState::Leading]);
}

#[test]
fn the_output_of_a_standby_is_suppressed() {
    let mut driven = Driven::<ONE_LEADS>::answered(vec![renewal("a", 7, 5)]);
    driven.receive(order("output"));
    driven.receive(pose("r1", 1.0));
    assert_eq!(driven.host.replica_state(), ReplicaState::Standby);
    assert!(driven.published.is_empty());
    assert!(driven.job.is_none());
}

#[test]
fn an_inquiry_repeats_unanswered_questions_for_two_seconds() {
    let mut driven = Driven::<ONE_LEADS>::new();
    driven.input(Input::Started { linked: true });
    let [lease, settings] = [Key::Lease(SERVICE), Key::Settings(SERVICE)].map(Pattern::One);
    let of_host = [lease, settings, Pattern::Commands(SERVICE)];
    let of_core = [Pattern::One(Key::Teams), Pattern::Graphs];
    assert_eq!(driven.asked(), [&of_core[..], &of_host[..]].concat());
    // A service that knows the answer soon is not asked again.
    let teams = driven.asks.remove(0);
    driven.answer(&teams, vec![output(header(Revision { term: 4, epoch: 2 }))]);
    driven.answer_all(Vec::new());
    let mut rounds = 0;
    while driven.host.replica_state() == ReplicaState::Starting {
        let due = driven.host.deadline().unwrap();
        assert_eq!(due.since(driven.now), Duration::from_millis(200));
        driven.now = due;
        driven.input(Input::Timer);
        assert_eq!(driven.asked(), [Pattern::Graphs]);
        driven.answer_all(Vec::new());
        rounds += 1;
    }
    assert_eq!(rounds, 10);
    assert_eq!(driven.log_after(0).last().unwrap(), "leads with 1 messages");
    assert_eq!(driven.host.status(driven.now).revision, Revision { term: 5, epoch: 0 });
}

#[test]
fn a_standby_that_takes_over_does_not_wait() {
    let mut driven = Driven::<ONE_LEADS>::answered(vec![renewal("a", 7, 5)]);
    driven.receive(token("a", true));
    assert_eq!(driven.host.replica_state(), ReplicaState::Standby);
    driven.receive(token("a", false));
    driven.wait(0.5);
    assert_eq!(driven.asks.len(), 5);
    driven.answer_all(Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
    assert_eq!(driven.host.status(driven.now).revision.term, 8);
}

#[test]
fn an_instance_without_a_link_asks_again_once_it_has_one() {
    let mut driven = Driven::<ONE_LEADS>::new();
    driven.now = driven.now.before(Duration::from_secs(2));
    driven.input(Input::Started { linked: false });
    driven.now = small::START;
    driven.answer_all(Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Starting);
    driven.input(Input::LinkRestored);
    assert_eq!(driven.asks.len(), 5);
    driven.now = driven.now.after(Duration::from_secs(2));
    driven.answer_all(Vec::new());
    assert_eq!(driven.host.replica_state(), ReplicaState::Leading);
}

fn alone() -> Bench<Small<EVERY_INSTANCE>> {
    Bench::new(Start {
        fleet: space().fleet().clone(),
        instance: InstanceId::of_process("b", 1, 1),
        now: small::START,
        settings: ClustererSettings::default(),
        stored: Stored::default(),
    })
}

#[test]
fn where_every_instance_works_for_itself_it_leads_at_once_without_an_election() {
    let mut bench = alone();
    bench.input(Input::Started { linked: true });
    assert_eq!(bench.host.replica_state(), ReplicaState::Leading);
    assert!(bench.asks.is_empty());
    bench.receive(token("a", true));
    bench.receive(renewal("a", 900, 1));
    bench.receive(settings(900, 1, 9));
    assert_eq!(bench.host.replica_state(), ReplicaState::Leading);
    assert_eq!(bench.host.core().teams, small::AUTO);
    bench.wait(60.0);
    bench.now = bench.now.after(Duration::from_secs(60));
    bench.input(Input::LinkLost);
    bench.receive(order("output"));
    bench.input(Input::LinkRestored);
    assert_eq!(bench.host.replica_state(), ReplicaState::Leading);
    let outputs = bench.published.iter().filter(|m| matches!(m, Message::Teams { .. }));
    assert_eq!(outputs.count(), 1, "the bus drops what it cannot carry");
    assert!(!bench.published.iter().any(|message| matches!(message, Message::LeaseRenewal(_))));
    assert!(bench.asks.is_empty(), "it asks neither who leads nor what was received");
    assert_eq!(bench.host.core().log, ["leads with 0 messages", "Offline", "Online"]);
    let wiring = Wiring::of::<Small<EVERY_INSTANCE>>();
    assert!(wiring.tokens.is_empty() && wiring.subscriptions.is_empty());
    let served: Vec<_> = wiring.served.into_iter().map(|served| served.pattern).collect();
    let own = [Key::Settings(SERVICE), Key::Status(SERVICE), Key::Schema].map(Pattern::One);
    assert_eq!(served, [&own[..], &[Pattern::Commands(SERVICE)]].concat());
}

#[test]
fn where_one_instance_leads_the_host_adds_the_keys_of_the_election() {
    let wiring = Wiring::of::<Small<CHANGED>>();
    // The renewals of two leaders have one key: that of the one must not take the place of that of the other.
    let lease_waits = wiring.subscriptions[0].delivery;
    assert!(matches!(lease_waits, Delivery::Queue(room) if room > 1), "{lease_waits:?}");
    let subscribed: Vec<_> = wiring.subscriptions.into_iter().map(|one| one.pattern).collect();
    let [lease, settings] = [Key::Lease(SERVICE), Key::Settings(SERVICE)].map(Pattern::One);
    assert_eq!(subscribed, [lease, settings, Pattern::Commands(SERVICE)]);
    assert_eq!(wiring.tokens, [Pattern::InstanceTokens(SERVICE)]);
    let served: Vec<_> = wiring.served.into_iter().map(|served| served.pattern).collect();
    let own = [Key::Settings(SERVICE), Key::Status(SERVICE), Key::Schema, Key::Lease(SERVICE)];
    let own = own.map(Pattern::One);
    assert_eq!(served, [&own[..], &[Pattern::Commands(SERVICE)]].concat());
}

#[test]
fn records_and_tokens_are_commands() {
    let mut driven = leading();
    for name in ["declare", "append", "lookup", "retain", "withdraw"] {
        driven.receive(order(name));
    }
    let key = Key::RobotToken(RobotId::new("other").unwrap());
    let expected = [
        Command::DeclareToken(key.clone()),
        Command::Append(Box::new(Entry { at: small::START, record: Record::Present(Vec::new()) })),
        Command::LookUp { lookup: 5, query: Query::of(Subject::Divisions) },
        Command::Retain(Retention { before: Tick(1), max_bytes: 2 }),
        Command::WithdrawToken(key),
    ];
    assert_eq!(driven.others, expected);
    let logged = driven.logged();
    let rows = Rows::Divisions(Vec::new());
    driven.input(Input::Found { lookup: 5, page: Ok(Page { rows, before: None }) });
    driven.input(Input::Found { lookup: 6, page: Err("gone".to_owned()) });
    let coverage = Coverage { sequence: 3, ..Coverage::default() };
    let report = RecordingReport { coverage, ..RecordingReport::default() };
    driven.input(Input::Recorded(Box::new(report)));
    let expected = ["lookup 5 finds Divisions([])", "lookup 6 finds gone", "recorded 3 records"];
    assert_eq!(driven.log_after(logged), expected);
}

#[test]
fn packets_of_other_programs_reach_the_core_as_they_are_and_are_answered_on_their_keys() {
    let mut driven = leading();
    let pattern = Pattern::Foreign(ForeignPattern::new("other/**").unwrap());
    let attachment = Attachment::new([7; 33]).unwrap();
    let packet = Packet {
        attachment: Some(attachment.clone()),
        ..Packet::put("other/topic", "application/cdr", [1, 2])
    };
    let mut inbox = Inbox::default();
    inbox.push(Parcel::new(&space(), packet, &pattern, Delivery::Latest).unwrap());
    let now = driven.now;
    let commands = driven.host.handle(now, Input::Arrived(inbox.pop().unwrap()));
    let Some(Command::Publish(publication)) = commands.first() else { panic!("{commands:?}") };
    let expected = Packet {
        attachment: Some(attachment),
        ..Packet::put("other/topic/reply", "application/cdr", [1, 2])
    };
    assert_eq!(publication.packets, [expected]);
    // On a subscription of the fleet such a key is refused, as is every other that does not belong.
    let stray = Packet::put("other/topic", "", []);
    inbox.push(Parcel::new(&space(), stray, &Pattern::RobotTeams, Delivery::Latest).unwrap());
    let refused = inbox.pop().unwrap().into_message(&space());
    assert!(refused.unwrap_err().reason.contains("does not stand under"));
}

#[test]
fn a_fetch_ends_with_its_last_answer_whatever_comes_twice() {
    let mut driven = leading();
    driven.asks.clear();
    driven.receive(order("fetch"));
    let logged = driven.logged();
    let asks = std::mem::take(&mut driven.asks);
    assert_eq!(asks.len(), 2);
    driven.answer(&asks[0], vec![pose("r1", 1.0)]);
    driven.answer(&asks[0], vec![pose("r2", 1.0)]);
    assert!(driven.log_after(logged).is_empty());
    driven.answer(&asks[1], vec![pose("r3", 1.0)]);
    driven.answer(&asks[1], vec![pose("r3", 1.0)]);
    assert_eq!(driven.log_after(logged), ["fetch 7 has 2 answers"]);
}

#[test]
fn an_answer_to_a_forgotten_question_is_ignored() {
    let mut driven = leading();
    driven.receive(token("a", true));
    driven.asks.clear();
    driven.receive(order("fetch"));
    let forgotten = std::mem::take(&mut driven.asks);
    driven.receive(renewal("a", 9, 1));
    let logged = driven.logged();
    for ask in &forgotten {
        driven.answer(ask, vec![pose("r1", 1.0)]);
    }
    assert!(driven.log_after(logged).is_empty());
    assert_eq!(driven.host.replica_state(), ReplicaState::Starting);
}

#[test]
fn refused_packets_are_counted_and_reported_at_a_bounded_rate() {
    let mut driven = leading();
    let key = "muster/v1/alpha/robot/r1/pose";
    let bad = || Packet::put(key.to_owned(), "application/json".to_owned(), b"{\"x\":1}".to_vec());
    for _ in 0..3 {
        driven.input(Input::Arrived(muster_service::Arrival::encoded(bad())));
    }
    let deleted = Packet { source: Source::Delete, ..bad() };
    driven.input(Input::Arrived(muster_service::Arrival::decoded(&space(), deleted)));
    assert_eq!(driven.host.status(driven.now).counters["messages_refused"], 4);
    let quarantined = |message: &Message| match message {
        Message::Event(event) => matches!(event.kind, EventKind::Quarantined { .. }),
        _ => false,
    };
    assert_eq!(driven.published.iter().filter(|message| quarantined(message)).count(), 1);
    assert_eq!(driven.host.memory_use().offenders, 1);
}
