//! What an instance hears of the other instances of its service, before its core hears anything.

use muster_model::role::Standing;
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Pattern};

use super::{Role, START_FETCH, TERM_FETCH};
use crate::core::{Effect, Effects, Event};
use crate::tenure::{Decision, Heard};

/// The number of the fetch by which an instance that stood by takes over: the same as
/// [`START_FETCH`] to its core, but nobody is waited for.
const TAKE_OVER_FETCH: u32 = u32::MAX - 2;

/// The number of the fetch by which a holder in doubt asks who holds.
const DOUBT_FETCH: u32 = u32::MAX - 3;

/// What the core has to do about an event.
#[derive(Debug)]
pub enum Turn<D> {
    /// To take these events in, in order.
    Events(Vec<Event<D>>),
    /// To forget what it has told, and to begin again with [`Event::Started`]: another instance holds
    /// the role.
    StandDown,
}

impl<S: Settings> Role<S> {
    /// Asks the bus for what the role begins with: what the core wants, who holds, and with which
    /// settings. The answers come as [`START_FETCH`].
    pub fn ask<J>(&mut self, mut patterns: Vec<Pattern>, effects: &mut Effects<J>) {
        self.asking = true;
        let fetch = if self.waited { TAKE_OVER_FETCH } else { START_FETCH };
        patterns.extend([Key::Holder(self.service), Key::Settings(self.service)].map(Pattern::One));
        effects.push(Effect::Fetch { fetch, patterns });
    }

    /// Looks at an event before the core does. What concerns the role alone is kept back; an instance
    /// that is to take over or to begin again is handed [`Event::Started`].
    #[must_use]
    pub fn attend<D, J>(
        &mut self,
        now: Tick,
        event: Event<D>,
        effects: &mut Effects<J>,
    ) -> Turn<D> {
        let mut events = Vec::new();
        if self.tenure.attend(now) {
            self.tenure.doubt();
            if self.tenure.is_linked() {
                self.ask_holder(effects);
            }
            // Whoever waits for robots could not hear them.
            events.push(Event::LinkLost);
        }
        match event {
            Event::Received(Message::Claim(claim)) => {
                match self.tenure.hear(now, &claim, false, self.revision.term) {
                    Heard::Noted => {}
                    Heard::StandDown => return self.stand_down(),
                    Heard::Raise(revision) => {
                        self.raise = Some(revision);
                        if self.standing() == Standing::Doubtful {
                            // The new term ends the doubt, and its first outputs need the link.
                            events.push(Event::LinkRestored);
                        }
                        events.push(Event::Fetched { fetch: TERM_FETCH, messages: Vec::new() });
                    }
                }
            }
            Event::Received(Message::ServiceToken { instance, alive, .. }) => {
                self.tenure.token(now, instance, alive);
            }
            Event::Received(Message::Settings(announced)) if announced.service == self.service => {
                self.adopt(&announced, effects);
            }
            Event::Fetched { fetch: DOUBT_FETCH, messages } => {
                self.doubts = self.doubts.saturating_sub(1);
                if self.hear_answers(now, &messages) == Heard::StandDown {
                    return self.stand_down();
                }
                // One that was asked before the doubt says nothing of it.
                if self.doubts == 0 {
                    self.tenure.unopposed();
                }
            }
            Event::Fetched { fetch: START_FETCH | TAKE_OVER_FETCH, messages }
                if self.asking && !self.is_holding() =>
            {
                self.asking = false;
                self.hear_answers(now, &messages);
                let (own, messages): (Vec<_>, Vec<_>) =
                    messages.into_iter().partition(|message| self.is_own(message));
                match self.tenure.decide(now, self.waited) {
                    Decision::Wait => return Turn::Events(events),
                    Decision::StandBy => {}
                    Decision::Begin => self.beginning = true,
                }
                // A holder in doubt answers as well, with what nobody has heard it announce.
                for message in own {
                    if let Message::Settings(announced) = message {
                        self.adopt(&announced, effects);
                    }
                }
                events.push(Event::Fetched { fetch: START_FETCH, messages });
            }
            Event::LinkLost => {
                self.tenure.link_lost();
                events.push(Event::LinkLost);
            }
            Event::LinkRestored => {
                self.tenure.link_restored(now);
                match self.standing() {
                    Standing::Doubtful => self.ask_holder(effects),
                    Standing::Starting if self.waited && !self.asking => {
                        self.tenure.stand_by();
                        events.push(Event::LinkRestored);
                    }
                    Standing::Starting if !self.asking => {
                        events.extend([Event::LinkRestored, Event::Started]);
                    }
                    _ => events.push(Event::LinkRestored),
                }
            }
            event => events.push(event),
        }
        if self.tenure.confirms(now) {
            // First of all: what the core makes of anything else is heard from now on.
            events.insert(0, Event::LinkRestored);
        }
        if self.tenure.takes_over(now) {
            self.waited = true;
            events.push(Event::Started);
        }
        Turn::Events(events)
    }

    fn ask_holder<J>(&mut self, effects: &mut Effects<J>) {
        self.doubts = self.doubts.saturating_add(1);
        let patterns = vec![Pattern::One(Key::Holder(self.service))];
        effects.push(Effect::Fetch { fetch: DOUBT_FETCH, patterns });
    }

    /// Hears the claims among answers to a get.
    fn hear_answers(&mut self, now: Tick, messages: &[Message]) -> Heard {
        let mut heard = Heard::Noted;
        for message in messages {
            if let Message::Claim(claim) = message
                && claim.service == self.service
            {
                let this = self.tenure.hear(now, claim, true, self.revision.term);
                if this == Heard::StandDown {
                    heard = this;
                }
            }
        }
        heard
    }

    fn is_own(&self, message: &Message) -> bool {
        match message {
            Message::Claim(_) => true,
            Message::Settings(announced) => announced.service == self.service,
            _ => false,
        }
    }

    fn stand_down<D>(&mut self) -> Turn<D> {
        self.tenure.restart();
        self.adopted = self.revision;
        self.check_at = None;
        self.higher = None;
        self.raise = None;
        self.beginning = false;
        self.waited = false;
        Turn::StandDown
    }

    /// Whether the answers to what [`Role::ask`] asked are those with which the term is to begin.
    #[must_use]
    pub fn is_beginning(&self) -> bool {
        self.beginning
    }
}
