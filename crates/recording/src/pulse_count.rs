//! Number of tachometer pulses in a protobuf message, counted before decoding: one byte of the message may
//! take eight in memory.

use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

use super::RecordingError;
use super::pulses::MAX_PULSES;

/// Number of the field `tachometer` in `WaveformBlock`.
const TACHOMETER: u32 = 9;

/// Number of the field `pulse_time_ns` in `Tachometer`.
const PULSE_TIME: u32 = 1;

/// Rejects a `Tachometer` message with more than the maximum number of pulses.
pub(super) fn check_tachometer(message: &[u8]) -> Result<(), RecordingError> {
    check(pulses_in(message, message.len()))
}

/// Rejects a `WaveformBlock` message with more than the maximum number of pulses.
pub(super) fn check_block(message: &[u8]) -> Result<(), RecordingError> {
    check(pulses_in_block(message))
}

fn check(pulses: usize) -> Result<(), RecordingError> {
    if pulses > MAX_PULSES {
        return Err(RecordingError::field(
            "the number of tachometer pulses",
            pulses,
            "at most 4194304: send them in shorter messages",
        ));
    }
    Ok(())
}

/// Counts the pulses in a `WaveformBlock` message. Several tachometers in it are merged when decoding, so
/// they are summed.
fn pulses_in_block(message: &[u8]) -> usize {
    let tachometers = Fields { left: message, after: 0 }.filter(|(tag, _)| *tag == TACHOMETER);
    let lengths = tachometers.filter_map(|(_, content)| content);
    lengths.map(|(bytes, length)| pulses_in(bytes, length)).sum()
}

/// Counts the pulses, packed or not, in a `Tachometer` message that is the first `length` of these bytes.
fn pulses_in(bytes: &[u8], length: usize) -> usize {
    let after = bytes.len() - length;
    let times = Fields { left: bytes, after }.filter(|(tag, _)| *tag == PULSE_TIME);
    times
        .map(|(_, content)| match content {
            Some((bytes, length)) => {
                let packed = &bytes[..length];
                // Only the last byte of each number is below 128. A number that continues past the end is
                // decoded before that is detected.
                packed.iter().filter(|byte| **byte < 0x80).count()
                    + usize::from(packed.last().is_some_and(|last| *last >= 0x80))
            }
            None => 1,
        })
        .sum()
}

/// The fields of a message: number and, for length-delimited fields, the bytes from the content on and its
/// length.
///
/// It follows the generated decoder, which detects only after a field that the field exceeds its message, and
/// hence decodes it completely. At any other error both stop.
struct Fields<'a> {
    left: &'a [u8],
    /// Number of remaining bytes at the message's end.
    after: usize,
}

impl<'a> Iterator for Fields<'a> {
    type Item = (u32, Option<(&'a [u8], usize)>);

    fn next(&mut self) -> Option<Self::Item> {
        if self.left.len() <= self.after {
            return None;
        }
        let (tag, wire_type) = decode_key(&mut self.left).ok()?;
        if wire_type != WireType::LengthDelimited {
            skip_field(wire_type, tag, &mut self.left, DecodeContext::default()).ok()?;
            return Some((tag, None));
        }
        let length = usize::try_from(decode_varint(&mut self.left).ok()?).ok()?;
        let bytes = self.left;
        self.left = bytes.get(length..)?;
        Some((tag, Some((bytes, length))))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use prost::Message;

    use super::super::message::{Tachometer, WaveformBlock};
    use super::*;

    /// A tachometer message with these times, packed or one by one.
    fn tachometer((times, is_packed): (Vec<i64>, bool)) -> Vec<u8> {
        let mut bytes = Vec::new();
        if is_packed {
            prost::encoding::int64::encode_packed(PULSE_TIME, &times, &mut bytes);
        } else {
            prost::encoding::int64::encode_repeated(PULSE_TIME, &times, &mut bytes);
        }
        bytes.extend([0x10, 60, 0x1a, 2, b'h', b's']);
        bytes
    }

    fn any_tachometer() -> impl Strategy<Value = Vec<u8>> {
        (prop::collection::vec(any::<i64>(), 0..40), any::<bool>()).prop_map(tachometer)
    }

    /// Pulses that the generated decoder takes of a block before it ends, whether it finds something wrong or
    /// not.
    fn decoded(block: &[u8]) -> usize {
        let mut decoded = WaveformBlock::default();
        let _ = decoded.merge(block);
        decoded.tachometer.map_or(0, |tachometer| tachometer.pulse_time_ns.len())
    }

    fn block_of(tachometers: &[Vec<u8>]) -> Vec<u8> {
        let mut block = Vec::new();
        for tachometer in tachometers {
            prost::encoding::bytes::encode(TACHOMETER, tachometer, &mut block);
            prost::encoding::string::encode(4, &"g".to_owned(), &mut block);
        }
        block
    }

    proptest! {
        #[test]
        fn the_count_equals_the_decoded_pulses(parts in prop::collection::vec(any_tachometer(), 1..4)) {
            let message = parts.concat();
            prop_assert_eq!(pulses_in(&message, message.len()), Tachometer::decode(&message[..]).unwrap().pulse_time_ns.len());
            let block = block_of(&parts);
            prop_assert_eq!(pulses_in_block(&block), decoded(&block));
        }

        #[test]
        fn a_corrupted_message_decodes_at_most_the_count(
            parts in prop::collection::vec(any_tachometer(), 1..4),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..3),
        ) {
            let mut message = parts.concat();
            let mut block = block_of(&parts);
            for (place, byte) in changes {
                let (in_message, in_block) = (place.index(message.len()), place.index(block.len()));
                message[in_message] = byte;
                block[in_block] = byte;
            }
            let mut tachometer = Tachometer::default();
            let _ = tachometer.merge(&message[..]);
            prop_assert!(tachometer.pulse_time_ns.len() <= pulses_in(&message, message.len()));
            prop_assert!(decoded(&block) <= pulses_in_block(&block));
        }
    }

    #[test]
    fn pulses_beyond_the_end_of_their_tachometer_count() {
        // A tachometer of two bytes whose pulses go on for a hundred.
        let block = [vec![0x4a, 2, 0x0a, 100], vec![1; 100]].concat();
        assert_eq!((decoded(&block), pulses_in_block(&block)), (100, 100));
        let unfinished = [0x0a, 2, 1, 0x80, 1];
        assert_eq!(pulses_in(&unfinished, unfinished.len()), 2);
    }

    #[test]
    fn one_pulse_too_many_is_rejected_even_in_two_parts() {
        let most = Tachometer { pulse_time_ns: vec![1; MAX_PULSES], ..Default::default() };
        let block = WaveformBlock { tachometer: Some(most.clone()), ..Default::default() };
        let (most, block) = (most.encode_to_vec(), block.encode_to_vec());
        assert!(check_tachometer(&most).is_ok() && check_block(&block).is_ok());
        let refused = check_tachometer(&[most, vec![0x08, 1]].concat()).unwrap_err().to_string();
        assert_eq!(
            refused,
            "the number of tachometer pulses is 4194305, expected at most 4194304: send them in shorter messages"
        );
        let refused = check_block(&[block, vec![0x4a, 2, 0x08, 1]].concat()).unwrap_err().to_string();
        assert!(refused.contains("is 4194305"), "{refused}");
    }
}
