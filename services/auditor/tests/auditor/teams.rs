//! What the audit says of each team, by graphs that are followed.

use muster_model::graph::{GraphDelta, GraphRow};
use muster_model::id::Modality;
use muster_model::team_audit::{Conductance, Spread};

use super::*;

/// The robots of a fleet, by node: a path a–b–c–d, and e and f by themselves.
pub(super) const NAMES: [&str; 6] = ["a", "b", "c", "d", "e", "f"];

/// A graph of all robots with edges in one direction each, as a snapshot.
pub(super) fn graph(epoch: u64, name: &str, edges: &[(&str, &str)]) -> Message {
    let node = |name: &str| u32::try_from(NAMES.iter().position(|n| *n == name).unwrap()).unwrap();
    let rows = NAMES.iter().filter_map(|from| {
        let mut targets: Vec<_> = edges.iter().filter(|edge| edge.0 == *from).collect();
        targets.sort_unstable();
        let edges = targets.iter().map(|edge| (node(edge.1), 1.0)).collect();
        (!targets.is_empty()).then(|| GraphRow { source: node(from), edges })
    });
    Message::Graph(Arc::new(GraphDelta {
        header: header(epoch + 100),
        modality: Modality::new(name).unwrap(),
        base: None,
        nodes_added: (0..).zip(NAMES.map(robot)).collect(),
        nodes_removed: vec![],
        rows: rows.collect(),
    }))
}

/// The roster of a frame with graphs of its revision, and superiors of robots.
pub(super) fn frame_roster(epoch: u64, graphs: &[&str], superiors: &[(&str, &str)]) -> Message {
    let places = [0.0, 2.0, 4.0, 6.0, 50.0, 53.0];
    let robots: Vec<_> =
        NAMES.iter().zip(places).map(|(n, x)| (*n, "map", Some([x, 0.0, 0.0]))).collect();
    let Message::Roster(mut roster) = roster(epoch, &robots) else { panic!() };
    let content = roster.make_mut_unchecked();
    let names = graphs.iter().map(|name| (Modality::new(name).unwrap(), revision(epoch + 100)));
    content.graphs = names.collect();
    for (of, superior) in superiors {
        let entry = content.robots.iter_mut().find(|entry| entry.robot == robot(of));
        entry.unwrap().superior = Some(robot(superior));
    }
    Message::Roster(roster)
}

pub(super) const PATH: &[(&str, &str)] = &[("a", "b"), ("b", "c"), ("d", "c"), ("e", "f")];
pub(super) const TWO: &[(&str, &str)] = &[("t1", "a b c d"), ("t2", "e f")];
pub(super) const SIX: Rows<'static> = &[
    ("a", [0.0, 0.0]),
    ("b", [0.1, 0.0]),
    ("c", [0.2, 0.0]),
    ("d", [0.3, 0.0]),
    ("e", [5.0, 0.0]),
    ("f", [5.5, 0.0]),
];

/// Stale robots of a division.
pub(super) fn with_stale(teams: Message, stale: &[&str]) -> Message {
    let Message::Teams { mut teams, mirror } = teams else { panic!() };
    teams.make_mut_unchecked().stale = stale.iter().map(|name| robot(name)).collect();
    Message::Teams { teams, mirror }
}

/// One that has scored a division with graphs.
pub(super) fn with_graphs() -> Bench {
    let mut bench = Bench::leading(vec![]);
    let superiors = [("b", "a"), ("c", "a"), ("d", "a"), ("e", "a"), ("f", "a")];
    bench.receive(graph(1, "connectivity", PATH));
    bench.receive(frame_roster(1, &["connectivity"], &superiors));
    bench.receive(embedding(1, SIX));
    bench.receive(teams(1, 1, TWO, ""));
    bench
}

#[test]
fn each_team_is_described() {
    let mut bench = with_graphs();
    let audit = bench.audit();
    assert_eq!(audit.graphs, Some(revision(101)));
    let [first, second] = &audit.per_team[..] else { panic!("{:?}", audit.per_team) };
    assert_eq!((first.robots, first.stale, first.leader_stale), (4, 0, false));
    assert_eq!(first.silhouette, Some(audit.in_embedding.per_team[0].1));
    let least = audit.in_embedding.per_robot[..4].iter().map(|of| of.1).fold(1.0, f64::min);
    assert_eq!(first.least.as_ref().unwrap().silhouette, least);
    let apart = Conductance { modality: Modality::connectivity(), conductance: 0.0 };
    assert_eq!((&first.conductance, &second.conductance), (&vec![apart.clone()], &vec![apart]));
    let radio = first.radio.as_ref().unwrap();
    assert_eq!((radio.parts, radio.reached_by_leader, radio.bridges), (1, 4, 3));
    assert_eq!((radio.cut_robot_count, radio.worst_cut), (2, 1.0 / 3.0));
    assert_eq!(radio.cut_robots, [robot("b"), robot("c")]);
    assert_eq!((first.heads, &first.only_head), (1, &Some(robot("a"))));
    // Both have a superior in the other team.
    assert_eq!((second.heads, &second.only_head), (2, &None));
    assert_eq!(first.spread, Some(Spread { rms_m: 5.0_f64.sqrt(), largest_m: 3.0 }));
    assert_eq!(second.spread, Some(Spread { rms_m: 1.5, largest_m: 1.5 }));
}

#[test]
fn the_worst_losses_are_named_with_what_happens() {
    let mut bench = with_graphs();
    let audit = bench.audit();
    let effects: Vec<_> = audit.losses.iter().map(|loss| loss.describe()).collect();
    assert_eq!(
        effects,
        [
            "b: t1 falls into 2 parts of 2 and 1",
            "c: t1 falls into 2 parts of 2 and 1",
            "a: t1 loses its leader and only command head",
            "e: t2 loses its leader",
        ]
    );
}

#[test]
fn stale_robots_do_not_join_the_parts_of_a_team() {
    let mut bench = with_graphs();
    bench.forget_audits();
    bench.receive(with_stale(teams(2, 1, TWO, ""), &["a", "c"]));
    let audit = bench.audit();
    let team = &audit.per_team[0];
    assert_eq!((team.stale, team.leader_stale), (2, true));
    let radio = team.radio.as_ref().unwrap();
    assert_eq!((radio.parts, radio.reached_by_leader, radio.cut_robot_count), (2, 0, 0));
    assert_eq!(audit.losses.len(), 1, "the leader of t1 is lost already: {:?}", audit.losses);
}

#[test]
fn where_no_links_are_reported_nothing_is_said_of_radio() {
    let mut bench = Bench::leading(vec![]);
    bench.receive(graph(1, "connectivity", &[]));
    bench.receive(frame_roster(1, &["connectivity"], &[]));
    bench.receive(embedding(1, SIX));
    bench.receive(teams(1, 1, TWO, ""));
    let audit = bench.audit();
    assert!(audit.per_team.iter().all(|team| team.radio.is_none() && team.heads == team.robots));
    assert_eq!(audit.losses.len(), 2, "the leaders");
}

#[test]
fn other_graphs_score_the_teams_again_once_a_second_and_the_silhouettes_stay() {
    let mut bench = with_graphs();
    let first = bench.audit();
    for epoch in 2..6 {
        bench.wait(0.1);
        bench.receive(graph(epoch, "connectivity", &PATH[..usize::try_from(epoch).unwrap() - 1]));
        bench.receive(frame_roster(epoch, &["connectivity"], &[("b", "a")]));
    }
    let scored = |bench: &mut Bench| bench.audits().last().map(|audit| audit.graphs);
    assert_eq!(scored(&mut bench), None);
    bench.wait(0.6);
    assert_eq!(scored(&mut bench), Some(Some(revision(105))));
    assert_eq!(bench.audits().last().unwrap().in_embedding, first.in_embedding);
    assert_eq!(bench.jobs_run, 2);
}

#[test]
fn teams_that_a_new_embedding_has_left_as_they_were_are_scored_a_second_later() {
    let mut bench = with_graphs();
    bench.wait(0.1);
    bench.receive(graph(2, "connectivity", &PATH[..3]));
    bench.receive(frame_roster(2, &["connectivity"], &[("b", "a")]));
    let moved: Vec<_> = SIX.iter().map(|(name, [x, y])| (*name, [x + y, 0.3])).collect();
    bench.receive(embedding(2, &moved));
    let superiors = [("b", "a"), ("c", "a"), ("d", "a"), ("e", "a"), ("f", "a")];
    bench.receive(frame_roster(3, &["connectivity"], &superiors));
    bench.receive(graph(3, "connectivity", &PATH[..3]));
    bench.forget_audits();
    bench.receive(embedding(3, &moved));
    bench.receive(teams(3, 3, TWO, ""));
    let audit = bench.audit();
    assert_eq!((audit.embedding, audit.graphs), (revision(3), Some(revision(101))));
    bench.wait(1.0);
    assert_eq!(bench.audits().last().unwrap().graphs, Some(revision(103)));
    let jobs = bench.jobs_run;
    bench.wait(5.0);
    assert_eq!(bench.jobs_run, jobs, "there is nothing else to score");
}

#[test]
fn newer_graphs_wait_for_an_embedding_that_is_missing() {
    let mut bench = with_graphs();
    bench.wait(0.1);
    bench.receive(graph(2, "connectivity", &PATH[..3]));
    bench.receive(frame_roster(2, &["connectivity"], &[("b", "a")]));
    bench.receive(teams(2, 2, TWO, ""));
    let jobs = bench.jobs_run;
    bench.wait(2.0);
    assert_eq!(bench.jobs_run, jobs);
    bench.forget_audits();
    bench.receive(embedding(2, SIX));
    assert_eq!(bench.audit().graphs, Some(revision(102)));
}

#[test]
fn a_graph_that_is_missing_is_fetched() {
    let mut bench = with_graphs();
    bench.wait(1.0);
    bench.asks.clear();
    bench.receive(frame_roster(2, &["connectivity"], &[]));
    bench.wait(0.06);
    let fetches = bench.take_fetches();
    let wanted = [Pattern::One(Key::Roster), Pattern::One(Key::Graph(Modality::connectivity()))];
    let asked: Vec<_> = fetches[0].iter().map(|ask| ask.pattern.clone()).collect();
    assert_eq!(asked, wanted);
    bench.answer_fetch(fetches[0].clone(), vec![graph(2, "connectivity", &PATH[..3])]);
    assert_eq!(bench.audits().last().unwrap().graphs, Some(revision(102)));
}

#[test]
fn a_contradictory_graph_is_refused_and_changes_nothing() {
    let mut bench = with_graphs();
    bench.forget_events();
    let Message::Graph(mut delta) = graph(2, "connectivity", PATH) else { panic!() };
    Arc::make_mut(&mut delta).rows[0].edges[0].1 = -1.0;
    bench.receive(Message::Graph(delta));
    assert!(matches!(bench.events()[0], EventKind::Quarantined { .. }));
    assert_eq!(bench.audits().last().unwrap().graphs, Some(revision(101)));
}
