//! Under which name the commands of this program are sent.

use muster_model::id::OperatorId;
use muster_runtime::bus::{self, BusConfig};
use muster_runtime::config::{ProcessConfig, process_environment};
use muster_runtime::exit::ExitError;

/// The environment variable with the name.
const VARIABLE: &str = "MUSTER_OPERATOR";

/// How the file of an operator's identity names it.
const IDENTITY: &str = "operator.";

/// The name where nothing says another.
const DEFAULT: &str = "operator";

/// Who commands.
#[derive(Debug, clap::Args)]
pub(crate) struct OperatorArgs {
    /// Who commands, in a-z 0-9 _ - [MUSTER_OPERATOR] [default: the operator whose identity --zenoh-config is, else
    /// operator]. Where access is controlled, the router lets nobody command under another name
    #[arg(long, value_name = "NAME")]
    operator: Option<OperatorId>,
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
        let identity = bus::identity(&BusConfig::from(config));
        let identity = identity.map_err(|error| ExitError::usage(error.to_string()))?;
        let name = identity.as_deref().and_then(|identity| identity.strip_prefix(IDENTITY));
        OperatorId::new(name.unwrap_or(DEFAULT))
            .map_err(|error| ExitError::usage(error.to_string()))
    }
}
