//! A core lives through a recording once more.
//!
//! A core is deterministic, so that the same events lead to the same commands, byte for byte. Jobs
//! are run again as well, with the times that were measured then. [`compare`] looks for the first
//! event at which something else comes out.

use std::ops::ControlFlow;
use std::panic::AssertUnwindSafe;

use muster_model::time::Tick;
use muster_wire::message::quoted;
use muster_wire::recording::{Received, RecordingError};
use muster_wire::{KeySpace, Message, Rejection};

use crate::core::{Core, Event, QueryId, Start};
use crate::driver::{Command, Driver};
use crate::recording::{Entry, Head, Input, Output};
use crate::stopwatch::Stopwatch;

/// Why an event cannot be handed to the core again.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// The recording says what this program does not understand.
    #[error("{0}")]
    Unreadable(String),
    /// The core is on another course than it was.
    #[error("{0}")]
    Astray(String),
    /// The core panicked, and is not to be used any more.
    #[error("the core panics: {0}")]
    Panicked(String),
}

/// A core that lives through a recording.
#[derive(Debug)]
pub struct Replay<C: Core> {
    driver: Driver<C>,
    space: KeySpace,
    job: Option<C::Job>,
}

impl<C: Core> Replay<C> {
    /// The core as it was made then.
    ///
    /// # Errors
    /// If the head is of another service, or its settings are none of this program's.
    pub fn new(head: Head) -> Result<Self, ReplayError> {
        if head.service != C::SERVICE {
            let problem = format!("the recording is of {}, not of {}", head.service, C::SERVICE);
            return Err(ReplayError::Unreadable(problem));
        }
        let settings = serde_json::from_value(head.settings).map_err(|error| {
            let problem = format!("the settings are none of this program's: {error}");
            ReplayError::Unreadable(problem)
        })?;
        let start = Start {
            fleet: head.fleet.clone(),
            instance: head.instance,
            now: head.started,
            settings,
            stored: head.stored,
        };
        Ok(Self { driver: Driver::new(start), space: KeySpace::new(head.fleet), job: None })
    }

    /// The keys of the fleet.
    #[must_use]
    pub fn space(&self) -> &KeySpace {
        &self.space
    }

    /// Hands a recorded event to the core, and returns what it wants done now.
    ///
    /// # Errors
    /// [`ReplayError`] if that cannot be done; the replay has ended then.
    pub fn step(&mut self, tick: Tick, input: Input) -> Result<Vec<Output>, ReplayError> {
        let event = self.event(input)?;
        let driver = &mut self.driver;
        let step = AssertUnwindSafe(|| driver.step(tick, event));
        let commands = std::panic::catch_unwind(step)
            .map_err(|panic| ReplayError::Panicked(panic_text(panic.as_ref())))?;
        let mut outputs = Vec::new();
        for command in commands {
            outputs.push(Output::new(&self.space, tick, &command));
            if let Command::Run(job) = command {
                self.job = Some(job);
            }
        }
        Ok(outputs)
    }

    fn event(&mut self, input: Input) -> Result<Event<C::Done>, ReplayError> {
        Ok(match input {
            Input::Started => Event::Started,
            Input::Received(heard) => Event::Received(self.understand(heard)?),
            Input::Rejected(rejection) => Event::Rejected(rejection),
            Input::Timeout => Event::Timeout,
            Input::Done(laps) => match self.run(laps)? {
                Ok(done) => Event::Done(done),
                Err(said) => {
                    let problem = format!("the job ended well then and panics now: {said}");
                    return Err(ReplayError::Astray(problem));
                }
            },
            Input::JobFailed(laps, said) => match self.run(laps)? {
                Err(now) if now == said => Event::JobFailed(said),
                Err(now) => {
                    let problem = format!("the job panicked then with {said:?}, now with {now:?}");
                    return Err(ReplayError::Astray(problem));
                }
                Ok(_) => {
                    let problem = format!("the job panicked then and ends well now: {said}");
                    return Err(ReplayError::Astray(problem));
                }
            },
            Input::Fetched(fetch, heard) => {
                let messages = heard.into_iter().map(|heard| self.understand(heard));
                Event::Fetched { fetch, messages: messages.collect::<Result<_, _>>()? }
            }
            Input::Query(query, request) => Event::Query { query: QueryId(query), request },
            Input::LinkLost => Event::LinkLost,
            Input::LinkRestored => Event::LinkRestored,
        })
    }

    fn understand(&self, heard: Received) -> Result<Message, ReplayError> {
        C::understand(&self.space, &heard.into_packet()).map_err(|rejection| {
            let Rejection { key, reason, .. } = rejection;
            ReplayError::Unreadable(format!("a message on {key} is not understood: {reason}"))
        })
    }

    /// Runs the job that was started last: its end, or what it said as it panicked.
    fn run(&mut self, laps: Vec<u64>) -> Result<Result<C::Done, String>, ReplayError> {
        let Some(job) = self.job.take() else {
            let problem = "a job has ended then, but none was started now".to_owned();
            return Err(ReplayError::Astray(problem));
        };
        let measured = laps.len();
        let mut stopwatch = Stopwatch::repeating(laps);
        let run = AssertUnwindSafe(|| C::run(job, &mut stopwatch));
        let ended = std::panic::catch_unwind(run).map_err(|panic| panic_text(panic.as_ref()));
        let measures = stopwatch.laps().len();
        if measures != measured {
            let problem = format!("the job measured {measured} times then, {measures} times now");
            return Err(ReplayError::Astray(problem));
        }
        Ok(ended)
    }
}

/// One event of a recording with what was wanted done then.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// Its number, from 1.
    pub number: u64,
    /// Its moment.
    pub tick: Tick,
    /// The event.
    pub input: Input,
    /// What the core wanted done; none if the recording ends before that was written.
    pub outputs: Option<Vec<Output>>,
}

/// The first event at which something else comes out than then.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// The event as it is recorded.
    pub step: Step,
    /// What comes out now.
    pub now: Result<Vec<Output>, ReplayError>,
}

/// How a recording ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// With a word why.
    Told(String),
    /// Without one, as after a kill: at the end of an entry, or at a byte within one.
    BrokenOff(Option<u64>),
    /// Later than it was looked at.
    NotReached,
    /// With bytes that are not those that were written.
    Damaged(String),
}

/// What came of a comparison.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Comparison {
    /// How many events were handed to the core.
    pub events: u64,
    /// How many of its commands were compared.
    pub outputs: u64,
    /// How many jobs were run.
    pub jobs: u64,
    /// Where the recording ends.
    pub ending: Ending,
    /// The first difference.
    pub difference: Option<Box<Difference>>,
}

/// Hands the first `until` events of a recording to a core, and compares what it wants done with
/// what it wanted then. `next` gives the entries; `see` is shown each event before the core is,
/// and may end it.
///
/// # Errors
/// [`ReplayError::Unreadable`] if the entries are none of this program's.
pub fn compare<C: Core>(
    head: Head,
    mut next: impl FnMut() -> Result<Option<Entry>, RecordingError>,
    until: u64,
    mut see: impl FnMut(&Step) -> ControlFlow<()>,
) -> Result<Comparison, ReplayError> {
    let mut replay = Replay::<C>::new(head)?;
    let mut done =
        Comparison { events: 0, outputs: 0, jobs: 0, ending: Ending::NotReached, difference: None };
    let mut read = || match next() {
        Ok(Some(Entry::End(why))) => Err(Ending::Told(why)),
        Ok(Some(entry)) => Ok(entry),
        Ok(None) => Err(Ending::BrokenOff(None)),
        Err(RecordingError::BreaksOff(at)) => Err(Ending::BrokenOff(Some(at))),
        Err(error) => Err(Ending::Damaged(error.to_string())),
    };
    let misplaced = |number: u64, what: &str| {
        let problem = format!("event {number}: {what} stands where none belongs");
        Err(ReplayError::Unreadable(problem))
    };
    while done.events < until {
        let number = done.events + 1;
        let (tick, input) = match read() {
            Ok(Entry::Event { tick, input }) => (tick, input),
            Ok(_) => return misplaced(number, "a list of outputs"),
            Err(ending) => {
                done.ending = ending;
                break;
            }
        };
        let outputs = match read() {
            Ok(Entry::Outputs(outputs)) => Some(outputs),
            Ok(_) => return misplaced(number, "another event"),
            Err(ending) => {
                done.ending = ending;
                None
            }
        };
        let step = Step { number, tick, input, outputs };
        if see(&step).is_break() {
            done.ending = Ending::NotReached;
            break;
        }
        done.jobs += u64::from(matches!(step.input, Input::Done(_) | Input::JobFailed(..)));
        let now = replay.step(tick, step.input.clone());
        if let Err(ReplayError::Unreadable(problem)) = now {
            return Err(ReplayError::Unreadable(format!("event {number}: {problem}")));
        }
        done.events = number;
        // What was wanted done last is not known if the recording ends before it; but where the core
        // panics now, it most likely did so then.
        let same = match (&step.outputs, &now) {
            (Some(then), Ok(now)) => then == now,
            (None, Ok(_)) => true,
            (_, Err(_)) => false,
        };
        if !same {
            done.difference = Some(Box::new(Difference { step, now }));
            break;
        }
        let Some(then) = step.outputs else { break };
        done.outputs += then.len() as u64;
    }
    Ok(done)
}

/// What a panic said, fit for a log line.
#[must_use]
pub fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without text");
    quoted(text)
}
