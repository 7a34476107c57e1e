//! A store in memory: every record as it came. What it answers is computed by reading all of them, so that it is
//! the measure of other stores.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::history::{
    AuditRecord, Coverage, DivisionRecord, DivisionRow, Entry, EventCoverage, EventRow,
    LeaveReason, Page, PastAudit, PastDivision, PastTeam, Place, PlaceRow, PositionsRecord, Query,
    Record, Retention, Rows, SnapshotCause, StayRow, Subject, TeamMean, TeamRow,
};
use muster_model::id::{RobotId, TeamId};
use muster_model::time::Tick;

use super::{MAX_PAGE_BYTES, Records, WriteError};

/// Microseconds of a minute.
const MINUTE_US: u64 = 60_000_000;

/// A record with its number.
#[derive(Debug, Clone)]
struct Numbered {
    sequence: u64,
    at: Tick,
    record: Record,
}

/// A store in memory.
#[derive(Debug, Default)]
pub struct MemoryRecords {
    records: Vec<Numbered>,
    stays: Vec<StayRow>,
    coverage: Coverage,
    next_stay: u64,
    /// Nothing before this number is kept but divisions that others rest on.
    kept_from: u64,
    /// Why nothing can be written, while a test says so.
    pub fails: Option<WriteError>,
}

impl MemoryRecords {
    /// A store that writes nothing.
    #[must_use]
    pub fn failing(error: WriteError) -> Self {
        Self { fails: Some(error), ..Self::default() }
    }

    fn add(&mut self, entry: &Entry) {
        let Entry { at, record } = entry.clone();
        self.coverage.sequence += 1;
        let sequence = self.coverage.sequence;
        match &record {
            Record::Division(division) => self.coverage.division = Some(division.revision),
            Record::Audit(audit) => self.coverage.audit = Some(audit.revision),
            Record::Event(event) => {
                let newest = EventCoverage { source: event.source, revision: event.revision };
                self.coverage.events.retain(|of| of.source != event.source);
                self.coverage.events.push(newest);
                self.coverage.events.sort_by_key(|of| of.source);
            }
            Record::Present(robots) => self.present(at, robots),
            Record::Joined(robot) => self.begin_stay(robot, at, Some(at)),
            Record::Left { robot, last_seen, reason } => {
                self.begin_stay(robot, at, None);
                self.end_stay(robot, at, Some(*last_seen), *reason);
            }
            Record::Settings { .. } | Record::Gap { .. } | Record::Positions(_) => {}
        }
        self.records.push(Numbered { sequence, at, record });
        self.coverage.recorded_from.get_or_insert(at);
        self.coverage.recorded_through = Some(at);
    }

    fn present(&mut self, at: Tick, robots: &[RobotId]) {
        let there: BTreeSet<&RobotId> = robots.iter().collect();
        let gone: Vec<RobotId> = self
            .stays
            .iter()
            .filter(|stay| stay.left.is_none() && !there.contains(&stay.robot))
            .map(|stay| stay.robot.clone())
            .collect();
        for robot in &gone {
            self.end_stay(robot, at, None, LeaveReason::Unrecorded);
        }
        for robot in robots {
            self.begin_stay(robot, at, None);
        }
    }

    /// A robot is there from now on; one that is there already stays.
    fn begin_stay(&mut self, robot: &RobotId, at: Tick, joined: Option<Tick>) {
        if self.stays.iter().any(|stay| stay.robot == *robot && stay.left.is_none()) {
            return;
        }
        self.next_stay += 1;
        self.stays.push(StayRow {
            sequence: self.next_stay,
            robot: robot.clone(),
            joined,
            recorded: at,
            left: None,
            last_seen: None,
            reason: None,
        });
    }

    fn end_stay(&mut self, robot: &RobotId, at: Tick, seen: Option<Tick>, reason: LeaveReason) {
        let open = |stay: &&mut StayRow| stay.robot == *robot && stay.left.is_none();
        if let Some(stay) = self.stays.iter_mut().find(open) {
            stay.left = Some(at);
            stay.last_seen = seen;
            stay.reason = Some(reason);
        }
    }

    fn divisions(&self) -> impl DoubleEndedIterator<Item = (&Numbered, &DivisionRecord)> {
        self.records.iter().filter_map(|numbered| match &numbered.record {
            Record::Division(division) => Some((numbered, division)),
            _ => None,
        })
    }

    fn audits(&self) -> impl DoubleEndedIterator<Item = (&Numbered, &AuditRecord)> {
        self.records.iter().filter_map(|numbered| match &numbered.record {
            Record::Audit(audit) => Some((numbered, audit)),
            _ => None,
        })
    }

    fn positions(&self) -> impl DoubleEndedIterator<Item = (&Numbered, &PositionsRecord)> {
        self.records.iter().filter_map(|numbered| match &numbered.record {
            Record::Positions(positions) => Some((numbered, positions)),
            _ => None,
        })
    }

    /// The last positions until a moment.
    fn positions_as_of(&self, moment: Tick) -> PastPositions {
        let all: Vec<_> = self.positions().collect();
        let Some(last) = all.iter().rposition(|(numbered, _)| numbered.at <= moment) else {
            return PastPositions::default();
        };
        let whole = all[..=last].iter().rposition(|(_, positions)| positions.is_whole);
        let records = whole.into_iter().chain([last]);
        let robots = records.flat_map(|at| all[at].1.robots.iter().cloned()).collect();
        PastPositions { at: Some(all[last].0.at), robots }
    }

    fn as_of(&self, moment: Tick) -> Option<PastDivision> {
        let all: Vec<_> = self.divisions().collect();
        let last = all.iter().rposition(|(numbered, _)| numbered.at <= moment)?;
        let first = all[..=last].iter().rposition(|(_, division)| division.snapshot.is_some())?;
        let (mut places, mut leaders) = (BTreeMap::new(), BTreeMap::new());
        for (_, division) in &all[first..=last] {
            if division.snapshot.is_some() {
                (places, leaders) = (BTreeMap::new(), BTreeMap::new());
            }
            places.extend(division.places.iter().map(|place| (&place.robot, place)));
            leaders.extend(division.lines.iter().map(|line| (&line.team, line.leader.as_ref())));
        }
        let (numbered, division) = all[last];
        let audit = self.audits().rev().find(|(numbered, _)| numbered.at <= moment);
        Some(past_division(
            DivisionHead {
                sequence: numbered.sequence,
                at: numbered.at,
                revision: division.revision,
                requested: division.requested,
            },
            places.into_values().cloned(),
            |team| leaders.get(team).copied().flatten().cloned(),
            audit.map(|(numbered, audit)| PastAudit {
                sequence: numbered.sequence,
                at: numbered.at,
                division: audit.division,
                mean: audit.mean,
                physical_mean: audit.physical_mean,
                verdict: audit.verdict,
                per_team: audit
                    .per_team
                    .iter()
                    .map(|(team, mean)| TeamMean { team: team.clone(), mean: *mean })
                    .collect(),
            }),
            self.positions_as_of(moment),
        ))
    }

    fn division_rows(&self) -> impl Iterator<Item = DivisionRow> {
        let changes = self.divisions().rev().filter(|(_, division)| !is_periodic(division));
        changes.map(|(numbered, division)| DivisionRow {
            sequence: numbered.sequence,
            at: numbered.at,
            revision: division.revision,
            requested: division.requested,
            teams: division.teams,
            robots: division.robots,
            changed: match division.snapshot {
                Some(_) => 0,
                None => u32::try_from(division.places.len()).unwrap_or(u32::MAX),
            },
            snapshot: division.snapshot,
        })
    }

    fn place_rows(&self, robot: &RobotId) -> impl Iterator<Item = PlaceRow> {
        self.divisions().rev().filter(|(_, division)| !is_periodic(division)).filter_map(
            move |(numbered, division)| {
                let place = division.places.iter().find(|place| place.robot == *robot)?;
                Some(PlaceRow {
                    sequence: numbered.sequence,
                    at: numbered.at,
                    team: place.team.clone(),
                    was: place.was.clone(),
                    present: place.present,
                    stale: place.stale,
                    snapshot: division.snapshot,
                })
            },
        )
    }

    fn team_rows(&self, team: &TeamId) -> impl Iterator<Item = TeamRow> {
        self.divisions().rev().filter(|(_, division)| !is_periodic(division)).filter_map(
            move |(numbered, division)| {
                let line = division.lines.iter().find(|line| line.team == *team)?;
                let is_in = |place: &Place| place.present && place.team.as_ref() == Some(team);
                let was_in = |place: &Place| place.was.as_ref() == Some(team);
                let names = |wanted: &dyn Fn(&Place) -> bool| {
                    let moved = division.places.iter().filter(|_| division.snapshot.is_none());
                    let names = moved.filter(|place| wanted(place)).map(|place| &place.robot);
                    names.cloned().collect::<BTreeSet<_>>().into_iter().collect()
                };
                Some(TeamRow {
                    sequence: numbered.sequence,
                    at: numbered.at,
                    leader: line.leader.clone(),
                    members: line.members,
                    came: names(&|place| is_in(place) && !was_in(place)),
                    went: names(&|place| was_in(place) && !is_in(place)),
                })
            },
        )
    }

    fn event_rows(&self, kind: Option<&str>) -> impl Iterator<Item = EventRow> {
        self.records.iter().rev().filter_map(move |numbered| match &numbered.record {
            Record::Event(event) if kind.is_none_or(|kind| event.kind == kind) => Some(EventRow {
                sequence: numbered.sequence,
                at: numbered.at,
                source: event.source,
                revision: event.revision,
                severity: event.severity,
                event: event.kind.clone(),
                detail: event.detail.clone(),
            }),
            _ => None,
        })
    }

    /// Forgets what is before a number; of divisions, what is before the last whole one until then. Of stays, those that
    /// ended before all that is kept, and before a moment.
    fn forget_before(&mut self, sequence: u64, before: Tick) {
        let is_base = |(numbered, division): &(&Numbered, &DivisionRecord)| {
            numbered.sequence <= sequence && division.snapshot.is_some()
        };
        let base = self.divisions().rev().find(is_base).map_or(0, |(base, _)| base.sequence);
        let is_whole = |(numbered, positions): &(&Numbered, &PositionsRecord)| {
            numbered.sequence <= sequence && positions.is_whole
        };
        let whole = self.positions().rev().find(is_whole).map(|(whole, _)| whole.sequence);
        let newest = self.positions().map(|(one, _)| one.sequence).filter(|one| *one <= sequence);
        let surveys = [whole, newest.max()];
        let audits = self.audits().map(|(audit, _)| audit.sequence);
        let in_force = audits.filter(|audit| *audit <= sequence).max();
        let kept = self.records.iter().filter(|numbered| numbered.sequence >= sequence);
        let moment = kept.map(|numbered| Tick(minute(numbered))).min();
        let moment = moment.map_or(before, |moment| moment.min(before));
        self.records.retain(|numbered| match numbered.record {
            Record::Division(_) => numbered.sequence >= base,
            Record::Positions(_) => {
                numbered.sequence >= sequence || surveys.contains(&Some(numbered.sequence))
            }
            // The scores in force are known to the end.
            Record::Audit(_) => {
                numbered.sequence >= sequence || in_force == Some(numbered.sequence)
            }
            _ => numbered.sequence >= sequence,
        });
        self.stays.retain(|stay| stay.left.is_none_or(|left| left >= moment));
        self.kept_from = sequence;
        let first = self.records.iter().find(|numbered| numbered.sequence >= sequence);
        self.coverage.recorded_from = first.map(|first| first.at);
    }
}

/// The moment at which the minute of a record began, in microseconds.
fn minute(numbered: &Numbered) -> u64 {
    numbered.at.0 / MINUTE_US * MINUTE_US
}

fn is_periodic(division: &DivisionRecord) -> bool {
    division.snapshot == Some(SnapshotCause::Periodic)
}

/// What a past division is known by.
#[derive(Debug, Clone, Copy)]
pub struct DivisionHead {
    /// Its number.
    pub sequence: u64,
    /// When it was recorded.
    pub at: Tick,
    /// Which output of `clusterer` it was.
    pub revision: muster_model::header::Revision,
    /// How many teams were asked for.
    pub requested: u32,
}

/// Where robots were at a moment.
#[derive(Debug, Clone, Default)]
pub struct PastPositions {
    /// When it was recorded.
    pub at: Option<Tick>,
    /// Centimetres east and north, by robot.
    pub robots: BTreeMap<RobotId, [i64; 2]>,
}

/// A past division out of the last place of each robot, ordered by name.
pub fn past_division(
    head: DivisionHead,
    places: impl Iterator<Item = Place>,
    leader: impl Fn(&TeamId) -> Option<RobotId>,
    audit: Option<PastAudit>,
    mut known: PastPositions,
) -> PastDivision {
    let mut teams: BTreeMap<TeamId, Vec<RobotId>> = BTreeMap::new();
    let (mut unassigned, mut stale) = (Vec::new(), Vec::new());
    let mut positions = BTreeMap::new();
    for place in places {
        if (place.stale || place.present)
            && let Some((robot, at)) = known.robots.remove_entry(&place.robot)
        {
            positions.insert(robot, at.map(metres));
        }
        // A stale robot may belong to no division any more.
        if place.stale {
            stale.push(place.robot.clone());
        }
        match (place.present, place.team) {
            (true, Some(team)) => teams.entry(team).or_default().push(place.robot),
            (true, None) => unassigned.push(place.robot),
            (false, _) => {}
        }
    }
    let teams = teams.into_iter().map(|(id, members)| {
        let leader = leader(&id);
        PastTeam { id, members, leader }
    });
    PastDivision {
        sequence: head.sequence,
        at: head.at,
        revision: head.revision,
        requested: head.requested,
        teams: teams.collect(),
        unassigned,
        stale,
        audit,
        positions_at: known.at,
        positions,
    }
}

#[expect(clippy::cast_precision_loss, reason = "coordinates are far below 2⁵³ centimetres")]
fn metres(centimetres: i64) -> f64 {
    centimetres as f64 / 100.0
}

/// The rows that a question selects, with the number before which there are further ones.
fn select<T>(
    query: &Query,
    rows: impl Iterator<Item = T>,
    key: impl Fn(&T) -> (u64, Tick),
    weight: impl Fn(&T) -> usize,
) -> (Vec<T>, Option<u64>) {
    let (mut taken, mut bytes): (Vec<T>, usize) = (Vec::new(), 0);
    for row in rows {
        let (sequence, at) = key(&row);
        if !query.selects(sequence, at) {
            continue;
        }
        bytes += weight(&row);
        if taken.len() == query.rows() || (bytes > MAX_PAGE_BYTES && !taken.is_empty()) {
            let before = taken.last().map(|last| key(last).0);
            return (taken, before);
        }
        taken.push(row);
    }
    (taken, None)
}

impl Records for MemoryRecords {
    fn write(&mut self, entries: &[Entry]) -> Result<(), WriteError> {
        if let Some(error) = &self.fails {
            return Err(error.clone());
        }
        entries.iter().for_each(|entry| self.add(entry));
        Ok(())
    }

    fn coverage(&self) -> Coverage {
        self.coverage.clone()
    }

    fn retain(&mut self, retention: &Retention) -> Result<bool, WriteError> {
        let is_kept = |numbered: &&Numbered| numbered.sequence >= self.kept_from;
        let kept: Vec<&Numbered> = self.records.iter().filter(is_kept).collect();
        let is_old = |one: &&Numbered| minute(one) + MINUTE_US <= retention.before.0;
        let last = kept.last().map(|last| minute(last));
        // What a clock that was ahead has recorded goes once what came after it is old.
        let is_young = |one: &&Numbered| !is_old(one) && Some(minute(one)) <= last;
        let young = kept.iter().position(is_young).unwrap_or(kept.len());
        let old = kept[..young].iter().rposition(is_old).map_or(0, |last| last + 1);
        // The last minute stays in any case.
        let others = kept.iter().rposition(|one| Some(minute(one)) != last);
        let last = others.map_or(0, |before| before + 1);
        let first = old.min(last);
        if let Some(sequence) = kept.get(first).filter(|_| first > 0).map(|first| first.sequence) {
            self.forget_before(sequence, retention.before);
        }
        Ok(false)
    }

    fn answer(&mut self, query: &Query) -> Result<Page, String> {
        macro_rules! page {
            ($kind:ident, $rows:expr, $weight:expr) => {{
                let (rows, before) = select(query, $rows, |row| (row.sequence, row.at), $weight);
                Page { rows: Rows::$kind(rows), before }
            }};
        }
        Ok(match &query.subject {
            Subject::AsOf(moment) => {
                Page { rows: Rows::AsOf(self.as_of(*moment).map(Box::new)), before: None }
            }
            Subject::Divisions => page!(Divisions, self.division_rows(), |_| 0),
            Subject::Robot(robot) => page!(Robot, self.place_rows(robot), |_| 0),
            Subject::Team(team) => page!(Team, self.team_rows(team), TeamRow::weight),
            Subject::Events(kind) => {
                page!(Events, self.event_rows(kind.as_deref()), EventRow::weight)
            }
            Subject::Robots(robot) => {
                let wanted = |stay: &&StayRow| {
                    robot.as_ref().is_none_or(|robot| stay.robot == *robot)
                        && query.until.is_none_or(|until| stay.recorded <= until)
                        && query.since.is_none_or(|since| stay.left.is_none_or(|at| at >= since))
                };
                let rows = self.stays.iter().rev().filter(wanted).cloned();
                let any = Query { since: None, until: None, ..query.clone() };
                let (rows, before) = select(&any, rows, |row| (row.sequence, row.recorded), |_| 0);
                Page { rows: Rows::Robots(rows), before }
            }
        })
    }
}
