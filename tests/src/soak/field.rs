//! The fleet: processes, links and a disk, and how each of them breaks and is mended.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use tokio::task::JoinHandle;

use super::disk::{Disk, folder_prefix};
use super::flood::flood;
use super::plan::{Host, Kind, Plan, second};
use crate::access::{OPERATOR, STRANGER};
use crate::client::Client;
use crate::cluster::{Cluster, ClusterOptions, Robots, SERVICES, robots_of};
use crate::relay::Relay;

/// The fleet of every soak.
pub(super) const FLEET: &str = "soak";

/// How long a process may take to end after SIGTERM.
const ENDS_WITHIN: Duration = Duration::from_secs(10);

/// A client that connects whenever the router answers.
const FOR_EVER: &str = "-1";

/// A fleet that runs. Its parts end in this order.
#[derive(Debug)]
pub(super) struct Field {
    flood: Option<JoinHandle<anyhow::Result<()>>>,
    on_hosts: BTreeMap<&'static str, Robots>,
    disk: Disk,
    cluster: Cluster,
    scenario: Vec<String>,
    base: Relay,
    group: Relay,
    mixed: Relay,
    names: BTreeMap<&'static str, Vec<String>>,
    instances: Vec<String>,
    /// The robots, each with its group.
    pub(super) truth: BTreeMap<String, String>,
}

fn host_name(host: Host) -> &'static str {
    match host {
        Host::Group => "group",
        Host::Mixed => "mixed",
    }
}

/// The robots that no fault of links touches.
const ELSEWHERE: &str = "elsewhere";

fn service_of(instance: &str) -> &str {
    instance.split('-').next().unwrap_or(instance)
}

impl Field {
    /// Starts everything.
    ///
    /// # Errors
    /// If a program is not built or does not start.
    pub(super) async fn start(plan: &Plan) -> anyhow::Result<Self> {
        let (robots, groups) = (plan.robots.to_string(), plan.groups.to_string());
        let scenario = ["--scenario", "clusters", "--robots", &robots, "--teams", &groups];
        let truth = robots_of(&scenario)?;
        let all: Vec<String> = truth.keys().cloned().collect();
        let teams = format!("teams={groups}");
        let settings = [("clusterer", teams.as_str())];
        let mut cluster = Cluster::start_without_services(&ClusterOptions {
            fleet: FLEET,
            security: plan.security,
            settings: if plan.sets_teams { &settings } else { &[] },
            robots: &all,
            folder_prefix: &folder_prefix(),
            ..ClusterOptions::default()
        })?;
        let disk = Disk::mount(&cluster.folder().join("state"))?;
        let base = Relay::to(&cluster.endpoint).await?;
        let (group, mixed) =
            (Relay::to(&cluster.endpoint).await?, Relay::to(&cluster.endpoint).await?);
        cluster.services_connect = Some(base.endpoint.clone());
        let mut instances: Vec<String> = SERVICES.map(str::to_owned).to_vec();
        if plan.has_standbys {
            instances.extend(SERVICES.map(second));
        }
        let mut field = Self {
            flood: None,
            on_hosts: BTreeMap::new(),
            disk,
            cluster,
            scenario: scenario.map(str::to_owned).to_vec(),
            base,
            group,
            mixed,
            names: on_hosts(&truth),
            instances,
            truth,
        };
        for instance in field.instances.clone() {
            field.start_instance(&instance)?;
        }
        for host in [host_name(Host::Group), host_name(Host::Mixed), ELSEWHERE] {
            field.start_robots(host)?;
        }
        Ok(field)
    }

    /// Whether its disk can be full.
    pub(super) fn disk_can_be_full(&self) -> bool {
        self.disk.can_be_full()
    }

    /// The folder of logs.
    pub(super) fn folder(&self) -> &Path {
        self.cluster.folder()
    }

    /// An operator's console next to the router.
    ///
    /// # Errors
    /// If the configuration is refused.
    pub(super) async fn console(&self) -> anyhow::Result<Client> {
        self.cluster.member(OPERATOR, &self.cluster.endpoint, FOR_EVER).await
    }

    /// An operator's console behind the link of a group of robots.
    ///
    /// # Errors
    /// If the configuration is refused.
    pub(super) async fn on_board(&self) -> anyhow::Result<Client> {
        self.cluster.member(OPERATOR, &self.group.endpoint, FOR_EVER).await
    }

    fn start_instance(&mut self, instance: &str) -> anyhow::Result<()> {
        let service = service_of(instance).to_owned();
        self.cluster.start_instance(&service, instance)
    }

    fn start_robots(&mut self, host: &'static str) -> anyhow::Result<()> {
        let only = self.names.get(host).context("a host without robots")?.join(",");
        let endpoint = match host {
            "group" => &self.group.endpoint,
            "mixed" => &self.mixed.endpoint,
            _ => &self.cluster.endpoint,
        };
        let scenario: Vec<&str> = self.scenario.iter().map(String::as_str).collect();
        let robots =
            self.cluster.robots_at(endpoint, &[&scenario[..], &["--only", &only]].concat())?;
        self.on_hosts.insert(host, robots);
        Ok(())
    }

    fn kill_robots(&mut self, host: &str) -> anyhow::Result<()> {
        self.on_hosts.get_mut(host).map_or(Ok(()), Robots::kill)
    }

    /// The processes of router and services that run, by name.
    pub(super) fn processes(&mut self) -> Vec<(String, u32)> {
        let mut all = vec![("router".to_owned(), self.cluster.router_id())];
        for instance in self.instances.clone() {
            if let Ok(process) = self.cluster.service(&instance) {
                all.push((instance, process.id()));
            }
        }
        all
    }

    /// Starts what has ended by itself, and returns its names.
    ///
    /// # Errors
    /// If it does not start.
    pub(super) fn revive(&mut self) -> anyhow::Result<Vec<String>> {
        let mut dead = Vec::new();
        for instance in self.instances.clone() {
            if !self.cluster.service(&instance)?.is_running()? {
                self.start_instance(&instance)?;
                dead.push(instance);
            }
        }
        if !self.cluster.router().is_running()? {
            self.cluster.restart_router()?;
            dead.push("router".to_owned());
        }
        Ok(dead)
    }

    /// Ends an instance; returns its name if it did not end by SIGTERM. One that has ended already is left.
    fn end_instance(&mut self, instance: &str, is_polite: bool) -> anyhow::Result<Option<String>> {
        let process = self.cluster.service(instance)?;
        if is_polite && process.is_running()? {
            // A process that another fault has stopped must run to end.
            process.signal("TERM")?;
            process.signal("CONT")?;
            if process.wait(ENDS_WITHIN).is_err() {
                process.kill()?;
                return Ok(Some(instance.to_owned()));
            }
        }
        process.kill()?;
        Ok(None)
    }

    fn end_router(&mut self, is_polite: bool) -> anyhow::Result<Option<String>> {
        let router = self.cluster.router();
        if is_polite && router.is_running()? {
            router.signal("TERM")?;
            router.signal("CONT")?;
            if router.wait(ENDS_WITHIN).is_err() {
                router.kill()?;
                return Ok(Some("router".to_owned()));
            }
        }
        router.kill()?;
        Ok(None)
    }

    fn start_missing(&mut self, instances: &[String]) -> anyhow::Result<()> {
        for instance in instances {
            if !self.cluster.service(instance)?.is_running()? {
                self.start_instance(instance)?;
            }
        }
        Ok(())
    }

    fn signal(&mut self, instances: &[String], signal: &str) -> anyhow::Result<()> {
        for instance in instances {
            let process = self.cluster.service(instance)?;
            if process.is_running()? {
                process.signal(signal)?;
            }
        }
        Ok(())
    }

    fn link(&self, host: Host) -> &Relay {
        match host {
            Host::Group => &self.group,
            Host::Mixed => &self.mixed,
        }
    }

    /// Begins a fault; returns the processes that did not end by SIGTERM in time. A flood is placed at a robot.
    ///
    /// # Errors
    /// If a signal cannot be sent.
    pub(super) async fn begin(
        &mut self,
        kind: &Kind,
        seed: u64,
        robot: &str,
        place: [f64; 3],
    ) -> anyhow::Result<Vec<String>> {
        let mut unwilling = Vec::new();
        match kind {
            Kind::Killed { instances, is_polite } => {
                for instance in instances {
                    unwilling.extend(self.end_instance(instance, *is_polite)?);
                }
            }
            Kind::Stopped { instances } => self.signal(instances, "STOP")?,
            Kind::RouterKilled { is_polite } => unwilling.extend(self.end_router(*is_polite)?),
            Kind::RouterStopped => {
                let router = self.cluster.router();
                if router.is_running()? {
                    router.signal("STOP")?;
                }
            }
            Kind::RobotsCut { host, link } => self.link(*host).set(*link),
            Kind::BaseCut { link } => self.base.set(*link),
            Kind::RobotsKilled { host } => self.kill_robots(host_name(*host))?,
            Kind::Everything { is_polite, with_robots } => {
                for instance in self.instances.clone() {
                    unwilling.extend(self.end_instance(&instance, *is_polite)?);
                }
                unwilling.extend(self.end_router(*is_polite)?);
                if *with_robots {
                    self.on_hosts.values_mut().try_for_each(Robots::kill)?;
                }
            }
            Kind::DiskFull { killed } => {
                self.disk.fill()?;
                unwilling.extend(self.end_instance(killed, false)?);
                self.start_instance(killed)?;
            }
            Kind::Garbage | Kind::Tokens { .. } | Kind::Poses { .. } => {
                // Floods do not add up: the one that began last goes on.
                self.end_flood();
                let stranger = format!("robot.{STRANGER}");
                let endpoint = &self.cluster.endpoint;
                let config = self.cluster.member_config(&stranger, endpoint, FOR_EVER)?;
                let (kind, robot) = (kind.clone(), robot.to_owned());
                // A router that another fault has stopped keeps the stranger waiting, and nobody else.
                let flood = async move {
                    let client = Client::open(config, FLEET).await?;
                    flood(client, kind, seed, robot, place).await
                };
                self.flood = Some(tokio::spawn(flood));
            }
        }
        Ok(unwilling)
    }

    /// Ends a fault.
    ///
    /// # Errors
    /// If a program does not start.
    pub(super) fn end(&mut self, kind: &Kind) -> anyhow::Result<()> {
        match kind {
            Kind::Killed { instances, .. } => self.start_missing(instances)?,
            Kind::Stopped { instances } => self.signal(instances, "CONT")?,
            Kind::RouterKilled { .. } => self.start_router()?,
            Kind::RouterStopped => {
                let router = self.cluster.router();
                if router.is_running()? {
                    router.signal("CONT")?;
                }
            }
            Kind::RobotsCut { host, .. } => self.link(*host).restore(),
            Kind::BaseCut { .. } => self.base.restore(),
            Kind::RobotsKilled { host } => self.start_robots(host_name(*host))?,
            Kind::Everything { with_robots, .. } => {
                self.start_router()?;
                self.start_missing(&self.instances.clone())?;
                if *with_robots {
                    for host in [host_name(Host::Group), host_name(Host::Mixed), ELSEWHERE] {
                        self.start_robots(host)?;
                    }
                }
            }
            Kind::DiskFull { .. } => self.disk.empty()?,
            Kind::Garbage | Kind::Tokens { .. } | Kind::Poses { .. } => self.end_flood(),
        }
        Ok(())
    }

    fn start_router(&mut self) -> anyhow::Result<()> {
        if self.cluster.router().is_running()? { Ok(()) } else { self.cluster.restart_router() }
    }

    fn end_flood(&mut self) {
        if let Some(flood) = self.flood.take() {
            flood.abort();
        }
    }

    /// The logs of processes that panicked, by the lines that say so.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub(super) fn panics(&self) -> anyhow::Result<BTreeSet<String>> {
        let mut panics = BTreeSet::new();
        for entry in std::fs::read_dir(self.folder())? {
            let path = entry?.path();
            if path.extension().is_some_and(|extension| extension == "log") {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                let text = std::fs::read_to_string(&path).unwrap_or_default();
                let lines = text.lines().filter(|line| line.contains("panicked at"));
                panics.extend(lines.map(|line| format!("{name}: {line}")));
            }
        }
        Ok(panics)
    }
}

impl Drop for Field {
    fn drop(&mut self) {
        self.end_flood();
    }
}

/// One whole group behind a link of its own, one robot of each other group behind another, and the others. The one is
/// the last of its group by name, which commands nobody: a fleet that loses the leaders of most of its teams has
/// other relations, and where these choose the number of teams it is divided anew.
fn on_hosts(truth: &BTreeMap<String, String>) -> BTreeMap<&'static str, Vec<String>> {
    let last = truth.values().max();
    let mut seen = BTreeSet::new();
    let mut hosts: BTreeMap<&'static str, Vec<String>> = BTreeMap::new();
    for (robot, group) in truth.iter().rev() {
        let host = if Some(group) == last {
            host_name(Host::Group)
        } else if seen.insert(group) {
            host_name(Host::Mixed)
        } else {
            ELSEWHERE
        };
        hosts.entry(host).or_default().push(robot.clone());
    }
    hosts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_group_is_alone_behind_a_link_and_no_other_is_whole_behind_one() {
        let robots = ["a1 a", "a2 a", "b1 b", "b2 b", "c1 c", "c2 c"];
        let truth = robots.iter().filter_map(|line| line.split_once(' '));
        let truth = truth.map(|(robot, group)| (robot.to_owned(), group.to_owned())).collect();
        let hosts = on_hosts(&truth);
        assert_eq!(hosts["group"], ["c2", "c1"]);
        assert_eq!(hosts["mixed"], ["b2", "a2"]);
        assert_eq!(hosts[ELSEWHERE], ["b1", "a1"]);
    }
}
