//! The port over real sockets: the page, its headers, who may come in, and how large what comes may be. No router runs.

#![cfg(feature = "binary")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; \
     frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

const KIM: &str = "kim-kim-kim-kim-kim-kim-kim";
const WALL: &str = "wall-wall-wall-wall-wall-wall";

/// A console of its own.
struct Served {
    process: Child,
    address: String,
    _folder: tempfile::TempDir,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Served {
    fn start(access: Option<&str>) -> Self {
        Self::start_with(access, None)
    }

    /// With an image below the map, whose edges lie ten metres around the origin.
    fn start_with(access: Option<&str>, image: Option<&[u8]>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_muster-console"));
        command.args(["--serve", "127.0.0.1:0", "--connect", "tcp/127.0.0.1:1", "--log", "info"]);
        if let Some(text) = access {
            let path = folder.path().join("access.toml");
            std::fs::write(&path, text).unwrap();
            command.arg("--access").arg(path);
        }
        if let Some(bytes) = image {
            let path = folder.path().join("ground.png");
            std::fs::write(&path, bytes).unwrap();
            command.arg("--image").arg(path).args(["--image-at", "-10,-10,10,10"]);
        }
        let mut process = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(process.stderr.take().unwrap());
        let mut line = String::new();
        let address = loop {
            line.clear();
            assert!(lines.read_line(&mut line).unwrap() > 0, "it has ended");
            if let Some((_, address)) = line.split_once("http://") {
                break address.split_whitespace().next().unwrap().to_owned();
            }
        };
        // What it says later must not fill the pipe.
        std::thread::spawn(move || std::io::copy(&mut lines, &mut std::io::sink()));
        Self { process, address, _folder: folder }
    }

    /// Sends a request with these fields besides `Host`, and returns the head and the body of the answer.
    fn ask(&self, line: &str, fields: &[&str], body: &str) -> (String, Vec<u8>) {
        let host = format!("Host: {}", self.address);
        let fields = [&[host.as_str()], fields].concat();
        self.ask_as(line, &fields, body)
    }

    fn ask_as(&self, line: &str, fields: &[&str], body: &str) -> (String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let fields = fields.join("\r\n");
        let length = body.len();
        let close = if fields.contains("Upgrade") { "" } else { "Connection: close\r\n" };
        let text =
            format!("{line} HTTP/1.1\r\n{fields}\r\n{close}Content-Length: {length}\r\n\r\n{body}");
        stream.write_all(text.as_bytes()).unwrap();
        let mut answer = Vec::new();
        if close.is_empty() {
            let mut part = [0; 4096];
            let length = stream.read(&mut part).unwrap();
            answer.extend(&part[..length]);
        } else {
            stream.read_to_end(&mut answer).unwrap();
        }
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        (String::from_utf8(answer[..end].to_vec()).unwrap(), answer[end + 4..].to_vec())
    }

    fn open_live(&self, fields: &[&str]) -> String {
        let upgrade = [
            "Connection: Upgrade",
            "Upgrade: websocket",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        ];
        self.ask("GET /live", &[&upgrade[..], fields].concat(), "").0
    }

    fn origin(&self) -> String {
        format!("Origin: http://{}", self.address)
    }
}

fn status(head: &str) -> u16 {
    head.split(' ').nth(1).unwrap().parse().unwrap()
}

fn field<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let lines = head.lines().filter_map(|line| line.split_once(": "));
    lines.filter(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value).next_back()
}

#[test]
fn the_page_comes_with_a_strict_policy_under_its_own_names_alone() {
    let served = Served::start(None);
    for (path, kind) in [
        ("/", "text/html; charset=utf-8"),
        ("/app.js", "text/javascript; charset=utf-8"),
        ("/vendor/uPlot.css", "text/css; charset=utf-8"),
        ("/nothing", "text/plain; charset=utf-8"),
        ("/session", "application/json"),
        ("/live", "text/plain; charset=utf-8"),
    ] {
        let (head, _) = served.ask(&format!("GET {path}"), &[], "");
        assert_eq!(field(&head, "content-security-policy"), Some(POLICY), "{path}");
        assert_eq!(field(&head, "x-content-type-options"), Some("nosniff"), "{path}");
        assert_eq!(field(&head, "content-type"), Some(kind), "{path}");
    }
    let (head, body) = served.ask("GET /app.js", &["Accept-Encoding: gzip, br"], "");
    assert_eq!((field(&head, "content-encoding"), &body[..2]), (Some("gzip"), &[0x1f, 0x8b][..]));
    for traversal in
        ["/../Cargo.toml", "/vendor/../app.js", "/vendor", "//app.js", "/%2e%2e/Cargo.toml"]
    {
        assert_eq!(status(&served.ask(&format!("GET {traversal}"), &[], "").0), 404, "{traversal}");
    }
    // A page elsewhere whose name was pointed at this host.
    for path in ["/", "/session", "/healthz", "/live"] {
        let (head, _) = served.ask_as(&format!("GET {path}"), &["Host: evil.example"], "");
        assert_eq!(status(&head), 421, "{path}");
    }
    assert_eq!(status(&served.ask("PUT /", &[], "").0), 405);
    let long = format!("X-Long: {}", "x".repeat(20_000));
    assert!(status(&served.ask("GET /", &[&long], "").0) >= 400);
}

#[test]
fn health_says_that_it_runs_and_that_no_router_is_linked() {
    let served = Served::start(None);
    let (head, body) = served.ask("GET /healthz", &[], "");
    assert_eq!((status(&head), body.as_slice()), (200, &b"{\"alive\":true}\n"[..]));
    let (head, body) = served.ask("GET /readyz", &[], "");
    assert_eq!(status(&head), 503);
    assert!(String::from_utf8(body).unwrap().contains("the link to the router is lost"));
}

#[test]
fn only_the_own_page_opens_a_websocket() {
    let served = Served::start(None);
    let own = served.open_live(&[&served.origin()]);
    assert_eq!(status(&own), 101, "{own}");
    assert_eq!(field(&own, "sec-websocket-accept"), Some("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="));
    for other in ["Origin: http://evil.example", "Origin: null", "X-None: 1"] {
        assert_eq!(status(&served.open_live(&[other])), 403, "{other}");
    }
}

#[test]
fn a_token_is_exchanged_for_a_cookie_that_scripts_do_not_see() {
    let text = format!(
        "[[operator]]\nname = \"kim\"\ntoken = \"{KIM}\"\n[[viewer]]\ntoken = \"{WALL}\"\n"
    );
    let served = Served::start(Some(&text));
    let origin = served.origin();
    assert_eq!(status(&served.ask("GET /session", &[], "").0), 401);
    assert_eq!(status(&served.open_live(&[&origin])), 401);
    // The page itself is no secret.
    assert_eq!(status(&served.ask("GET /", &[], "").0), 200);
    let sign_in = |token: &str, origin: &str| {
        let body = format!("{{\"token\": \"{token}\"}}");
        served.ask("POST /session", &[origin], &body).0
    };
    assert_eq!(status(&sign_in("wrong", &origin)), 401);
    assert_eq!(status(&sign_in(KIM, "Origin: http://evil.example")), 403);
    assert_eq!(status(&served.ask("POST /session", &[&origin], &"x".repeat(5000)).0), 400);
    let head = sign_in(KIM, &origin);
    assert_eq!(status(&head), 200, "{head}");
    let cookie = field(&head, "set-cookie").unwrap();
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    let session = format!("Cookie: {}", cookie.split(';').next().unwrap());
    let (_, body) = served.ask("GET /session", &[&session], "");
    assert!(String::from_utf8(body).unwrap().contains("\"operator\":\"kim\""));
    assert_eq!(status(&served.open_live(&[&origin, &session])), 101);
    assert_eq!(status(&served.ask("DELETE /session", &[&origin, &session], "").0), 200);
    assert_eq!(status(&served.open_live(&[&origin, &session])), 401);
    let head = sign_in(WALL, &origin);
    let session =
        format!("Cookie: {}", field(&head, "set-cookie").unwrap().split(';').next().unwrap());
    let (_, body) = served.ask("GET /session", &[&session], "");
    assert!(String::from_utf8(body).unwrap().contains("\"role\":\"viewer\""));
}

#[test]
fn a_websocket_ends_with_the_session_under_which_it_was_opened() {
    let served = Served::start(Some(&format!("[[viewer]]\ntoken = \"{WALL}\"\n")));
    let origin = served.origin();
    let body = format!("{{\"token\": \"{WALL}\"}}");
    let open = || {
        let (head, _) = served.ask("POST /session", &[&origin], &body);
        let cookie = field(&head, "set-cookie").unwrap().split(';').next().unwrap();
        let session = format!("Cookie: {cookie}");
        let mut stream = TcpStream::connect(&served.address).unwrap();
        let head = format!(
            "GET /live HTTP/1.1\r\nHost: {}\r\n{origin}\r\n{session}\r\nConnection: Upgrade\r\n\
             Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
            served.address
        );
        stream.write_all(head.as_bytes()).unwrap();
        (stream, session)
    };
    let (mut ended, session) = open();
    let (mut other, _) = open();
    assert_eq!(status(&served.ask("DELETE /session", &[&origin, &session], "").0), 200);
    // Without a message of its browser.
    ended.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut rest = Vec::new();
    ended.read_to_end(&mut rest).expect("it is closed");
    assert!(rest.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&rest));
    let reason = b"the session has ended";
    assert!(rest.windows(reason.len()).any(|part| part == reason));
    // That of another session stays open.
    other.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    assert!(other.read_to_end(&mut rest).is_err());
}

#[test]
fn a_message_that_is_too_long_ends_the_browser_and_not_the_console() {
    let served = Served::start(None);
    let mut stream = TcpStream::connect(&served.address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let head = format!(
        "GET /live HTTP/1.1\r\nHost: {0}\r\nOrigin: http://{0}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        served.address
    );
    stream.write_all(head.as_bytes()).unwrap();
    // A text of 16 MB is announced, masked, and never sent.
    let announced: [u8; 14] = [0x81, 0xff, 0, 0, 0, 0, 1, 0, 0, 0, 1, 2, 3, 4];
    stream.write_all(&announced).unwrap();
    // The end comes at once, without waiting for it.
    let mut rest = Vec::new();
    let _ = stream.read_to_end(&mut rest);
    assert_eq!(status(&served.ask("GET /healthz", &[], "").0), 200);
}

#[test]
fn an_image_below_the_map_is_for_those_who_may_see_the_fleet() {
    let png = b"\x89PNG\r\n\x1a\n and more";
    let open = Served::start_with(None, Some(png));
    let (head, body) = open.ask("GET /image", &[], "");
    assert_eq!((status(&head), field(&head, "content-type")), (200, Some("image/png")));
    assert_eq!(body, png);
    let text = format!("[[viewer]]\ntoken = \"{WALL}\"\n");
    let closed = Served::start_with(Some(&text), Some(png));
    assert_eq!(status(&closed.ask("GET /image", &[], "").0), 401);
    assert_eq!(status(&Served::start(None).ask("GET /image", &[], "").0), 404);
}
