//! Which missions are run, on how many seeds.

use rayon::prelude::*;

use super::faults::{Fault, Sense};
use super::measures::{GRACE_S, Outcome};
use super::mission::Case;
use super::pipeline::AllSettings;
use super::run::{Count, RunError, Setup, run};
use crate::experiments::Progress;
use crate::formations::Radio;

/// Fleets: robots, teams, seeds of missions without faults and of those with one. The large ones have few
/// seeds, as one mission of theirs takes as long as hundreds of the smallest.
const FLEETS: [(usize, usize, usize, usize); 5] =
    [(50, 4, 20, 10), (200, 8, 8, 4), (500, 10, 4, 0), (1000, 10, 2, 0), (5000, 10, 1, 0)];

/// The same for a quick run.
const QUICK_FLEETS: [(usize, usize, usize, usize); 1] = [(50, 4, 1, 1)];

/// Fleets above this size have missions of two kinds, on radios of one.
const SMALL_FLEET_ROBOTS: usize = 500;

/// Missions that faults are tried on.
pub const FAULTY_CASES: [Case; 2] = [Case::March, Case::Split];

/// A setup with the number of its seeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Planned {
    /// What is run.
    pub setup: Setup,
    /// On so many seeds.
    pub seeds: usize,
}

/// What became of a setup on all of its seeds.
#[derive(Debug, Clone)]
pub struct Tried {
    /// What was run.
    pub setup: Setup,
    /// One outcome for each seed.
    pub outcomes: Vec<(u64, Outcome)>,
}

/// The accuracy of one setup over time, for plots.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// What was run.
    pub setup: Setup,
    /// In order of time.
    pub points: Vec<CurvePoint>,
}

/// One moment of a [`Curve`]: means over seeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// Seconds from the beginning of the mission.
    pub t: f64,
    /// Share of all robots that are in the right team.
    pub accuracy: f64,
    /// The same of those whose teams the mission changes.
    pub involved: f64,
}

/// All setups of a run.
#[must_use]
pub fn planned(quick: bool) -> Vec<Planned> {
    let mut all = Vec::new();
    for (robots, teams, seeds, faulty) in if quick { &QUICK_FLEETS[..] } else { &FLEETS[..] } {
        let setup =
            |case, radio, fault| Setup {
                robots: *robots,
                teams: *teams,
                case,
                radio,
                fault,
                count: Count::Chosen,
            };
        for case in Case::ALL {
            let is_in_nets =
                *robots <= SMALL_FLEET_ROBOTS || matches!(case, Case::March | Case::Split);
            let radios = if *robots < SMALL_FLEET_ROBOTS && !quick {
                &Radio::ALL[..]
            } else {
                &Radio::ALL[..1]
            };
            for radio in radios.iter().filter(|_| is_in_nets) {
                all.push(Planned { setup: setup(case, *radio, None), seeds: *seeds });
            }
        }
        let cases = if quick { &FAULTY_CASES[..1] } else { &FAULTY_CASES[..] };
        for case in cases.iter().copied().filter(|_| *faulty > 0) {
            for fault in Fault::ALL {
                for sense in Sense::ALL {
                    let setup = setup(case, Radio::Range, Some((sense, fault)));
                    all.push(Planned { setup, seeds: *faulty });
                }
            }
        }
    }
    all
}

/// Runs a setup on the first of these seeds, by default settings.
///
/// # Errors
/// If a mission has no outcome.
pub fn tried(planned: &Planned, seeds: &[u64], progress: &Progress<'_>) -> Result<Tried, RunError> {
    let setup = planned.setup;
    progress(&format!("moving: {} robots, {}, {}", setup.robots, setup.case, condition(&setup)));
    let seeds = &seeds[..planned.seeds.min(seeds.len())];
    let outcomes = seeds
        .par_iter()
        .map(|seed| Ok((*seed, run(&setup, AllSettings::default(), *seed)?)))
        .collect::<Result<_, RunError>>()?;
    Ok(Tried { setup, outcomes })
}

/// Radio and fault in words.
#[must_use]
pub fn condition(setup: &Setup) -> String {
    match setup.fault {
        None => setup.radio.to_string(),
        Some((sense, fault)) => format!("{}, {sense} {fault}", setup.radio),
    }
}

impl Tried {
    /// One number of each seed.
    pub fn each(&self, number: impl Fn(&Outcome) -> f64) -> Vec<f64> {
        self.outcomes.iter().map(|(_, outcome)| number(outcome)).collect()
    }

    /// Seconds in which the change of the truth of this number was followed, by seed; none where it was not.
    #[must_use]
    pub fn took_s(&self, change: usize) -> Vec<Option<f64>> {
        let of = |(_, outcome): &(u64, Outcome)| outcome.followings.get(change)?.took_s;
        self.outcomes.iter().map(of).collect()
    }

    /// The share of the seeds on which a change of the truth was followed within [`GRACE_S`].
    #[must_use]
    pub fn in_time(&self, change: usize) -> f64 {
        let all = self.took_s(change);
        let good = all.iter().flatten().filter(|took| **took <= GRACE_S + 1e-9).count();
        good as f64 / all.len().max(1) as f64
    }

    /// How the accuracy went, as a mean over seeds.
    #[must_use]
    pub fn curve(&self) -> Curve {
        let length = self.outcomes.iter().map(|(_, outcome)| outcome.series.len()).min();
        let mean = |at: usize, number: &dyn Fn(usize, &Outcome) -> f64| {
            let sum: f64 = self.outcomes.iter().map(|(_, outcome)| number(at, outcome)).sum();
            sum / self.outcomes.len() as f64
        };
        let point = |at| CurvePoint {
            t: mean(at, &|at, outcome| outcome.series[at].t),
            accuracy: mean(at, &|at, outcome| outcome.series[at].accuracy),
            involved: mean(at, &|at, outcome| outcome.series[at].involved),
        };
        Curve { setup: self.setup, points: (0..length.unwrap_or(0)).map(point).collect() }
    }
}
