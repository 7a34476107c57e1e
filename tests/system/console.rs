//! The console in a real browser, over a real router, with real services and simulated robots.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use muster_tests::access::{OPERATOR, Security, VIEWER};
use muster_tests::cluster::{Cluster, ClusterOptions, robots_of};
use muster_tests::ports::{free_address, free_endpoint};
use muster_tests::process::{Process, run};
use serde_json::{Value, json};

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];

/// An image of one green pixel.
const GREEN_PNG: &[u8] = &[
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52,
    0x00, 0x00, 0x00, 0x01, 0x00, 0x00, 0x00, 0x01, 0x08, 0x02, 0x00, 0x00, 0x00, 0x90, 0x77, 0x53,
    0xde, 0x00, 0x00, 0x00, 0x0c, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x60, 0xf8, 0xcf, 0x00,
    0x00, 0x02, 0x02, 0x01, 0x00, 0x45, 0xf4, 0x52, 0xd4, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e,
    0x44, 0xae, 0x42, 0x60, 0x82,
];

/// How long a console may take to serve.
const SERVES_WITHIN: Duration = Duration::from_secs(20);

/// Where the packages of `services/console/tests/package.json` are.
fn packages() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/web/node_modules")
}

/// The browser and the packages; `tests/run` installs them.
fn chromium() -> PathBuf {
    let browser = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let browser = browser.iter().map(PathBuf::from).find(|path| path.exists());
    let remedy = "tests/run installs it, or `apt-get install chromium nodejs npm` and \
                  `npm install --prefix target/web` of services/console/tests/package.json";
    assert!(packages().join("playwright-core").exists(), "playwright-core is missing: {remedy}");
    browser.unwrap_or_else(|| panic!("there is no Chromium: {remedy}"))
}

fn start_console(cluster: &Cluster, address: &str, further: &[&str]) -> Process {
    let flags = ["--fleet", &cluster.fleet, "--connect", &cluster.endpoint, "--serve", address];
    let arguments = [&flags, further].concat();
    let mut console = Process::start("muster-console", &arguments, &[], cluster.folder()).unwrap();
    console.until_prints("serves the console at", SERVES_WITHIN).unwrap();
    console
}

#[test]
fn console_types_hold() {
    let compiler = packages().join(".bin/tsc");
    assert!(compiler.exists(), "typescript is missing; tests/run installs it");
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).join("../services/console");
    let output = Command::new(compiler).arg("--project").arg(project).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

/// Runs a test of the page in a browser; what it asks for is done by `act`.
fn run_in_browser(
    script: &str,
    addresses: [&str; 2],
    mut act: impl FnMut(&[&str]) -> Option<Value>,
) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../services/console/tests");
    let mut node = Command::new("node")
        .arg(folder.join(script))
        .arg(chromium())
        .args(addresses)
        .args(std::env::var("MUSTER_PICTURES"))
        .env("MUSTER_WEB_PACKAGES", packages())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut answers = node.stdin.take().unwrap();
    let mut held = false;
    for line in BufReader::new(node.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        println!("{line}");
        held |= line == "everything holds";
        let Some(what) = line.strip_prefix("do ") else { continue };
        let what: Vec<String> = serde_json::from_str(what).unwrap();
        let what: Vec<&str> = what.iter().map(String::as_str).collect();
        let answer = act(&what).unwrap_or_else(|| panic!("nobody knows how to {what:?}"));
        writeln!(answers, "{answer}").unwrap();
    }
    let status = node.wait().unwrap();
    assert!(status.success() && held, "{status}");
}

/// What `muster` prints about a fleet.
fn muster(cluster: &Cluster, arguments: &[&str]) -> Value {
    let (code, out, err) = cluster.muster(arguments).unwrap();
    json!({"code": code, "out": out, "err": err})
}

/// A fleet of one robot with the longest name.
fn long_name(cluster: &Cluster) -> PathBuf {
    let name = format!("scout-{}", "x".repeat(58));
    let fleet = json!({"name": "long", "robots": [{"id": name, "role": "scout", "superior": null, "at": [0.0, 0.0]}],
                       "divisions": [[[name]]]});
    let path = cluster.folder().join("long.json");
    std::fs::write(&path, fleet.to_string()).unwrap();
    path
}

#[test]
fn console_shows_and_commands_a_fleet_in_a_browser() {
    let mut cluster = Cluster::start_by(&ClusterOptions {
        settings: &[("clusterer", "teams=3"), ("ingest", "gone_after_s=6")],
        ..ClusterOptions::default()
    })
    .unwrap();
    cluster.start_service("historian").unwrap();
    cluster.start_service("planner").unwrap();
    // The last robot is a process of its own, which is killed. Five are medics.
    let names: Vec<String> = robots_of(&SCENARIO).unwrap().into_keys().collect();
    let (last, others) = names.split_last().unwrap();
    let mut lonely = cluster.robots(&[&SCENARIO[..], &["--only", last]].concat()).unwrap();
    let (medics, others) = others.split_at(5);
    let (medics, others) = (medics.join(","), others.join(","));
    let medics = [&SCENARIO[..], &["--only", &medics, "--skills", "medic"]].concat();
    let _medics = cluster.robots(&medics).unwrap();
    let _others = cluster.robots(&[&SCENARIO[..], &["--only", &others]].concat()).unwrap();
    let file = long_name(&cluster);
    let _long = cluster.robots(&["--file", file.to_str().unwrap()]).unwrap();

    let (address, viewer_address) = (free_address().unwrap(), free_address().unwrap());
    let mut console = Some(start_console(&cluster, &address, &["--operator", "kim"]));
    let access = cluster.folder().join("access.toml");
    std::fs::write(&access, "[[viewer]]\ntoken = \"wall-wall-wall-wall-wall-wall\"\n").unwrap();
    let ground = cluster.folder().join("ground.png");
    std::fs::write(&ground, GREEN_PNG).unwrap();
    let access = ["--access", access.to_str().unwrap(), "--image", ground.to_str().unwrap()];
    let access = [&access[..], &["--image-at", "-1000,-1000,1000,1000"]].concat();
    let _viewers = start_console(&cluster, &viewer_address, &access);

    run_in_browser("browser.mjs", [&address, &viewer_address], |what| {
        let done = |()| Some(Value::Null);
        match *what {
            ["muster", ref arguments @ ..] => Some(muster(&cluster, arguments)),
            ["kill-robot"] => lonely.kill().ok().and_then(done),
            ["kill", service] => cluster.service(service).unwrap().kill().ok().and_then(done),
            ["start", service] => cluster.start_service(service).ok().and_then(done),
            ["stop", service] => {
                cluster.service(service).unwrap().signal("STOP").ok().and_then(done)
            }
            ["continue", service] => {
                cluster.service(service).unwrap().signal("CONT").ok().and_then(done)
            }
            ["kill-console"] => console.take().unwrap().kill().ok().and_then(done),
            ["start-console"] => {
                console = Some(start_console(&cluster, &address, &["--operator", "kim"]));
                done(())
            }
            _ => None,
        }
    });
}

#[test]
fn console_with_the_certificate_of_a_viewer_commands_nothing_whatever_its_code_says() {
    let names: Vec<String> = robots_of(&SCENARIO).unwrap().into_keys().collect();
    let cluster = Cluster::start_by(&ClusterOptions {
        security: Security::Secured,
        settings: &[("clusterer", "teams=3")],
        robots: &names,
        ..ClusterOptions::default()
    })
    .unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    // The console takes itself for that of an operator, and its page does; its certificate is that of a viewer.
    let (by_viewer, by_operator) = (free_address().unwrap(), free_address().unwrap());
    let identity = |name: &str| cluster.identity(name).unwrap().to_str().unwrap().to_owned();
    let start = |address: &str, name: &str| {
        let identity = identity(name);
        let flags = [
            "--fleet",
            &cluster.fleet,
            "--zenoh-config",
            &identity,
            "--serve",
            address,
            "--operator",
            "operator",
        ];
        let mut console = Process::start("muster-console", &flags, &[], cluster.folder()).unwrap();
        console.until_prints("serves the console at", SERVES_WITHIN).unwrap();
        console
    };
    let _viewer = start(&by_viewer, VIEWER);
    let _operator = start(&by_operator, OPERATOR);
    run_in_browser("certificate.mjs", [&by_viewer, &by_operator], |what| match *what {
        ["muster", ref arguments @ ..] => Some(muster(&cluster, arguments)),
        _ => None,
    });
}

#[test]
fn console_refuses_what_is_unsafe_at_the_start() {
    let (code, _, err) =
        run("muster-console", &["--serve", "0.0.0.0:0"], Duration::from_secs(20)).unwrap();
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("serve: ") && err.contains("--access"), "{err}");
    let print = ["--print-config", "--fleet", "alpha"];
    let (code, out, err) = run("muster-console", &print, Duration::from_secs(20)).unwrap();
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("fleet = \"alpha\"") && out.contains("# serves 127.0.0.1:7480"), "{out}");
}

/// The status and the body of what an address answers.
fn get(address: &str, path: &str) -> String {
    use std::io::Read as _;
    let mut stream = std::net::TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(SERVES_WITHIN)).unwrap();
    let text = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(text.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn console_comes_along_with_up_and_demo() {
    let folder = tempfile::tempdir().unwrap();
    let (endpoint, address) = (free_endpoint().unwrap(), free_address().unwrap());
    let up = [
        "up",
        "--router",
        "--listen",
        &endpoint,
        "--state-directory",
        "none",
        "--console",
        &address,
    ];
    let mut up = Process::start("muster", &up, &[], folder.path()).unwrap();
    up.until_prints(&format!("console at http://{address}"), SERVES_WITHIN).unwrap();
    assert!(get(&address, "/").starts_with("HTTP/1.1 200"), "the page is there");
    assert!(get(&address, "/session").contains("\"operator\""), "whoever is on this host commands");
    // Where services are named, it comes along only if it is asked for; and never to other hosts.
    let far = ["up", "--connect", &endpoint, "--console", "0.0.0.0:0"];
    let (code, _, err) = run("muster", &far, SERVES_WITHIN).unwrap();
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("console: ") && err.contains("--access"), "{err}");
    let taken = ["up", "--connect", &endpoint, "--console", &address];
    let (code, _, err) = run("muster", &taken, SERVES_WITHIN).unwrap();
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("cannot listen at"), "{err}");
    up.kill().unwrap();

    // A browser that only writes down what it was asked to open.
    let (programs, opened) = (folder.path().join("programs"), folder.path().join("opened"));
    std::fs::create_dir(&programs).unwrap();
    let browser = programs.join("xdg-open");
    std::fs::write(&browser, format!("#!/bin/sh\necho \"$1\" > {}\n", opened.display())).unwrap();
    std::fs::set_permissions(&browser, PermissionsExt::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let demo = ["demo", "--listen", &free_endpoint().unwrap(), "--open"];
    let mut demo = Process::start("muster", &demo, &[("PATH", &path)], folder.path()).unwrap();
    demo.until_prints("Ctrl-C ends it\nin a browser: http://127.0.0.1:", SERVES_WITHIN).unwrap();
    demo.until_prints("from another terminal", SERVES_WITHIN).unwrap();
    let printed = demo.output();
    let url = printed.lines().find_map(|line| line.strip_prefix("in a browser: ")).unwrap();
    let start = std::time::Instant::now();
    while std::fs::read_to_string(&opened).unwrap_or_default().trim() != url {
        assert!(start.elapsed() < SERVES_WITHIN, "{url} is not opened");
        std::thread::sleep(Duration::from_millis(50));
    }
    let address = url.strip_prefix("http://").unwrap();
    assert!(get(address, "/").starts_with("HTTP/1.1 200"), "the page is there");
}
