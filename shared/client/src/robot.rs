//! One robot of a fleet.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use muster_bus::{Subscription, Token};
use muster_model::id::{Modality, RobotId};
use muster_model::observation::{Link, Links, Pose, Rank, Relation, Report, Stream};
use muster_model::teams::RobotTeam;
use muster_wire::{Key, KeySpace, Message, Packet, Pattern};
use tokio::sync::watch;
use tokio::task::AbortHandle;
use tokio::time::{MissedTickBehavior, interval};

use crate::client::Client;
use crate::config::Config;
use crate::error::Error;
use crate::outgoing::Outgoing;
use crate::voice::Voice;
use crate::watch::Watch;

/// How long a token of the same robot may outlive its process: a robot that restarts must not be
/// refused for the sake of itself. A dead host is noticed within the lease of 2 s; this is twice that.
const TOKEN_OUTLIVES: Duration = Duration::from_secs(4);

/// How often such a token is looked for again.
const TOKEN_AGAIN: Duration = Duration::from_millis(200);

/// How long the answer to such a look is waited for.
const TOKEN_WITHIN: Duration = Duration::from_secs(1);

/// How often it is looked whether something is to be said again.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// When what holds is said again after the link is back, beside at once: the services may find the
/// router later than the robot does.
const AGAIN_AFTER_LINK: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(3)];

/// For how long another process that spoke for the robot counts as there.
const RIVAL_LASTS: Duration = Duration::from_secs(5);

/// How long a rival is not mentioned again in the log.
const RIVAL_SILENCE: Duration = Duration::from_secs(10);

/// One robot of a fleet. The fleet sees it until it leaves or is dropped.
///
/// Nothing that it says waits for the bus, nor for anything else: of each stream, the newest waits for
/// its turn. A message that is lost with the link is not sent later, but links, rank and relations
/// are said again once the link is back, and every [`Config::repeat_every`] in any case.
#[derive(Debug)]
pub struct Robot {
    client: Client,
    /// Whether the client was opened for this robot alone.
    alone: bool,
    id: RobotId,
    voice: Arc<Mutex<Voice>>,
    team: Watch<RobotTeam>,
    token: Option<Token>,
    rival: Arc<Mutex<Rival>>,
    repeating: AbortHandle,
    _rivals: Subscription,
    _name: Name,
}

/// Another process that speaks for the same robot.
#[derive(Debug, Default)]
struct Rival {
    heard: Option<Instant>,
    logged: Option<Instant>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No critical section can panic half-way, so that a poisoned lock still guards a whole state.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Robot {
    /// Opens a session and joins the fleet as a robot.
    ///
    /// # Errors
    /// As [`Client::open`] and [`Client::join`].
    pub async fn join(config: &Config, robot: &str) -> Result<Self, Error> {
        let robot = RobotId::new(robot).map_err(Error::id("robot"))?;
        let client = Client::open(config).await?;
        Self::begin(client, robot, true).await
    }

    pub(crate) async fn begin(client: Client, id: RobotId, alone: bool) -> Result<Self, Error> {
        let name = Name::take(client.clone(), id.clone())?;
        wait_until_free(&client, &id).await?;
        let config = client.config();
        let voice = Voice::new(id.clone(), config.format);
        let rival = Arc::<Mutex<Rival>>::default();
        let take = rivals(client.bus().space().clone(), voice.boot().to_owned(), &rival);
        let pattern = Pattern::One(Key::Stream(id.clone(), Stream::Pose));
        let rivals = client.bus().listen(&pattern, take).await.map_err(Error::bus)?;
        let team = client.team(&id).await?;
        let token = client.bus().declare_token(&Key::RobotToken(id.clone())).await;
        let token = Some(token.map_err(Error::bus)?);
        let voice = Arc::new(Mutex::new(voice));
        let repeating = repeat(
            Arc::clone(&voice),
            client.outgoing().clone(),
            client.link(),
            config.repeat_every,
        );
        let repeating = tokio::spawn(repeating).abort_handle();
        Ok(Self {
            client,
            alone,
            id,
            voice,
            team,
            token,
            rival,
            repeating,
            _rivals: rivals,
            _name: name,
        })
    }

    /// Its id.
    #[must_use]
    pub fn id(&self) -> &RobotId {
        &self.id
    }

    /// The session through which it speaks.
    #[must_use]
    pub fn client(&self) -> &Client {
        &self.client
    }

    /// Follows its team: what it was told last, and every change.
    #[must_use]
    pub fn team(&self) -> Watch<RobotTeam> {
        self.team.clone()
    }

    /// Puts where it is: `Pose::at(x, y)`, or with more fields
    /// `Pose { heading: Some(0.1), ..Pose::at(x, y) }`. Name of the run and number are set; so is the
    /// stamp, if it is left out.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong; then nothing is sent.
    pub fn put_pose(&self, pose: Pose) -> Result<(), Error> {
        self.put(Report::Pose(pose))
    }

    /// Puts whom it hears, and how well: 0 to 1, or dBm if `ingest` is set so. Who is left out is
    /// not heard any more.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong; then nothing is sent.
    pub fn put_links<'a>(
        &self,
        links: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> Result<(), Error> {
        let links = links.into_iter().map(|(peer, quality)| {
            let peer = RobotId::new(peer).map_err(Error::id("links.peer"))?;
            Ok(Link { peer, quality })
        });
        let links = links.collect::<Result<_, Error>>()?;
        self.put(Report::Links(Links { links, stamp: None, boot: None, seq: None }))
    }

    /// Puts whom it answers to; none at the top.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong; then nothing is sent.
    pub fn put_rank(&self, superior: Option<&str>) -> Result<(), Error> {
        let superior = superior.map(RobotId::new).transpose().map_err(Error::id("superior"))?;
        self.put(Report::Rank(Rank::under(superior)))
    }

    /// Puts its edges of a modality that the settings of `ingest` declare, each with its weight.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong; then nothing is sent.
    pub fn put_relation<'a>(
        &self,
        modality: &str,
        edges: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> Result<(), Error> {
        let modality = Modality::new(modality).map_err(Error::id("modality"))?;
        let edges = edges.into_iter().map(|(to, weight)| {
            let to = RobotId::new(to).map_err(Error::id("edges"))?;
            Ok((self.id.clone(), to, weight))
        });
        let edges = edges.collect::<Result<_, Error>>()?;
        let relation = Relation { edges, stamp: None, boot: None, seq: None };
        self.put(Report::Relation(modality, relation))
    }

    /// Puts any report, with all its fields. The name of the run and the number are set.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong, and nothing is sent; [`Error::Closed`] if the
    /// client was closed.
    pub fn put(&self, report: Report) -> Result<(), Error> {
        let mut voice = lock(&self.voice);
        let message = voice.say(Instant::now(), report)?;
        // Under the lock of the voice, so that messages leave in the order of their numbers.
        let sent = self.client.outgoing().push(message);
        if sent { Ok(()) } else { Err(Error::Closed) }
    }

    /// Whether another process has spoken for this robot within the last 5 s. Both are heard then by
    /// turns, and refused by turns: one of them needs another id.
    #[must_use]
    pub fn is_contested(&self) -> bool {
        lock(&self.rival).heard.is_some_and(|heard| heard.elapsed() < RIVAL_LASTS)
    }

    /// Leaves the fleet on purpose: sends what waits, withdraws the token, and closes the session if
    /// it was opened for this robot.
    pub async fn leave(mut self) {
        self.client.flush().await;
        self.repeating.abort();
        self.team.end();
        if let Some(token) = self.token.take()
            && let Err(error) = token.withdraw().await
        {
            tracing::debug!("the token of {} is not withdrawn: {error:#}", self.id);
        }
        if self.alone {
            self.client.clone().close().await;
        }
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.repeating.abort();
        self.team.end();
    }
}

/// A robot's name within its session; given back as this is dropped.
#[derive(Debug)]
struct Name {
    client: Client,
    id: RobotId,
}

impl Name {
    fn take(client: Client, id: RobotId) -> Result<Self, Error> {
        let free = client.joined().insert(id.clone());
        if free { Ok(Self { client, id }) } else { Err(taken(&client, &id)) }
    }
}

impl Drop for Name {
    fn drop(&mut self) {
        self.client.joined().remove(&self.id);
    }
}

fn taken(client: &Client, id: &RobotId) -> Error {
    Error::Taken { robot: id.clone(), fleet: client.bus().space().fleet().clone() }
}

/// Waits until nobody holds the token of the robot; gives up once it cannot be that of a dead one.
async fn wait_until_free(client: &Client, id: &RobotId) -> Result<(), Error> {
    let until = Instant::now() + TOKEN_OUTLIVES;
    let pattern = Pattern::One(Key::RobotToken(id.clone()));
    loop {
        let tokens = client.bus().tokens(&pattern, TOKEN_WITHIN).await.map_err(Error::bus)?;
        if tokens.is_empty() {
            return Ok(());
        }
        if Instant::now() >= until {
            return Err(taken(client, id));
        }
        tokio::time::sleep(TOKEN_AGAIN).await;
    }
}

/// Listens to poses of the robot that others put.
fn rivals(
    space: KeySpace,
    boot: String,
    rival: &Arc<Mutex<Rival>>,
) -> impl Fn(Packet) + Send + Sync + 'static {
    let rival = Arc::clone(rival);
    move |packet| {
        let Ok(Message::Report(report)) = Message::decode(&space, &packet) else { return };
        if report.report().provenance().boot.as_ref() == Some(&boot) {
            return;
        }
        let (mut rival, now) = (lock(&rival), Instant::now());
        rival.heard = Some(now);
        if rival.logged.is_none_or(|logged| now.duration_since(logged) >= RIVAL_SILENCE) {
            rival.logged = Some(now);
            drop(rival);
            tracing::warn!(
                "another process speaks for {}: give one of them another id",
                report.robot()
            );
        }
    }
}

/// Says again what holds: soon after the link is back, and slowly in any case.
async fn repeat(
    voice: Arc<Mutex<Voice>>,
    outgoing: Outgoing,
    mut link: watch::Receiver<bool>,
    every: Duration,
) {
    let mut looks = interval(LOOK_EVERY);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut soon: VecDeque<Instant> = VecDeque::new();
    loop {
        tokio::select! {
            _ = looks.tick() => {}
            changed = link.changed() => {
                if changed.is_err() {
                    return;
                }
                soon.clear();
                if *link.borrow_and_update() {
                    let now = Instant::now();
                    soon.push_back(now);
                    soon.extend(AGAIN_AFTER_LINK.map(|after| now + after));
                }
            }
        }
        if !*link.borrow() {
            continue;
        }
        let now = Instant::now();
        let hurried = soon.front().is_some_and(|at| now >= *at);
        while soon.front().is_some_and(|at| now >= *at) {
            soon.pop_front();
        }
        let before = if hurried { Some(now) } else { now.checked_sub(every) };
        let Some(before) = before else { continue };
        let mut voice = lock(&voice);
        for message in voice.repeat(now, before) {
            outgoing.push(message);
        }
    }
}
