//! One link: a connection with a stream for each direction.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use async_trait::async_trait;
use quinn::{Connection, RecvStream, SendStream};
use tokio::sync::Mutex;
use zenoh_link_commons::quic::{get_cert_chain_expiration, get_cert_common_name};
use zenoh_link_commons::{LinkAuthId, LinkUnicast, LinkUnicastTrait, get_ip_interface_names};
use zenoh_protocol::core::{Locator, Priority};
use zenoh_protocol::transport::BatchSize;
use zenoh_result::ZResult;

use crate::QUIC_LOCATOR_PREFIX;

/// How often the clock is compared with the end of a certificate: clocks of hosts are set.
const CLOCK_LOOK_EVERY: Duration = Duration::from_secs(60);

/// A link. Both directions have a lock of their own, so that reading and writing do not wait for each other.
pub(crate) struct QuicLink {
    connection: Connection,
    sending: Mutex<SendStream>,
    receiving: Mutex<RecvStream>,
    here: Locator,
    there: Locator,
    address: SocketAddr,
    identity: LinkAuthId,
}

impl QuicLink {
    /// A link of a connection, which ends with the certificate of the other side if that is asked for.
    ///
    /// # Errors
    /// If an address or a certificate cannot be read.
    pub(crate) fn start(
        connection: Connection,
        (sending, receiving): (SendStream, RecvStream),
        address: SocketAddr,
        there: Locator,
        ends_with_certificate: bool,
    ) -> ZResult<LinkUnicast> {
        if ends_with_certificate {
            match get_cert_chain_expiration(&connection)? {
                Some(end) => drop(tokio::spawn(close_at(end.into(), connection.clone()))),
                None => {
                    tracing::warn!("{there} shows no certificate with whose end its link could end")
                }
            }
        }
        let link = Self {
            identity: get_cert_common_name(&connection)?.into(),
            connection,
            sending: Mutex::new(sending),
            receiving: Mutex::new(receiving),
            here: Locator::new(QUIC_LOCATOR_PREFIX, address.to_string(), "")?,
            there,
            address,
        };
        let link: Arc<dyn LinkUnicastTrait> = Arc::new(link);
        Ok(link.into())
    }
}

/// Closes a connection at a moment, unless it is closed before.
async fn close_at(end: SystemTime, connection: Connection) {
    while let Ok(left) = end.duration_since(SystemTime::now()) {
        tokio::select! {
            _ = connection.closed() => return,
            () = tokio::time::sleep(left.min(CLOCK_LOOK_EVERY)) => {}
        }
    }
    tracing::warn!("the certificate of {} has expired: its link ends", connection.remote_address());
    close(&connection);
}

fn close(connection: &Connection) {
    connection.close(0u8.into(), b"");
}

impl Drop for QuicLink {
    fn drop(&mut self) {
        close(&self.connection);
    }
}

#[async_trait]
impl LinkUnicastTrait for QuicLink {
    fn get_mtu(&self) -> BatchSize {
        BatchSize::MAX
    }

    fn get_src(&self) -> &Locator {
        &self.here
    }

    fn get_dst(&self) -> &Locator {
        &self.there
    }

    fn is_reliable(&self) -> bool {
        true
    }

    fn is_streamed(&self) -> bool {
        true
    }

    fn get_interface_names(&self) -> Vec<String> {
        get_ip_interface_names(&self.address)
    }

    fn get_auth_id(&self) -> &LinkAuthId {
        &self.identity
    }

    async fn write(&self, buffer: &[u8], _priority: Option<Priority>) -> ZResult<usize> {
        Ok(self.sending.lock().await.write(buffer).await?)
    }

    async fn write_all(&self, buffer: &[u8], _priority: Option<Priority>) -> ZResult<()> {
        Ok(self.sending.lock().await.write_all(buffer).await?)
    }

    async fn read(&self, buffer: &mut [u8], _priority: Option<Priority>) -> ZResult<usize> {
        let read = self.receiving.lock().await.read(buffer).await?;
        read.ok_or_else(|| format!("{} has ended its stream", self.there).into())
    }

    async fn read_exact(&self, buffer: &mut [u8], _priority: Option<Priority>) -> ZResult<()> {
        Ok(self.receiving.lock().await.read_exact(buffer).await?)
    }

    async fn close(&self) -> ZResult<()> {
        close(&self.connection);
        Ok(())
    }
}
