//! What operators have changed of the settings: a map in which the later change of each field wins.
//!
//! A leader confirms a change once it is on its own disk, and may be lost before another instance knows of it; two instances may
//! lead at once. So a change is dated as it is carried out, and its date goes with it: in announcements, in the outcome of the
//! command, and on the disk. Whoever receives changes in whatever order, and however often, ends with the same map (a map of
//! last-writer-wins registers, M. Shapiro et al., "A comprehensive study of convergent and commutative replicated data types",
//! INRIA RR-7506, 2011).

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::command::SettingsChange;
use muster_model::settings::{Settings, patch_of};
use muster_model::time::Tick;
use serde_json::{Map, Value};

/// By how much a change is later than the one before it, if clocks say otherwise.
const NEXT: Duration = Duration::from_micros(1);

/// What a field was changed to.
#[derive(Debug, Clone, PartialEq)]
struct Change {
    /// When it counts as changed. Zero where no operator has changed it: a leader has it by its file or flags.
    at: Tick,
    value: Value,
}

/// The changes, by the paths of their fields.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Changes {
    fields: BTreeMap<String, Change>,
    /// Those that do not go together with later ones, or fit no setting. Every instance leaves out the same.
    unfit: BTreeSet<String>,
}

impl Changes {
    /// Those on the disk. A date after the `latest` moment that is believed is damage, and counts no more than none.
    pub(crate) fn stored<S: Settings>(
        patch: &Map<String, Value>,
        changed: &BTreeMap<String, Tick>,
        latest: Tick,
    ) -> Self {
        let dated = |(path, value): (String, Value)| {
            let at = changed.get(&path).copied().filter(|at| *at <= latest).unwrap_or_default();
            (path, Change { at, value })
        };
        let fields = S::fields_of(patch).into_iter().map(dated).collect();
        Self { fields, unfit: BTreeSet::new() }
    }

    /// When a field was changed; zero if no operator has changed it.
    pub(crate) fn at(&self, path: &str) -> Tick {
        self.fields.get(path).map(|change| change.at).unwrap_or_default()
    }

    /// Receives a change of a field. Returns whether it is later than the one that there is.
    pub(crate) fn merge(&mut self, path: &str, at: Tick, value: &Value) -> bool {
        // Two leaders may have dated two commands alike. Which of them wins does not matter, as long as all agree.
        let is_later = self
            .fields
            .get(path)
            .is_none_or(|known| (at, value.to_string()) > (known.at, known.value.to_string()));
        if is_later {
            self.fields.insert(path.to_owned(), Change { at, value: value.clone() });
        }
        is_later
    }

    /// Receives a change of settings. Returns whether anything of it is later than what there is. What is no setting of this program, or
    /// has another type, is left out as a whole.
    pub(crate) fn merge_change<S: Settings>(&mut self, change: &SettingsChange) -> bool {
        let Ok(Value::Object(patch)) = serde_json::from_str(&change.fields) else { return false };
        // All write a value in one way, so that it is compared with itself.
        let Ok(settings) = S::default().merged(&patch) else { return false };
        let values = settings.fields();
        S::fields_of(&patch).keys().fold(false, |is_new, path| {
            let value = values.get(path);
            value.is_some_and(|value| self.merge(path, change.at, value)) || is_new
        })
    }

    /// The leader has a value that no operator has set. None if it is that of this instance's own file and flags.
    pub(crate) fn follow(&mut self, path: &str, value: Option<&Value>) {
        if self.at(path) > Tick::default() {
            return;
        }
        match value {
            Some(value) => {
                let change = Change { at: Tick::default(), value: value.clone() };
                self.fields.insert(path.to_owned(), change);
            }
            None => {
                self.fields.remove(path);
            }
        }
    }

    /// An operator has changed the fields of a patch, so that the settings are now these. Returns the change. It counts as made when
    /// it was `sent`, and after all earlier changes of the same fields. What did not fit gives way for good, since the operator
    /// has changed settings without it.
    pub(crate) fn command<S: Settings>(
        &mut self,
        patch: &Map<String, Value>,
        settings: &S,
        sent: Tick,
    ) -> SettingsChange {
        let named = S::fields_of(patch).into_keys();
        let paths: BTreeSet<String> = named.chain(std::mem::take(&mut self.unfit)).collect();
        let earlier = paths.iter().map(|path| self.at(path)).max().unwrap_or_default();
        let at = sent.max(earlier.after(NEXT));
        let mut values = settings.fields();
        values.retain(|path, _| paths.contains(path));
        for (path, value) in &values {
            self.fields.insert(path.clone(), Change { at, value: value.clone() });
        }
        SettingsChange { at, fields: Value::Object(patch_of(&values)).to_string() }
    }

    /// The settings with all changes. Where they do not all fit together, the later ones count, and changes of operators more than
    /// what stands in files.
    pub(crate) fn applied_to<S: Settings>(&mut self, base: &S) -> S {
        self.unfit.clear();
        if self.fields.is_empty() {
            return base.clone();
        }
        let settings =
            base.patched(&Value::Object(self.patch())).unwrap_or_else(|_| self.latest(base));
        let values = settings.fields();
        for (path, change) in &mut self.fields {
            match values.get(path) {
                Some(value) if !self.unfit.contains(path) => change.value.clone_from(value),
                Some(_) => {}
                None => {
                    self.unfit.insert(path.clone());
                }
            }
        }
        settings
    }

    /// The settings with the changes one by one, the latest first, and at last with what makes the base differ from the defaults.
    /// What fits only together with an earlier change is tried again.
    fn latest<S: Settings>(&mut self, base: &S) -> S {
        let mut settings = S::default();
        let defaults = settings.fields();
        let mut base = base.fields();
        base.retain(|path, value| {
            defaults.get(path) != Some(value) && !self.fields.contains_key(path)
        });
        let changes = self.fields.iter().map(|(path, change)| (path, &change.value, change.at));
        let of_base = base.iter().map(|(path, value)| (path, value, Tick::default()));
        let mut left: Vec<(&String, &Value, Tick)> = changes.chain(of_base).collect();
        left.sort_by(|one, other| other.2.cmp(&one.2).then_with(|| one.0.cmp(other.0)));
        loop {
            let before = left.len();
            left.retain(|(path, value, _)| {
                let patched = settings.patched(&Value::Object(patch_of([(*path, *value)])));
                let is_left = patched.is_err();
                settings = patched.unwrap_or_else(|_| settings.clone());
                is_left
            });
            if left.len() == before {
                break;
            }
        }
        let unfit = left.into_iter().map(|(path, ..)| path.clone());
        self.unfit = unfit.filter(|path| self.fields.contains_key(path)).collect();
        settings
    }

    /// Forgets what is no setting of this program, or no value of it. Returns the paths. What only does not go together with the others
    /// is kept, as other instances keep it.
    pub(crate) fn drop_misfits<S: Settings>(&mut self) -> Vec<String> {
        let is_misfit = |path: &&String| {
            let alone = self.fields.get(*path).map(|change| patch_of([(*path, &change.value)]));
            alone.is_none_or(|alone| S::default().patched(&Value::Object(alone)).is_err())
        };
        let misfits: Vec<String> = self.unfit.iter().filter(is_misfit).cloned().collect();
        for path in &misfits {
            self.unfit.remove(path);
            self.fields.remove(path);
        }
        misfits
    }

    /// What is kept of the values.
    pub(crate) fn patch(&self) -> Map<String, Value> {
        patch_of(self.fields.iter().map(|(path, change)| (path, &change.value)))
    }

    /// When each field was changed that an operator has changed.
    pub(crate) fn dates(&self) -> BTreeMap<String, Tick> {
        let fields = self.fields.iter().filter(|(_, change)| change.at > Tick::default());
        fields.map(|(path, change)| (path.clone(), change.at)).collect()
    }

    /// The same of the changes that are in force.
    pub(crate) fn dates_in_force(&self) -> BTreeMap<String, Tick> {
        let mut dates = self.dates();
        dates.retain(|path, _| !self.unfit.contains(path));
        dates
    }
}

#[cfg(test)]
mod tests {
    use muster_model::settings::{ClustererSettings, TeamCount};
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    type Field = (&'static str, u64, Value);

    fn merged(fields: &[Field]) -> (Changes, ClustererSettings) {
        let mut changes = Changes::default();
        for (path, at, value) in fields {
            changes.merge(path, Tick(*at), value);
        }
        let settings = changes.applied_to(&ClustererSettings::default());
        (changes, settings)
    }

    fn field() -> impl Strategy<Value = Field> {
        let number = (prop::sample::select(vec!["size.min", "size.max"]), 1..6_u64, 1..6_u32);
        let count = (1..6_u64, 0..4_u32);
        prop_oneof![
            number.prop_map(|(path, at, value)| (path, at, json!(value))),
            count.prop_map(|(at, value)| ("teams", at, json!(value))),
            Just(("nothing", 3, json!({"a": 1}))),
        ]
    }

    proptest! {
        /// Sizes that exclude each other, a number of teams that no fleet has, and no setting at all are among them.
        #[test]
        fn all_end_with_the_same_settings_in_whatever_order_and_however_often_they_receive_changes(
            fields in prop::collection::vec(field(), 0..9),
            other in any::<u64>(),
        ) {
            let (changes, settings) = merged(&fields);
            let mut mixed: Vec<Field> = fields.iter().chain(&fields).cloned().collect();
            let places = mixed.len() as u64;
            for place in 0..mixed.len() {
                let with = other.rotate_left(u32::try_from(7 * place % 64).unwrap()) % places.max(1);
                mixed.swap(place, usize::try_from(with).unwrap());
            }
            prop_assert_eq!(&merged(&mixed), &(changes.clone(), settings.clone()));
            // So they do by way of what others announce.
            let (mut half, _) = merged(&fields[..fields.len() / 2]);
            let values = settings.fields();
            for (path, at) in changes.dates_in_force() {
                half.merge(&path, at, &values[&path]);
            }
            for (path, at, value) in &fields {
                half.merge(path, Tick(*at), value);
            }
            prop_assert_eq!(half.applied_to(&ClustererSettings::default()), settings);
        }
    }

    #[test]
    fn later_changes_count_where_they_do_not_go_together_with_earlier_ones() {
        let min = |at| ("size.min", at, json!(5));
        let max = |at| ("size.max", at, json!(2));
        let (changes, settings) = merged(&[min(1), max(2)]);
        assert_eq!((settings.size.min, settings.size.max), (None, Some(2)));
        assert_eq!(changes.dates_in_force().into_keys().collect::<Vec<_>>(), ["size.max"]);
        let (_, settings) = merged(&[min(2), max(1)]);
        assert_eq!((settings.size.min, settings.size.max), (Some(5), None));
        // An operator who changes anything then has seen the settings without the first.
        let (mut changes, settings) = merged(&[min(1), max(2)]);
        let patch = json!({"size": {"max": 7}}).as_object().unwrap().clone();
        let settings = settings.patched(&Value::Object(patch.clone())).unwrap();
        let change = changes.command(&patch, &settings, Tick(9));
        assert_eq!(changes.applied_to(&ClustererSettings::default()), settings);
        assert_eq!(settings.size.min, None);
        // So has whoever receives it, and knows the first alone.
        let (mut other, _) = merged(&[min(1)]);
        assert!(other.merge_change::<ClustererSettings>(&change));
        assert_eq!(other.applied_to(&ClustererSettings::default()), settings);
    }

    #[test]
    fn a_command_is_later_than_what_it_changes_and_says_nothing_of_the_rest() {
        let (mut changes, settings) =
            merged(&[("teams", 50, json!(3)), ("restarts", 90, json!(7))]);
        let patch = json!({"teams": 4}).as_object().unwrap().clone();
        let settings = settings.patched(&Value::Object(patch.clone())).unwrap();
        let change = changes.command(&patch, &settings, Tick(20));
        assert_eq!((change.at, change.fields.as_str()), (Tick(51), r#"{"teams":4}"#));
        assert_eq!((changes.at("teams"), changes.at("restarts")), (Tick(51), Tick(90)));
        assert!(!changes.merge("teams", Tick(50), &json!(9)));
        // What a leader has by its file replaces nothing that an operator has changed.
        changes.follow("teams", Some(&json!(5)));
        changes.follow("seed", Some(&json!(6)));
        let settings = changes.applied_to(&ClustererSettings::default());
        assert_eq!((settings.teams, settings.seed), (TeamCount::Fixed(4), 6));
        assert_eq!(changes.dates().len(), 2);
        changes.follow("seed", None);
        assert_eq!(changes.patch().len(), 2);
    }

    #[test]
    fn what_is_no_setting_is_not_kept() {
        let change =
            |at: u64, fields: &str| SettingsChange { at: Tick(at), fields: fields.to_owned() };
        let mut changes = Changes::default();
        for fields in [
            r#"{"nothing": 1}"#,
            r#"{"size": 3}"#,
            r#"{"size.min": 2}"#,
            r#"{"teams": {"a": 1}}"#,
            r#"{"seed": 1, "nothing": 1}"#,
            "[]",
            "",
        ] {
            assert!(!changes.merge_change::<ClustererSettings>(&change(5, fields)), "{fields}");
        }
        assert_eq!(changes, Changes::default());
        // A value is the same in whatever form it is written.
        assert!(changes.merge_change::<ClustererSettings>(&change(5, r#"{"teams": null}"#)));
        assert!(!changes.merge_change::<ClustererSettings>(&change(5, r#"{"teams": "auto"}"#)));
        assert!(changes.merge_change::<ClustererSettings>(&change(6, r#"{"size": {"min": 2}}"#)));
        assert_eq!(changes.applied_to(&ClustererSettings::default()).size.min, Some(2));
    }

    /// A leader has a file, and its standby has none.
    #[test]
    fn what_operators_change_counts_more_than_files() {
        let patch = json!({"size": {"max": 2}});
        let of_file = ClustererSettings::default().patched(&patch).unwrap();
        let (mut leader, _) = merged(&[("size.min", 1, json!(5))]);
        let mut standby = leader.clone();
        standby.follow("size.max", Some(&json!(2)));
        let settings = leader.applied_to(&of_file);
        assert_eq!((settings.size.min, settings.size.max), (Some(5), None));
        assert_eq!(standby.applied_to(&ClustererSettings::default()), settings);
    }

    #[test]
    fn what_is_stored_is_the_same_again() {
        let (mut changes, settings) =
            merged(&[("size.min", 7, json!(2)), ("teams", 8, Value::Null)]);
        changes.follow("seed", Some(&json!(6)));
        let mut again =
            Changes::stored::<ClustererSettings>(&changes.patch(), &changes.dates(), Tick(8));
        assert_eq!(again, changes);
        assert_eq!(again.applied_to(&ClustererSettings::default()).size, settings.size);
        let damaged =
            Changes::stored::<ClustererSettings>(&changes.patch(), &changes.dates(), Tick(7));
        assert_eq!((damaged.at("size.min"), damaged.at("teams")), (Tick(7), Tick(0)));
    }
}
