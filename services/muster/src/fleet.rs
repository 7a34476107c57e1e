//! A simulated fleet on a real bus: what robots would put there, at the rates of robots.

use std::time::Duration;

use muster_model::observation::{CheckedReport, Provenance, Report};
use muster_runtime::bus::{Bus, Token};
use muster_runtime::clock::Clock;
use muster_runtime::outbox::Outbox;
use muster_runtime::stop::Stop;
use muster_scenario::Fleet;
use muster_wire::{Format, Key, Message};
use tokio::time::{Instant, MissedTickBehavior, interval};

/// How often links are reported, in seconds: radios change more slowly than positions.
const LINKS_EVERY_S: f64 = 0.5;

/// How often ranks are repeated, in seconds, so that whoever missed one soon knows it.
const RANKS_EVERY_S: f64 = 1.0;

/// How a simulated fleet speaks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Speech {
    /// Poses per second of each robot.
    pub(crate) rate_hz: f64,
    /// JSON, or binary.
    pub(crate) format: Format,
}

/// Some robots of a fleet on a bus.
pub(crate) struct FleetOnBus {
    bus: Bus,
    fleet: Fleet,
    /// Which robots of the fleet speak here.
    speakers: Vec<usize>,
    speech: Speech,
    clock: Clock,
    boot: String,
    sequence: u64,
    tokens: Vec<Token>,
}

impl FleetOnBus {
    /// Declares the liveliness tokens of the robots that speak here.
    ///
    /// # Errors
    /// If the bus refuses them.
    pub(crate) async fn join(
        bus: Bus,
        fleet: Fleet,
        speakers: Vec<usize>,
        speech: Speech,
    ) -> anyhow::Result<Self> {
        let clock = Clock::start();
        let mut tokens = Vec::with_capacity(speakers.len());
        for robot in &speakers {
            tokens.push(bus.declare_token(&Key::RobotToken(fleet.robots()[*robot].clone())).await?);
        }
        let boot = format!("{:x}", clock.now().0);
        Ok(Self { bus, fleet, speakers, speech, clock, boot, sequence: 0, tokens })
    }

    /// Speaks until it is time to stop, or for some seconds; then withdraws the tokens. The story of
    /// the scenario begins at the moment `from`, in its seconds.
    ///
    /// # Errors
    /// If a thread cannot be started or a message not be written.
    pub(crate) async fn run(
        mut self,
        from: f64,
        seconds: Option<f64>,
        mut stop: Stop,
    ) -> anyhow::Result<()> {
        let outbox = Outbox::default();
        let bus = self.bus.clone();
        outbox.start(move |message| {
            if let Err(error) = bus.put(message) {
                tracing::debug!("{error:#}");
            }
        })?;
        let mut ticks = interval(Duration::from_secs_f64(1.0 / self.speech.rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let start = Instant::now();
        let (mut links_at, mut ranks_at) = (from, from);
        loop {
            tokio::select! {
                _ = ticks.tick() => {}
                () = stop.stopped() => break,
            }
            let elapsed = start.elapsed().as_secs_f64();
            if seconds.is_some_and(|seconds| elapsed > seconds) {
                break;
            }
            let t = from + elapsed;
            self.sequence += 1;
            let poses = self.fleet.poses(t);
            self.say(&outbox, &poses)?;
            if t >= links_at {
                links_at = t + LINKS_EVERY_S;
                let links = self.fleet.links(t);
                self.say(&outbox, &links)?;
            }
            if t >= ranks_at {
                ranks_at = t + RANKS_EVERY_S;
                let ranks = self.fleet.ranks(t);
                self.say(&outbox, &ranks)?;
            }
        }
        for token in self.tokens {
            token.withdraw().await?;
        }
        let _ = tokio::task::spawn_blocking(move || outbox.close()).await;
        Ok(())
    }

    fn say<T: Clone + Into<Report>>(&self, outbox: &Outbox, all: &[T]) -> anyhow::Result<()> {
        let now = self.clock.now();
        let provenance = Provenance {
            stamp: Some(now.as_seconds()),
            boot: Some(self.boot.clone()),
            seq: Some(self.sequence),
        };
        for robot in &self.speakers {
            let id = self.fleet.robots()[*robot].clone();
            let report = all[*robot].clone().into().with_provenance(provenance.clone());
            let message = Message::Report(CheckedReport::new(id, report)?);
            outbox.push(message.encode(message.keys().0, self.speech.format, now)?);
        }
        Ok(())
    }
}
