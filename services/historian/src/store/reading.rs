//! How questions are answered.

use std::collections::BTreeMap;

use muster_model::history::{
    Coverage, DivisionRow, EventCoverage, EventRow, Page, PastAudit, PastDivision, Place, PlaceRow,
    Query, Rows, StayRow, Subject, TeamMean, TeamRow,
};
use muster_model::id::{RobotId, TeamId};
use muster_model::time::Tick;
use muster_service::records::{DivisionHead, MAX_PAGE_BYTES, PastPositions, past_division};
use rusqlite::{Connection, OptionalExtension as _, Params, Row, params};

use super::values::{moment, number, read, read_some, revision, signed, some_moment, unsigned};

fn pragma(connection: &Connection, name: &str) -> rusqlite::Result<u64> {
    connection.query_row(&format!("PRAGMA {name}"), [], |row| number(row, 0))
}

/// The size of the file, without its journal.
pub(super) fn bytes(connection: &Connection) -> rusqlite::Result<u64> {
    Ok(pragma(connection, "page_count")? * pragma(connection, "page_size")?)
}

/// How many bytes of the file are in use.
pub(super) fn used_bytes(connection: &Connection) -> rusqlite::Result<u64> {
    let free = pragma(connection, "freelist_count")? * pragma(connection, "page_size")?;
    Ok(bytes(connection)?.saturating_sub(free))
}

/// The moment of the oldest record.
pub(super) fn recorded_from(connection: &Connection) -> rusqlite::Result<Option<Tick>> {
    let oldest = "SELECT at_us FROM minutes ORDER BY first_seq LIMIT 1";
    connection.query_row(oldest, [], |row| moment(row, 0)).optional()
}

/// What is on the disk.
pub(super) fn coverage(connection: &Connection) -> rusqlite::Result<Coverage> {
    let meta = |key: &str| {
        let value = "SELECT value FROM meta WHERE key = ?1";
        connection.query_row(value, [key], |row| number(row, 0)).optional()
    };
    let newest = |table: &str| {
        let newest = format!("SELECT term, epoch FROM {table} ORDER BY seq DESC LIMIT 1");
        connection.query_row(&newest, [], |row| revision(row, 0)).optional()
    };
    // Of the row with the highest number, as SQLite promises for a single max.
    let mut events =
        connection.prepare("SELECT source, term, epoch, max(seq) FROM events GROUP BY source")?;
    let events = events.query_map([], |row| {
        Ok(EventCoverage { source: read(row, 0)?, revision: revision(row, 1)? })
    })?;
    let mut events: Vec<EventCoverage> = events.collect::<rusqlite::Result<_>>()?;
    events.sort_by_key(|of| of.source);
    Ok(Coverage {
        recorded_from: recorded_from(connection)?,
        recorded_through: meta("through_us")?.map(Tick),
        sequence: meta("sequence")?.unwrap_or(0),
        division: newest("divisions")?,
        audit: newest("audits")?,
        events,
        bytes: bytes(connection)?,
    })
}

/// Answers a question.
pub(super) fn answer(connection: &Connection, query: &Query) -> rusqlite::Result<Page> {
    match &query.subject {
        Subject::AsOf(moment) => {
            let division = as_of(connection, *moment)?.map(Box::new);
            Ok(Page { rows: Rows::AsOf(division), before: None })
        }
        Subject::Divisions => divisions(connection, query),
        Subject::Robot(robot) => places(connection, query, robot),
        Subject::Team(team) => team_rows(connection, query, team),
        Subject::Events(kind) => events(connection, query, kind.as_deref()),
        Subject::Robots(robot) => stays(connection, query, robot.as_ref()),
    }
}

/// The bounds of a question as SQLite takes them: since, until, before, and one row more than asked for.
fn bounds(query: &Query) -> [i64; 4] {
    [
        query.since.map_or(0, |since| signed(since.0)),
        query.until.map_or(i64::MAX, |until| signed(until.0)),
        query.before.map_or(i64::MAX, signed),
        i64::try_from(query.rows()).unwrap_or(i64::MAX - 1) + 1,
    ]
}

/// Reads rows, one more than asked for, and leaves that one out: there are further ones then.
fn page<T>(
    connection: &Connection,
    query: &Query,
    statement: &str,
    params: impl Params,
    read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
    key: impl Fn(&T) -> u64,
    weight: impl Fn(&T) -> usize,
) -> rusqlite::Result<(Vec<T>, Option<u64>)> {
    let mut prepared = connection.prepare_cached(statement)?;
    let (mut rows, mut bytes, mut before): (Vec<T>, usize, _) = (Vec::new(), 0, None);
    for row in prepared.query_map(params, read)? {
        let row = row?;
        bytes += weight(&row);
        if rows.len() == query.rows() || (bytes > MAX_PAGE_BYTES && !rows.is_empty()) {
            before = rows.last().map(&key);
            break;
        }
        rows.push(row);
    }
    Ok((rows, before))
}

/// The number of the last row of a table until a moment. Within an era, moments and numbers grow together.
fn last_until(connection: &Connection, table: &str, moment: Tick) -> rusqlite::Result<Option<i64>> {
    let mut eras =
        connection.prepare_cached("SELECT era FROM eras WHERE first_us <= ?1 ORDER BY era DESC")?;
    let mut last = connection.prepare_cached(&format!(
        "SELECT seq FROM {table} WHERE era = ?1 AND at_us <= ?2 ORDER BY at_us DESC, seq DESC LIMIT 1"
    ))?;
    let mut eras = eras.query([signed(moment.0)])?;
    while let Some(era) = eras.next()? {
        let era: i64 = era.get(0)?;
        let found = last.query_row([era, signed(moment.0)], |row| row.get(0)).optional()?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

fn as_of(connection: &Connection, moment: Tick) -> rusqlite::Result<Option<PastDivision>> {
    let Some(last) = last_until(connection, "divisions", moment)? else { return Ok(None) };
    let whole: Option<i64> = connection.query_row(
        "SELECT max(seq) FROM divisions WHERE snapshot IS NOT NULL AND seq <= ?1",
        [last],
        |row| row.get(0),
    )?;
    let Some(whole) = whole else { return Ok(None) };
    let place = |row: &Row<'_>| {
        Ok(Place {
            robot: read(row, 0)?,
            present: row.get(1)?,
            team: read_some(row, 2)?,
            stale: row.get(3)?,
            was: None,
        })
    };
    let mut places: BTreeMap<RobotId, Place> = BTreeMap::new();
    for (statement, until) in [
        ("SELECT robot, present, team, stale FROM places WHERE division BETWEEN ?1 AND ?2", whole),
        (
            "SELECT robot, present, team, stale FROM moves WHERE division BETWEEN ?1 AND ?2 \
             ORDER BY division",
            last,
        ),
    ] {
        let mut found = connection.prepare_cached(statement)?;
        for found in found.query_map([whole, until], place)? {
            let found: Place = found?;
            places.insert(found.robot.clone(), found);
        }
    }
    let mut leaders: BTreeMap<TeamId, Option<RobotId>> = BTreeMap::new();
    let mut lines = connection.prepare_cached(
        "SELECT team, leader FROM division_teams WHERE division BETWEEN ?1 AND ?2 ORDER BY division",
    )?;
    for line in lines.query_map([whole, last], |row| Ok((read(row, 0)?, read_some(row, 1)?)))? {
        let (team, leader) = line?;
        leaders.insert(team, leader);
    }
    let head = connection.query_row(
        "SELECT seq, at_us, term, epoch, requested FROM divisions WHERE seq = ?1",
        [last],
        |row| {
            Ok(DivisionHead {
                sequence: number(row, 0)?,
                at: self::moment(row, 1)?,
                revision: revision(row, 2)?,
                requested: row.get(4)?,
            })
        },
    )?;
    let audit = match last_until(connection, "audits", moment)? {
        Some(audit) => Some(past_audit(connection, audit)?),
        None => None,
    };
    let leader = |team: &TeamId| leaders.get(team).cloned().flatten();
    let positions = positions(connection, moment)?;
    Ok(Some(past_division(head, places.into_values(), leader, audit, positions)))
}

/// The last positions until a moment.
fn positions(connection: &Connection, moment: Tick) -> rusqlite::Result<PastPositions> {
    let Some(last) = last_until(connection, "surveys", moment)? else {
        return Ok(PastPositions::default());
    };
    let mut known = PastPositions {
        at: connection.query_row("SELECT at_us FROM surveys WHERE seq = ?1", [last], |row| {
            self::moment(row, 0).map(Some)
        })?,
        ..PastPositions::default()
    };
    let whole: Option<i64> = connection.query_row(
        "SELECT max(seq) FROM surveys WHERE is_whole AND seq <= ?1",
        [last],
        |row| row.get(0),
    )?;
    let mut found = connection
        .prepare_cached("SELECT robot, east_cm, north_cm FROM positions WHERE survey = ?1")?;
    for survey in whole.into_iter().chain([last]) {
        let place = |row: &Row<'_>| Ok((read(row, 0)?, [row.get(1)?, row.get(2)?]));
        for found in found.query_map([survey], place)? {
            let (robot, at) = found?;
            known.robots.insert(robot, at);
        }
    }
    Ok(known)
}

fn past_audit(connection: &Connection, sequence: i64) -> rusqlite::Result<PastAudit> {
    let mut means = connection
        .prepare_cached("SELECT team, mean FROM audit_teams WHERE audit = ?1 ORDER BY team")?;
    let means = means
        .query_map([sequence], |row| Ok(TeamMean { team: read(row, 0)?, mean: row.get(1)? }))?;
    let per_team = means.collect::<rusqlite::Result<_>>()?;
    connection.query_row(
        "SELECT at_us, division_term, division_epoch, mean, physical_mean, verdict FROM audits \
         WHERE seq = ?1",
        [sequence],
        |row| {
            Ok(PastAudit {
                sequence: unsigned(sequence),
                at: moment(row, 0)?,
                division: revision(row, 1)?,
                mean: row.get(3)?,
                physical_mean: row.get(4)?,
                verdict: read(row, 5)?,
                per_team,
            })
        },
    )
}

fn divisions(connection: &Connection, query: &Query) -> rusqlite::Result<Page> {
    let statement = "SELECT seq, at_us, term, epoch, requested, teams, robots, snapshot, \
         (SELECT count(*) FROM moves WHERE division = seq) FROM divisions \
         WHERE snapshot IS NOT 'periodic' AND at_us BETWEEN ?1 AND ?2 AND seq < ?3 \
         ORDER BY seq DESC LIMIT ?4";
    let read_row = |row: &Row<'_>| {
        Ok(DivisionRow {
            sequence: number(row, 0)?,
            at: moment(row, 1)?,
            revision: revision(row, 2)?,
            requested: row.get(4)?,
            teams: row.get(5)?,
            robots: row.get(6)?,
            snapshot: read_some(row, 7)?,
            changed: row.get(8)?,
        })
    };
    let (rows, before) =
        page(connection, query, statement, bounds(query), read_row, |row| row.sequence, |_| 0)?;
    Ok(Page { rows: Rows::Divisions(rows), before })
}

fn places(connection: &Connection, query: &Query, robot: &RobotId) -> rusqlite::Result<Page> {
    let statement = "SELECT seq, at_us, team, was, present, stale, snapshot FROM ( \
         SELECT d.seq, d.at_us, m.team, m.was, m.present, m.stale, d.snapshot \
         FROM moves m JOIN divisions d ON d.seq = m.division WHERE m.robot = ?5 \
         UNION ALL \
         SELECT d.seq, d.at_us, p.team, NULL, p.present, p.stale, d.snapshot \
         FROM divisions d JOIN places p ON p.division = d.seq AND p.robot = ?5 \
         WHERE d.snapshot IS NOT NULL AND d.snapshot <> 'periodic') \
         WHERE at_us BETWEEN ?1 AND ?2 AND seq < ?3 ORDER BY seq DESC LIMIT ?4";
    let read_row = |row: &Row<'_>| {
        Ok(PlaceRow {
            sequence: number(row, 0)?,
            at: moment(row, 1)?,
            team: read_some(row, 2)?,
            was: read_some(row, 3)?,
            present: row.get(4)?,
            stale: row.get(5)?,
            snapshot: read_some(row, 6)?,
        })
    };
    let [since, until, before, limit] = bounds(query);
    let params = params![since, until, before, limit, robot.as_str()];
    let (rows, before) =
        page(connection, query, statement, params, read_row, |row| row.sequence, |_| 0)?;
    Ok(Page { rows: Rows::Robot(rows), before })
}

fn team_rows(connection: &Connection, query: &Query, team: &TeamId) -> rusqlite::Result<Page> {
    let statement = "SELECT d.seq, d.at_us, t.leader, t.members FROM division_teams t \
         JOIN divisions d ON d.seq = t.division \
         WHERE t.team = ?5 AND d.snapshot IS NOT 'periodic' \
         AND d.at_us BETWEEN ?1 AND ?2 AND d.seq < ?3 ORDER BY d.seq DESC LIMIT ?4";
    let mut moves = connection.prepare_cached(
        "SELECT robot, present AND team IS ?2, was IS ?2 FROM moves WHERE division = ?1 ORDER BY robot",
    )?;
    let read_row = |row: &Row<'_>| {
        let (mut came, mut went) = (Vec::new(), Vec::new());
        let sequence: i64 = row.get(0)?;
        let mut moves = moves.query(params![sequence, team.as_str()])?;
        while let Some(place) = moves.next()? {
            match (place.get(1)?, place.get(2)?) {
                (true, false) => came.push(read(place, 0)?),
                (false, true) => went.push(read(place, 0)?),
                _ => {}
            }
        }
        Ok(TeamRow {
            sequence: unsigned(sequence),
            at: moment(row, 1)?,
            leader: read_some(row, 2)?,
            members: row.get(3)?,
            came,
            went,
        })
    };
    let [since, until, before, limit] = bounds(query);
    let params = params![since, until, before, limit, team.as_str()];
    let (rows, before) =
        page(connection, query, statement, params, read_row, |row| row.sequence, TeamRow::weight)?;
    Ok(Page { rows: Rows::Team(rows), before })
}

fn events(connection: &Connection, query: &Query, kind: Option<&str>) -> rusqlite::Result<Page> {
    let statement = "SELECT seq, at_us, source, term, epoch, severity, kind, detail FROM events \
         WHERE (?5 IS NULL OR kind = ?5) AND at_us BETWEEN ?1 AND ?2 AND seq < ?3 \
         ORDER BY seq DESC LIMIT ?4";
    let read_row = |row: &Row<'_>| {
        Ok(EventRow {
            sequence: number(row, 0)?,
            at: moment(row, 1)?,
            source: read(row, 2)?,
            revision: revision(row, 3)?,
            severity: read(row, 5)?,
            event: row.get(6)?,
            detail: row.get(7)?,
        })
    };
    let [since, until, before, limit] = bounds(query);
    let params = params![since, until, before, limit, kind];
    let (rows, before) =
        page(connection, query, statement, params, read_row, |row| row.sequence, EventRow::weight)?;
    Ok(Page { rows: Rows::Events(rows), before })
}

fn stays(
    connection: &Connection,
    query: &Query,
    robot: Option<&RobotId>,
) -> rusqlite::Result<Page> {
    let statement = "SELECT stay, robot, joined_us, recorded_us, left_us, last_seen_us, reason FROM stays \
         WHERE (?5 IS NULL OR robot = ?5) AND recorded_us <= ?2 AND (left_us IS NULL OR left_us >= ?1) \
         AND stay < ?3 ORDER BY stay DESC LIMIT ?4";
    let read_row = |row: &Row<'_>| {
        Ok(StayRow {
            sequence: number(row, 0)?,
            robot: read(row, 1)?,
            joined: some_moment(row, 2)?,
            recorded: moment(row, 3)?,
            left: some_moment(row, 4)?,
            last_seen: some_moment(row, 5)?,
            reason: read_some(row, 6)?,
        })
    };
    let [since, until, before, limit] = bounds(query);
    let params = params![since, until, before, limit, robot.map(RobotId::as_str)];
    let (rows, before) =
        page(connection, query, statement, params, read_row, |row| row.sequence, |_| 0)?;
    Ok(Page { rows: Rows::Robots(rows), before })
}
