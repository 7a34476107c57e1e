//! `muster graph`: the graphs of the live fleet, each or fused.

use std::sync::Arc;

use muster_client::{Client, Error};
use muster_model::embedding::EmbeddingGraph;
use muster_model::graph::GraphDelta;
use muster_model::id::{Modality, RobotId, ServiceName};
use muster_model::role::ReplicaState;
use muster_model::time::Tick;
use muster_runtime::config::ProcessConfig;
use muster_wire::json::EdgeJson;

use super::page::{Column, Page};
use super::watch::{Polled, Shown, follow, print};
use super::{ShowArgs, katz};
use crate::console::{self, exit_error, reply};

/// Most edges that are printed as a table; all are in `--json`.
const MAX_EDGES: usize = 200;

/// Arguments of `muster graph`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  muster graph\n  muster graph hierarchy\n  muster graph spatial --json\n  \
                  muster graph --katz r1 r2"
)]
pub(crate) struct GraphArgs {
    /// One modality, edge by edge; all, in numbers, if none is named
    modality: Option<Modality>,
    /// How similar two robots are in the fused graph, and the share of each modality
    #[arg(long, num_args = 2, value_names = ["FROM", "TO"], conflicts_with_all = ["modality", "watch"])]
    katz: Option<Vec<RobotId>>,
    #[command(flatten)]
    show: ShowArgs,
}

/// Shows the graphs, or every change of them.
///
/// # Errors
/// If no router or no service answers.
pub(crate) async fn run(args: &GraphArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let client = console::open(config).await?;
    if let Some([from, to]) = args.katz.as_deref() {
        let shown = katz::run(&client, [from, to], args.show.json).await;
        client.close().await;
        return shown;
    }
    let modality = args.modality.clone();
    let first = graphs(client.clone(), modality.clone()).await.map_err(exit_error)?;
    if !is_published(&client).await.map_err(exit_error)? {
        eprintln!("ingest does not answer: this is what was received from it last");
    }
    if args.show.watch {
        let asking = client.clone();
        let ask = move || {
            let (client, asked) = (asking.clone(), graphs(asking.clone(), modality.clone()));
            async move {
                // Whoever has received graphs answers for an ingest that has ended.
                let (published, asked) = tokio::join!(is_published(&client), asked);
                let asked = reply(asked)?;
                Ok(if published? { asked } else { None })
            }
        };
        return follow(&client, Polled::start(&client, first, ask), args.show.json).await;
    }
    client.close().await;
    print(&first, args.show.json)
}

/// The newest snapshot of each graph, by name.
#[derive(Debug)]
struct Graphs {
    graphs: Vec<Arc<GraphDelta>>,
    /// The graphs of the newest embedding, which have weights and trust; none without an answer.
    embedded: Vec<EmbeddingGraph>,
    /// Whether one modality was asked for, edge by edge.
    edges: bool,
}

/// Whether an ingest leads that publishes graphs.
async fn is_published(client: &Client) -> Result<bool, Error> {
    let statuses = client.get_statuses(Some(ServiceName::Ingest)).await?;
    Ok(statuses.iter().any(|status| status.standing == ReplicaState::Leading))
}

async fn graphs(client: Client, modality: Option<Modality>) -> Result<Graphs, Error> {
    let (graphs, embedding) = tokio::try_join!(client.get_graphs(modality.as_ref()), async {
        // The edges of one graph are shown without its weight.
        if modality.is_some() { Ok(None) } else { reply(client.get_embedding().await) }
    })?;
    let embedded = embedding.map(|embedding| embedding.graphs.clone()).unwrap_or_default();
    Ok(Graphs { graphs, embedded, edges: modality.is_some() })
}

impl Graphs {
    /// What the newest embedding says of a modality.
    fn embedded(&self, modality: &Modality) -> Option<&EmbeddingGraph> {
        self.embedded.iter().find(|graph| graph.modality == *modality)
    }
}

/// The trust in a modality as text; one in doubt stands out.
fn trust(graph: &EmbeddingGraph) -> String {
    let doubt = if graph.is_doubted() { " IN DOUBT" } else { "" };
    format!("{:.2}{doubt}", graph.trust)
}

impl Shown for Graphs {
    const PUBLISHER: &'static str = "ingest";

    fn lines(&self, page: &Page, _: Tick) -> Vec<String> {
        if self.edges {
            return self.graphs.iter().flat_map(|graph| edges(graph, page)).collect();
        }
        let row = |graph: &Arc<GraphDelta>| {
            let weights = graph.rows.iter().flat_map(|row| row.edges.iter().map(|edge| edge.1));
            let (count, sum) = weights.fold((0_u32, 0.0), |(count, sum), w| (count + 1, sum + w));
            let embedded = self.embedded(&graph.modality);
            vec![
                graph.modality.to_string(),
                graph.nodes_added.len().to_string(),
                count.to_string(),
                if count == 0 { String::new() } else { format!("{:.3}", sum / f64::from(count)) },
                embedded.map_or_else(String::new, |graph| format!("{:.3}", graph.weight)),
                embedded.map_or_else(String::new, trust),
                graph.header.revision.epoch.to_string(),
            ]
        };
        let [modality, robots, edges] = ["modality", "robots", "edges"].map(Column::kept);
        let mean = Column::dropped("mean edge", 2);
        let (weight, trust) = (Column::dropped("weight", 1), Column::kept("trust"));
        let epoch = Column::dropped("epoch", 3);
        let columns = [modality, robots, edges, mean, weight, trust, epoch];
        page.table(&columns, self.graphs.iter().map(row))
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let mut lines = Vec::new();
        for graph in &self.graphs {
            lines.extend(graph.to_json(now)?);
            lines.push(b'\n');
        }
        Ok(lines)
    }

    fn same(&self, other: &Self) -> bool {
        let revisions = |graphs: &Self| -> Vec<_> {
            graphs.graphs.iter().map(|graph| graph.header.revision).collect()
        };
        let embedded = |graphs: &Self| -> Vec<_> {
            graphs.embedded.iter().map(|graph| (graph.modality.clone(), trust(graph))).collect()
        };
        revisions(self) == revisions(other) && embedded(self) == embedded(other)
    }
}

/// The edges of one graph as a table.
fn edges(graph: &GraphDelta, page: &Page) -> Vec<String> {
    let name = |node| {
        let found = graph.nodes_added.iter().find(|(other, _)| *other == node);
        found.map_or_else(String::new, |(_, robot)| robot.to_string())
    };
    let all = || graph.rows.iter().flat_map(|row| row.edges.iter().map(|edge| (row.source, *edge)));
    let rows = all()
        .take(MAX_EDGES)
        .map(|(source, (target, weight))| vec![name(source), name(target), format!("{weight:.4}")]);
    let mut lines = vec![format!("{} of {} robots", graph.modality, graph.nodes_added.len())];
    lines.extend(page.table(&["from", "to", "weight"].map(Column::kept), rows));
    if let Some(more @ 1..) = all().count().checked_sub(MAX_EDGES) {
        lines.push(format!("… and {more} more edges; --json prints all"));
    }
    lines
}

#[cfg(test)]
mod tests {
    use muster_model::graph::GraphRow;
    use muster_model::header::{Header, Revision};
    use muster_model::id::FleetId;

    use super::super::page::tests::{WIDTHS, assert_fits, page};
    use super::*;

    fn shown(edges: bool) -> Graphs {
        let nodes = 0..300;
        let graph = GraphDelta {
            header: Header {
                fleet: FleetId::new("alpha").unwrap(),
                revision: Revision { term: 1, epoch: 123_456_789 },
                oldest: None,
                newest: None,
                stages: vec![],
            },
            modality: Modality::new("m".repeat(30)).unwrap(),
            base: None,
            nodes_added: nodes
                .clone()
                .map(|node| (node, RobotId::new(format!("{node:r>60}")).unwrap()))
                .collect(),
            nodes_removed: vec![],
            rows: nodes.map(|node| GraphRow { source: node, edges: vec![(0, 0.5)] }).collect(),
        };
        let embedded = EmbeddingGraph {
            modality: graph.modality.clone(),
            revision: graph.header.revision,
            weight: 0.125,
            trust: 0.25,
        };
        Graphs { graphs: vec![Arc::new(graph)], embedded: vec![embedded], edges }
    }

    #[test]
    fn the_tables_fit_the_terminal() {
        for width in WIDTHS {
            let all = shown(false).lines(&page(width), Tick(0));
            assert_fits(&all, width);
            assert!(all.join("\n").contains("edges"), "{}", all.join("\n"));
            assert!(all.join("\n").contains("DOUBT"), "{}", all.join("\n"));
            let edges = shown(true).lines(&page(width), Tick(0));
            assert_fits(&edges, width);
            assert_eq!(edges.last().unwrap(), "… and 100 more edges; --json prints all");
        }
    }
}
