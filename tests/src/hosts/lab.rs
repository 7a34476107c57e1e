//! Network namespaces as hosts, and their links as cables that can be pulled, cut or narrowed.

use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use crate::process::Process;

/// Where `ip netns` keeps its names.
const NAMES: &str = "/run/netns";

/// How every namespace of these tests begins, so that leftovers are known as ours.
const PREFIX: &str = "muster-hosts-";

/// How the one link of a host is called there.
pub(super) const LINK: &str = "cable";

/// The rights that hosts take, by the kernel's numbers: `CAP_NET_ADMIN` for links, `CAP_SYS_ADMIN` for
/// namespaces.
const NEEDED_RIGHTS: [u32; 2] = [12, 21];

/// What `tc` prints about a filter that the kernel does not have, by version.
const NO_FILTER: [&str; 3] =
    ["qdisc kind is unknown", "Unknown qdisc", "No such file or directory"];

/// How long the relay of a slow link may take to open its ends.
const RELAY_WITHIN: Duration = Duration::from_secs(10);

/// A host of the lab.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Host {
    /// Where robots run.
    Robots,
    /// Where the services run.
    Base,
    /// Where the router runs, and the robots that no fault touches.
    Router,
}

impl Host {
    /// All hosts.
    pub const ALL: [Self; 3] = [Self::Robots, Self::Base, Self::Router];

    /// Its name, also that of its port on the bridge.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Robots => "robots",
            Self::Base => "base",
            Self::Router => "router",
        }
    }

    /// Its address on the bridge.
    #[must_use]
    pub fn address(self) -> &'static str {
        match self {
            Self::Robots => "10.77.0.2",
            Self::Base => "10.77.0.3",
            Self::Router => "10.77.0.1",
        }
    }
}

/// Three hosts on a bridge. They are gone when the test lets go of them, also when it fails.
#[derive(Debug)]
pub struct Lab {
    name: String,
}

fn run(program: &str, arguments: &[&str]) -> anyhow::Result<String> {
    let output = Command::new(program)
        .args(arguments)
        .output()
        .with_context(|| format!("{program} does not start; install iproute2 and python3"))?;
    ensure!(
        output.status.success(),
        "{program} {}: {}",
        arguments.join(" "),
        String::from_utf8_lossy(&output.stderr).trim()
    );
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// When a process was started, in the kernel's ticks since the machine was: with its id, it names
/// one process for good, though ids are used again.
fn started(process: &str) -> Option<String> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // The name of the program is in brackets and may contain blanks; the 20th field after it counts.
    stat.rsplit_once(") ")?.1.split(' ').nth(19).map(str::to_owned)
}

/// Ends what runs in a namespace, and the namespace.
fn remove(namespace: &str) {
    for process in run("ip", &["netns", "pids", namespace]).unwrap_or_default().split_whitespace() {
        let _ = run("kill", &["-s", "KILL", process]);
    }
    let _ = run("ip", &["netns", "del", namespace]);
}

/// Removes the namespaces of test processes that were killed before they could.
fn remove_leftovers() {
    for entry in std::fs::read_dir(NAMES).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some(maker) = name.strip_prefix(PREFIX) else { continue };
        let mut parts = maker.split('-');
        let (Some(process), Some(start)) = (parts.next(), parts.next()) else { continue };
        if started(process).as_deref() != Some(start) {
            remove(&name);
        }
    }
}

/// Why hosts cannot be tested here; none if they can.
///
/// # Errors
/// If nothing that a machine may lack is missing, and the hosts can still not be made: then this lab is
/// broken, and must not pass for a machine without the means.
pub fn missing() -> anyhow::Result<Option<String>> {
    // Tests run at the same time, and what a machine lacks does not change meanwhile.
    static FOUND: OnceLock<Result<Option<String>, String>> = OnceLock::new();
    let found = FOUND.get_or_init(|| look_for_missing().map_err(|error| format!("{error:#}")));
    found.clone().map_err(anyhow::Error::msg)
}

fn look_for_missing() -> anyhow::Result<Option<String>> {
    let missing = |what: &str| Ok(Some(what.to_owned()));
    if !may_make_networks()? {
        return missing("these are not the rights of root");
    }
    for program in ["ip", "tc"] {
        let started = Command::new(program).arg("-V").output();
        if started.is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound) {
            return missing("iproute2 is not installed");
        }
    }
    if !Path::new("/dev/net/tun").exists() {
        return missing("the kernel has no tap devices");
    }
    let lab = Lab::new()?;
    match lab.limit(Host::Robots, 64) {
        Err(error) if NO_FILTER.iter().any(|text| error.to_string().contains(text)) => {
            missing("the kernel has no token bucket filter")
        }
        Err(error) => Err(error),
        Ok(()) => lab.widen(Host::Robots).map(|()| None),
    }
}

/// Whether this process may make namespaces and links. Root in a container often may not.
fn may_make_networks() -> anyhow::Result<bool> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let rights = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let rights = rights.context("the kernel does not report the rights of a process")?;
    let rights = u64::from_str_radix(rights.trim(), 16)?;
    Ok(NEEDED_RIGHTS.iter().all(|right| rights >> right & 1 == 1))
}

impl Lab {
    /// Makes the hosts and joins them.
    ///
    /// # Errors
    /// Without the right to, the command `ip`, or a kernel with namespaces, veth and bridges.
    pub fn new() -> anyhow::Result<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        remove_leftovers();
        let process = std::process::id();
        let start = started(&process.to_string()).context("no process is found in /proc")?;
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let lab = Self { name: format!("{PREFIX}{process}-{start}-{number}") };
        let bridge = lab.bridge();
        run("ip", &["netns", "add", &bridge])?;
        run("ip", &["-n", &bridge, "link", "add", "bridge", "type", "bridge", "stp_state", "0"])?;
        run("ip", &["-n", &bridge, "link", "set", "bridge", "up"])?;
        for host in Host::ALL {
            let (name, port) = (lab.namespace(host), host.name());
            run("ip", &["netns", "add", &name])?;
            let ends = ["link", "add", LINK, "netns", &name, "type", "veth", "peer", "name", port];
            run("ip", &[&["-n", &bridge], &ends[..], &["netns", &bridge]].concat())?;
            lab.bring_up(host)?;
        }
        Ok(lab)
    }

    fn bridge(&self) -> String {
        format!("{}-bridge", self.name)
    }

    /// The namespace of a host.
    #[must_use]
    pub fn namespace(&self, host: Host) -> String {
        format!("{}-{}", self.name, host.name())
    }

    fn bring_up(&self, host: Host) -> anyhow::Result<()> {
        let name = self.namespace(host);
        let address = format!("{}/24", host.address());
        run("ip", &["-n", &name, "address", "add", &address, "dev", LINK])?;
        run("ip", &["-n", &name, "link", "set", "lo", "up"])?;
        run("ip", &["-n", &name, "link", "set", LINK, "up"])?;
        run("ip", &["-n", &self.bridge(), "link", "set", host.name(), "master", "bridge", "up"])?;
        Ok(())
    }

    /// A command that runs a program on a host. The program takes the place of the command, so that
    /// its process is the one that is started.
    #[must_use]
    pub fn command(&self, host: Host, program: &Path) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespace(host)]).arg(program);
        command
    }

    fn port(&self, host: Host, change: &[&str]) -> anyhow::Result<()> {
        let bridge = self.bridge();
        run("ip", &[&["-n", &bridge, "link", "set", host.name()], change].concat()).map(drop)
    }

    /// Pulls the cable of a host: its link has no carrier.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn pull(&self, host: Host) -> anyhow::Result<()> {
        self.port(host, &["down"])
    }

    /// Plugs the cable in again.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn plug(&self, host: Host) -> anyhow::Result<()> {
        self.port(host, &["up"])
    }

    /// Loses every packet from and to a host in silence: its link stays up, nothing is answered, and
    /// nothing is refused.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn lose(&self, host: Host) -> anyhow::Result<()> {
        self.port(host, &["nomaster"])
    }

    /// Loses no packet any more.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn find(&self, host: Host) -> anyhow::Result<()> {
        self.port(host, &["master", "bridge"])
    }

    /// Limits the rate of a link in kbit/s, in both directions, with at most a second's worth waiting.
    ///
    /// # Errors
    /// If the kernel refuses, as one does that was built without the token bucket filter.
    pub fn limit(&self, host: Host, kbit_per_s: u32) -> anyhow::Result<()> {
        // The bucket holds one whole frame; a smaller one would never let it pass.
        self.filter(host, &format!("{kbit_per_s}kbit"), "1600")
    }

    /// Widens a limited link to a rate that nothing here reaches, so that its queue drains.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn widen(&self, host: Host) -> anyhow::Result<()> {
        self.filter(host, "1gbit", "1mb")
    }

    fn filter(&self, host: Host, rate: &str, burst: &str) -> anyhow::Result<()> {
        for (namespace, device) in self.ends(host) {
            let root = ["-n", &namespace, "qdisc", "replace", "dev", device, "root"];
            let filter = ["tbf", "rate", rate, "burst", burst, "latency", "1s"];
            run("tc", &[&root[..], &filter[..]].concat())?;
        }
        Ok(())
    }

    fn ends(&self, host: Host) -> [(String, &'static str); 2] {
        [(self.namespace(host), LINK), (self.bridge(), host.name())]
    }

    /// Replaces the cable of a host by a relay that passes frames at once. The signal `USR1` makes it
    /// delay and lose them, and `USR2` ends that. (Not every kernel can delay.)
    ///
    /// # Errors
    /// If there is no Python, or the kernel has no tap devices.
    pub fn relay(&self, host: Host, folder: &Path) -> anyhow::Result<Process> {
        let (bridge, name) = (self.bridge(), self.namespace(host));
        run("ip", &["-n", &bridge, "link", "del", host.name()])?;
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &bridge, "python3", "-u"]).args([
            concat!(env!("CARGO_MANIFEST_DIR"), "/hosts/slow_link.py"),
            LINK,
            host.name(),
        ]);
        let mut relay = Process::start_command("slow_link", command, folder)?;
        let start = Instant::now();
        while !relay.output().contains("ready") {
            ensure!(
                relay.is_running()? && start.elapsed() < RELAY_WITHIN,
                "the relay does not start:\n{}",
                relay.output()
            );
            std::thread::sleep(Duration::from_millis(20));
        }
        run("ip", &["-n", &bridge, "link", "set", LINK, "netns", &name])?;
        self.bring_up(host)?;
        Ok(relay)
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        for host in Host::ALL {
            remove(&self.namespace(host));
        }
        remove(&self.bridge());
    }
}
