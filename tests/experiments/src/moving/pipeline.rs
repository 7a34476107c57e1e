//! The cores of all services in one thread and in virtual time.
//!
//! Messages travel and jobs run for as long as on a live system, or for no time: a service that is busy goes on with
//! the newest of what has come meanwhile. Messages are delivered unchanged, since the bus is tested elsewhere.
//! Fetches find nothing, as on a new bus that loses nothing.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::audit::Audit;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::graph::GraphReplica;
use muster_model::id::{FleetId, IdError, InstanceId, Modality, ServiceName};
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, IngestSettings,
};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_service::testkit::{START_RETRY_TIME, command_of};
use muster_service::{
    Arrival, Command, Core, GetId, Host, IncomingGet, Input, Start, Stopwatch, Stored,
};
use muster_wire::{Key, KeySpace, Message};

use super::times::{Leg, Times};

/// How long a service that starts repeats its unanswered query.
const START_TIME: Duration = START_RETRY_TIME;

/// The settings of all services.
#[derive(Debug, Clone, Default)]
pub struct AllSettings {
    /// Of `ingest`.
    pub ingest: IngestSettings,
    /// Of `embedder`.
    pub embedder: EmbedderSettings,
    /// Of `clusterer`.
    pub clusterer: ClustererSettings,
    /// Of `auditor`.
    pub auditor: AuditorSettings,
}

/// Why there is no pipeline, or it refuses an order.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// A name is none.
    #[error(transparent)]
    Name(#[from] IdError),
    /// A service refuses an order.
    #[error("an order is refused: {0}")]
    Refused(String),
}

/// One service.
struct Stage<C: Core> {
    host: Host<C>,
    space: KeySpace,
    /// What takes as long as a job.
    job: Leg,
    /// What a job has led to, and when that is known.
    done: Option<(Tick, C::Done)>,
    /// Nothing is handled before this.
    busy_until: Tick,
    refusal: Option<String>,
}

impl<C: Core> Stage<C> {
    fn new(now: Tick, fleet: &FleetId, settings: C::Settings, job: Leg) -> Result<Self, IdError> {
        let start = Start {
            fleet: fleet.clone(),
            instance: InstanceId::new(C::SERVICE.as_str())?,
            now,
            settings,
            stored: Stored::default(),
        };
        let space = KeySpace::new(fleet.clone());
        let host = Host::new(start);
        Ok(Self { host, space, job, done: None, busy_until: now, refusal: None })
    }

    fn due(&self) -> Option<Tick> {
        let due = self.host.deadline().into_iter().chain(self.done.as_ref().map(|(at, _)| *at));
        due.min().map(|due| due.max(self.busy_until))
    }

    /// Does what is due, and returns what is published.
    fn wake(&mut self, now: Tick, times: &mut Option<Times>) -> Vec<Message> {
        match self.done.take() {
            Some((at, done)) if at <= now => {
                self.host.finish_job(done);
                self.step(now, Input::JobEnded { laps: Vec::new(), panic: None }, times)
            }
            done => {
                self.done = done;
                self.step(now, Input::Timer, times)
            }
        }
    }

    fn receive(&mut self, now: Tick, message: Message, times: &mut Option<Times>) -> Vec<Message> {
        self.step(now, Input::Arrived(Arrival::of_message(&self.space, message)), times)
    }

    fn step(&mut self, now: Tick, input: Input, times: &mut Option<Times>) -> Vec<Message> {
        let mut out = Vec::new();
        let mut inputs = VecDeque::from([input]);
        while let Some(input) = inputs.pop_front() {
            for command in self.host.handle(now, input) {
                match command {
                    Command::Publish(publication) => out.extend(publication.message),
                    Command::RunJob => {
                        let job = self.host.take_job();
                        let done = job.map(|job| C::run(job, &mut Stopwatch::still()));
                        let takes = time(times, self.job);
                        self.done = done.map(|done| (now.after(takes), done));
                    }
                    Command::Ask(ask) => {
                        inputs.push_back(Input::Answered { ask: ask.ask, answers: Vec::new() });
                    }
                    Command::Reply(reply) => self.refusal = reply.answer.err(),
                    Command::Store(_) => inputs.push_back(Input::Stored { error: None }),
                    Command::Keep(_) => inputs.push_back(Input::Kept { error: None }),
                    // There is no other bus here, and these services keep no records.
                    Command::ReplicaState(_)
                    | Command::DeclareToken(_)
                    | Command::WithdrawToken(_)
                    | Command::KeptIsUnusable(_)
                    | Command::Append(_)
                    | Command::LookUp { .. }
                    | Command::Retain(_)
                    | Command::Unencodable(_) => {}
                }
            }
        }
        out
    }
}

/// How long something takes; no time where nothing does.
fn time(times: &mut Option<Times>, leg: Leg) -> Duration {
    times.as_mut().map_or(Duration::ZERO, |times| times.draw(leg))
}

/// Who receives messages, and does what is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Receiver {
    Ingest,
    Embedder,
    Clusterer,
    Auditor,
    /// Who wants to know the teams.
    Reader,
}

/// Messages on their way: by arrival, then in the order in which they were sent.
type Flying = BTreeMap<(Tick, u64), (Receiver, Message)>;

/// All services of a fleet.
pub struct Pipeline {
    now: Tick,
    space: KeySpace,
    ingest: Stage<Ingest>,
    embedder: Stage<Embedder>,
    clusterer: Stage<Clusterer>,
    auditor: Stage<Auditor>,
    flying: Flying,
    sent: u64,
    /// When the last message of a kind arrives at a receiver: none overtakes another.
    last_arrivals: BTreeMap<(u8, Receiver), Tick>,
    times: Option<Times>,
    gets: u64,
    /// The last division that has reached the reader.
    pub teams: Option<Checked<Teams>>,
    /// All divisions that have reached the reader since they were last taken, with when.
    received: Vec<(Tick, Checked<Teams>)>,
    /// Its last audit.
    pub audit: Option<Arc<Audit>>,
    /// The last embedding.
    pub embedding: Option<Checked<Embedding>>,
    /// Columns of the last embedding.
    pub dimension: u32,
    /// The graphs that were published last.
    pub graphs: BTreeMap<Modality, GraphReplica>,
}

impl Pipeline {
    /// Services that have just started. Messages arrive and jobs end at once.
    ///
    /// # Errors
    /// If a name is none, which is not so.
    pub fn new(now: Tick, settings: AllSettings) -> Result<Self, PipelineError> {
        let fleet = FleetId::new("moving")?;
        let AllSettings { ingest, embedder, clusterer, auditor } = settings;
        // The services lead once their queries for an earlier leader have gone unanswered.
        let began = now.before(START_TIME);
        let mut pipeline = Self {
            now: began,
            ingest: Stage::new(began, &fleet, ingest, Leg::Frame)?,
            embedder: Stage::new(began, &fleet, embedder, Leg::Embedding)?,
            clusterer: Stage::new(began, &fleet, clusterer, Leg::Division)?,
            auditor: Stage::new(began, &fleet, auditor, Leg::Audit)?,
            space: KeySpace::new(fleet),
            flying: BTreeMap::new(),
            sent: 0,
            last_arrivals: BTreeMap::new(),
            times: None,
            gets: 0,
            teams: None,
            received: Vec::new(),
            audit: None,
            embedding: None,
            dimension: 0,
            graphs: BTreeMap::new(),
        };
        let started = || Input::Started { linked: true };
        let out = pipeline.embedder.step(began, started(), &mut None);
        pipeline.send(out);
        let out = pipeline.clusterer.step(began, started(), &mut None);
        pipeline.send(out);
        let out = pipeline.auditor.step(began, started(), &mut None);
        pipeline.send(out);
        let out = pipeline.ingest.step(began, started(), &mut None);
        pipeline.send(out);
        pipeline.deliver();
        pipeline.advance(now);
        Ok(pipeline)
    }

    /// The same services, whose messages and jobs take time from here on.
    #[must_use]
    pub fn with_times(self, times: Times) -> Self {
        Self { times: Some(times), ..self }
    }

    /// A robot sends a message now.
    pub fn receive(&mut self, message: Message) {
        let takes = time(&mut self.times, Leg::Report);
        // The messages of one robot keep their order, those of others do not matter.
        let at = self.now.after(takes);
        self.sent += 1;
        self.flying.insert((at, self.sent), (Receiver::Ingest, message));
        self.deliver();
    }

    /// The operator asks for so many teams now.
    ///
    /// # Errors
    /// If `clusterer` refuses.
    pub fn order_teams(&mut self, teams: usize) -> Result<(), PipelineError> {
        self.gets += 1;
        let (key, id) = (Key::Settings(ServiceName::Clusterer).to_string(), self.gets.to_string());
        let patch = format!("{{\"teams\": {teams}}}");
        let Some((key, command)) = command_of(self.now, &key, &id, &patch) else { return Ok(()) };
        let get = IncomingGet {
            get: GetId(self.gets),
            selector: format!("muster/v1/{}/{key}", self.space.fleet()),
            narrowed: None,
            parameters: String::new(),
            payload: Some(command.into_bytes()),
        };
        let out = self.clusterer.step(self.now, Input::Get(get), &mut self.times);
        self.send(out);
        self.deliver();
        self.clusterer.refusal.take().map_or(Ok(()), |reason| Err(PipelineError::Refused(reason)))
    }

    /// All divisions that have reached the reader since this was last asked, with when.
    pub fn take_received(&mut self) -> Vec<(Tick, Checked<Teams>)> {
        std::mem::take(&mut self.received)
    }

    /// Advances the time to a moment, and does everything that happens until then.
    pub fn advance(&mut self, until: Tick) {
        loop {
            let dues = [
                (self.ingest.due(), Receiver::Ingest),
                (self.embedder.due(), Receiver::Embedder),
                (self.clusterer.due(), Receiver::Clusterer),
                (self.auditor.due(), Receiver::Auditor),
            ];
            let due = dues.into_iter().filter_map(|(at, of)| Some((at?, of))).min();
            let arrival = self.flying.first_key_value().map(|(key, _)| *key);
            let is_first = |at: Tick| due.is_none_or(|(due, _)| at <= due);
            if let Some((at, number)) = arrival.filter(|(at, _)| *at <= until && is_first(*at)) {
                self.now = self.now.max(at);
                if let Some((receiver, message)) = self.flying.remove(&(at, number)) {
                    self.arrive(number, receiver, message);
                }
            } else if let Some((due, of)) = due.filter(|(due, _)| *due <= until) {
                self.now = self.now.max(due);
                self.wake(of);
            } else {
                break;
            }
        }
        self.now = self.now.max(until);
    }

    /// Delivers the messages that arrive now.
    fn deliver(&mut self) {
        while let Some(((at, number), (receiver, message))) = self.flying.pop_first() {
            if at > self.now {
                self.flying.insert((at, number), (receiver, message));
                break;
            }
            self.arrive(number, receiver, message);
        }
    }

    /// A service does what is due.
    fn wake(&mut self, service: Receiver) {
        let (now, times) = (self.now, &mut self.times);
        let out = match service {
            Receiver::Ingest => self.ingest.wake(now, times),
            Receiver::Embedder => self.embedder.wake(now, times),
            Receiver::Clusterer => self.clusterer.wake(now, times),
            Receiver::Auditor => self.auditor.wake(now, times),
            Receiver::Reader => return,
        };
        if service == Receiver::Ingest && out.iter().any(|one| matches!(one, Message::Roster(_))) {
            self.ingest.busy_until = now.after(time(times, Leg::Frame));
        }
        self.send(out);
    }

    /// A message arrives, which was sent under a number.
    fn arrive(&mut self, number: u64, receiver: Receiver, message: Message) {
        let (now, times) = (self.now, &mut self.times);
        let out = match receiver {
            Receiver::Ingest if self.ingest.busy_until > now => {
                self.flying.insert((self.ingest.busy_until, number), (receiver, message));
                return;
            }
            Receiver::Ingest => self.ingest.receive(now, message, times),
            Receiver::Embedder => self.embedder.receive(now, message, times),
            Receiver::Clusterer => self.clusterer.receive(now, message, times),
            Receiver::Auditor => self.auditor.receive(now, message, times),
            Receiver::Reader => {
                match message {
                    Message::Teams { teams, .. } => {
                        self.teams = Some(teams.clone());
                        self.received.push((now, teams));
                    }
                    Message::Audit(audit) => self.audit = Some(audit),
                    _ => {}
                }
                return;
            }
        };
        self.send(out);
    }

    /// Sends what was published to the services that subscribe to it.
    fn send(&mut self, messages: Vec<Message>) {
        for message in messages {
            let (leg, receivers): (Leg, &[Receiver]) = match &message {
                Message::Graph(delta) => {
                    // On this bus nothing is lost, so that every delta applies.
                    let _ = self.graphs.entry(delta.modality.clone()).or_default().apply(delta);
                    (Leg::Graphs, &[Receiver::Embedder])
                }
                Message::Roster(_) => {
                    let all = &[Receiver::Embedder, Receiver::Clusterer, Receiver::Auditor];
                    (Leg::Graphs, all)
                }
                Message::Settings(announced) if announced.service == ServiceName::Clusterer => {
                    (Leg::Teams, &[Receiver::Embedder])
                }
                Message::Embedding(embedding) => {
                    self.dimension = embedding.dimension;
                    self.embedding = Some(embedding.clone());
                    (Leg::Vectors, &[Receiver::Clusterer, Receiver::Auditor])
                }
                Message::Teams { .. } => (Leg::Teams, &[Receiver::Auditor, Receiver::Reader]),
                Message::Audit(_) => (Leg::Teams, &[Receiver::Clusterer, Receiver::Reader]),
                _ => continue,
            };
            // What `ingest` publishes leaves once the whole frame is made.
            let leaves = if leg == Leg::Graphs { self.ingest.busy_until } else { self.now };
            for receiver in receivers {
                let at = leaves.max(self.now).after(time(&mut self.times, leg));
                let last = self.last_arrivals.entry((leg as u8, *receiver)).or_default();
                *last = at.max(*last);
                self.sent += 1;
                self.flying.insert((*last, self.sent), (*receiver, message.clone()));
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use muster_model::id::RobotId;
    use muster_model::observation::{CheckedReport, Pose};
    use muster_model::settings::TeamCount;

    use super::*;

    #[test]
    fn groups_become_as_many_teams_as_are_asked_for() {
        let mut settings = AllSettings::default();
        settings.clusterer.teams = TeamCount::Fixed(2);
        let mut pipeline = Pipeline::new(Tick(10_000_000), settings).unwrap();
        for step in 0..40_u64 {
            for robot in 0..12_u32 {
                let name = RobotId::new(format!("r{robot:02}")).unwrap();
                let x = f64::from(robot / 4) * 100.0 + f64::from(robot % 4);
                let pose = CheckedReport::new(name, Pose::at(x, 0.1 * step as f64)).unwrap();
                pipeline.receive(Message::Report(pose));
            }
            pipeline.advance(Tick(10_000_000 + (step + 1) * 100_000));
            if step == 25 {
                let teams = pipeline.teams.clone().unwrap();
                assert_eq!((teams.teams.len(), teams.requested), (2, 2));
                pipeline.order_teams(3).unwrap();
            }
        }
        let teams = pipeline.teams.unwrap();
        assert_eq!((teams.teams.len(), teams.requested), (3, 3));
        assert!(pipeline.audit.is_some() && pipeline.dimension >= 2);
    }

    #[test]
    fn an_order_that_makes_no_sense_is_refused() {
        let mut pipeline = Pipeline::new(Tick(10_000_000), AllSettings::default()).unwrap();
        assert!(matches!(pipeline.order_teams(0), Err(PipelineError::Refused(_))));
    }
}
