//! How records are forgotten: whole minutes, the oldest first.
//!
//! Of divisions and positions, the last whole ones before what is kept stay, with what rests on them: without them, what
//! is kept could not be read. So do the last scores and settings, which are in force then.

use muster_model::history::Retention;
use rusqlite::{Connection, OptionalExtension as _};

use super::values::{signed, unsigned};
use super::writing::MINUTE_US;
use super::{file, is_full, reading};

/// Most minutes that are forgotten in one transaction: records of a few hours take far less than a second.
const MAX_MINUTES: i64 = 240;

/// Pages that one transaction gives back to the disk at most: 8 MiB.
const MAX_PAGES: i64 = 2048;

/// Pages that one transaction gives back to a disk that is full. With the pages that point to them they take less of the
/// journal than the reserve.
const MAX_SHORT_PAGES: i64 = 32;

/// Most such transactions at once, 2 MiB: each of them waits for the disk.
const MAX_SHORT_STEPS: usize = 16;

/// What part of the minutes goes when there is no room: one of so many.
const PART_OF_MINUTES: i64 = 20;

/// Minutes that are never forgotten for want of room: what is being looked at.
const MIN_MINUTES: i64 = 2;

/// Forgets what is too old or too much, and gives room back to the disk; in small steps, and as far as the file is too
/// large, if that is full. True if something is left to do.
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
    // What is forgotten by its age takes no stay with it that is younger.
    let before = if much > old { i64::MAX } else { signed(retention.before.0) };
    let forgot = forget_some(connection, wanted, 1, before)?;
    let is_short = is_short
        || match vacuum(connection) {
            // There is room for the reserve, and not for the journal of so many pages.
            Err(error) if is_full(&error) => true,
            vacuumed => vacuumed.map(|()| false)?,
        };
    let gives = is_short && vacuum_short(connection, retention.max_bytes)?;
    Ok(gives || forgot.is_some_and(|count| wanted > count || much > 0))
}

/// Deletes some of the oldest minutes. False if there are none but the last ones.
pub(super) fn oldest_minutes(connection: &mut Connection) -> rusqlite::Result<bool> {
    let count = minutes(connection)? / PART_OF_MINUTES + 1;
    Ok(forget_some(connection, count, MIN_MINUTES, i64::MAX)?.is_some())
}

fn minutes(connection: &Connection) -> rusqlite::Result<i64> {
    connection.query_row("SELECT count(*) FROM minutes", [], |row| row.get(0))
}

/// How many of the oldest minutes have ended before the moment of a retention, one after the other. Those that are later
/// than the newest one were recorded by a clock that was ahead: they go once what came after them is old.
fn old_minutes(connection: &Connection, retention: &Retention) -> rusqlite::Result<i64> {
    let (minute, before) = (signed(MINUTE_US), signed(retention.before.0));
    let newest: Option<i64> = connection
        .query_row(
            "SELECT at_us / ?1 FROM minutes ORDER BY first_seq DESC LIMIT 1",
            [minute],
            |row| row.get(0),
        )
        .optional()?;
    let young: Option<i64> = connection
        .query_row(
            "SELECT first_seq FROM minutes WHERE at_us / ?1 * ?1 + ?1 > ?2 AND at_us / ?1 <= ?3 \
             ORDER BY first_seq LIMIT 1",
            [minute, before, newest.unwrap_or(i64::MAX)],
            |row| row.get(0),
        )
        .optional()?;
    connection.query_row(
        "SELECT count(*) FROM minutes WHERE first_seq <= ( \
         SELECT max(first_seq) FROM minutes WHERE at_us / ?1 * ?1 + ?1 <= ?2 AND first_seq < ?3)",
        [minute, before, young.unwrap_or(i64::MAX)],
        |row| row.get(0),
    )
}

/// Forgets so many of the oldest minutes, or fewer: one transaction must be short, and a disk that is full may have no
/// room for the journal of many. Says how many were to go; none if there was nothing to forget.
fn forget_some(
    connection: &mut Connection,
    count: i64,
    stay: i64,
    before: i64,
) -> rusqlite::Result<Option<i64>> {
    let mut count = count.min(MAX_MINUTES);
    loop {
        match forget(connection, count, stay, before) {
            Err(error) if is_full(&error) && count > 1 => count /= 2,
            forgot => return Ok(forgot?.then_some(count)),
        }
    }
}

/// Forgets so many of the oldest minutes, and leaves at least one, and as many as are to stay. Of stays, those go that
/// ended before all that is kept, and before a moment. True if any minute was forgotten.
fn forget(
    connection: &mut Connection,
    count: i64,
    stay: i64,
    before: i64,
) -> rusqlite::Result<bool> {
    let all = minutes(connection)?;
    let count = count.min(all - stay);
    if count <= 0 {
        return Ok(false);
    }
    let deleting = connection.transaction()?;
    let cut: i64 = deleting.query_row(
        "SELECT first_seq FROM minutes ORDER BY first_seq LIMIT 1 OFFSET ?1",
        [count],
        |row| row.get(0),
    )?;
    // The first minute that is kept may be of a clock that was ahead.
    let earliest: i64 = deleting.query_row(
        "SELECT min(at_us / ?1 * ?1) FROM minutes WHERE first_seq >= ?2",
        [signed(MINUTE_US), cut],
        |row| row.get(0),
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
    // The scores in force are known to the end.
    let audit: Option<i64> =
        deleting
            .query_row("SELECT max(seq) FROM audits WHERE seq <= ?1", [cut], |row| row.get(0))?;
    let audit = audit.unwrap_or(cut);
    deleting.execute("DELETE FROM audit_teams WHERE audit < ?1", [audit])?;
    deleting.execute("DELETE FROM audits WHERE seq < ?1", [audit])?;
    for statement in [
        "DELETE FROM events WHERE seq < ?1",
        "DELETE FROM gaps WHERE seq < ?1",
        "DELETE FROM minutes WHERE first_seq < ?1",
        // The settings in force are known to the end.
        "DELETE FROM settings WHERE seq < ?1 AND seq NOT IN (SELECT max(seq) FROM settings GROUP BY service)",
    ] {
        deleting.execute(statement, [cut])?;
    }
    deleting.execute("DELETE FROM stays WHERE left_us < ?1", [earliest.min(before)])?;
    // An era ends where the next begins.
    deleting.execute(
        "DELETE FROM eras WHERE era < (SELECT max(era) FROM eras WHERE first_seq <= ?1)",
        [base.min(whole.unwrap_or(cut)).min(audit)],
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

/// Takes free pages out of a file that is too large on a disk that is full. True if there are more.
fn vacuum_short(connection: &Connection, max_bytes: u64) -> rusqlite::Result<bool> {
    for _ in 0..MAX_SHORT_STEPS {
        // The file becomes shorter, and the journal begins from its start, once all of that is in the file. A reader may
        // hold it up, and the journal must not grow then.
        if !file::checkpoint(connection)? || reading::bytes(connection)? <= max_bytes {
            return Ok(false);
        }
        let free: i64 = connection.query_row("PRAGMA freelist_count", [], |row| row.get(0))?;
        if free == 0 {
            return Ok(false);
        }
        match drain(connection, &format!("PRAGMA incremental_vacuum({MAX_SHORT_PAGES})")) {
            Err(error) if is_full(&error) => return Ok(false),
            drained => drained?,
        }
    }
    file::checkpoint(connection)
}

fn vacuum(connection: &Connection) -> rusqlite::Result<()> {
    let free: i64 = connection.query_row("PRAGMA freelist_count", [], |row| row.get(0))?;
    // A few free pages are used again soon.
    if free < MAX_PAGES / 8 {
        return Ok(());
    }
    drain(connection, &format!("PRAGMA incremental_vacuum({MAX_PAGES})"))
}
