//! The watchdog of a service manager is fed by the loops themselves: one that hangs starves it, also
//! while another loop of the same process, and all its threads, are well.
//!
//! Where to send notes is read from the environment of a process, so that each case is a process of its own:
//! this program, which then runs the test called `a_process_with_two_loops`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::{config, connected, options, passive_core, router};
use muster_model::id::{InstanceId, ServiceName};
use muster_model::settings::{ClustererSettings, TeamCount};
use muster_model::time::Tick;
use muster_runtime::bus::{Bus, ConnectTimeout};
use muster_runtime::shell::{self, ServiceOptions};
use muster_runtime::stop;
use muster_service::{Context, Core, Get, Stopwatch, View, Wiring};
use muster_wire::{Key, Message, Pattern};

/// How soon the manager wants the next note that the loops run.
const WATCHDOG: Duration = Duration::from_secs(1);

/// When one of the loops hangs.
const HANGS_AFTER: Duration = Duration::from_secs(3);

/// How long it hangs: longer than the test looks.
const HANGS_FOR: Duration = Duration::from_secs(60);

/// How long the test waits for anything.
const SOON: Duration = Duration::from_secs(30);

/// The variable that makes the second loop of a process hang.
const HANG: &str = "MUSTER_TEST_HANG";

/// A core that hangs at its deadline, or does nothing at all.
struct Probe {
    hangs_at: Option<Tick>,
}

impl Core for Probe {
    passive_core!();

    type Settings = ClustererSettings;
    type Job = ();
    type Done = ();
    const SERVICE: ServiceName = ServiceName::Clusterer;

    fn wiring() -> Wiring {
        Wiring::default()
    }

    fn output() -> Key {
        Key::Teams
    }

    fn new(now: Tick, settings: &ClustererSettings) -> Self {
        Self { hangs_at: (settings.teams == TeamCount::Fixed(7)).then(|| now.after(HANGS_AFTER)) }
    }

    fn on_lead(&mut self, _: &mut Context<'_, Self>, _: Vec<Message>) {}

    fn on_message(&mut self, _: &mut Context<'_, Self>, _: Message) {}

    fn on_timer(&mut self, context: &mut Context<'_, Self>) {
        if self.hangs_at.is_some_and(|at| at <= context.now()) {
            std::thread::sleep(HANGS_FOR);
        }
    }

    fn deadline(&self, _: &View<'_, Self>) -> Option<Tick> {
        self.hangs_at
    }

    fn run((): (), _: &mut Stopwatch) {}
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "the process that the other tests look at"]
async fn a_process_with_two_loops() {
    let (_router, endpoint) = router().await;
    let (_stopper, stop) = stop::channel();
    let hangs = std::env::var_os(HANG).is_some();
    let mut loops = tokio::task::JoinSet::new();
    for (number, teams) in [(1, 2), (2, if hangs { 7 } else { 2 })] {
        let bus = config(connected(&endpoint));
        let bus = Bus::open(&bus, ConnectTimeout::Never).await.unwrap();
        let teams = TeamCount::Fixed(teams);
        let settings = ClustererSettings { teams, ..ClustererSettings::default() };
        let instance = InstanceId::of_process("test", number, number);
        let options = ServiceOptions { instance, ..options::<Probe>(settings) };
        loops.spawn(shell::run::<Probe>(bus, options, stop.clone()));
    }
    while loops.join_next().await.is_some() {}
}

/// A process, which ends with the test.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

struct Looked {
    _process: Ended,
    socket: UnixDatagram,
    _folder: tempfile::TempDir,
}

impl Looked {
    fn start(hang: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify.socket");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_nonblocking(true).unwrap();
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args(["--ignored", "--exact", "a_process_with_two_loops"])
            .env("NOTIFY_SOCKET", &path)
            .env("WATCHDOG_USEC", WATCHDOG.as_micros().to_string())
            .stdout(Stdio::null());
        if hang {
            command.env(HANG, "yes");
        }
        let process = Ended(command.spawn().unwrap());
        Self { _process: process, socket, _folder: folder }
    }

    /// How often the watchdog is fed in some time, at most so often.
    fn fed(&self, time: Duration, enough: usize) -> usize {
        let until = Instant::now() + time;
        let (mut fed, mut note) = (0, [0; 1024]);
        while Instant::now() < until && fed < enough {
            match self.socket.recv(&mut note) {
                Ok(length) => {
                    fed += usize::from(note[..length].starts_with(b"WATCHDOG=1"));
                }
                Err(_) => std::thread::sleep(Duration::from_millis(10)),
            }
        }
        fed
    }
}

#[test]
fn loops_that_run_feed_the_watchdog() {
    let looked = Looked::start(false);
    assert_eq!(looked.fed(SOON, 20), 20);
}

#[test]
fn one_loop_that_hangs_starves_the_watchdog() {
    let looked = Looked::start(true);
    assert_eq!(looked.fed(SOON, 4), 4, "it is fed before");
    std::thread::sleep(HANGS_AFTER + WATCHDOG);
    looked.fed(Duration::from_millis(200), usize::MAX);
    assert_eq!(looked.fed(3 * WATCHDOG, usize::MAX), 0, "it is fed while a loop hangs");
}
