//! The page of the physical case.

use crate::experiments::Progress;
use crate::figures::{command, leaders, team_names};
use crate::live::{TeamsReceived, play};
use crate::physical::{Case, DROPPED_SHARE, JITTER_M, MISSED_SHARE, RADIO_RANGE_M, RATE_HZ};
use crate::plots::map::{Map, maps};
use crate::results::{Page, Record};
use crate::score::{Correct, correct};

/// Teams that are asked for, as in the paper.
const TEAMS: usize = 3;

/// Plays all recordings for so many seconds each through the real services.
///
/// # Errors
/// If a file is none, the bus or a service fails, or a drawing.
pub fn physical(seconds: f64, progress: &Progress<'_>) -> anyhow::Result<Page> {
    let mut page = Page::default();
    let (mut rows, mut pictures) = (Vec::new(), Vec::new());
    for case in Case::all()? {
        progress(&format!("physical: {}", case.layout.name));
        let received = play(&case, &case.recording()?, TEAMS, seconds)?;
        let right = right(&received, &case);
        page.records.extend(records(&case, &received, right));
        let whole = received.whole_s.map_or("never".to_owned(), |whole| format!("{whole:.2}"));
        let [newest, oldest] = [&received.newest_ms, &received.oldest_ms].map(|ms| {
            let [half, most] = [0.5, 0.95].map(|share| quantile(ms, share));
            format!("{half:.1} / {most:.1}")
        });
        rows.push(vec![
            case.layout.name.clone(),
            format!("{} of {}", right.right, right.total),
            whole,
            received.moves.to_string(),
            format!("{:.2}", received.settled_s),
            received.newest_ms.len().to_string(),
            newest,
            oldest,
        ]);
        pictures.push(picture(&case, &received, right)?);
    }
    page.say(
        "## The physical case, recorded",
        &format!(
            "Ten robots in four layouts, as in the paper's study with ten TurtleBots, and three teams asked for. \
             There are no robots here: what a camera would see of them is simulated, {RATE_HZ} pictures a second \
             with places off by {:.0} mm (standard deviation along each axis), {:.0} % of the marks not recognised \
             and {:.0} % of the pictures lost. Everything else is real: a router, the four services with their \
             defaults and ten robots with a session each exchange messages over sockets for {seconds} s, starting \
             with the services. Radios reach about {RADIO_RANGE_M} m, and robots nearer to the middle command the \
             others of their team.\n\nThe table has how many robots had received the right team in the end; after \
             how many seconds all had a team, how often one received another team after that, and when the last \
             change was; how many divisions a console received, and how many milliseconds (median / 95 %) after \
             `ingest` had received the newest and the oldest pose behind them. The paper shows pictures of its four \
             layouts and no numbers, so there is nothing to compare.",
            1e3 * JITTER_M,
            100.0 * MISSED_SHARE,
            100.0 * DROPPED_SHARE
        ),
    );
    let note = "rings: robots that command others; dark lines: robots and their superiors; pale lines: radio links";
    page.plot(
        "physical",
        "Four layouts of ten robots, each in the colour of the team that it received",
        maps(&pictures, 2, &team_names(TEAMS), note)?,
    );
    let head = [
        "layout",
        "right",
        "all know, s",
        "moves after",
        "last change, s",
        "divisions",
        "newest pose, ms",
        "oldest pose, ms",
    ];
    page.table(&head.map(str::to_owned), &rows);
    Ok(page)
}

/// Robots that received the right team; those without a team are wrong.
fn right(received: &TeamsReceived, case: &Case) -> Correct {
    let truth = &case.layout.divisions[0];
    // Robots without a team are left out: they are no team of their own.
    let known =
        received.teams.iter().zip(truth).filter_map(|(team, truth)| Some(((*team)?, *truth)));
    let (found, wanted): (Vec<usize>, Vec<Option<usize>>) = known.unzip();
    // Both have been made of the same robots.
    let right = correct(&found, &wanted).unwrap_or_default().right;
    Correct { right, total: truth.iter().flatten().count() as u64 }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
fn records(case: &Case, received: &TeamsReceived, right: Correct) -> Vec<Record> {
    let record = |measure: &'static str, value: f64| Record {
        experiment: "physical",
        case: case.layout.name.clone(),
        teams: TEAMS,
        condition: String::new(),
        method: "live services".to_owned(),
        seed: case.seed,
        measure,
        value,
    };
    let once = [
        ("right", right.right as f64),
        ("counted", right.total as f64),
        ("moves", received.moves as f64),
        ("settled s", received.settled_s),
    ];
    let mut records: Vec<Record> =
        once.into_iter().map(|(measure, value)| record(measure, value)).collect();
    records.extend(received.whole_s.map(|whole| record("whole s", whole)));
    records.extend(received.newest_ms.iter().map(|ms| record("newest pose ms", *ms)));
    records.extend(received.oldest_ms.iter().map(|ms| record("oldest pose ms", *ms)));
    records
}

/// The least value that so large a share of all does not exceed; NaN for none.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(place.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

fn picture(case: &Case, received: &TeamsReceived, right: Correct) -> anyhow::Result<Map> {
    let layout = &case.layout;
    let number = |robot: &str| layout.robots.iter().position(|other| other.as_str() == robot);
    let links = case.links()?.into_iter().enumerate().flat_map(|(robot, links)| {
        let peers = links.links.into_iter().filter_map(|link| number(link.peer.as_str()));
        peers.map(move |peer| (robot, peer)).collect::<Vec<_>>()
    });
    Ok(Map {
        title: format!("{}: {} of {} right", layout.name, right.right, right.total),
        places: layout.places.clone(),
        teams: received.teams.clone(),
        leaders: leaders(&layout.superiors),
        command: command(&layout.superiors),
        links: links.collect(),
        boxes: true,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_without_a_team_are_wrong() {
        let case = &Case::all().unwrap()[0];
        let mut received =
            TeamsReceived { teams: case.layout.divisions[0].clone(), ..TeamsReceived::default() };
        assert_eq!(right(&received, case), Correct { right: 10, total: 10 });
        received.teams[0] = None;
        assert_eq!(right(&received, case), Correct { right: 9, total: 10 });
        received.teams.fill(None);
        assert_eq!(right(&received, case), Correct { right: 0, total: 10 });
        assert_eq!(picture(case, &received, right(&received, case)).unwrap().places.len(), 10);
    }

    #[test]
    fn quantiles_are_values() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!([0.25, 0.5, 0.95].map(|share| quantile(&values, share)), [1.0, 2.0, 4.0]);
        assert!(quantile(&[], 0.5).is_nan());
    }
}
