//! A core of any service behind one face, with its job done on the spot.
//!
//! A job is computed when it is started and its result kept until the world says that the job has
//! ended; whether it takes long or panics is the world's choice. A panic of the code under test is
//! caught and becomes a [`Output::Broken`].

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_machine::{
    Command, Core, Driver, Event, Footprint, QueryId, Start, Stopwatch, Stored, Wiring, is_patient,
};
use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::role::Standing;
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::{KeySpace, Message, Packet, Pattern, Rejection, Request};

/// What happens to a core.
#[derive(Debug)]
pub(crate) enum Input {
    Started,
    Received(Result<Message, Rejection>),
    Timeout,
    /// The job has ended: well, or with a panic.
    JobEnded {
        panicked: bool,
    },
    Fetched {
        fetch: u32,
        messages: Vec<Message>,
    },
    Query {
        query: QueryId,
        request: Request,
    },
    LinkLost,
    LinkRestored,
}

/// What a core wants done.
#[derive(Debug)]
pub(crate) enum Output {
    Publish(Message),
    Reply {
        query: QueryId,
        request: Request,
        answer: Result<Vec<Message>, String>,
    },
    /// A job has been started.
    Started,
    Fetch {
        fetch: u32,
        patterns: Vec<Pattern>,
    },
    Store(Stored),
    /// The core or its job has broken the contract.
    Broken(String),
}

/// What a process of a service starts with.
#[derive(Debug, Clone)]
pub(crate) struct Birth {
    pub(crate) fleet: FleetId,
    pub(crate) instance: InstanceId,
    pub(crate) now: Tick,
    pub(crate) stored: Stored,
    /// What its configuration file changes, as a patch.
    pub(crate) file: serde_json::Value,
}

/// A core of any service.
pub(crate) trait Machine {
    fn step(&mut self, now: Tick, input: Input) -> Vec<Output>;
    fn deadline(&self) -> Option<Tick>;
    fn footprint(&self) -> Footprint;
    fn standing(&self) -> Standing;
}

/// What is known of a service without starting it.
#[derive(Debug, Clone)]
pub(crate) struct Kind {
    pub(crate) wiring: Wiring,
    pub(crate) is_patient: fn(u32, &Pattern) -> bool,
    pub(crate) understand: fn(&KeySpace, &Packet) -> Result<Message, Rejection>,
    start: fn(Birth) -> Box<dyn Machine>,
}

impl Kind {
    /// The real core of a service.
    pub(crate) fn of(service: ServiceName) -> Self {
        match service {
            ServiceName::Ingest => Self::real::<Ingest>(),
            ServiceName::Embedder => Self::real::<Embedder>(),
            ServiceName::Clusterer => Self::real::<Clusterer>(),
            ServiceName::Auditor => Self::real::<Auditor>(),
        }
    }

    fn real<C: Core>() -> Self {
        Self {
            wiring: Wiring::of::<C>(),
            is_patient: is_patient::<C>,
            understand: C::understand,
            start: |birth| Box::new(Running::<C>::new(birth)),
        }
    }

    /// A process of the service.
    pub(crate) fn start(&self, birth: Birth) -> Box<dyn Machine> {
        (self.start)(birth)
    }
}

struct Running<C: Core> {
    driver: Driver<C>,
    job: Option<C::Done>,
}

impl<C: Core> Running<C> {
    fn new(birth: Birth) -> Self {
        let Birth { fleet, instance, now, stored, file } = birth;
        let settings = C::Settings::default();
        let settings = settings.patched(&file).unwrap_or(settings);
        let start = Start { fleet, instance, now, settings, stored };
        Self { driver: Driver::new(start), job: None }
    }

    fn event(&mut self, input: Input) -> Result<Event<C::Done>, String> {
        Ok(match input {
            Input::Started => Event::Started,
            Input::Received(Ok(message)) => Event::Received(message),
            Input::Received(Err(rejection)) => Event::Rejected(rejection),
            Input::Timeout => Event::Timeout,
            Input::JobEnded { panicked } => match (self.job.take(), panicked) {
                (Some(_), true) => Event::JobFailed("a panic that the simulation wants".to_owned()),
                (Some(done), false) => Event::Done(done),
                (None, _) => return Err("a job has ended that nobody started".to_owned()),
            },
            Input::Fetched { fetch, messages } => Event::Fetched { fetch, messages },
            Input::Query { query, request } => Event::Query { query, request },
            Input::LinkLost => Event::LinkLost,
            Input::LinkRestored => Event::LinkRestored,
        })
    }

    fn carry_out(&mut self, command: Command<C::Job>) -> Output {
        match command {
            Command::Publish(message) => Output::Publish(message),
            Command::Reply { query, request, answer } => Output::Reply { query, request, answer },
            Command::Run(_) if self.job.is_some() => {
                Output::Broken("a second job is started while one runs".to_owned())
            }
            Command::Run(job) => {
                match catch_unwind(AssertUnwindSafe(|| C::run(job, &mut Stopwatch::still()))) {
                    Ok(done) => {
                        self.job = Some(done);
                        Output::Started
                    }
                    Err(panic) => {
                        let said = panic_text(panic.as_ref());
                        Output::Broken(format!("a job of {} panics: {said}", C::SERVICE))
                    }
                }
            }
            Command::Fetch { fetch, patterns } => Output::Fetch { fetch, patterns },
            Command::Store(stored) => Output::Store(stored),
        }
    }
}

impl<C: Core> Machine for Running<C> {
    fn step(&mut self, now: Tick, input: Input) -> Vec<Output> {
        let event = match self.event(input) {
            Ok(event) => event,
            Err(problem) => return vec![Output::Broken(problem)],
        };
        match catch_unwind(AssertUnwindSafe(|| self.driver.step(now, event))) {
            Ok(commands) => commands.into_iter().map(|command| self.carry_out(command)).collect(),
            Err(panic) => {
                let said = panic_text(panic.as_ref());
                vec![Output::Broken(format!("the core of {} panics: {said}", C::SERVICE))]
            }
        }
    }

    fn deadline(&self) -> Option<Tick> {
        self.driver.deadline()
    }

    fn footprint(&self) -> Footprint {
        self.driver.core().footprint()
    }

    fn standing(&self) -> Standing {
        self.driver.standing()
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("(no text)").to_owned()
}
