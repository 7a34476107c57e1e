//! `muster set`: shows or changes the settings of a running service.

use std::io::Write as _;

use muster_model::id::ServiceName;
use muster_runtime::config::{ProcessConfig, parse_assignments};
use muster_runtime::exit::ExitError;

use crate::console;
use crate::operator::OperatorArgs;

/// Arguments of `muster set`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without assignments the settings are shown. A change is checked as a whole, applied at \
once, and kept over a restart of the service. `null` resets a field to its default.\n\n\
Examples:\n  muster set clusterer\n  muster set clusterer teams=3\n  \
muster set embedder 'weights={\"spatial\":0.5,\"hierarchy\":0.5}' alpha.fraction=0.7\n  \
muster set ingest spatial.width=1.5 stale_after_s=null"
)]
pub(crate) struct SetArgs {
    /// ingest, embedder, clusterer, auditor, historian or planner
    service: ServiceName,
    /// What to change, such as teams=3; dots lead into tables
    #[arg(value_name = "FIELD=VALUE")]
    assignments: Vec<String>,
    #[command(flatten)]
    operator: OperatorArgs,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

impl SetArgs {
    /// The command that shows what this one changes; none if it changes nothing.
    pub(crate) fn shown_by(&self) -> Option<&'static str> {
        (!self.assignments.is_empty()).then_some("`muster set SERVICE`")
    }
}

/// Shows or changes settings.
///
/// # Errors
/// If the service does not answer, or refuses the change.
pub(crate) async fn run(args: &SetArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let patch = (!args.assignments.is_empty()).then(|| parse_assignments(&args.assignments));
    let patch = patch.transpose().map_err(ExitError::usage)?;
    let operator = args.operator.name(config)?;
    let client = console::open(config).await?;
    let settings = match &patch {
        Some(patch) => client.change_settings(&operator, args.service, patch).await,
        None => client.get_settings(args.service).await,
    };
    client.close().await;
    let settings = settings.map_err(console::exit_error)?;
    let text =
        if args.json { settings.to_string() } else { serde_json::to_string_pretty(&settings)? };
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}
