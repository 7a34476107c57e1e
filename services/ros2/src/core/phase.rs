//! When the newest of each robot is put: shortly before `ingest` makes its next frame, so that no pose waits for two ticks.
//!
//! `ingest` makes a frame as soon as something has changed, but so many times a second at most. Without this, poses that are
//! put a moment after a frame wait for the whole next tick of `ingest`, after they have waited for that of the bridge. A
//! roster says when its robots last reported and when its frame was made, both by the clock of the host of `ingest`: the
//! difference is by how much the poses came too early.

use std::time::Duration;

use muster_model::roster::Roster;
use muster_model::time::Tick;

use super::robots::Robots;

/// How long before a frame the last pose should be there. It covers how much the way from here to `ingest` varies on a network
/// that is not busy.
const MARGIN: Duration = Duration::from_millis(2);

/// The part of an error by which the next tick comes later. Coming too late costs a whole tick of `ingest`, so that it is
/// approached slowly.
const LATER_BY: f64 = 0.1;

/// By how many margins the next tick comes sooner after poses that came with, or after, the frame: on a busy machine, where that
/// happens again and again, they come the earlier for it.
const SOONER_BY: f64 = 1.5;

/// The part of a tick by which one tick is moved at most: a robot is never put twice in quick succession.
const MOST_SHIFT: f64 = 0.25;

/// What was seen of the last roster.
#[derive(Debug, Default)]
pub(super) struct Phase {
    /// When the newest report of a robot was received, by the clock of `ingest`.
    newest: Tick,
}

impl Phase {
    /// By how many seconds the next tick should come later, or sooner if that is negative; none if a roster says nothing
    /// new of it.
    pub(super) fn shift(
        &mut self,
        every: Duration,
        roster: &Roster,
        robots: &Robots,
    ) -> Option<f64> {
        let made = roster.header.stages.first()?.published;
        let ours = roster.robots.iter().filter(|entry| robots.contains(&entry.robot));
        let newest = ours.map(|entry| entry.last_seen).max()?;
        // Frames between two ticks rest on what was put at the last one.
        if std::mem::replace(&mut self.newest, newest) >= newest {
            return None;
        }
        let every = every.as_secs_f64();
        let early = made.since(newest).as_secs_f64() - MARGIN.as_secs_f64();
        // Where frames are rarer than ticks, those in between do not count.
        let early = if early > every { early % every } else { early };
        let shift = match early {
            // Another frame is nearer.
            _ if early > every / 2.0 => early - every,
            _ if early > -0.5 * MARGIN.as_secs_f64() => early * LATER_BY,
            _ => -SOONER_BY * MARGIN.as_secs_f64(),
        };
        Some(shift.clamp(-every * MOST_SHIFT, every * MOST_SHIFT))
    }
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision, StageTime};
    use muster_model::id::{FleetId, ServiceName};
    use muster_model::roster::RosterEntry;

    use super::*;

    const EVERY: Duration = Duration::from_millis(100);

    fn robots() -> Robots {
        let mut robots = Robots::default();
        robots.join("r1", 0).unwrap();
        robots
    }

    /// A roster of a frame, in microseconds, with the last sign of life of each robot.
    fn roster(made: u64, seen: &[(&str, u64)]) -> Roster {
        let entry = |(name, last_seen): &(&str, u64)| {
            RosterEntry::active(0, name.parse().unwrap(), Tick(*last_seen))
        };
        let published = Tick(made);
        let stage = StageTime { stage: ServiceName::Ingest, received: published, published };
        let header = Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: vec![stage],
        };
        Roster { header, robots: seen.iter().map(entry).collect(), graphs: Vec::new() }
    }

    #[test]
    fn poses_come_to_lie_shortly_before_the_frame_from_every_beginning() {
        for begin in (0..100_000_u64).step_by(1_000) {
            let mut phase = Phase::default();
            // Frames of `ingest` are a little more than a tick apart.
            let (mut put, mut next_put) = (1_000_000 + begin, 1_100_000 + begin);
            let mut margins = Vec::new();
            for frame in (1_100_000_u64..).step_by(100_200).take(300) {
                while next_put <= frame {
                    (put, next_put) = (next_put, next_put + 100_000);
                }
                let Some(shift) = phase.shift(EVERY, &roster(frame, &[("r1", put)]), &robots())
                else {
                    continue;
                };
                assert!(shift.abs() <= 0.025 + 1e-9, "{shift}");
                margins.push(frame - put);
                next_put = next_put.saturating_add_signed((shift * 1e6) as i64);
            }
            let settled = &margins[margins.len() - 100..];
            assert!(settled.iter().all(|margin| (1_000..9_000).contains(margin)), "{settled:?}");
        }
    }

    #[test]
    fn only_new_reports_of_the_bridge_s_own_robots_count() {
        let (mut phase, robots) = (Phase::default(), robots());
        let mut shift =
            |made, seen: &[(&str, u64)]| phase.shift(EVERY, &roster(made, seen), &robots);
        assert_eq!(shift(2_000_000, &[("other", 1_990_000)]), None);
        let later = shift(2_000_000, &[("other", 1_999_000), ("r1", 1_977_000)]).unwrap();
        assert!((later - 0.0021).abs() < 1e-9, "{later}");
        assert_eq!(shift(2_100_000, &[("r1", 1_977_000)]), None, "nothing was put in between");
        let sooner = shift(2_100_000, &[("r1", 2_100_000)]).unwrap();
        assert!((sooner + 0.003).abs() < 1e-9, "it was hardly in time: {sooner}");
        let next = shift(2_300_000, &[("r1", 2_208_000)]).unwrap();
        assert!((next + 0.010).abs() < 1e-9, "it has just missed the frame before: {next}");
    }
}
