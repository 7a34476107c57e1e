//! One target under LLVM's fuzzer, guided by coverage; `MUSTER_FUZZ_TARGET` names it.
//! `tests/fuzz/run` builds and starts it.

#![no_main]
#![allow(clippy::expect_used, reason = "a wrong start ends with its reason")]

use std::sync::OnceLock;

use libfuzzer_sys::Corpus;

static TARGET: OnceLock<muster_fuzz::Target> = OnceLock::new();

libfuzzer_sys::fuzz_target!(|data: &[u8]| -> Corpus {
    let target = TARGET.get_or_init(|| {
        let name = std::env::var("MUSTER_FUZZ_TARGET").expect("MUSTER_FUZZ_TARGET is not set");
        muster_fuzz::find(&name).expect("MUSTER_FUZZ_TARGET is the name of no target")
    });
    if data.len() > target.longest {
        return Corpus::Reject;
    }
    let _ = (target.run)(data);
    Corpus::Keep
});
