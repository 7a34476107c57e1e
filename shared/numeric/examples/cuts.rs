//! Finds what holds graphs together, for `tests/peers/check_cuts.py`.
//!
//! Each line of standard input is one graph of whole numbers: nodes, groups, the group of each node (−1 for none),
//! and the edges as from, to, weight. Each line of the answer has four parts, with `;` in between: the sizes of
//! the components; each articulation point with the sizes of its parts; the ends of each bridge with the sizes of
//! its parts; the conductance of each group, or `-`. Within a part, entries are separated by `,`.

use std::error::Error;
use std::io::{BufRead, Write};

use muster_numeric::conductance::conductances;
use muster_numeric::cuts::cuts;

fn main() -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let numbers: Vec<i64> =
            line?.split_ascii_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [nodes, groups, rest @ ..] = &numbers[..] else {
            return Err("a line begins with two numbers".into());
        };
        let (nodes, groups) = (usize::try_from(*nodes)?, usize::try_from(*groups)?);
        let (labels, edges) = rest.split_at_checked(nodes).ok_or("labels are missing")?;
        let labels: Vec<_> = labels.iter().map(|label| usize::try_from(*label).ok()).collect();
        let mut read = Vec::new();
        for edge in edges.chunks_exact(3) {
            let weight = f64::from(i32::try_from(edge[2])?);
            read.push((usize::try_from(edge[0])?, usize::try_from(edge[1])?, weight));
        }
        let found = cuts(nodes, read.iter().map(|(from, to, _)| (*from, *to)));
        let joined = |numbers: &[usize]| {
            numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
        };
        let points = found.nodes.iter().map(|cut| format!("{} {}", cut.node, joined(&cut.parts)));
        let bridges = found
            .bridges
            .iter()
            .map(|bridge| format!("{} {}", joined(&bridge.ends), joined(&bridge.parts)));
        let shares = conductances(read.iter().copied(), &labels, groups)
            .into_iter()
            .map(|share| share.map_or("-".to_owned(), |share| format!("{share:e}")));
        let parts = [
            joined(&found.sizes),
            points.collect::<Vec<_>>().join(","),
            bridges.collect::<Vec<_>>().join(","),
            shares.collect::<Vec<_>>().join(","),
        ];
        writeln!(out, "{}", parts.join(";"))?;
    }
    Ok(())
}
