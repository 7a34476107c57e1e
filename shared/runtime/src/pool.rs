//! What the services of many fleets in one process share, so that a thousand fleets cost no thousands of threads.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use muster_service::inbox::InboxLimits;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::bus::Turns;

/// How many services may write files or answer gets at the same time: enough to keep a disk busy.
const MAX_WRITING: usize = 8;

/// How often the loop of a service shows that it runs: several times in the five seconds after which it counts as hung,
/// and rarely, since there are thousands.
pub(crate) const SHOW_INTERVAL: Duration = Duration::from_secs(2);

/// What may wait for one service: a fleet of 5,000 robots fits, and a flood of one fleet leaves memory to the others.
pub(crate) const INBOX_LIMITS: InboxLimits = InboxLimits { items: 25_000, bytes: 32 * 1024 * 1024 };

/// Most threads for work that blocks: a computation for each processor of a large host, and what writes and asks. Whoever
/// finds none waits for its turn. Without a limit a busy machine, which takes a thread from its processor before that can
/// say that it is idle, gets one more each time, and as all are used in turn, none ends.
pub const MAX_BLOCKING_THREADS: usize = 64;

/// Threads and turns that services share. Clones share them.
#[derive(Debug, Clone)]
pub struct Pool {
    /// As many computations as there are processors, in the order in which they were wanted. A service has one at a
    /// time, so that none keeps the others waiting for longer than its own takes.
    jobs: Arc<Semaphore>,
    writing: Arc<Semaphore>,
    pub(crate) packets: Turns,
    pub(crate) renewals: Turns,
}

impl Pool {
    /// Starts the threads.
    ///
    /// # Errors
    /// If one cannot be started.
    pub fn start() -> anyhow::Result<Self> {
        let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let turns = |name| Turns::start(name).context("cannot start the threads that send");
        Ok(Self {
            jobs: Arc::new(Semaphore::new(processors)),
            writing: Arc::new(Semaphore::new(MAX_WRITING)),
            packets: turns("muster-sender")?,
            renewals: turns("muster-renewals")?,
        })
    }

    /// Ends the threads once nothing waits for them.
    pub fn end(&self) {
        self.packets.end();
        self.renewals.end();
    }

    /// Leave to compute. It waits for its turn.
    pub(crate) fn compute(&self) -> impl Future<Output = Option<OwnedSemaphorePermit>> + use<> {
        let jobs = Arc::clone(&self.jobs);
        async move { jobs.acquire_owned().await.ok() }
    }

    /// Leave to write files or answer gets. It waits for its turn.
    pub(crate) fn write(&self) -> impl Future<Output = Option<OwnedSemaphorePermit>> + use<> {
        let writing = Arc::clone(&self.writing);
        async move { writing.acquire_owned().await.ok() }
    }
}
