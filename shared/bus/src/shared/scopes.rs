//! Which fleets a shared bus receives, and which of those it means.

use std::collections::HashSet;

use muster_wire::FleetPattern;

/// Most patterns of fleets that have subscriptions of their own: a message is compared with each. Beyond them one
/// pattern is received that all fit, and what is not served is dropped.
pub const MAX_SCOPES: usize = 16;

/// The patterns that are received, each a scope with subscriptions of its own, and the fleets that are meant.
#[derive(Debug)]
pub(crate) struct Scopes {
    received: Vec<FleetPattern>,
    names: HashSet<String>,
    patterns: Vec<FleetPattern>,
}

impl Scopes {
    /// Those of the patterns that a process is to serve.
    pub(crate) fn new(patterns: &[FleetPattern]) -> Self {
        let names = patterns.iter().filter_map(FleetPattern::single);
        let several = patterns.iter().filter(|pattern| pattern.single().is_none());
        Self {
            received: received(patterns),
            names: names.map(|name| name.as_str().to_owned()).collect(),
            patterns: several.cloned().collect(),
        }
    }

    /// What is received.
    pub(crate) fn received(&self) -> impl Iterator<Item = &FleetPattern> {
        self.received.iter()
    }

    /// Whether the scope at a place is the one that receives a fleet. Where several fit, Zenoh hands a message to each.
    pub(crate) fn receive(&self, scope: usize, fleet: &str) -> bool {
        self.received.iter().position(|scope| scope.matches(fleet)) == Some(scope)
    }

    /// Whether a fleet that is received is meant.
    pub(crate) fn mean(&self, fleet: &str) -> bool {
        self.names.contains(fleet) || self.patterns.iter().any(|pattern| pattern.matches(fleet))
    }
}

/// Patterns that together mean every fleet that is meant, and perhaps others; not more than are received apart.
fn received(patterns: &[FleetPattern]) -> Vec<FleetPattern> {
    if patterns.len() <= MAX_SCOPES {
        return patterns.to_vec();
    }
    let texts: Vec<String> = patterns.iter().map(ToString::to_string).collect();
    let mut common = texts.first().map_or("", String::as_str);
    for text in &texts {
        let same = common.bytes().zip(text.bytes()).take_while(|(left, right)| left == right);
        common = &common[..same.count()];
    }
    // What stands behind a star is no beginning of names.
    let prefix = common.split('*').next().unwrap_or_default();
    vec![FleetPattern::beginning_with(prefix)]
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    fn patterns(texts: &[&str]) -> Vec<FleetPattern> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    }

    #[test]
    fn few_patterns_are_received_apart_and_many_by_what_they_begin_with() {
        let few = patterns(&["a", "b-*"]);
        assert_eq!(received(&few), few);
        let named = |prefix: &str| -> Vec<String> {
            (0..=MAX_SCOPES).map(|at| format!("{prefix}{at}")).collect()
        };
        let many = |names: &[String]| {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            received(&patterns(&names))
        };
        assert_eq!(many(&named("site-")), patterns(&["site-*"]));
        assert_eq!(many(&[named("site-"), named("x")].concat()), patterns(&["*"]));
        assert_eq!(
            many(&[named("site-"), vec!["site-*-x".into()]].concat()),
            patterns(&["site-*"])
        );
    }

    #[test]
    fn one_scope_receives_a_fleet_and_not_all_that_are_received_are_meant() {
        let overlapping = Scopes::new(&patterns(&["site-*", "site-1", "*-1", "site-*"]));
        for (fleet, scope) in
            [("site-1", Some(0)), ("site-2", Some(0)), ("a-1", Some(2)), ("b", None)]
        {
            let receiving: Vec<usize> =
                (0..4).filter(|scope| overlapping.receive(*scope, fleet)).collect();
            assert_eq!(receiving.first().copied(), scope, "{fleet}");
            assert!(receiving.len() < 2, "{fleet}");
            assert_eq!(overlapping.mean(fleet), scope.is_some(), "{fleet}");
        }
        let names: Vec<String> = (0..=MAX_SCOPES).map(|at| format!("site-{at}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let many = Scopes::new(&patterns(&names));
        assert!(many.receive(0, "site-x") && !many.mean("site-x") && many.mean("site-3"));
    }
}
