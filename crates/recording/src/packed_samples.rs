//! Bulk copy of the samples of a waveform message.

use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

/// Number of the field `samples` in `WaveformBlock`.
const SAMPLES: u32 = 5;

/// A message is split only if it has at most this many bytes besides the samples, as these are copied.
const MAX_OTHER_BYTES: usize = 1 << 16;

/// Splits a `WaveformBlock` message into its packed samples and the bytes of its other fields, in order.
///
/// The generated decoder reads packed samples one by one, which takes several times as long as copying them.
/// `None` if the samples are not packed, or the message is damaged or large: then the generated decoder reads
/// it or reports the error.
pub(super) fn split(bytes: &[u8]) -> Option<(Vec<f32>, Vec<u8>)> {
    let (mut samples, mut others) = (Vec::new(), Vec::new());
    let mut left = bytes;
    while !left.is_empty() {
        let field = left;
        let (tag, wire_type) = decode_key(&mut left).ok()?;
        if tag != SAMPLES {
            skip_field(wire_type, tag, &mut left, DecodeContext::default()).ok()?;
            let field = &field[..field.len() - left.len()];
            if others.len() + field.len() > MAX_OTHER_BYTES {
                return None;
            }
            others.extend_from_slice(field);
            continue;
        }
        if wire_type != WireType::LengthDelimited {
            return None;
        }
        let length = usize::try_from(decode_varint(&mut left).ok()?).ok()?;
        let (packed, after) = left.split_at_checked(length)?;
        let (packed, rest) = packed.as_chunks();
        if !rest.is_empty() {
            return None;
        }
        samples.extend(packed.iter().map(|sample| f32::from_le_bytes(*sample)));
        left = after;
    }
    Some((samples, others))
}

#[cfg(test)]
mod tests {
    use prost::Message;

    use super::super::message::WaveformBlock;
    use super::*;

    /// What is split and put together is what the generated decoder makes of the whole.
    #[test]
    fn a_message_in_any_order_matches_the_generated_decoder() {
        let block = |unit: &str, samples: &[f32]| WaveformBlock {
            unit: unit.to_owned(),
            sample_rate_hz: 20_000.0,
            samples: samples.to_vec(),
            ..Default::default()
        };
        let first = block("g", &[1.0, -2.5, f32::MIN_POSITIVE]).encode_to_vec();
        let second = block("m/s2", &[0.25]).encode_to_vec();
        for bytes in
            [Vec::new(), first.clone(), [first.clone(), vec![0xfd, 0x7f, 1, 2, 3, 4], second].concat()]
        {
            let want = WaveformBlock::decode(&bytes[..]).unwrap();
            let (samples, others) = split(&bytes).unwrap();
            let rest = WaveformBlock::decode(&others[..]).unwrap();
            assert_eq!(WaveformBlock { samples, ..rest }, want);
        }
    }

    #[test]
    fn unpacked_or_damaged_messages_use_the_generated_decoder() {
        let unpacked = [&[0x2d_u8][..], &1.5_f32.to_le_bytes()].concat();
        let whole = [&[0x2a_u8, 8][..], &[0; 8]].concat();
        assert_eq!(split(&whole), Some((vec![0.0; 2], Vec::new())));
        for bytes in [&unpacked[..], &whole[..9], &[0x2a, 3, 0, 0, 0], &[0x2a, 0xff], &[0x0f]] {
            assert_eq!(split(bytes), None);
        }
        let long = WaveformBlock { unit: "g".repeat(MAX_OTHER_BYTES + 1), ..Default::default() };
        assert_eq!(split(&long.encode_to_vec()), None);
    }
}
