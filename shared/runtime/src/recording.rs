//! Writes the life of a service to a file, on a thread of its own.
//!
//! The loop hands over entries and never waits. When the disk is too slow, full, or the file has
//! reached its limit, the recording ends with a warning and the service goes on: a recording with a
//! gap would be worth nothing.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context;
use muster_model::id::{InstanceId, ServiceName};
use muster_service::recording::{Entry, Head};
use muster_wire::envelope::EnvelopeError;
use muster_wire::recording::{begin, frame};

use crate::exit::ExitError;

/// How long the end of a service waits for what is not written yet.
const FLUSH_WITHIN: Duration = Duration::from_secs(1);

/// The limits of a recording.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// Most entries that wait to be written.
    entries: usize,
    /// Most bytes that wait to be written.
    bytes: usize,
    /// Most bytes of the file.
    file: u64,
}

/// A busy service makes some thousand entries a second, and a disk may stall for a few seconds; a few
/// of the largest messages may wait. A file of this size holds half a day of a fleet of twenty, and
/// most of an hour of two hundred robots that all move; a flag that was forgotten must not fill the
/// disk of a robot.
const LIMITS: Limits = Limits { entries: 16_384, bytes: 256 * 1024 * 1024, file: 4 << 30 };

/// Where services are to be recorded, from `--record`.
#[derive(Debug, Clone)]
pub struct RecordTo {
    /// A file; or a folder, in which every run of a service gets a file of its own.
    pub path: PathBuf,
    /// Whether several services run in this process: the name of each is added to that of the file.
    pub several: bool,
}

impl RecordTo {
    /// Makes the file of one service, for its owner alone to read.
    ///
    /// # Errors
    /// If there is a file already, or none can be made; names the remedy.
    pub fn create(
        &self,
        service: ServiceName,
        instance: &InstanceId,
    ) -> Result<RecordFile, ExitError> {
        let path = if self.path.is_dir() {
            self.path.join(format!("{service}-{instance}.rec"))
        } else if self.several {
            let mut name = self.path.clone().into_os_string();
            name.push(format!(".{service}"));
            PathBuf::from(name)
        } else {
            self.path.clone()
        };
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        // It holds everything that the service receives, settings and positions included.
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let file = options.open(&path).map_err(|error| {
            let name = path.display();
            ExitError::usage(if error.kind() == std::io::ErrorKind::AlreadyExists {
                format!(
                    "--record {name}: exists already and is not written over; name another file, \
                     or a folder, in which every run gets a file of its own"
                )
            } else {
                format!("--record {name}: cannot be made: {error}")
            })
        })?;
        Ok(RecordFile { file, path })
    }
}

/// An empty file for a recording.
#[derive(Debug)]
pub struct RecordFile {
    file: File,
    path: PathBuf,
}

/// A recording that goes on. Letting go of it waits a moment for what is not written yet.
#[derive(Debug)]
pub(crate) struct Recording {
    path: PathBuf,
    limits: Limits,
    /// None once the recording has ended.
    sender: Option<SyncSender<Vec<u8>>>,
    waiting_bytes: Arc<AtomicUsize>,
    /// Why it ended, to be written as its last word.
    why: Arc<Mutex<Option<String>>>,
    written: Receiver<()>,
}

impl Recording {
    /// Begins a recording.
    ///
    /// # Errors
    /// If the head does not encode, or no thread can be started.
    pub(crate) fn start(file: RecordFile, head: &Head) -> anyhow::Result<Self> {
        tracing::info!("recording to {}", file.path.display());
        Self::begin(file.file, file.path, head, LIMITS)
    }

    fn begin(
        output: impl Write + Send + 'static,
        path: PathBuf,
        head: &Head,
        limits: Limits,
    ) -> anyhow::Result<Self> {
        let head = begin(head)?;
        let (sender, frames) = sync_channel(limits.entries);
        let (done, written) = sync_channel(1);
        let waiting_bytes = Arc::new(AtomicUsize::new(0));
        let why = Arc::new(Mutex::new(None));
        let writer = Writer {
            output: BufWriter::new(output),
            size: 0,
            limit: limits.file,
            waiting_bytes: Arc::clone(&waiting_bytes),
            why: Arc::clone(&why),
        };
        let name = path.clone();
        std::thread::Builder::new()
            .name("muster-recorder".to_owned())
            .spawn(move || {
                if let Err(error) = writer.run(&head, &frames) {
                    warn_of_end(&name, &error.to_string());
                }
                drop(frames);
                let _ = done.send(());
            })
            .context("cannot start the thread that records")?;
        Ok(Self { path, limits, sender: Some(sender), waiting_bytes, why, written })
    }

    /// Adds the bytes of an entry, if the recording still goes on. Never waits.
    pub(crate) fn add(&mut self, frame: impl FnOnce() -> Result<Vec<u8>, EnvelopeError>) {
        let Some(sender) = &self.sender else { return };
        let bytes = match frame() {
            Ok(bytes) => bytes,
            Err(error) => return self.end(&format!("something cannot be recorded: {error}")),
        };
        let size = bytes.len();
        let waiting = self.waiting_bytes.fetch_add(size, Ordering::Relaxed);
        let fits = waiting == 0 || waiting.saturating_add(size) <= self.limits.bytes;
        let sent = if fits { sender.try_send(bytes) } else { Err(TrySendError::Full(bytes)) };
        match sent {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => {
                self.end("the disk is too slow: too much waits to be written");
            }
            // The thread has logged why.
            Err(TrySendError::Disconnected(_)) => self.sender = None,
        }
    }

    fn end(&mut self, why: &str) {
        warn_of_end(&self.path, why);
        *self.why.lock().unwrap_or_else(PoisonError::into_inner) = Some(why.to_owned());
        self.sender = None;
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        self.sender = None;
        let _ = self.written.recv_timeout(FLUSH_WITHIN);
    }
}

fn warn_of_end(path: &Path, why: &str) {
    tracing::warn!("the recording {} ends, and the service goes on: {why}", path.display());
}

struct Writer<W: Write> {
    output: BufWriter<W>,
    size: u64,
    limit: u64,
    waiting_bytes: Arc<AtomicUsize>,
    why: Arc<Mutex<Option<String>>>,
}

impl<W: Write> Writer<W> {
    /// Writes what comes until nothing more will.
    fn run(mut self, head: &[u8], frames: &Receiver<Vec<u8>>) -> std::io::Result<()> {
        self.output.write_all(head)?;
        loop {
            let bytes = match frames.try_recv() {
                Ok(bytes) => bytes,
                Err(TryRecvError::Disconnected) => break,
                Err(TryRecvError::Empty) => {
                    // What is known now survives the death of the process.
                    self.output.flush()?;
                    let Ok(bytes) = frames.recv() else { break };
                    bytes
                }
            };
            let size = bytes.len();
            self.size += size as u64;
            if self.size > self.limit {
                let why = format!("the file has reached its limit of {} bytes", self.limit);
                self.close(&why)?;
                return Err(std::io::Error::other(why));
            }
            self.output.write_all(&bytes)?;
            self.waiting_bytes.fetch_sub(size, Ordering::Relaxed);
        }
        let why = self.why.lock().unwrap_or_else(PoisonError::into_inner).take();
        self.close(why.as_deref().unwrap_or("the service has stopped"))
    }

    fn close(&mut self, why: &str) -> std::io::Result<()> {
        let last = frame(&Entry::End(why.to_owned())).map_err(std::io::Error::other)?;
        self.output.write_all(&last)?;
        self.output.flush()
    }
}

/// What last digits of numbers depend on, apart from the version of the program: vector instructions
/// add in another order.
#[must_use]
pub fn host_facts() -> String {
    let mut facts = vec![std::env::consts::OS, std::env::consts::ARCH];
    #[cfg(target_arch = "x86_64")]
    for (has, name) in [
        (std::is_x86_feature_detected!("avx2"), "avx2"),
        (std::is_x86_feature_detected!("fma"), "fma"),
        (std::is_x86_feature_detected!("avx512f"), "avx512f"),
    ] {
        if has {
            facts.push(name);
        }
    }
    facts.push(if cfg!(debug_assertions) { "debug" } else { "release" });
    facts.join(" ")
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use muster_model::id::FleetId;
    use muster_model::time::Tick;
    use muster_service::recording::input_frame;
    use muster_service::{Input, Stored};
    use muster_wire::recording::{Reader, RecordingError};

    use super::*;

    fn head() -> Head {
        Head {
            version: "0".to_owned(),
            service: ServiceName::Ingest,
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::of_process("h", 1, 1),
            started: Tick(1),
            settings: serde_json::json!({}),
            stored: Stored::default(),
            host: host_facts(),
        }
    }

    fn entry(tick: u64) -> Result<Vec<u8>, EnvelopeError> {
        input_frame(Tick(tick), &Input::Timer)
    }

    fn entry_read(tick: u64) -> Entry {
        Entry::Input { tick: Tick(tick), input: Input::Timer }
    }

    fn read(path: &Path) -> (Vec<Entry>, Option<RecordingError>) {
        let (mut reader, _) = Reader::open::<Head>(File::open(path).unwrap()).unwrap();
        let mut entries = Vec::new();
        loop {
            match reader.next_entry() {
                Ok(Some(entry)) => entries.push(entry),
                Ok(None) => return (entries, None),
                Err(error) => return (entries, Some(error)),
            }
        }
    }

    fn end(entries: &[Entry]) -> &str {
        match entries.last() {
            Some(Entry::End(why)) => why,
            other => panic!("{other:?}"),
        }
    }

    fn to(path: PathBuf) -> RecordTo {
        RecordTo { path, several: false }
    }

    #[test]
    fn what_was_added_is_read_back_and_the_end_is_stated() {
        let folder = tempfile::tempdir().unwrap();
        let instance = head().instance;
        let file = to(folder.path().join("a")).create(ServiceName::Ingest, &instance).unwrap();
        let mut recording = Recording::start(file, &head()).unwrap();
        for tick in 0..1000 {
            recording.add(|| entry(tick));
        }
        drop(recording);
        let (entries, error) = read(&folder.path().join("a"));
        assert!(error.is_none());
        assert_eq!(entries.len(), 1001);
        assert_eq!(entries[999], entry_read(999));
        assert_eq!(end(&entries), "the service has stopped");
    }

    #[test]
    fn files_are_private_named_by_the_rules_and_never_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let instance = head().instance;
        let file = to(folder.path().join("a"));
        let made = file.create(ServiceName::Ingest, &instance).unwrap();
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            assert_eq!(made.file.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        }
        assert_eq!(made.path, folder.path().join("a"));
        let again = file.create(ServiceName::Ingest, &instance).unwrap_err();
        assert!(again.message.contains("name another file"), "{}", again.message);
        let several = RecordTo { several: true, ..file };
        let made = several.create(ServiceName::Auditor, &instance).unwrap();
        assert_eq!(made.path, folder.path().join("a.auditor"));
        let inside = RecordTo { path: folder.path().to_owned(), several: true };
        let made = inside.create(ServiceName::Auditor, &instance).unwrap();
        assert_eq!(made.path, folder.path().join(format!("auditor-{instance}.rec")));
        let nowhere = to(folder.path().join("no/such")).create(ServiceName::Ingest, &instance);
        assert!(nowhere.unwrap_err().message.contains("cannot be made"));
    }

    /// A disk that hangs until it is released, and then takes so many bytes.
    struct Disk {
        file: File,
        hangs: Option<Receiver<()>>,
        room: usize,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            if let Some(hangs) = self.hangs.take() {
                let _ = hangs.recv();
            }
            if self.room == 0 {
                return Err(std::io::Error::from(std::io::ErrorKind::StorageFull));
            }
            let written = self.file.write(&bytes[..bytes.len().min(self.room)])?;
            self.room -= written;
            Ok(written)
        }
        fn flush(&mut self) -> std::io::Result<()> {
            self.file.flush()
        }
    }

    #[test]
    fn a_disk_that_hangs_ends_the_recording_and_delays_nothing() {
        let folder = tempfile::tempdir().unwrap();
        for limits in [Limits { entries: 100, ..LIMITS }, Limits { bytes: 2000, ..LIMITS }] {
            let path = folder.path().join(format!("{}", limits.entries));
            let (go_on, hangs) = std::sync::mpsc::channel();
            let file = File::create(&path).unwrap();
            let disk = Disk { file, hangs: Some(hangs), room: usize::MAX };
            let mut recording = Recording::begin(disk, path.clone(), &head(), limits).unwrap();
            let start = Instant::now();
            for tick in 0..10_000 {
                recording.add(|| entry(tick));
            }
            assert!(start.elapsed() < Duration::from_secs(5), "adding does not wait");
            assert!(recording.sender.is_none(), "the recording has ended");
            go_on.send(()).unwrap();
            drop(recording);
            let (entries, error) = read(&path);
            assert!(error.is_none());
            assert!(end(&entries).contains("too slow"), "{}", end(&entries));
            // Up to its end it has no gap.
            for (tick, found) in entries[..entries.len() - 1].iter().enumerate() {
                assert_eq!(*found, entry_read(tick as u64));
            }
            // The queue, and what the buffer of the writer holds before the disk is asked.
            assert!(entries.len() > 10 && entries.len() < 1000, "{}", entries.len());
        }
    }

    /// Records until the recording ends by itself.
    fn fill(mut recording: Recording) {
        let start = Instant::now();
        while recording.sender.is_some() {
            assert!(start.elapsed() < Duration::from_secs(10));
            recording.add(|| entry(7));
        }
    }

    #[test]
    fn a_full_disk_and_a_full_file_end_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("full");
        let disk = Disk { file: File::create(&path).unwrap(), hangs: None, room: 2000 };
        let recording = Recording::begin(disk, path.clone(), &head(), LIMITS).unwrap();
        fill(recording);
        let (entries, error) = read(&path);
        assert!(matches!(error, Some(RecordingError::BreaksOff(_))), "{error:?}");
        assert!(entries.len() > 10 && entries.iter().all(|found| *found == entry_read(7)));

        let path = folder.path().join("long");
        let limits = Limits { file: 5000, ..LIMITS };
        let file = File::create(&path).unwrap();
        let recording = Recording::begin(file, path.clone(), &head(), limits).unwrap();
        fill(recording);
        let (entries, error) = read(&path);
        assert!(error.is_none());
        assert!(end(&entries).contains("limit of 5000 bytes"), "{}", end(&entries));
        assert!(std::fs::metadata(&path).unwrap().len() < 5000 + 1000);
    }

    #[test]
    fn what_cannot_be_recorded_ends_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let file = File::create(&path).unwrap();
        let mut recording = Recording::begin(file, path.clone(), &head(), LIMITS).unwrap();
        recording.add(|| entry(1));
        recording.add(|| Err(EnvelopeError::Encode("too odd".to_owned())));
        recording.add(|| entry(2));
        drop(recording);
        let (entries, _) = read(&path);
        assert_eq!(entries.len(), 2);
        assert!(end(&entries).contains("too odd"));
    }
}
