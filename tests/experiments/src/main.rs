//! Runs the experiments and writes their results.

use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::path::PathBuf;

use clap::{Parser, Subcommand};
use muster_experiments::experiments;
use muster_experiments::formations::Formation;
use muster_experiments::grid::{random, scores, variations};
use muster_experiments::methods::{Method, Recipe};
use muster_experiments::moving::page::moving;
use muster_experiments::results::Page;
use muster_experiments::seeds::{HELD_OUT, TRAINING, judging};
use muster_experiments::statistics::Estimate;

/// Divides formations, random systems and planted fleets by all methods, and tells how well.
#[derive(Debug, Parser)]
#[command(
    version,
    after_help = "Examples:\n  muster-experiments all --out results\n  muster-experiments formations --quick\n  \
                  muster-experiments grid --around chosen"
)]
struct Arguments {
    #[command(subcommand)]
    what: What,
    /// Where RESULTS.md and results.csv go, a folder that is made if need be; without it the page goes to standard
    /// output
    #[arg(long, global = true, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Few seeds: shows that everything works, and measures nothing well
    #[arg(long, global = true)]
    quick: bool,
}

#[derive(Debug, Clone, Copy, Subcommand)]
enum What {
    /// All experiments but the grid
    All,
    /// Formations that experts divide, squads and platoons
    Formations,
    /// The same with wrong distances
    Noise,
    /// Random systems, of which nobody knows the right division
    Systems,
    /// Planted fleets, whose division is known
    Planted,
    /// Fleets that move, whose division is known at any moment, through the cores of all services
    Moving,
    /// What each choice of the method is worth, on training seeds
    Grid {
        /// So many recipes made by chance, instead of all that differ from one in one choice
        #[arg(long, value_name = "RECIPES", value_parser = clap::value_parser!(u32).range(1..=100_000))]
        random: Option<u32>,
        /// The recipe that they differ from
        #[arg(long, value_enum, default_value_t = Around::Live)]
        around: Around,
    },
}

/// A recipe to begin with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Around {
    /// The live system's
    Live,
    /// What training seeds have chosen
    Chosen,
}

/// Seed of the recipes that chance makes.
const RECIPE_SEED: u64 = 1;

/// Seeds of a quick run.
const FEW: usize = 5;

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let count = if arguments.quick { FEW } else { HELD_OUT.count() };
    let seeds: Vec<u64> = judging(count).collect();
    let (formations, methods) = (Formation::all()?, Method::all());
    // The paper looks at one embedding beside its own; Girvan and Newman's method sees no distances.
    let noisy: Vec<Method> = methods
        .iter()
        .filter(|method| {
            matches!(method, Method::Hope(0) | Method::HopeConcatenated | Method::Multimodal(..))
        })
        .cloned()
        .collect();
    let mut page = Page { text: "# Experiments\n\n".to_owned(), ..Page::default() };
    let is = |what: &str| match arguments.what {
        What::All => true,
        What::Formations => what == "formations",
        What::Noise => what == "noise",
        What::Systems => what == "systems",
        What::Planted => what == "planted",
        What::Moving => what == "moving",
        What::Grid { .. } => false,
    };
    if is("formations") {
        page.append(experiments::formations(&formations, &methods, &seeds, &progress)?);
    }
    if is("noise") {
        page.append(experiments::noise(&formations, &noisy, &seeds, &progress)?);
    }
    if is("systems") {
        page.append(experiments::systems(&methods, &seeds, &progress)?);
    }
    if is("planted") {
        page.append(experiments::planted_fleets(&methods, &seeds, &progress)?);
    }
    if is("moving") {
        page.append(moving(arguments.quick, &seeds, &progress)?.page);
    }
    if let What::Grid { random, around } = arguments.what {
        page.text = grid(count, random, around)?;
    }
    progress("");
    match arguments.out {
        None => print!("{}", page.text),
        Some(folder) => {
            page.write(&folder)?;
            eprintln!("written: {}", folder.display());
        }
    }
    Ok(())
}

fn grid(seeds: usize, recipes: Option<u32>, around: Around) -> anyhow::Result<String> {
    let formations = Formation::all()?;
    let seeds: Vec<u64> = TRAINING.take(seeds).collect();
    let mut rows = Vec::new();
    let all = match recipes {
        Some(count) => random(count as usize, RECIPE_SEED),
        None => variations(&match around {
            Around::Live => Recipe::live(),
            Around::Chosen => Recipe::chosen(),
        }),
    };
    for (done, variation) in all.iter().enumerate() {
        progress(&format!("{} ({} of {})", variation.name, done + 1, all.len()));
        rows.push((variation, scores(&formations, &variation.recipe, &seeds)?));
    }
    progress("");
    rows.sort_by(|left, right| right.1.worth().total_cmp(&left.1.worth()));
    let mut page = String::from("# What each choice is worth\n\n");
    writeln!(page, "Robots in the right team in percent, over {} training seeds.\n", seeds.len())?;
    writeln!(
        page,
        "| choice | worth | squads, range | platoons | noisy | squads, net | platoons | noisy | planted |"
    )?;
    writeln!(page, "| --- | --- | --- | --- | --- | --- | --- | --- | --- |")?;
    for (variation, scores) in rows {
        let cell = |shares: &[f64]| format!("{:.2}", 100.0 * Estimate::of(shares).mean);
        let of_radio = |at: usize| {
            [&scores.squads[at], &scores.platoons[at], &scores.noisy[at]]
                .map(|shares| cell(shares))
                .join(" | ")
        };
        writeln!(
            page,
            "| {} | {:.2} | {} | {} | {} |",
            variation.name,
            100.0 * scores.worth(),
            of_radio(0),
            of_radio(1),
            cell(&scores.planted)
        )?;
    }
    Ok(page)
}

/// One line on a terminal; nothing where standard error is none.
fn progress(what: &str) {
    if std::io::stderr().is_terminal() {
        eprint!("\r\x1b[K{what}");
    }
}
