//! Commands of operators: those that are being carried out, and what came of the last ones.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use muster_model::command::{
    CommandOutcome, MAX_REMEMBERED_COMMANDS, MAX_REMEMBERED_REFUSALS, OperatorCommand,
    SettingsChange,
};
use muster_model::id::{CommandId, OperatorId};
use muster_model::time::Tick;
use muster_wire::Request;

use crate::io::GetId;

/// Names a command.
pub(crate) type CommandName = (OperatorId, CommandId);

/// A command that is being carried out.
#[derive(Debug)]
pub(crate) struct Pending {
    pub(crate) name: CommandName,
    pub(crate) command: OperatorCommand,
    /// The get that brought it.
    pub(crate) request: Request,
    /// What it has changed of the settings.
    pub(crate) changed: Option<SettingsChange>,
}

/// Whether a command may be carried out.
#[derive(Debug)]
pub(crate) enum Admission {
    /// It is new.
    New,
    /// It was carried out or refused before.
    Known(Arc<CommandOutcome>),
    /// It is being carried out.
    Pending,
    /// Too many are remembered.
    Full,
}

/// The commands of one service.
#[derive(Debug, Default)]
pub(crate) struct Commands {
    pending: BTreeMap<GetId, Pending>,
    outcomes: BTreeMap<CommandName, Arc<CommandOutcome>>,
    /// Their names, the oldest first.
    order: VecDeque<CommandName>,
}

impl Commands {
    /// With what is remembered from the last run.
    pub(crate) fn new(outcomes: &[CommandOutcome]) -> Self {
        let mut commands = Self::default();
        for outcome in outcomes {
            commands.remember(Arc::new(outcome.clone()));
        }
        commands
    }

    /// Whether a command may be carried out now. Those that have expired give way: they would be refused by their time.
    /// So do those that were refused: they have changed nothing.
    pub(crate) fn admit(&mut self, now: Tick, name: &CommandName) -> Admission {
        if let Some(outcome) = self.outcomes.get(name).filter(|known| !known.may_be_repeated) {
            return Admission::Known(Arc::clone(outcome));
        }
        if self.pending.values().any(|pending| pending.name == *name) {
            return Admission::Pending;
        }
        let now = now.as_seconds();
        while self.order.len() + self.pending.len() >= MAX_REMEMBERED_COMMANDS {
            let outcomes = &self.outcomes;
            let has_expired = |name: &CommandName| {
                outcomes
                    .get(name)
                    .is_none_or(|outcome| outcome.expires <= now || outcome.refused.is_some())
            };
            let Some(place) = self.order.iter().position(has_expired) else {
                return Admission::Full;
            };
            self.forget(place);
        }
        Admission::New
    }

    /// A command is being carried out, by a get of this id.
    pub(crate) fn begin(&mut self, get: GetId, pending: Pending) {
        self.pending.insert(get, pending);
    }

    /// The command that is being carried out by a get.
    pub(crate) fn pending(&mut self, get: GetId) -> Option<&mut Pending> {
        self.pending.get_mut(&get)
    }

    /// The command that a get carried out; none if it carried out none.
    pub(crate) fn end(&mut self, get: GetId) -> Option<Pending> {
        self.pending.remove(&get)
    }

    /// Remembers an outcome. Returns whether it was not known, and there was room for it. What one leader has carried out
    /// counts, even if another one at the same time has refused it, by a wrong clock for example.
    pub(crate) fn remember(&mut self, outcome: Arc<CommandOutcome>) -> bool {
        let name = (outcome.operator.clone(), outcome.id.clone());
        match self.outcomes.get_mut(&name) {
            Some(known) if known.refused.is_none() => {
                // Another leader has carried it out as well: the later change is the one that holds.
                let place = |outcome: &CommandOutcome| {
                    let at = outcome.changed.as_ref().map(|changed| changed.at);
                    (at, outcome.header.revision.term)
                };
                if outcome.refused.is_none() && place(&outcome) > place(known) {
                    *known = outcome;
                }
                return false;
            }
            Some(known) if outcome.refused.is_some() && !known.may_be_repeated => return false,
            Some(_) => {
                let place = self.order.iter().position(|other| *other == name);
                place.into_iter().for_each(|place| self.forget(place));
            }
            None => {}
        }
        let refusals = self.outcomes.values().filter(|known| known.refused.is_some()).count();
        if outcome.refused.is_some() && refusals >= MAX_REMEMBERED_REFUSALS
            || self.order.len() >= MAX_REMEMBERED_COMMANDS
        {
            // The oldest that was refused gives way; one that was carried out gives way to no refusal.
            let is_refused = |name| {
                self.outcomes.get(name).is_some_and(|known: &Arc<_>| known.refused.is_some())
            };
            match self.order.iter().position(is_refused) {
                Some(place) => self.forget(place),
                None if outcome.refused.is_some() => return false,
                None => self.forget(0),
            }
        }
        self.order.push_back(name.clone());
        self.outcomes.insert(name, outcome);
        true
    }

    fn forget(&mut self, place: usize) {
        if let Some(name) = self.order.remove(place) {
            self.outcomes.remove(&name);
        }
    }

    /// What is remembered, the oldest first.
    pub(crate) fn outcomes(&self) -> impl Iterator<Item = &Arc<CommandOutcome>> {
        self.order.iter().filter_map(|name| self.outcomes.get(name))
    }
}
