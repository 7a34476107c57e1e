//! The port: the page, its sign-in, health, and the upgrade to a WebSocket.
//!
//! Every connection is bounded in time and bytes, and so is their number: one more closes the oldest.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    ACCEPT_ENCODING, ALLOW, CACHE_CONTROL, CONNECTION, CONTENT_ENCODING, CONTENT_SECURITY_POLICY,
    CONTENT_TYPE, COOKIE, HOST, HeaderName, HeaderValue, ORIGIN, REFERRER_POLICY,
    SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_VERSION, SET_COOKIE, UPGRADE, VARY,
    X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

use super::options::GroundImage;
use super::run::Shared;
use super::socket;
use crate::Role;
use crate::access::{self, Hosts, SESSION_TIME, SignInError};
use crate::assets::{Asset, Compressed};
use crate::limits::MAX_BROWSERS;

/// Most connections at once besides WebSockets: some for each browser that loads the page.
const MAX_CONNECTIONS: usize = 4 * MAX_BROWSERS;

/// Largest head of a request in bytes, and most fields in it: browsers send some hundred bytes.
const MAX_HEAD: usize = 16 * 1024;
const MAX_FIELDS: usize = 64;

/// Largest body in bytes: a token.
const MAX_BODY: usize = 4096;

/// How long a request may take to arrive.
const HEAD_WITHIN: Duration = Duration::from_secs(5);

/// How long a connection may last altogether; a browser opens another one.
const CONNECTION_WITHIN: Duration = Duration::from_secs(30);

/// How long nothing is accepted after that failed: descriptors may have run out, and are not there again at once.
const ACCEPT_AGAIN: Duration = Duration::from_millis(100);

/// Random bytes of a session's name.
const SESSION_BYTES: usize = 24;

/// What pages may do: nothing but what this port serves, and nothing that stands in the page itself.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; \
     frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

type Answer = Response<Full<Bytes>>;

/// What every request is answered from.
struct Port {
    hosts: Hosts,
    assets: Vec<Compressed>,
    image: Option<GroundImage>,
    shared: Arc<Shared>,
    next: AtomicU64,
}

/// Serves the port until the process ends.
pub(super) async fn serve(
    listener: TcpListener,
    hosts: Hosts,
    image: Option<GroundImage>,
    shared: Arc<Shared>,
) {
    let assets = Asset::ALL.iter().map(Compressed::new).collect();
    let port = Arc::new(Port { hosts, assets, image, shared, next: AtomicU64::new(1) });
    let mut open: VecDeque<JoinHandle<()>> = VecDeque::with_capacity(MAX_CONNECTIONS);
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!("nothing is accepted for a moment: {error}");
                tokio::time::sleep(ACCEPT_AGAIN).await;
                continue;
            }
        };
        // A frame is sent when it is there, not when more is.
        let _ = stream.set_nodelay(true);
        open.retain(|connection| !connection.is_finished());
        if open.len() >= MAX_CONNECTIONS
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
        }
        let port = Arc::clone(&port);
        open.push_back(tokio::spawn(async move {
            let service = service_fn(move |request| {
                let port = Arc::clone(&port);
                async move { Ok::<_, Infallible>(secured(answer(request, &port).await)) }
            });
            let connection = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEAD_WITHIN)
                .max_buf_size(MAX_HEAD)
                .max_headers(MAX_FIELDS)
                .serve_connection(TokioIo::new(stream), service)
                .with_upgrades();
            // What a client does wrong is its own affair; the text of hyper quotes no request.
            if let Ok(Err(error)) = tokio::time::timeout(CONNECTION_WITHIN, connection).await {
                tracing::debug!("a connection failed: {error}");
            }
        }));
    }
}

/// An answer with the headers that all have.
fn secured(mut answer: Answer) -> Answer {
    let headers = answer.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (X_FRAME_OPTIONS, "DENY"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        // The next version of the program brings another page under the same names.
        (CACHE_CONTROL, "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    answer
}

fn field(request: &Request<Incoming>, name: HeaderName) -> Option<&str> {
    request.headers().get(name).and_then(|value| value.to_str().ok())
}

async fn answer(request: Request<Incoming>, port: &Port) -> Answer {
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    if !port.hosts.knows(field(&request, HOST)) {
        let problem = "this console has another name; see `hosts` of its file of access\n";
        return text(StatusCode::MISDIRECTED_REQUEST, problem);
    }
    match (method, path.as_str()) {
        (Method::GET | Method::HEAD, "/healthz") => {
            let alive = port.shared.is_alive();
            health(alive, &json!({"alive": alive}))
        }
        (Method::GET | Method::HEAD, "/readyz") => {
            let (alive, linked) = (port.shared.is_alive(), port.shared.is_linked());
            let reason = (!linked).then_some("the link to the router is lost");
            health(alive && linked, &json!({"ready": alive && linked, "reason": reason}))
        }
        (Method::GET, "/session") => who(&request, port),
        (Method::POST | Method::DELETE, "/session") => sign(request, port).await,
        (Method::GET, "/live") => upgrade(request, port),
        (Method::GET | Method::HEAD, "/image") => image(&request, port),
        (Method::GET | Method::HEAD, path) => asset(&request, path, port),
        _ => {
            let mut answer = text(StatusCode::METHOD_NOT_ALLOWED, "only GET and HEAD\n");
            answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
            answer
        }
    }
}

fn asset(request: &Request<Incoming>, path: &str, port: &Port) -> Answer {
    let path = if path == "/" { "/index.html" } else { path };
    let Some(asset) = port.assets.iter().find(|asset| path.strip_prefix('/') == Some(asset.path))
    else {
        return text(StatusCode::NOT_FOUND, "there is no such page\n");
    };
    let takes_gzip = field(request, ACCEPT_ENCODING).is_some_and(|all| all.contains("gzip"));
    let body = if takes_gzip { asset.gzip.clone() } else { Bytes::from_static(asset.plain) };
    let mut answer = Response::new(Full::new(body));
    let headers = answer.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(asset.kind));
    headers.insert(VARY, HeaderValue::from_static("accept-encoding"));
    if takes_gzip {
        headers.insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    answer
}

/// The image below the map, for those who may see the fleet.
fn image(request: &Request<Incoming>, port: &Port) -> Answer {
    if role(request, port).is_none() {
        return text(StatusCode::UNAUTHORIZED, "sign in first\n");
    }
    let Some(image) = &port.image else {
        return text(StatusCode::NOT_FOUND, "there is no image below the map\n");
    };
    let mut answer = Response::new(Full::new(image.bytes.clone()));
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(image.kind));
    answer
}

/// The session that a request names.
fn session(request: &Request<Incoming>) -> Option<&str> {
    field(request, COOKIE).and_then(access::session_of)
}

/// What the bearer of the request's session may do.
fn role(request: &Request<Incoming>, port: &Port) -> Option<Role> {
    let session = session(request);
    let sessions = port.shared.sessions.lock().unwrap_or_else(PoisonError::into_inner);
    sessions.role(port.shared.clock.now(), session)
}

fn who(request: &Request<Incoming>, port: &Port) -> Answer {
    let asks = port.shared.sessions.lock().unwrap_or_else(PoisonError::into_inner).asks();
    match role(request, port) {
        Some(Role::Viewer) => {
            json_answer(StatusCode::OK, &json!({"role": "viewer", "token": asks}))
        }
        Some(Role::Operator(name)) => {
            let answer = json!({"role": "operator", "operator": name, "token": asks});
            json_answer(StatusCode::OK, &answer)
        }
        None => json_answer(StatusCode::UNAUTHORIZED, &json!({"role": null})),
    }
}

/// What somebody signs in with.
#[derive(Deserialize)]
struct SignIn {
    token: String,
}

async fn sign(request: Request<Incoming>, port: &Port) -> Answer {
    if !port.hosts.knows_origin(field(&request, ORIGIN)) {
        return text(StatusCode::FORBIDDEN, "only the page of this console may sign in\n");
    }
    let now = port.shared.clock.now();
    let sessions = || port.shared.sessions.lock().unwrap_or_else(PoisonError::into_inner);
    if request.method() == Method::DELETE {
        sessions().sign_out(session(&request));
        return cookie(json_answer(StatusCode::OK, &json!({"role": null})), "", 0);
    }
    let body =
        tokio::time::timeout(HEAD_WITHIN, Limited::new(request.into_body(), MAX_BODY).collect());
    let Ok(Ok(body)) = body.await else {
        return text(StatusCode::BAD_REQUEST, "the token is too long, or did not arrive\n");
    };
    let Ok(SignIn { token }) = serde_json::from_slice(&body.to_bytes()) else {
        return text(StatusCode::BAD_REQUEST, "must be {\"token\": \"…\"}\n");
    };
    let Some(session) = fresh_session() else {
        return text(StatusCode::INTERNAL_SERVER_ERROR, "there is no randomness\n");
    };
    let signed = sessions().sign_in(now, token.trim(), session.clone());
    match signed {
        Ok(()) => cookie(json_answer(StatusCode::OK, &json!({})), &session, SESSION_TIME.as_secs()),
        Err(SignInError::Unknown) => {
            json_answer(StatusCode::UNAUTHORIZED, &json!({"problem": "this token is unknown"}))
        }
        Err(SignInError::TooMany) => {
            let problem = "this token is unknown, as were many within the last minute";
            json_answer(StatusCode::TOO_MANY_REQUESTS, &json!({"problem": problem}))
        }
    }
}

fn fresh_session() -> Option<String> {
    let mut bytes = [0; SESSION_BYTES];
    getrandom::fill(&mut bytes).ok()?;
    Some(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn cookie(mut answer: Answer, session: &str, seconds: u64) -> Answer {
    let name = access::COOKIE;
    let text = format!("{name}={session}; Path=/; Max-Age={seconds}; HttpOnly; SameSite=Strict");
    if let Ok(value) = HeaderValue::from_str(&text) {
        answer.headers_mut().insert(SET_COOKIE, value);
    }
    answer
}

fn upgrade(mut request: Request<Incoming>, port: &Port) -> Answer {
    if !port.hosts.knows_origin(field(&request, ORIGIN)) {
        return text(StatusCode::FORBIDDEN, "only the page of this console may open this\n");
    }
    let Some(role) = role(&request, port) else {
        return text(StatusCode::UNAUTHORIZED, "sign in first\n");
    };
    let is = |name, value: &str| {
        field(&request, name).is_some_and(|field| field.to_ascii_lowercase().contains(value))
    };
    let is_websocket = is(UPGRADE, "websocket") && is(SEC_WEBSOCKET_VERSION, "13");
    let key = field(&request, SEC_WEBSOCKET_KEY).map(|key| derive_accept_key(key.as_bytes()));
    let (true, Some(key)) = (is_websocket, key) else {
        return text(StatusCode::UPGRADE_REQUIRED, "this is a WebSocket\n");
    };
    let Ok(key) = HeaderValue::from_str(&key) else {
        return text(StatusCode::BAD_REQUEST, "this is no WebSocket\n");
    };
    let id = port.next.fetch_add(1, Ordering::Relaxed);
    let session = session(&request).map(str::to_owned);
    let (upgraded, shared) = (hyper::upgrade::on(&mut request), Arc::clone(&port.shared));
    tokio::spawn(async move {
        match upgraded.await {
            Ok(upgraded) => socket::serve(upgraded, id, role, session, shared).await,
            Err(error) => tracing::debug!("an upgrade failed: {error}"),
        }
    });
    let mut answer = Response::new(Full::default());
    *answer.status_mut() = StatusCode::SWITCHING_PROTOCOLS;
    let headers = answer.headers_mut();
    headers.insert(CONNECTION, HeaderValue::from_static("Upgrade"));
    headers.insert(UPGRADE, HeaderValue::from_static("websocket"));
    headers.insert(SEC_WEBSOCKET_ACCEPT, key);
    answer
}

fn health(good: bool, value: &Value) -> Answer {
    json_answer(if good { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE }, value)
}

fn json_answer(status: StatusCode, value: &Value) -> Answer {
    with_type(status, format!("{value}\n"), "application/json")
}

fn text(status: StatusCode, body: &'static str) -> Answer {
    with_type(status, body.to_owned(), "text/plain; charset=utf-8")
}

fn with_type(status: StatusCode, body: String, kind: &'static str) -> Answer {
    let mut answer = Response::new(Full::new(Bytes::from(body)));
    *answer.status_mut() = status;
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    answer
}
