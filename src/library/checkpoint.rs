//! Finished parts of a library that is being built, kept so that a stopped build can go on.
//!
//! A line that names the library, then one line a part with its hash. Parts are only ever added, so that a build that is cut off leaves at most one
//! broken line; broken lines are left out.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::file::{FORMAT_VERSION, hex};
use super::{LibraryError, LibraryState};
use crate::signal::Features;

const MAGIC: &str = "flankwatch-library-parts";

/// Where the parts of a library that will be kept in `path` are kept while it is built: beside it, with `.parts` added to its name.
pub fn checkpoint_beside(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".parts");
    PathBuf::from(name)
}

/// Neighbouring wear states at one torque and every speed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Part {
    /// Index of the first wear state.
    pub(super) first: usize,
    /// Index of the torque.
    pub(super) torque: usize,
    /// The whole states, at the nominal torque alone.
    pub(super) states: Vec<LibraryState>,
    /// Features over the speeds, then over the wear states.
    pub(super) features: Vec<Vec<Features>>,
}

/// The file, open for further parts.
#[derive(Debug)]
pub(super) struct Checkpoint {
    path: PathBuf,
    file: Mutex<File>,
}

impl Checkpoint {
    /// Opens the checkpoint of the library `id` and gives the parts that are in it; starts a new one where there is none or another library's.
    pub(super) fn open(path: &Path, id: &str) -> Result<(Self, Vec<Part>), LibraryError> {
        let failed = |source| LibraryError::Io {
            path: path.to_owned(),
            source,
        };
        let header = format!("{MAGIC} {FORMAT_VERSION} {id}");
        let parts = match fs::read(path) {
            Ok(bytes) => read(&bytes, &header, path),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(source) => return Err(failed(source)),
        };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder).map_err(failed)?;
        }
        if parts.is_none() {
            fs::write(path, format!("{header}\n")).map_err(failed)?;
        }
        let file = OpenOptions::new().append(true).open(path).map_err(failed)?;
        let checkpoint = Self {
            path: path.to_owned(),
            file: Mutex::new(file),
        };
        Ok((checkpoint, parts.unwrap_or_default()))
    }

    /// Adds a finished part.
    pub(super) fn add(&self, part: &Part) -> Result<(), LibraryError> {
        let body = serde_json::to_vec(part).expect("numbers, strings and lists always serialise");
        // It starts a line of its own, whatever an earlier build that was cut off has left.
        let mut line = format!("\n{} ", hex(&body)).into_bytes();
        line.extend_from_slice(&body);
        line.push(b'\n');
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(&line).map_err(|source| LibraryError::Io {
            path: self.path.clone(),
            source,
        })
    }

    /// Removes it: the library is kept whole.
    pub(super) fn remove(path: &Path) -> Result<(), LibraryError> {
        match fs::remove_file(path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => Err(LibraryError::Io {
                path: path.to_owned(),
                source,
            }),
            _ => Ok(()),
        }
    }
}

/// The whole parts, or nothing where the first line is not `header`.
fn read(bytes: &[u8], header: &str, path: &Path) -> Option<Vec<Part>> {
    let mut lines = bytes.split(|byte| *byte == b'\n');
    if lines.next() != Some(header.as_bytes()) {
        tracing::warn!(file = %path.display(), "the kept parts are damaged or another library's; beginning again");
        return None;
    }
    let part = |line: &[u8]| -> Option<Part> {
        let (hash, body) = line.split_at_checked(64)?;
        let body = body.strip_prefix(b" ")?;
        (hash == hex(body).as_bytes()).then(|| serde_json::from_slice(body).ok())?
    };
    let mut parts = Vec::new();
    for line in lines.filter(|line| !line.is_empty()) {
        match part(line) {
            Some(part) => parts.push(part),
            None => tracing::warn!(file = %path.display(), "a kept part is damaged; simulating it again"),
        }
    }
    Some(parts)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Write;

    use super::{Checkpoint, Part, checkpoint_beside};

    fn part(first: usize) -> Part {
        Part {
            first,
            torque: 1,
            states: Vec::new(),
            features: vec![Vec::new(); 3],
        }
    }

    #[test]
    fn whole_parts_are_taken_up_and_broken_ones_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = checkpoint_beside(&folder.path().join("new/library.fwlib"));
        assert!(path.ends_with("new/library.fwlib.parts"));
        let (checkpoint, parts) = Checkpoint::open(&path, "a").unwrap();
        assert_eq!(parts, []);
        checkpoint.add(&part(0)).unwrap();
        checkpoint.add(&part(8)).unwrap();
        drop(checkpoint);
        // Cut off in the middle of a line, then gone on with.
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 20]).unwrap();
        let (checkpoint, parts) = Checkpoint::open(&path, "a").unwrap();
        assert_eq!(parts, [part(0)]);
        checkpoint.add(&part(16)).unwrap();
        let (_, parts) = Checkpoint::open(&path, "a").unwrap();
        assert_eq!(parts, [part(0), part(16)]);
        // A changed byte.
        let mut bytes = fs::read(&path).unwrap();
        let place = bytes.iter().position(|byte| *byte == b'{').unwrap();
        bytes[place + 3] ^= 1;
        fs::write(&path, bytes).unwrap();
        assert_eq!(Checkpoint::open(&path, "a").unwrap().1, [part(16)]);
        Checkpoint::remove(&path).unwrap();
        Checkpoint::remove(&path).unwrap();
        assert!(!path.exists());
    }

    #[test]
    fn another_librarys_parts_are_not_taken() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.parts");
        Checkpoint::open(&path, "a").unwrap().0.add(&part(0)).unwrap();
        assert_eq!(Checkpoint::open(&path, "b").unwrap().1, []);
        assert_eq!(Checkpoint::open(&path, "a").unwrap().1, []);
        let mut file = fs::File::create(&path).unwrap();
        file.write_all(&[0xff; 100]).unwrap();
        let (checkpoint, parts) = Checkpoint::open(&path, "a").unwrap();
        assert_eq!(parts, []);
        checkpoint.add(&part(3)).unwrap();
        assert_eq!(Checkpoint::open(&path, "a").unwrap().1, [part(3)]);
    }
}
