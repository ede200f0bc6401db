//! Parts of an MCAP topic: `/{asset}/{channel}/waveform`, `/{asset}/{shaft}/tachometer`.

use super::pulses::DRIVEN;

/// Returns the first part of a topic.
pub(super) fn asset_of(topic: &str) -> &str {
    let topic = topic.strip_prefix('/').unwrap_or(topic);
    topic.split_once('/').map_or(topic, |(asset, _)| asset)
}

/// Returns the record's channel: `/{asset}/{channel}/waveform` without its first and last part, any other
/// topic unchanged.
pub(super) fn channel_of(topic: &str) -> &str {
    let topic = topic.strip_prefix('/').unwrap_or(topic);
    match topic.strip_suffix("/waveform") {
        Some(path) => path.split_once('/').map_or(path, |(_, channel)| channel),
        None => topic,
    }
}

/// Returns the shaft of a tachometer message that does not state it: `driven` if that precedes `tachometer`,
/// else the driving one, as other words are locations.
pub(super) fn shaft_of(topic: &str) -> &str {
    let topic = topic.strip_prefix('/').unwrap_or(topic);
    let path = topic.strip_suffix("/tachometer").unwrap_or_default();
    match path.rsplit_once('/') {
        Some((_, shaft)) if shaft == DRIVEN => shaft,
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_gives_asset_and_channel() {
        for (topic, asset, channel) in [
            ("/pump-1/gearbox/x/waveform", "pump-1", "gearbox/x"),
            ("/pump-1/a1/waveform", "pump-1", "a1"),
            ("/a1/waveform", "a1", "a1"),
            ("vibration", "vibration", "vibration"),
            ("/robot/imu", "robot", "robot/imu"),
        ] {
            assert_eq!((asset_of(topic), channel_of(topic)), (asset, channel), "{topic}");
        }
    }

    #[test]
    fn a_topic_names_the_driven_shaft_and_no_other_but_the_driving_one() {
        for (topic, shaft) in [
            ("/pump/driven/tachometer", "driven"),
            ("/pump/gearbox/driven/tachometer", "driven"),
            ("/pump/tachometer", ""),
            ("/pump/driving/tachometer", ""),
            ("/pump/gearbox/tachometer", ""),
            // An asset of that name.
            ("/driven/tachometer", ""),
            ("/driven/gearbox/tachometer", ""),
            ("pulses", ""),
        ] {
            assert_eq!(shaft_of(topic), shaft, "{topic}");
        }
    }
}
