//! The loop: samples, messages and time into the core, outputs to both buses.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use muster_client::{BridgeGets, Client, Config, Mode};
use muster_model::time::Tick;
use muster_runtime::bus::{Bus, BusConfig, ConnectTimeout, Subscription, Token, Urgency};
use muster_runtime::clock::Clock;
use muster_runtime::config::{self, Origin, ProcessConfig};
use muster_runtime::instance::instance_name;
use muster_runtime::notify;
use muster_runtime::observe::Observatory;
use muster_runtime::stop::Stop;
use muster_wire::{ForeignKey, Key, Packet};
use tokio::time::Instant;

use super::options::Ros2Options;
use super::queue::SendQueue;
use crate::config::{Content, Setup};
use crate::core::{Bridge, Input, Output};

/// Largest message of ROS in bytes that is read: transforms of a thousand frames.
const MAX_SAMPLE_BYTES: usize = 256 * 1024;

/// How often publishers are asked for the static transforms, links and superiors that they keep: one that was lost with a link
/// is there again before an operator looks.
const ASK_KEPT_EVERY: Duration = Duration::from_secs(10);

/// When a process that waits for its router counts as started.
const READY_AFTER: Duration = Duration::from_secs(1);

/// How long answers are waited for.
const ASK_KEPT_WITHIN: Duration = Duration::from_secs(2);

/// The process options as a client takes them.
fn client_config(config: &ProcessConfig) -> Config {
    Config {
        fleet: config.fleet.value.to_string(),
        // An address that the user gave overrides Zenoh's configuration, also if it is the default.
        routers: (config.connect.origin != Origin::Default).then(|| config.connect.value.clone()),
        zenoh_config: config.zenoh_config.value.clone(),
        mode: if config.mode.value == config::Mode::Peer { Mode::Peer } else { Mode::Client },
        listen: config.listen.value.clone(),
        ..Config::default()
    }
}

/// What the bus of ROS and the loop share. A lock is held for a moment only.
#[derive(Debug)]
struct Shared {
    bridge: Mutex<Bridge>,
    clock: Clock,
}

impl Shared {
    fn bridge(&self) -> MutexGuard<'_, Bridge> {
        // No critical section can panic half-way: the state behind a poisoned lock is whole.
        self.bridge.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> Tick {
        self.clock.now()
    }

    /// A sample that was put, on a thread of the bus, or one that is kept.
    fn receive(&self, sample: Input) {
        let now = self.now();
        let outputs = self.bridge().handle(now, sample);
        outputs.iter().for_each(say);
    }
}

/// Logs what is refused.
fn say(output: &Output) {
    if let Output::Refused(refusal) = output {
        let count = refusal.count;
        tracing::warn!("{}: {} ({count} since the last warning)", refusal.key, refusal.reason);
    }
}

/// Runs the bridge until it is time to stop.
///
/// # Errors
/// If a bus does not open or refuses a subscription.
pub(super) async fn run(
    config: ProcessConfig,
    options: Ros2Options,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let observatory = Observatory::open(&config, &[])?;
    let client_config = client_config(&config);
    let mut watched = notify::watch();
    let (client, ros) = tokio::select! {
        opened = watched.during(open(&client_config, options.ros)) => opened?,
        () = stop.stopped() => return Ok(()),
    };
    drop(watched);
    let setup = Arc::new(options.setup);
    let instance = instance_name();
    let bridge = Bridge::new(Arc::clone(&setup), &ros.session_id(), &instance);
    let shared = Arc::new(Shared { bridge: Mutex::new(bridge), clock: Clock::start() });
    let queue = SendQueue::default();
    let sending = ros.clone();
    queue.start("muster-ros2", move |packet: Packet| {
        if let Err(error) = sending.put_packet(packet, Urgency::Normal) {
            tracing::debug!("{error:#}");
        }
    })?;
    let gets = client.serve_bridge(&instance).await?;
    let mut hands = Hands { client, ros, queue, tokens: BTreeMap::new() };
    let outputs = shared.bridge().start();
    hands.perform(outputs).await;
    let subscriptions = subscribe(&hands.ros, &setup, &shared).await?;
    let asking = tokio::spawn(ask_kept(hands.ros.clone(), Arc::clone(&setup), Arc::clone(&shared)));
    notify::ready(&format!("reads {} kinds of topics of ROS", setup.sources.len()));
    let result = turn(&mut hands, gets, &shared, &observatory, setup.every, &mut stop).await;
    asking.abort();
    drop(subscriptions);
    notify::stopping().await;
    hands.queue.abandon();
    hands.client.close().await;
    hands.ros.close().await;
    result
}

/// Opens both sessions, and notes for the service manager if that waits for a router: it may take long, and is no failure
/// of this process.
async fn open(config: &Config, ros: BusConfig) -> anyhow::Result<(Client, Bus)> {
    let opening = async {
        let client = Client::open(config).await?;
        let ros = Bus::open(ros, ConnectTimeout::Never).await?;
        anyhow::Ok((client, ros))
    };
    let mut opening = std::pin::pin!(opening);
    if let Ok(opened) = tokio::time::timeout(READY_AFTER, &mut opening).await {
        return opened;
    }
    notify::ready("waiting for a router");
    opening.await
}

async fn turn(
    hands: &mut Hands,
    mut gets: BridgeGets,
    shared: &Shared,
    observatory: &Observatory,
    every: Duration,
    stop: &mut Stop,
) -> anyhow::Result<()> {
    let mut teams = hands.client.teams().await?;
    let mut audits = hands.client.audits().await?;
    let mut rosters = hands.client.rosters().await?;
    let mut watched = notify::watch();
    let mut next_tick = Instant::now();
    loop {
        let input = tokio::select! {
            () = stop.stopped() => return Ok(()),
            () = watched.due() => {
                watched.report();
                continue;
            }
            () = tokio::time::sleep_until(next_tick) => {
                // Ticks that were missed are left out.
                next_tick = (next_tick + every).max(Instant::now());
                // Who asks for the health of the process is answered by this loop.
                observatory.router_turned();
                // The same division again has younger data behind it.
                if let Some(latest) = teams.latest() {
                    let again = Input::Teams(latest.value, latest.stale.is_some());
                    let outputs = shared.bridge().handle(shared.now(), again);
                    hands.perform(outputs).await;
                }
                Input::Tick
            }
            get = gets.next() => {
                let state = shared.bridge().state();
                get.answer(state);
                continue;
            }
            latest = teams.changed() => {
                let latest = latest?;
                Input::Teams(latest.value, latest.stale.is_some())
            }
            latest = audits.changed() => Input::Audit(latest?.value),
            latest = rosters.changed() => Input::Roster(latest?.value),
        };
        let now = shared.now();
        let outputs = shared.bridge().handle(now, input);
        for output in &outputs {
            if let Output::Shift(seconds) = output {
                let shift = Duration::from_secs_f64(seconds.abs());
                let shifted = if *seconds < 0.0 {
                    next_tick.checked_sub(shift)
                } else {
                    next_tick.checked_add(shift)
                };
                next_tick = shifted.unwrap_or(next_tick);
            }
        }
        hands.perform(outputs).await;
    }
}

/// Subscribes to the topics of all sources.
async fn subscribe(
    ros: &Bus,
    setup: &Setup,
    shared: &Arc<Shared>,
) -> anyhow::Result<Vec<Subscription>> {
    let mut subscriptions = Vec::new();
    for (number, source) in setup.sources.iter().enumerate() {
        for pattern in &source.patterns {
            let shared = Arc::clone(shared);
            let receive = move |packet| shared.receive(Input::Sample(number, packet));
            subscriptions.push(ros.listen_foreign(pattern, MAX_SAMPLE_BYTES, receive).await?);
        }
    }
    Ok(subscriptions)
}

/// Whether publishers may keep what is said once for those that come late: what holds until something else is said.
fn is_kept(content: &Content) -> bool {
    match content {
        Content::Transforms { is_static } => *is_static,
        Content::Links { .. } | Content::Rank { .. } => true,
        Content::Pose { .. } => false,
    }
}

/// Asks for what publishers keep, again and again.
async fn ask_kept(ros: Bus, setup: Arc<Setup>, shared: Arc<Shared>) {
    let mut rounds = tokio::time::interval(ASK_KEPT_EVERY);
    let mut link = ros.link();
    loop {
        tokio::select! {
            _ = rounds.tick() => {}
            changed = link.changed() => if changed.is_err() {
                return;
            },
        }
        for (number, source) in setup.sources.iter().enumerate() {
            if !is_kept(&source.content) {
                continue;
            }
            for pattern in &source.patterns {
                match ros.get_kept(pattern, MAX_SAMPLE_BYTES, ASK_KEPT_WITHIN).await {
                    Ok(kept) => {
                        let kept = kept.into_iter().map(|packet| Input::Kept(number, packet));
                        kept.for_each(|sample| shared.receive(sample));
                    }
                    Err(error) => tracing::debug!("{error:#}"),
                }
            }
        }
    }
}

/// What outputs are carried out with.
struct Hands {
    client: Client,
    ros: Bus,
    queue: SendQueue,
    tokens: BTreeMap<String, Token>,
}

impl Hands {
    async fn perform(&mut self, outputs: Vec<Output>) {
        for output in outputs {
            say(&output);
            match output {
                Output::Report(robot, report) => {
                    if let Err(error) = self.client.relay(robot, report) {
                        tracing::debug!("{error}");
                    }
                }
                Output::Publish { key, payload, attachment } => {
                    let packet = Packet::put(key, "", payload);
                    // It fails as the process ends.
                    let _ = self.queue.push(Packet { attachment, ..packet });
                }
                Output::Declare(text) => self.declare(text).await,
                Output::Withdraw(text) => {
                    if let Some(token) = self.tokens.remove(&text)
                        && let Err(error) = token.withdraw().await
                    {
                        tracing::debug!("{error:#}");
                    }
                }
                Output::Refused(_) | Output::Shift(_) => {}
            }
        }
    }

    async fn declare(&mut self, text: String) {
        let declared = match ForeignKey::new(text.as_str()) {
            Ok(key) => self.ros.declare_token(&Key::Foreign(key)).await,
            Err(error) => Err(error.into()),
        };
        match declared {
            Ok(token) => {
                self.tokens.insert(text, token);
            }
            Err(error) => tracing::warn!("{error:#}"),
        }
    }
}
