//! Runs the experiments and writes their results.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Parser, Subcommand, ValueEnum};
use muster_experiments::collapse::{RANKS, collapse};
use muster_experiments::experiments;
use muster_experiments::explained::papers_numbers;
use muster_experiments::formations::{Formation, Radio};
use muster_experiments::goals::goals;
use muster_experiments::grid::{
    Scores, Variation, described, left_out, random, scores, variations,
};
use muster_experiments::methods::{Method, Recipe};
use muster_experiments::moving::page::moving;
use muster_experiments::physical::Case;
use muster_experiments::progress::Bar;
use muster_experiments::results::Page;
use muster_experiments::seeds::{HELD_OUT, TRAINING, held_out};
use muster_experiments::situations::exchange::{Baselines, export};
use muster_experiments::situations::kinds::List;
use muster_experiments::situations::{
    page as situations_page, run as situations_run, steps as situations_steps,
};
use muster_experiments::statistics::Estimate;

/// Divides formations, random systems and planted fleets by all methods, and reports how well.
#[derive(Debug, Parser)]
#[command(
    version,
    after_help = "Examples:\n  muster-experiments all --out results\n  muster-experiments formations --quick\n  \
                  muster-experiments grid --random 200"
)]
struct Arguments {
    #[command(subcommand)]
    what: What,
    /// Where RESULTS.md, results.csv and plots go, a folder that is made if need be; without it the page goes to
    /// standard output
    #[arg(long, global = true, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Few seeds: shows that everything works, and measures nothing well
    #[arg(long, global = true)]
    quick: bool,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    /// All experiments but those with a page of their own: moving, grid and situations
    All,
    /// Formations that experts divide, squads and platoons
    Formations,
    /// The same with wrong distances
    Noise,
    /// Random systems, whose right division is unknown
    Systems,
    /// Planted fleets, whose division is known
    Planted,
    /// Fleets that move, whose division is known at any moment, through the cores of all services
    Moving,
    /// Ten robots in four layouts, recorded, through the real services; takes ten seconds each
    #[cfg(feature = "bus")]
    Physical,
    /// Make the recordings of the physical case again from their seeds, in the folder --out
    Record,
    /// What each choice of the method is worth, on training seeds
    Grid {
        /// Number of random recipes, instead of all that differ from one in one choice
        #[arg(long, value_name = "RECIPES", value_parser = clap::value_parser!(u32).range(1..=100_000))]
        random: Option<u32>,
    },
    /// Kinds of fleets of all sorts, and what others make of them: tests/peers/divide runs it with the others
    Situations {
        /// Which kinds: those that defaults may be chosen on, those that are looked at once, or all
        #[arg(long, value_enum, default_value_t = Kinds::Chosen)]
        kinds: Kinds,
        /// Seeds of each kind; the largest kinds have three at most
        #[arg(
            long,
            value_name = "SEEDS",
            default_value_t = 10,
            value_parser = clap::value_parser!(u32).range(1..=1000)
        )]
        seeds: u32,
        /// The first seed; by default that of the list
        #[arg(long, value_name = "SEED")]
        first: Option<u64>,
        /// Write what the baselines read into this folder, and divide nothing
        #[arg(long, value_name = "FOLDER")]
        export: Option<PathBuf>,
        /// Compare with the divisions that the baselines have written into this folder
        #[arg(long, value_name = "FOLDER", conflicts_with = "export")]
        baselines: Option<PathBuf>,
    },
}

/// Lists of kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kinds {
    Chosen,
    Once,
    All,
}

impl Kinds {
    fn lists(self) -> &'static [List] {
        match self {
            Self::Chosen => &List::ALL[..1],
            Self::Once => &List::ALL[1..],
            Self::All => &List::ALL,
        }
    }
}

/// Seed of random recipes.
const RECIPE_SEED: u64 = 1;

/// What a page begins with.
const TITLE: &str = "# Experiments\n\n";

/// What other pages there are.
const OTHER_PAGES: &str = "Pages of their own have [kinds of fleets of all sorts](situations/RESULTS.md), on which the \
    defaults were chosen, [fleets that move](moving/RESULTS.md), and [what each choice is worth](grid/RESULTS.md).\n\n";

/// Seeds of a quick run.
const QUICK_SEEDS: usize = 5;

/// Most seeds of each kind on which the method is run without one step each.
const STEP_SEEDS: usize = 5;

/// Seeds of each kind of situation in a quick run.
const QUICK_SITUATIONS: usize = 2;

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    match arguments.what {
        What::Record => return record(arguments.out.as_deref()),
        What::Situations { kinds, seeds, first, export, baselines } => {
            let seeds = if arguments.quick { QUICK_SITUATIONS } else { seeds as usize };
            let cases = situations_run::cases(kinds.lists(), seeds, first);
            if let Some(folder) = export {
                return self::export(&cases, &folder);
            }
            let page = situations(&cases, baselines.as_deref(), seeds)?;
            return shown(&page, arguments.out.as_deref());
        }
        _ => {}
    }
    let count = if arguments.quick { QUICK_SEEDS } else { HELD_OUT.count() };
    let seeds: Vec<u64> = held_out(count).collect();
    let (formations, methods) = (Formation::all()?, Method::all());
    // The paper compares one other embedding; Girvan and Newman's method sees no distances.
    let noisy: Vec<Method> = methods
        .iter()
        .filter(|method| {
            matches!(method, Method::Hope(0) | Method::HopeConcatenated | Method::Multimodal(..))
        })
        .cloned()
        .collect();
    let bar = Bar::of(steps(&arguments.what, methods.len(), noisy.len()));
    let progress = |what: &str| bar.step(what);
    let mut page = Page { text: TITLE.to_owned(), ..Page::default() };
    let is = |what: &str| match arguments.what {
        What::All => what != "moving",
        What::Formations => what == "formations",
        What::Noise => what == "noise",
        What::Systems => what == "systems",
        What::Planted => what == "planted",
        What::Moving => what == "moving",
        #[cfg(feature = "bus")]
        What::Physical => what == "physical",
        What::Record | What::Grid { .. } | What::Situations { .. } => false,
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
        page.append(moving(arguments.quick, &seeds, &progress)?);
    }
    #[cfg(feature = "bus")]
    if is("physical") {
        // The first seconds matter most: later pictures show the same robots again.
        let seconds = if arguments.quick { 3.0 } else { 10.0 };
        bar.count(Case::all()?.len());
        page.append(muster_experiments::case_study::physical(seconds, &progress)?);
    }
    if matches!(arguments.what, What::All) {
        page.append(collapse(&formations, &seeds, &progress)?);
        let explained = papers_numbers(&page);
        page.append(explained);
        let goals = goals(&page).text;
        page.text = format!("{TITLE}{OTHER_PAGES}{goals}{}", page.text.trim_start_matches(TITLE));
    }
    if let What::Grid { random } = arguments.what {
        page.text = grid(count, random, &bar)?;
    }
    bar.end();
    shown(&page, arguments.out.as_deref())
}

/// Writes the page into a folder, or else to standard output.
fn shown(page: &Page, folder: Option<&Path>) -> anyhow::Result<()> {
    match folder {
        None => print!("{}", page.text),
        Some(folder) => {
            page.write(folder)?;
            eprintln!("written: {}", folder.display());
        }
    }
    Ok(())
}

/// The page of situations.
fn situations(
    cases: &[situations_run::Case],
    baselines: Option<&Path>,
    seeds: usize,
) -> anyhow::Result<Page> {
    let baselines = baselines.map(Baselines::read).transpose()?;
    let outcomes = situations_run::outcomes(cases, baselines.as_ref())?;
    let steps = situations_steps::steps(seeds.min(STEP_SEEDS))?;
    Ok(situations_page::page(&outcomes, &steps)?)
}

fn grid(seeds: usize, recipes: Option<u32>, bar: &Bar) -> anyhow::Result<String> {
    let formations = Formation::all()?;
    let seeds: Vec<u64> = TRAINING.take(seeds).collect();
    let tables = match recipes {
        Some(count) => {
            vec![("Recipes put together by chance", random(count as usize, RECIPE_SEED))]
        }
        None => vec![
            ("Each step left out", left_out(&Recipe::live())),
            ("Each choice made otherwise", variations(&Recipe::live())),
        ],
    };
    bar.count(tables.iter().map(|(_, all)| all.len()).sum());
    let mut page = String::from("# What each choice is worth\n\n");
    writeln!(
        page,
        "Robots in the right team in percent, over {} training seeds. *Worth* is the mean of formations with both \
         radios, of the same with distances wrong by up to half of them, of planted fleets, and of small fleets \
         that are plain to see, with its 95 % interval. *Mistaken* are planted fleets in which every robot reports \
         the position, the links or the superior of another robot. *As it is*: {}.\n",
        seeds.len(),
        described(&Recipe::live())
    )?;
    for (title, all) in &tables {
        let mut rows = Vec::new();
        for variation in all {
            bar.step(&variation.name);
            rows.push((variation, scores(&formations, &variation.recipe, &seeds)?));
        }
        rows.sort_by(|left, right| right.1.worth().mean.total_cmp(&left.1.worth().mean));
        write!(page, "## {title}\n\n{}\n", grid_table(&rows)?)?;
    }
    Ok(page)
}

/// The table of variations with their scores.
fn grid_table(rows: &[(&Variation, Scores)]) -> anyhow::Result<String> {
    let mut page = String::new();
    writeln!(
        page,
        "| choice | worth | squads, range | platoons | noisy | squads, net | platoons | noisy | planted | plain | \
         mistaken: spatial | connectivity | hierarchy |"
    )?;
    writeln!(page, "|{}", " --- |".repeat(13))?;
    for (variation, scores) in rows {
        let cell = |shares: &[f64]| format!("{:.2}", 100.0 * Estimate::of(shares).mean);
        let of_radio = |at: usize| {
            [&scores.squads[at], &scores.platoons[at], &scores.noisy[at]]
                .map(|shares| cell(shares))
                .join(" | ")
        };
        writeln!(
            page,
            "| {} | {} | {} | {} | {} | {} | {} |",
            variation.name,
            scores.worth().percent(),
            of_radio(0),
            of_radio(1),
            cell(&scores.planted),
            cell(&scores.plain),
            scores.mistaken.each_ref().map(|shares| cell(shares)).join(" | ")
        )?;
    }
    Ok(page)
}

/// Of how many steps each experiment is, those of its loops.
fn steps(what: &What, methods: usize, noisy: usize) -> usize {
    let formations = methods * Radio::ALL.len();
    let noise = noisy * Radio::ALL.len() * 2;
    let systems = experiments::ROBOTS.len() * experiments::TEAMS.len();
    match what {
        What::All => formations + noise + systems + methods + RANKS.len(),
        What::Formations => formations,
        What::Noise => noise,
        What::Systems => systems,
        What::Planted => methods,
        #[cfg(feature = "bus")]
        What::Physical => 0,
        What::Moving | What::Record | What::Grid { .. } | What::Situations { .. } => 0,
    }
}

/// Writes the recordings of the physical case.
fn record(folder: Option<&Path>) -> anyhow::Result<()> {
    let folder = folder.context("record: --out says where the recordings go")?;
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    for case in Case::all()? {
        let file = folder.join(format!("{}.jsonl", case.layout.name));
        std::fs::write(&file, case.record()?.text()?)
            .with_context(|| file.display().to_string())?;
    }
    Ok(())
}
