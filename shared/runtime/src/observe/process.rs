//! What Prometheus expects of every process: processor time, memory, descriptors, threads and its start.

use std::fmt;
use std::time::{SystemTime, UNIX_EPOCH};

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric};
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::registry::Unit;

/// Reads what the system reports of this process, each time that it is asked for.
#[derive(Debug)]
pub(super) struct ProcessCollector {
    /// Seconds since 1970.
    started_s: f64,
}

/// What the system reports. What it does not report is no metric.
#[derive(Debug, Default)]
struct Usage {
    cpu_s: Option<f64>,
    resident_bytes: Option<u64>,
    threads: Option<i64>,
    open_fds: Option<u64>,
    /// None as well where there is no limit.
    max_fds: Option<u64>,
}

impl ProcessCollector {
    /// For a process that starts now.
    pub(super) fn new() -> Self {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { started_s: now.as_secs_f64() }
    }
}

impl Collector for ProcessCollector {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let Usage { cpu_s, resident_bytes, threads, open_fds, max_fds } = Usage::now();
        let started = ConstGauge::new(self.started_s);
        let (bytes, seconds) = (Some(&Unit::Bytes), Some(&Unit::Seconds));
        let mut show = |name, unit, help, metric: Option<&dyn EncodeMetric>| match metric {
            Some(metric) => {
                metric.encode(encoder.encode_descriptor(name, help, unit, metric.metric_type())?)
            }
            None => Ok(()),
        };
        show("start_time", seconds, "When the process started, since 1970", Some(&started))?;
        let cpu = cpu_s.map(ConstCounter::new);
        show("cpu", seconds, "Processor time of the process so far", shown(&cpu))?;
        let resident = resident_bytes.map(ConstGauge::new);
        show("resident_memory", bytes, "Resident memory of the process", shown(&resident))?;
        let threads = threads.map(ConstGauge::new);
        show("threads", None, "Threads of the process", shown(&threads))?;
        let open = open_fds.map(ConstGauge::new);
        show("open_fds", None, "Open file descriptors of the process", shown(&open))?;
        let most = max_fds.map(ConstGauge::new);
        show("max_fds", None, "Most file descriptors that the process may open", shown(&most))
    }
}

fn shown<M: EncodeMetric>(metric: &Option<M>) -> Option<&dyn EncodeMetric> {
    metric.as_ref().map(|metric| metric as &dyn EncodeMetric)
}

impl Usage {
    #[cfg(target_os = "linux")]
    fn now() -> Self {
        use procfs::WithCurrentSystemInfo;
        use procfs::process::{LimitValue, Process};

        let Ok(process) = Process::myself() else { return Self::default() };
        let stat = process.stat().ok();
        let ticks = stat.as_ref().map(|stat| stat.utime.saturating_add(stat.stime));
        let soft = process.limits().ok().map(|limits| limits.max_open_files.soft_limit);
        Self {
            cpu_s: ticks.map(|ticks| ticks as f64 / procfs::ticks_per_second() as f64),
            resident_bytes: stat.as_ref().map(|stat| stat.rss_bytes().get()),
            threads: stat.as_ref().map(|stat| stat.num_threads),
            open_fds: process.fd_count().ok().map(|count| count as u64),
            max_fds: match soft {
                Some(LimitValue::Value(most)) => Some(most),
                Some(LimitValue::Unlimited) | None => None,
            },
        }
    }

    #[cfg(not(target_os = "linux"))]
    fn now() -> Self {
        Self::default()
    }
}
