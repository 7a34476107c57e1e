//! What a service keeps over a restart, as one small JSON file per fleet and service.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use muster_model::id::{FleetId, ServiceName};
use muster_service::Stored;

/// Largest file that is read back: 256 outcomes of commands with four texts of 4 KiB each, of which JSON may write every byte as six, and
/// settings, which are far smaller.
const MAX_FILE: u64 = 32 * 1024 * 1024;

/// The file of one service.
#[derive(Debug, Clone)]
pub struct Store {
    path: Option<PathBuf>,
}

impl Store {
    /// The file `{directory}/{fleet}/{service}.json`, or nothing at all without a directory.
    #[must_use]
    pub fn new(directory: Option<&Path>, fleet: &FleetId, service: ServiceName) -> Self {
        let path = directory
            .map(|directory| directory.join(fleet.as_str()).join(format!("{service}.json")));
        Self { path }
    }

    /// What was kept; nothing if there is no file, or none that can be read. A damaged file is
    /// renamed to `….bad`, for an operator to look at.
    #[must_use]
    pub fn load(&self) -> Stored {
        self.load_noting(&mut None)
    }

    /// The same, and notes why what was kept is lost, if it is.
    pub fn load_noting(&self, loss: &mut Option<String>) -> Stored {
        let Some(path) = &self.path else { return Stored::default() };
        match self.read(path) {
            Ok(stored) => stored.unwrap_or_else(|| {
                // Nothing else tells a first start from a loss of the whole directory, where all hosts have lost theirs.
                tracing::info!(
                    "nothing is stored in {}, as at a first start; if this service has run here before, its state is lost, \
                     and settings that were changed must be changed again",
                    path.display()
                );
                Stored::default()
            }),
            Err(error) => {
                *loss = Some(format!(
                    "the stored state is damaged and not used: {error:#}; settings that were changed are \
                     lost, so change them again"
                ));
                let bad = path.with_extension("json.bad");
                tracing::error!(
                    "the stored state is damaged, not used, and renamed to {}: {error:#}",
                    bad.display()
                );
                let _ = std::fs::rename(path, bad);
                Stored::default()
            }
        }
    }

    /// What the file holds; none if there is no file.
    fn read(&self, path: &Path) -> anyhow::Result<Option<Stored>> {
        let name = path.display();
        let bytes = match read_at_most(path, MAX_FILE) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(None);
            }
            read => read.with_context(|| format!("cannot read {name}"))?,
        };
        let stored = serde_json::from_slice(&bytes);
        stored.map(Some).with_context(|| format!("{name} is not what was written"))
    }

    /// Replaces the file, whole or not at all.
    ///
    /// # Errors
    /// If the directory or file cannot be written; the text names it.
    pub fn save(&self, stored: &Stored) -> anyhow::Result<()> {
        let Some(path) = &self.path else { return Ok(()) };
        replace(path, &serde_json::to_vec_pretty(stored)?)
    }
}

/// Replaces a file, whole or not at all.
///
/// # Errors
/// If the directory or file cannot be written; the text names it.
pub(crate) fn replace(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    let directory = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(directory)
        .with_context(|| format!("cannot make the directory {}", directory.display()))?;
    let mut file = tempfile::NamedTempFile::new_in(directory)
        .with_context(|| format!("cannot write in {}", directory.display()))?;
    file.write_all(content).with_context(|| format!("cannot write in {}", directory.display()))?;
    file.as_file().sync_all()?;
    file.persist(path).with_context(|| format!("cannot write {}", path.display()))?;
    // The new name is only kept over a loss of power once the directory is on the disk, too.
    std::fs::File::open(directory)
        .and_then(|directory| directory.sync_all())
        .with_context(|| format!("cannot sync the directory {}", directory.display()))
}

/// Reads a file that should be small, and never more than its limit.
///
/// # Errors
/// If it cannot be read, or has more bytes than the limit.
pub fn read_at_most(path: &Path, limit: u64) -> std::io::Result<Vec<u8>> {
    use std::io::Read as _;
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        let problem = format!("it has more than {limit} bytes");
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, problem));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store(directory: &Path) -> Store {
        Store::new(Some(directory), &FleetId::new("f").unwrap(), ServiceName::Clusterer)
    }

    #[test]
    fn what_is_saved_is_loaded() {
        let directory = tempfile::tempdir().unwrap();
        let store = store(directory.path());
        assert_eq!(store.load(), Stored::default());
        let mut stored = Stored { term: 7, ..Stored::default() };
        stored.patch.insert("teams".to_owned(), 3.into());
        store.save(&stored).unwrap();
        assert_eq!(store.load(), stored);
    }

    #[test]
    fn a_damaged_file_is_as_good_as_none() {
        let directory = tempfile::tempdir().unwrap();
        let store = store(directory.path());
        store.save(&Stored { term: 7, ..Stored::default() }).unwrap();
        let path = directory.path().join("f/clusterer.json");
        for damage in ["", "{", "[1]", "{\"term\":-1,\"patch\":{}}", "{\"term\":1,\"x\":2}"] {
            std::fs::write(&path, damage).unwrap();
            assert_eq!(store.load(), Stored::default(), "{damage}");
            let bad = directory.path().join("f/clusterer.json.bad");
            assert_eq!(std::fs::read_to_string(bad).unwrap(), damage);
        }
    }
}
