//! The name of a process among the instances of its service.

use std::time::{SystemTime, UNIX_EPOCH};

use muster_model::id::InstanceId;

/// The name of this process among the instances of its service: host, process id, and a number that
/// distinguishes two services of one process.
#[must_use]
pub fn instance_name() -> InstanceId {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    InstanceId::of_process(&host, std::process::id(), now.map_or(0, |time| time.subsec_nanos()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_an_instance_name() {
        assert!(instance_name().as_str().contains(&std::process::id().to_string()));
    }
}
