//! Who is there: joining, growing stale, leaving, with and without tokens, and lost links.

use crate::bench::{self, Bench, links, pose, rank, token};
use muster_model::event::EventKind;
use muster_model::id::{InstanceId, ServiceName};
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_model::roster::Presence::{Active, Stale};
use muster_model::settings::IngestSettings;
use muster_service::Input;
use muster_wire::Message;
use serde_json::json;

#[test]
fn a_robot_joins_by_any_message_and_by_its_token() {
    let mut bench = Bench::default();
    for message in
        [pose("r1", 0.0, 0.0), links("r2", &[]), rank("r3", None, None), token("r4", true)]
    {
        bench.receive(message);
    }
    assert_eq!(bench.happened(), ["joined r1", "joined r2", "joined r3", "joined r4"]);
    bench.wait(0.2);
    assert_eq!(bench.names(), ["r1", "r2", "r3", "r4"]);
    let nodes: Vec<_> = bench.roster.as_ref().unwrap().robots.iter().map(|r| r.node).collect();
    assert_eq!(nodes, [1, 2, 3, 4]);
    assert_eq!(bench.entry("r4").unwrap().position, None);
    assert_eq!(bench.counter("robots_joined"), 4);
    assert_eq!(bench.status().state, "4 robots, 0 stale");
}

#[test]
fn a_silent_robot_is_stale_and_then_gone() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(1.999);
    assert_eq!(bench.happened(), ["joined r1"]);
    bench.wait(0.001);
    assert_eq!(bench.happened(), ["stale r1"]);
    bench.wait(0.2);
    assert_eq!(bench.presence("r1"), Some(Stale));
    assert_eq!(bench.status().state, "1 robot, 1 stale");
    bench.wait(7.799);
    assert!(bench.happened().is_empty());
    bench.wait(0.001);
    assert_eq!(bench.happened(), ["left r1"]);
    bench.wait(0.2);
    assert!(bench.names().is_empty());
    assert_eq!(bench.counter("robots_left"), 2, "one before the test");
}

#[test]
fn a_stale_robot_recovers_by_a_pose_only_and_is_stale_again() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(3.0);
    bench.happened();
    bench.receive(links("r1", &[]));
    bench.receive(token("r1", true));
    assert!(bench.happened().is_empty());
    bench.receive(pose("r1", 0.0, 0.0));
    assert_eq!(bench.happened(), ["recovered r1"]);
    bench.wait(0.2);
    assert_eq!(bench.presence("r1"), Some(Active));
    bench.wait(1.8);
    assert_eq!(bench.happened(), ["stale r1"]);
}

#[test]
fn other_streams_keep_a_stale_robot_in_the_fleet() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    for _ in 0..30 {
        bench.wait(1.0);
        bench.receive(links("r1", &[]));
    }
    assert_eq!(bench.happened(), ["joined r1", "stale r1"]);
    bench.wait(9.9);
    assert!(bench.happened().is_empty());
    bench.wait(0.1);
    assert_eq!(bench.happened(), ["left r1"]);
}

#[test]
fn a_token_keeps_an_unplaced_robot() {
    let mut bench = Bench::default();
    bench.receive(token("r1", true));
    bench.wait(100.0);
    assert_eq!(bench.happened(), ["joined r1"]);
    assert_eq!(bench.presence("r1"), Some(Active));
    bench.receive(token("r1", false));
    bench.wait(1.999);
    assert!(bench.happened().is_empty());
    bench.wait(0.001);
    assert_eq!(bench.happened(), ["stale r1"]);
    bench.receive(token("r1", true));
    assert_eq!(bench.happened(), ["recovered r1"]);
    bench.wait(50.0);
    bench.receive(token("r1", false));
    bench.wait(10.0);
    assert_eq!(bench.happened(), ["stale r1", "left r1"]);
}

#[test]
fn an_unplaced_robot_without_a_token_lives_by_its_messages() {
    let mut bench = Bench::default();
    bench.receive(rank("r1", None, None));
    bench.wait(2.0);
    assert_eq!(bench.happened(), ["joined r1", "stale r1"]);
    bench.receive(links("r1", &[]));
    assert_eq!(bench.happened(), ["recovered r1"]);
    bench.wait(2.0);
    assert_eq!(bench.happened(), ["stale r1"]);
    bench.wait(8.0);
    assert_eq!(bench.happened(), ["left r1"]);
}

#[test]
fn the_loss_of_a_token_is_a_sign_and_a_message_after_it_another() {
    let mut bench = Bench::default();
    bench.receive(token("r1", true));
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(1.0);
    bench.receive(token("r1", false));
    bench.wait(1.0);
    assert_eq!(bench.happened(), ["joined r1", "stale r1"], "its pose is two seconds old");
    bench.wait(8.5);
    assert!(bench.happened().is_empty(), "gone ten seconds after the token");
    bench.receive(rank("r1", None, None));
    bench.wait(9.9);
    assert!(bench.happened().is_empty());
    bench.wait(0.1);
    assert_eq!(bench.happened(), ["left r1"]);
}

#[test]
fn a_process_that_hangs_leaves_though_its_token_stays() {
    let mut bench = Bench::default();
    bench.receive(token("r1", true));
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(10.0);
    assert_eq!(bench.happened(), ["joined r1", "stale r1", "left r1"]);
    bench.receive(token("r1", true));
    bench.wait(20.0);
    assert!(bench.happened().is_empty(), "its token does not bring it back");
    bench.receive(rank("r1", None, None));
    bench.wait(50.0);
    assert_eq!(bench.happened(), ["joined r1"], "its token keeps it, unplaced as it is");
    assert_eq!(bench.entry("r1").unwrap().position, None);
    assert_eq!(bench.entry("r1").unwrap().node, 2, "a node is never given twice");
}

#[test]
fn a_hung_robot_that_restarts_joins_by_its_new_token() {
    let mut bench = Bench::default();
    bench.receive(token("r1", true));
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(15.0);
    bench.happened();
    bench.receive(token("r1", false));
    assert!(bench.happened().is_empty());
    bench.receive(token("r1", true));
    assert_eq!(bench.happened(), ["joined r1"]);
}

#[test]
fn whoever_leaves_takes_all_that_was_said_along() {
    let mut bench = Bench::default();
    for _ in 0..30 {
        bench.receive(pose("r2", 1.0, 0.0));
        bench.receive(pose("r3", 2.0, 0.0));
        if bench.entry("r1").is_none() && bench.names().is_empty() {
            bench.receive(pose("r1", 0.0, 0.0));
            bench.receive(links("r1", &[("r2", 0.5)]));
            bench.receive(rank("r2", Some("r1"), None));
        }
        bench.wait(0.5);
    }
    assert_eq!(bench.names(), ["r2", "r3"]);
    assert!(bench.graph("connectivity").is_empty());
    assert!(bench.graph("hierarchy").is_empty());
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.5);
    assert!(bench.graph("connectivity").is_empty(), "what it said before it left is forgotten");
    assert_eq!(bench.weight("hierarchy", "r1", "r2"), Some(1.0), "what others say counts again");
}

#[test]
fn relations_to_unknown_robots_count_once_these_join() {
    let mut bench = Bench::default();
    bench.receive(links("r1", &[("r2", 0.5)]));
    bench.receive(rank("r1", Some("r2"), Some(3.0)));
    bench.wait(0.5);
    assert!(bench.graph("connectivity").is_empty());
    assert_eq!(bench.entry("r1").unwrap().superior, Some(bench::robot("r2")));
    bench.receive(token("r2", true));
    bench.wait(0.5);
    assert_eq!(bench.weight("connectivity", "r2", "r1"), Some(0.5));
    assert_eq!(bench.weight("hierarchy", "r2", "r1"), Some(3.0));
}

#[test]
fn no_robot_is_marked_stale_while_the_link_is_lost() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(rank("r2", None, None));
    bench.wait(1.5);
    bench.happened();
    bench.input(Input::LinkLost);
    let frames = bench.frame_times().len();
    bench.wait(100.0);
    bench.input(Input::LinkLost);
    bench.input(Input::Timer);
    assert!(bench.happened().is_empty());
    assert_eq!(bench.frame_times().len(), frames);
    assert_eq!(bench.status().state, "2 robots, 0 stale, the link to the router is lost");
    bench.input(Input::LinkRestored);
    assert_eq!(bench.happened(), ["link back after 100 s"]);
    bench.wait(0.001);
    assert_eq!(bench.frame_times().len(), frames + 1, "consumers know at once");
    bench.wait(1.998);
    assert!(bench.happened().is_empty(), "their grace period begins again");
    bench.wait(0.001);
    assert_eq!(bench.happened(), ["stale r1 r2"]);
    bench.wait(8.0);
    assert_eq!(bench.happened(), ["left r1 r2"]);
    bench.input(Input::LinkRestored);
    assert!(bench.happened().is_empty(), "the link was not lost");
}

#[test]
fn the_age_of_the_data_is_not_forgiven_with_the_outage() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    let said = bench.now;
    bench.wait(1.0);
    bench.input(Input::LinkLost);
    bench.wait(30.0);
    bench.input(Input::LinkRestored);
    bench.wait(0.1);
    assert_eq!(bench.presence("r1"), Some(Active));
    assert_eq!(bench.entry("r1").unwrap().last_seen, said);
    assert_eq!(bench.roster.as_ref().unwrap().header.oldest, Some(said));
}

#[test]
fn robots_that_fall_silent_just_before_the_link_is_found_lost_are_not_reported_stale() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.1);
    bench.receive(pose("r2", 5.0, 0.0));
    bench.wait(1.9);
    // The first one is stale, and its event waits for the other.
    assert_eq!(bench.status().state, "2 robots, 1 stale");
    bench.happened();
    bench.input(Input::LinkLost);
    bench.wait(20.0);
    bench.input(Input::LinkRestored);
    bench.wait(1.9);
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(pose("r2", 5.0, 0.0));
    bench.wait(0.2);
    assert_eq!(bench.happened(), ["link back after 20 s"]);
    assert_eq!(["r1", "r2"].map(|robot| bench.presence(robot)), [Some(Active); 2]);
}

#[test]
fn tokens_that_are_lost_with_the_link_are_no_sign_of_dead_robots() {
    let mut bench = Bench::default();
    for name in ["dead", "shortly", "during", "never"] {
        bench.receive(token(name, true));
    }
    bench.wait(1.0);
    bench.happened();
    bench.receive(token("dead", false));
    bench.wait(2.5);
    assert_eq!(bench.happened(), ["stale dead"]);
    bench.receive(token("shortly", false));
    bench.wait(0.3);
    bench.input(Input::LinkLost);
    bench.receive(token("during", false));
    bench.wait(60.0);
    bench.input(Input::LinkRestored);
    bench.happened();
    bench.receive(token("shortly", true));
    bench.wait(0.2);
    assert_eq!(bench.presence("dead"), Some(Stale), "the link's return is no sign of life");
    bench.wait(1.7);
    assert!(bench.happened().is_empty());
    bench.wait(0.1);
    assert_eq!(bench.happened(), ["stale during"], "has not come back");
    bench.wait(20.0);
    assert_eq!(bench.happened(), ["left dead during"]);
    assert_eq!(bench.names(), ["never", "shortly"]);
}

#[test]
fn messages_during_an_outage_are_kept() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(3.0);
    bench.input(Input::LinkLost);
    bench.wait(1.0);
    bench.happened();
    bench.receive(pose("r1", 5.0, 0.0));
    bench.receive(pose("r2", 6.0, 0.0));
    assert!(bench.happened().is_empty(), "its output is suppressed");
    bench.wait(1.0);
    bench.input(Input::LinkRestored);
    bench.wait(0.2);
    assert_eq!(bench.happened(), ["link back after 2 s", "recovered r1"]);
    assert_eq!(bench.entry("r1").unwrap().position, Some([5.0, 0.0, 0.0]));
    assert_eq!(bench.names(), ["r1", "r2"]);
}

#[test]
fn a_new_grace_period_is_applied_at_once() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(3.0);
    assert_eq!(bench.happened(), ["joined r1", "stale r1"]);
    bench.set(&json!({"stale_after_s": 5.0}));
    bench.wait(0.1);
    assert_eq!(bench.happened(), ["recovered r1"]);
    bench.set(&json!({"stale_after_s": 1.0, "gone_after_s": 2.0}));
    bench.wait(0.001);
    assert_eq!(bench.happened(), ["left r1"]);
}

#[test]
fn an_empty_roster_is_published_again_and_again() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(10.2);
    assert!(bench.names().is_empty());
    let frames = bench.frame_times().len();
    bench.wait(5.0);
    assert_eq!(bench.frame_times().len(), frames + 5);
}

#[test]
fn the_return_of_the_link_makes_no_stale_robot_active_and_gives_it_time_to_speak() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(9.0);
    bench.happened();
    bench.input(Input::LinkLost);
    bench.wait(5.0);
    bench.input(Input::LinkRestored);
    bench.wait(9.9);
    assert_eq!(bench.happened(), ["link back after 5 s"]);
    assert_eq!(bench.presence("r1"), Some(Stale));
    bench.wait(0.1);
    assert_eq!(bench.happened(), ["left r1"]);
}

#[test]
fn a_pause_is_no_outage_and_no_robot_is_judged_by_the_time_that_ingest_did_not_run() {
    let mut bench = Bench::default();
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(rank("r2", None, None));
    bench.wait(1.5);
    bench.happened();
    bench.now = bench.now.after(bench::seconds(3.0));
    bench.input(Input::Timer);
    assert!(bench.happened().is_empty());
    assert!(!bench.events.iter().any(|event| matches!(event, EventKind::LinkRestored { .. })));
    bench.wait(1.999);
    assert!(bench.happened().is_empty(), "their grace period begins again");
    assert_eq!(bench.presence("r1"), Some(Active));
    bench.wait(0.1);
    assert_eq!(bench.happened(), ["stale r1 r2"]);
    // A real outage is reported as before.
    bench.input(Input::LinkLost);
    bench.wait(3.0);
    bench.input(Input::LinkRestored);
    assert_eq!(bench.happened(), ["link back after 3 s"]);
}

/// A standby takes the fleet over with what robots report once.
#[test]
fn a_standby_that_was_paused_takes_no_robot_for_gone() {
    let mut bench = Bench::asleep(IngestSettings::default());
    let Message::Roster(roster) = bench::roster_of(bench::START, Vec::new()) else { panic!() };
    bench.begin_inquiry();
    bench.answer_all(vec![Message::LeaseRenewal(Box::new(LeaseRenewal {
        header: roster.header.clone(),
        service: ServiceName::Ingest,
        instance: InstanceId::new("other-1").unwrap(),
    }))]);
    bench.receive(pose("r1", 0.0, 0.0));
    bench.receive(rank("r1", None, None));
    bench.wait(0.1);
    bench.now = bench.now.after(bench::seconds(30.0));
    bench.input(Input::Timer);
    bench.wait(0.1);
    assert_eq!(bench.status().standing, ReplicaState::Standby);
    assert_eq!(bench.status().departed, [], "it did not run");
}

/// With others about, a leader that was paused waits until its link has proved sound.
#[test]
fn a_paused_leader_with_peers_marks_no_robot_stale_until_it_is_confirmed() {
    let mut bench = Bench::default();
    let instance = InstanceId::new("other-1").unwrap();
    let token = Message::ServiceToken { service: ServiceName::Ingest, instance, alive: true };
    bench.receive(token.to_packet(bench.space()));
    bench.receive(pose("r1", 0.0, 0.0));
    bench.wait(0.5);
    bench.happened();
    let frames = bench.frame_times().len();
    bench.now = bench.now.after(bench::seconds(3.0));
    bench.input(Input::Timer);
    assert_eq!(bench.status().standing, ReplicaState::Suspect);
    assert_eq!(bench.status().state, "1 robot, 0 stale, the process was paused");
    bench.wait(0.6);
    assert_eq!(bench.frame_times().len(), frames);
    bench.wait(0.2);
    assert_eq!(bench.status().standing, ReplicaState::Leading);
    assert!(bench.frame_times().len() > frames);
    assert!(bench.events.is_empty(), "neither stale robots nor a restored link");
    // A link that is lost while it is paused is an outage.
    bench.now = bench.now.after(bench::seconds(3.0));
    bench.input(Input::LinkLost);
    bench.wait(2.0);
    bench.input(Input::LinkRestored);
    bench.wait(0.7);
    assert_eq!(bench.happened(), ["link back after 2.7 s"]);
}

#[test]
fn robots_that_are_lost_together_are_one_event_and_remembered_for_an_hour() {
    let mut bench = Bench::default();
    let names: Vec<String> = (0..18).map(|number| format!("r{number:02}")).collect();
    // Each puts ten poses a second, at a phase of its own.
    for name in &names {
        bench.receive(pose(name, 0.0, 0.0));
        bench.wait(0.1 / 18.0);
    }
    bench.happened();
    let listed = names.join(" ");
    bench.wait(2.5);
    assert_eq!(bench.happened(), [format!("stale {listed}")]);
    assert_eq!(bench.counter("robots_left"), 1, "one before the test");
    bench.wait(8.0);
    assert_eq!(bench.happened(), [format!("left {listed}")]);
    let departed = |bench: &mut Bench| -> Vec<String> {
        bench.status().departed.iter().map(|departure| departure.robot.to_string()).collect()
    };
    let mut known = departed(&mut bench);
    known.sort();
    assert_eq!(known, [&["last".to_owned()], names.as_slice()].concat());
    bench.receive(pose("r07", 0.0, 0.0));
    assert!(!departed(&mut bench).contains(&"r07".to_owned()), "it is here again");
    bench.wait(3600.0);
    assert_eq!(departed(&mut bench), ["r07"], "the others have left more than an hour ago");
}

#[test]
fn robots_that_come_back_together_are_one_event() {
    let mut bench = Bench::default();
    for name in ["r1", "r2", "r3"] {
        bench.receive(pose(name, 0.0, 0.0));
    }
    bench.wait(3.0);
    bench.happened();
    for name in ["r1", "r2", "r3"] {
        bench.receive(pose(name, 0.0, 0.0));
        bench.wait(0.03);
    }
    bench.wait(0.5);
    assert_eq!(bench.happened(), ["recovered r1 r2 r3"]);
}
