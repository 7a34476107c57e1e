//! Logs on standard error, human or JSON lines.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// What is logged when neither a flag nor `MUSTER_LOG` says otherwise: what Muster does, and what
/// goes wrong below it.
const DEFAULT_FILTER: &str = "warn,muster=info";

/// Checks a filter.
///
/// # Errors
/// Names the form.
pub fn check(filter: Option<&str>) -> Result<(), String> {
    read_filter(filter).map(drop)
}

fn read_filter(filter: Option<&str>) -> Result<EnvFilter, String> {
    EnvFilter::try_new(filter.unwrap_or(DEFAULT_FILTER)).map_err(|error| {
        format!("log: {error}; use a level such as info, or target=level pairs with commas")
    })
}

/// Starts logging. Calling it again, as tests do, changes nothing.
///
/// # Errors
/// If the filter is not understood; the text names the form.
pub fn start(filter: Option<&str>, json: bool) -> Result<(), String> {
    let filter = read_filter(filter)?;
    // Colours are for people: a file or a service manager gets plain text.
    let colours = std::io::stderr().is_terminal();
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .with_ansi(colours);
    let started = if json { builder.json().try_init() } else { builder.try_init() };
    // Another subscriber is there already: whoever set it wins.
    drop(started);
    Ok(())
}
