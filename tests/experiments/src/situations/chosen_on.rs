//! Kinds that are looked at while defaults are chosen.

use std::f64::consts::{PI, TAU};

use super::draw::Draw;
use super::fleet::{Command, Fleet, Reports, Top};
use super::kinds::{Kind, Source};
use super::shapes::{arc, blob, column};
use super::situation::Situation;
use crate::formations::Radio;

/// Range of a hand-held radio in metres.
const RANGE_M: f64 = 60.0;

/// Share of links that are lost where nothing is wrong.
const USUAL_LOSS: f64 = 0.1;

const fn kind(name: &'static str, description: &'static str, draw: fn(u64) -> Situation) -> Kind {
    Kind { name, description, source: Source::Drawn(draw), large: false }
}

/// The kinds.
pub(super) static CHOSEN_ON: [Kind; 26] = [
    kind(
        "round teams",
        "Five round teams of 12 robots, 80 m apart, with radio by range and a leader each, who \
         answer to the first.",
        round_teams,
    ),
    kind(
        "overlapping teams",
        "Six teams of 10 robots whose areas overlap, with radio by range, which hears all of \
         them, and trees of command.",
        overlapping_teams,
    ),
    kind(
        "parallel columns",
        "Four teams drive in columns of 12 robots side by side, 15 m apart and 10 m from robot to \
         robot.",
        parallel_columns,
    ),
    kind(
        "one to ten",
        "Four teams of 5, 10, 25 and 50 robots, each as dense as the others.",
        one_to_ten,
    ),
    kind(
        "dense beside wide",
        "Three teams of 20 robots on 3, 8 and 20 m, one beside the other; no ranks.",
        dense_beside_wide,
    ),
    kind(
        "crescents",
        "Two crescents of 40 robots, one within the arm of the other; positions only.",
        crescents,
    ),
    kind(
        "radio nets only",
        "Six teams of 15 robots, each with a net of its own that overhears others; links only.",
        radio_nets_only,
    ),
    kind(
        "trees only",
        "Five teams of 13 robots with trees of command whose leaders answer to the first; ranks \
         only.",
        trees_only,
    ),
    kind(
        "neighbours, no ranks",
        "Eight teams of 12 robots, 45 m apart, with radio by range; no ranks.",
        neighbours_without_ranks,
    ),
    kind(
        "indoors",
        "Six teams of 10 robots in overlapping areas without positions: radio by range, of which \
         a third is lost, and ranks.",
        indoors,
    ),
    kind(
        "places and orders",
        "Seven teams of 8 to 14 robots in overlapping areas, with trees of command; no links.",
        places_and_orders,
    ),
    kind(
        "half of the ranks",
        "Six teams of 12 robots, 40 m apart, of whom half do not report whom they answer to.",
        half_of_the_ranks,
    ),
    kind(
        "positions at random",
        "Five teams of 12 robots, every one of which reports a random position within the area of \
         the fleet.",
        positions_at_random,
    ),
    kind(
        "ranks of others",
        "Five teams of 12 robots, 60 m apart, every one of which reports the rank of another \
         robot.",
        ranks_of_others,
    ),
    kind(
        "command by kind",
        "Four teams of 12 robots of four kinds: all scouts answer to one scout, all carriers to \
         one carrier, and so on.",
        command_by_kind,
    ),
    kind(
        "headquarters",
        "A headquarters of 3 robots beside four platoons of 16, whose leaders all answer to it.",
        headquarters,
    ),
    kind(
        "crossing columns",
        "Three columns of 14 robots march through each other, so that positions mislead; each has \
         a radio net and squads.",
        crossing_columns,
    ),
    kind(
        "noisy positions",
        "Six teams of 12 robots, 50 m apart, whose positions are off by 15 m; radio by range and \
         ranks.",
        noisy_positions,
    ),
    kind(
        "squads as teams",
        "Nine squads of 8 robots in three platoons, whose leaders command the squads; each squad \
         is a team.",
        squads_as_teams,
    ),
    kind(
        "twelve pairs",
        "Twelve pairs of robots, 4 m from each other and 25 m from the next pair, one of each \
         leading the other.",
        twelve_pairs,
    ),
    kind(
        "drones in layers",
        "Three layers of 20 drones at 20, 50 and 80 m over the same ground, with radio by range; \
         no ranks.",
        drones_in_layers,
    ),
    kind("two and two", "Four robots in two pairs, 30 m apart; positions only.", two_and_two),
    kind(
        "three and three",
        "Six robots in two groups, 30 m apart, with radio by range and a leader each.",
        three_and_three,
    ),
    Kind {
        large: true,
        ..kind(
            "a large fleet",
            "Fourteen teams of 50 to 230 robots, 2,000 in all, in areas that touch, with radio by \
             range and trees of command.",
            a_large_fleet,
        )
    },
    Kind {
        name: "squads on the march",
        description: "Squads of the paper's formations on the march, with radio by range; their \
                      leader is in a team of its own in every other one.",
        source: Source::Formations { platoons: false, radio: Radio::Range },
        large: false,
    },
    Kind {
        name: "platoons on the march",
        description: "Platoons of the paper's formations on the march, with radio nets, in three \
                      to five teams.",
        source: Source::Formations { platoons: true, radio: Radio::Net },
        large: false,
    },
];

fn round_teams(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 5], 80.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn overlapping_teams(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[10; 6], 25.0, 10.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Tree(3), Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn parallel_columns(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[12; 4]);
    let angle = draw.angle();
    fleet.place(|team, robots| {
        let side = 15.0 * team as f64;
        let along = draw.within(-10.0, 10.0);
        let (sin, cos) = angle.sin_cos();
        let start = [along * cos - side * sin, along * sin + side * cos];
        column(&mut draw, (start, angle), 10.0, 1.5, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn one_to_ten(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[50, 25, 10, 5]);
    let middles = draw.middles(4, 70.0);
    fleet
        .place(|team, robots| blob(&mut draw, middles[team], 2.5 * (robots as f64).sqrt(), robots));
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn dense_beside_wide(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[20; 3]);
    let (spreads, east) = ([3.0, 8.0, 20.0], [0.0, 28.0, 90.0]);
    fleet.place(|team, robots| {
        let middle = [east[team], draw.within(-5.0, 5.0)];
        blob(&mut draw, middle, spreads[team], robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.situation(&mut draw, Reports::NO_RANKS)
}

fn crescents(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[40; 2]);
    let angle = draw.angle();
    let (sin, cos) = angle.sin_cos();
    fleet.place(|team, robots| {
        let side = team as f64;
        // The middle of the second is on the rim of the first, and a little beside it.
        let middle = [40.0 * side * cos + 15.0 * side * sin, 40.0 * side * sin - 15.0 * side * cos];
        arc(&mut draw, (middle, 40.0), (angle + PI * side, PI), 2.5, robots)
    });
    fleet.situation(&mut draw, Reports::POSITIONS)
}

fn radio_nets_only(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[15; 6]);
    fleet.radio_nets(&mut draw, 0.3, 0.2);
    fleet.situation(&mut draw, Reports::LINKS)
}

fn trees_only(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let sizes = draw.counts(5, 11, 15);
    let mut fleet = Fleet::of(&sizes);
    fleet.command(Command::Tree(3), Top::First);
    fleet.situation(&mut draw, Reports::RANKS)
}

fn neighbours_without_ranks(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 8], 45.0, 8.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.situation(&mut draw, Reports::NO_RANKS)
}

fn indoors(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[10; 6], 30.0, 10.0);
    fleet.radio_by_range(&mut draw, RANGE_M, 0.33);
    fleet.command(Command::Tree(4), Top::First);
    fleet.situation(&mut draw, Reports::NO_POSITIONS)
}

fn places_and_orders(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let sizes = draw.counts(7, 8, 14);
    let mut fleet = Fleet::blobs(&mut draw, &sizes, 28.0, 10.0);
    fleet.command(Command::Tree(3), Top::First);
    fleet.situation(&mut draw, Reports::NO_LINKS)
}

fn half_of_the_ranks(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 6], 40.0, 10.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.ranks_unknown(&mut draw, 0.5);
    fleet.situation(&mut draw, Reports::ALL)
}

fn positions_at_random(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 5], 60.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.positions_at_random(&mut draw);
    fleet.situation(&mut draw, Reports::ALL)
}

fn ranks_of_others(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 5], 60.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.ranks_of_others(&mut draw);
    fleet.situation(&mut draw, Reports::ALL)
}

fn command_by_kind(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 4], 50.0, 9.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    // In each team robots 0 to 2 are scouts, 3 to 5 carriers, and so on. The chief of each kind is in another team.
    for kind in 0..4 {
        let chief = fleet.members[kind][3 * kind];
        for members in &fleet.members {
            for robot in members[3 * kind..3 * kind + 3].iter().filter(|robot| **robot != chief) {
                fleet.superiors[*robot] = Some(chief as u32);
            }
        }
    }
    fleet.situation(&mut draw, Reports::ALL)
}

fn headquarters(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[3, 16, 16, 16, 16]);
    let turn = draw.angle();
    fleet.place(|team, robots| {
        let angle = turn + TAU * team as f64 / 4.0;
        let out_m = if team == 0 { 0.0 } else { 55.0 };
        let spread_m = if team == 0 { 3.0 } else { 10.0 };
        blob(&mut draw, [out_m * angle.cos(), out_m * angle.sin()], spread_m, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Tree(5), Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn crossing_columns(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[14; 3]);
    let turn = draw.angle();
    fleet.place(|team, robots| {
        let angle = turn + TAU * team as f64 / 3.0;
        // Half of each column is past the point in which all of them cross.
        let back = -8.0 * draw.within(5.5, 7.5);
        let start = [back * angle.cos(), back * angle.sin()];
        column(&mut draw, (start, angle), 8.0, 2.0, robots)
    });
    fleet.radio_nets(&mut draw, 0.2, 0.2);
    fleet.command(Command::Tree(3), Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn noisy_positions(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::blobs(&mut draw, &[12; 6], 50.0, 8.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::First);
    fleet.positions_off(&mut draw, 15.0);
    fleet.situation(&mut draw, Reports::ALL)
}

fn squads_as_teams(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[8; 9]);
    let platoons = draw.middles(3, 110.0);
    let turn = draw.angle();
    fleet.place(|team, robots| {
        let angle = turn + TAU * (team % 3) as f64 / 3.0;
        let [x, y] = platoons[team / 3];
        blob(&mut draw, [x + 20.0 * angle.cos(), y + 20.0 * angle.sin()], 6.0, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::Nobody);
    let leaders = fleet.leaders();
    for (squad, leader) in leaders.iter().enumerate().filter(|(squad, _)| squad % 3 > 0) {
        fleet.superiors[*leader] = Some(leaders[squad / 3 * 3] as u32);
    }
    fleet.situation(&mut draw, Reports::ALL)
}

fn twelve_pairs(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[2; 12]);
    let middles = draw.middles(12, 25.0);
    fleet.place(|team, robots| {
        let angle = draw.angle();
        column(&mut draw, (middles[team], angle), 4.0, 0.3, robots)
    });
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Star, Top::Nobody);
    fleet.situation(&mut draw, Reports::ALL)
}

fn drones_in_layers(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::of(&[20; 3]);
    fleet.place(|_, robots| {
        (0..robots).map(|_| [draw.within(0.0, 60.0), draw.within(0.0, 60.0)]).collect()
    });
    fleet.raise(&mut draw, &[20.0, 50.0, 80.0], 2.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.situation(&mut draw, Reports::NO_RANKS)
}

fn two_and_two(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let fleet = Fleet::few(&mut draw, &[2, 2]);
    fleet.situation(&mut draw, Reports::POSITIONS)
}

fn three_and_three(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut fleet = Fleet::few(&mut draw, &[3, 3]);
    fleet.radio_by_range(&mut draw, RANGE_M, 0.0);
    fleet.command(Command::Star, Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}

fn a_large_fleet(seed: u64) -> Situation {
    let mut draw = Draw::new(seed);
    let mut sizes = draw.counts(14, 50, 230);
    // So that there are 2,000: what is missing or too much is shared out.
    while sizes.iter().sum::<usize>() != 2000 {
        let team = draw.index(14);
        if sizes.iter().sum::<usize>() > 2000 {
            sizes[team] = (sizes[team] - 1).max(50);
        } else {
            sizes[team] = (sizes[team] + 1).min(230);
        }
    }
    let mut fleet = Fleet::blobs(&mut draw, &sizes, 140.0, 40.0);
    fleet.radio_by_range(&mut draw, RANGE_M, USUAL_LOSS);
    fleet.command(Command::Tree(8), Top::First);
    fleet.situation(&mut draw, Reports::ALL)
}
