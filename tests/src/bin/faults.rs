//! Lets every fault of hosts and links happen, and prints the table of services/README.md.
//!
//! `faults [--json] [NAME …]`, as root. It ends with 1 if a promise was not kept.

use std::collections::VecDeque;
use std::io::Write as _;
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use muster_tests::hosts::fault::{FAULTS, Fault};
use muster_tests::hosts::lab;
use muster_tests::hosts::run_plan::{self, Measured};

/// Faults that happen at the same time, each on hosts of its own: they mostly wait.
const PARALLEL_FAULTS: usize = 3;

fn main() -> anyhow::Result<ExitCode> {
    let mut names: Vec<String> = std::env::args().skip(1).collect();
    let json = names.iter().any(|name| name == "--json");
    names.retain(|name| name != "--json");
    let mut chosen = Vec::new();
    for name in &names {
        let known = || FAULTS.map(|fault| fault.name).join(", ");
        let fault = Fault::named(name);
        chosen.push(fault.ok_or_else(|| anyhow::anyhow!("{name:?} is none of: {}", known()))?);
    }
    if chosen.is_empty() {
        chosen = FAULTS.to_vec();
    }
    if let Some(missing) = lab::missing()? {
        anyhow::bail!("hosts cannot be simulated here: {missing}; run as root on Linux");
    }
    let order = chosen.clone();
    let waiting = Mutex::new(VecDeque::from(chosen));
    let results = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..PARALLEL_FAULTS {
            scope.spawn(|| {
                loop {
                    let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
                    let Some(fault) = next else { break };
                    let result = run_plan::run(fault);
                    results
                        .lock()
                        .unwrap_or_else(PoisonError::into_inner)
                        .push((fault.name, result));
                }
            });
        }
    });
    let results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut out = std::io::stdout();
    let mut kept = true;
    if !json {
        writeln!(out, "{}", Measured::head())?;
    }
    for fault in order {
        let found = results.iter().find(|(name, _)| *name == fault.name);
        match found.map(|(_, result)| result) {
            Some(Ok(measured)) => {
                let line = if json { measured.json().to_string() } else { measured.line() };
                writeln!(out, "{line}")?;
                for broken in measured.broken() {
                    kept = false;
                    writeln!(std::io::stderr(), "{}: {broken}", fault.name)?;
                }
            }
            Some(Err(error)) => {
                kept = false;
                writeln!(std::io::stderr(), "{}: {error:#}", fault.name)?;
            }
            None => kept = false,
        }
    }
    Ok(if kept { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
