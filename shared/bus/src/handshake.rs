//! What answers at an endpoint, before any session is open: nothing, something else, or a router of
//! Zenoh, with the lease that it announces.
//!
//! A session only reports that it does not open. This opens a link by hand, as far as the router states
//! its terms, and lets go of it: nothing is declared on it and nothing is put. It serves `muster
//! doctor`, and finds which router of a list to try first.

use std::net::SocketAddr;
use std::time::Duration;

use muster_wire::message::quoted;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use zenoh::config::EndPoint;
use zenoh_buffers::reader::HasReader;
use zenoh_buffers::writer::HasWriter;
use zenoh_codec::{RCodec, WCodec, Zenoh080};
use zenoh_protocol::VERSION;
use zenoh_protocol::common::ZExtBody;
use zenoh_protocol::core::{Resolution, WhatAmI, ZenohIdProto};
use zenoh_protocol::network::NetworkBody;
use zenoh_protocol::network::oam::id::OAM_LINKSTATE;
use zenoh_protocol::transport::init::ext::PatchType;
use zenoh_protocol::transport::{
    BatchSize, Close, InitSyn, OpenSyn, TransportBody, TransportMessage, close,
};

/// The lease that is announced for the moment that the link lasts.
const OWN_LEASE: Duration = Duration::from_secs(2);

/// Most bytes of the answer of another program that are shown.
const MAX_TEXT: usize = 64;

/// How long after a link is open the announcement of a router is waited for. It is the first thing that is sent on it.
const ANNOUNCED_WITHIN: Duration = Duration::from_secs(1);

/// The flag of a link state that says where the node listens (`linkstate::LOC` of Zenoh 1.10.2).
const LISTENS_AT: u64 = 1 << 2;

/// Whether a router announces peers to each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Announcing {
    /// The id of the router, as Zenoh writes it.
    pub router: String,
    /// Whether it does.
    pub is_on: bool,
}

/// What answers at an endpoint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reach {
    /// The name of the host is not known.
    Unknown(String),
    /// Nothing listens there: the host refuses.
    Refused,
    /// The host does not answer, or something on the way drops what is sent.
    Silent,
    /// Something takes connections and does not speak Zenoh. The start of its answer, if it sent any.
    Foreign(Option<String>),
    /// It speaks Zenoh and does not let us in, such as one that wants a password or another version.
    Closed(String),
    /// A node of Zenoh, with the lease that it announces.
    Zenoh {
        /// How long a silent link counts as alive.
        lease: Duration,
        /// Whether it is a router, which relays.
        router: bool,
    },
    /// Something listens; this protocol (TLS, a local socket) is not looked into further.
    Listens,
    /// This protocol (QUIC, over UDP) shows nothing before a session is open.
    Unseen,
}

impl Reach {
    /// Whether there may be a router.
    #[must_use]
    pub fn answers(&self) -> bool {
        matches!(self, Self::Zenoh { .. } | Self::Listens | Self::Unseen | Self::Closed(_))
    }
}

/// Looks what answers at an endpoint.
pub async fn reach(endpoint: &str, within: Duration) -> Reach {
    let Ok(parsed) = endpoint.parse::<EndPoint>() else {
        return Reach::Unknown("this is no endpoint".to_owned());
    };
    let address = parsed.address().as_str().to_owned();
    match parsed.protocol().as_str() {
        "unixsock-stream" => match tokio::net::UnixStream::connect(&address).await {
            Ok(_) => Reach::Listens,
            Err(_) => Reach::Refused,
        },
        "quic" => match tokio::net::lookup_host(&address).await {
            Ok(_) => Reach::Unseen,
            Err(error) => Reach::Unknown(error.to_string()),
        },
        protocol => {
            let plain = protocol == "tcp";
            let looking = async {
                let mut stream = match connect(&address).await {
                    Ok(stream) => stream,
                    Err(reach) => return reach,
                };
                if plain { greet(&mut stream, within).await } else { Reach::Listens }
            };
            tokio::time::timeout(within, looking).await.unwrap_or(Reach::Silent)
        }
    }
}

async fn connect(address: &str) -> Result<TcpStream, Reach> {
    let addresses: Vec<SocketAddr> = match tokio::net::lookup_host(address).await {
        Ok(addresses) => addresses.collect(),
        Err(error) => return Err(Reach::Unknown(error.to_string())),
    };
    let mut refused = false;
    for address in addresses {
        match TcpStream::connect(address).await {
            Ok(stream) => return Ok(stream),
            Err(error) => refused |= error.kind() == std::io::ErrorKind::ConnectionRefused,
        }
    }
    Err(if refused { Reach::Refused } else { Reach::Silent })
}

/// Whether a router announces to peers where others are (Zenoh calls that gossip): only then do they link to each other.
/// None if it cannot be seen: over other protocols than TCP, or if it does not let us in.
///
/// This links as a peer for a moment, one that listens nowhere. A router that announces says at once where it listens
/// itself; one that does not leaves that out (1.9 and later), or says nothing (before).
pub async fn announces_peers(endpoint: &str, within: Duration) -> Option<Announcing> {
    let endpoint = endpoint.parse::<EndPoint>().ok()?;
    if endpoint.protocol().as_str() != "tcp" {
        return None;
    }
    let connecting = tokio::time::timeout(within, connect(endpoint.address().as_str()));
    let mut stream = connecting.await.ok()?.ok()?;
    let opened = tokio::time::timeout(within, open(&mut stream, WhatAmI::Peer, within));
    let opened = opened.await.ok()?.ok().filter(|opened| opened.router)?;
    let listening = async {
        loop {
            let batch = receive_bytes(&mut stream).await.ok()?;
            if let Some(is_on) = announcement(&batch) {
                return Some(is_on);
            }
        }
    };
    let is_on = tokio::time::timeout(ANNOUNCED_WITHIN, listening).await;
    close(&mut stream).await;
    match is_on {
        Ok(Some(is_on)) => Some(Announcing { router: opened.id, is_on }),
        // The link is lost.
        Ok(None) => None,
        Err(_) => Some(Announcing { router: opened.id, is_on: false }),
    }
}

/// Whether a batch holds what a router says of its links, and whether it says there where it listens.
fn announcement(batch: &[u8]) -> Option<bool> {
    let mut reader = batch.reader();
    while let Ok(message) = RCodec::<TransportMessage, _>::read(Zenoh080::new(), &mut reader) {
        let TransportBody::Frame(frame) = message.body else { continue };
        for message in frame.payload {
            let NetworkBody::OAM(oam) = message.body else { continue };
            let (OAM_LINKSTATE, ZExtBody::ZBuf(list)) = (oam.id, oam.body) else { continue };
            // How many there are, and what the first one, the router's own, contains.
            let mut list = list.reader();
            let count: u64 = Zenoh080::new().read(&mut list).ok()?;
            let contains: u64 = Zenoh080::new().read(&mut list).ok()?;
            return Some(count > 0 && contains & LISTENS_AT != 0);
        }
    }
    None
}

/// Opens a link by hand, and lets go of it. A program that sends nothing has half of the time.
async fn greet(stream: &mut TcpStream, within: Duration) -> Reach {
    match open(stream, WhatAmI::Client, within).await {
        Ok(Opened { lease, router, .. }) => {
            close(stream).await;
            Reach::Zenoh { lease, router }
        }
        Err(reach) => reach,
    }
}

/// What a node states of itself as it opens a link.
struct Opened {
    id: String,
    lease: Duration,
    router: bool,
}

async fn open(stream: &mut TcpStream, whatami: WhatAmI, within: Duration) -> Result<Opened, Reach> {
    let syn = TransportBody::InitSyn(InitSyn {
        version: VERSION,
        whatami,
        zid: ZenohIdProto::rand(),
        resolution: Resolution::default(),
        batch_size: BatchSize::MAX,
        ext_qos: None,
        ext_qos_link: None,
        ext_auth: None,
        ext_mlink: None,
        ext_lowlatency: None,
        ext_compression: None,
        ext_patch: PatchType::NONE,
        ext_region_name: None,
    });
    let answered = async {
        send(stream, syn).await?;
        receive(stream).await
    };
    let answer = match tokio::time::timeout(within / 2, answered).await {
        Ok(Ok(answer)) => answer,
        Ok(Err(text)) => return Err(Reach::Foreign(text)),
        Err(_) => return Err(Reach::Foreign(None)),
    };
    let ack = match answer {
        TransportBody::InitAck(ack) => ack,
        TransportBody::Close(closed) => {
            return Err(Reach::Closed(close::reason_to_str(closed.reason).to_owned()));
        }
        _ => return Err(Reach::Closed("it answers out of order".to_owned())),
    };
    let open = TransportBody::OpenSyn(OpenSyn {
        lease: OWN_LEASE,
        initial_sn: 0,
        cookie: ack.cookie,
        ext_qos: None,
        ext_auth: None,
        ext_mlink: None,
        ext_lowlatency: None,
        ext_compression: None,
        ext_remote_bound: None,
    });
    let opened = match send(stream, open).await {
        Ok(()) => receive(stream).await,
        Err(text) => Err(text),
    };
    let refused = match opened {
        Ok(TransportBody::OpenAck(open)) => {
            let (id, router) = (ack.zid.to_string(), ack.whatami == WhatAmI::Router);
            return Ok(Opened { id, lease: open.lease, router });
        }
        Ok(TransportBody::Close(closed)) => close::reason_to_str(closed.reason),
        Ok(_) | Err(_) => "it does not open a link",
    };
    close(stream).await;
    Err(Reach::Closed(refused.to_owned()))
}

/// Lets go of a link; whether the other end reads that does not matter.
async fn close(stream: &mut TcpStream) {
    let close = Close { reason: close::reason::GENERIC, session: true };
    let _ = send(stream, TransportBody::Close(close)).await;
}

/// Sends a message: its length in two bytes, then itself.
async fn send(stream: &mut TcpStream, body: TransportBody) -> Result<(), Option<String>> {
    let mut bytes: Vec<u8> = Vec::new();
    let written: Result<(), _> =
        Zenoh080::new().write(&mut (&mut bytes).writer(), &TransportMessage { body });
    let length = u16::try_from(bytes.len());
    let (Ok(()), Ok(length)) = (written, length) else { return Err(None) };
    let mut all = length.to_le_bytes().to_vec();
    all.extend(bytes);
    stream.write_all(&all).await.map_err(|_| None)
}

/// Receives a message; the start of the answer instead, if it is none.
async fn receive(stream: &mut TcpStream) -> Result<TransportBody, Option<String>> {
    let bytes = receive_bytes(stream).await?;
    let message: Result<TransportMessage, _> = Zenoh080::new().read(&mut bytes.as_slice().reader());
    match message {
        Ok(message) => Ok(message.body),
        // The length is the start of what came as well, where it is no message of Zenoh.
        Err(_) => {
            let length = u16::try_from(bytes.len()).unwrap_or(u16::MAX).to_le_bytes();
            Err(first_line(&[&length[..], &bytes].concat()))
        }
    }
}

/// Receives a batch of messages: the length in two bytes, then themselves.
async fn receive_bytes(stream: &mut TcpStream) -> Result<Vec<u8>, Option<String>> {
    let mut length = [0; 2];
    let mut read = 0;
    while read < length.len() {
        match stream.read(&mut length[read..]).await {
            Ok(0) | Err(_) => return Err(first_line(&length[..read])),
            Ok(more) => read += more,
        }
    }
    let wanted = usize::from(u16::from_le_bytes(length));
    let mut bytes = vec![0; wanted];
    let mut read = 0;
    // What is no message of Zenoh is rarely as long as its first two bytes state: the text that came is
    // looked at as soon as nothing more comes.
    while read < wanted {
        let more =
            tokio::time::timeout(Duration::from_millis(500), stream.read(&mut bytes[read..]));
        match more.await {
            Ok(Ok(more)) if more > 0 => read += more,
            _ => return Err(first_line(&[&length[..], &bytes[..read]].concat())),
        }
    }
    Ok(bytes)
}

fn first_line(bytes: &[u8]) -> Option<String> {
    let start = &bytes[..bytes.len().min(MAX_TEXT)];
    let text = String::from_utf8_lossy(start);
    let line = text.lines().next().unwrap_or_default();
    (!line.is_empty()).then(|| quoted(line))
}
