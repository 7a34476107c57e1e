//! Moments as people write and read them, in UTC.

use std::time::Duration;

use muster_model::time::{Tick, seconds};

const DAY_S: u64 = 24 * 60 * 60;

/// Seconds from which on a number is one of seconds since 1970: whoever writes fewer digits means something else.
const MIN_EPOCH_S: f64 = 1e8;

/// Seconds since 1970 that are still a moment: the year 2255.
const MAX_EPOCH_S: f64 = 9e9;

/// The forms that are read, for errors.
const FORMS: &str =
    "must be like 2026-11-23T04:05:06Z, 04:05 (UTC), 90s, 10m, 2h, 3d, or seconds since 1970";

/// Days from 1970 to a date of the Gregorian calendar.
fn days(year: i64, month: i64, day: i64) -> i64 {
    // Years begin in March, so that a leap day is the last of its year.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let era = year.div_euclid(400);
    let of_era = year.rem_euclid(400);
    let of_year = (153 * month + 2) / 5 + day - 1;
    era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

/// The date of a day since 1970: year, month, day.
fn date(days: i64) -> [i64; 3] {
    let days = days + 719_468;
    let (era, of_era) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    [era * 400 + year + next, month, day]
}

/// A moment as text, to the second.
pub(super) fn shown(at: Tick) -> String {
    let seconds = at.0 / 1_000_000;
    let [year, month, day] = date(i64::try_from(seconds / DAY_S).unwrap_or(0));
    let (hour, minute, second) = (seconds % DAY_S / 3600, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}")
}

/// A moment as programs read it, to the microsecond.
pub(super) fn exact(at: Tick) -> String {
    format!("{}.{:06}Z", shown(at).replace(' ', "T"), at.0 % 1_000_000)
}

/// Reads a moment.
///
/// # Errors
/// Names the forms that are read.
pub(super) fn parse(text: &str, now: Tick) -> Result<Tick, String> {
    let read = ago(text, now).or_else(|| clock(text, now)).or_else(|| whole(text));
    read.or_else(|| since_1970(text)).ok_or_else(|| format!("{text:?} {FORMS}"))
}

/// `10m` and the like: so long ago.
fn ago(text: &str, now: Tick) -> Option<Tick> {
    let unit = text.chars().last()?;
    let each = match unit {
        's' => 1.0,
        'm' => 60.0,
        'h' => 3600.0,
        'd' => 86_400.0,
        _ => return None,
    };
    let count: f64 = text.strip_suffix(unit)?.parse().ok()?;
    (count.is_finite() && count >= 0.0).then(|| now.before(seconds(count * each)))
}

/// `04:05` or `04:05:06`: the last time that the clock showed that.
fn clock(text: &str, now: Tick) -> Option<Tick> {
    let of_day = of_day(text)?;
    let today = now.0 / 1_000_000 / DAY_S * DAY_S;
    let at = Tick(today.checked_mul(1_000_000)?).after(Duration::from_secs_f64(of_day));
    Some(if at > now { at.before(Duration::from_secs(DAY_S)) } else { at })
}

/// Seconds since midnight.
fn of_day(text: &str) -> Option<f64> {
    let parts: Vec<&str> = text.split(':').collect();
    let (hour, minute, second) = match parts.as_slice() {
        [hour, minute] => (*hour, *minute, "0"),
        [hour, minute, second] => (*hour, *minute, *second),
        _ => return None,
    };
    let is_plain = |text: &str| text.chars().all(|c| c.is_ascii_digit() || c == '.');
    let (hour, minute): (u32, u32) = (hour.parse().ok()?, minute.parse().ok()?);
    let second: f64 = Some(second).filter(|text| is_plain(text))?.parse().ok()?;
    let fits = hour < 24 && minute < 60 && second < 60.0;
    fits.then(|| f64::from(hour) * 3600.0 + f64::from(minute) * 60.0 + second)
}

/// `2026-11-23T04:05:06Z`; a space instead of T, and no Z, are UTC as well.
fn whole(text: &str) -> Option<Tick> {
    let (date_text, time) = text.split_once(['T', ' '])?;
    let time = time.strip_suffix('Z').unwrap_or(time);
    let parts: Vec<i64> =
        date_text.split('-').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let [year, month, day] = parts.as_slice() else { return None };
    // No other one can be computed with.
    let is_date = (1970..2255).contains(year) && (1..=12).contains(month) && (1..=31).contains(day);
    let day = is_date.then(|| days(*year, *month, *day))?;
    // A date that does not exist is another one.
    let exists = [*year, *month, parts[2]] == date(day);
    let at = Duration::from_secs_f64(of_day(time)?);
    let start = u64::try_from(day).ok().filter(|_| exists)? * DAY_S * 1_000_000;
    Some(Tick(start).after(at))
}

fn since_1970(text: &str) -> Option<Tick> {
    let value: f64 = text.parse().ok()?;
    let fits = (MIN_EPOCH_S..MAX_EPOCH_S).contains(&value);
    fits.then(|| Tick(0).after(seconds(value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-11-20 21:09:50 UTC.
    const NOW: Tick = Tick(1_795_208_990_500_000);

    #[test]
    fn moments_are_shown_and_read_back() {
        assert_eq!(shown(NOW), "2026-11-20 21:09:50");
        assert_eq!(exact(NOW), "2026-11-20T21:09:50.500000Z");
        assert_eq!(parse(&exact(NOW), NOW), Ok(NOW));
        for at in [0, 951_782_400, 951_868_799, 951_868_800, 1_709_164_800, 4_107_542_399] {
            let at = Tick(at * 1_000_000);
            assert_eq!(parse(&shown(at), NOW), Ok(at), "{}", shown(at));
        }
        assert_eq!(shown(Tick(951_782_400_000_000)), "2000-02-29 00:00:00");
    }

    #[test]
    fn every_form_is_read() {
        let whole = |seconds: u64| Ok(Tick(seconds * 1_000_000));
        for (text, wanted) in [
            ("90s", Ok(Tick(NOW.0 - 90_000_000))),
            ("10m", Ok(Tick(NOW.0 - 600_000_000))),
            ("0.5h", Ok(Tick(NOW.0 - 1_800_000_000))),
            ("1d", Ok(Tick(NOW.0 - 86_400_000_000))),
            ("21:09", whole(1_795_208_940)),
            ("21:09:30", whole(1_795_208_970)),
            ("21:10", whole(1_795_209_000 - 86_400)),
            ("2026-11-20T21:09:50Z", whole(1_795_208_990)),
            ("2026-11-20 21:09:50", whole(1_795_208_990)),
            ("1795208990.5", Ok(NOW)),
        ] {
            assert_eq!(parse(text, NOW), wanted, "{text}");
        }
    }

    #[test]
    fn what_is_no_moment_is_refused_with_the_forms() {
        for text in [
            "",
            "yesterday",
            "5",
            "-1s",
            "nans",
            "24:00",
            "1:2:3:4",
            "2026-02-30T00:00:00Z",
            "2026-13-01T00:00:00Z",
            "99999999999999999-01-01T00:00:00Z",
            "2026-9999999999999999-01T00:00:00Z",
            "1e30",
            "2026-11-20",
            "12:00:-1",
            "inf",
        ] {
            assert!(parse(text, NOW).unwrap_err().contains("10m"), "{text}");
        }
    }
}
