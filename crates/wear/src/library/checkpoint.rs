//! Checkpoint of a library build: its finished parts, from which a stopped build resumes.
//!
//! The file has a line with the library's id, then one line per part with its hash. It is append-only, so a
//! build that is killed leaves at most one incomplete line; damaged lines are skipped.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::LibraryError;
use super::file::{FORMAT_VERSION, hex};
use super::part::{Part, PartStore};

const MAGIC: &str = "flankwatch-library-parts";

/// Returns the path of the checkpoint for a library at `path`: the same path with `.parts` appended.
pub fn checkpoint_path(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".parts");
    PathBuf::from(name)
}

/// A checkpoint file.
#[derive(Debug)]
pub(super) struct Checkpoint {
    path: PathBuf,
    /// Open for appending after [`PartStore::open`].
    file: Mutex<Option<File>>,
}

impl Checkpoint {
    /// Creates the checkpoint for a library at the path `library`.
    pub(super) fn for_library(library: &Path) -> Self {
        Self::at(checkpoint_path(library))
    }

    fn at(path: PathBuf) -> Self {
        Self { path, file: Mutex::default() }
    }

    /// Removes the file, once the library is complete.
    pub(super) fn remove(&self) -> Result<(), LibraryError> {
        match fs::remove_file(&self.path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => Err(self.failed(source)),
            _ => Ok(()),
        }
    }

    fn failed(&self, source: io::Error) -> LibraryError {
        LibraryError::Io { path: self.path.clone(), source }
    }
}

impl PartStore for Checkpoint {
    /// Starts a new file where there is none or where it belongs to another library.
    fn open(&self, id: &str) -> Result<Vec<Part>, LibraryError> {
        let path = &self.path;
        let failed = |source| self.failed(source);
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
        *self.file.lock().unwrap_or_else(PoisonError::into_inner) = Some(file);
        Ok(parts.unwrap_or_default())
    }

    fn add(&self, part: &Part) -> Result<(), LibraryError> {
        let body = serde_json::to_vec(part).expect("numbers, strings and lists always serialise");
        // The leading newline ends an incomplete line that an earlier build may have left.
        let mut line = format!("\n{} ", hex(&body)).into_bytes();
        line.extend_from_slice(&body);
        line.push(b'\n');
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let closed = || io::Error::other("the checkpoint is not open");
        let file = file.as_mut().ok_or_else(|| self.failed(closed()))?;
        file.write_all(&line).map_err(|source| self.failed(source))
    }
}

/// Returns the intact parts, or `None` where the first line is not `header`.
fn read(bytes: &[u8], header: &str, path: &Path) -> Option<Vec<Part>> {
    let mut lines = bytes.split(|byte| *byte == b'\n');
    if lines.next() != Some(header.as_bytes()) {
        tracing::warn!(file = %path.display(), "the checkpoint is damaged or of another library; starting over");
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
            None => {
                tracing::warn!(file = %path.display(), "a part of the checkpoint is damaged; simulating it again")
            }
        }
    }
    Some(parts)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Write;
    use std::path::Path;

    use super::{Checkpoint, Part, PartStore, checkpoint_path};

    fn open(path: &Path, id: &str) -> (Checkpoint, Vec<Part>) {
        let checkpoint = Checkpoint::at(path.to_owned());
        let parts = checkpoint.open(id).unwrap();
        (checkpoint, parts)
    }

    fn part(first: usize) -> Part {
        Part { first, torque: 1, states: Vec::new(), features: vec![Vec::new(); 3] }
    }

    #[test]
    fn intact_parts_are_resumed_and_damaged_ones_skipped() {
        let folder = tempfile::tempdir().unwrap();
        let path = checkpoint_path(&folder.path().join("new/library.fwlib"));
        assert!(path.ends_with("new/library.fwlib.parts"));
        let (checkpoint, parts) = open(&path, "a");
        assert_eq!(parts, []);
        checkpoint.add(&part(0)).unwrap();
        checkpoint.add(&part(8)).unwrap();
        drop(checkpoint);
        // Truncated in the middle of a line, then continued.
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 20]).unwrap();
        let (checkpoint, parts) = open(&path, "a");
        assert_eq!(parts, [part(0)]);
        checkpoint.add(&part(16)).unwrap();
        let (_, parts) = open(&path, "a");
        assert_eq!(parts, [part(0), part(16)]);
        // A changed byte.
        let mut bytes = fs::read(&path).unwrap();
        let place = bytes.iter().position(|byte| *byte == b'{').unwrap();
        bytes[place + 3] ^= 1;
        fs::write(&path, bytes).unwrap();
        assert_eq!(open(&path, "a").1, [part(16)]);
        checkpoint.remove().unwrap();
        checkpoint.remove().unwrap();
        assert!(!path.exists());
    }

    #[test]
    fn another_librarys_parts_are_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.parts");
        open(&path, "a").0.add(&part(0)).unwrap();
        assert_eq!(open(&path, "b").1, []);
        assert_eq!(open(&path, "a").1, []);
        let mut file = fs::File::create(&path).unwrap();
        file.write_all(&[0xff; 100]).unwrap();
        let (checkpoint, parts) = open(&path, "a");
        assert_eq!(parts, []);
        checkpoint.add(&part(3)).unwrap();
        assert_eq!(open(&path, "a").1, [part(3)]);
    }
}
