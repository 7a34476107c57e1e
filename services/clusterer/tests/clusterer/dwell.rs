//! What must last before it is published: another team of a robot, and another number of teams.

use super::*;

/// Two teams, with the dwell of a live fleet.
fn patient() -> ClustererSettings {
    ClustererSettings { dwell_s: 0.5, heartbeat_s: 4.0, ..teams(2) }
}

fn automatic() -> ClustererSettings {
    ClustererSettings { teams: TeamCount::Auto, ..patient() }
}

/// The same embedding with the evidence for 1, 2, … teams, of which it shows the number with the best one.
fn scored(embedding: &Embedding, scores: &[f64]) -> Checked<Embedding> {
    let mut scored = embedding.clone();
    let best = (1..).zip(scores).max_by(|left, right| left.1.total_cmp(right.1));
    scored.quality.teams_shown = best.map(|(teams, _)| teams);
    scored.quality.team_scores = scores.to_vec();
    Checked::new_unchecked(scored)
}

fn before(epoch: u64) -> Checked<Embedding> {
    embedding(epoch, &[("a b c", WEST), ("x y z", EAST)])
}

/// c is elsewhere.
fn after(epoch: u64) -> Checked<Embedding> {
    embedding(epoch, &[("a b", WEST), ("c x y z", EAST)])
}

const BEFORE: &str = "t1: a b c | t2: x y z";
const AFTER: &str = "t1: a b | t2: c x y z";

#[test]
fn a_robot_that_flips_between_two_teams_stays() {
    let (mut bench, first) = divided(patient(), &before(1));
    assert_eq!(short(&first), BEFORE);
    for epoch in 2..40 {
        bench.wait(0.3);
        let next = if epoch % 2 == 0 { after(epoch) } else { before(epoch) };
        bench.receive_embedding(&next);
        let sent = bench.take();
        assert_eq!(short(&sent.division()), BEFORE, "epoch {epoch}");
        assert!(sent.events.is_empty() && sent.division().changes.is_empty());
    }
    assert!(bench.counter("moves_held") > 10);
}

#[test]
fn a_move_that_lasts_is_published_even_if_nothing_else_changes() {
    let (mut bench, _) = divided(patient(), &before(1));
    let start = bench.now;
    bench.receive_embedding(&after(2));
    let kept = bench.division();
    assert_eq!(short(&kept), BEFORE);
    // What is published of the teams is that of the robots that are in them.
    let west = &kept.teams[0];
    assert!((west.centroid[0] - 1.0 / 3.0).abs() < 1e-2, "{:?}", west.centroid);
    let margin = |robot: usize| west.members[robot].margin;
    assert!(margin(0) > 0.4 && margin(2) < 0.0, "{west:?}");
    assert!((kept.inertia - 2.0 / 3.0).abs() < 1e-2, "{}", kept.inertia);
    assert_eq!(bench.host.deadline(), Some(start.after(std::time::Duration::from_millis(500))));
    bench.wait(0.49);
    assert!(bench.take().teams.is_empty());
    bench.wait(0.02);
    let sent = bench.take();
    assert_eq!(short(&sent.division()), AFTER);
    assert_eq!(changes_in_short(&sent.changes()), ["moved c t1 t2"]);
    assert_eq!(sent.informed_robots(), "a b c x y z");
    assert!(sent.division().inertia < 1e-4);
    assert_eq!(sent.division().embedding, kept.embedding);
    assert_eq!(bench.jobs_run, 2, "it is not divided again");
    bench.wait(3.0);
    assert!(bench.take().teams.is_empty(), "and that was all");
}

#[test]
fn the_time_of_a_move_goes_on_over_embeddings() {
    let (mut bench, _) = divided(patient(), &before(1));
    for (epoch, wanted) in (2..8).zip([BEFORE, BEFORE, BEFORE, BEFORE, BEFORE, AFTER]) {
        let drift = 1e-4 * f64::from(u32::try_from(epoch).unwrap());
        bench.receive_embedding(&embedding(epoch, &[("a b", [drift, 0.0]), ("c x y z", EAST)]));
        assert_eq!(short(&bench.division()), wanted, "epoch {epoch}");
        // The timer has nothing to add before the next embedding.
        bench.wait(0.1);
        bench.take();
    }
}

#[test]
fn new_orders_are_followed_at_once_by_all_below() {
    let (mut bench, _) = divided(patient(), &before(1));
    bench.receive_roster(roster(1, "a b<a c<b x y<x z<x"));
    bench.receive_roster(roster(2, "a b<x c<b x y<x z<x"));
    bench.take();
    bench.wait(1.0);
    bench.receive_embedding(&embedding(2, &[("a", WEST), ("b c x y z", EAST)]));
    assert_eq!(short(&bench.division()), "t1: a | t2: b c x y z");
    // Ten seconds later they are no longer new.
    bench.wait(10.0);
    bench.take();
    bench.receive_embedding(&embedding(3, &[("a b", WEST), ("c x y z", EAST)]));
    assert_eq!(short(&bench.division()), "t1: a | t2: b c x y z");
}

#[test]
fn the_first_division_for_what_operators_ask_for_counts_at_once() {
    let changes = [
        ("service/clusterer/settings", r#"{"size":{"max":4}}"#),
        ("wish/kim/w", r#"{"kind":"together","robots":["a","b"]}"#),
        ("service/clusterer/settings", r#"{"hysteresis":0.01}"#),
    ];
    for (key, change) in changes {
        let (mut bench, _) = divided(patient(), &before(1));
        bench.receive_embedding(&after(2));
        assert_eq!(short(&bench.division()), BEFORE);
        bench.get(key, Some(change)).unwrap();
        assert_eq!(short(&bench.take().teams.pop().unwrap().0), AFTER, "{change}");
        // The next has to last again.
        bench.receive_embedding(&before(3));
        assert_eq!(short(&bench.division()), AFTER, "{change}");
    }
}

#[test]
fn who_is_new_and_what_was_asked_for_is_not_delayed() {
    let (mut bench, _) = divided(patient(), &before(1));
    bench.receive_embedding(&embedding(2, &[("a b c n", WEST), ("x y! z", EAST)]));
    assert_eq!(short(&bench.division()), "t1: a b c n | t2: x z | - y");
    bench.receive_embedding(&embedding(3, &[("a b n", WEST), ("x y z", EAST), ("c", NORTH)]));
    bench.take();
    bench.get("service/clusterer/settings", Some("{\"teams\":3}")).unwrap();
    let three = bench.division();
    assert_eq!((three.teams.len(), short(&three).contains("t3: c")), (3, true));
    bench.get("service/clusterer/settings", Some("{\"dwell_s\":0}")).unwrap();
    bench.receive_embedding(&embedding(4, &[("a b", WEST), ("n x y z", EAST), ("c", NORTH)]));
    assert_eq!(short(&bench.division()), "t1: a b | t2: n x y z | t3: c");
}

#[test]
fn the_next_leader_goes_on_from_what_was_published() {
    let (_, first) = divided(patient(), &before(1));
    let found = vec![mirrored(&first), Message::Embedding(after(2))];
    let mut next = Bench::restored(patient(), found);
    assert_eq!(short(&next.division()), BEFORE);
    next.wait(0.6);
    assert_eq!(short(&next.division()), AFTER);
}

#[test]
fn the_number_of_teams_follows_evidence_that_lasts() {
    let groups = |epoch, scores: &[f64]| {
        scored(&embedding(epoch, &[("a b", WEST), ("c d", EAST), ("e f", NORTH)]), scores)
    };
    let (two, three) = ([0.1, 0.6, 0.5, 0.1], [0.1, 0.3, 0.6, 0.1]);
    let (mut bench, first) = divided(automatic(), &groups(1, &three));
    assert_eq!((first.teams.len(), first.requested), (3, 3), "the first at once");
    let considered: Vec<_> = first.considered.iter().map(|one| (one.teams, one.score)).collect();
    assert_eq!(considered, [(1, 0.1), (2, 0.3), (3, 0.6), (4, 0.1)]);
    // One embedding says otherwise.
    bench.wait(0.2);
    bench.receive_embedding(&groups(2, &two));
    assert_eq!(bench.division().requested, 3);
    bench.wait(0.2);
    bench.receive_embedding(&groups(3, &three));
    assert_eq!(bench.division().requested, 3);
    // From now on all do.
    bench.wait(0.2);
    bench.receive_embedding(&groups(4, &two));
    assert_eq!(bench.division().requested, 3);
    bench.wait(0.39);
    assert!(bench.take().teams.is_empty());
    bench.wait(0.02);
    let sent = bench.take();
    assert_eq!((sent.division().teams.len(), sent.division().requested), (2, 2));
    assert_eq!(sent.changes().len(), 3, "a merger and its two robots: {:?}", sent.changes());
    let few = |kind: &EventKind| matches!(kind, EventKind::FewerTeams { .. });
    assert!(!sent.events.iter().any(few));
    // A number that is asked for is obeyed, and has no evidence.
    bench.get("service/clusterer/settings", Some("{\"teams\":3}")).unwrap();
    let fixed = bench.division();
    assert_eq!((fixed.requested, fixed.considered.len()), (3, 0));
    let range = "{\"teams\":{\"from\":4,\"to\":5}}";
    bench.get("service/clusterer/settings", Some(range)).unwrap();
    let range = bench.division();
    assert_eq!((range.requested, range.considered.len()), (4, 1));
}

#[test]
fn only_what_was_asked_for_can_be_missing() {
    let alone = |epoch| scored(&embedding(epoch, &[("a", WEST), ("b", EAST)]), &[0.0, 0.7, 0.0]);
    let few = |sent: &common::Published| {
        let few = |kind: &EventKind| match kind {
            EventKind::FewerTeams { requested, formed, .. } => Some((*requested, *formed)),
            _ => None,
        };
        sent.events.iter().filter_map(few).collect::<Vec<_>>()
    };
    for (wanted, reported) in [
        (TeamCount::Auto, vec![]),
        (TeamCount::Between { from: 1, to: 9 }, vec![]),
        (TeamCount::Between { from: 3, to: 9 }, vec![(3, 2)]),
        (TeamCount::Fixed(4), vec![(4, 2)]),
    ] {
        let mut bench = Bench::leading(ClustererSettings { teams: wanted, ..patient() });
        bench.take();
        bench.receive_embedding(&alone(1));
        assert_eq!(few(&bench.take()), reported, "{wanted}");
    }
}

#[test]
fn nothing_to_choose_by_is_one_team_and_keeps_a_number() {
    let mut bench = Bench::leading(automatic());
    bench.receive_embedding(&embedding(1, &[("a! b!", WEST)]));
    let none = bench.division();
    assert_eq!((none.teams.len(), none.requested), (0, 1));
    // The first robots with relations are divided at once.
    let groups = embedding(2, &[("a b", WEST), ("c d", EAST)]);
    bench.receive_embedding(&scored(&groups, &[0.1, 0.8, 0.0]));
    assert_eq!(bench.division().requested, 2);
    bench.receive_embedding(&embedding(3, &[("a b c", WEST), ("d", EAST)]));
    assert_eq!(bench.division().requested, 2);
}
