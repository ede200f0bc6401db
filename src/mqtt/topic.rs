//! Topics: `{root}/{asset}/{point}/waveform` for records, `…/samples` for blocks of a stream, and
//! `…/rejected` for rejections of both.

use super::rejection::Rejection;
use super::settings::MqttSettings;
use crate::asset::AssetId;

const WAVEFORM: &str = "waveform";
const SAMPLES: &str = "samples";
const REJECTED: &str = "rejected";

/// The asset and the measuring point of a topic.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Address {
    /// The asset.
    pub(super) asset: AssetId,
    /// The measuring point, which becomes the record's channel and overrides that of the message.
    pub(super) point: String,
}

/// What the messages of a topic are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    /// Each is a record.
    Record,
    /// Each is a block of a stream.
    Block,
}

/// Returns the topic filters to subscribe to.
pub(super) fn filters(settings: &MqttSettings) -> [String; 2] {
    [WAVEFORM, SAMPLES].map(|kind| {
        let topics = format!("{}/+/+/{kind}", settings.root);
        match &settings.share {
            Some(share) => format!("$share/{share}/{topics}"),
            None => topics,
        }
    })
}

/// Returns the topic for rejections of messages of a topic.
pub(super) fn rejected(topic: &str) -> String {
    let address = topic.rsplit_once('/').map_or(topic, |(address, _)| address);
    format!("{address}/{REJECTED}")
}

/// Parses a topic.
pub(super) fn read(root: &str, topic: &str) -> Result<(Address, Content), Rejection> {
    let rest = topic.strip_prefix(root).and_then(|rest| rest.strip_prefix('/')).unwrap_or_default();
    let mut levels = rest.split('/');
    let (asset, point, content) = match (levels.next(), levels.next(), levels.next(), levels.next()) {
        (Some(asset), Some(point), Some(WAVEFORM), None) => (asset, point, Content::Record),
        (Some(asset), Some(point), Some(SAMPLES), None) => (asset, point, Content::Block),
        _ => {
            let expected = "{root}/{asset}/{point}/waveform or {root}/{asset}/{point}/samples";
            return Err(Rejection::field(400, "topic", topic, expected));
        }
    };
    let Ok(asset) = AssetId::new(asset) else {
        let expected = "an asset of 1 to 64 characters of a-z, 0-9, - and _, the first a letter or digit";
        return Err(Rejection::field(400, "topic", topic, expected));
    };
    if point.is_empty() || point.chars().count() > 200 || point.chars().any(char::is_control) {
        return Err(Rejection::field(
            400,
            "topic",
            topic,
            "a point of 1 to 200 characters, none of them control characters",
        ));
    }
    Ok((Address { asset, point: point.to_owned() }, content))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn asset_and_point_are_parsed() {
        let (address, content) = read("plant/7", "plant/7/gearbox-1/input/waveform").unwrap();
        assert_eq!((address.asset.as_str(), address.point.as_str()), ("gearbox-1", "input"));
        assert_eq!(content, Content::Record);
        assert_eq!(read("plant/7", "plant/7/gearbox-1/input/samples").unwrap(), (address, Content::Block));
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
