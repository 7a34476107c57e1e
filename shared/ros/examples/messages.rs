//! Reads, writes and makes up messages, for `tests/peers/check_ros.py`.
//!
//! Each line of standard input is a request in JSON, each line of the answer its result:
//! - `{"define": TYPE, "text": TEXT}` adds definitions: `{}`;
//! - `{"hash": TYPE}`: `{"hash": HASH}`;
//! - `{"types": true}`: `{"types": [TYPE, …]}`, those that are built in;
//! - `{"read": TYPE, "bytes": HEX}`: `{"value": VALUE, "little": HEX, "big": HEX}`;
//! - `{"random": TYPE, "seed": NUMBER}`: the same of a message that is made up.
//!
//! What is refused is answered with `{"error": TEXT}`. A value is an object by field, a float is its digits as text.

#[path = "../tests/random/mod.rs"]
mod random;

use std::error::Error;
use std::fmt::Write as _;
use std::io::{BufRead, Write};
use std::sync::Arc;

use muster_ros::cdr::{decode, encode};
use muster_ros::definition::Element;
use muster_ros::{ByteOrder, Catalog, Layout, TypeHash, TypeName, Value};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::{Map, json};

type Json = serde_json::Value;

fn main() -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let standard: Vec<_> = Catalog::standard().types().map(TypeName::to_string).collect();
    let mut catalog = Catalog::standard();
    for line in std::io::stdin().lock().lines() {
        let request: Json = serde_json::from_str(&line?)?;
        let answer = if request["types"] == json!(true) {
            json!({ "types": standard })
        } else {
            let answered = answer(&mut catalog, &request);
            answered.unwrap_or_else(|error| json!({ "error": error.to_string() }))
        };
        writeln!(out, "{answer}")?;
    }
    Ok(())
}

fn answer(catalog: &mut Catalog, request: &Json) -> Result<Json, Box<dyn Error>> {
    let text = |name: &str| request[name].as_str();
    if let Some(name) = text("define") {
        catalog.add(&TypeName::parse(name)?, text("text").ok_or("text is missing")?)?;
        return Ok(json!({}));
    }
    let find = |name: &str| -> Result<Arc<Layout>, Box<dyn Error>> {
        Ok(catalog.layout(&TypeName::parse(name)?)?)
    };
    if let Some(name) = text("hash") {
        return Ok(json!({ "hash": TypeHash::of(&*find(name)?).to_string() }));
    }
    if let Some(name) = text("random") {
        let layout = find(name)?;
        let seed = request["seed"].as_u64().ok_or("seed is missing")?;
        let value = random::message(&layout, &mut ChaCha8Rng::seed_from_u64(seed));
        return written(&layout, &value);
    }
    let layout = find(text("read").ok_or("this is no request")?)?;
    let value = decode(&layout, &from_hex(text("bytes").ok_or("bytes are missing")?)?)?;
    written(&layout, &value)
}

fn written(layout: &Layout, value: &Value) -> Result<Json, Box<dyn Error>> {
    let little = encode(layout, value, ByteOrder::Little)?;
    let big = encode(layout, value, ByteOrder::Big)?;
    Ok(json!({
        "value": message(layout, value),
        "little": to_hex(&little),
        "big": to_hex(&big),
    }))
}

fn message(layout: &Layout, value: &Value) -> Json {
    let Value::Struct(values) = value else { return Json::Null };
    let fields = layout.fields().iter().zip(values);
    let fields = fields.map(|(field, value)| {
        let shown = match value {
            Value::List(values) => {
                values.iter().map(|value| one(&field.kind.element, value)).collect()
            }
            Value::Bytes(bytes) => json!(bytes),
            value => one(&field.kind.element, value),
        };
        (field.name.clone(), shown)
    });
    Json::Object(fields.collect::<Map<_, _>>())
}

fn one(element: &Element<Arc<Layout>>, value: &Value) -> Json {
    match (element, value) {
        (Element::Nested(layout), value) => message(layout, value),
        (_, Value::Bool(value)) => json!(value),
        (_, Value::Int(value)) => json!(value),
        (_, Value::Uint(value)) => json!(value),
        (_, Value::F32(value)) => json!(f64::from(*value).to_string()),
        (_, Value::F64(value)) => json!(value.to_string()),
        (_, Value::Text(text)) => json!(text),
        _ => Json::Null,
    }
}

fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a text does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn from_hex(text: &str) -> Result<Vec<u8>, Box<dyn Error>> {
    let pairs = text.as_bytes().chunks(2);
    pairs.map(|pair| Ok(u8::from_str_radix(std::str::from_utf8(pair)?, 16)?)).collect()
}
