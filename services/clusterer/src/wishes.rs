//! The wishes of operators: what they are, which of them count, and what has become of each.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::embedding::Embedding;
use muster_model::id::{OperatorId, RobotId, TeamId, WishId};
use muster_model::limits::{MAX_GROUP_WISHES, MAX_WISHES};
use muster_model::settings::SettingsError;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, Wish, WishKind, WishState};

use muster_division::rules::{Asked, grants_group};

/// How long a wish stands in the list after it has expired, so that its operator sees what has become of it.
const EXPIRED_WISH_TIME: Duration = Duration::from_secs(3600);

/// What a new wish waits for.
const NEXT_DIVISION: &str = "the next division";

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

    /// Notes what has become of each wish in a division of an embedding. Returns those that have come to another state.
    pub(crate) fn assess(&mut self, teams: &Teams, embedding: &Embedding) -> Vec<WishName> {
        let placed: BTreeMap<RobotId, TeamId> =
            teams.assignments().map(|(robot, team)| (robot.clone(), team.clone())).collect();
        let robots = embedding.robots.iter().zip(&embedding.without_embedding);
        let there: BTreeSet<&RobotId> =
            robots.filter(|(_, without)| !**without).map(|(robot, _)| robot).collect();
        let living: BTreeSet<&TeamId> = teams.teams.iter().map(|team| &team.id).collect();
        let conflict = teams.limited.as_ref().and_then(|limited| limited.conflict.as_deref());
        let mut changed = Vec::new();
        for (name, one) in &mut self.all {
            if one.state == WishState::Expired {
                continue;
            }
            let (state, reason) = match awaited(&one.wish, &there, &living) {
                Some(reason) => (WishState::Waiting, Some(reason)),
                None if is_granted(&one.wish, &placed, &there) => (WishState::Active, None),
                None => match conflict {
                    Some(why) => (WishState::Conflicting, Some(why.to_owned())),
                    // Its team has just come to life again.
                    None => (WishState::Waiting, Some(NEXT_DIVISION.to_owned())),
                },
            };
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

/// What a wish waits for; none if its robots and its team are there.
fn awaited(wish: &Wish, there: &BTreeSet<&RobotId>, living: &BTreeSet<&TeamId>) -> Option<String> {
    if let Some(team) = wish.team.as_ref().filter(|team| !living.contains(*team)) {
        return Some(format!("team {team} is not there"));
    }
    let needed = if wish.kind.is_of_group() { 2 } else { 1 };
    let absent: Vec<&RobotId> =
        wish.robots.iter().filter(|robot| !there.contains(*robot)).collect();
    if wish.kind != WishKind::Lock && wish.robots.len() - absent.len() < needed {
        let names: Vec<String> = absent.iter().map(ToString::to_string).collect();
        let verb = if names.len() == 1 { "is" } else { "are" };
        return Some(format!("{} {verb} not there", muster_division::words::list(&names)));
    }
    None
}

/// Whether a division grants a wish to those of its robots that are there.
fn is_granted(wish: &Wish, placed: &BTreeMap<RobotId, TeamId>, there: &BTreeSet<&RobotId>) -> bool {
    let mut robots = wish.robots.iter().filter(|robot| there.contains(*robot));
    match wish.kind {
        WishKind::Pin => robots.all(|robot| placed.get(robot) == wish.team.as_ref()),
        WishKind::Ban => robots.all(|robot| placed.get(robot) != wish.team.as_ref()),
        WishKind::Together | WishKind::Apart => grants_group(wish, placed),
        WishKind::Reserve => robots.all(|robot| !placed.contains_key(robot)),
        // Who stays in the team is in it.
        WishKind::Lock => true,
    }
}
