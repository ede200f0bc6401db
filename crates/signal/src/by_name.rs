//! Values by name.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Index;

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde::ser::{Serialize, Serializer};

/// A name. Up to 23 bytes need no memory of their own.
pub type Name = smol_str::SmolStr;

/// Values by name, in ascending order of the names: a map of some dozen entries in one block of memory. As
/// JSON it is an object.
#[derive(Clone, PartialEq, Eq)]
pub struct ByName<V> {
    entries: Vec<(Name, V)>,
}

/// Names and references to their values, in ascending order of the names.
type Iter<'a, V> = std::iter::Map<std::slice::Iter<'a, (Name, V)>, fn(&(Name, V)) -> (&Name, &V)>;

impl<V> ByName<V> {
    /// Creates an empty map with room for this many entries.
    pub fn with_capacity(entries: usize) -> Self {
        Self { entries: Vec::with_capacity(entries) }
    }

    /// Returns whether there are no entries.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Returns the number of entries.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns the value of a name.
    pub fn get(&self, name: &str) -> Option<&V> {
        self.position(name).ok().map(|index| &self.entries[index].1)
    }

    /// Returns whether a name has a value.
    pub fn contains_key(&self, name: &str) -> bool {
        self.position(name).is_ok()
    }

    /// Gives a name a value, in place of the one that it may have.
    pub fn insert(&mut self, name: impl Into<Name>, value: V) {
        let name = name.into();
        // Names often come in ascending order.
        if self.entries.last().is_none_or(|(last, _)| *last < name) {
            self.entries.push((name, value));
            return;
        }
        match self.position(&name) {
            Ok(index) => self.entries[index].1 = value,
            Err(index) => self.entries.insert(index, (name, value)),
        }
    }

    /// Removes a name and returns its value.
    pub fn remove(&mut self, name: &str) -> Option<V> {
        self.position(name).ok().map(|index| self.entries.remove(index).1)
    }

    /// Returns the names and their values.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&Name, &V)> + DoubleEndedIterator + Clone {
        self.into_iter()
    }

    /// Returns the names.
    pub fn keys(&self) -> impl ExactSizeIterator<Item = &Name> + DoubleEndedIterator + Clone {
        self.entries.iter().map(|(name, _)| name)
    }

    /// Returns the values in the order of their names.
    pub fn values(&self) -> impl ExactSizeIterator<Item = &V> + DoubleEndedIterator + Clone {
        self.entries.iter().map(|(_, value)| value)
    }

    fn position(&self, name: &str) -> Result<usize, usize> {
        self.entries.binary_search_by(|(other, _)| other.as_str().cmp(name))
    }
}

impl<V> Default for ByName<V> {
    fn default() -> Self {
        Self { entries: Vec::new() }
    }
}

impl<V: fmt::Debug> fmt::Debug for ByName<V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_map().entries(self).finish()
    }
}

impl<V, N: AsRef<str> + ?Sized> Index<&N> for ByName<V> {
    type Output = V;

    /// Returns the value of a name.
    ///
    /// # Panics
    /// If the name has none.
    fn index(&self, name: &N) -> &V {
        let name = name.as_ref();
        self.get(name).unwrap_or_else(|| panic!("no value of {name:?}"))
    }
}

impl<N: Into<Name>, V> Extend<(N, V)> for ByName<V> {
    fn extend<I: IntoIterator<Item = (N, V)>>(&mut self, entries: I) {
        for (name, value) in entries {
            self.insert(name, value);
        }
    }
}

impl<N: Into<Name>, V> FromIterator<(N, V)> for ByName<V> {
    fn from_iter<I: IntoIterator<Item = (N, V)>>(entries: I) -> Self {
        let entries = entries.into_iter();
        let mut all = Self::with_capacity(entries.size_hint().0);
        all.extend(entries);
        all
    }
}

impl<N: Into<Name>, V, const ENTRIES: usize> From<[(N, V); ENTRIES]> for ByName<V> {
    fn from(entries: [(N, V); ENTRIES]) -> Self {
        entries.into_iter().collect()
    }
}

impl<V> IntoIterator for ByName<V> {
    type Item = (Name, V);
    type IntoIter = std::vec::IntoIter<(Name, V)>;

    fn into_iter(self) -> Self::IntoIter {
        self.entries.into_iter()
    }
}

impl<'a, V> IntoIterator for &'a ByName<V> {
    type Item = (&'a Name, &'a V);
    type IntoIter = Iter<'a, V>;

    fn into_iter(self) -> Self::IntoIter {
        self.entries.iter().map(|(name, value)| (name, value))
    }
}

impl<V: Serialize> Serialize for ByName<V> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self)
    }
}

impl<'de, V: Deserialize<'de>> Deserialize<'de> for ByName<V> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Entries(PhantomData))
    }
}

struct Entries<V>(PhantomData<V>);

impl<'de, V: Deserialize<'de>> Visitor<'de> for Entries<V> {
    type Value = ByName<V>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("values by name")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Self::Value, A::Error> {
        // No more at first than a record has, however many are announced.
        let mut all = ByName::with_capacity(entries.size_hint().unwrap_or(0).min(256));
        while let Some((name, value)) = entries.next_entry::<Name, V>()? {
            all.insert(name, value);
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// The reference is the standard library's map.
        #[test]
        fn entries_are_those_of_a_map(entries in prop::collection::vec(("[a-d]{0,2}", 0..9), 0..40), removed in "[a-d]{0,2}") {
            let mut map: BTreeMap<String, i32> = entries.iter().cloned().collect();
            let mut own: ByName<i32> = entries.into_iter().collect();
            prop_assert_eq!(own.remove(&removed), map.remove(&removed));
            prop_assert!(own.iter().map(|(name, value)| (name.as_str(), value)).eq(map.iter().map(|(name, value)| (name.as_str(), value))));
            prop_assert_eq!(own.get(&removed), None);
            for (name, value) in &map {
                prop_assert_eq!(own[name], *value);
            }
            let text = serde_json::to_string(&map).unwrap();
            prop_assert_eq!(&serde_json::to_string(&own).unwrap(), &text);
            prop_assert_eq!(serde_json::from_str::<ByName<i32>>(&text).unwrap(), own);
        }
    }
}
