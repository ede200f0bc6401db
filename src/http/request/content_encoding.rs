//! Content encodings of bodies: gzip and zstd, decoded in small steps so that the output can be limited.

use std::io::{self, Write};

use axum::http::{HeaderMap, StatusCode, header};
use flate2::write::MultiGzDecoder;
use zstd::stream::raw::{Decoder as ZstdDecoder, Operation};

use crate::http::problem::Problem;

/// Bytes decoded per step: at the maximum ratio (zstd: 32000) this gives tens of megabytes.
pub(crate) const STEP: usize = 1024;

/// Logarithm of the largest zstd window accepted: 8 MiB, which every decoder has to support.
const MAX_WINDOW_LOG: u32 = 23;

/// The encoding of a body.
pub(crate) enum ContentEncoding {
    /// None.
    Identity,
    /// gzip, of one or more members.
    Gzip(Box<MultiGzDecoder<Vec<u8>>>),
    /// Zstandard, and whether the decoder is at the end of a frame.
    Zstd(Box<ZstdDecoder<'static>>, bool),
}

impl ContentEncoding {
    /// Reads the encoding from the header fields.
    pub(crate) fn of(headers: &HeaderMap) -> Result<Self, Problem> {
        let Some(coding) = headers.get(header::CONTENT_ENCODING) else {
            return Ok(Self::Identity);
        };
        match coding.to_str().map(|coding| coding.trim().to_ascii_lowercase()).as_deref() {
            Ok("identity" | "") => Ok(Self::Identity),
            Ok("gzip" | "x-gzip") => Ok(Self::Gzip(Box::new(MultiGzDecoder::new(Vec::new())))),
            Ok("zstd") => {
                let mut decoder = ZstdDecoder::new().map_err(broken)?;
                decoder
                    .set_parameter(zstd::stream::raw::DParameter::WindowLogMax(MAX_WINDOW_LOG))
                    .map_err(broken)?;
                Ok(Self::Zstd(Box::new(decoder), true))
            }
            _ => {
                let detail = format!("content-encoding is {coding:?}, expected gzip, zstd or none");
                Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, detail))
            }
        }
    }

    /// Whether the body is not encoded.
    pub(crate) fn is_identity(&self) -> bool {
        matches!(self, Self::Identity)
    }

    /// Decodes one step of at most [`STEP`] bytes; without an encoding, any length.
    pub(crate) fn decode(&mut self, step: &[u8], out: &mut Vec<u8>) -> Result<(), Problem> {
        match self {
            Self::Identity => out.extend_from_slice(step),
            Self::Gzip(decoder) => {
                decoder.write_all(step).map_err(not_gzip)?;
                out.append(decoder.get_mut());
            }
            Self::Zstd(decoder, is_whole) => {
                let mut rest = step;
                let mut buffer = [0; 16 << 10];
                loop {
                    if rest.is_empty() && *is_whole {
                        break;
                    }
                    let status = decoder.run_on_buffers(rest, &mut buffer).map_err(broken)?;
                    rest = &rest[status.bytes_read..];
                    out.extend_from_slice(&buffer[..status.bytes_written]);
                    *is_whole = status.remaining == 0;
                    if rest.is_empty() && status.bytes_written < buffer.len() {
                        break;
                    }
                }
            }
        }
        Ok(())
    }

    /// Returns the remaining output; fails if the body is incomplete.
    pub(crate) fn finish(mut self, out: &mut Vec<u8>) -> Result<(), Problem> {
        match &mut self {
            Self::Identity => Ok(()),
            Self::Gzip(decoder) => {
                decoder.try_finish().map_err(incomplete)?;
                out.append(decoder.get_mut());
                Ok(())
            }
            Self::Zstd(_, true) => Ok(()),
            Self::Zstd(_, false) => Err(broken(io::ErrorKind::UnexpectedEof.into())),
        }
    }
}

/// Only the header of a further member is invalid input after bytes were decoded.
fn not_gzip(error: io::Error) -> Problem {
    match error.kind() {
        io::ErrorKind::InvalidInput => {
            let detail = "the body does not match content-encoding: at its beginning, or after the \
                          compressed data, are bytes that are not gzip";
            Problem::new(StatusCode::BAD_REQUEST, detail)
        }
        _ => broken(error),
    }
}

/// At the end of the body, its gzip data end too.
fn incomplete(error: io::Error) -> Problem {
    match error.kind() {
        io::ErrorKind::InvalidInput | io::ErrorKind::UnexpectedEof => {
            let detail = "the body does not match content-encoding: the gzip data end early, or their checksum \
                          is wrong";
            Problem::new(StatusCode::BAD_REQUEST, detail)
        }
        _ => broken(error),
    }
}

fn broken(error: io::Error) -> Problem {
    Problem::new(StatusCode::BAD_REQUEST, format!("the body does not match content-encoding: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn decode(coding: &'static str, bytes: &[u8]) -> Result<Vec<u8>, Problem> {
        let mut headers = HeaderMap::new();
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(coding));
        let mut coding = ContentEncoding::of(&headers)?;
        let mut out = Vec::new();
        for step in bytes.chunks(STEP) {
            coding.decode(step, &mut out)?;
        }
        coding.finish(&mut out)?;
        Ok(out)
    }

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn bodies_are_decoded_and_truncated_ones_refused() {
        let mut bytes: Vec<u8> = (0..300_000_u32).flat_map(|n| n.wrapping_mul(n).to_le_bytes()).collect();
        bytes.resize(bytes.len() + 500_000, 0);
        for (coding, coded) in [("gzip", gzip(&bytes)), ("zstd", zstd::bulk::compress(&bytes, 3).unwrap())] {
            assert!(decode(coding, &coded).unwrap() == bytes, "{coding}");
            assert!(decode(coding, &coded[..coded.len() - 5]).is_err(), "{coding} cut off");
            assert!(decode(coding, b"something else entirely").is_err(), "{coding} broken");
        }
        let mut coded = gzip(&bytes);
        coded.truncate(coded.len() / 2);
        for cut in [coded, gzip(b"abc")[..20].to_vec(), Vec::new()] {
            let problem = decode("gzip", &cut).unwrap_err();
            assert!(problem.detail().contains("end early"), "{}: {}", cut.len(), problem.detail());
        }
        let parts = [gzip(&bytes[..1000]), gzip(&bytes[1000..])].concat();
        assert!(decode("gzip", &parts).unwrap() == bytes, "two members");
        let problem = decode("gzip", &[gzip(b"abc"), b"more bytes".to_vec()].concat()).unwrap_err();
        assert!(problem.detail().contains("not gzip"), "{}", problem.detail());
        assert!(decode("br", b"").is_err());
        assert_eq!(decode("identity", b"abc").unwrap(), b"abc");
    }
}
