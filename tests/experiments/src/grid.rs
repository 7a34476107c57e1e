//! How well a recipe divides what the truth is known of: what defaults are chosen by.

use muster_model::settings::Normalization;
use muster_model::settings::RowScaling as Rows;
use muster_model::settings::{IngestSettings, SpatialKernel, SpatialScale, SpatialSettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::formations::{Formation, Radio};
use crate::methods::embedding::{Form, Rank};
use crate::methods::{Consensus, DivisionError, Method, Recipe};
use crate::moving::faults::Sense;
use crate::random_systems::{Known, plain_to_see, planted};
use crate::score::{Correct, correct};
use crate::statistics::Estimate;
use crate::system::{MODALITIES, Nearness};

/// Teams of planted fleets.
pub const PLANTED_TEAMS: std::ops::RangeInclusive<usize> = 2..=6;

/// Teams, and robots of each, of fleets that are plain to see.
pub const PLAIN: [(usize, usize); 9] =
    [(2, 2), (3, 2), (5, 2), (2, 3), (4, 3), (2, 4), (3, 5), (2, 8), (5, 8)];

/// Share of every distance by which measurements are wrong where noise is looked at.
pub const NOISE: f64 = 0.5;

/// Shares of robots in the right team, one for each seed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scores {
    /// Squads and platoons, for each radio.
    pub squads: [Vec<f64>; 2],
    /// See [`Scores::squads`].
    pub platoons: [Vec<f64>; 2],
    /// All formations together, for each radio.
    pub formations: [Vec<f64>; 2],
    /// All formations with distances that are wrong by up to [`NOISE`], for each radio.
    pub noisy: [Vec<f64>; 2],
    /// Planted fleets of all numbers of teams.
    pub planted: Vec<f64>,
    /// Small fleets that are plain to see, by each choice of relations.
    pub plain: Vec<f64>,
    /// Planted fleets of all numbers of teams, where every robot reports one modality of another robot, by
    /// modality. No part of what a recipe is worth.
    pub mistaken: [Vec<f64>; 3],
}

impl Scores {
    /// What a recipe is worth: the mean over both radios of formations as they are and with noise, of planted
    /// fleets and of those plain to see, each counting alike.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "there are a few parts")]
    pub fn worth(&self) -> Estimate {
        let [range, net] = &self.formations;
        let [noisy_range, noisy_net] = &self.noisy;
        let parts = [range, net, noisy_range, noisy_net, &self.planted, &self.plain];
        let of_seed = |at: usize| {
            let shares = parts.iter().filter_map(|part| part.get(at));
            shares.sum::<f64>() / parts.len() as f64
        };
        Estimate::of(&(0..range.len()).map(of_seed).collect::<Vec<_>>())
    }
}

/// The width that won where one length measures the whole fleet, in multiples of it.
const FLEET_WIDTH: f64 = 2.0;

/// Scores of a recipe on seeds.
///
/// # Errors
/// If the method fails.
pub fn scores(
    formations: &[Formation],
    recipe: &Recipe,
    seeds: &[u64],
) -> Result<Scores, DivisionError> {
    let method = Method::Multimodal("", Box::new(recipe.clone()));
    let of_seed = |seed: &u64| score(formations, &method, *seed);
    let all: Vec<Scores> = seeds.par_iter().map(of_seed).collect::<Result<_, _>>()?;
    let mut together = Scores::default();
    for one in all {
        for radio in 0..2 {
            together.squads[radio].extend(&one.squads[radio]);
            together.platoons[radio].extend(&one.platoons[radio]);
            together.formations[radio].extend(&one.formations[radio]);
            together.noisy[radio].extend(&one.noisy[radio]);
        }
        together.planted.extend(&one.planted);
        together.plain.extend(&one.plain);
        for (all, one) in together.mistaken.iter_mut().zip(&one.mistaken) {
            all.extend(one);
        }
    }
    Ok(together)
}

fn score(formations: &[Formation], method: &Method, seed: u64) -> Result<Scores, DivisionError> {
    let mut scores = Scores::default();
    for (at, radio) in Radio::ALL.into_iter().enumerate() {
        let (mut squads, mut platoons, mut noisy) =
            (Correct::default(), Correct::default(), Correct::default());
        for formation in formations {
            let system = formation.marching(radio, seed);
            let measured = system.with_noise(NOISE, seed);
            for (division, truth) in formation.layout.divisions.iter().enumerate() {
                let teams = formation.layout.teams(division);
                let found = method.divide(&system, teams, seed)?.labels;
                let found = correct(&found, truth).unwrap_or_default();
                if formation.is_platoon() {
                    platoons += found
                } else {
                    squads += found
                }
                let found = method.divide(&measured, teams, seed)?.labels;
                noisy += correct(&found, truth).unwrap_or_default();
            }
        }
        scores.squads[at].push(squads.share());
        scores.platoons[at].push(platoons.share());
        let mut all = squads;
        all += platoons;
        scores.formations[at].push(all.share());
        scores.noisy[at].push(noisy.share());
    }
    let mut sum = Correct::default();
    let mut sums = [Correct::default(); 3];
    for teams in PLANTED_TEAMS {
        let (system, truth) = planted(teams, seed);
        let found = method.divide(&system, teams, seed)?.labels;
        sum += correct(&found, &truth).unwrap_or_default();
        for (sense, sum) in Sense::ALL.into_iter().zip(&mut sums) {
            let found = method.divide(&system.mistaken(sense, seed), teams, seed)?.labels;
            *sum += correct(&found, &truth).unwrap_or_default();
        }
    }
    scores.planted.push(sum.share());
    for (shares, sum) in scores.mistaken.iter_mut().zip(sums) {
        shares.push(sum.share());
    }
    let mut sum = Correct::default();
    for (teams, size) in PLAIN {
        for known in Known::all() {
            let (system, truth) = plain_to_see(teams, size, known, seed);
            let found = method.divide(&system, teams, seed)?.labels;
            sum += correct(&found, &truth).unwrap_or_default();
        }
    }
    scores.plain.push(sum.share());
    Ok(scores)
}

/// A recipe with what is changed in it, for tables.
#[derive(Debug, Clone, PartialEq)]
pub struct Variation {
    /// What is other than in the recipe at the beginning.
    pub name: String,
    /// The whole recipe.
    pub recipe: Recipe,
}

/// `base`, and the recipes in which one step of it is left out or done as in the paper: what each step is worth.
#[must_use]
pub fn left_out(base: &Recipe) -> Vec<Variation> {
    let plain = Recipe::plain();
    let mut all = vec![Variation { name: "as it is".to_owned(), recipe: base.clone() }];
    let mut without = |name: &str, change: &dyn Fn(&mut Recipe)| {
        let mut recipe = base.clone();
        change(&mut recipe);
        all.push(Variation { name: name.to_owned(), recipe });
    };
    without("graphs scaled by their norm", &|recipe| {
        recipe.form.normalization = Normalization::Spectral;
    });
    without("graphs not scaled", &|recipe| recipe.form.normalization = Normalization::None);
    without("no self-loops", &|recipe| recipe.form.self_loops = plain.form.self_loops);
    without("αρ 0.5", &|recipe| recipe.form.fraction = plain.form.fraction);
    without("singular vectors as they come", &|recipe| recipe.form.power = plain.form.power);
    without("rows as they come", &|recipe| recipe.form.rows = plain.form.rows);
    without("every modality trusted", &|recipe| recipe.form.doubts = plain.form.doubts);
    without("equal weights", &|recipe| recipe.weights = plain.weights);
    without("weights whatever a modality relates", &|recipe| recipe.by_coverage = false);
    without("one width for the fleet", &|recipe| {
        let spatial = IngestSettings::default().spatial;
        let scale = SpatialScale::Fleet;
        recipe.nearness =
            Nearness::Kernel(SpatialSettings { scale, width: FLEET_WIDTH, ..spatial });
    });
    without("1/d", &|recipe| recipe.nearness = plain.nearness.clone());
    without("orders lead down only", &|recipe| recipe.upward = plain.upward);
    without("K 3", &|recipe| recipe.form.rank = plain.form.rank);
    without("one random start of k-means", &|recipe| recipe.clustering = plain.clustering);
    all.push(Variation { name: "none of them: the paper's method".to_owned(), recipe: plain });
    all
}

/// All recipes that differ from `base` in one choice, and `base` itself.
#[must_use]
pub fn variations(base: &Recipe) -> Vec<Variation> {
    let mut all = vec![Variation { name: "as it is".to_owned(), recipe: base.clone() }];
    let mut add = |name: String, change: &dyn Fn(&mut Recipe)| {
        let mut recipe = base.clone();
        change(&mut recipe);
        if recipe != *base {
            all.push(Variation { name, recipe });
        }
    };
    let spatial =
        SpatialSettings { scale: SpatialScale::Fleet, ..IngestSettings::default().spatial };
    add("1/d".to_owned(), &|recipe| recipe.nearness = Nearness::Inverse);
    for kernel in [SpatialKernel::Gaussian, SpatialKernel::Exponential] {
        for width in [0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0] {
            let settings = SpatialSettings { kernel, width, ..spatial.clone() };
            add(format!("{kernel:?} {width}"), &|recipe| {
                recipe.nearness = Nearness::Kernel(settings.clone());
            });
        }
    }
    for cutoff in [2.0, 3.0, 5.0, 9.0] {
        let kernel = SpatialKernel::WendlandC2;
        let settings = SpatialSettings { kernel, cutoff, ..spatial.clone() };
        add(format!("Wendland {cutoff}"), &|recipe| {
            recipe.nearness = Nearness::Kernel(settings.clone());
        });
    }
    for width in [0.5, 0.6, 0.7, 1.0, 1.2] {
        let settings = SpatialSettings { width, ..IngestSettings::default().spatial };
        add(format!("width {width}"), &|recipe| {
            recipe.nearness = Nearness::Kernel(settings.clone());
        });
    }
    for normalization in [Normalization::None, Normalization::Spectral, Normalization::Degree] {
        add(format!("normalization {normalization:?}"), &|recipe| {
            recipe.form.normalization = normalization;
        });
    }
    for self_loops in [0.0, 0.1, 0.25, 1.0, 2.0] {
        add(format!("self-loops {self_loops}"), &|recipe| recipe.form.self_loops = self_loops);
    }
    add("every modality trusted".to_owned(), &|recipe| recipe.form.doubts = false);
    for fraction in [0.1, 0.25, 0.5, 0.65, 0.75, 0.8, 0.9, 0.99] {
        add(format!("fraction {fraction}"), &|recipe| recipe.form.fraction = fraction);
    }
    for rank in
        [Rank::Ratio, Rank::Teams, Rank::Fixed(2), Rank::Fixed(3), Rank::Fixed(4), Rank::Fixed(6)]
    {
        add(format!("rank {rank:?}"), &|recipe| recipe.form.rank = rank);
    }
    for power in [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0] {
        add(format!("power {power}"), &|recipe| recipe.form.power = power);
    }
    for upward in [0.0, 0.25, 0.5, 0.75, 1.0, 1.5] {
        add(format!("upward {upward}"), &|recipe| recipe.upward = upward);
    }
    for siblings in [0.1, 0.3, 0.5, 1.0] {
        add(format!("siblings {siblings}"), &|recipe| recipe.siblings = siblings);
    }
    for (place, factor) in [
        (1, 0.7),
        (1, 1.0),
        (1, 1.4),
        (2, 0.5),
        (2, 0.6),
        (2, 0.7),
        (2, 0.8),
        (2, 0.9),
        (2, 1.0),
        (3, 0.6),
        (3, 0.5),
        (3, 0.7),
        (3, 1.0),
        (4, 0.7),
        (4, 0.85),
        (4, 1.0),
        (6, 0.85),
        (8, 0.85),
    ] {
        add(format!("local {place} {factor}"), &|recipe| recipe.nearness = local(place, factor));
    }
    for more in [1, 2, 4, 8] {
        add(format!("rank teams + {more}"), &|recipe| recipe.form.rank = Rank::More(more));
    }
    for rows in [Rows::None, Rows::Unit] {
        add(format!("rows {rows:?}"), &|recipe| recipe.form.rows = rows);
    }
    for (modality, name) in MODALITIES.iter().enumerate() {
        for weight in [0.0, 0.05, 0.2, 0.5, 0.6] {
            add(format!("weight of {name} {weight}"), &|recipe| {
                recipe.weights = [0.5 * (1.0 - weight); 3];
                recipe.weights[modality] = weight;
            });
        }
    }
    add("equal weights".to_owned(), &|recipe| recipe.weights = [1.0 / 3.0; 3]);
    for starts in [1, 10, 200] {
        add(format!("{starts} starts"), &|recipe| recipe.clustering.starts = starts);
    }
    for starts in [10, 100] {
        add(format!("consensus of {starts} starts"), &|recipe| {
            recipe.consensus = Consensus::Starts(starts);
        });
    }
    add("consensus of K".to_owned(), &|recipe| recipe.consensus = Consensus::Ranks);
    all
}

/// The live system's Gaussian, by which each robot is measured by its `place`-th nearest.
fn local(place: u32, width: f64) -> Nearness {
    let (kernel, scale) = (SpatialKernel::Gaussian, SpatialScale::Robots);
    let spatial = IngestSettings::default().spatial;
    Nearness::Kernel(SpatialSettings {
        kernel,
        scale,
        scale_neighbour: Some(place),
        width,
        ..spatial
    })
}

/// Recipes that chance puts together from all that can be chosen.
#[must_use]
pub fn random(count: usize, seed: u64) -> Vec<Variation> {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let recipes = (0..count).map(|_| {
        let mut recipe = Recipe::live();
        recipe.nearness = any_nearness(&mut chance);
        recipe.form.fraction = one_of(&mut chance, &[0.25, 0.5, 0.65, 0.75, 0.85]);
        recipe.form.self_loops = one_of(&mut chance, &[0.0, 0.25, 0.5, 1.0]);
        let scales = [Normalization::None, Normalization::Spectral, Normalization::Degree];
        recipe.form.normalization = one_of(&mut chance, &scales);
        recipe.form.power = one_of(&mut chance, &[-1.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0]);
        let ranks = [Rank::Ratio, Rank::Teams, Rank::More(1), Rank::More(2), Rank::Fixed(4)];
        recipe.form.rank = one_of(&mut chance, &ranks);
        recipe.form.rows = one_of(&mut chance, &[Rows::None, Rows::Unit]);
        recipe.upward = one_of(&mut chance, &[0.0, 0.25, 0.5, 1.0]);
        recipe.siblings = one_of(&mut chance, &[0.0, 0.2, 0.5, 1.0]);
        let parts = recipe.weights.map(|_| f64::from(chance.random_range(1..=5)));
        recipe.weights = parts.map(|part| part / parts.iter().sum::<f64>());
        Variation { name: described(&recipe), recipe }
    });
    recipes.collect()
}

fn one_of<T: Copy>(chance: &mut ChaCha8Rng, all: &[T]) -> T {
    all[chance.random_range(0..all.len())]
}

fn any_nearness(chance: &mut ChaCha8Rng) -> Nearness {
    let spatial =
        SpatialSettings { scale: SpatialScale::Fleet, ..IngestSettings::default().spatial };
    let width = one_of(chance, &[0.7, 1.0, 1.2, 1.4, 1.7, 2.0]);
    let kernels = [SpatialKernel::Gaussian, SpatialKernel::Exponential, SpatialKernel::WendlandC2];
    match chance.random_range(0..=kernels.len()) {
        place if place < kernels.len() => Nearness::Kernel(SpatialSettings {
            kernel: kernels[place],
            width,
            // Where the Gaussian of that width has fallen to little.
            cutoff: 3.5 * width,
            ..spatial
        }),
        _ => local(chance.random_range(2..=4), one_of(chance, &[0.5, 0.7, 1.0, 1.4])),
    }
}

/// A recipe in one line.
#[must_use]
pub fn described(recipe: &Recipe) -> String {
    let nearness = match &recipe.nearness {
        Nearness::Kernel(settings) if settings.kernel == SpatialKernel::WendlandC2 => {
            format!("Wendland {:.1}", settings.cutoff)
        }
        Nearness::Kernel(settings) if settings.scale == SpatialScale::Robots => {
            let by = settings
                .scale_neighbour
                .map_or("4th to 8th".to_owned(), |neighbour| format!("{neighbour}."));
            format!("{:?} {} by the {by} nearest", settings.kernel, settings.width)
        }
        Nearness::Kernel(settings) => {
            format!("{:?} {} by the fleet", settings.kernel, settings.width)
        }
        Nearness::Inverse => "1/d".to_owned(),
    };
    let Form { normalization, self_loops, doubts, fraction, power, rank, rows } = recipe.form;
    let scaled = match normalization {
        Normalization::None => "graphs as they are",
        Normalization::Spectral => "graphs scaled by their norm",
        Normalization::Degree => "graphs scaled by degree",
    };
    let trust = if doubts { "contradicted modalities doubted" } else { "all modalities trusted" };
    let weights = recipe.weights.map(|weight| format!("{weight:.2}")).join(" ");
    let ties = format!("orders lead back by {}, siblings {}", recipe.upward, recipe.siblings);
    format!(
        "{nearness}, {ties}, {scaled}, weights {weights}, {trust}, self-loops {self_loops}, αρ {fraction}, K by \
         {rank:?}, σ^{power}, rows {rows:?}"
    )
}
