//! A client for resumable uploads.

use std::path::PathBuf;

use serde_json::Value;

use crate::running::{Answer, Service, mcap, record};

pub(crate) const TUS: (&str, &str) = ("tus-resumable", "1.0.0");
pub(crate) const OFFSET_TYPE: (&str, &str) = ("content-type", "application/offset+octet-stream");

/// Requests an upload of `length` bytes for the asset `pump`.
pub(crate) fn ask(service: &Service, length: usize) -> Answer {
    let length = length.to_string();
    // "pump" in base64
    let headers = [TUS, ("upload-length", length.as_str()), ("upload-metadata", "asset cHVtcA==")];
    service.send("POST", "/v1/uploads", &headers, b"")
}

/// Starts an upload for the asset `pump` and returns its path.
#[track_caller]
pub(crate) fn begin(service: &Service, length: usize) -> String {
    ask(service, length).expect(201).header("location").to_owned()
}

pub(crate) fn patch(service: &Service, path: &str, at: usize, bytes: &[u8]) -> Answer {
    let at = at.to_string();
    service.send("PATCH", path, &[TUS, OFFSET_TYPE, ("upload-offset", &at)], bytes)
}

#[track_caller]
pub(crate) fn offset(service: &Service, path: &str) -> usize {
    let head = service.send("HEAD", path, &[TUS], b"").expect(200);
    head.header("upload-offset").parse().unwrap()
}

/// Waits until an upload is read, and checks the number of stored records.
#[track_caller]
pub(crate) fn expect_read(service: &Service, path: &str, records: u64) {
    let done =
        service.wait_for(path, |upload| upload["error"] != Value::Null || upload["state"] == "finished");
    let count = |what: &str| done["result"][what].as_u64().unwrap_or_default();
    assert_eq!(count("stored") + count("repeated"), records, "{done}");
    assert_eq!((&done["error"], &done["waits_for"]), (&Value::Null, &Value::Null), "{done}");
}

/// Returns the folder of an upload's parts.
pub(crate) fn pieces(service: &Service, path: &str) -> PathBuf {
    service.folder().join("raw/uploads").join(path.rsplit('/').next().unwrap())
}

/// Returns a recording of the records `from..to`.
pub(crate) fn recording(from: u32, to: u32) -> Vec<u8> {
    mcap(&(from..to).map(|n| record("1", n)).collect::<Vec<_>>())
}
