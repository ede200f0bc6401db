//! Topics: `{root}/{asset}/{point}/waveform` and, for what cannot be used, `{root}/{asset}/{point}/rejected`.

use super::refusal::Refusal;
use super::settings::MqttSettings;
use crate::asset::AssetId;

const WAVEFORM: &str = "waveform";
const REJECTED: &str = "rejected";

/// What a topic says of its message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Address {
    /// The asset.
    pub(super) asset: AssetId,
    /// The measuring point: the channel's name, whatever the message calls it.
    pub(super) point: String,
}

/// The filter that is subscribed to.
pub(super) fn filter(settings: &MqttSettings) -> String {
    let topics = format!("{}/+/+/{WAVEFORM}", settings.root);
    match &settings.share {
        Some(share) => format!("$share/{share}/{topics}"),
        None => topics,
    }
}

/// Where the sender of a message is told that it cannot be used.
pub(super) fn rejected(topic: &str) -> String {
    let address = topic.rsplit_once('/').map_or(topic, |(address, _)| address);
    format!("{address}/{REJECTED}")
}

/// Reads a topic.
pub(super) fn read(root: &str, topic: &str) -> Result<Address, Refusal> {
    let rest = topic.strip_prefix(root).and_then(|rest| rest.strip_prefix('/')).unwrap_or_default();
    let mut levels = rest.split('/');
    let (Some(asset), Some(point), Some(WAVEFORM), None) =
        (levels.next(), levels.next(), levels.next(), levels.next())
    else {
        return Err(Refusal::field(400, "topic", topic, "{root}/{asset}/{point}/waveform"));
    };
    let Ok(asset) = AssetId::new(asset) else {
        let expected = "an asset of 1 to 64 characters of a-z, 0-9, - and _, the first a letter or digit";
        return Err(Refusal::field(400, "topic", topic, expected));
    };
    if point.is_empty() || point.len() > 200 || point.chars().any(char::is_control) {
        return Err(Refusal::field(
            400,
            "topic",
            topic,
            "a point of 1 to 200 bytes without control characters",
        ));
    }
    Ok(Address { asset, point: point.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn asset_and_point_are_read() {
        let address = read("plant/7", "plant/7/gearbox-1/input/waveform").unwrap();
        assert_eq!((address.asset.as_str(), address.point.as_str()), ("gearbox-1", "input"));
        assert_eq!(rejected("plant/7/gearbox-1/input/waveform"), "plant/7/gearbox-1/input/rejected");
    }

    #[test]
    fn other_topics_are_refused_with_what_was_expected() {
        for (topic, words) in [
            ("flankwatch/Pump/1/waveform", "a-z"),
            ("flankwatch//1/waveform", "a-z"),
            ("flankwatch/pump//waveform", "a point"),
            ("flankwatch/pump/1/2/waveform", "{asset}"),
            ("flankwatch/pump/waveform", "{asset}"),
            ("flankwatch2/pump/1/waveform", "{asset}"),
            ("flankwatch/pump/1/spectrum", "{asset}"),
        ] {
            let refusal = read("flankwatch", topic).unwrap_err();
            assert!(refusal.detail().contains(words), "{topic}: {}", refusal.detail());
        }
    }
}
