//! What was measured, as a page with tables, and as a picture of the age of the data over time.

use std::fmt::Write as _;
use std::process::Command;

use super::run_plan::{Measured, RunPlan, Spread};

/// `ingest`'s tick in milliseconds, by its default of 10 Hz: a pose waits for the next frame up to this
/// long, half of it on average.
const TICK_MS: f64 = 100.0;

/// What is wanted of the 99th percentile beyond the frame, in milliseconds, by the number of robots.
const GOALS_MS: [(usize, f64); 2] = [(50, 20.0), (500, 60.0)];

/// What is wanted of large fleets: so many robots that put so many poses per second are divided at least so many times per
/// second, by data whose age at the 99th percentile is at most so many milliseconds.
const LARGE_FLEETS: [LargeFleet; 3] = [
    LargeFleet { robots: 5000, rate_hz: 10.0, divisions_hz: Some(5.0), age_ms: 500.0 },
    LargeFleet { robots: 20_000, rate_hz: 1.0, divisions_hz: None, age_ms: 2000.0 },
    LargeFleet { robots: 50_000, rate_hz: 1.0, divisions_hz: None, age_ms: 5000.0 },
];

/// A goal of [`LARGE_FLEETS`].
struct LargeFleet {
    robots: usize,
    rate_hz: f64,
    divisions_hz: Option<f64>,
    age_ms: f64,
}

/// Growth of the age that counts as none, in milliseconds per minute: in half an hour it would not be
/// noticed, and a fit through some hundred divisions is not better than that.
const MAX_AGE_GROWTH_MS: f64 = 100.0;

/// With busy neighbours, divisions may rest on data that is so many times as old as without, and no older: the
/// rate falls in proportion to the processor time that is left, and never to nothing.
const MAX_BUSY_AGE_RATIO: f64 = 10.0;

/// How much longer a pose may take to its division with wishes than without, in milliseconds at the 99th percentile.
const MAX_WISHES_COST_MS: f64 = 3.0;

/// Bytes per second for each robot below which a key is left out of the page.
const LEAST_BYTES_HZ: f64 = 0.05;

/// A goal, what was measured, and whether it is reached.
#[derive(Debug, Clone, PartialEq)]
pub struct Goal {
    /// What is wanted.
    pub wanted: String,
    /// What was measured.
    pub measured: String,
    /// Whether that is enough.
    pub reached: bool,
}

/// A run that could not be measured.
#[derive(Debug, Clone)]
pub struct Failed {
    /// What was to be run.
    pub plan: RunPlan,
    /// Why there is no measurement.
    pub reason: String,
}

/// The goals of all runs.
#[must_use]
pub fn goals(all: &[Measured], failed: &[Failed]) -> Vec<Goal> {
    let (busy, quiet): (Vec<_>, Vec<_>) = all.iter().partition(|measured| measured.plan.busy > 0);
    let mut goals: Vec<_> = quiet.iter().flat_map(|measured| goals_quiet(measured)).collect();
    let (pinned, alone): (Vec<_>, Vec<_>) =
        quiet.into_iter().partition(|measured| measured.plan.pins > 0);
    let same = |robots| alone.iter().find(|other| other.plan.robots == robots);
    for measured in pinned {
        goals.extend(same(measured.plan.robots).map(|alone| goal_wishes(alone, measured)));
    }
    for measured in busy {
        goals.extend(same(measured.plan.robots).map(|alone| goal_busy(alone, measured)));
    }
    goals.extend(failed.iter().map(|Failed { plan, reason }| Goal {
        wanted: format!(
            "{} at {} Hz: a division of all, to be measured",
            robots(plan),
            plan.rate_hz
        ),
        measured: reason.clone(),
        reached: false,
    }));
    goals
}

/// That wishes cost little time.
fn goal_wishes(without: &Measured, with: &Measured) -> Goal {
    let beyond = |measured: &Measured| Spread::of(measured.ways.beyond.iter().copied());
    let (without, with, plan) = (beyond(without), beyond(with), &with.plan);
    Goal {
        wanted: format!(
            "{} robots of which {} are pinned: p99 at most {MAX_WISHES_COST_MS} ms more beyond the frame",
            plan.robots, plan.pins
        ),
        measured: format!(
            "{:+.1} ms, p50 {:+.1} ms",
            with.p99 - without.p99,
            with.p50 - without.p50
        ),
        reached: with.p99 - without.p99 <= MAX_WISHES_COST_MS,
    }
}

/// That divisions go on with neighbours: how long until the next one, next to the age of the data without them.
fn goal_busy(alone: &Measured, busy: &Measured) -> Goal {
    let p50 = |measured: &Measured| Spread::of(measured.ages().into_iter().map(|(_, age)| age)).p50;
    let most = MAX_BUSY_AGE_RATIO * p50(alone);
    let pause = busy.longest_pause();
    let oldest = busy.ages().into_iter().map(|(_, age)| age).fold(0.0, f64::max);
    Goal {
        wanted: format!(
            "{} robots, with neighbours: divisions at most {most:.0} ms apart, and their data no older \
             ({MAX_BUSY_AGE_RATIO} times its age without them)",
            busy.plan.robots
        ),
        measured: format!("{pause:.0} ms apart, data {oldest:.0} ms old"),
        reached: pause <= most && oldest <= most,
    }
}

/// The goals of a run without neighbours.
fn goals_quiet(measured: &Measured) -> Vec<Goal> {
    let (robots, named) = (measured.plan.robots, robots(&measured.plan));
    let mut goals = Vec::new();
    for (_, most) in GOALS_MS.iter().filter(|(of, _)| *of == robots) {
        let p99 = Spread::of(measured.ways.beyond.iter().copied()).p99;
        goals.push(Goal {
            wanted: format!("{named}: p99 at most {most} ms beyond the frame"),
            measured: format!("{p99:.1} ms"),
            reached: p99 <= *most,
        });
    }
    let rate_hz = measured.plan.rate_hz;
    let large =
        LARGE_FLEETS.iter().find(|fleet| (fleet.robots, fleet.rate_hz) == (robots, rate_hz));
    if let Some(least) = large.and_then(|fleet| fleet.divisions_hz) {
        goals.push(Goal {
            wanted: format!("{named}: at least {least} divisions per second"),
            measured: format!("{:.1}", measured.rate()),
            reached: measured.rate() >= least,
        });
    }
    if let Some(LargeFleet { age_ms, .. }) = large {
        let p99 = Spread::of(measured.ages().into_iter().map(|(_, age)| age)).p99;
        goals.push(Goal {
            wanted: format!("{named} at {rate_hz} Hz: p99 of the age at most {age_ms} ms"),
            measured: format!("{p99:.0} ms"),
            reached: p99 <= *age_ms,
        });
    }
    goals.push(Goal {
        wanted: format!("{named}: the age does not grow (at most {MAX_AGE_GROWTH_MS} ms/min)"),
        measured: format!("{:+.0} ms/min", measured.growth()),
        reached: measured.growth() <= MAX_AGE_GROWTH_MS,
    });
    let lost = measured.lost_on_the_way.max(0);
    goals.push(Goal {
        wanted: format!("{named}: nothing lost but superseded poses"),
        measured: format!(
            "{} poses without a division, {lost} messages lost on the way, dropped or refused: {:?}",
            measured.ways.missing, measured.dropped
        ),
        reached: measured.ways.missing == 0 && lost == 0 && measured.dropped.is_empty(),
    });
    goals
}

/// What a program prints in one line, or "unknown".
fn output_of(program: &str, arguments: &[&str]) -> String {
    let output =
        Command::new(program).args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output();
    let text = output.ok().and_then(|output| String::from_utf8(output.stdout).ok());
    text.and_then(|text| text.lines().next().map(str::to_owned)).unwrap_or_else(|| "unknown".into())
}

/// The version of a package by the lock file that this was built with.
fn locked(package: &str) -> &'static str {
    let lock = include_str!("../../../Cargo.lock");
    let entry = format!("name = \"{package}\"\nversion = \"");
    let rest = lock.split_once(&entry).map(|(_, rest)| rest);
    rest.and_then(|rest| rest.split('"').next()).unwrap_or("unknown")
}

fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let line = info.lines().find(|line| line.starts_with(name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    let model = field("model name").unwrap_or_else(|| "an unknown processor".into());
    let memory = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let kib: Option<f64> = memory.split_whitespace().nth(1).and_then(|kib| kib.parse().ok());
    let gib = kib.unwrap_or(f64::NAN) / f64::from(1 << 20);
    format!("{cores} cores of {model}, {gib:.0} GiB, Linux {}", output_of("uname", &["-r"]))
}

fn spread(spread: Spread) -> String {
    format!("{:.1} | {:.1} | {:.1}", spread.p50, spread.p99, spread.most)
}

fn pair(spread: Spread) -> String {
    format!("{:.1} / {:.1}", spread.p50, spread.p99)
}

/// The page. `command` is how it was asked for, `plot` the name of its picture.
///
/// # Errors
/// Never; the signature is that of writing.
pub fn page(
    all: &[Measured],
    failed: &[Failed],
    command: &str,
    plot: Option<&str>,
) -> Result<String, std::fmt::Error> {
    let mut page = String::new();
    let revision = output_of("git", &["describe", "--always", "--dirty", "--abbrev=10"]);
    writeln!(page, "# From a pose to its team: latency, age, load\n")?;
    writeln!(
        page,
        "Written by `{command}` on {}.\n",
        output_of("date", &["-u", "+%Y-%m-%d %H:%M UTC"])
    )?;
    writeln!(page, "- machine: {}", machine())?;
    writeln!(
        page,
        "- versions: Muster {} at {revision}, Zenoh {}, {}; {} build",
        env!("CARGO_PKG_VERSION"),
        locked("zenoh"),
        output_of("rustc", &["--version"]),
        if cfg!(debug_assertions) { "debug" } else { "release" }
    )?;
    for measured in all {
        let plan = &measured.plan;
        let settings = plan.settings.iter().map(|(service, set)| format!(", {service} {set}"));
        writeln!(
            page,
            "- {}: march in {} teams, {} poses per second each, {:.0} s{}",
            robots(plan),
            plan.teams,
            plan.rate_hz,
            measured.seconds,
            settings.collect::<String>()
        )?;
    }
    writeln!(page, "\n{DEFINITIONS}")?;
    goals_table(&mut page, &goals(all, failed))?;
    ways_table(&mut page, all)?;
    ages_table(&mut page, all)?;
    if let Some(plot) = plot {
        writeln!(page, "![age of the data over time]({plot})\n")?;
    }
    stages_table(&mut page, all)?;
    poses_table(&mut page, all)?;
    processes_table(&mut page, all)?;
    traffic_tables(&mut page, all)?;
    Ok(page)
}

/// What the numbers are, for readers of the page alone.
const DEFINITIONS: &str = "\
A router, the four services and all robots run as processes of one host, over TCP on loopback, with \
default settings, by which the number of teams is chosen as well. The robots march in squads and move with every pose; \
each has a phase of its own. They join 1,000 a second, and also report links with every fifth pose and ranks with every tenth. \
Robots of fleets of more than 5,000 report through one gateway that declares no keys for them; the others declare their own, as \
`muster robot` does. The heading of a pose is its number, which the roster contains, and the header of each division \
names its frame: which poses are in a division is known, not estimated. *busy*: so many other processes for each processor \
compute all the time. *pinned*: wishes hold so many robots in their teams.

- **pose → division**: from the put of a pose to the arrival, at a client of the same router, of the \
first message on `teams` that uses it or, if the robot has put another meanwhile, that one.
- **beyond the frame**: the same for poses in a division, without the time from their arrival at \
`ingest` to the frame (10 frames a second by default).
- **pose → robot**: from the put of the pose to the arrival of `robot/*/team` with another team.
- **age**: time from the arrival of the oldest pose behind a division at `ingest` to the division.
- **round trip**: of a message as long as a pose, through the same router and back, between two \
processes that do nothing else; without robots (idle), and with them (loaded).

All times are in milliseconds.
";

/// How many robots a run had, whether it had neighbours, and how many were pinned.
fn robots(plan: &RunPlan) -> String {
    let RunPlan { robots, busy, pins, .. } = plan;
    match (busy, pins) {
        (0, 0) => format!("{robots} robots"),
        (0, pins) => format!("{robots} robots, {pins} pinned"),
        (busy, _) => format!("{robots} robots, {busy} busy"),
    }
}

fn goals_table(page: &mut String, goals: &[Goal]) -> std::fmt::Result {
    writeln!(page, "## Goals\n\n| goal | measured | |\n| --- | --- | --- |")?;
    for goal in goals {
        let verdict = if goal.reached { "reached" } else { "**missed**" };
        writeln!(page, "| {} | {} | {verdict} |", goal.wanted, goal.measured)?;
    }
    writeln!(page)
}

fn ways_table(page: &mut String, all: &[Measured]) -> std::fmt::Result {
    writeln!(page, "## From pose to division\n")?;
    writeln!(
        page,
        "| robots | divisions/s | pose → division p50 | p99 | max | beyond the frame p50 | p99 | max | \
         pose → robot p50 / p99 (changes) | round trip idle p50 / p99 | loaded p50 / p99 |"
    )?;
    writeln!(page, "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")?;
    for measured in all {
        writeln!(
            page,
            "| {} | {:.1} | {} | {} | {} ({}) | {:.2} / {:.2} | {:.2} / {:.2} |",
            robots(&measured.plan),
            measured.rate(),
            spread(Spread::of(measured.ways.whole.iter().copied())),
            spread(Spread::of(measured.ways.beyond.iter().copied())),
            pair(Spread::of(measured.changes.iter().copied())),
            measured.changes.len(),
            measured.round_trip[0].p50,
            measured.round_trip[0].p99,
            measured.round_trip[1].p50,
            measured.round_trip[1].p99,
        )?;
    }
    writeln!(page, "\nOne tick is {TICK_MS} ms.\n")
}

fn ages_table(page: &mut String, all: &[Measured]) -> std::fmt::Result {
    writeln!(page, "## Age of the data at the decision\n")?;
    writeln!(
        page,
        "| robots | p50 | p99 | max | growth, ms per minute | longest pause between divisions |"
    )?;
    writeln!(page, "| --- | --- | --- | --- | --- | --- |")?;
    for measured in all {
        let ages = Spread::of(measured.ages().into_iter().map(|(_, age)| age));
        let growth = measured.growth();
        let pause = measured.longest_pause();
        writeln!(
            page,
            "| {} | {} | {growth:+.1} | {pause:.1} |",
            robots(&measured.plan),
            spread(ages)
        )?;
    }
    writeln!(page)
}

fn stages_table(page: &mut String, all: &[Measured]) -> std::fmt::Result {
    writeln!(page, "## Where the time goes, p50 / p99\n")?;
    let mut row = |name: &str, of: &dyn Fn(&Measured) -> String| {
        let cells: Vec<_> = all.iter().map(of).collect();
        writeln!(page, "| {name} | {} |", cells.join(" | "))
    };
    row("robots", &|measured| robots(&measured.plan))?;
    row("---", &|_| "---".to_owned())?;
    row("robot → ingest", &|measured| pair(Spread::of(measured.ways.to_ingest.iter().copied())))?;
    row("in ingest until the frame", &|measured| {
        pair(Spread::of(measured.ways.held.iter().copied()))
    })?;
    let between = |measured: &Measured, from: fn(&super::follow::Division) -> (u64, u64)| {
        let took = measured.divisions.iter().map(from);
        pair(Spread::of(took.map(|(begin, end)| end.saturating_sub(begin) as f64 / 1e3)))
    };
    row("ingest → embedder", &|m| between(m, |d| (d.stages[0].1, d.stages[1].0)))?;
    row("embedder", &|m| between(m, |d| (d.stages[1].0, d.stages[1].1)))?;
    row("of it: fusing, radius", &|m| pair(m.embedding[0]))?;
    row("of it: similarity", &|m| pair(m.embedding[1]))?;
    row("of it: decomposition", &|m| pair(m.embedding[2]))?;
    row("embedder → clusterer", &|m| between(m, |d| (d.stages[1].1, d.stages[2].0)))?;
    row("clusterer", &|m| between(m, |d| (d.stages[2].0, d.stages[2].1)))?;
    row("clusterer → reader", &|m| between(m, |d| (d.stages[2].1, d.arrived)))?;
    row("in parallel: division → audit", &|m| pair(m.audit[0]))?;
    row("of it: auditor", &|m| pair(m.audit[1]))?;
    writeln!(
        page,
        "\nThe time of a stage is from the receipt of its input to its output, with the wait for the \
         previous job.\n"
    )?;
    for measured in all {
        let robots = robots(&measured.plan);
        let modes: Vec<_> =
            measured.modes.iter().map(|(mode, count)| format!("{count} {mode}")).collect();
        let (least, most) = measured.dimensions;
        writeln!(
            page,
            "- {robots}: {:.1} embeddings/s ({}), vectors of length {least} to {most}, largest \
             residual {:.1e}; {:.1} audits/s",
            measured.modes.values().sum::<usize>() as f64 / measured.seconds,
            modes.join(", "),
            measured.residual,
            measured.audits as f64 / measured.seconds
        )?;
    }
    writeln!(page)
}

fn poses_table(page: &mut String, all: &[Measured]) -> std::fmt::Result {
    writeln!(page, "## What happened to the poses\n")?;
    writeln!(
        page,
        "| robots | put | per second | in a division | superseded by a later one of the robot | in none | \
         messages lost on the way | dropped, refused, failed | replaced in inboxes |"
    )?;
    writeln!(page, "| --- | --- | --- | --- | --- | --- | --- | --- | --- |")?;
    let listed = |counts: &std::collections::BTreeMap<String, u64>| {
        let counts: Vec<_> = counts.iter().map(|(name, count)| format!("{name} {count}")).collect();
        if counts.is_empty() { "0".to_owned() } else { counts.join(", ") }
    };
    for measured in all {
        writeln!(
            page,
            "| {} | {} | {:.0} | {} | {} | {} | {} | {} | {} |",
            robots(&measured.plan),
            measured.poses,
            measured.poses as f64 / measured.seconds,
            measured.ways.beyond.len(),
            measured.ways.superseded,
            measured.ways.missing,
            measured.lost_on_the_way.max(0),
            listed(&measured.dropped),
            listed(&measured.replaced),
        )?;
    }
    writeln!(page)
}

fn processes_table(page: &mut String, all: &[Measured]) -> std::fmt::Result {
    writeln!(page, "## What each process uses: processor % of one core / MiB resident\n")?;
    let Some(first) = all.first() else { return Ok(()) };
    let names: Vec<_> = first.taken.iter().map(|taken| taken.name).collect();
    writeln!(page, "| robots | {} |", names.join(" | "))?;
    writeln!(page, "| --- |{}", " --- |".repeat(names.len()))?;
    for measured in all {
        let cells = measured
            .taken
            .iter()
            .map(|taken| format!(" {:.1} / {:.0} |", taken.processors * 100.0, taken.memory));
        writeln!(page, "| {} |{}", robots(&measured.plan), cells.collect::<String>())?;
    }
    writeln!(page, "\nThe same memory for each robot, in KiB:\n")?;
    writeln!(page, "| robots | {} |", names.join(" | "))?;
    writeln!(page, "| --- |{}", " --- |".repeat(names.len()))?;
    for measured in all {
        let of_robots = measured.plan.robots as f64;
        let cells = measured.taken.iter().map(|taken| taken.memory * 1024.0 / of_robots);
        let cells = cells.map(|kib| format!(" {kib:.1} |"));
        writeln!(page, "| {} |{}", robots(&measured.plan), cells.collect::<String>())?;
    }
    writeln!(
        page,
        "\n*robots* is the process that simulates all robots; *listener* the one that measures.\n"
    )
}

fn traffic_tables(page: &mut String, all: &[Measured]) -> std::fmt::Result {
    writeln!(
        page,
        "## What each key carries\n\nPayloads, without what the bus adds to each message, in the seconds before the \
         measurement. What robots carry is that of ten of them. Keys below 0.05 bytes a second for each robot are left out."
    )?;
    for measured in all {
        writeln!(page, "\n{}:\n", robots(&measured.plan))?;
        writeln!(page, "| key | messages/s | bytes each | bytes/s for each robot |")?;
        writeln!(page, "| --- | --- | --- | --- |")?;
        let carried = measured.traffic.carried().into_iter();
        for one in carried.filter(|one| one.robot_bytes_hz >= LEAST_BYTES_HZ) {
            writeln!(
                page,
                "| `{}` | {:.1} | {:.0} | {:.1} |",
                one.key, one.messages_hz, one.bytes, one.robot_bytes_hz
            )?;
        }
    }
    Ok(())
}

/// The age of the data at each decision over time, one line for each run.
#[must_use]
pub fn plot(all: &[Measured]) -> String {
    const WIDTH: f64 = 720.0;
    const HEIGHT: f64 = 320.0;
    const COLOURS: [&str; 6] = ["#1b6", "#26c", "#c33", "#c80", "#808", "#555"];
    let lines: Vec<_> = all.iter().map(Measured::ages).collect();
    let points = || lines.iter().flatten();
    let last = points().map(|point| point.0).fold(1.0, f64::max);
    let most = points().map(|point| point.1).fold(1.0, f64::max);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<text x=\"4\" y=\"14\">age of the oldest pose at the decision, ms (top: \
         {most:.0}) over {last:.0} s</text>\n",
        WIDTH + 120.0,
        HEIGHT + 24.0
    );
    for (number, (measured, line)) in all.iter().zip(&lines).enumerate() {
        let colour = COLOURS[number % COLOURS.len()];
        let places = line.iter().map(|(at, age)| {
            format!("{:.1},{:.1}", at / last * WIDTH, HEIGHT + 22.0 - age / most * HEIGHT)
        });
        let places: Vec<_> = places.collect();
        svg += &format!(
            "<polyline fill=\"none\" stroke=\"{colour}\" points=\"{}\"/>\n<text x=\"{}\" y=\"{}\" \
             fill=\"{colour}\">{}</text>\n",
            places.join(" "),
            WIDTH + 6.0,
            40 + 18 * number,
            robots(&measured.plan)
        );
    }
    svg + "</svg>\n"
}
