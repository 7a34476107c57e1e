//! Which positions of robots are worth a record: in a fleet that moves they change with every frame.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::history::PositionsRecord;
use muster_model::id::RobotId;
use muster_model::roster::Roster;
use muster_model::time::Tick;

/// How often all positions are recorded, so that old ones can be forgotten and a moment rests on two records.
const WHOLE_INTERVAL: Duration = Duration::from_secs(3600);

/// How far a robot is from where it was recorded before it is recorded again, in centimetres along an axis: what noise
/// moves is not worth a row.
const MOVED_CM: u64 = 50;

/// Centimetres of a metre.
const CENTIMETRES: f64 = 100.0;

/// The positions as they are recorded.
#[derive(Debug, Default)]
pub(crate) struct Positions {
    /// Those of the last whole record.
    whole: BTreeMap<RobotId, [i64; 2]>,
    /// Those of the last record that differ from it.
    moved: Vec<(RobotId, [i64; 2])>,
    /// When they were last recorded as a whole.
    whole_at: Option<Tick>,
    /// When positions were last looked at.
    looked_at: Option<Tick>,
}

impl Positions {
    /// What is to be recorded of a roster now; none if that was done less than an interval ago, or robots are where they
    /// were recorded.
    pub(crate) fn take(
        &mut self,
        now: Tick,
        interval: Duration,
        roster: &Roster,
    ) -> Option<PositionsRecord> {
        let is_early = self.looked_at.is_some_and(|at| at <= now && now.since(at) < interval);
        if interval.is_zero() || is_early {
            return None;
        }
        self.looked_at = Some(now);
        let present: BTreeMap<RobotId, [i64; 2]> = roster
            .robots
            .iter()
            .filter_map(|entry| Some((entry.robot.clone(), entry.position.map(centimetres)?)))
            .collect();
        let has_moved = |(robot, at): &(&RobotId, &[i64; 2])| {
            self.whole.get(*robot).is_none_or(|before| is_far(before, at))
        };
        let mut moved: Vec<_> =
            present.iter().filter(has_moved).map(|(robot, at)| (robot.clone(), *at)).collect();
        let is_old = self.whole_at.is_none_or(|at| at > now || now.since(at) >= WHOLE_INTERVAL);
        if !present.is_empty() && (is_old || 2 * moved.len() > present.len()) {
            self.whole_at = Some(now);
            self.whole.clone_from(&present);
            self.moved.clear();
            return Some(PositionsRecord { is_whole: true, robots: present.into_iter().collect() });
        }
        // What noise moves stays where it was recorded.
        for (robot, at) in &mut moved {
            let known = self.moved.binary_search_by(|(other, _)| other.cmp(robot));
            if let Some((_, before)) = known.ok().map(|place| &self.moved[place])
                && !is_far(before, at)
            {
                *at = *before;
            }
        }
        if moved == self.moved {
            return None;
        }
        self.moved.clone_from(&moved);
        Some(PositionsRecord { is_whole: false, robots: moved })
    }

    /// Records were lost: the next one is whole, since it could rest on one of them.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// How many robots are kept.
    pub(crate) fn robots(&self) -> usize {
        self.whole.len() + self.moved.len()
    }
}

/// Whether two places are further from each other than noise.
fn is_far(left: &[i64; 2], right: &[i64; 2]) -> bool {
    left.iter().zip(right).any(|(left, right)| left.abs_diff(*right) > MOVED_CM)
}

/// Centimetres east and north.
#[expect(clippy::cast_possible_truncation, reason = "a coordinate is far below the largest number")]
fn centimetres([east, north, _]: [f64; 3]) -> [i64; 2] {
    [east, north].map(|metres| (metres * CENTIMETRES).round() as i64)
}
