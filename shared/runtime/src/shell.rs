//! Runs the host of one service: a loop that hands it one input after another and carries out its
//! commands.
//!
//! The loop never waits for the bus, a disk or a computation. Packets wait in the [`SharedInbox`], what
//! is published in the [`SendQueue`]; jobs run on blocking threads, questions to the bus in tasks,
//! replies and stored state on a [`ReplyWorker`], and what they lead to comes back as inputs. A panic in
//! a job is an input, too; one in the core ends the process. Records, where a service keeps some, are written by
//! a thread of their own.

use std::collections::{BTreeMap, HashMap};
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use muster_model::id::InstanceId;
use muster_model::role::ReplicaState;
use muster_service::inbox::InboxLimits;
use muster_service::recording::{Head, commands_frame, input_frame};
use muster_service::replay::panic_text;
use muster_service::{
    Arrival, Command, Core, GetId, Host, IncomingGet, Input, Start, Stopwatch, Wiring,
};
use muster_wire::message::quoted;
use muster_wire::{Key, KeySpace, Packet, Request};
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, MissedTickBehavior, sleep_until};
use tracing::Instrument as _;

use crate::bus::{
    Answer, Ask, Bus, DeclaredKeys, IncomingQuery, Query, RobotTokens, Target, Urgency,
};
use crate::clock::Clock;
use crate::declarations::{TokenChange, declare, declare_tokens};
use crate::inbox::SharedInbox;
use crate::kept::KeptStore;
use crate::notify;
use crate::observe::{Observer, Queues};
use crate::pool::{self, Pool};
use crate::recording::{RecordFile, Recording, host_facts};
use crate::records::{RecordOptions, RecordWriter};
use crate::reply_worker::{Files, ReplyWorker};
use crate::send_queue::SendQueue;
use crate::stop::Stop;
use crate::store::Store;

/// Most gets that wait for the loop.
const MAX_WAITING_GETS: usize = 256;

/// How long the last tasks of the reply worker are waited for at the end.
const REPLIES_TIMEOUT: Duration = Duration::from_secs(1);

/// Most inputs that jobs, questions and stored state leave waiting: one job, and the questions of a
/// few fetches.
const MAX_WAITING_INPUTS: usize = 64;

/// Most packets that are handled before deadlines and gets are looked at again.
const MAX_PACKETS_PER_ROUND: usize = 256;

/// How long packets gather after some were handled: to wake the loop for each pose of 5,000 robots costs more than to
/// handle it. A packet that comes alone does not wait.
const GATHERING_TIME: Duration = Duration::from_millis(1);

/// How often the loop shows that it runs, whatever else happens.
const SHOW_INTERVAL: Duration = Duration::from_millis(500);

/// What a service is run with.
#[derive(Debug)]
pub struct ServiceOptions<S> {
    /// This process.
    pub instance: InstanceId,
    /// The settings by defaults, file, environment and flags.
    pub settings: S,
    /// Where it keeps settings over a restart.
    pub store: Store,
    /// Where its core keeps what is its own over a restart.
    pub kept: KeptStore,
    /// How it keeps records; none if it keeps none.
    pub records: Option<RecordOptions>,
    /// Sees what passes, for metrics and health.
    pub observer: Observer,
    /// Where its life is recorded, if it is.
    pub record: Option<RecordFile>,
    /// What it shares with services of other fleets in the same process, if there are any.
    pub pool: Option<Pool>,
}

/// Something that was started has ended.
struct Ended<Done> {
    input: Input,
    /// The result of a job that has ended well.
    done: Option<Done>,
}

/// Runs a service on a bus until it is time to stop.
///
/// # Errors
/// If the bus refuses a declaration, or a thread cannot be started.
pub async fn run<C: Core>(
    bus: Bus,
    options: ServiceOptions<C::Settings>,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let mut watchdog = notify::watch();
    let clock = Clock::start();
    let pool = options.pool;
    let limits = pool.as_ref().map_or_else(InboxLimits::default, |_| pool::INBOX_LIMITS);
    let inbox = Arc::new(SharedInbox::bounded(limits));
    let send_queue = SendQueue::default();
    let (gets, mut incoming) = mpsc::channel(MAX_WAITING_GETS);
    let (ended_sender, mut ended) = mpsc::channel(MAX_WAITING_INPUTS);

    let mut state_loss = None;
    let start = Start {
        fleet: bus.space().fleet().clone(),
        instance: options.instance.clone(),
        now: clock.now(),
        settings: options.settings,
        stored: options.store.load_noting(&mut state_loss),
    };
    let has_run = start.stored.term > 0;
    let restored = options.kept.load(has_run);
    let recording = match options.record {
        Some(file) => Some(Recording::start(file, &Head::new::<C>(&start, host_facts())?)?),
        None => None,
    };
    let host = Host::<C>::new(start);
    start_sending::<C>(&bus, &send_queue, pool.as_ref())?;
    let worker_ended = ended_sender.clone();
    let files = Files { store: options.store, kept: options.kept.clone() };
    let (replies, replies_done) = ReplyWorker::start(files, pool.as_ref(), move |input| {
        // Sending fails only after the loop has ended.
        let _ = worker_ended.blocking_send(Ended { input, done: None });
    })?;
    let records_ended = ended_sender.clone();
    let start_records = |records| {
        RecordWriter::start(records, move |input| {
            let _ = records_ended.blocking_send(Ended { input, done: None });
        })
    };
    let (records, records_done) = options.records.map(start_records).transpose()?.unzip();
    let observer = options.observer;
    let leads = watchdog.during(declare::<C>(&bus, &inbox, gets, &observer)).await?;
    let token = bus.declare_token(&Key::ServiceToken(C::SERVICE, options.instance)).await?;
    let mut link = bus.link();

    // Thousands of services have one state of the process in common, which is not theirs to note.
    let is_alone = pool.is_none();
    let mut shell = Shell {
        host,
        bus: bus.clone(),
        clock,
        inbox: Arc::clone(&inbox),
        send_queue: send_queue.clone(),
        replies,
        records,
        ended: ended_sender,
        leads,
        tokens: declare_tokens(bus.clone()),
        gets: HashMap::new(),
        next_get: 0,
        observer: observer.clone(),
        kept: options.kept,
        recording,
        pool,
    };
    let serving = format!("{} serves fleet {}", C::SERVICE, bus.space().fleet());
    tracing::info!("{serving}");
    if is_alone {
        notify::ready(&serving);
    }
    let linked = *link.borrow_and_update();
    observer.link(linked);
    if let Some(content) = restored {
        shell.handle(Input::Restored(content));
    }
    shell.handle(Input::Started { linked });
    if let Some(reason) = state_loss {
        shell.handle(Input::StateLost { reason });
    }
    let interval = shell.pool.as_ref().map_or(SHOW_INTERVAL, |_| pool::SHOW_INTERVAL);
    let mut gathered_at = None;
    let mut show = tokio::time::interval(interval);
    show.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        let deadline = shell.host.deadline();
        let due = async {
            match deadline {
                // An absolute moment: other inputs must not put it off.
                Some(tick) => sleep_until(shell.clock.instant(tick)).await,
                None => std::future::pending().await,
            }
        };
        let gathered = async {
            if let Some(at) = gathered_at {
                sleep_until(at).await;
            }
            inbox.arrived().await;
        };
        tokio::select! {
            () = stop.stopped() => break,
            () = watchdog.due() => watchdog.report(),
            () = due => shell.handle(Input::Timer),
            _ = show.tick() => shell.show(),
            () = gathered => gathered_at = shell.handle_packets(),
            // Checked again with every round of the loop, the next show at the latest.
            Some(query) = incoming.recv(), if shell.replies.has_room() => shell.handle_get(query),
            Some(ended) = ended.recv() => shell.handle_ended(ended),
            Ok(()) = link.changed() => {
                let up = *link.borrow_and_update();
                tracing::warn!("the link to the router is {}", if up { "back" } else { "lost" });
                observer.link(up);
                if is_alone {
                    notify::status(if up { &serving } else { "the link to the router is lost" });
                }
                shell.handle(if up { Input::LinkRestored } else { Input::LinkLost });
            }
        }
    }
    observer.ended();
    tracing::info!("{} ends", C::SERVICE);
    if is_alone {
        notify::stopping().await;
    }
    let recording = shell.recording.take();
    drop(shell);
    // What waits for a place must not keep the worker from its end.
    drop(ended);
    // What is stored last must reach the disk; everything else may be lost.
    let written = async {
        let _ = replies_done.await;
        if let Some(records_done) = records_done {
            let _ = records_done.await;
        }
    };
    let _ = tokio::time::timeout(REPLIES_TIMEOUT, written).await;
    let _ = token.withdraw().await;
    let _ = tokio::task::spawn_blocking(move || {
        send_queue.close();
        drop(recording);
    })
    .await;
    bus.close().await;
    tracing::info!("{} has stopped", C::SERVICE);
    Ok(())
}

fn start_sending<C: Core>(
    bus: &Bus,
    send_queue: &SendQueue,
    pool: Option<&Pool>,
) -> anyhow::Result<()> {
    let tokens = RobotTokens::default();
    // A bus that many fleets share declares no keys of robots.
    if pool.is_none() && Wiring::of::<C>().puts_robot_teams() {
        let (bus, tokens) = (bus.clone(), tokens.clone());
        let following = async move {
            if let Err(error) = tokens.follow(&bus).await {
                tracing::warn!("{error:#}; teams are put by undeclared keys");
            }
        };
        tokio::spawn(following.in_current_span());
    }
    let (mut sending, span) =
        (DeclaredKeys::with_tokens(bus.clone(), tokens), tracing::Span::current());
    let send = move |packet, urgency: Urgency| {
        let _service = span.enter();
        if let Err(error) = sending.put_packet(packet, urgency) {
            tracing::debug!("{error:#}");
        }
    };
    match pool {
        Some(pool) => send_queue.share(pool, send),
        None => drop(send_queue.start(send)?),
    }
    Ok(())
}

struct Shell<C: Core> {
    host: Host<C>,
    bus: Bus,
    clock: Clock,
    inbox: Arc<SharedInbox>,
    send_queue: SendQueue,
    replies: ReplyWorker,
    records: Option<RecordWriter>,
    ended: mpsc::Sender<Ended<C::Done>>,
    /// For whether this instance leads.
    leads: watch::Sender<bool>,
    tokens: mpsc::Sender<TokenChange>,
    gets: HashMap<GetId, Query>,
    next_get: u64,
    kept: KeptStore,
    recording: Option<Recording>,
    observer: Observer,
    pool: Option<Pool>,
}

impl<C: Core> Shell<C> {
    /// Hands an input to the host and carries out what follows.
    fn handle(&mut self, input: Input) {
        let (kind, begun) = (input.kind(), Instant::now());
        let now = self.clock.now();
        if let Some(recording) = &mut self.recording {
            recording.add(|| input_frame(now, &input));
        }
        let commands = self.host.handle(now, input);
        if let Some(recording) = &mut self.recording {
            recording.add(|| commands_frame(&commands));
        }
        for command in commands {
            self.carry_out(command);
        }
        self.observer.handled(kind, begun.elapsed());
    }

    fn carry_out(&mut self, command: Command) {
        match command {
            Command::Publish(publication) => {
                if let Some(message) = &publication.message {
                    let bytes = publication.packets.iter().map(Packet::size).sum();
                    self.observer.published(message, bytes, self.clock.now());
                }
                for packet in &publication.packets {
                    self.bus.hand_over(packet);
                }
                if !publication.is_lease_renewal || self.bus.has_rivals() {
                    self.send_queue.push(publication);
                }
            }
            Command::Reply(reply) => {
                if let Some(query) = self.gets.remove(&reply.get) {
                    self.observer.answered();
                    self.replies.reply(query, reply.answer);
                }
            }
            Command::RunJob => self.run_job(),
            Command::Ask(ask) => self.ask(ask),
            Command::Store(stored) => self.replies.store(stored),
            Command::Keep(content) => self.replies.keep(content),
            Command::KeptIsUnusable(problem) => self.kept.put_aside(&problem),
            Command::ReplicaState(state) => self.show_replica_state(state),
            Command::DeclareToken(key) => self.change_token(TokenChange::Declare(key)),
            Command::WithdrawToken(key) => self.change_token(TokenChange::Withdraw(key)),
            Command::Append(entry) => match &self.records {
                Some(records) => records.append(entry),
                None => tracing::error!("a record is lost: {} keeps none", C::SERVICE),
            },
            Command::LookUp { lookup, query } => {
                let records = self.records.as_ref();
                if !records.is_some_and(|records| records.look_up(lookup, query)) {
                    let page = Err("too many lookups wait; ask again later".to_owned());
                    self.send_later(Input::Found { lookup, page });
                }
            }
            Command::Unencodable(problem) => tracing::error!("{problem}"),
            Command::Retain(retention) => {
                if let Some(records) = &self.records {
                    records.retain(retention);
                }
            }
        }
    }

    /// Brings an input to the loop after the current one.
    fn send_later(&self, input: Input) {
        let ended = self.ended.clone();
        tokio::spawn(async move { ended.send(Ended { input, done: None }).await });
    }

    fn change_token(&self, change: TokenChange) {
        if self.tokens.try_send(change).is_err() {
            tracing::error!("a token is not declared or withdrawn: too many wait");
        }
    }

    fn show_replica_state(&self, state: ReplicaState) {
        let service = C::SERVICE;
        match state {
            ReplicaState::Starting => tracing::info!("{service} asks the bus what there is"),
            ReplicaState::Standby => {
                tracing::info!("{service} is a standby: another instance leads")
            }
            ReplicaState::Suspect => {
                tracing::info!("{service} is suspect: silent until it knows that it still leads");
            }
            ReplicaState::Leading => tracing::info!("{service} leads"),
        }
        let leads = matches!(state, ReplicaState::Leading | ReplicaState::Suspect);
        self.leads.send_if_modified(|before| std::mem::replace(before, leads) != leads);
    }

    /// Shows that the loop runs, and how the service is.
    fn show(&self) {
        let status = self.host.status(self.clock.now());
        let inbox = self.inbox.counts();
        let queues = Queues {
            inbox,
            send_queue: self.send_queue.backlog(),
            sending: self.send_queue.counts(),
        };
        self.observer.turned(&status, &queues, self.host.failing_jobs());
    }

    /// Handles packets that wait. Returns until when others gather; none if some still wait.
    fn handle_packets(&mut self) -> Option<Instant> {
        for _ in 0..MAX_PACKETS_PER_ROUND {
            let Some(mut arrival) = self.inbox.pop() else {
                return Some(Instant::now() + GATHERING_TIME);
            };
            arrival.decode(self.host.space());
            if let Some(message) = arrival.message() {
                self.observer.received(message);
            }
            self.handle(Input::Arrived(arrival));
        }
        self.inbox.rewake();
        None
    }

    fn handle_get(&mut self, incoming: IncomingQuery) {
        let IncomingQuery { query, narrowed, payload } = incoming;
        let get = GetId(self.next_get);
        self.next_get += 1;
        let selector = query.selector().to_owned();
        let parameters = query.parameters().to_owned();
        if asks_for_status::<C>(self.host.space(), &selector) {
            self.handle(Input::ProcessCounters(self.process_counters()));
        }
        self.gets.insert(get, query);
        let get = IncomingGet { get, selector, narrowed, parameters, payload };
        self.handle(Input::Get(get));
    }

    fn handle_ended(&mut self, ended: Ended<C::Done>) {
        if let Some(done) = ended.done {
            self.host.finish_job(done);
        }
        self.handle(ended.input);
    }

    fn process_counters(&self) -> BTreeMap<String, u64> {
        let inbox = self.inbox.counts();
        let sending = self.send_queue.counts();
        let counters = [
            ("inbox_superseded", inbox.superseded),
            ("inbox_dropped", inbox.dropped),
            ("outbox_sent", sending.sent),
            ("outbox_dropped", sending.dropped),
        ];
        counters.map(|(name, count)| (name.to_owned(), count)).into()
    }

    fn run_job(&mut self) {
        let Some(job) = self.host.take_job() else { return };
        let (ended, observer) = (self.ended.clone(), self.observer.clone());
        observer.job_started();
        let span = tracing::Span::current();
        let compute = move || {
            let _service = span.enter();
            let start = Instant::now();
            let micros = move || u64::try_from(start.elapsed().as_micros()).unwrap_or(u64::MAX);
            let mut stopwatch = Stopwatch::reading(micros);
            let run = AssertUnwindSafe(|| C::run(job, &mut stopwatch));
            let (done, panic) = match std::panic::catch_unwind(run) {
                Ok(done) => (Some(done), None),
                Err(panic) => (None, Some(panic_text(panic.as_ref()))),
            };
            observer.job_ended(start.elapsed());
            let input = Input::JobEnded { laps: stopwatch.laps().to_vec(), panic };
            // Sending fails only after the loop has ended.
            let _ = ended.blocking_send(Ended { input, done });
        };
        match &self.pool {
            None => drop(tokio::task::spawn_blocking(compute)),
            Some(pool) => {
                let turn = pool.compute();
                tokio::spawn(async move {
                    let _leave = turn.await;
                    let _ = tokio::task::spawn_blocking(compute).await;
                });
            }
        }
    }

    fn ask(&self, ask: muster_service::Ask) {
        let (bus, ended) = (self.bus.clone(), self.ended.clone());
        let asking = async move {
            let answers = answers(&bus, &ask).await;
            let input = Input::Answered { ask: ask.ask, answers };
            let _ = ended.send(Ended { input, done: None }).await;
        };
        tokio::spawn(asking.in_current_span());
    }
}

/// Whether a get may be one of the status, which holds the counters of the process.
fn asks_for_status<C: Core>(space: &KeySpace, selector: &str) -> bool {
    let request = Request::new(selector, "", None);
    request.is_ok_and(|request| request.selects(space, &Key::Status(C::SERVICE)))
}

/// What the bus answers in time, decoded on the way.
async fn answers(bus: &Bus, ask: &muster_service::Ask) -> Vec<Arrival> {
    let question = Ask {
        parameters: "format=bincode",
        payload: None,
        within: ask.within,
        further_within: ask.further_within,
        target: Target::All,
    };
    let answers = match bus.get(&ask.pattern, question).await {
        Ok(answers) => answers,
        Err(error) => {
            tracing::debug!("{error:#}");
            return Vec::new();
        }
    };
    let arrival = |answer| match answer {
        Answer::Packet(packet) => Some(Arrival::decoded(bus.space(), packet)),
        Answer::Error(error) => {
            tracing::debug!("a question is answered with: {}", quoted(&error));
            None
        }
    };
    answers.into_iter().filter_map(arrival).collect()
}
