//! Settings: patches of them, and what is kept of them over a restart.

use muster_auditor::Auditor;
use muster_clusterer::Clusterer;
use muster_embedder::Embedder;
use muster_ingest::Ingest;
use muster_model::id::{FleetId, InstanceId};
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, IngestSettings, Settings, from_value,
};
use muster_service::testkit::Bench;
use muster_service::{Core, Start, Stored};
use muster_wire::wish::WishChange;
use muster_wire::{Key, Message};
use serde_json::{Value, json};

use crate::packets::{NOW, may_hold};
use crate::{Outcome, allocation, text};

/// Longest field of a refused patch, in characters.
const MAX_FIELD: usize = 120;

/// Longest error about it, in characters: some list all fields.
const MAX_PROBLEM: usize = 400;

/// A service in one byte, and patches in JSON, one after the other, a line each; each is read as a wish as well.
pub(crate) fn settings(data: &[u8]) -> Outcome {
    let Some((service, patches)) = data.split_first() else { return Outcome::Refused };
    for wish in patches.split(|byte| *byte == b'\n') {
        match muster_wire::wish::decode(wish) {
            Ok(WishChange::Put(wish)) => assert_eq!(wish.clone().checked(), Ok(wish)),
            Ok(WishChange::Withdraw) => {}
            Err(error) => {
                text::check(&error.field, MAX_FIELD);
                text::check(&error.problem, MAX_PROBLEM);
            }
        }
    }
    let run = match service % 4 {
        0 => patched::<IngestSettings>,
        1 => patched::<EmbedderSettings>,
        2 => patched::<ClustererSettings>,
        _ => patched::<AuditorSettings>,
    };
    allocation::at_most(may_hold(patches.len()), "patching", || run(patches))
}

fn patched<S: Settings>(patches: &[u8]) -> Outcome {
    let mut settings = S::default();
    let mut outcome = Outcome::Refused;
    for patch in patches.split(|byte| *byte == b'\n') {
        let Ok(patch) = serde_json::from_slice::<Value>(patch) else { continue };
        match settings.patched(&patch) {
            Ok(next) => (settings, outcome) = (next, Outcome::Accepted),
            Err(error) => {
                text::check(&error.field, MAX_FIELD);
                text::check(&error.problem, MAX_PROBLEM);
            }
        }
        assert_eq!(settings.check(), Ok(()));
        let written = serde_json::to_value(&settings).unwrap();
        assert_eq!(from_value::<S>(written.clone()).as_ref(), Ok(&settings));
        assert_eq!(S::default().patched(&written).as_ref(), Ok(&settings));
        assert_eq!(settings.patched(&json!({})).as_ref(), Ok(&settings));
    }
    outcome
}

/// A service in one byte, and the file that is kept over a restart.
pub(crate) fn stored(data: &[u8]) -> Outcome {
    let Some((service, file)) = data.split_first() else { return Outcome::Refused };
    let Ok(stored) = serde_json::from_slice::<Stored>(file) else { return Outcome::Refused };
    let run = match service % 4 {
        0 => started::<Ingest>,
        1 => started::<Embedder>,
        2 => started::<Clusterer>,
        _ => started::<Auditor>,
    };
    allocation::at_most(may_hold(file.len()), "starting", || run(stored));
    Outcome::Accepted
}

/// A service that starts with a file takes a term above it, announces its settings, and stores those
/// that it announces.
fn started<C: Core>(stored: Stored) {
    let term = stored.term;
    let bench = |stored: Stored| {
        Bench::<C>::new(Start {
            fleet: FleetId::new("alpha").unwrap(),
            instance: InstanceId::new("fuzz-1").unwrap(),
            now: NOW,
            settings: C::Settings::default(),
            stored,
        })
    };
    let mut first = bench(stored);
    first.start(Vec::new());
    assert!(first.stored.term > term || term == u64::MAX, "the term does not rise");
    assert_eq!(first.unencodable, Vec::<String>::new());
    for message in &first.published {
        for out in message.publish(NOW).unwrap() {
            text::check(&out.key.to_string(), MAX_FIELD);
        }
    }
    let announced = |bench: &mut Bench<C>| {
        let answer = bench.get(&Key::Settings(C::SERVICE).to_string(), None).unwrap();
        match answer.last() {
            Some(Message::Settings(announced)) => announced.settings.clone(),
            other => panic!("settings are answered with {other:?}"),
        }
    };
    let settings = announced(&mut first);
    let read: C::Settings = serde_json::from_str(&settings).unwrap();
    assert_eq!(read.check(), Ok(()));
    let written = serde_json::to_vec(&first.stored).unwrap();
    let again = bench(serde_json::from_slice(&written).unwrap());
    assert_eq!(announced(&mut { again }), settings, "a restart changes settings");
}
