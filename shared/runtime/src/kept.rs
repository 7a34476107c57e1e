//! What a core keeps over a restart, as one file per fleet and service, in addition to the state that every
//! service has. The core knows the bytes; they are replaced whole or not at all.

use std::path::{Path, PathBuf};

use anyhow::Context;
use muster_model::id::{FleetId, ServiceName};
use muster_wire::kept::MAX_KEPT;

use crate::store::{read_at_most, replace};

/// The file of one service.
#[derive(Debug, Clone)]
pub struct KeptStore {
    path: Option<PathBuf>,
    /// What happens without the file, for the log.
    without: &'static str,
}

impl KeptStore {
    /// The file `{directory}/{fleet}/{service}.kept`, or nothing at all without a directory, or for a service that keeps
    /// nothing. `without` says what happens without the file ([`Core::WITHOUT_KEPT`](muster_service::Core::WITHOUT_KEPT)).
    #[must_use]
    pub fn new(
        directory: Option<&Path>,
        fleet: &FleetId,
        service: ServiceName,
        without: Option<&'static str>,
    ) -> Self {
        let path = directory
            .filter(|_| without.is_some())
            .map(|directory| directory.join(fleet.as_str()).join(format!("{service}.kept")));
        Self { path, without: without.unwrap_or_default() }
    }

    /// What was kept. Operators are told if that cannot be read, or if there is nothing though the service
    /// `has_run` here before.
    #[must_use]
    pub fn load(&self, has_run: bool) -> Option<Vec<u8>> {
        let path = self.path.as_ref()?;
        match read_at_most(path, MAX_KEPT as u64) {
            Ok(content) => Some(content),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                if has_run {
                    tracing::warn!(
                        "there is no {}, though this service has run here before: {}",
                        path.display(),
                        self.without
                    );
                }
                None
            }
            Err(error) => {
                self.put_aside(&format!("it cannot be read: {error}"));
                None
            }
        }
    }

    /// Renames a file that cannot be used to `….bad`, for an operator to look at, and says why.
    pub fn put_aside(&self, problem: &str) {
        let Some(path) = &self.path else { return };
        let bad = path.with_extension("kept.bad");
        tracing::error!(
            "{} is damaged, not used, and renamed to {}: {problem}; {}",
            path.display(),
            bad.display(),
            self.without
        );
        let _ = std::fs::rename(path, bad);
    }

    /// Replaces the file, whole or not at all.
    ///
    /// # Errors
    /// If the directory or file cannot be written; the text names it.
    pub fn save(&self, content: &[u8]) -> anyhow::Result<()> {
        let Some(path) = &self.path else { return Ok(()) };
        replace(path, content).context("the last output will not survive a restart")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_saved_is_loaded_and_what_is_damaged_is_put_aside() {
        let folder = tempfile::tempdir().unwrap();
        let fleet = FleetId::new("f").unwrap();
        let store = KeptStore::new(
            Some(folder.path()),
            &fleet,
            ServiceName::Clusterer,
            Some("ids begin again"),
        );
        assert_eq!(store.load(true), None);
        store.save(b"one").unwrap();
        store.save(b"two").unwrap();
        assert_eq!(store.load(false).as_deref(), Some(&b"two"[..]));
        store.put_aside("it is no division");
        assert_eq!(store.load(false), None);
        let bad = folder.path().join("f/clusterer.kept.bad");
        assert_eq!(std::fs::read(bad).unwrap(), b"two");
    }

    #[test]
    fn without_a_directory_nothing_is_kept() {
        let fleet = FleetId::new("f").unwrap();
        let store = KeptStore::new(None, &fleet, ServiceName::Clusterer, Some("ids begin again"));
        store.save(b"one").unwrap();
        assert_eq!(store.load(true), None);
    }
}
