//! The loop: inputs into the core, outputs to where they belong.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::{Exit, ExitError};
use muster_runtime::notify;
use muster_runtime::observe::Observatory;
use muster_runtime::stop::Stop;
use tokio::net::TcpListener;
use tokio::sync::mpsc;

use super::fleet::{self, Order};
use super::http;
use super::options::ConsoleOptions;
use super::socket::ToBrowser;
use crate::access::Sessions;
use crate::limits::{MAX_BROWSERS, MAX_PENDING};
use crate::{BrowserId, Console, Input, Output, Role};

/// How often the core is told that time passes.
const TICK: Duration = Duration::from_millis(100);

/// Most inputs that wait for the core. Whoever has one more waits.
const MAX_WAITING_INPUTS: usize = 1024;

/// Most orders that wait for the bus: more than all browsers may have pending.
const MAX_WAITING_ORDERS: usize = 2048;

const _: () = assert!(MAX_WAITING_ORDERS > 2 * MAX_PENDING * MAX_BROWSERS);

/// When a loop that has not turned counts as hanging, as that of a service.
const HANGING_AFTER: Duration = Duration::from_secs(5);

/// What comes to the loop.
#[derive(Debug)]
pub(super) enum Happening {
    /// An input of the core.
    Core(Input),
    /// A browser, what it may do, and the way to it.
    Opened(BrowserId, Role, Way),
}

/// The way to a browser.
#[derive(Debug)]
pub(super) struct Way {
    /// The session under which it was opened; none where no one signs in.
    pub(super) session: Option<String>,
    /// Where what goes to it waits.
    pub(super) outbox: mpsc::UnboundedSender<ToBrowser>,
}

type Browsers = BTreeMap<BrowserId, Way>;

/// The browsers whose session has ended: one that was opened before must not outlast it.
fn signed_out(browsers: &Browsers, sessions: &Sessions, now: Tick) -> Vec<BrowserId> {
    let is_over = |way: &Way| sessions.role(now, way.session.as_deref()).is_none();
    browsers.iter().filter_map(|(id, way)| is_over(way).then_some(*id)).collect()
}

/// What the port and the loop share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) clock: Clock,
    pub(super) sessions: Mutex<Sessions>,
    pub(super) happenings: mpsc::Sender<Happening>,
    /// When the loop last turned, in microseconds since 1970.
    turned: AtomicU64,
    linked: AtomicBool,
}

impl Shared {
    /// Whether the loop runs.
    pub(super) fn is_alive(&self) -> bool {
        let turned = Tick(self.turned.load(Ordering::Relaxed));
        self.clock.now().since(turned) < HANGING_AFTER
    }

    /// Whether a router is linked.
    pub(super) fn is_linked(&self) -> bool {
        self.linked.load(Ordering::Relaxed)
    }
}

/// Runs the program: serves the page until it is time to stop.
///
/// # Errors
/// If the port cannot be listened at; the text names the flag.
pub(super) async fn run(
    config: ProcessConfig,
    options: ConsoleOptions,
    stop: Stop,
) -> anyhow::Result<()> {
    let _observatory = Observatory::open(&config, &[])?;
    let fail = |error: std::io::Error| ExitError {
        exit: Exit::Failure,
        message: format!(
            "serve: cannot listen at {}: {error}; choose another address with --serve",
            options.address
        ),
    };
    let listener = TcpListener::bind(options.address).await.map_err(fail)?;
    let address = listener.local_addr().map_err(fail)?;
    notify::ready(&format!("serves the console at http://{address}"));
    serve(&config, listener, address, options, stop).await;
    notify::stopping().await;
    Ok(())
}

/// Serves the page at a port until it is time to stop.
pub(super) async fn serve(
    config: &ProcessConfig,
    listener: TcpListener,
    address: SocketAddr,
    options: ConsoleOptions,
    mut stop: Stop,
) {
    let hosts = options.hosts(address);
    let clock = Clock::start();
    let (happenings, mut inbox) = mpsc::channel(MAX_WAITING_INPUTS);
    let shared = Arc::new(Shared {
        clock,
        sessions: Mutex::new(Sessions::new(options.door)),
        happenings: happenings.clone(),
        turned: AtomicU64::new(clock.now().0),
        linked: AtomicBool::new(false),
    });
    let edges = options.image.as_ref().map(|image| image.edges);
    let port = tokio::spawn(http::serve(listener, hosts, options.image, Arc::clone(&shared)));
    tracing::info!("serves the console at http://{address}");
    let (orders, to_fleet) = mpsc::channel(MAX_WAITING_ORDERS);
    tokio::spawn(fleet::follow(fleet::client_config(config), happenings, to_fleet));
    let mut watched = notify::watch();

    let mut console =
        Console::new(config.fleet.value.clone(), env!("CARGO_PKG_VERSION")).with_image(edges);
    let mut browsers = Browsers::new();
    let mut ticks = tokio::time::interval(TICK);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    loop {
        let input = tokio::select! {
            () = stop.stopped() => break,
            () = watched.due() => {
                watched.report();
                continue;
            }
            _ = ticks.tick() => Input::Tick,
            Some(happening) = inbox.recv() => match happening {
                Happening::Core(input) => input,
                Happening::Opened(id, role, way) => {
                    browsers.insert(id, way);
                    Input::Opened(id, role)
                }
            },
        };
        if let Input::Closed(id) = input {
            browsers.remove(&id);
        }
        let now = clock.now();
        shared.turned.store(now.0, Ordering::Relaxed);
        // Before a message of a browser counts, and as time passes.
        if matches!(input, Input::Tick | Input::Text(..)) {
            let sessions = shared.sessions.lock().unwrap_or_else(PoisonError::into_inner);
            let over = signed_out(&browsers, &sessions, now);
            drop(sessions);
            for id in over {
                perform(Output::Close(id, "the session has ended"), &mut browsers, &orders);
                for output in console.handle(now, Input::Closed(id)) {
                    perform(output, &mut browsers, &orders);
                }
            }
        }
        for output in console.handle(now, input) {
            perform(output, &mut browsers, &orders);
        }
        shared.linked.store(console.is_linked(), Ordering::Relaxed);
    }
    port.abort();
}

fn perform(output: Output, browsers: &mut Browsers, orders: &mpsc::Sender<Order>) {
    // A browser whose end is not known yet gets nothing; its task says that it is closed.
    let to = |id: BrowserId, what: ToBrowser, browsers: &Browsers| {
        if let Some(way) = browsers.get(&id) {
            let _ = way.outbox.send(what);
        }
    };
    let order = match output {
        Output::Text(id, text) => return to(id, ToBrowser::Text(text), browsers),
        Output::Frame(id, frame) => return to(id, ToBrowser::Frame(frame), browsers),
        Output::Close(id, reason) => {
            to(id, ToBrowser::Close(reason), browsers);
            browsers.remove(&id);
            return;
        }
        Output::Command(ticket, command) => Order::Command(ticket, Box::new(command)),
        Output::Ask(ticket, question) => Order::Ask(ticket, question),
        Output::Propose(ticket, order) => Order::Propose(ticket, Box::new(order)),
        Output::Fetch(fetch) => Order::Fetch(fetch),
    };
    if let Err(error) = orders.try_send(order) {
        tracing::warn!("an order is not carried out: {error}");
    }
}

#[cfg(test)]
mod tests {
    use muster_model::id::OperatorId;

    use super::*;
    use crate::access::{Door, SESSION_TIME};

    fn way(session: Option<&str>) -> Way {
        Way { session: session.map(str::to_owned), outbox: mpsc::unbounded_channel().0 }
    }

    #[test]
    fn a_browser_is_closed_with_its_session() {
        const TOKEN: &str = "wall-wall-wall-wall-wall-wall";
        let now = Tick(1_000_000_000);
        let mut sessions = Sessions::new(Door::Tokens(vec![(TOKEN.to_owned(), Role::Viewer)]));
        sessions.sign_in(now, TOKEN, "s1".to_owned()).unwrap();
        sessions.sign_in(now.after(SESSION_TIME / 2), TOKEN, "s2".to_owned()).unwrap();
        let browsers = Browsers::from([(1, way(Some("s1"))), (2, way(Some("s2")))]);
        assert!(signed_out(&browsers, &sessions, now).is_empty());
        assert_eq!(signed_out(&browsers, &sessions, now.after(SESSION_TIME)), [1]);
        sessions.sign_out(Some("s2"));
        assert_eq!(signed_out(&browsers, &sessions, now), [2]);
        // Where no one signs in, no session ends.
        let open = Sessions::new(Door::Open(OperatorId::new("kim").unwrap()));
        let browsers = Browsers::from([(3, way(None))]);
        assert!(signed_out(&browsers, &open, now.after(2 * SESSION_TIME)).is_empty());
    }
}
