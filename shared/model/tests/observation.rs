//! The checks of what robots report.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use muster_model::id::{Modality, RobotId, SkillId};
use muster_model::observation::{
    CheckedReport, Link, Links, Observation, Pose, Provenance, Rank, ReadObservation, Relation,
    Report, Stream,
};

fn pose(json: &str) -> Result<Pose, String> {
    let pose: Pose = serde_json::from_str(json).map_err(|error| error.to_string())?;
    pose.check().map_err(|error| error.to_string())?;
    Ok(pose)
}

#[test]
fn a_pose_needs_only_x_and_y() {
    assert!(pose(r#"{"x":1.0,"y":2}"#).is_ok());
    assert!(pose(r#"{"x":1.0}"#).is_err());
}

#[test]
fn unknown_keys_and_absurd_values_are_refused_by_name() {
    assert!(pose(r#"{"x":1.0,"y":2,"speed":3}"#).unwrap_err().contains("speed"));
    assert!(pose(r#"{"x":1e300,"y":2}"#).unwrap_err().contains("x:"));
    assert!(pose(r#"{"x":1,"y":2,"stamp":-1}"#).unwrap_err().contains("stamp"));
    let long = format!(r#"{{"x":1,"y":2,"frame":"{}"}}"#, "m".repeat(65));
    assert!(pose(&long).unwrap_err().contains("frame"));
    let nan = Pose { x: f64::NAN, ..pose(r#"{"x":1,"y":2}"#).unwrap() };
    assert_eq!(nan.check().unwrap_err().field, "x");
}

#[test]
fn a_link_in_json_is_an_object() {
    let by_position = r#"{"links":[["a",1.0]]}"#;
    assert!(serde_json::from_str::<Links>(by_position).unwrap_err().to_string().contains("object"));
}

#[test]
fn every_stream_has_a_name_a_modality_and_reads_its_own_content() {
    struct Json<'a>(&'a str);
    impl ReadObservation for Json<'_> {
        type Error = serde_json::Error;
        fn read<T: Observation>(&mut self) -> Result<T, Self::Error> {
            serde_json::from_str(self.0)
        }
    }
    let thermal = Stream::Relation(Modality::new("thermal").unwrap());
    let contents = [
        r#"{"x":1.0,"y":2.0,"z":null,"heading":null,"frame":null,"stamp":null,"boot":"a","seq":7}"#,
        r#"{"links":[{"peer":"r2","quality":0.5}],"stamp":null,"boot":"a","seq":7}"#,
        r#"{"superior":"r2","weight":null,"role":null,"stamp":null,"boot":"a","seq":7}"#,
        r#"{"edges":[["r1","r2",0.5]],"stamp":null,"boot":"a","seq":7}"#,
    ];
    for (stream, content) in Stream::BUILT_IN.into_iter().chain([thermal]).zip(contents) {
        let report = stream.read(&mut Json(content)).unwrap();
        assert_eq!(report.stream(), stream);
        assert_eq!(serde_json::to_string(&report).unwrap(), content);
        let built_in = Stream::built_in(stream.name());
        assert_eq!(built_in.is_some(), stream.modality().is_built_in());
        assert!(built_in.is_none_or(|named| named == stream));
        let checked = CheckedReport::new(RobotId::new("r1").unwrap(), report.clone()).unwrap();
        assert_eq!((checked.stream(), checked.report()), (stream, &report));
        let later = Provenance { seq: Some(8), ..report.provenance() };
        let checked = checked.with_provenance(later.clone()).unwrap();
        assert_eq!(checked.report().provenance(), later);
        let absurd = Provenance { stamp: Some(f64::NAN), ..later };
        assert_eq!(checked.with_provenance(absurd).unwrap_err().field, "stamp");
    }
}

#[test]
fn a_report_that_relates_a_robot_to_itself_is_refused_by_name() {
    let me = || RobotId::new("r1").unwrap();
    let relation = |from: &str, to: &str| Relation {
        edges: vec![(RobotId::new(from).unwrap(), RobotId::new(to).unwrap(), 1.0)],
        stamp: None,
        boot: None,
        seq: None,
    };
    let links = vec![Link { peer: me(), quality: 0.5 }];
    let thermal = || Modality::new("thermal").unwrap();
    let wrong: [(Report, &str); 4] = [
        (Links { links, stamp: None, boot: None, seq: None }.into(), "links.peer"),
        (Rank::under(Some(me())).into(), "superior"),
        ((thermal(), relation("r1", "r1")).into(), "edges"),
        ((thermal(), relation("r2", "r1")).into(), "edges"),
    ];
    for (report, field) in wrong {
        assert_eq!(CheckedReport::new(me(), report).unwrap_err().field, field);
    }
    assert!(CheckedReport::new(me(), (thermal(), relation("r1", "r2"))).is_ok());
}

#[test]
fn a_peer_named_twice_is_refused() {
    let links: Links =
        serde_json::from_str(r#"{"links":[{"peer":"a","quality":1},{"peer":"a","quality":0.5}]}"#)
            .unwrap();
    assert_eq!(links.check().unwrap_err().field, "links.peer");
}

#[test]
fn skills_are_few_and_each_stands_once() {
    let check = |skills: Vec<&str>| {
        let skills = skills.into_iter().map(|name| SkillId::new(name).unwrap()).collect();
        Rank { skills: Some(skills), ..Rank::under(None) }.check()
    };
    assert_eq!(check(vec!["relay", "medic"]), Ok(()));
    assert_eq!(check(vec![]), Ok(()));
    let twice = check(vec!["medic", "relay", "medic"]).unwrap_err();
    assert!(twice.field == "skills" && twice.problem.contains("medic"), "{twice}");
    let names: Vec<String> = (0..17).map(|at| format!("s{at}")).collect();
    let all = names.iter().map(String::as_str);
    assert_eq!(check(all.clone().take(16).collect()), Ok(()));
    let many = check(all.collect()).unwrap_err();
    assert!(many.field == "skills" && many.problem.contains("16"), "{many}");
    let text = r#"{"superior":null,"skills":["medic",7]}"#;
    assert!(serde_json::from_str::<Rank>(text).is_err());
    assert!(serde_json::from_str::<Rank>(r#"{"superior":null,"skills":["Medic"]}"#).is_err());
    let none = serde_json::from_str::<Rank>(r#"{"superior":null}"#).unwrap();
    assert_eq!(none.skills, None);
}
