//! A small disk that can be full.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, ensure};

/// The size of the disk: many times what the services keep.
const SIZE: &str = "size=1m";

/// What is written at once to fill it.
const BLOCK_BYTES: usize = 4096;

/// Where the kernel lists what is mounted.
const MOUNTS: &str = "/proc/self/mounts";

/// What the folders of soaks begin with; the id of the process that made one follows.
const PREFIX: &str = "muster-soak-";

/// What the folder of this process's fleet begins with.
pub(super) fn folder_prefix() -> String {
    format!("{PREFIX}{}-", std::process::id())
}

/// A disk of its own, or a folder where the kernel allows none. It is gone when the test lets go of it.
#[derive(Debug)]
pub(super) struct Disk {
    folder: PathBuf,
    is_mounted: bool,
}

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    let mut command = Command::new(program);
    command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// Unmounts the disks of soaks that were killed before they could.
fn remove_leftovers() {
    let mounts = std::fs::read_to_string(MOUNTS).unwrap_or_default();
    for folder in mounts.lines().filter_map(|line| line.split(' ').nth(1)) {
        let maker = folder.split_once(PREFIX).and_then(|(_, rest)| rest.split('-').next());
        if maker.is_some_and(|maker| !Path::new("/proc").join(maker).exists()) {
            succeeds("umount", &["--lazy", folder]);
        }
    }
}

impl Disk {
    /// Mounts a disk in memory at a folder, which is made.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub(super) fn mount(folder: &Path) -> anyhow::Result<Self> {
        remove_leftovers();
        std::fs::create_dir_all(folder)?;
        let path = folder.to_str().context("a path of the tests is not UTF-8")?;
        let is_mounted = succeeds("mount", &["-t", "tmpfs", "-o", SIZE, "tmpfs", path]);
        Ok(Self { folder: folder.to_owned(), is_mounted })
    }

    /// Whether it can be full.
    pub(super) fn can_be_full(&self) -> bool {
        self.is_mounted
    }

    fn filler(&self) -> PathBuf {
        self.folder.join("filler")
    }

    /// Writes until nothing more can be written. Does nothing where it cannot be full.
    ///
    /// # Errors
    /// If that ends for another reason.
    pub(super) fn fill(&self) -> anyhow::Result<()> {
        if !self.is_mounted {
            return Ok(());
        }
        let mut file = File::create(self.filler())?;
        loop {
            match file.write_all(&[0; BLOCK_BYTES]) {
                Ok(()) => {}
                Err(error) => {
                    let is_full = error.kind() == std::io::ErrorKind::StorageFull;
                    ensure!(is_full, "the disk is not full, but: {error}");
                    return Ok(());
                }
            }
        }
    }

    /// Makes room again.
    ///
    /// # Errors
    /// If the file cannot be removed.
    pub(super) fn empty(&self) -> anyhow::Result<()> {
        if self.is_mounted { Ok(std::fs::remove_file(self.filler())?) } else { Ok(()) }
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        if self.is_mounted {
            let path = self.folder.to_string_lossy().into_owned();
            succeeds("umount", &["--lazy", &path]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_takes_nothing_until_there_is_room() {
        let folder = tempfile::Builder::new().prefix(&folder_prefix()).tempdir().unwrap();
        let state = folder.path().join("state");
        let disk = Disk::mount(&state).unwrap();
        disk.fill().unwrap();
        let writes = || std::fs::write(state.join("a"), vec![1; 2 * BLOCK_BYTES]).is_ok();
        assert_eq!(writes(), !disk.can_be_full());
        disk.empty().unwrap();
        assert!(writes());
        drop(disk);
        let mounts = std::fs::read_to_string(MOUNTS).unwrap();
        assert!(!mounts.contains(state.to_str().unwrap()), "{mounts}");
    }
}
