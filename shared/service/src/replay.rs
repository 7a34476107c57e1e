//! A service lives through a recording once more.
//!
//! A host is deterministic, so that the same inputs lead to the same commands, byte for byte. Jobs run
//! again as well, with the times that were measured then. [`compare`] looks for the first input at
//! which something else comes out.

use std::ops::ControlFlow;
use std::panic::AssertUnwindSafe;

use muster_model::time::Tick;
use muster_wire::message::quoted;
use muster_wire::recording::RecordingError;

use crate::core::Core;
use crate::host::Host;
use crate::io::{Command, Input};
use crate::recording::{Entry, Head};
use crate::start::Start;
use crate::stopwatch::Stopwatch;

/// Why an input cannot be handed to the host again.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// The recording holds what this program does not understand.
    #[error("{0}")]
    Unreadable(String),
    /// The host does something else than it did.
    #[error("{0}")]
    Astray(String),
    /// The core panicked, and is not to be used any more.
    #[error("the core panics: {0}")]
    Panicked(String),
}

/// A host that lives through a recording.
pub struct Replay<C: Core> {
    host: Host<C>,
    job: Option<C::Job>,
}

impl<C: Core> Replay<C> {
    /// The host as it was made then.
    ///
    /// # Errors
    /// If the head is of another service, or its settings do not fit this program.
    pub fn new(head: Head) -> Result<Self, ReplayError> {
        if head.service != C::SERVICE {
            let problem = format!("the recording is of {}, not of {}", head.service, C::SERVICE);
            return Err(ReplayError::Unreadable(problem));
        }
        let settings = serde_json::from_value(head.settings).map_err(|error| {
            let problem = format!("the settings do not fit this program: {error}");
            ReplayError::Unreadable(problem)
        })?;
        let Head { fleet, instance, started: now, stored, .. } = head;
        let host = Host::new(Start { fleet, instance, now, settings, stored });
        Ok(Self { host, job: None })
    }

    /// Hands a recorded input to the host, and returns what it wants done now.
    ///
    /// # Errors
    /// [`ReplayError`] if that cannot be done; the replay has ended then.
    pub fn step(&mut self, tick: Tick, input: Input) -> Result<Vec<Command>, ReplayError> {
        if let Input::JobEnded { laps, panic } = &input {
            self.end_job(laps.clone(), panic.as_deref())?;
        }
        let host = &mut self.host;
        let step = AssertUnwindSafe(|| host.handle(tick, input));
        let commands = std::panic::catch_unwind(step)
            .map_err(|panic| ReplayError::Panicked(panic_text(panic.as_ref())))?;
        if commands.contains(&Command::RunJob) {
            self.job = self.host.take_job();
        }
        Ok(commands)
    }

    /// Runs the job that was started last, with the times that were measured then.
    fn end_job(&mut self, laps: Vec<u64>, panic: Option<&str>) -> Result<(), ReplayError> {
        let astray = |problem: String| Err(ReplayError::Astray(problem));
        let Some(job) = self.job.take() else {
            return astray("a job has ended then, but none was started now".to_owned());
        };
        let measured = laps.len();
        let mut stopwatch = Stopwatch::repeating(laps);
        let run = AssertUnwindSafe(|| C::run(job, &mut stopwatch));
        let ended = std::panic::catch_unwind(run).map_err(|panic| panic_text(panic.as_ref()));
        let measures = stopwatch.laps().len();
        if measures != measured {
            let problem = format!("the job measured {measured} times then, {measures} times now");
            return astray(problem);
        }
        match (ended, panic) {
            (Ok(done), None) => self.host.finish_job(done),
            (Err(now), Some(then)) if now == then => {}
            (Err(now), Some(then)) => {
                return astray(format!("the job panicked then with {then:?}, now with {now:?}"));
            }
            (Err(now), None) => {
                return astray(format!("the job ended well then and panics now: {now}"));
            }
            (Ok(_), Some(then)) => {
                return astray(format!("the job panicked then and ends well now: {then}"));
            }
        }
        Ok(())
    }
}

/// One input of a recording with what was wanted done then.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Its number, from 1.
    pub number: u64,
    /// Its moment.
    pub tick: Tick,
    /// The input.
    pub input: Input,
    /// What the host wanted done; none if the recording ends before that was written.
    pub commands: Option<Vec<Command>>,
}

/// The first input at which something else comes out than then.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The input as it is recorded.
    pub step: Step,
    /// What comes out now.
    pub now: Result<Vec<Command>, ReplayError>,
}

/// How a recording ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// With a word why.
    Stated(String),
    /// Without one, as after a kill: at the end of an entry, or at a byte within one.
    BrokenOff(Option<u64>),
    /// Later than it was looked at.
    NotReached,
    /// With bytes that are not those that were written.
    Damaged(String),
}

/// What came of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// How many inputs were handed to the host.
    pub inputs: u64,
    /// How many of its commands were compared.
    pub commands: u64,
    /// How many jobs were run.
    pub jobs: u64,
    /// Where the recording ends.
    pub ending: Ending,
    /// The first difference.
    pub difference: Option<Box<Difference>>,
}

/// Hands the first `until` inputs of a recording to a host, and compares what it wants done with what
/// it wanted then. `next` gives the entries; `see` is shown each input before the host takes it, and
/// may end the comparison.
///
/// # Errors
/// [`ReplayError::Unreadable`] if the entries are of no recording of this program.
pub fn compare<C: Core>(
    head: Head,
    mut next: impl FnMut() -> Result<Option<Entry>, RecordingError>,
    until: u64,
    mut see: impl FnMut(&Step) -> ControlFlow<()>,
) -> Result<Comparison, ReplayError> {
    let mut replay = Replay::<C>::new(head)?;
    let ending = Ending::NotReached;
    let mut done = Comparison { inputs: 0, commands: 0, jobs: 0, ending, difference: None };
    let mut read = || match next() {
        Ok(Some(Entry::End(why))) => Err(Ending::Stated(why)),
        Ok(Some(entry)) => Ok(entry),
        Ok(None) => Err(Ending::BrokenOff(None)),
        Err(RecordingError::BreaksOff(at)) => Err(Ending::BrokenOff(Some(at))),
        Err(error) => Err(Ending::Damaged(error.to_string())),
    };
    let misplaced = |number: u64, what: &str| {
        let problem = format!("input {number}: {what} stands where none belongs");
        Err(ReplayError::Unreadable(problem))
    };
    while done.inputs < until {
        let number = done.inputs + 1;
        let (tick, input) = match read() {
            Ok(Entry::Input { tick, input }) => (tick, input),
            Ok(_) => return misplaced(number, "a list of commands"),
            Err(ending) => {
                done.ending = ending;
                break;
            }
        };
        let commands = match read() {
            Ok(Entry::Commands(commands)) => Some(commands),
            Ok(_) => return misplaced(number, "another input"),
            Err(ending) => {
                done.ending = ending;
                None
            }
        };
        let step = Step { number, tick, input, commands };
        if see(&step).is_break() {
            done.ending = Ending::NotReached;
            break;
        }
        done.jobs += u64::from(matches!(step.input, Input::JobEnded { .. }));
        let now = replay.step(tick, step.input.clone());
        done.inputs = number;
        // The last commands are not known if the recording ends before them; but where the core panics
        // now, it most likely did so then.
        let is_same = match (&step.commands, &now) {
            (Some(then), Ok(now)) => then == now,
            (None, Ok(_)) => true,
            (_, Err(_)) => false,
        };
        if !is_same {
            done.difference = Some(Box::new(Difference { step, now }));
            break;
        }
        let Some(then) = step.commands else { break };
        done.commands += then.len() as u64;
    }
    Ok(done)
}

/// The text of a panic, fit for a log line.
#[must_use]
pub fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without text");
    quoted(text)
}
