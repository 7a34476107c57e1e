//! `muster teams`: the division of the live fleet.

use std::io::Write as _;

use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_wire::json::EdgeJson;
use muster_wire::{Key, Message};

use super::{ShowArgs, names, table};
use crate::ask;

/// Shows the teams, or every change of them.
///
/// # Errors
/// If no router answers, or nobody knows the teams.
pub(crate) async fn run(args: &ShowArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let clock = Clock::start();
    let bus = ask::open(config).await?;
    if !args.watch {
        let newest = ask::newest(&bus, Key::Teams).await;
        bus.close().await;
        if let Message::Teams { teams, .. } = newest? {
            print(&teams, args.json, clock.now())?;
        }
        return Ok(());
    }
    let mut follow = ask::follow(&bus, Key::Teams).await?;
    let mut shown: Option<std::sync::Arc<Teams>> = None;
    loop {
        let message = follow.next().await;
        if let Message::Teams { teams, .. } = message
            && !shown.as_ref().is_some_and(|shown| shown.same_division(&teams))
        {
            print(&teams, args.json, clock.now())?;
            shown = Some(teams);
        }
    }
}

/// Prints a division as a table, or as one line of JSON in the shape of `json/teams`.
///
/// # Errors
/// If standard output is closed.
pub(crate) fn print(teams: &Teams, json: bool, now: Tick) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if json {
        out.write_all(&teams.to_json(now)?)?;
        writeln!(out)?;
        return Ok(out.flush()?);
    }
    let header = &teams.header;
    writeln!(
        out,
        "fleet {}  term {}  epoch {}  {}",
        header.fleet,
        header.revision.term,
        header.revision.epoch,
        header.data_age_s(now).map_or("no poses".to_owned(), |age| format!("data {age:.2} s old"))
    )?;
    let mut table = table(&["team", "robots", "leader", "members"]);
    for team in &teams.teams {
        table.add_row([
            team.id.to_string(),
            team.members.len().to_string(),
            team.leader.to_string(),
            names(team.members.iter().map(|member| &member.robot)),
        ]);
    }
    if !teams.unassigned.is_empty() {
        let count = teams.unassigned.len().to_string();
        table.add_row(["none".to_owned(), count, String::new(), names(teams.unassigned.iter())]);
    }
    writeln!(out, "{table}")?;
    if !teams.stale.is_empty() {
        writeln!(out, "stale: {}", names(teams.stale.iter()))?;
    }
    for change in &teams.changes {
        writeln!(out, "  {}", describe(change))?;
    }
    Ok(out.flush()?)
}

/// One change in words.
fn describe(change: &muster_model::teams::TeamChange) -> String {
    use muster_model::teams::TeamChange::{Born, Died, Merged, Moved, Split};
    let place = |team: &Option<muster_model::id::TeamId>| {
        team.as_ref().map_or_else(|| "no team".to_owned(), ToString::to_string)
    };
    match change {
        Born { team } => format!("{team} is new"),
        Died { team } => format!("{team} is gone"),
        Split { from, into } => format!("{into} split off {from}"),
        Merged { from, into } => format!("{from} merged into {into}"),
        Moved { robot, from, to } => format!("{robot} moved from {} to {}", place(from), place(to)),
    }
}
