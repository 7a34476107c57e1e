//! What this machine can do at most: bytes and operations per second on one thread, how much more two
//! threads do, and how long one waits for the other.

use std::hint::black_box;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::{Duration, Instant};

use faer::linalg::matmul::matmul;
use faer::traits::ComplexField;
use faer::{Accum, Mat, Par};
use pulp::Arch;

use crate::clock::timed;

/// Each limit is the best of so many tries: nothing but other work on the machine makes one slower.
const ATTEMPTS: usize = 9;

/// Bytes that one try moves at least.
const MOVED: usize = 1 << 30;

/// How often work is handed over, and how long the other thread has slept before.
const HANDOVERS: usize = 101;
const SLEEP_TIME: Duration = Duration::from_millis(1);

/// Side of the matrices that are multiplied.
const SIDE: usize = 1024;

/// Numbers whose roots are taken, twice 8 KiB, and how often in one try.
const ROOTS: usize = 1024;
const ROOT_PASSES: usize = 1 << 17;

/// Bytes per second of a = b + s c over three arrays of `bytes` together, counting each array once.
pub(crate) fn triad(bytes: usize) -> f64 {
    let n = bytes / (3 * size_of::<f64>());
    let (mut a, b, c) = (vec![0.0_f64; n], vec![1.0_f64; n], vec![2.0_f64; n]);
    let moved = 3 * n * size_of::<f64>();
    let passes = (MOVED / moved).max(1);
    best(|| {
        for _ in 0..passes {
            let s = black_box(3.0);
            Arch::new().dispatch(|| {
                for ((a, b), c) in a.iter_mut().zip(&b).zip(&c) {
                    *a = b + s * c;
                }
            });
            black_box(&a);
        }
    })
    .recip()
        * (passes * moved) as f64
}

/// Operations per second of a product of two dense matrices in double precision.
pub(crate) fn gemm() -> f64 {
    product_rate(|value| value)
}

/// The same in single precision.
pub(crate) fn single_gemm() -> f64 {
    product_rate(|value| value as f32)
}

fn product_rate<T: ComplexField>(entry: impl Fn(f64) -> T) -> f64 {
    let a = Mat::from_fn(SIDE, SIDE, |i, j| entry((i + j) as f64 / SIDE as f64));
    let b = Mat::from_fn(SIDE, SIDE, |i, j| entry((2 * i + j) as f64 / SIDE as f64));
    let mut c = Mat::<T>::zeros(SIDE, SIDE);
    let seconds = best(|| {
        matmul(c.as_mut(), Accum::Replace, a.as_ref(), b.as_ref(), entry(1.0), Par::Seq);
        black_box(&c);
    });
    2.0 * (SIDE as f64).powi(3) / seconds
}

/// Square roots per second in double precision, of numbers in the first-level cache.
pub(crate) fn roots() -> f64 {
    let from: Vec<f64> = (0..ROOTS).map(|i| 1.0 + i as f64).collect();
    let mut to = vec![0.0_f64; ROOTS];
    let seconds = best(|| {
        for _ in 0..ROOT_PASSES {
            Arch::new().dispatch(|| {
                for (to, from) in to.iter_mut().zip(&from) {
                    *to = from.sqrt();
                }
            });
            black_box(&mut to);
        }
    });
    (ROOTS * ROOT_PASSES) as f64 / seconds
}

/// How many times as much two threads do as one, each with memory of its own, by the wall.
pub(crate) fn two_threads(work: impl Fn() -> f64 + Sync) -> f64 {
    let alone = work();
    let together: f64 = thread::scope(|scope| {
        let other = scope.spawn(&work);
        work() + other.join().unwrap_or(0.0)
    });
    together / alone
}

/// Seconds until a thread that sleeps goes on with work that another one hands it, and the other has its
/// word that it is done: the median of [`HANDOVERS`] times.
pub(crate) fn hand_over() -> f64 {
    let ((hand, take), (answer, receive)) = (sync_channel::<()>(1), sync_channel::<()>(1));
    let mut waits: Vec<f64> = thread::scope(|scope| {
        scope.spawn(move || while take.recv().is_ok() && answer.send(()).is_ok() {});
        let waits = (0..HANDOVERS).map(|_| {
            // Long enough for the other one to fall asleep.
            thread::sleep(SLEEP_TIME);
            let begin = Instant::now();
            let done = hand.send(()).is_ok() && receive.recv().is_ok();
            if done { begin.elapsed().as_secs_f64() } else { f64::INFINITY }
        });
        let waits = waits.collect();
        drop(hand);
        waits
    });
    waits.sort_by(f64::total_cmp);
    waits[HANDOVERS / 2]
}

/// Seconds for the fastest try.
fn best(mut work: impl FnMut()) -> f64 {
    (0..ATTEMPTS).map(|_| timed(&mut work).0.wall).fold(f64::INFINITY, f64::min)
}
