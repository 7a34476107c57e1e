//! How terms follow the clock, and from where on a term is not believed.
//!
//! A term begins at the seconds since 1970, if nothing higher is known. So a service that has lost its
//! stored state begins above what it published before, without a message of anybody. Clocks may be
//! wrong: a term from a clock is a beginning, not a proof, and the order of leaders rests on what is
//! stored and received.

use crate::time::Tick;

/// The earliest moment that a right clock shows, in seconds since 1970: the first of January 2026. A
/// machine without a clock of its own shows 1970 or the day its software was built.
const EARLIEST_S: u64 = 1_767_225_600;

/// How far a believed term may be above the clock, in seconds: 68 years. A host whose clock is decades
/// behind still believes one whose clock is right or decades ahead.
const ROOM_S: u64 = 1 << 31;

/// How much of a clock counts that cannot be right, in seconds: two years. The bound then still rises
/// by one each second, so that a leader that had to begin right above it is believed soon.
const WRONG_CLOCK_SPAN_S: u64 = 1 << 26;

/// The latest moment that a clock is believed to show, in seconds since 1970, in the year 2094. From a
/// later one no term begins: hosts with an unset clock would not believe it.
const LATEST_S: u64 = EARLIEST_S + ROOM_S;

fn seconds(now: Tick) -> u64 {
    now.0 / 1_000_000
}

fn may_be_right(seconds: u64) -> bool {
    (EARLIEST_S..=LATEST_S).contains(&seconds)
}

/// The lowest term that may begin now, if nothing higher is known: the seconds since 1970. It is zero
/// while the clock shows a moment that cannot be right; terms are then counted from what is known.
#[must_use]
pub fn clock_term(now: Tick) -> u64 {
    let now = seconds(now);
    if may_be_right(now) { now } else { 0 }
}

/// The highest term that is believed now. A higher one was forged, or is of a damaged file: terms begin
/// at the seconds since 1970 and grow with each leader by one.
///
/// The bound rises by one each second by any clock. So a leader that begins a term above a forged one at
/// the bound is believed a second later, by hosts with the same clock.
#[must_use]
pub fn highest_term(now: Tick) -> u64 {
    let now = seconds(now);
    let clock = if may_be_right(now) { now } else { EARLIEST_S + now % WRONG_CLOCK_SPAN_S };
    clock + ROOM_S
}

/// The moment by which a change is dated that was sent at a moment: that one, or in 2094 the latest that hosts with an unset clock
/// believe.
#[must_use]
pub fn date_of(sent: Tick) -> Tick {
    sent.min(Tick(LATEST_S * 1_000_000))
}

/// The latest date of a change that is believed now: a later one was forged. It is the moment of the highest believed term, so
/// that it rises with every clock, and a change after a forged one at the bound is believed a moment later.
#[must_use]
pub fn latest_date(now: Tick) -> Tick {
    Tick(highest_term(now).saturating_mul(1_000_000))
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    #[test]
    fn a_term_begins_at_the_seconds_of_the_clock() {
        assert_eq!(clock_term(Tick(1_795_000_000 * S + 7)), 1_795_000_000);
        assert_eq!(clock_term(Tick(EARLIEST_S * S)), EARLIEST_S);
        assert_eq!(clock_term(Tick(LATEST_S * S)), LATEST_S);
        // A clock that was never set.
        assert_eq!(clock_term(Tick(40 * S)), 0);
        assert_eq!(clock_term(Tick(EARLIEST_S * S - 1)), 0);
        assert_eq!(clock_term(Tick((LATEST_S + 1) * S)), 0);
        assert_eq!(clock_term(Tick(u64::MAX)), 0);
    }

    #[test]
    fn every_clock_believes_the_terms_of_every_other() {
        let clocks = [0, 40, EARLIEST_S - 1, EARLIEST_S, 1_795_000_000, LATEST_S, 1 << 40];
        for own in clocks {
            for other in clocks {
                let term = clock_term(Tick(other * S));
                assert!(term <= highest_term(Tick(own * S)), "{own} {other}");
            }
        }
    }

    #[test]
    fn every_clock_believes_dates_by_every_other() {
        let clocks = [0, 40, EARLIEST_S - 1, EARLIEST_S, 1_795_000_000, LATEST_S, 1 << 32, 1 << 40];
        for own in clocks {
            for other in clocks {
                assert!(date_of(Tick(other * S)) <= latest_date(Tick(own * S)), "{own} {other}");
            }
        }
    }

    #[test]
    fn the_bound_rises_with_every_clock_and_stays_far_below_overflow() {
        for clock in [0, 40, 1_795_000_000, LATEST_S - 1, LATEST_S + 7, u64::MAX / S - 1] {
            let (now, next) = (highest_term(Tick(clock * S)), highest_term(Tick((clock + 1) * S)));
            assert_eq!(next, now + 1, "{clock}");
            assert!(next < crate::limits::MAX_REVISION / 2);
        }
    }
}
