//! Standard output: a terminal that is redrawn in place, or a pipe that plain text is appended to.

use std::io::{IsTerminal as _, Write as _, stdout};

use terminal_size::{Height, Width, terminal_size_of};

use super::page::{Line, Page};

/// Standard output.
#[derive(Debug)]
pub(crate) struct Screen {
    terminal: bool,
    /// How many lines of the terminal the last frame took.
    drawn: usize,
}

impl Page {
    /// The page of standard output now: terminals are resized.
    pub(crate) fn of_stdout() -> Self {
        if !stdout().is_terminal() {
            return Self::default();
        }
        let size = terminal_size_of(stdout());
        let width = size.map(|(Width(width), _)| width).filter(|width| *width > 0);
        let height = size.map(|(_, Height(height))| height).filter(|height| *height > 0);
        Self { width, height, colour: !is_set("NO_COLOR") && !is_dumb() }
    }
}

/// Whether a variable of the environment is there and not empty.
fn is_set(name: &str) -> bool {
    std::env::var_os(name).is_some_and(|value| !value.is_empty())
}

/// Whether the terminal cannot move its cursor.
fn is_dumb() -> bool {
    std::env::var_os("TERM").is_some_and(|term| term == "dumb")
}

impl Screen {
    /// Standard output as it is.
    pub(crate) fn of_stdout() -> Self {
        Self { terminal: stdout().is_terminal() && !is_dumb(), drawn: 0 }
    }

    /// Whether it is redrawn in place.
    pub(crate) const fn is_terminal(&self) -> bool {
        self.terminal
    }

    /// Shows lines: in the place of the last ones on a terminal, after them elsewhere.
    ///
    /// # Errors
    /// If standard output is closed.
    pub(crate) fn show(&mut self, page: &Page, lines: &[Line]) -> std::io::Result<()> {
        let mut out = stdout().lock();
        if self.terminal {
            let frame = page.frame(lines, self.drawn);
            self.drawn = frame.lines;
            out.write_all(frame.text.as_bytes())?;
        } else {
            for line in lines {
                writeln!(out, "{}", line.text)?;
            }
        }
        out.flush()
    }
}
