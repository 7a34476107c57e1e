//! The cores of all services in one thread and in virtual time.
//!
//! Messages are delivered at once and unchanged: the bus is tested elsewhere. Fetches find nothing, as on a new bus
//! that loses nothing. A job takes as long as the settings say.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::audit::Audit;
use muster_model::content::Checked;
use muster_model::graph::GraphReplica;
use muster_model::id::{FleetId, IdError, InstanceId, Modality, ServiceName};
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, IngestSettings,
};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_service::testkit::START_RETRY_TIME;
use muster_service::{
    Arrival, Command, Core, GetId, Host, IncomingGet, Input, Start, Stopwatch, Stored,
};
use muster_wire::{Key, KeySpace, Message};

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
    /// How long a job takes.
    pub job_takes: Duration,
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
    /// What a job has led to, and when that is known.
    done: Option<(Tick, C::Done)>,
    job_takes: Duration,
    refusal: Option<String>,
}

impl<C: Core> Stage<C> {
    fn new(
        now: Tick,
        fleet: &FleetId,
        settings: C::Settings,
        job_takes: Duration,
    ) -> Result<Self, IdError> {
        let start = Start {
            fleet: fleet.clone(),
            instance: InstanceId::new(C::SERVICE.as_str())?,
            now,
            settings,
            stored: Stored::default(),
        };
        let space = KeySpace::new(fleet.clone());
        Ok(Self { host: Host::new(start), space, done: None, job_takes, refusal: None })
    }

    fn due(&self) -> Option<Tick> {
        self.host.deadline().into_iter().chain(self.done.as_ref().map(|(at, _)| *at)).min()
    }

    /// Does what is due.
    fn wake(&mut self, now: Tick, out: &mut VecDeque<Message>) {
        match self.done.take() {
            Some((at, done)) if at <= now => {
                self.host.finish_job(done);
                self.step(now, Input::JobEnded { laps: Vec::new(), panic: None }, out);
            }
            done => {
                self.done = done;
                self.step(now, Input::Timer, out);
            }
        }
    }

    fn receive(&mut self, now: Tick, message: Message, out: &mut VecDeque<Message>) {
        self.step(now, Input::Arrived(Arrival::of_message(&self.space, message)), out);
    }

    fn step(&mut self, now: Tick, input: Input, out: &mut VecDeque<Message>) {
        let mut inputs = VecDeque::from([input]);
        while let Some(input) = inputs.pop_front() {
            for command in self.host.handle(now, input) {
                match command {
                    Command::Publish(publication) => out.extend(publication.message),
                    Command::RunJob => {
                        let job = self.host.take_job();
                        let done = job.map(|job| C::run(job, &mut Stopwatch::still()));
                        self.done = done.map(|done| (now.after(self.job_takes), done));
                    }
                    Command::Ask(ask) => {
                        inputs.push_back(Input::Answered { ask: ask.ask, answers: Vec::new() });
                    }
                    Command::Reply(reply) => self.refusal = reply.answer.err(),
                    Command::Store(_) => inputs.push_back(Input::Stored { error: None }),
                    // There is no other bus here, and these services keep no records.
                    Command::ReplicaState(_)
                    | Command::DeclareToken(_)
                    | Command::WithdrawToken(_)
                    | Command::Append(_)
                    | Command::LookUp { .. }
                    | Command::Unencodable(_) => {}
                }
            }
        }
    }
}

/// All services of a fleet.
pub struct Pipeline {
    now: Tick,
    space: KeySpace,
    ingest: Stage<Ingest>,
    embedder: Stage<Embedder>,
    clusterer: Stage<Clusterer>,
    auditor: Stage<Auditor>,
    queue: VecDeque<Message>,
    gets: u64,
    /// The last division.
    pub teams: Option<Checked<Teams>>,
    /// Its last audit.
    pub audit: Option<Arc<Audit>>,
    /// Columns of the last embedding.
    pub dimension: u32,
    /// The graphs that were published last.
    pub graphs: BTreeMap<Modality, GraphReplica>,
}

impl Pipeline {
    /// Services that have just started.
    ///
    /// # Errors
    /// If a name is none, which is not so.
    pub fn new(now: Tick, settings: AllSettings) -> Result<Self, PipelineError> {
        let fleet = FleetId::new("moving")?;
        let AllSettings { ingest, embedder, clusterer, auditor, job_takes } = settings;
        // The services lead once their queries for an earlier leader have gone unanswered.
        let began = now.before(START_TIME);
        let mut pipeline = Self {
            now: began,
            ingest: Stage::new(began, &fleet, ingest, job_takes)?,
            embedder: Stage::new(began, &fleet, embedder, job_takes)?,
            clusterer: Stage::new(began, &fleet, clusterer, job_takes)?,
            auditor: Stage::new(began, &fleet, auditor, job_takes)?,
            space: KeySpace::new(fleet),
            queue: VecDeque::new(),
            gets: 0,
            teams: None,
            audit: None,
            dimension: 0,
            graphs: BTreeMap::new(),
        };
        let started = || Input::Started { linked: true };
        pipeline.embedder.step(began, started(), &mut pipeline.queue);
        pipeline.clusterer.step(began, started(), &mut pipeline.queue);
        pipeline.auditor.step(began, started(), &mut pipeline.queue);
        pipeline.ingest.step(began, started(), &mut pipeline.queue);
        pipeline.deliver();
        pipeline.advance(now);
        Ok(pipeline)
    }

    /// A message of a robot arrives now.
    pub fn receive(&mut self, message: Message) {
        self.ingest.receive(self.now, message, &mut self.queue);
        self.deliver();
    }

    /// The operator asks for so many teams now.
    ///
    /// # Errors
    /// If `clusterer` refuses.
    pub fn order_teams(&mut self, teams: usize) -> Result<(), PipelineError> {
        let selector = self.space.format(&Key::Settings(ServiceName::Clusterer));
        let payload = Some(format!("{{\"teams\": {teams}}}").into_bytes());
        self.gets += 1;
        let (get, parameters) = (GetId(self.gets), String::new());
        let get = IncomingGet { get, selector, narrowed: None, parameters, payload };
        self.clusterer.step(self.now, Input::Get(get), &mut self.queue);
        self.deliver();
        self.clusterer.refusal.take().map_or(Ok(()), |reason| Err(PipelineError::Refused(reason)))
    }

    /// Advances the time to a moment, and does everything that is due until then.
    pub fn advance(&mut self, until: Tick) {
        loop {
            let dues =
                [self.ingest.due(), self.embedder.due(), self.clusterer.due(), self.auditor.due()];
            let next = (0..dues.len()).filter_map(|at| Some((dues[at]?, at))).min();
            let Some((due, at)) = next.filter(|(due, _)| *due <= until) else { break };
            self.now = self.now.max(due);
            let (now, queue) = (self.now, &mut self.queue);
            match at {
                0 => self.ingest.wake(now, queue),
                1 => self.embedder.wake(now, queue),
                2 => self.clusterer.wake(now, queue),
                _ => self.auditor.wake(now, queue),
            }
            self.deliver();
        }
        self.now = self.now.max(until);
    }

    /// Delivers what was published to the services that subscribe to it.
    fn deliver(&mut self) {
        let now = self.now;
        while let Some(message) = self.queue.pop_front() {
            let out = &mut self.queue;
            match &message {
                Message::Graph(delta) => {
                    // On this bus nothing is lost, so that every delta applies.
                    let _ = self.graphs.entry(delta.modality.clone()).or_default().apply(delta);
                    self.embedder.receive(now, message, out);
                }
                Message::Roster(_) => {
                    self.embedder.receive(now, message.clone(), out);
                    self.clusterer.receive(now, message.clone(), out);
                    self.auditor.receive(now, message, out);
                }
                Message::Settings(announced) if announced.service == ServiceName::Clusterer => {
                    self.embedder.receive(now, message, out);
                }
                Message::Embedding(embedding) => {
                    self.dimension = embedding.dimension;
                    self.clusterer.receive(now, message.clone(), out);
                    self.auditor.receive(now, message, out);
                }
                Message::Teams { teams, .. } => {
                    self.teams = Some(teams.clone());
                    self.auditor.receive(now, message, out);
                }
                Message::Audit(audit) => {
                    self.audit = Some(Arc::clone(audit));
                    self.clusterer.receive(now, message, out);
                }
                _ => {}
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use muster_model::id::RobotId;
    use muster_model::observation::{CheckedReport, Pose};

    use super::*;

    #[test]
    fn groups_become_as_many_teams_as_are_asked_for() {
        let mut pipeline = Pipeline::new(Tick(10_000_000), AllSettings::default()).unwrap();
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
