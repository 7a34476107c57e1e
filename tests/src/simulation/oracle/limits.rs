//! Limits on the robots of teams hold, or the division and an event say why not.
//!
//! So are pins and bans that the process has published as granted. The limits are those that the publishing process
//! itself has announced. A division that was made before they were changed may be repeated until the first one that obeys
//! the new ones.

use std::collections::BTreeMap;

use muster_model::event::EventKind;
use muster_model::id::TeamId;
use muster_model::settings::ClustererSettings;
use muster_model::teams::{Limited, Teams};
use muster_model::wish::{StandingWish, WishKind, WishList, WishState};
use muster_wire::envelope::AnnouncedSettings;

use super::{Publisher, Verified, breach};

/// What is promised of limits.
const LIMITS: &str = "limits on the robots of teams hold, or the division says why not";

/// What is promised of wishes.
const WISHES: &str = "a wish that is published as active is granted";

/// What is promised of the event.
const EVENT: &str = "an event says that nothing satisfies the limits any more";

/// Most changes of settings that are remembered until a division obeys the last one: more than a storm brings.
const MAX_CHANGES: usize = 64;

/// What is known of the limits of the process that published last.
#[derive(Debug, Default)]
pub(crate) struct Limits {
    publisher: Option<Publisher>,
    /// What other processes have said: two leaders may publish in turn until one hears of the other.
    others: BTreeMap<Publisher, Limits>,
    /// The settings that may still be in force, the newest last.
    announced: Vec<ClustererSettings>,
    /// The wishes that it has published last.
    wishes: Vec<StandingWish>,
    /// Whether a division may be made for wishes alone: there are some, or there were until lately.
    has_wishes: bool,
    /// The term of the last division of the process, and whether that had no conflict; none if it has published none.
    had_no_conflict: Option<(u64, bool)>,
    /// Whether an event must come before the next division.
    awaits_event: bool,
}

impl Limits {
    /// A process publishes: what counts is what it has said before, whoever has published meanwhile.
    fn follow(&mut self, publisher: Publisher) {
        if self.publisher == Some(publisher) {
            return;
        }
        let mut others = std::mem::take(&mut self.others);
        let before = std::mem::take(self);
        others.extend(before.publisher.map(|of| (of, before)));
        *self = others
            .remove(&publisher)
            .unwrap_or_else(|| Self { publisher: Some(publisher), ..Self::default() });
        self.others = others;
    }

    /// A process has announced the settings of the clusterer.
    pub(crate) fn announced(&mut self, publisher: Publisher, announced: &AnnouncedSettings) {
        self.follow(publisher);
        let Ok(settings) = serde_json::from_str::<ClustererSettings>(&announced.settings) else {
            return;
        };
        let same = |last: &ClustererSettings| {
            let limits = (&last.size, &last.team_size, &last.needs);
            limits == (&settings.size, &settings.team_size, &settings.needs)
        };
        if !self.announced.last().is_some_and(same) {
            self.announced.push(settings);
        }
        if self.announced.len() > MAX_CHANGES {
            self.announced.remove(0);
        }
    }

    /// A process has published all wishes. Returns whether they are others than before.
    pub(crate) fn wished(&mut self, publisher: Publisher, list: &WishList) -> bool {
        self.follow(publisher);
        let is_other = self.wishes != list.wishes;
        self.wishes.clone_from(&list.wishes);
        self.has_wishes |= self.has_current_wishes();
        is_other
    }

    fn has_current_wishes(&self) -> bool {
        self.wishes.iter().any(|one| one.state != WishState::Expired)
    }

    /// Whether the next division grants a wish that this one could not: one that waited for a team which is there for the first
    /// time, or one of a robot that had no team because its own was locked.
    pub(crate) fn wish_begins_to_count(&self, before: &Teams, now: &Teams) -> bool {
        let stands = now.limited.as_ref().is_some_and(Limited::stands);
        let is_lock = |one: &StandingWish| one.wish.kind == WishKind::Lock;
        if stands && !now.unassigned.is_empty() && self.wishes.iter().any(is_lock) {
            return true;
        }
        let waits = |one: &&StandingWish| one.state == WishState::Waiting;
        let mut wanted = self.wishes.iter().filter(waits).filter_map(|one| one.wish.team.as_ref());
        let has = |teams: &Teams, id: &TeamId| teams.teams.iter().any(|team| team.id == *id);
        wanted.any(|id| has(now, id) && !has(before, id))
    }

    /// Whether nothing is asked of teams: a team that is cut off may otherwise leave others without what they need.
    pub(crate) fn are_none(&self) -> bool {
        let settings = self.announced.last();
        let asks = |last: &ClustererSettings| has_limits(last) || !last.needs.is_empty();
        !settings.is_some_and(asks) && !self.has_current_wishes()
    }

    /// Whether settings or wishes name a team that there may be only later, by a number that no team has had yet. After a
    /// restart of everything numbers go on higher, so that no team may ever have it.
    pub(crate) fn name_team_to_come(&self, teams: &Teams) -> bool {
        let settings = self.announced.last();
        let limited = settings.into_iter().flat_map(|settings| settings.team_size.keys());
        let needing = settings.into_iter().flat_map(|settings| &settings.needs);
        let needing = needing.filter_map(|need| need.team.as_ref());
        let wished = self.wishes.iter().filter(|one| one.state != WishState::Expired);
        let wished = wished.filter_map(|one| one.wish.team.as_ref());
        let number = |id: &TeamId| id.as_str().strip_prefix('t')?.parse::<u64>().ok();
        let mut named = limited.chain(needing).chain(wished);
        named.any(|id| number(id).is_some_and(|number| number >= teams.next_team))
    }

    /// A pin or a ban that was granted and is not.
    fn broken_wish(&self, teams: &Teams) -> Option<&StandingWish> {
        let granted = self.wishes.iter().filter(|one| one.state == WishState::Active);
        let mut broken = granted.filter(|one| {
            let wished = one.wish.team.as_ref();
            let is_there = teams.teams.iter().any(|team| Some(&team.id) == wished);
            let mut placed = teams
                .assignments()
                .filter(|(robot, _)| is_there && one.wish.robots.contains(robot))
                .map(|(_, team)| team);
            match one.wish.kind {
                WishKind::Pin => placed.any(|team| Some(team) != wished),
                WishKind::Ban => placed.any(|team| Some(team) == wished),
                WishKind::Reserve => {
                    teams.assignments().any(|(robot, _)| one.wish.robots.contains(robot))
                }
                _ => false,
            }
        });
        broken.next()
    }

    /// A process has published an event.
    pub(crate) fn reported(&mut self, publisher: Publisher, kind: &EventKind) {
        self.follow(publisher);
        if matches!(kind, EventKind::Infeasible { .. }) {
            self.awaits_event = false;
        }
    }

    /// A process has published a division.
    pub(crate) fn check(&mut self, publisher: Publisher, teams: &Teams) -> Verified {
        self.follow(publisher);
        let revision = teams.header.revision;
        if self.awaits_event {
            return breach(EVENT, format!("none came before division {revision:?}"));
        }
        let conflict = teams.limited.as_ref().and_then(|limited| limited.conflict.as_deref());
        // The first division of a term goes on from that of another leader, which may have reported the conflict.
        self.awaits_event =
            conflict.is_some() && self.had_no_conflict == Some((revision.term, true));
        self.had_no_conflict = Some((revision.term, conflict.is_none()));
        if conflict.is_none()
            && let Some(one) = self.broken_wish(teams)
        {
            return breach(WISHES, format!("division {revision:?} does not grant {one:?}"));
        }
        if teams.limited.is_none() {
            self.has_wishes = self.has_current_wishes();
        }
        let has_wishes = self.has_wishes;
        let Some(newest) = self.announced.last().cloned() else { return Ok(()) };
        match self.announced.iter().rposition(|settings| obeys(teams, settings, has_wishes)) {
            Some(place) => {
                self.announced.drain(..place);
                Ok(())
            }
            None => {
                let sizes: Vec<(String, usize)> =
                    teams.teams.iter().map(|t| (t.id.to_string(), t.members.len())).collect();
                breach(
                    LIMITS,
                    format!(
                        "division {revision:?} has {sizes:?}, {:?}, under {:?} and {:?}",
                        teams.limited, newest.size, newest.team_size
                    ),
                )
            }
        }
    }
}

/// Whether a division obeys limits, as far as it says that it does.
fn obeys(teams: &Teams, settings: &ClustererSettings, has_wishes: bool) -> bool {
    let Some(limited) = &teams.limited else { return !has_limits(settings) };
    (has_wishes || has_limits(settings) || !settings.needs.is_empty())
        && teams.teams.iter().all(|team| {
            let own = settings.team_size.get(&team.id);
            let least = own.and_then(|own| own.min).or(settings.size.min).unwrap_or(0);
            let most = own.and_then(|own| own.max).or(settings.size.max);
            let robots = team.members.len();
            let few = robots < least as usize && limited.conflict.is_none();
            !few && most.is_none_or(|most| robots <= most as usize)
        })
}

fn has_limits(settings: &ClustererSettings) -> bool {
    let sizes = settings.team_size.values().chain([&settings.size]);
    sizes.into_iter().any(|size| size.min.unwrap_or(0) > 0 || size.max.is_some())
}
