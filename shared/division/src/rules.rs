//! What operators ask of divisions: how many robots each team has, which skills it needs, and which robots are to be in
//! which, together, apart, or in none.
//!
//! A team is a column of the assignment, under the id that it has or will have, so that its limits are its own before
//! the robots are divided.

mod holding;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, SkillId, TeamId};
use muster_model::limits::MAX_CONFLICT_LENGTH;
use muster_model::settings::{ClustererSettings, TeamSize};
use muster_model::teams::{Limited, Teams};
use muster_model::wish::{StandingWish, Wish, WishKind, WishState};
use muster_numeric::assignment::{
    self as numeric, Assigner, Bounds, Column, CostMatrix, Pair, Relation, Rule, Rules, RulesError,
    ValidRules, ValidWishes, WishesError, assign_with_wishes, is_grantable,
};

use crate::identity::{self, Memory, Numbers};
use crate::needs::{NeedLimits, Needs};
use crate::seats::last_teams;

/// Most flows to find out whether the wishes of groups can be granted: a number and no time, so that a replay is the
/// same.
const GROUP_NODES: usize = 64;

/// A team of the next division.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TeamColumn {
    /// Its id.
    pub(crate) team: TeamId,
    /// The team that its robots were in last; none if it is new.
    pub(crate) last: Option<TeamId>,
}

/// The teams of a division.
pub(crate) struct Columns {
    /// Ordered by id.
    pub(crate) columns: Vec<TeamColumn>,
    /// Teams that robots were in and in which none may be.
    pub(crate) closed: BTreeSet<TeamId>,
    /// Whether a team that rules name was left out for one that they do not name, as its limits do not fit.
    pub(crate) is_named_replaced: bool,
}

/// A wish that counts, under the name that operators know it by.
#[derive(Debug, Clone, PartialEq)]
pub struct Asked {
    /// The operator and the id.
    pub name: String,
    /// What is wished.
    pub wish: Wish,
}

impl Asked {
    /// Those of standing wishes that count: all that have not expired.
    pub fn of<'a>(wishes: impl Iterator<Item = &'a StandingWish>) -> Vec<Self> {
        let counts = wishes.filter(|one| one.state != WishState::Expired);
        counts
            .map(|one| Self {
                name: format!("{}/{}", one.operator, one.id),
                wish: Wish { expires: None, note: None, ..one.wish.clone() },
            })
            .collect()
    }
}

/// A pair of a robot and a team, and the place of the wish that asks for it.
struct Tie {
    pair: Pair,
    wish: usize,
}

/// Groups of robots, and needs that are no limits of classes.
pub(crate) struct Groups {
    pub(crate) valid: ValidWishes,
    /// The place of the wish that asks for each group.
    wishes: Vec<usize>,
    /// The skill and the team of each need.
    needs: Vec<(SkillId, TeamId)>,
}

impl Groups {
    /// Whether nothing needs a search.
    fn is_empty(&self) -> bool {
        self.wishes.is_empty() && self.needs.is_empty()
    }
}

/// What divisions have to respect.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TeamRules {
    size: TeamSize,
    of_team: BTreeMap<TeamId, TeamSize>,
    wishes: Vec<Asked>,
    pub(crate) needs: Needs,
    /// The teams that robots of locked teams stay in, once it is known who they are.
    locked: BTreeMap<RobotId, TeamId>,
}

impl TeamRules {
    /// The rules of some settings, of the wishes that count and of the needs; none if these ask for nothing.
    pub fn of(settings: &ClustererSettings, wishes: Vec<Asked>, needs: Needs) -> Option<Self> {
        if !settings.has_limits() && wishes.is_empty() && needs.is_empty() {
            return None;
        }
        let of_team = settings.team_size.keys().map(|id| (id.clone(), settings.size_of(id)));
        let locked = BTreeMap::new();
        Some(Self { size: settings.size, of_team: of_team.collect(), wishes, needs, locked })
    }

    /// The rules with other needs.
    pub fn with_needs(&self, needs: Needs) -> Self {
        Self { needs, ..self.clone() }
    }

    /// The rules without the wishes for some teams that a division does not grant.
    pub(crate) fn without_new_wishes(&self, teams: &BTreeSet<&TeamId>, found: &Teams) -> Self {
        let placed: BTreeMap<&RobotId, &TeamId> = found.assignments().collect();
        let counts = |asked: &Asked| {
            let Some(team) = asked.wish.team.as_ref().filter(|team| teams.contains(team)) else {
                return true;
            };
            let mut places = asked.wish.robots.iter().map(|robot| placed.get(robot) == Some(&team));
            match asked.wish.kind {
                WishKind::Pin => places.all(|is_there| is_there),
                WishKind::Ban => places.all(|is_there| !is_there),
                _ => true,
            }
        };
        let mut rules = self.clone();
        rules.wishes.retain(counts);
        rules
    }

    /// Whether other rules ask for the same, whichever robots can fill needs.
    pub fn asks_as(&self, other: &Self) -> bool {
        self.needs.asks_as(&other.needs) && *self == other.with_needs(self.needs.clone())
    }

    /// The rules with the robots that locked teams have, by the last team of each robot. Those that come back are locked in theirs
    /// as far as it has places left: others may have been put there meanwhile, as its limits or needs demanded it.
    pub fn resolved(
        mut self,
        previous: Option<&Teams>,
        memory: &Memory,
        embedding: &Embedding,
    ) -> Self {
        let locks: BTreeSet<TeamId> = self
            .wishes
            .iter()
            .filter(|asked| asked.wish.kind == WishKind::Lock)
            .filter_map(|asked| asked.wish.team.clone())
            .collect();
        let Some(previous) = previous.filter(|_| !locks.is_empty()) else { return self };
        let robots = embedding.robots.iter().zip(&embedding.without_embedding);
        let robots = robots.filter(|(_, without)| !**without).map(|(robot, _)| robot);
        let last = last_teams(previous, memory, embedding);
        // Whoever has no team while nothing satisfies the rules is in no locked team any more, whatever is remembered.
        let stands = previous.limited.as_ref().is_some_and(Limited::stands);
        let is_left_out = |robot: &RobotId| stands && previous.unassigned.contains(robot);
        let is_locked = |(robot, team): (&RobotId, Option<&TeamId>)| {
            let team = team.filter(|team| locks.contains(*team) && !is_left_out(robot))?;
            Some((robot.clone(), team.clone()))
        };
        let divided: BTreeSet<&RobotId> = previous.assignments().map(|(robot, _)| robot).collect();
        let (members, returning): (Vec<_>, Vec<_>) =
            robots.zip(last).filter_map(is_locked).partition(|(robot, _)| divided.contains(robot));
        let mut taken: BTreeMap<TeamId, usize> = BTreeMap::new();
        for (_, team) in &members {
            *taken.entry(team.clone()).or_default() += 1;
        }
        let has_place = |(_, team): &(RobotId, TeamId)| {
            let taken = taken.entry(team.clone()).or_default();
            *taken += 1;
            *taken <= self.bounds(team).upper
        };
        let returning: Vec<_> = returning.into_iter().filter(has_place).collect();
        self.locked = members.into_iter().chain(returning).collect();
        self
    }

    /// The rows of the robots that may be in a team: those with an embedding that are not kept in reserve.
    pub(crate) fn rows(&self, embedding: &Embedding) -> Vec<usize> {
        let reserved = self.reserved();
        let is_placed = |row: &usize| {
            !embedding.without_embedding[*row] && !reserved.contains(&embedding.robots[*row])
        };
        (0..embedding.robots.len()).filter(is_placed).collect()
    }

    /// The robots that are in no team on purpose.
    pub fn reserved(&self) -> BTreeSet<&RobotId> {
        let reserves = self.wishes.iter().filter(|asked| asked.wish.kind == WishKind::Reserve);
        reserves.flat_map(|asked| &asked.wish.robots).collect()
    }

    /// Whether a limit, a need or a wish names a team.
    pub(crate) fn names(&self, team: &TeamId) -> bool {
        self.of_team.contains_key(team) || self.needs.name(team) || self.is_wished(team)
    }

    /// The teams of a division that wishes or needs name.
    pub fn wished(&self, division: Option<&Teams>) -> BTreeSet<TeamId> {
        let teams = division.into_iter().flat_map(|division| &division.teams);
        let is_named = |id: &&TeamId| self.is_wished(id) || self.needs.name(id);
        teams.map(|team| &team.id).filter(is_named).cloned().collect()
    }

    /// Whether a team may have so many robots.
    pub(crate) fn has_room(&self, team: &TeamId, robots: usize) -> bool {
        let bounds = self.bounds(team);
        (bounds.lower..=bounds.upper).contains(&robots)
    }

    /// Whether a wish names a team.
    pub fn is_wished(&self, team: &TeamId) -> bool {
        self.wishes.iter().any(|asked| asked.wish.team.as_ref() == Some(team))
    }

    /// Pairs of robots and teams that wishes ask for. Those for robots or teams that are not there wait.
    fn ties(&self, columns: &[TeamId], robots: &[&RobotId]) -> Vec<Tie> {
        if self.wishes.is_empty() {
            return Vec::new();
        }
        let row_of: BTreeMap<&RobotId, usize> = robots.iter().copied().zip(0..).collect();
        let mut ties = Vec::new();
        for (wish, asked) in self.wishes.iter().enumerate() {
            let Some(team) = &asked.wish.team else { continue };
            let Some(place) = columns.iter().position(|column| column == team) else { continue };
            let column = Column::Team(place);
            let named = asked.wish.robots.iter().filter_map(|robot| row_of.get(robot).copied());
            match asked.wish.kind {
                WishKind::Pin => {
                    ties.extend(
                        named.map(|robot| Tie { pair: Pair::Forced { robot, column }, wish }),
                    );
                }
                WishKind::Ban => {
                    let tie = |robot| Tie { pair: Pair::Forbidden { robot, column }, wish };
                    ties.extend(named.map(tie));
                }
                WishKind::Lock => {
                    let stays = |(_, locked): &(&RobotId, &TeamId)| *locked == team;
                    let members = self.locked.iter().filter(stays);
                    let members = members.filter_map(|(robot, _)| row_of.get(robot).copied());
                    ties.extend(
                        members.map(|robot| Tie { pair: Pair::Forced { robot, column }, wish }),
                    );
                }
                WishKind::Together | WishKind::Apart | WishKind::Reserve => {}
            }
        }
        ties
    }

    /// The groups of robots that are to be together or apart, and needs that are no limits of classes. A group of which
    /// fewer than two robots are there waits.
    pub(crate) fn groups(
        &self,
        rules: &ValidRules,
        columns: &[TeamId],
        robots: &[&RobotId],
    ) -> Result<Groups, WishesError> {
        let (mut all, mut places) = (Vec::new(), Vec::new());
        if self.wishes.iter().any(|asked| asked.wish.kind.is_of_group()) {
            let row_of: BTreeMap<&RobotId, usize> = robots.iter().copied().zip(0..).collect();
            for (place, asked) in self.wishes.iter().enumerate() {
                let relation = match asked.wish.kind {
                    WishKind::Together => Relation::Together,
                    WishKind::Apart => Relation::Apart,
                    _ => continue,
                };
                let named = asked.wish.robots.iter();
                let robots: Vec<usize> =
                    named.filter_map(|robot| row_of.get(robot).copied()).collect();
                if robots.len() > 1 {
                    all.push(numeric::Wish { relation, robots, price: None });
                    places.push(place);
                }
            }
        }
        let NeedLimits { needs, names, .. } = self.needs.limits(columns, robots);
        let valid = numeric::Wishes { wishes: all, needs }.check(rules)?;
        Ok(Groups { valid, wishes: places, needs: names })
    }

    /// How many robots a team may have.
    pub(crate) fn bounds(&self, team: &TeamId) -> Bounds {
        let size = self.of_team.get(team).copied().unwrap_or(self.size);
        let upper = size.max.map_or(usize::MAX, |max| max as usize);
        Bounds::new(size.least() as usize, upper)
    }

    /// The teams of the next division. Of those that robots were in so many stay as there are to be: teams that rules
    /// name before others, then those with most robots. New ones get the next numbers, and so do teams that ended, as long
    /// as it is not known whether most of their robots are in them again. A team in which no robot may be any more makes
    /// room for another one, and so does one whose limits leave robots without a place, or places without robots. Where the last
    /// division is to stand there are no `robots` to look at: no team makes room, and those of that division go before all others.
    pub(crate) fn columns(
        &self,
        teams: usize,
        robots: &[&RobotId],
        last: &[Option<&TeamId>],
        previous: Option<&Teams>,
        memory: &Memory,
    ) -> Columns {
        let living: BTreeSet<&TeamId> =
            previous.into_iter().flat_map(|last| &last.teams).map(|team| &team.id).collect();
        let mut members: BTreeMap<&TeamId, usize> = BTreeMap::new();
        for id in last.iter().flatten() {
            *members.entry(id).or_default() += 1;
        }
        let mut known: Vec<(&TeamId, usize)> = members.into_iter().collect();
        // Whoever comes back puts no robots out of their team while nothing satisfies the rules.
        let waits = |id: &TeamId| robots.is_empty() && !living.contains(id);
        known.sort_by_key(|&(id, count)| {
            (waits(id), !self.names(id), Reverse(count), identity::order(id))
        });
        let mut closed = BTreeSet::new();
        let mut is_named_left_out = false;
        // Each turn but the last leaves out a team, so there are no more turns than teams.
        loop {
            let mut numbers = Numbers::after(previous, memory);
            let column = |(id, _): &(&TeamId, usize)| {
                let team = if living.contains(*id) { (*id).clone() } else { numbers.next() };
                TeamColumn { team, last: Some((*id).clone()) }
            };
            let mut columns: Vec<TeamColumn> = known.iter().take(teams).map(column).collect();
            while columns.len() < teams {
                columns.push(TeamColumn { team: numbers.next(), last: None });
            }
            columns.sort_by(|left, right| {
                identity::order(&left.team).cmp(&identity::order(&right.team))
            });
            if let Some(id) = self.closed(&columns, robots) {
                known.retain(|(other, _)| **other != id);
                closed.insert(id);
                continue;
            }
            let others: Vec<&TeamId> = known.iter().skip(teams).map(|(id, _)| *id).collect();
            let Some(id) = self.misfit(&columns, &others, robots.len()) else {
                let is_unnamed = |column: &TeamColumn| !self.names(&column.team);
                let is_named_replaced = is_named_left_out && columns.iter().any(is_unnamed);
                return Columns { columns, closed, is_named_replaced };
            };
            known.retain(|(other, _)| **other != id);
            is_named_left_out |= self.names(&id);
        }
    }

    /// Of the teams that robots were in the one whose limits fit so many robots least, where they do not fit and one of the
    /// others fits better. Teams that wishes name stay.
    fn misfit(&self, columns: &[TeamColumn], others: &[&TeamId], robots: usize) -> Option<TeamId> {
        let all = || columns.iter().map(|column| self.bounds(&column.team));
        let known = || {
            let last =
                columns.iter().filter_map(|column| Some((&column.team, column.last.clone()?)));
            last.filter(|(_, last)| !self.is_wished(last))
        };
        let others = || others.iter().map(|id| self.bounds(id));
        let most = all().fold(0_usize, |most, bounds| most.saturating_add(bounds.upper));
        let least = all().fold(0_usize, |least, bounds| least.saturating_add(bounds.lower));
        if robots > most {
            let room = others().map(|bounds| bounds.upper).max()?;
            let tight = known().min_by_key(|(team, _)| self.bounds(team).upper);
            return tight.filter(|(team, _)| self.bounds(team).upper < room).map(|(_, id)| id);
        }
        if robots > 0 && robots < least {
            let need = others().map(|bounds| bounds.lower).min()?;
            let large = known().max_by_key(|(team, _)| self.bounds(team).lower);
            return large.filter(|(team, _)| self.bounds(team).lower > need).map(|(_, id)| id);
        }
        None
    }

    /// The first team that robots were in and in which none may be: each is banned from there, or must be in another one.
    fn closed(&self, columns: &[TeamColumn], robots: &[&RobotId]) -> Option<TeamId> {
        let ids: Vec<TeamId> = columns.iter().map(|column| column.team.clone()).collect();
        let ties = self.ties(&ids, robots);
        if ties.is_empty() || robots.is_empty() {
            return None;
        }
        let may_be = |robot: usize, at: usize| {
            ties.iter().all(|tie| match tie.pair {
                Pair::Forced { robot: named, column } => {
                    named != robot || column == Column::Team(at)
                }
                Pair::Forbidden { robot: named, column } => {
                    named != robot || column != Column::Team(at)
                }
            })
        };
        let is_closed = |at: usize| !(0..robots.len()).any(|robot| may_be(robot, at));
        let known = columns.iter().zip(0..).filter(|(_, at)| is_closed(*at));
        known.filter_map(|(column, _)| column.last.clone()).next()
    }

    /// The rules of the assignment of robots.
    pub(crate) fn assignment(
        &self,
        columns: &[TeamId],
        robots: &[&RobotId],
    ) -> Result<ValidRules, RulesError> {
        let teams = columns.iter().map(|id| self.bounds(id)).collect();
        let pairs = self.ties(columns, robots).into_iter().map(|tie| tie.pair).collect();
        let NeedLimits { classes, class_limits, .. } = self.needs.limits(columns, robots);
        Rules { robots: robots.len(), teams, pairs, classes, class_limits, ..Rules::default() }
            .check()
    }

    /// The rules while nothing satisfies all of them: no team has more robots than it may have or a robot that must not be
    /// there, the other robots stay in their last team, and those that have no place have no team.
    pub(crate) fn relaxed(
        &self,
        columns: &[TeamId],
        robots: &[&RobotId],
        stay: &[Option<Column>],
    ) -> Result<ValidRules, RulesError> {
        let upper = |id: &TeamId| Bounds::at_most(self.bounds(id).upper);
        let bans = self.ties(columns, robots).into_iter().map(|tie| tie.pair);
        let bans: BTreeSet<Pair> =
            bans.filter(|pair| matches!(pair, Pair::Forbidden { .. })).collect();
        let stays = |(robot, column): (usize, &Option<Column>)| {
            let column = (*column)?;
            let is_banned = bans.contains(&Pair::Forbidden { robot, column });
            (!is_banned).then_some(Pair::Forced { robot, column })
        };
        let pairs = stay.iter().enumerate().filter_map(stays).chain(bans.iter().copied()).collect();
        let teams = columns.iter().map(upper).collect();
        let reserve = Some(Bounds::ANY);
        Rules { robots: robots.len(), teams, reserve, pairs, ..Rules::default() }.check()
    }

    /// Whether something satisfies the rules for these robots in these teams.
    pub(crate) fn is_possible(&self, columns: &[TeamId], robots: &[&RobotId]) -> bool {
        let bounds = columns.iter().map(|id| self.bounds(id));
        let (least, most) = bounds.fold((0_usize, 0_usize), |(least, most), bounds| {
            (least.saturating_add(bounds.lower), most.saturating_add(bounds.upper))
        });
        (least..=most).contains(&robots.len())
            && (self.wishes.is_empty() && self.needs.is_empty()
                || self.is_satisfiable(columns, robots))
    }

    /// Whether something satisfies all rules, as far as a bounded search tells.
    fn is_satisfiable(&self, columns: &[TeamId], robots: &[&RobotId]) -> bool {
        if self.conflict_of_reserve().is_some() || self.needs.shortage(columns, robots).is_some() {
            return false;
        }
        let Ok(rules) = self.assignment(columns, robots) else { return false };
        if rules.conflict().is_some() {
            return false;
        }
        let Ok(groups) = self.groups(&rules, columns, robots) else { return false };
        groups.is_empty()
            || is_grantable(&mut Assigner::new(), &rules, &groups.valid, GROUP_NODES)
                .is_ok_and(|is_granted| is_granted == Some(true))
    }

    /// Why nothing satisfies the rules for these robots; none if something does.
    pub(crate) fn conflict(&self, columns: &[TeamId], robots: &[&RobotId]) -> Option<String> {
        self.conflict_of_reserve()
            .or_else(|| self.needs.shortage(columns, robots))
            .or_else(|| match self.assignment(columns, robots) {
                Ok(rules) => self.conflict_within(&rules, columns, robots),
                Err(error) => Some(error.to_string()),
            })
            .map(|text| text.chars().take(MAX_CONFLICT_LENGTH).collect())
    }

    /// A robot that is to be in no team and in one.
    fn conflict_of_reserve(&self) -> Option<String> {
        let reserved = self.reserved();
        for asked in &self.wishes {
            if !matches!(asked.wish.kind, WishKind::Pin | WishKind::Together) {
                continue;
            }
            let Some(robot) = asked.wish.robots.iter().find(|robot| reserved.contains(robot))
            else {
                continue;
            };
            let reserves = |other: &&Asked| {
                other.wish.kind == WishKind::Reserve && other.wish.robots.contains(robot)
            };
            let other = self.wishes.iter().find(reserves)?;
            return Some(format!(
                "{robot} cannot be in a team (wish {}) and in none (wish {})",
                asked.name, other.name
            ));
        }
        None
    }

    fn conflict_within(
        &self,
        rules: &ValidRules,
        columns: &[TeamId],
        robots: &[&RobotId],
    ) -> Option<String> {
        if let Some(conflict) = rules.conflict() {
            let skills = self.needs.class_names();
            let text = crate::words::conflict(&conflict, columns, robots, &skills);
            let has = |tie: &Tie| conflict.rules.contains(&Rule::Pair(tie.pair));
            let mut wishes: Vec<usize> = self
                .ties(columns, robots)
                .iter()
                .filter(|tie| has(tie))
                .map(|tie| tie.wish)
                .collect();
            wishes.sort_unstable();
            wishes.dedup();
            return Some(if wishes.is_empty() {
                text
            } else {
                format!("{text} ({})", self.list(&wishes))
            });
        }
        let groups = match self.groups(rules, columns, robots) {
            Ok(groups) if groups.is_empty() => return None,
            Ok(groups) => groups,
            Err(error) => return Some(error.to_string()),
        };
        let (count, places) = (robots.len(), columns.len());
        let costs = CostMatrix::new(count, places, vec![0; count * places]).ok()?;
        let mut assigner = Assigner::new();
        match assign_with_wishes(&mut assigner, rules, &groups.valid, &costs, GROUP_NODES) {
            Ok(_) => None,
            Err(numeric::DivisionError::Infeasible { wishes, needs, .. }) => {
                let wishes: Vec<usize> = wishes.iter().map(|at| groups.wishes[*at]).collect();
                if needs.is_empty() {
                    let wishes = self.list(&wishes);
                    return Some(format!(
                        "{wishes} cannot be granted within the limits and the other wishes"
                    ));
                }
                let asked = self.needs.describe(&needs, &groups.needs, robots);
                let beside = if wishes.is_empty() {
                    String::new()
                } else {
                    format!(" beside {}", self.list(&wishes))
                };
                Some(format!("{asked} are not enough to fill them together{beside}"))
            }
            Err(error) => Some(error.to_string()),
        }
    }

    /// The names of wishes as a list.
    fn list(&self, wishes: &[usize]) -> String {
        let names: Vec<String> = wishes.iter().map(|at| self.wishes[*at].name.clone()).collect();
        let noun = if names.len() == 1 { "wish" } else { "wishes" };
        format!("{noun} {}", crate::words::list(&names))
    }

    /// Whether all wishes that robots be together or apart are granted where these are placed.
    pub(crate) fn grants_groups(&self, placed: &BTreeMap<RobotId, TeamId>) -> bool {
        let of_groups =
            |asked: &&Asked| matches!(asked.wish.kind, WishKind::Together | WishKind::Apart);
        self.wishes.iter().filter(of_groups).all(|asked| grants_group(&asked.wish, placed))
    }

    /// Whether these robots may be a team of these, instead of `before`. Needs may be soft, or more than the fleet can
    /// fill, so that they need only be filled no worse.
    pub(crate) fn admits(
        &self,
        team: &TeamId,
        before: &TeamId,
        robots: &[&RobotId],
        columns: &[TeamId],
    ) -> bool {
        let is_here = |column: Column| matches!(column, Column::Team(at) if columns[at] == *team);
        let unfilled = |team: &TeamId| self.needs.unfilled_by(team, robots);
        self.has_room(team, robots.len())
            && unfilled(team) <= unfilled(before)
            && self.ties(columns, robots).iter().all(|tie| match tie.pair {
                Pair::Forced { column, .. } => is_here(column),
                Pair::Forbidden { column, .. } => !is_here(column),
            })
    }
}

/// Whether two rules ask for the same, whichever robots can fill needs: who can changes with every robot that falls
/// silent, and a division for those of a moment ago is better than none.
pub fn asks_alike(left: Option<&TeamRules>, right: Option<&TeamRules>) -> bool {
    match (left, right) {
        (Some(left), Some(right)) => left.asks_as(right),
        (left, right) => left.is_none() && right.is_none(),
    }
}

/// Whether the robots of a group that have a team are together or apart as they are to be; true for other wishes.
pub fn grants_group(wish: &Wish, placed: &BTreeMap<RobotId, TeamId>) -> bool {
    let teams: Vec<&TeamId> = wish.robots.iter().filter_map(|robot| placed.get(robot)).collect();
    let distinct: BTreeSet<&TeamId> = teams.iter().copied().collect();
    match wish.kind {
        WishKind::Together => distinct.len() <= 1,
        WishKind::Apart => distinct.len() == teams.len(),
        _ => true,
    }
}
