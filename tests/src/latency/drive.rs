//! A process of robots, which put poses at a rate, each with a phase of its own, and writes down when.
//!
//! The robots share one Zenoh session and put JSON. Up to [`MOST_MEMBERS`] are members as `muster robot` is: each
//! has its token, subscribes to its team, and puts by declared publishers, since a router searches all keys
//! of the fleet for the receivers of each message on an undeclared key. Those of larger fleets report through a
//! gateway, which declares nothing for one robot: it subscribes to the teams of all, and puts by the text of keys.
//!
//! A robot that also reports links or its rank does so just before a pose, so that the pose is its last message: the
//! roster then contains when `ingest` received it.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use serde_json::json;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;

use super::squads::Squads;
use super::{now_us, robot_name};
use crate::client::Client;

/// Every so many poses, and at the first, a robot reports its links.
const LINKS_EVERY: u64 = 5;

/// Every so many poses, and at the first, a robot repeats its rank.
const RANK_EVERY: u64 = 10;

/// Robots that join in a second: an operator switches a fleet on squad by squad. What all robots of a large
/// fleet say at once overflows the queues of a transport, which drop it, as poses are made to be dropped.
const JOIN_HZ: f64 = 1000.0;

/// Most robots that are members of the fleet themselves. A router compares each key that one declares with those of all
/// others (`Resource::get_matches` of Zenoh 1.10.2), so that the time of joining grows with the square: a minute for
/// 5,000 robots, a quarter of an hour for 20,000.
pub const MOST_MEMBERS: usize = 5000;

/// Shortest sleep. Robots that are due within it put one after the other, a little late: their poses
/// count from when they were really put.
const MIN_SLEEP: Duration = Duration::from_micros(500);

/// How often it is looked whether to stop.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Which robots are driven, and how.
#[derive(Debug, Clone)]
pub struct Drive {
    /// The router.
    pub endpoint: String,
    /// The fleet.
    pub fleet: String,
    /// How many robots the fleet has.
    pub robots: usize,
    /// In how many teams they march.
    pub teams: usize,
    /// Poses per second of each robot.
    pub rate_hz: f64,
    /// Where the log is written; the robots fall silent once a file `stop` is there.
    pub folder: PathBuf,
}

/// What was put.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Puts {
    /// When each pose of each robot was put, in microseconds since 1970; the first has the number 0.
    pub poses: Vec<Vec<u64>>,
    /// Messages of any kind.
    pub messages: u64,
}

/// The name of the log within its folder.
const LOG: &str = "puts";

/// The name of the file that ends it.
const STOP: &str = "stop";

/// Makes robots fall silent.
///
/// # Errors
/// If the folder cannot be written.
pub fn stop(folder: &Path) -> anyhow::Result<()> {
    std::fs::write(folder.join(STOP), "").with_context(|| format!("{}", folder.display()))
}

impl Puts {
    /// The log of a stopped drive, once it is written.
    ///
    /// # Errors
    /// If it is none.
    pub fn read(folder: &Path) -> anyhow::Result<Option<Self>> {
        let path = folder.join(LOG);
        if !path.exists() {
            return Ok(None);
        }
        let bytes = std::fs::read(&path)?;
        let mut numbers = bytes.chunks_exact(8).map(|chunk| {
            chunk.iter().rev().fold(0_u64, |number, byte| (number << 8) | u64::from(*byte))
        });
        let mut next = || numbers.next().context("the log of what was put is cut off");
        let (messages, robots) = (next()?, next()?);
        let mut poses = Vec::new();
        for _ in 0..robots {
            let count = next()?;
            poses.push((0..count).map(|_| next()).collect::<anyhow::Result<_>>()?);
        }
        Ok(Some(Self { poses, messages }))
    }

    fn write(&self, folder: &Path) -> anyhow::Result<()> {
        let robots = self.poses.iter();
        let rows = robots
            .flat_map(|times| std::iter::once(times.len() as u64).chain(times.iter().copied()));
        let numbers = [self.messages, self.poses.len() as u64].into_iter().chain(rows);
        let bytes: Vec<u8> = numbers.flat_map(u64::to_le_bytes).collect();
        let (partial, done) = (folder.join("puts.partial"), folder.join(LOG));
        std::fs::write(&partial, bytes)?;
        // A reader finds the whole file or none.
        std::fs::rename(partial, done)?;
        Ok(())
    }
}

/// What a robot puts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stream {
    Pose,
    Links,
    Rank,
}

/// All streams with their names, each at the place of its number.
const STREAMS: [(Stream, &str); 3] =
    [(Stream::Pose, "pose"), (Stream::Links, "links"), (Stream::Rank, "rank")];

/// The payload of a pose: as long as those of robots in the field, with the number as heading.
#[must_use]
pub fn pose_json(at: [f64; 2], number: u64, boot: &str, stamp_us: u64) -> String {
    format!(
        "{{\"x\":{:.4},\"y\":{:.4},\"heading\":{number},\"stamp\":{}.{:06},\"boot\":\"{boot}\",\
         \"seq\":{number}}}",
        at[0],
        at[1],
        stamp_us / 1_000_000,
        stamp_us % 1_000_000
    )
}

/// How the robots put.
enum Reports {
    /// By three publishers of each robot, in the order of [`STREAMS`].
    Members { publishers: Vec<Publisher<'static>>, _tokens: Vec<LivelinessToken>, _client: Client },
    /// By the text of keys.
    Gateway(Client),
}

impl Reports {
    async fn open(client: Client, robots: usize) -> anyhow::Result<Self> {
        // The listener measures the messages on teams and their arrival; but robots subscribe as well.
        if robots > MOST_MEMBERS {
            client.listen("robot/*/team", |_, _| {}).await?;
            return Ok(Self::Gateway(client));
        }
        let (mut tokens, mut publishers) = (Vec::new(), Vec::new());
        for robot in (0..robots).map(robot_name) {
            tokens.push(client.token(&format!("robot/{robot}")).await?);
            client.listen(&format!("robot/{robot}/team"), |_, _| {}).await?;
            for (_, stream) in STREAMS {
                let publisher = client
                    .session()
                    .declare_publisher(client.key(&format!("robot/{robot}/{stream}")))
                    .encoding(Encoding::APPLICATION_JSON)
                    .await;
                publishers.push(publisher.map_err(|error| anyhow::anyhow!("{robot}: {error}"))?);
            }
        }
        Ok(Self::Members { publishers, _tokens: tokens, _client: client })
    }

    fn put(&self, robot: usize, stream: Stream, payload: String) -> anyhow::Result<()> {
        let put = match self {
            Self::Members { publishers, .. } => {
                publishers[robot * STREAMS.len() + stream as usize].put(payload).wait()
            }
            Self::Gateway(client) => {
                let key = format!("robot/{}/{}", robot_name(robot), STREAMS[stream as usize].1);
                let put = client.session().put(client.key(&key), payload);
                put.encoding(Encoding::APPLICATION_JSON).wait()
            }
        };
        put.map_err(|error| anyhow::anyhow!("{stream:?} of robot {robot}: {error}"))
    }
}

/// Drives robots until they are stopped, writes the log, and waits to be killed, so that the robots
/// stay members of the fleet.
///
/// # Errors
/// If the router does not answer, or the log cannot be written.
pub async fn run(drive: &Drive) -> anyhow::Result<()> {
    let client = Client::connect_for_many(&drive.endpoint, &drive.fleet).await?;
    let squads = Squads::new(drive.robots, drive.teams);
    let reports = Reports::open(client, drive.robots).await?;
    let (drive, folder) = (drive.clone(), drive.folder.clone());
    let driving = tokio::task::spawn_blocking(move || {
        let mut puts = Puts { poses: vec![Vec::new(); drive.robots], messages: 0 };
        let put = |robot, stream, payload| reports.put(robot, stream, payload);
        put_reports(&drive, &squads, put, &mut puts)?;
        anyhow::Ok((puts, reports))
    });
    let (puts, _reports) = driving.await??;
    puts.write(&folder)?;
    std::future::pending().await
}

/// Puts what is due, again and again, until the stop.
fn put_reports(
    drive: &Drive,
    squads: &Squads,
    put: impl Fn(usize, Stream, String) -> anyhow::Result<()>,
    puts: &mut Puts,
) -> anyhow::Result<()> {
    let stop = drive.folder.join(STOP);
    let period = Duration::from_secs_f64(1.0 / drive.rate_hz);
    let boot = format!("{:x}", now_us());
    let (begin, mut looked) = (Instant::now(), Instant::now());
    for round in 0_u64.. {
        for robot in 0..drive.robots {
            // Phases that are spread evenly over the period, in the order of the robots.
            let phase = period.mul_f64(robot as f64 / drive.robots as f64);
            let due = begin + period.mul_f64(round as f64) + phase;
            let now = Instant::now();
            if due > now + MIN_SLEEP {
                std::thread::sleep(due - now);
            }
            if looked.elapsed() > LOOK_EVERY {
                looked = Instant::now();
                if stop.exists() {
                    return Ok(());
                }
            }
            let t = begin.elapsed().as_secs_f64();
            if robot as f64 > t * JOIN_HZ {
                break;
            }
            let number = puts.poses[robot].len() as u64;
            // Not all robots report links in the same round.
            let turn = number + robot as u64;
            let stamp = now_us();
            if number == 0 || turn.is_multiple_of(LINKS_EVERY) {
                let links = squads.links(robot, t).into_iter();
                let links: Vec<_> = links
                    .map(|(peer, quality)| json!({"peer": robot_name(peer), "quality": quality}))
                    .collect();
                let links = json!({"links": links, "boot": boot, "seq": number});
                put(robot, Stream::Links, links.to_string())?;
                puts.messages += 1;
            }
            if number == 0 || turn.is_multiple_of(RANK_EVERY) {
                let superior = squads.superior(robot, t).map(robot_name);
                let rank = json!({"superior": superior, "boot": boot, "seq": number});
                put(robot, Stream::Rank, rank.to_string())?;
                puts.messages += 1;
            }
            let pose = pose_json(squads.place(robot, t), number, &boot, stamp);
            puts.poses[robot].push(now_us());
            put(robot, Stream::Pose, pose)?;
            puts.messages += 1;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_put_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Puts::read(folder.path()).unwrap(), None);
        let puts = Puts { poses: vec![vec![5, u64::MAX], vec![], vec![1 << 40]], messages: 9 };
        puts.write(folder.path()).unwrap();
        assert_eq!(Puts::read(folder.path()).unwrap(), Some(puts));
        std::fs::write(folder.path().join(LOG), 7_u64.to_le_bytes()).unwrap();
        assert!(Puts::read(folder.path()).is_err());
    }

    #[test]
    fn robots_put_at_their_rate_each_in_its_turn_until_they_are_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let drive = Drive {
            endpoint: String::new(),
            fleet: String::new(),
            robots: 20,
            teams: 2,
            rate_hz: 50.0,
            folder: folder.path().to_owned(),
        };
        let mut puts = Puts { poses: vec![Vec::new(); 20], messages: 0 };
        let begin = Instant::now();
        let put = |_, stream: Stream, payload: String| {
            let value: serde_json::Value = serde_json::from_str(&payload)?;
            assert_eq!(value["heading"].is_u64(), stream == Stream::Pose, "{payload}");
            if begin.elapsed() > Duration::from_millis(500) {
                stop(&drive.folder)?;
            }
            Ok(())
        };
        put_reports(&drive, &Squads::new(20, 2), put, &mut puts).unwrap();
        let rounds = puts.poses[0].len();
        assert!((20..100).contains(&rounds), "{rounds} rounds in half a second or a little more");
        // One in five also puts links, one in ten a rank, and all do at first.
        let poses: usize = puts.poses.iter().map(Vec::len).sum();
        let share = puts.messages as f64 / poses as f64;
        assert!((1.3..1.45).contains(&share), "{share}");
        let pairs = puts.poses[10].iter().zip(&puts.poses[0]);
        let mut apart: Vec<u64> = pairs.map(|(one, other)| one.abs_diff(*other)).collect();
        apart.sort_unstable();
        let apart = apart[apart.len() / 2];
        assert!(apart > 5_000, "half a period is 10 ms, not {apart} µs");
    }
}
