//! A browser as it is known from outside: what it has received, and how fast it draws.

use std::collections::{BTreeMap, BTreeSet};

use muster_console::{Role, frame, limits};
use serde_json::Value;

use super::clock::{MS, Micros, SECOND};
use super::oracle::{Verified, breach};

/// How fast a browser draws a turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pace {
    /// Within so much time.
    Within(Micros),
    /// It never does: its computer sleeps, or its network is gone.
    Never,
}

impl Pace {
    /// A fast screen, a slow computer, one that is hidden, and one that has stopped.
    pub(crate) const ALL: [Self; 4] =
        [Self::Within(30 * MS), Self::Within(700 * MS), Self::Within(2 * SECOND), Self::Never];
}

/// What a browser shows, and what it was sent and has not drawn.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) role: Role,
    pub(crate) pace: Pace,
    /// Bytes that it was sent and has not drawn.
    undrawn: usize,
    /// The turn that it has to draw.
    awaits: Option<u64>,
    topics: BTreeMap<String, Value>,
    /// The list of names that arrives: its number, how many it has, and the names so far.
    coming: (u64, usize, Vec<String>),
    /// The list that it has.
    names: (u64, Vec<String>),
    /// The teams of the robots, by the last frame of the ground.
    slots: Vec<u16>,
    next: u64,
    /// What it has sent and has no reply to, and when that was.
    pub(crate) unanswered: BTreeMap<u64, Micros>,
}

/// A number of a frame's head.
fn number(frame: &[u8], at: usize) -> u64 {
    let bytes: [u8; 4] = frame.get(at..at + 4).and_then(|b| b.try_into().ok()).unwrap_or_default();
    u32::from_le_bytes(bytes).into()
}

impl Page {
    pub(crate) fn new(role: Role, pace: Pace) -> Self {
        Self {
            role,
            pace,
            undrawn: 0,
            awaits: None,
            topics: BTreeMap::new(),
            coming: (0, 0, Vec::new()),
            names: (0, Vec::new()),
            slots: Vec::new(),
            next: 1,
            unanswered: BTreeMap::new(),
        }
    }

    /// The number of its next command or question.
    pub(crate) fn next_id(&mut self, now: Micros) -> u64 {
        self.next += 1;
        self.unanswered.insert(self.next, now);
        self.next
    }

    fn sent(&mut self, bytes: usize) -> Verified {
        self.undrawn += bytes;
        if self.awaits.is_some() {
            let seen = format!("{bytes} bytes come while {} are not drawn", self.undrawn);
            return breach("a browser is sent nothing before it has drawn", seen);
        }
        Ok(())
    }

    /// It receives a text; the turn that ends with it, if one does.
    pub(crate) fn text(&mut self, text: &str) -> Result<Option<u64>, super::oracle::Breach> {
        self.sent(text.len())?;
        let mut message: Value = serde_json::from_str(text).unwrap_or_default();
        let data = message["data"].take();
        match message["topic"].as_str() {
            Some("end") => {
                self.awaits = data["turn"].as_u64();
                return Ok(self.awaits);
            }
            Some("reply") => {
                let known = data["id"].as_u64().and_then(|id| self.unanswered.remove(&id));
                if known.is_none() {
                    return breach("a browser is answered once", format!("{data}"));
                }
            }
            Some("names") => self.name_piece(&data),
            Some(topic) => {
                self.topics.insert(topic.to_owned(), data);
            }
            None => return breach("what browsers are sent can be read", text.to_owned()),
        }
        Ok(None)
    }

    fn name_piece(&mut self, data: &Value) {
        let number = |field: &str| data[field].as_u64().unwrap_or_default();
        let count = usize::try_from(number("of")).unwrap_or_default();
        if number("from") == 0 {
            self.coming = (number("names"), count, Vec::new());
        }
        let rows = data["robots"].as_array().into_iter().flatten();
        let names = rows.filter_map(|row| row[0].as_str().map(str::to_owned));
        self.coming.2.extend(names);
        if self.coming.2.len() >= count {
            self.names = (self.coming.0, std::mem::take(&mut self.coming.2));
        }
    }

    /// It receives a frame.
    pub(crate) fn frame(&mut self, bytes: &[u8]) -> Verified {
        self.sent(bytes.len())?;
        let (names, count) = (number(bytes, 4), (bytes.len() - frame::HEAD) / frame::RECORD);
        if bytes[0] != frame::View::Ground as u8 {
            return Ok(());
        }
        if names != self.names.0 || count != self.names.1.len() {
            let known = (self.names.0, self.names.1.len());
            let seen =
                format!("a frame of {count} robots of list {names} comes to one with {known:?}");
            return breach("a browser has the names of all robots that it draws", seen);
        }
        let slot = |record: &[u8]| u16::from_le_bytes([record[4], record[5]]);
        self.slots = bytes[frame::HEAD..].chunks_exact(frame::RECORD).map(slot).collect();
        Ok(())
    }

    /// It has drawn a turn; false if that is not the one that it was sent last.
    pub(crate) fn draw(&mut self, turn: u64) -> bool {
        let is_last = self.awaits == Some(turn);
        if is_last {
            self.awaits = None;
            self.undrawn = 0;
        }
        is_last
    }

    /// Whether it costs no more than is stated. `waiting` waits for it in the core.
    pub(crate) fn check_bytes(&self, waiting: usize) -> Verified {
        let all = self.undrawn + waiting;
        if all > limits::MAX_WAITING_BYTES {
            return breach(
                "a browser that draws nothing costs at most 4 MiB",
                format!("{all} bytes wait"),
            );
        }
        Ok(())
    }

    /// The robots that it shows.
    pub(crate) fn robots(&self) -> BTreeSet<&str> {
        self.names.1.iter().map(String::as_str).collect()
    }

    /// The team of each robot that it shows in one.
    pub(crate) fn teams(&self) -> BTreeMap<&str, &str> {
        let teams = self.topics.get("teams").and_then(|teams| teams["teams"].as_array());
        let id = |slot: u16| teams?.get(usize::from(slot))?["id"].as_str();
        let robots = self.names.1.iter().zip(&self.slots);
        robots.filter_map(|(robot, slot)| Some((robot.as_str(), id(*slot)?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn promise(checked: Result<Option<u64>, super::super::oracle::Breach>) -> &'static str {
        checked.unwrap_err().promise
    }

    fn page() -> Page {
        Page::new(Role::Viewer, Pace::Within(MS))
    }

    fn text(topic: &str, data: &Value) -> String {
        json!({"topic": topic, "data": data}).to_string()
    }

    #[test]
    fn what_is_sent_before_a_turn_is_drawn_is_seen() {
        let mut page = page();
        assert_eq!(page.text(&text("end", &json!({"turn": 1}))), Ok(Some(1)));
        let more = text("teams", &json!({}));
        assert_eq!(promise(page.text(&more)), "a browser is sent nothing before it has drawn");
        assert!(page.draw(1));
        assert_eq!(page.text(&more), Ok(None));
    }

    #[test]
    fn a_second_answer_and_one_that_no_one_waits_for_are_seen() {
        let mut page = page();
        let answer = text("reply", &json!({"id": page.next_id(0)}));
        assert_eq!(page.text(&answer), Ok(None));
        assert_eq!(promise(page.text(&answer)), "a browser is answered once");
    }

    #[test]
    fn what_no_browser_can_read_is_seen() {
        assert_eq!(promise(page().text("{\"data\":1")), "what browsers are sent can be read");
    }

    #[test]
    fn a_frame_of_robots_without_names_is_seen() {
        let mut ground = vec![0; frame::HEAD + frame::RECORD];
        ground[0] = frame::View::Ground as u8;
        ground[4] = 7;
        let mut page = page();
        assert_eq!(
            page.frame(&ground).unwrap_err().promise,
            "a browser has the names of all robots that it draws"
        );
        let names = json!({"names": 7, "of": 1, "from": 0, "robots": [["r1"]]});
        assert_eq!(page.text(&text("names", &names)), Ok(None));
        assert_eq!(page.frame(&ground), Ok(()));
    }

    #[test]
    fn a_browser_for_which_too_much_waits_is_seen() {
        let page = page();
        assert_eq!(page.check_bytes(limits::MAX_WAITING_BYTES), Ok(()));
        assert_eq!(
            page.check_bytes(limits::MAX_WAITING_BYTES + 1).unwrap_err().promise,
            "a browser that draws nothing costs at most 4 MiB"
        );
    }
}
