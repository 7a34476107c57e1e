//! What an observer has seen, and what can be measured in it.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::client::{Division, division, is_event_of_robots, robots_of_event};

/// One line of an observer.
#[derive(Debug, Clone)]
pub struct Seen {
    /// When it arrived, in seconds since 1970.
    pub at: f64,
    /// Where: a key of the fleet, or `get` for an answer to a get of the division.
    pub key: String,
    /// What; null where a get was not answered.
    pub value: Value,
    /// For a pose, how many seconds it was on its way.
    pub late: Option<f64>,
}

/// Everything that an observer has seen, in order.
#[derive(Debug, Clone, Default)]
pub struct Record(Vec<Seen>);

impl Record {
    /// Reads the lines of an observer; a last line that is not yet whole is left out.
    #[must_use]
    pub fn read(lines: &str) -> Self {
        let seen = lines.lines().filter_map(|line| {
            let mut value: Value = serde_json::from_str(line).ok()?;
            Some(Seen {
                at: value["at"].as_f64()?,
                key: value["key"].as_str()?.to_owned(),
                late: value["late"].as_f64(),
                value: value["value"].take(),
            })
        });
        Self(seen.collect())
    }

    fn of<'a>(&'a self, key: &'a str, since: f64) -> impl DoubleEndedIterator<Item = &'a Seen> {
        self.0.iter().filter(move |seen| seen.key == key && seen.at >= since)
    }

    /// The divisions that were published since a moment.
    pub fn teams(&self, since: f64) -> impl DoubleEndedIterator<Item = &Seen> {
        self.of("json/teams", since).filter(|seen| seen.value["teams"].is_array())
    }

    /// How many messages came by the key of another since a moment. Zenoh has been seen to do so after a
    /// router hung and its clients had reconnected meanwhile.
    #[must_use]
    pub fn misplaced(&self, since: f64) -> usize {
        let teams = self.of("json/teams", since).filter(|seen| !seen.value["teams"].is_array());
        let events = self.of("json/event", since).filter(|seen| !seen.value["event"].is_string());
        teams.count() + events.count()
    }

    /// When the first event of a name was seen since a moment.
    #[must_use]
    pub fn first_event(&self, name: &str, since: f64) -> Option<f64> {
        self.of("json/event", since)
            .find(|seen| is_event_of_robots(&seen.value, name))
            .map(|seen| seen.at)
    }

    /// When the last event of a name was seen since a moment.
    #[must_use]
    pub fn last_event(&self, name: &str, since: f64) -> Option<f64> {
        self.of("json/event", since)
            .rfind(|seen| is_event_of_robots(&seen.value, name))
            .map(|seen| seen.at)
    }

    /// The robots that events of a name are about, since a moment.
    #[must_use]
    pub fn robots_of(&self, name: &str, since: f64) -> BTreeSet<String> {
        let events =
            self.of("json/event", since).filter(|seen| is_event_of_robots(&seen.value, name));
        events.flat_map(|seen| robots_of_event(&seen.value)).collect()
    }

    /// When a division was published for the first time since a moment that is the wanted one, has no
    /// stale robot, and was computed from nothing measured before that moment.
    #[must_use]
    pub fn whole(&self, wanted: &Division, since: f64) -> Option<f64> {
        let whole = |seen: &&Seen| {
            let age = seen.value["data_age_s"].as_f64();
            age.is_some_and(|age| seen.at - age >= since)
                && seen.value["stale"].as_array().is_some_and(Vec::is_empty)
                && division(&seen.value) == *wanted
        };
        self.teams(since).find(whole).map(|seen| seen.at)
    }

    /// The longest time without a division between two moments.
    #[must_use]
    pub fn longest_pause(&self, from: f64, to: f64) -> f64 {
        let times = self.teams(from).map(|seen| seen.at).take_while(|at| *at < to);
        let (longest, last) =
            times.fold((0.0_f64, from), |(longest, last), at| (longest.max(at - last), at));
        longest.max(to - last)
    }

    /// The greatest age of the data behind a division that was published between two moments.
    #[must_use]
    pub fn oldest_data(&self, from: f64, to: f64) -> f64 {
        let teams = self.teams(from).take_while(|seen| seen.at < to);
        teams.filter_map(|seen| seen.value["data_age_s"].as_f64()).fold(0.0, f64::max)
    }

    /// How long the poses that arrived between two moments were on their way, sorted; those of some
    /// robots left out.
    #[must_use]
    pub fn lateness(&self, from: f64, to: f64, without: &BTreeSet<String>) -> Vec<f64> {
        let counts = |seen: &&Seen| {
            let robot = seen.key.split('/').nth(1).unwrap_or_default();
            (from..to).contains(&seen.at) && !without.contains(robot)
        };
        let mut late: Vec<_> = self.0.iter().filter(counts).filter_map(|seen| seen.late).collect();
        late.sort_by(f64::total_cmp);
        late
    }

    /// How many gets that were asked between two moments were answered with a division, and how many
    /// were asked.
    #[must_use]
    pub fn answered(&self, from: f64, to: f64) -> (usize, usize) {
        let asked = self.of("get", from).take_while(|seen| seen.at < to);
        asked.fold((0, 0), |(answered, asked), seen| {
            (answered + usize::from(seen.value["teams"].is_array()), asked + 1)
        })
    }

    /// Everything published since a moment that puts a robot elsewhere than into the wanted team, or leaves
    /// out one of `always`.
    #[must_use]
    pub fn contradictions(
        &self,
        wanted: &Division,
        always: &BTreeSet<String>,
        since: f64,
    ) -> Vec<String> {
        let mut found = Vec::new();
        for seen in self.teams(since) {
            let published = division(&seen.value);
            for (robot, team) in &published {
                let expected = wanted.get(robot).and_then(Option::as_ref);
                if team.as_ref() != expected {
                    found.push(format!("{robot} is in {team:?}, not {expected:?}: {}", seen.value));
                }
            }
            for robot in always {
                if !published.contains_key(robot) {
                    found.push(format!("{robot} is missing: {}", seen.value));
                }
            }
        }
        for seen in self.0.iter().filter(|seen| seen.at >= since && seen.key.ends_with("/team")) {
            let Some(robot) = seen.value["robot"].as_str() else { continue };
            let expected = wanted.get(robot).and_then(Option::as_deref);
            if seen.value["team"].as_str() != expected {
                found.push(format!("{robot} received {}", seen.value));
            }
        }
        found
    }
}
