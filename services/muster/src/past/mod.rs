//! What a fleet was: `muster history`, `muster events` and `muster robots` ask the recordings of `historian`.

mod moment;
mod table;
mod text;

use std::io::Write as _;

use muster_client::Client;
use muster_model::history::{HistoryAnswer, Query, Rows, Subject};
use muster_model::id::{RobotId, TeamId};
use muster_model::limits::MAX_HISTORY_ROWS;
use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;

use crate::console::{self, exit_error};
use crate::show::page::Page;

/// Rows that are printed unless another number is asked for: a few pages of a terminal.
const DEFAULT_ROWS: u32 = 100;

/// Arguments that all commands about the past have.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct SpanArgs {
    /// No rows before this time: 2026-11-23T04:05:06Z, 04:05 (UTC, within the last 24 h), 90s, 10m, 2h or 3d ago, or
    /// seconds since 1970
    #[arg(long, value_name = "TIME")]
    since: Option<String>,
    /// No rows after this time
    #[arg(long, value_name = "TIME")]
    until: Option<String>,
    /// Most rows, the newest
    #[arg(long, value_name = "N", default_value_t = DEFAULT_ROWS)]
    limit: u32,
    /// Print JSON: one object on one line
    #[arg(long, conflicts_with = "csv")]
    json: bool,
    /// Print comma-separated values, with a line of names
    #[arg(long)]
    csv: bool,
}

/// Arguments of `muster history`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "A `historian` must run, and has recorded only what happened while it did. Times are UTC.\n\n\
Examples:\n  muster history                        divisions that changed something, the newest last\n  \
muster history --as-of 10m            the fleet as it was ten minutes ago\n  \
muster history --robot r7 --since 2h  in which teams r7 was\n  \
muster history --team t2 --csv        who came into t2 and went out of it, for a spreadsheet"
)]
pub(crate) struct HistoryArgs {
    /// The fleet as it was at this time, in the forms of --since
    #[arg(long, value_name = "TIME", conflicts_with_all = ["robot", "team", "since", "until"])]
    as_of: Option<String>,
    /// In which teams a robot was
    #[arg(long, value_name = "ROBOT", conflicts_with = "team")]
    robot: Option<RobotId>,
    /// Who came into a team and went out of it, and who led it
    #[arg(long, value_name = "TEAM")]
    team: Option<TeamId>,
    #[command(flatten)]
    span: SpanArgs,
}

/// Arguments of `muster events`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "A `historian` must run, and has recorded only what happened while it did. Times are UTC.\n\n\
Examples:\n  muster events --since 1h\n  muster events --kind robots_left --limit 20\n  \
muster events --since 2026-11-23T04:00:00Z --json"
)]
pub(crate) struct EventsArgs {
    /// Only events of this kind, such as team_changed or robot_left
    #[arg(long, value_name = "KIND")]
    kind: Option<String>,
    #[command(flatten)]
    span: SpanArgs,
}

/// Arguments of `muster robots`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "A `historian` must run, and has recorded only what happened while it did. Times are UTC. A robot that \
left was disconnected (its program ended or lost its link), silent (its link stood and nothing came) or unrecorded (it \
left while no historian ran).\n\n\
Examples:\n  muster robots              every stay in the fleet\n  muster robots --gone       those that left\n  \
muster robots --robot r7"
)]
pub(crate) struct RobotsArgs {
    /// Only this robot
    #[arg(long, value_name = "ROBOT")]
    robot: Option<RobotId>,
    /// Only stays that have ended
    #[arg(long)]
    gone: bool,
    #[command(flatten)]
    span: SpanArgs,
}

fn time(flag: &str, text: Option<&String>, now: Tick) -> Result<Option<Tick>, ExitError> {
    text.map(|text| moment::parse(text, now))
        .transpose()
        .map_err(|problem| ExitError::usage(format!("{flag}: {problem}")))
}

fn query(subject: Subject, span: &SpanArgs, now: Tick) -> Result<Query, ExitError> {
    if span.limit == 0 {
        return Err(ExitError::usage("--limit: must be at least 1"));
    }
    let since = time("--since", span.since.as_ref(), now)?;
    let until = time("--until", span.until.as_ref(), now)?;
    if since.is_some_and(|since| until.is_some_and(|until| until < since)) {
        return Err(ExitError::usage("--until: must not be before --since"));
    }
    Ok(Query { since, until, limit: span.limit.min(MAX_HISTORY_ROWS), ..Query::of(subject) })
}

/// Prints what the fleet was.
///
/// # Errors
/// If an argument is wrong, or no historian answers.
pub(crate) async fn history(args: &HistoryArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let now = Clock::start().now();
    let subject = match (&args.as_of, &args.robot, &args.team) {
        (Some(as_of), _, _) => {
            let moment = time("--as-of", Some(as_of), now)?.unwrap_or(now);
            Subject::AsOf(moment)
        }
        (None, Some(robot), _) => Subject::Robot(robot.clone()),
        (None, None, Some(team)) => Subject::Team(team.clone()),
        (None, None, None) => Subject::Divisions,
    };
    run(query(subject, &args.span, now)?, &args.span, config, |_| {}).await
}

/// Prints what happened.
///
/// # Errors
/// If an argument is wrong, or no historian answers.
pub(crate) async fn events(args: &EventsArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let query = query(Subject::Events(args.kind.clone()), &args.span, Clock::start().now())?;
    run(query, &args.span, config, |_| {}).await
}

/// Prints which robots joined and left.
///
/// # Errors
/// If an argument is wrong, or no historian answers.
pub(crate) async fn robots(args: &RobotsArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let query = query(Subject::Robots(args.robot.clone()), &args.span, Clock::start().now())?;
    let gone = args.gone;
    let keep = move |answer: &mut HistoryAnswer| {
        if let Rows::Robots(rows) = &mut answer.rows {
            rows.retain(|row| !gone || row.left.is_some());
        }
    };
    run(query, &args.span, config, keep).await
}

async fn run(
    query: Query,
    span: &SpanArgs,
    config: &ProcessConfig,
    keep: impl Fn(&mut HistoryAnswer),
) -> anyhow::Result<()> {
    let client = console::open(config).await?;
    let answer = ask(&client, query, span.limit as usize, keep).await;
    client.close().await;
    let answer = answer.map_err(exit_error)?;
    let mut out = std::io::stdout().lock();
    if span.json {
        writeln!(out, "{}", serde_json::to_string(&answer)?)?;
    } else if span.csv {
        for line in table::csv(&answer.rows) {
            writeln!(out, "{line}")?;
        }
    } else {
        for line in text::lines(&answer, &Page::of_stdout()) {
            writeln!(out, "{line}")?;
        }
    }
    Ok(out.flush()?)
}

/// Asks until there are as many rows as wanted, or no more.
async fn ask(
    client: &Client,
    mut query: Query,
    wanted: usize,
    keep: impl Fn(&mut HistoryAnswer),
) -> Result<HistoryAnswer, muster_client::Error> {
    let mut answer = client.get_history(&query).await?;
    keep(&mut answer);
    while let Some(before) = answer.before.filter(|_| count(&answer.rows) < wanted) {
        query.before = Some(before);
        let mut next = client.get_history_of(&answer.instance, &query).await?;
        keep(&mut next);
        answer.before = next.before;
        append(&mut answer.rows, next.rows);
    }
    keep_first(&mut answer, wanted);
    Ok(answer)
}

macro_rules! each_list {
    ($rows:expr, $list:ident => $then:expr, $other:expr) => {
        match $rows {
            Rows::AsOf(_) => $other,
            Rows::Divisions($list) => $then,
            Rows::Robot($list) => $then,
            Rows::Team($list) => $then,
            Rows::Events($list) => $then,
            Rows::Robots($list) => $then,
        }
    };
}

fn count(rows: &Rows) -> usize {
    each_list!(rows, list => list.len(), 1)
}

/// Keeps as many rows as wanted. The further ones begin behind the last of them.
fn keep_first(answer: &mut HistoryAnswer, wanted: usize) {
    if count(&answer.rows) > wanted {
        each_list!(&mut answer.rows, list => list.truncate(wanted), ());
        let last = each_list!(&answer.rows, list => list.last().map(|row| row.sequence), None);
        answer.before = last.or(answer.before);
    }
}

fn append(rows: &mut Rows, more: Rows) {
    match (rows, more) {
        (Rows::Divisions(rows), Rows::Divisions(mut more)) => rows.append(&mut more),
        (Rows::Robot(rows), Rows::Robot(mut more)) => rows.append(&mut more),
        (Rows::Team(rows), Rows::Team(mut more)) => rows.append(&mut more),
        (Rows::Events(rows), Rows::Events(mut more)) => rows.append(&mut more),
        (Rows::Robots(rows), Rows::Robots(mut more)) => rows.append(&mut more),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use muster_model::history::StayRow;
    use muster_model::id::{FleetId, InstanceId};

    use super::*;

    #[test]
    fn further_rows_begin_behind_the_last_one_that_is_kept() {
        let stay = |sequence| StayRow {
            sequence,
            robot: RobotId::new("r1").unwrap(),
            joined: None,
            recorded: Tick(0),
            left: None,
            last_seen: None,
            reason: None,
        };
        let answer = || HistoryAnswer {
            fleet: FleetId::new("alpha").unwrap(),
            instance: InstanceId::new("h").unwrap(),
            recorded_from: None,
            recorded_through: None,
            before: Some(3),
            rows: Rows::Robots([9, 6, 3].map(stay).to_vec()),
        };
        for (wanted, before, left) in [(2, 6, 2), (3, 3, 3), (4, 3, 3)] {
            let mut kept = answer();
            keep_first(&mut kept, wanted);
            assert_eq!((kept.before, count(&kept.rows)), (Some(before), left));
        }
    }
}
