//! `muster deploy config`: the commented default configuration of one service.
//!
//! Its one source is the configuration of a whole host. The text before the first ruled line applies to
//! every program; each service has a part below a ruled line of its own.

use std::io::Write as _;

use anyhow::Context;
use muster_model::id::ServiceName;

/// The commented configuration of a host.
const WHOLE: &str = include_str!("../../../../deploy/muster.toml");

/// Start of the line above the part of a service.
const RULE: &str = "# -----";

/// Arguments of `muster deploy config`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  muster deploy config ingest > /etc/muster/ingest.toml\n  \
muster-ingest --config /etc/muster/ingest.toml --check-config\n  \
muster deploy config                    all services in one file")]
pub(crate) struct ConfigArgs {
    /// ingest, embedder, clusterer, auditor, historian or planner; all if none is named
    service: Option<ServiceName>,
}

/// Prints the configuration.
///
/// # Errors
/// If it cannot be written.
pub(super) fn run(args: &ConfigArgs) -> anyhow::Result<()> {
    let text = match args.service {
        Some(service) => of_service(service)?,
        None => WHOLE.to_owned(),
    };
    std::io::stdout().write_all(text.as_bytes())?;
    Ok(())
}

/// The part for every program, and that for one service.
fn of_service(service: ServiceName) -> anyhow::Result<String> {
    let mut parts: Vec<String> = vec![String::new()];
    for line in WHOLE.lines() {
        if line.starts_with(RULE) {
            parts.push(String::new());
        }
        if let Some(part) = parts.last_mut() {
            part.push_str(line);
            part.push('\n');
        }
    }
    let table = format!("\n[{service}]\n");
    let own = parts.iter().skip(1).find(|part| part.contains(&table));
    let own = own.with_context(|| format!("deploy/muster.toml has no part for {service}"))?;
    let head = parts.first().map(String::as_str).unwrap_or_default();
    Ok(format!("{head}{}\n", own.trim_end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_files_are_what_is_printed() {
        for service in ServiceName::ALL {
            let text = of_service(service).unwrap();
            let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/config");
            let path = format!("{root}/{service}.toml");
            if std::env::var_os("UPDATE_GOLDEN").is_some() {
                std::fs::write(&path, &text).unwrap();
            }
            let shipped = std::fs::read_to_string(&path).unwrap();
            assert_eq!(shipped, text, "run this test with UPDATE_GOLDEN=1 after a change");
            for other in ServiceName::ALL {
                let table = format!("\n[{other}]\n");
                assert_eq!(text.contains(&table), other == service, "{service} and {other}");
            }
        }
    }
}
