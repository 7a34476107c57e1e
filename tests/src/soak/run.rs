//! Plays a plan: faults begin and end by the clock, and after each step the fleet must be whole again.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context;
use muster_model::id::{RobotId, TeamId};
use tokio::time::sleep;

use super::field::{FLEET, Field};
use super::judge::{Division, Judge, Observer};
use super::memory::Memory;
use super::plan::{Kind, Plan, Step};
use crate::client::now;
use crate::process_stats::quantile;

/// How long a fleet may take from nothing to teams that stand.
const FORMED_WITHIN: Duration = Duration::from_secs(60);

/// How long teams must not change before the first fault.
const STANDS_FOR: Duration = Duration::from_secs(3);

/// How much longer than is promised a fleet may take before the plan goes on without it, in seconds.
const GIVEN_UP_AFTER_S: f64 = 30.0;

/// How often the clock, the memory and the judge are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// How often memory is sampled.
const SAMPLE_EVERY: Duration = Duration::from_secs(1);

/// How late this process must wake up to say so, in seconds.
const NOTABLE_LATENESS_S: f64 = 0.5;

/// How long all is watched once the last fault is mended.
const WATCHED: Duration = Duration::from_secs(3);

/// How a plan is played.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Where the logs of all processes are copied to.
    pub logs: Option<PathBuf>,
    /// How many times longer than promised everything may take.
    pub patience: f64,
}

/// What a run showed.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The promises that were broken, with what was seen.
    pub broken: Vec<String>,
    /// What was measured, as a text of several lines.
    pub report: String,
    /// How many faults happened.
    pub faults: usize,
}

/// How long the fleet took to be whole after each kind of fault, and how long the division paused, in seconds.
#[derive(Debug, Default)]
struct Measured {
    fresh: Vec<f64>,
    pauses: Vec<f64>,
}

/// A run that goes on.
struct Run<'a, S: FnMut(&str)> {
    plan: &'a Plan,
    patience: f64,
    field: Field,
    judge: Judge,
    memory: Memory,
    begin: Instant,
    sampled: Instant,
    /// How late this process woke up at most since that was asked, in seconds: as late may be what it measures.
    late_s: f64,
    latest_s: f64,
    broken: Vec<String>,
    measured: BTreeMap<String, Measured>,
    faults: usize,
    say: S,
}

/// Plays a plan on a fleet of its own, and says what happens.
///
/// # Errors
/// If a program is not built or does not start, or the fleet forms no teams before the first fault.
pub async fn run(
    plan: &Plan,
    options: &RunOptions,
    say: impl FnMut(&str),
) -> anyhow::Result<Outcome> {
    let field = Field::start(plan).await?;
    let robots: Vec<String> = field.truth.keys().cloned().collect();
    let judge = Judge::new(FLEET, &robots)?;
    let (console, on_board) = (field.console().await?, field.on_board().await?);
    judge.listen(&console, Observer::Console).await?;
    judge.listen(&on_board, Observer::OnBoard).await?;
    let begin = Instant::now();
    let mut run = Run {
        plan,
        patience: options.patience,
        field,
        judge,
        memory: Memory::default(),
        begin,
        sampled: begin,
        late_s: 0.0,
        latest_s: 0.0,
        broken: Vec::new(),
        measured: BTreeMap::new(),
        faults: 0,
        say,
    };
    let played = run.play().await;
    if let Some(folder) = &options.logs {
        std::fs::create_dir_all(folder).with_context(|| format!("{}", folder.display()))?;
        for entry in std::fs::read_dir(run.field.folder())? {
            let path = entry?.path();
            if path.extension().is_some_and(|extension| extension == "log") {
                std::fs::copy(&path, folder.join(path.file_name().unwrap_or_default()))?;
            }
        }
    }
    played?;
    Ok(run.outcome())
}

/// Whether a division has the groups of the truth as teams, whatever their names are.
fn is_formed(truth: &BTreeMap<String, String>, division: &Division) -> bool {
    let mut teams: BTreeMap<&String, &TeamId> = BTreeMap::new();
    for (robot, group) in truth {
        let team = RobotId::new(robot).ok().and_then(|robot| division.teams.get(&robot));
        let Some(Some(team)) = team else { return false };
        if *teams.entry(group).or_insert(team) != team {
            return false;
        }
    }
    let mut all: Vec<_> = teams.values().collect();
    all.sort_unstable();
    all.dedup();
    all.len() == teams.len()
}

/// The first kinds of a step's faults in a few words, for the summary.
fn kind_of(step: &Step) -> String {
    let kind = |kind: &Kind| match kind {
        Kind::Killed { instances, .. } if instances.len() == 1 => "a service killed",
        Kind::Killed { .. } => "several services killed",
        Kind::Stopped { .. } => "a service stopped",
        Kind::RouterKilled { .. } => "router killed",
        Kind::RouterStopped => "router stopped",
        Kind::RobotsCut { .. } => "link of robots",
        Kind::BaseCut { .. } => "link of the services",
        Kind::RobotsKilled { .. } => "robots killed",
        Kind::Everything { .. } => "restart of everything",
        Kind::DiskFull { .. } => "disk full",
        Kind::Garbage => "garbage",
        Kind::Tokens { .. } => "tokens",
        Kind::Poses { .. } => "strange robots",
    };
    match step.faults.as_slice() {
        [fault] => kind(&fault.kind).to_owned(),
        _ => "two at once".to_owned(),
    }
}

impl<S: FnMut(&str)> Run<'_, S> {
    async fn play(&mut self) -> anyhow::Result<()> {
        self.form().await?;
        if !self.field.disk_can_be_full() {
            (self.say)("the disk cannot be full here, as only root may mount one: NOT TESTED");
        }
        for (number, step) in self.plan.steps.iter().enumerate() {
            self.step(number + 1, step).await?;
        }
        self.wait(WATCHED).await;
        self.take_broken("after the last fault");
        let panics = self.field.panics()?;
        self.broken.extend(panics.into_iter().map(|line| format!("nothing panics: {line}")));
        let (_, flat) = self.memory.judge();
        self.broken.extend(flat);
        Ok(())
    }

    fn at(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }

    /// Says what happens, and when.
    fn note(&mut self, text: &str) {
        let line = format!("{:>6.1} s  {text}", self.at());
        (self.say)(&line);
    }

    /// Waits, while memory is sampled and this process looks how late it wakes up.
    async fn wait(&mut self, time: Duration) {
        let until = Instant::now() + time;
        loop {
            if self.sampled.elapsed() >= SAMPLE_EVERY {
                self.sampled = Instant::now();
                let processes = self.field.processes();
                self.memory.sample(self.at(), &processes);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            let (asked, slept) = (left.min(LOOK_EVERY), Instant::now());
            sleep(asked).await;
            let late = slept.elapsed().saturating_sub(asked).as_secs_f64();
            self.late_s = self.late_s.max(late);
            self.latest_s = self.latest_s.max(late);
        }
    }

    async fn form(&mut self) -> anyhow::Result<()> {
        let (mut since, mut last) = (Instant::now(), BTreeMap::new());
        loop {
            self.wait(LOOK_EVERY).await;
            let division = self.judge.division();
            let is_same = division.teams == last && is_formed(&self.field.truth, &division);
            if !is_same {
                since = Instant::now();
                last = division.teams;
            } else if since.elapsed() >= STANDS_FOR {
                break;
            }
            let limit = FORMED_WITHIN.mul_f64(self.patience);
            anyhow::ensure!(self.begin.elapsed() < limit, "no teams are formed: {last:?}");
        }
        self.judge.hold();
        self.note("teams stand");
        self.take_broken("before the first fault");
        Ok(())
    }

    fn take_broken(&mut self, when: &str) -> bool {
        let broken = self.judge.take_broken();
        let is_broken = !broken.is_empty();
        for broken in broken {
            let text = format!("{when}: {broken}");
            (self.say)(&format!("        BROKEN {text}"));
            self.broken.push(text);
        }
        is_broken
    }

    fn breaks(&mut self, text: String) {
        (self.say)(&format!("        BROKEN {text}"));
        self.broken.push(text);
    }

    async fn step(&mut self, number: usize, step: &Step) -> anyhow::Result<()> {
        self.wait(step.quiet).await;
        let when = format!("step {number} ({step})");
        self.take_broken(&format!("before {when}"));
        self.late_s = 0.0;
        self.note(&format!("{number}: {step}"));
        let hangs = step.faults.iter().any(|fault| fault.kind == Kind::RouterStopped);
        self.judge.step_begins(hangs);
        self.play_faults(number, step, &when).await?;
        let healed = now();
        self.judge.await_fresh(healed);
        let limit = step.fresh_within_s() * self.patience;
        while self.judge.fresh_after_s().is_none()
            && now() - healed < limit + self.late_s + GIVEN_UP_AFTER_S
        {
            self.wait(LOOK_EVERY).await;
        }
        // What robots are told is published behind the division.
        let told_by = now() + limit;
        while !self.judge.told_wrong().is_empty() && now() < told_by {
            self.wait(LOOK_EVERY).await;
        }
        self.conclude(number, step, &when, limit);
        for name in self.field.revive()? {
            self.breaks(format!("{when}: no process ends by itself: {name} has ended"));
        }
        Ok(())
    }

    /// Begins and ends the faults of a step, each at its time.
    async fn play_faults(&mut self, number: usize, step: &Step, when: &str) -> anyhow::Result<()> {
        let mut moments: Vec<(Duration, bool, usize)> = Vec::new();
        for (place, fault) in step.faults.iter().enumerate() {
            moments.push((fault.after, true, place));
            moments.push((fault.after + fault.lasts, false, place));
        }
        moments.sort_by_key(|moment| moment.0);
        let robot = self.field.truth.keys().next().cloned().unwrap_or_default();
        let begin = Instant::now();
        for (moment, begins, place) in moments {
            self.wait(moment.saturating_sub(begin.elapsed())).await;
            let kind = &step.faults[place].kind;
            if begins {
                self.faults += 1;
                let seed = self.plan.seed.wrapping_add(number as u64);
                let at = self.judge.place(&RobotId::new(&robot)?);
                for name in self.field.begin(kind, seed, &robot, at).await? {
                    self.breaks(format!("{when}: {name} does not end by SIGTERM within 10 s"));
                }
            } else {
                self.field.end(kind)?;
            }
        }
        Ok(())
    }

    /// Says what was measured, and compares it with what is promised.
    fn conclude(&mut self, number: usize, step: &Step, when: &str, limit: f64) {
        let (fresh, pause) = (self.judge.fresh_after_s(), self.judge.longest_pause_s());
        let late = self.late_s;
        let fresh_text = fresh.map_or("never".to_owned(), |fresh| format!("{fresh:.1} s"));
        let mut seen = format!("{number}: fresh after {fresh_text}, longest pause {pause:.1} s");
        if late > NOTABLE_LATENESS_S {
            let _ = write!(seen, ", this process woke up {late:.1} s late");
        }
        self.note(&seen);
        if fresh.is_none_or(|fresh| fresh > limit + late) {
            let missing = self.judge.missing();
            self.breaks(format!(
                "{when}: the division is whole and fresh within {limit:.1} s: {fresh_text} {missing}"
            ));
        }
        let max_pause = step.max_pause_s(self.plan.has_standbys);
        if let Some(most) = max_pause.map(|most| most * self.patience + late)
            && pause > most
        {
            self.breaks(format!(
                "{when}: the division pauses for {most:.1} s at most: {pause:.1} s"
            ));
        }
        let told_wrong = self.judge.told_wrong();
        if !told_wrong.is_empty() {
            self.breaks(format!("{when}: all robots have their teams: {}", told_wrong.join("; ")));
        }
        if self.take_broken(when) || !told_wrong.is_empty() {
            // The next fault is judged by what there is then.
            self.judge.release();
            self.judge.hold();
        }
        let measured = self.measured.entry(kind_of(step)).or_default();
        measured.fresh.extend(fresh);
        measured.pauses.push(pause);
    }

    fn outcome(self) -> Outcome {
        let mut report =
            format!("{:<26} {:>6} {:>14} {:>14}\n", "fault", "times", "fresh s", "pause s");
        for (kind, measured) in &self.measured {
            let spread = |values: &[f64]| {
                let mut sorted = values.to_vec();
                sorted.sort_by(f64::total_cmp);
                format!("{:.1} … {:.1}", quantile(&sorted, 0.5), quantile(&sorted, 1.0))
            };
            let _ = writeln!(
                report,
                "{kind:<26} {:>6} {:>14} {:>14}",
                measured.pauses.len(),
                spread(&measured.fresh),
                spread(&measured.pauses)
            );
        }
        report += "(median … longest; fresh counts from the end of the fault)\n\n";
        report += &self.memory.judge().0;
        let counts = self.judge.counts();
        let _ = writeln!(
            report,
            "\n{} divisions; {} messages judged with what they name, {} alone, {} outdated, {} of a stranger, \
             {} under the key of another; this process woke up {:.1} s late at most",
            counts.divisions,
            counts.whole,
            counts.alone,
            counts.outdated,
            counts.garbage,
            counts.misplaced,
            self.latest_s
        );
        Outcome { broken: self.broken, report, faults: self.faults }
    }
}
