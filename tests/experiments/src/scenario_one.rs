//! Scenario I: formations that experts divide.
//!
//! Squads are divided into two teams, of which the leader is none, and into three, of which he is one;
//! platoons into three squads, without the two leaders, and into four and five teams, of which the leaders
//! are one together or one each. These are 3 · (8 + 9) + 3 · (27 + 29 + 29) = 306 robots.

use crate::formations::{Formation, Radio};
use crate::methods::{DivisionError, Method};
use crate::score::{Correct, correct};
use crate::spaces::Silhouettes;
use crate::system::System;

/// One division of one formation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Case {
    /// The formation, by its place in [`Formation::all`].
    pub formation: usize,
    /// The division, by its place in the file.
    pub division: usize,
}

/// All cases of all formations.
#[must_use]
pub fn cases(formations: &[Formation]) -> Vec<Case> {
    let cases = formations.iter().enumerate().flat_map(|(formation, one)| {
        (0..one.layout.divisions.len()).map(move |division| Case { formation, division })
    });
    cases.collect()
}

/// What became of one case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// Robots in the right team.
    pub correct: Correct,
    /// How the division looks, over all robots of the formation.
    pub silhouettes: Silhouettes,
}

/// Divides all formations, case by case, for one seed. No seed: as the files have them.
///
/// # Errors
/// If the method fails.
pub fn run(
    formations: &[Formation],
    method: &Method,
    radio: Radio,
    seed: Option<u64>,
) -> Result<Vec<Outcome>, DivisionError> {
    let mut found = Vec::new();
    for case in cases(formations) {
        let formation = &formations[case.formation];
        let system = match seed {
            Some(seed) => formation.marching(radio, seed),
            None => formation.drawn(radio),
        };
        found.push(divided(formation, case, method, &system, seed.unwrap_or(0))?);
    }
    Ok(found)
}

/// Divides all formations, case by case, where every distance is measured with an error of up to `noise` of it.
/// Silhouettes are those of the true places.
///
/// # Errors
/// If the method fails.
pub fn run_noisy(
    formations: &[Formation],
    method: &Method,
    radio: Radio,
    noise: f64,
    seed: u64,
) -> Result<Vec<Outcome>, DivisionError> {
    let mut outcomes = Vec::new();
    for case in cases(formations) {
        let formation = &formations[case.formation];
        let system = formation.marching(radio, seed).with_noise(noise, seed);
        outcomes.push(divided(formation, case, method, &system, seed)?);
    }
    Ok(outcomes)
}

/// What becomes of one case.
fn divided(
    formation: &Formation,
    case: Case,
    method: &Method,
    system: &System,
    seed: u64,
) -> Result<Outcome, DivisionError> {
    let found = method.divide(system, formation.layout.teams(case.division), seed)?;
    let truth = &formation.layout.divisions[case.division];
    Ok(Outcome {
        case,
        // Both name the robots of the formation.
        correct: correct(&found.labels, truth).unwrap_or_default(),
        silhouettes: Silhouettes::of(system, &found.labels, found.vectors.as_ref()),
    })
}

/// All robots together.
#[must_use]
pub fn total(found: &[Outcome]) -> Correct {
    let mut total = Correct::default();
    for outcome in found {
        total += outcome.correct;
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check of the reconstruction: 39.22 % of the paper's robots, whatever their distances, since all
    /// pairs are related.
    #[test]
    fn girvan_newman_finds_the_papers_share_on_the_spatial_graph() {
        let formations = Formation::all().unwrap();
        for seed in [None, Some(1), Some(2)] {
            let found = run(&formations, &Method::GirvanNewman(0), Radio::Range, seed).unwrap();
            assert_eq!(found.len(), 15);
            assert_eq!(total(&found), Correct { right: 120, total: 306 });
        }
    }
}
