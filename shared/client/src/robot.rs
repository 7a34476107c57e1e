//! One robot of a fleet.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use muster_bus::config::ROBOT_LEASE;
use muster_bus::{Subscription, Token};
use muster_model::id::{Modality, RobotId};
use muster_model::observation::{
    CheckedReport, Link, Links, Pose, Provenance, Rank, Relation, Report, Stream,
};
use muster_model::replay::{REPLAY_PREFIX, is_replay};
use muster_model::teams::RobotTeam;
use muster_wire::{Key, KeySpace, Message, Packet, Pattern};
use tokio::sync::watch;
use tokio::task::AbortHandle;
use tokio::time::{MissedTickBehavior, interval};

use crate::client::Client;
use crate::config::Config;
use crate::error::Error;
use crate::feed::Refusals;
use crate::reporter::{Reporter, encode, wall_clock};
use crate::send_queue::SendQueue;
use crate::watch::Watch;

/// How long the token of a robot may outlive its process: a robot that restarts must not be refused
/// because of its own last run. A dead host is noticed within its lease; this is a little longer.
const TOKEN_LIFETIME: Duration = ROBOT_LEASE.saturating_add(Duration::from_secs(1));

/// How often such a token is looked for again.
const TOKEN_POLL_INTERVAL: Duration = Duration::from_millis(200);

/// How long the reply to such a look is waited for.
const TOKEN_TIMEOUT: Duration = Duration::from_secs(1);

/// How often it is checked whether a report is to be republished.
const REPUBLISH_POLL_INTERVAL: Duration = Duration::from_secs(1);

/// When valid reports are republished after the link is restored, in addition to at once: the services
/// may find the router later than the robot does.
const REPUBLISH_AFTER_LINK: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(3)];

/// How long after its last pose another process with the same id counts as present.
const DUPLICATE_LIFETIME: Duration = Duration::from_secs(5);

/// How long a duplicate is not logged again.
const DUPLICATE_LOG_INTERVAL: Duration = Duration::from_secs(10);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No critical section can panic half-way: the state behind a poisoned lock is whole.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The reporting part of a robot: its liveliness token and its streams. The fleet sees the robot until
/// this leaves or is dropped.
///
/// Nothing that it reports waits for the bus: of each stream, the newest message waits to be sent.
#[derive(Debug)]
pub struct RobotPublisher {
    reporter: Arc<Mutex<Reporter>>,
    queue: SendQueue,
    token: Token,
}

impl RobotPublisher {
    pub(crate) async fn join(client: Client, id: RobotId) -> Result<Self, Error> {
        let reporter = Reporter::new(id, client.config().format);
        Self::declare(&client, reporter).await
    }

    async fn replay(client: Client, id: RobotId) -> Result<Self, Error> {
        let reporter = Reporter::replay(id, client.config().format);
        Self::declare(&client, reporter).await
    }

    async fn declare(client: &Client, reporter: Reporter) -> Result<Self, Error> {
        let key = Key::RobotToken(reporter.robot().clone());
        let token = client.bus().declare_token(&key).await.map_err(Error::bus)?;
        let reporter = Arc::new(Mutex::new(reporter));
        Ok(Self { reporter, queue: client.queue().clone(), token })
    }

    /// Puts a report. Boot id and sequence number are set, and the stamp if it has none.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong, and nothing is sent; [`Error::Closed`] if the
    /// client was closed.
    pub fn put(&self, report: Report) -> Result<(), Error> {
        let mut reporter = lock(&self.reporter);
        let message = reporter.publish(Instant::now(), report)?;
        // Under the lock, so that messages leave in the order of their numbers.
        self.queue.push(message).map_err(|_| Error::Closed)
    }

    /// The boot id of its reports.
    #[must_use]
    pub fn boot(&self) -> String {
        lock(&self.reporter).boot().to_owned()
    }

    /// Leaves the fleet on purpose. What is queued is sent all the same.
    pub async fn leave(self) {
        if let Err(error) = self.token.withdraw().await {
            tracing::debug!("a token is not withdrawn: {error:#}");
        }
    }
}

impl Client {
    /// Joins the fleet as a robot. Several robots may share a session.
    ///
    /// # Errors
    /// [`Error::Input`] if the id is invalid, [`Error::Taken`] if another process has joined as the
    /// robot and stays for longer than it takes to notice a dead one, [`Error::Bus`] if the bus fails.
    pub async fn join(&self, robot: &str) -> Result<Robot, Error> {
        let robot = RobotId::new(robot).map_err(Error::id("robot"))?;
        Robot::begin(self.clone(), robot, false).await
    }

    /// Puts what a robot reports that speaks another protocol, for a program that bridges it. Boot id and sequence
    /// number are those of the robot's own program, so that several bridges may relay the same; the robot has no token, so
    /// that its presence follows from what is put.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong, also if the report has no boot id or sequence number, and nothing
    /// is sent; [`Error::Closed`] if the client was closed.
    pub fn relay(&self, robot: RobotId, report: Report) -> Result<(), Error> {
        let Provenance { boot, seq, .. } = report.provenance();
        if boot.is_none() || seq.is_none() {
            let field = if boot.is_none() { "boot" } else { "seq" };
            return Err(Error::input(
                field,
                "a report that is relayed has that of its robot".to_owned(),
            ));
        }
        let report = CheckedReport::new(robot, report)?;
        let message = encode(report, self.config().format, wall_clock())?;
        self.queue().push(message).map_err(|_| Error::Closed)
    }

    /// Joins the fleet as a robot that only reports: it has no team, republishes nothing, and does not
    /// look for another process with its id. For simulations of many robots in one process.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn join_as_publisher(&self, robot: RobotId) -> Result<RobotPublisher, Error> {
        RobotPublisher::join(self.clone(), robot).await
    }

    /// The same for a robot of a recording that is played: every report says so in its boot id, which begins with
    /// [`REPLAY_PREFIX`].
    ///
    /// # Errors
    /// [`Error::Input`] if the fleet is none for recordings: its name must begin with [`REPLAY_PREFIX`]. [`Error::Bus`]
    /// if the bus fails.
    pub async fn join_as_replay(&self, robot: RobotId) -> Result<RobotPublisher, Error> {
        let fleet = self.config().fleet()?;
        if !is_replay(&fleet) {
            let problem =
                format!("{fleet} is not for recordings; its name must begin with {REPLAY_PREFIX}");
            return Err(Error::input("fleet", problem));
        }
        RobotPublisher::replay(self.clone(), robot).await
    }
}

/// One robot of a fleet. The fleet sees it until it leaves or is dropped.
///
/// Nothing that it puts waits for the bus: of each stream, the newest message waits to be sent. A
/// message that is lost with the link is not sent later, but links, rank and relations are republished
/// once the link is restored, and every [`Config::republish_every`] in any case.
#[derive(Debug)]
pub struct Robot {
    client: Client,
    /// Whether the client was opened for this robot alone.
    alone: bool,
    id: RobotId,
    /// None once the robot has left.
    publisher: Option<RobotPublisher>,
    team: Watch<RobotTeam>,
    refusals: Refusals,
    duplicate: Arc<Mutex<Duplicate>>,
    republishing: AbortHandle,
    _duplicates: Subscription,
    _name: Name,
}

/// Another process with the same id.
#[derive(Debug, Default)]
struct Duplicate {
    received: Option<Instant>,
    logged: Option<Instant>,
}

impl Robot {
    /// Opens a session and joins the fleet as a robot.
    ///
    /// # Errors
    /// As [`Client::open`] and [`Client::join`].
    pub async fn join(config: &Config, robot: &str) -> Result<Self, Error> {
        let robot = RobotId::new(robot).map_err(Error::id("robot"))?;
        let client = Client::open_with(config, ROBOT_LEASE).await?;
        Self::begin(client, robot, true).await
    }

    pub(crate) async fn begin(client: Client, id: RobotId, alone: bool) -> Result<Self, Error> {
        let name = Name::reserve(client.clone(), id.clone())?;
        wait_until_free(&client, &id).await?;
        let config = client.config();
        let reporter = Reporter::new(id.clone(), config.format);
        let duplicate = Arc::<Mutex<Duplicate>>::default();
        let space = client.bus().space().clone();
        let accept = notice_duplicates(space, reporter.boot().to_owned(), &duplicate);
        let pattern = Pattern::One(Key::Stream(id.clone(), Stream::Pose));
        let duplicates = client.bus().listen(&pattern, accept).await.map_err(Error::bus)?;
        let team = client.team(&id).await?;
        let refusals = client.refusals(&id).await?;
        let publisher = RobotPublisher::declare(&client, reporter).await?;
        let republishing = republish(
            Arc::clone(&publisher.reporter),
            client.queue().clone(),
            client.link(),
            config.republish_every,
        );
        let republishing = tokio::spawn(republishing).abort_handle();
        Ok(Self {
            client,
            alone,
            id,
            publisher: Some(publisher),
            team,
            refusals,
            duplicate,
            republishing,
            _duplicates: duplicates,
            _name: name,
        })
    }

    /// Its id.
    #[must_use]
    pub fn id(&self) -> &RobotId {
        &self.id
    }

    /// The session that it uses.
    #[must_use]
    pub fn client(&self) -> &Client {
        &self.client
    }

    /// Follows its team: the newest message, and every change.
    #[must_use]
    pub fn team(&self) -> Watch<RobotTeam> {
        self.team.clone()
    }

    /// What services refuse of its messages from now on, each with the reason and the remedy. Unlike an
    /// [`Error::Input`] these are known to `ingest` only: frames and modalities that its settings do not
    /// name, rates, or another program with the same id.
    #[must_use]
    pub fn refusals(&self) -> Refusals {
        self.refusals.resubscribe()
    }

    /// Puts where it is: `Pose::at(x, y)`, or with more fields
    /// `Pose { heading: Some(0.1), ..Pose::at(x, y) }`. Boot id and sequence number are set; so is the
    /// stamp, if it is left out.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong; then nothing is sent.
    pub fn put_pose(&self, pose: Pose) -> Result<(), Error> {
        self.put(Report::Pose(pose))
    }

    /// Puts the robots that it receives by radio, each with the quality of the link: 0 to 1, or dBm if
    /// `ingest` is set so. A robot that is left out is not received any more.
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

    /// Puts its superior; none at the top.
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

    /// Puts any report, with all its fields. Boot id and sequence number are set.
    ///
    /// # Errors
    /// [`Error::Input`] names the field that is wrong, and nothing is sent; [`Error::Closed`] if the
    /// client was closed.
    pub fn put(&self, report: Report) -> Result<(), Error> {
        self.publisher.as_ref().ok_or(Error::Closed)?.put(report)
    }

    /// Whether another process has put a pose of this robot within the last 5 s. Services then accept
    /// and refuse both alternately: one of them needs another id.
    #[must_use]
    pub fn is_contested(&self) -> bool {
        lock(&self.duplicate).received.is_some_and(|at| at.elapsed() < DUPLICATE_LIFETIME)
    }

    /// Leaves the fleet on purpose: sends what is queued, withdraws the token, and closes the session if
    /// it was opened for this robot.
    pub async fn leave(mut self) {
        self.client.flush().await;
        self.republishing.abort();
        self.team.end();
        if let Some(publisher) = self.publisher.take() {
            publisher.leave().await;
        }
        if self.alone {
            self.client.clone().close().await;
        }
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.republishing.abort();
        self.team.end();
    }
}

/// The reservation of a robot's id within its session; released when dropped.
#[derive(Debug)]
struct Name {
    client: Client,
    id: RobotId,
}

impl Name {
    fn reserve(client: Client, id: RobotId) -> Result<Self, Error> {
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

/// Waits until the token of the robot is gone; gives up once it cannot be that of a dead process.
async fn wait_until_free(client: &Client, id: &RobotId) -> Result<(), Error> {
    let until = Instant::now() + TOKEN_LIFETIME;
    let pattern = Pattern::One(Key::RobotToken(id.clone()));
    loop {
        let tokens = client.bus().tokens(&pattern, TOKEN_TIMEOUT).await.map_err(Error::bus)?;
        if tokens.is_empty() {
            return Ok(());
        }
        if Instant::now() >= until {
            return Err(taken(client, id));
        }
        tokio::time::sleep(TOKEN_POLL_INTERVAL).await;
    }
}

/// Notes poses of the robot that other processes put.
fn notice_duplicates(
    space: KeySpace,
    boot: String,
    duplicate: &Arc<Mutex<Duplicate>>,
) -> impl Fn(Packet) + Send + Sync + 'static {
    let duplicate = Arc::clone(duplicate);
    move |packet| {
        let Ok(Message::Report(report)) = Message::decode(&space, &packet) else { return };
        if report.report().provenance().boot.as_ref() == Some(&boot) {
            return;
        }
        let (mut duplicate, now) = (lock(&duplicate), Instant::now());
        duplicate.received = Some(now);
        let due = |logged| now.duration_since(logged) >= DUPLICATE_LOG_INTERVAL;
        if duplicate.logged.is_none_or(due) {
            duplicate.logged = Some(now);
            drop(duplicate);
            let robot = report.robot();
            tracing::warn!("another process puts poses of {robot}: give one of them another id");
        }
    }
}

/// Republishes valid reports: soon after the link is restored, and slowly in any case.
async fn republish(
    reporter: Arc<Mutex<Reporter>>,
    queue: SendQueue,
    mut link: watch::Receiver<bool>,
    every: Duration,
) {
    let mut polls = interval(REPUBLISH_POLL_INTERVAL);
    polls.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut soon: VecDeque<Instant> = VecDeque::new();
    loop {
        tokio::select! {
            _ = polls.tick() => {}
            changed = link.changed() => {
                if changed.is_err() {
                    return;
                }
                soon.clear();
                if *link.borrow_and_update() {
                    let now = Instant::now();
                    soon.push_back(now);
                    soon.extend(REPUBLISH_AFTER_LINK.map(|after| now + after));
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
        let mut reporter = lock(&reporter);
        for message in reporter.republish(now, before) {
            if queue.push(message).is_err() {
                return;
            }
        }
    }
}
