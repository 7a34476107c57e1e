//! What is chosen with the command and not in the file.

use clap::ValueEnum;
use muster_model::settings::TeamCount;
use serde::Deserialize;

/// Residuals that may be asked for. Below the least one rounding has the last word; above the largest
/// one singular values have no correct digits.
pub const TOLERANCES: (f64, f64) = (1e-12, 1e-1);

/// Divisions of up to so many robots have exact silhouettes, twice as many as those of a live fleet: nothing
/// else waits for a solve.
pub(super) const EXACT_ROBOTS: usize = 20_000;

/// How a file is solved.
#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct Options {
    /// Divide the weights of the modalities by their sum instead of refusing them.
    #[arg(long)]
    pub normalize_weights: bool,
    /// How the Katz similarity is decomposed.
    #[arg(long, value_enum, default_value_t)]
    pub path: PathChoice,
    /// Residual ‖Mᵀ(Sᵀu − σv)‖ of the singular triplets, relative to σ₁, at which the search of the
    /// inverse-free path ends (M = I − αA*).
    #[arg(long, value_name = "RESIDUAL", value_parser = tolerance, default_value_t = Options::default().tolerance)]
    pub tolerance: f64,
    /// How the silhouettes are computed.
    #[arg(long, value_enum, default_value_t)]
    pub silhouette: SilhouetteChoice,
    /// Take the settings of this method where the file gives none, instead of the live fleet's. Of a saved
    /// fleet it replaces the settings of embedder, and init and restarts of clusterer.
    #[arg(long, value_enum, value_name = "METHOD")]
    pub preset: Option<Preset>,
    /// How many teams: a number, a range such as 2..6, or auto, which is 1 to 16; instead of what the file
    /// says. Where it is no number, the relations of the robots decide.
    #[arg(long, value_name = "N|auto|FROM..TO", value_parser = team_count)]
    pub teams: Option<TeamCount>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            normalize_weights: false,
            path: PathChoice::Auto,
            tolerance: 1e-10,
            silhouette: SilhouetteChoice::Auto,
            preset: None,
            teams: None,
        }
    }
}

/// How the Katz similarity is to be decomposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum PathChoice {
    /// dense for up to 2000 robots and where the similarity is wanted in the output, if it fits; else
    /// inverse-free
    #[default]
    Auto,
    /// the similarity by LU, and its full decomposition: exact to rounding, in N³ operations
    Dense,
    /// its leading singular triplets by products with the graphs alone: for large fleets, with a residual
    InverseFree,
}

/// How silhouettes are to be computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum SilhouetteChoice {
    /// exact for up to 20000 robots, sampled for more
    #[default]
    Auto,
    /// from the distances between all pairs of robots
    Exact,
    /// from the squared distances between all pairs of robots, which is exact too and fast, and not the same
    Squared,
    /// the mean estimated from 2000 robots, with its standard error; those of robots and teams as by squared
    Sampled,
}

/// A published method whose settings a solve can begin with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// the paper's: graphs as they are with equal weights, singular vectors as they come, and k-means once from
    /// a random start
    Paper,
}

/// A tolerance as it is written.
fn tolerance(text: &str) -> Result<f64, String> {
    let (least, most) = TOLERANCES;
    match text.parse() {
        Ok(value) if (least..=most).contains(&value) => Ok(value),
        _ => Err(format!("must be a number from {least:e} to {most:e}")),
    }
}

/// A number of teams as it is written.
fn team_count(text: &str) -> Result<TeamCount, String> {
    let number = |text: &str| {
        text.parse().map_err(|_| "must be a number, auto, or a range such as 2..6".to_owned())
    };
    let teams = match text.split_once("..") {
        Some((from, to)) => TeamCount::Between { from: number(from)?, to: number(to)? },
        None if text == "auto" => TeamCount::Auto,
        None => TeamCount::Fixed(number(text)?),
    };
    teams.check().map_err(|error| error.to_string())?;
    Ok(teams)
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};
    use muster_model::limits::MAX_AUTO_TEAMS;
    use muster_numeric::silhouette::SAMPLE_POINTS;

    use super::*;
    use crate::path::DENSE_ROBOTS;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        options: Options,
    }

    fn parsed(arguments: &[&str]) -> Result<Options, String> {
        let parsed = Command::try_parse_from([&["solve"], arguments].concat());
        parsed.map(|command| command.options).map_err(|error| error.to_string())
    }

    #[test]
    fn options_have_defaults_and_limits() {
        assert_eq!(parsed(&[]), Ok(Options::default()));
        let found = parsed(&["--path", "inverse-free", "--tolerance", "1e-6"]).unwrap();
        assert_eq!((found.path, found.tolerance), (PathChoice::InverseFree, 1e-6));
        for wrong in ["0", "1e-13", "1", "NaN", "inf", "-1e-6", "small"] {
            let error = parsed(&[&format!("--tolerance={wrong}")]).unwrap_err();
            assert!(
                error.contains("--tolerance") && error.contains("from 1e-12 to 1e-1"),
                "{error}"
            );
        }
        assert_eq!(parsed(&["--preset", "paper"]).unwrap().preset, Some(Preset::Paper));
        assert!(parsed(&["--preset", "hope"]).unwrap_err().contains("paper"));
        for (text, teams) in [
            ("3", TeamCount::Fixed(3)),
            ("auto", TeamCount::Auto),
            ("2..6", TeamCount::Between { from: 2, to: 6 }),
        ] {
            assert_eq!(parsed(&["--teams", text]).unwrap().teams, Some(teams));
            assert_eq!(teams.to_string(), text);
        }
        for wrong in ["0", "6..2", "0..2", "2..", "..", "many", "-1", "2..1000", "2.5"] {
            let error = parsed(&[&format!("--teams={wrong}")]).unwrap_err();
            assert!(error.contains("--teams") && error.contains("must be"), "{error}");
        }
        assert!(parsed(&["--path", "sparse"]).unwrap_err().contains("inverse-free"));
    }

    #[test]
    fn the_help_states_the_numbers_that_hold() {
        let help = |value: &dyn Fn() -> Option<clap::builder::PossibleValue>| {
            value().unwrap().get_help().unwrap().to_string()
        };
        let teams = Command::command().render_long_help().to_string();
        assert!(teams.contains(&format!("auto, which is 1 to {MAX_AUTO_TEAMS}")), "{teams}");
        let path = help(&|| PathChoice::Auto.to_possible_value());
        assert!(path.contains(&format!("up to {DENSE_ROBOTS} robots")), "{path}");
        let silhouette = help(&|| SilhouetteChoice::Auto.to_possible_value());
        assert!(silhouette.contains(&format!("up to {EXACT_ROBOTS} robots")), "{silhouette}");
        let sampled = help(&|| SilhouetteChoice::Sampled.to_possible_value());
        assert!(sampled.contains(&format!("from {SAMPLE_POINTS} robots")), "{sampled}");
    }
}
