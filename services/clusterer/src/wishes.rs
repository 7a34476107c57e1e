//! The wishes of operators: what they are, which of them count, and what has become of each.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::embedding::Embedding;
use muster_model::id::{OperatorId, WishId};
use muster_model::limits::{MAX_GROUP_WISHES, MAX_WISHES};
use muster_model::settings::SettingsError;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, Wish, WishState};

use muster_division::rules::Asked;
use muster_division::wishes::{Assessment, NEXT_DIVISION};

/// How long a wish stands in the list after it has expired, so that its operator sees what has become of it.
const EXPIRED_WISH_TIME: Duration = Duration::from_secs(3600);

/// Names a wish.
pub(crate) type WishName = (OperatorId, WishId);

/// All wishes.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct WishBook {
    all: BTreeMap<WishName, StandingWish>,
}

impl WishBook {
    /// The wishes of a list.
    pub(crate) fn of(list: &[StandingWish]) -> Self {
        let named = |one: &StandingWish| ((one.operator.clone(), one.id.clone()), one.clone());
        Self { all: list.iter().map(named).collect() }
    }

    /// All of them, ordered by operator and id.
    pub(crate) fn list(&self) -> Vec<StandingWish> {
        self.all.values().cloned().collect()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// One of them.
    pub(crate) fn get(&self, name: &WishName) -> Option<&StandingWish> {
        self.all.get(name)
    }

    /// Those that count: all that have not expired.
    pub(crate) fn asked(&self) -> Vec<Asked> {
        Asked::of(self.all.values())
    }

    /// Puts a wish, in place of the one with its name.
    ///
    /// # Errors
    /// If there are too many.
    pub(crate) fn put(&mut self, name: WishName, wish: Wish) -> Result<(), SettingsError> {
        let others = || self.all.iter().filter(|(other, _)| **other != name).map(|(_, one)| one);
        if others().count() >= MAX_WISHES {
            let problem = format!("there may be {MAX_WISHES} at most: withdraw some");
            return Err(SettingsError::new("(wish)", problem));
        }
        let groups = others().filter(|one| one.wish.kind.is_of_group()).count();
        if wish.kind.is_of_group() && groups >= MAX_GROUP_WISHES {
            let problem = format!(
                "there may be {MAX_GROUP_WISHES} of together and apart at most: withdraw some"
            );
            return Err(SettingsError::new("(wish)", problem));
        }
        let (operator, id) = name.clone();
        let reason = Some(NEXT_DIVISION.to_owned());
        let one = StandingWish { operator, id, wish, state: WishState::Waiting, reason };
        self.all.insert(name, one);
        Ok(())
    }

    /// Takes a wish away.
    pub(crate) fn withdraw(&mut self, name: &WishName) -> Option<StandingWish> {
        let one = self.all.remove(name)?;
        Some(StandingWish { state: WishState::Withdrawn, reason: None, ..one })
    }

    /// Lets those expire whose time is over, and forgets those that expired long ago. Returns whether anything changed,
    /// and those that expired.
    pub(crate) fn expire(&mut self, now: Tick) -> (bool, Vec<WishName>) {
        let mut expired = Vec::new();
        for (name, one) in &mut self.all {
            if one.state != WishState::Expired && expiry(one).is_some_and(|at| now >= at) {
                (one.state, one.reason) = (WishState::Expired, None);
                expired.push(name.clone());
            }
        }
        let count = self.all.len();
        self.all.retain(|_, one| {
            one.state != WishState::Expired
                || expiry(one).is_some_and(|at| now < at.after(EXPIRED_WISH_TIME))
        });
        (self.all.len() != count || !expired.is_empty(), expired)
    }

    /// When the next one expires or is forgotten.
    pub(crate) fn due(&self) -> Option<Tick> {
        let due = |one: &StandingWish| {
            let at = expiry(one)?;
            Some(if one.state == WishState::Expired { at.after(EXPIRED_WISH_TIME) } else { at })
        };
        self.all.values().filter_map(due).min()
    }

    /// Notes of those that are said to be granted what becomes of them by the division that an instance goes on from: it may
    /// be another one than that which the list is about.
    pub(crate) fn check_granted(&mut self, division: Option<&Teams>, divided: Option<&Embedding>) {
        let assessment = division.map(|division| match divided {
            Some(embedding) => Assessment::of(division, embedding),
            None => Assessment::of_last(division),
        });
        for one in self.all.values_mut().filter(|one| one.state == WishState::Active) {
            let next = || (WishState::Waiting, Some(NEXT_DIVISION.to_owned()));
            let last = assessment.as_ref().map(|assessment| assessment.state(&one.wish));
            (one.state, one.reason) = last.unwrap_or_else(next);
        }
    }

    /// Notes what has become of each wish in a division of an embedding. Returns those that have come to another state.
    pub(crate) fn assess(&mut self, teams: &Teams, embedding: &Embedding) -> Vec<WishName> {
        let assessment = Assessment::of(teams, embedding);
        let mut changed = Vec::new();
        for (name, one) in &mut self.all {
            if one.state == WishState::Expired {
                continue;
            }
            let (state, reason) = assessment.state(&one.wish);
            if one.state != state {
                changed.push(name.clone());
            }
            (one.state, one.reason) = (state, reason);
        }
        changed
    }
}

/// When a wish expires.
fn expiry(one: &StandingWish) -> Option<Tick> {
    let seconds = Duration::try_from_secs_f64(one.wish.expires?).ok()?;
    Some(Tick(0).after(seconds))
}
