//! What is sent when: only what somebody watches, at most ten times a second, and never more in one turn than may wait for
//! one viewer.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_model::roster::RosterEntry;
use muster_model::time::Tick;
use muster_wire::{Format, Key, Message as BusMessage};
use serde_json::Value;

use super::fleet::frame_of;
use super::limits::{MAX_LINK_SCENES, REPEAT_INTERVAL, SCENE_INTERVAL};
use super::scene::{Entity, Message, Scene, Transform};
use super::{Bridge, Output, Topic, teams};

/// What was sent of each topic, and what has changed since.
#[derive(Debug, Default)]
pub(super) struct Sent {
    changed: BTreeSet<Topic>,
    at: BTreeMap<Topic, Tick>,
    entities: BTreeMap<Topic, BTreeSet<String>>,
    /// The number of the last interval in which something was sent.
    interval: u64,
    /// Where robots are has changed, and with it every scene.
    robots: u64,
    robots_sent: BTreeMap<Topic, u64>,
}

impl Sent {
    pub(super) fn change(&mut self, topic: &Topic) {
        self.changed.insert(topic.clone());
    }

    pub(super) fn change_robots(&mut self) {
        self.robots += 1;
    }

    fn is_due(&self, now: Tick, topic: &Topic) -> bool {
        let moves = !matches!(topic, Topic::Quality | Topic::Events);
        let has_moved = moves && self.robots_sent.get(topic) != Some(&self.robots);
        // Numbers that have not changed are no new points of a plot.
        let is_old = self.at.get(topic).is_none_or(|at| now.since(*at) >= REPEAT_INTERVAL);
        self.changed.contains(topic) || has_moved || (moves && is_old)
    }

    fn done(&mut self, now: Tick, topic: &Topic) {
        self.changed.remove(topic);
        self.at.insert(topic.clone(), now);
        self.robots_sent.insert(topic.clone(), self.robots);
    }

    /// A scene, with the names of what was sent before and is gone.
    fn scene(&mut self, topic: &Topic, entities: Vec<Entity>) -> Message {
        let names: BTreeSet<String> = entities.iter().map(|entity| entity.id.clone()).collect();
        let before = self.entities.insert(topic.clone(), names.clone()).unwrap_or_default();
        let removed = before.into_iter().filter(|name| !names.contains(name)).collect();
        Message::Scene(Scene { entities, removed })
    }
}

impl Bridge {
    /// Sends what is due.
    pub(super) fn send(&mut self, now: Tick, outputs: &mut Vec<Output>) {
        let micros = u64::try_from(SCENE_INTERVAL.as_micros()).unwrap_or(u64::MAX);
        let interval = now.0 / micros;
        if interval == self.sent.interval {
            return;
        }
        self.sent.interval = interval;
        for topic in [Topic::Transforms, Topic::Teams, Topic::Quality] {
            self.send_one(now, &topic, outputs);
        }
        let is_links = |topic: &&Topic| matches!(topic, Topic::Links(_));
        let mut links: Vec<Topic> = self.watched.iter().filter(is_links).cloned().collect();
        // Those that were sent longest ago come first.
        links.sort_by_key(|topic| self.sent.at.get(topic).copied());
        let mut left = MAX_LINK_SCENES;
        for topic in links {
            if left > 0 && self.send_one(now, &topic, outputs) {
                left -= 1;
            }
        }
        if self.watched.contains(&Topic::Events) {
            let lines = self.news.next().into_iter();
            outputs.extend(lines.map(|line| Output::Send(Topic::Events, line)));
        } else {
            self.news.forget();
        }
    }

    /// Sends one topic if it is watched and due; true if it was sent.
    fn send_one(&mut self, now: Tick, topic: &Topic, outputs: &mut Vec<Output>) -> bool {
        if !self.watched.contains(topic) || !self.sent.is_due(now, topic) {
            return false;
        }
        let Some(message) = self.message(now, topic) else { return false };
        self.sent.done(now, topic);
        outputs.push(Output::Send(topic.clone(), message));
        true
    }

    /// The newest message of a topic; none if there is nothing to say.
    fn message(&mut self, now: Tick, topic: &Topic) -> Option<Message> {
        match topic {
            Topic::Transforms => {
                let robots = self.fleet.robots();
                Some(Message::Transforms(robots.iter().filter_map(transform).collect()))
            }
            Topic::Teams => {
                let notice = self.said.values().map(String::as_str).collect::<Vec<_>>().join("\n");
                let notice = Some(notice.as_str()).filter(|notice| !notice.is_empty());
                let entities = teams::entities(&self.fleet, now, notice);
                Some(self.sent.scene(topic, entities))
            }
            Topic::Links(modality) => {
                let entities = self.links.get(modality)?.entities(modality, &self.fleet);
                Some(self.sent.scene(topic, entities))
            }
            Topic::Quality => {
                let mut brief = self.audit.as_deref()?.clone();
                // A number for each robot is a megabyte in a large fleet; muster audit has them.
                brief.in_embedding.per_robot.clear();
                brief.in_physical.per_robot.clear();
                let encoded =
                    BusMessage::Audit(Arc::new(brief)).encode(Key::JsonAudit, Format::Json, now);
                let value: Value = serde_json::from_slice(&encoded.ok()?.payload).ok()?;
                Some(Message::Json(value))
            }
            Topic::Events => None,
        }
    }
}

/// The frame of a robot; none while it is nowhere.
fn transform(entry: &RosterEntry) -> Option<Transform> {
    let parent = frame_of(entry);
    let robot = entry.robot.as_str();
    // A frame cannot be its own parent.
    let child = if robot == parent { format!("robot/{robot}") } else { robot.to_owned() };
    let heading = entry.heading.unwrap_or_default();
    Some(Transform { parent: parent.to_owned(), child, position: entry.position?, heading })
}
