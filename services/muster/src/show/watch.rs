//! Shows something once, or again and again.
//!
//! On a terminal a watch redraws in place and counts every second how old what it shows is. Elsewhere it
//! appends what changes; with `--json` one line per change, and says on standard error when it is stale.

use std::future::Future;
use std::io::Write as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_client::{Client, Error, Latest, Publication, Staleness, Watch};
use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use tokio::sync::watch;
use tokio::task::AbortHandle;
use tokio::time::{MissedTickBehavior, interval, sleep};

use super::page::{Age, Line, Page, age_line};
use super::screen::Screen;
use crate::console::exit_error;

/// How often a terminal is redrawn.
const REDRAW_INTERVAL: Duration = Duration::from_secs(1);

/// How often the fleet is asked where a watch polls.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// What can be shown of a fleet.
pub(crate) trait Shown {
    /// Who publishes it.
    const PUBLISHER: &'static str;

    /// It as text, of which tables fit the page.
    fn lines(&self, page: &Page, now: Tick) -> Vec<String>;

    /// It as lines of JSON.
    ///
    /// # Errors
    /// If a number cannot be written.
    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error>;

    /// Whether another one shows the same.
    fn same(&self, other: &Self) -> bool;
}

/// Where a watch has its content from.
pub(crate) trait Source<T> {
    /// The newest content.
    fn latest(&self) -> Option<Latest<T>>;

    /// Waits for another content, or for a change of whether it is stale.
    fn changed(&mut self) -> impl Future<Output = Result<Latest<T>, Error>> + Send;
}

impl<T: Publication> Source<T> for Watch<T> {
    fn latest(&self) -> Option<Latest<T>> {
        Self::latest(self)
    }

    fn changed(&mut self) -> impl Future<Output = Result<Latest<T>, Error>> + Send {
        Self::changed(self)
    }
}

/// Content that a fleet is asked for every second.
#[derive(Debug)]
pub(crate) struct Polled<T> {
    receiver: watch::Receiver<Result<Latest<T>, String>>,
    task: AbortHandle,
}

impl<T> Drop for Polled<T> {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl<T: Send + Sync + 'static> Polled<T> {
    /// Asks every second, after a first content. `ask` returns none without a reply.
    pub(crate) fn start<F>(client: &Client, first: T, ask: impl Fn() -> F + Send + 'static) -> Self
    where
        F: Future<Output = Result<Option<T>, Error>> + Send + 'static,
    {
        let first = Latest { value: Arc::new(first), stale: None, received: Instant::now() };
        let (sender, receiver) = watch::channel(Ok(first));
        let link = client.link();
        let polling = async move {
            loop {
                sleep(POLL_INTERVAL).await;
                let linked = *link.borrow();
                let reply = if linked { ask().await } else { Ok(None) };
                let closed = reply.is_err();
                sender.send_modify(|latest| *latest = after(latest, reply, linked));
                if closed {
                    return;
                }
            }
        };
        Self { receiver, task: tokio::spawn(polling).abort_handle() }
    }
}

/// The content after a reply, or none, to one more question.
fn after<T>(
    before: &Result<Latest<T>, String>,
    reply: Result<Option<T>, Error>,
    linked: bool,
) -> Result<Latest<T>, String> {
    let stale = Some(if linked { Staleness::Silent } else { Staleness::LinkLost });
    match (reply, before) {
        (Ok(Some(value)), _) => {
            Ok(Latest { value: Arc::new(value), stale: None, received: Instant::now() })
        }
        (Ok(None), Ok(before)) => Ok(Latest { stale, ..before.clone() }),
        (Ok(None), Err(problem)) => Err(problem.clone()),
        (Err(error), _) => Err(error.to_string()),
    }
}

impl<T: Send + Sync> Source<T> for Polled<T> {
    fn latest(&self) -> Option<Latest<T>> {
        self.receiver.borrow().clone().ok()
    }

    async fn changed(&mut self) -> Result<Latest<T>, Error> {
        self.receiver.changed().await.map_err(|_| Error::Closed)?;
        let latest = self.receiver.borrow_and_update().clone();
        latest.map_err(|reason| Error::Bus { reason })
    }
}

/// Prints something once.
///
/// # Errors
/// If standard output is closed.
pub(crate) fn print<T: Shown>(shown: &T, json: bool) -> anyhow::Result<()> {
    let now = Clock::start().now();
    let mut out = std::io::stdout().lock();
    if json {
        out.write_all(&shown.json(now)?)?;
    } else {
        for line in shown.lines(&Page::of_stdout(), now) {
            writeln!(out, "{line}")?;
        }
    }
    Ok(out.flush()?)
}

/// Shows every change until the client is closed.
///
/// # Errors
/// If the client fails, or standard output is closed.
pub(crate) async fn follow<T: Shown>(
    client: &Client,
    mut source: impl Source<T>,
    json: bool,
) -> anyhow::Result<()> {
    let (clock, mut screen) = (Clock::start(), Screen::of_stdout());
    let link = client.link();
    let in_place = screen.is_terminal() && !json;
    let mut redraws = interval(REDRAW_INTERVAL);
    redraws.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut before: Option<Latest<T>> = None;
    loop {
        let latest = tokio::select! {
            changed = source.changed() => Some(changed.map_err(exit_error)?),
            _ = redraws.tick(), if in_place => source.latest(),
        };
        let (page, now) = (Page::of_stdout(), clock.now());
        let age = match &latest {
            Some(Latest { received, stale, .. }) => {
                Age::Received { age: received.elapsed(), stale: *stale }
            }
            None => Age::Waiting { linked: *link.borrow() },
        };
        let age = age_line(now, T::PUBLISHER, age);
        if in_place {
            let mut lines = vec![age];
            let content = latest.map(|latest| latest.value.lines(&page, now));
            lines.extend(content.into_iter().flatten().map(Line::from));
            screen.show(&page, &lines)?;
            continue;
        }
        let Some(latest) = latest else { continue };
        match news(before.as_ref(), &latest) {
            News::Content if json => {
                let mut out = std::io::stdout().lock();
                out.write_all(&latest.value.json(now)?)?;
                out.flush()?;
            }
            News::Content => {
                let lines = latest.value.lines(&page, now);
                let lines: Vec<_> =
                    std::iter::once(age).chain(lines.into_iter().map(Line::from)).collect();
                screen.show(&page, &lines)?;
            }
            News::Staleness if json => eprintln!("{}", age.text),
            News::Staleness => screen.show(&page, &[age])?,
            News::Nothing => {}
        }
        before = Some(latest);
    }
}

/// What is new after what was shown last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum News {
    Content,
    Staleness,
    Nothing,
}

fn news<T: Shown>(before: Option<&Latest<T>>, latest: &Latest<T>) -> News {
    match before {
        None => News::Content,
        // The same once more is old, also of what never counts as the same.
        Some(before) if before.received != latest.received && !before.value.same(&latest.value) => {
            News::Content
        }
        Some(before) if before.stale != latest.stale => News::Staleness,
        Some(_) => News::Nothing,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug)]
    struct Number(u32);

    impl Shown for Number {
        const PUBLISHER: &'static str = "service";

        fn lines(&self, _: &Page, _: Tick) -> Vec<String> {
            vec![self.0.to_string()]
        }

        fn json(&self, _: Tick) -> Result<Vec<u8>, serde_json::Error> {
            serde_json::to_vec(&self.0)
        }

        fn same(&self, other: &Self) -> bool {
            self.0 == other.0
        }
    }

    fn latest(number: u32, stale: Option<Staleness>) -> Latest<Number> {
        Latest { value: Arc::new(Number(number)), stale, received: Instant::now() }
    }

    #[test]
    fn a_pipe_gets_what_changes_and_nothing_else() {
        let silent = Some(Staleness::Silent);
        let first = latest(1, None);
        assert_eq!(news(None, &first), News::Content);
        assert_eq!(news(Some(&first), &latest(1, None)), News::Nothing);
        assert_eq!(news(Some(&first), &latest(1, silent)), News::Staleness);
        assert_eq!(news(Some(&latest(1, silent)), &latest(1, None)), News::Staleness);
        assert_eq!(news(Some(&first), &latest(2, silent)), News::Content);
        // What is kept in silence is no news again, even if it never counts as the same.
        let kept = Latest { value: Arc::new(Number(2)), stale: silent, received: first.received };
        assert_eq!(news(Some(&first), &kept), News::Staleness);
    }

    #[test]
    fn a_poll_without_a_reply_keeps_the_last_content_and_says_why() {
        let first = Ok(latest(1, None));
        let silent = after(&first, Ok(None), true).unwrap();
        assert_eq!((silent.value.0, silent.stale), (1, Some(Staleness::Silent)));
        let lost = after(&Ok(silent), Ok(None), false).unwrap();
        assert_eq!((lost.value.0, lost.stale), (1, Some(Staleness::LinkLost)));
        let fresh = after(&Ok(lost), Ok(Some(Number(2))), true).unwrap();
        assert_eq!((fresh.value.0, fresh.stale), (2, None));
        assert!(after(&Ok(fresh), Err(Error::Closed), true).is_err());
    }
}
