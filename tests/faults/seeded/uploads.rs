//! The resumable uploads of a schedule.

use flankwatch::recording::{BlockEncoding, RecordDefaults, decode_block};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use super::life::Life;
use crate::resumable_client::{OFFSET_TYPE, TUS};
use crate::running::{mcap, plain_asset, record};

pub(super) const ASSET: &str = "lift";

/// Records of each upload.
const RECORDS: u32 = 2;

/// The description of the asset.
pub(super) fn asset() -> Value {
    plain_asset(ASSET)
}

/// An upload whose begin was acknowledged.
struct Upload {
    path: String,
    bytes: Vec<u8>,
    /// Number of acknowledged bytes.
    offset: usize,
    /// Number of bytes that were sent.
    sent: usize,
}

/// What is known about the uploads.
#[derive(Default)]
pub(super) struct KnownUploads {
    /// The upload that is being sent.
    current: Option<Upload>,
    /// Paths of those that were acknowledged completely.
    complete: Vec<String>,
    /// Number of uploads that were begun.
    begun: u32,
}

impl KnownUploads {
    /// Begins an upload, or sends the next bytes, as far as the disk allows.
    pub(super) fn send(&mut self, life: &Life, random: &mut ChaCha8Rng) {
        let Some(upload) = &mut self.current else { return self.begin(life) };
        let missing = upload.bytes.len() - upload.offset;
        let count = if random.random_bool(0.6) { missing } else { random.random_range(1..=missing) };
        let until = upload.offset + count;
        upload.sent = upload.sent.max(until);
        let answer = send(
            life,
            "PATCH",
            &upload.path,
            &[TUS, OFFSET_TYPE, ("upload-offset", &upload.offset.to_string())],
            &upload.bytes[upload.offset..until],
        );
        match answer {
            Some((204, _)) => self.advance(until),
            Some((status, _)) => {
                assert!(status >= 409, "{status}");
                if let Some(offset) = offset(life, &upload.path) {
                    self.advance(offset);
                }
            }
            None => {}
        }
    }

    fn begin(&mut self, life: &Life) {
        let records: Vec<_> = (0..RECORDS).map(|k| record("1", 100 + self.begun * RECORDS + k)).collect();
        let bytes = mcap(&records);
        let length = bytes.len().to_string();
        // The asset's name in base64.
        let headers = [TUS, ("upload-length", length.as_str()), ("upload-metadata", "asset bGlmdA==")];
        if let Some((201, location)) = send(life, "POST", "/v1/uploads", &headers, b"") {
            self.begun += 1;
            self.current = Some(Upload { path: location, bytes, offset: 0, sent: 0 });
        }
    }

    /// Records that the bytes before an offset are acknowledged.
    fn advance(&mut self, offset: usize) {
        let Some(upload) = &mut self.current else { return };
        assert!((upload.offset..=upload.sent).contains(&offset), "{offset}, not {}", upload.offset);
        upload.offset = offset;
        if offset == upload.bytes.len()
            && let Some(upload) = self.current.take()
        {
            self.complete.push(upload.path);
        }
    }

    /// Compares the uploads and their records with what was acknowledged.
    pub(super) fn check(&mut self, life: &Life) {
        if let Some(upload) = &self.current {
            let found = offset(life, &upload.path).expect("the upload was acknowledged");
            self.advance(found);
        }
        for path in &self.complete {
            let done = life.wait_for("an upload to be read", async || {
                let id = path.rsplit('/').next()?;
                let upload = life.service().store.resumable(id, life.service().now()).await.unwrap();
                let upload = upload.expect("the upload was acknowledged");
                upload.result.map(Ok).or(upload.error.map(Err))
            });
            let result: Value = serde_json::from_str(&done.unwrap()).unwrap();
            let count = |what: &str| result[what].as_u64().unwrap_or_default();
            assert_eq!(count("stored") + count("repeated"), u64::from(RECORDS), "{result}");
        }
        let stored = life.stored(ASSET);
        assert_eq!(stored.len(), self.complete.len() * RECORDS as usize);
        for (segment, n) in stored.iter().zip(100..) {
            let raw = life.service().store.objects().get(&segment.raw.sha256).unwrap();
            let found = decode_block(&raw, BlockEncoding::Protobuf, &RecordDefaults::default());
            // The reader marks the time between two records as a gap.
            assert!(found.is_ok_and(|found| found.samples() == record("1", n).samples()), "record {n}");
        }
    }
}

/// The offset of an upload; `None` if the response does not count.
fn offset(life: &Life, path: &str) -> Option<usize> {
    match send(life, "HEAD", path, &[TUS], b"")? {
        (200, offset) => Some(offset.parse().unwrap()),
        _ => None,
    }
}

/// Sends a request; returns its status, and the offset or location. A response after the disk has stopped
/// does not count.
fn send(
    life: &Life,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: &[u8],
) -> Option<(u16, String)> {
    let mut request = ureq::http::Request::builder().method(method).uri(life.url(path));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let agent = ureq::Agent::config_builder().http_status_as_error(false).build();
    let answer = ureq::Agent::from(agent).run(request.body(body).unwrap()).unwrap();
    let header = |name: &str| answer.headers().get(name).map(|value| value.to_str().unwrap().to_owned());
    let text = header(if method == "POST" { "location" } else { "upload-offset" }).unwrap_or_default();
    (!life.disk.is_stopped()).then(|| (answer.status().as_u16(), text))
}
