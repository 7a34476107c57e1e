//! The scene of the teams: one entity for each, with its robots, its hull and its label; those that are silent or lost; and
//! what whoever looks must know before all else.

use std::collections::BTreeMap;

use muster_model::roster::{Presence, RosterEntry};
use muster_model::time::Tick;

use super::color::{MISSING, NO_TEAM, NOTICE, TEXT, team_color};
use super::fleet::{Fleet, frame_of};
use super::hull::hull;
use super::limits::MAX_AGES;
use super::scene::{Color, Entity, LineKind, Lines, Sphere, Text};

/// Height of names in pixels.
const LABEL_PX: f64 = 18.0;

/// Height of ages in pixels.
const AGE_PX: f64 = 12.0;

/// Width of a hull in pixels.
const HULL_PX: f64 = 2.0;

/// Smallest robot that is drawn, in metres: below it no fleet keeps apart.
const MIN_SIZE_M: f64 = 0.3;

/// A robot is drawn as large as this part of the way across the fleet, so that it is seen when all are.
const SIZE_SHARE: f64 = 0.01;

/// The entity of robots without a team.
const UNASSIGNED: &str = "unassigned";

/// The entity of those that are silent or lost.
const MISSING_ID: &str = "missing";

/// The entity that says what must be known.
const NOTICE_ID: &str = "notice";

/// The robots of one entity.
#[derive(Debug, Default)]
struct Group {
    places: Vec<[f64; 3]>,
}

/// How large a robot is drawn, in metres. It changes by steps of 1, 2 and 5, so that it rests while robots move.
fn size(places: &[[f64; 3]]) -> f64 {
    let across = (0..2).map(|axis| {
        let along = places.iter().map(|at| at[axis]);
        let (least, most) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), x| {
            (least.min(x), most.max(x))
        });
        most - least
    });
    let wanted = across.fold(0.0, f64::max) * SIZE_SHARE;
    if wanted <= MIN_SIZE_M {
        return MIN_SIZE_M;
    }
    let decade = 10.0_f64.powf(wanted.log10().floor());
    let step = [5.0, 2.0, 1.0].into_iter().find(|step| step * decade <= wanted);
    (step.unwrap_or(1.0) * decade).max(MIN_SIZE_M)
}

fn middle(places: &[[f64; 3]]) -> [f64; 3] {
    let count = places.len().max(1) as f64;
    [0, 1, 2].map(|axis| places.iter().map(|at| at[axis]).sum::<f64>() / count)
}

/// How long ago something was, as people say it.
fn age(now: Tick, then: Tick) -> String {
    let seconds = now.since(then).as_secs();
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7200 => format!("{} min", seconds / 60),
        _ => format!("{} h", seconds / 3600),
    }
}

fn entity(id: String, frame: &str) -> Entity {
    Entity {
        id,
        frame: frame.to_owned(),
        facts: Vec::new(),
        spheres: Vec::new(),
        lines: Vec::new(),
        texts: Vec::new(),
    }
}

/// The name of an entity: positions of another frame than that of most robots need one of their own.
fn id(name: &str, frame: &str, main: &str) -> String {
    if frame == main { name.to_owned() } else { format!("{name}@{frame}") }
}

fn draw(entity: &mut Entity, places: &[[f64; 3]], size: f64, color: Color) {
    entity.spheres = places.iter().map(|at| Sphere { at: *at, size, color }).collect();
    let points = hull(places);
    if points.len() > 1 {
        entity.lines.push(Lines { kind: LineKind::Loop, points, width: HULL_PX, color });
    }
}

/// All entities of the teams. `notice` is what must be known.
pub(super) fn entities(fleet: &Fleet, now: Tick, notice: Option<&str>) -> Vec<Entity> {
    let mut groups: BTreeMap<(&str, Option<usize>), Group> = BTreeMap::new();
    let mut everywhere = Vec::with_capacity(fleet.robots().len());
    for (entry, slot) in fleet.placed() {
        let Some(at) = entry.position else { continue };
        everywhere.push(at);
        if entry.presence == Presence::Active {
            groups.entry((frame_of(entry), slot)).or_default().places.push(at);
        }
    }
    let missing = fleet.missing();
    let main = main_frame(fleet, &missing);
    let size = size(&everywhere);
    let mut all = Vec::with_capacity(groups.len() + 2);
    for ((frame, slot), group) in groups {
        let team = slot.and_then(|slot| fleet.teams()?.teams.get(slot));
        let (name, color) = match team {
            Some(team) => (format!("team/{}", team.id), team_color(team.id.as_str())),
            None => (UNASSIGNED.to_owned(), NO_TEAM),
        };
        let mut entity = entity(id(&name, frame, main), frame);
        draw(&mut entity, &group.places, size, color);
        if let Some(team) = team {
            let text = format!("{} · {}", team.id, team.members.len());
            let at = middle(&group.places);
            entity.texts.push(Text { at, text, size: LABEL_PX, color });
            entity.facts = vec![
                ("team", team.id.to_string()),
                ("robots", team.members.len().to_string()),
                ("leader", team.leader.to_string()),
            ];
        } else {
            entity.lines.clear();
        }
        all.push(entity);
    }
    all.extend(missing_entities(&missing, main, size, now));
    if let Some(text) = notice {
        let mut entity = entity(NOTICE_ID.to_owned(), main);
        let at = middle(&everywhere);
        entity.texts.push(Text { at, text: text.to_owned(), size: LABEL_PX, color: NOTICE });
        all.push(entity);
    }
    all
}

/// The frame of the first robot that is anywhere.
fn main_frame<'a>(fleet: &'a Fleet, missing: &[&'a RosterEntry]) -> &'a str {
    let first = fleet.robots().iter().find(|entry| entry.position.is_some());
    first.or_else(|| missing.first().copied()).map_or("map", frame_of)
}

fn missing_entities(missing: &[&RosterEntry], main: &str, size: f64, now: Tick) -> Vec<Entity> {
    let mut all: BTreeMap<&str, Entity> = BTreeMap::new();
    for (number, entry) in missing.iter().enumerate() {
        let Some(at) = entry.position else { continue };
        let frame = frame_of(entry);
        let entity = all.entry(frame).or_insert_with(|| entity(id(MISSING_ID, frame, main), frame));
        entity.spheres.push(Sphere { at, size, color: MISSING });
        if number < MAX_AGES {
            let text = format!("{} {}", entry.robot, age(now, entry.last_seen));
            let at = [at[0], at[1], at[2] + size];
            entity.texts.push(Text { at, text, size: AGE_PX, color: TEXT });
        }
    }
    all.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_are_drawn_by_steps_and_never_vanish() {
        assert_eq!(size(&[]), MIN_SIZE_M);
        assert_eq!(size(&[[1.0, 1.0, 0.0]]), MIN_SIZE_M);
        assert_eq!(size(&[[0.0, 0.0, 0.0], [99.0, 0.0, 0.0]]), 0.5);
        assert_eq!(size(&[[0.0, 0.0, 0.0], [0.0, 10_000.0, 0.0]]), 100.0);
        assert_eq!(
            size(&[[0.0, 0.0, 0.0], [0.0, 0.0, 10_000.0]]),
            MIN_SIZE_M,
            "heights are not across"
        );
    }

    #[test]
    fn ages_are_short() {
        let at = |seconds: u64| Tick(seconds * 1_000_000);
        assert_eq!(age(at(130), at(11)), "119 s");
        assert_eq!(age(at(130), at(10)), "2 min");
        assert_eq!(age(at(9_000), at(0)), "2 h");
        assert_eq!(age(at(0), at(9)), "0 s", "a clock that was set back");
    }
}
