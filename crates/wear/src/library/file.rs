//! The library's file format: a header line with the format version and the content's hash, then the
//! manifest, the states and the curves as JSON.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::operating::FeatureCurves;
use super::{Library, LibraryError, LibraryState, Manifest};

/// Version of the file format.
pub const FORMAT_VERSION: u32 = 2;

/// First word of the first line.
const MAGIC: &str = "flankwatch-library";

#[derive(Serialize)]
struct BodyRef<'a> {
    manifest: &'a Manifest,
    states: &'a [LibraryState],
    tables: &'a [FeatureCurves],
}

#[derive(Deserialize)]
struct Body {
    manifest: Manifest,
    states: Vec<LibraryState>,
    /// Feature curves for each torque and, within it, each speed.
    tables: Vec<FeatureCurves>,
}

/// Encodes a library.
pub fn encode(library: &Library) -> Vec<u8> {
    let body = serde_json::to_vec(&BodyRef {
        manifest: library.manifest(),
        states: library.states(),
        tables: &library.tables,
    })
    .expect("numbers, strings and lists always serialise");
    let mut bytes = format!("{MAGIC} {FORMAT_VERSION} {}\n", hex(&body)).into_bytes();
    bytes.extend_from_slice(&body);
    bytes
}

/// Decodes a library.
///
/// # Errors
/// [`LibraryError::Version`], or [`LibraryError::Damaged`] where the content does not match its hash.
pub fn decode(bytes: &[u8]) -> Result<Library, LibraryError> {
    let damaged = |what: &str| LibraryError::Damaged(what.to_owned());
    let end = bytes.iter().take(200).position(|&b| b == b'\n').ok_or_else(|| damaged("no header line"))?;
    let header = std::str::from_utf8(&bytes[..end]).map_err(|_| damaged("the header line is not text"))?;
    let mut words = header.split(' ');
    if words.next() != Some(MAGIC) {
        return Err(damaged("the first line does not name a flankwatch library"));
    }
    let found: u32 =
        words.next().and_then(|word| word.parse().ok()).ok_or_else(|| damaged("no format version"))?;
    if found != FORMAT_VERSION {
        return Err(LibraryError::Version { found, expected: FORMAT_VERSION });
    }
    let body = &bytes[end + 1..];
    let (expected, actual) = (words.next().unwrap_or_default(), hex(body));
    if expected != actual {
        return Err(LibraryError::Damaged(format!(
            "its content has the hash {actual}, expected {expected:?}"
        )));
    }
    let body: Body =
        serde_json::from_slice(body).map_err(|error| LibraryError::Damaged(error.to_string()))?;
    let grid = &body.manifest.grid;
    for (what, found, expected) in [
        ("states", body.states.len(), grid.states),
        ("operating points", body.tables.len(), grid.operating_points()),
    ] {
        if found != expected {
            return Err(LibraryError::Damaged(format!("{found} {what}, expected {expected}")));
        }
    }
    let short = body.tables.iter().flatten().find(|(_, curve)| curve.len() != grid.states);
    if let Some((name, curve)) = short {
        return Err(LibraryError::Damaged(format!(
            "{} values of {name}, expected {}",
            curve.len(),
            grid.states
        )));
    }
    Ok(Library::from_parts(body.manifest, body.states, body.tables))
}

/// SHA-256 in hexadecimal.
pub(super) fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::synthetic_library;
    use super::*;

    #[test]
    fn a_library_reads_back_as_it_was_written() {
        let library = synthetic_library();
        assert_eq!(decode(&encode(&library)).unwrap(), library);
    }

    #[test]
    fn another_format_version_is_reported() {
        for found in [1, 99] {
            let error = decode(format!("flankwatch-library {found} abc\n{{}}").as_bytes()).unwrap_err();
            assert!(error.to_string().contains(&format!("version {found}, expected 2")), "{error}");
        }
    }

    proptest! {
        #[test]
        fn a_changed_byte_or_a_missing_end_is_found(position in 0.0..1.0f64, flip in 1u8.., cut in any::<bool>()) {
            let mut bytes = encode(&synthetic_library());
            let at = (position * bytes.len() as f64) as usize;
            if cut { bytes.truncate(at) } else { bytes[at] ^= flip }
            prop_assert!(decode(&bytes).is_err());
        }
    }
}
