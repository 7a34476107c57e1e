//! How records are forgotten: whole minutes, the oldest first.
//!
//! Of divisions and positions, the last whole ones before what is kept stay, with what rests on them: without them, what
//! is kept could not be read.

use muster_model::history::Retention;
use rusqlite::{Connection, OptionalExtension as _};

use super::reading;
use super::values::{signed, unsigned};
use super::writing::MINUTE_US;

/// Most minutes that are forgotten in one transaction: records of a few hours take far less than a second.
const MAX_MINUTES: i64 = 240;

/// Pages that one transaction gives back to the disk at most: 8 MiB.
const MAX_PAGES: i64 = 2048;

/// What part of the minutes goes when there is no room: one of so many.
const PART_OF_MINUTES: i64 = 20;

/// Minutes that are never forgotten for want of room: what is being looked at.
const MIN_MINUTES: i64 = 2;

/// Forgets what is too old or too much, and gives room back to the disk unless that is full. True if something is
/// left to forget.
pub(super) fn retain(
    connection: &mut Connection,
    retention: &Retention,
    is_short: bool,
) -> rusqlite::Result<bool> {
    let old = old_minutes(connection, retention)?;
    let used = reading::used_bytes(connection)?;
    let excess = used.saturating_sub(retention.max_bytes);
    let much = if excess == 0 {
        0
    } else {
        let minutes = unsigned(minutes(connection)?);
        signed((u128::from(minutes) * u128::from(excess) / u128::from(used)) as u64 + 1)
    };
    let wanted = old.max(much);
    let forgot = forget(connection, wanted.min(MAX_MINUTES), 1)?;
    if !is_short {
        vacuum(connection)?;
    }
    Ok(forgot && (wanted > MAX_MINUTES || much > 0))
}

/// Deletes some of the oldest minutes. False if there are none but the last ones.
pub(super) fn oldest_minutes(connection: &mut Connection) -> rusqlite::Result<bool> {
    let count = minutes(connection)? / PART_OF_MINUTES + 1;
    forget(connection, count.min(MAX_MINUTES), MIN_MINUTES)
}

fn minutes(connection: &Connection) -> rusqlite::Result<i64> {
    connection.query_row("SELECT count(*) FROM minutes", [], |row| row.get(0))
}

/// How many of the oldest minutes have ended before the moment of a retention, one after the other.
fn old_minutes(connection: &Connection, retention: &Retention) -> rusqlite::Result<i64> {
    let young: Option<i64> = connection
        .query_row(
            "SELECT first_seq FROM minutes WHERE at_us / ?1 * ?1 + ?1 > ?2 ORDER BY first_seq LIMIT 1",
            [signed(MINUTE_US), signed(retention.before.0)],
            |row| row.get(0),
        )
        .optional()?;
    connection.query_row(
        "SELECT count(*) FROM minutes WHERE first_seq < ?1",
        [young.unwrap_or(i64::MAX)],
        |row| row.get(0),
    )
}

/// Forgets so many of the oldest minutes, and leaves at least one, and as many as are to stay. True if any was
/// forgotten.
fn forget(connection: &mut Connection, count: i64, stay: i64) -> rusqlite::Result<bool> {
    let all = minutes(connection)?;
    let count = count.min(all - stay);
    if count <= 0 {
        return Ok(false);
    }
    let deleting = connection.transaction()?;
    let (cut, moment): (i64, i64) = deleting.query_row(
        "SELECT first_seq, at_us FROM minutes ORDER BY first_seq LIMIT 1 OFFSET ?1",
        [count],
        |row| Ok((row.get(0)?, row.get(1)?)),
    )?;
    let whole: Option<i64> = deleting.query_row(
        "SELECT max(seq) FROM divisions WHERE snapshot IS NOT NULL AND seq <= ?1",
        [cut],
        |row| row.get(0),
    )?;
    let base = whole.unwrap_or(0);
    for statement in [
        "DELETE FROM places WHERE division < ?1",
        "DELETE FROM moves WHERE division < ?1",
        "DELETE FROM division_teams WHERE division < ?1",
        "DELETE FROM divisions WHERE seq < ?1",
    ] {
        deleting.execute(statement, [base])?;
    }
    let whole: Option<i64> = deleting.query_row(
        "SELECT max(seq) FROM surveys WHERE is_whole AND seq <= ?1",
        [cut],
        |row| row.get(0),
    )?;
    // Positions rest on the last whole survey alone, so that of the others the last one until the cut is enough.
    let newest: Option<i64> =
        deleting
            .query_row("SELECT max(seq) FROM surveys WHERE seq <= ?1", [cut], |row| row.get(0))?;
    let kept = [cut, whole.unwrap_or(cut), newest.unwrap_or(cut)];
    deleting.execute("DELETE FROM positions WHERE survey < ?1 AND survey NOT IN (?2, ?3)", kept)?;
    deleting.execute("DELETE FROM surveys WHERE seq < ?1 AND seq NOT IN (?2, ?3)", kept)?;
    for statement in [
        "DELETE FROM audit_teams WHERE audit < ?1",
        "DELETE FROM audits WHERE seq < ?1",
        "DELETE FROM events WHERE seq < ?1",
        "DELETE FROM gaps WHERE seq < ?1",
        "DELETE FROM minutes WHERE first_seq < ?1",
        // The settings in force are known to the end.
        "DELETE FROM settings WHERE seq < ?1 AND seq NOT IN (SELECT max(seq) FROM settings GROUP BY service)",
    ] {
        deleting.execute(statement, [cut])?;
    }
    deleting.execute("DELETE FROM stays WHERE left_us < ?1", [moment])?;
    // An era ends where the next begins.
    deleting.execute(
        "DELETE FROM eras WHERE era < (SELECT max(era) FROM eras WHERE first_seq <= ?1)",
        [base.min(whole.unwrap_or(cut)).min(cut)],
    )?;
    deleting.commit()?;
    Ok(true)
}

/// Takes all free pages out of the file.
pub(super) fn vacuum_all(connection: &Connection) -> rusqlite::Result<()> {
    drain(connection, "PRAGMA incremental_vacuum")
}

fn drain(connection: &Connection, pragma: &str) -> rusqlite::Result<()> {
    let mut prepared = connection.prepare(pragma)?;
    let mut rows = prepared.query([])?;
    while rows.next()?.is_some() {}
    Ok(())
}

fn vacuum(connection: &Connection) -> rusqlite::Result<()> {
    let free: i64 = connection.query_row("PRAGMA freelist_count", [], |row| row.get(0))?;
    // A few free pages are used again soon.
    if free < MAX_PAGES / 8 {
        return Ok(());
    }
    drain(connection, &format!("PRAGMA incremental_vacuum({MAX_PAGES})"))
}
