//! A core as every shell drives it: one event in, what is to be done out.

use muster_model::role::Standing;
use muster_model::time::Tick;

use crate::core::{Core, Effect, Effects, Event, QueryId, Start, Stored};
use muster_wire::{Message, Pattern, Request};

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

/// A core with the effects of its current event.
#[derive(Debug)]
pub struct Driver<C: Core> {
    core: C,
    effects: Effects<C::Job>,
}

impl<C: Core> Driver<C> {
    /// A core that has seen no event yet.
    #[must_use]
    pub fn new(start: Start<C::Settings>) -> Self {
        Self { core: C::new(start), effects: Effects::default() }
    }

    /// Hands one event to the core and returns what is to be done, in order. What an instance that
    /// does not hold the role would publish is left out.
    #[must_use = "commands that are not carried out are lost"]
    pub fn step(&mut self, now: Tick, event: Event<C::Done>) -> Vec<Command<C::Job>> {
        self.core.handle(now, event, &mut self.effects);
        let silent = self.core.standing() != Standing::Holding;
        let mut commands = Vec::new();
        for effect in self.effects.drain() {
            match effect {
                Effect::Publish(_) if silent => {}
                Effect::Publish(message) => commands.push(Command::Publish(message)),
                Effect::Reply { query, request, answer } => {
                    commands.push(Command::Reply { query, request, answer });
                }
                Effect::Start(job) => commands.push(Command::Run(job)),
                Effect::Fetch { fetch, patterns } => {
                    commands.push(Command::Fetch { fetch, patterns });
                }
                Effect::Store(stored) => commands.push(Command::Store(stored)),
            }
        }
        commands
    }

    /// Where the instance stands towards the role of its service.
    #[must_use]
    pub fn standing(&self) -> Standing {
        self.core.standing()
    }

    /// When the core wants [`Event::Timeout`].
    #[must_use]
    pub fn deadline(&self) -> Option<Tick> {
        self.core.deadline()
    }

    /// The core, to look at.
    #[must_use]
    pub fn core(&self) -> &C {
        &self.core
    }
}
