//! From what was put and what was received to how long it took: arithmetic without a bus.

use std::collections::BTreeMap;

use super::drive::Puts;

/// What the frame of a roster holds of one robot: the number of its last pose, and when `ingest`
/// received it.
pub type Newest = Option<(u64, u64)>;

/// A frame of `ingest`, by the moment in which it was made.
pub type Frames = BTreeMap<u64, Vec<Newest>>;

/// When one stage had received its input, and when it published its output.
pub type Stage = (u64, u64);

/// A division that was received. All moments are in microseconds since 1970.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Division {
    /// When it was received.
    pub arrived: u64,
    /// Those of `ingest`, `embedder` and `clusterer`.
    pub stages: [Stage; 3],
    /// When the oldest pose behind it was received by `ingest`.
    pub oldest: Option<u64>,
    /// How many robots it places or knows.
    pub robots: usize,
    /// How many robots have no team.
    pub unassigned: usize,
    /// How many robots are stale.
    pub stale: usize,
}

/// A message on `robot/*/team`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TeamMessage {
    /// When it was received.
    pub arrived: u64,
    /// The robot.
    pub robot: usize,
    /// The frame of the division.
    pub frame: u64,
    /// The team.
    pub team: Option<String>,
}

/// How poses became divisions. All durations are in milliseconds.
#[derive(Debug, Clone, Default)]
pub struct Ways {
    /// From the put of each pose to the first division received that contains it or, where the robot has
    /// put another pose meanwhile, on that one.
    pub whole: Vec<f64>,
    /// Of the poses that a division contains: the same without the time for which `ingest` held the
    /// pose until it made the frame.
    pub beyond: Vec<f64>,
    /// Of these, from the put to `ingest`.
    pub to_ingest: Vec<f64>,
    /// Of these, how long `ingest` held it.
    pub held: Vec<f64>,
    /// Poses that a later one of the same robot replaced before a division rested on them.
    pub superseded: usize,
    /// Poses that no division contains, nor a later one of the same robot.
    pub missing: usize,
}

fn milliseconds(from: u64, to: u64) -> f64 {
    // Moments of two processes on one host: the clock may have been set by some microseconds between.
    (to as f64 - from as f64) / 1e3
}

/// Follows the poses that were put within a window into the divisions, which are in the order of their
/// arrival.
#[must_use]
pub fn follow(puts: &Puts, window: (u64, u64), frames: &Frames, divisions: &[Division]) -> Ways {
    let mut ways = Ways::default();
    let within = |put: &u64| (window.0..window.1).contains(put);
    // The number of the first pose of each robot that no division covers yet.
    let mut next = vec![0; puts.poses.len()];
    for division in divisions {
        let made = division.stages[0].1;
        let Some(frame) = frames.get(&made) else { continue };
        for ((newest, poses), next) in frame.iter().zip(&puts.poses).zip(&mut next) {
            let Some((number, received)) = *newest else { continue };
            let last = usize::try_from(number).unwrap_or(usize::MAX);
            let Some(covered) = poses.get(*next..=last) else { continue };
            for (behind, put) in (0..covered.len()).rev().zip(covered) {
                if !within(put) {
                    continue;
                }
                let whole = milliseconds(*put, division.arrived);
                ways.whole.push(whole);
                if behind > 0 {
                    ways.superseded += 1;
                    continue;
                }
                let held = milliseconds(received, made);
                ways.beyond.push(whole - held);
                ways.to_ingest.push(milliseconds(*put, received));
                ways.held.push(held);
            }
            *next = last + 1;
        }
    }
    let left = puts.poses.iter().zip(next).flat_map(|(poses, next)| poses.iter().skip(next));
    ways.missing = left.filter(|put| within(put)).count();
    ways
}

/// Milliseconds from the put of the newest pose behind a division to the arrival of the message that gives
/// the robot another team than before.
#[must_use]
pub fn follow_changes(puts: &Puts, frames: &Frames, messages: &[TeamMessage]) -> Vec<f64> {
    let mut last: BTreeMap<usize, &Option<String>> = BTreeMap::new();
    let mut ways = Vec::new();
    for message in messages {
        let before = last.insert(message.robot, &message.team);
        if before.is_none_or(|before| *before == message.team) {
            continue;
        }
        let newest = frames.get(&message.frame).and_then(|frame| *frame.get(message.robot)?);
        let put = newest.and_then(|(number, _)| {
            puts.poses.get(message.robot)?.get(usize::try_from(number).ok()?).copied()
        });
        ways.extend(put.map(|put| milliseconds(put, message.arrived)));
    }
    ways
}

#[cfg(test)]
mod tests {
    use super::*;

    fn division(arrived: u64, made: u64) -> Division {
        let stages = [(made, made), (made, made), (made, made)];
        Division { arrived, stages, oldest: None, robots: 2, unassigned: 0, stale: 0 }
    }

    fn puts() -> Puts {
        // Robot 0 puts each 100 ms, robot 1 50 ms later.
        let poses = [0, 50].map(|phase| (0..10).map(|n| (n * 100 + phase) * 1000).collect());
        Puts { poses: poses.into(), messages: 20 }
    }

    #[test]
    fn each_pose_is_followed_to_the_first_division_that_rests_on_it_or_a_later_one() {
        let frames = Frames::from([
            (260_000, vec![Some((2, 201_000)), Some((2, 251_000))]),
            (560_000, vec![Some((5, 501_000)), Some((5, 551_000))]),
        ]);
        let divisions = [division(270_000, 260_000), division(600_000, 560_000)];
        let ways = follow(&puts(), (200_000, 560_000), &frames, &divisions);
        // Poses 0 and 1 lie before the window; 2 of either in the first division, 3 and 4 superseded.
        assert_eq!(ways.whole, [70.0, 20.0, 300.0, 200.0, 100.0, 250.0, 150.0, 50.0]);
        assert_eq!((ways.superseded, ways.missing), (4, 0));
        assert_eq!(ways.held, [59.0, 9.0, 59.0, 9.0]);
        assert_eq!(ways.beyond, [11.0, 11.0, 41.0, 41.0]);
        assert_eq!(ways.to_ingest, [1.0; 4]);
    }

    #[test]
    fn what_no_division_rests_on_is_missing_and_a_repeated_division_counts_once() {
        let frames = Frames::from([(260_000, vec![Some((2, 201_000)), None])]);
        let divisions = [division(270_000, 260_000), division(300_000, 260_000), division(9, 1)];
        let ways = follow(&puts(), (0, 400_000), &frames, &divisions);
        assert_eq!((ways.whole.len(), ways.superseded, ways.missing), (3, 2, 5));
    }

    #[test]
    fn only_changes_of_team_are_followed() {
        let frames = Frames::from([(260_000, vec![Some((2, 201_000)), Some((2, 251_000))])]);
        let message = |arrived, robot, team: &str| TeamMessage {
            arrived,
            robot,
            frame: 260_000,
            team: Some(team.to_owned()),
        };
        let messages = [
            message(1_000, 0, "t1"),
            message(280_000, 0, "t1"),
            message(290_000, 0, "t2"),
            message(290_000, 1, "t2"),
            message(300_000, 1, "t1"),
        ];
        assert_eq!(follow_changes(&puts(), &frames, &messages), [90.0, 50.0]);
    }
}
