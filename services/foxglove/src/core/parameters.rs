//! Parameters: the settings that viewers show and change, always as the services confirmed them.

use std::collections::BTreeMap;

use muster_model::id::ServiceName;
use serde_json::{Value, json};

use super::limits::{MAX_PARAMETER_BYTES, MAX_PARAMETER_NAME_BYTES, MAX_PARAMETERS};

/// The number of teams.
pub const TEAMS: &str = "clusterer.teams";

/// The weights of the modalities, as one table: they sum to 1, so that none can be changed alone. An empty one means that the
/// service chooses them.
pub const WEIGHTS: &str = "embedder.weights";

/// One parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Its value: a whole number or a text for the number of teams, a table for the weights. None is one that is not set.
    pub value: Option<Value>,
}

/// Whether names of parameters are few and short enough to be kept until they are answered.
#[must_use]
pub fn are_bounded<'a>(mut names: impl ExactSizeIterator<Item = &'a str>) -> bool {
    names.len() <= MAX_PARAMETERS && names.all(|name| name.len() <= MAX_PARAMETER_NAME_BYTES)
}

/// The services that have parameters.
pub(super) const SERVICES: [ServiceName; 2] = [ServiceName::Clusterer, ServiceName::Embedder];

/// The settings as their services confirmed them.
#[derive(Debug, Default)]
pub(super) struct Confirmed(BTreeMap<ServiceName, Value>);

impl Confirmed {
    /// Whether all services have answered.
    pub(super) fn is_complete(&self) -> bool {
        SERVICES.iter().all(|service| self.0.contains_key(service))
    }

    /// Takes the settings of a service, and returns the parameters that have other values than before.
    pub(super) fn confirm(&mut self, service: ServiceName, settings: Value) -> Vec<Parameter> {
        let before = self.all();
        self.0.insert(service, settings);
        let after = self.all();
        let is_new = |parameter: &Parameter| !before.contains(parameter);
        after.into_iter().filter(is_new).collect()
    }

    /// All parameters.
    pub(super) fn all(&self) -> Vec<Parameter> {
        let field = |service: ServiceName, name: &str| self.0.get(&service)?.get(name);
        let teams = field(ServiceName::Clusterer, "teams").map(shown);
        let weights = field(ServiceName::Embedder, "weights").cloned();
        let all = [(TEAMS, teams), (WEIGHTS, weights)].into_iter();
        let named = all.filter_map(|(name, value)| Some((name, value?)));
        named.map(|(name, value)| Parameter { name: name.to_owned(), value: Some(value) }).collect()
    }

    /// Some parameters by name, all for no name; what does not exist is left out.
    pub(super) fn some(&self, names: &[String]) -> Vec<Parameter> {
        let mut all = self.all();
        all.retain(|parameter| names.is_empty() || names.contains(&parameter.name));
        all
    }

    /// What services must be commanded for some parameters: the fields of each to change.
    ///
    /// # Errors
    /// Says which parameter is wrong.
    pub(super) fn patches(
        parameters: &[Parameter],
    ) -> Result<BTreeMap<ServiceName, Value>, String> {
        if parameters.len() > MAX_PARAMETERS {
            return Err(format!("at most {MAX_PARAMETERS} parameters can be changed at once"));
        }
        let mut patches: BTreeMap<ServiceName, Value> = BTreeMap::new();
        for Parameter { name, value } in parameters {
            let value = value.as_ref().ok_or_else(|| format!("{name}: cannot be removed"))?;
            if value.to_string().len() > MAX_PARAMETER_BYTES {
                return Err(format!("{name}: is longer than {MAX_PARAMETER_BYTES} bytes"));
            }
            match name.as_str() {
                TEAMS => patches.insert(ServiceName::Clusterer, json!({"teams": teams(value)?})),
                WEIGHTS => patches.insert(ServiceName::Embedder, json!({"weights": value})),
                _ => return Err(format!("{name}: there is no such parameter")),
            };
        }
        Ok(patches)
    }
}

/// A number of teams as it is shown: bounds have no form of their own among parameters.
fn shown(teams: &Value) -> Value {
    match (teams.get("from"), teams.get("to")) {
        (Some(from), Some(to)) => json!(format!("{from}..{to}")),
        _ => teams.clone(),
    }
}

/// A number of teams as the service reads it: 3, auto, or 2..6. A viewer may send a number as a text.
fn teams(value: &Value) -> Result<Value, String> {
    let Some(text) = value.as_str() else {
        // Viewers know no whole numbers.
        let whole = value.as_f64().filter(|number| number.fract() == 0.0 && number.abs() < 1e9);
        return Ok(whole.map_or_else(|| value.clone(), |number| json!(number as i64)));
    };
    if let Some((from, to)) = text.split_once("..") {
        let bound = |text: &str| {
            text.trim().parse::<u32>().map_err(|_| format!("{TEAMS}: must be 3, auto or 2..6"))
        };
        return Ok(json!({"from": bound(from)?, "to": bound(to)?}));
    }
    Ok(text.trim().parse::<u32>().map_or_else(|_| value.clone(), |number| json!(number)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn confirmed() -> Confirmed {
        let mut confirmed = Confirmed::default();
        confirmed.confirm(ServiceName::Clusterer, json!({"teams": 2, "dwell_s": 1.0}));
        let weights = json!({"weights": {"spatial": 0.5, "hierarchy": 0.5}});
        confirmed.confirm(ServiceName::Embedder, weights);
        confirmed
    }

    fn parameter(name: &str, value: Value) -> Parameter {
        Parameter { name: name.to_owned(), value: Some(value) }
    }

    #[test]
    fn what_changed_is_returned_and_nothing_else() {
        let mut confirmed = confirmed();
        assert!(confirmed.is_complete());
        let changed = confirmed.confirm(ServiceName::Clusterer, json!({"teams": "auto"}));
        assert_eq!(changed, [parameter(TEAMS, json!("auto"))]);
        assert!(confirmed.confirm(ServiceName::Clusterer, json!({"teams": "auto"})).is_empty());
        let range = json!({"teams": {"from": 2, "to": 6}});
        assert_eq!(confirmed.confirm(ServiceName::Clusterer, range)[0].value, Some(json!("2..6")));
        assert_eq!(confirmed.some(&[]).len(), 2);
        let weights = confirmed.some(&[WEIGHTS.to_owned()]);
        assert_eq!(weights, [parameter(WEIGHTS, json!({"spatial": 0.5, "hierarchy": 0.5}))]);
    }

    #[test]
    fn each_service_gets_its_own_patch() {
        let weights = json!({"spatial": 0.25, "hierarchy": 0.75});
        let all = [parameter(WEIGHTS, weights.clone()), parameter(TEAMS, json!("3"))];
        let patches = Confirmed::patches(&all).unwrap();
        assert_eq!(patches[&ServiceName::Embedder], json!({"weights": weights}));
        assert_eq!(patches[&ServiceName::Clusterer], json!({"teams": 3}));
    }

    #[test]
    fn what_is_no_parameter_is_refused() {
        for (wrong, problem) in [
            (parameter("clusterer.dwell_s", json!(1)), "no such parameter"),
            (parameter("embedder.weights.radar", json!(1)), "no such parameter"),
            (Parameter { name: TEAMS.to_owned(), value: None }, "cannot be removed"),
            (parameter(TEAMS, json!("2..x")), "must be 3, auto or 2..6"),
        ] {
            let found = Confirmed::patches(std::slice::from_ref(&wrong)).unwrap_err();
            assert!(found.contains(problem) && found.contains(&wrong.name), "{found}");
        }
        let long = parameter(WEIGHTS, json!({"spatial": "1".repeat(MAX_PARAMETER_BYTES)}));
        assert!(Confirmed::patches(&[long]).unwrap_err().contains("is longer than"));
        assert!(are_bounded([TEAMS; MAX_PARAMETERS].into_iter()));
        assert!(!are_bounded([TEAMS; MAX_PARAMETERS + 1].into_iter()));
        let name = "n".repeat(MAX_PARAMETER_NAME_BYTES + 1);
        assert!(are_bounded([&name[1..]].into_iter()) && !are_bounded([name.as_str()].into_iter()));
        let many = vec![parameter(TEAMS, json!(1)); MAX_PARAMETERS + 1];
        assert!(Confirmed::patches(&many).unwrap_err().contains("at most"));
        // What the service refuses is its business.
        assert_eq!(teams(&json!(2.0)), Ok(json!(2)));
        assert_eq!(teams(&json!(2.5)), Ok(json!(2.5)));
        assert_eq!(teams(&json!("many")), Ok(json!("many")));
    }
}
