//! Under which name the commands of this program are sent.

use muster_model::id::OperatorId;
use muster_runtime::config::{ProcessConfig, process_environment};
use muster_runtime::exit::ExitError;

use crate::console;

/// The environment variable with the name.
const VARIABLE: &str = "MUSTER_OPERATOR";

/// How the file of an operator's identity names it.
const IDENTITY: &str = "operator.";

/// The name where nothing says another.
const DEFAULT: &str = "operator";

/// Who commands.
#[derive(Debug, Default, clap::Args)]
pub(crate) struct OperatorArgs {
    /// Who commands, in a-z 0-9 _ - [MUSTER_OPERATOR] [default: the operator whose identity --zenoh-config is, else
    /// operator]. Where access is controlled, the router lets no one command under another name
    #[arg(long, value_name = "NAME")]
    operator: Option<OperatorId>,
}

/// Who commands, and how what came of it is printed.
#[derive(Debug, clap::Args)]
pub(crate) struct CommandArgs {
    #[command(flatten)]
    pub(crate) operator: OperatorArgs,
    /// Print one line of JSON
    #[arg(long)]
    pub(crate) json: bool,
}

impl OperatorArgs {
    /// The name: of the flag, the environment or the identity, in this order.
    ///
    /// # Errors
    /// If the environment names none that is allowed, or the file of the identity is wrong.
    pub(crate) fn name(&self, config: &ProcessConfig) -> Result<OperatorId, ExitError> {
        if let Some(name) = &self.operator {
            return Ok(name.clone());
        }
        let variable = process_environment(VARIABLE);
        if let Some(name) = variable {
            return OperatorId::new(&name)
                .map_err(|error| ExitError::usage(format!("{VARIABLE}: {error}")));
        }
        let identity = console::client_config(config)?.identity().map_err(console::exit_error)?;
        let name = identity.as_deref().and_then(|identity| identity.strip_prefix(IDENTITY));
        OperatorId::new(name.unwrap_or(DEFAULT))
            .map_err(|error| ExitError::usage(error.to_string()))
    }
}
