//! A link that can be cut: a relay in front of a router, for TCP (`tcp/`, `tls/`) and UDP (`quic/`).

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::{Context, ensure};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::watch;

/// Bytes that are carried at once: the largest datagram of UDP.
const MAX_DATAGRAM: usize = 65_536;

/// Senders behind a relay of datagrams, each with a socket of its own: far more than tests have robots.
const MAX_SENDERS: usize = 4096;

/// What a relay does to what it carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// It carries everything.
    Whole,
    /// Connections end, and nobody connects, as with a cable that is pulled.
    Cut,
    /// Nothing is carried, nothing ends and nothing is refused, as behind a router that drops packets.
    Silent,
}

/// A link to a router. It ends when the test lets go of it.
#[derive(Debug)]
pub struct Relay {
    /// Where to connect, instead of to the router.
    pub endpoint: String,
    link: watch::Sender<Link>,
}

impl Relay {
    /// A whole link to an endpoint, such as `tcp/127.0.0.1:7447`.
    ///
    /// # Errors
    /// If the endpoint is of no protocol over TCP or UDP, or no port is free.
    pub async fn to(endpoint: &str) -> anyhow::Result<Self> {
        let (protocol, far) =
            endpoint.split_once('/').context("an endpoint is PROTOCOL/ADDRESS")?;
        let far = far.to_owned();
        let (link, state) = watch::channel(Link::Whole);
        let own = match protocol {
            "tcp" | "tls" => {
                let listener = TcpListener::bind("127.0.0.1:0").await?;
                let own = listener.local_addr()?;
                tokio::spawn(relay_connections(listener, far, state));
                own
            }
            "quic" => {
                let near = UdpSocket::bind("127.0.0.1:0").await?;
                let own = near.local_addr()?;
                tokio::spawn(relay_datagrams(near, far, state));
                own
            }
            other => anyhow::bail!("{other} is neither over TCP nor over UDP"),
        };
        ensure!(own.port() != 0, "the relay has no port");
        Ok(Self { endpoint: format!("{protocol}/{own}"), link })
    }

    /// Cuts the link, makes it silent or restores it.
    pub fn set(&self, link: Link) {
        self.link.send_replace(link);
    }

    /// Cuts the link.
    pub fn cut(&self) {
        self.set(Link::Cut);
    }

    /// Restores the link.
    pub fn restore(&self) {
        self.set(Link::Whole);
    }
}

/// Ends when the test has let go of the relay.
async fn let_go(mut state: watch::Receiver<Link>) {
    while state.changed().await.is_ok() {}
}

async fn relay_connections(listener: TcpListener, far: String, state: watch::Receiver<Link>) {
    loop {
        let near = tokio::select! {
            accepted = listener.accept() => accepted,
            () = let_go(state.clone()) => return,
        };
        // Without a descriptor to spare, the next one is tried.
        let Ok((near, _)) = near else { continue };
        let (mut ended, mut whole, far) = (state.clone(), state.clone(), far.clone());
        let carried = state.clone();
        tokio::spawn(async move {
            let carrying = async {
                whole.wait_for(|link| *link != Link::Silent).await.ok()?;
                let far = TcpStream::connect(far).await.ok()?;
                // What waits to be put together would add to delays that tests measure.
                near.set_nodelay(true).ok()?;
                far.set_nodelay(true).ok()?;
                let (from_near, to_near) = near.into_split();
                let (from_far, to_far) = far.into_split();
                tokio::join!(
                    carry(from_near, to_far, carried.clone()),
                    carry(from_far, to_near, carried)
                );
                Some(())
            };
            tokio::select! {
                _ = carrying => {}
                _ = ended.wait_for(|link| *link == Link::Cut) => {}
            }
        });
    }
}

/// Carries bytes one way until either end closes. In silence they wait, as in the buffers of TCP.
async fn carry(
    mut from: impl AsyncRead + Unpin,
    mut to: impl AsyncWrite + Unpin,
    mut state: watch::Receiver<Link>,
) {
    let mut bytes = vec![0; MAX_DATAGRAM];
    while let Ok(count @ 1..) = from.read(&mut bytes).await {
        let heard = state.wait_for(|link| *link != Link::Silent).await.is_ok();
        if !heard || to.write_all(&bytes[..count]).await.is_err() {
            break;
        }
    }
    let _ = to.shutdown().await;
}

/// Datagrams of each sender leave by a socket of its own, so that answers find back.
async fn relay_datagrams(near: UdpSocket, far: String, state: watch::Receiver<Link>) {
    let near = Arc::new(near);
    let mut senders: BTreeMap<SocketAddr, Arc<UdpSocket>> = BTreeMap::new();
    let mut bytes = vec![0; MAX_DATAGRAM];
    loop {
        let received = tokio::select! {
            received = near.recv_from(&mut bytes) => received,
            () = let_go(state.clone()) => return,
        };
        let Ok((count, sender)) = received else { continue };
        if *state.borrow() != Link::Whole {
            continue;
        }
        if !senders.contains_key(&sender) {
            let Ok(socket) = UdpSocket::bind("127.0.0.1:0").await else { continue };
            if senders.len() >= MAX_SENDERS || socket.connect(&far).await.is_err() {
                continue;
            }
            let socket = Arc::new(socket);
            senders.insert(sender, Arc::clone(&socket));
            tokio::spawn(answer(Arc::clone(&near), socket, sender, state.clone()));
        }
        if let Some(socket) = senders.get(&sender) {
            // An error of an earlier datagram, such as a router that is gone; this one is lost as well.
            let _ = socket.send(&bytes[..count]).await;
        }
    }
}

async fn answer(
    near: Arc<UdpSocket>,
    far: Arc<UdpSocket>,
    sender: SocketAddr,
    state: watch::Receiver<Link>,
) {
    let mut bytes = vec![0; MAX_DATAGRAM];
    loop {
        let received = tokio::select! {
            received = far.recv(&mut bytes) => received,
            () = let_go(state.clone()) => return,
        };
        // A router that is gone is an error of the socket, and may come back.
        let Ok(count) = received else { continue };
        if *state.borrow() == Link::Whole {
            let _ = near.send_to(&bytes[..count], sender).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const SOON: Duration = Duration::from_secs(10);
    const NEVER: Duration = Duration::from_millis(200);

    #[tokio::test]
    async fn a_connection_is_carried_silenced_and_cut() {
        let far = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let relay = Relay::to(&format!("tcp/{}", far.local_addr().unwrap())).await.unwrap();
        let address = relay.endpoint.strip_prefix("tcp/").unwrap().to_owned();
        let mut near = TcpStream::connect(&address).await.unwrap();
        let (mut end, _) = tokio::time::timeout(SOON, far.accept()).await.unwrap().unwrap();
        let mut byte = [0; 1];
        near.write_all(b"a").await.unwrap();
        end.read_exact(&mut byte).await.unwrap();
        assert_eq!(&byte, b"a");
        relay.set(Link::Silent);
        near.write_all(b"b").await.unwrap();
        assert!(tokio::time::timeout(NEVER, end.read_exact(&mut byte)).await.is_err());
        relay.restore();
        tokio::time::timeout(SOON, end.read_exact(&mut byte)).await.unwrap().unwrap();
        assert_eq!(&byte, b"b");
        relay.cut();
        let ended = tokio::time::timeout(SOON, end.read(&mut byte)).await.unwrap();
        assert!(matches!(ended, Ok(0) | Err(_)), "{ended:?}");
    }

    #[tokio::test]
    async fn datagrams_are_carried_both_ways_unless_the_link_is_cut() {
        let far = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let relay = Relay::to(&format!("quic/{}", far.local_addr().unwrap())).await.unwrap();
        let near = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        near.connect(relay.endpoint.strip_prefix("quic/").unwrap()).await.unwrap();
        let mut bytes = [0; 8];
        near.send(b"there").await.unwrap();
        let (count, from) =
            tokio::time::timeout(SOON, far.recv_from(&mut bytes)).await.unwrap().unwrap();
        assert_eq!(&bytes[..count], b"there");
        far.send_to(b"back", from).await.unwrap();
        let count = tokio::time::timeout(SOON, near.recv(&mut bytes)).await.unwrap().unwrap();
        assert_eq!(&bytes[..count], b"back");
        relay.cut();
        near.send(b"lost").await.unwrap();
        assert!(tokio::time::timeout(NEVER, far.recv_from(&mut bytes)).await.is_err());
        assert!(Relay::to("unixsock-stream/x").await.is_err());
    }
}
