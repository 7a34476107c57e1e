//! Who joined the fleet and who left it, by its rosters, and why, by its liveliness tokens.

use std::collections::BTreeSet;

use muster_model::content::Checked;
use muster_model::history::{LeaveReason, Record};
use muster_model::id::RobotId;
use muster_model::limits::MAX_ROBOTS;
use muster_model::roster::Roster;
use muster_model::time::Tick;
use muster_service::{Newest, Recency};

/// The robots of the fleet.
#[derive(Debug, Default)]
pub(crate) struct Fleet {
    roster: Option<Checked<Roster>>,
    newest: Newest,
    /// Robots whose tokens are there, no more than a fleet may have: anybody may declare one.
    tokens: BTreeSet<RobotId>,
}

impl Fleet {
    /// A token appeared or was lost.
    pub(crate) fn token(&mut self, robot: RobotId, alive: bool) {
        if !alive {
            self.tokens.remove(&robot);
        } else if self.tokens.len() < MAX_ROBOTS {
            self.tokens.insert(robot);
        }
    }

    /// Receives a roster. What is returned is to be recorded, robots that left first.
    pub(crate) fn receive(&mut self, now: Tick, roster: Checked<Roster>) -> Vec<Record> {
        if self.newest.receive(now, roster.header.revision) == Recency::Old {
            return Vec::new();
        }
        let Some(last) = &self.roster else {
            self.roster = Some(roster);
            return self.present().into_iter().collect();
        };
        // Both are ordered by name.
        let (mut left, mut joined) = (Vec::new(), Vec::new());
        let (mut old, mut new) = (last.robots.iter().peekable(), roster.robots.iter().peekable());
        loop {
            match (old.peek(), new.peek()) {
                (Some(before), Some(after)) if before.robot == after.robot => {
                    old.next();
                    new.next();
                }
                (Some(before), after) if after.is_none_or(|after| before.robot < after.robot) => {
                    left.push(Record::Left {
                        robot: before.robot.clone(),
                        last_seen: before.last_seen,
                        reason: if self.tokens.contains(&before.robot) {
                            LeaveReason::Silent
                        } else {
                            LeaveReason::Disconnected
                        },
                    });
                    old.next();
                }
                (_, Some(after)) => {
                    joined.push(Record::Joined(after.robot.clone()));
                    new.next();
                }
                (_, None) => break,
            }
        }
        self.roster = Some(roster);
        left.append(&mut joined);
        left
    }

    /// The newest roster.
    pub(crate) fn roster(&self) -> Option<&Roster> {
        self.roster.as_deref()
    }

    /// All robots, if a roster was received.
    pub(crate) fn present(&self) -> Option<Record> {
        let roster = self.roster.as_ref()?;
        Some(Record::Present(roster.robots.iter().map(|entry| entry.robot.clone()).collect()))
    }

    /// How many robots are kept, by roster and by token.
    pub(crate) fn robots(&self) -> usize {
        self.roster.as_ref().map_or(0, |roster| roster.robots.len()) + self.tokens.len()
    }
}
