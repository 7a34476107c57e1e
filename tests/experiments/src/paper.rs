//! The numbers of the paper's tables.

/// Accuracy in percent and mean silhouette of each method in Scenario I.
const ACCURACY: &str = include_str!("../paper/scenario1_accuracy.csv");

/// Silhouettes of Scenario II, by robots and teams.
const SYSTEMS: &str = include_str!("../paper/scenario2_silhouette.csv");

/// Silhouettes of Scenario I, by formation and teams.
const FORMATIONS: &str = include_str!("../paper/scenario1_silhouette.csv");

/// Those of four teams, which are in the paper's source but not printed.
const UNPRINTED: &str = include_str!("../paper/scenario1_silhouette_unprinted.csv");

/// Accuracy of HOPE on the spatial graph without noise, from 0 to 1, as the paper's text states it: squads and
/// platoons, whose robots are 3 · (8 + 9) and 3 · (27 + 29 + 29).
pub const HOPE_WITHOUT_NOISE: [(f64, usize); 2] = [(0.7647, 51), (0.8824, 255)];

/// The robots of all formations and divisions that count.
pub const ROBOTS: usize = 306;

/// The name of a method of ours in the paper's table of Scenario I; none for those that it does not have.
fn in_scenario_one(method: &str) -> Option<String> {
    let named = |start: &str, theirs: &str| {
        method
            .strip_prefix(start)?
            .strip_suffix(')')
            .map(|modality| format!("{theirs} ({modality})"))
    };
    match method {
        "multimodal, plain" => Some("our approach".to_owned()),
        _ => named("GN (", "gn")
            .or_else(|| named("LLE (", "lle"))
            .or_else(|| named("HOPE (", "hope")),
    }
}

/// Accuracy, from 0 to 1, and mean silhouette that the paper prints for a method in Scenario I.
#[must_use]
pub fn scenario_one(method: &str) -> Option<(f64, f64)> {
    let wanted = in_scenario_one(method)?;
    ACCURACY.lines().skip(1).find_map(|line| {
        let mut cells = line.split(',');
        let words: Vec<&str> = cells.next()?.split_whitespace().collect();
        let (accuracy, silhouette) = (cells.next()?.parse::<f64>(), cells.next()?.parse().ok()?);
        (words.join(" ").to_lowercase() == wanted).then_some((accuracy.ok()? / 100.0, silhouette))
    })
}

/// The mean silhouette that the paper prints for a method in Scenario II.
#[must_use]
pub fn scenario_two(robots: usize, teams: usize, method: &str) -> Option<f64> {
    let column = column(SYSTEMS, method)?;
    SYSTEMS.lines().skip(1).find_map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        let is_asked = cells.first()?.parse() == Ok(robots) && cells.get(1)?.parse() == Ok(teams);
        is_asked.then(|| cells.get(column)?.parse().ok()).flatten()
    })
}

/// The column of a method in a table of silhouettes.
fn column(table: &str, method: &str) -> Option<usize> {
    let name = match method {
        "multimodal, plain" => "multimodal".to_owned(),
        _ => method.to_lowercase().replace(" (", "_").replace(')', ""),
    };
    table.lines().next()?.split(',').position(|column| column == name)
}

/// The silhouettes of a method in Scenario I, of all rows that are printed and of those that are not; empty for
/// methods that the paper does not have.
#[must_use]
pub fn scenario_one_silhouettes(method: &str) -> [Vec<f64>; 2] {
    [FORMATIONS, UNPRINTED].map(|table| {
        let Some(column) = column(table, method) else { return Vec::new() };
        let cells = table.lines().skip(1).filter_map(|line| line.split(',').nth(column));
        cells.filter_map(|cell| cell.parse().ok()).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_are_found_by_our_names() {
        assert_eq!(scenario_one("GN (spatial)"), Some((0.3922, -0.012)));
        assert_eq!(scenario_one("HOPE (concatenated)"), Some((0.9314, 0.518)));
        assert_eq!(scenario_one("multimodal, plain"), Some((0.9673, 0.680)));
        assert_eq!(scenario_one("muster"), None);
        assert_eq!(scenario_two(10, 5, "LLE (hierarchy)"), Some(0.03));
        assert_eq!(scenario_two(50, 4, "multimodal, plain"), Some(0.71));
        assert_eq!(scenario_two(50, 4, "GN (spatial)"), None);
        assert_eq!(scenario_two(60, 4, "LLE (hierarchy)"), None);
        let [printed, unprinted] = scenario_one_silhouettes("multimodal, plain");
        assert_eq!((printed.len(), printed[0]), (12, 0.763));
        assert_eq!(unprinted, [0.864, 0.879, 0.882]);
        assert!(scenario_one_silhouettes("muster").iter().all(Vec::is_empty));
    }
}
