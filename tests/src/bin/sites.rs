//! Measures what crosses the links between three sites for each robot of one fleet, by where its services run.
//! `sites --help` has the flags; `tests/peers/sites` builds and runs it in release. It needs root.

use std::io::Write as _;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use muster_tests::hosts::lab;
use muster_tests::hosts::sites::{ARRANGEMENTS, measure};

/// One fleet over three sites in network namespaces, each with a router of its own; a console follows the teams at the third.
#[derive(Debug, Parser)]
struct Options {
    /// Sizes of the fleet, one run for each
    #[arg(long, value_delimiter = ',', default_values_t = [18, 72],
          value_parser = clap::value_parser!(u32).range(2..=2000))]
    robots: Vec<u32>,
    /// Seconds that are measured in each run
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
}

fn main() -> anyhow::Result<ExitCode> {
    let options = Options::parse();
    if let Some(missing) = lab::missing()? {
        writeln!(std::io::stderr(), "nothing is measured: {missing}")?;
        return Ok(ExitCode::FAILURE);
    }
    for robots in options.robots {
        for arrangement in ARRANGEMENTS {
            let measured =
                measure(arrangement, robots as usize, Duration::from_secs(options.seconds))?;
            let each = |bytes: f64| bytes / f64::from(robots) / 1024.0;
            let links: Vec<String> = measured
                .links
                .iter()
                .map(|(site, crossed)| {
                    let (received, sent) = (each(crossed.received), each(crossed.sent));
                    format!("{site} in {received:.2} out {sent:.2}")
                })
                .collect();
            writeln!(
                std::io::stdout(),
                "{robots} robots, {}: KiB/s per robot: {}; {:.1} divisions a second",
                arrangement.name,
                links.join(", "),
                measured.divisions
            )?;
        }
    }
    Ok(ExitCode::SUCCESS)
}
