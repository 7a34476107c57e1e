//! The robots that ROS brings: where each runs, and which of its topics is read for each kind of report.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::id::RobotId;
use muster_model::time::Tick;

use crate::config::Content;

/// How long a source must be silent until one that is listed behind it is read. `ingest` refuses a publisher that comes
/// back for 2 s by default, and by then it must not have to do with the other one again.
pub(super) const SWITCH_AFTER: Duration = Duration::from_secs(3);

/// A kind of report, of which `ingest` judges the order by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stream {
    Pose,
    Links,
    Rank,
}

impl Stream {
    /// That of a source; none of transforms.
    pub(super) fn of(content: &Content) -> Option<Self> {
        match content {
            Content::Pose { .. } => Some(Self::Pose),
            Content::Links { .. } => Some(Self::Links),
            Content::Rank { .. } => Some(Self::Rank),
            Content::Transforms { .. } => None,
        }
    }
}

/// The source that last brought a report.
#[derive(Debug, Clone, Copy)]
struct Reader {
    source: usize,
    last: Tick,
}

#[derive(Debug)]
struct Robot {
    /// Its name in ROS, which may have capitals.
    name: String,
    domain: u32,
    /// By stream.
    readers: [Option<Reader>; 3],
}

/// The robots with a topic that has data.
#[derive(Debug, Default)]
pub struct Robots {
    by_id: BTreeMap<RobotId, Robot>,
}

impl Robots {
    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.by_id.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.by_id.is_empty()
    }

    /// Whether ROS has a robot.
    #[must_use]
    pub fn contains(&self, robot: &RobotId) -> bool {
        self.by_id.contains_key(robot)
    }

    /// The robots with their names in ROS.
    pub fn iter(&self) -> impl Iterator<Item = (&RobotId, &str)> {
        self.by_id.iter().map(|(robot, known)| (robot, known.name.as_str()))
    }

    /// The id of a robot of ROS.
    pub(super) fn join(&mut self, name: &str, domain: u32) -> Result<RobotId, String> {
        let robot = RobotId::new(name.to_ascii_lowercase()).map_err(|error| error.to_string())?;
        match self.by_id.get(&robot) {
            Some(known) if known.name != name => {
                let known = &known.name;
                Err(format!("{name} and {known} would both be the robot {robot}; rename one"))
            }
            Some(known) if known.domain != domain => Err(format!(
                "{name} is a robot of domain {} already, and of domain {domain} as well; rename one",
                known.domain
            )),
            Some(_) => Ok(robot),
            None => {
                let known = Robot { name: name.to_owned(), domain, readers: [None; 3] };
                self.by_id.insert(robot.clone(), known);
                Ok(robot)
            }
        }
    }

    /// Whether a source of a robot is read now: no source that is listed before it has brought a report lately.
    pub(super) fn is_read(
        &self,
        now: Tick,
        robot: &RobotId,
        stream: Stream,
        source: usize,
    ) -> bool {
        let reader = self.reader(robot, stream);
        reader.is_none_or(|reader| source <= reader.source || now.since(reader.last) > SWITCH_AFTER)
    }

    /// A source of a robot brought a report.
    pub(super) fn reported(&mut self, now: Tick, robot: &RobotId, stream: Stream, source: usize) {
        if let Some(known) = self.by_id.get_mut(robot) {
            known.readers[stream as usize] = Some(Reader { source, last: now });
        }
    }

    /// Whether a robot has brought a report within a time.
    pub(super) fn has_reported(&self, now: Tick, robot: &RobotId, within: Duration) -> bool {
        let readers = self.by_id.get(robot).into_iter().flat_map(|known| &known.readers);
        readers.flatten().any(|reader| now.since(reader.last) <= within)
    }

    /// Whether a robot has brought a pose within a time.
    pub(super) fn has_posed(&self, now: Tick, robot: &RobotId, within: Duration) -> bool {
        let reader = self.reader(robot, Stream::Pose);
        reader.is_some_and(|reader| now.since(reader.last) <= within)
    }

    /// The source that last brought a kind of report of a robot.
    pub(super) fn source(&self, robot: &RobotId, stream: Stream) -> Option<usize> {
        self.reader(robot, stream).map(|reader| reader.source)
    }

    fn reader(&self, robot: &RobotId, stream: Stream) -> Option<Reader> {
        self.by_id.get(robot)?.readers[stream as usize]
    }

    /// Whether a robot has named its superior itself.
    pub(super) fn has_rank(&self, robot: &RobotId) -> bool {
        self.by_id.get(robot).is_some_and(|known| known.readers[Stream::Rank as usize].is_some())
    }

    /// Drops all robots but some.
    pub(super) fn keep(&mut self, stay: &BTreeSet<&RobotId>) {
        self.by_id.retain(|robot, _| stay.contains(robot));
    }

    /// Domains and names of all robots.
    pub(super) fn places(&self) -> BTreeSet<(u32, &str)> {
        self.by_id.values().map(|known| (known.domain, known.name.as_str())).collect()
    }
}
