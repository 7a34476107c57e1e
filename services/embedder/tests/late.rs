//! A busy host or link: snapshots are outdated when they come, and deltas arrive meanwhile.

use crate::common::{Bench, Ingest, patterns};
use muster_embedder::Embedder;
use muster_service::inbox::{Inbox, Parcel};
use muster_service::{Ask, Core, Input};
use muster_wire::{Key, Message, Pattern};

/// The answers of a fetch, as they were made when it was asked.
struct UnderWay {
    fetch: Vec<Ask>,
    answers: Vec<Message>,
    frames_left: u32,
}

#[test]
fn a_snapshot_that_is_always_outdated_leads_to_frames_all_the_same() {
    // How many frames a snapshot is on its way: from less than a frame to several seconds.
    for delay in [1, 3, 9, 40] {
        let (mut bench, mut ingest) = (Bench::fresh(), Ingest::two_cliques(&["spatial"], 4));
        bench.frame(&mut ingest);
        let mut under_way: Option<UnderWay> = None;
        let mut last_embedding = 0;
        for frame in 1..300_u32 {
            bench.wait(0.1);
            ingest.edge("spatial", "a0", "a1", 0.2 + f64::from(frame) / 1000.0);
            let published = ingest.frame(bench.now);
            // Now and then a delta is lost, and less often than a snapshot takes.
            let is_lost = frame % 50 == 5;
            let messages = published.messages().skip(usize::from(is_lost));
            let before = bench.published.len();
            messages.for_each(|message| bench.receive(message));
            if let Some(fetch) = bench.fetches.pop_front() {
                assert!(under_way.is_none(), "one fetch at a time");
                let answers = ingest.answer(&patterns(&fetch));
                under_way = Some(UnderWay { fetch, answers, frames_left: delay });
            }
            if let Some(way) = &mut under_way {
                way.frames_left = way.frames_left.saturating_sub(1);
            }
            if let Some(way) = under_way.take_if(|way| way.frames_left == 0) {
                bench.answer_fetch(way.fetch, way.answers);
            }
            if bench.published.len() > before {
                last_embedding = frame;
            }
            let waited = frame - last_embedding;
            assert!(
                waited <= delay + 2,
                "no embedding for {waited} frames, snapshots take {delay}"
            );
        }
    }
}

#[test]
fn a_fetch_in_vain_gives_the_next_one_more_time() {
    let (mut bench, mut ingest) = (Bench::fresh(), Ingest::two_cliques(&["spatial"], 4));
    bench.frame(&mut ingest);
    let mut within = Vec::new();
    for weight in 1..=6 {
        ingest.edge("spatial", "a0", "a1", f64::from(weight) / 10.0);
        let frame = ingest.frame(bench.now);
        bench.receive(frame.roster());
        bench.wait(1.0);
        let fetch = bench.fetches.pop_front().unwrap();
        within.push(fetch[0].within.as_secs());
        let answers = if weight == 5 { ingest.answer(&patterns(&fetch)) } else { Vec::new() };
        bench.answer_fetch(fetch, answers);
    }
    assert_eq!(within, [1, 2, 4, 8, 8, 1]);
}

#[test]
fn a_fetch_that_was_answered_and_did_not_suffice_gives_the_next_one_no_more_time() {
    let (mut bench, mut ingest) = (Bench::fresh(), Ingest::two_cliques(&["spatial"], 4));
    bench.frame(&mut ingest);
    for weight in 1..=4 {
        ingest.edge("spatial", "a0", "a1", f64::from(weight) / 10.0);
        bench.receive(ingest.frame(bench.now).roster());
        bench.wait(1.0);
        let fetch = bench.fetches.pop_front().unwrap();
        assert_eq!(fetch[0].within.as_secs(), 1, "fetch {weight}");
        // The snapshot is outdated when it comes: the next delta was lost as well.
        let answers = ingest.answer(&patterns(&fetch));
        ingest.edge("spatial", "a0", "a2", f64::from(weight) / 10.0);
        bench.receive(ingest.frame(bench.now).roster());
        bench.answer_fetch(fetch, answers);
    }
}

#[test]
fn one_that_handles_less_than_what_comes_makes_frames_all_the_same() {
    let names = ["connectivity", "hierarchy", "spatial"];
    let (mut bench, mut ingest) = (Bench::fresh(), Ingest::two_cliques(&names, 4));
    let (mut inbox, wiring) = (Inbox::default(), Embedder::wiring());
    for frame in 1..=60_u32 {
        bench.wait(0.1);
        for name in names {
            ingest.edge(name, "a0", "a1", 0.2 + f64::from(frame) / 1000.0);
        }
        // Each frame is three graphs and a roster …
        for message in ingest.frame(bench.now).messages() {
            let pattern = match &message {
                Message::Graph(_) => Pattern::Graphs,
                _ => Pattern::One(Key::Roster),
            };
            let mut subscriptions = wiring.subscriptions.iter();
            let delivery = subscriptions.find(|of| of.pattern == pattern).unwrap().delivery;
            let packet = message.to_packet(bench.space());
            inbox.push(Parcel::new(bench.space(), packet, &pattern, delivery).unwrap());
        }
        // … and three packets are handled in its time.
        for _ in 0..3 {
            if let Some(arrival) = inbox.pop() {
                bench.input(Input::Arrived(arrival));
            }
        }
    }
    let embeddings = bench.published.len();
    assert!((40..=45).contains(&embeddings), "{embeddings} embeddings of 60 frames");
}
