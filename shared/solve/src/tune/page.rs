//! What a search has found, as JSON and to read.

use comfy_table::presets::UTF8_BORDERS_ONLY;
use comfy_table::{Cell, CellAlignment, Table};
use muster_model::settings::{Alpha, Dimension};
use serde_json::{Value, json};

use super::{Tuned, Tuning};

impl Tuning {
    /// One JSON object: what is in force, the best of the grid, and what is proposed (null for what is in force).
    #[must_use]
    pub fn to_json(&self) -> Value {
        json!({
            "robots": self.robots,
            "teams": self.teams,
            "scored": self.scored,
            "present": entry(&self.present),
            "best": self.best.iter().map(entry).collect::<Vec<_>>(),
            "proposed": self.proposed().map(Self::patch),
        })
    }

    /// A table, and what to do.
    #[must_use]
    pub fn summary(&self) -> String {
        let mut table = Table::new();
        table.load_style(UTF8_BORDERS_ONLY);
        let shown = std::iter::once(&self.present).chain(&self.best);
        let mut modalities: Vec<_> =
            shown.flat_map(|tuned| tuned.settings.weights.keys()).collect();
        modalities.sort();
        modalities.dedup();
        let names = modalities.iter().map(|name| name.to_string());
        let head = ["", "alpha", "dimension", "silhouette", "stability", "moved"];
        let (first, rest) = head.split_at(1);
        let rest = rest.iter().map(|name| (*name).to_owned());
        table.set_header(first.iter().map(|name| (*name).to_owned()).chain(names).chain(rest));
        let proposed = self.proposed();
        for (tuned, is_present) in
            std::iter::once((&self.present, true)).chain(self.best.iter().map(|of| (of, false)))
        {
            let is_proposed = proposed.is_some_and(|other| std::ptr::eq(other, tuned));
            let mark = match (is_present, is_proposed) {
                (true, _) => "in force",
                (_, true) => "proposed",
                _ => "",
            };
            let right = |text: String| Cell::new(text).set_alignment(CellAlignment::Right);
            let weight = |name: &&_| tuned.settings.weights.get(*name).copied().unwrap_or(0.0);
            let weights = modalities.iter().map(|name| right(format!("{:.2}", weight(name))));
            let alpha = match tuned.settings.alpha {
                Alpha::Fraction { fraction } => format!("{fraction}/ρ"),
                Alpha::Value(alpha) => alpha.to_string(),
            };
            let dimension = match tuned.settings.dimension {
                Dimension::Auto => "auto".to_owned(),
                Dimension::Fixed(dimension) => dimension.to_string(),
            };
            let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3}"));
            let rest = [
                alpha,
                dimension,
                number(tuned.silhouette),
                number(tuned.stability),
                tuned.moved.to_string(),
            ];
            let cells = std::iter::once(Cell::new(mark)).chain(weights);
            table.add_row(cells.chain(rest.map(right)));
        }
        let advice = match proposed {
            Some(tuned) => format!(
                "proposed: its division has better silhouettes, is as stable, and moves {} of {} robots.\n\
                 muster set embedder '{}'",
                tuned.moved,
                self.robots,
                arguments(tuned)
            ),
            None => "the settings in force are the best: no other is as stable and has better \
                     silhouettes"
                .to_owned(),
        };
        format!(
            "{} robots in {} teams; {} settings scored, the best {} divisions shown\n{table}\n{advice}\n",
            self.robots,
            self.teams,
            self.scored,
            self.best.len()
        )
    }
}

/// A setting as arguments of `muster set embedder`.
fn arguments(tuned: &Tuned) -> String {
    let patch = Tuning::patch(tuned);
    let fields = patch.as_object().into_iter().flatten();
    fields.map(|(field, value)| format!("{field}={value}")).collect::<Vec<_>>().join("' '")
}

fn entry(tuned: &Tuned) -> Value {
    json!({
        "settings": Tuning::patch(tuned),
        "silhouette": tuned.silhouette,
        "stability": tuned.stability,
        "moved": tuned.moved,
        "largest_team": tuned.largest_team(),
        "unassigned": tuned.unassigned(),
    })
}
