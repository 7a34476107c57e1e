//! What each step of the method is worth: Muster with that step left out, on the kinds that defaults are chosen
//! on.

use std::collections::BTreeMap;

use anyhow::Context as _;
use muster_model::id::Modality;
use muster_model::settings::{
    Alpha, EmbedderSettings, Normalization, RowScaling, SingularValueScaling, Trusted,
};
use rayon::prelude::*;

use super::divided::muster_with;
use super::kinds::{Kind, List};
use super::run::Score;
use crate::statistics::Estimate;

/// The method without a step.
struct Variant {
    /// What is different.
    name: &'static str,
    /// The settings.
    settings: fn() -> EmbedderSettings,
}

/// The defaults, first, and the defaults without one step each.
const VARIANTS: [Variant; 10] = [
    Variant { name: "the defaults", settings: EmbedderSettings::default },
    Variant { name: "without self-loops", settings: || with(|all| all.self_loops = 0.0) },
    Variant {
        name: "graphs divided by their largest singular value, not by degrees",
        settings: || with(|all| all.normalize = Normalization::Spectral),
    },
    Variant { name: "every modality trusted", settings: || with(|all| all.trusted = Trusted::All) },
    Variant {
        name: "α = 0.9/ρ instead of 0.6/ρ",
        settings: || with(|all| all.alpha = Alpha::Fraction { fraction: 0.9 }),
    },
    Variant {
        name: "α = 0.3/ρ instead of 0.6/ρ",
        settings: || with(|all| all.alpha = Alpha::Fraction { fraction: 0.3 }),
    },
    Variant {
        name: "equal weights of the modalities",
        settings: || {
            let names = [Modality::spatial(), Modality::connectivity(), Modality::hierarchy()];
            let weights: BTreeMap<Modality, f64> = names.map(|name| (name, 1.0 / 3.0)).into();
            with(|all| all.weights = weights)
        },
    },
    Variant {
        name: "ranks lead down only",
        settings: || with(|all| all.reciprocity = BTreeMap::new()),
    },
    Variant {
        name: "vectors times √σ",
        settings: || with(|all| all.scale = SingularValueScaling::SqrtSigma),
    },
    Variant { name: "rows as they are", settings: || with(|all| all.rows = RowScaling::None) },
];

fn with(change: impl FnOnce(&mut EmbedderSettings)) -> EmbedderSettings {
    let mut settings = EmbedderSettings::default();
    change(&mut settings);
    settings
}

/// The worth of a step.
#[derive(Debug, Clone)]
pub struct Worth {
    /// What is different from the defaults.
    pub name: &'static str,
    /// Robots in the right team: the mean over the kinds.
    pub accuracy: f64,
    /// By how much that is less than with the defaults, kind by kind.
    pub loss: Estimate,
    /// The kind that loses most, and how much; none for the defaults.
    pub worst: Option<(&'static str, f64)>,
}

/// The worth of each step, with so many seeds of each kind, the number of teams given.
///
/// # Errors
/// Names the kind and the step at which the method fails.
pub fn steps(seeds: usize) -> anyhow::Result<Vec<Worth>> {
    let kinds = List::ChosenOn.kinds();
    let table: Vec<Vec<f64>> = VARIANTS
        .iter()
        .map(|variant| kinds.par_iter().map(|kind| accuracy(kind, variant, seeds)).collect())
        .collect::<anyhow::Result<_>>()?;
    let worth = |(variant, row): (&Variant, &Vec<f64>)| {
        let losses: Vec<f64> =
            table[0].iter().zip(row).map(|(with, without)| with - without).collect();
        let worst = kinds.iter().zip(&losses).max_by(|left, right| left.1.total_cmp(right.1));
        Worth {
            name: variant.name,
            accuracy: Estimate::of(row).mean,
            loss: Estimate::of(&losses),
            worst: worst.filter(|(_, loss)| **loss > 0.0).map(|(kind, loss)| (kind.name, *loss)),
        }
    };
    Ok(VARIANTS.iter().zip(&table).map(worth).collect())
}

/// The mean accuracy of a variant on a kind.
fn accuracy(kind: &Kind, variant: &Variant, seeds: usize) -> anyhow::Result<f64> {
    let of_seed = |seed: u64| {
        let situation = kind.situation(seed)?;
        let labels = muster_with(&situation, situation.teams, &(variant.settings)())?;
        Ok(Score::of(&labels, &situation.truth)?.accuracy)
    };
    let seeds = List::ChosenOn.seeds().take(kind.seeds(seeds));
    let found: anyhow::Result<Vec<f64>> = seeds.map(of_seed).collect();
    let found = found.with_context(|| format!("{}, {}", kind.name, variant.name))?;
    Ok(Estimate::of(&found).mean)
}

#[cfg(test)]
mod tests {
    use muster_model::settings::Settings as _;

    use super::*;

    #[test]
    fn the_defaults_lose_nothing_against_themselves_and_each_variant_is_another_method() {
        let defaults = (VARIANTS[0].settings)();
        assert_eq!(defaults, EmbedderSettings::default());
        for (place, variant) in VARIANTS.iter().enumerate().skip(1) {
            let settings = (variant.settings)();
            assert!(settings.check().is_ok(), "{}", variant.name);
            let others = VARIANTS.iter().enumerate().filter(|(other, _)| *other != place);
            assert!(others.map(|(_, other)| (other.settings)()).all(|other| other != settings));
        }
    }
}
