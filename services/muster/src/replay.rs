//! `muster replay-core`: feeds a recording to the service again and compares what comes out.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufReader, Write as _};
use std::ops::ControlFlow;
use std::path::PathBuf;

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_historian::Historian;
use muster_ingest::Ingest;
use muster_model::id::ServiceName;
use muster_model::time::Tick;
use muster_planner::Planner;
use muster_runtime::exit::ExitError;
use muster_runtime::recording::host_facts;
use muster_service::recording::{Entry, Head};
use muster_service::replay::{Comparison, Difference, Ending, Step, compare};
use muster_service::{Arrival, Command, Input};
use muster_wire::message::quoted;
use muster_wire::recording::Reader;
use muster_wire::{Format, KeySpace, Message, Packet, Source};
use serde_json::{Value, json};

/// Most characters of one message that are printed: a line is to be looked at, not to be parsed.
const MAX_SHOWN: usize = 300;

/// How many characters before a difference are shown.
const BEFORE_DIFFERENCE: usize = 60;

/// Arguments of `muster replay-core`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A service that runs with --record FILE writes down every input and what it did. This \
command feeds the inputs to the same service again, without a bus, and compares what it does now byte for \
byte.\n\nExamples:\n  muster-embedder --record embedder.rec      record, until Ctrl-C\n  \
muster replay-core embedder.rec            does it do the same again?\n  \
muster replay-core embedder.rec --print | less\n\n\
Exit codes: 0 all is equal; 1 something differs, or the core panics; 2 the file cannot be read."
)]
pub(crate) struct ReplayArgs {
    /// The recording
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print the result as JSON; with --print, every input as a line of JSON before it
    #[arg(long)]
    json: bool,
    /// Print every input, and what the service did then
    #[arg(long)]
    print: bool,
    /// Look at the first N inputs only
    #[arg(long, value_name = "N")]
    until: Option<u64>,
}

/// Feeds a recording to its service.
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
    // By lines, so that the input at which a core hangs or dies has been printed.
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
    let mut printed = Ok(());
    let see = |step: &Step| {
        if args.print {
            printed = if args.json {
                writeln!(out, "{}", show.step_json(step))
            } else {
                write!(out, "{}", show.step(step))
            };
        }
        if printed.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    let next = || reader.next_entry::<Entry>();
    let until = args.until.unwrap_or(u64::MAX);
    let compared = by_service(head.clone(), next, until, see);
    printed?;
    let compared = compared.map_err(|error| unreadable(error.to_string()))?;
    if args.json {
        writeln!(out, "{}", report(&head, &compared, &show, &warnings))?;
    } else {
        let Comparison { inputs, commands, jobs, .. } = compared;
        let equal = if compared.difference.is_none() { "equal" } else { "different" };
        let counts = format!("{inputs} inputs, {commands} commands, {jobs} jobs");
        writeln!(out, "{equal}: {counts}; {}", ending(&compared.ending))?;
    }
    if let Some(difference) = &compared.difference {
        anyhow::bail!("{}", show.difference(difference));
    }
    match compared.ending {
        Ending::Damaged(problem) => {
            let inputs = compared.inputs;
            Err(unreadable(format!("{problem}; the {inputs} inputs before are equal")).into())
        }
        _ => Ok(()),
    }
}

fn by_service(
    head: Head,
    next: impl FnMut() -> Result<Option<Entry>, muster_wire::recording::RecordingError>,
    until: u64,
    see: impl FnMut(&Step) -> ControlFlow<()>,
) -> Result<Comparison, muster_service::replay::ReplayError> {
    match head.service {
        ServiceName::Ingest => compare::<Ingest>(head, next, until, see),
        ServiceName::Embedder => compare::<Embedder>(head, next, until, see),
        ServiceName::Clusterer => compare::<Clusterer>(head, next, until, see),
        ServiceName::Auditor => compare::<Auditor>(head, next, until, see),
        ServiceName::Historian => compare::<Historian>(head, next, until, see),
        ServiceName::Planner => compare::<Planner>(head, next, until, see),
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
        Ending::Stated(why) => format!("the recording ends: {}", clean(why, MAX_SHOWN)),
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
        Ending::Stated(_) => "stated",
        Ending::BrokenOff(_) => "broken_off",
        Ending::NotReached => "not_reached",
        Ending::Damaged(_) => "damaged",
    };
    let difference = compared.difference.as_ref().map(|difference| {
        let Place { command, then, now } = show.place(difference);
        json!({
            "event": difference.step.number, "at_s": show.at(difference.step.tick),
            "input": show.input(&difference.step.input), "output": command,
            "recorded": then, "now": now,
        })
    });
    json!({
        "service": head.service, "fleet": head.fleet, "instance": head.instance,
        "version": head.version, "host": head.host, "settings": head.settings,
        "events": compared.inputs, "outputs": compared.commands, "jobs": compared.jobs,
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
    /// The number of the command, from 1.
    command: usize,
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
        let mut text = format!("input {} at {:+.6} s: {input}\n", step.number, self.at(step.tick));
        for command in step.commands.iter().flatten() {
            // Writing to a text does not fail.
            let _ = writeln!(text, "    {}", clean(&self.command(command), MAX_SHOWN));
        }
        text
    }

    fn step_json(&self, step: &Step) -> Value {
        let commands = step.commands.as_ref().map(|commands| -> Vec<String> {
            commands.iter().map(|command| self.command(command)).collect()
        });
        json!({
            "event": step.number, "tick_us": step.tick.0, "at_s": self.at(step.tick),
            "input": self.input(&step.input), "outputs": commands,
        })
    }

    fn input(&self, input: &Input) -> String {
        match input {
            Input::Started { linked: true } => "the service starts".to_owned(),
            Input::Started { linked: false } => "the service starts without a link".to_owned(),
            Input::Arrived(arrival) => self.arrival(arrival),
            Input::Timer => "a deadline has passed".to_owned(),
            Input::JobEnded { laps, panic: None } => format!("the job is done, laps {laps:?} µs"),
            Input::JobEnded { panic: Some(said), .. } => format!("the job has panicked: {said}"),
            Input::Answered { ask, answers } => {
                let mut text = format!("question {} has brought {} answers", ask.0, answers.len());
                for answer in answers {
                    let _ = write!(text, "; {}", clean(&self.arrival(answer), MAX_SHOWN));
                }
                text
            }
            Input::Get(get) => {
                let payload = get.payload.as_deref().map(String::from_utf8_lossy);
                let (selector, parameters) = (self.key(&get.selector), &get.parameters);
                format!(
                    "get {}: {selector}?{parameters} {}",
                    get.get.0,
                    payload.unwrap_or_default()
                )
            }
            Input::LinkLost => "the link to the router is lost".to_owned(),
            Input::LinkRestored => "the link to the router is back".to_owned(),
            Input::Stored { error: None } => "the state is stored".to_owned(),
            Input::Stored { error: Some(error) } => format!("the state is not stored: {error}"),
            Input::Restored(content) => format!("{} bytes were kept", content.len()),
            Input::Kept { error: None } => "what is to be kept is written".to_owned(),
            Input::Kept { error: Some(error) } => format!("nothing is kept: {error}"),
            Input::Recorded(report) => {
                format!("records up to {} are written", report.coverage.sequence)
            }
            Input::Found { lookup, page: Ok(page) } => {
                format!("lookup {lookup} has found {:?}", page.rows)
            }
            Input::Found { lookup, page: Err(problem) } => {
                format!("lookup {lookup} has found nothing: {problem}")
            }
            Input::ProcessCounters(counters) => format!("counters of the process: {counters:?}"),
            Input::StateLost { reason } => format!("stored state is lost: {}", quoted(reason)),
        }
    }

    fn arrival(&self, arrival: &Arrival) -> String {
        match arrival.clone().into_message(&self.space) {
            Ok(_) => format!("received {}", self.packet(arrival.packet())),
            Err(rejection) => format!("refused {}: {}", rejection.key, rejection.reason),
        }
    }

    fn command(&self, command: &Command) -> String {
        self.command_with(command, |packet| self.packet(packet))
    }

    /// Everything that a command holds, for differences that the JSON form does not show.
    fn in_full(&self, command: &Command) -> String {
        self.command_with(command, |packet| match self.decoded(packet) {
            Some(message) => format!("{} {message:?}", self.key(&packet.key)),
            None => format!("{} {} {:?}", self.key(&packet.key), packet.encoding, packet.payload),
        })
    }

    fn command_with(&self, command: &Command, show: impl Fn(&Packet) -> String) -> String {
        let packets = |packets: &[Packet]| {
            let all: Vec<_> = packets.iter().map(&show).collect();
            if all.is_empty() { "nothing".to_owned() } else { all.join(" and ") }
        };
        match command {
            Command::Publish(publication) => format!("publish {}", packets(&publication.packets)),
            Command::Reply(reply) => match &reply.answer {
                Ok(answer) => format!("answer get {}: {}", reply.get.0, packets(answer)),
                Err(problem) => format!("answer get {} with an error: {problem}", reply.get.0),
            },
            Command::RunJob => "start a job".to_owned(),
            Command::Ask(ask) => {
                format!("ask question {}: {}", ask.ask.0, self.space.pattern(&ask.pattern))
            }
            Command::Store(stored) => {
                format!("store {}", serde_json::to_string(stored).unwrap_or_default())
            }
            Command::Keep(content) => format!("keep {} bytes", content.len()),
            Command::KeptIsUnusable(problem) => format!("put aside what was kept: {problem}"),
            Command::ReplicaState(state) => format!("be {state:?} from now on"),
            Command::DeclareToken(key) => format!("declare the token {}", self.space.format(key)),
            Command::WithdrawToken(key) => {
                format!("withdraw the token {}", self.space.format(key))
            }
            Command::Append(entry) => format!("append a record: {:?}", entry.record),
            Command::LookUp { lookup, query } => format!("lookup {lookup}: {query:?}"),
            Command::Retain(retention) => {
                format!("forget records before {}", retention.before.as_seconds())
            }
            Command::Unencodable(problem) => format!("publish nothing: {problem}"),
        }
    }

    fn key<'a>(&self, key: &'a str) -> &'a str {
        let prefix = self.space.pattern(&muster_wire::Pattern::One(muster_wire::Key::Roster));
        key.strip_prefix(prefix.trim_end_matches("roster")).unwrap_or(key)
    }

    /// A message as JSON; its length where it is not understood.
    fn packet(&self, packet: &Packet) -> String {
        let key = self.key(&packet.key);
        match packet.source {
            Source::TokenAlive => return format!("{key} is there"),
            Source::TokenGone => return format!("{key} is gone"),
            Source::Put | Source::Delete => {}
        }
        let payload = match &packet.payload {
            Ok(payload) => payload,
            Err(size) => return format!("{key} ({size} bytes, which is too many)"),
        };
        if packet.encoding.starts_with(muster_wire::message::JSON) {
            return format!("{key} {}", String::from_utf8_lossy(payload));
        }
        let text = match self.decoded(packet) {
            Some(message) => message
                .encode(message.keys().0, Format::Json, self.started)
                .map(|outbound| String::from_utf8_lossy(&outbound.payload).into_owned()),
            None => return format!("{key} ({} bytes that are not understood)", payload.len()),
        };
        format!("{key} ({} bytes) {}", payload.len(), text.unwrap_or_default())
    }

    fn decoded(&self, packet: &Packet) -> Option<Message> {
        Message::decode(&self.space, packet).ok()
    }

    /// The first command that differs, both sides cut to where they part.
    fn place(&self, difference: &Difference) -> Place {
        let Difference { step, now } = difference;
        let then = step.commands.as_deref().unwrap_or_default();
        let now = match now {
            Ok(now) => now.as_slice(),
            Err(error) => {
                let text = clean(&error.to_string(), MAX_SHOWN);
                return Place { command: 1, then: None, now: Some(text) };
            }
        };
        let same = then.iter().zip(now).take_while(|(then, now)| then == now).count();
        let (then, now) = (then.get(same), now.get(same));
        let side = |command: Option<&Command>| command.map(|command| self.command(command));
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
        Place { command: same + 1, then: cut(texts.0), now: cut(texts.1) }
    }

    fn difference(&self, difference: &Difference) -> String {
        let Place { command, then, now } = self.place(difference);
        let step = &difference.step;
        let missing = if step.commands.is_some() {
            "nothing more"
        } else {
            "nothing: the recording breaks off here"
        };
        format!(
            "input {} at {:+.6} s differs in command {command}\n  input:    {}\n  recorded: {}\n  now:      {}",
            step.number,
            self.at(step.tick),
            clean(&self.input(&step.input), MAX_SHOWN),
            then.as_deref().unwrap_or(missing),
            now.as_deref().unwrap_or("nothing more"),
        )
    }
}
