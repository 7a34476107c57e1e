//! Looks at a live fleet: what it is now, or with `--watch` whatever changes.

pub(crate) mod audit;
pub(crate) mod graph;
pub(crate) mod katz;
pub(crate) mod status;
pub(crate) mod teams;

use comfy_table::{Table, presets};

/// Most robots that are named in one cell of a table; all are in `--json`.
const MAX_NAMED: usize = 24;

/// Arguments of the commands that look at a live fleet.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:\n  muster teams                one look\n  \
muster teams --watch        every change, until Ctrl-C\n  \
muster teams --watch --json one line of JSON per change, for scripts")]
pub(crate) struct ShowArgs {
    /// Go on and show every change
    #[arg(long)]
    pub(crate) watch: bool,
    /// Print JSON: one line per look or change
    #[arg(long)]
    pub(crate) json: bool,
}

/// A table in the style of all tables.
#[must_use]
pub(crate) fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED).set_header(header.to_vec());
    table
}

/// Names with commas, cut short.
pub(crate) fn names<T: ToString>(all: impl ExactSizeIterator<Item = T>) -> String {
    let count = all.len();
    let mut text = all.take(MAX_NAMED).map(|name| name.to_string()).collect::<Vec<_>>().join(" ");
    if count > MAX_NAMED {
        text.push_str(&format!(" … and {} more", count - MAX_NAMED));
    }
    text
}
