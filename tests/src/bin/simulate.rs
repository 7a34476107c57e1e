//! Runs any number of seeds of the whole-fleet simulation, and reports what broke.

use std::collections::BTreeSet;
use std::io::Write as _;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Parser;
use muster_tests::simulation::{Batch, Options, Outcome, in_ticks, run_batch, simulate};

/// Runs the real hosts of all services and a fleet on a virtual bus, with faults that follow from a
/// seed, and checks after every event that all promises hold.
///
/// Needs no router. Exit codes: 0 every promise held, 1 one was broken, 2 wrong flag.
#[derive(Debug, Parser)]
#[command(name = "simulate")]
struct Args {
    /// How many seeds to run
    #[arg(long, default_value_t = 300, conflicts_with = "seed")]
    seeds: u64,
    /// The first of them
    #[arg(long, default_value_t = 0, conflicts_with = "seed")]
    first: u64,
    /// Run this seed alone, and print its faults
    #[arg(long)]
    seed: Option<u64>,
    /// With --seed: print every event
    #[arg(long, requires = "seed")]
    log: bool,
    /// How long faults happen, in steps of 10 ms of virtual time
    #[arg(long, default_value_t = Options::default().steps, value_parser = clap::value_parser!(u64).range(100..=1_000_000))]
    steps: u64,
    /// How many robots; by the seed if left out
    #[arg(long, value_parser = robots)]
    robots: Option<usize>,
    /// Of those, how many really start: what a shortened run needs to be replayed
    #[arg(long, value_parser = robots)]
    fleet: Option<usize>,
    /// Of all faults of the seed, only those with these numbers, such as 3,17; or none
    #[arg(long, value_parser = numbers)]
    only: Option<Numbers>,
    /// Of the seeds, only those in which a fault of this kind happens, such as "bridge killed"
    #[arg(long, conflicts_with = "seed")]
    having: Option<String>,
    /// How many robots appear in every second in addition to the faults of the seed, and report only once
    #[arg(long, default_value_t = 0)]
    ghosts: usize,
    /// How many threads; all processors if left out
    #[arg(long)]
    jobs: Option<usize>,
    /// How many seconds a failing run may be shortened
    #[arg(long, default_value_t = 60)]
    shrink_s: u64,
}

#[derive(Debug, Clone)]
struct Numbers(BTreeSet<usize>);

fn numbers(text: &str) -> Result<Numbers, String> {
    if text == "none" {
        return Ok(Numbers(BTreeSet::new()));
    }
    let numbers = text.split(',').map(|number| {
        number.trim().parse().map_err(|_| "must be numbers with commas, such as 3,17, or none")
    });
    Ok(Numbers(numbers.collect::<Result<_, _>>()?))
}

fn robots(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(robots @ 1..=2000) => Ok(robots),
        _ => Err("must be a number from 1 to 2000".to_owned()),
    }
}

fn main() -> ExitCode {
    let args = Args::parse();
    let options = Options {
        robots: args.robots,
        fleet: args.fleet,
        steps: args.steps,
        only: args.only.clone().map(|Numbers(only)| only),
        ghosts: args.ghosts,
    };
    let held = match args.seed {
        Some(seed) => one(seed, &options, args.log),
        None => batch(&args, options),
    };
    match held {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "{error:#}");
            ExitCode::FAILURE
        }
    }
}

fn one(seed: u64, options: &Options, log: bool) -> anyhow::Result<bool> {
    let outcome = simulate(seed, options, None, log);
    let mut out = std::io::stdout().lock();
    for line in if log { &outcome.log } else { &outcome.faults } {
        writeln!(out, "{line}")?;
    }
    let Outcome { stats, robots, failure, .. } = outcome;
    writeln!(out, "seed {seed}: {robots} robots, {} events", stats.events)?;
    match &failure {
        None => writeln!(out, "every promise held; agreement after {}", in_ticks(stats.agreement))?,
        Some(failure) => writeln!(out, "broken: {}\n  {}", failure.promise, failure.seen)?,
    }
    Ok(failure.is_none())
}

fn batch(args: &Args, options: Options) -> anyhow::Result<bool> {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let batch = Batch {
        first: args.first,
        seeds: args.seeds,
        jobs: args.jobs.unwrap_or(processors),
        options,
        having: args.having.clone(),
        mutant: None,
        shrink_within: Duration::from_secs(args.shrink_s),
    };
    let started = Instant::now();
    let every = (args.seeds / 20).max(1);
    let summary = run_batch(
        &batch,
        |done, _| {
            if done % every == 0 {
                let seconds = started.elapsed().as_secs();
                let _ = writeln!(std::io::stderr(), "{done} of {} seeds, {seconds} s", args.seeds);
            }
        },
        |report| {
            let _ = writeln!(std::io::stderr(), "{report}");
        },
    );
    let seconds = started.elapsed().as_secs_f64();
    writeln!(std::io::stdout(), "{}in {seconds:.1} s", summary.text()).context("cannot write")?;
    Ok(summary.failed.is_empty())
}
