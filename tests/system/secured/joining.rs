//! Joining a secured bus while strangers begin handshakes and fall silent, and a robot hears no answer.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use muster_tests::BUSY;
use muster_tests::client::Client;
use muster_tests::cluster::{SERVICES, start_router};
use muster_tests::ports::free_endpoint;
use muster_tests::process::Process;
use zenoh::Wait;
use zenoh::config::ZenohId;

use super::{SOON, Secured, open, text};

/// Robots with a session each. With the services there are 40 clients.
const ROBOTS: usize = 36;

/// How soon after the router has started again all clients are back, 5 s on an idle machine: one stranger costs 30 s in Zenoh's own
/// listener of QUIC, and that of TLS never comes to an end.
const BACK_WITHIN: Duration = Duration::from_secs(5 * BUSY);

/// How soon a client is there that comes after silent connections, which cost 10 s in Zenoh's own configuration.
const THERE_WITHIN: Duration = Duration::from_secs(8);

/// How long the beginnings of handshakes are gathered: several attempts of a client of Zenoh.
const GATHERING: Duration = Duration::from_secs(4);

/// How many beginnings of handshakes are gathered at once.
const STRANGERS: usize = 12;

/// Silent connections to a plain router: more than Zenoh lets open a session at once by default.
const SILENT: usize = 150;

/// Time between strangers once the router listens, by protocol; before that they come as fast as it could
/// start.
const BETWEEN: [(&str, Duration); 2] =
    [("quic", Duration::from_secs(1)), ("tls", Duration::from_millis(50))];

/// The configuration of a member that tries for a second to open a session at an address.
fn config_at(identity: &Path, protocol: &str, address: SocketAddr) -> zenoh::Config {
    let mut config = zenoh::Config::from_file(identity).unwrap();
    let endpoint = format!("[\"{protocol}/{address}\"]");
    config.insert_json5("connect/endpoints", &endpoint).unwrap();
    config.insert_json5("connect/timeout_ms", "1000").unwrap();
    config.insert_json5("transport/link/protocols", "null").unwrap();
    config
}

/// A way to a router over which nothing comes back.
fn one_way(protocol: &str, router: SocketAddr) -> SocketAddr {
    if protocol == "quic" {
        let from_robots = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = from_robots.local_addr().unwrap();
        thread::spawn(move || {
            let mut sockets: HashMap<SocketAddr, UdpSocket> = HashMap::new();
            let mut bytes = [0; 4096];
            while let Ok((length, from)) = from_robots.recv_from(&mut bytes) {
                let to_router =
                    sockets.entry(from).or_insert_with(|| UdpSocket::bind("127.0.0.1:0").unwrap());
                // As long as no router listens it is refused.
                let _ = to_router.send_to(&bytes[..length], router);
            }
        });
        return address;
    }
    let from_robots = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = from_robots.local_addr().unwrap();
    thread::spawn(move || {
        for mut from_robot in from_robots.incoming().flatten() {
            thread::spawn(move || {
                let mut to_router = TcpStream::connect(router)?;
                std::io::copy(&mut from_robot, &mut to_router)
            });
        }
    });
    address
}

/// A robot that goes on trying to join, and hears no answer. Returns how often it has tried.
fn robot_that_hears_nothing(
    identity: &Path,
    protocol: &'static str,
    router: SocketAddr,
    ended: Arc<AtomicBool>,
) -> JoinHandle<usize> {
    let address = one_way(protocol, router);
    let identity = identity.to_owned();
    thread::spawn(move || {
        for number in 0.. {
            if ended.load(Ordering::Relaxed) {
                return number;
            }
            let session = zenoh::open(config_at(&identity, protocol, address)).wait();
            assert!(session.is_err(), "it has received an answer");
        }
        0
    })
}

/// The first bytes of handshakes as clients of Zenoh send them, to an address where nobody answers.
fn beginnings(identity: &Path, protocol: &'static str) -> Vec<Vec<u8>> {
    let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
    let tcp = TcpListener::bind("127.0.0.1:0").unwrap();
    let nowhere = match protocol {
        "quic" => udp.local_addr().unwrap(),
        _ => tcp.local_addr().unwrap(),
    };
    for _ in 0..STRANGERS {
        let config = config_at(identity, protocol, nowhere);
        thread::spawn(move || drop(zenoh::open(config).wait()));
    }
    let mut found: HashMap<SocketAddr, Vec<u8>> = HashMap::new();
    let start = Instant::now();
    udp.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    tcp.set_nonblocking(true).unwrap();
    while found.len() < STRANGERS && start.elapsed() < GATHERING {
        let mut bytes = [0; 4096];
        if let Ok((length, from)) = udp.recv_from(&mut bytes) {
            found.entry(from).or_insert_with(|| bytes[..length].to_vec());
        }
        if let Ok((mut stream, from)) = tcp.accept() {
            stream.set_nonblocking(false).unwrap();
            let length = stream.read(&mut bytes).unwrap();
            found.insert(from, bytes[..length].to_vec());
        }
    }
    assert!(found.len() > STRANGERS / 2, "{} handshakes were begun", found.len());
    found.into_values().collect()
}

/// Strangers that come to a router one after another, begin a handshake and fall silent.
struct Strangers {
    listening: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<usize>>,
}

impl Strangers {
    fn start(protocol: &'static str, router: SocketAddr, beginnings: Vec<Vec<u8>>) -> Self {
        let (listening, ended) =
            (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let (is_listening, has_ended) = (listening.clone(), ended.clone());
        let between = BETWEEN.iter().find(|(name, _)| *name == protocol).unwrap().1;
        let thread = thread::spawn(move || {
            let (mut sockets, mut streams) = (Vec::new(), Vec::new());
            for number in 0.. {
                let beginning = &beginnings[number % beginnings.len()];
                if protocol == "quic" {
                    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
                    // As long as nobody listens it is refused.
                    let _ = socket.send_to(beginning, router);
                    sockets.push(socket);
                } else if let Ok(mut stream) = TcpStream::connect(router) {
                    // Nothing, half a beginning, a whole one; and a fourth that ends at once.
                    let length = [0, beginning.len() / 2, beginning.len(), 1][number % 4];
                    let _ = stream.write_all(&beginning[..length]);
                    if number % 4 != 3 {
                        streams.push(stream);
                    }
                }
                let pause = if is_listening.load(Ordering::Relaxed) {
                    between
                } else {
                    Duration::from_millis(20)
                };
                thread::sleep(pause);
                if has_ended.load(Ordering::Relaxed) {
                    return number;
                }
            }
            0
        });
        Self { listening, ended, thread: Some(thread) }
    }

    /// From now on they come at their own pace.
    fn router_listens(&self) {
        self.listening.store(true, Ordering::Relaxed);
    }

    /// Ends them; returns how many there were.
    fn end(mut self) -> usize {
        self.ended.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

async fn routers(client: &Client) -> Vec<ZenohId> {
    client.session().info().routers_zid().await.collect()
}

/// The services whose tokens the operator sees.
async fn services(operator: &Client) -> usize {
    let found = operator.session().liveliness().get(operator.key("service/*/*")).await.unwrap();
    let mut count = 0;
    while found.recv_async().await.is_ok() {
        count += 1;
    }
    count
}

#[tokio::test(flavor = "multi_thread")]
async fn forty_clients_are_back_at_once_while_strangers_fall_silent_and_a_robot_hears_nothing() {
    for protocol in ["quic", "tls"] {
        let mut secured = Secured::start_over(protocol, &["base"]);
        let identity = secured.identity("robot.a1");
        let config = std::fs::read_to_string(&identity).unwrap();
        let begin = format!("{protocol}/");
        let router = config.split(&begin).nth(1).unwrap().split('"').next().unwrap();
        let router: SocketAddr = router.parse().unwrap();
        let mut clients = vec![secured.client("operator.op").await];
        for _ in 1..ROBOTS {
            clients.push(secured.client("robot.a1").await);
        }
        let start = Instant::now();
        while services(&clients[0]).await < SERVICES.len() {
            assert!(start.elapsed() < SOON, "{protocol}: the services do not start");
        }
        let before = routers(&clients[0]).await;
        let beginnings = beginnings(&identity, protocol);

        secured.routers[0].kill().unwrap();
        let strangers = Strangers::start(protocol, router, beginnings);
        let file = secured.folder.path().join("base.json5");
        let arguments = ["router", "--zenoh-config", text(&file)];
        let mut again = Process::start("muster", &arguments, &[], secured.folder.path()).unwrap();
        again.until_prints("router listens at", SOON).unwrap();
        let start = Instant::now();
        strangers.router_listens();
        let deaf = robot_that_hears_nothing(&identity, protocol, router, strangers.ended.clone());
        secured.routers[0] = again;
        let back = async {
            loop {
                let mut count = 0;
                for client in &clients {
                    let now = routers(client).await;
                    count += usize::from(now.iter().any(|router| !before.contains(router)));
                }
                if count == ROBOTS {
                    count += services(&clients[0]).await;
                }
                if count == ROBOTS + SERVICES.len() || start.elapsed() > BACK_WITHIN {
                    return count;
                }
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        let count = back.await;
        println!("{protocol}: {count} of 40 are back after {:.1} s", start.elapsed().as_secs_f64());
        assert_eq!(count, ROBOTS + SERVICES.len(), "{protocol}: after {BACK_WITHIN:?}");
        // A new one comes in as well.
        let robot = open(&identity, &[]).await;
        assert!(robot.is_ok(), "{protocol}: {robot:?}");
        let count = strangers.end();
        assert!(count > 2, "{protocol}: {count} strangers came");
        let tried = deaf.join().unwrap();
        assert!(tried > 0, "{protocol}: the robot that hears nothing has not tried");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_connections_keep_nobody_out_of_a_plain_router() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint().unwrap();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    let address = endpoint.strip_prefix("tcp/").unwrap();
    let silent: Vec<_> = (0..SILENT).map(|_| TcpStream::connect(address).unwrap()).collect();
    tokio::time::sleep(Duration::from_millis(500)).await;
    let start = Instant::now();
    Client::connect(&endpoint, "alpha").await.unwrap();
    assert!(start.elapsed() < THERE_WITHIN, "after {:?}", start.elapsed());
    drop(silent);
}
