//! Turns: what a browser that has drawn is sent next, and nothing more until it has drawn that.

use std::sync::Arc;

use muster_model::id::RobotId;
use muster_model::time::Tick;
use serde_json::{Value, json};

use super::frame::{self, Line};
use super::limits::{MAX_LINKS_SHOWN, MAX_TURN_BYTES};
use super::request::LinksRequest;
use super::topics::{self, Topic};
use super::{BrowserId, Console, Output};

/// Frames that were made, for all browsers that show the same.
#[derive(Debug, Default)]
pub(super) struct Cached {
    robots: u64,
    links: u64,
    ground: Option<(u64, Arc<[u8]>)>,
    embedding: Option<(u64, Arc<[u8]>)>,
}

impl Cached {
    pub(super) fn change_robots(&mut self) {
        self.robots += 1;
    }

    pub(super) fn change_links(&mut self) {
        self.links += 1;
    }
}

fn cached(
    place: &mut Option<(u64, Arc<[u8]>)>,
    version: u64,
    make: impl FnOnce() -> Vec<u8>,
) -> Arc<[u8]> {
    match place {
        Some((made, frame)) if *made == version => Arc::clone(frame),
        _ => {
            let frame: Arc<[u8]> = make().into();
            *place = Some((version, Arc::clone(&frame)));
            frame
        }
    }
}

/// A turn that is put together.
struct Turn<'a> {
    id: BrowserId,
    bytes: usize,
    outputs: &'a mut Vec<Output>,
    is_empty: bool,
}

impl Turn<'_> {
    /// Whether so many bytes more fit. Something always fits into an empty turn.
    fn fits(&self, bytes: usize) -> bool {
        self.is_empty || self.bytes + bytes <= MAX_TURN_BYTES
    }

    fn text(&mut self, text: Arc<str>) {
        self.bytes += text.len();
        self.is_empty = false;
        self.outputs.push(Output::Text(self.id, text));
    }

    fn frame(&mut self, frame: Arc<[u8]>) {
        self.bytes += frame.len();
        self.is_empty = false;
        self.outputs.push(Output::Frame(self.id, frame));
    }
}

impl Console {
    /// Sends a turn to each browser that has a credit and for which there is something new.
    pub(super) fn turns(&mut self, now: Tick, outputs: &mut Vec<Output>) {
        let with_credit = self.browsers.iter().filter(|(_, browser)| browser.has_credit());
        let ids: Vec<BrowserId> = with_credit.map(|(id, _)| *id).collect();
        for id in ids {
            let mut turn = Turn { id, bytes: 0, outputs, is_empty: true };
            self.replies_to(&mut turn);
            self.topics_to(&mut turn, now);
            self.events_to(&mut turn);
            self.names_to(&mut turn);
            self.robots_to(&mut turn);
            self.links_to(&mut turn);
            if turn.is_empty {
                continue;
            }
            if let Some(browser) = self.browsers.get_mut(&id) {
                let end = json!({"topic": "end", "data": {
                    "turn": browser.begin_turn(now), "now": now.as_seconds(), "link": self.link,
                }});
                turn.text(end.to_string().into());
            }
        }
    }

    fn replies_to(&mut self, turn: &mut Turn<'_>) {
        let Some(browser) = self.browsers.get_mut(&turn.id) else { return };
        if browser.has_replies() {
            browser.take_replies().into_iter().for_each(|reply| turn.text(reply));
        }
    }

    fn topics_to(&mut self, turn: &mut Turn<'_>, now: Tick) {
        for topic in Topic::ALL {
            let version = self.topics.version(topic);
            let has = self.browsers.get(&turn.id).map(|browser| browser.topics[topic as usize]);
            if has == Some(version) {
                continue;
            }
            let text = self.topic(topic, now);
            if !turn.fits(text.len()) {
                return;
            }
            turn.text(text);
            if let Some(browser) = self.browsers.get_mut(&turn.id) {
                browser.topics[topic as usize] = version;
            }
        }
    }

    fn events_to(&mut self, turn: &mut Turn<'_>) {
        let Some(browser) = self.browsers.get_mut(&turn.id) else { return };
        let Some((newest, _)) = self.events.back() else { return };
        if browser.events == *newest {
            return;
        }
        let fresh = self.events.iter().filter(|(number, _)| *number > browser.events);
        let fresh: Vec<&Value> = fresh.map(|(_, event)| event.as_ref()).collect();
        let text = topics::text("events", &json!(fresh));
        if turn.fits(text.len()) {
            browser.events = *newest;
            turn.text(text);
        }
    }

    /// Sends the names from the next piece on; all of a list come before any frame that refers to it.
    fn names_to(&mut self, turn: &mut Turn<'_>) {
        let Some(browser) = self.browsers.get_mut(&turn.id) else { return };
        let list = self.fleet.names();
        if browser.names.0 != list {
            browser.names = (list, 0);
        }
        while browser.names.1 < self.fleet.pieces() && list > 0 {
            let text = topics::text("names", &self.fleet.piece(browser.names.1));
            if !turn.fits(text.len()) {
                return;
            }
            turn.text(text);
            browser.names.1 += 1;
        }
    }

    fn robots_to(&mut self, turn: &mut Turn<'_>) {
        let Some(browser) = self.browsers.get_mut(&turn.id) else { return };
        let version = self.frames.robots;
        let has_names = browser.names.1 >= self.fleet.pieces();
        if browser.frames.0 == version || !has_names || self.fleet.roster().is_none() {
            return;
        }
        // Robots without vectors are no picture.
        if browser.view.embedding && self.embedding.is_empty() {
            return;
        }
        let frame = if browser.view.embedding {
            let make = || self.fleet.embedding(&self.embedding);
            cached(&mut self.frames.embedding, version, make)
        } else {
            cached(&mut self.frames.ground, version, || self.fleet.ground())
        };
        if turn.fits(frame.len()) {
            browser.frames.0 = version;
            turn.frame(frame);
        }
    }

    fn links_to(&mut self, turn: &mut Turn<'_>) {
        let Some(browser) = self.browsers.get_mut(&turn.id) else { return };
        let Some(links) = &browser.view.links else { return };
        // Indices change with the names, and each list of names with its frame of robots.
        let version = self.frames.links.wrapping_add(u64::from(self.fleet.names()) << 32);
        if browser.frames.1 == version || browser.names.1 < self.fleet.pieces() {
            return;
        }
        let Some(graph) = self.graphs.get(&links.modality) else { return };
        let node_of = |robots: &[RobotId]| -> Vec<u32> {
            let named = |(node, robot): &(u32, RobotId)| robots.contains(robot).then_some(*node);
            graph.nodes_added.iter().filter_map(named).collect()
        };
        let LinksRequest { robots, .. } = links;
        let chosen = (!robots.is_empty()).then(|| node_of(robots));
        let is_chosen = |node: u32| chosen.as_ref().is_none_or(|nodes| nodes.contains(&node));
        let mut edges: Vec<(u32, u32, f64)> = Vec::new();
        for row in &graph.rows {
            for (target, weight) in &row.edges {
                if is_chosen(row.source) || is_chosen(*target) {
                    edges.push((row.source, *target, *weight));
                }
            }
        }
        edges.sort_by(|left, right| right.2.total_cmp(&left.2));
        edges.truncate(MAX_LINKS_SHOWN);
        let most = edges.first().map_or(1.0, |edge| edge.2);
        let mut nodes: Vec<(u32, Option<u32>)> = graph
            .nodes_added
            .iter()
            .map(|(node, robot)| (*node, self.fleet.index(robot)))
            .collect();
        nodes.sort_unstable();
        let index = |node: u32| {
            let at = nodes.binary_search_by_key(&node, |(known, _)| *known).ok()?;
            nodes[at].1
        };
        let line = |(from, to, weight): &(u32, u32, f64)| {
            Some(Line { from: index(*from)?, to: index(*to)?, share: weight / most })
        };
        let lines: Vec<Line> = edges.iter().filter_map(line).collect();
        let frame = frame::links(&self.fleet.links_head(), &lines);
        if turn.fits(frame.len()) {
            browser.frames.1 = version;
            turn.frame(frame.into());
        }
    }
}
