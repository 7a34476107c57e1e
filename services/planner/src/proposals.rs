//! The open proposals, and the gets that wait for them.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::header::Header;
use muster_model::id::{OperatorId, ProposalId, WishId};
use muster_model::proposal::{
    MAX_OPEN_PROPOSALS, MAX_OPEN_PROPOSALS_OF_OPERATOR, PROPOSAL_LIFETIME, Proposal,
    ProposalReport, ProposalRequest, ProposalState, ProposedDivision,
};
use muster_model::settings::SettingsError;
use muster_model::time::Tick;
use muster_service::{Context, Get};
use muster_wire::json::Problem;
use muster_wire::{Message, Request};

use crate::Planner;

/// How long a get waits for a proposal before it is answered with how far that is: most are there by then, and whoever
/// waits for a larger one sees that it goes on.
pub const ANSWER_TIME: Duration = Duration::from_secs(3);

/// Most gets that wait for proposals at once; further ones are answered at once with how far theirs is.
const MAX_WAITING_GETS: usize = 64;

/// Names a proposal.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Name {
    pub(crate) operator: OperatorId,
    pub(crate) id: ProposalId,
}

impl Name {
    /// The wish that keeps the robots in reserve once the proposal is accepted.
    pub(crate) fn reserve_wish(&self) -> Option<WishId> {
        Proposal::reserve_wish(&self.id)
    }
}

/// How far a proposal is.
#[derive(Debug)]
enum Progress {
    Queued,
    Running,
    Computed {
        division: Box<ProposedDivision>,
        at: Tick,
    },
    /// Nobody waited for the answer when it was refused.
    Refused {
        error: SettingsError,
        at: Tick,
    },
}

#[derive(Debug)]
struct Waiting {
    get: Get,
    until: Tick,
}

#[derive(Debug)]
struct Entry {
    asked: ProposalRequest,
    at: Tick,
    /// Lower ones are computed first.
    number: u64,
    progress: Progress,
    waiting: Vec<Waiting>,
}

impl Entry {
    fn is_open(&self) -> bool {
        matches!(self.progress, Progress::Queued | Progress::Running)
    }

    fn forgotten(&self) -> Option<Tick> {
        match &self.progress {
            Progress::Computed { at, .. } | Progress::Refused { at, .. } => {
                Some(at.after(PROPOSAL_LIFETIME))
            }
            Progress::Queued | Progress::Running => None,
        }
    }
}

/// All proposals that are not forgotten.
#[derive(Debug, Default)]
pub(crate) struct Proposals {
    all: BTreeMap<Name, Entry>,
    next: u64,
}

/// What asking for a proposal has led to.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Asking {
    /// It is to be computed.
    New,
    /// The same was asked for before.
    Known,
    /// It takes the place of one that is being computed.
    InPlaceOfRunning,
}

fn refused(problem: String) -> SettingsError {
    SettingsError::new("(proposal)", problem)
}

/// The JSON form of an error.
pub(crate) fn problem(error: &SettingsError) -> String {
    Problem::new(&error.field, &error.problem).to_json()
}

type PlannerContext<'a> = Context<'a, Planner>;

impl Proposals {
    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.all.len()
    }

    /// How many gets wait.
    pub(crate) fn waiting(&self) -> usize {
        self.all.values().map(|entry| entry.waiting.len()).sum()
    }

    /// Asks for a proposal, in place of the one with its name.
    ///
    /// # Errors
    /// If there are too many.
    pub(crate) fn ask(
        &mut self,
        context: &mut PlannerContext<'_>,
        name: &Name,
        asked: ProposalRequest,
    ) -> Result<Asking, SettingsError> {
        let known = self.all.get(name);
        if known.is_some_and(|entry| {
            entry.asked == asked && !matches!(entry.progress, Progress::Refused { .. })
        }) {
            return Ok(Asking::Known);
        }
        let others = || self.all.keys().filter(|other| *other != name);
        if others().count() >= MAX_OPEN_PROPOSALS {
            let problem = format!("there may be {MAX_OPEN_PROPOSALS} at most: drop some, or wait");
            return Err(refused(problem));
        }
        let own = others().filter(|other| other.operator == name.operator).count();
        if own >= MAX_OPEN_PROPOSALS_OF_OPERATOR {
            let problem = format!(
                "{} may have {MAX_OPEN_PROPOSALS_OF_OPERATOR} at most: drop some, or wait",
                name.operator
            );
            return Err(refused(problem));
        }
        self.next += 1;
        let (at, number) = (context.now(), self.next);
        let entry = Entry { asked, at, number, progress: Progress::Queued, waiting: Vec::new() };
        let Some(last) = self.all.insert(name.clone(), entry) else { return Ok(Asking::New) };
        let was_running = matches!(last.progress, Progress::Running);
        for waiting in last.waiting {
            let error = refused("another one was asked for under this id".to_owned());
            context.reply_error(waiting.get, problem(&error));
        }
        Ok(if was_running { Asking::InPlaceOfRunning } else { Asking::New })
    }

    /// Answers a get of one proposal, once that is computed or [`ANSWER_TIME`] is over.
    pub(crate) fn answer(&mut self, context: &mut PlannerContext<'_>, name: &Name, get: Get) {
        let is_full = self.waiting() >= MAX_WAITING_GETS;
        match self.all.get_mut(name) {
            None => {
                let error = refused(format!(
                    "{}/{} is not there: it was dropped, or forgotten {} s after it was computed; ask for it again",
                    name.operator,
                    name.id,
                    PROPOSAL_LIFETIME.as_secs()
                ));
                context.reply_error(get, problem(&error));
            }
            Some(Entry { progress: Progress::Refused { error, .. }, .. }) => {
                let error = problem(error);
                context.reply_error(get, error);
            }
            Some(entry) if entry.is_open() && !is_full => {
                let until = context.now().after(ANSWER_TIME);
                entry.waiting.push(Waiting { get, until });
            }
            Some(_) => {
                let report = self.report(context, name);
                context.reply(get, report.into_iter().collect());
            }
        }
    }

    /// Drops a proposal and answers the get with the last of it. Returns whether it was being computed.
    pub(crate) fn drop_one(
        &mut self,
        context: &mut PlannerContext<'_>,
        name: &Name,
        get: Get,
    ) -> bool {
        if !self.all.contains_key(name) {
            self.answer(context, name, get);
            return false;
        }
        let mut last = self.proposal(context.now(), name);
        let Some(entry) = self.all.remove(name) else { return false };
        for waiting in entry.waiting {
            context.reply_error(waiting.get, problem(&refused("it was dropped".to_owned())));
        }
        if let Some(last) = &mut last {
            (last.state, last.division, last.forgotten_in_s) = (ProposalState::Dropped, None, None);
        }
        let report = last.map(|proposal| message(context, proposal));
        context.reply(get, report.into_iter().collect());
        context.count("proposals_dropped");
        matches!(entry.progress, Progress::Running)
    }

    /// The one that is to be computed next.
    pub(crate) fn next(&self) -> Option<&Name> {
        let queued =
            self.all.iter().filter(|(_, entry)| matches!(entry.progress, Progress::Queued));
        queued.min_by_key(|(_, entry)| entry.number).map(|(name, _)| name)
    }

    /// One of them is being computed from now on. Returns what is asked.
    pub(crate) fn begin(&mut self, name: &Name) -> Option<ProposalRequest> {
        let entry = self.all.get_mut(name)?;
        entry.progress = Progress::Running;
        Some(entry.asked.clone())
    }

    /// One of them is computed, or refused. Those who wait are answered.
    pub(crate) fn end(
        &mut self,
        context: &mut PlannerContext<'_>,
        name: &Name,
        result: Result<ProposedDivision, SettingsError>,
    ) {
        let now = context.now();
        let Some(entry) = self.all.get_mut(name) else { return };
        let waiting = std::mem::take(&mut entry.waiting);
        match result {
            Ok(division) => {
                context.count("proposals_computed");
                entry.progress = Progress::Computed { division: Box::new(division), at: now };
                for Waiting { get, .. } in waiting {
                    let report = self.report(context, name);
                    context.reply(get, report.into_iter().collect());
                }
            }
            Err(error) => {
                context.count("proposals_refused");
                let text = problem(&error);
                if waiting.is_empty() {
                    entry.progress = Progress::Refused { error, at: now };
                } else {
                    self.all.remove(name);
                }
                for Waiting { get, .. } in waiting {
                    context.reply_error(get, text.clone());
                }
            }
        }
    }

    /// Forgets those whose time is over, and answers those who have waited for long enough.
    pub(crate) fn expire(&mut self, context: &mut PlannerContext<'_>) {
        let now = context.now();
        let count = self.all.len();
        self.all.retain(|_, entry| entry.forgotten().is_none_or(|at| now < at));
        context.add("proposals_forgotten", (count - self.all.len()) as u64);
        let names: Vec<Name> = self.all.keys().cloned().collect();
        for name in names {
            let Some(entry) = self.all.get_mut(&name) else { continue };
            let (over, left) = std::mem::take(&mut entry.waiting)
                .into_iter()
                .partition(|waiting| waiting.until <= now);
            entry.waiting = left;
            let over: Vec<Waiting> = over;
            for Waiting { get, .. } in over {
                let report = self.report(context, &name);
                context.reply(get, report.into_iter().collect());
            }
        }
    }

    /// When [`Self::expire`] has something to do.
    pub(crate) fn due(&self) -> Option<Tick> {
        let entries = self.all.values();
        let due = entries.flat_map(|entry| {
            let waiting = entry.waiting.iter().map(|waiting| waiting.until);
            waiting.chain(entry.forgotten())
        });
        due.min()
    }

    /// All that a get selects, as they are.
    pub(crate) fn select(
        &self,
        context: &mut PlannerContext<'_>,
        request: &Request,
    ) -> Vec<Message> {
        let reports = self.all.keys().filter_map(|name| self.report(context, name));
        let reports: Vec<Message> = reports.collect();
        let selects = |message: &Message| request.selects(context.space(), &message.keys().0);
        reports.into_iter().filter(selects).collect()
    }

    /// Answers every waiting get with a reason, and forgets all proposals.
    pub(crate) fn refuse_all(&mut self, context: &mut PlannerContext<'_>, reason: &str) {
        let error = Problem::unavailable("(proposal)", reason).to_json();
        for entry in std::mem::take(&mut self.all).into_values() {
            for waiting in entry.waiting {
                context.reply_error(waiting.get, error.clone());
            }
        }
    }

    fn report(&self, context: &mut PlannerContext<'_>, name: &Name) -> Option<Message> {
        let proposal = self.proposal(context.now(), name)?;
        Some(message(context, proposal))
    }

    /// One of them as it is read; none if it was refused.
    fn proposal(&self, now: Tick, name: &Name) -> Option<Proposal> {
        let entry = self.all.get(name)?;
        let (state, division) = match &entry.progress {
            Progress::Queued | Progress::Running => (ProposalState::Computing, None),
            Progress::Computed { division, .. } => {
                (ProposalState::Ready, Some((**division).clone()))
            }
            Progress::Refused { .. } => return None,
        };
        let ahead = |other: &&Entry| other.is_open() && other.number < entry.number;
        let ahead = self.all.values().filter(ahead).count();
        Some(Proposal {
            operator: name.operator.clone(),
            id: name.id.clone(),
            state,
            asked: entry.asked.clone(),
            ahead: if entry.is_open() { u32::try_from(ahead).unwrap_or(u32::MAX) } else { 0 },
            age_s: now.since(entry.at).as_secs_f64(),
            forgotten_in_s: entry.forgotten().map(|at| at.since(now).as_secs_f64()),
            division,
        })
    }
}

fn message(context: &mut PlannerContext<'_>, proposal: Proposal) -> Message {
    let header = Header {
        fleet: context.fleet().clone(),
        revision: context.next_revision(),
        oldest: None,
        newest: None,
        stages: vec![context.stage(context.now())],
    };
    Message::Proposal(Box::new(ProposalReport { header, proposal }))
}
