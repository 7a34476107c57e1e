//! The port: `/healthz`, `/readyz` and `/metrics`, and nothing else.
//!
//! It runs on a thread of its own. Every connection is bounded in time and bytes, and so is their
//! number: one more closes the oldest. A client of the port can watch the process, but
//! neither slow it down nor keep others out by silent connections.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{ALLOW, CACHE_CONTROL, CONTENT_TYPE, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use muster_model::id::ServiceName;
use serde_json::{Map, Value, json};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::health::Look;
use super::observer::Shared;
use super::{health, metrics};
use crate::exit::{Exit, ExitError};

/// Most connections at once: a handful of probes and scrapers.
const MAX_CONNECTIONS: usize = 32;

/// Largest head of a request in bytes, and most fields in it: browsers send some hundred bytes.
const MAX_HEAD: usize = 16 * 1024;
const MAX_FIELDS: usize = 64;

/// How long a request may take to arrive.
const HEAD_WITHIN: Duration = Duration::from_secs(5);

/// How long a connection may last altogether, also if its answer is not read.
const CONNECTION_WITHIN: Duration = Duration::from_secs(10);

/// How long nothing is accepted after that failed: descriptors may have run out, and are not there
/// again at once.
const ACCEPT_AGAIN: Duration = Duration::from_millis(100);

/// What a process shows at its port.
pub(super) trait Shown: Send + Sync {
    /// Whether it is alive, and the answer that says so.
    fn healthz(&self) -> (bool, Value);

    /// Whether it is ready, and the answer that says so.
    fn readyz(&self) -> (bool, Value);

    /// All metrics as text.
    ///
    /// # Errors
    /// If a metric cannot be written, which none of ours is.
    fn metrics(&self) -> Result<String, std::fmt::Error>;
}

/// An open port. It closes when this is let go of.
#[derive(Debug)]
pub(super) struct Port {
    address: SocketAddr,
    _closing: oneshot::Sender<Infallible>,
}

impl Port {
    /// Listens at an address.
    ///
    /// # Errors
    /// If that is not possible; the text names the flag.
    pub(super) fn open(address: SocketAddr, shown: Arc<dyn Shown>) -> anyhow::Result<Self> {
        let fail = |error: std::io::Error| ExitError {
            exit: Exit::Failure,
            message: format!(
                "http: cannot listen at {address}: {error}; choose another address with --http, or \
                 leave it out"
            ),
        };
        let listener = TcpListener::bind(address).map_err(fail)?;
        listener.set_nonblocking(true).map_err(fail)?;
        let address = listener.local_addr().map_err(fail)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (closing, closed) = oneshot::channel();
        std::thread::Builder::new()
            .name("muster-http".to_owned())
            .spawn(move || runtime.block_on(serve(listener, shown, closed)))
            .context("cannot start the thread that serves --http")?;
        tracing::info!("serves /healthz, /readyz and /metrics at http://{address}");
        Ok(Self { address, _closing: closing })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }
}

async fn serve(
    listener: TcpListener,
    shown: Arc<dyn Shown>,
    mut closed: oneshot::Receiver<Infallible>,
) {
    let listener = match tokio::net::TcpListener::from_std(listener) {
        Ok(listener) => listener,
        Err(error) => return tracing::error!("--http is not served: {error}"),
    };
    let mut open: VecDeque<JoinHandle<()>> = VecDeque::with_capacity(MAX_CONNECTIONS);
    loop {
        let accepted = tokio::select! {
            _ = &mut closed => return,
            accepted = listener.accept() => accepted,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!("--http accepts nothing for a moment: {error}");
                tokio::time::sleep(ACCEPT_AGAIN).await;
                continue;
            }
        };
        open.retain(|connection| !connection.is_finished());
        if open.len() >= MAX_CONNECTIONS
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
        }
        let shown = Arc::clone(&shown);
        open.push_back(tokio::spawn(async move {
            let service = service_fn(move |request| {
                let answer = answer(&request, &*shown);
                async move { Ok::<_, Infallible>(answer) }
            });
            let connection = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEAD_WITHIN)
                .max_buf_size(MAX_HEAD)
                .max_headers(MAX_FIELDS)
                .keep_alive(false)
                .serve_connection(TokioIo::new(stream), service);
            // What a client does wrong is its own affair; the text of hyper quotes no request.
            if let Ok(Err(error)) = tokio::time::timeout(CONNECTION_WITHIN, connection).await {
                tracing::debug!("a connection to --http failed: {error}");
            }
        }));
    }
}

fn answer(request: &Request<Incoming>, shown: &dyn Shown) -> Response<Full<Bytes>> {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        let mut answer = text(StatusCode::METHOD_NOT_ALLOWED, "only GET and HEAD\n".to_owned());
        answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
        return answer;
    }
    match request.uri().path() {
        "/healthz" => json_answer(shown.healthz()),
        "/readyz" => json_answer(shown.readyz()),
        "/metrics" => match shown.metrics() {
            Ok(all) => with_type(text(StatusCode::OK, all), metrics::CONTENT_TYPE),
            Err(error) => {
                tracing::error!("the metrics cannot be written: {error}");
                text(StatusCode::INTERNAL_SERVER_ERROR, "no metrics\n".to_owned())
            }
        },
        _ => text(StatusCode::NOT_FOUND, "there are /healthz, /readyz and /metrics\n".to_owned()),
    }
}

impl Shown for Shared {
    fn healthz(&self) -> (bool, Value) {
        let alive = |_, look: &Look| {
            let alive = health::is_alive(look);
            let since = look.since_turn.map(|since| since.as_secs_f64());
            (alive, json!({"alive": alive, "last_turn_s": since}))
        };
        let (mut all, mut answer) = answer_for_all(self, "alive", alive);
        if let Some(since) = self.since_router_turned() {
            let runs = health::loop_runs(Some(since));
            all &= runs;
            answer["alive"] = all.into();
            answer["router"] = json!({"alive": runs, "last_turn_s": since.as_secs_f64()});
        }
        (all, answer)
    }

    fn readyz(&self) -> (bool, Value) {
        let ready = |service, look: &Look| {
            let reasons = health::reasons(service, look);
            let (ready, standing) = (reasons.is_empty(), look.standing);
            (ready, json!({"ready": ready, "standing": standing, "reasons": reasons}))
        };
        answer_for_all(self, "ready", ready)
    }

    fn metrics(&self) -> Result<String, std::fmt::Error> {
        self.watched.iter().for_each(|watched| watched.refresh());
        self.metrics.text()
    }
}

/// Whether all services are good, and the answer with their states, which says so under `name`.
fn answer_for_all(
    shared: &Shared,
    name: &str,
    state: impl Fn(ServiceName, &Look) -> (bool, Value),
) -> (bool, Value) {
    let mut all = true;
    let mut services = Map::new();
    for watched in &shared.watched {
        let (good, state) = state(watched.service, &watched.look());
        all &= good;
        services.insert(watched.service.to_string(), state);
    }
    (all, json!({name: all, "services": services}))
}

fn json_answer((good, value): (bool, Value)) -> Response<Full<Bytes>> {
    let status = if good { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    with_type(text(status, format!("{value}\n")), "application/json")
}

fn text(status: StatusCode, body: String) -> Response<Full<Bytes>> {
    let mut answer = Response::new(Full::new(Bytes::from(body)));
    *answer.status_mut() = status;
    // A cached state is a wrong one.
    answer.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    with_type(answer, "text/plain; charset=utf-8")
}

fn with_type(mut answer: Response<Full<Bytes>>, kind: &'static str) -> Response<Full<Bytes>> {
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    answer
}
