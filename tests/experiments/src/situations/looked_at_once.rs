//! Kinds that are looked at once, when all defaults are chosen. Whoever works on the method must not look at
//! their results.

use std::f64::consts::TAU;

use super::draw::Draw;
use super::fleet::{Command, Fleet, Reports, Top};
use super::kinds::{Kind, Source};
use super::shapes::{arc, blob, camp, column};
use super::situation::Situation;

/// Range of a radio among obstacles, in metres.
const RANGE_M: f64 = 50.0;

/// Share of links that are lost where nothing is wrong.
const USUAL_LOSS: f64 = 0.15;

const fn kind(name: &'static str, description: &'static str, draw: fn(u64) -> Situation) -> Kind {
    Kind { name, description, source: Source::Drawn(draw), large: false }
}

/// The kinds.
pub(super) static LOOKED_AT_ONCE: [Kind; 27] = [
    kind(
        "grid of camps",
        "Nine camps of 4 to 9 robots in a square of three by three, 30 m from camp to camp, with \
         radio by range and leaders.",
        grid_of_camps,
    ),
    kind(
        "guard rings",
        "Four rings of 16 robots guard four sites beside each other, with radio by range and a \
         leader each.",
        guard_rings,
    ),
    kind(
        "lines abreast",
        "Five lines of 9 robots march one behind the other, 12 m apart, with chains of command.",
        lines_abreast,
    ),
    kind(
        "crowded field",
        "Ten teams of 12 robots in one crowd, their middles 18 m apart, with trees of command; no \
         links.",
        crowded_field,
    ),
    kind(
        "camps, positions only",
        "Seven groups of 6 to 30 robots on 3 to 12 m, 50 m apart; positions only.",
        camps_by_position,
    ),
    kind(
        "ring around a camp",
        "A ring of 36 robots around a camp of 14; positions only.",
        ring_around_a_camp,
    ),
    kind(
        "lossy radio only",
        "Five teams of 16 robots, 55 m apart, with radio by range of which half is lost; links \
         only.",
        lossy_radio_only,
    ),
    kind(
        "chains only",
        "Six chains of command of 7 to 10 robots, whose heads answer to the first; ranks only.",
        chains_only,
    ),
    kind(
        "one to five, no ranks",
        "Five teams of 6 to 30 robots, 50 m apart, with radio by range; no ranks.",
        one_to_five_without_ranks,
    ),
    kind(
        "tunnels",
        "Four teams of 6 to 18 robots without positions: lossy nets that overhear each other, and \
         trees of command.",
        tunnels,
    ),
    kind(
        "a third of ranks wrong",
        "Six teams of 10 robots, 35 m apart, of whose ranks 30 % name a random robot.",
        a_third_of_the_ranks_wrong,
    ),
    kind(
        "links of others",
        "Five teams of 14 robots, 45 m apart, every one of which reports the links of another \
         robot.",
        links_of_others,
    ),
    kind(
        "positions of others",
        "Six teams of 9 robots, 50 m apart, every one of which reports the position of another \
         robot.",
        positions_of_others,
    ),
    kind(
        "orders of others",
        "Eight camps of 8 robots, 40 m apart, with radio nets; every robot reports the rank of \
         another.",
        orders_of_others,
    ),
    kind(
        "one commander",
        "Five teams of 11 robots, 45 m apart, all of whom answer to one robot.",
        one_commander,
    ),
    kind(
        "scouts with one chief",
        "Five teams of 12 robots, 40 m apart: three scouts of each answer to the chief of scouts, \
         all others to the leader of their team.",
        scouts_with_one_chief,
    ),
    kind(
        "platoons of squads",
        "Three platoons of three squads of 9 robots, each squad plain to see; each platoon is a \
         team.",
        platoons_of_squads,
    ),
    kind(
        "command post",
        "A command post of 2 robots within five platoons of 10 to 20 in close order, whose \
         leaders answer to it; the ranks of a quarter are unknown.",
        command_post,
    ),
    kind(
        "lone robots",
        "Four groups of 12 robots and three robots alone, 45 m apart, each a team, with radio by \
         range and ranks.",
        lone_robots,
    ),
    kind(
        "head-on crowds",
        "Two crowds of 25 robots walk through each other, each with a radio net; half of the \
         ranks are known.",
        head_on_crowds,
    ),
    kind(
        "deep trees",
        "Four teams of 31 robots with trees of command of five levels, in areas that overlap, \
         positions off by 10 m; no links.",
        deep_trees,
    ),
    kind(
        "some at the origin",
        "Six teams of 10 robots, 50 m apart: a fifth report the origin as their position, and a \
         fifth report none.",
        some_at_the_origin,
    ),
    kind(
        "two alone",
        "Two robots, 30 m apart, each a team, that hear each other faintly.",
        two_alone,
    ),
    kind(
        "two and one",
        "Three robots: two that keep close, and one 30 m away, with radio and ranks.",
        two_and_one,
    ),
    kind("three and two", "Five robots in two groups, 30 m apart; positions only.", three_and_two),
    kind(
        "three pairs",
        "Six robots in three pairs, 30 m apart, with radio by range; no ranks.",
        three_pairs,
    ),
    Kind {
        large: true,
        ..kind(
            "a large field",
            "Ten camps of 80 to 200 robots in areas that touch, with lossy radio by range; half \
             of the ranks are known.",
            a_large_field,
        )
    },
];

fn grid_of_camps(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let sizes = draw.counts(9, 4, 9);
    let mut fleet = Fleet::of(&sizes);
    fleet.place(|team, robots| {
        let corner = [30.0 * (team % 3) as f64, 30.0 * (team / 3) as f64];
        camp(&mut draw, corner, 6.0, 1.0, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn guard_rings(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[16; 4]);
    let radius_m = draw.within(15.0, 20.0);
    let site_m = 2.0 * radius_m + 10.0;
    fleet.place(|team, robots| {
        let site = [site_m * (team % 2) as f64, site_m * (team / 2) as f64];
        let from = draw.angle();
        arc(&mut draw, (site, radius_m), (from, TAU), 1.0, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn lines_abreast(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[9; 5]);
    fleet.place(|team, robots| {
        let start = [draw.within(-6.0, 6.0), 12.0 * team as f64];
        column(&mut draw, (start, 0.0), 9.0, 1.0, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Chain, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn crowded_field(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 10], 18.0, 10.0);
    fleet.command(Command::Tree(4), Top::First);
    fleet.situation(&mut draw, Reports::NO_LINKS)
}

fn camps_by_position(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let sizes = draw.counts(7, 6, 30);
    let mut fleet = Fleet::of(&sizes);
    let middles = draw.middles(7, 50.0);
    fleet.place(|team, robots| {
        let spread_m = draw.within(3.0, 12.0);
        blob(&mut draw, middles[team], spread_m, robots)
    });
    fleet.situation(&mut draw, Reports::POSITIONS)
}

fn ring_around_a_camp(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[36, 14]);
    fleet.place(|team, robots| match team {
        0 => arc(&mut draw, ([0.0; 2], 40.0), (0.0, TAU), 1.5, robots),
        _ => blob(&mut draw, [0.0; 2], 7.0, robots),
    });
    fleet.situation(&mut draw, Reports::POSITIONS)
}

fn lossy_radio_only(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[16; 5], 55.0, 11.0);
    fleet.radio_by_range(&mut draw, RANGE_M, 0.5);
    fleet.situation(&mut draw, Reports::LINKS)
}

fn chains_only(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let sizes = draw.counts(6, 7, 10);
    let mut fleet = Fleet::of(&sizes);
    fleet.command(Command::Chain, Top::First);
    fleet.situation(&mut draw, Reports::RANKS)
}

fn one_to_five_without_ranks(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[30, 18, 12, 8, 6], 50.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.situation(&mut draw, Reports::NO_RANKS)
}

fn tunnels(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let sizes = draw.counts(4, 6, 18);
    let mut fleet = Fleet::of(&sizes);
    fleet.radio_nets(&mut draw, 0.4, 0.4);
    fleet.command(Command::Tree(3), Top::First);
    fleet.situation(&mut draw, Reports::NO_POSITIONS)
}

fn a_third_of_the_ranks_wrong(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[10; 6], 35.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.ranks_wrong(&mut draw, 0.3);
    fleet.situation(&mut draw, Reports::ALL)
}

fn links_of_others(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[14; 5], 45.0, 10.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Tree(4), Top::First);
    fleet.links_of_others(&mut draw);
    fleet.situation(&mut draw, Reports::ALL)
}

fn positions_of_others(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[9; 6], 50.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.positions_of_others(&mut draw);
    fleet.situation(&mut draw, Reports::ALL)
}

fn orders_of_others(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[8; 8]);
    let corners = draw.middles(8, 40.0);
    fleet.place(|team, robots| camp(&mut draw, corners[team], 8.0, 1.5, robots));
    fleet.radio_nets(&mut draw, 0.2, 0.2);
    fleet.command(Command::Tree(3), Top::First);
    fleet.ranks_of_others(&mut draw);
    fleet.situation(&mut draw, Reports::ALL)
}

fn one_commander(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[11; 5], 45.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    for superior in fleet.superiors.iter_mut().skip(1) {
        *superior = Some(0);
    }
    fleet.situation(&mut draw, Reports::ALL)
}

fn scouts_with_one_chief(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 5], 40.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    let chief = fleet.members[draw.index(5)][1];
    for members in &fleet.members {
        for scout in members[1..4].iter().filter(|scout| **scout != chief) {
            fleet.superiors[*scout] = Some(chief as u32);
        }
    }
    fleet.situation(&mut draw, Reports::ALL)
}

fn platoons_of_squads(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[27; 3]);
    let platoons = draw.middles(3, 120.0);
    let turn = draw.angle();
    fleet.place(|team, _| {
        let squad = |squad: usize| {
            let angle = turn + TAU * squad as f64 / 3.0;
            let [x, y] = platoons[team];
            blob(&mut draw, [x + 25.0 * angle.cos(), y + 25.0 * angle.sin()], 5.0, 9)
        };
        (0..3).flat_map(squad).collect()
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    // The leader of the first squad leads the platoon as well.
    for members in &fleet.members {
        for (place, robot) in members.iter().enumerate().skip(1) {
            let above = if place % 9 == 0 { 0 } else { place / 9 * 9 };
            fleet.superiors[*robot] = Some(members[above] as u32);
        }
    }
    fleet.situation(&mut draw, Reports::ALL)
}

fn command_post(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut sizes = draw.counts(5, 10, 20);
    sizes.insert(0, 2);
    let mut fleet = Fleet::of(&sizes);
    let turn = draw.angle();
    fleet.place(|team, robots| {
        let angle = turn + TAU * team as f64 / 5.0;
        let (out_m, spread_m) = if team == 0 { (0.0, 2.0) } else { (40.0, 9.0) };
        blob(&mut draw, [out_m * angle.cos(), out_m * angle.sin()], spread_m, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.ranks_unknown(&mut draw, 0.25);
    fleet.situation(&mut draw, Reports::ALL)
}

fn lone_robots(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12, 12, 12, 12, 1, 1, 1], 45.0, 7.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn head_on_crowds(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[25; 2]);
    let passed_m = draw.within(-10.0, 10.0);
    fleet.place(|team, robots| {
        let middle = [passed_m * (team as f64 - 0.5), 0.0];
        blob(&mut draw, middle, 18.0, robots)
    });
    fleet.radio_nets(&mut draw, 0.25, 0.3);
    fleet.command(Command::Tree(4), Top::Nobody);
    fleet.ranks_unknown(&mut draw, 0.5);
    fleet.situation(&mut draw, Reports::ALL)
}

fn deep_trees(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[31; 4], 35.0, 14.0);
    fleet.command(Command::Tree(2), Top::First);
    fleet.positions_off(&mut draw, 10.0);
    fleet.situation(&mut draw, Reports::NO_LINKS)
}

fn some_at_the_origin(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[10; 6], 50.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.positions_at_origin(&mut draw, 0.2);
    fleet.positions_lost(&mut draw, 0.2);
    fleet.situation(&mut draw, Reports::ALL)
}

fn two_alone(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::few(&mut draw, &[1, 1]);
    fleet.radio_by_range(&mut draw, RANGE_M, 0.0);
    fleet.situation(&mut draw, Reports::NO_RANKS)
}

fn two_and_one(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::few(&mut draw, &[2, 1]);
    fleet.radio_by_range(&mut draw, RANGE_M, 0.0);
    fleet.command(Command::Star, Top::Nobody);
    fleet.situation(&mut draw, Reports::ALL)
}

fn three_and_two(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let fleet = Fleet::few(&mut draw, &[3, 2]);
    fleet.situation(&mut draw, Reports::POSITIONS)
}

fn three_pairs(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::few(&mut draw, &[2, 2, 2]);
    fleet.radio_by_range(&mut draw, RANGE_M, 0.0);
    fleet.situation(&mut draw, Reports::NO_RANKS)
}

fn a_large_field(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let sizes = draw.counts(10, 80, 200);
    let mut fleet = Fleet::blobs(&mut draw, &sizes, 120.0, 35.0);
    fleet.radio_by_range(&mut draw, RANGE_M, 0.3);
    fleet.command(Command::Tree(6), Top::First);
    fleet.ranks_unknown(&mut draw, 0.5);
    fleet.situation(&mut draw, Reports::ALL)
}
