//! `muster schema`: the JSON Schema of every message at the edge, without a bus.

use std::io::Write as _;

use muster_runtime::exit::ExitError;
use muster_wire::message::quoted;
use muster_wire::schema::{Schemas, names, one};

/// Arguments of `muster schema`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without a name it prints one document with all messages under $defs, as a get on the key \
`schema` of a fleet is answered.\n\n\
Examples:\n  muster schema --list\n  muster schema pose\n  muster schema > muster.schema.json"
)]
pub(crate) struct SchemaArgs {
    /// Print the schema of this message alone, with all parts that it needs
    #[arg(value_name = "NAME", conflicts_with = "list")]
    name: Option<String>,
    /// Print the names of the messages
    #[arg(long)]
    list: bool,
}

/// Prints schemas.
///
/// # Errors
/// If no message has the name, or the output cannot be written.
pub(crate) fn run(args: &SchemaArgs) -> anyhow::Result<()> {
    let document = Schemas::edge().document();
    let text = match &args.name {
        _ if args.list => names(&document).map(|name| format!("{name}\n")).collect(),
        None => format!("{}\n", serde_json::to_string_pretty(&document)?),
        Some(name) => {
            let Some(schema) = one(&document, name) else {
                let known = names(&document).collect::<Vec<_>>().join(", ");
                let name = quoted(name);
                let problem = format!("NAME: no message is called {name:?}; there are {known}");
                return Err(ExitError::usage(problem).into());
            };
            format!("{}\n", serde_json::to_string_pretty(&schema)?)
        }
    };
    std::io::stdout().lock().write_all(text.as_bytes())?;
    Ok(())
}
