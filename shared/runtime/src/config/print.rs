//! The configuration as text, each value with its origin.

use std::fmt::Write as _;
use std::path::PathBuf;

use muster_model::id::ServiceName;
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, HistorianSettings, IngestSettings,
    PlannerSettings, Settings,
};
use serde_json::{Map, Value};

use super::{Origin, ProcessConfig};
use crate::exit::ExitError;

impl ProcessConfig {
    /// The configuration as TOML, each value with its origin.
    ///
    /// # Errors
    /// If settings do not hold together.
    pub fn print(&self, services: &[ServiceName]) -> Result<String, ExitError> {
        let mut text = String::new();
        let mut line = |name: &str, value: Value, origin: &Origin| {
            let value = toml_value(&value);
            // Writing to a string does not fail.
            let _ = match value {
                Some(value) => writeln!(text, "{name} = {value}  # {origin}"),
                None => writeln!(text, "# {name} is not set  # {origin}"),
            };
        };
        let path = |path: &Option<PathBuf>| {
            path.as_ref().map_or(Value::Null, |path| path.display().to_string().into())
        };
        line("fleet", self.fleet.value.as_str().into(), &self.fleet.origin);
        line("connect", self.connect.value.clone().into(), &self.connect.origin);
        line("listen", self.listen.value.clone().into(), &self.listen.origin);
        line("mode", self.mode.value.to_string().into(), &self.mode.origin);
        line("zenoh_config", path(&self.zenoh_config.value), &self.zenoh_config.origin);
        line("state_directory", path(&self.state_directory.value), &self.state_directory.origin);
        line("log", self.log.value.clone().into(), &self.log.origin);
        line("log_json", self.log_json.value.into(), &self.log_json.origin);
        let http = self.http.value.map_or(Value::Null, |address| address.to_string().into());
        line("http", http, &self.http.origin);
        for service in services {
            let settings = match service {
                ServiceName::Ingest => to_value(&self.settings::<IngestSettings>(*service)?),
                ServiceName::Embedder => to_value(&self.settings::<EmbedderSettings>(*service)?),
                ServiceName::Clusterer => to_value(&self.settings::<ClustererSettings>(*service)?),
                ServiceName::Auditor => to_value(&self.settings::<AuditorSettings>(*service)?),
                ServiceName::Historian => to_value(&self.settings::<HistorianSettings>(*service)?),
                ServiceName::Planner => to_value(&self.settings::<PlannerSettings>(*service)?),
            };
            let _ = write!(text, "\n[{service}]\n");
            self.print_table(&mut text, *service, &settings, "");
        }
        Ok(text)
    }

    fn print_table(
        &self,
        text: &mut String,
        service: ServiceName,
        table: &Map<String, Value>,
        path: &str,
    ) {
        for (name, value) in table {
            let field = format!("{path}{name}");
            match value {
                Value::Object(inner) if inner.len() > 1 => {
                    self.print_table(text, service, inner, &format!("{field}."));
                }
                _ => {
                    let origin = self.origin(service, &field);
                    let _ = match toml_value(value) {
                        Some(value) => writeln!(text, "{field} = {value}  # {origin}"),
                        None => writeln!(text, "# {field} is not set  # {origin}"),
                    };
                }
            }
        }
    }

    fn origin(&self, service: ServiceName, field: &str) -> Origin {
        let pointer = format!("/{}", field.replace('.', "/"));
        self.patches
            .iter()
            .rev()
            .find(|(of, _, patch)| *of == service && patch.pointer(&pointer).is_some())
            .map_or(Origin::Default, |(_, origin, _)| origin.clone())
    }
}

fn to_value<S: Settings>(settings: &S) -> Map<String, Value> {
    match serde_json::to_value(settings) {
        Ok(Value::Object(map)) => map,
        _ => Map::new(),
    }
}

/// A value as it stands in TOML on one line; none for null, which TOML does not have.
fn toml_value(value: &Value) -> Option<String> {
    if value.is_null() {
        return None;
    }
    toml::Value::try_from(without_nulls(value)).ok().map(|value| value.to_string())
}

/// The same value; what is null within it is left out.
fn without_nulls(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let set = fields.iter().filter(|(_, value)| !value.is_null());
            set.map(|(name, value)| (name.clone(), without_nulls(value))).collect()
        }
        Value::Array(values) => values.iter().map(without_nulls).collect(),
        other => other.clone(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn what_is_null_within_a_value_is_left_out() {
        let needs = json!([{"skill": "medic", "team": null, "per_team": {"min": 1, "max": null}}]);
        let text = toml_value(&needs).unwrap();
        let read: toml::Table = format!("needs = {text}").parse().unwrap();
        assert_eq!(
            serde_json::to_value(read).unwrap(),
            json!({"needs": [{"skill": "medic", "per_team": {"min": 1}}]})
        );
        assert_eq!(toml_value(&Value::Null), None);
    }
}
