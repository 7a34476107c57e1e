//! `muster graph --katz`: how near two robots are to one another in the fused graph, and by what.

use std::io::Write as _;
use std::time::Duration;

use muster_model::id::RobotId;
use muster_runtime::bus::{Answer, Ask, Bus};
use muster_runtime::exit::ExitError;
use muster_wire::message::quoted;
use muster_wire::{Key, Pattern};
use serde_json::Value;

use super::table;

/// How long `embedder` may take: the first question makes the similarity of all pairs of a fleet.
const ANSWER_WITHIN: Duration = Duration::from_secs(30);

/// Shows the similarity of two robots in both directions.
///
/// # Errors
/// If a robot is not known, or nobody answers.
pub(crate) async fn run(bus: &Bus, [from, to]: [&RobotId; 2], json: bool) -> anyhow::Result<()> {
    let there = similarity(bus, [from, to]).await?;
    let back = similarity(bus, [to, from]).await?;
    let mut out = std::io::stdout().lock();
    if json {
        writeln!(out, "{there}\n{back}")?;
        return Ok(out.flush()?);
    }
    let shares = |pair: &Value| pair["shares"].as_object().cloned().unwrap_or_default();
    let modalities: Vec<String> = shares(&there).keys().cloned().collect();
    let mut header = vec!["from", "to", "similarity"];
    header.extend(modalities.iter().map(String::as_str));
    let mut table = table(&header);
    for pair in [&there, &back] {
        let total = pair["similarity"].as_f64().unwrap_or_default();
        let text = |field: &str| pair[field].as_str().unwrap_or_default().to_owned();
        let mut row = vec![text("from"), text("to"), format!("{total:.3e}")];
        let shares = shares(pair);
        row.extend(modalities.iter().map(|name| {
            let share = shares.get(name).and_then(Value::as_f64).unwrap_or_default();
            if total > 0.0 { format!("{:.1} %", 100.0 * share / total) } else { "–".to_owned() }
        }));
        table.add_row(row);
    }
    writeln!(out, "{table}")?;
    writeln!(
        out,
        "The weight of all walks from one robot to the other, each step damped by α = {:.4e}, and the \
         share of the walks whose first step is of each modality ({} method, residual {:.0e}).",
        there["alpha"].as_f64().unwrap_or_default(),
        there["method"].as_str().unwrap_or_default(),
        there["residual"].as_f64().unwrap_or_default(),
    )?;
    Ok(out.flush()?)
}

/// The answer to one question, as it came.
async fn similarity(bus: &Bus, [from, to]: [&RobotId; 2]) -> anyhow::Result<Value> {
    let parameters = format!("format=json;katz={from},{to}");
    let ask =
        Ask { parameters: &parameters, payload: None, within: ANSWER_WITHIN, everybody: false };
    for answer in bus.get(&Pattern::One(Key::Embedding), ask).await? {
        match answer {
            Answer::Packet(packet) => {
                if let Ok(bytes) = packet.payload {
                    return Ok(serde_json::from_slice(&bytes)?);
                }
            }
            Answer::Error(error) => {
                let text = serde_json::from_str::<Value>(&error).ok();
                let text = text.as_ref().and_then(|value| value.get("error")?.as_str());
                let problem = quoted(text.unwrap_or(&error));
                return Err(ExitError::usage(format!("embedder refuses: {problem}")).into());
            }
        }
    }
    Err(ExitError::unreachable(format!(
        "no embedder of fleet {} answers; see `muster status` for what runs",
        bus.space().fleet()
    ))
    .into())
}
