//! Logs on standard error, human or JSON lines.
//!
//! Every line of a service carries its name, instance and fleet, from the span that it runs in. What
//! comes from outside is one line whatever it contains, and the same place in the code writes at most
//! so many lines in a while: a fault that repeats must not fill a disk.

use std::collections::HashMap;
use std::fmt;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde_json::json;
use tracing::callsite::Identifier;
use tracing::{Event, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{FormatEvent, FormatFields, Writer};
use tracing_subscriber::registry::LookupSpan;

/// What is logged without a flag and without `MUSTER_LOG`: what Muster does, and what
/// goes wrong below it.
const DEFAULT_FILTER: &str = "warn,muster=info";

/// Most lines that one place in the code writes in [`WINDOW`]: enough to see what repeats and how
/// often. More are counted, and the count is logged afterwards.
const MAX_LINES: u32 = 20;

/// The time in which they are counted.
const WINDOW: Duration = Duration::from_secs(10);

/// Longest line for people, in characters: what is longer is a payload.
const MAX_LINE: usize = 8 * 1024;

/// A filter that is not understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("log: {problem}; use a level such as info, or target=level pairs with commas")]
pub struct FilterError {
    /// What is wrong with it.
    pub problem: String,
}

/// Checks a filter.
///
/// # Errors
/// A [`FilterError`] that shows the right form.
pub fn check(filter: Option<&str>) -> Result<(), FilterError> {
    read_filter(filter).map(drop)
}

fn read_filter(filter: Option<&str>) -> Result<EnvFilter, FilterError> {
    let default = || format!("{DEFAULT_FILTER},{}", crate::bus::QUIET_LOG);
    let filter = filter.map_or_else(default, str::to_owned);
    EnvFilter::try_new(filter).map_err(|error| FilterError { problem: error.to_string() })
}

/// Starts logging. Calling it again, as tests do, changes nothing.
///
/// # Errors
/// As of [`check`].
pub fn start(filter: Option<&str>, json: bool) -> Result<(), FilterError> {
    let filter = read_filter(filter)?;
    // Colours are for people: a file or a service manager gets plain text.
    let colours = std::io::stderr().is_terminal();
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .with_ansi(colours);
    let started = if json {
        let builder = builder.json().with_span_list(false);
        builder.map_event_format(|inner| Bounded::new(inner, Form::Json)).try_init()
    } else {
        let form = if colours { Form::Coloured } else { Form::Plain };
        builder.map_event_format(|inner| Bounded::new(inner.with_ansi(colours), form)).try_init()
    };
    // Another subscriber is there already, and stays.
    drop(started);
    Ok(())
}

/// Writes lines in the form of another, one line each, and not too many.
struct Bounded<F> {
    inner: F,
    form: Form,
    places: Mutex<HashMap<Identifier, Place>>,
}

/// The form of the lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Plain,
    Coloured,
    Json,
}

/// One place in the code that logs. There are as many as the program has.
struct Place {
    since: Instant,
    lines: u32,
    untold: u64,
}

impl<F> Bounded<F> {
    fn new(inner: F, form: Form) -> Self {
        Self { inner, form, places: Mutex::default() }
    }

    /// Whether a line may be written now; and how many were not since the last one.
    fn admit(&self, place: Identifier, now: Instant) -> Option<u64> {
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        let place = places.entry(place).or_insert(Place { since: now, lines: 0, untold: 0 });
        if now.saturating_duration_since(place.since) >= WINDOW {
            (place.since, place.lines) = (now, 0);
        }
        if place.lines >= MAX_LINES {
            place.untold += 1;
            return None;
        }
        place.lines += 1;
        Some(std::mem::take(&mut place.untold))
    }
}

impl<S, N, F> FormatEvent<S, N> for Bounded<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let Some(untold) = self.admit(event.metadata().callsite(), Instant::now()) else {
            return Ok(());
        };
        let mut line = String::new();
        self.inner.format_event(context, Writer::new(&mut line), event)?;
        writeln!(writer, "{}", one_line(&line, self.form))?;
        if untold > 0 {
            let text = format!("{untold} more lines like the one above were left out");
            if self.form == Form::Json {
                let level = event.metadata().level().as_str();
                writeln!(writer, "{}", json!({"level": level, "fields": {"message": text}}))?;
            } else {
                writeln!(writer, "  ({text})")?;
            }
        }
        Ok(())
    }
}

/// A line without what would make it several, or would do something to a terminal, and not longer
/// than a line may be. Where there are colours, their escape sequences stay: the subscriber has taken
/// out those that are not its own. JSON is not cut short, which would make it none.
fn one_line(line: &str, form: Form) -> std::borrow::Cow<'_, str> {
    let line = line.trim_end_matches('\n');
    let harms = |c: char| c.is_control() && (c != '\u{1b}' || form != Form::Coloured);
    let is_long = form != Form::Json && line.len() > MAX_LINE;
    if !is_long && !line.contains(harms) {
        return line.into();
    }
    let most = if is_long { MAX_LINE } else { usize::MAX };
    let mut harmless: String =
        line.chars().take(most).map(|c| if harms(c) { '\u{FFFD}' } else { c }).collect();
    if is_long {
        harmless.push('…');
    }
    harmless.into()
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::Arc;

    use super::*;

    #[derive(Clone, Default)]
    struct Sink(Arc<Mutex<Vec<u8>>>);

    impl Write for Sink {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    fn logged(json: bool, log: impl FnOnce()) -> String {
        let sink = Sink::default();
        let writer = sink.clone();
        let builder =
            tracing_subscriber::fmt().with_writer(move || writer.clone()).with_ansi(false);
        if json {
            let builder = builder.json().with_span_list(false);
            let format = builder.map_event_format(|inner| Bounded::new(inner, Form::Json)).finish();
            tracing::subscriber::with_default(format, log);
        } else {
            let format =
                builder.map_event_format(|inner| Bounded::new(inner, Form::Plain)).finish();
            tracing::subscriber::with_default(format, log);
        }
        let bytes = sink.0.lock().unwrap().clone();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn foreign_text_stays_on_its_line() {
        let foreign = "r1\n2026-11-21T00:00:00Z ERROR forged\r\u{1b}[31m\u{7}\u{9b}31m";
        for json in [false, true] {
            let text = logged(json, || tracing::warn!("from outside: {foreign}"));
            assert_eq!(text.lines().count(), 1, "{text:?}");
            assert!(!text.trim_end_matches('\n').contains(char::is_control), "{text:?}");
        }
        let long = "x".repeat(10 * MAX_LINE);
        assert!(logged(false, || tracing::warn!("{long}")).len() < 2 * MAX_LINE);
    }

    #[test]
    fn what_repeats_is_written_a_few_times_and_other_places_go_on() {
        for json in [false, true] {
            let text = logged(json, || {
                for _ in 0..1000 {
                    tracing::warn!("again");
                }
                tracing::warn!("another");
            });
            assert_eq!(text.matches("again").count(), MAX_LINES as usize);
            assert_eq!(text.matches("another").count(), 1);
        }
    }

    #[test]
    fn what_was_left_out_is_reported_with_the_next_line() {
        tracing::subscriber::with_default(tracing_subscriber::registry(), || {
            let bounded = Bounded::new((), Form::Plain);
            let place =
                tracing::callsite!(name: "x", kind: tracing::metadata::Kind::EVENT, fields: m);
            let place = tracing::Callsite::metadata(place).callsite();
            let now = Instant::now();
            let admitted = (0..50).filter_map(|_| bounded.admit(place.clone(), now)).count();
            assert_eq!(admitted, MAX_LINES as usize);
            assert_eq!(bounded.admit(place.clone(), now + WINDOW), Some(30));
            assert_eq!(bounded.admit(place, now + WINDOW), Some(0));
        });
    }

    #[test]
    fn a_line_names_service_instance_and_fleet() {
        for json in [false, true] {
            let text = logged(json, || {
                let span = tracing::error_span!("service", service = "ingest", fleet = "alpha");
                span.in_scope(|| tracing::info!("serves"));
            });
            assert!(text.contains("ingest") && text.contains("alpha"), "{text}");
        }
    }
}
