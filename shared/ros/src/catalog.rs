//! Definitions of message types by their names, and their layouts.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::cdr::MAX_MESSAGE_BYTES;
use crate::definition::{self, Definition, DefinitionError, Element, FieldType};
use crate::layout::{Field, Layout};
use crate::name::TypeName;
use crate::standard;

/// Most types of one catalog. All of ROS together have fewer.
pub const MAX_TYPES: usize = 2048;

/// How deep types may be made of types. Those of ROS reach six.
pub const MAX_DEPTH: usize = 16;

/// Why a type has no layout.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// Nothing defines the type.
    #[error("{name} is not defined{}", by(.wanted_by.as_ref()))]
    Unknown {
        /// The type.
        name: TypeName,
        /// The type that is made of it, if another one is asked for.
        wanted_by: Option<TypeName>,
    },
    /// Types are made of each other in a circle, or deeper than [`MAX_DEPTH`].
    #[error("{0} is made of itself, or of types more than {MAX_DEPTH} deep")]
    TooDeep(TypeName),
    /// Arrays make each message larger than is read.
    #[error("each {0} has more than {MAX_MESSAGE_BYTES} bytes")]
    TooLarge(TypeName),
}

fn by(wanted_by: Option<&TypeName>) -> String {
    wanted_by.map_or_else(String::new, |name| format!(", of which {name} is made"))
}

/// Why definitions are not added.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CatalogError {
    /// The text is wrong.
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    /// The type is defined already, with other fields.
    #[error("{0} is defined already, with other fields")]
    Conflict(TypeName),
    /// There are [`MAX_TYPES`] already.
    #[error("there are {MAX_TYPES} types already")]
    Full,
}

/// Definitions of message types by their names.
#[derive(Debug, Clone, Default)]
pub struct Catalog {
    definitions: BTreeMap<TypeName, Definition>,
}

impl Catalog {
    /// The messages that most fleets use; see [`standard`].
    ///
    /// # Panics
    /// Never: a test reads every text.
    #[must_use]
    pub fn standard() -> Self {
        let mut catalog = Self::default();
        for (name, text) in standard::DEFINITIONS {
            let added = TypeName::parse(name).map(|name| catalog.add(&name, text));
            debug_assert!(matches!(added, Ok(Ok(()))), "{name}: {added:?}");
        }
        catalog
    }

    /// Adds the definition of a type, and those that follow it in the text after separators. What is defined already
    /// may come again, with the same fields.
    ///
    /// # Errors
    /// Says what is wrong, and adds nothing.
    pub fn add(&mut self, name: &TypeName, text: &str) -> Result<(), CatalogError> {
        let definitions = definition::parse(name, text)?;
        for new in &definitions {
            let known = self.definitions.get(&new.name);
            if known.is_some_and(|known| !has_same_fields(known, new)) {
                return Err(CatalogError::Conflict(new.name.clone()));
            }
        }
        if self.definitions.len() + definitions.len() > MAX_TYPES {
            return Err(CatalogError::Full);
        }
        for new in definitions {
            self.definitions.entry(new.name.clone()).or_insert(new);
        }
        Ok(())
    }

    /// The types that are defined, sorted by name.
    pub fn types(&self) -> impl Iterator<Item = &TypeName> {
        self.definitions.keys()
    }

    /// Whether a type is defined.
    #[must_use]
    pub fn knows(&self, name: &TypeName) -> bool {
        self.definitions.contains_key(name)
    }

    /// The layout of a type.
    ///
    /// # Errors
    /// If it, or a type that it is made of, is not defined, made of itself, or too large.
    pub fn layout(&self, name: &TypeName) -> Result<Arc<Layout>, LayoutError> {
        self.resolve(name, None, 0, &mut BTreeMap::new())
    }

    fn resolve(
        &self,
        name: &TypeName,
        wanted_by: Option<&TypeName>,
        depth: usize,
        resolved: &mut BTreeMap<TypeName, Arc<Layout>>,
    ) -> Result<Arc<Layout>, LayoutError> {
        if let Some(layout) = resolved.get(name) {
            return Ok(Arc::clone(layout));
        }
        if depth >= MAX_DEPTH {
            return Err(LayoutError::TooDeep(name.clone()));
        }
        let definition = self.definitions.get(name).ok_or_else(|| LayoutError::Unknown {
            name: name.clone(),
            wanted_by: wanted_by.cloned(),
        })?;
        let mut fields = Vec::with_capacity(definition.fields.len());
        for field in &definition.fields {
            let element = match &field.kind.element {
                Element::Primitive(primitive) => Element::Primitive(*primitive),
                Element::Text { is_wide, bound } => {
                    Element::Text { is_wide: *is_wide, bound: *bound }
                }
                Element::Nested(nested) => {
                    Element::Nested(self.resolve(nested, Some(name), depth + 1, resolved)?)
                }
            };
            let kind = FieldType { element, arity: field.kind.arity };
            fields.push(Field::new(field.name.clone(), kind, field.default.clone()));
        }
        let layout = Layout::new(name.clone(), fields);
        if layout.min_bytes() > MAX_MESSAGE_BYTES {
            return Err(LayoutError::TooLarge(name.clone()));
        }
        let layout = Arc::new(layout);
        resolved.insert(name.clone(), Arc::clone(&layout));
        Ok(layout)
    }
}

fn has_same_fields(one: &Definition, other: &Definition) -> bool {
    let fields = |definition: &Definition| {
        let fields = definition.fields.iter();
        fields.map(|field| (field.name.clone(), field.kind.clone())).collect::<Vec<_>>()
    };
    fields(one) == fields(other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::PLACEHOLDER;
    use crate::value::Value;

    fn name(text: &str) -> TypeName {
        TypeName::parse(text).unwrap()
    }

    #[test]
    fn every_standard_message_has_a_layout() {
        let catalog = Catalog::standard();
        assert_eq!(catalog.types().count(), standard::DEFINITIONS.len());
        for known in catalog.types() {
            catalog.layout(known).unwrap();
        }
    }

    #[test]
    fn what_is_not_defined_is_named_with_who_wants_it() {
        let mut catalog = Catalog::default();
        catalog.add(&name("a/A"), "b/B[] more").unwrap();
        let error = catalog.layout(&name("a/A")).unwrap_err();
        assert_eq!(error.to_string(), "b/msg/B is not defined, of which a/msg/A is made");
        assert_eq!(catalog.layout(&name("c/C")).unwrap_err().to_string(), "c/msg/C is not defined");
    }

    #[test]
    fn circles_depth_and_size_are_bounded() {
        let mut catalog = Catalog::default();
        catalog.add(&name("a/A"), "A[] more").unwrap();
        assert!(matches!(catalog.layout(&name("a/A")), Err(LayoutError::TooDeep(_))));
        for depth in 0..MAX_DEPTH {
            catalog.add(&name(&format!("a/D{depth}")), &format!("D{} more", depth + 1)).unwrap();
        }
        catalog.add(&name(&format!("a/D{MAX_DEPTH}")), "bool last").unwrap();
        assert!(catalog.layout(&name("a/D1")).is_ok());
        assert!(matches!(catalog.layout(&name("a/D0")), Err(LayoutError::TooDeep(_))));
        catalog.add(&name("a/Many"), "float64[1048576] x").unwrap();
        catalog.add(&name("a/More"), "Many[1048576] x").unwrap();
        for large in ["a/Many", "a/More"] {
            assert!(
                matches!(catalog.layout(&name(large)), Err(LayoutError::TooLarge(_))),
                "{large}"
            );
        }
    }

    #[test]
    fn what_is_defined_stays_as_it_is() {
        let mut catalog = Catalog::standard();
        let point = name("geometry_msgs/Point");
        catalog.add(&point, "float64 x 7\nfloat64 y\nfloat64 z").unwrap();
        let other = catalog.add(&point, "float32 x\nfloat32 y\nfloat32 z");
        assert_eq!(other, Err(CatalogError::Conflict(point)));
    }

    #[test]
    fn an_empty_type_has_a_placeholder_and_defaults_are_initial_values() {
        let mut catalog = Catalog::default();
        catalog.add(&name("a/Empty"), "int8 SIX=6").unwrap();
        let empty = catalog.layout(&name("a/Empty")).unwrap();
        assert_eq!(empty.fields()[0].name, PLACEHOLDER);
        catalog.add(&name("a/D"), "int8 x -3\nuint8[2] b [1, 2]\nbool[2] f\nstring s 'q'").unwrap();
        let initial = catalog.layout(&name("a/D")).unwrap().initial();
        let list = Value::List(vec![Value::Bool(false), Value::Bool(false)]);
        let expected = vec![Value::Int(-3), Value::Bytes(vec![1, 2]), list, Value::from("q")];
        assert_eq!(initial, Value::Struct(expected));
    }
}
