//! `muster replay-core`: feeds a recording to the core again and compares what comes out.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufReader, Write as _};
use std::ops::ControlFlow;
use std::path::PathBuf;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_machine::recording::{Entry, Head, Input, Output};
use muster_machine::replay::{Comparison, Difference, Ending, Step, compare};
use muster_model::id::ServiceName;
use muster_model::time::Tick;
use muster_runtime::exit::ExitError;
use muster_runtime::recording::host_facts;
use muster_wire::recording::{Put, Reader, Received};
use muster_wire::{Format, KeySpace, Message};
use serde_json::{Value, json};

/// Most characters of one message that are printed: a line is to be looked at, not to be parsed.
const MAX_SHOWN: usize = 300;

/// How many characters before a difference are shown.
const BEFORE_DIFFERENCE: usize = 60;

/// Arguments of `muster replay-core`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A service that runs with --record FILE writes down every event and what it did. This \
command feeds the events to the same core again, without a bus, and compares what it does now byte for \
byte.\n\nExamples:\n  muster-embedder --record embedder.rec      record, until Ctrl-C\n  \
muster replay-core embedder.rec            is it what it was?\n  \
muster replay-core embedder.rec --print | less\n\n\
Exit codes: 0 all is equal; 1 something differs, or the core panics; 2 the file cannot be read."
)]
pub(crate) struct ReplayArgs {
    /// The recording
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print the result as JSON; with --print, every event as a line of JSON before it
    #[arg(long)]
    json: bool,
    /// Print every event, and what the core did then
    #[arg(long)]
    print: bool,
    /// Look at the first N events only
    #[arg(long, value_name = "N")]
    until: Option<u64>,
}

/// Feeds a recording to its core.
///
/// # Errors
/// If something differs; or, as a wrong argument, if the file cannot be read to its end.
pub(crate) fn run(args: &ReplayArgs) -> anyhow::Result<()> {
    let name = args.file.display();
    let unreadable = |problem: String| ExitError::usage(format!("{name}: {problem}"));
    let file = File::open(&args.file).map_err(|error| unreadable(error.to_string()))?;
    let (mut reader, head) = Reader::open::<Head>(BufReader::new(file))
        .map_err(|error| unreadable(error.to_string()))?;
    let show = Show { space: KeySpace::new(head.fleet.clone()), started: head.started };
    let warnings = warnings(&head);
    for warning in &warnings {
        eprintln!("warning: {warning}");
    }
    // By lines, so that the event at which a core hangs or dies has been printed.
    let mut out = std::io::stdout().lock();
    if !args.json {
        writeln!(
            out,
            "recording of {} {}, fleet {}, version {} on {}",
            head.service,
            head.instance,
            head.fleet,
            clean(&head.version, MAX_SHOWN),
            clean(&head.host, MAX_SHOWN)
        )?;
    }
    let mut told = Ok(());
    let see = |step: &Step| {
        if args.print {
            told = if args.json {
                writeln!(out, "{}", show.step_json(step))
            } else {
                write!(out, "{}", show.step(step))
            };
        }
        if told.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    let next = || reader.next_entry::<Entry>();
    let until = args.until.unwrap_or(u64::MAX);
    let compared = by_service(head.clone(), next, until, see);
    told?;
    let compared = compared.map_err(|error| unreadable(error.to_string()))?;
    if args.json {
        writeln!(out, "{}", report(&head, &compared, &show, &warnings))?;
    } else {
        let Comparison { events, outputs, jobs, .. } = compared;
        let equal = if compared.difference.is_none() { "equal" } else { "different" };
        let counts = format!("{events} events, {outputs} outputs, {jobs} jobs");
        writeln!(out, "{equal}: {counts}; {}", ending(&compared.ending))?;
    }
    if let Some(difference) = &compared.difference {
        anyhow::bail!("{}", show.difference(difference));
    }
    match compared.ending {
        Ending::Damaged(problem) => {
            let events = compared.events;
            Err(unreadable(format!("{problem}; the {events} events before are equal")).into())
        }
        _ => Ok(()),
    }
}

fn by_service(
    head: Head,
    next: impl FnMut() -> Result<Option<Entry>, muster_wire::recording::RecordingError>,
    until: u64,
    see: impl FnMut(&Step) -> ControlFlow<()>,
) -> Result<Comparison, muster_machine::replay::ReplayError> {
    match head.service {
        ServiceName::Ingest => compare::<Ingest>(head, next, until, see),
        ServiceName::Embedder => compare::<Embedder>(head, next, until, see),
        ServiceName::Clusterer => compare::<Clusterer>(head, next, until, see),
        ServiceName::Auditor => compare::<Auditor>(head, next, until, see),
    }
}

/// Why a difference may come from somewhere else than a fault.
fn warnings(head: &Head) -> Vec<String> {
    let (mine, here) = (env!("CARGO_PKG_VERSION"), host_facts());
    let mut warnings = Vec::new();
    if head.version != mine {
        let theirs = clean(&head.version, MAX_SHOWN);
        warnings.push(format!(
            "recorded by version {theirs}, replayed by {mine}: what differs may have been changed on purpose"
        ));
    }
    if head.host != here {
        let there = clean(&head.host, MAX_SHOWN);
        warnings.push(format!(
            "recorded on {there}, replayed on {here}: last digits of numbers may differ"
        ));
    }
    warnings
}

fn ending(ending: &Ending) -> String {
    match ending {
        Ending::Told(why) => format!("the recording ends: {}", clean(why, MAX_SHOWN)),
        Ending::BrokenOff(None) => {
            "the recording breaks off between two entries, as after a kill".to_owned()
        }
        Ending::BrokenOff(Some(at)) => {
            format!("the recording breaks off at byte {at}, as after a kill")
        }
        Ending::NotReached => "the rest was not looked at".to_owned(),
        Ending::Damaged(problem) => problem.clone(),
    }
}

fn report(head: &Head, compared: &Comparison, show: &Show, warnings: &[String]) -> Value {
    let kind = match compared.ending {
        Ending::Told(_) => "told",
        Ending::BrokenOff(_) => "broken_off",
        Ending::NotReached => "not_reached",
        Ending::Damaged(_) => "damaged",
    };
    let difference = compared.difference.as_ref().map(|difference| {
        let Place { output, then, now } = show.place(difference);
        json!({
            "event": difference.step.number, "at_s": show.at(difference.step.tick),
            "input": show.input(&difference.step.input), "output": output,
            "recorded": then, "now": now,
        })
    });
    json!({
        "service": head.service, "fleet": head.fleet, "instance": head.instance,
        "version": head.version, "host": head.host, "settings": head.settings,
        "events": compared.events, "outputs": compared.outputs, "jobs": compared.jobs,
        "ending": kind, "ending_text": ending(&compared.ending), "warnings": warnings,
        "equal": compared.difference.is_none(), "difference": difference,
    })
}

/// Text without control characters, cut to a length.
fn clean(text: &str, limit: usize) -> String {
    let mut cut: String =
        text.chars().take(limit).map(|c| if c.is_control() { '\u{FFFD}' } else { c }).collect();
    if text.chars().nth(limit).is_some() {
        cut.push('…');
    }
    cut
}

/// Where the two texts of a difference part.
struct Place {
    /// The number of the output, from 1.
    output: usize,
    then: Option<String>,
    now: Option<String>,
}

/// Makes entries readable.
struct Show {
    space: KeySpace,
    started: Tick,
}

impl Show {
    fn at(&self, tick: Tick) -> f64 {
        tick.since(self.started).as_secs_f64()
    }

    fn step(&self, step: &Step) -> String {
        let input = clean(&self.input(&step.input), MAX_SHOWN);
        let mut text = format!("event {} at {:+.6} s: {input}\n", step.number, self.at(step.tick));
        for output in step.outputs.iter().flatten() {
            // Writing to a text does not fail.
            let _ = writeln!(text, "    {}", clean(&self.output(output), MAX_SHOWN));
        }
        text
    }

    fn step_json(&self, step: &Step) -> Value {
        let outputs = step.outputs.as_ref().map(|outputs| -> Vec<String> {
            outputs.iter().map(|output| self.output(output)).collect()
        });
        json!({
            "event": step.number, "tick_us": step.tick.0, "at_s": self.at(step.tick),
            "input": self.input(&step.input), "outputs": outputs,
        })
    }

    fn input(&self, input: &Input) -> String {
        match input {
            Input::Started => "the service starts".to_owned(),
            Input::Received(heard) => format!("received {}", self.heard(heard)),
            Input::Rejected(rejection) => {
                format!("refused {}: {}", rejection.key, rejection.reason)
            }
            Input::Timeout => "a deadline has passed".to_owned(),
            Input::Done(laps) => format!("the job is done, laps {laps:?} µs"),
            Input::JobFailed(_, said) => format!("the job has panicked: {said}"),
            Input::Fetched(fetch, heard) => {
                let mut text = format!("fetch {fetch} has brought {} messages", heard.len());
                for heard in heard {
                    let _ = write!(text, "; {}", clean(&self.heard(heard), MAX_SHOWN));
                }
                text
            }
            Input::Query(query, request) => format!("get {query}: {request}"),
            Input::LinkLost => "the link to the router is lost".to_owned(),
            Input::LinkRestored => "the link to the router is back".to_owned(),
        }
    }

    fn heard(&self, heard: &Received) -> String {
        match heard {
            Received::Put(put) => self.put(put),
            Received::Token { key, alive } => {
                format!("{} {}", self.key(key), if *alive { "is there" } else { "is gone" })
            }
        }
    }

    fn output(&self, output: &Output) -> String {
        Self::told(output, |put| self.put(put))
    }

    /// Everything that an output holds, for differences that the JSON form does not show.
    fn in_full(&self, output: &Output) -> String {
        Self::told(output, |put| match self.understood(put) {
            Some(message) => format!("{} {message:?}", self.key(&put.key)),
            None => format!("{} {} {:?}", self.key(&put.key), put.encoding, put.payload.0),
        })
    }

    fn told(output: &Output, put: impl Fn(&Put) -> String) -> String {
        let puts = |puts: &[Put]| {
            let all: Vec<_> = puts.iter().map(&put).collect();
            if all.is_empty() { "nothing".to_owned() } else { all.join(" and ") }
        };
        match output {
            Output::Published(Ok(all)) => format!("publish {}", puts(all)),
            Output::Published(Err(problem)) => format!("publish nothing: {problem}"),
            Output::Replied(query, Ok(all)) => format!("answer get {query}: {}", puts(all)),
            Output::Replied(query, Err(problem)) => {
                format!("answer get {query} with an error: {problem}")
            }
            Output::Ran => "start a job".to_owned(),
            Output::Fetched(fetch, patterns) => format!("fetch {fetch}: {}", patterns.join(", ")),
            Output::Stored(stored) => format!("store {stored}"),
        }
    }

    fn key<'a>(&self, key: &'a str) -> &'a str {
        let prefix = self.space.pattern(&muster_wire::Pattern::One(muster_wire::Key::Roster));
        key.strip_prefix(prefix.trim_end_matches("roster")).unwrap_or(key)
    }

    /// A message as JSON; its length where it is not understood.
    fn put(&self, put: &Put) -> String {
        let (key, payload) = (self.key(&put.key), &put.payload.0);
        if put.encoding.starts_with(muster_wire::message::JSON) {
            return format!("{key} {}", String::from_utf8_lossy(payload));
        }
        let text = match self.understood(put) {
            Some(message) => message
                .encode(message.keys().0, Format::Json, self.started)
                .map(|outbound| String::from_utf8_lossy(&outbound.payload).into_owned()),
            None => return format!("{key} ({} bytes that are not understood)", payload.len()),
        };
        format!("{key} ({} bytes) {}", payload.len(), text.unwrap_or_default())
    }

    fn understood(&self, put: &Put) -> Option<Message> {
        Message::decode(&self.space, &put.clone().into_packet()).ok()
    }

    /// The first output that differs, both sides cut to where they part.
    fn place(&self, difference: &Difference) -> Place {
        let Difference { step, now } = difference;
        let then = step.outputs.as_deref().unwrap_or_default();
        let now = match now {
            Ok(now) => now.as_slice(),
            Err(error) => {
                let text = clean(&error.to_string(), MAX_SHOWN);
                return Place { output: 1, then: None, now: Some(text) };
            }
        };
        let same = then.iter().zip(now).take_while(|(then, now)| then == now).count();
        let (then, now) = (then.get(same), now.get(same));
        let side = |output: Option<&Output>| output.map(|output| self.output(output));
        let (mut texts, mut from) = ((side(then), side(now)), 0);
        if let (Some(then), Some(now)) = (then, now) {
            if texts.0 == texts.1 {
                texts = (Some(self.in_full(then)), Some(self.in_full(now)));
            }
            let (a, b) = (texts.0.as_deref().unwrap_or(""), texts.1.as_deref().unwrap_or(""));
            let common = a.chars().zip(b.chars()).take_while(|(a, b)| a == b).count();
            from = common.saturating_sub(BEFORE_DIFFERENCE);
        }
        let cut = |text: Option<String>| {
            text.map(|text| {
                if from == 0 {
                    return clean(&text, MAX_SHOWN);
                }
                let what = clean(&text, BEFORE_DIFFERENCE);
                let rest: String = text.chars().skip(from.max(BEFORE_DIFFERENCE)).collect();
                format!("{what} {}", clean(&rest, MAX_SHOWN))
            })
        };
        Place { output: same + 1, then: cut(texts.0), now: cut(texts.1) }
    }

    fn difference(&self, difference: &Difference) -> String {
        let Place { output, then, now } = self.place(difference);
        let step = &difference.step;
        let missing = if step.outputs.is_some() {
            "nothing more"
        } else {
            "nothing: the recording breaks off here"
        };
        format!(
            "event {} at {:+.6} s differs in output {output}\n  event:    {}\n  recorded: {}\n  now:      {}",
            step.number,
            self.at(step.tick),
            clean(&self.input(&step.input), MAX_SHOWN),
            then.as_deref().unwrap_or(missing),
            now.as_deref().unwrap_or("nothing more"),
        )
    }
}
