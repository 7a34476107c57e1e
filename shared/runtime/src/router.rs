//! An embedded Zenoh router, so that nobody has to install one to start.

use crate::bus::{Bus, Patience};
use crate::config::ProcessConfig;

/// Opens a router; it relays for as long as the bus is open.
///
/// # Errors
/// If the endpoint is taken or the configuration wrong; the text names the remedy.
pub async fn open(config: &ProcessConfig) -> anyhow::Result<Bus> {
    Bus::open(config, Patience::Forever).await
}
