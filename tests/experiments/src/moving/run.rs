//! One mission through all services.

use muster_model::id::IdError;
use muster_model::time::Tick;
use muster_numeric::matching::MatchError;

use super::faults::{Fault, Sense};
use super::fleet::Fleet;
use super::measures::{Outcome, Scorer};
use super::mission::{Case, Mission};
use super::pipeline::{AllSettings, Pipeline, PipelineError};
use super::reports::{POSE_STEPS, Reports, STEPS_HZ};
use super::times::Times;
use crate::formations::Radio;

/// When everything begins: any moment that does not look like a clock that was not set.
const BEGINNING: Tick = Tick(1_700_000_000_000_000);

/// Microseconds of a step.
const STEP_US: u64 = 1_000_000 / STEPS_HZ;

/// How long after a change of the truth the operator asks for another number of teams, in seconds.
pub const ORDER_AFTER_S: f64 = 5.0;

/// Who chooses the number of teams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Count {
    /// The services, as by default.
    #[default]
    Chosen,
    /// The operator, [`ORDER_AFTER_S`] after each change of the truth.
    Told,
}

/// What is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setup {
    /// Robots of the fleet.
    pub robots: usize,
    /// Teams of the fleet.
    pub teams: usize,
    /// What it lives through.
    pub case: Case,
    /// Between which robots there are links.
    pub radio: Radio,
    /// What is wrong with the reports.
    pub fault: Option<(Sense, Fault)>,
    /// Who chooses the number of teams.
    pub count: Count,
}

/// Why a run has no outcome.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A robot's name is none.
    #[error(transparent)]
    Name(#[from] IdError),
    /// A service refuses an order.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A division cannot be compared.
    #[error(transparent)]
    Match(#[from] MatchError),
}

/// Runs a mission; the same seed and settings have the same outcome.
///
/// # Errors
/// [`RunError`] if the services refuse an order, or there are too many teams.
pub fn run(setup: &Setup, settings: AllSettings, seed: u64) -> Result<Outcome, RunError> {
    run_watched(setup, settings, seed, |_, _| ())
}

/// Runs a mission likewise; `watch` sees the services at every comparison, with the seconds from the beginning.
///
/// # Errors
/// As [`run`].
pub fn run_watched(
    setup: &Setup,
    mut settings: AllSettings,
    seed: u64,
    mut watch: impl FnMut(f64, &Pipeline),
) -> Result<Outcome, RunError> {
    let mission = Mission::new(Fleet::new(setup.robots, setup.teams)?, setup.case, seed);
    let mut reports = Reports::new(&mission, setup.radio, setup.fault, seed);
    let is_told = setup.count == Count::Told;
    if is_told {
        settings.clusterer.teams = setup.teams.into();
    }
    let times = Times::new(setup.robots, seed);
    let mut pipeline = Pipeline::new(BEGINNING, settings)?.with_times(times);
    let mut scorer = Scorer::new(&mission);
    for token in reports.joining() {
        pipeline.receive(token);
    }
    let mut asked = setup.teams;
    for step in 0..(setup.case.lasts_s() * STEPS_HZ as f64) as u64 {
        let t = step as f64 / STEPS_HZ as f64;
        pipeline.advance(Tick(BEGINNING.0 + step * STEP_US));
        for (at, teams) in pipeline.take_received() {
            scorer.accept(at.since(BEGINNING).as_secs_f64(), &teams)?;
        }
        // What the services know of a moment is compared before they receive it.
        if step % POSE_STEPS == 0 {
            let silhouette = pipeline.audit.as_ref().and_then(|audit| audit.in_embedding.mean);
            scorer.compare(t, silhouette, pipeline.dimension)?;
            watch(t, &pipeline);
        }
        let wanted = mission.teams_asked((t - ORDER_AFTER_S).max(0.0));
        if is_told && wanted != asked {
            asked = wanted;
            pipeline.order_teams(asked)?;
        }
        for message in reports.step(step) {
            pipeline.receive(message);
        }
    }
    Ok(scorer.outcome())
}
