//! Seeded mutations of inputs, for the test command: no guidance by coverage, but the same inputs on
//! every machine.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Pieces that the readers know.
const WORDS: [&[u8]; 40] = [
    b"null",
    b"true",
    b"-1",
    b"0",
    b"1e308",
    b"1e-320",
    b"NaN",
    b"18446744073709551615",
    b"0.5",
    b"{}",
    b"[]",
    b"\"\"",
    b"\"auto\"",
    b"{\"fraction\":0.5}",
    b"\"x\":",
    b"\"teams\":",
    b"\"seed\":",
    b"\"weights\":",
    b"\"spatial\":",
    b"\"stamp\":",
    b"\"seq\":",
    b"\"boot\":",
    b"\\u0000",
    b"\n",
    b"~/",
    b"robot/r1/",
    b"pose",
    b"service/ingest/",
    b"graph/",
    b"json/",
    b"**",
    b"$*",
    b"*",
    b"/",
    b"format=json",
    b"\xFB\xFF\xFF",
    b"\xFC\xFF\xFF\xFF\x7F",
    b"\xFD\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF",
    b"\0\0\0\0\0\0\xF8\x7F",
    b"\0\0\0\0\0\0\xF0\x7F",
];

/// A stream of mutated inputs.
#[derive(Debug)]
pub struct Mutator {
    random: ChaCha8Rng,
}

impl Mutator {
    /// The stream of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// One of the inputs, changed in a few places, perhaps with a piece of another one.
    ///
    /// # Panics
    /// If there are no inputs.
    pub fn next(&mut self, inputs: &[Vec<u8>], longest: usize) -> Vec<u8> {
        let mut bytes = inputs[self.random.random_range(0..inputs.len())].clone();
        for _ in 0..1 << self.random.random_range(0..4) {
            self.change(&mut bytes, inputs);
        }
        bytes.truncate(longest);
        bytes
    }

    fn change(&mut self, bytes: &mut Vec<u8>, inputs: &[Vec<u8>]) {
        let random = &mut self.random;
        let at = random.random_range(0..=bytes.len());
        match random.random_range(0..7) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
            1 if at < bytes.len() => bytes[at] = random.random(),
            2 => {
                let end = bytes.len().min(at + random.random_range(0..16));
                bytes.drain(at..end);
            }
            3 => {
                let word = WORDS[random.random_range(0..WORDS.len())];
                bytes.splice(at..at, word.iter().copied());
            }
            4 => {
                let word = WORDS[random.random_range(0..WORDS.len())];
                let end = bytes.len().min(at + word.len());
                bytes.splice(at..end, word.iter().copied());
            }
            5 => {
                let other = &inputs[random.random_range(0..inputs.len())];
                let from = random.random_range(0..=other.len());
                let end = other.len().min(from + random.random_range(0..64));
                bytes.splice(at..at, other[from..end].iter().copied());
            }
            _ => {
                let mut noise = vec![0; random.random_range(0..8)];
                random.fill_bytes(&mut noise);
                bytes.splice(at..at, noise);
            }
        }
    }
}
