//! What ROS is shown of a fleet.

use std::sync::Arc;

use muster_model::audit::{Audit, Flapping, Quality, SilhouetteReport, Space};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, TeamId};
use muster_model::remembered::RememberedTeams;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::team_audit::{Radio, TeamAudit};
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;
use muster_ros::Path;

use super::*;

/// Every topic, also that for those who have built our messages.
const ALL: &str = "publish = { typed_teams = \"/muster/division\" }";

fn header(epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("f").unwrap(),
        revision: Revision { term: 1, epoch },
        oldest: None,
        newest: None,
        stages: Vec::new(),
    }
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

/// Two teams, t1 of r1 and r2, and t2 of r3.
fn teams(epoch: u64, silent: &[&str]) -> Arc<Teams> {
    let team = |id: &str, members: &[&str]| Team {
        id: TeamId::new(id).unwrap(),
        members: members.iter().map(|name| Member { robot: robot(name), margin: 0.5 }).collect(),
        leader: robot(members[0]),
        centroid: Vec::new(),
    };
    Arc::new(Teams {
        header: header(epoch),
        embedding: Revision::default(),
        requested: 2,
        considered: Vec::new(),
        teams: vec![team("t1", &["r1", "r2"]), team("t2", &["r3"])],
        unassigned: vec![robot("r4")],
        stale: silent.iter().map(|name| robot(name)).collect(),
        inertia: 0.0,
        changes: Vec::new(),
        next_team: 3,
        limited: None,
        needs: Vec::new(),
        provisional: Vec::new(),
        held: Vec::new(),
        remembered: RememberedTeams::default(),
    })
}

/// An audit with the silhouette of t1, and into how many parts its links fall.
fn audit(silhouette: f64, parts: u32) -> Arc<Audit> {
    let radio = Radio {
        parts,
        reached_by_leader: 2,
        cut_robot_count: 0,
        cut_robots: Vec::new(),
        bridges: 0,
        worst_cut: 0.0,
    };
    let team = TeamAudit {
        team: TeamId::new("t1").unwrap(),
        robots: 2,
        stale: 0,
        leader_stale: false,
        silhouette: Some(silhouette),
        least: None,
        conductance: Vec::new(),
        radio: Some(radio),
        heads: 1,
        only_head: None,
        spread: None,
        skills: Vec::new(),
    };
    Arc::new(Audit {
        header: header(1),
        teams: Revision::default(),
        embedding: Revision::default(),
        in_embedding: SilhouetteReport::undefined(Space::Embedding),
        in_physical: SilhouetteReport::undefined(Space::Physical),
        quality: Quality::Good,
        flapping: Flapping::default(),
        graphs: None,
        per_team: vec![team],
        losses: Vec::new(),
    })
}

/// A message as a program of ROS reads it.
struct Read(Arc<muster_ros::Layout>, Value);

impl Read {
    fn at(&self, path: &str) -> Value {
        let place = path.parse::<Path>().unwrap().find(&self.0).unwrap();
        place.get(&self.1).unwrap_or_else(|| panic!("{path} is not in {:?}", self.1)).clone()
    }

    fn text(&self, path: &str) -> String {
        self.at(path).as_text().unwrap().to_owned()
    }
}

/// The messages on a topic among what is to be done.
fn shown(world: &World, outputs: &[Output], topic: &str, type_name: &str) -> Vec<Read> {
    let name = TypeName::parse(type_name).unwrap();
    let layout = world.setup.catalog.layout(&name).unwrap();
    let on_topic = |output: &Output| match output {
        Output::Publish { key, payload, .. } if key.starts_with(&format!("0/{topic}/")) => {
            Some(Read(Arc::clone(&layout), muster_ros::cdr::decode(&layout, payload).unwrap()))
        }
        _ => None,
    };
    outputs.iter().filter_map(on_topic).collect()
}

/// The level of a team, and what is said of it.
fn status(world: &mut World, team: usize) -> (i64, String) {
    world.pass(1.0);
    let outputs = world.bridge.handle(world.now, Input::Tick);
    let found = shown(world, &outputs, "diagnostics", "diagnostic_msgs/DiagnosticArray");
    let read = &found[0];
    assert_eq!(read.text(&format!("status[{team}].name")), format!("muster: team t{}", team + 1));
    let level = read.at(&format!("status[{team}].level")).as_i64().unwrap();
    (level, read.text(&format!("status[{team}].message")))
}

#[test]
fn each_team_has_a_status_by_its_quality() {
    let mut world = World::new("");
    let divide = |world: &mut World, silent: &[&str], is_stale: bool| {
        let _ = world.bridge.handle(world.now, Input::Teams(teams(1, silent), is_stale));
    };
    divide(&mut world, &[], false);
    assert_eq!(status(&mut world, 0), (0, "good".to_owned()), "nothing is known of its quality");
    let judge = |world: &mut World, audit| {
        let _ = world.bridge.handle(world.now, Input::Audit(audit));
    };
    judge(&mut world, audit(0.7, 1));
    assert_eq!(status(&mut world, 0).0, 0);
    judge(&mut world, audit(-0.1, 1));
    assert_eq!(status(&mut world, 0), (1, "the team is hardly apart from others".to_owned()));
    judge(&mut world, audit(0.7, 2));
    assert_eq!(status(&mut world, 0), (1, "the team has parts that no link joins".to_owned()));
    judge(&mut world, audit(0.7, 1));
    divide(&mut world, &["r2"], false);
    assert_eq!(status(&mut world, 0), (1, "1 robots of the team are silent".to_owned()));
    divide(&mut world, &["r1", "r2"], false);
    assert_eq!(status(&mut world, 0), (2, "all robots of the team are silent".to_owned()));
    assert_eq!(status(&mut world, 1).0, 0, "the other team is as it was");
    divide(&mut world, &[], true);
    assert_eq!(status(&mut world, 0), (3, "no service publishes the division".to_owned()));
}

#[test]
fn messages_of_our_own_hold_the_division() {
    let mut world = World::new(ALL);
    let _ = world.bridge.handle(world.now, Input::Audit(audit(0.25, 1)));
    let outputs = world.bridge.handle(world.now, Input::Teams(teams(1, &["r2"]), false));
    let found = shown(&world, &outputs, "muster/division", "muster_msgs/Teams");
    let [read] = &found[..] else { panic!("{outputs:?}") };
    assert_eq!((read.text("fleet"), read.text("header.frame_id")), ("f".into(), "map".into()));
    assert_eq!(read.at("stale"), Value::Bool(false));
    assert_eq!(
        (read.text("teams[0].id"), read.text("teams[0].leader")),
        ("t1".into(), "r1".into())
    );
    assert_eq!(read.at("teams[0].members").as_list().unwrap().len(), 2);
    assert_eq!(read.text("teams[0].members[1]"), "r2");
    assert_eq!(read.at("teams[0].silhouette").as_f64(), Some(0.25));
    assert!(read.at("teams[1].silhouette").as_f64().unwrap().is_nan(), "it is not known");
    assert_eq!((read.text("unassigned[0]"), read.text("silent[0]")), ("r4".into(), "r2".into()));
    // Whether it may be valid no longer is said at once.
    let outputs = world.bridge.handle(world.now, Input::Teams(teams(1, &["r2"]), true));
    let found = shown(&world, &outputs, "muster/division", "muster_msgs/Teams");
    assert_eq!(found[0].at("stale"), Value::Bool(true));
}

/// A robot somewhere in a frame.
fn entry(name: &str, x: f64, frame: Option<&str>) -> RosterEntry {
    RosterEntry {
        node: 0,
        robot: robot(name),
        presence: Presence::Active,
        position: Some([x, 2.0, 0.0]),
        heading: None,
        frame: frame.map(str::to_owned),
        superior: None,
        role: None,
        skills: Vec::new(),
        last_seen: Tick(0),
    }
}

#[test]
fn markers_leave_out_robots_of_other_frames() {
    let drawn = |topics: &str, own: Option<&str>| {
        let mut world = World::new(topics);
        if let Some(name) = own {
            let pose = world.odometry("map", 1.0, 2.0);
            world.put(&format!("{name}/odom"), &pose);
            world.tick();
        }
        let robots = vec![
            entry("r1", 1.0, Some("hall")),
            entry("r2", 3.0, Some("yard")),
            entry("r3", 5.0, Some("yard")),
        ];
        let roster = Roster { header: header(1), robots, graphs: Vec::new() };
        let _ = world.bridge.handle(world.now, Input::Roster(Arc::new(roster)));
        let outputs = world.bridge.handle(world.now, Input::Teams(teams(1, &[]), false));
        let found = shown(&world, &outputs, "muster/markers", "visualization_msgs/MarkerArray");
        let count = found[0].at("markers").as_list().unwrap().len();
        // Behind the one that takes all away: balls and a name of each team.
        let names = (2..count).step_by(2).map(|number| {
            let marker = format!("markers[{number}]");
            let x = found[0].at(&format!("{marker}.pose.position.x")).as_f64().unwrap();
            format!("{} {x}", found[0].text(&format!("{marker}.text")))
        });
        names.collect::<Vec<_>>()
    };
    assert_eq!(drawn("frame = \"yard\"", Some("r1")), ["t1 3", "t2 5"], "that of the file");
    assert_eq!(drawn("", Some("r3")), ["t1 3", "t2 5"], "that of the robots of the bridge");
    assert_eq!(drawn("", Some("r1")), ["t1 1"]);
    assert_eq!(drawn("", None), ["t1 1"], "that of the first robot");
    assert_eq!(drawn("frame = \"roof\"", Some("r1")), [""; 0]);
}

#[test]
fn markers_stand_where_the_robots_of_each_team_are() {
    let mut world = World::new("");
    let robots = vec![entry("r1", 1.0, None), entry("r2", 3.0, None)];
    let roster = Roster { header: header(1), robots, graphs: Vec::new() };
    let _ = world.bridge.handle(world.now, Input::Roster(Arc::new(roster)));
    let outputs = world.bridge.handle(world.now, Input::Teams(teams(1, &[]), false));
    let found = shown(&world, &outputs, "muster/markers", "visualization_msgs/MarkerArray");
    let read = &found[0];
    let count = read.at("markers").as_list().unwrap().len();
    assert_eq!(count, 3, "all old ones are taken away; balls and a name; t2 is nowhere");
    assert_eq!(read.at("markers[0].action").as_i64(), Some(3));
    let (balls, name) = ("markers[1]", "markers[2]");
    assert_eq!(read.at(&format!("{balls}.type")).as_i64(), Some(7));
    assert_eq!(read.text(&format!("{balls}.header.frame_id")), "map");
    assert_eq!(read.at(&format!("{balls}.points")).as_list().unwrap().len(), 2);
    assert_eq!(read.at(&format!("{balls}.points[1].x")).as_f64(), Some(3.0));
    assert_eq!(read.at(&format!("{balls}.pose.orientation.w")).as_f64(), Some(1.0));
    assert_eq!(read.text(&format!("{name}.text")), "t1");
    assert_eq!(read.at(&format!("{name}.pose.position.x")).as_f64(), Some(2.0));
}

#[test]
fn a_robot_is_shown_its_team_while_that_holds_and_its_topic_goes_with_it() {
    let mut world = World::new("");
    let pose = world.odometry("map", 1.0, 2.0);
    world.put("r1/odom", &pose);
    world.tick();
    let string = "std_msgs/String";
    let outputs = world.bridge.handle(world.now, Input::Teams(teams(1, &[]), false));
    let of_r1 = shown(&world, &outputs, "r1/team", string);
    assert!(of_r1[0].text("data").contains("\"team\":\"t1\""), "{}", of_r1[0].text("data"));
    assert!(shown(&world, &outputs, "r2/team", string).is_empty(), "r2 is no robot of ROS");
    let outputs = world.bridge.handle(world.now, Input::Teams(teams(1, &[]), true));
    assert!(shown(&world, &outputs, "r1/team", string).is_empty(), "it may be valid no longer");
    assert_eq!(shown(&world, &outputs, "muster/teams", string).len(), 1);
    let _ = world.bridge.handle(world.now, Input::Teams(teams(2, &[]), false));
    let mut withdrawn = Vec::new();
    for _ in 0..80 {
        world.pass(1.0);
        let outputs = world.bridge.handle(world.now, Input::Tick);
        withdrawn.extend(outputs.into_iter().filter_map(|output| match output {
            Output::Withdraw(token) => Some(token),
            _ => None,
        }));
    }
    let of_team =
        withdrawn.iter().filter(|token| token.contains("/MP/") && token.contains("%r1%team"));
    assert_eq!(of_team.count(), 1, "{withdrawn:?}");
}

#[test]
fn who_has_another_team_is_shown_it_before_all_others() {
    let mut world = World::new("");
    for name in ["r1", "r2", "r3"] {
        let pose = world.odometry("map", 1.0, 2.0);
        world.put(&format!("{name}/odom"), &pose);
    }
    world.tick();
    let _ = world.bridge.handle(world.now, Input::Teams(teams(1, &[]), false));
    // r2 goes to the team of r3.
    let mut after = Teams::clone(&teams(2, &[]));
    let goes = after.teams[0].members.pop().unwrap();
    after.teams[1].members.insert(0, goes);
    let outputs = world.bridge.handle(world.now, Input::Teams(Arc::new(after), false));
    let order: Vec<&str> = outputs
        .iter()
        .filter_map(|output| match output {
            Output::Publish { key, .. } => key.split('/').nth(1).filter(|name| name.len() == 2),
            _ => None,
        })
        .collect();
    assert_eq!(order, ["r2", "r1", "r3"]);
}

#[test]
fn every_standard_message_with_a_pose_is_moved_from_the_frame_of_its_head() {
    let types = [
        ("geometry_msgs/PoseStamped", "pose"),
        ("geometry_msgs/PoseWithCovarianceStamped", "pose.pose"),
        ("nav_msgs/Odometry", "pose.pose"),
    ];
    for (type_name, pose) in types {
        let topics = format!("[[pose]]\ntopic = \"/{{robot}}/pose\"\ntype = \"{type_name}\"\n");
        let mut world = World::new(&topics);
        world.localise("r1/tf", "map", "odom");
        let mut message = world.message(type_name);
        message.set("header.frame_id", "odom").unwrap();
        message.set(&format!("{pose}.position.x"), 1.0).unwrap();
        message.set(&format!("{pose}.position.y"), 2.0).unwrap();
        world.put("r1/pose", &message);
        near(&world.pose(), 8.0, 1.0, Some(std::f64::consts::FRAC_PI_2));
    }
}
