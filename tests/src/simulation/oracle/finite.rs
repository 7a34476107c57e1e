//! No number that is published is infinite or none at all.
//!
//! A serializer that writes nothing walks every field of a message, those of tomorrow too.

use std::fmt::{self, Display};

use muster_wire::Message;
use serde::ser::{
    self, Serialize, SerializeMap, SerializeSeq, SerializeStruct, SerializeStructVariant,
    SerializeTuple, SerializeTupleStruct, SerializeTupleVariant,
};

use super::{Verified, breach};

/// Checks every number of a message.
pub(crate) fn check(message: &Message) -> Verified {
    let walked = match message {
        Message::RobotToken { .. } | Message::ServiceToken { .. } => Ok(()),
        // Texts and whole numbers.
        Message::Refused(_) => Ok(()),
        Message::Report(report) => report.report().serialize(Walker),
        Message::RobotTeam(team) => team.serialize(Walker),
        Message::Graph(delta) => delta.serialize(Walker),
        Message::Roster(roster) => roster.serialize(Walker),
        Message::Embedding(embedding) => embedding.serialize(Walker),
        Message::Teams { teams, .. } => teams.serialize(Walker),
        Message::Katz(pair) => pair.serialize(Walker),
        Message::Audit(audit) => audit.serialize(Walker),
        Message::Event(event) => event.serialize(Walker),
        Message::LeaseRenewal(claim) => claim.serialize(Walker),
        Message::Settings(announced) => announced.serialize(Walker),
        Message::Status(status) => status.serialize(Walker),
        Message::History(answer) => answer.serialize(Walker),
        Message::HistoryState(state) => state.serialize(Walker),
        Message::Alerts(alerts) => alerts.serialize(Walker),
        Message::Wishes(list) => list.serialize(Walker),
        Message::Wish(report) => report.wish.serialize(Walker),
        Message::Outcome(outcome) => outcome.serialize(Walker),
        Message::Why(why) => why.reason.serialize(Walker),
        Message::Proposal(report) => report.proposal.serialize(Walker),
    };
    match walked {
        Ok(()) => Ok(()),
        Err(Found(what)) => breach(
            "every number that is published is finite",
            format!("{}: {what}", message.keys().0),
        ),
    }
}

/// What was found.
#[derive(Debug)]
struct Found(String);

impl Display for Found {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl std::error::Error for Found {}

impl ser::Error for Found {
    fn custom<T: Display>(text: T) -> Self {
        Self(text.to_string())
    }
}

/// Walks a value.
#[derive(Clone, Copy)]
struct Walker;

macro_rules! nothing {
    ($($name:ident: $type:ty),*) => {
        $(fn $name(self, _: $type) -> Result<(), Found> {
            Ok(())
        })*
    };
}

impl ser::Serializer for Walker {
    type Ok = ();
    type Error = Found;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Self;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    nothing!(
        serialize_bool: bool, serialize_i8: i8, serialize_i16: i16, serialize_i32: i32,
        serialize_i64: i64, serialize_u8: u8, serialize_u16: u16, serialize_u32: u32,
        serialize_u64: u64, serialize_char: char, serialize_str: &str, serialize_bytes: &[u8],
        serialize_unit_struct: &'static str
    );

    fn serialize_f32(self, value: f32) -> Result<(), Found> {
        self.serialize_f64(f64::from(value))
    }

    fn serialize_f64(self, value: f64) -> Result<(), Found> {
        if value.is_finite() { Ok(()) } else { Err(Found(value.to_string())) }
    }

    fn serialize_none(self) -> Result<(), Found> {
        Ok(())
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), Found> {
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result<(), Found> {
        Ok(())
    }

    fn serialize_unit_variant(self, _: &'static str, _: u32, _: &'static str) -> Result<(), Found> {
        Ok(())
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), Found> {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        value: &T,
    ) -> Result<(), Found> {
        value.serialize(self)
    }

    fn serialize_seq(self, _: Option<usize>) -> Result<Self, Found> {
        Ok(self)
    }

    fn serialize_tuple(self, _: usize) -> Result<Self, Found> {
        Ok(self)
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, Found> {
        Ok(self)
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Found> {
        Ok(self)
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Self, Found> {
        Ok(self)
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, Found> {
        Ok(self)
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Found> {
        Ok(self)
    }
}

macro_rules! elements {
    ($($part:ident $method:ident),*) => {
        $(impl $part for Walker {
            type Ok = ();
            type Error = Found;

            fn $method<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), Found> {
                value.serialize(*self)
            }

            fn end(self) -> Result<(), Found> {
                Ok(())
            }
        })*
    };
}

elements!(
    SerializeSeq serialize_element, SerializeTuple serialize_element,
    SerializeTupleStruct serialize_field, SerializeTupleVariant serialize_field
);

macro_rules! fields {
    ($($part:ident),*) => {
        $(impl $part for Walker {
            type Ok = ();
            type Error = Found;

            fn serialize_field<T: Serialize + ?Sized>(
                &mut self,
                name: &'static str,
                value: &T,
            ) -> Result<(), Found> {
                value.serialize(*self).map_err(|Found(what)| Found(format!("{name}: {what}")))
            }

            fn end(self) -> Result<(), Found> {
                Ok(())
            }
        })*
    };
}

fields!(SerializeStruct, SerializeStructVariant);

impl SerializeMap for Walker {
    type Ok = ();
    type Error = Found;

    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), Found> {
        key.serialize(*self)
    }

    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), Found> {
        value.serialize(*self)
    }

    fn end(self) -> Result<(), Found> {
        Ok(())
    }
}
