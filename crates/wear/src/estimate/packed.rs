//! Probabilities packed to 16 bits, as the state of a channel stores them.

use base64::Engine;
use base64::engine::general_purpose::STANDARD_NO_PAD;
use pulp::Arch;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Probabilities relative to the highest one, with 5 bits of exponent and 11 of fraction: exact to a part in
/// 4000, down to 2⁻³¹.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Packed(Vec<u16>);

/// Bits of a single-precision fraction that are dropped, and the exponent bits below which values become 0.
const DROPPED_BITS: u32 = 12;
const MIN_EXPONENT: u32 = (127 - 31) << 23;

impl Packed {
    /// Packs probabilities.
    pub(super) fn of(values: &[f32]) -> Self {
        let mut packed = Self(vec![0; values.len()]);
        packed.set(values);
        packed
    }

    /// Returns their number.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Replaces all values by as many others.
    pub(super) fn set(&mut self, values: &[f32]) {
        Arch::new().dispatch(|| {
            let (eights, rest) = values.as_chunks::<8>();
            let mut highest = [f32::MIN_POSITIVE; 8];
            for eight in eights {
                // A comparison takes one instruction, `max` three.
                for (highest, value) in highest.iter_mut().zip(eight) {
                    *highest = if *value > *highest { *value } else { *highest };
                }
            }
            let highest = highest.iter().chain(rest).copied().fold(f32::MIN_POSITIVE, f32::max);
            let scale = 1.0 / highest;
            let packed = |value: &f32| {
                let bits = (value * scale).to_bits().saturating_add(1 << (DROPPED_BITS - 1));
                (bits.saturating_sub(MIN_EXPONENT) >> DROPPED_BITS).min(u32::from(u16::MAX)) as u16
            };
            self.0.iter_mut().zip(values).for_each(|(old, value)| *old = packed(value));
        });
    }

    /// Returns the probabilities, the highest as 1.
    pub(super) fn unpacked(&self) -> Vec<f32> {
        let value = |packed: &u16| match packed {
            0 => 0.0,
            packed => f32::from_bits((u32::from(*packed) << DROPPED_BITS) + MIN_EXPONENT),
        };
        Arch::new().dispatch(|| self.0.iter().map(value).collect())
    }
}

/// Base64 of the cells in little-endian order, with each run of zeros as a zero and its length.
impl Serialize for Packed {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = Vec::with_capacity(self.0.len());
        let mut cells = self.0.iter().peekable();
        while let Some(cell) = cells.next() {
            bytes.extend_from_slice(&cell.to_le_bytes());
            if *cell == 0 {
                let mut run: u16 = 1;
                while run < u16::MAX && cells.next_if(|next| **next == 0).is_some() {
                    run += 1;
                }
                bytes.extend_from_slice(&run.to_le_bytes());
            }
        }
        serializer.serialize_str(&STANDARD_NO_PAD.encode(bytes))
    }
}

impl<'de> Deserialize<'de> for Packed {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let bytes = STANDARD_NO_PAD.decode(text).map_err(serde::de::Error::custom)?;
        let mut words = bytes.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]]));
        let mut cells = Vec::new();
        while let Some(cell) = words.next() {
            let run = if cell == 0 { words.next().unwrap_or(1) } else { 1 };
            cells.extend(std::iter::repeat_n(cell, run.into()));
        }
        Ok(Self(cells))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_keeps_a_part_in_four_thousand() {
        let values: Vec<f32> = (0..2000).map(|i| (-0.01 * i as f32).exp()).collect();
        let packed = Packed::of(&values);
        for (value, back) in values.iter().zip(packed.unpacked()) {
            assert!((value - back).abs() <= value / 4000.0 || *value < 1e-9, "{value} {back}");
        }
        // Packing again changes nothing.
        assert_eq!(Packed::of(&packed.unpacked()), packed);
        let text = serde_json::to_string(&packed).unwrap();
        assert_eq!(serde_json::from_str::<Packed>(&text).unwrap(), packed);
    }

    #[test]
    fn a_run_of_zeros_is_short() {
        let mut values = vec![0.0_f32; 200_000];
        values[100_000] = 1.0;
        let packed = Packed::of(&values);
        let text = serde_json::to_string(&packed).unwrap();
        assert!(text.len() < 60, "{}", text.len());
        assert_eq!(serde_json::from_str::<Packed>(&text).unwrap(), packed);
    }
}
