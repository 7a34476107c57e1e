//! Fleets in files.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use muster_scenario::{Fleet, FleetOptions, Layout};

/// Two pairs and a leader who belongs to neither, with `change` in place of `what`.
fn text(what: &str, change: &str) -> String {
    let text = r#"{
        "name": "pairs", "velocity": [1.0, 0.0],
        "robots": [
            {"id": "a", "role": "member", "superior": "lead", "at": [0.0, 0.0]},
            {"id": "b", "role": "member", "superior": "lead", "at": [1.0, 0.0]},
            {"id": "c", "role": "member", "superior": "lead", "at": [50.0, 0.0]},
            {"id": "d", "role": "member", "superior": "c", "at": [51.0, 0.0]},
            {"id": "lead", "role": "leader", "superior": null, "at": [25.0, 0.0]}
        ],
        "nets": [["a", "b", "lead"], ["c", "d", "lead"]],
        "divisions": [[["a", "b"], ["d", "c"]], [["a", "b"], ["c", "d"], ["lead"]]]
    }"#;
    assert!(text.contains(what));
    text.replacen(what, change, 1)
}

#[test]
fn a_file_is_a_fleet_with_its_nets_and_divisions() {
    let layout = Layout::read(&text("", "")).unwrap();
    assert_eq!(layout.superiors, [Some(4), Some(4), Some(4), Some(2), None]);
    assert_eq!(layout.nets, [[0, 1, 4], [2, 3, 4]]);
    assert_eq!(layout.divisions[0], [Some(0), Some(0), Some(1), Some(1), None]);
    assert_eq!([0, 1, 2].map(|division| layout.teams(division)), [2, 3, 0]);
}

#[test]
fn it_marches_and_comes_back_while_all_keep_their_places() {
    let layout = Layout::read(&text("", "")).unwrap();
    let still = FleetOptions { noise_m: 0.0, radio_range_m: 10.0, ..FleetOptions::default() };
    let fleet = Fleet::of_layout(&layout, still).unwrap();
    assert_eq!(fleet.robots().len(), 5);
    for (t, gone, heading) in
        [(0.0, 0.0, 0.0), (30.0, 30.0, 0.0), (100.0, 20.0, std::f64::consts::PI)]
    {
        let poses = fleet.poses(t);
        for (pose, at) in poses.iter().zip(&layout.places) {
            assert_eq!((pose.x, pose.y), (at[0] + gone, at[1]), "{t} s");
            assert_eq!(pose.heading, Some(heading));
        }
    }
    assert_eq!(fleet.truth(7.0), [0, 0, 1, 1, 2]);
    assert_eq!(fleet.ranks(0.0)[4].role.as_deref(), Some("leader"));
    let counts: Vec<usize> = fleet.links(5.0).iter().map(|links| links.links.len()).collect();
    assert_eq!(counts, [1, 1, 1, 1, 0], "the leader is out of range of all");
}

#[test]
fn what_is_wrong_is_named_with_the_remedy() {
    let problem =
        |what: &str, change: &str| Layout::read(&text(what, change)).unwrap_err().to_string();
    assert_eq!(problem("\"id\": \"b\"", "\"id\": \"a\""), "robots[1].id: a stands twice");
    let unknown = problem("\"superior\": \"c\"", "\"superior\": \"x\"");
    assert_eq!(unknown, "robots[3].superior: x is none of the robots");
    let itself = problem("\"superior\": \"c\"", "\"superior\": \"d\"");
    assert_eq!(itself, "robots[3].superior: d cannot answer to itself");
    assert!(problem("[50.0, 0.0]", "[5e9, 0.0]").starts_with("robots[2].at: must be within"));
    assert!(
        problem("[1.0, 0.0],\n        \"robots\"", "[1e9, 0.0],\n        \"robots\"")
            .starts_with("velocity")
    );
    assert_eq!(problem("[\"a\", \"b\", \"lead\"]", "[\"z\"]"), "nets[0]: z is none of the robots");
    assert_eq!(problem("[\"d\", \"c\"]", "[\"a\"]"), "divisions[0][1]: a stands in two teams");
    assert_eq!(problem("[\"d\", \"c\"]", "[]"), "divisions[0][1]: must have a robot");
    assert!(problem("\"nets\"", "\"nest\"").contains("unknown field `nest`"));
    assert!(Layout::read("").unwrap_err().to_string().starts_with("(file)"));
    let none =
        text("", "").split("\"divisions\"").next().unwrap().to_owned() + "\"divisions\": []}";
    assert!(Layout::read(&none).unwrap_err().to_string().starts_with("divisions: must be one"));
    let empty = r#"{"name": "", "robots": [], "divisions": []}"#;
    assert!(Layout::read(empty).unwrap_err().to_string().starts_with("robots: must be 1 to"));
}
