//! What must hold of fleets that move, even of a few seeds.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use muster_experiments::formations::Radio;
use muster_experiments::moving::faults::{Fault, Sense};
use muster_experiments::moving::measures::Outcome;
use muster_experiments::moving::mission::Case;
use muster_experiments::moving::pipeline::AllSettings;
use muster_experiments::moving::run::{Count, Setup, run};
use muster_experiments::seeds::held_out;

/// Few: a change that breaks a goal breaks it on most seeds.
const SEEDS: usize = 2;

fn outcomes(case: Case, fault: Option<(Sense, Fault)>, count: Count) -> Vec<Outcome> {
    let setup = Setup { robots: 50, teams: 4, case, radio: Radio::Net, fault, count };
    held_out(SEEDS).map(|seed| run(&setup, AllSettings::default(), seed).unwrap()).collect()
}

fn accuracy(outcome: &Outcome) -> f64 {
    outcome.mean(|sample| sample.accuracy)
}

#[test]
fn no_robot_changes_team_in_a_fleet_at_rest() {
    for count in [Count::Chosen, Count::Told] {
        assert!(outcomes(Case::Rest, None, count).iter().all(|outcome| outcome.needless == 0));
    }
}

/// In a fleet of 50 robots a team is two squads, which are as plain to see: there the squads are found.
#[test]
fn the_number_of_teams_is_found() {
    let setup = Setup {
        robots: 200,
        teams: 8,
        case: Case::March,
        radio: Radio::Net,
        fault: None,
        count: Count::Chosen,
    };
    let seed = held_out(1).next().unwrap();
    let outcome = run(&setup, AllSettings::default(), seed).unwrap();
    assert!(accuracy(&outcome) >= 0.99, "{}", accuracy(&outcome));
    assert_eq!(outcome.needless, 0);
}

#[test]
fn teams_on_the_march_stay_together_without_one_modality() {
    for outcome in outcomes(Case::March, Some((Sense::Connectivity, Fault::Lost)), Count::Told) {
        assert!(accuracy(&outcome) >= 0.95, "{}", accuracy(&outcome));
    }
}

#[test]
fn the_same_seed_has_the_same_outcome() {
    let [first, again] = [(); 2].map(|()| outcomes(Case::Split, None, Count::Chosen));
    assert_eq!(first, again);
    assert_eq!(first[0].followings.len(), 2);
}
