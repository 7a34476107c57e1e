//! Gets that put, withdraw and list wishes, and what is published of them.

use std::time::Duration;

use muster_model::content::Checked;
use muster_model::event::{EventKind, Severity};
use muster_model::header::{Header, Revision};
use muster_model::role::ReplicaState;
use muster_model::settings::SettingsError;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, WishList, WishReport, WishState};
use muster_service::Get;
use muster_wire::command::STARTING;
use muster_wire::json::{Problem, ProblemCode};
use muster_wire::wish::{WishChange, changed_by, decode};
use muster_wire::{Key, Message, Request};

use super::{Clusterer, Context};
use crate::wishes::{WishBook, WishName};

/// How often the wishes are published again, so that a standby that missed a change has them soon.
const REPUBLISH_TIME: Duration = Duration::from_secs(2);

/// What an operator reads who waited for a wish to be on disk when the instance stood down.
pub(super) const NO_LONGER_LEADS: &str = "another instance leads now; ask again";

/// Somebody waits until a wish is on disk.
#[derive(Debug)]
pub(super) struct Confirmation {
    pub(super) get: Get,
    /// The number of the write that holds the wish.
    write: u64,
    answer: StandingWish,
}

/// What is wrong with a change, as its field and the problem.
struct Refusal {
    code: ProblemCode,
    field: String,
    problem: String,
}

fn refusal<T>(field: &str, problem: impl Into<String>) -> Result<T, Refusal> {
    Err(Refusal { code: ProblemCode::Refused, field: field.to_owned(), problem: problem.into() })
}

impl Clusterer {
    /// A get that puts or withdraws a wish.
    pub(super) fn change_wish(&mut self, context: &mut Context<'_>, get: Get) {
        let key = get.request.exact_key(context.space()).filter(|_| get.request.is_exact());
        let Some(Key::Wish(operator, id)) = key else {
            let problem = "a payload belongs on exactly one key wish/{operator}/{id}";
            return context.reply_error(get, Problem::new("(key)", problem).to_json());
        };
        if context.replica_state() == ReplicaState::Standby {
            // The leader answers.
            return context.reply(get, Vec::new());
        }
        let name = (operator, id);
        let payload = get.request.payload.clone().unwrap_or_default();
        match self.changed(context, &name, &payload) {
            Ok((book, answer)) => {
                self.wishes = book;
                context.count("wishes_changed");
                self.publish_wishes(context, &[(name, answer.state)]);
                self.keep(context);
                let write = self.keeping.writes_begun();
                self.confirmations.push_back(Confirmation { get, write, answer });
                if self.keeping.writes_ended() >= write {
                    // There is nothing to write: it is on the disk as it is, or could not be written.
                    self.confirm_wishes(context, !self.keeping.has_failed());
                }
                self.consider(context);
            }
            Err(Refusal { code, field, problem }) => {
                context.reply_error(get, Problem::with_code(code, &field, &problem).to_json());
            }
        }
    }

    /// Does what an earlier leader has confirmed to operators since the list that this instance begins with: that leader
    /// may have been lost before its next list had arrived, and the outcomes of the commands had.
    pub(super) fn recover_wishes(&mut self, context: &mut Context<'_>) {
        let known = self.keeping.wishes().map(|list| list.header.revision).unwrap_or_default();
        for outcome in context.carried_out_after(known) {
            let Some((operator, id, change)) = changed_by(&outcome) else { continue };
            let name = (operator, id);
            let is_done = match change {
                // In the list already, with what has become of it.
                WishChange::Put(wish)
                    if self.wishes.get(&name).is_some_and(|one| one.wish == wish) =>
                {
                    false
                }
                WishChange::Put(wish) => self.wishes.put(name, wish).is_ok(),
                WishChange::Withdraw => self.wishes.withdraw(&name).is_some(),
            };
            if is_done {
                context.count("wishes_recovered");
            }
        }
    }

    /// All wishes with a change, and the one that it is about.
    fn changed(
        &self,
        context: &Context<'_>,
        name: &WishName,
        payload: &[u8],
    ) -> Result<(WishBook, StandingWish), Refusal> {
        if !context.has_term() {
            return Err(Refusal {
                code: ProblemCode::Unavailable,
                field: "(wish)".to_owned(),
                problem: STARTING.to_owned(),
            });
        }
        let code = ProblemCode::Refused;
        let wrong =
            |error: SettingsError| Refusal { code, field: error.field, problem: error.problem };
        let mut book = self.wishes.clone();
        let wish = match decode(payload).map_err(wrong)? {
            WishChange::Put(wish) => wish,
            WishChange::Withdraw => {
                return match book.withdraw(name) {
                    Some(withdrawn) => Ok((book, withdrawn)),
                    None => refusal("(wish)", format!("{}/{} is not there", name.0, name.1)),
                };
            }
        };
        let seconds = context.now().as_seconds();
        if wish.expires.is_some_and(|expires| expires <= seconds) {
            return refusal("expires", format!("must be after now, which is {seconds:.0}"));
        }
        book.put(name.clone(), wish).map_err(wrong)?;
        let settings = context.settings();
        let needs = self.needs(settings);
        let asked = muster_division::rules::TeamRules::of(settings, book.asked(), needs);
        let before = self.rules(settings);
        let conflict = asked.and_then(|rules| {
            self.new_conflict(context.now(), settings, &rules, settings, before.as_ref())
        });
        if let Some(conflict) = conflict {
            let remedy = "withdraw a wish, or change a limit";
            return refusal("(wish)", format!("{conflict}; {remedy}"));
        }
        match book.get(name).cloned() {
            Some(one) => Ok((book, one)),
            None => refusal("(wish)", "is not there"),
        }
    }

    /// Answers those whose wishes are on disk, or are not.
    pub(super) fn confirm_wishes(&mut self, context: &mut Context<'_>, is_on_disk: bool) {
        let ended = self.keeping.writes_ended();
        while self.confirmations.front().is_some_and(|first| first.write <= ended) {
            let Some(Confirmation { get, answer, .. }) = self.confirmations.pop_front() else {
                return;
            };
            if is_on_disk {
                let report = WishReport { header: self.wish_header(context), wish: answer };
                context.reply(get, vec![Message::Wish(Box::new(report))]);
            } else {
                let problem = "it counts, and could not be stored: a restart forgets it";
                context.reply_error(get, Problem::unstored("(wish)", problem).to_json());
            }
        }
    }

    /// What a get without a payload is answered with.
    pub(super) fn select_wishes(&self, context: &Context<'_>, request: &Request) -> Vec<Message> {
        let space = context.space();
        let Some(list) = self.keeping.wishes() else { return Vec::new() };
        if !context.has_term() && context.replica_state() != ReplicaState::Standby {
            return Vec::new();
        }
        let mut messages = Vec::new();
        if request.selects(space, &Key::Wishes) || request.selects(space, &Key::JsonWishes) {
            messages.push(Message::Wishes(list.clone()));
        }
        // A standby knows the list, and the leader what has become of each.
        if context.has_term() {
            let selected = list.wishes.iter().filter(|one| {
                request.selects(space, &Key::Wish(one.operator.clone(), one.id.clone()))
            });
            messages.extend(selected.map(|one| {
                let report = WishReport { header: list.header.clone(), wish: one.clone() };
                Message::Wish(Box::new(report))
            }));
        }
        messages
    }

    /// The header of the list, or of an answer before there is one.
    fn wish_header(&self, context: &Context<'_>) -> Header {
        let none = || Header {
            fleet: context.fleet().clone(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: vec![context.stage(context.now())],
        };
        self.keeping.wishes().map_or_else(none, |list| list.header.clone())
    }

    /// Publishes all wishes, and events of those that have come to another state.
    pub(super) fn publish_wishes(
        &mut self,
        context: &mut Context<'_>,
        changed: &[(WishName, WishState)],
    ) {
        // An empty list says that none counts: the last one was withdrawn while nothing could be published, or a standby has
        // one on its disk that a leader put which has lost it. The first list of a term may be as old as the term.
        let last = context.revision();
        let is_said = |list: &Checked<WishList>| {
            let Revision { term, epoch } = list.header.revision;
            list.wishes.is_empty() && term == last.term && epoch == 0
        };
        let is_empty = self.wishes.is_empty() && changed.is_empty();
        if is_empty && self.keeping.wishes().is_some_and(is_said) {
            return;
        }
        let is_first = is_empty && last.epoch == 0;
        let revision = if is_first { last } else { context.next_revision() };
        let now = context.now();
        let header = Header {
            fleet: context.fleet().clone(),
            revision,
            oldest: None,
            newest: None,
            stages: vec![context.stage(now)],
        };
        let list = WishList { header, wishes: self.wishes.list() };
        let list = Checked::new_unchecked(list);
        self.keeping.keep_wishes(list.clone());
        self.wishes_published = Some(now);
        context.publish(Message::Wishes(list));
        for ((operator, id), state) in changed {
            let severity = match state {
                WishState::Conflicting => Severity::Warning,
                _ => Severity::Info,
            };
            let (operator, id, state) = (operator.clone(), id.clone(), *state);
            context.publish_event(severity, EventKind::WishChanged { operator, id, state });
        }
    }

    /// Notes what has become of the wishes in a division that was published, and publishes them if that has changed or
    /// was long ago.
    pub(super) fn assess_wishes(&mut self, context: &mut Context<'_>, teams: &Teams) {
        if self.wishes.is_empty() {
            return;
        }
        let Some(embedding) = self.divided.clone() else { return };
        let before = self.wishes.clone();
        let changed = self.wishes.assess(teams, &embedding);
        let is_due = |at: Tick| context.now().since(at) >= REPUBLISH_TIME;
        if self.wishes != before || self.wishes_published.is_none_or(is_due) {
            let states: Vec<(WishName, WishState)> = changed
                .into_iter()
                .filter_map(|name| {
                    let state = self.wishes.get(&name)?.state;
                    Some((name, state))
                })
                .collect();
            self.publish_wishes(context, &states);
        }
    }

    /// Lets wishes expire.
    pub(super) fn expire_wishes(&mut self, context: &mut Context<'_>) {
        if !context.has_term() || self.wishes.due().is_none_or(|due| context.now() < due) {
            return;
        }
        let (is_changed, expired) = self.wishes.expire(context.now());
        if is_changed {
            let states: Vec<_> =
                expired.into_iter().map(|name| (name, WishState::Expired)).collect();
            self.publish_wishes(context, &states);
            self.consider(context);
        }
    }
}
