//! How many tachometer pulses a protobuf message has, counted before it is decoded: what takes one byte there takes eight in memory.

use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

use super::RecordingError;
use super::pulses::MOST_PULSES;

/// Number of the field `tachometer` in `WaveformBlock`.
const TACHOMETER: u32 = 9;

/// Number of the field `pulse_time_ns` in `Tachometer`.
const PULSE_TIME: u32 = 1;

/// Refuses a `Tachometer` message with more pulses than are taken.
pub(super) fn check_tachometer(message: &[u8]) -> Result<(), RecordingError> {
    check(pulses_in(message))
}

/// Refuses a `WaveformBlock` message with more pulses than are taken. Several tachometers in it are merged, and so count together.
pub(super) fn check_block(message: &[u8]) -> Result<(), RecordingError> {
    let tachometers = Fields { left: message }.filter(|(tag, _)| *tag == TACHOMETER);
    check(tachometers.map(|(_, content)| pulses_in(content.unwrap_or_default())).sum())
}

fn check(pulses: usize) -> Result<(), RecordingError> {
    if pulses > MOST_PULSES {
        return Err(RecordingError::field(
            "the number of tachometer pulses",
            pulses,
            "at most 4194304: send them in shorter messages",
        ));
    }
    Ok(())
}

/// Pulses in a `Tachometer` message, packed or not.
fn pulses_in(message: &[u8]) -> usize {
    let times = Fields { left: message }.filter(|(tag, _)| *tag == PULSE_TIME);
    times
        .map(|(_, packed)| match packed {
            // Of each number only the last byte is below 128.
            Some(packed) => packed.iter().filter(|byte| **byte < 0x80).count(),
            None => 1,
        })
        .sum()
}

/// The fields of a message: number and, where a length stands before it, content. They end where something is wrong; the generated decoder comes no
/// further either, and says what it is.
struct Fields<'a> {
    left: &'a [u8],
}

impl<'a> Iterator for Fields<'a> {
    type Item = (u32, Option<&'a [u8]>);

    fn next(&mut self) -> Option<Self::Item> {
        if self.left.is_empty() {
            return None;
        }
        let (tag, wire_type) = decode_key(&mut self.left).ok()?;
        if wire_type != WireType::LengthDelimited {
            skip_field(wire_type, tag, &mut self.left, DecodeContext::default()).ok()?;
            return Some((tag, None));
        }
        let length = usize::try_from(decode_varint(&mut self.left).ok()?).ok()?;
        let (content, after) = self.left.split_at_checked(length)?;
        self.left = after;
        Some((tag, Some(content)))
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

    proptest! {
        #[test]
        fn as_many_are_counted_as_are_decoded(parts in prop::collection::vec(any_tachometer(), 1..4)) {
            let message = parts.concat();
            prop_assert_eq!(pulses_in(&message), Tachometer::decode(&message[..]).unwrap().pulse_time_ns.len());
        }

        /// What is wrong may hide pulses from neither.
        #[test]
        fn of_a_changed_message_no_more_are_decoded_than_counted(
            mut message in any_tachometer(),
            place in any::<prop::sample::Index>(),
            byte in any::<u8>(),
        ) {
            let place = place.index(message.len());
            message[place] = byte;
            let mut decoded = Tachometer::default();
            let _ = decoded.merge(&message[..]);
            prop_assert!(decoded.pulse_time_ns.len() <= pulses_in(&message));
        }
    }

    #[test]
    fn one_more_than_are_taken_is_refused_also_in_two_parts() {
        let most = Tachometer {
            pulse_time_ns: vec![1; MOST_PULSES],
            ..Default::default()
        };
        let block = WaveformBlock {
            tachometer: Some(most.clone()),
            ..Default::default()
        };
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
