//! Runs one core: a loop that hands it every event in turn and carries out what it wants.
//!
//! The loop never waits for the bus, a disk or a computation. Packets wait in the [`Inbox`], what
//! is sent in the [`Outbox`]; jobs run on blocking threads, fetches in tasks, and both come back as
//! events. A panic in a job becomes [`Event::JobFailed`]; one in the core ends the process.

use std::collections::HashMap;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use muster_machine::recording::{Entry, Head};
use muster_machine::replay::panic_text;
use muster_machine::{
    Command, Core, Delivery, Driver, Event, QueryId, Start, Stopwatch, Wiring, is_patient,
};
use muster_model::id::InstanceId;
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_model::role::Standing;
use muster_model::time::Tick;
use muster_wire::json::Problem;
use muster_wire::message::JSON;
use muster_wire::{Key, KeySpace, Message, Outbound, Packet, Pattern, Rejection, Request, schema};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, sleep_until};
use tracing::Instrument as _;

use crate::bus::{Answer, Ask, Asked, Bus, Query};
use crate::clock::Clock;
use crate::errands::Errands;
use crate::inbox::Inbox;
use crate::notify;
use crate::observe::{Observer, Queues};
use crate::outbox::Outbox;
use crate::recording::{RecordFile, Recording, host_facts};
use crate::stop::Stop;
use crate::store::Store;

/// How long a fetch waits for answers: a service that hangs must not hold up one that starts.
const FETCH_WITHIN: Duration = Duration::from_secs(1);

/// How long a service that starts goes on asking where nobody answers: after a failure of the router
/// those who know its last output need a moment to find back, and who begins without them begins
/// from nothing. Twice the slowest reconnection, and some.
const START_PATIENCE: Duration = Duration::from_secs(2);

/// How soon it asks again.
const START_AGAIN: Duration = Duration::from_millis(200);

/// Most gets that wait for the core.
const MAX_QUERIES: usize = 256;

/// How long the last errands are waited for at the end.
const ERRANDS_WITHIN: Duration = Duration::from_secs(1);

/// Most ended jobs and fetches that wait for the core; one job and a few fetches are under way.
const MAX_ENDED: usize = 16;

/// Shortest time between two timeouts: a core that names a past moment again and again must not keep
/// the loop from everything else.
const BETWEEN_TIMEOUTS: Duration = Duration::from_millis(1);

/// How many packets are handled before deadlines and gets are looked after again.
const BATCH: usize = 256;

/// How often the loop shows that it turns, whatever else happens.
const BEAT: Duration = Duration::from_millis(500);

/// What a service is run with.
#[derive(Debug)]
pub struct ServiceOptions<S> {
    /// This process.
    pub instance: InstanceId,
    /// The settings by defaults, file, environment and flags.
    pub settings: S,
    /// Where it keeps settings over a restart.
    pub store: Store,
    /// Who is told what passes.
    pub observer: Observer,
    /// Where its life is recorded, if it is.
    pub record: Option<RecordFile>,
}

/// A job or fetch that has ended.
enum Ended<Done> {
    Job { event: Event<Done>, laps: Vec<u64> },
    Fetch { fetch: u32, messages: Vec<Message> },
}

/// Runs a core on a bus until it is time to stop.
///
/// # Errors
/// If the bus refuses a declaration, or a thread cannot be started.
pub async fn run<C: Core>(
    bus: Bus,
    options: ServiceOptions<C::Settings>,
    mut stop: Stop,
) -> anyhow::Result<()> {
    let mut watched = notify::watch();
    let clock = Clock::start();
    let inbox = Arc::new(Inbox::default());
    let outbox = Outbox::default();
    let (queries, mut asked) = mpsc::channel(MAX_QUERIES);
    let (ended_sender, mut ended) = mpsc::channel(MAX_ENDED);

    let start = Start {
        fleet: bus.space().fleet().clone(),
        instance: options.instance.clone(),
        now: clock.now(),
        settings: options.settings,
        stored: options.store.load(),
    };
    let recording = match options.record {
        Some(file) => {
            let head = Head::new::<C>(&start, host_facts()).map_err(anyhow::Error::msg)?;
            Some(Recording::start(file, &head)?)
        }
        None => None,
    };
    let driver = Driver::<C>::new(start);
    let (sending, span) = (bus.clone(), tracing::Span::current());
    outbox.start(move |message| {
        let _service = span.enter();
        if let Err(error) = sending.put(message) {
            tracing::debug!("{error:#}");
        }
    })?;
    let (errands, errands_done) = Errands::start(bus.clone(), options.store)?;
    let observer = options.observer;
    let served = watched.during(declare::<C>(&bus, &inbox, queries, &observer)).await?;
    let token = Key::ServiceToken(C::SERVICE, options.instance);
    let token = bus.declare_token(&token).await?;
    let mut link = bus.link();

    let mut shell = Shell {
        driver,
        bus: bus.clone(),
        clock,
        inbox: Arc::clone(&inbox),
        outbox: outbox.clone(),
        errands,
        ended: ended_sender,
        served,
        standing: Standing::Starting,
        queries: HashMap::new(),
        next_query: 0,
        observer: observer.clone(),
        recording,
    };
    let serving = format!("{} serves fleet {}", C::SERVICE, bus.space().fleet());
    tracing::info!("{serving}");
    notify::ready(&serving);
    shell.step(Event::Started);
    let up = *link.borrow_and_update();
    observer.link(up);
    if !up {
        shell.step(Event::LinkLost);
    }
    let mut beat = tokio::time::interval(BEAT);
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut not_before = Instant::now();
    loop {
        let deadline = shell.driver.deadline();
        let due = async {
            match deadline {
                // An absolute moment: other events must not put it off.
                Some(tick) => sleep_until(shell.clock.instant(tick).max(not_before)).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = stop.stopped() => break,
            () = watched.due() => watched.beat(),
            () = due => {
                shell.step(Event::Timeout);
                not_before = Instant::now() + BETWEEN_TIMEOUTS;
            }
            _ = beat.tick() => shell.show(),
            () = inbox.arrived() => shell.take_packets(),
            // Looked at again with every turn of the loop, the next beat at the latest.
            Some(asked) = asked.recv(), if shell.errands.has_room() => shell.take_query(asked),
            Some(ended) = ended.recv() => match ended {
                Ended::Job { event, laps } => shell.step_with(event, &laps),
                Ended::Fetch { fetch, messages } => shell.step(Event::Fetched { fetch, messages }),
            },
            Ok(()) = link.changed() => {
                let up = *link.borrow_and_update();
                tracing::warn!("the link to the router is {}", if up { "back" } else { "lost" });
                observer.link(up);
                notify::status(if up { &serving } else { "the link to the router is lost" });
                shell.step(if up { Event::LinkRestored } else { Event::LinkLost });
            }
        }
    }
    observer.ended();
    tracing::info!("{} ends", C::SERVICE);
    notify::stopping().await;
    let recording = shell.recording.take();
    drop(shell);
    // What is stored last must reach the disk; everything else may be lost.
    let _ = tokio::time::timeout(ERRANDS_WITHIN, errands_done).await;
    let _ = token.withdraw().await;
    let _ = tokio::task::spawn_blocking(move || {
        outbox.close();
        drop(recording);
    })
    .await;
    bus.close().await;
    tracing::info!("{} has stopped", C::SERVICE);
    Ok(())
}

/// What waits for the core.
enum Arrival {
    /// What a robot said, understood as it came.
    Understood(Result<Message, Rejection>),
    /// What a service said. It may be large, takes many times its bytes once it is read, and its time
    /// to read; it is understood when its turn comes.
    Packet(Packet),
}

/// Takes packets in, on the thread that the bus calls back on. What robots say is understood at once,
/// and what is refused waits in a place of its own: it must not take that of a good message of the
/// same key. Services repeat what they say, so that their messages need no such care.
fn take_in<C: Core>(
    space: &KeySpace,
    inbox: &Arc<Inbox<Arrival>>,
    from_robots: bool,
    observer: &Observer,
) -> impl Fn(Packet, Delivery) + Send + Sync + 'static {
    let (space, inbox, observer) = (space.clone(), Arc::clone(inbox), observer.clone());
    move |packet, delivery| {
        let size = packet.key.len() + packet.payload.as_ref().map_or(0, Vec::len);
        observer.arrived(size);
        if !from_robots {
            inbox.push(packet.key.clone(), Arrival::Packet(packet), size, delivery);
            return;
        }
        match C::understand(&space, &packet) {
            Ok(message) => {
                inbox.push(packet.key, Arrival::Understood(Ok(message)), size, delivery);
            }
            Err(refused) => {
                let place = format!("{} refused", refused.key);
                let refused = Arrival::Understood(Err(refused));
                inbox.push(place, refused, size, Delivery::Latest);
            }
        }
    }
}

/// Declares what comes in and what is served. The sender that is returned is told whether this
/// instance holds the role of its service.
async fn declare<C: Core>(
    bus: &Bus,
    inbox: &Arc<Inbox<Arrival>>,
    queries: mpsc::Sender<Asked>,
    observer: &Observer,
) -> anyhow::Result<watch::Sender<bool>> {
    let mut wiring = Wiring::of::<C>();
    wiring.served.push((Pattern::One(Key::Schema), true));
    let served = serve(bus.clone(), wiring.served, queries).await?;
    for subscription in wiring.subscriptions {
        let from_robots = subscription.pattern.payload_limit() == MAX_ROBOT_PAYLOAD;
        let take = take_in::<C>(bus.space(), inbox, from_robots, observer);
        let delivery = subscription.delivery;
        bus.subscribe(&subscription.pattern, move |packet| take(packet, delivery)).await?;
    }
    for pattern in &wiring.tokens {
        let take = take_in::<C>(bus.space(), inbox, true, observer);
        bus.subscribe_tokens(pattern, move |packet| take(packet, Delivery::Latest)).await?;
    }
    Ok(served)
}

/// Serves keys until the sender that is returned is gone. The answer of who holds the role suffices
/// for the service's own output; a get must not end at an instance that stands by, so that the keys
/// are declared anew whenever the role comes or goes.
async fn serve(
    bus: Bus,
    keys: Vec<(Pattern, bool)>,
    queries: mpsc::Sender<Asked>,
) -> anyhow::Result<watch::Sender<bool>> {
    let (holds, mut changed) = watch::channel(false);
    let mut standing = Vec::new();
    for (pattern, _) in &keys {
        standing.push(bus.serve(pattern, false, queries.clone()).await?);
    }
    let following = async move {
        while changed.changed().await.is_ok() {
            let holds = *changed.borrow_and_update();
            for ((pattern, own), served) in keys.iter().zip(&mut standing).filter(|(key, _)| key.1)
            {
                // The new one first, so that the key is never unserved.
                match bus.serve(pattern, *own && holds, queries.clone()).await {
                    Ok(anew) => drop(std::mem::replace(served, anew)),
                    Err(error) => tracing::error!("{error:#}"),
                }
            }
        }
    };
    tokio::spawn(following.in_current_span());
    Ok(holds)
}

struct Shell<C: Core> {
    driver: Driver<C>,
    bus: Bus,
    clock: Clock,
    inbox: Arc<Inbox<Arrival>>,
    outbox: Outbox,
    errands: Errands,
    ended: mpsc::Sender<Ended<C::Done>>,
    /// Hears whether this instance holds the role.
    served: watch::Sender<bool>,
    standing: Standing,
    queries: HashMap<QueryId, Query>,
    next_query: u64,
    recording: Option<Recording>,
    observer: Observer,
}

impl<C: Core> Shell<C> {
    fn step(&mut self, event: Event<C::Done>) {
        self.step_with(event, &[]);
    }

    /// Hands an event to the core; `laps` are those of the job that it ends, if it does.
    fn step_with(&mut self, event: Event<C::Done>, laps: &[u64]) {
        let (kind, begun) = (kind(&event), Instant::now());
        if let Event::Received(message) = &event {
            self.observer.received(message);
        }
        let now = self.clock.now();
        let space = self.bus.space();
        if let Some(recording) = &mut self.recording {
            recording.add(|| Entry::event(space, now, &event, laps));
        }
        let commands = self.driver.step(now, event);
        if let Some(recording) = &mut self.recording {
            recording.add(|| Ok(Entry::outputs(space, now, &commands)));
        }
        let mut stored = false;
        for command in commands {
            stored |= matches!(command, Command::Store(_));
            self.carry_out(now, command, stored);
        }
        let standing = self.driver.standing();
        if standing != std::mem::replace(&mut self.standing, standing) {
            self.stands(standing);
        }
        self.observer.handled(kind, begun.elapsed());
    }

    /// Shows that the loop turns, and how the service stands.
    fn show(&self) {
        let status = self.driver.core().status(self.clock.now());
        let inbox = self.inbox.counts();
        let (sent, outbox_dropped) = self.outbox.counts();
        let queues = Queues {
            inbox: inbox.waiting,
            superseded: inbox.superseded,
            inbox_dropped: inbox.dropped,
            outbox: self.outbox.waiting(),
            sent,
            outbox_dropped,
        };
        self.observer.turned(&status, &queues);
    }

    fn stands(&self, standing: Standing) {
        let service = C::SERVICE;
        match standing {
            Standing::Starting => tracing::info!("{service} asks the bus what there is"),
            Standing::Standby => {
                tracing::info!("{service} stands by: another instance holds the role")
            }
            Standing::Doubtful => {
                tracing::info!("{service} is silent until it knows that it still holds the role")
            }
            Standing::Holding => tracing::info!("{service} holds the role"),
        }
        let holds = matches!(standing, Standing::Holding | Standing::Doubtful);
        self.served.send_if_modified(|before| std::mem::replace(before, holds) != holds);
    }

    fn take_packets(&mut self) {
        for _ in 0..BATCH {
            let Some(arrival) = self.inbox.pop() else { return };
            let understood = match arrival {
                Arrival::Understood(understood) => understood,
                Arrival::Packet(packet) => C::understand(self.bus.space(), &packet),
            };
            match understood {
                Ok(message) => self.step(Event::Received(message)),
                Err(rejection) => self.step(Event::Rejected(rejection)),
            }
        }
        self.inbox.rewake();
    }

    fn take_query(&mut self, asked: Asked) {
        let Asked { query, narrowed, payload } = asked;
        let request = Request::new(query.selector(), query.parameters(), payload);
        match request {
            Ok(request) => {
                let request = match narrowed {
                    Some(served) => request.narrowed(served),
                    None => request,
                };
                if request.exact_key(self.bus.space()) == Some(Key::Schema) {
                    // It is the same for every core and every moment, so that none needs to know it.
                    let schema = Outbound {
                        key: Key::Schema,
                        encoding: JSON.into(),
                        payload: schema::text().to_vec(),
                        attachment: None,
                    };
                    self.errands.reply(query, Ok(vec![schema]), false);
                    return;
                }
                let id = QueryId(self.next_query);
                self.next_query += 1;
                self.queries.insert(id, query);
                self.step(Event::Query { query: id, request });
            }
            Err(problem) => {
                let problem = Problem::new("(parameters)", &problem.to_string()).to_json();
                self.errands.reply(query, Err(problem), false);
            }
        }
    }

    /// `stored` says whether the same event has led to something that is kept: its answer is only
    /// right if that worked.
    fn carry_out(&mut self, now: Tick, command: Command<C::Job>, stored: bool) {
        match command {
            Command::Publish(message) => match message.publish(now) {
                Ok(outbound) => {
                    let bytes = outbound.iter().map(|outbound| outbound.payload.len()).sum();
                    self.observer.published(&message, bytes, now);
                    outbound.into_iter().for_each(|message| self.outbox.push(message));
                }
                Err(error) => tracing::error!("{} is not published: {error}", message.keys().0),
            },
            Command::Reply { query, request, answer } => {
                if let Some(query) = self.queries.remove(&query) {
                    let answer = self.encode_answer(&request, answer, now);
                    self.observer.answered();
                    self.errands.reply(query, answer, stored);
                }
            }
            Command::Run(job) => self.run_job(job),
            Command::Fetch { fetch, patterns } => self.fetch(fetch, patterns),
            Command::Store(stored) => self.errands.store(stored),
        }
    }

    fn encode_answer(
        &self,
        request: &Request,
        answer: Result<Vec<Message>, String>,
        now: Tick,
    ) -> Result<Vec<Outbound>, String> {
        let mut outbound = Vec::new();
        for mut message in answer? {
            if let Message::Status(status) = &mut message {
                self.add_counters(&mut status.counters);
            }
            let encoded = message.answer(self.bus.space(), request, now);
            outbound.extend(
                encoded.map_err(|error| Problem::new("(answer)", &error.to_string()).to_json())?,
            );
        }
        Ok(outbound)
    }

    fn add_counters(&self, counters: &mut std::collections::BTreeMap<String, u64>) {
        let inbox = self.inbox.counts();
        let (sent, dropped) = self.outbox.counts();
        let held = self.driver.core().footprint();
        for (name, count) in [
            ("held_robots", held.robots as u64),
            ("held_edges", held.edges as u64),
            ("held_messages", held.messages as u64),
            ("inbox_superseded", inbox.superseded),
            ("inbox_dropped", inbox.dropped),
            ("outbox_sent", sent),
            ("outbox_dropped", dropped),
        ] {
            counters.insert(name.to_owned(), count);
        }
    }

    fn run_job(&self, job: C::Job) {
        let (ended, observer) = (self.ended.clone(), self.observer.clone());
        observer.job_started();
        let span = tracing::Span::current();
        tokio::task::spawn_blocking(move || {
            let _service = span.enter();
            let start = Instant::now();
            let micros = move || u64::try_from(start.elapsed().as_micros()).unwrap_or(u64::MAX);
            let mut stopwatch = Stopwatch::reading(micros);
            let run = AssertUnwindSafe(|| C::run(job, &mut stopwatch));
            let event = match std::panic::catch_unwind(run) {
                Ok(done) => Event::Done(done),
                Err(panic) => Event::JobFailed(panic_text(panic.as_ref())),
            };
            observer.job_ended(start.elapsed());
            // The loop has ended if nobody receives; then nobody needs the result.
            let laps = stopwatch.laps().to_vec();
            let _ = ended.blocking_send(Ended::Job { event, laps });
        });
    }

    fn fetch(&self, fetch: u32, patterns: Vec<Pattern>) {
        let (bus, ended) = (self.bus.clone(), self.ended.clone());
        let now = Instant::now();
        let fetching = async move {
            let mut asked = JoinSet::new();
            for pattern in patterns {
                let bus = bus.clone();
                let patient = is_patient::<C>(fetch, &pattern);
                let until = if patient { now + START_PATIENCE } else { now };
                let asking = async move {
                    loop {
                        let answers = fetch_one::<C>(&bus, &pattern).await;
                        if !answers.is_empty() || Instant::now() >= until {
                            return answers;
                        }
                        tokio::time::sleep(START_AGAIN).await;
                    }
                };
                asked.spawn(asking.in_current_span());
            }
            let mut messages = Vec::new();
            while let Some(answered) = asked.join_next().await {
                messages.extend(answered.unwrap_or_default());
            }
            let _ = ended.send(Ended::Fetch { fetch, messages }).await;
        };
        tokio::spawn(fetching.in_current_span());
    }
}

async fn fetch_one<C: Core>(bus: &Bus, pattern: &Pattern) -> Vec<Message> {
    let ask =
        Ask { parameters: "format=bincode", payload: None, within: FETCH_WITHIN, everybody: true };
    let answers = match bus.get(pattern, ask).await {
        Ok(answers) => answers,
        Err(error) => {
            tracing::debug!("{error:#}");
            return Vec::new();
        }
    };
    let understood = answers.into_iter().filter_map(|answer| match answer {
        Answer::Packet(packet) => match C::understand(bus.space(), &packet) {
            Ok(message) => Some(message),
            Err(rejection) => {
                tracing::warn!("an answer on {} is refused: {}", rejection.key, rejection.reason);
                None
            }
        },
        Answer::Error(error) => {
            tracing::debug!("a fetch is answered with: {}", muster_wire::message::quoted(&error));
            None
        }
    });
    understood.collect()
}

/// The kind of an event, as it is counted.
fn kind<Done>(event: &Event<Done>) -> &'static str {
    match event {
        Event::Started => "started",
        Event::Received(_) => "message",
        Event::Rejected(_) => "refused",
        Event::Timeout => "timeout",
        Event::Done(_) => "job_done",
        Event::JobFailed(_) => "job_failed",
        Event::Fetched { .. } => "fetched",
        Event::Query { .. } => "get",
        Event::LinkLost => "link_lost",
        Event::LinkRestored => "link_restored",
    }
}
