//! What the schema accepts the services accept, and what it refuses they refuse.
//!
//! Every case is checked twice: by a validator that is not Muster's, and by a live service. Where
//! the two may differ, the schema's own description says so, in words that the case names.

mod robots;
mod settings;

use serde_json::Value;

use crate::schema::validated;
use Wanted::{Accepted, OnlyByService, Refused};

/// How a case must come out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wanted {
    /// Both accept it.
    Accepted,
    /// Both refuse it.
    Refused,
    /// The schema accepts it, the service does not, and a description says why, in these words.
    OnlyByService(&'static str),
}

/// Checks all cases against the schema, and that what only the service refuses is documented.
fn compare(document: &Value, cases: &[(String, String, Wanted, Result<(), String>)]) {
    let texts: Vec<_> = cases.iter().map(|(name, text, ..)| (name.clone(), text.clone())).collect();
    let all = document.to_string();
    for ((name, text, wanted, service), schema) in
        cases.iter().zip(validated(document, &[], &texts))
    {
        let text: String = text.chars().take(200).collect();
        let says =
            format!("{name} {text}: wanted {wanted:?}, schema {schema:?}, service {service:?}");
        assert_eq!(schema.is_none(), *wanted != Refused, "{says}");
        assert_eq!(service.is_ok(), *wanted == Accepted, "{says}");
        if let OnlyByService(words) = wanted {
            assert!(all.contains(words), "not documented: {says}");
        }
        if let Err(reason) = service {
            assert!(!reason.is_empty(), "{says}");
        }
    }
}
