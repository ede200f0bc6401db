//! What the topic of an MCAP message says: `/{asset}/{channel}/waveform`.

/// The first part of a topic.
pub(super) fn asset_of(topic: &str) -> &str {
    let topic = topic.strip_prefix('/').unwrap_or(topic);
    topic.split_once('/').map_or(topic, |(asset, _)| asset)
}

/// The record's channel: `/{asset}/{channel}/waveform` without its first and last part, another topic whole.
pub(super) fn channel_of(topic: &str) -> &str {
    let topic = topic.strip_prefix('/').unwrap_or(topic);
    match topic.strip_suffix("/waveform") {
        Some(path) => path.split_once('/').map_or(path, |(_, channel)| channel),
        None => topic,
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
}
