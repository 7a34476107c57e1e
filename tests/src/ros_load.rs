//! Robots of ROS 2 in numbers: odometry and transforms in the form of `rmw_zenoh`, and what a bridge takes for them.
//!
//! One thread puts for all robots, each in its turn, by declared publishers as ROS has them. Every message has the
//! attachment, the key and the token that a program of ROS would have. The robots stand in two groups, and now and then one
//! goes to the other group: from the put of the first odometry with the new place to the arrival of the first message on
//! `/{robot}/team` with another team is what counts as the time from a pose to its team.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use muster_ros::{
    Attachment, Catalog, Endpoint, EndpointKind, Gid, Message, Node, Qos, Token, TopicKey,
    TopicName, TypeHash, Value, cdr,
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;

use crate::client::Client;
use crate::latency::now_us;

/// How far the groups are from each other in metres.
const APART_M: f64 = 1000.0;

/// How far robots of a group are from each other.
const SPACING_M: f64 = 2.0;

/// How many robots stand in a row.
const PER_ROW: usize = 16;

/// How far robots sway to and fro.
const SWAY_M: f64 = 0.5;

/// How long a robot stays at least, and within what time more it goes: no multiple of a tick, so that all phases occur.
const STAYS: (Duration, Duration) = (Duration::from_millis(300), Duration::from_millis(200));

/// How long a team is waited for.
const TEAM_WITHIN: Duration = Duration::from_secs(5);

/// Shortest sleep: robots that are due within it put one after the other.
const MIN_SLEEP: Duration = Duration::from_micros(500);

/// The domain of all robots.
const DOMAIN: u32 = 0;

/// Where a number stands in a payload, so that it is changed without writing the whole message again.
#[derive(Debug)]
struct Template {
    bytes: Vec<u8>,
    /// Where the first coordinate stands.
    x: usize,
}

/// A message with a coordinate that is found by writing it twice.
fn template(make: impl Fn(f64) -> anyhow::Result<Vec<u8>>) -> anyhow::Result<Template> {
    // All eight bytes differ between these two.
    let (one, two) = (f64::from_bits(0x4011_1111_1111_1111), f64::from_bits(0x4122_2222_2222_2222));
    let (first, second) = (make(one)?, make(two)?);
    let x = first.iter().zip(&second).position(|(a, b)| a != b).context("no coordinate")?;
    anyhow::ensure!(first.get(x..x + 8) == Some(&one.to_le_bytes()[..]), "it stands elsewhere");
    Ok(Template { bytes: first, x })
}

impl Template {
    fn with(&mut self, x: f64) -> &[u8] {
        if let Some(place) = self.bytes.get_mut(self.x..self.x + 8) {
            place.copy_from_slice(&x.to_le_bytes());
        }
        &self.bytes
    }
}

/// A publisher of ROS.
struct RosPublisher {
    publisher: Publisher<'static>,
    gid: Gid,
    sequence: i64,
    _token: LivelinessToken,
}

impl RosPublisher {
    fn declare(
        client: &Client,
        node: &Node,
        number: u64,
        topic: &str,
        message: &Message,
    ) -> anyhow::Result<Self> {
        let layout = message.layout();
        let key = TopicKey {
            domain: DOMAIN,
            topic: TopicName::new(topic)?,
            type_name: layout.name().clone(),
            hash: TypeHash::of(layout),
        };
        let endpoint = Endpoint {
            number,
            kind: EndpointKind::Publisher,
            topic: key.topic.to_string(),
            type_name: key.type_name.to_dds(),
            hash: key.hash.to_string(),
            qos: Qos { depth: 10, ..Qos::default() },
            further: Vec::new(),
        };
        let token = Token { node: node.clone(), endpoint: Some(endpoint) };
        let fail = |error: zenoh::Error| anyhow::anyhow!("{error}");
        let session = client.session();
        let declared = session.liveliness().declare_token(token.to_string());
        Ok(Self {
            publisher: session.declare_publisher(key.to_string()).wait().map_err(fail)?,
            gid: token.gid(),
            sequence: 0,
            _token: declared.wait().map_err(fail)?,
        })
    }

    fn put(&mut self, payload: &[u8]) -> anyhow::Result<()> {
        self.sequence += 1;
        let stamp_ns = i64::try_from(now_us()).unwrap_or(i64::MAX).saturating_mul(1000);
        let attachment = Attachment { sequence: self.sequence, stamp_ns, gid: self.gid };
        let put = self.publisher.put(payload).attachment(attachment.to_bytes());
        put.wait().map_err(|error| anyhow::anyhow!("{error}"))
    }
}

/// One robot.
struct Robot {
    odom: RosPublisher,
    tf: RosPublisher,
    x: f64,
    /// In which group it stands.
    group: usize,
}

/// What is to be done.
#[derive(Debug, Clone, Copy)]
pub struct Load {
    /// How many robots.
    pub robots: usize,
    /// How many odometries, and how many transforms, each puts a second.
    pub rate_hz: f64,
}

/// A robot on its way to another team.
#[derive(Debug, Clone)]
struct Move {
    left: Option<String>,
    put: Instant,
}

/// What is known of the teams of robots.
#[derive(Debug, Default)]
struct Teams {
    newest: BTreeMap<String, String>,
    moves: BTreeMap<String, Move>,
    /// From a pose to its team.
    took: Vec<Duration>,
    /// Robots that were given no other team in time.
    missing: usize,
}

/// What was put, and what came back.
#[derive(Debug, Default)]
pub struct Counts {
    /// Messages of robots.
    put: AtomicU64,
    teams: Mutex<Teams>,
    moves: AtomicBool,
    stops: AtomicBool,
}

impl Counts {
    fn teams(&self) -> MutexGuard<'_, Teams> {
        // No critical section can panic half-way: the state behind a poisoned lock is whole.
        self.teams.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many messages of robots were put.
    #[must_use]
    pub fn put(&self) -> u64 {
        self.put.load(Ordering::Relaxed)
    }

    /// How many robots have a team.
    #[must_use]
    pub fn divided(&self) -> usize {
        self.teams().newest.len()
    }

    /// From now on robots go to the other group.
    pub fn begin_moves(&self) {
        self.moves.store(true, Ordering::Relaxed);
    }

    /// No robot puts any more.
    pub fn stop(&self) {
        self.stops.store(true, Ordering::Relaxed);
    }

    /// How long each team took in milliseconds, and how many robots got none in time.
    #[must_use]
    pub fn took(&self) -> (Vec<f64>, usize) {
        let teams = self.teams();
        (teams.took.iter().map(|took| took.as_secs_f64() * 1e3).collect(), teams.missing)
    }
}

/// Names of robots, as the bridge reads them.
#[must_use]
pub fn robot_name(robot: usize) -> String {
    format!("r{robot}")
}

fn x_of(robot: usize, group: usize) -> f64 {
    group as f64 * APART_M + (robot % PER_ROW) as f64 * SPACING_M
}

/// Reads `/{robot}/team` of all robots, for as long as the session lives.
///
/// # Errors
/// If the session is closed.
pub async fn listen(client: &Client, counts: &Arc<Counts>) -> anyhow::Result<()> {
    let catalog = Catalog::standard();
    let layout = Arc::clone(Message::new(&catalog, "std_msgs/String")?.layout());
    let key = format!("{DOMAIN}/*/team/{}/*", layout.name().to_dds());
    let counts = Arc::clone(counts);
    let receive = move |sample: zenoh::sample::Sample| {
        let arrived = Instant::now();
        let Some(robot) = sample.key_expr().as_str().split('/').nth(1).map(str::to_owned) else {
            return;
        };
        let Ok(Value::Struct(fields)) = cdr::decode(&layout, &sample.payload().to_bytes()) else {
            return;
        };
        let text = fields.first().and_then(Value::as_text).unwrap_or_default();
        let json: serde_json::Value = serde_json::from_str(text).unwrap_or_default();
        let Some(team) = json["team"].as_str() else { return };
        let mut teams = counts.teams();
        let other = teams.moves.get(&robot).filter(|one| one.left.as_deref() != Some(team));
        if let Some(put) = other.map(|one| one.put) {
            teams.moves.remove(&robot);
            teams.took.push(arrived.duration_since(put));
        }
        teams.newest.insert(robot, team.to_owned());
    };
    let declared = client.session().declare_subscriber(key).callback(receive).background().await;
    declared.map_err(|error| anyhow::anyhow!("{error}"))
}

/// Puts for all robots until they are stopped. It takes a thread of its own.
///
/// # Errors
/// If the session is closed.
pub fn drive(client: &Client, load: Load, counts: &Counts) -> anyhow::Result<()> {
    let catalog = Catalog::standard();
    let odometry = |x: f64, frame: &str, y: f64| -> anyhow::Result<Message> {
        let mut message = Message::new(&catalog, "nav_msgs/Odometry")?;
        message.set("header.frame_id", frame)?;
        message.set("child_frame_id", "base_link")?;
        message.set("pose.pose.position.x", x)?;
        message.set("pose.pose.position.y", y)?;
        message.set("pose.pose.orientation.w", 1.0)?;
        Ok(message)
    };
    let mut transform = Message::new(&catalog, "geometry_msgs/TransformStamped")?;
    transform.set("header.frame_id", "map")?;
    transform.set("child_frame_id", "odom")?;
    transform.set("transform.rotation.w", 1.0)?;
    let mut tf = Message::new(&catalog, "tf2_msgs/TFMessage")?;
    tf.set("transforms", Value::List(vec![transform.into_value()]))?;
    let tf_bytes = tf.encode()?;

    let session = client.session().zid().to_string();
    let mut robots = Vec::new();
    let mut rows = BTreeMap::new();
    for number in 0..load.robots {
        let (name, group, row) = (robot_name(number), number % 2, number / PER_ROW);
        let y = row as f64 * SPACING_M;
        if let std::collections::btree_map::Entry::Vacant(entry) = rows.entry(row) {
            entry.insert(template(|x| Ok(odometry(x, "odom", y)?.encode()?))?);
        }
        let node = Node {
            domain: DOMAIN,
            session: session.clone(),
            number: number as u64,
            enclave: "/".to_owned(),
            namespace: format!("/{name}"),
            name: "driver".to_owned(),
        };
        let first = odometry(0.0, "odom", y)?;
        let publisher = |number, topic: &str, message: &Message| {
            RosPublisher::declare(client, &node, number, &format!("/{name}/{topic}"), message)
        };
        let (odom, tf) = (publisher(1, "odom", &first)?, publisher(2, "tf", &tf)?);
        robots.push(Robot { odom, tf, x: x_of(number, group), group });
    }

    let mut chance = ChaCha8Rng::seed_from_u64(1);
    let (period, begin) = (Duration::from_secs_f64(1.0 / load.rate_hz), Instant::now());
    let mut goes_at = begin;
    let mut due_to_go = None;
    for round in 0_u32.. {
        for (number, robot) in robots.iter_mut().enumerate() {
            let phase = period.mul_f64(number as f64 / load.robots as f64);
            let due = begin + period.mul_f64(f64::from(round)) + phase;
            let now = Instant::now();
            if due > now + MIN_SLEEP {
                std::thread::sleep(due - now);
            }
            if counts.moves.load(Ordering::Relaxed) && Instant::now() >= goes_at {
                goes_at = Instant::now() + STAYS.0 + STAYS.1.mul_f64(chance.random_range(0.0..1.0));
                due_to_go = Some(chance.random_range(0..load.robots));
            }
            if due_to_go == Some(number) {
                due_to_go = None;
                robot.group = 1 - robot.group;
                robot.x = x_of(number, robot.group);
                note_move(counts, &robot_name(number));
            }
            let Some(template) = rows.get_mut(&(number / PER_ROW)) else { continue };
            // Robots are never quite still, so that every frame of the fleet is another one.
            let sway = SWAY_M * begin.elapsed().as_secs_f64().sin();
            robot.odom.put(template.with(robot.x + sway))?;
            robot.tf.put(&tf_bytes)?;
            counts.put.fetch_add(2, Ordering::Relaxed);
        }
        if counts.stops.load(Ordering::Relaxed) {
            return Ok(());
        }
    }
    Ok(())
}

fn note_move(counts: &Counts, robot: &str) {
    let mut teams = counts.teams();
    let now = Instant::now();
    let late = |one: &Move| now.duration_since(one.put) > TEAM_WITHIN;
    let before = teams.moves.len();
    teams.moves.retain(|_, one| !late(one));
    teams.missing += before - teams.moves.len();
    // One that goes again before it was given a team is not counted.
    if teams.moves.remove(robot).is_none() {
        let left = teams.newest.get(robot).cloned();
        teams.moves.insert(robot.to_owned(), Move { left, put: now });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_template_changes_the_coordinate_alone() {
        let catalog = Catalog::standard();
        let make = |x: f64| -> anyhow::Result<Vec<u8>> {
            let mut message = Message::new(&catalog, "nav_msgs/Odometry")?;
            message.set("header.frame_id", "odom")?;
            message.set("pose.pose.position.x", x)?;
            Ok(message.encode()?)
        };
        let mut template = template(make).unwrap();
        for x in [0.0, -17.25, 1e9] {
            assert_eq!(template.with(x), make(x).unwrap());
        }
    }

    #[test]
    fn a_move_that_is_answered_late_is_missing() {
        let counts = Counts::default();
        note_move(&counts, "r1");
        counts.teams().moves.get_mut("r1").unwrap().put -= 2 * TEAM_WITHIN;
        note_move(&counts, "r2");
        assert_eq!(counts.took(), (vec![], 1));
    }
}
