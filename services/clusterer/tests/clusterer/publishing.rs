//! What is published, and when.

use super::*;

#[test]
fn the_one_who_commands_most_leads() {
    let first = embedding(1, &[("a b c d", WEST), ("x y", EAST)]);
    let (mut bench, division) = divided(teams(2), &first);
    assert_eq!(leaders(&division), ["a", "x"], "no robot commands: the first by name");
    // c commands a and b, b through x of the other team; d commands y, who is no member.
    bench.receive_roster(roster(1, "a<c b<x x<c y<d c d"));
    let sent = bench.take();
    assert_eq!(leaders(&sent.division()), ["c", "x"]);
    assert_eq!(sent.informed_robots(), "a b c d", "the other team has not changed");
    // d commands as many: the one before stays.
    bench.receive_roster(roster(2, "a<c b<d c d x y"));
    assert!(bench.take().teams.is_empty());
    bench.receive_embedding(&embedding(2, &[("a b c d", WEST), ("x y", NORTH)]));
    assert_eq!(leaders(&bench.division()), ["c", "x"]);
    // No robot commands: the one before stays, too, until it is in another team.
    bench.receive_roster(roster(3, "a b c d x y"));
    bench.receive_embedding(&embedding(3, &[("a b d", WEST), ("x y c", EAST)]));
    assert_eq!(leaders(&bench.division()), ["a", "x"]);
    // In a circle all command as many; one above them commands more.
    bench.receive_roster(roster(4, "a<b b<d d<a x<y y<x c<absent"));
    assert!(bench.take().teams.is_empty());
    bench.receive_roster(roster(5, "a<b b<d d<a x<y y<c c"));
    assert_eq!(leaders(&bench.division()), ["a", "c"]);
}

#[test]
fn an_unchanged_division_is_published_every_heartbeat() {
    let settings = ClustererSettings { heartbeat_s: 0.5, ..teams(2) };
    let (mut bench, first) = divided(settings, &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    let start = bench.now;
    assert_eq!(bench.host.deadline(), Some(start.after(std::time::Duration::from_millis(500))));
    bench.wait(0.4);
    bench.input(Input::Timer);
    assert!(bench.take().teams.is_empty(), "too early");
    bench.wait(0.15);
    let sent = bench.take();
    assert!(sent.teams[0].1, "the mirror beats as well");
    let second = sent.division();
    assert_eq!(second.header.revision, Revision { term: 1, epoch: 2 });
    assert_eq!(second.header.oldest, first.header.oldest, "the data are as old as they are");
    let due = start.after(std::time::Duration::from_millis(500));
    assert_eq!(second.header.stages.last().unwrap().published, due);
    assert_eq!(second.header.stages.len(), first.header.stages.len());
    bench.wait(0.5);
    assert_eq!(bench.division().header.revision.epoch, 3);
    assert_eq!(bench.jobs_run, 1);
}

#[test]
fn the_mirror_is_published_on_change_and_by_heartbeat() {
    let (mut bench, _) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    let mut mirrors = Vec::new();
    for epoch in 2..25 {
        bench.wait(0.1);
        // All the time a bit elsewhere: a new division each time, with the same teams.
        let drift = 1e-4 * f64::from(u32::try_from(epoch).unwrap());
        bench.receive_embedding(&embedding(epoch, &[("a b", [drift, 0.0]), ("c d", EAST)]));
        let sent = bench.take();
        assert_eq!(sent.robots.len(), if sent.teams[0].1 { 4 } else { 0 }, "by heartbeat");
        if sent.teams[0].1 {
            mirrors.push(epoch);
        }
    }
    assert_eq!(mirrors, [11, 21]);
    bench.receive_embedding(&embedding(25, &[("a b c", WEST), ("d", EAST)]));
    assert!(bench.take().teams[0].1);
}

#[test]
fn silent_robots_are_marked_without_a_new_embedding() {
    let (mut bench, first) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d!", EAST)]));
    assert!(first.stale.is_empty());
    bench.receive_roster(roster(1, "a b? c d? elsewhere?"));
    let sent = bench.take();
    assert_eq!(sent.division().stale, [robot("b"), robot("d")]);
    assert!(sent.teams[0].1 && sent.robots.is_empty());
    assert_eq!(sent.division().teams, first.teams);
    bench.receive_roster(roster(2, "a b? c d?"));
    assert!(bench.take().teams.is_empty(), "nothing is new");
    bench.receive_roster(roster(1, "a b c d"));
    assert!(bench.take().teams.is_empty(), "an old roster");
    assert_eq!(bench.counter("messages_old"), 1);
    bench.receive_roster(roster(3, "a b c d"));
    assert!(bench.division().stale.is_empty());
    assert_eq!(bench.jobs_run, 1);
}

#[test]
fn robots_are_informed_when_their_team_changes_and_by_heartbeat() {
    let (mut bench, _) =
        divided(teams(3), &embedding(1, &[("a b", WEST), ("c d", EAST), ("e f", NORTH)]));
    bench.receive_embedding(&embedding(2, &[("a b", [0.01, 0.0]), ("c d", EAST), ("e f", NORTH)]));
    assert_eq!(bench.take().informed_robots(), "");
    bench.receive_embedding(&embedding(3, &[("a b", WEST), ("c d new", EAST), ("e f", NORTH)]));
    assert_eq!(bench.take().informed_robots(), "c d new");
    bench.receive_embedding(&embedding(4, &[("a b", WEST), ("c d new", EAST), ("f", NORTH)]));
    let sent = bench.take();
    assert_eq!(sent.informed_robots(), "f");
    let revision = sent.division().header.revision;
    assert_eq!(sent.robots[0].header.revision, revision);
    bench.wait(0.9);
    assert_eq!(bench.take().informed_robots(), "");
    bench.wait(0.1);
    assert_eq!(bench.take().informed_robots(), "a b c d f new");
}

#[test]
fn events_of_one_division_are_bounded() {
    let half = |swap: bool| {
        let row = |i: usize| {
            let east = (i < 100) != (swap && i.is_multiple_of(3));
            let x = if east { 1.0 } else { 0.0 };
            (
                robot(&format!("r{i:03}")),
                vec![x, 1e-4 * f64::from(u32::try_from(i).unwrap())],
                false,
            )
        };
        (0..200).map(row).collect::<Vec<_>>()
    };
    let (mut bench, _) = divided(teams(2), &from_rows(1, 1, half(false)));
    bench.receive_embedding(&from_rows(1, 2, half(true)));
    let sent = bench.take();
    assert_eq!(sent.changes().len(), 64);
    assert_eq!(sent.division().changes.len(), 67);
    assert_eq!(bench.counter("team_changes_untold"), 3);
    assert_eq!(bench.counter("team_changes"), 2 + 67);
}

#[test]
fn after_a_lost_link_everyone_is_informed_again() {
    let (mut bench, division) = divided(teams(2), &embedding(1, &[("a b", WEST), ("c d", EAST)]));
    bench.input(Input::LinkLost);
    bench.asks.clear();
    bench.wait(0.2);
    bench.input(Input::LinkRestored);
    let sent = bench.take();
    assert!(sent.division().same_division(&division));
    assert_eq!(sent.informed_robots(), "a b c d");
    let mut fetches = bench.take_fetches();
    assert_eq!(fetches.len(), 2);
    assert_eq!(fetches[1].len(), 1);
    assert_eq!(fetches[1][0].pattern, Pattern::One(Key::Teams));
    let missed = embedding(2, &[("a b c", WEST), ("d", EAST)]);
    bench.answer_fetch(fetches.remove(0), vec![Message::Embedding(missed)]);
    assert_eq!(short(&bench.division()), "t1: a b c | t2: d");
}

#[test]
fn robots_that_one_modality_relates_are_provisional() {
    let first = embedding(1, &[("a b", WEST), ("c d", EAST), ("e!", NORTH)]);
    let (mut bench, division) = divided(teams(2), &first);
    assert!(division.provisional.is_empty());
    // Whoever has no team is in no provisional one.
    let marked = |epoch: u64, place: [f64; 2]| {
        let next = embedding(epoch, &[("a b", WEST), ("c d", place), ("e!", NORTH)]);
        let provisional = vec![false, true, false, false, true];
        Checked::new_unchecked(Embedding { provisional, ..(*next).clone() })
    };
    bench.receive_embedding(&marked(2, NORTH));
    let sent = bench.take();
    assert_eq!(sent.division().provisional, [robot("b")]);
    assert!(sent.teams.iter().any(|(_, mirror)| *mirror), "the mirror says so at once");
    bench.receive_embedding(&marked(3, EAST));
    assert_eq!(bench.division().provisional, [robot("b")]);
}
