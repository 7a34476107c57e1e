//! Which missions are run, on how many seeds.

use rayon::prelude::*;

use super::faults::{Fault, Sense};
use super::measures::Outcome;
use super::mission::Case;
use super::pipeline::AllSettings;
use super::run::{Count, RunError, Setup, run};
use crate::experiments::Progress;
use crate::formations::Radio;

/// One size of fleets with what is run on it.
#[derive(Debug, Clone, Copy)]
struct Size {
    robots: usize,
    teams: usize,
    /// Seeds of each mission.
    seeds: usize,
    /// Missions where radios have a range, and where they are nets.
    in_range: &'static [Case],
    in_nets: &'static [Case],
    /// Missions in which the operator chooses the number of teams.
    told: &'static [Case],
    /// Seeds of each mission with a fault.
    faulty: usize,
}

/// The sizes. The large fleets have few missions, as one of theirs takes as long as hundreds of the smallest.
const SIZES: [Size; 5] = [
    Size {
        robots: 50,
        teams: 4,
        seeds: 20,
        in_range: &Case::ALL,
        in_nets: &Case::ALL,
        told: &[Case::Split],
        faulty: 20,
    },
    Size {
        robots: 200,
        teams: 8,
        seeds: 20,
        in_range: &Case::ALL,
        in_nets: &[Case::Split],
        told: &[],
        faulty: 0,
    },
    Size {
        robots: 500,
        teams: 10,
        seeds: 20,
        in_range: &[Case::Rest, Case::March, Case::Split, Case::Regroup],
        in_nets: &[],
        told: &[],
        faulty: 0,
    },
    Size {
        robots: 1000,
        teams: 10,
        seeds: 5,
        in_range: &[Case::March, Case::Split],
        in_nets: &[],
        told: &[],
        faulty: 0,
    },
    Size {
        robots: 5000,
        teams: 10,
        seeds: 5,
        in_range: &[Case::Split],
        in_nets: &[],
        told: &[],
        faulty: 0,
    },
];

/// The same for a quick run.
const QUICK_SIZES: [Size; 1] = [Size {
    robots: 50,
    teams: 4,
    seeds: 1,
    in_range: &Case::ALL,
    in_nets: &[],
    told: &[Case::Split],
    faulty: 1,
}];

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
    for size in if quick { &QUICK_SIZES[..] } else { &SIZES[..] } {
        let mut add = |case: &Case, radio, fault, count, seeds| {
            let Size { robots, teams, .. } = *size;
            let setup = Setup { robots, teams, case: *case, radio, fault, count };
            all.push(Planned { setup, seeds });
        };
        let kinds = [
            (size.in_range, Radio::Range, Count::Chosen),
            (size.in_nets, Radio::Net, Count::Chosen),
            (size.told, Radio::Range, Count::Told),
        ];
        for (cases, radio, count) in kinds {
            cases.iter().for_each(|case| add(case, radio, None, count, size.seeds));
        }
        let cases = if quick { &FAULTY_CASES[..1] } else { &FAULTY_CASES[..] };
        for case in cases.iter().filter(|_| size.faulty > 0) {
            for fault in Fault::ALL {
                for sense in Sense::ALL {
                    let fault = Some((sense, fault));
                    add(case, Radio::Range, fault, Count::Chosen, size.faulty);
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

/// Radio, fault, and who chooses the number of teams, in words.
#[must_use]
pub fn condition(setup: &Setup) -> String {
    let told = match setup.count {
        Count::Chosen => "",
        Count::Told => ", number told",
    };
    match setup.fault {
        None => format!("{}{told}", setup.radio),
        Some((sense, fault)) => format!("{}, {sense} {fault}{told}", setup.radio),
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

    /// Median and largest time in seconds in which a change of the truth was followed, where it never was
    /// infinite; none where there is no such change.
    #[must_use]
    pub fn following_s(&self, change: usize) -> Option<(f64, f64)> {
        if self.outcomes.iter().all(|(_, outcome)| outcome.followings.len() <= change) {
            return None;
        }
        let took = self.took_s(change).into_iter();
        let mut all: Vec<f64> = took.map(|took| took.unwrap_or(f64::INFINITY)).collect();
        all.sort_by(f64::total_cmp);
        Some((*all.get((all.len() - 1) / 2)?, *all.last()?))
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
