//! The tree of frames of one robot, or of all: the newest transform of each frame, and chains of them.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::time::Tick;
use muster_ros::Gid;

use super::geometry::Transform;

/// Most frames of one robot: a humanoid with two hands has about a hundred.
pub const MAX_ROBOT_FRAMES: usize = 1024;

/// Most frames of a tree that all robots share: a dozen of each of 5,000 robots.
pub const MAX_SHARED_FRAMES: usize = 65_536;

/// Longest chain from a frame to its root.
pub const MAX_CHAIN: usize = 64;

/// How a frame lies in its parent.
#[derive(Debug, Clone, PartialEq)]
struct Link {
    parent: String,
    transform: Transform,
    received: Tick,
    /// Whether it holds for good.
    is_static: bool,
    /// Which message of which publisher it came with; none with a bridge of DDS, which numbers none.
    number: Option<Number>,
}

/// Which message of which publisher a transform came with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Number {
    /// The publisher.
    pub publisher: Gid,
    /// Grows with each of its messages.
    pub sequence: i64,
}

impl Number {
    /// Whether a message of the same publisher came before another one. Of different publishers nothing is known.
    fn is_before(self, other: Self) -> bool {
        self.publisher == other.publisher && self.sequence < other.sequence
    }
}

/// Why there is no way from a frame to the world.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ChainError {
    /// No chain joins both.
    #[error(
        "no transforms lead from the frame {frame} to {world}; the chain ends at {end}. Is the localisation of the robot \
         running, and are its tf topics configured?"
    )]
    Apart {
        /// The frame of the pose.
        frame: String,
        /// The frame of the fleet.
        world: String,
        /// Where the chain ends.
        end: String,
    },
    /// A transform of the chain is too old.
    #[error("the transform of {frame} in {parent} is {age_s:.1} s old, more than {limit_s} s")]
    Old {
        /// The frame.
        frame: String,
        /// Its parent.
        parent: String,
        /// How old it is.
        age_s: f64,
        /// How old it may be.
        limit_s: f64,
    },
    /// Frames are parents of each other.
    #[error("the transforms of {0} form a circle, or a chain of more than {MAX_CHAIN}")]
    Circle(String),
}

/// A tree has as many frames as it may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("more than {0} frames in one tree are not taken")]
pub struct TooManyFrames(usize);

/// The newest transform of each frame.
#[derive(Debug, Clone)]
pub struct Frames {
    links: BTreeMap<String, Link>,
    limit: usize,
}

impl Frames {
    /// A tree without frames, which may have so many.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self { links: BTreeMap::new(), limit }
    }

    /// A transform arrived. One of a frame that is its own parent is left out, and so is one that was put before another one
    /// of its publisher that has arrived already.
    ///
    /// # Errors
    /// If the frame is new and one too many.
    pub fn receive(
        &mut self,
        now: Tick,
        parent: &str,
        child: &str,
        transform: Transform,
        is_static: bool,
        number: Option<Number>,
    ) -> Result<(), TooManyFrames> {
        if parent == child || !transform.is_finite() {
            return Ok(());
        }
        if let Some(link) = self.links.get_mut(child) {
            if number.zip(link.number).is_some_and(|(new, last)| new.is_before(last)) {
                return Ok(());
            }
            (link.transform, link.received, link.is_static) = (transform, now, is_static);
            link.number = number;
            if link.parent != parent {
                parent.clone_into(&mut link.parent);
            }
        } else if self.links.len() >= self.limit {
            return Err(TooManyFrames(self.limit));
        } else {
            let parent = parent.to_owned();
            let link = Link { parent, transform, received: now, is_static, number };
            self.links.insert(child.to_owned(), link);
        }
        Ok(())
    }

    /// How a frame lies in the world, by the newest transforms.
    ///
    /// # Errors
    /// If no chain joins them, or one of its transforms is older than it may be.
    pub fn chain(
        &self,
        now: Tick,
        frame: &str,
        world: &str,
        max_age: Duration,
    ) -> Result<Transform, ChainError> {
        let up = self.ancestors(frame)?;
        // Mostly the world is above the frame.
        if let Some(at) = up.iter().position(|name| *name == world) {
            return self.down(now, &up[..at], max_age);
        }
        let across = self.ancestors(world)?;
        let joint = up.iter().position(|name| across.contains(name));
        let Some((own, joint)) = joint.map(|at| (at, up[at])) else {
            return Err(ChainError::Apart {
                frame: frame.to_owned(),
                world: world.to_owned(),
                end: up.last().map_or_else(|| frame.to_owned(), |end| (*end).to_owned()),
            });
        };
        let other = across.iter().position(|name| *name == joint).unwrap_or_default();
        let own = self.down(now, &up[..own], max_age)?;
        let world = self.down(now, &across[..other], max_age)?;
        Ok(own.within(world.inverse()))
    }

    /// A frame, its parent, and so on up to the root.
    fn ancestors<'a>(&'a self, frame: &'a str) -> Result<Vec<&'a str>, ChainError> {
        let mut names = vec![frame];
        let mut last = frame;
        while let Some(link) = self.links.get(last) {
            if names.len() > MAX_CHAIN {
                return Err(ChainError::Circle(frame.to_owned()));
            }
            last = &link.parent;
            names.push(last);
        }
        Ok(names)
    }

    /// How the first of some frames lies in the parent of the last, each of which is the parent of the one before.
    fn down(&self, now: Tick, frames: &[&str], max_age: Duration) -> Result<Transform, ChainError> {
        let mut whole = Transform::IDENTITY;
        for frame in frames {
            let Some(link) = self.links.get(*frame) else { continue };
            let age = now.since(link.received);
            if !link.is_static && age > max_age {
                return Err(ChainError::Old {
                    frame: (*frame).to_owned(),
                    parent: link.parent.clone(),
                    age_s: age.as_secs_f64(),
                    limit_s: max_age.as_secs_f64(),
                });
            }
            whole = whole.within(link.transform);
        }
        Ok(whole)
    }

    /// Drops what is older than an age, so that frames of robots that are gone take no memory. Static ones have an age of
    /// their own, or stay.
    pub fn forget(&mut self, now: Tick, age: Duration, static_age: Option<Duration>) {
        self.links.retain(|_, link| {
            let age = if link.is_static { static_age } else { Some(age) };
            age.is_none_or(|age| now.since(link.received) <= age)
        });
    }

    /// How many frames have a transform.
    #[must_use]
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Whether no frame has one.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::Rotation;

    const SECOND: Duration = Duration::from_secs(1);

    fn shift(x: f64) -> Transform {
        Transform { translation: [x, 0.0, 0.0], rotation: Rotation::IDENTITY }
    }

    fn at(seconds: u64) -> Tick {
        Tick(0).after(Duration::from_secs(seconds))
    }

    fn x(frames: &Frames, now: Tick, frame: &str, world: &str) -> Result<f64, ChainError> {
        frames.chain(now, frame, world, SECOND).map(|transform| transform.translation[0])
    }

    #[test]
    fn the_newest_chain_leads_to_the_world_wherever_that_is() {
        let mut frames = Frames::new(MAX_ROBOT_FRAMES);
        frames.receive(at(1), "earth", "map", shift(100.0), true, None).unwrap();
        frames.receive(at(1), "map", "odom", shift(10.0), false, None).unwrap();
        frames.receive(at(1), "odom", "base_link", shift(1.0), false, None).unwrap();
        frames.receive(at(1), "earth", "utm", shift(7.0), true, None).unwrap();
        for (world, expected) in
            [("odom", 1.0), ("map", 11.0), ("earth", 111.0), ("utm", 104.0), ("base_link", 0.0)]
        {
            assert_eq!(x(&frames, at(1), "base_link", world), Ok(expected), "{world}");
        }
        frames.receive(at(2), "map", "odom", shift(20.0), false, None).unwrap();
        assert_eq!(x(&frames, at(2), "odom", "map"), Ok(20.0));
        assert_eq!(x(&frames, at(2), "map", "map"), Ok(0.0), "the world itself needs no transform");
    }

    #[test]
    fn turns_and_shifts_of_a_chain_follow_one_another_from_the_frame_to_the_world() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let quarter = |axis: usize| {
            let mut turn = [0.0, 0.0, 0.0, half];
            turn[axis] = half;
            Rotation::new(turn).unwrap()
        };
        let mut frames = Frames::new(MAX_ROBOT_FRAMES);
        let odom = Transform { translation: [100.0, 0.0, 0.0], rotation: quarter(2) };
        let base = Transform { translation: [0.0, 10.0, 0.0], rotation: quarter(0) };
        frames.receive(at(1), "map", "odom", odom, false, None).unwrap();
        frames.receive(at(1), "odom", "base_link", base, false, None).unwrap();
        let near = |frame: &str, world: &str, expected: [f64; 3]| {
            let chain = frames.chain(at(1), frame, world, SECOND).unwrap();
            let point = Transform { translation: [1.0, 2.0, 3.0], rotation: Rotation::IDENTITY };
            let found = point.within(chain).translation;
            let is_near = (0..3).all(|axis| (found[axis] - expected[axis]).abs() < 1e-9);
            assert!(is_near, "{frame} in {world}: {found:?} is not {expected:?}");
        };
        // About x, a quarter turn takes y to z and z to -y: (1, -3, 2), shifted to (1, 7, 2). About z, it takes x to y and y
        // to -x: (-7, 1, 2), shifted to (93, 1, 2).
        near("base_link", "odom", [1.0, 7.0, 2.0]);
        near("base_link", "map", [93.0, 1.0, 2.0]);
        // And back: (-99, 2, 3) turned to (2, 99, 3), (2, 89, 3) turned to (2, 3, -89).
        near("map", "base_link", [2.0, 3.0, -89.0]);
    }

    #[test]
    fn a_frame_without_a_chain_and_an_old_one_are_refused() {
        let mut frames = Frames::new(MAX_ROBOT_FRAMES);
        frames.receive(at(1), "odom", "base_link", shift(1.0), false, None).unwrap();
        let apart = x(&frames, at(1), "base_link", "map").unwrap_err().to_string();
        assert!(
            apart.contains("from the frame base_link to map; the chain ends at odom"),
            "{apart}"
        );
        frames.receive(at(1), "map", "odom", shift(1.0), false, None).unwrap();
        let old = x(&frames, at(3), "odom", "map").unwrap_err().to_string();
        assert_eq!(old, "the transform of odom in map is 2.0 s old, more than 1 s");
        frames.receive(at(1), "map", "odom", shift(1.0), true, None).unwrap();
        assert!(x(&frames, at(3), "odom", "map").is_ok(), "a static one grows not old");
    }

    #[test]
    fn circles_and_memory_are_bounded() {
        let mut frames = Frames::new(MAX_ROBOT_FRAMES);
        frames.receive(at(1), "a", "b", shift(1.0), false, None).unwrap();
        frames.receive(at(1), "b", "a", shift(1.0), false, None).unwrap();
        frames.receive(at(1), "c", "c", shift(1.0), false, None).unwrap();
        assert!(matches!(x(&frames, at(1), "a", "map"), Err(ChainError::Circle(_))));
        assert_eq!(frames.len(), 2, "no frame is its own parent");
        frames.receive(at(1), "map", "lidar", shift(1.0), true, None).unwrap();
        frames.forget(at(9), SECOND, None);
        assert_eq!(frames.len(), 1);
        frames.forget(at(9), SECOND, Some(8 * SECOND));
        assert_eq!(frames.len(), 1, "it has eight seconds");
        frames.forget(at(10), SECOND, Some(8 * SECOND));
        assert_eq!(frames.len(), 0, "nor does a static one stay for ever, where it may not");
        frames.receive(at(1), "map", "lidar", shift(1.0), true, None).unwrap();
        frames.receive(at(1), "map", "far", shift(f64::NAN), true, None).unwrap();
        assert_eq!(frames.len(), 1);
    }

    #[test]
    fn a_transform_that_comes_late_replaces_no_newer_one_of_its_publisher() {
        let number =
            |publisher: u8, sequence| Some(Number { publisher: Gid([publisher; 16]), sequence });
        let mut frames = Frames::new(MAX_ROBOT_FRAMES);
        let mut put = |seconds, shifted, number| {
            frames.receive(at(seconds), "map", "odom", shift(shifted), false, number).unwrap();
            x(&frames, at(seconds), "odom", "map").unwrap()
        };
        assert_eq!(put(1, 1.0, number(1, 5)), 1.0);
        assert_eq!(put(1, 2.0, number(1, 4)), 1.0, "it was put before");
        assert_eq!(put(1, 3.0, number(1, 5)), 3.0, "a kept one comes again");
        assert_eq!(put(1, 4.0, number(1, 6)), 4.0);
        assert_eq!(put(1, 5.0, number(2, 1)), 5.0, "another publisher counts by itself");
        assert_eq!(put(1, 6.0, None), 6.0);
        assert_eq!(put(1, 7.0, number(1, 1)), 7.0);
    }

    #[test]
    fn a_late_transform_makes_none_younger() {
        let number = |sequence| Some(Number { publisher: Gid([1; 16]), sequence });
        let mut frames = Frames::new(MAX_ROBOT_FRAMES);
        frames.receive(at(1), "map", "odom", shift(1.0), false, number(5)).unwrap();
        frames.receive(at(3), "map", "odom", shift(1.0), false, number(4)).unwrap();
        assert!(matches!(x(&frames, at(3), "odom", "map"), Err(ChainError::Old { .. })));
    }
}
