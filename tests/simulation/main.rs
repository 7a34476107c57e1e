//! Seeds of the whole-fleet simulation.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod mutants;

use std::collections::BTreeSet;
use std::io::Write as _;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_service::Core;
use muster_tests::simulation::{
    Batch, Options, Stats, Summary, fault_numbers, has_fault, run_batch, simulate,
};
use muster_wire::{Key, Pattern};

/// How many seeds the test command runs; `simulate --seeds` runs any number.
const SEEDS: u64 = 300;

/// How many seeds the test command runs that nobody has run before.
const FRESH_SEEDS: u64 = 100;

fn batch(first: u64, seeds: u64) -> Batch {
    Batch {
        first,
        seeds,
        jobs: std::thread::available_parallelism().map_or(1, usize::from),
        options: Options::default(),
        having: None,
        mutant: None,
        shrink_within: Duration::from_secs(30),
    }
}

fn run(batch: &Batch) -> Summary {
    run_batch(batch, |_, _| {}, |_| {})
}

#[test]
fn every_promise_holds_for_three_hundred_seeds() {
    let started = Instant::now();
    let summary = run(&batch(0, SEEDS));
    println!("{}", summary.text());
    // Past the harness, which keeps back what a good test prints: `tests/run` repeats it.
    let seconds = started.elapsed().as_secs();
    writeln!(std::io::stderr(), "simulation: {SEEDS} seeds in {seconds} s").unwrap();
    let failed = summary.failed.values().next().cloned().unwrap_or_default();
    assert!(summary.failed.is_empty(), "{}\n{failed}", summary.text());
    assert_eq!(summary.runs, SEEDS);
    // A storm without faults would prove nothing.
    for kind in [
        "storm",
        "clean cut",
        "silent cut",
        "router restart",
        "kill",
        "lost disk",
        "blackout",
        "blackout without disks",
        "power cut",
        "team cut off",
        "busy hosts",
        "forged term",
        "hang",
        "slow service",
        "slow jobs",
        "job panics",
        "clock set",
        "robot leaves",
        "robot leaves and returns",
        "robot reboots",
        "jump",
        "rank change",
        "rubbish",
        "ghosts",
        "burst",
        "settings",
        "bad alpha",
        "full disk",
        "wish",
        "proposal",
        "many proposals",
        "proposal at rest",
        "bridge killed",
        "bridge hangs",
        "bridge cut off",
        "bridge cut off silently",
        "bridge in bad weather",
        "ROS cut off",
        "ROS in bad weather",
        "ROS robot restarts",
        "ROS robot leaves",
        "transforms pause",
        "transforms stop",
        "second publisher",
        "clock of ROS set",
        "rank change in ROS",
        "rubbish in ROS",
    ] {
        let count = summary.total.faults.get(kind).copied().unwrap_or(0);
        assert!(count > 0, "no fault of the kind {kind:?} has happened");
    }
    let total = &summary.total;
    assert!(total.lost > 0 && total.repeated > 0 && total.mixed > 0 && total.panics > 0);
    // Rules that never had anything to check would prove nothing either.
    assert!(total.bridged > SEEDS * 10 && total.scenes > SEEDS * 100, "{}", summary.text());
    assert!(total.takeovers > 0 && total.joined > SEEDS, "{}", summary.text());
    assert!(total.proposals > 100 && total.proposals_refused > 10, "{total:?}");
    assert!(total.proposals_compared > 20, "{total:?}");
    assert!(total.events > SEEDS * 2000, "{}", total.events);
}

/// How many of the fresh seeds may break a promise. Of the last 48,000, on several states of the programs, four did. Those
/// causes are mended, and too few seeds were run since to know that there is no other one: with none allowed, a run could
/// fail for something that no change has caused. What fails is printed in any case.
const ALLOWED_FAILURES: usize = 1;

/// Seeds that broke a promise once, and what it was.
const ONCE_BROKEN: [(u64, &str); 139] = [
    (
        2_026_300_019_706,
        "robots that were cut off had returned, and another number of teams was kept that the others had shown without them",
    ),
    (
        2_026_300_013_839,
        "the judge did not expect that a leader's term was on its disk alone, as all were killed that answer with its output",
    ),
    (
        2_026_290_000_298,
        "while a team was absent half of another one became a team that had ended, and the other half took its id to a third one",
    ),
    (
        2_026_290_003_416,
        "the judge did not expect that there are other teams once more when a second absent team is forgotten",
    ),
    (
        2_026_290_005_459,
        "the judge did not expect that a robot that returns says later which skills it has",
    ),
    (
        2_026_220_020_809,
        "a new leader said that a wish is granted, and went on from a forged division that did not grant it",
    ),
    (
        2_026_220_023_185,
        "a change was lost that a leader did not know which had confirmed another one since and was restarted",
    ),
    (
        2_026_200_038_517,
        "of two numbers of teams the better one was possible once the other had brought a team without limits about",
    ),
    (
        2_026_210_007_036,
        "the judge expected a new planner to know in which team a robot had been that had no place (and robots waited that operators had moved)",
    ),
    (
        2_026_200_023_737,
        "the judge expected browsers to show the last division of a fleet without robots, whose clusterer and its disk were lost",
    ),
    (
        2_026_200_004_989,
        "settings that a leader announced before a change arrived after those with it, and it had published nothing in between",
    ),
    (
        2_026_200_010_765,
        "a change that a suspect of a lower term had confirmed was lost when the instance with the higher term took over",
    ),
    (
        2_026_200_010_627,
        "the judge compared a proposal with fewer teams than asked for with the division after the seats of absent teams had ended",
    ),
    (
        2_026_180_035_723,
        "a robot that waited for an absent team of which nothing was remembered moved when everything was restarted",
    ),
    (
        2_026_180_024_972,
        "a robot that waited in its last team left a team without a robot, as a pin into a team that had just begun counted already",
    ),
    (
        2_026_180_004_800,
        "moves that waited for an absent team followed a minute after the last outage, as the division had said (the judge did not expect it)",
    ),
    (
        2_026_170_055_847,
        "a viewer that read slowly lost four scenes of the teams in a row, as messages of other topics made them leave its queue",
    ),
    (
        2_026_170_041_816,
        "a robot that no team knew let the evidence end a team whose robots were leaving one after the other",
    ),
    (
        2_026_170_017_130,
        "robots moved before the ranks of a team that had returned were trusted again as before",
    ),
    (
        2_026_165_009_358,
        "a division that stood changed who was in a locked team, and was another one after a restart",
    ),
    (
        2_026_165_009_626,
        "the number of teams of a fleet that was at rest within two seconds of its start was not kept",
    ),
    (
        2_026_162_000_309,
        "robots that all relations place alike were divided by the last bits of their vectors, and otherwise after a restart",
    ),
    (
        2_026_161_001_953,
        "a fleet at rest showed another number of teams after a restart, by divisions that were found with fewer starts",
    ),
    (2_026_162_001_020, "K was that of the time when a team was absent as the team was back"),
    (
        2_026_163_006_012,
        "robots that stayed while a team was absent were elsewhere by the same vectors after a restart",
    ),
    (
        2_026_162_001_212,
        "a team that lived again went to a robot that a wish put there, as it was divided once more",
    ),
    (
        2_026_164_001_428,
        "a team that lived again changed all its robots as it was divided once more",
    ),
    (
        2_026_130_036_521,
        "under needs and wishes the same vectors were divided otherwise after a restart of everything",
    ),
    (2_026_130_037_001, "a restart of everything forgot that a team was absent"),
    (
        2_026_130_037_009,
        "a restart of everything forgot that a team was absent, so that others were divided by vectors without it",
    ),
    (2_026_130_043_333, "a restart of everything forgot that a team was absent"),
    (2_026_150_000_226, "a restart of everything forgot that a team was absent"),
    (2_026_150_001_864, "a restart of everything forgot that a team was absent"),
    (
        2_026_130_008_703,
        "robots of a team that had been silent moved as one after the other reported again",
    ),
    (
        2_026_130_044_755,
        "a silent robot that left and was back by the next roster seemed to have new orders",
    ),
    (
        2_026_130_027_922,
        "an accepted proposal with new teams was divided once more, with wishes for one of them",
    ),
    (
        2_026_160_005_745,
        "a change was lost that a leader had confirmed before it had published anything",
    ),
    (
        2_026_160_017_007,
        "a command that an earlier leader had refused was carried out from a copy that arrived late",
    ),
    (
        2_026_130_014_301,
        "an embedder took an empty embedding that no reader had received for published, and robots that had left stayed",
    ),
    (
        2_026_130_013_428,
        "the judge forgot that a blackout had ended all that remembered the ids of a clusterer without its disk",
    ),
    (
        2_026_130_028_315,
        "the judge compared with terms from before a loss of all that was known of them, on a host without a clock",
    ),
    (
        2_026_130_034_405,
        "the judge compared with terms from before a loss of all disks, on hosts without a clock",
    ),
    (
        2_026_130_003_746,
        "a robot that was banned from the only team had none while the seat of an absent team was kept",
    ),
    (
        2_026_123_008_963,
        "a robot left and came back between two rosters, and others moved by what related them without it",
    ),
    (
        2_026_123_000_361,
        "an instance that led again went on from the division of another one, and the judge compared with its own",
    ),
    (
        2_026_118_005_728,
        "robots were divided into as many teams as before when a seat was given up, and then into more",
    ),
    (
        2_026_118_005_090,
        "a robot of the reserve and the one in its place were locked in a team that holds one of them, and a restart forgot that",
    ),
    (
        2_026_118_006_099,
        "a leader without settings of the fleet was restarted, and passed for one that has them",
    ),
    (
        2_026_117_007_608,
        "a robot that left and came back between two frames had no superior, which counted as new orders",
    ),
    (7_000_085, "a number of teams that is chosen was another one while a team was absent"),
    (7_000_402, "one team was ended and another divided while a third was absent"),
    (
        7_000_567,
        "the last robots of a team that was leaving joined another one, and a third was divided",
    ),
    (7_000_124, "a team that was leaving was two for a moment, and two others were one"),
    (7_001_350, "robots of a team that returned were divided into teams that had ended before"),
    (
        7_001_979,
        "the last robot of a team that was leaving joined the other one, which was divided",
    ),
    (
        7_002_028,
        "the last robot of a team that was leaving joined another one, and a third was divided",
    ),
    (
        2_026_114_011_499,
        "an embedder that started again found other divisions of eight robots, and with them another number of teams",
    ),
    (
        2_026_114_021_458,
        "a console did not receive a forged division that no reader believes (the judge expected it)",
    ),
    (
        2_026_113_503_770,
        "a bridge that started was given what had been put while none ran (the judge's network did)",
    ),
    (
        2_026_113_401_259,
        "a new embedder of a fleet at rest published nothing, as the one before had published it",
    ),
    (
        2_026_112_912_581,
        "a change was lost that an instance had confirmed and said once, as it led again",
    ),
    (
        2_026_112_963_565,
        "a slow viewer drew a team that had ended, for as long as entities live (the judge did)",
    ),
    (
        2_026_113_200_900,
        "silhouettes of robots in nearly one place rest on rounding (the judge's tolerance did)",
    ),
    (
        2_026_113_201_353,
        "a clock that was behind did not believe a term above a forged one yet (the judge expected it)",
    ),
    (
        2_026_112_753_654,
        "a division within limits was not found again from itself, nor from what came of that",
    ),
    (
        2_026_112_775_680,
        "all were to see a division that had filled the place of an absent team a moment before the end",
    ),
    (
        2_026_112_780_242,
        "no embedding was published any more after one of a roster that was forged",
    ),
    (
        2_026_112_780_866,
        "settings that were announced after a job had begun were taken for those of before",
    ),
    (2_026_112_786_646, "a robot that had no team was locked in the one that it had lost"),
    (
        2_026_112_790_605,
        "teams of robots that had fallen silent changed with each division, and with them the needs",
    ),
    (
        2_026_112_791_413,
        "a change was lost that a leader of a lower term had confirmed before it was replaced",
    ),
    (
        2_026_112_792_112,
        "an accepted proposal of another number of teams went through a division with robots that were held",
    ),
    (
        2_026_112_792_577,
        "of two changes the one counted as later whose operator had the clock of another century",
    ),
    (2_026_112_792_673, "a leader began a term that an instance that was starting had on its disk"),
    (2_026_112_799_222, "viewers were to see a team in its new place before the next division"),
    (2_026_112_808_063, "a suspect leader answered with a division that it had not published"),
    (2_026_112_810_754, "the team that kept its id depended on which robots were held meanwhile"),
    (
        2_026_112_811_941,
        "an earlier change of one leader replaced a later one, by the clocks of two operators",
    ),
    (2_026_112_817_504, "a proposal that asked for nothing new moved robots"),
    (
        2_026_112_828_831,
        "a leader that led again after another one was to go on from its own last division",
    ),
    (2_026_112_905_898, "an embedder believed a forged number of teams for twenty seconds"),
    (
        2_026_112_912_771,
        "a historian was to record divisions that were older than one it had been answered with",
    ),
    (
        2_026_112_912_792,
        "a division that came back as an answer was taken for the newest one of a bridge",
    ),
    (2_026_112_607_603, "an instance said as its own what another leader of its term had answered"),
    (2_026_112_612_325, "a team that limits had left empty was taken for no other number of teams"),
    (2_026_112_618_942, "a message of a robot that was left out counted as its newest one"),
    (
        2_026_112_625_344,
        "all were to agree at the moment in which the place of an absent team was filled",
    ),
    (
        2_026_112_639_247,
        "robots that stayed in their team while one returned were never divided again",
    ),
    (2_026_112_641_858, "a proposal was compared with the division of a fleet that all had left"),
    (2_026_112_642_808, "a planner kept to a forged embedding for ever"),
    (2_026_112_646_712, "a long job brought an embedding of an older roster than the last one"),
    (2_026_112_652_751, "a need named a team to come by a number that a restart skipped"),
    (
        2_026_112_653_663,
        "a proposal took another number of teams at once, which the division does not",
    ),
    (2_026_112_656_121, "a leader of a new term was taken for the one of before"),
    (2_026_112_660_439, "of two leaders of one term each kept to what itself had confirmed"),
    (
        2_026_112_667_481,
        "a restart divided robots again that had stayed in their team while one returned",
    ),
    (2_026_112_711_940, "silhouettes of robots in the same place were those of rounding"),
    (
        2_026_112_713_175,
        "settings of a leader of a lower term replaced those on the disk of who had led since",
    ),
    (
        2_026_112_723_228,
        "a restart kept a seat where a team was missing because nothing satisfied the limits",
    ),
    (
        2_026_112_730_146,
        "a division within limits was not found again from itself as a team had gone",
    ),
    (2_026_112_609_446, "a clusterer was woken each millisecond after a failed job"),
    (2_026_112_613_249, "a command came back that a later one had replaced"),
    (2_026_112_651_311, "an answer that had waited replaced newer settings"),
    (
        2_026_112_657_604,
        "a team that needs nothing fell silent, and the same vectors were divided again",
    ),
    (85_000_861, "a standby never received the settings of its leader, and led with its own"),
    (85_001_035, "the last division was none that is found again from itself"),
    (85_002_256, "the evidence took a team away while nothing satisfied the limits"),
    (85_002_789, "what another instance had from its disk kept no seat for a team that is absent"),
    (85_002_870, "a console was to join over a link that was down"),
    (90_000_091, "which numbers of teams are possible depended on which team was the largest"),
    (91_000_051, "a historian was to go back to a division of a lower term"),
    (
        110_000_011,
        "a leader without state was taken for one with settings, as its announcement came before it was followed",
    ),
    (
        110_000_099,
        "a leader that came back while another began was not asked for the settings it had confirmed",
    ),
    (
        120_001_493,
        "the token of a robot that died while its link was silent stayed in the judge's network for ever",
    ),
    (
        120_002_741,
        "a change was lost that a leader had confirmed just before its link was cut, and whose outcome had arrived",
    ),
    (
        120_006_857,
        "a wish that began to count with a division was taken for no change of what the next one rests on",
    ),
    (
        130_000_195,
        "an embedder that knew no embedding of before chose another number of teams that was hardly worse",
    ),
    (131_000_739, "a change counted as confirmed whose answer came after all disks were lost"),
    (131_000_885, "a conflict that another leader had reported was to be reported again"),
    (
        131_001_713,
        "the power was cut while orders were still new to an embedder that had learned of them late",
    ),
    (
        150_000_371,
        "an outcome from before the settings on its disk changed those of a standby that took over",
    ),
    (
        160_000_135,
        "the lease renewal of one leader took the place of that of another one, as both have one key",
    ),
    (160_001_793, "robots of a division before a restart were awaited though all of them had left"),
    (160_001_973, "viewers believed services without state only after two stale times"),
    (
        160_004_497,
        "the last wish was withdrawn while nothing could be published, and nothing said so afterwards",
    ),
    (160_008_335, "what a leader had confirmed was said once to another one, and lost"),
    (
        160_011_335,
        "a change counted as lasting that a leader had confirmed while one of a higher term led",
    ),
    (160_012_326, "fewer teams were asked for than could be formed anyway, which changes no team"),
    (
        160_012_601,
        "a confirmed change was refused by a clusterer that knew no robots yet as it took over",
    ),
    (
        180_001_901,
        "a wish was lost that a leader had confirmed just before it was killed, and a standby still answered with it",
    ),
    (180_002_565, "a leader forgot the term that a reader had known when it asked once more"),
    (
        190_000_017,
        "a change that one leader had confirmed was not taken over by another one whose clock had made it refuse it",
    ),
    (
        179_549_396_280,
        "the judge took the end of the seat of an absent team for a change without a cause",
    ),
    (
        2_026_255_023_305,
        "the judge took an outcome that a process says again for another one for a command that it has carried out twice",
    ),
    (
        2_026_255_021_965,
        "a standby that had missed how robots left led after a restart, and moved others that had stayed for their team",
    ),
    (
        2_026_260_002_672,
        "robots that had stayed as one left were divided twice once a lost link was back",
    ),
    (
        2_026_260_007_526,
        "the judge cut the power while a robot was about to move, and wanted it where it had been",
    ),
    (
        2_026_260_008_307,
        "the judge took a change for the later one that was sent by a clock of another century",
    ),
    (
        2_026_270_002_928,
        "robots that stayed together took over the id of another team, where needs allowed fewer teams after a restart",
    ),
];

#[test]
fn seeds_that_broke_a_promise_once_break_none() {
    for (seed, cause) in ONCE_BROKEN {
        let outcome = simulate(seed, &Options::default(), None, false);
        assert_eq!(outcome.failure, None, "seed {seed}, once: {cause}");
    }
}

/// The fixed seeds pass, or a change was not finished. What nobody has looked at are others: each run of the
/// test command draws some, and prints the first one, so that a failure can be repeated.
#[test]
fn every_promise_holds_for_a_hundred_fresh_seeds() {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    // Far from the fixed seeds, and another range in every second.
    let first = since.as_secs() * FRESH_SEEDS;
    // Past the harness, and before the run: it is to be known whatever happens.
    writeln!(
        std::io::stderr(),
        "simulation: {FRESH_SEEDS} fresh seeds; again: cargo run -p muster-tests --bin simulate -- \
         --seeds {FRESH_SEEDS} --first {first}"
    )
    .unwrap();
    let summary = run(&batch(first, FRESH_SEEDS));
    for (seed, failed) in &summary.failed {
        writeln!(std::io::stderr(), "simulation: seed {seed} breaks a promise: {failed}").unwrap();
    }
    assert!(summary.failed.len() <= ALLOWED_FAILURES, "first {first}\n{}", summary.text());
    assert_eq!(summary.runs, FRESH_SEEDS);
}

/// A clusterer remembers robots that left for a minute, and no longer: in a run that outlasts that, with
/// hundreds of robots that come and go, it never remembers more than those of that time.
#[test]
fn what_is_remembered_of_robots_that_left_is_forgotten_again() {
    let options = Options { robots: Some(4), steps: 12_000, ghosts: 3, ..Options::default() };
    let ghosts = 3 * 120;
    let outcome = simulate(1, &options, None, false);
    assert_eq!(outcome.failure, None);
    let most = outcome.stats.remembered;
    println!("{ghosts} ghosts, at most {most} robots remembered");
    assert!(most > 60 && most < ghosts, "{most} robots are remembered");
}

/// What operators ask of planners, without what they accept of it.
const PROPOSALS: [&str; 1] = ["many proposals"];

/// Proposals are computed by others than the division: it is published as often with many of them as without any.
#[test]
fn proposals_delay_no_division() {
    let options = Options { robots: Some(6), ..Options::default() };
    let seeds: Vec<u64> =
        (0..200).filter(|seed| has_fault(*seed, &options, &PROPOSALS)).take(6).collect();
    assert_eq!(seeds.len(), 6);
    let mut proposals = 0;
    for seed in seeds {
        let asked = fault_numbers(seed, &options, &PROPOSALS);
        let run = |only: BTreeSet<usize>| {
            let options = Options { only: Some(only), ..options.clone() };
            let outcome = simulate(seed, &options, None, false);
            assert_eq!(outcome.failure, None, "seed {seed}");
            outcome.stats
        };
        let (with, without) = (run(asked), run(BTreeSet::new()));
        // A planner that is starting refuses them.
        assert!(with.proposals + with.proposals_refused > 0, "seed {seed}: {with:?}");
        assert_eq!(without.proposals + without.proposals_refused, 0, "seed {seed}: {without:?}");
        proposals += with.proposals;
        let per_second = |stats: &Stats| stats.divisions as f64 / stats.simulated as f64;
        let ratio = per_second(&with) / per_second(&without);
        assert!((0.9..1.1).contains(&ratio), "seed {seed}: {with:?} {without:?}");
    }
    assert!(proposals > 0);
}

/// Proposals that no one accepts or drops are forgotten, in runs that outlast them.
#[test]
fn proposals_are_forgotten() {
    let options = Options { robots: Some(4), ..FORGETFUL };
    let seeds = (0..200).filter(|seed| has_fault(*seed, &options, &PROPOSALS));
    for seed in seeds.take(2) {
        let only = Some(fault_numbers(seed, &options, &PROPOSALS));
        let outcome = simulate(seed, &Options { only, ..options.clone() }, None, false);
        assert_eq!(outcome.failure, None, "seed {seed}");
        assert!(outcome.stats.proposals > 0, "seed {seed}");
    }
}

/// Topics of robots of ROS that have left, and of robots that never were, are forgotten, in runs that outlast them.
#[test]
fn topics_of_robots_of_ros_that_are_gone_are_forgotten() {
    let gone = ["ROS robot leaves", "rubbish in ROS"];
    let seeds =
        (0..500).filter(|seed| gone.iter().all(|kind| has_fault(*seed, &FORGETFUL, &[kind])));
    for seed in seeds.take(2) {
        let only = Some(fault_numbers(seed, &FORGETFUL, &gone));
        let outcome = simulate(seed, &Options { only, ..FORGETFUL }, None, false);
        assert_eq!(outcome.failure, None, "seed {seed}");
        assert!(outcome.stats.bridged > 0 && outcome.stats.simulated > 90_000_000, "seed {seed}");
    }
}

/// A run that outlasts proposals.
const FORGETFUL: Options =
    Options { robots: None, fleet: None, steps: 9000, only: None, ghosts: 0 };

/// A leader that has lost its terms asks its readers, and each must answer for what it goes by: one that
/// does not would drop all that the leader publishes until the epochs have passed what it knows.
#[test]
fn every_reader_serves_what_it_reads() {
    let wirings = [Ingest::wiring(), Embedder::wiring(), Clusterer::wiring(), Auditor::wiring()];
    for wiring in wirings {
        for subscription in wiring.subscriptions {
            let pattern = subscription.pattern;
            // Robots have no terms, and settings are accepted when they contradict twice.
            let exempt = pattern.payload_limit() == MAX_ROBOT_PAYLOAD
                || matches!(pattern, Pattern::One(Key::Settings(_)))
                // Nor have the states of recordings: the newest one holds.
                || pattern == Pattern::HistoryStates;
            let serves =
                |pattern: &Pattern| wiring.served.iter().any(|served| served.pattern == *pattern);
            // A roster names the term and the revision of every graph, so that nothing is taken twice from who serves
            // it alone; graphs of large fleets are megabytes, which the embedder sends already.
            let served = serves(&pattern)
                || pattern == Pattern::Graphs && serves(&Pattern::One(Key::Roster));
            assert!(exempt || served, "{pattern:?} is read and not served");
        }
    }
}

#[test]
fn the_same_seed_leads_to_the_same_run() {
    for seed in [1, 2, 3, 8] {
        let first = simulate(seed, &Options::default(), None, true);
        let again = simulate(seed, &Options::default(), None, true);
        assert!(first.log.len() > 1000);
        for (line, other) in first.log.iter().zip(&again.log) {
            assert_eq!(line, other, "seed {seed}");
        }
        assert_eq!(first, again, "seed {seed}");
    }
    let one = simulate(1, &Options::default(), None, true);
    let other = simulate(2, &Options::default(), None, true);
    assert_ne!(one.log, other.log);
}
