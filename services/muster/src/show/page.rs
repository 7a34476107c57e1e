//! What is printed as lines of text that fit a page: tables, clock times, how old something is.
//!
//! Everything here is pure: a test renders for any width, with and without colours.

use std::time::Duration;

use comfy_table::{ContentArrangement, Table, presets};
use muster_client::Staleness;
use muster_model::time::Tick;

/// Most names in one cell of a table; all are in `--json`.
const MAX_NAMES: usize = 24;

/// Most characters of a cell that count when columns are dropped: longer texts are rather wrapped.
const MAX_UNWRAPPED: usize = 32;

/// Columns that a table's borders and padding take: three for each column, and one at the end.
const BORDER_WIDTH: usize = 3;

/// Where lines are printed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Page {
    /// Columns of the terminal; none where lines may have any length, as in a pipe.
    pub(crate) width: Option<u16>,
    /// Lines of the terminal; none where there may be any number.
    pub(crate) height: Option<u16>,
    /// Whether colours are printed.
    pub(crate) colour: bool,
}

/// A column of a table.
#[derive(Debug, Clone)]
pub(crate) struct Column {
    name: String,
    /// Columns with higher numbers are left out first where the page is narrow; 0 never.
    dropped: u8,
}

impl Column {
    /// A column that is always there.
    pub(crate) fn kept(name: &str) -> Self {
        Self::dropped(name, 0)
    }

    /// A column that is left out on narrow pages, higher numbers first.
    pub(crate) fn dropped(name: &str, dropped: u8) -> Self {
        Self { name: name.to_owned(), dropped }
    }
}

/// The style of a line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Tone {
    /// Plain.
    #[default]
    Plain,
    /// All is well.
    Good,
    /// Something needs attention.
    Bad,
}

/// One line of text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Line {
    pub(crate) text: String,
    pub(crate) tone: Tone,
}

impl From<String> for Line {
    fn from(text: String) -> Self {
        Self { text, tone: Tone::Plain }
    }
}

impl Page {
    /// A table as lines, no wider than the page: first columns that may be dropped are, then cells are
    /// wrapped.
    pub(crate) fn table(
        &self,
        columns: &[Column],
        rows: impl Iterator<Item = Vec<String>>,
    ) -> Vec<String> {
        let mut cells: Vec<Vec<String>> = vec![columns.iter().map(|c| c.name.clone()).collect()];
        cells.extend(rows);
        let mut kept: Vec<usize> = (0..columns.len()).collect();
        while self.width.is_some_and(|width| natural_width(&cells, &kept) > usize::from(width)) {
            let last = kept.iter().copied().max_by_key(|index| columns[*index].dropped);
            let Some(last) = last.filter(|index| columns[*index].dropped > 0) else { break };
            kept.retain(|index| *index != last);
        }
        let mut cells = cells.iter().map(|row| kept.iter().map(|index| row[*index].as_str()));
        let mut table = Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        if let Some(width) = self.width {
            table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
        }
        if let Some(header) = cells.next() {
            table.set_header(header);
        }
        table.add_rows(cells);
        table.to_string().lines().map(str::to_owned).collect()
    }

    /// The bytes that print lines over the last `drawn` lines of a terminal: each is cut to the width,
    /// and those that do not fit the height are left out; the last line has their number.
    pub(crate) fn frame(&self, lines: &[Line], drawn: usize) -> Frame {
        let most = self.height.map_or(usize::MAX, |height| usize::from(height.saturating_sub(1)));
        let mut shown: Vec<Line> = lines.iter().take(most).cloned().collect();
        if lines.len() > most
            && let Some(last) = shown.last_mut()
        {
            let more = lines.len() - most + 1;
            *last = format!("… {more} more lines; enlarge the terminal, or use --json").into();
        }
        let mut text = match drawn {
            0 => String::new(),
            drawn => format!("\x1b[{drawn}A\r"),
        };
        for line in &shown {
            text.push_str(&self.painted(&cut(&line.text, self.width), line.tone));
            text.push_str("\x1b[K\n");
        }
        text.push_str("\x1b[J");
        Frame { text, lines: shown.len() }
    }

    fn painted(&self, text: &str, tone: Tone) -> String {
        let code = match tone {
            Tone::Good => 32,
            Tone::Bad => 31,
            Tone::Plain => 0,
        };
        if self.colour && code > 0 { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_owned() }
    }
}

/// What is written to redraw a terminal, and how many lines it takes there.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Frame {
    pub(crate) text: String,
    pub(crate) lines: usize,
}

/// How wide a table of these columns is, with only long texts wrapped.
fn natural_width(rows: &[Vec<String>], columns: &[usize]) -> usize {
    let widest =
        |column: &usize| rows.iter().map(|row| row[*column].chars().count()).max().unwrap_or(0);
    let width = |column| widest(column).min(MAX_UNWRAPPED) + BORDER_WIDTH;
    columns.iter().map(width).sum::<usize>() + 1
}

fn cut(text: &str, width: Option<u16>) -> String {
    let Some(width) = width.map(usize::from) else { return text.to_owned() };
    if text.chars().count() <= width {
        return text.to_owned();
    }
    text.chars().take(width.saturating_sub(1)).chain(['…']).collect()
}

/// Names with spaces between them, cut short.
pub(crate) fn names<T: ToString>(all: impl ExactSizeIterator<Item = T>) -> String {
    let count = all.len();
    let mut text = all.take(MAX_NAMES).map(|name| name.to_string()).collect::<Vec<_>>().join(" ");
    if count > MAX_NAMES {
        text.push_str(&format!(" … and {} more", count - MAX_NAMES));
    }
    text
}

/// A moment as a clock shows it, in UTC as logs have it.
pub(crate) fn clock_time(moment: Tick) -> String {
    const DAY_S: u64 = 24 * 60 * 60;
    let seconds = moment.0 / 1_000_000 % DAY_S;
    format!("{:02}:{:02}:{:02} UTC", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

/// How old what a watch shows is, and why it is stale if it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Age {
    /// Nothing has arrived yet.
    Waiting {
        /// Whether a router is linked.
        linked: bool,
    },
    /// A message was received so long ago.
    Received {
        /// Time since then.
        age: Duration,
        /// Why it may not be valid any more.
        stale: Option<Staleness>,
    },
}

/// The line with the time, how old what is shown is, and why it is stale.
pub(crate) fn age_line(now: Tick, publisher: &str, age: Age) -> Line {
    let (text, tone) = match age {
        Age::Waiting { linked: true } => {
            (format!("waiting for {publisher}; see `muster status`"), Tone::Plain)
        }
        Age::Waiting { linked: false } => {
            ("waiting: the link to the router is lost".to_owned(), Tone::Bad)
        }
        Age::Received { age, stale: None } => {
            (format!("live, received {} s ago", age.as_secs()), Tone::Good)
        }
        Age::Received { age, stale: Some(why) } => {
            let why = match why {
                Staleness::LinkLost => "the link to the router is lost".to_owned(),
                Staleness::Silent => format!("{publisher} is silent; see `muster status`"),
                Staleness::Restarted => {
                    format!("{publisher} started again with lower terms and is followed soon")
                }
            };
            (format!("STALE, {} s old: {why}", age.as_secs()), Tone::Bad)
        }
    };
    Line { text: format!("{}  {text}", clock_time(now)), tone }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The widths of terminals that every table is to fit.
    pub(crate) const WIDTHS: [u16; 4] = [60, 80, 120, 200];

    pub(crate) fn page(width: u16) -> Page {
        Page { width: Some(width), height: Some(50), colour: false }
    }

    /// Fails if a line is wider than the page.
    pub(crate) fn assert_fits(lines: &[String], width: u16) {
        for line in lines {
            assert!(line.chars().count() <= usize::from(width), "{width}: {}", lines.join("\n"));
        }
    }

    fn lines(texts: &[&str]) -> Vec<Line> {
        texts.iter().map(|text| (*text).to_owned().into()).collect()
    }

    #[test]
    fn narrow_pages_drop_columns_before_they_wrap_cells() {
        let columns = [Column::kept("name"), Column::dropped("a", 1), Column::dropped("b", 2)];
        let rows = || std::iter::once(vec!["r".repeat(20), "1".repeat(20), "2".repeat(20)]);
        let has = |width: Option<u16>| {
            let text = Page { width, ..Page::default() }.table(&columns, rows()).join("\n");
            ["r", "1", "2"].map(|part| text.contains(&part.repeat(20)))
        };
        assert_eq!(has(None), [true, true, true]);
        assert_eq!(has(Some(70)), [true, true, true]);
        assert_eq!(has(Some(69)), [true, true, false]);
        assert_eq!(has(Some(40)), [true, false, false]);
        let narrow = page(20).table(&columns, rows());
        assert_fits(&narrow, 20);
        assert_eq!(narrow.join("").matches('r').count(), 20, "a cell is wrapped, not cut");
    }

    #[test]
    fn a_frame_is_drawn_over_the_one_before() {
        let page = Page { width: Some(10), height: Some(4), colour: false };
        let first = page.frame(&lines(&["one", "two"]), 0);
        assert_eq!(first, Frame { text: "one\x1b[K\ntwo\x1b[K\n\x1b[J".to_owned(), lines: 2 });
        let second = page.frame(&lines(&["a line that is too long"]), first.lines);
        assert_eq!(second.text, "\x1b[2A\ra line th…\x1b[K\n\x1b[J");
        let tall = page.frame(&lines(&["1", "2", "3", "4", "5"]), 1);
        assert_eq!(tall.lines, 3, "one line of the terminal is left for the cursor");
        assert!(tall.text.contains("… 3 more"), "{}", tall.text);
    }

    #[test]
    fn colours_are_printed_only_where_they_are_wanted() {
        let line = age_line(Tick(0), "clusterer", Age::Waiting { linked: false });
        for colour in [false, true] {
            let page = Page { colour, ..Page::default() };
            let text = page.frame(std::slice::from_ref(&line), 0).text;
            assert_eq!(text.contains("\x1b[31m"), colour, "{text}");
        }
    }

    #[test]
    fn the_age_says_why_something_is_stale() {
        let now = Tick(14 * 3_600_000_000 + 3 * 60_000_000 + 7_900_000);
        let age = Duration::from_millis(12_900);
        let text = |age| age_line(now, "clusterer", age).text;
        let stale = |why| text(Age::Received { age, stale: Some(why) });
        assert_eq!(
            text(Age::Received { age, stale: None }),
            "14:03:07 UTC  live, received 12 s ago"
        );
        for (why, words) in [
            (Staleness::LinkLost, "STALE, 12 s old: the link to the router is lost"),
            (Staleness::Silent, "STALE, 12 s old: clusterer is silent"),
            (Staleness::Restarted, "STALE, 12 s old: clusterer started again with lower terms"),
        ] {
            assert!(stale(why).starts_with(&format!("14:03:07 UTC  {words}")), "{}", stale(why));
        }
        assert!(text(Age::Waiting { linked: true }).contains("waiting for clusterer"));
        assert!(text(Age::Waiting { linked: false }).contains("the link to the router is lost"));
    }
}
