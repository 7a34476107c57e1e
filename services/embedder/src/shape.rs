//! The number of teams that the fleet shows and K, kept on disk so that they stand after a restart of everything.
//!
//! Both are kept from frame to frame where others are hardly better. An embedder that knows no embedding of before could choose
//! others on the same graphs, and robots would change team though nothing has changed.

use std::time::Duration;

use muster_model::embedding::Embedding;
use muster_model::time::Tick;
use muster_wire::kept::KeptShape;

/// Shortest time between two writes: a fleet whose number changes in every frame must not wear out its disk.
const WRITE_INTERVAL: Duration = Duration::from_millis(500);

/// How long after a failed write the next is tried.
const RETRY_TIME: Duration = Duration::from_secs(10);

/// How often a standby asks for the embedding of its leader: after a power cut either may lead. An embedding of thousands of
/// robots is megabytes, and the number seldom changes.
const ASK_INTERVAL: Duration = Duration::from_secs(10);

/// For how long a leader that begins goes on from what it has found, from the first robot on: robots connect again, and repeat their
/// links and ranks, within it. By what a part of them shows another number may be clearly better, and be kept from then on.
const GATHERING_TIME: Duration = Duration::from_secs(2);

/// What is known, and what is on disk.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    newest: Option<KeptShape>,
    /// What was known as this instance began to lead, as long as it goes on from that.
    found: Option<KeptShape>,
    /// When it made its first embedding of robots since.
    gathering_since: Option<Tick>,
    written: Option<KeptShape>,
    /// When the next write may begin, if anything has changed.
    next_write: Tick,
    /// When a standby asked last.
    asked: Tick,
}

impl Shape {
    /// Takes over what was kept.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub(crate) fn restore(&mut self, content: &[u8]) -> Result<(), String> {
        let kept = KeptShape::decode(content).map_err(|error| error.to_string())?;
        (self.newest, self.written) = (Some(kept), Some(kept));
        Ok(())
    }

    /// An embedding was published, by this instance or its leader. One of no robots, or of those that came first, says nothing of the
    /// fleet.
    pub(crate) fn note(&mut self, now: Tick, embedding: &Embedding) {
        if embedding.robots.is_empty() || self.found(now).is_some() {
            return;
        }
        let teams = embedding.quality.teams_shown.unwrap_or(0);
        self.newest = Some(KeptShape { teams, rank: embedding.dimension / 2 });
    }

    /// This instance begins to lead.
    pub(crate) fn lead(&mut self) {
        (self.found, self.gathering_since) = (self.newest, None);
    }

    /// This instance leads no more.
    pub(crate) fn stand_down(&mut self) {
        self.found = None;
    }

    /// What an embedding of robots that begins now goes on from; none if from the last one.
    pub(crate) fn goes_on_from(&mut self, now: Tick) -> Option<KeptShape> {
        self.gathering_since.get_or_insert(now);
        self.found(now)
    }

    /// What was found, until the robots have gathered: a fleet at rest has no further job that would end that time.
    fn found(&mut self, now: Tick) -> Option<KeptShape> {
        if self.gathering_since.is_some_and(|since| now.since(since) >= GATHERING_TIME) {
            self.found = None;
        }
        self.found
    }

    /// When something is to be written.
    pub(crate) fn write_due(&self) -> Option<Tick> {
        (self.newest != self.written).then_some(self.next_write)
    }

    /// The bytes to be written, if that is due.
    pub(crate) fn write(&mut self, now: Tick) -> Option<Vec<u8>> {
        let newest = self.newest.filter(|_| self.write_due().is_some_and(|due| due <= now))?;
        self.written = Some(newest);
        self.next_write = now.after(WRITE_INTERVAL);
        newest.encode().ok()
    }

    /// A write has ended.
    pub(crate) fn write_ended(&mut self, now: Tick, is_on_disk: bool) {
        if !is_on_disk {
            self.written = None;
            self.next_write = now.after(RETRY_TIME);
        }
    }

    /// When a standby asks its leader again.
    pub(crate) fn ask_due(&self) -> Tick {
        self.asked.after(ASK_INTERVAL)
    }

    /// The leader was asked.
    pub(crate) fn asked(&mut self, now: Tick) {
        self.asked = now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_found_holds_until_the_robots_have_gathered() {
        let at = |ms: u64| Tick(1_000_000).after(Duration::from_millis(ms));
        let found = KeptShape { teams: 5, rank: 4 };
        let mut shape = Shape::default();
        shape.restore(&found.encode().unwrap()).unwrap();
        assert_eq!(shape.goes_on_from(at(0)), None, "it follows");
        shape.lead();
        // However long it waits for the first robot.
        for ms in [60_000, 61_000, 61_999] {
            assert_eq!(shape.goes_on_from(at(ms)), Some(found));
        }
        assert_eq!(shape.goes_on_from(at(62_000)), None);
        assert_eq!(shape.newest, Some(found));
    }
}
