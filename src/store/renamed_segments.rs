//! Segments of databases from before their identifiers began with the time: the same hash, behind the second.

/// Without it a record that is there and comes again would be another one. What was answered under clients' keys names segments as they were:
/// such an upload is found by its record instead.
pub(super) const BY_TIME: &[&str] = &[
    "CREATE TABLE renamed_segments (former TEXT NOT NULL PRIMARY KEY, id TEXT NOT NULL)",
    "INSERT INTO renamed_segments (former, id) SELECT id, {second_of_start} || substr(id, 1, 15) FROM segments",
    "INSERT INTO segments (id, channel_no, start_time_ns, received_at_ns, sample_rate_hz, samples, unit, operating_point, reference_wear_um,
            raw_sha256, raw_bytes, raw_media_type, raw_channel_index)
        SELECT r.id, s.channel_no, s.start_time_ns, s.received_at_ns, s.sample_rate_hz, s.samples, s.unit, s.operating_point, s.reference_wear_um,
            s.raw_sha256, s.raw_bytes, s.raw_media_type, s.raw_channel_index
        FROM segments s JOIN renamed_segments r ON r.former = s.id",
    "UPDATE analyses SET segment_id = (SELECT r.id FROM renamed_segments r WHERE r.former = segment_id)",
    "UPDATE wear_estimates SET segment_id = (SELECT r.id FROM renamed_segments r WHERE r.former = segment_id)",
    "UPDATE wear_posteriors SET segment_id = (SELECT r.id FROM renamed_segments r WHERE r.former = segment_id)",
    // These may stand between two records, where there is no identifier.
    "UPDATE fold_states SET segment_id = COALESCE((SELECT r.id FROM renamed_segments r WHERE r.former = segment_id), segment_id)",
    "UPDATE channels SET changed_from_id = COALESCE((SELECT r.id FROM renamed_segments r WHERE r.former = changed_from_id), changed_from_id)",
    "UPDATE channels SET last_segment_id = (SELECT r.id FROM renamed_segments r WHERE r.former = last_segment_id)",
    "DELETE FROM segments WHERE id IN (SELECT former FROM renamed_segments)",
    "DELETE FROM keyed_uploads",
    "DROP TABLE renamed_segments",
];
