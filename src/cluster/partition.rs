//! Partitions of the queue: all records of a channel are in the same one, so that one worker takes them.
//!
//! The key is the asset that owns the sensor, and the channel, as they are in the message. A record of a
//! shared sensor is one message, and the worker that stores it stores it for all assets of the sensor. The
//! channels of a recording are messages of their own and share nothing but their bytes.

use sha2::{Digest, Sha256};

use super::connection::Connection;
use super::message;
use crate::asset::AssetId;

/// Number of partitions. It is the same for all processes of a cluster: records of a partition that no worker
/// knows would wait for ever.
pub(super) const PARTITIONS: u16 = 64;

/// The records that one consumer delivers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    /// Those of a partition, for its owner.
    Partition(u16),
    /// Those that are enqueued without a partition, for any worker: by API nodes of a version without
    /// partitions, or on a server that they do not suit.
    Unpartitioned,
}

impl Source {
    /// Returns the sources of a queue with or without partitions.
    pub(super) fn all(has_partitions: bool) -> impl Iterator<Item = Self> {
        // First the one whose consumer takes everything in a cluster without partitions.
        let partitions = if has_partitions { PARTITIONS } else { 0 };
        std::iter::once(Self::Unpartitioned).chain((0..partitions).map(Self::Partition))
    }

    /// Returns the source of a channel's records in a queue with partitions.
    fn of(asset: &AssetId, channel: &str) -> Self {
        Self::Partition(partition_of(asset, channel))
    }

    /// Returns the subject on which a channel's records are enqueued.
    pub(super) fn subject_of(asset: &AssetId, channel: &str, connection: &Connection) -> String {
        let source = if connection.has_partitions() { Self::of(asset, channel) } else { Self::Unpartitioned };
        source.subject(connection)
    }

    /// Returns the subject on which a message is enqueued; one that cannot be read may be on any.
    pub(super) fn subject_of_message(payload: &[u8], connection: &Connection) -> String {
        match message::decode(payload) {
            Ok(record) => Self::subject_of(&record.metadata.asset_id, &record.metadata.channel, connection),
            Err(_) => Self::Unpartitioned.subject(connection),
        }
    }

    /// Returns the subject of its messages.
    pub(super) fn subject(self, connection: &Connection) -> String {
        match self {
            Self::Partition(number) => format!("{}.{number}", connection.work_subject()),
            Self::Unpartitioned => connection.work_subject(),
        }
    }

    /// Returns the name of its consumer.
    pub(super) fn consumer(self) -> String {
        match self {
            Self::Partition(number) => format!("partition-{number}"),
            Self::Unpartitioned => "workers".to_owned(),
        }
    }
}

/// Returns the partition of a channel. Part of the protocol between API nodes and workers of all versions.
fn partition_of(asset: &AssetId, channel: &str) -> u16 {
    let mut hash = Sha256::new();
    hash.update(asset.as_str().as_bytes());
    // No name of an asset has it.
    hash.update([0]);
    hash.update(channel.as_bytes());
    let hash = hash.finalize();
    u16::from_be_bytes([hash[0], hash[1]]) % PARTITIONS
}

#[cfg(test)]
mod tests {
    use super::*;

    fn partition(asset: &str, channel: &str) -> u16 {
        partition_of(&AssetId::new(asset).unwrap(), channel)
    }

    #[test]
    fn the_partition_of_a_channel_never_changes() {
        let found = [("pump", "1"), ("pump", "2"), ("pump", ""), ("gearbox-7", "gearbox/x"), ("fan", "Ä")]
            .map(|(asset, channel)| partition(asset, channel));
        assert_eq!(found, [38, 36, 41, 1, 19]);
    }

    #[test]
    fn channels_are_spread_evenly() {
        let mut counts = [0_u32; PARTITIONS as usize];
        for asset in 0..1000 {
            for channel in 1..=4 {
                counts[usize::from(partition(&format!("gearbox-{asset}"), &channel.to_string()))] += 1;
            }
        }
        // The mean is 62.5, the standard deviation of an even spread 7.8.
        let (least, most) = (counts.iter().min().unwrap(), counts.iter().max().unwrap());
        assert!(*least >= 35 && *most <= 95, "{counts:?}");
    }
}
