//! Records a live fleet: what is on the bus, and the scenes that viewers would be sent.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::time::Duration;

use mcap::McapError;
use muster_client::{Client, ReceivedJson};
use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::{Exit, ExitError};
use muster_runtime::stop::Stop;
use tokio::sync::mpsc;

use super::Entry;
use super::file::Recording;
use super::options::RecordArgs;
use crate::messages::{bytes, form, json_form, nanoseconds};
use crate::shell::fleet::{self, Order, client_config};
use crate::{Access, Bridge, Input, Output, Topic};

/// How often what was written goes to the disk: twice in the second that a kill may cost.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// How often the scenes learn that time passes.
const TURN: Duration = Duration::from_millis(50);

/// Most messages that wait for the disk. While it hangs, those that do not fit are counted and left out.
const MAX_WAITING: usize = 16 * 1024;

/// Most inputs that wait for the scenes.
const MAX_WAITING_INPUTS: usize = 256;

/// Most orders that wait for the bus.
const MAX_WAITING_ORDERS: usize = 256;

/// What goes to the thread that writes.
enum Job {
    /// A message of the bus.
    Json(ReceivedJson),
    /// A scene.
    Scene(Topic, Tick, Vec<u8>),
    /// Bring what there is to the disk.
    Flush,
}

/// Writes until no more comes, and returns how many messages were written.
fn write(mut recording: Recording, mut jobs: mpsc::Receiver<Job>) -> Result<u64, McapError> {
    let mut is_full = false;
    while let Some(job) = jobs.blocking_recv() {
        let had_room = match job {
            Job::Json(message) => {
                let topic = format!("/{}", message.key);
                let at = nanoseconds(message.received);
                let entry = Entry { topic: &topic, at, bytes: &message.json };
                recording.write(&entry, || json_form(message.schema))?
            }
            Job::Scene(topic, now, bytes) => {
                let name = topic.name();
                let entry = Entry { topic: &name, at: nanoseconds(now), bytes: &bytes };
                recording.write(&entry, || form(&topic))?
            }
            Job::Flush => {
                recording.flush()?;
                true
            }
        };
        if !had_room && !is_full {
            is_full = true;
            tracing::warn!("the file has no room for more topics: what new robots say is left out");
        }
    }
    recording.finish()
}

/// What goes to the writer, and how much it could not take.
struct Writing {
    jobs: mpsc::Sender<Job>,
    left_out: u64,
}

impl Writing {
    fn send(&mut self, job: Job) {
        if self.jobs.try_send(job).is_err() {
            self.left_out += 1;
        }
    }
}

/// Records until it is time to stop.
///
/// # Errors
/// If no router answers, or the file cannot be written.
pub(super) async fn run(
    args: &RecordArgs,
    config: ProcessConfig,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let name = args.file.display();
    let fail = |error: McapError| ExitError {
        exit: Exit::Failure,
        message: format!("{name}: cannot be written: {error}"),
    };
    let clock = Clock::start();
    let client_config = client_config(&config);
    let client = Client::open(&client_config)
        .await
        .map_err(|error| ExitError::unreachable(error.to_string()))?;
    let fleet = config.fleet.value.clone();
    let facts = BTreeMap::from([
        ("fleet".to_owned(), fleet.to_string()),
        ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("began".to_owned(), clock.now().as_seconds().to_string()),
    ]);
    let recording = Recording::create(&args.file, facts).map_err(fail)?;
    let (jobs, waiting) = mpsc::channel(MAX_WAITING);
    let mut writer = tokio::task::spawn_blocking(move || write(recording, waiting));
    let mut writing = Writing { jobs, left_out: 0 };

    let mut messages = client.json_messages().await?;
    let (inputs, mut inbox) = mpsc::channel(MAX_WAITING_INPUTS);
    let (orders, to_fleet) = mpsc::channel(MAX_WAITING_ORDERS);
    tokio::spawn(fleet::follow(client_config, inputs, to_fleet));
    let mut scenes = Scenes {
        bridge: Bridge::new(fleet.clone(), Access::ReadOnly),
        watched: BTreeSet::new(),
        orders,
    };
    writeln!(std::io::stdout(), "records fleet {fleet} in {name}; Ctrl-C ends it")?;
    let end = args.seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    let end = async {
        match end {
            Some(end) => tokio::time::sleep(end).await,
            None => std::future::pending().await,
        }
    };
    tokio::pin!(end);
    let mut turns = tokio::time::interval(TURN);
    turns.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut flushes = tokio::time::interval(FLUSH_INTERVAL);
    flushes.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    loop {
        tokio::select! {
            () = stop.stopped() => break,
            () = &mut end => break,
            // It ends by itself only if it fails.
            written = &mut writer => return match written? {
                Ok(_) => Ok(()),
                Err(error) => anyhow::bail!("{name}: {error}; what was written until then is there"),
            },
            _ = flushes.tick() => writing.send(Job::Flush),
            _ = turns.tick() => scenes.handle(clock.now(), Input::Tick, &mut writing),
            Some(input) = inbox.recv() => scenes.handle(clock.now(), input, &mut writing),
            message = messages.next() => match message {
                Ok(message) => writing.send(Job::Json(message)),
                Err(_) => break,
            },
        }
    }
    let left_out = writing.left_out + messages.missed();
    drop(writing);
    let count = writer.await?.map_err(fail)?;
    client.close().await;
    writeln!(std::io::stdout(), "{count} messages are in {name}")?;
    if left_out > 0 {
        eprintln!("{left_out} messages were left out, as the disk or this host was too slow");
    }
    Ok(())
}

/// Makes the scenes, all of them.
struct Scenes {
    bridge: Bridge,
    watched: BTreeSet<Topic>,
    orders: mpsc::Sender<Order>,
}

impl Scenes {
    fn handle(&mut self, now: Tick, input: Input, writing: &mut Writing) {
        let before = self.watched.len();
        for output in self.bridge.handle(now, input) {
            match output {
                Output::Offer(topic) => {
                    self.watched.insert(topic);
                }
                Output::Send(topic, message) => {
                    if let Some(bytes) = bytes(message, now) {
                        writing.send(Job::Scene(topic, now, bytes));
                    }
                }
                // The core asks again for what no one answers, and for what found no room here.
                Output::Fetch(fetch) => drop(self.orders.try_send(Order::Fetch(fetch))),
                // There are no viewers.
                _ => {}
            }
        }
        if self.watched.len() != before {
            let watched = self.watched.clone();
            self.bridge.handle(now, Input::Watched(watched));
        }
    }
}
