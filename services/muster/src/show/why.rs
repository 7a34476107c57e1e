//! `muster why`: why a robot is in its team.

use std::io::Write as _;

use muster_model::id::{Modality, RobotId};
use muster_model::why::{Reason, TeamReason, Why};
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_wire::json::EdgeJson;

use super::page::{Column, Page};
use crate::console::{self, exit_error};

/// Arguments of `muster why`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A robot is in the team with the largest score, 2 x·c − ‖c‖², as that is the nearest one. The score is the \
sum of one pull per modality, what the robot's self-loop keeps (itself), the spread of the team, and what rounding leaves \
(rest). What decides is the total: the score, less the price of a place where teams have limits and of a \
needed skill, and with what the \
hysteresis gives the robot's own team.\n\nExamples:\n  muster why r7\n  muster why r7 --json"
)]
pub(crate) struct WhyArgs {
    /// The robot
    robot: RobotId,
    /// Print JSON: one line
    #[arg(long)]
    json: bool,
}

/// Shows why a robot is in its team.
///
/// # Errors
/// If the robot is unknown or in no team, or no router or no service answers.
pub(crate) async fn run(args: &WhyArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let client = console::open(config).await?;
    let why = client.get_reason(&args.robot).await;
    client.close().await;
    let why = why.map_err(exit_error)?;
    let mut out = std::io::stdout().lock();
    if args.json {
        out.write_all(&why.to_json(Clock::start().now())?)?;
        writeln!(out)?;
    } else {
        for line in lines(&why, &Page::of_stdout()) {
            writeln!(out, "{line}")?;
        }
    }
    Ok(out.flush()?)
}

/// A number as the table has it; rounding has no sign.
fn shown(number: f64) -> String {
    let text = format!("{number:.3}");
    if text == "-0.000" { "0.000".to_owned() } else { text }
}

/// The paragraph, and a table of the parts of each total.
fn lines(why: &Why, page: &Page) -> Vec<String> {
    let Reason { text, teams, .. } = &why.reason;
    let names: Vec<&Modality> = teams
        .first()
        .into_iter()
        .flat_map(|team| &team.modalities)
        .map(|of| &of.modality)
        .collect();
    let mut columns: Vec<Column> = ["team", "robots", "total"].map(Column::kept).to_vec();
    columns.extend(names.iter().map(|name| Column::kept(name.as_str())));
    columns.extend(["itself", "spread", "rest", "price", "skill", "hysteresis"].map(Column::kept));
    let row = |team: &TeamReason| {
        let pull = |name: &&Modality| {
            let pull = team.modalities.iter().find(|of| of.modality == **name);
            pull.map_or(0.0, |of| of.pull)
        };
        let numbers = [team.total].into_iter().chain(names.iter().map(pull)).chain([
            team.itself,
            team.spread,
            team.rest,
            // These are taken away.
            0.0 - team.price,
            0.0 - team.skill_price,
            team.hysteresis,
        ]);
        let name =
            if team.barred { format!("{} (barred)", team.team) } else { team.team.to_string() };
        let robots = match team.max {
            Some(max) => format!("{} of {max}", team.robots),
            None => team.robots.to_string(),
        };
        [name, robots].into_iter().chain(numbers.map(shown)).collect()
    };
    let mut lines = vec![text.clone(), String::new()];
    lines.extend(page.table(&columns, teams.iter().map(row)));
    lines
}
