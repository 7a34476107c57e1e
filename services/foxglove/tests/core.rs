//! The core: what is sent when, what scenes show, and how parameters are changed.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::sync::Arc;

use muster_foxglove::limits::{
    LOST_FOR, MAX_LINKS, MAX_PENDING_CHANGES, MAX_TURN_MESSAGES, PARAMETERS_WITHIN, SETTINGS_PERIOD,
};
use muster_foxglove::scene::{Entity, Message, Scene, Transform};
use muster_foxglove::{
    Access, Bridge, Fetch, Input, Output, Parameter, TEAMS, Ticket, Topic, WEIGHTS, team_color,
};
use muster_model::audit::{Audit, Flapping, Quality, SilhouetteReport, Space};
use muster_model::event::{Event, EventKind, Severity};
use muster_model::header::Revision;
use muster_model::id::{FleetId, Modality, OperatorId, ServiceName};
use muster_model::roster::{Presence, Roster};
use muster_model::time::Tick;
use serde_json::{Value, json};

use fleet::{graph, header, robot, roster, teams};

mod fleet;

/// A moment in milliseconds after the start.
fn at(milliseconds: u64) -> Tick {
    Tick(1_795_208_000_000_000 + milliseconds * 1_000)
}

fn links() -> Topic {
    Topic::Links(Modality::spatial())
}

fn kim() -> OperatorId {
    OperatorId::new("kim").unwrap()
}

/// A bridge with a link, whose topics are watched.
fn bridge(access: Access, watched: &[Topic]) -> Bridge {
    let mut bridge = Bridge::new(FleetId::new("grid").unwrap(), access);
    bridge.handle(at(0), Input::Link(true));
    bridge.handle(at(0), Input::Watched(watched.iter().cloned().collect()));
    bridge
}

fn show(bridge: &mut Bridge, now: u64, roster: Roster) {
    bridge.handle(at(now), Input::Roster(Arc::new(roster), None));
}

fn sent(outputs: Vec<Output>) -> Vec<(Topic, Message)> {
    let sent = outputs.into_iter().filter_map(|output| match output {
        Output::Send(topic, message) => Some((topic, message)),
        _ => None,
    });
    sent.collect()
}

/// The scene of a topic that is sent at a moment.
fn scene(bridge: &mut Bridge, now: u64, topic: &Topic) -> Scene {
    let all = sent(bridge.handle(at(now), Input::Tick));
    let found = all.into_iter().find(|(sent, _)| sent == topic);
    match found {
        Some((_, Message::Scene(scene))) => scene,
        other => panic!("{topic:?}: {other:?}"),
    }
}

fn entity<'a>(scene: &'a Scene, id: &str) -> &'a Entity {
    let found = scene.entities.iter().find(|entity| entity.id == id);
    let names: Vec<_> = scene.entities.iter().map(|entity| &entity.id).collect();
    found.unwrap_or_else(|| panic!("{id} is none of {names:?}"))
}

fn audit(epoch: u64) -> Arc<Audit> {
    let mut in_embedding = SilhouetteReport::undefined(Space::Embedding);
    in_embedding.mean = Some(0.5);
    in_embedding.per_robot = vec![(robot(1), 0.5)];
    Arc::new(Audit {
        header: header(1, epoch),
        teams: Revision::default(),
        embedding: Revision::default(),
        in_embedding,
        in_physical: SilhouetteReport::undefined(Space::Physical),
        quality: Quality::Good,
        flapping: Flapping::default(),
        graphs: None,
        per_team: Vec::new(),
        losses: Vec::new(),
    })
}

#[test]
fn what_no_one_watches_is_not_made() {
    let mut bridge = bridge(Access::ReadOnly, &[]);
    show(&mut bridge, 10, roster(10, 1));
    bridge.handle(at(20), Input::Teams(teams(10, 2), None));
    bridge.handle(at(30), Input::Audit(audit(1), None));
    for turn in 1..50 {
        assert!(sent(bridge.handle(at(turn * 100), Input::Tick)).is_empty());
    }
    bridge.handle(at(5_000), Input::Watched(BTreeSet::from([Topic::Quality])));
    let all = sent(bridge.handle(at(5_100), Input::Tick));
    assert_eq!(all.len(), 1);
    let (Topic::Quality, Message::Json(quality)) = &all[0] else { panic!("{all:?}") };
    assert_eq!(quality["silhouette"]["mean"], 0.5);
    assert_eq!(quality["silhouette"]["per_robot"], json!({}), "single robots are left out");
}

#[test]
fn scenes_come_ten_times_a_second_and_no_turn_has_more_than_may_wait() {
    let modalities: Vec<Modality> =
        (0..20).map(|at| Modality::new(format!("m{at}")).unwrap()).collect();
    let mut watched = vec![Topic::Transforms, Topic::Teams, Topic::Quality, Topic::Events];
    watched.extend(modalities.iter().cloned().map(Topic::Links));
    let mut bridge = bridge(Access::ReadOnly, &watched);
    bridge.handle(at(0), Input::Teams(teams(10, 2), None));
    for modality in &modalities {
        let mut graph = (*graph(10, 1)).clone();
        graph.modality = modality.clone();
        bridge.handle(at(0), Input::Graph(Arc::new(graph)));
    }
    let mut count = std::collections::BTreeMap::<Topic, usize>::new();
    // A second in which everything changes every 7 ms.
    for (epoch, now) in (1_000..2_000).step_by(7).enumerate() {
        show(&mut bridge, now, roster(10, epoch as u64));
        bridge.handle(at(now), Input::Audit(audit(epoch as u64), None));
        bridge.handle(at(now), Input::Event(Box::new(joined())));
        let turn = sent(bridge.handle(at(now), Input::Tick));
        assert!(turn.len() <= MAX_TURN_MESSAGES, "{} messages in one turn", turn.len());
        for (topic, _) in turn {
            *count.entry(topic).or_default() += 1;
        }
    }
    for topic in [Topic::Transforms, Topic::Teams, Topic::Quality] {
        assert_eq!(count[&topic], 10, "{topic:?}");
    }
    for modality in modalities {
        assert_eq!(count[&Topic::Links(modality)], 1, "each has its turn");
    }
}

fn joined() -> Event {
    Event {
        header: header(1, 1),
        source: ServiceName::Ingest,
        severity: Severity::Info,
        kind: EventKind::RobotJoined { robot: robot(1) },
    }
}

#[test]
fn a_scene_that_rests_is_repeated_and_a_new_viewer_has_it_at_once() {
    let mut bridge = bridge(Access::ReadOnly, &[Topic::Teams, Topic::Quality]);
    show(&mut bridge, 0, roster(4, 1));
    bridge.handle(at(0), Input::Audit(audit(1), None));
    assert_eq!(sent(bridge.handle(at(100), Input::Tick)).len(), 2);
    let mut later = 0;
    for turn in 2..31 {
        // It is looked at again although nothing says that it changed.
        bridge.handle(at(turn * 100), Input::Audit(audit(1), None));
        later += sent(bridge.handle(at(turn * 100), Input::Tick)).len();
    }
    assert_eq!(later, 2, "the scene once a second, and no number twice");
    assert!(sent(bridge.handle(at(3_150), Input::Tick)).len() <= 1);
    bridge.handle(at(3_160), Input::Subscribed(Topic::Quality));
    assert_eq!(sent(bridge.handle(at(3_260), Input::Tick)).len(), 1);
}

#[test]
fn each_robot_has_a_frame_where_it_is() {
    let mut bridge = bridge(Access::ReadOnly, &[Topic::Transforms]);
    let mut shown = roster(3, 1);
    shown.robots[1].position = None;
    shown.robots[2].frame = None;
    let positions: Vec<_> = shown.robots.iter().map(|entry| entry.position).collect();
    show(&mut bridge, 0, shown);
    let all = sent(bridge.handle(at(100), Input::Tick));
    let (_, Message::Transforms(transforms)) = &all[0] else { panic!("{all:?}") };
    let expected = |node: u32, position: Option<[f64; 3]>| Transform {
        parent: "map".to_owned(),
        child: robot(node).to_string(),
        position: position.unwrap(),
        heading: 0.5,
    };
    assert_eq!(transforms, &[expected(0, positions[0]), expected(2, positions[2])]);
}

#[test]
fn each_team_is_one_entity_in_the_colour_of_its_id() {
    let mut bridge = bridge(Access::ReadOnly, &[Topic::Teams]);
    show(&mut bridge, 0, roster(9, 1));
    bridge.handle(at(0), Input::Teams(teams(8, 2), None));
    let shown = scene(&mut bridge, 100, &Topic::Teams);
    let names: Vec<_> = shown.entities.iter().map(|entity| entity.id.as_str()).collect();
    assert_eq!(names, ["unassigned", "team/t1", "team/t2"]);
    for id in ["t1", "t2"] {
        let team = entity(&shown, &format!("team/{id}"));
        assert_eq!(team.spheres.len(), 4);
        assert!(team.spheres.iter().all(|sphere| sphere.color == team_color(id)));
        assert_eq!(team.texts[0].text, format!("{id} · 4"));
        assert_eq!(team.lines.len(), 1, "the hull");
        assert_eq!(team.lines[0].color, team_color(id));
        assert_eq!(team.facts[0], ("team", id.to_owned()));
    }
    assert_eq!(entity(&shown, "unassigned").spheres.len(), 1);
    // A team that is gone is removed, and the other keeps its colour.
    let mut left = (*teams(8, 2)).clone();
    left.teams.remove(0);
    bridge.handle(at(150), Input::Teams(Arc::new(left), None));
    let shown = scene(&mut bridge, 200, &Topic::Teams);
    assert_eq!(shown.removed, ["team/t1"]);
    assert_eq!(entity(&shown, "team/t2").spheres[0].color, team_color("t2"));
    assert_eq!(entity(&shown, "unassigned").spheres.len(), 5);
}

#[test]
fn positions_of_other_frames_are_entities_of_their_own() {
    let mut bridge = bridge(Access::ReadOnly, &[Topic::Teams]);
    let mut shown = roster(4, 1);
    shown.robots[3].frame = Some("hall".to_owned());
    show(&mut bridge, 0, shown);
    bridge.handle(at(0), Input::Teams(teams(4, 1), None));
    let shown = scene(&mut bridge, 100, &Topic::Teams);
    assert_eq!(entity(&shown, "team/t1").spheres.len(), 3);
    let other = entity(&shown, "team/t1@hall");
    assert_eq!((other.spheres.len(), other.frame.as_str()), (1, "hall"));
}

#[test]
fn who_is_silent_or_lost_stays_grey_with_an_age() {
    let mut bridge = bridge(Access::ReadOnly, &[Topic::Teams]);
    let seen = |mut roster: Roster| {
        roster.robots.iter_mut().for_each(|entry| entry.last_seen = at(0));
        roster
    };
    show(&mut bridge, 0, seen(roster(4, 1)));
    bridge.handle(at(0), Input::Teams(teams(4, 1), None));
    let mut later = seen(roster(4, 1));
    later.robots[1].presence = Presence::Stale;
    later.robots.remove(2);
    show(&mut bridge, 30_000, later);
    let shown = scene(&mut bridge, 30_000, &Topic::Teams);
    assert_eq!(entity(&shown, "team/t1").spheres.len(), 2);
    let missing = entity(&shown, "missing");
    let grey = missing.spheres[0].color;
    assert!(grey.r == grey.g && grey.g == grey.b && missing.spheres.len() == 2);
    let texts: Vec<_> = missing.texts.iter().map(|text| text.text.as_str()).collect();
    assert_eq!(texts, ["r00001 30 s", "r00002 30 s"]);
    // One comes back; the other is forgotten in time.
    show(&mut bridge, 31_000, seen(roster(2, 1)));
    let shown = scene(&mut bridge, 31_100, &Topic::Teams);
    assert_eq!(entity(&shown, "missing").spheres.len(), 2, "r00002 and r00003");
    let forgotten = 31_200 + u64::try_from(LOST_FOR.as_millis()).unwrap();
    let shown = scene(&mut bridge, forgotten, &Topic::Teams);
    assert!(shown.entities.iter().all(|entity| entity.id != "missing"), "{shown:?}");
    assert_eq!(shown.removed, ["missing"]);
}

#[test]
fn links_join_the_robots_of_their_graph_and_are_bounded() {
    let robots = 3_000;
    let mut bridge = bridge(Access::ReadOnly, &[links()]);
    show(&mut bridge, 0, roster(robots, 1));
    bridge.handle(at(0), Input::Graph(graph(robots, 1)));
    let shown = scene(&mut bridge, 100, &links());
    let lines: usize = shown.entities[0].lines.iter().map(|lines| lines.points.len() / 2).sum();
    assert_eq!(lines, MAX_LINKS, "of {}", robots * 6);
    // Stronger links are less transparent.
    let opacities: Vec<_> = shown.entities[0].lines.iter().map(|lines| lines.color.a).collect();
    assert!(opacities.is_sorted() && opacities.len() > 2, "{opacities:?}");
    // They move with the robots.
    let first = shown.entities[0].lines[0].points[0];
    show(&mut bridge, 150, roster(robots, 11));
    let moved = scene(&mut bridge, 200, &links()).entities[0].lines[0].points[0];
    assert!((moved[0] - first[0] - 1.0).abs() < 1e-9, "{first:?} {moved:?}");
    // A graph of another term numbers other robots.
    bridge.handle(at(250), Input::Graph(graph(robots, 2)));
    assert!(scene(&mut bridge, 300, &links()).entities.is_empty());
}

#[test]
fn graphs_are_asked_for_while_they_are_watched_and_settings_always() {
    let mut bridge = bridge(Access::ReadOnly, &[]);
    let fetched = |outputs: Vec<Output>| -> Vec<Fetch> {
        let fetched = outputs.into_iter().filter_map(|output| match output {
            Output::Fetch(fetch) => Some(fetch),
            _ => None,
        });
        fetched.collect()
    };
    let settings = [ServiceName::Clusterer, ServiceName::Embedder].map(Fetch::Settings);
    assert_eq!(fetched(bridge.handle(at(100), Input::Tick)), settings);
    assert!(fetched(bridge.handle(at(150), Input::Tick)).is_empty(), "they are asked for");
    bridge.handle(at(200), Input::Watched(BTreeSet::from([links()])));
    let graph = Fetch::Graph(Modality::spatial());
    assert_eq!(fetched(bridge.handle(at(300), Input::Tick)), std::slice::from_ref(&graph));
    bridge.handle(at(300), Input::Unfetched(graph.clone()));
    assert!(fetched(bridge.handle(at(400), Input::Tick)).is_empty(), "once a second");
    assert_eq!(fetched(bridge.handle(at(1_400), Input::Tick)), [graph]);
    bridge.handle(at(1_500), Input::Link(false));
    assert!(fetched(bridge.handle(at(60_000), Input::Tick)).is_empty(), "no one would answer");
}

fn parameter(name: &str, value: Value) -> Parameter {
    Parameter { name: name.to_owned(), value: Some(value) }
}

/// A bridge that knows the settings.
fn with_settings(access: Access) -> Bridge {
    let mut bridge = bridge(access, &[]);
    bridge.handle(at(0), Input::Settings(ServiceName::Clusterer, json!({"teams": 2})));
    let weights = json!({"weights": {"spatial": 0.5}});
    bridge.handle(at(0), Input::Settings(ServiceName::Embedder, weights));
    bridge
}

fn command(outputs: &[Output]) -> Ticket {
    let found = outputs.iter().find_map(|output| match output {
        Output::Command(ticket, operator, _, _) => {
            assert_eq!(*operator, kim());
            Some(*ticket)
        }
        _ => None,
    });
    found.unwrap_or_else(|| panic!("{outputs:?}"))
}

#[test]
fn a_question_for_parameters_waits_for_the_settings_but_not_forever() {
    let mut bridge = bridge(Access::ReadOnly, &[]);
    assert!(
        !bridge
            .handle(at(0), Input::Get(7, Vec::new()))
            .iter()
            .any(|o| matches!(o, Output::Respond(..)))
    );
    bridge.handle(at(10), Input::Settings(ServiceName::Clusterer, json!({"teams": 2})));
    let weights = json!({"weights": {"spatial": 0.5}});
    let outputs = bridge.handle(at(20), Input::Settings(ServiceName::Embedder, weights));
    let all = vec![parameter(TEAMS, json!(2)), parameter(WEIGHTS, json!({"spatial": 0.5}))];
    assert!(outputs.contains(&Output::Respond(7, all)), "{outputs:?}");
    let one = bridge.handle(at(30), Input::Get(8, vec![TEAMS.to_owned(), "other".to_owned()]));
    assert!(one.contains(&Output::Respond(8, vec![parameter(TEAMS, json!(2))])));

    let mut alone = self::bridge(Access::ReadOnly, &[]);
    alone.handle(at(0), Input::Get(1, Vec::new()));
    let waited = u64::try_from(PARAMETERS_WITHIN.as_millis()).unwrap();
    assert!(alone.handle(at(waited), Input::Tick).contains(&Output::Respond(1, Vec::new())));
}

#[test]
fn a_change_is_shown_as_the_service_confirmed_it() {
    let mut bridge = with_settings(Access::Changes(kim()));
    let outputs = bridge.handle(at(100), Input::Set(1, vec![parameter(TEAMS, json!(3))]));
    let ticket = command(&outputs);
    assert!(!outputs.iter().any(|o| matches!(o, Output::Respond(..) | Output::Publish(_))));
    // The service may confirm something else than was wished.
    let outputs = bridge.handle(at(200), Input::Answer(ticket, Ok(json!({"teams": 4}))));
    let confirmed = vec![parameter(TEAMS, json!(4))];
    assert!(outputs.contains(&Output::Publish(confirmed.clone())));
    assert!(outputs.contains(&Output::Respond(1, confirmed)));
    assert!(!outputs.iter().any(|o| matches!(o, Output::Refuse(..))));
}

#[test]
fn what_is_refused_is_said_with_its_reason_and_nothing_is_shown_that_does_not_hold() {
    let holds = vec![parameter(TEAMS, json!(2))];
    let mut read_only = with_settings(Access::ReadOnly);
    let outputs = read_only.handle(at(100), Input::Set(1, vec![parameter(TEAMS, json!(3))]));
    assert!(!outputs.iter().any(|o| matches!(o, Output::Command(..))));
    let refusal = outputs.iter().find_map(|o| match o {
        Output::Refuse(1, reason) => Some(reason.clone()),
        _ => None,
    });
    assert!(refusal.unwrap().contains("--allow-changes"));
    assert!(outputs.contains(&Output::Respond(1, holds.clone())));
    assert!(outputs.contains(&Output::Publish(holds.clone())));

    let mut bridge = with_settings(Access::Changes(kim()));
    let outputs = bridge.handle(at(100), Input::Set(2, vec![parameter(TEAMS, json!(0))]));
    let refused = Err("teams: must be 1 to 1024".to_owned());
    let outputs = bridge.handle(at(200), Input::Answer(command(&outputs), refused));
    assert!(outputs.contains(&Output::Refuse(2, "teams: must be 1 to 1024".to_owned())));
    assert!(outputs.contains(&Output::Respond(2, holds)));

    bridge.handle(at(300), Input::Link(false));
    let outputs = bridge.handle(at(300), Input::Set(3, vec![parameter(TEAMS, json!(3))]));
    assert!(outputs.iter().any(|o| matches!(o, Output::Refuse(3, why) if why.contains("link"))));
}

#[test]
fn changes_that_are_not_answered_are_bounded() {
    let mut bridge = with_settings(Access::Changes(kim()));
    let set = |bridge: &mut Bridge, id| {
        bridge.handle(at(100), Input::Set(id, vec![parameter(TEAMS, json!(3))]))
    };
    for id in 0..MAX_PENDING_CHANGES as u64 {
        command(&set(&mut bridge, id));
    }
    let outputs = set(&mut bridge, 99);
    assert!(
        outputs.iter().any(|o| matches!(o, Output::Refuse(99, why) if why.contains("too many")))
    );
}

#[test]
fn changes_by_others_are_shown_soon() {
    let mut bridge = with_settings(Access::ReadOnly);
    bridge.handle(at(0), Input::Tick);
    bridge.handle(at(10), Input::Settings(ServiceName::Clusterer, json!({"teams": 2})));
    bridge.handle(
        at(10),
        Input::Settings(ServiceName::Embedder, json!({"weights": {"spatial": 0.5}})),
    );
    let event =
        Event { kind: EventKind::SettingsChanged { settings: "{}".to_owned() }, ..joined() };
    bridge.handle(at(100), Input::Event(Box::new(event)));
    let outputs = bridge.handle(at(150), Input::Tick);
    assert!(SETTINGS_PERIOD.as_millis() > 150);
    assert!(outputs.contains(&Output::Fetch(Fetch::Settings(ServiceName::Clusterer))));
    let outputs =
        bridge.handle(at(200), Input::Settings(ServiceName::Clusterer, json!({"teams": 5})));
    assert!(outputs.contains(&Output::Publish(vec![parameter(TEAMS, json!(5))])));
}

#[test]
fn what_must_be_known_is_said_to_whoever_comes_and_taken_back() {
    let replay = FleetId::new("replay-grid").unwrap();
    let mut bridge = Bridge::new(replay, Access::ReadOnly);
    bridge.handle(at(0), Input::Watched(BTreeSet::from([Topic::Teams])));
    let said = |outputs: &[Output]| -> Vec<&'static str> {
        let said = outputs.iter().filter_map(|output| match output {
            Output::Say(name, _, _) => Some(*name),
            _ => None,
        });
        said.collect()
    };
    assert_eq!(said(&bridge.handle(at(0), Input::Joined)), ["link", "replay"]);
    assert!(said(&bridge.handle(at(0), Input::Tick)).is_empty(), "once");
    assert_eq!(said(&bridge.handle(at(0), Input::Joined)), ["link", "replay"]);
    let outputs = bridge.handle(at(10), Input::Link(true));
    assert!(outputs.contains(&Output::Unsay("link")));
    let stale = Input::Roster(Arc::new(roster(2, 1)), Some("silent"));
    assert_eq!(said(&bridge.handle(at(20), stale)), ["stale"]);
    let shown = scene(&mut bridge, 100, &Topic::Teams);
    let notice = &entity(&shown, "notice").texts[0].text;
    assert!(
        notice.contains("REPLAY: replay-grid") && notice.contains("old are roster"),
        "{notice}"
    );
}

#[test]
fn topics_are_offered_once_and_links_as_the_fleet_has_them() {
    let mut bridge = Bridge::new(FleetId::new("grid").unwrap(), Access::ReadOnly);
    let offered = |outputs: Vec<Output>| -> Vec<String> {
        let offered = outputs.into_iter().filter_map(|output| match output {
            Output::Offer(topic) => Some(topic.name()),
            _ => None,
        });
        offered.collect()
    };
    assert_eq!(
        offered(bridge.handle(at(0), Input::Tick)),
        ["/tf", "/teams", "/quality", "/events"]
    );
    assert!(offered(bridge.handle(at(0), Input::Tick)).is_empty());
    let outputs = bridge.handle(at(0), Input::Roster(Arc::new(roster(2, 1)), None));
    assert_eq!(offered(outputs), ["/links/spatial"]);
}
