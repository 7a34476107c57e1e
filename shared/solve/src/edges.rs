//! The edges of a graph as a file lists them.
//!
//! A large file names each robot a dozen times. Every name is checked and kept once, and an edge holds
//! numbers.

use std::collections::HashMap;
use std::fmt;

use muster_model::id::RobotId;
use serde::de::{DeserializeSeed, Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

/// Edges in the order of the file.
#[derive(Debug, Default)]
pub(super) struct Edges {
    /// The names that occur, in the order in which they first do.
    pub(super) names: Vec<RobotId>,
    /// From and to, by the places of their names, and the weight.
    pub(super) list: Vec<(u32, u32, f64)>,
}

impl<'de> Deserialize<'de> for Edges {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(ListVisitor)
    }
}

struct ListVisitor;

impl<'de> Visitor<'de> for ListVisitor {
    type Value = Edges;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a list of edges, [from, to, weight] each")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Edges, A::Error> {
        let mut edges = Edges::default();
        let mut places = HashMap::new();
        loop {
            let names = Names { names: &mut edges.names, places: &mut places };
            let Some(edge) = list.next_element_seed(EdgeSeed(names))? else { return Ok(edges) };
            edges.list.push(edge);
        }
    }
}

/// The names so far, and the place of each.
struct Names<'a> {
    names: &'a mut Vec<RobotId>,
    places: &'a mut HashMap<Box<str>, u32>,
}

/// Reads one edge.
struct EdgeSeed<'a>(Names<'a>);

impl<'de> DeserializeSeed<'de> for EdgeSeed<'_> {
    type Value = (u32, u32, f64);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_tuple(3, self)
    }
}

impl<'de> Visitor<'de> for EdgeSeed<'_> {
    type Value = (u32, u32, f64);

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("an edge [from, to, weight]")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut parts: A) -> Result<Self::Value, A::Error> {
        let lacks = |count| A::Error::invalid_length(count, &"an edge [from, to, weight]");
        let from = parts.next_element_seed(NameSeed(&mut self.0))?.ok_or_else(|| lacks(0))?;
        let to = parts.next_element_seed(NameSeed(&mut self.0))?.ok_or_else(|| lacks(1))?;
        let weight = parts.next_element()?.ok_or_else(|| lacks(2))?;
        Ok((from, to, weight))
    }
}

/// Reads one name, to its place.
struct NameSeed<'a, 'b>(&'a mut Names<'b>);

impl<'de> DeserializeSeed<'de> for NameSeed<'_, '_> {
    type Value = u32;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<u32, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for NameSeed<'_, '_> {
    type Value = u32;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("the name of a robot")
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<u32, E> {
        let Names { names, places } = self.0;
        if let Some(place) = places.get(text) {
            return Ok(*place);
        }
        let name = RobotId::new(text).map_err(E::custom)?;
        let place = u32::try_from(names.len()).map_err(E::custom)?;
        places.insert(text.into(), place);
        names.push(name);
        Ok(place)
    }
}
