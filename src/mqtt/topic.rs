//! Topics: `{root}/{asset}/{point}/waveform` for records and `{root}/{asset}/{point}/rejected` for rejections.

use super::rejection::Rejection;
use super::settings::MqttSettings;
use crate::asset::AssetId;

const WAVEFORM: &str = "waveform";
const REJECTED: &str = "rejected";

/// The asset and the measuring point of a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Address {
    /// The asset.
    pub(super) asset: AssetId,
    /// The measuring point, which becomes the record's channel and overrides that of the message.
    pub(super) point: String,
}

/// Returns the topic filter to subscribe to.
pub(super) fn filter(settings: &MqttSettings) -> String {
    let topics = format!("{}/+/+/{WAVEFORM}", settings.root);
    match &settings.share {
        Some(share) => format!("$share/{share}/{topics}"),
        None => topics,
    }
}

/// Returns the topic for rejections of messages of a topic.
pub(super) fn rejected(topic: &str) -> String {
    let address = topic.rsplit_once('/').map_or(topic, |(address, _)| address);
    format!("{address}/{REJECTED}")
}

/// Parses a topic.
pub(super) fn read(root: &str, topic: &str) -> Result<Address, Rejection> {
    let rest = topic.strip_prefix(root).and_then(|rest| rest.strip_prefix('/')).unwrap_or_default();
    let mut levels = rest.split('/');
    let (Some(asset), Some(point), Some(WAVEFORM), None) =
        (levels.next(), levels.next(), levels.next(), levels.next())
    else {
        return Err(Rejection::field(400, "topic", topic, "{root}/{asset}/{point}/waveform"));
    };
    let Ok(asset) = AssetId::new(asset) else {
        let expected = "an asset of 1 to 64 characters of a-z, 0-9, - and _, the first a letter or digit";
        return Err(Rejection::field(400, "topic", topic, expected));
    };
    if point.is_empty() || point.len() > 200 || point.chars().any(char::is_control) {
        return Err(Rejection::field(
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
    fn asset_and_point_are_parsed() {
        let address = read("plant/7", "plant/7/gearbox-1/input/waveform").unwrap();
        assert_eq!((address.asset.as_str(), address.point.as_str()), ("gearbox-1", "input"));
        assert_eq!(rejected("plant/7/gearbox-1/input/waveform"), "plant/7/gearbox-1/input/rejected");
    }

    #[test]
    fn invalid_topics_are_rejected_with_what_was_expected() {
        for (topic, words) in [
            ("flankwatch/Pump/1/waveform", "a-z"),
            ("flankwatch//1/waveform", "a-z"),
            ("flankwatch/pump//waveform", "a point"),
            ("flankwatch/pump/1/2/waveform", "{asset}"),
            ("flankwatch/pump/waveform", "{asset}"),
            ("flankwatch2/pump/1/waveform", "{asset}"),
            ("flankwatch/pump/1/spectrum", "{asset}"),
        ] {
            let rejection = read("flankwatch", topic).unwrap_err();
            assert!(rejection.detail().contains(words), "{topic}: {}", rejection.detail());
        }
    }
}
