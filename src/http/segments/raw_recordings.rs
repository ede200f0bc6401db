//! `/v1/segments/{segment}/raw`: the bytes as received.

use axum::body::Body;
use axum::extract::State;
use axum::http::header::{self, HeaderValue};
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use futures_util::stream::unfold;

use super::find;
use crate::asset::Segment;
use crate::http::access::client::{Client, ClientPermit};
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::etag;
use crate::http::request::query::SegmentPath;

/// The raw recording of a segment
///
/// The bytes as received, with all channels of the upload.
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/raw",
    tag = "records",
    responses((status = 200, description = "The recording, in its original media type", content(
        (Vec<u8> = "audio/wav"), (Vec<u8> = "audio/flac"), (Vec<u8> = "application/x-protobuf"), (Vec<u8> = "application/octet-stream"), (Vec<u8> = "text/csv"),
        (Vec<u8> = "application/x-matlab-data"), (Vec<u8> = "application/x-npy"),
        (serde_json::Value = "application/json")
    ))),
)]
pub(crate) async fn download(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    client: Client,
) -> Result<Response, Problem> {
    let segment = find(&app, &id).await?;
    let too_many = || Problem::busy("too many recordings are downloaded by this client or in total", 5);
    let permit = app.service.download_limiter.try_acquire(client).ok_or_else(too_many)?;
    let bytes = app.service.records.check_raw(&segment).await?;
    let (media_type, ending) = form_of(&segment.raw.media_type);
    let disposition = format!("attachment; filename=\"{}.{ending}\"", file_name(&segment));
    let disposition = HeaderValue::try_from(disposition).unwrap_or(HeaderValue::from_static("attachment"));
    let fields = [
        (header::CONTENT_TYPE, HeaderValue::from_static(media_type)),
        (header::CONTENT_DISPOSITION, disposition),
        (header::CONTENT_LENGTH, HeaderValue::from(bytes)),
        // JSON without a tag would be read into memory to compute one
        (header::ETAG, etag::of_bytes(&[segment.raw.sha256.as_bytes()])),
    ];
    Ok((fields, pieces(app, segment, bytes, permit)).into_response())
}

/// The raw bytes, read piece by piece as the client takes them; the permit is held until the end.
fn pieces(app: App, segment: Segment, bytes: u64, permit: ClientPermit) -> Body {
    let pieces = unfold((app, segment, 0, permit), move |(app, segment, offset, permit)| async move {
        if offset >= bytes {
            return None;
        }
        let piece = app.service.records.raw_piece(&segment, bytes, offset).await;
        // Ends after an error
        let next = piece.as_ref().map_or(bytes, |piece| offset + piece.len() as u64);
        Some((piece, (app, segment, next, permit)))
    });
    // Compression polls once more after the end
    Body::from_stream(pieces.fuse())
}

/// The media type and file extension of a response. The stored layout parameters are internal.
fn form_of(media_type: &str) -> (&'static str, &'static str) {
    match media_type.split(';').next().unwrap_or_default().trim() {
        "audio/wav" | "audio/x-wav" | "audio/wave" | "audio/vnd.wave" => ("audio/wav", "wav"),
        "audio/flac" => ("audio/flac", "flac"),
        "text/csv" => ("text/csv", "csv"),
        "application/x-npy" => ("application/x-npy", "npy"),
        "application/x-matlab-data" => ("application/x-matlab-data", "mat"),
        "application/json" => ("application/json", "json"),
        "application/x-protobuf" | "application/protobuf" => ("application/x-protobuf", "pb"),
        _ => ("application/octet-stream", "raw"),
    }
}

/// Asset, channel and time, in characters that are valid in file names on every system.
fn file_name(segment: &Segment) -> String {
    let name = format!("{}-{}-{}", segment.asset_id, segment.channel, segment.start_time);
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || ".-_".contains(letter);
    name.chars().map(|letter| if is_plain(letter) { letter } else { '-' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_layout_and_unit_parameters_are_not_returned() {
        assert_eq!(form_of("audio/wav; unit=g"), ("audio/wav", "wav"));
        assert_eq!(form_of("audio/flac;scale=50; unit=g"), ("audio/flac", "flac"));
        assert_eq!(form_of("application/octet-stream; sample=i16").1, "raw");
        assert_eq!(form_of("text/html"), ("application/octet-stream", "raw"));
    }
}
