//! The counters that services report by names of their own: each name is a metric.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use muster_model::id::ServiceName;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;

use super::metrics::of;

/// The counters of each service as of its last turn.
#[derive(Debug, Clone, Default)]
pub(super) struct Counted(Arc<Mutex<Totals>>);

type Totals = BTreeMap<ServiceName, BTreeMap<String, u64>>;

impl Counted {
    /// No critical section can panic half-way, so that a poisoned lock still guards whole totals.
    fn totals(&self) -> MutexGuard<'_, Totals> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps the totals of a service.
    pub(super) fn set<'a>(
        &self,
        service: ServiceName,
        totals: impl Iterator<Item = (&'a String, &'a u64)>,
    ) {
        let mut all = self.totals();
        let own = all.entry(service).or_default();
        for (name, total) in totals {
            match own.get_mut(name) {
                Some(before) => *before = *total,
                None => {
                    own.insert(name.clone(), *total);
                }
            }
        }
    }
}

impl Collector for Counted {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        // A copy, so that no service waits for the text.
        let all = self.totals().clone();
        let names: BTreeSet<&str> =
            all.values().flat_map(|totals| totals.keys()).map(String::as_str).collect();
        for name in names {
            let help = format!("Counted since the service started: {}", name.replace('_', " "));
            let mut metric = encoder.encode_descriptor(name, &help, None, MetricType::Counter)?;
            for (service, totals) in &all {
                if let Some(total) = totals.get(name) {
                    ConstCounter::new(*total).encode(metric.encode_family(&of(*service))?)?;
                }
            }
        }
        Ok(())
    }
}
