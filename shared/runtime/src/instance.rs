//! The name of a process among the instances of its service.

use muster_model::id::InstanceId;
use muster_wire::key::is_free_instance_name;

/// The name of this process among the instances of its service: host and process id.
#[must_use]
pub fn instance_name() -> InstanceId {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host: String = host
        .trim()
        .to_lowercase()
        .chars()
        .map(|c| if matches!(c, 'a'..='z' | '0'..='9' | '-' | '_') { c } else { '-' })
        .take(40)
        .collect();
    let nonce = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |time| time.subsec_micros());
    let name = format!("{host}-{}-{nonce}", std::process::id());
    let name = InstanceId::new(name.trim_start_matches('-')).ok().filter(is_free_instance_name);
    // The form above always is an id; a constant keeps the function free of panics.
    name.unwrap_or_else(fallback_instance)
}

fn fallback_instance() -> InstanceId {
    match InstanceId::new("instance") {
        Ok(id) => id,
        Err(_) => unreachable!("a constant id"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_an_instance_name() {
        assert!(instance_name().as_str().contains(&std::process::id().to_string()));
    }
}
