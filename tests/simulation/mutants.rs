//! Proof that the simulation finds faults of the code: each of its promises is broken on purpose.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use muster_tests::simulation::{Effort, Mutant, Options, has_fault, shrink, simulate};

use crate::FORGETFUL;

/// How many runs are tried to shorten that of a mutant. Most take fewer than a hundred.
const SHRINK_RUNS: usize = 400;

/// How many mutants are looked for at a time: the machines of continuous integration have two cores.
const MUTANTS_AT_ONCE: usize = 2;

/// Seeds in which a mutant must show, of which those are run that have a fault after which it may. Most show in the first
/// ten; what takes several faults in a row is rare.
const MUTANT_SEEDS: u64 = 1000;

#[test]
fn every_mutant_is_found_and_its_run_made_short() {
    let settle = "after the last fault all agree within the stated time";
    let all = [
        (Mutant::RobotTwice, vec!["what a service publishes, others understand"]),
        (Mutant::RobotForgotten, vec!["a robot is in exactly one team, or in none"]),
        (Mutant::WrongSilhouette, vec!["silhouettes are those of the definition"]),
        (Mutant::NotANumber, vec!["every number that is published is finite"]),
        (Mutant::OldTermAsNewest, vec!["every division names an embedding that was published"]),
        (Mutant::IsolatedAuditor, vec![settle]),
        // The core does not know of it, and answers with what was not published.
        (
            Mutant::Restless,
            vec![settle, "a console that joins late receives what was published last"],
        ),
        (Mutant::Fickle, vec!["unchanged input leaves the teams unchanged"]),
        (Mutant::RevisionTwice, vec!["epochs grow within a term, and terms never go back"]),
        (Mutant::TermTwice, vec!["a new leader begins above every term of its service"]),
        (Mutant::OlderRoster, vec!["a reader never goes back to a lower term or epoch"]),
        (Mutant::NoPositions, vec![settle]),
        (Mutant::TermsFromOne, vec!["epochs grow within a term, and terms never go back"]),
        (Mutant::DeafRobots, vec!["robots believe services that have lost their state within 5 s"]),
        (Mutant::UnbelievedTerm, vec!["no service begins a term that others do not believe"]),
        (Mutant::Forgetful, vec!["a restart of everything changes no team"]),
        (
            Mutant::Rearranging,
            vec!["a team that is cut off moves no other robot, and comes back as what it was"],
        ),
        (
            Mutant::StarvedEmbedder,
            vec![
                "on busy hosts a division is never older than ten times what its stages take alone",
            ],
        ),
        (
            Mutant::Overfull,
            vec!["limits on the robots of teams hold, or the division says why not"],
        ),
        (Mutant::Repetitive, vec!["a command is carried out once"]),
        (
            Mutant::Boastful,
            vec!["what a division says of needs is so by a roster that was published"],
        ),
        (
            Mutant::LostRecords,
            vec!["what is published as recorded is on the disk, whatever is killed"],
        ),
        (
            Mutant::Forgotten,
            vec![
                "everything that a historian received is recorded, up to the moment that it names",
            ],
        ),
        (
            Mutant::Careless,
            vec!["what is published as recorded is on the disk, whatever is killed"],
        ),
        (Mutant::Resigned, vec!["recording goes on by itself once there is room"]),
        (Mutant::Renumbered, vec!["the number of an alert is used once in a term"]),
        (Mutant::Insistent, vec!["an alert is raised once and ends once"]),
        (
            Mutant::Negligent,
            vec!["needs of teams are filled within 20 s, or the division says why not"],
        ),
        (Mutant::Disobedient, vec!["a wish that is published as active is granted"]),
        (Mutant::Silent, vec!["an event says that nothing satisfies the limits any more"]),
        (Mutant::Reused, vec!["no id of a team is given to another team"]),
        (Mutant::Reversed, vec!["every event about teams is the difference of two divisions"]),
        (Mutant::Misled, vec!["browsers that draw show the division that all agree on"]),
        (Mutant::Dependent, vec![settle, "a full disk stops no division"]),
        (Mutant::Unmoved, vec!["a robot of ROS is where its newest transforms put it"]),
        (Mutant::Inert, vec!["what a bridge puts for a robot is in the order of its publisher"]),
        (Mutant::Nostalgia, vec!["ROS is never shown an older division after a newer one"]),
        (Mutant::Absent, vec!["a bridge that starts again puts each robot within 3 s"]),
        (Mutant::Retentive, vec!["the memory of a bridge is bounded"]),
        (Mutant::Secretive, vec!["a robot of ROS that is not taken is named with its reason"]),
        (Mutant::Wasteful, vec!["nothing is made that no viewer watches"]),
        (
            Mutant::Blinded,
            vec!["viewers that read show the division that all agree on, and lost robots grey"],
        ),
        (
            Mutant::Garish,
            vec!["viewers that read show the division that all agree on, and lost robots grey"],
        ),
        (Mutant::Wishful, vec!["parameters are shown as services confirmed them"]),
        (Mutant::Curt, vec!["a change that is refused is reported with its reason"]),
        (
            Mutant::Wordy,
            vec!["a viewer that reads misses nothing", "a topic has at most ten scenes a second"],
        ),
        (Mutant::Reticent, vec!["a host announces where its instance stands"]),
        (Mutant::Twofold, vec!["every get is answered once"]),
        (Mutant::Hasty, vec!["an answer waits for what was stored before"]),
        (Mutant::Voluble, vec!["what is published fits its key"]),
        (Mutant::Garbled, vec!["a robot can read the team that it is sent"]),
        (Mutant::Corrupting, vec!["what is kept can be read again"]),
        (Mutant::Eager, vec!["no core and no job panics or breaks its contract"]),
        (Mutant::Falsifying, vec!["what is recorded is what was published"]),
        (Mutant::Prophetic, vec!["ROS is shown what was published"]),
        (Mutant::Unmannerly, vec!["a bridge puts what a fleet takes"]),
        // Readers refuse a list in which an alert stands twice.
        (Mutant::Doubled, vec!["what a service publishes, others understand"]),
        (Mutant::Meddling, vec!["a planner publishes nothing that others go by"]),
        (Mutant::Hoarding, vec!["at most 16 proposals are open, and 8 of one operator"]),
        (Mutant::Nostalgic, vec!["a proposal is forgotten 60 s after it was computed"]),
        (Mutant::Chorus, vec!["one planner answers"]),
        (Mutant::Discreet, vec!["a proposal says who would move"]),
        (
            Mutant::Misleading,
            vec!["an accepted proposal becomes the division, if nothing else changes"],
        ),
    ];
    // MUTANT=Reversed looks for one alone.
    let wanted = std::env::var("MUTANT").ok();
    let is_wanted =
        |mutant: Mutant| wanted.as_ref().is_none_or(|wanted| *wanted == format!("{mutant:?}"));
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..MUTANTS_AT_ONCE {
            scope.spawn(|| {
                while let Some((mutant, promises)) = all.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if is_wanted(*mutant) {
                        find_and_shorten(*mutant, promises);
                    }
                }
            });
        }
    });
}

/// Promises that no mutant breaks, and why.
const UNBROKEN: [&str; 2] = [
    // The judge itself would have to go on for ever.
    "a run ends",
    // A host counts its timers by itself, and ends with an error before.
    "a core that waits names a moment to come",
];

/// The text of a literal that a source goes on with.
fn literal(source: &str) -> Option<&str> {
    source.trim_start().strip_prefix('"')?.split('"').next()
}

/// The promises of a part of a source, and the names of their constants.
fn promises(source: &str) -> Vec<(&str, &str)> {
    let after = |mark| source.split(mark).skip(1);
    let direct = ["breach(", "promise: ", "promise = "].into_iter().flat_map(after);
    let named = after("const ").filter_map(|rest| {
        let (name, rest) = rest.split_once(": &str =")?;
        Some((literal(rest)?, name))
    });
    let all = direct.filter_map(literal).map(|text| (text, text)).chain(named);
    // Other texts are words.
    all.filter(|(text, _)| text.matches(' ').count() > 1).collect()
}

#[test]
fn every_promise_is_broken_by_a_mutant_or_a_test() {
    let mut sources = Vec::new();
    let mut folders = vec![PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/src/simulation"))];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => sources.push(std::fs::read_to_string(path).unwrap()),
            }
        }
    }
    let (_, mutants) = include_str!("mutants.rs").split_once("fn every_mutant_is_found").unwrap();
    let (mutants, _) = mutants.split_once("\n}\n").unwrap();
    let parts: Vec<(&str, &str)> = sources
        .iter()
        .map(|source| source.split_once("#[cfg(test)]\nmod tests").unwrap_or((source, "")))
        .collect();
    let mut count = 0;
    for (code, own_tests) in &parts {
        for (promise, name) in promises(code) {
            count += 1;
            let is_broken = mutants.contains(promise)
                || parts.iter().any(|(_, tests)| tests.contains(promise))
                || own_tests.contains(name);
            assert!(is_broken != UNBROKEN.contains(&promise), "nothing breaks {promise:?}");
        }
    }
    assert!(count > 60, "{count} promises");
}

/// Finds a mutant by one of these promises, and requires that its run is made short.
fn find_and_shorten(mutant: Mutant, promises: &[&str]) {
    let options = match mutant {
        // It shows after a minute.
        Mutant::Nostalgic => Options { robots: Some(6), ..FORGETFUL },
        _ => Options { robots: Some(6), ..Options::default() },
    };
    let seeds = (0..MUTANT_SEEDS).filter(|seed| has_fault(*seed, &options, mutant.after()));
    let outcomes = seeds.map(|seed| simulate(seed, &options, Some(mutant), false));
    let found = outcomes
        .filter_map(|outcome| Some((outcome.seed, outcome.failure?)))
        .find(|(_, failure)| promises.contains(&failure.promise) && failure.happened.len() > 3);
    let (seed, failure) = found.unwrap_or_else(|| panic!("{mutant:?} is not found"));
    let effort = Effort::Runs(SHRINK_RUNS);
    let shrunk = shrink(seed, &options, Some(mutant), &failure, effort);
    let left = shrunk.outcome.failure.as_ref().unwrap();
    assert_eq!(left.promise, failure.promise, "{mutant:?}");
    // A second fault may be what lets the first one be seen.
    let faults = &shrunk.outcome.faults;
    assert!(shrunk.faults.len() <= 2, "{mutant:?} of seed {seed}: {faults:#?}");
    let is_after =
        |fault: &String| mutant.after().iter().any(|kind| fault.contains(&format!(": {kind}: ")));
    assert!(faults.iter().any(is_after), "{mutant:?} of seed {seed}: {faults:#?}");
    assert!(shrunk.outcome.log.last().unwrap().contains("BROKEN"), "{mutant:?}");
    // Without the mutant the same run breaks no promise.
    assert_eq!(simulate(seed, &shrunk.options, None, false).failure, None, "{mutant:?}");
}
