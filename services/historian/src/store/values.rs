//! How values stand in columns.

use muster_model::header::Revision;
use muster_model::time::Tick;
use rusqlite::Row;
use rusqlite::types::Type;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A number as SQLite has them, which are signed.
pub(super) fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

pub(super) fn unsigned(number: i64) -> u64 {
    u64::try_from(number).unwrap_or(0)
}

/// The word that a value is in JSON.
pub(super) fn word<T: Serialize>(value: T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

fn parsed<T: DeserializeOwned>(column: usize, text: String) -> rusqlite::Result<T> {
    serde_json::from_value(serde_json::Value::String(text)).map_err(|error| {
        rusqlite::Error::FromSqlConversionFailure(column, Type::Text, Box::new(error))
    })
}

/// A value out of the word that it is in JSON: an id, or one of several.
pub(super) fn read<T: DeserializeOwned>(row: &Row<'_>, column: usize) -> rusqlite::Result<T> {
    parsed(column, row.get(column)?)
}

/// The same, where there may be none.
pub(super) fn read_some<T: DeserializeOwned>(
    row: &Row<'_>,
    column: usize,
) -> rusqlite::Result<Option<T>> {
    let text: Option<String> = row.get(column)?;
    text.map(|text| parsed(column, text)).transpose()
}

pub(super) fn number(row: &Row<'_>, column: usize) -> rusqlite::Result<u64> {
    Ok(unsigned(row.get(column)?))
}

pub(super) fn moment(row: &Row<'_>, column: usize) -> rusqlite::Result<Tick> {
    Ok(Tick(number(row, column)?))
}

pub(super) fn some_moment(row: &Row<'_>, column: usize) -> rusqlite::Result<Option<Tick>> {
    let moment: Option<i64> = row.get(column)?;
    Ok(moment.map(|moment| Tick(unsigned(moment))))
}

/// A term in one column, and an epoch in the next.
pub(super) fn revision(row: &Row<'_>, column: usize) -> rusqlite::Result<Revision> {
    Ok(Revision { term: number(row, column)?, epoch: number(row, column + 1)? })
}
