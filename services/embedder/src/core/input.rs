//! What becomes of messages and of the answers of fetches.

use muster_model::id::ServiceName;
use muster_service::following::Acceptance;
use muster_wire::{Key, Message};

use super::{Context, Embedder};

impl Embedder {
    /// Accepts a message; what became of it, if it is one that the service reads and not refused.
    pub(super) fn accept(
        &mut self,
        context: &mut Context<'_>,
        message: Message,
    ) -> Option<Acceptance> {
        let (key, _) = message.keys();
        let accepted = match message {
            Message::Graph(delta) => {
                self.follow.accept_graph(&delta).map_err(|error| error.to_string())
            }
            Message::Roster(roster) => Ok(self.follow.accept_roster(roster)),
            Message::Settings(announced) if announced.service == ServiceName::Clusterer => {
                self.teams.accept(&announced).map_err(|error| error.to_string())
            }
            _ => return None,
        };
        match accepted {
            Ok(Acceptance::Gap) => context.count("gaps"),
            Ok(Acceptance::Ignored) => context.count("modalities_ignored"),
            Ok(Acceptance::Applied | Acceptance::Known | Acceptance::Old) => {}
            Err(ref reason) => context.refuse(&key, reason),
        }
        accepted.ok()
    }

    /// Accepts the answers of `clusterer`.
    pub(super) fn settings_answered(&mut self, context: &mut Context<'_>, found: &[Message]) {
        let announced = found.iter().filter_map(|message| match message {
            Message::Settings(announced) if announced.service == ServiceName::Clusterer => {
                Some(announced)
            }
            _ => None,
        });
        let newest = announced.max_by_key(|announced| announced.header.revision);
        if let Some(Err(error)) = newest.map(|newest| self.teams.accept_answer(newest)) {
            context.refuse(&Key::Settings(ServiceName::Clusterer), error.to_string());
        }
    }

    /// Accepts the answers of a fetch: graphs first, since the roster says which belong together. Answers
    /// that are older than what is known are normal, because several services answer.
    pub(super) fn accept_answers(&mut self, context: &mut Context<'_>, messages: Vec<Message>) {
        let mut rosters = Vec::new();
        let (mut settings, mut old) = (Vec::new(), Vec::new());
        for message in messages {
            match message {
                Message::Roster(_) => rosters.push(message),
                Message::Settings(_) => settings.push(message),
                Message::Graph(delta) => {
                    if self.accept(context, Message::Graph(delta.clone())) == Some(Acceptance::Old)
                    {
                        old.push(delta);
                    }
                }
                other => {
                    self.accept(context, other);
                }
            }
        }
        self.settings_answered(context, &settings);
        for roster in rosters {
            self.accept(context, roster);
        }
        for delta in old {
            if self.follow.roll_back(context.now(), &delta) {
                context.count("graphs_taken_back");
            }
        }
        self.follow.fetch_ended();
    }
}
