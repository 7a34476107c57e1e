//! How records are written: many in one transaction.

use muster_model::history::{
    AuditRecord, Coverage, DivisionRecord, Entry, EventCoverage, EventRecord, LeaveReason,
    PositionsRecord, Record,
};
use muster_model::id::{InstanceId, RobotId};
use muster_model::time::Tick;
use rusqlite::{Connection, Transaction, params};

use super::reading;
use super::values::{signed, word};

/// Microseconds of a minute.
pub(super) const MINUTE_US: u64 = 60_000_000;

/// Where the next record stands.
#[derive(Debug, Clone, Default)]
pub(super) struct Position {
    /// The span in which the clock has not gone back; none before the first record of this run.
    era: Option<i64>,
    sequence: u64,
    /// The moment of the newest record.
    last: Option<Tick>,
}

impl Position {
    /// The place behind what is on the disk.
    pub(super) fn after(coverage: &Coverage) -> Self {
        Self { era: None, sequence: coverage.sequence, last: coverage.recorded_through }
    }

    /// The next record has a higher number than at another place.
    pub(super) fn skip_behind(&mut self, other: &Self) {
        self.sequence = self.sequence.max(other.sequence);
    }
}

/// A transaction that is being written.
struct Writing<'a> {
    to: Transaction<'a>,
    coverage: Coverage,
    position: Position,
}

/// Writes records in one transaction. What is returned holds once it is on the disk.
pub(super) fn write(
    connection: &mut Connection,
    instance: &InstanceId,
    (coverage, position): (&Coverage, &Position),
    entries: &[Entry],
) -> rusqlite::Result<(Coverage, Position)> {
    let (coverage, position) = (coverage.clone(), position.clone());
    let to = connection.transaction()?;
    let mut writing = Writing { to, coverage, position };
    for entry in entries {
        let era = writing.advance(instance, entry.at)?;
        writing.record(era, entry)?;
    }
    let Writing { to, mut coverage, position } = writing;
    let through = position.last.map(|last| signed(last.0));
    let mut meta = to.prepare_cached("INSERT OR REPLACE INTO meta (key, value) VALUES (?1, ?2)")?;
    meta.execute(params!["sequence", signed(position.sequence)])?;
    meta.execute(params!["through_us", through.unwrap_or_default()])?;
    drop(meta);
    coverage.bytes = reading::bytes(&to)?;
    to.commit()?;
    coverage.sequence = position.sequence;
    coverage.recorded_through = position.last;
    Ok((coverage, position))
}

impl Writing<'_> {
    /// Gives the next number, and begins an era or a minute where one begins.
    fn advance(&mut self, instance: &InstanceId, at: Tick) -> rusqlite::Result<i64> {
        self.position.sequence += 1;
        let sequence = signed(self.position.sequence);
        let last = self.position.last.replace(at);
        let went_back = last.is_some_and(|last| at < last);
        let cause = if self.position.era.is_none() { "start" } else { "clock" };
        let era = match self.position.era.filter(|_| !went_back) {
            Some(era) => era,
            None => {
                self.to.execute(
                    "INSERT INTO eras (first_seq, first_us, cause, instance) VALUES (?1, ?2, ?3, ?4)",
                    params![sequence, signed(at.0), cause, instance.as_str()],
                )?;
                let era = self.to.last_insert_rowid();
                self.position.era = Some(era);
                era
            }
        };
        let minute = |at: Tick| at.0 / MINUTE_US;
        if last.map(minute) != Some(minute(at)) || self.coverage.recorded_from.is_none() {
            self.to
                .prepare_cached("INSERT INTO minutes (first_seq, at_us) VALUES (?1, ?2)")?
                .execute([sequence, signed(at.0)])?;
        }
        self.coverage.recorded_from.get_or_insert(at);
        Ok(era)
    }

    fn record(&mut self, era: i64, entry: &Entry) -> rusqlite::Result<()> {
        let at = signed(entry.at.0);
        match &entry.record {
            Record::Division(division) => self.division(era, at, division),
            Record::Audit(audit) => self.audit(era, at, audit),
            Record::Event(event) => self.event(at, event),
            Record::Present(robots) => self.present(at, robots),
            Record::Positions(positions) => self.positions(era, at, positions),
            Record::Joined(robot) => self.begin_stay(at, robot, Some(at)),
            Record::Left { robot, last_seen, reason } => {
                self.begin_stay(at, robot, None)?;
                self.end_stay(at, robot, Some(signed(last_seen.0)), *reason)
            }
            Record::Settings { service, revision, settings } => {
                self.to.execute(
                    "INSERT INTO settings VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
                    params![
                        signed(self.position.sequence),
                        at,
                        service.as_str(),
                        signed(revision.term),
                        signed(revision.epoch),
                        settings
                    ],
                )?;
                Ok(())
            }
            Record::Gap { from, until, records } => {
                self.to.execute(
                    "INSERT INTO gaps VALUES (?1, ?2, ?3, ?4, ?5)",
                    [
                        signed(self.position.sequence),
                        at,
                        signed(from.0),
                        signed(until.0),
                        signed(*records),
                    ],
                )?;
                Ok(())
            }
        }
    }

    fn division(&mut self, era: i64, at: i64, record: &DivisionRecord) -> rusqlite::Result<()> {
        let sequence = signed(self.position.sequence);
        self.to
            .prepare_cached("INSERT INTO divisions VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)")?
            .execute(params![
                sequence,
                era,
                at,
                signed(record.revision.term),
                signed(record.revision.epoch),
                record.requested,
                record.teams,
                record.robots,
                record.snapshot.map(word),
            ])?;
        if record.snapshot.is_some() {
            let mut places =
                self.to.prepare_cached("INSERT INTO places VALUES (?1, ?2, ?3, ?4, ?5)")?;
            for place in &record.places {
                let team = place.team.as_ref().map(|team| team.as_str());
                let robot = place.robot.as_str();
                places.execute(params![sequence, robot, place.present, team, place.stale])?;
            }
        } else {
            let mut moves =
                self.to.prepare_cached("INSERT INTO moves VALUES (?1, ?2, ?3, ?4, ?5, ?6)")?;
            for place in &record.places {
                let team = place.team.as_ref().map(|team| team.as_str());
                let was = place.was.as_ref().map(|team| team.as_str());
                let robot = place.robot.as_str();
                moves.execute(params![sequence, robot, place.present, team, place.stale, was])?;
            }
        }
        let mut lines =
            self.to.prepare_cached("INSERT INTO division_teams VALUES (?1, ?2, ?3, ?4)")?;
        for line in &record.lines {
            let leader = line.leader.as_ref().map(|robot| robot.as_str());
            lines.execute(params![sequence, line.team.as_str(), leader, line.members])?;
        }
        drop(lines);
        self.coverage.division = Some(record.revision);
        Ok(())
    }

    fn audit(&mut self, era: i64, at: i64, record: &AuditRecord) -> rusqlite::Result<()> {
        let sequence = signed(self.position.sequence);
        let insert = "INSERT INTO audits VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)";
        self.to.prepare_cached(insert)?.execute(params![
            sequence,
            era,
            at,
            signed(record.revision.term),
            signed(record.revision.epoch),
            signed(record.division.term),
            signed(record.division.epoch),
            record.mean,
            record.physical_mean,
            word(record.verdict),
        ])?;
        let mut teams =
            self.to.prepare_cached("INSERT OR REPLACE INTO audit_teams VALUES (?1, ?2, ?3)")?;
        for (team, mean) in &record.per_team {
            teams.execute(params![sequence, team.as_str(), mean])?;
        }
        drop(teams);
        self.coverage.audit = Some(record.revision);
        Ok(())
    }

    fn event(&mut self, at: i64, record: &EventRecord) -> rusqlite::Result<()> {
        let insert = "INSERT INTO events VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
        self.to.prepare_cached(insert)?.execute(params![
            signed(self.position.sequence),
            at,
            record.source.as_str(),
            signed(record.revision.term),
            signed(record.revision.epoch),
            word(record.severity),
            record.kind,
            record.detail,
        ])?;
        let newest = EventCoverage { source: record.source, revision: record.revision };
        self.coverage.events.retain(|of| of.source != record.source);
        self.coverage.events.push(newest);
        self.coverage.events.sort_by_key(|of| of.source);
        Ok(())
    }

    fn positions(&mut self, era: i64, at: i64, record: &PositionsRecord) -> rusqlite::Result<()> {
        let sequence = signed(self.position.sequence);
        self.to.prepare_cached("INSERT INTO surveys VALUES (?1, ?2, ?3, ?4)")?.execute(params![
            sequence,
            era,
            at,
            record.is_whole
        ])?;
        let mut positions =
            self.to.prepare_cached("INSERT INTO positions VALUES (?1, ?2, ?3, ?4)")?;
        for (robot, [east, north]) in &record.robots {
            positions.execute(params![sequence, robot.as_str(), east, north])?;
        }
        Ok(())
    }

    fn present(&mut self, at: i64, robots: &[RobotId]) -> rusqlite::Result<()> {
        let open: Vec<String> = {
            let mut open = self
                .to
                .prepare_cached("SELECT robot FROM stays WHERE left_us IS NULL ORDER BY stay")?;
            let names = open.query_map([], |row| row.get(0))?;
            names.collect::<rusqlite::Result<_>>()?
        };
        let there: std::collections::BTreeSet<&str> = robots.iter().map(RobotId::as_str).collect();
        let mut ending = self.to.prepare_cached(END_STAY)?;
        for gone in open.iter().filter(|robot| !there.contains(robot.as_str())) {
            let reason = word(LeaveReason::Unrecorded);
            ending.execute(params![gone, at, Option::<i64>::None, reason])?;
        }
        drop(ending);
        robots.iter().try_for_each(|robot| self.begin_stay(at, robot, None))
    }

    /// A robot is there from now on; one that is there already stays.
    fn begin_stay(
        &mut self,
        at: i64,
        robot: &RobotId,
        joined: Option<i64>,
    ) -> rusqlite::Result<()> {
        self.to.prepare_cached(BEGIN_STAY)?.execute(params![robot.as_str(), joined, at])?;
        Ok(())
    }

    fn end_stay(
        &mut self,
        at: i64,
        robot: &RobotId,
        last_seen: Option<i64>,
        reason: LeaveReason,
    ) -> rusqlite::Result<()> {
        let reason = word(reason);
        self.to.prepare_cached(END_STAY)?.execute(params![
            robot.as_str(),
            at,
            last_seen,
            reason
        ])?;
        Ok(())
    }
}

const BEGIN_STAY: &str = "INSERT INTO stays (robot, joined_us, recorded_us) SELECT ?1, ?2, ?3 \
     WHERE NOT EXISTS (SELECT 1 FROM stays WHERE robot = ?1 AND left_us IS NULL)";

const END_STAY: &str = "UPDATE stays SET left_us = ?2, last_seen_us = ?3, reason = ?4 \
     WHERE robot = ?1 AND left_us IS NULL";
