//! A value whose numbers and texts stand in place of those of its layout.

use serde::de::value::{BorrowedStrDeserializer, MapAccessDeserializer};
use serde::de::{self, DeserializeOwned, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde::forward_to_deserialize_any;
use serde_json::{Map, Value};

/// Reads the value with this layout whose numbers and then texts are `content`; `None` if there are more of
/// them than the layout has.
pub(in crate::store) fn read<T: DeserializeOwned>(
    layout: &Value,
    content: &[u8],
) -> Result<Option<T>, serde_json::Error> {
    let (numbers, texts) = content.split_at_checked(8 * count(layout)).unwrap_or((content, &[]));
    let mut content = Content { numbers, texts };
    let value = T::deserialize(Filled { layout, content: &mut content })?;
    Ok((content.numbers.is_empty() && content.texts.is_empty()).then_some(value))
}

/// Number of floating-point numbers in a layout.
fn count(layout: &Value) -> usize {
    match layout {
        Value::Number(number) => usize::from(number.is_f64()),
        Value::Array(items) => items.iter().map(count).sum(),
        Value::Object(entries) => entries.values().map(count).sum(),
        _ => 0,
    }
}

/// The numbers and texts of a value that are not read yet.
struct Content<'a> {
    numbers: &'a [u8],
    texts: &'a [u8],
}

impl<'a> Content<'a> {
    fn number(&mut self) -> Result<f64, serde_json::Error> {
        let (number, rest) = self.numbers.split_first_chunk().ok_or_else(too_short)?;
        self.numbers = rest;
        Ok(f64::from_le_bytes(*number))
    }

    fn text(&mut self) -> Result<&'a str, serde_json::Error> {
        let (length, rest) = self.texts.split_first_chunk().ok_or_else(too_short)?;
        let (text, rest) =
            rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or_else(too_short)?;
        self.texts = rest;
        std::str::from_utf8(text).map_err(de::Error::custom)
    }
}

fn too_short() -> serde_json::Error {
    de::Error::custom("fewer numbers and texts than its layout has")
}

/// A value whose numbers and texts stand in place of those of its layout.
struct Filled<'a, 'c> {
    layout: &'a Value,
    content: &'c mut Content<'a>,
}

impl<'de> Deserializer<'de> for Filled<'de, '_> {
    type Error = serde_json::Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        match self.layout {
            Value::Number(number) if number.is_f64() => visitor.visit_f64(self.content.number()?),
            Value::String(_) => visitor.visit_borrowed_str(self.content.text()?),
            Value::Array(items) => visitor.visit_seq(Items { items: items.iter(), content: self.content }),
            Value::Object(entries) => visitor.visit_map(Entries::of(entries, self.content)),
            other => other.deserialize_any(visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        match self.layout {
            Value::Null => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        match self.layout {
            Value::String(_) => visitor.visit_enum(BorrowedStrDeserializer::new(self.content.text()?)),
            Value::Object(entries) => {
                visitor.visit_enum(MapAccessDeserializer::new(Entries::of(entries, self.content)))
            }
            other => other.deserialize_enum(name, variants, visitor),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        visitor.visit_newtype_struct(self)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct
        seq tuple tuple_struct map struct identifier ignored_any
    }
}

struct Items<'a, 'c> {
    items: std::slice::Iter<'a, Value>,
    content: &'c mut Content<'a>,
}

impl<'de> SeqAccess<'de> for Items<'de, '_> {
    type Error = serde_json::Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Self::Error> {
        let Some(layout) = self.items.next() else { return Ok(None) };
        seed.deserialize(Filled { layout, content: self.content }).map(Some)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.items.len())
    }
}

struct Entries<'a, 'c> {
    entries: serde_json::map::Iter<'a>,
    /// The layout of the value whose name was read last.
    layout: &'a Value,
    content: &'c mut Content<'a>,
}

impl<'a, 'c> Entries<'a, 'c> {
    fn of(entries: &'a Map<String, Value>, content: &'c mut Content<'a>) -> Self {
        Self { entries: entries.iter(), layout: &Value::Null, content }
    }
}

impl<'de> MapAccess<'de> for Entries<'de, '_> {
    type Error = serde_json::Error;

    fn next_key_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Self::Error> {
        let Some((name, layout)) = self.entries.next() else { return Ok(None) };
        self.layout = layout;
        seed.deserialize(BorrowedStrDeserializer::new(name)).map(Some)
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, Self::Error> {
        seed.deserialize(Filled { layout: self.layout, content: self.content })
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.entries.len())
    }
}
