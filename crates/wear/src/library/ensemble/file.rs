//! The ensemble's file format: a header line with the format version, the id and the content's hash, then
//! numbers of fixed width in little-endian order.

use std::sync::Arc;

use super::super::file::hex;
use super::super::{Library, LibraryError};
use super::member::Simulated;
use super::{DEPTHS, Ensemble, MESH_LINES, Member};
use flankwatch_gear::ContactRule;

const MAGIC: &str = "flankwatch-ensemble";

/// Version of the file format.
const FORMAT_VERSION: u32 = 1;

/// Numbers in the tables of a member: lines, transmission error, places.
const FLOATS: usize = (MESH_LINES + 1 + 8) * DEPTHS;

/// Bytes of a member: draw, contact rule, shape, damping, tables.
const MEMBER_BYTES: usize = 4 + 1 + 1 + 8 + 4 * FLOATS;

/// Encodes an ensemble.
pub fn encode_ensemble(ensemble: &Ensemble) -> Vec<u8> {
    let mut body = Vec::with_capacity(ensemble.members.len() * MEMBER_BYTES);
    for (member, changes) in ensemble.members.iter().zip(ensemble.changes.tables()) {
        let draw = member.draw.map_or(u32::MAX, |draw| draw as u32);
        body.extend_from_slice(&draw.to_le_bytes());
        body.push(u8::from(member.contact == ContactRule::Loaded));
        body.push(u8::from(member.archard));
        body.extend_from_slice(&member.mesh_damping_ratio.to_le_bytes());
        let tables = [&changes, &member.transmission_error_um, &member.places];
        body.extend(tables.into_iter().flatten().flat_map(|value| value.to_le_bytes()));
    }
    let header = format!("{MAGIC} {FORMAT_VERSION} {} {}\n", ensemble.id, hex(&body));
    [header.into_bytes(), body].concat()
}

/// Decodes the ensemble around a library.
///
/// # Errors
/// [`LibraryError::Version`], or [`LibraryError::Damaged`] where the content does not match its hash.
pub fn decode_ensemble(bytes: &[u8], described: Arc<Library>) -> Result<Ensemble, LibraryError> {
    let damaged = |what: &str| LibraryError::Damaged(what.to_owned());
    let end = bytes.iter().take(200).position(|&b| b == b'\n').ok_or_else(|| damaged("no header line"))?;
    let header = std::str::from_utf8(&bytes[..end]).map_err(|_| damaged("the header line is not text"))?;
    let words: Vec<&str> = header.split(' ').collect();
    let [MAGIC, version, id, hash] = words[..] else {
        return Err(damaged("the first line does not name a flankwatch ensemble"));
    };
    let found: u32 = version.parse().map_err(|_| damaged("no format version"))?;
    if found != FORMAT_VERSION {
        return Err(LibraryError::Version { found, expected: FORMAT_VERSION });
    }
    let body = &bytes[end + 1..];
    if hash != hex(body) || !body.len().is_multiple_of(MEMBER_BYTES) {
        return Err(damaged("its content does not match its hash or size"));
    }
    let members = body.chunks_exact(MEMBER_BYTES).map(member).collect();
    Ok(Ensemble::from_members(id.to_owned(), described, members))
}

fn member(bytes: &[u8]) -> Simulated {
    let (head, tables) = bytes.split_at(MEMBER_BYTES - 4 * FLOATS);
    let draw = u32::from_le_bytes([head[0], head[1], head[2], head[3]]);
    let damping: [u8; 8] = std::array::from_fn(|i| head[6 + i]);
    let floats: Vec<f32> =
        tables.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let (changes, rest) = floats.split_at(MESH_LINES * DEPTHS);
    let (transmission_error_um, places) = rest.split_at(DEPTHS);
    let member = Member {
        draw: (draw != u32::MAX).then_some(draw as usize),
        contact: if head[4] == 1 { ContactRule::Loaded } else { ContactRule::Threshold },
        archard: head[5] == 1,
        mesh_damping_ratio: f64::from_le_bytes(damping),
        transmission_error_um: transmission_error_um.to_vec(),
        places: places.to_vec(),
    };
    Simulated { member, changes: changes.to_vec() }
}
