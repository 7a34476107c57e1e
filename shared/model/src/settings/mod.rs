//! What may be changed while the fleet runs, per service.
//!
//! Settings are checked as a whole: a patch either leads to settings that hold together, or changes
//! nothing and is answered with the field that is wrong. A patch is a JSON object of the fields to
//! change; `null` puts a field back to its default, and fields of nested tables may be named alone.

mod auditor;
mod clusterer;
mod embedder;
mod historian;
mod ingest;
mod need;
mod planner;
mod team_count;
mod team_size;
pub mod written;

use std::collections::BTreeMap;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

pub use auditor::AuditorSettings;
pub use clusterer::{CentroidStart, ClustererSettings};
pub use embedder::{
    Alpha, Dimension, EmbedderSettings, MAX_DIMENSION, MAX_SELF_LOOPS, Normalization, RowScaling,
    SingularValueScaling, Trusted, WEIGHT_SUM_TOLERANCE, WHOLE_FROM, check_reciprocity,
    check_weights, coverage, default_weight,
};
pub use historian::HistorianSettings;
pub use ingest::{
    ConnectivitySettings, IngestSettings, LinkUnit, MAX_TICK_HZ, SpatialKernel, SpatialScale,
    SpatialSettings,
};
pub use need::{Need, SkillCount};
pub use planner::PlannerSettings;
pub use team_count::TeamCount;
pub use team_size::TeamSize;

/// Longest field in an error, in characters: the path of any setting, and of a mistaken one its
/// beginning.
const MAX_FIELD: usize = 96;

/// Longest problem in an error, in characters: the list of all settings of a service fits.
const MAX_PROBLEM: usize = 320;

/// Why settings are refused: the field, and what it should have been.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct SettingsError {
    /// The path of the field, with dots.
    pub field: String,
    /// What is wrong and what would be right.
    pub problem: String,
}

impl SettingsError {
    /// An error of one field. Both texts may hold foreign words: they are cut short, and control
    /// characters are replaced.
    #[must_use]
    pub fn new(field: impl AsRef<str>, problem: impl AsRef<str>) -> Self {
        Self {
            field: plain(field.as_ref(), MAX_FIELD),
            problem: plain(problem.as_ref(), MAX_PROBLEM),
        }
    }
}

fn plain(text: &str, longest: usize) -> String {
    text.chars().take(longest).map(|c| if c.is_control() { '\u{FFFD}' } else { c }).collect()
}

/// Settings of a service.
pub trait Settings:
    Clone + std::fmt::Debug + Default + PartialEq + Serialize + DeserializeOwned + Send + 'static
{
    /// Checks every field, and that the fields fit each other.
    ///
    /// # Errors
    /// Names the first field that is wrong.
    fn check(&self) -> Result<(), SettingsError>;

    /// These settings with the fields of a patch changed.
    ///
    /// # Errors
    /// Names the field that is unknown, of the wrong type, or out of range; nothing is changed then.
    fn patched(&self, patch: &Value) -> Result<Self, SettingsError> {
        let Value::Object(patch) = patch else {
            return Err(SettingsError::new(
                "(patch)",
                "must be a JSON object of the fields to change, such as {\"teams\": 3}",
            ));
        };
        let settings = self.merged(patch)?;
        settings.check()?;
        Ok(settings)
    }

    /// The same without a check of the values: they have the right types, and may be out of range or not go together.
    ///
    /// # Errors
    /// Names the field that is unknown or of the wrong type.
    fn merged(&self, patch: &Map<String, Value>) -> Result<Self, SettingsError> {
        let mut current = to_object(self)?;
        merge(&mut current, patch, &to_object(&Self::default())?, "")?;
        from_value::<Self>(Value::Object(current))
    }

    /// The values of all fields that change one by one, each by its path: `{"size": {"min": 2}}` has the field `size.min`.
    #[must_use]
    fn fields(&self) -> BTreeMap<String, Value> {
        to_object(self).map(|settings| Self::fields_of(&settings)).unwrap_or_default()
    }

    /// What a patch says of the fields that change one by one, each by its path. `null` for a table is `null` for each of its fields.
    /// What is no setting stands under its own name.
    #[must_use]
    fn fields_of(patch: &Map<String, Value>) -> BTreeMap<String, Value> {
        let mut fields = BTreeMap::new();
        if let Ok(defaults) = to_object(&Self::default()) {
            take_fields(patch, &defaults, "", &mut fields);
        }
        fields
    }
}

/// The patch that has these fields, each by its path.
#[must_use]
pub fn patch_of<'a>(
    fields: impl IntoIterator<Item = (&'a String, &'a Value)>,
) -> Map<String, Value> {
    let mut patch = Map::new();
    for (path, value) in fields {
        let names: Vec<&str> = path.split('.').collect();
        put_field(&mut patch, &names, value);
    }
    patch
}

/// Where a field of a table stands under a name that another field has, it takes its place.
fn put_field(table: &mut Map<String, Value>, path: &[&str], value: &Value) {
    match path {
        [] => {}
        [name] => {
            table.insert((*name).to_owned(), value.clone());
        }
        [name, rest @ ..] => {
            let inner = table.entry(*name).or_insert(Value::Null);
            if !inner.is_object() {
                *inner = Value::Object(Map::new());
            }
            if let Value::Object(inner) = inner {
                put_field(inner, rest, value);
            }
        }
    }
}

fn take_fields(
    patch: &Map<String, Value>,
    defaults: &Map<String, Value>,
    path: &str,
    fields: &mut BTreeMap<String, Value>,
) {
    for (name, value) in patch {
        let field = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        match (value, defaults.get(name)) {
            (Value::Object(patch), Some(Value::Object(default))) if is_table(default) => {
                take_fields(patch, default, &field, fields);
            }
            (Value::Null, Some(Value::Object(default))) if is_table(default) => {
                let nothing = default.keys().map(|name| (name.clone(), Value::Null)).collect();
                take_fields(&nothing, default, &field, fields);
            }
            _ => {
                fields.insert(field, value.clone());
            }
        }
    }
}

/// Reads settings out of a JSON value and names the field that does not fit.
///
/// # Errors
/// Names the path of the field that is unknown or of the wrong type.
pub fn from_value<T: DeserializeOwned>(value: Value) -> Result<T, SettingsError> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let path = error.path().to_string();
        let field = if path == "." { "(settings)".to_owned() } else { path };
        SettingsError::new(field, error.into_inner().to_string())
    })
}

fn to_object<T: Serialize>(settings: &T) -> Result<Map<String, Value>, SettingsError> {
    match serde_json::to_value(settings) {
        Ok(Value::Object(object)) => Ok(object),
        Ok(_) => Err(SettingsError::new("(settings)", "must be an object")),
        Err(error) => Err(SettingsError::new("(settings)", error.to_string())),
    }
}

/// Tables that the defaults have as tables are merged field by field; everything else, such as the
/// maps of weights and reciprocities, whose keys are the fleet's own, is replaced as a whole.
fn merge(
    current: &mut Map<String, Value>,
    patch: &Map<String, Value>,
    defaults: &Map<String, Value>,
    path: &str,
) -> Result<(), SettingsError> {
    for (name, value) in patch {
        let field = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        let Some(default) = defaults.get(name) else {
            let known = defaults.keys().cloned().collect::<Vec<_>>().join(", ");
            return Err(SettingsError::new(field, format!("is no setting; there are {known}")));
        };
        match (value, default, current.get_mut(name)) {
            (Value::Null, _, _) => {
                current.insert(name.clone(), default.clone());
            }
            (Value::Object(patch), Value::Object(default), Some(Value::Object(current)))
                if is_table(default) =>
            {
                merge(current, patch, default, &field)?;
            }
            (_, Value::Object(default), _) if is_table(default) => {
                let fields = default.keys().cloned().collect::<Vec<_>>().join(", ");
                return Err(SettingsError::new(field, format!("must be an object of {fields}")));
            }
            _ => {
                current.insert(name.clone(), value.clone());
            }
        }
    }
    Ok(())
}

/// A table of several named fields, as against a choice with one field such as `{"fraction": 0.5}`.
fn is_table(default: &Map<String, Value>) -> bool {
    default.len() > 1
}

pub(crate) fn check_range(
    field: &str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
) -> Result<(), SettingsError> {
    if range.contains(&value) {
        Ok(())
    } else {
        Err(SettingsError::new(
            field,
            format!("must be a number from {} to {}, not {value}", range.start(), range.end()),
        ))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde_json::json;

    use super::*;
    use crate::id::TeamId;
    use crate::limits::MAX_TEAM_SIZES;

    #[test]
    fn a_patch_is_taken_apart_into_fields_and_put_together_again() {
        let fields = |patch: &Value| ClustererSettings::fields_of(patch.as_object().unwrap());
        let patch =
            json!({"size": {"min": 2}, "teams": 3, "team_size": {"t1": {"max": 4}}, "nothing": 1});
        let apart = fields(&patch);
        let names: Vec<&str> = apart.keys().map(String::as_str).collect();
        assert_eq!(names, ["nothing", "size.min", "team_size", "teams"]);
        assert_eq!(Value::Object(patch_of(&apart)), patch);
        let reset = fields(&json!({"size": null}));
        assert_eq!(patch_of(&reset)["size"], json!({"min": null, "max": null}));
        // A table and a field of one name come from another program.
        let both =
            BTreeMap::from([("size".to_owned(), json!(1)), ("size.min".to_owned(), json!(2))]);
        assert_eq!(Value::Object(patch_of(&both)), json!({"size": {"min": 2}}));
        // All fields of settings lead to the same settings.
        let settings = ClustererSettings::default().patched(&json!({"size": {"min": 2}})).unwrap();
        assert_eq!(settings.fields()["size.min"], 2);
        let patch = Value::Object(patch_of(&settings.fields()));
        assert_eq!(ClustererSettings::default().patched(&patch), Ok(settings));
    }

    #[test]
    fn the_defaults_hold_together() {
        assert_eq!(IngestSettings::default().check(), Ok(()));
        assert_eq!(EmbedderSettings::default().check(), Ok(()));
        assert_eq!(ClustererSettings::default().check(), Ok(()));
        assert_eq!(AuditorSettings::default().check(), Ok(()));
        assert_eq!(HistorianSettings::default().check(), Ok(()));
        assert_eq!(PlannerSettings::default().check(), Ok(()));
    }

    #[test]
    fn a_patch_changes_its_fields_and_null_restores_the_default() {
        let settings = ClustererSettings::default().patched(&json!({"teams": 5})).unwrap();
        assert_eq!(settings.teams, TeamCount::Fixed(5));
        assert_eq!(settings.restarts, ClustererSettings::default().restarts);
        let back = settings.patched(&json!({"teams": null})).unwrap();
        assert_eq!(back, ClustererSettings::default());
    }

    #[test]
    fn a_number_of_teams_is_fixed_a_range_or_chosen() {
        let settings = ClustererSettings::default();
        assert_eq!(settings.teams, TeamCount::Auto);
        let range = TeamCount::Between { from: 2, to: 4 };
        let forms = [
            (json!("auto"), TeamCount::Auto),
            (json!({"from": 2, "to": 4}), range),
            (json!(3), TeamCount::Fixed(3)),
            (json!({"from": 2, "to": 2}), TeamCount::Between { from: 2, to: 2 }),
        ];
        let mut current = settings;
        for (form, wanted) in forms {
            current = current.patched(&json!({ "teams": form })).unwrap();
            assert_eq!(current.teams, wanted);
            let text = serde_json::to_value(&current).unwrap();
            assert_eq!(text["teams"], form);
            assert_eq!(from_value::<ClustererSettings>(text), Ok(current.clone()));
        }
        for (wrong, field) in [
            (json!("many"), "teams"),
            (json!(2.5), "teams"),
            (json!(1025), "teams"),
            (json!(5_000_000_000_u64), "teams"),
            (json!([2, 4]), "teams"),
            (json!(true), "teams"),
            (json!({"from": 2}), "teams"),
            (json!({"from": 0, "to": 4}), "teams.from"),
            (json!({"from": "2", "to": 4}), "teams.from"),
            (json!({"from": 2, "to": 129}), "teams.to"),
            (json!({"from": 3, "to": 2}), "teams.to"),
            (json!({"from": 2, "to": -4}), "teams.to"),
            (json!({"from": 2, "to": 4, "step": 2}), "teams.step"),
        ] {
            let error = current.patched(&json!({ "teams": wrong })).unwrap_err();
            assert_eq!(error.field, field, "{error}");
        }
        let word = current.patched(&json!({"teams": "many"})).unwrap_err();
        assert!(word.problem.contains("\"auto\"") && word.problem.contains("\"from\""), "{word}");
        assert_eq!(
            [TeamCount::Auto, range, 3.into()].map(|t| t.to_string()),
            ["auto", "2..4", "3"]
        );
    }

    #[test]
    fn limits_of_teams_are_checked_together() {
        let patched = |patch: Value| ClustererSettings::default().patched(&patch);
        let t3 = TeamId::numbered(3);
        let some = patched(json!({"size": {"min": 2}, "team_size": {"t3": {"max": 4}}})).unwrap();
        assert_eq!(some.size_of(&t3), TeamSize { min: Some(2), max: Some(4) });
        assert_eq!(some.size_of(&TeamId::numbered(1)), TeamSize { min: Some(2), max: None });
        assert!(some.has_limits() && !ClustererSettings::default().has_limits());
        let more = some.patched(&json!({"size": {"max": 9}})).unwrap();
        assert_eq!(more.size, TeamSize { min: Some(2), max: Some(9) });
        let none = more.patched(&json!({"size": null, "team_size": null})).unwrap();
        assert_eq!(none, ClustererSettings::default());
        for (wrong, field) in [
            (json!({"size": 4}), "size"),
            (json!({"size": {"most": 4}}), "size.most"),
            (json!({"size": {"max": 0}}), "size.max"),
            (json!({"size": {"min": 5, "max": 4}}), "size.max"),
            (json!({"size": {"min": 200_000}}), "size.min"),
            (json!({"team_size": {"t3": {"max": 0}}}), "team_size.t3.max"),
            (json!({"size": {"min": 3}, "team_size": {"t3": {"max": 2}}}), "team_size.t3.max"),
        ] {
            let error = patched(wrong.clone()).unwrap_err();
            assert_eq!(error.field, field, "{wrong}: {error}");
        }
        let many: BTreeMap<String, Value> =
            (0..=MAX_TEAM_SIZES).map(|at| (format!("t{at}"), json!({"max": 4}))).collect();
        let error = patched(json!({ "team_size": many })).unwrap_err();
        assert!(error.field == "team_size" && error.problem.contains("256"), "{error}");
    }

    #[test]
    fn needs_are_checked_together() {
        let patched =
            |needs: Value| ClustererSettings::default().patched(&json!({ "needs": needs }));
        let medic = json!({"skill": "medic", "per_team": {"min": 1}});
        let of_t2 = json!({"skill": "medic", "team": "t2", "per_team": {"min": 2, "max": 3}});
        let some = patched(json!([medic, of_t2])).unwrap();
        let [all, own] = &some.needs[..] else { panic!("{some:?}") };
        assert_eq!(all.per_team, SkillCount { min: 1, max: None });
        assert!(all.team.is_none() && !all.soft && own.team == Some(TeamId::numbered(2)));
        assert_eq!(some.need_of(&all.skill, &TeamId::numbered(2)), Some(own));
        assert_eq!(some.need_of(&all.skill, &TeamId::numbered(1)), Some(all));
        let text = serde_json::to_value(&some).unwrap();
        assert_eq!(from_value::<ClustererSettings>(text), Ok(some.clone()));
        assert_eq!(some.patched(&json!({"needs": null})), Ok(ClustererSettings::default()));
        for (wrong, field) in [
            (json!("medic"), "needs"),
            (json!(["medic"]), "needs[0]"),
            (json!([["medic", null, [1, null], false]]), "needs[0]"),
            (json!([{"skill": "Medic", "per_team": {"min": 1}}]), "needs[0].skill"),
            (json!([{"skill": "medic"}]), "needs[0]"),
            (json!([{"skill": "medic", "per_team": {}}]), "needs[0].per_team"),
            (json!([{"skill": "medic", "per_team": 1}]), "needs[0].per_team"),
            (json!([{"skill": "medic", "per_team": [1, null]}]), "needs[0].per_team"),
            (json!([{"skill": "medic", "per_team": {"min": -1}}]), "needs[0].per_team.min"),
            (json!([{"skill": "medic", "per_team": {"min": 200_000}}]), "needs[0].per_team.min"),
            (
                json!([{"skill": "medic", "per_team": {"min": 2, "max": 1}}]),
                "needs[0].per_team.max",
            ),
            (
                json!([{"skill": "medic", "per_team": {"most": 1, "min": 0}}]),
                "needs[0].per_team.most",
            ),
            (json!([{"skill": "medic", "per_team": {"min": 1}, "soft": 1}]), "needs[0].soft"),
            (json!([{"skill": "medic", "per_team": {"min": 1}, "hard": true}]), "needs[0].hard"),
            (json!([medic, of_t2, medic]), "needs[2].skill"),
        ] {
            let error = patched(wrong.clone()).unwrap_err();
            assert_eq!(error.field, field, "{wrong}: {error}");
        }
        let many = |count: usize, skill: &dyn Fn(usize) -> String| {
            let need =
                |at| json!({"skill": skill(at), "team": format!("t{at}"), "per_team": {"min": 1}});
            patched((0..count).map(need).collect::<Value>())
        };
        assert!(many(64, &|_| "medic".to_owned()).is_ok());
        let error = many(65, &|_| "medic".to_owned()).unwrap_err();
        assert!(error.field == "needs" && error.problem.contains("64"), "{error}");
        assert!(many(16, &|at| format!("s{at}")).is_ok());
        let error = many(17, &|at| format!("s{at}")).unwrap_err();
        assert!(error.field == "needs" && error.problem.contains("16"), "{error}");
    }

    #[test]
    fn nested_tables_merge_and_maps_are_replaced() {
        let settings = IngestSettings::default();
        let patched = settings.patched(&json!({"spatial": {"radius_m": 12.5}})).unwrap();
        assert_eq!(patched.spatial.radius_m, Some(12.5));
        assert_eq!(patched.spatial.kernel, settings.spatial.kernel);

        let first = EmbedderSettings::default().patched(&json!({"weights": {"spatial": 1.0}}));
        let second = first.unwrap().patched(&json!({"weights": {"hierarchy": 1.0}})).unwrap();
        assert_eq!(second.weights.len(), 1);
        let alpha = second.patched(&json!({"alpha": 0.25})).unwrap().alpha;
        assert_eq!(alpha, Alpha::Value(0.25));
    }

    #[test]
    fn the_largest_graph_of_each_kernel_fits_a_message() {
        let settings = IngestSettings::default().patched(&json!({"max_robots": 100_000})).unwrap();
        for (kernel, most) in [("gaussian", 22), ("exponential", 22), ("wendland-c2", 11)] {
            let patch =
                |neighbours: u32| json!({"spatial": {"kernel": kernel, "neighbours": neighbours}});
            assert!(settings.patched(&patch(most)).is_ok());
            let error = settings.patched(&patch(most + 1)).unwrap_err();
            assert_eq!(error.field, "spatial.neighbours");
            let remedy = format!("at most {most} for max_robots of 100000");
            assert!(error.problem.contains(&remedy), "{error}");
        }
    }

    #[test]
    fn no_service_may_be_silent_for_so_long_that_it_is_taken_for_dead() {
        let heartbeat = |s: f64| ClustererSettings::default().patched(&json!({"heartbeat_s": s}));
        assert!(heartbeat(4.0).is_ok() && heartbeat(4.1).unwrap_err().field == "heartbeat_s");
        let tick = |hz: f64| IngestSettings::default().patched(&json!({"tick_hz": hz}));
        assert!(tick(0.5).is_ok() && tick(0.4).unwrap_err().field == "tick_hz");
    }

    #[test]
    fn a_bad_patch_names_its_field() {
        let field = |patch: Value| ClustererSettings::default().patched(&patch).unwrap_err().field;
        assert_eq!(field(json!({"team": 5})), "team");
        assert_eq!(field(json!({"teams": "five"})), "teams");
        assert_eq!(field(json!({"teams": -1})), "teams");
        assert_eq!(field(json!({"teams": 0})), "teams");
        assert_eq!(field(json!({"init": "best"})), "init");
        assert_eq!(field(json!([1])), "(patch)");
        let spatial = |patch: Value| IngestSettings::default().patched(&patch).unwrap_err().field;
        assert_eq!(spatial(json!({"spatial": {"radius": 1}})), "spatial.radius");
        assert_eq!(spatial(json!({"spatial": {"width": 0.0}})), "spatial.width");
        assert_eq!(spatial(json!({"spatial": {"cutoff": 0.9}})), "spatial.cutoff");
        assert_eq!(spatial(json!({"spatial": {"kernel": "wendland"}})), "spatial.kernel");
        assert_eq!(spatial(json!({"spatial": ["gaussian", 2.0, 9.0, 200, 16, null]})), "spatial");
        let alpha = |patch: Value| EmbedderSettings::default().patched(&patch).unwrap_err();
        for wrong in [json!("x"), json!({"fraction": 0.5, "x": 1}), json!({}), json!([1])] {
            let error = alpha(json!({ "alpha": wrong }));
            assert!(error.field == "alpha" && error.problem.contains("fraction"), "{error}");
        }
    }
}
