//! Seats: while a whole team is absent its place is kept, so that the robots that are there are divided into
//! the number of teams less those that are absent, and no robot has to fill a place that is only empty for now. That holds
//! also where the number of teams is chosen, unless rules are to be obeyed: without the absent team the relations of the others
//! are no evidence for it.
//!
//! A team is absent while none of its robots is in the embedding: their link is cut, or the services have just
//! been started and hear one robot after the other. Its seat is kept for as long as the team is remembered
//! (`TEAM_MEMORY_TIME`). Robots that no team knows may be a team of their own: for a moment after they came
//! the evidence decides whether they get a free seat. The first robots of a team that returns may be too few to
//! be one by the evidence: for a moment after they came their team has its seat whatever the evidence is, and every
//! robot without new orders stays in its last team (`division`).
//!
//! Robots that came when none was there that had been in a team are another fleet: while no earlier robot
//! returns, no seat is kept for the teams of the earlier ones.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::settings::TeamCount;
use muster_model::teams::Teams;
use muster_model::time::Tick;

use crate::memory::Memory;

/// For how long after robots have left the number of teams stays, and each of the others in its team: the robots of a team
/// leave within a second or two, and until the last one has, the vectors rest on a part of the team. At least as much time passes
/// before the next such period, so that a fleet of which robots leave all the time is divided as well.
const LOSS_TIME: Duration = Duration::from_secs(3);

/// For how long after robots have left, or report again, a move that begins is taken for a consequence: while all stay, and a moment
/// after.
const LOSS_SHOWS_TIME: Duration = Duration::from_secs(6);

/// For how long after robots came that no team knows the evidence decides whether they get a free seat: the robots of a team come
/// within a second or two, one after the other.
const SETTLE_TIME: Duration = Duration::from_secs(3);

/// For how long after a team returned, or robots of it that had left or were silent, it has its seat and all stay in their teams: its robots come within a second or two, repeat
/// their ranks within two more, and the fleet is at rest a second later. What is trusted of the relations is that of before again then.
const RETURN_TIME: Duration = Duration::from_secs(5);

/// Who has a team, at one embedding.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Seats {
    /// The teams of which a robot is there.
    present: BTreeSet<TeamId>,
    /// How many teams have a seat and no robot that is there.
    pub absent: u32,
    /// How many of the present teams are not in the last division: they return.
    returning: u32,
    /// Whether there are robots that no team knows.
    newcomers: bool,
    /// Whether robots of teams of the last division are not there any more.
    have_left: bool,
}

impl Seats {
    /// The seats of the last division and of the teams that are remembered. Robots that are in no team on purpose have no seat, and neither has a team of which all robots are.
    pub fn of(
        division: Option<&Teams>,
        memory: &Memory,
        reserved: &BTreeSet<&RobotId>,
        embedding: &Embedding,
    ) -> Self {
        let Some(division) = division else { return Self::default() };
        let robots = embedding.robots.iter().zip(&embedding.without_embedding);
        let robots = robots.filter(|(_, without)| !**without).map(|(robot, _)| robot);
        let last_of: Vec<Option<&TeamId>> = robots
            .zip(last_teams(division, memory, embedding))
            .filter(|(robot, _)| !reserved.contains(robot))
            .map(|(_, last)| last)
            .collect();
        let newcomers = last_of.contains(&None);
        let mut members = division.assignments().map(|(robot, _)| robot);
        let have_left = members.any(|robot| embedding.robots.binary_search(robot).is_err());
        let mut seats = Self { newcomers, have_left, ..Self::default() };
        let occupied: BTreeSet<&TeamId> = last_of.into_iter().flatten().collect();
        for team in &division.teams {
            if occupied.contains(&team.id) {
                seats.present.insert(team.id.clone());
            } else if team.members.iter().any(|member| !reserved.contains(&member.robot)) {
                seats.absent = seats.absent.saturating_add(1);
            }
        }
        let are_newcomers = occupied.iter().all(|id| memory.is_of_newcomers(id));
        let lost = memory.lost_teams(reserved);
        for id in lost.filter(|id| !are_newcomers || memory.is_of_newcomers(id)) {
            if occupied.contains(id) {
                seats.present.insert(id.clone());
                seats.returning += 1;
            } else {
                seats.absent = seats.absent.saturating_add(1);
            }
        }
        if seats.present.is_empty() {
            // None of the robots that are there had a team: there is nothing to keep together.
            seats.absent = 0;
        }
        seats
    }

    /// How many teams the robots that are there were in, none if there is no division to go on from.
    /// `divided_into` is how many teams they were divided into last.
    pub fn current(&self, divided_into: Option<u32>) -> Option<u32> {
        if self.absent == 0 && self.returning == 0 {
            // Robots in the same place are fewer teams than asked for, and may come apart.
            return divided_into;
        }
        u32::try_from(self.present.len()).ok()
    }

    /// The number of teams that is wanted of the robots that are there, while absent teams keep their seats and
    /// those that have just returned have theirs. Where rules are to hold (`has_rules`), a number that is chosen is not kept
    /// for absent teams: it may be one that the others cannot obey them with.
    pub fn wanted(
        &self,
        now: Tick,
        wanted: TeamCount,
        has_rules: bool,
        current: Option<u32>,
        arrivals: &mut Arrivals,
    ) -> TeamCount {
        if self.newcomers {
            arrivals.newcomers = Some(now);
        }
        if self.returning > 0 {
            arrivals.returned = Some(now);
        }
        if std::mem::replace(&mut arrivals.is_team_absent, self.absent > 0) && self.absent == 0 {
            arrivals.absence_ended = Some(now);
        }
        if self.have_left {
            arrivals.note_loss(now);
        }
        let less = |teams: u32| teams.saturating_sub(self.absent).max(1);
        let range = wanted.range();
        let (from, to) = (less(*range.start()), *range.end());
        let is_given = matches!(wanted, TeamCount::Fixed(_));
        // Robots that no team knows have their moment once no more robots leave: the evidence would put those of a team that are still
        // there into other teams.
        let are_leaving = !self.present.is_empty() && is_within(LOSS_TIME, arrivals.lost, now);
        let have_come = is_within(SETTLE_TIME, arrivals.newcomers, now);
        if have_come && are_leaving {
            arrivals.newcomers = Some(now);
        }
        let may_keep = (is_given || !has_rules) && (are_leaving || !have_come);
        let is_unsettled = !has_rules && arrivals.is_unsettled(now);
        let seated = match (wanted, current) {
            _ if self.absent == 0 && !is_unsettled => wanted,
            (_, Some(current)) if may_keep => TeamCount::Fixed(current.clamp(from, to)),
            (TeamCount::Auto, _) => wanted,
            (TeamCount::Between { .. } | TeamCount::Fixed(_), _) => TeamCount::Between { from, to },
        };
        if matches!(seated, TeamCount::Fixed(_)) || !is_within(RETURN_TIME, arrivals.returned, now)
        {
            return seated;
        }
        let (range, present) = (seated.range(), u32::try_from(self.present.len()));
        let from = present.unwrap_or(1).clamp(*range.start(), *range.end());
        TeamCount::Between { from, to: *range.end() }
    }
}

/// Who came and left lately.
#[derive(Debug, Clone, Default)]
pub struct Arrivals {
    /// When robots were last there that no team knew.
    newcomers: Option<Tick>,
    /// When the first robots of a team that had been absent were last there again.
    returned: Option<Tick>,
    /// When the last period of losses began.
    lost: Option<Tick>,
    /// When the last period began in which robots report again.
    reporting: Option<Tick>,
    /// Whether a whole team was absent when it was last looked at.
    is_team_absent: bool,
    /// When that was last the case no more.
    absence_ended: Option<Tick>,
}

impl Arrivals {
    /// Robots have left, whether they are back or not: others may follow. At least as much time passes before the next such period.
    pub fn note_loss(&mut self, now: Tick) {
        if self.ends_showing().is_none_or(|end| now >= end) {
            self.lost = Some(now);
        }
    }

    /// Robots report again of a team that was silent, or that had left: others may follow, and until all have reported again,
    /// their vectors rest on what is new of some and old of others. At least as much time passes before the next such period.
    pub fn note_reporting_again(&mut self, now: Tick) {
        if self.reporting.is_none_or(|since| now >= since.after(2 * RETURN_TIME)) {
            self.reporting = Some(now);
        }
    }

    /// Whether a team has returned, or reports again, of which more robots may follow, or robots have left that others may follow.
    #[must_use]
    pub fn is_unsettled(&self, now: Tick) -> bool {
        is_within(RETURN_TIME, self.returned, now)
            || is_within(RETURN_TIME, self.reporting, now)
            || is_within(LOSS_TIME, self.lost, now)
    }

    /// Whether no team is absent any more since less than `time` ago: the last one that was has returned, or is forgotten.
    #[must_use]
    pub fn has_absence_ended_within(&self, now: Tick, time: Duration) -> bool {
        self.absence_ended.is_some_and(|ended| now.since(ended) < time)
    }

    /// Until when moves that begin are taken for a consequence of losses, or of the return of robots; none if no robots have left.
    #[must_use]
    pub fn losses_show_until(&self) -> Option<Tick> {
        let reporting = self.reporting.map(|since| since.after(LOSS_SHOWS_TIME));
        self.ends_showing().max(reporting)
    }

    /// When the consequences of the last losses no longer show.
    fn ends_showing(&self) -> Option<Tick> {
        Some(self.lost?.after(LOSS_SHOWS_TIME))
    }

    /// When robots that may follow those that returned or left last are no longer waited for; empty if there are none.
    pub fn settled_at(&self) -> impl Iterator<Item = Tick> {
        let all =
            [(self.returned, RETURN_TIME), (self.reporting, RETURN_TIME), (self.lost, LOSS_TIME)];
        all.into_iter().filter_map(|(began, time)| Some(began?.after(time)))
    }
}

/// Whether less than some time has passed since something began.
fn is_within(time: Duration, began: Option<Tick>, now: Tick) -> bool {
    began.is_some_and(|began| now.since(began) < time)
}

/// The team of each robot that has an embedding, in the order of the embedding: in the division, or else the
/// last one that is remembered.
pub(crate) fn last_teams<'a>(
    division: &'a Teams,
    memory: &'a Memory,
    embedding: &Embedding,
) -> Vec<Option<&'a TeamId>> {
    let team_of: BTreeMap<&RobotId, &TeamId> = division.assignments().collect();
    let known = |robot: &RobotId| team_of.get(robot).copied().or_else(|| memory.last_team(robot));
    let robots = embedding.robots.iter().zip(&embedding.without_embedding);
    robots.filter(|(_, without)| !**without).map(|(robot, _)| known(robot)).collect()
}

/// The last team of the robots of some rows of an embedding, all of which have one that is not zero.
pub(crate) fn last_of<'a>(
    division: Option<&'a Teams>,
    memory: &'a Memory,
    embedding: &Embedding,
    rows: &[usize],
) -> Vec<Option<&'a TeamId>> {
    let Some(division) = division else { return vec![None; rows.len()] };
    let placed = (0..embedding.robots.len()).filter(|row| !embedding.without_embedding[*row]);
    let all: BTreeMap<usize, Option<&TeamId>> =
        placed.zip(last_teams(division, memory, embedding)).collect();
    rows.iter().map(|row| all.get(row).copied().flatten()).collect()
}

/// A division as it would be with the seats of the next one: without the teams that have lost all their
/// robots, and with those whose robots are all back. What is between the two are moves of robots alone; none
/// if teams were divided or put together.
pub fn reseated(before: &Teams, new: &Teams) -> Option<Teams> {
    let ids = |teams: &Teams| -> BTreeSet<TeamId> {
        teams.teams.iter().map(|team| team.id.clone()).collect()
    };
    let (old_ids, new_ids) = (ids(before), ids(new));
    if old_ids == new_ids {
        return None;
    }
    let old: BTreeSet<&RobotId> = before.assignments().map(|(robot, _)| robot).collect();
    let now: BTreeSet<&RobotId> = new.assignments().map(|(robot, _)| robot).collect();
    let is_among = |robots: &BTreeSet<&RobotId>, team: &muster_model::teams::Team| {
        team.members.iter().any(|member| robots.contains(&member.robot))
    };
    let lost = |team: &&muster_model::teams::Team| !new_ids.contains(&team.id);
    let back = |team: &&muster_model::teams::Team| !old_ids.contains(&team.id);
    if before.teams.iter().filter(lost).any(|team| is_among(&now, team))
        || new.teams.iter().filter(back).any(|team| is_among(&old, team))
    {
        return None;
    }
    let mut seated = before.clone();
    seated.teams.retain(|team| new_ids.contains(&team.id));
    seated.teams.extend(new.teams.iter().filter(back).cloned());
    seated.requested = new.requested;
    Some(seated)
}
