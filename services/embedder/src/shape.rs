//! The number of teams that the fleet shows and K, kept on disk so that they stand after a restart of everything.
//!
//! Both are kept from frame to frame where others are hardly better. An embedder that knows no embedding of before could choose
//! others on the same graphs, and robots would change team though nothing has changed.

use std::time::Duration;

use muster_model::embedding::Embedding;
use muster_model::id::RobotId;
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

/// How long robots are remembered that have left: as long as the clusterer remembers their team.
const ABSENCE_TIME: Duration = Duration::from_secs(60);

/// The fleet as it was before robots left.
#[derive(Debug)]
struct Whole {
    /// Ordered by name.
    robots: Vec<RobotId>,
    shape: KeptShape,
    /// Since when some are missing.
    missing_since: Option<Tick>,
}

impl Whole {
    fn misses_any(&self, robots: &[RobotId]) -> bool {
        // Both are ordered, and mostly the same.
        let mut there = robots.iter();
        !self.robots.iter().all(|robot| there.any(|other| other == robot))
    }
}

/// What is known, and what is on disk.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    newest: Option<KeptShape>,
    /// What was known as this instance began to lead, or before robots left that are back, as long as it goes on from that.
    found: Option<KeptShape>,
    /// When it made its first embedding of robots since.
    gathering_since: Option<Tick>,
    /// What a leader knows of the fleet with those that have left.
    whole: Option<Whole>,
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
        let teams = embedding.quality.teams_shown.unwrap_or(0);
        let shape = KeptShape { teams, rank: embedding.dimension / 2 };
        self.note_shape(now, &embedding.robots, shape);
    }

    fn note_shape(&mut self, now: Tick, robots: &[RobotId], shape: KeptShape) {
        if robots.is_empty() || self.found(now).is_some() {
            return;
        }
        self.newest = Some(shape);
        match &mut self.whole {
            Some(whole) if whole.missing_since.is_some() => {}
            Some(whole) if whole.robots == robots => whole.shape = shape,
            whole => {
                *whole = Some(Whole { robots: robots.to_vec(), shape, missing_since: None });
            }
        }
    }

    /// This instance begins to lead.
    pub(crate) fn lead(&mut self) {
        (self.found, self.gathering_since) = (self.newest, None);
        self.whole = None;
    }

    /// This instance leads no more.
    pub(crate) fn stand_down(&mut self) {
        self.found = None;
    }

    /// What an embedding of these robots that begins now goes on from; none if from the last one.
    ///
    /// Where robots have left and all are back, it is what was known before: the others without them may show another number, which
    /// would be kept with them too, where it is hardly worse.
    pub(crate) fn goes_on_from(&mut self, now: Tick, robots: &[RobotId]) -> Option<KeptShape> {
        if let Some(whole) = &mut self.whole {
            let is_over = |since: Tick| now.since(since) >= ABSENCE_TIME;
            if whole.missing_since.is_some_and(is_over) {
                self.whole = None;
            } else if whole.misses_any(robots) {
                whole.missing_since.get_or_insert(now);
            } else if whole.missing_since.take().is_some() {
                (self.found, self.gathering_since) = (Some(whole.shape), None);
            }
        }
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
        assert_eq!(shape.goes_on_from(at(0), &[]), None, "it follows");
        shape.lead();
        // However long it waits for the first robot.
        for ms in [60_000, 61_000, 61_999] {
            assert_eq!(shape.goes_on_from(at(ms), &[]), Some(found));
        }
        assert_eq!(shape.goes_on_from(at(62_000), &[]), None);
        assert_eq!(shape.newest, Some(found));
    }

    #[test]
    fn robots_that_left_and_are_back_find_what_was_known_of_all() {
        let at = |seconds: u64| Tick(1_000_000).after(Duration::from_secs(seconds));
        let robots =
            |names: &str| names.split(' ').map(|name| RobotId::new(name).unwrap()).collect();
        for (away_s, is_remembered) in [(20, true), (59, true), (60, false)] {
            let mut shape = Shape::default();
            shape.lead();
            let mut makes = |seconds: u64, names: &str, teams: u32| {
                let robots: Vec<RobotId> = robots(names);
                let found = shape.goes_on_from(at(seconds), &robots);
                shape.note_shape(at(seconds), &robots, KeptShape { teams, rank: teams });
                found
            };
            assert_eq!(makes(0, "a b c", 3), None);
            assert_eq!(makes(1, "a b c d", 3), None, "who joins misses none");
            assert_eq!(makes(2, "a d", 2), None);
            assert_eq!(makes(3, "a b d e", 2), None, "c is missing still");
            let back = 2 + away_s;
            let whole = is_remembered.then_some(KeptShape { teams: 3, rank: 3 });
            assert_eq!(makes(back - 1, "a d", 2), None);
            assert_eq!(makes(back, "a b c d e", 3), whole);
            assert_eq!(makes(back + 1, "a b c d e", 3), whole, "they repeat their links");
            assert_eq!(makes(back + 2, "a b c d e", 3), None);
        }
    }
}
