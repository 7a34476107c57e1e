//! The real host of any service behind one trait, with its jobs run at once.
//!
//! A job is computed when it is started, and its result is kept until the scheduler ends the job, by the
//! time and the panics of the plan. A panic of the code under test is caught and becomes a
//! [`Misbehaviour`].

use std::panic::{AssertUnwindSafe, catch_unwind};

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_historian::Historian;
use muster_ingest::Ingest;
use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_planner::Planner;
use muster_service::replay::panic_text;
use muster_service::{Command, Core, Host, Input, MemoryUse, Start, Stopwatch, Stored, Wiring};

/// What a process of a service starts with.
#[derive(Debug, Clone)]
pub(crate) struct ProcessStart {
    pub(crate) fleet: FleetId,
    pub(crate) instance: InstanceId,
    pub(crate) now: Tick,
    pub(crate) stored: Stored,
    /// What its configuration file changes, as a patch.
    pub(crate) file: serde_json::Value,
}

/// A panic of a core or job, or another breach of the contract between a host and its caller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Misbehaviour {
    /// What was seen, with the name of the service.
    pub(crate) seen: String,
}

/// The host of any service.
pub(crate) trait AnyHost {
    fn handle(&mut self, now: Tick, input: Input) -> Result<Vec<Command>, Misbehaviour>;
    fn deadline(&self) -> Option<Tick>;
    /// Does what [`Command::RunJob`] is about, and keeps the result for [`Input::JobEnded`].
    fn run_job(&mut self) -> Result<(), Misbehaviour>;
    fn memory_use(&self) -> MemoryUse;
    fn replica_state(&self) -> ReplicaState;
}

/// What is known of a service without starting it.
#[derive(Debug, Clone)]
pub(crate) struct ServiceKind {
    pub(crate) wiring: Wiring,
    start: fn(ProcessStart) -> Box<dyn AnyHost>,
}

impl ServiceKind {
    /// The kind of a name.
    pub(crate) fn of(service: ServiceName) -> Self {
        match service {
            ServiceName::Ingest => Self::of_core::<Ingest>(),
            ServiceName::Embedder => Self::of_core::<Embedder>(),
            ServiceName::Clusterer => Self::of_core::<Clusterer>(),
            ServiceName::Auditor => Self::of_core::<Auditor>(),
            ServiceName::Historian => Self::of_core::<Historian>(),
            ServiceName::Planner => Self::of_core::<Planner>(),
        }
    }

    fn of_core<C: Core>() -> Self {
        Self { wiring: Wiring::of::<C>(), start: |start| Box::new(JobRunner::<C>::new(start)) }
    }

    /// The host of a process of the service.
    pub(crate) fn start(&self, start: ProcessStart) -> Box<dyn AnyHost> {
        (self.start)(start)
    }
}

/// A host with the result of the job that runs.
struct JobRunner<C: Core> {
    host: Host<C>,
    done: Option<C::Done>,
}

impl<C: Core> JobRunner<C> {
    fn new(start: ProcessStart) -> Self {
        let ProcessStart { fleet, instance, now, stored, file } = start;
        let settings = C::Settings::default();
        let settings = settings.patched(&file).unwrap_or(settings);
        Self { host: Host::new(Start { fleet, instance, now, settings, stored }), done: None }
    }
}

fn misbehaves<C: Core, T>(problem: &str) -> Result<T, Misbehaviour> {
    Err(Misbehaviour { seen: format!("{}: {problem}", C::SERVICE) })
}

impl<C: Core> AnyHost for JobRunner<C> {
    fn handle(&mut self, now: Tick, input: Input) -> Result<Vec<Command>, Misbehaviour> {
        if let Input::JobEnded { panic, .. } = &input {
            match (self.done.take(), panic) {
                (Some(done), None) => self.host.finish_job(done),
                (Some(_), Some(_)) => {}
                (None, _) => return misbehaves::<C, _>("a job has ended that was never started"),
            }
        }
        catch_unwind(AssertUnwindSafe(|| self.host.handle(now, input))).or_else(|panic| {
            misbehaves::<C, _>(&format!("the core panics: {}", panic_text(panic.as_ref())))
        })
    }

    fn deadline(&self) -> Option<Tick> {
        self.host.deadline()
    }

    fn run_job(&mut self) -> Result<(), Misbehaviour> {
        let Some(job) = self.host.take_job() else {
            return misbehaves::<C, _>("a job is to be run, and there is none");
        };
        if self.done.is_some() {
            return misbehaves::<C, _>("a second job is started while one runs");
        }
        let run = || C::run(job, &mut Stopwatch::still());
        match catch_unwind(AssertUnwindSafe(run)) {
            Ok(done) => {
                self.done = Some(done);
                Ok(())
            }
            Err(panic) => {
                misbehaves::<C, _>(&format!("a job panics: {}", panic_text(panic.as_ref())))
            }
        }
    }

    fn memory_use(&self) -> MemoryUse {
        self.host.memory_use()
    }

    fn replica_state(&self) -> ReplicaState {
        self.host.replica_state()
    }
}
