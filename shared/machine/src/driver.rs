//! A core with its jobs: one in flight, the newest request wins.

use muster_model::time::Tick;

use crate::core::{Core, Effect, Effects, Event, QueryId, Start, Stored};
use muster_wire::{Message, Pattern, Request};

/// One job runs, at most one waits, and a newer request replaces the one that waits.
#[derive(Debug)]
pub struct SingleFlight<Job> {
    running: bool,
    waiting: Option<Job>,
    superseded: u64,
}

impl<Job> Default for SingleFlight<Job> {
    fn default() -> Self {
        Self { running: false, waiting: None, superseded: 0 }
    }
}

impl<Job> SingleFlight<Job> {
    /// Takes a request; the job that is returned is to be run now.
    #[must_use = "the job that is returned runs nowhere else"]
    pub fn request(&mut self, job: Job) -> Option<Job> {
        if self.running {
            self.superseded += u64::from(self.waiting.replace(job).is_some());
            return None;
        }
        self.running = true;
        Some(job)
    }

    /// The running job has ended, well or not; the job that is returned is to be run now.
    #[must_use = "the job that is returned runs nowhere else"]
    pub fn ended(&mut self) -> Option<Job> {
        let next = self.waiting.take();
        self.running = next.is_some();
        next
    }

    /// How many requests were replaced before they ran.
    #[must_use]
    pub fn superseded(&self) -> u64 {
        self.superseded
    }
}

/// What a shell has to do for a core.
#[derive(Debug)]
pub enum Command<Job> {
    /// Put a message on the bus.
    Publish(Message),
    /// Answer a get.
    Reply {
        /// Which get.
        query: QueryId,
        /// The get itself.
        request: Request,
        /// The answer.
        answer: Result<Vec<Message>, String>,
    },
    /// Run a job now, and hand its end to [`Driver::step`] as [`Event::Done`] or
    /// [`Event::JobFailed`].
    Run(Job),
    /// Ask the bus.
    Fetch {
        /// To be named in [`Event::Fetched`].
        fetch: u32,
        /// What is asked for.
        patterns: Vec<Pattern>,
    },
    /// Keep something over a restart.
    Store(Stored),
}

/// A core with its jobs.
#[derive(Debug)]
pub struct Driver<C: Core> {
    core: C,
    flight: SingleFlight<C::Job>,
    effects: Effects<C::Job>,
}

impl<C: Core> Driver<C> {
    /// A core that has seen no event yet.
    #[must_use]
    pub fn new(start: Start<C::Settings>) -> Self {
        Self { core: C::new(start), flight: SingleFlight::default(), effects: Effects::default() }
    }

    /// Hands one event to the core and returns what is to be done, in order.
    #[must_use = "commands that are not carried out are lost"]
    pub fn step(&mut self, now: Tick, event: Event<C::Done>) -> Vec<Command<C::Job>> {
        let ended = matches!(event, Event::Done(_) | Event::JobFailed(_));
        let mut commands = Vec::new();
        // The core hears of the end first: what it wants now is newer than what waits.
        self.core.handle(now, event, &mut self.effects);
        for effect in self.effects.drain() {
            match effect {
                Effect::Publish(message) => commands.push(Command::Publish(message)),
                Effect::Reply { query, request, answer } => {
                    commands.push(Command::Reply { query, request, answer });
                }
                Effect::Start(job) => {
                    commands.extend(self.flight.request(job).map(Command::Run));
                }
                Effect::Fetch { fetch, patterns } => {
                    commands.push(Command::Fetch { fetch, patterns });
                }
                Effect::Store(stored) => commands.push(Command::Store(stored)),
            }
        }
        if ended {
            commands.extend(self.flight.ended().map(Command::Run));
        }
        commands
    }

    /// When the core wants [`Event::Timeout`].
    #[must_use]
    pub fn deadline(&self) -> Option<Tick> {
        self.core.deadline()
    }

    /// How many jobs were replaced before they ran.
    #[must_use]
    pub fn superseded_jobs(&self) -> u64 {
        self.flight.superseded()
    }

    /// The core, to look at.
    #[must_use]
    pub fn core(&self) -> &C {
        &self.core
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_job_runs_and_the_newest_of_the_others_follows() {
        let mut flight = SingleFlight::default();
        assert_eq!(flight.request(1), Some(1));
        assert_eq!(flight.request(2), None);
        assert_eq!(flight.request(3), None);
        assert_eq!(flight.superseded(), 1);
        assert_eq!(flight.ended(), Some(3));
        assert_eq!(flight.request(4), None);
        assert_eq!(flight.ended(), Some(4));
        assert_eq!(flight.ended(), None);
        assert_eq!(flight.request(5), Some(5));
    }
}
