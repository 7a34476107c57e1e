//! The tree of frames of one robot, or of all: the newest transform of each frame, and chains of them.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::time::Tick;

use super::geometry::Transform;

/// Most frames of one tree. An arm has some dozens; a tree that all robots share has those of each.
pub const MAX_FRAMES: usize = 65_536;

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

/// The newest transform of each frame.
#[derive(Debug, Clone, Default)]
pub struct Frames {
    links: BTreeMap<String, Link>,
}

impl Frames {
    /// A transform arrived. One of a frame that is its own parent, or one frame too many, is left out.
    pub fn receive(
        &mut self,
        now: Tick,
        parent: &str,
        child: &str,
        transform: Transform,
        is_static: bool,
    ) {
        if parent == child || !transform.is_finite() {
            return;
        }
        if let Some(link) = self.links.get_mut(child) {
            (link.transform, link.received, link.is_static) = (transform, now, is_static);
            if link.parent != parent {
                parent.clone_into(&mut link.parent);
            }
        } else if self.links.len() < MAX_FRAMES {
            let parent = parent.to_owned();
            let link = Link { parent, transform, received: now, is_static };
            self.links.insert(child.to_owned(), link);
        }
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
        let mut frames = Frames::default();
        frames.receive(at(1), "earth", "map", shift(100.0), true);
        frames.receive(at(1), "map", "odom", shift(10.0), false);
        frames.receive(at(1), "odom", "base_link", shift(1.0), false);
        frames.receive(at(1), "earth", "utm", shift(7.0), true);
        for (world, expected) in
            [("odom", 1.0), ("map", 11.0), ("earth", 111.0), ("utm", 104.0), ("base_link", 0.0)]
        {
            assert_eq!(x(&frames, at(1), "base_link", world), Ok(expected), "{world}");
        }
        frames.receive(at(2), "map", "odom", shift(20.0), false);
        assert_eq!(x(&frames, at(2), "odom", "map"), Ok(20.0));
        assert_eq!(x(&frames, at(2), "map", "map"), Ok(0.0), "the world itself needs no transform");
    }

    #[test]
    fn a_frame_without_a_chain_and_an_old_one_are_refused() {
        let mut frames = Frames::default();
        frames.receive(at(1), "odom", "base_link", shift(1.0), false);
        let apart = x(&frames, at(1), "base_link", "map").unwrap_err().to_string();
        assert!(
            apart.contains("from the frame base_link to map; the chain ends at odom"),
            "{apart}"
        );
        frames.receive(at(1), "map", "odom", shift(1.0), false);
        let old = x(&frames, at(3), "odom", "map").unwrap_err().to_string();
        assert_eq!(old, "the transform of odom in map is 2.0 s old, more than 1 s");
        frames.receive(at(1), "map", "odom", shift(1.0), true);
        assert!(x(&frames, at(3), "odom", "map").is_ok(), "a static one grows not old");
    }

    #[test]
    fn circles_and_memory_are_bounded() {
        let mut frames = Frames::default();
        frames.receive(at(1), "a", "b", shift(1.0), false);
        frames.receive(at(1), "b", "a", shift(1.0), false);
        frames.receive(at(1), "c", "c", shift(1.0), false);
        assert!(matches!(x(&frames, at(1), "a", "map"), Err(ChainError::Circle(_))));
        assert_eq!(frames.len(), 2, "no frame is its own parent");
        frames.receive(at(1), "map", "lidar", shift(1.0), true);
        frames.forget(at(9), SECOND, None);
        assert_eq!(frames.len(), 1);
        frames.forget(at(9), SECOND, Some(8 * SECOND));
        assert_eq!(frames.len(), 1, "it has eight seconds");
        frames.forget(at(10), SECOND, Some(8 * SECOND));
        assert_eq!(frames.len(), 0, "nor does a static one stay for ever, where it may not");
        frames.receive(at(1), "map", "lidar", shift(1.0), true);
        frames.receive(at(1), "map", "far", shift(f64::NAN), true);
        assert_eq!(frames.len(), 1);
    }
}
