//! The input file: its shape, and how it is read.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

use muster_model::id::{Modality, RobotId, SkillId, TeamId};
use muster_model::object::Object;
use muster_model::observation::{Link, Pose, Rank};
use muster_model::settings::{
    Alpha, CentroidStart, Dimension, Need, Normalization, RowScaling, SingularValueScaling,
    TeamCount, TeamSize, Trusted,
};
use muster_model::wish::Wish;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error as _, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};

use super::edges::Edges;
use super::error::{SolveError, tidy};
use super::options::Preset;

/// The file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) robots: Vec<RobotId>,
    pub(super) modalities: Option<Vec<Object<ModalityEntry>>>,
    pub(super) poses: Option<Named<RobotId, Object<Pose>>>,
    pub(super) links: Option<Named<RobotId, Vec<Object<Link>>>>,
    pub(super) ranks: Option<Named<RobotId, Object<Rank>>>,
    pub(super) weights: Option<Named<Modality, f64>>,
    pub(super) spatial: Option<Map<String, Value>>,
    pub(super) connectivity: Option<Map<String, Value>>,
    pub(super) reciprocity: Option<Named<Modality, f64>>,
    pub(super) preset: Option<Preset>,
    pub(super) normalize: Option<Normalization>,
    pub(super) self_loops: Option<f64>,
    pub(super) trusted: Option<Trusted>,
    pub(super) alpha: Option<Decay>,
    pub(super) dimension: Option<Dimension>,
    pub(super) scale: Option<SingularValueScaling>,
    pub(super) rows: Option<RowScaling>,
    pub(super) teams: Option<TeamCount>,
    pub(super) labels: Option<Vec<u32>>,
    pub(super) init: Option<CentroidStart>,
    pub(super) restarts: Option<u32>,
    pub(super) seed: Option<u64>,
    pub(super) size: Option<Object<TeamSize>>,
    pub(super) team_size: Option<Named<TeamId, Object<TeamSize>>>,
    pub(super) needs: Option<Vec<Object<Need>>>,
    pub(super) skills: Option<Named<RobotId, Vec<SkillId>>>,
    pub(super) wishes: Option<Vec<Object<Wish>>>,
    pub(super) emit: Option<Vec<Emit>>,
}

/// One graph, in one of two forms.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModalityEntry {
    pub(super) name: Modality,
    pub(super) weight: Option<f64>,
    pub(super) matrix: Option<Vec<Vec<f64>>>,
    pub(super) edges: Option<Edges>,
}

/// An object whose keys are names, each of them once.
pub(super) struct Named<K, V>(pub(super) BTreeMap<K, V>);

impl<'de, K, V> Deserialize<'de> for Named<K, V>
where
    K: Deserialize<'de> + Ord + fmt::Display,
    V: Deserialize<'de>,
{
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NamedVisitor<K, V>(PhantomData<(K, V)>);
        impl<'de, K, V> Visitor<'de> for NamedVisitor<K, V>
        where
            K: Deserialize<'de> + Ord + fmt::Display,
            V: Deserialize<'de>,
        {
            type Value = Named<K, V>;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("an object whose keys are names")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut named = BTreeMap::new();
                while let Some(key) = map.next_key::<K>()? {
                    if named.contains_key(&key) {
                        return Err(A::Error::custom(format_args!("{key} is named twice")));
                    }
                    named.insert(key, map.next_value()?);
                }
                Ok(Named(named))
            }
        }
        deserializer.deserialize_map(NamedVisitor(PhantomData))
    }
}

/// The decay as it is written.
pub(super) struct Decay(pub(super) Alpha);

impl<'de> Deserialize<'de> for Decay {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Fraction {
            fraction: f64,
        }
        struct DecayVisitor;
        impl<'de> Visitor<'de> for DecayVisitor {
            type Value = Decay;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a number, or {\"fraction\": number}")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Decay, E> {
                Ok(Decay(Alpha::Value(value)))
            }

            #[expect(clippy::cast_precision_loss, reason = "as every number in JSON")]
            fn visit_u64<E>(self, value: u64) -> Result<Decay, E> {
                Ok(Decay(Alpha::Value(value as f64)))
            }

            #[expect(clippy::cast_precision_loss, reason = "as every number in JSON")]
            fn visit_i64<E>(self, value: i64) -> Result<Decay, E> {
                Ok(Decay(Alpha::Value(value as f64)))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Decay, A::Error> {
                let Fraction { fraction } = Fraction::deserialize(MapAccessDeserializer::new(map))?;
                Ok(Decay(Alpha::Fraction { fraction }))
            }
        }
        deserializer.deserialize_any(DecayVisitor)
    }
}

/// What the JSON output holds in addition to the results that it always holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Emit {
    Katz,
    Embedding,
    Diagnostics,
}

/// The text as a file, whatever its numbers.
pub(super) fn read(text: &[u8]) -> Result<File, SolveError> {
    // Some programs on Windows mark UTF-8 files so.
    let text = text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text);
    let mut json = serde_json::Deserializer::from_slice(text);
    let read = serde_path_to_error::deserialize::<_, Object<File>>(&mut json);
    let file = read.map_err(|error| {
        let path = error.path().to_string();
        let error = error.into_inner();
        let problem = explained(&error, text);
        match path.as_str() {
            "." | "" | "?" => SolveError::Json(tidy(&problem)),
            _ => SolveError::Field { field: tidy(&path), problem: tidy(&problem) },
        }
    })?;
    json.end().map_err(|error| SolveError::Json(tidy(&error.to_string())))?;
    Ok(file.0)
}

/// The text of the error, with a hint where the text holds a number that JSON does not have.
pub(super) fn explained(error: &serde_json::Error, text: &[u8]) -> String {
    let hint = "; NaN and Infinity are no JSON, every number must be finite";
    let hint = if is_not_finite(error, text) { hint } else { "" };
    format!("{error}{hint}")
}

/// Whether the error stands at the word NaN or Infinity in one of its spellings, or at a number
/// beyond the range of double precision.
fn is_not_finite(error: &serde_json::Error, text: &[u8]) -> bool {
    if error.to_string().starts_with("number out of range") {
        return true;
    }
    let lines = text.split(|byte| *byte == b'\n');
    let Some(line) = lines.clone().nth(error.line().saturating_sub(1)) else { return false };
    // The column counts bytes from 1 and may stand on any letter of the word, or right after it.
    let at = error.column().saturating_sub(1).min(line.len());
    let (before, after) = line.split_at(at);
    let in_word = |byte: &&u8| byte.is_ascii_alphabetic();
    let head = before.iter().rev().take(16).take_while(in_word).count();
    let tail = after.iter().take(16).skip_while(|byte| **byte == b'-');
    let word = before[before.len() - head..].iter().chain(tail.take_while(in_word));
    let word: Vec<u8> = word.map(u8::to_ascii_lowercase).collect();
    matches!(word.as_slice(), b"nan" | b"inf" | b"infinity")
}
