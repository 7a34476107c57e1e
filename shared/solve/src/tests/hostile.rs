//! Texts that no user would write.

use serde_json::{Value, json};

use super::*;
use crate::file::Emit;
use crate::options::PathChoice;
use crate::output;

/// A small generator of its own (splitmix64): the cases are the same on every machine.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    pub(super) fn below(&mut self, bound: usize) -> usize {
        (self.roll() % bound.max(1) as u64) as usize
    }

    fn one_of<T: Clone>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())].clone()
    }

    /// A value such as might stand anywhere in a file.
    fn value(&mut self, depth: usize) -> Value {
        let numbers = [0.0, -0.0, 1.0, 0.5, -1.0, 1e-300, 1e-100, 1e99, 1e100, 1e308, 3.0, 1e6];
        let words = ["r0", "r1", "r2", "none", "unit", "auto", "katz", "", "R", "spectral", "m"];
        match self.below(if depth == 0 { 6 } else { 9 }) {
            0 => Value::Null,
            1 => json!(self.one_of(&[true, false])),
            2 => json!(self.one_of(&numbers)),
            3 => json!(self.roll() >> self.below(64)),
            4 => json!(self.below(6)),
            5 => json!(self.one_of(&words)),
            6 | 7 => (0..self.below(4)).map(|_| self.value(depth - 1)).collect(),
            _ => {
                let keys = ["fraction", "name", "weight", "matrix", "edges", "x", "y", "superior"];
                let entry =
                    |dice: &mut Self| (dice.one_of(&keys).to_owned(), dice.value(depth - 1));
                Value::Object((0..self.below(4)).map(|_| entry(self)).collect())
            }
        }
    }

    /// Some value inside of `value` becomes another one.
    fn spoil(&mut self, value: &mut Value) {
        let deeper = self.below(4) > 0;
        match value {
            Value::Array(items) if deeper && !items.is_empty() => {
                let at = self.below(items.len());
                self.spoil(&mut items[at]);
            }
            Value::Object(fields) if deeper && !fields.is_empty() => {
                let at = self.below(fields.len());
                if let Some(field) = fields.values_mut().nth(at) {
                    self.spoil(field);
                }
            }
            _ => *value = self.value(3),
        }
    }

    /// A file that might be right.
    fn file(&mut self) -> Value {
        let robots = 1 + self.below(6);
        let weight = |dice: &mut Self| {
            let wild = 10f64.powi(dice.below(200) as i32 - 100);
            dice.one_of(&[0.0, 0.0, 1.0, 0.3, 2.0, 1e-100, 1e100, wild])
        };
        let matrix: Vec<Vec<f64>> =
            (0..robots).map(|_| (0..robots).map(|_| weight(self)).collect()).collect();
        let edges: Vec<Value> = (0..robots)
            .map(|i| json!([format!("r{i}"), format!("r{}", self.below(robots)), weight(self)]))
            .collect();
        let mut file = json!({
            "robots": names(robots),
            "preset": self.one_of(&[json!(null), json!(null), json!("paper")]),
            "normalize": self.one_of(&["none", "spectral", "degree"]),
            "self_loops": self.one_of(&[json!(null), json!(0), json!(0.5), json!(4)]),
            "trusted": self.one_of(&[json!(null), json!([]), json!("all"), json!(["m"])]),
            "scale": self.one_of(&["none", "sqrt-sigma", "inverse-sqrt-sigma"]),
            "rows": self.one_of(&["none", "unit"]),
            "alpha": self.one_of(&[json!(0.2), json!({"fraction": 0.5}), json!({"fraction": 1e-9}),
                                   json!({"fraction": 0.999_999}), json!(1e-90), json!(1e90)]),
            "dimension": self.one_of(&[json!("auto"), json!(2), json!(2 * robots)]),
            "init": self.one_of(&["kmeans++", "random"]),
            "restarts": 3, "seed": self.roll(), "emit": ["katz", "embedding", "diagnostics"],
        });
        let more = match self.below(3) {
            0 => json!({"modalities": [{"name": "m", "weight": 0.25, "matrix": matrix},
                                       {"name": "e", "weight": 0.75, "edges": edges}]}),
            1 => json!({"modalities": [{"name": "m", "matrix": matrix}]}),
            _ => json!({
                "poses": {"r0": {"x": weight(self), "y": 1e-30}},
                "links": {"r0": [{"peer": "r1", "quality": weight(self)}]},
                "ranks": {"r0": {"superior": "r1", "weight": weight(self)}},
                "spatial": {"radius_m": 3.0, "all_pairs_up_to": self.below(4)},
            }),
        };
        file = with(file, more);
        if self.below(4) == 0 {
            with(file, json!({"labels": (0..robots).map(|_| self.below(3)).collect::<Vec<_>>()}))
        } else {
            with(file, json!({"teams": 1 + self.below(robots)}))
        }
    }
}

/// Every text is either solved, with finite numbers, or refused with a message.
fn never_panics(text: &[u8]) -> bool {
    // Half of the texts by each path, of which one does not form the similarity.
    let path =
        if text.len().is_multiple_of(2) { PathChoice::Dense } else { PathChoice::InverseFree };
    let options = Options { normalize_weights: true, path, ..Options::default() };
    let solved = parse(text, options).and_then(|mut problem| {
        if path == PathChoice::InverseFree {
            problem.emit.remove(&Emit::Katz);
        }
        let path = path_of(&problem, path)?;
        let solution = method::solve(&problem, path, &mut |_| {})?;
        Ok((problem, solution))
    });
    match solved {
        Ok((problem, solution)) => {
            let decomposition = &solution.decomposition;
            let numbers = solution.embedding.data().iter().chain(&decomposition.svd.sigma);
            let (inertia, gap) = (solution.divided.inertia, decomposition.svd.gap());
            let found = [
                solution.radius.value,
                solution.alpha,
                inertia,
                gap,
                solution.decomposition.residual,
            ];
            assert!((0.0..=1.0).contains(&solution.angle_bound()));
            assert!(numbers.chain(&found).all(|number| number.is_finite()));
            assert!(!output::summary(&problem, &solution).is_empty());
            let json = output::to_json(&problem, &solution).unwrap();
            let read: Value = serde_json::from_str(&json).unwrap();
            let silhouettes = read["silhouette"]["per_robot"].as_array().unwrap();
            assert!(silhouettes.iter().all(Value::is_number), "{json}");
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

/// How many texts of each kind are tried; more by the environment, for a long run by hand.
fn cases() -> usize {
    let wanted = std::env::var("MUSTER_SOLVE_CASES").ok();
    wanted.and_then(|count| count.parse().ok()).unwrap_or(1500)
}

#[test]
fn files_of_any_numbers_are_solved_or_refused() {
    let mut dice = Dice(1);
    let mut solved = 0;
    for _ in 0..cases() {
        solved += usize::from(never_panics(dice.file().to_string().as_bytes()));
    }
    assert!(solved > cases() / 10, "only {solved} of {} were any use", cases());
}

#[test]
fn spoiled_files_are_solved_or_refused() {
    let mut dice = Dice(2);
    for _ in 0..cases() {
        let mut file = dice.file();
        for _ in 0..=dice.below(2) {
            dice.spoil(&mut file);
        }
        never_panics(file.to_string().as_bytes());
        never_panics(dice.value(5).to_string().as_bytes());
    }
}

#[test]
fn spoiled_texts_are_solved_or_refused() {
    let mut dice = Dice(3);
    for _ in 0..cases() {
        let mut text = dice.file().to_string().into_bytes();
        for _ in 0..=dice.below(3) {
            let at = dice.below(text.len());
            match dice.below(4) {
                0 => text.truncate(at),
                1 => text[at..].rotate_left(1),
                2 => {
                    let words: [&[u8]; 5] = [b"NaN", b"[[[[", b"-Infinity", b"1e999", b"\xff\n"];
                    text.splice(at..at, dice.one_of(&words).iter().copied()).for_each(drop);
                }
                _ => text[at] = dice.roll() as u8,
            }
            text.push(b'}');
        }
        never_panics(&text);
    }
}
