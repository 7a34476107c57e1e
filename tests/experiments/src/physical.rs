//! The physical case: ten robots in four layouts under a camera, as in the paper's case study, and what the camera
//! has seen of them.
//!
//! There are no robots and no camera here. A recording is what a camera above marked robots would report: at
//! [`RATE_HZ`], each place off by [`JITTER_M`] (standard deviation along each axis), a mark not recognised in
//! [`MISSED_SHARE`] of all cases and a whole picture lost in [`DROPPED_SHARE`]. Recordings are files, so every run
//! replays the same; `muster-experiments record` makes them again from their seeds.

use std::fmt::Write as _;

use anyhow::Context as _;
use muster_model::observation::Links;
use muster_scenario::{Fleet, FleetOptions, Layout};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::seeds::held_out;

/// The layouts with their recordings. How robots command each other follows the paper's rule, within teams that
/// are known: the robot of a team that is nearest to the middle of all leads it, and the nearest of the leaders
/// leads them.
const FILES: [(&str, &str); 4] = [
    (
        include_str!("../physical/corners.json"),
        include_str!("../physical/recordings/corners.jsonl"),
    ),
    (include_str!("../physical/row.json"), include_str!("../physical/recordings/row.jsonl")),
    (include_str!("../physical/ring.json"), include_str!("../physical/recordings/ring.jsonl")),
    (include_str!("../physical/mixed.json"), include_str!("../physical/recordings/mixed.jsonl")),
];

/// Pictures per second.
pub const RATE_HZ: f64 = 10.0;

/// How far a place is off, as the standard deviation along each axis in metres: a mark of a few centimetres under
/// a camera at the ceiling.
pub const JITTER_M: f64 = 0.01;

/// Share of marks that are not recognised in a picture.
pub const MISSED_SHARE: f64 = 0.02;

/// Share of pictures that are lost as a whole.
pub const DROPPED_SHARE: f64 = 0.01;

/// Pictures of a recording: ten seconds.
const PICTURES: u32 = 100;

/// Mean range of a radio in metres: half of the room.
pub const RADIO_RANGE_M: f64 = 2.0;

/// What a recording begins with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// The layout.
    pub layout: String,
    /// From which all chance follows.
    pub seed: u64,
    /// See [`RATE_HZ`].
    pub rate_hz: f64,
    /// See [`JITTER_M`].
    pub jitter_m: f64,
    /// See [`MISSED_SHARE`].
    pub missed: f64,
    /// See [`DROPPED_SHARE`].
    pub dropped: f64,
}

/// What the camera has seen at one moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Picture {
    /// Seconds from the beginning.
    pub t: f64,
    /// Metres east and north of each robot of the layout, in its order; none where its mark was not recognised.
    pub at: Vec<Option<[f64; 2]>>,
}

/// What the camera has seen of a layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Its first line.
    pub head: Head,
    /// All others; what is lost is not there.
    pub pictures: Vec<Picture>,
}

/// A layout with its recording.
#[derive(Debug, Clone)]
pub struct Case {
    /// The content of its file.
    pub layout: Layout,
    /// From which all chance follows.
    pub seed: u64,
    /// The text of its file.
    recording: &'static str,
}

impl Case {
    /// All of them.
    ///
    /// # Errors
    /// If a file is none.
    pub fn all() -> anyhow::Result<Vec<Self>> {
        let seeds = held_out(FILES.len());
        let read = |((layout, recording), seed): (&(&str, &'static str), u64)| {
            Ok(Self { layout: Layout::read(layout)?, seed, recording })
        };
        FILES.iter().zip(seeds).map(read).collect()
    }

    /// The recording of its file.
    ///
    /// # Errors
    /// Names the line that is wrong.
    pub fn recording(&self) -> anyhow::Result<Recording> {
        Recording::read(self.recording).with_context(|| self.layout.name.clone())
    }

    /// The fleet of the layout, with the noise of the camera.
    ///
    /// # Errors
    /// If there is none.
    pub fn fleet(&self) -> anyhow::Result<Fleet> {
        let options = FleetOptions {
            seed: self.seed,
            noise_m: JITTER_M,
            radio_range_m: RADIO_RANGE_M,
            ..FleetOptions::default()
        };
        Ok(Fleet::of_layout(&self.layout, options)?)
    }

    /// The incoming links of each robot.
    ///
    /// # Errors
    /// If there is no fleet.
    pub fn links(&self) -> anyhow::Result<Vec<Links>> {
        Ok(self.fleet()?.links(0.0))
    }

    /// Makes the recording from its seed.
    ///
    /// # Errors
    /// If there is no fleet.
    pub fn record(&self) -> anyhow::Result<Recording> {
        let fleet = self.fleet()?;
        let mut chance = ChaCha8Rng::seed_from_u64(self.seed);
        let mut pictures = Vec::new();
        for number in 0..PICTURES {
            let t = f64::from(number) / RATE_HZ;
            let is_dropped = chance.random::<f64>() < DROPPED_SHARE;
            let seen: Vec<bool> =
                fleet.robots().iter().map(|_| chance.random::<f64>() >= MISSED_SHARE).collect();
            let millimetres = |metres: f64| (1e3 * metres).round() / 1e3;
            let places = fleet
                .poses(t)
                .into_iter()
                .zip(seen)
                .map(|(pose, is_seen)| is_seen.then(|| [pose.x, pose.y].map(millimetres)));
            if !is_dropped {
                pictures.push(Picture { t, at: places.collect() });
            }
        }
        let head = Head {
            layout: self.layout.name.clone(),
            seed: self.seed,
            rate_hz: RATE_HZ,
            jitter_m: JITTER_M,
            missed: MISSED_SHARE,
            dropped: DROPPED_SHARE,
        };
        Ok(Recording { head, pictures })
    }
}

impl Recording {
    /// Reads lines of JSON: the head, and a line for each picture.
    ///
    /// # Errors
    /// Names the line that is wrong.
    pub fn read(text: &str) -> anyhow::Result<Self> {
        let mut lines = text.lines();
        let head = serde_json::from_str(lines.next().unwrap_or_default()).context("line 1")?;
        let pictures = lines.enumerate().map(|(at, line)| {
            serde_json::from_str(line).with_context(|| format!("line {}", at + 2))
        });
        Ok(Self { head, pictures: pictures.collect::<anyhow::Result<_>>()? })
    }

    /// Writes lines of JSON, as they are read.
    ///
    /// # Errors
    /// If a number has no JSON.
    pub fn text(&self) -> anyhow::Result<String> {
        let mut text = String::new();
        writeln!(text, "{}", serde_json::to_string(&self.head)?)?;
        for picture in &self.pictures {
            writeln!(text, "{}", serde_json::to_string(picture)?)?;
        }
        Ok(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_four_layouts_of_ten_robots_in_three_teams() {
        let all = Case::all().unwrap();
        assert_eq!(all.len(), 4);
        for case in all {
            let layout = &case.layout;
            assert_eq!((layout.robots.len(), layout.divisions.len()), (10, 1), "{}", layout.name);
            assert_eq!(layout.teams(0), 3);
            assert!(layout.divisions[0].iter().all(Option::is_some));
            assert_eq!(layout.superiors.iter().filter(|superior| superior.is_none()).count(), 1);
            // Only leaders answer to another team.
            for (robot, superior) in layout.superiors.iter().enumerate() {
                let team = |robot: usize| layout.divisions[0][robot];
                let leads = layout.superiors.contains(&Some(robot));
                assert!(leads || superior.is_some_and(|superior| team(superior) == team(robot)));
            }
            assert!(case.links().unwrap().iter().all(|links| !links.links.is_empty()));
        }
    }

    #[test]
    fn recordings_are_those_of_their_seeds_and_small() {
        let mut bytes = 0;
        for case in Case::all().unwrap() {
            let recording = case.record().unwrap();
            let name = &case.layout.name;
            assert!(case.recording().unwrap() == recording, "{name}: make it again by `record`");
            assert!(case.recording == recording.text().unwrap(), "{name} reads back otherwise");
            assert_eq!(recording.head.layout, case.layout.name);
            bytes += case.recording.len();
        }
        assert!(bytes < 100_000, "{bytes}");
    }

    #[test]
    fn the_camera_is_as_bad_as_its_numbers() {
        let (mut off, mut missed, mut marks, mut pictures) = (Vec::new(), 0, 0, 0);
        for case in Case::all().unwrap() {
            let recording = case.recording().unwrap();
            pictures += recording.pictures.len();
            for picture in recording.pictures {
                marks += picture.at.len();
                for (at, place) in picture.at.iter().zip(&case.layout.places) {
                    match at {
                        Some(at) => off.extend([at[0] - place[0], at[1] - place[1]]),
                        None => missed += 1,
                    }
                }
            }
        }
        let deviation = (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt();
        assert!((deviation - JITTER_M).abs() < 0.001, "{deviation}");
        let share = f64::from(missed) / marks as f64;
        assert!((share - MISSED_SHARE).abs() < 0.01, "{share}");
        assert!((380..=399).contains(&pictures), "{pictures}");
        assert!(Recording::read("{}").is_err());
    }
}
