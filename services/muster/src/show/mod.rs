//! Shows a live fleet: what it is now, or with `--watch` every change.

pub(crate) mod audit;
pub(crate) mod graph;
pub(crate) mod katz;
pub(crate) mod page;
mod screen;
pub(crate) mod status;
pub(crate) mod teams;
pub(crate) mod watch;
pub(crate) mod why;

/// Arguments of the commands that show a live fleet.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "A watch redraws in place on a terminal and shows every second how old its content \
is, and why if it is stale: the link to the router is lost, the service is silent, or it started \
again without its state. Elsewhere it appends what changes as plain text. NO_COLOR=1 turns colours \
off.\n\nExamples:\n  muster teams                once\n  \
muster teams --watch        every change, until Ctrl-C\n  \
muster teams --watch --json one line of JSON per change, for scripts"
)]
pub(crate) struct ShowArgs {
    /// Continue and show every change
    #[arg(long)]
    pub(crate) watch: bool,
    /// Print JSON: one line each time
    #[arg(long)]
    pub(crate) json: bool,
}
