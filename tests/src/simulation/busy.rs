//! Hosts that are busy with other work: everything takes longer, deltas are lost, and a snapshot is outdated
//! when it comes. Divisions become rarer in proportion, and never stop.

use std::collections::VecDeque;
use std::fmt;

use muster_model::header::Revision;

use super::chance::Chance;
use super::clock::{MS, Micros};
use super::oracle::{Verified, breach};
use super::plan::Span;

/// What is promised of the age of a division.
const FRESH: &str =
    "on busy hosts a division is never older than ten times what its stages take alone";

/// See [`FRESH`].
const MAX_AGE_FACTOR: u64 = 10;

/// The longest frame of `ingest` that a seed has.
const LONGEST_FRAME: Micros = 250 * MS;

/// How many inputs of services one pose passes on its way to a division, with those that wait before it.
const INPUTS_ON_THE_WAY: u64 = 20;

/// Most rosters whose time is remembered: more than a minute of frames.
const MAX_ROSTERS: usize = 2048;

/// How busy the hosts are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Load {
    /// How long a service takes over each input.
    pub(crate) each: Micros,
    /// How long a job takes.
    pub(crate) job: Micros,
    /// How long a message waits on the link of a service at most.
    pub(crate) delay: Micros,
    /// How much later answers of gets come than what is published: they may be large, and have less priority.
    pub(crate) late: Micros,
    /// How many of a hundred messages that are put from and to `embedder` are lost. The bus drops what is put where a link is
    /// busy; gets and answers wait (`CongestionControl::DEFAULT_REQUEST` of Zenoh 1.10.2).
    pub(crate) loss: u64,
}

impl Load {
    pub(crate) fn draw(chance: &mut Chance) -> Self {
        Self {
            each: chance.between(1, 3) * MS,
            job: chance.between(50, 100) * MS,
            delay: chance.between(10, 30) * MS,
            late: chance.between(100, 250) * MS,
            loss: chance.between(2, 8),
        }
    }

    /// What the stages of a division take alone under this load: a frame, two jobs, the links between, and
    /// the answer of a fetch.
    fn alone(&self) -> Micros {
        let ways = 2 * self.delay + self.late;
        LONGEST_FRAME + 2 * self.job + ways + INPUTS_ON_THE_WAY * self.each
    }
}

impl fmt::Display for Load {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { each, job, delay, late, loss } = *self;
        let [each, job, delay, late] = [each, job, delay, late].map(Span);
        write!(
            formatter,
            "inputs take {each}, jobs {job}, links up to {delay}, answers {late} more; embedder loses {loss} %"
        )
    }
}

/// How old the newest division is.
#[derive(Debug, Default)]
pub(crate) struct Freshness {
    /// When each roster was published.
    rosters: VecDeque<(Revision, Micros)>,
    /// When the roster was published that the newest division rests on.
    newest: Option<Micros>,
    /// From when until when how old it may be at most.
    limit: Option<(Micros, Micros, Micros)>,
}

impl Freshness {
    /// The hosts are busy for a while.
    pub(crate) fn begin(&mut self, now: Micros, until: Micros, load: &Load) {
        self.limit = Some((now, until, MAX_AGE_FACTOR * load.alone()));
    }

    /// A roster is published.
    pub(crate) fn roster(&mut self, now: Micros, revision: Revision) {
        self.rosters.push_back((revision, now));
        if self.rosters.len() > MAX_ROSTERS {
            self.rosters.pop_front();
        }
    }

    /// A division is published that rests on a roster.
    pub(crate) fn division(&mut self, roster: Revision) {
        let published = self.rosters.iter().rev().find(|(revision, _)| *revision == roster);
        self.newest = self.newest.max(published.map(|(_, at)| *at));
    }

    /// Whether the newest division is fresh. What came before the hosts were busy is not judged.
    pub(crate) fn check(&self, now: Micros) -> Verified {
        let (Some((from, until, limit)), Some(newest)) = (self.limit, self.newest) else {
            return Ok(());
        };
        let age = now.saturating_sub(newest.max(from));
        if now >= until || age <= limit {
            return Ok(());
        }
        let (age, limit) = (Span(age), Span(limit));
        breach(
            FRESH,
            format!("the newest division rests on data of {age} ago, allowed are {limit}"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_division_grows_old_only_while_the_hosts_are_busy() {
        let load = Load { each: MS, job: 50 * MS, delay: 10 * MS, late: 100 * MS, loss: 2 };
        assert_eq!(load.alone(), 490 * MS);
        let at = |epoch| Revision { term: 1, epoch };
        let mut freshness = Freshness::default();
        freshness.roster(0, at(1));
        freshness.roster(100 * MS, at(2));
        freshness.division(at(2));
        freshness.division(at(1));
        assert_eq!(freshness.newest, Some(100 * MS));
        assert_eq!(freshness.check(100_000 * MS), Ok(()), "nothing was promised");
        freshness.begin(1000 * MS, 9000 * MS, &load);
        assert_eq!(freshness.check(5900 * MS), Ok(()));
        assert!(freshness.check(5901 * MS).is_err());
        assert_eq!(freshness.check(9000 * MS), Ok(()));
        freshness.roster(3000 * MS, at(3));
        freshness.division(at(3));
        assert_eq!(freshness.check(7900 * MS), Ok(()));
    }
}
