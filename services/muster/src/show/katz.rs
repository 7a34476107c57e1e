//! `muster graph --katz`: how similar two robots are in the fused graph, and by which modalities.

use std::io::Write as _;

use muster_client::Client;
use muster_model::id::{Modality, RobotId};
use muster_model::katz::{PairMethod, PairSimilarity};
use muster_runtime::clock::Clock;
use muster_wire::json::EdgeJson;

use super::page::{Column, Page};
use crate::console::exit_error;

/// Shows the similarity of two robots in both directions.
///
/// # Errors
/// If a robot is not known, or no service answers.
pub(crate) async fn run(
    client: &Client,
    [one, other]: [&RobotId; 2],
    json: bool,
) -> anyhow::Result<()> {
    let mut pairs = Vec::new();
    for (from, to) in [(one, other), (other, one)] {
        pairs.push(client.get_similarity(from, to).await.map_err(exit_error)?);
    }
    let mut out = std::io::stdout().lock();
    if json {
        let now = Clock::start().now();
        for pair in &pairs {
            out.write_all(&pair.to_json(now)?)?;
            writeln!(out)?;
        }
    } else {
        for line in lines(&pairs, &Page::of_stdout()) {
            writeln!(out, "{line}")?;
        }
    }
    Ok(out.flush()?)
}

fn lines(pairs: &[PairSimilarity], page: &Page) -> Vec<String> {
    let Some(first) = pairs.first() else { return Vec::new() };
    let modalities: Vec<&Modality> = first.shares.iter().map(|(modality, _)| modality).collect();
    let mut columns: Vec<Column> = ["from", "to", "similarity"].map(Column::kept).to_vec();
    columns.extend(modalities.iter().map(|modality| Column::kept(modality.as_str())));
    let share = |pair: &PairSimilarity, modality: &Modality| {
        let share = pair.shares.iter().find(|(name, _)| name == modality);
        share.map_or(0.0, |(_, weight)| *weight)
    };
    let row = |pair: &PairSimilarity| {
        let total = pair.similarity;
        let mut row = vec![pair.from.to_string(), pair.to.to_string(), format!("{total:.3e}")];
        row.extend(modalities.iter().map(|modality| {
            let part = share(pair, modality);
            if total > 0.0 { format!("{:.1} %", 100.0 * part / total) } else { "–".to_owned() }
        }));
        row
    };
    let mut lines = page.table(&columns, pairs.iter().map(row));
    let method = match first.method {
        PairMethod::Cached => "cached",
        PairMethod::Column => "column",
    };
    lines.push(format!(
        "The weight of all walks from one robot to the other, each step damped by α = {:.4e}, and the \
         share of the walks whose first step is of each modality ({method} method, residual {:.0e}).",
        first.alpha, first.residual,
    ));
    lines
}
