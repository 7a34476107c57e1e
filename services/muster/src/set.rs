//! `muster set`: shows or changes the settings of a running service.

use std::io::Write as _;

use muster_model::id::ServiceName;
use muster_runtime::bus::{Answer, Ask};
use muster_runtime::config::{ProcessConfig, parse_assignments};
use muster_runtime::exit::ExitError;
use muster_wire::{Key, Pattern};
use serde_json::Value;

use crate::ask;

/// Arguments of `muster set`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without assignments the settings are shown. A change is checked as a whole, holds at \
once, and is kept over a restart of the service. `null` puts a field back to its default.\n\n\
Examples:\n  muster set clusterer\n  muster set clusterer teams=3\n  \
muster set embedder 'weights={\"spatial\":0.5,\"hierarchy\":0.5}' alpha.fraction=0.7\n  \
muster set ingest spatial.width=1.5 stale_after_s=null"
)]
pub(crate) struct SetArgs {
    /// ingest, embedder, clusterer or auditor
    service: ServiceName,
    /// What to change, such as teams=3; dots lead into tables
    #[arg(value_name = "FIELD=VALUE")]
    assignments: Vec<String>,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

/// Shows or changes settings.
///
/// # Errors
/// If nobody answers, or the service refuses the change.
pub(crate) async fn run(args: &SetArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let patch = if args.assignments.is_empty() {
        None
    } else {
        let patch = parse_assignments(&args.assignments).map_err(ExitError::usage)?;
        Some(patch.to_string().into_bytes())
    };
    let bus = ask::open(config).await?;
    let ask = Ask {
        parameters: "",
        payload: patch.as_deref(),
        within: ask::ANSWER_WITHIN,
        everybody: false,
    };
    let answers = bus.get(&Pattern::One(Key::Settings(args.service)), ask).await;
    bus.close().await;
    let mut refused = None;
    let mut shown = false;
    for answer in answers? {
        match answer {
            Answer::Packet(packet) => {
                let bytes = packet.payload.unwrap_or_default();
                let settings: Value = serde_json::from_slice(&bytes)?;
                let text = if args.json {
                    settings.to_string()
                } else {
                    serde_json::to_string_pretty(&settings)?
                };
                writeln!(std::io::stdout(), "{text}")?;
                shown = true;
            }
            Answer::Error(error) => {
                let text = serde_json::from_str::<Value>(&error).ok();
                let text = text.as_ref().and_then(|value| value.get("error")?.as_str());
                refused = Some(muster_wire::message::quoted(text.unwrap_or(&error)));
            }
        }
    }
    match refused {
        Some(problem) => {
            Err(ExitError::usage(format!("{} refuses: {problem}", args.service)).into())
        }
        None if shown => Ok(()),
        None => Err(ExitError::unreachable(format!(
            "no {} of fleet {} answers; see `muster status` for what runs",
            args.service, config.fleet.value
        ))
        .into()),
    }
}
