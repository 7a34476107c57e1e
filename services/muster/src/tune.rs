//! `muster tune`: which weights, decay and dimension divide a fleet best.
//!
//! The search is that of `muster-solve`. Here it gets its fleet, from the bus or from a file, and what it
//! proposes is applied where that is asked for.

use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;

use anyhow::Context as _;
use muster_client::Client;
use muster_model::id::ServiceName;
use muster_model::roster::RosterEntry;
use muster_model::settings::ClustererSettings;
use muster_model::time::Tick;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_solve::{SolveError, TuneOptions, Tuning, read_file, tune};
use muster_wire::json::EdgeJson as _;
use serde_json::{Value, json};

use crate::console;
use crate::operator::OperatorArgs;

/// Arguments of `muster tune`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Each setting of a grid divides the fleet into as many teams as the settings in force. The \
table has those with the best mean silhouette, each among its own vectors, and how stable their divisions are: the \
mean adjusted Rand index with the divisions of four fifths of the robots, drawn at random; 1 is the same. All \
divisions but these respect limits, wishes and needs. The best \
one that is as stable as the settings in force is proposed. A silhouette tells how far teams are apart, and not \
whether they are the right ones: look at who would move before you apply it.\n\n\
Examples:\n  muster tune\n  muster tune --apply\n  muster tune fleet.json --teams 4\n  \
(muster graph --json; muster set embedder --json; muster set clusterer --json; muster status --json; \
muster wish list --json) > fleet.jsonl; muster tune fleet.jsonl"
)]
pub(crate) struct TuneArgs {
    /// A saved fleet, or a file of `muster solve`, or - for standard input; the live fleet if none is named
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Apply what is proposed to the live fleet
    #[arg(long, conflicts_with = "file")]
    apply: bool,
    #[command(flatten)]
    operator: OperatorArgs,
    #[command(flatten)]
    options: TuneOptions,
}

impl TuneArgs {
    /// The command that shows what this one changes; none if it changes nothing.
    pub(crate) fn shown_by(&self) -> Option<&'static str> {
        self.apply.then_some("`muster set embedder`")
    }

    /// Whether the fleet is that of a file, and no bus is needed.
    pub(crate) fn has_file(&self) -> bool {
        self.file.is_some()
    }

    /// Whether a line on the terminal says how far the search is; with --json another program waits.
    fn shows_progress(&self) -> bool {
        !self.json && std::io::stderr().is_terminal()
    }

    fn print(&self, tuning: &Tuning) -> anyhow::Result<()> {
        let text = if self.json { format!("{}\n", tuning.to_json()) } else { tuning.summary() };
        Ok(std::io::stdout().write_all(text.as_bytes())?)
    }
}

/// Tunes the fleet of a file.
///
/// # Errors
/// If the file is wrong; the text names the field and the remedy.
pub(crate) fn of_file(args: &TuneArgs) -> anyhow::Result<()> {
    let Some(file) = &args.file else { return Ok(()) };
    let name = file.display().to_string();
    let text = read_file(file).map_err(|error| usage(&error, &name))?;
    let tuning = tune(&text, &args.options, args.shows_progress());
    args.print(&tuning.map_err(|error| usage(&error, &name))?)
}

/// Tunes the live fleet.
///
/// # Errors
/// If no router or no service answers, if the fleet cannot be tuned, or if a change is refused.
pub(crate) async fn of_fleet(args: &TuneArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let operator = args.operator.name(config)?;
    let client = console::open(config).await?;
    let (options, is_shown) = (args.options, args.shows_progress());
    // On a thread of its own, so that a signal ends the command.
    let search =
        |text: Vec<u8>| tokio::task::spawn_blocking(move || tune(&text, &options, is_shown));
    let mut tuning = search(saved(&client, true).await?).await?;
    if let Err(conflict @ SolveError::Conflict(_)) = &tuning {
        // The live fleet goes on with an alert, and so does this.
        eprintln!("the divisions respect no limits, wishes and needs: {conflict}");
        tuning = search(saved(&client, false).await?).await?;
    }
    let tuning = tuning.map_err(|error| usage(&error, "the live fleet"))?;
    args.print(&tuning)?;
    if args.apply
        && let Some(proposed) = tuning.proposed()
    {
        let patch = Tuning::patch(proposed);
        let changed = client.change_settings(&operator, ServiceName::Embedder, &patch).await;
        changed.map_err(console::exit_error)?;
        eprintln!("applied");
    }
    client.close().await;
    Ok(())
}

/// The live fleet as a saved one, a line each: its graphs, the settings of embedder and clusterer, the robots with
/// their skills, and the wishes; or without all that is asked of the teams.
async fn saved(client: &Client, has_rules: bool) -> anyhow::Result<Vec<u8>> {
    let graphs = client.get_graphs(None).await.map_err(console::exit_error)?;
    let mut text = Vec::new();
    for graph in graphs {
        text.extend(graph.to_json(Tick(0)).context("a graph has no form as JSON")?);
        text.push(b'\n');
    }
    let mut lines = Vec::new();
    for service in [ServiceName::Embedder, ServiceName::Clusterer] {
        let mut settings = client.get_settings(service).await.map_err(console::exit_error)?;
        if !has_rules && service == ServiceName::Clusterer {
            let free = json!(ClustererSettings::default());
            for field in ["size", "team_size", "needs"] {
                settings[field] = free[field].clone();
            }
        }
        lines.push(settings);
    }
    if !has_rules {
        return Ok(with_lines(text, &lines));
    }
    let roster = client.get_roster().await.map_err(console::exit_error)?;
    let robot = |entry: &RosterEntry| json!({ "robot": entry.robot, "presence": entry.presence, "skills": entry.skills });
    let robots: Vec<Value> = roster.robots.iter().map(robot).collect();
    lines.push(json!({ "robot_tokens": robots.len(), "robots": robots }));
    let wishes = client.get_wishes().await.map_err(console::exit_error)?;
    lines.extend(wishes.into_iter().map(|wish| json!(wish)));
    Ok(with_lines(text, &lines))
}

fn with_lines(mut text: Vec<u8>, lines: &[Value]) -> Vec<u8> {
    for line in lines {
        text.extend(line.to_string().into_bytes());
        text.push(b'\n');
    }
    text
}

fn usage(error: &SolveError, name: &str) -> anyhow::Error {
    ExitError::usage(format!("{name}: {error}")).into()
}
