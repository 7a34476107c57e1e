//! Files of `muster solve`.

use muster_solve::{Options, PathChoice, Preset, SilhouetteChoice, Solved};
use serde_json::Value;

use crate::{Outcome, allocation, text};

/// Longest error in characters: a field and a problem.
const MAX_ERROR: usize = 1700;

/// Larger fleets take longer than an input may; the mathematics has tests of its own.
const MAX_ROBOTS: usize = 24;

/// More starts of k-means do.
const MAX_RESTARTS: u64 = 64;

/// Bytes that the method may hold: a dozen dense matrices of [`MAX_ROBOTS`], working space, and the
/// table.
const MAX_BYTES_HELD: usize = 8 << 20;

/// How far a silhouette may be outside of -1 to 1, by rounding.
const ROUNDING: f64 = 1e-12;

/// The options, in one byte, and the text of a file.
pub(crate) fn solve(data: &[u8]) -> Outcome {
    let Some((choices, text)) = data.split_first() else { return Outcome::Refused };
    let options = options(*choices);
    if let Ok(file) = serde_json::from_slice::<Value>(text) {
        let robots = file.get("robots").and_then(Value::as_array).map_or(0, Vec::len);
        let restarts = file.get("restarts").and_then(Value::as_u64).unwrap_or_default();
        if robots > MAX_ROBOTS || restarts > MAX_RESTARTS {
            return Outcome::Refused;
        }
    }
    let solved = allocation::at_most(MAX_BYTES_HELD, "solving", || Solved::new(text, options));
    match solved {
        Err(error) => {
            text::check(&error.to_string(), MAX_ERROR);
            Outcome::Refused
        }
        Ok(solved) => {
            assert!(!solved.summary().is_empty());
            let json: Value = serde_json::from_str(&solved.to_json().unwrap()).unwrap();
            check(&json);
            Outcome::Accepted
        }
    }
}

/// One bit for the weights, two for each way, and one for the preset.
fn options(choices: u8) -> Options {
    let path = match choices >> 1 & 3 {
        0 => PathChoice::Dense,
        1 => PathChoice::InverseFree,
        _ => PathChoice::Auto,
    };
    let silhouette = match choices >> 3 & 3 {
        0 => SilhouetteChoice::Exact,
        1 => SilhouetteChoice::Squared,
        2 => SilhouetteChoice::Sampled,
        _ => SilhouetteChoice::Auto,
    };
    let preset = (choices >> 5 & 1 == 1).then_some(Preset::Paper);
    let normalize_weights = choices & 1 == 1;
    Options { normalize_weights, path, silhouette, preset, ..Options::default() }
}

/// Checks that everything is a finite number and all rows are there.
fn check(json: &Value) {
    let robots = json["robots"].as_array().unwrap().len();
    assert_eq!(json["labels"].as_array().unwrap().len(), robots);
    assert_eq!(json["teams"].as_object().unwrap().len(), robots);
    for name in ["rho", "alpha", "inertia"] {
        assert!(json[name].as_f64().is_some_and(|number| number >= 0.0), "{name} {}", json[name]);
    }
    for modality in json["modalities"].as_array().unwrap() {
        for name in ["weight", "trust"] {
            let share = modality[name].as_f64().unwrap();
            assert!((-ROUNDING..=1.0 + ROUNDING).contains(&share), "{name} {share}");
        }
    }
    for value in json["singular_values"].as_array().unwrap() {
        assert!(value.as_f64().is_some_and(|value| value >= 0.0), "{value}");
    }
    for name in ["katz", "embedding"] {
        for row in json.get(name).and_then(Value::as_array).into_iter().flatten() {
            assert!(row.as_array().unwrap().iter().all(Value::is_number), "{name} {row}");
        }
    }
    let silhouette = &json["silhouette"];
    let all = silhouette["per_robot"].as_array().unwrap().iter();
    // Within limits robots without a team have none.
    let is_limited = json.get("optimal").is_some();
    for value in all.chain(silhouette["per_team"].as_array().unwrap()) {
        assert!(
            is_limited && value.is_null()
                || value.as_f64().is_some_and(|value| value.abs() <= 1.0 + ROUNDING),
            "{value}"
        );
    }
}
